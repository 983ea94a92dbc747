"""The dictionary evaluated on records: Gram matrices of the training and the held-out rows.

Terms that cannot be used are left out here, each with its reason: not finite on the data, constant, or a copy
of an earlier column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary.build import evaluate_terms
from bayeq.errors import InputError
from bayeq.expressions import Expression
from bayeq.gram.gram import Gram, grams_from_blocks

__all__ = ["Design", "DroppedTerm", "build_design"]

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]

# Rows evaluated at a time.
BLOCK_ROWS = 65_536

# The largest value whose square can be summed over any number of rows.
LARGEST = 1e150

# A column counts as constant below this relative spread, and as a copy above this correlation: both are the
# rounding of the centred sums of squares.
CONSTANT_SPREAD = 1e-13
COPY_CORRELATION = 1.0 - 1e-13


@dataclass(frozen=True, slots=True)
class DroppedTerm:
    """A candidate that was left out, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Design:
    """What inference is given, one Gram per target.

    Attributes
    ----------
    terms : tuple of Expression
        The P columns that are kept.
    train, held_out : tuple of Gram
        Statistics of the training and of the held-out rows; `held_out` is empty if no rows were held out.
    dropped : tuple of DroppedTerm
        Candidates left out.
    """

    terms: tuple[Expression, ...]
    train: tuple[Gram, ...]
    held_out: tuple[Gram, ...]
    dropped: tuple[DroppedTerm, ...]


def build_design(
    terms: Sequence[Expression],
    targets: Sequence[str],
    train: Sequence[Columns],
    held_out: Sequence[Columns] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Design:
    """Evaluate terms on pieces of records and add up their Gram matrices.

    Parameters
    ----------
    terms : sequence of Expression
        Candidates.
    targets : sequence of str
        Names of the target columns.
    train, held_out : sequence of mapping of str to (n,) array
        Columns of each piece of a record.
    progress : callable, optional
        Called with (rows done, rows in all).

    Raises
    ------
    InputError
        No candidate can be used.
    """
    names = tuple(term.text for term in terms)
    bad = np.zeros(len(terms), dtype=np.int64)
    total = sum(_rows(piece) for piece in (*train, *held_out))
    counter = _Counter(total, progress)
    grams = _grams(terms, targets, train, bad, counter)
    tests = _grams(terms, targets, held_out, bad, counter) if any(_rows(p) for p in held_out) else ()
    reasons = _reasons(grams[0], bad, total)
    dropped = tuple(DroppedTerm(names[j], why) for j, why in sorted(reasons.items()))
    kept = np.array([j for j in range(len(terms)) if j not in reasons], dtype=np.intp)
    if not len(kept):
        raise InputError(f"no usable term in the dictionary: {'; '.join(f'{d.name}: {d.reason}' for d in dropped[:5])}")
    if not dropped:
        return Design(tuple(terms), grams, tests, dropped)
    return Design(
        terms=tuple(terms[j] for j in kept),
        train=tuple(gram.select(kept) for gram in grams),
        held_out=tuple(gram.select(kept) for gram in tests),
        dropped=dropped,
    )


class _Counter:
    """Rows done so far, told to whoever wants to show progress."""

    def __init__(self, total: int, progress: Callable[[int, int], None] | None) -> None:
        self.total, self.done, self.progress = total, 0, progress

    def add(self, rows: int) -> None:
        self.done += rows
        if self.progress is not None:
            self.progress(self.done, self.total)


def _rows(piece: Columns) -> int:
    return len(next(iter(piece.values())))


def _grams(
    terms: Sequence[Expression],
    targets: Sequence[str],
    pieces: Sequence[Columns],
    bad: NDArray[np.int64],
    counter: _Counter,
) -> tuple[Gram, ...]:
    names = tuple(term.text for term in terms)

    def blocks() -> Iterator[tuple[Floats, Floats]]:
        for piece in pieces:
            for start in range(0, _rows(piece), BLOCK_ROWS):
                block = {name: values[start : start + BLOCK_ROWS] for name, values in piece.items()}
                D = evaluate_terms(terms, block)
                suspects = np.flatnonzero(~(np.abs(D).max(axis=0) <= LARGEST))
                for j in suspects:
                    bad[j] += int(np.count_nonzero(~(np.abs(D[:, j]) <= LARGEST)))
                    D[:, j] = 0.0
                yield D, np.column_stack([block[target] for target in targets])
                counter.add(len(D))

    return grams_from_blocks(blocks(), names, len(targets))


def _reasons(gram: Gram, bad: NDArray[np.int64], rows: int) -> dict[int, str]:
    """Why each unusable column is left out."""
    sd = gram.standard_deviation
    out: dict[int, str] = {}
    for j in range(len(sd)):
        if bad[j]:
            out[j] = f"not finite, or too large to square, in {bad[j]} of {rows} rows"
        elif not sd[j] > CONSTANT_SPREAD * abs(gram.mean[j]):
            out[j] = "constant on the data"
    usable = np.array([j for j in range(len(sd)) if j not in out], dtype=np.intp)
    scaled = gram.DtD[np.ix_(usable, usable)] / (sd[usable][:, None] * sd[usable] * gram.n)
    rows_of, columns_of = np.nonzero(np.triu(np.abs(scaled) >= COPY_CORRELATION, k=1))
    for a, b in zip(usable[rows_of], usable[columns_of], strict=True):
        if int(a) not in out:
            out.setdefault(int(b), f"a copy of {gram.names[a]} on the data")
    return out
