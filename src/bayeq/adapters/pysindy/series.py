"""Rows of a library and a target as a time series: the Gram that allows for errors of the numerical derivative.

An optimizer of PySINDy does not know how the derivatives were computed; docs/method/regression.md has what holds for
all methods. Differences that correct them are further candidates, integrated out; they are of the fitted target, since
those of the target itself would share its noise (two-stage least squares). The regression uses the Fourier bins below
the frequency at which the target comes near to the residual, weighted by the inverse of the residual's density, which
is assumed not to fall with frequency: bins of tapered columns have independent residuals (generalised least squares;
Hannan 1963).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bayeq.arrays import Bools, Complexes, Floats
from bayeq.inference.collapsed.slab import likeliest_by_rows
from bayeq.inference.gram import Gram

# Taper at either end of a piece: share of its rows; fewest rows; length as a multiple of the inverse bandwidth, since
# that is how far a smoother's errors at the ends reach; and largest share for that length.
TAPERED = 1 / 40
LEAST_TAPER = 16
MEMORY = 4.0
MOST_TAPERED = 1 / 5

# Bins on either side over which the spectrum of residuals is averaged: 122 degrees of freedom.
SMOOTHING = 30

# Coefficients of d2, d4 and d6 that correct the error of second-order central differences.
COMPLETION = np.array([1 / 6, 1 / 30, 1 / 140])
ORDERS = len(COMPLETION)

# Iterations of the two-stage least squares.
TURNS = 4

# A shorter piece is not used, and no piece where more than half of the rows would be lost.
LEAST_PIECE = 64

# A step between rows is the joint of two trajectories if it is this many times as long as both its neighbours.
JOINT = 10.0

# The band ends where the target's density is no more than this many times that of the residual, ...
ABOVE_RESIDUAL = 30.0
# ... each averaged over this many bins on either side, and holds this many bins at least.
COARSE = 5
LEAST_BINS = 40

# Least noise, as a share of the target: rounding.
LEAST_FLOOR = 1e-6

# Error, as a share of the target, that rows in no order may have without showing it: derivatives inside a weak form by
# differences of second order; and the largest number of rows over which it averages out.
UNSEEN = 1e-2
UNSEEN_ROWS = 10.0

# Fits that find the spectrum of the residual.
PILOTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Fourier bins of the rows of one piece, from frequency zero to the end of the band."""

    frequency: Floats  # (b,), frequencies [1/row]
    count: Floats  # (b,), real numbers that a bin stands for: 1 at zero frequency, otherwise 2
    # (b, P + 1), transforms of columns and target, scaled so that white noise of variance s^2 has E|.|^2 = s^2
    columns: Complexes
    kept: float  # share of the rows' information that the taper leaves


def pieces_of(Z: Floats, gaps: Bools) -> list[slice] | None:
    """Uninterrupted pieces of rows of a library (n, P); gaps (n,) are rows that do not follow on the one before.

    None where fewer than half of the rows are in pieces of 64 rows, or the columns change more from row to row than at
    about six rows per period: samples in no order, or subdomains of a weak form.
    """
    step = np.linalg.norm(np.diff(Z, axis=0), axis=1)
    padded = np.concatenate([[0.0], step, [0.0]])
    joint = (step > JOINT * np.maximum(padded[:-2], padded[2:])) | gaps[1:]
    edges = [0, *(np.flatnonzero(joint) + 1).tolist(), len(Z)]
    pieces = [slice(a, b) for a, b in pairwise(edges) if b - a >= LEAST_PIECE]
    if 2 * sum(p.stop - p.start for p in pieces) < len(Z):
        return None
    deviation = np.sqrt(sum(((Z[p] - Z[p].mean(axis=0)) ** 2).sum(axis=0) for p in pieces))
    second = np.sqrt(sum((np.diff(Z[p], 2, axis=0) ** 2).sum(axis=0) for p in pieces))
    varying = deviation > 1e-9
    return pieces if varying.any() and np.median(second[varying] / deviation[varying]) < 1.0 else None


def row_gram(Z: Floats, t: Floats, w: Floats, floor: float) -> Gram:
    """Uncentred statistics of rows in no order, each counted `w` (n,) times, with white noise of sd `floor` added."""
    columns = np.column_stack([Z, t])
    found = _uncentred((columns * w[:, None]).T @ columns, float(w.sum()))
    return replace(found, yty=found.yty + found.n * floor**2)


def series_grams(Z: Floats, T: Floats, pieces: Sequence[slice], floors: Floats) -> list[Gram]:
    """Statistics of each target in its band, errors of the derivative allowed for.

    Library (n, P), columns of unit size; targets (n, K) of unit size, or zero; pieces from `pieces_of`; floors (K,),
    the least standard deviations of the noise.
    """
    spare = 2 * ORDERS
    inner = [slice(p.start + spare, p.stop - spare) for p in pieces]
    library = [Z[p] for p in inner]
    targets = [[T[p, k] for p in inner] for k in range(T.shape[1])]
    highest = min(_band_end(library, t) for t in targets)
    out = []
    for t, floor in zip(targets, floors, strict=True):
        bands = _with_differences(Z, pieces, library, t, highest)
        out.append(_banded(bands, Z.shape[1], max(float(floor), _last_order(bands))))
    return out


def _with_differences(
    Z: Floats, pieces: Sequence[slice], library: Sequence[Floats], t: Sequence[Floats], highest: float
) -> list[Band]:
    """Library, differences and target of each piece in the band; differences are of the fitted target."""
    bands = [to_band(D, y, highest) for D, y in zip(library, t, strict=True)]
    fitted = [Z[p] @ _least_squares(bands) for p in pieces]
    for _ in range(TURNS):
        own = [_differences(y) for y in fitted]
        columns = [np.column_stack([D, E[ORDERS:-ORDERS]]) for D, E in zip(library, own, strict=True)]
        bands = [to_band(D, y, highest) for D, y in zip(columns, t, strict=True)]
        coef = _least_squares(bands)
        terms = Z.shape[1]
        # rows at either end that have no differences of their own take those of the nearest
        fitted = [
            Z[p] @ coef[:terms] + np.pad(E, ((ORDERS, ORDERS), (0, 0)), mode="edge") @ coef[terms:]
            for p, E in zip(pieces, own, strict=True)
        ]
    return bands


def _least_squares(bands: Sequence[Band]) -> Floats:
    """Coefficients of all columns, bins weighted by the residual's density."""
    stacked = np.concatenate([b.columns for b in bands])
    weight = np.ones(len(stacked))
    for _ in range(2):
        rows = stacked * weight[:, None]
        rows = np.concatenate([rows.real, rows.imag])
        coef = np.asarray(np.linalg.lstsq(rows[:, :-1], rows[:, -1])[0], dtype=np.float64)
        weight = 1.0 / np.sqrt(np.concatenate(_spectrum(bands, coef, LEAST_FLOOR)))
    return coef


def _last_order(bands: Sequence[Band]) -> float:
    """Root mean square of the last correction, taken as the error that higher differences would leave."""
    power = count = 0.0
    for b in bands:
        symbol = COMPLETION[-1] * (2.0 * np.sin(np.pi * b.frequency)) ** (2 * ORDERS)
        power += float(b.count @ np.abs(symbol * b.columns[:, -1]) ** 2)
        count += float(b.count.sum())
    return float(np.sqrt(power / count))


def _differences(t: Floats) -> Floats:
    """Differences of order 2, 4, 6 about each row that has them all, (n - 2 ORDERS, ORDERS)."""
    out, d = [], t
    for k in range(ORDERS):
        d = np.diff(d, 2)
        spare = ORDERS - k - 1
        out.append(d[spare : len(d) - spare])
    return np.column_stack(out)


def _band_end(D: Sequence[Floats], t: Sequence[Floats]) -> float:
    """Frequency [1/row] below which the density of a target is well above that of its residual on all columns."""
    coef = np.linalg.lstsq(np.concatenate(D), np.concatenate(t))[0]
    left = [y - d @ coef for d, y in zip(D, t, strict=True)]
    frequency = np.concatenate([np.fft.rfftfreq(len(y)) for y in t])
    order = np.argsort(frequency, kind="stable")
    reach = COARSE * len(t)
    average = np.full(2 * reach + 1, 1.0 / (2 * reach + 1))

    def density(pieces: Sequence[Floats]) -> Floats:
        power = np.concatenate([np.abs(np.fft.rfft(taper(len(y)) * y)) ** 2 / len(y) for y in pieces])
        return np.asarray(np.convolve(np.pad(power[order], reach, mode="reflect"), average, "valid"))

    mean = np.mean(np.concatenate(t))
    signal, noise = density([y - mean for y in t]), np.maximum.accumulate(density(left))
    below = np.flatnonzero(signal < ABOVE_RESIDUAL * noise)
    end = float(frequency[order][below[0]]) if len(below) else 0.5
    return max(end, LEAST_BINS / max(len(y) for y in t))


def taper(n: int, memory: float = 0.0) -> Floats:
    """Window that rises from 0 to 1 with three continuous derivatives at either end; `memory` is in rows."""
    length = max(LEAST_TAPER, round(TAPERED * n), round(min(MEMORY * memory, MOST_TAPERED * n)))
    s = np.clip(np.minimum(np.arange(n), n - 1 - np.arange(n)) / length, 0.0, 1.0)
    return np.asarray(s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3))


def to_band(D: Floats, y: Floats, highest: float) -> Band:
    """Transform columns (n, P) and a target (n,): the bins up to `highest` [1/row]."""
    n = len(y)
    window = taper(n, 1.0 / highest)
    power = float(np.sum(window**2))
    frequency = np.asarray(np.fft.rfftfreq(n), dtype=np.float64)
    # the bin at half the sampling rate is left out: it is real, and aliased
    last = max(min(int(np.searchsorted(frequency, highest, side="right")), (n + 1) // 2), 1)
    columns = np.column_stack([np.fft.rfft(window * values)[:last] for values in (*D.T, y)]) / np.sqrt(power)
    count = np.full(last, 2.0)
    count[0] = 1.0
    return Band(frequency[:last], count, columns, power**2 / (n * float(np.sum(window**4))))


def band_gram(bands: Sequence[Band], spectrum: Sequence[Floats]) -> Gram:
    """Uncentred sufficient statistics of the bins of all pieces, weighted by the inverse of their residual's variance.

    Weights are scaled to a mean of 1, so that the n of the Gram is the number of real numbers in the band.
    """
    total = sum(float(np.sum(b.count)) for b in bands)
    mean_weight = sum(float(np.sum(b.count / s)) for b, s in zip(bands, spectrum, strict=True)) / total
    products, rows = 0.0, 0.0
    for variance, band in zip(spectrum, bands, strict=True):
        root = np.sqrt(band.count * band.kept / variance / mean_weight)[:, None] * band.columns
        stacked = np.concatenate([root.real, root.imag])
        products = products + stacked.T @ stacked
        rows += float(np.sum(band.count)) * band.kept
    return _uncentred(np.asarray(products), rows)


def _uncentred(products: Floats, n: float) -> Gram:
    """A Gram from uncentred sums of products of columns and target."""
    terms = len(products) - 1
    DtD, Dty = np.ascontiguousarray(products[:terms, :terms]), products[:terms, terms].copy()
    names = tuple(f"x{j}" for j in range(terms))
    return Gram(names, n, np.zeros(terms), 0.0, DtD, Dty, float(products[terms, terms]), n)


def residual_spectrum(bands: Sequence[Band], coef: Floats, rising: bool = False) -> list[Floats]:
    """Variance in each bin of the residual of coefficients (P,): its periodogram, averaged over neighbouring bins.

    If `rising`, it is made not to fall with frequency.
    """
    power = [np.abs(band.columns[:, -1] - band.columns[:, :-1] @ coef) ** 2 for band in bands]
    order = np.argsort(np.concatenate([band.frequency for band in bands]), kind="stable")
    values = np.concatenate(power)[order]
    half = min(SMOOTHING, max(1, (len(values) - 1) // 4))
    padded = np.pad(values, half, mode="reflect")
    smooth = np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
    smooth = np.maximum(smooth, 1e-6 * smooth.max())
    out = np.empty_like(smooth)
    out[order] = np.maximum.accumulate(smooth) if rising else smooth
    return np.split(out, np.cumsum([len(p) for p in power])[:-1])


def _banded(bands: Sequence[Band], terms: int, floor: float) -> Gram:
    """Statistics of the terms, weighted by the residual's spectrum, the differences integrated out."""
    coef = _least_squares(bands)
    for _ in range(PILOTS):
        whole, gram, unit = _weighted(bands, terms, _spectrum(bands, coef, floor), floor)
        coef = np.zeros(terms + ORDERS)
        coef[:terms] = likeliest_by_rows(gram)[1]
        E = slice(terms, None)
        ridged = whole.DtD[E, E] + np.diag(unit / COMPLETION**2)
        coef[E] = np.linalg.solve(ridged, whole.Dty[E] - whole.DtD[E, :terms] @ coef[:terms])
    spectrum = _spectrum(bands, coef, floor)
    # A bin whose residual is below the density that weights it counts less: beyond the pass band of a smoothed motion
    # the residual is nearly zero, and would be evidence that the noise is small in other bins too.
    own = residual_spectrum(bands, coef)
    counted = sum(float(b.count @ ((o + floor**2) / s)) for b, o, s in zip(bands, own, spectrum, strict=True))
    return replace(_weighted(bands, terms, spectrum, floor)[1], n=counted, dof=counted)


def _spectrum(bands: Sequence[Band], coef: Floats, floor: float) -> list[Floats]:
    """Density of the residual in each bin, made not to fall with frequency, plus that of the floor."""
    return [density + floor**2 for density in residual_spectrum(bands, coef, rising=True)]


def _weighted(bands: Sequence[Band], terms: int, spectrum: Sequence[Floats], floor: float) -> tuple[Gram, Gram, float]:
    """Statistics of all columns, of the terms with the others integrated out, and the noise variance they imply."""
    whole = band_gram(bands, spectrum)
    count = sum(float(b.count.sum()) for b in bands)
    unit = count / sum(float((b.count / s).sum()) for b, s in zip(bands, spectrum, strict=True))
    T, E = slice(0, terms), slice(terms, None)
    share = np.linalg.inv(whole.DtD[E, E] + np.diag(unit / COMPLETION**2))
    across = whole.DtD[T, E] @ share
    gram = replace(
        whole.select(range(terms)),
        DtD=whole.DtD[T, T] - across @ whole.DtD[E, T],
        Dty=whole.Dty[T] - across @ whole.Dty[E],
        yty=max(whole.yty - float(whole.Dty[E] @ share @ whole.Dty[E]), 0.0) + whole.n * floor**2,
    )
    return whole, gram, unit
