"""The Gram of smoothed records: in the band that the smoother follows, weighted by the spectrum of the residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.gram import Gram
from bayeq.gram.band import (
    MOST_NOISE,
    Band,
    added_floor,
    band_gram,
    noise_floor,
    periodogram,
    residual_spectrum,
    to_band,
)
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from bayeq.regression.design import Design
from bayeq.regression.filtered_terms import unsmoothed
from bayeq.regression.residuals import Residuals
from bayeq.states import ChainSmoothing

__all__ = ["InBand", "Piece", "gains_of", "regress_in_band", "thinned_gram", "weighted_gram", "without_noise"]

Floats = NDArray[np.float64]

# Fits that find the spectrum of the residuals and the coefficients of the inputs.
PILOTS = 3

# A model that leaves more of the target's variance is rejected.
REJECTED = 0.5

# Beneath the noise of the chain's channels there is white noise of at least this share of the residual.
LEAST_FLOOR = 1e-6

# Real numbers in the band without which there is no regression there. There may be more terms than numbers.
LEAST_NUMBERS = 16.0


class Piece(NamedTuple):
    """An uninterrupted piece of a smoothed record.

    Attributes
    ----------
    D : (n, P) array
        Dictionary on smoothed states.
    y : (n,) array
        Smoothed target.
    states, inputs : (n, K) and (n, M) arrays
        States of the target's chain, and inputs: what shapes the residual's spectrum.
    """

    D: Floats
    y: Floats
    states: Floats
    inputs: Floats


@dataclass(frozen=True, slots=True)
class InBand:
    """What inference is given, and how it came about.

    Attributes
    ----------
    gram : Gram
        Weighted statistics of the bins.
    span : (float, float)
        The band [Hz].
    bands : tuple of Band
        The bins of each piece.
    spectrum : tuple of (b,) array
        Variance of the residual in each of them.
    noise : mapping of int to float
        Noise variance of columns that are inputs themselves.
    """

    gram: Gram
    span: tuple[float, float]
    bands: tuple[Band, ...]
    spectrum: tuple[Floats, ...]
    noise: Mapping[int, float]


def _pilot(gram: Gram) -> Posterior:
    standard = gram.standardise(residual_scale(gram))
    prior = Prior()
    prior = replace(prior, slab_variance=learn_slab_variance(standard.gram, prior))
    best = [model for _, model in best_models(Problem.of(standard.gram, prior))]
    return spike_slab_vb(standard.gram, prior, models=best).rescaled(standard)


def gains_of(y: Floats, smoothing: ChainSmoothing) -> Floats:
    """Gain of the smoother at the frequencies of a piece's transform, (n//2 + 1,)."""
    assert smoothing.fs is not None
    return smoothing.gain(np.asarray(np.fft.rfftfreq(len(y), 1.0 / smoothing.fs), dtype=np.float64))


def _noise_shapes(
    pieces: Sequence[Piece], bands: Sequence[Band], smoothing: ChainSmoothing
) -> tuple[list[Floats], list[Floats]]:
    """Density of the residual that the noise of the chain's channels makes: G^2 |L|^2/J.

    L(i omega) is the equation linearised: the target on the states and inputs by least squares in the band. At a
    resonance of L the noise of the motion leaves nothing in the residual. Also the periodograms of what L leaves.
    """
    assert smoothing.fs is not None
    linear = []
    for piece, band in zip(pieces, bands, strict=True):
        both = np.column_stack([piece.states, piece.inputs])
        driven = range(piece.states.shape[1], both.shape[1])
        span = float(band.frequency[0]), float(band.frequency[-1])
        linear.append(to_band(both, piece.y, smoothing.fs, span, gains_of(piece.y, smoothing), driven).columns)
    whole = np.concatenate(linear)
    stacked = np.concatenate([whole.real, whole.imag])
    # columns in units of their own, whatever those of the channels
    size = np.linalg.norm(stacked[:, :-1], axis=0)
    size[size == 0] = 1.0
    coef = np.linalg.lstsq(stacked[:, :-1] / size, stacked[:, -1])[0] / size
    gains, order = smoothing.unit_gains, pieces[0].states.shape[1]
    shapes, left = [], []
    for band, columns in zip(bands, linear, strict=True):
        left.append(np.asarray(np.abs(columns[:, -1] - columns[:, :-1] @ coef) ** 2))
        s = 2j * np.pi * band.frequency
        response = gains[order] * s**order - sum(coef[1 + k] * gains[k] * s**k for k in range(order))
        shapes.append(band.gain**2 * np.abs(response) ** 2 / smoothing.information(band.frequency))
    return shapes, left


def _with_floor(bands: Sequence[Band], shapes: Sequence[Floats], periodograms: Sequence[Floats]) -> list[Floats]:
    """The shapes and white noise beneath: that of inputs, and all else that the chain's noise does not explain."""
    power = np.concatenate(periodograms)
    floor = added_floor(power, np.concatenate(shapes), np.concatenate([b.count for b in bands]))
    least = LEAST_FLOOR * float(power.mean())
    return [shape + max(floor, least) * band.gain**2 for shape, band in zip(shapes, bands, strict=True)]


def weighted_gram(
    pieces: Sequence[Piece],
    names: tuple[str, ...],
    smoothing: ChainSmoothing,
    span: tuple[float, float],
    inputs: Sequence[int] = (),
    noise: Mapping[int, float] | None = None,
) -> InBand | None:
    """Gram of smoothed records for one target.

    Parameters
    ----------
    pieces : sequence of Piece
        Uninterrupted pieces of the records.
    names : tuple of str
        The P columns.
    smoothing : ChainSmoothing
        Of the target's chain.
    span : (float, float)
        The band [Hz].
    inputs : sequence of int
        Columns to be filtered as the smoother filters the motion, see `bayeq.regression.filtered_terms.unsmoothed`.
    noise : mapping of int to float, optional
        Noise variance of columns that are inputs themselves.

    Returns
    -------
    InBand or None
        None where the band holds too few numbers.
    """
    fs = smoothing.fs
    assert fs is not None
    bands = [to_band(piece.D, piece.y, fs, span, gains_of(piece.y, smoothing), inputs) for piece in pieces]
    gram = band_gram(bands, names)
    if gram.dof < LEAST_NUMBERS:
        return None
    shapes, left = _noise_shapes(pieces, bands, smoothing)
    # weights that see next to a resonance from the first: there the damping of a light structure is, and nowhere else
    spectrum = _with_floor(bands, shapes, left)
    coef: Floats | None = None
    for _ in range(PILOTS):
        posterior = _pilot(band_gram(bands, names, spectrum, noise, coef))
        coef = posterior.coef
        left = [periodogram(band, coef, posterior.intercept) for band in bands]
        spectrum = residual_spectrum(bands, coef, posterior.intercept, _with_floor(bands, shapes, left))
    gram = band_gram(bands, names, spectrum, noise, coef)
    return InBand(gram, span, tuple(bands), tuple(spectrum), noise or {})


def regress_in_band(design: Design, k: int) -> InBand | None:
    """The band regression of one target, noise of the inputs read from their spectra.

    Parameters
    ----------
    design : Design
        Candidates on the training rows.
    k : int
        The chain whose target is meant.

    Returns
    -------
    InBand or None
        None where nothing was smoothed, records are not sampled uniformly, or the band holds too few numbers.

    Raises
    ------
    InputError
        The band that was asked for holds too few numbers.
    """
    motion = design.motion
    if not motion.smoothing or any(s.fs is None for s in motion.smoothing):
        return None
    chain, inputs = motion.roles.chains[k], motion.roles.inputs
    pieces = [
        Piece(
            design.columns(i),
            rows.columns[chain.target],
            np.column_stack([rows.columns[name] for name in chain.states]),
            np.column_stack([np.empty((rows.n, 0)), *(rows.columns[name] for name in inputs)]),
        )
        for i, rows in enumerate(motion.train)
    ]
    known = motion.sensors.noise
    floors = {
        j: known[name] ** 2 if name in known else noise_floor([rows.columns[name] for rows in motion.train])
        for j, name in enumerate(design.names)
        if name in inputs
    }
    noise = {j: floor for j, floor in floors.items() if floor is not None}
    filtered = unsmoothed(design.terms, motion.roles.chains)
    spans = [smoothing.band for smoothing in motion.smoothing]
    span = max(low for low, _ in spans), min(high for _, high in spans)
    if motion.band is None:
        return weighted_gram(pieces, design.names, motion.smoothing[k], span, filtered, noise)
    low, high = max(span[0], motion.band[0]), min(span[1], motion.band[1])
    found = None
    if low < high:
        found = weighted_gram(pieces, design.names, motion.smoothing[k], (low, high), filtered, noise)
    if found is None:
        raise InputError(
            f"the band {motion.band[0]:g} to {motion.band[1]:g} Hz holds too few lines of the spectra for a regression:"
            f" {chain.target} follows the motion between {span[0]:.3g} and {span[1]:.3g} Hz; widen the band, or leave"
            " it out"
        )
    return found


def without_noise(gram: Gram, noise: Mapping[int, float]) -> Gram:
    """The Gram of rows without the known noise variances of columns that are inputs themselves.

    It is in the residual all the same, times the square of the coefficient.
    """
    removed = np.zeros(len(gram.names))
    for j, variance in noise.items():
        removed[j] = min(gram.n * variance, MOST_NOISE * gram.DtD[j, j])
    if not removed.any():
        return gram
    less = replace(gram, DtD=gram.DtD - np.diag(removed))
    found = less
    for _ in range(PILOTS):
        coef = _pilot(found).coef
        found = replace(less, yty=gram.yty + float(coef**2 @ removed))
    return found


def thinned_gram(gram: Gram, residuals: Callable[[Posterior], Residuals]) -> Gram:
    """The Gram of as many rows as the residuals are worth: where they are correlated, N_eff rows instead of N.

    The likelihood is raised to the power N_eff/N, which widens intervals and asks more evidence of a term. Found in
    turn, since a model of fewer terms leaves residuals that are more correlated. What a rejected model leaves, one that
    explains less than half of the target, is the motion itself: no row is discounted by that.

    Parameters
    ----------
    gram : Gram
        Of all rows.
    residuals : callable
        Inspection of the residuals that a posterior leaves, in order of time.
    """
    share = 1.0
    for _ in range(PILOTS):
        model = _pilot(gram.raised(_least(gram, share)))
        if gram.squared_error(model.coef) > REJECTED * gram.yty:
            return gram
        found = residuals(model)
        share = found.n_eff / found.n if found.correlated else 1.0
        if share == 1.0:
            break
    return gram.raised(_least(gram, share))


def _least(gram: Gram, share: float) -> float:
    """The share, but at least as many rows as leave a regression."""
    return min(max(share, 3.0 / gram.n), 1.0)
