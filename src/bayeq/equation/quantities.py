"""Physical parameters as they are shown, each a value with its interval and unit, and modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayeq.arrays import Floats
from bayeq.equation.written import with_interval
from bayeq.figures.style import named
from bayeq.markup import aligned

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Quantity:
    """A physical parameter with its uncertainty, from draws of the posterior."""

    symbol: str  # "k3"
    meaning: str  # "cubic stiffness"
    mean: float  # mean of the draws
    sd: float
    low: float  # 95 % interval: their 2.5 % and 97.5 % quantiles
    high: float
    unit: str | None  # None where the units of the channels are not known; empty for a pure number

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """Mean, standard deviation, interval and unit as text."""
        return *with_interval(self.mean, self.sd, (self.low, self.high)), self.unit or ""


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode of small motion."""

    frequency: Quantity  # the natural frequency [Hz]
    damping_ratio: Quantity
    shape: Mapping[str, float]  # displacement over that of the coordinate that moves most, by coordinate


@dataclass(frozen=True, slots=True)
class PhysicalParameters:
    """Physical parameters of equations; iterate over them, or take one by its symbol.

    Attributes
    ----------
    quantities : tuple of Quantity
        For oscillators natural frequency ``omega_n`` [rad/s] and ``f_n`` [Hz], damping ratio ``zeta``, then mass,
        damping and stiffnesses, per unit of mass (``k/m``) if it is not known; else time constants and static gains.
    unexplained : tuple of str
        Terms of the equations that belong to none of the quantities.
    modes : tuple of Mode
        The lowest frequency first.
    note : str
        Why there are no modes, or no parameters; else empty.
    """

    quantities: tuple[Quantity, ...]
    unexplained: tuple[str, ...] = ()
    modes: tuple[Mode, ...] = ()
    note: str = ""

    def __iter__(self) -> Iterator[Quantity]:
        return iter(self.quantities)

    def __len__(self) -> int:
        return len(self.quantities)

    def __getitem__(self, symbol: str) -> Quantity:
        by_symbol = {quantity.symbol: quantity for quantity in self.quantities}
        return by_symbol[named("parameter", symbol, by_symbol)]

    def table(self) -> pd.DataFrame:
        """Columns symbol, meaning, mean, sd, ci_low, ci_high, unit."""
        import pandas as pd

        return pd.DataFrame(
            [(q.symbol, q.meaning, q.mean, q.sd, q.low, q.high, q.unit) for q in self.quantities],
            columns=["symbol", "meaning", "mean", "sd", "ci_low", "ci_high", "unit"],
        )

    def __str__(self) -> str:
        """A line per parameter."""
        header = ("parameter", "mean", "sd", "95 % interval", "unit", "")
        rows = [header, *((q.symbol, *q.cells, q.meaning) for q in self.quantities)]
        lines = aligned(rows, left=(0, 4, 5)) if self.quantities else []
        if self.unexplained:
            lines.append(f"also in the equation: {', '.join(self.unexplained)}")
        return "\n".join([*lines, *([self.note] if self.note else [])])


def quantity(symbol: str, meaning: str, values: Floats, unit: str | None) -> Quantity:
    """The quantity whose mean, standard deviation and 95 % interval are those of draws; NaN are left out."""
    low, high = np.nanquantile(values, [0.025, 0.975])
    return Quantity(symbol, meaning, float(np.nanmean(values)), float(np.nanstd(values)), float(low), float(high), unit)
