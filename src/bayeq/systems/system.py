"""``System``: a known system, as data; and ``oscillator``, for those of Nayek, Worden and Cross."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayeq.citation import PAPER


@dataclass(frozen=True)
class BandLimitedForce:
    """Gaussian noise of flat spectrum inside ``lo < f <= hi`` [Hz] and none outside.

    Attributes
    ----------
    std : float
        Standard deviation, in expectation over realisations.
    band : tuple of float
        ``(lo, hi)`` [Hz]; `hi` at or above half the sampling rate means the whole band up to there.
    """

    std: float
    band: tuple[float, float]


@dataclass(frozen=True, eq=False)
class System:
    """A system whose law is known: enough to simulate it and to judge what was discovered.

    Nothing is parsed on construction; the conformance tests see to it that a system is consistent.

    Attributes
    ----------
    name, title : str
        The name by which `get_system` finds it, and its title.
    chains : tuple of str
        Coordinates with their derivatives: ``"x:v:a"`` for an oscillator, ``"x"`` for a first-order state.
    rhs : mapping of str to str
        State -> its time derivative, in states, inputs and parameters. States come first in a chain: all
        names of a chain but the last are states, or the only one.
    terms : mapping of str to mapping of str to str
        Target -> term -> coefficient in the parameters. The target is the last name of a chain, or ``"dx"``
        for a first-order state ``x``. Terms may hold the targets of other equations.
    parameters : mapping of str to float
        Nominal values, SI units.
    fixed : tuple of str
        Parameters that are not perturbed.
    initial : mapping of str to float
        Initial state.
    inputs : tuple of str
        External forces.
    force : BandLimitedForce or None
        Random force of each input.
    n, fs : int, float
        Samples, and sampling rate [Hz].
    substeps : int
        Integration steps per sample.
    noise : float
        Ratio of the noise's standard deviation to the scale of the clean signal.
    noise_scale : {"channel", "pooled"}
        The scale of the noise: each channel's own standard deviation, or one of all states' samples together.
    units : mapping of str to str
        Units of the channels.
    citation : str
        Source of the system.
    """

    name: str
    title: str
    chains: tuple[str, ...]
    rhs: Mapping[str, str]
    terms: Mapping[str, Mapping[str, str]]
    parameters: Mapping[str, float]
    initial: Mapping[str, float]
    n: int
    fs: float
    noise: float
    citation: str
    inputs: tuple[str, ...] = ()
    force: BandLimitedForce | None = None
    fixed: tuple[str, ...] = ()
    noise_scale: Literal["channel", "pooled"] = "channel"
    substeps: int = 1
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def states(self) -> tuple[str, ...]:
        """The states, in the order of `rhs`."""
        return tuple(self.rhs)

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of a record: every name of every chain, then the inputs."""
        return (*(name for chain in self.chains for name in chain.split(":")), *self.inputs)

    @property
    def targets(self) -> dict[str, str]:
        """Target -> the state whose time derivative it is."""
        targets = {}
        for chain in self.chains:
            *lower, last = chain.split(":")
            targets[last if lower else f"d{last}"] = lower[-1] if lower else last
        return targets


def oscillator(name: str, title: str, own: tuple[str, float, str] | None = None) -> System:
    """``m*a + c*v + k*x + p*g = u`` with a band-limited Gaussian force; `own` is the parameter p, its value, and g."""
    force, terms, values = "u-c*v-k*x", {"x": "-k/m", "v": "-c/m"}, {"m": 1.0, "c": 2.0, "k": 1e3}
    if own is not None:
        parameter, value, term = own
        force, terms[term], values[parameter] = f"{force}-{parameter}*{term}", f"-{parameter}/m", value
    return System(
        name=name,
        title=title,
        chains=("x:v:a",),
        inputs=("u",),
        rhs={"x": "v", "v": f"({force})/m"},
        terms={"a": {**terms, "u": "1/m"}},
        parameters=values,
        fixed=("m",),
        initial={"x": 0.0, "v": 0.0},
        force=BandLimitedForce(std=50.0, band=(0.0, 100.0)),
        n=4000,
        fs=1000.0,
        noise=0.05,
        units={"x": "m", "v": "m/s", "a": "m/s^2", "u": "N"},
        citation=f"{PAPER}, section 4 and Table 1",
    )
