"""Sufficient statistics of a linear regression: the only thing that inference sees.

A `Gram` holds the row count, the column means and the centred co-moments D'D, D'y and y'y. It is additive:
blocks of rows, records, files and folds are merged by the parallel-variance formula (Chan, Golub and LeVeque
1983), so nothing downstream depends on the number of rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.inference.gram_products import shifted_products

# Rows that are centred and multiplied at a time: large enough for BLAS, small enough for the cache.
BLOCK_ROWS = 8192

# A sum of squares below this has lost digits.
LEAST_SQUARES = 1e-280

# Up to this many columns our own kernel computes the products; with more, BLAS is as fast.
SMALL = 160


class GramLike(Protocol):
    """Interface of a Gram matrix to engines; `Gram` holds all of it in memory, others may compute columns lazily."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def dof(self) -> float:
        """Degrees of freedom of the target: the N of the likelihood."""
        ...

    @property
    def diagonal(self) -> Floats: ...

    @property
    def Dty(self) -> Floats: ...

    @property
    def yty(self) -> float: ...

    def column(self, j: int) -> Floats: ...


def dense(gram: GramLike) -> Floats:
    """D'D of any `GramLike` as a (P, P) array."""
    if isinstance(gram, Gram):
        return gram.DtD
    return np.stack([gram.column(j) for j in range(len(gram.names))])


@dataclass(frozen=True, eq=False, slots=True)
class Gram:
    """Centred sufficient statistics of y = b0 + D theta + noise.

    Parameters
    ----------
    names : tuple of str
        The P columns of the dictionary.
    n : float
        Number of rows: an int, or the sum of their weights.
    mean : (P,) array
        Column means of D.
    target_mean : float
        Mean of y.
    DtD : (P, P) array
        Centred D'D.
    Dty : (P,) array
        Centred D'y.
    yty : float
        Centred y'y.
    dof : float
        Degrees of freedom: the N that engines put into their likelihood. After centring n - 1 remain, because
        the intercept has been integrated out under a flat prior; the paper uses n (`with_dof`).

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> D = rng.normal(size=(100, 2))
    >>> y = 3 + D @ [2.0, 0.0] + 0.1 * rng.normal(size=100)
    >>> whole = Gram.from_data(D, y, names=("x", "v"))
    >>> parts = Gram.from_data(D[:30], y[:30], names=("x", "v")) + Gram.from_data(D[30:], y[30:], ("x", "v"))
    >>> bool(np.allclose(whole.DtD, parts.DtD)), parts.n
    (True, 100)
    """

    names: tuple[str, ...]
    n: float
    mean: Floats
    target_mean: float
    DtD: Floats
    Dty: Floats
    yty: float
    dof: float

    @classmethod
    def from_data(
        cls, D: ArrayLike, y: ArrayLike, names: Sequence[str] | None = None, weights: ArrayLike | None = None
    ) -> Gram:
        """Build from a dictionary matrix (n, P) and a target (n,).

        Parameters
        ----------
        D, y : (n, P) array, (n,) array
            The rows.
        names : sequence of str, optional
            The P columns; by default x0, x1 ...
        weights : (n,) array, optional
            How often each row counts: k is the row k times over, 0 leaves it out. The count n of the Gram is their
            sum, so where they state noise ratios (proportional to 1/variance), scale them to sum to the number of
            rows.

        Raises
        ------
        InputError
            Shapes that do not match, no rows, non-finite values, or weights that are negative, not finite or all zero.
        """
        y = np.asarray(y, dtype=np.float64)
        if y.ndim != 1:
            raise InputError(f"need D of shape (n, P) and y of shape (n,), got {np.shape(D)} and {y.shape}")
        return grams_from_data(D, y[:, None], names, weights)[0]

    def __add__(self, other: Gram) -> Gram:
        """Statistics of both sets of rows together."""
        if not isinstance(other, Gram):
            return NotImplemented
        if self.names != other.names:
            raise InputError("cannot add Grams of different dictionaries")
        joined = self._moments() + other._moments()
        merged = from_moments(joined, self.names, 1)[0]
        # The intercept takes its degree of freedom once, however many parts were added.
        return merged.with_dof(merged.n - max(self.n - self.dof, other.n - other.dof))

    @property
    def diagonal(self) -> Floats:
        """Centred sums of squares of the columns, (P,)."""
        return np.diagonal(self.DtD)

    @property
    def target_deviation(self) -> float:
        """Standard deviation of the target over the rows."""
        return float(np.sqrt(self.yty / self.n))

    @property
    def standard_deviation(self) -> Floats:
        """Column standard deviations (divisor n), (P,)."""
        return np.sqrt(self.diagonal / self.n)

    def column(self, j: int) -> Floats:
        """Column j of D'D, (P,).

        Parameters
        ----------
        j : int
            Index of the column, from 0.

        Returns
        -------
        (P,) array
            Products of column j with all columns.
        """
        return self.DtD[:, j]

    def with_dof(self, dof: float) -> Gram:
        """The same statistics with another N in the likelihood (n for the paper's convention).

        Parameters
        ----------
        dof : float
            Degrees of freedom.

        Returns
        -------
        Gram
            The same Gram with this `dof`.
        """
        return replace(self, dof=float(dof))

    def select(self, columns: Sequence[int] | NDArray[np.intp]) -> Gram:
        """The Gram of some of the columns.

        Parameters
        ----------
        columns : sequence of int
            Indices of the columns, from 0.

        Returns
        -------
        Gram
            Statistics of these columns, in this order.
        """
        idx = np.asarray(columns, dtype=np.intp)
        return replace(
            self,
            names=tuple(self.names[j] for j in idx),
            mean=self.mean[idx],
            DtD=np.ascontiguousarray(self.DtD[np.ix_(idx, idx)]),
            Dty=self.Dty[idx],
        )

    def squared_error(self, coef: ArrayLike, intercept: float | None = None) -> float:
        """Sum of squared errors ||y - b0 - D theta||^2 over the rows of this Gram.

        On the Gram of the training rows this is the training error, on that of other rows the held-out error.

        Parameters
        ----------
        coef : (P,) array
            theta.
        intercept : float, optional
            b0; by default the best one for these rows.
        """
        theta = np.asarray(coef, dtype=np.float64)
        used = np.flatnonzero(theta)
        t = theta[used]
        centred = self.yty - 2.0 * t @ self.Dty[used] + t @ self.DtD[np.ix_(used, used)] @ t
        offset = 0.0
        if intercept is not None:
            offset = self.n * (self.target_mean - float(self.mean[used] @ t) - intercept) ** 2
        return max(float(centred), 0.0) + offset

    def raised(self, power: float) -> Gram:
        """The statistics of a likelihood raised to a power of at most 1, equivalent to fewer rows.

        Parameters
        ----------
        power : float
            Weight of every row.
        """
        if power == 1.0:
            return self
        return replace(
            self,
            n=self.n * power,
            DtD=self.DtD * power,
            Dty=self.Dty * power,
            yty=self.yty * power,
            dof=self.n * power - 1.0,
        )

    def standardise(self, target_scale: float = 1.0) -> Standardised:
        """Eq. (32) as algebra: columns of zero mean and unit standard deviation, y divided by `target_scale`.

        A column without variance is left unscaled.

        Parameters
        ----------
        target_scale : float
            Divisor of y, in its unit.

        Returns
        -------
        Standardised
            The Gram matrix, and the scales that lead back to original units.
        """
        sd = self.standard_deviation
        return self.in_units(np.where(sd > 0, sd, 1.0), target_scale)

    def in_units(self, scale: Floats, target_scale: float) -> Standardised:
        """The Gram of centred columns divided by `scale` and of centred y divided by `target_scale`.

        Parameters
        ----------
        scale : (P,) array
            Divisor of each column, in its unit.
        target_scale : float
            Divisor of y, in its unit.

        Returns
        -------
        Standardised
            The Gram matrix, and the scales that lead back to original units.
        """
        units = Standardised(gram=self, source=self, scale=scale, target_scale=float(target_scale))
        return replace(units, gram=units.apply(self))

    def _moments(self) -> Moments:
        cross = np.block([[self.DtD, self.Dty[:, None]], [self.Dty, np.float64(self.yty)]])
        return Moments(self.n, np.append(self.mean, self.target_mean), cross)


@dataclass(frozen=True, eq=False, slots=True)
class Standardised:
    """A standardised Gram (or `LazyGram`) and the way back to the original units."""

    gram: Any
    source: Any
    scale: Floats
    target_scale: float

    def apply(self, other: Gram) -> Gram:
        """The Gram of other rows in the same units: shifted by the same means, divided by the same scales."""
        return replace(
            other,
            mean=(other.mean - self.source.mean) / self.scale,
            target_mean=(other.target_mean - self.source.target_mean) / self.target_scale,
            DtD=other.DtD / self.scale[:, None] / self.scale,
            Dty=other.Dty / self.scale / self.target_scale,
            yty=other.yty / self.target_scale**2,
        )


@dataclass(frozen=True, eq=False, slots=True)
class Moments:
    """Count, means and centred co-moments of the columns [D Y]."""

    n: float
    mean: Floats
    cross: Floats

    def __add__(self, other: Moments) -> Moments:
        """Moments of both sets of rows together (Chan, Golub and LeVeque 1983)."""
        n = self.n + other.n
        delta = other.mean - self.mean
        cross = self.cross + other.cross + np.outer(delta, delta * (self.n * other.n / n))
        return Moments(n, self.mean + delta * (other.n / n), cross)


def _block_moments(D: Floats, Y: Floats) -> Moments:
    """Centred co-moments of a block: products about an approximate mean, corrected for the error of that mean."""
    n = len(D)
    if D.shape[1] + Y.shape[1] > SMALL:
        return _weighted_moments(D, Y, np.ones(n))
    with np.errstate(over="ignore", invalid="ignore"):
        shift, sums, cross = shifted_products(np.ascontiguousarray(D), np.ascontiguousarray(Y))
        cross -= sums[:, None] * (sums / n)
    return Moments(n, shift + sums / n, cross)


def _weighted_moments(D: Floats, Y: Floats, weights: Floats) -> Moments:
    """`_block_moments` of rows that count `weights` (all above 0) times."""
    n = float(weights.sum())
    with np.errstate(over="ignore", invalid="ignore"):
        z = np.concatenate([D, Y], axis=1)
        # the first row is subtracted, so that a constant column has exactly zero variance
        first = z[0].copy()
        z -= first
        mean = weights @ z / n
        z -= mean
        rest = weights @ z
        z *= np.sqrt(weights)[:, None]
        cross = z.T @ z
        cross -= np.outer(rest, rest / n)
    return Moments(n, first + (mean + rest / n), cross)


def from_moments(moments: Moments, names: tuple[str, ...], targets: int) -> tuple[Gram, ...]:
    """One `Gram` per target from moments of D and the targets; an InputError refuses values that are not finite."""
    squares = np.diagonal(moments.cross)
    if not np.isfinite(squares).all():
        bad = np.flatnonzero(~np.isfinite(squares))
        labels = [*names, *(["the target"] * targets)]
        raise InputError(f"non-finite values (or squares that overflow) in {', '.join(labels[j] for j in bad[:8])}")
    p = len(names)
    DtD = np.ascontiguousarray(moments.cross[:p, :p])
    # n is an int if the weights add up to a whole number
    n = int(moments.n) if moments.n == int(moments.n) else moments.n
    return tuple(
        Gram(
            names=names,
            n=n,
            mean=moments.mean[:p],
            target_mean=float(moments.mean[p + k]),
            DtD=DtD,
            Dty=moments.cross[:p, p + k].copy(),
            yty=float(moments.cross[p + k, p + k]),
            dof=float(n - 1),
        )
        for k in range(targets)
    )


def _joined(parts: Iterable[Moments], names: tuple[str, ...], targets: int) -> tuple[Gram, ...]:
    """One `Gram` per target from the merged moments of all parts; an InputError refuses no parts."""
    total: Moments | None = None
    for part in parts:
        total = part if total is None else total + part
    if total is None:
        raise InputError("no rows: a Gram needs at least one")
    return from_moments(total, names, targets)


def grams_from_blocks(
    blocks: Iterable[tuple[Floats, Floats]], names: Sequence[str], targets: int = 1
) -> tuple[Gram, ...]:
    """One `Gram` per target from blocks of dictionary rows (m, P) and target rows (m, T), in one pass; all share D'D.

    An InputError refuses no rows at all, and values that are not finite (or overflow when squared).
    """
    return _joined((_block_moments(D, Y) for D, Y in blocks if len(D)), tuple(names), targets)


def grams_from_data(
    D: ArrayLike, Y: ArrayLike, names: Sequence[str] | None = None, weights: ArrayLike | None = None
) -> tuple[Gram, ...]:
    """Like `Gram.from_data`, with one `Gram` per column of Y (n, T); all share D'D."""
    D = np.asarray(D, dtype=np.float64)
    Y = np.asarray(Y, dtype=np.float64)
    if D.ndim != 2 or Y.ndim != 2 or len(D) != len(Y):
        raise InputError(f"need D of shape (n, P) and a target of as many rows, got {D.shape} and {Y.shape}")
    columns = tuple(names) if names is not None else default_names(D.shape[1])
    w = None if weights is None else checked_weights(weights, len(D))
    if w is not None and not w.all():
        D, Y, w = D[w > 0.0], Y[w > 0.0], w[w > 0.0]
    rows = (slice(i, i + BLOCK_ROWS) for i in range(0, len(D), BLOCK_ROWS))
    parts = (_block_moments(D[r], Y[r]) if w is None else _weighted_moments(D[r], Y[r], w[r]) for r in rows)
    grams = _joined(parts, columns, Y.shape[1])
    require_squares(D, Y, grams[0].diagonal, np.array([gram.yty for gram in grams]), columns)
    return grams


@lru_cache(maxsize=16)
def default_names(columns: int) -> tuple[str, ...]:
    """x0, x1 ... for columns without names."""
    return tuple(f"x{j}" for j in range(columns))


def require_squares(D: Floats, Y: Floats, diagonal: Floats, yty: Floats, names: Sequence[str]) -> None:
    """Raise an InputError that names the columns of D (n, P) and Y (n, T) that vary, but whose centred sums of squares,
    `diagonal` (P,) and `yty` (T,), are too small to keep digits."""
    if min(diagonal.min(initial=np.inf), yty.min(initial=np.inf)) >= LEAST_SQUARES:
        return
    small = [names[int(j)] for j in np.flatnonzero(diagonal < LEAST_SQUARES) if np.ptp(D[:, j]) > 0.0]
    small += ["the target" for k in np.flatnonzero(yty < LEAST_SQUARES) if np.ptp(Y[:, k]) > 0.0]
    if small:
        raise InputError(f"values too small to square in {', '.join(small[:8])}: multiply them by a power of ten")


def checked_weights(weights: ArrayLike, rows: int) -> Floats:
    """Weights of `rows` rows as an array, or an `InputError` that says what is wrong with them."""
    w = np.asarray(weights, dtype=np.float64)
    if w.shape != (rows,):
        raise InputError(f"need one weight per row, shape ({rows},), got shape {w.shape}")
    bad = np.flatnonzero(~(np.isfinite(w) & (w >= 0.0)))
    if bad.size:
        raise InputError(f"weights must be finite and not negative: weights[{bad[0]}] is {w[bad[0]]:g}")
    if rows and not w.any():
        raise InputError("weights are all zero: no row is left; give at least one a positive weight")
    return w


# Least number of columns for a `LazyGram`: with fewer, D'D is small, however few the rows.
LEAST_COLUMNS = 500


@dataclass(frozen=True, eq=False, slots=True)
class LazyGram:
    """Centred data with the interface of a Gram; columns of D'D are computed on demand."""

    names: tuple[str, ...]  # the P columns
    n: float  # number of rows
    mean: Floats  # (P,), column means of D
    target_mean: float
    data: Floats  # (n, P), centred D
    # centred sums of squares and products
    diagonal: Floats  # (P,)
    Dty: Floats  # (P,)
    yty: float
    dof: float  # degrees of freedom, as in `Gram`

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
    """One `LazyGram` per column of Y (n, T); all share the centred D."""
    columns = tuple(names) if names is not None else default_names(D.shape[1])
    w = np.ones(len(D)) if weights is None else checked_weights(weights, len(D))
    n = float(w.sum())
    with np.errstate(over="ignore", invalid="ignore"):
        mean, target_mean, root = w @ D / n, w @ Y / n, np.sqrt(w)[:, None]
        data, rest = root * (D - mean), root * (Y - target_mean)
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
    """Like `grams_from_data`; `LazyGram`s if D (n, P) has more columns than rows and at least `LEAST_COLUMNS`."""
    rows, columns = D.shape
    if columns > rows and columns >= LEAST_COLUMNS:
        return _lazy_grams(D, Y, names, weights)
    return grams_from_data(D, Y, names, weights)
