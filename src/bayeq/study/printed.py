"""The paper's Tables 2 and 3, as printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from bayeq.citation import PAPER

__all__ = ["CITATION", "LABELS", "PRINTED_ALGORITHMS", "RUNTIMES", "TABLE_2", "Printed"]

CITATION = f"{PAPER}, Tables 2 and 3 (averages over 1000 realisations)"

# The order of its columns and rows.
PRINTED_ALGORITHMS = ("sindy", "rvm", "gibbs", "vb")

# Its names for the algorithms.
LABELS: Mapping[str, str] = MappingProxyType({"sindy": "SINDy", "rvm": "RVM", "gibbs": "SS-MCMC", "vb": "SS-VB"})


@dataclass(frozen=True, slots=True)
class Printed:
    """A row of Table 2.

    Attributes
    ----------
    e_theta_scaled, e_theta, e_p, fdr, exact, superset : float
        Its columns from left to right.
    approximate : tuple of str
        Columns whose value is printed as approximate.
    """

    e_theta_scaled: float
    e_theta: float
    e_p: float
    fdr: float
    exact: float
    superset: float
    approximate: tuple[str, ...] = ()


_ABOUT = ("e_theta",)

# (system, algorithm) -> row.
TABLE_2: Mapping[tuple[str, str], Printed] = MappingProxyType(
    {
        ("linear", "sindy"): Printed(0.168, 3e4, 0.302, 0.580, 0.190, 0.778, _ABOUT),
        ("linear", "rvm"): Printed(0.010, 502.261, 0.097, 0.576, 0.005, 0.999),
        ("linear", "gibbs"): Printed(0.004, 5.863, 0.072, 0.002, 0.992, 1.000),
        ("linear", "vb"): Printed(0.004, 0.164, 0.071, 0.003, 0.991, 0.997),
        ("duffing", "sindy"): Printed(0.253, 609.134, 0.168, 0.558, 0.113, 0.742),
        ("duffing", "rvm"): Printed(0.070, 47.377, 0.091, 0.560, 0.001, 0.976),
        ("duffing", "gibbs"): Printed(0.026, 4.116, 0.078, 0.037, 0.846, 0.977),
        ("duffing", "vb"): Printed(0.034, 4.631, 0.076, 0.041, 0.845, 0.971),
        ("quadratic", "sindy"): Printed(0.147, 4e5, 0.097, 0.488, 0.106, 0.520, _ABOUT),
        ("quadratic", "rvm"): Printed(0.017, 1546.542, 0.073, 0.497, 0.003, 0.931),
        ("quadratic", "gibbs"): Printed(0.017, 0.004, 0.072, 0.030, 0.859, 0.865),
        ("quadratic", "vb"): Printed(0.012, 0.004, 0.071, 0.019, 0.886, 0.892),
        ("coulomb", "sindy"): Printed(0.216, 4e5, 0.257, 0.592, 0.021, 0.371, _ABOUT),
        ("coulomb", "rvm"): Printed(0.013, 1034.780, 0.092, 0.496, 0.003, 0.993),
        ("coulomb", "gibbs"): Printed(0.011, 0.004, 0.071, 0.018, 0.847, 0.850),
        ("coulomb", "vb"): Printed(0.009, 0.026, 0.070, 0.003, 0.762, 0.765),
    }
)

# Table 3: seconds of a single run (SS-MCMC: of a single chain; SS-VB: with the RVM that it starts from).
RUNTIMES: Mapping[str, float] = MappingProxyType({"sindy": 3.65, "rvm": 0.03, "gibbs": 34.23, "vb": 0.33})
