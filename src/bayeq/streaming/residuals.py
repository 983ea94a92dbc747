"""Autocorrelation of the residuals of all rows, exact up to a lag, from units of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.expressions import Evaluator, Expression
from bayeq.regression.residuals import Residuals
from bayeq.streaming.extent import Extent, Unit
from bayeq.streaming.work import AsMeasured

__all__ = ["Lagged", "LaggedResiduals", "with_all_rows"]

Floats = NDArray[np.float64]

# Lags that are summed over: correlation reaches further in hardly any residual.
LAGS = 4096


@dataclass(frozen=True)
class Lagged:
    """Sums of products of residuals some rows apart.

    Attributes
    ----------
    products : (LAGS,) array
        Sum of e(t + k) e(t) over the rows, at lags k.
    first, last : arrays
        The first and the last residuals of the rows, up to LAGS - 1 each.
    extent, n : int
        The extent of the last row, and the number of rows.
    """

    products: Floats
    first: Floats
    last: Floats
    extent: int
    n: int

    @classmethod
    def of(cls, e: Floats, extent: int) -> Lagged:
        """Of the residuals of consecutive rows."""
        return cls(_products(e, e), e[: LAGS - 1], e[-(LAGS - 1) :], extent, len(e))

    def __add__(self, other: Lagged) -> Lagged:
        products = self.products + other.products
        first, last = self.first, other.last
        if self.extent == other.extent:
            both = np.concatenate([self.last, other.first])
            products = products + _products(both, both) - _products(self.last, self.last)
            products -= _products(other.first, other.first)
            if len(other.last) < LAGS - 1:
                last = np.concatenate([self.last, other.last])[-(LAGS - 1) :]
        return Lagged(products, first, last, other.extent, self.n + other.n)


def _products(a: Floats, b: Floats) -> Floats:
    """Sum of a(t + k) b(t) at each lag."""
    out = np.zeros(LAGS)
    size = 1 << (2 * max(len(a), 1) - 1).bit_length()
    found = np.fft.irfft(np.fft.rfft(a, size) * np.fft.rfft(b, size).conj(), size)[: min(len(a), LAGS)]
    out[: len(found)] = found
    return out


@dataclass(frozen=True)
class LaggedResiduals:
    """The residuals of the training rows of a unit, and their products.

    Attributes
    ----------
    rows : AsMeasured
        The rows.
    target : str
        The target.
    terms, coef : tuple of Expression, (r,) array
        The terms of a model, and their coefficients.
    constant : float
        What is subtracted further, so that the mean is zero.
    """

    rows: AsMeasured
    target: str
    terms: tuple[Expression, ...]
    coef: Floats
    constant: float

    @property
    def extents(self) -> tuple[Extent, ...]:
        """The rows."""
        return self.rows.extents

    @property
    def reach(self) -> int:
        """Rows beside a unit that are looked at."""
        return self.rows.reach

    def on(self, extents: Sequence[Extent]) -> LaggedResiduals:
        """The same of the same rows, kept elsewhere."""
        return replace(self, rows=self.rows.on(extents))

    def __call__(self, unit: Unit) -> Lagged:
        columns = self.rows.columns(unit).train
        evaluate = Evaluator(columns)
        e = columns[self.target] - self.constant
        for term, theta in zip(self.terms, self.coef.tolist(), strict=True):
            e = e - theta * evaluate(term)
        return Lagged.of(e, unit.extent)


def with_all_rows(found: Residuals, lagged: Lagged) -> Residuals:
    """What was found of some residuals, with the correlation of all of them."""
    rho = lagged.products / lagged.products[0] if lagged.products[0] > 0 else np.zeros(1)
    negative = np.flatnonzero(rho <= 0)
    last = int(negative[0]) if len(negative) else len(rho)
    n_eff = lagged.n / (1.0 + 2.0 * float(rho[1:last].sum()))
    return Residuals(
        lagged.n, float(rho[1]) if len(rho) > 1 else 0.0, n_eff, found.skewness, found.kurtosis, found.normality,
        found.driver,
    )  # fmt: skip
