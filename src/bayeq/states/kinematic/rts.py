"""Rauch-Tung-Striebel smoother of an integrated Wiener process, compiled; it goes back over what `kalman` filtered.

Covariances are square roots here too, and are stored once for all rows on which they have settled.

Source: Rauch, Tung and Striebel, AIAA Journal 3 (1965); in array form Park and Kailath, IEEE Trans. Automatic
Control 40 (1995).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Floats
from bayeq.kernels import kernel
from bayeq.states.kinematic.kalman import (
    SETTLED,
    Tables,
    advance,
    close,
    copy_block,
    outer,
    pre_array,
    taylor,
    triangularise,
)


@kernel
def _backward_gain(S: Floats, f: Floats, h: float, noise: Floats, M: Floats, J: Floats, rest: Floats) -> None:
    """Gain J of the Rauch-Tung-Striebel smoother and a root of the covariance given the state at the next row.

    [[F S, root of Qd], [S, 0]] is triangularised to [[A, 0], [B, rest]]: J = B A^-1.
    """
    m = len(f)
    pre_array(S, f, h, noise, M)
    for i in range(m):
        for j in range(m):
            M[m + i, j] = S[i, j]
            M[m + i, m + j] = 0.0
    triangularise(M, 2 * m, 2 * m)
    for i in range(m):
        for j in range(m - 1, -1, -1):
            total = M[m + i, j]
            for k in range(j + 1, m):
                total -= J[i, k] * M[k, j]
            J[i, j] = total / M[j, j]
            rest[i, j] = M[m + i, m + j]


@kernel
def smooth(
    steps: Floats, tables: Tables, steady: int, noise: Floats, covariances: Floats, rows: NDArray[np.int64]
) -> int:
    """Rauch-Tung-Striebel smoother: the filtered means in `tables` become smoothed ones.

    `covariances` is filled with one entry per row until they have settled and `rows` with the entry of each row;
    returns the number of entries.
    """
    index, anew, roots, means = tables.entry, tables.anew, tables.roots, tables.means
    n, m = means.shape
    M, S, last = np.empty((2 * m, 2 * m)), np.empty((m, m)), np.empty((m, m))
    J, rest = np.empty((m, m)), np.empty((m, m))
    steady_J, steady_rest = np.empty((m, m)), np.empty((m, m))
    f, regular_f, x, d = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    taylor(1.0, regular_f)
    copy_block(S, roots[index[n - 1]])
    outer(S, covariances[0])
    rows[n - 1] = 0
    entries = 1
    settled, run, known = False, 0, False
    for t in range(n - 2, -1, -1):
        if anew[t + 1]:
            copy_block(S, roots[index[t]])
            outer(S, covariances[entries])
            rows[t] = entries
            entries += 1
            settled, run = False, 0
            continue
        h = steps[t + 1]
        regular = index[t] == steady and h == 1.0
        run = run + 1 if regular else 0
        if regular and not known:
            _backward_gain(roots[steady], regular_f, 1.0, noise, M, steady_J, steady_rest)
            known = True
        gain, remainder, g = steady_J, steady_rest, regular_f
        if not regular:
            settled = False
            gain, remainder = J, rest
            if h != 1.0:
                g = f
                taylor(h, f)
            _backward_gain(roots[index[t]], g, h, noise, M, J, rest)
        for i in range(m):
            x[i] = means[t, i]
        advance(x, g)
        for i in range(m):
            d[i] = means[t + 1, i] - x[i]
        for i in range(m):
            total = means[t, i]
            for j in range(m):
                total += gain[i, j] * d[j]
            means[t, i] = total
        if settled:
            rows[t] = entries - 1
            continue
        copy_block(last, S)
        for i in range(m):
            for j in range(m):
                total = 0.0
                for k in range(m):
                    total += gain[i, k] * last[k, j]
                M[i, j] = total
                M[i, m + j] = remainder[i, j]
        triangularise(M, m, 2 * m)
        copy_block(S, M)
        settled = run > 1 and close(S, last, m, SETTLED)
        outer(S, covariances[entries])
        rows[t] = entries
        entries += 1
    return entries
