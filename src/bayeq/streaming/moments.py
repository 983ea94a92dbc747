"""The dictionary evaluated on units of rows and folded into moments, block by block within the processor's cache."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.expressions import Expression, Tape
from bayeq.expressions.on_rows import registers_for, run_on_rows
from bayeq.gram.gram import Moments
from bayeq.gram.products import add_products, block_for
from bayeq.kernels import kernel

__all__ = ["Folded", "fold_columns"]

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

# Rows that are evaluated together: a block of some 40 columns, 0.6 MB, stays in a processor's second cache.
ROWS = 2048

# The largest value whose square can be summed over any number of rows, and the square itself.
LARGEST = 1e150
LARGEST_SQUARE = LARGEST**2


@dataclass(frozen=True, slots=True)
class Folded:
    """What is left of some rows.

    Attributes
    ----------
    moments : Moments or None
        Count, means and centred products of the columns of the dictionary and the targets; None without rows.
    bad : (P,) int array
        Rows in which each term is not finite, or too large to square.
    """

    moments: Moments | None
    bad: Counts

    def __add__(self, other: Folded) -> Folded:
        if self.moments is None or other.moments is None:
            moments = self.moments if other.moments is None else other.moments
        else:
            moments = self.moments + other.moments
        return Folded(moments, self.bad + other.bad)


@kernel
def _centred(
    code: NDArray[np.uint32], outputs: NDArray[np.uint32], registers: Floats, rows: int, shift: Floats, z: Floats
) -> None:
    """The terms in the registers' variables, less `shift`, into the first rows of z (C, R)."""
    run_on_rows(code, registers, rows)
    for i in range(len(outputs)):
        value, out, centre = registers[outputs[i]], z[i], shift[i]
        for j in range(rows):
            out[j] = value[j] - centre


@kernel
def _without_bad(z: Floats, rows: int, shift: Floats, bad: Counts) -> None:
    """Count values that have no square, and put zeros in their places."""
    for i in range(len(bad)):
        for j in range(rows):
            if not abs(z[i, j] + shift[i]) <= LARGEST:
                bad[i] += 1
                z[i, j] = -shift[i]


def fold_columns(terms: Sequence[Expression], columns: Mapping[str, Floats], targets: Sequence[str]) -> Folded:
    """Moments of terms and targets over some rows.

    Parameters
    ----------
    terms : sequence of Expression
        The P candidates.
    columns : mapping of str to (n,) array
        States, inputs and targets.
    targets : sequence of str
        Those among the columns that are targets.
    """
    names = sorted({name for term in terms for name in term.names})
    tape = Tape.compile([*terms], [*names, *(t for t in targets if t not in names)])
    bad = np.zeros(len(terms), dtype=np.int64)
    given = [columns[name] for name in tape.variables]
    n = len(given[0])
    if not n:
        return Folded(None, bad)
    place = [tape.variables.index(t) for t in targets]
    outputs = np.concatenate([tape.outputs, np.array(place, dtype=np.uint32)])
    registers = registers_for(tape, min(ROWS, n))
    size = len(outputs)
    z, shift = block_for(size, registers.shape[1]), np.zeros(size)
    sums = np.zeros((len(z), len(z)))
    with np.errstate(all="ignore"):
        for start in range(0, n, ROWS):
            rows = min(ROWS, n - start)
            for register, values in zip(registers, given, strict=False):
                register[:rows] = values[start : start + rows]
            if not start:
                shift = _first_means(tape, outputs, registers, rows)
            _centred(tape.code, outputs, registers, rows, shift, z)
            products = np.zeros_like(sums)
            add_products(z, rows, products)
            if not (np.diagonal(products) <= LARGEST_SQUARE).all():
                _without_bad(z, rows, shift, bad)
                products[:] = 0.0
                add_products(z, rows, products)
            sums += products
    rest = sums[size, :size]
    cross = np.tril(sums[:size, :size])
    cross += np.tril(cross, -1).T - np.outer(rest, rest / n)
    return Folded(Moments(n, shift + rest / n, cross), bad)


def _first_means(tape: Tape, outputs: NDArray[np.uint32], registers: Floats, rows: int) -> Floats:
    """Means over the first block, 0 where they are not finite: what products are taken about."""
    z = np.zeros((len(outputs), rows))
    _centred(tape.code, outputs, registers, rows, np.zeros(len(outputs)), z)
    mean = z.mean(axis=1)
    return np.where(np.abs(mean) <= LARGEST, mean, 0.0)
