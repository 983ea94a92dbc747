"""`LazyGram`: the statistics of a wide dictionary, whose D'D is larger than the data.

With more columns than rows D'D has more entries than D. It is never formed: engines ask for the rows of the few terms
that they take in, and each is one product of D' with a column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.inference.gram import Gram, Standardised, checked_weights, default_names, grams_from_data, require_squares

# With fewer columns than this D'D is small, however few the rows.
LEAST_COLUMNS = 500


@dataclass(frozen=True, slots=True)
class LazyGram:
    """Centred data that answer as a `Gram` does."""

    names: tuple[str, ...]  # the P columns
    n: float  # number of rows
    mean: Floats  # (P,), of D
    target_mean: float
    data: Floats  # (n, P), centred D
    # centred sums of squares and products
    diagonal: Floats  # (P,)
    Dty: Floats  # (P,)
    yty: float
    dof: float  # degrees of freedom, as in `Gram`

    @property
    def DtD(self) -> Floats:
        """All of D'D, for those who cannot do without."""
        return self.data.T @ self.data

    def column(self, j: int) -> Floats:
        """Column j of D'D, (P,)."""
        return np.asarray(self.data[:, j] @ self.data)

    def standardise(self, target_scale: float = 1.0) -> Standardised:
        """Eq. (32): columns of zero mean and unit standard deviation, y divided by `target_scale`."""
        sd = np.sqrt(self.diagonal / self.n)
        scale = np.where(sd > 0, sd, 1.0)
        gram = replace(
            self,
            mean=np.zeros(len(self.names)),
            target_mean=0.0,
            data=self.data / scale,
            diagonal=self.diagonal / scale**2,
            Dty=self.Dty / scale / target_scale,
            yty=self.yty / target_scale**2,
        )
        return Standardised(gram=gram, source=self, scale=scale, target_scale=float(target_scale))


def _lazy_grams(D: Floats, Y: Floats, names: Sequence[str] | None, weights: ArrayLike | None) -> tuple[LazyGram, ...]:
    """One `LazyGram` per column of Y, all with the same data."""
    columns = tuple(names) if names is not None else default_names(D.shape[1])
    w = np.ones(len(D)) if weights is None else checked_weights(weights, len(D))
    n = float(w.sum())
    with np.errstate(over="ignore", invalid="ignore"):
        mean, target_mean = w @ D / n, w @ Y / n
        data, rest = D - mean, Y - target_mean
        if weights is not None:
            data *= np.sqrt(w)[:, None]
            rest *= np.sqrt(w)[:, None]
        diagonal, yty = np.einsum("ij,ij->j", data, data), np.einsum("ij,ij->j", rest, rest)
        Dty = data.T @ rest
    bad = np.flatnonzero(~np.isfinite(diagonal))
    if bad.size or not np.isfinite(yty).all():
        where = ", ".join(columns[j] for j in bad[:8]) or "the target"
        raise InputError(f"non-finite values (or squares that overflow) in {where}")
    require_squares(D, Y, diagonal, yty, columns)
    return tuple(
        LazyGram(
            names=columns,
            n=int(n) if n == int(n) else n,
            mean=mean,
            target_mean=float(target_mean[k]),
            data=data,
            diagonal=diagonal,
            Dty=np.ascontiguousarray(Dty[:, k]),
            yty=float(yty[k]),
            dof=n - 1.0,
        )
        for k in range(Y.shape[1])
    )


def grams_of(
    D: Floats, Y: Floats, names: Sequence[str] | None = None, weights: ArrayLike | None = None
) -> tuple[Gram | LazyGram, ...]:
    """The statistics of regressions of the columns of Y (n, T) on D (n, P); lazy where D is wide and P large.

    Raises as `Gram.from_data`.
    """
    rows, columns = D.shape
    if columns > rows and columns >= LEAST_COLUMNS:
        return _lazy_grams(D, Y, names, weights)
    return grams_from_data(D, Y, names, weights)
