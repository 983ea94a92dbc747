"""The Gram of smoothed records: in the band that the smoother follows, weighted by the spectrum of the residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.diagnostics import Residuals
from bayeq.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.inference.slab import learn_slab_variance, residual_scale
from bayeq.inference.vb import spike_slab_vb
from bayeq.posterior import Posterior
from bayeq.spectral import band_gram, residual_spectrum, to_band
from bayeq.states import ChainSmoothing

__all__ = ["InBand", "thinned_gram", "weighted_gram"]

Floats = NDArray[np.float64]

# Fits that find the spectrum of the residuals and the coefficients of the inputs.
PILOTS = 3

# Real numbers in the band that a candidate term needs.
LEAST_PER_TERM = 2.0


@dataclass(frozen=True, slots=True)
class InBand:
    """What inference is given, and how it came about.

    Attributes
    ----------
    gram : Gram
        Weighted statistics of the bins.
    limit : float
        Upper end of the band [Hz].
    """

    gram: Gram
    limit: float


def _pilot(gram: Gram) -> Posterior:
    standard = gram.standardise(residual_scale(gram))
    prior = Prior()
    prior = replace(prior, slab_variance=learn_slab_variance(standard.gram, prior))
    return standard.restore(spike_slab_vb(standard.gram, prior))


def weighted_gram(
    rows: Sequence[tuple[Floats, Floats]],
    names: tuple[str, ...],
    smoothing: ChainSmoothing,
    limit: float,
    inputs: Sequence[int] = (),
    noise: Mapping[int, float] | None = None,
) -> InBand | None:
    """Gram of smoothed records for one target.

    Parameters
    ----------
    rows : sequence of (D, y)
        Dictionary (n, P) on smoothed states and smoothed target (n,) of each uninterrupted piece.
    names : tuple of str
        The P columns.
    smoothing : ChainSmoothing
        Of the target's chain.
    limit : float
        Upper end of the band [Hz].
    inputs : sequence of int
        Columns that involve measured inputs: they are filtered as the smoother filters the motion.
    noise : mapping of int to float, optional
        Noise variance of columns that are inputs themselves.

    Returns
    -------
    InBand or None
        None where the band holds too few numbers for so many terms.
    """
    fs = smoothing.fs
    assert fs is not None
    bands = [
        to_band(
            D, y, fs, limit, smoothing.gain(np.asarray(np.fft.rfftfreq(len(y), 1.0 / fs), dtype=np.float64)), inputs
        )
        for D, y in rows
    ]
    gram = band_gram(bands, names)
    if gram.dof < LEAST_PER_TERM * len(names):
        return None
    spectrum: list[Floats] | None = None
    coef: Floats | None = None
    for _ in range(PILOTS):
        posterior = _pilot(band_gram(bands, names, spectrum, noise, coef))
        coef = posterior.coef
        spectrum = residual_spectrum(bands, coef, posterior.intercept)
    return InBand(band_gram(bands, names, spectrum, noise, coef), limit)


def thinned_gram(gram: Gram, residuals: Callable[[Posterior], Residuals]) -> Gram:
    """The Gram of as many rows as the residuals are worth: where they are correlated, N_eff rows instead of N.

    The likelihood is raised to the power N_eff/N, which widens intervals and asks more evidence of a term. Found in
    turn, since a model of fewer terms leaves residuals that are more correlated.

    Parameters
    ----------
    gram : Gram
        Of all rows.
    residuals : callable
        Inspection of the residuals that a posterior leaves, in order of time.
    """
    share = 1.0
    for _ in range(PILOTS):
        found = residuals(_pilot(_power(gram, share)))
        share = found.n_eff / found.n if found.correlated else 1.0
        if share == 1.0:
            break
    return _power(gram, share)


def _power(gram: Gram, share: float) -> Gram:
    if share >= 1.0:
        return gram
    # at least as many rows as leave a regression
    share = max(share, 3.0 / gram.n)
    return replace(
        gram,
        n=gram.n * share,
        DtD=gram.DtD * share,
        Dty=gram.Dty * share,
        yty=gram.yty * share,
        dof=gram.n * share - 1.0,
    )
