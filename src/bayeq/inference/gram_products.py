"""Sums of products z z' over rows z of few columns, faster than BLAS and in one pass over the rows.

Columns lie one after the other in a block that stays in the cache, four at a time are multiplied with four others, and
the sixteen sums stay in registers. Unlike those of BLAS they are the same to the last bit for any number of threads.
"""

from __future__ import annotations

import numpy as np

from bayeq.arrays import Floats
from bayeq.kernels import kernel

# Rows that are multiplied at a time: forty columns of them are 80 kB.
CACHED_ROWS = 256

# Each column of a block has this many values beyond its rows: at strides of a power of two columns share cache lines.
APART = 8


def block_for(columns: int, rows: int) -> Floats:
    """Array (C, R > `rows`) for `add_products`: zeros for `columns` columns, one of ones, zeros to a multiple of 4."""
    block = np.zeros((_padded(columns), rows + APART))
    block[columns] = 1.0
    return block


@kernel
def _padded(columns: int) -> int:
    return columns + 4 - columns % 4


@kernel(reordered=True)
def _add_tile(block: Floats, first: int, stop: int, a: int, b: int, sums: Floats) -> None:
    """Products of columns a to a + 3 with columns b to b + 3."""
    # slices, so that the index starts at 0: one that may be negative keeps LLVM from using vectors
    a0, a1, a2, a3 = (
        block[a][first:stop], block[a + 1][first:stop], block[a + 2][first:stop], block[a + 3][first:stop]
    )  # fmt: skip
    b0, b1, b2, b3 = (
        block[b][first:stop], block[b + 1][first:stop], block[b + 2][first:stop], block[b + 3][first:stop]
    )  # fmt: skip
    s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = 0.0
    s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = 0.0
    for k in range(stop - first):
        p, q, r, s = b0[k], b1[k], b2[k], b3[k]
        s00 += a0[k] * p
        s01 += a0[k] * q
        s02 += a0[k] * r
        s03 += a0[k] * s
        s10 += a1[k] * p
        s11 += a1[k] * q
        s12 += a1[k] * r
        s13 += a1[k] * s
        s20 += a2[k] * p
        s21 += a2[k] * q
        s22 += a2[k] * r
        s23 += a2[k] * s
        s30 += a3[k] * p
        s31 += a3[k] * q
        s32 += a3[k] * r
        s33 += a3[k] * s
    tile = ((s00, s01, s02, s03), (s10, s11, s12, s13), (s20, s21, s22, s23), (s30, s31, s32, s33))
    for i in range(4):
        for j in range(4):
            sums[a + i, b + j] += tile[i][j]


@kernel
def add_products(block: Floats, rows: int, sums: Floats) -> None:
    """Add z z' of the first `rows` of a block (C, R) to the lower triangle of `sums` (C, C)."""
    for first in range(0, rows, CACHED_ROWS):
        stop = min(first + CACHED_ROWS, rows)
        for a in range(0, len(sums), 4):
            for b in range(0, a + 1, 4):
                _add_tile(block, first, stop, a, b, sums)


@kernel
def _transpose(part: Floats, shift: Floats, block: Floats) -> None:
    """block[j, i] = part[i, j] - shift[j], four rows at a time."""
    n, columns = part.shape
    whole = n - n % 4
    for i in range(0, whole, 4):
        r0, r1, r2, r3 = part[i], part[i + 1], part[i + 2], part[i + 3]
        for j in range(columns):
            out, centre = block[j], shift[j]
            out[i], out[i + 1], out[i + 2], out[i + 3] = r0[j] - centre, r1[j] - centre, r2[j] - centre, r3[j] - centre
    for i in range(whole, n):
        for j in range(columns):
            block[j, i] = part[i, j] - shift[j]


@kernel
def shifted_products(D: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Shifts (P + T,) of the columns of [D y]; sums (P + T,) and products (P + T, P + T) of the shifted columns.

    The shifts are the means of the first rows of D (n, P) and y (n, T): a constant column is exactly zero.
    """
    n, p = D.shape
    columns = p + y.shape[1]
    block = np.zeros((_padded(columns), CACHED_ROWS + APART))
    block[columns] = 1.0
    sums, shift = np.zeros((len(block), len(block))), np.zeros(columns)
    some = min(n, CACHED_ROWS)
    for i in range(some):
        for j in range(p):
            shift[j] += D[i, j] - D[0, j]
        for j in range(y.shape[1]):
            shift[p + j] += y[i, j] - y[0, j]
    for j in range(p):
        shift[j] = D[0, j] + shift[j] / some
    for j in range(y.shape[1]):
        shift[p + j] = y[0, j] + shift[p + j] / some
    for first in range(0, n, CACHED_ROWS):
        rows = min(CACHED_ROWS, n - first)
        _transpose(D[first : first + rows], shift[:p], block[:p])
        _transpose(y[first : first + rows], shift[p:], block[p:])
        add_products(block, rows, sums)
    products = np.empty((columns, columns))
    for a in range(columns):
        for b in range(a + 1):
            products[a, b] = sums[a, b]
            products[b, a] = sums[a, b]
    return shift, sums[columns, :columns].copy(), products
