"""Regression in a band of frequencies, of columns of which nothing but their rows is known.

The equation of motion a(t) = theta'd(t) holds at every instant, so it holds for any linear transform of both sides. The
discrete Fourier transform of tapered columns separates the band in which smoothed states follow the motion from what
is beyond it, where a smoothed target has lost its signal; and it makes residuals whose spectrum is not flat
independent, each bin with a variance of its own: least squares with weights 1/S_r(f) is then efficient, and its
intervals are honest, whatever filters the data went through (generalised least squares; Hannan 1963).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.gram.gram import Gram

__all__ = ["Band", "band_gram", "residual_spectrum", "taper", "to_band"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Share of a record that is tapered at either end, and the least number of rows; this many times the inverse of the
# band's width, since that is how far a smoother's errors at the ends reach; and not more than this share.
TAPERED = 1 / 40
LEAST_TAPER = 16
MEMORY = 4.0
MOST_TAPERED = 1 / 5

# Bins on either side over which the spectrum of residuals is averaged: 122 degrees of freedom.
SMOOTHING = 30


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """The rows of one record as bins of a band.

    Attributes
    ----------
    frequency : (b,) array
        Frequencies [Hz].
    count : (b,) array
        Real numbers that a bin stands for: 1 at zero frequency, otherwise 2.
    columns : (b, P + 2) complex array
        Transforms of a constant, of the columns and of the target, scaled so that white noise of variance s^2 has
        E|.|^2 = s^2.
    kept : float
        Share of the rows' information that the taper leaves.
    """

    frequency: Floats
    count: Floats
    columns: Complexes
    kept: float


def taper(n: int, memory: float = 0.0) -> Floats:
    """Window that rises from 0 to 1 with three continuous derivatives at either end.

    It does so over 1/40 of the rows, or 16, or over four times the `memory` in rows, whichever is most.
    """
    length = max(LEAST_TAPER, round(TAPERED * n), round(min(MEMORY * memory, MOST_TAPERED * n)))
    s = np.clip(np.minimum(np.arange(n), n - 1 - np.arange(n)) / length, 0.0, 1.0)
    return np.asarray(s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3))


def to_band(D: Floats, y: Floats, fs: float, span: tuple[float, float]) -> Band:
    """Transform the rows of a record.

    Parameters
    ----------
    D, y : (n, P) array, (n,) array
        Dictionary and target, uniformly sampled.
    fs : float
        Sampling rate [Hz].
    span : (float, float)
        Lower and upper end of the band [Hz]. A band that does not begin at zero holds no constant.
    """
    n = len(y)
    window = taper(n, fs / span[1] if span[1] > 0 else 0.0)
    power = float(np.sum(window**2))
    frequency = np.asarray(np.fft.rfftfreq(n, 1.0 / fs), dtype=np.float64)
    first = int(np.searchsorted(frequency, span[0], side="left"))
    # the bin at half the sampling rate is left out: it is real, and aliased
    last = min(int(np.searchsorted(frequency, span[1], side="right")), (n + 1) // 2)
    chosen = slice(first, max(last, first + 1))
    columns = np.zeros((len(frequency[chosen]), D.shape[1] + 2), dtype=np.complex128)
    for j in range(first > 0, columns.shape[1]):
        values = np.ones(n) if j == 0 else y if j == D.shape[1] + 1 else D[:, j - 1]
        columns[:, j] = np.fft.rfft(window * values)[chosen] / np.sqrt(power)
    count = np.full(len(columns), 2.0)
    if first == 0:
        count[0] = 1.0
    kept = power**2 / (n * float(np.sum(window**4)))
    return Band(frequency[chosen], count, columns, kept)


def band_gram(
    bands: Sequence[Band],
    names: tuple[str, ...],
    spectrum: Sequence[Floats] | None = None,
) -> Gram:
    """Sufficient statistics of the bins of all records.

    Parameters
    ----------
    bands : sequence of Band
        One per record.
    names : tuple of str
        The P columns.
    spectrum : sequence of (b,) array, optional
        Variance of the residual in each bin; by default the same in all.

    Returns
    -------
    Gram
        Weights are scaled to a mean of 1, so that n is the number of real numbers in the band.
    """
    weights = [np.ones(len(b.count)) for b in bands] if spectrum is None else [1.0 / s for s in spectrum]
    total = sum(float(np.sum(b.count)) for b in bands)
    mean_weight = sum(float(np.sum(w * b.count)) for w, b in zip(weights, bands, strict=True)) / total
    terms = len(names)
    products = np.zeros((terms + 2, terms + 2))
    rows = 0.0
    for weight, band in zip(weights, bands, strict=True):
        w = weight / mean_weight * band.count * band.kept
        root = np.sqrt(w)[:, None] * band.columns
        stacked = np.concatenate([root.real, root.imag])
        products += stacked.T @ stacked
        rows += float(np.sum(band.count)) * band.kept
    constant = float(products[0, 0])
    mean = products[0, 1:] / constant if constant > 0 else np.zeros(terms + 1)
    cross = products[1:, 1:] - np.outer(mean, mean) * constant
    return Gram(
        names=names,
        n=rows,
        mean=mean[:terms],
        target_mean=float(mean[terms]),
        DtD=np.ascontiguousarray(cross[:terms, :terms]),
        Dty=cross[:terms, terms].copy(),
        yty=float(cross[terms, terms]),
        dof=rows - (constant > 0),
    )


def periodogram(band: Band, coef: Floats, intercept: float) -> Floats:
    """Squared modulus of the residual that coefficients (P,) leave in each bin, (b,)."""
    theta = np.concatenate([[intercept], coef])
    return np.asarray(np.abs(band.columns[:, -1] - band.columns[:, :-1] @ theta) ** 2)


def residual_spectrum(bands: Sequence[Band], coef: Floats, intercept: float) -> list[Floats]:
    """Variance of the residual in each bin: its periodogram, averaged over neighbouring frequencies of all records.

    Parameters
    ----------
    bands : sequence of Band
        One per record.
    coef, intercept : (P,) array, float
        What the residual is of.
    """
    power = [periodogram(band, coef, intercept) for band in bands]
    frequency = np.concatenate([band.frequency for band in bands])
    order = np.argsort(frequency, kind="stable")
    values = np.concatenate(power)[order]
    half = min(SMOOTHING, max(1, (len(values) - 1) // 4))
    padded = np.pad(values, half, mode="reflect")
    smooth = np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
    smooth = np.maximum(smooth, 1e-6 * smooth.max())
    out = np.empty_like(smooth)
    out[order] = smooth
    return np.split(out, np.cumsum([len(p) for p in power])[:-1])
