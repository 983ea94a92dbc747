"""Regression in a band of frequencies.

The equation of motion a(t) = theta'd(t) holds at every instant, so it holds for any linear transform of both sides. The
discrete Fourier transform of tapered columns separates the band in which smoothed states follow the motion from what
is beyond it, where a smoothed target has lost its signal; and it makes residuals whose spectrum is not flat
independent, each bin with a variance of its own: least squares with weights 1/S_r(f) is then efficient, and its
intervals are honest, whatever filters the data went through (generalised least squares; Hannan 1963).

A smoothed state is an expectation given the channels; the smoother's gain G(f) multiplies the signals of the
equation's motion alike, so that the measured input is multiplied by it too: both sides see the same filter. The noise
of a measured input is a classical error in a regressor and is subtracted from its sum of squares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.gram.gram import Gram

__all__ = [
    "MOST_NOISE",
    "Band",
    "added_floor",
    "band_gram",
    "noise_floor",
    "periodogram",
    "residual_spectrum",
    "taper",
    "to_band",
]

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

# Floors of white noise are looked for down to this power of 1/2 of the mean.
FLOORS = 24

# Up to this factor they are found.
FLOOR_TOLERANCE = 1e-4

# No more than this share of a column's sum of squares is subtracted as noise.
MOST_NOISE = 0.5


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
    gain : (b,) array
        By which input columns have been multiplied.
    kept : float
        Share of the rows' information that the taper leaves.
    first : int
        Number of the first bin in the transform of the rows.
    """

    frequency: Floats
    count: Floats
    columns: Complexes
    gain: Floats
    kept: float
    first: int


def taper(n: int, memory: float = 0.0) -> Floats:
    """Window that rises from 0 to 1 with three continuous derivatives at either end.

    It does so over 1/40 of the rows, or 16, or over four times the `memory` in rows, whichever is most.
    """
    length = max(LEAST_TAPER, round(TAPERED * n), round(min(MEMORY * memory, MOST_TAPERED * n)))
    s = np.clip(np.minimum(np.arange(n), n - 1 - np.arange(n)) / length, 0.0, 1.0)
    return np.asarray(s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3))


def to_band(
    D: Floats,
    y: Floats,
    fs: float,
    span: tuple[float, float],
    gain: Floats | None = None,
    inputs: Sequence[int] = (),
) -> Band:
    """Transform the rows of a record.

    Parameters
    ----------
    D, y : (n, P) array, (n,) array
        Dictionary and target, uniformly sampled.
    fs : float
        Sampling rate [Hz].
    span : (float, float)
        Lower and upper end of the band [Hz]. A band that does not begin at zero holds no constant.
    gain : (n//2 + 1,) array, optional
        Factor of input columns at the frequencies of `numpy.fft.rfftfreq`.
    inputs : sequence of int
        Columns to be multiplied by it.
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
    factor = np.ones(len(columns)) if gain is None else gain[chosen]
    for j in inputs:
        columns[:, j + 1] *= factor
    count = np.full(len(columns), 2.0)
    if first == 0:
        count[0] = 1.0
    kept = power**2 / (n * float(np.sum(window**4)))
    return Band(frequency[chosen], count, columns, factor, kept, first)


def band_gram(
    bands: Sequence[Band],
    names: tuple[str, ...],
    spectrum: Sequence[Floats] | None = None,
    noise: Mapping[int, float] | None = None,
    coef: Floats | None = None,
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
    noise : mapping of int to float, optional
        Noise variance of input columns, subtracted from their sums of squares and, times the square of their
        coefficient `coef`, added to that of y: it is in the residual, though not in the regression.
    coef : (P,) array, optional
        Coefficients of an earlier fit.

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
    added = 0.0
    for weight, band in zip(weights, bands, strict=True):
        w = weight / mean_weight * band.count * band.kept
        root = np.sqrt(w)[:, None] * band.columns
        stacked = np.concatenate([root.real, root.imag])
        products += stacked.T @ stacked
        rows += float(np.sum(band.count)) * band.kept
        for j, variance in (noise or {}).items():
            removed = min(
                variance * float(np.sum(w * band.gain**2)), MOST_NOISE * float(np.sum(root[:, j + 1].real ** 2))
            )
            products[j + 1, j + 1] -= removed
            if coef is not None:
                added += float(coef[j]) ** 2 * removed
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
        yty=float(cross[terms, terms]) + added,
        dof=rows - (constant > 0),
    )


def periodogram(band: Band, coef: Floats, intercept: float) -> Floats:
    """Squared modulus of the residual that coefficients (P,) leave in each bin, (b,)."""
    theta = np.concatenate([[intercept], coef])
    return np.asarray(np.abs(band.columns[:, -1] - band.columns[:, :-1] @ theta) ** 2)


def residual_spectrum(
    bands: Sequence[Band], coef: Floats, intercept: float, shapes: Sequence[Floats] | None = None
) -> list[Floats]:
    """Variance of the residual in each bin: its periodogram, averaged over neighbouring frequencies of all records.

    Parameters
    ----------
    bands : sequence of Band
        One per record.
    coef, intercept : (P,) array, float
        What the residual is of.
    shapes : sequence of (b,) array, optional
        Densities known up to a factor that varies slowly with frequency: it is the ratio to these that is averaged, so
        that what is narrower than the average, a resonance, keeps its form.
    """
    power = [periodogram(band, coef, intercept) for band in bands]
    known = np.ones(sum(len(p) for p in power)) if shapes is None else np.concatenate(shapes)
    frequency = np.concatenate([band.frequency for band in bands])
    order = np.argsort(frequency, kind="stable")
    values = (np.concatenate(power) / known)[order]
    half = min(SMOOTHING, max(1, (len(values) - 1) // 4))
    padded = np.pad(values, half, mode="reflect")
    smooth = np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
    smooth = np.maximum(smooth, 1e-6 * smooth.max())
    out = np.empty_like(smooth)
    out[order] = smooth
    return np.split(out * known, np.cumsum([len(p) for p in power])[:-1])


def added_floor(power: Floats, shape: Floats, count: Floats) -> float:
    """Level f of white noise for which `power` is likeliest as a periodogram of density shape + f (Whittle 1953).

    Parameters
    ----------
    power, shape : (b,) array
        Periodogram and known part of the density.
    count : (b,) array
        Real numbers in each bin.
    """
    levels = float(np.average(power, weights=count)) * np.append(0.0, 2.0 ** np.arange(-FLOORS, 3.0, 0.5))
    # where the known part is nothing, a floor there must be
    least = float(np.sqrt(np.finfo(np.float64).tiny))

    def misfits(candidates: Floats) -> Floats:
        density = np.maximum(shape[:, None] + candidates, least)
        return np.asarray(count @ (np.log(density) + power[:, None] / density))

    best = int(np.argmin(misfits(levels)))
    width = np.sqrt(2.0)
    level = float(levels[best])
    while level > 0 and width > 1.0 + FLOOR_TOLERANCE:
        nearby = level * width ** np.linspace(-1.0, 1.0, 9)
        level = float(nearby[np.argmin(misfits(nearby))])
        width **= 0.25
    return level


def noise_floor(values: Sequence[Floats], widest: float = 0.85) -> float | None:
    """Variance of white noise on a channel, from the part of its spectrum above its pass band.

    Parameters
    ----------
    values : sequence of (n,) array
        The channel in uninterrupted, uniformly sampled pieces.
    widest : float
        Share of the spectrum that the pass band may fill.

    Returns
    -------
    float or None
        None where no flat floor, well below the level of the pass band, is seen: the band fills the spectrum, or rolls
        off slowly.
    """
    levels = np.zeros(40)
    counts = np.zeros(40)
    for piece in values:
        n = len(piece)
        if n < 400:
            continue
        window = taper(n)
        power = np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2 / float(np.sum(window**2))
        place = np.minimum((np.arange(len(power)) * 40) // len(power), 39)
        levels += np.bincount(place, power, minlength=40)
        counts += np.bincount(place, minlength=40)
    if not counts.all():
        return None
    levels /= counts
    top = levels[round(40 * widest) :]
    floor = float(np.mean(top))
    # flat: the upper bands agree within their scatter, and lie far below the strongest
    scatter = 5.0 / np.sqrt(counts[-len(top) :].min())
    if floor > 0.1 * levels.max() or top.max() > floor * (1.0 + scatter) or top.min() < floor * (1.0 - scatter):
        return None
    # more of the spectrum at that level makes the estimate better
    flat = levels < floor * (1.0 + 2.0 * scatter)
    first = 39 - int(np.argmin(flat[::-1])) + 2 if not flat.all() else 0
    used = slice(min(first, round(40 * widest)), 40)
    return float(np.sum(levels[used] * counts[used]) / np.sum(counts[used]))
