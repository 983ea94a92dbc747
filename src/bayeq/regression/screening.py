"""Dictionaries too large to compare all models of: the simplest candidates are kept, and those that explain most.

Iterative sure independence screening (Fan and Lv 2008): the columns that correlate most with the target are taken, then
those that correlate most with what these leave, both less what was taken before, and so on. A term that matters beside
others and not alone comes in a later round. Where terms are nearly the same on the record, as the monomials of
``(x2-x1)**3`` are, correlations do not tell which of them is true: half of the places go to the simplest terms whatever
they explain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.polynomial import degree
from bayeq.expressions import Expression
from bayeq.states import Motion

__all__ = ["screened"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Rows that candidates are judged by, at most, spread over the records.
ROWS = 4000

# A column of which what was taken leaves no more than this share of the square is a combination of it.
NEARLY_NOTHING = 1e-8

# Rounds in which each equation takes its share.
ROUNDS = 20


def screened(terms: Sequence[Expression], motion: Motion, allowed: Bools, forced: Bools, most: int) -> NDArray[np.intp]:
    """Candidates to keep.

    Parameters
    ----------
    terms : sequence of Expression
        The P candidates.
    motion : Motion
        States, targets and inputs.
    allowed : (C, P) bool array
        Candidates of each equation.
    forced : (P,) bool array
        Candidates that are kept whatever they explain.
    most : int
        How many to keep; each equation has an equal share.

    Returns
    -------
    (K,) int array
        Their numbers, in order.
    """
    D, Y = _rows(terms, motion)
    kept = forced.copy()
    simplest = sorted(range(len(terms)), key=lambda j: (degree(terms[j]), terms[j].size))
    kept[simplest[: min(most // 2, len(D) // 4)]] = True
    basis = _independent(D[:, kept])
    share = max((most - int(kept.sum())) // len(allowed), 1)
    found = [explaining(D, y, own & ~kept, basis, share) for own, y in zip(allowed, Y.T, strict=True)]
    kept[np.concatenate(found)] = True
    return np.flatnonzero(kept)


def explaining(D: Floats, y: Floats, free: Bools, basis: Floats, share: int) -> NDArray[np.intp]:
    """The columns that explain most of what a basis leaves of y, taken in rounds.

    Parameters
    ----------
    D : (n, P) array
        Columns of length 1, or 0.
    y : (n,) array
        The target.
    free : (P,) bool array
        Columns to choose from.
    basis : (n, q) array
        Orthonormal columns.
    share : int
        How many.
    """
    taken = np.zeros(0, dtype=np.intp)
    free, added, left = free.copy(), basis, y
    rest = np.ones(D.shape[1])  # squared length of what the basis leaves of each column
    while True:
        left = left - added @ (added.T @ left)
        rest -= ((added.T @ D) ** 2).sum(axis=0)
        free &= rest > NEARLY_NOTHING
        count = min(-(-share // ROUNDS), share - len(taken), int(free.sum()))
        if count <= 0:
            return taken
        gain = np.where(free, (left @ D) ** 2 / np.maximum(rest, NEARLY_NOTHING), -1.0)
        best = np.argsort(-gain, kind="stable")[:count]
        free[best] = False
        taken = np.append(taken, best)
        new = D[:, best] - basis @ (basis.T @ D[:, best])
        added = _independent(new - basis @ (basis.T @ new))
        basis = np.column_stack([basis, added])


def _independent(columns: Floats) -> Floats:
    """An orthonormal basis of some columns."""
    if not columns.shape[1]:
        return columns
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-10])


def _rows(terms: Sequence[Expression], motion: Motion) -> tuple[Floats, Floats]:
    """Centred columns of length 1 on some of the training rows, 0 for those not finite, and the centred targets."""
    step = max(1, -(-sum(rows.n for rows in motion.train) // ROWS))
    parts = [rows.part(slice(None, None, step)) for rows in motion.train]
    Y = np.concatenate(
        [np.column_stack([rows.observed[t] for t in motion.roles.targets])[rows.known] for rows in parts]
    )
    D = np.concatenate([evaluate_terms(terms, rows.columns)[rows.known] for rows in parts])
    with np.errstate(all="ignore"):
        D -= D.mean(axis=0)
        D /= np.sqrt(np.einsum("ij,ij->j", D, D))
    D[:, ~np.isfinite(D).all(axis=0)] = 0.0
    return D, Y - Y.mean(axis=0)
