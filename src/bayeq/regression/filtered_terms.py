"""Dictionary columns passed through the smoother, so that both sides of an equation are filtered alike.

A target that was estimated holds what the smoother follows of the motion; an input, and the products of states, hold
more. Here the same filter is applied to these, so that fits, residuals and shares of variance are those of an equation
both sides of which went through it. The rows at either end, where a smoother knows least, are left out of the
judgement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.expressions import Expression
from bayeq.states import Chain, ChainSmoothing

__all__ = ["filtered_terms", "unsmoothed"]

Floats = NDArray[np.float64]


def unsmoothed(terms: Sequence[Expression], chains: Sequence[Chain]) -> list[int]:
    """Terms that are not states: the smoother's gain is in the states and in the target, but not in these.

    An input is as measured. A product such as x**3 is that of smoothed states, which follow the motion where it is
    strong, so that its harmonics stand there at full height.
    """
    states = {name for chain in chains for name in chain.states}
    return [j for j, term in enumerate(terms) if term.text not in states]


def filtered_terms(
    D: Floats, terms: Sequence[Expression], chains: Sequence[Chain], smoothing: ChainSmoothing | None
) -> Floats:
    """Columns (n, P) of the terms on the rows of a record through the smoother; as they are without one."""
    if smoothing is None:
        return D
    chosen = unsmoothed(terms, chains)
    out = D.copy()
    out[:, chosen] = smoothing.follow(D[:, chosen])
    return out
