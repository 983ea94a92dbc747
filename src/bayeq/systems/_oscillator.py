"""What the four oscillators of Nayek, Worden and Cross have in common (section 4 of the paper)."""

from __future__ import annotations

from collections.abc import Mapping

from bayeq.citation import PAPER
from bayeq.systems.system import BandLimitedForce, System

__all__ = ["oscillator"]


def oscillator(
    name: str,
    title: str,
    restoring: str = "",
    terms: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
) -> System:
    """``m*a + c*v + k*x + g(x, v) = u`` with a band-limited Gaussian force; `restoring` is g, `terms` are its own."""
    force = "u-c*v-k*x" + (f"-{restoring}" if restoring else "")
    return System(
        name=name,
        title=title,
        chains=("x:v:a",),
        inputs=("u",),
        rhs={"x": "v", "v": f"({force})/m"},
        terms={"a": {"x": "-k/m", "v": "-c/m", **(terms or {}), "u": "1/m"}},
        parameters={"m": 1.0, "c": 2.0, "k": 1e3, **(parameters or {})},
        fixed=("m",),
        initial={"x": 0.0, "v": 0.0},
        force=BandLimitedForce(std=50.0, band=(0.0, 100.0)),
        n=4000,
        fs=1000.0,
        noise=0.05,
        units={"x": "m", "v": "m/s", "a": "m/s^2", "u": "N"},
        citation=f"{PAPER}, section 4 and Table 1",
    )
