"""Covariance of coefficients by propagation of the measured noise through smoother and equation.

In the band regression the residual's spectrum is known, but the residual is not stationary: an error of the
displacement acts through the stiffness at the displacement of the moment, and where that is large, x**3 is. Here noise
of the levels that the smoother has found is drawn, smoothed as the channels were, put through the equation and
projected onto its terms as the true residual is. That gives the covariance of the projections, and by it that of the
coefficients (the sandwich form, with its filling from the known noise instead of from the residuals).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import evaluate_terms
from bayeq.gram.band import periodogram, to_band
from bayeq.inference.posterior import Posterior
from bayeq.regression.filtered_terms import unsmoothed
from bayeq.regression.regression import Regression
from bayeq.regression.weights import gains_of
from bayeq.states import Chain, ChainSmoothing

__all__ = ["propagated_covariance"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Independent projections that the covariance is estimated from: a standard deviation errs by 5 %.
PROJECTIONS = 200

# Weighting makes the residual nearly white, so that projections of stretches of it count as independent: of at least so
# many rows, and of this many times those in which the filter that weights has this share of its energy.
STRETCH = 256
MEMORIES = 8
ENERGY = 0.9

# The noise's power in a bin is an average of at least this many drawn periodograms, which errs by 1/4 in one bin.
LEAST_AVERAGED = 16


def propagated_covariance(regression: Regression, posterior: Posterior, basis: Floats) -> tuple[Floats, float]:
    """Covariance of the included coefficients, and how far the residual exceeds the noise that it is to come from.

    Parameters
    ----------
    regression : Regression
        Of a band.
    posterior : Posterior
        In original units, r terms in its support. Inputs whose noise is not known add none, but the level of the whole
        is that of the residuals.
    basis : (r, f) array
        How the coefficients move with those that are free; the identity where all are.

    Returns
    -------
    (r, r) array
        H^-1 M H^-1: H the sums of squares and products of the weighted columns, M the covariance of their products with
        the residual.
    float
        Squares of the residual over what the noise drawn gives in the same bin, on average over the bins.
    """
    in_band = regression.band
    assert in_band is not None
    motion, terms, which = regression.motion, regression.design.terms, regression.k
    chains, smoothings = motion.roles.chains, motion.smoothing
    pieces = [rows.columns for rows in motion.train]
    kept = np.flatnonzero(posterior.support)
    chosen = [terms[int(j)] for j in kept]
    theta = posterior.coef[kept]
    own = smoothings[which]
    target = chains[which].target
    filtered = unsmoothed(chosen, chains)
    noisy = {terms[j].text: float(np.sqrt(variance)) for j, variance in in_band.noise.items()}
    rng = np.random.default_rng(0)
    H, M = np.zeros((len(kept) + 1,) * 2), np.zeros((len(kept) + 1,) * 2)
    drawn = found = surplus = numbers = 0.0
    for piece, band, spectrum in zip(pieces, in_band.bands, in_band.spectrum, strict=True):
        n = len(piece[target])
        root = np.sqrt(1.0 / spectrum)
        X = _in_time(band.columns[:, np.append(0, kept + 1)], root, band.first, n)
        H += X.T @ X
        stretches = max(n // max(STRETCH, MEMORIES * _memory(root, band.first, n)), 1)
        edges = (np.arange(stretches) * n) // stretches
        count = -(-PROJECTIONS // stretches)
        base = evaluate_terms(chosen, piece)
        gain = gains_of(piece[target], own)
        filters = [_noise_filter(smoothing, n) for smoothing in smoothings]
        power = np.zeros(len(band.frequency))
        filling = np.zeros_like(M)
        for _ in range(count):
            errors = _errors(n, chains, filters, noisy, rng)
            moved = {name: piece[name] + error for name, error in errors.items() if name != target}
            difference = evaluate_terms(chosen, {**piece, **moved}) - base
            columns = to_band(difference, errors[target], _rate(own), in_band.span, gain, filtered).columns
            e = columns[:, -1] - columns[:, 1:-1] @ theta
            power += np.abs(e) ** 2 / count
            scores = np.add.reduceat(X * _in_time(e[:, None], root, band.first, n), edges, axis=0)
            filling += scores.T @ scores / count
        M += filling
        left = periodogram(band, posterior.coef, posterior.intercept)
        drawn += float(band.count @ (power / spectrum))
        found += float(band.count @ (left / spectrum))
        surplus += _surplus(left / spectrum, power / spectrum, count, band.count)
        numbers += float(band.count.sum())
    # in a band that does not begin at zero there is no constant
    constant = np.eye(1 + len(kept))[:, : int(H[0, 0] > 0)]
    free = np.hstack([constant, np.vstack([np.zeros((1, basis.shape[1])), basis])])
    covariance = free @ _sandwich(free.T @ H @ free, free.T @ M @ free) @ free.T * max(found / drawn, 1.0)
    covariance = covariance[1:, 1:]
    return np.asarray(0.5 * (covariance + covariance.T)), surplus / numbers


def _sandwich(H: Floats, M: Floats) -> Floats:
    """H^-1 M H^-1 of symmetric matrices, H positive and M not negative, and so is the product in floating point.

    Directions of H that rounding decides are left out.
    """
    sizes = np.diagonal(H)
    unit = np.where(sizes > 0.0, 1.0 / np.sqrt(np.where(sizes > 0.0, sizes, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(H * unit[:, None] * unit)
    kept = values > len(values) * np.finfo(np.float64).eps * values.max(initial=0.0)
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    inner, axes = np.linalg.eigh(M * unit[:, None] * unit)
    root = inverse @ (axes * np.sqrt(np.maximum(inner, 0.0))) * unit[:, None]
    return np.asarray(root @ root.T)


def _surplus(left: Floats, drawn: Floats, draws: int, numbers: Floats) -> float:
    """Sum over the bins of the residual's power over that of the noise, both in units of the spectrum.

    The power of the noise is averaged over draws and, where these are few, over neighbouring bins.
    """
    width = -(-LEAST_AVERAGED // draws)
    starts = np.arange(0, max(len(drawn) - width + 1, 1), width)
    bins = np.diff(np.append(starts, len(drawn)))
    averaged = np.add.reduceat(drawn, starts) / bins
    # the inverse of an average of m exponential variables is larger than that of their mean, by m/(m - 1)
    averaged *= bins * draws / np.maximum(bins * draws - 1.0, 1.0)
    return float(numbers @ (left / np.repeat(averaged, bins)))


def _rate(smoothing: ChainSmoothing) -> float:
    assert smoothing.fs is not None
    return smoothing.fs


def _in_time(columns: Complexes, factor: Floats, first: int, n: int) -> Floats:
    """Weighted bins as a signal of n rows, scaled so that sums over rows are those over bins."""
    whole = np.zeros((n // 2 + 1, columns.shape[1]), dtype=np.complex128)
    whole[first : first + len(columns)] = columns * factor[:, None]
    return np.asarray(np.fft.irfft(whole, n, axis=0) * np.sqrt(n))


def _memory(root: Floats, first: int, n: int) -> int:
    """Rows in which the filter of that gain has most of its energy."""
    energy = _in_time(np.ones((len(root), 1), dtype=np.complex128), root, first, n)[: n // 2, 0] ** 2
    return int(np.searchsorted(np.cumsum(energy), ENERGY * energy.sum()))


class _NoiseFilter(NamedTuple):
    """From white noise of unit variance on each measured derivative to the errors of all smoothed ones."""

    channels: list[Complexes]
    derivatives: list[Complexes]


def _noise_filter(smoothing: ChainSmoothing, n: int) -> _NoiseFilter:
    frequency = np.asarray(np.fft.rfftfreq(n, 1.0 / _rate(smoothing)), dtype=np.float64)
    s = 2j * np.pi * np.maximum(frequency, 1e-6 * _rate(smoothing))
    coordinate = smoothing.gain(frequency) / smoothing.information(frequency)
    return _NoiseFilter(
        [coordinate * (-s) ** k / sd for k, sd in smoothing.measured_noise()],
        [gain * s**k for k, gain in enumerate(smoothing.unit_gains)],
    )


def _errors(
    n: int,
    chains: Sequence[Chain],
    filters: Sequence[_NoiseFilter],
    inputs: Mapping[str, float],
    rng: np.random.Generator,
) -> dict[str, Floats]:
    """Errors that noise makes in n rows of the smoothed derivatives of all chains, and noise of the inputs."""
    out: dict[str, Floats] = {}
    for chain, noise in zip(chains, filters, strict=True):
        coordinate = sum(factor * np.fft.rfft(rng.standard_normal(n)) for factor in noise.channels)
        for name, factor in zip(chain.names, noise.derivatives, strict=True):
            out[name] = np.fft.irfft(factor * coordinate, n)
    for name, sd in inputs.items():
        out[name] = sd * rng.standard_normal(n)
    return out
