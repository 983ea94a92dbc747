"""Designs that a plan compares: a kind of excitation and a band each, at several amplitudes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.plan.conditions import Conditions
from bayeq.plan.excitations import EXCITATIONS
from bayeq.plan.excitations.lines import lines_within

__all__ = ["SHARES", "Design", "designs_for", "shapes"]

# Amplitudes, as shares of the range allowed: where the range is the best amplitude, the half says by how much.
SHARES = (1.0, 0.5)

# Besides the whole band, this many parts of it, equal in octaves.
PARTS = 3


@dataclass(frozen=True, slots=True)
class Design:
    """An excitation that could be applied, at the whole amplitude or less.

    Attributes
    ----------
    kind : str
        A row of `bayeq.plan.excitations.EXCITATIONS`.
    band : (float, float)
        [Hz].
    """

    kind: str
    band: tuple[float, float]


def designs_for(conditions: Conditions, parameters: int) -> list[Design]:
    """All designs within the conditions.

    A part of the band is left out if its odd lines are too few to tell the parameters: k sines are persistently
    exciting of order 2 k (Ljung 1999, section 13.2).

    Parameters
    ----------
    conditions : Conditions
        Of the measurement.
    parameters : int
        Coefficients of the largest model.
    """
    bands = [conditions.band, *(part for part in _parts(conditions) if _lines(conditions, part) * 2 >= parameters)]
    lines_within(conditions.n, conditions.fs, conditions.band, odd=True)  # raises where there are none
    return [Design(kind, band) for kind in EXCITATIONS for band in bands]


def _parts(conditions: Conditions) -> Iterator[tuple[float, float]]:
    low, high = max(conditions.band[0], 1.0 / conditions.seconds), conditions.band[1]
    if low >= high:
        return
    edges = np.geomspace(low, high, PARTS + 1).tolist()
    yield from pairwise(edges)


def _lines(conditions: Conditions, band: tuple[float, float]) -> int:
    try:
        return len(lines_within(conditions.n, conditions.fs, band, odd=True))
    except InputError:
        return 0


def shapes(design: Design, conditions: Conditions, seed: tuple[int, ...]) -> NDArray[np.float64]:
    """One realisation for all inputs, (n, m), largest magnitudes 1: independent of each other."""
    rng = np.random.default_rng(seed)
    kind = EXCITATIONS[design.kind]
    columns = [kind.samples(conditions.n, conditions.fs, design.band, rng) for _ in conditions.reach]
    return np.column_stack(columns)
