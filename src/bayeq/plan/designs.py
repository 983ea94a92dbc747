"""Designs that a plan compares, a kind of excitation and a band each, and motion under them within limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import ANYWHERE, mean_run, state_range
from bayeq.ode.rk4 import Drive, interpolant, slope_at
from bayeq.plan.conditions import Conditions
from bayeq.plan.excitations import EXCITATIONS, lines_within

# Amplitudes, as shares of the range allowed: where the range is the best amplitude, the half says by how much.
SHARES = (1.0, 0.5)

# Besides the whole band, this many parts of it, equal in octaves.
PARTS = 3


# Bisections towards the largest amplitude within limits: it is found to 0.1 % of the range.
HALVINGS = 10


@dataclass(frozen=True, slots=True)
class Design:
    """A kind of excitation, a row of `EXCITATIONS`, and its band [Hz], to be applied at the whole amplitude or less."""

    kind: str
    band: tuple[float, float]


def designs_for(conditions: Conditions, parameters: int) -> list[Design]:
    """All designs within the conditions, for models of this many parameters at most.

    A part of the band is left out if its odd lines are too few to tell the parameters: k sines are persistently
    exciting of order 2 k (Ljung 1999, section 13.2).
    """
    lines_within(conditions.n, conditions.fs, conditions.band, odd=True)  # raises where there are none
    low, high = max(conditions.band[0], 1.0 / conditions.seconds), conditions.band[1]
    parts = pairwise(np.geomspace(low, high, PARTS + 1).tolist()) if low < high else ()
    bands = [conditions.band, *(part for part in parts if _lines(conditions, part) * 2 >= parameters)]
    return [Design(kind, band) for kind in EXCITATIONS for band in bands]


def _lines(conditions: Conditions, band: tuple[float, float]) -> int:
    try:
        return len(lines_within(conditions.n, conditions.fs, band, odd=True))
    except InputError:
        return 0


def shapes(design: Design, conditions: Conditions, seed: tuple[int, ...]) -> Floats:
    """One realisation for all inputs, (n, m), largest magnitudes 1: independent of each other."""
    rng = np.random.default_rng(seed)
    kind = EXCITATIONS[design.kind]
    columns = [kind.samples(conditions.n, conditions.fs, design.band, rng) for _ in conditions.reach]
    return np.column_stack(columns)


class Motions:
    """Free runs of some dynamics from rest, under conditions.

    At rest is the equilibrium under the middle of the inputs, if there is one within the range of the record; else
    coordinates are in the middle of their range (0 where it is not known) and derivatives 0.
    """

    def __init__(self, dynamics: Dynamics, conditions: Conditions) -> None:
        self.dynamics = dynamics
        self.conditions = conditions
        spans = [conditions.ranges.get(name) for name in dynamics.states]
        known = [state_range(np.array([[low], [high]])) for low, high in (span or (0.0, 0.0) for span in spans)]
        self.low = np.array([low[0] for low, _ in known])
        self.high = np.array([high[0] for _, high in known])
        self.limits = np.array([conditions.limits.get(name, ANYWHERE) for name in dynamics.states])
        self.first = self._rest(spans)

    def _rest(self, spans: Sequence[tuple[float, float] | None]) -> Floats:
        from scipy.optimize import root

        chains = self.dynamics.chains
        lowest = [k == 0 for chain in chains for k in range(len(chain.states))]
        middle = np.array([0.5 * sum(span or ()) if low else 0.0 for span, low in zip(spans, lowest, strict=True)])
        program = self.dynamics.program(self.dynamics.mean)
        still = interpolant(np.array([0.0, 1.0]), np.tile(self.conditions.offset, (2, 1)), "hold")

        def slope(state: Floats) -> Floats:
            out = np.empty(len(state))
            slope_at(program, still, np.ascontiguousarray(state), 0, 0.0, None, out)
            return out

        with np.errstate(all="ignore"):
            found = root(slope, middle)
        inside = all(
            span is None or span[0] <= value <= span[1] for span, value in zip(spans, found.x, strict=True)
        ) and bool(np.isfinite(found.x).all())
        return np.asarray(found.x) if found.success and inside else middle

    def run(self, shape: Floats, share: float) -> Mapping[str, Floats] | None:
        """States and inputs under ``offset + share reach shape``, of shape (n, m); None if they leave every range."""
        c = self.conditions
        inputs = c.offset + share * c.reach * shape
        time = np.arange(c.n) / c.fs
        drive = Drive.over(time, interpolant(time, inputs, "band-limited"), self.low, self.high)
        states, stopped, _ = mean_run(self.dynamics, self.dynamics.mean, self.first, drive)
        if stopped is not None:
            return None
        return dict(zip((*self.dynamics.states, *self.dynamics.inputs), (*states.T, *inputs.T), strict=True))

    def keeps(self, columns: Mapping[str, Floats] | None) -> bool:
        """Whether a motion is within the limits."""
        if columns is None:
            return False
        peaks = [np.abs(columns[name]).max() for name in self.dynamics.states]
        return bool((np.array(peaks) <= self.limits).all())


def largest_share(motions: Motions, realisations: Sequence[Floats]) -> float:
    """The largest share of the amplitude with which all realisations keep the limits, by bisection.

    0 if even a thousandth does not.
    """

    def fits(scale: float) -> bool:
        return all(motions.keeps(motions.run(shape, scale)) for shape in realisations)

    if fits(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low
