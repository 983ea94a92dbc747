"""`KinematicDerivative`: bayeq's kinematic smoother as a differentiation method of PySINDy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pysindy.differentiation.base import BaseDifferentiation

from bayeq.arrays import Floats
from bayeq.errors import InputError, RecordError
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.model import ChainSeries
from bayeq.states.kinematic.smoother import smooth_kinematic

__all__ = ["KinematicDerivative"]


class KinematicDerivative(BaseDifferentiation):  # type: ignore[misc]
    """Derivative of noisy samples by the kinematic smoother, for ``pysindy.SINDy(differentiation_method=...)``.

    Each coordinate is an integrated Wiener process measured with white noise; the noise level, the roughness and the
    order are found from the samples by maximum likelihood and left-out samples (`bayeq.states.kinematic`). PySINDy then
    evaluates its library on the smoothed coordinates, `smoothed_x_`. Steps of time may be uneven, and NaN is a missing
    sample: `SINDy.fit` refuses it, but takes ``smoothed_x_``, and the derivative as ``x_dot``. The derivative of a
    coordinate that does not change is 0.

    Parameters
    ----------
    noise_sd : float or (K,) array, optional
        Standard deviation of the noise of each coordinate, in its unit, where it is known.

    Attributes
    ----------
    smoothed_x_ : (n, K) array
        Smoothed coordinates of the samples that were differentiated last.
    noise_sd_ : (K,) array
        Noise of each coordinate, found or given.

    Examples
    --------
    >>> t = np.arange(500) / 50
    >>> x = np.sin(t)[:, None] + 0.01 * np.random.default_rng(0).normal(size=(500, 1))
    >>> bool(np.std(KinematicDerivative()(x, t)[:, 0] - np.cos(t)) < 0.02)
    True
    """

    def __init__(self, noise_sd: ArrayLike | None = None) -> None:
        self.noise_sd = noise_sd

    def _differentiate(self, x: Any, t: ArrayLike = 1) -> Any:
        """Derivatives of samples (n,) or (n, K), in the shape of `x`; `t` is the step of time or the times (n,) [s].

        Raises
        ------
        InputError
            Samples of more than two dimensions, times that do not increase, or a noise level that is not positive.
        RecordError
            Samples from which noise cannot be told from motion, as there are too few.
        """
        samples = np.asarray(x, dtype=np.float64)
        if samples.ndim not in (1, 2):
            raise InputError(
                f"KinematicDerivative takes samples of shape (n,) or (n, K), got {samples.shape}; differentiate fields"
                " of a partial differential equation by another method, or use its weak form"
            )
        columns = samples[:, None] if samples.ndim == 1 else samples
        step = np.asarray(t, dtype=np.float64)
        times = np.arange(len(columns)) * step if step.ndim == 0 else step
        smoothed, rates = np.empty_like(columns), np.empty_like(columns)
        levels = self._levels(columns.shape[1])
        found = np.empty(columns.shape[1])
        for k, values in enumerate(columns.T):
            known = values[np.isfinite(values)]
            if len(known) and (known == known[0]).all():
                smoothed[:, k], rates[:, k], found[k] = known[0], 0.0, 0.0
                continue
            series = ChainSeries(times, (values, None))
            try:
                model = fit_kinematic([series], noise_sd=None if levels is None else (float(levels[k]), None))
            except InputError as error:
                raise RecordError(f"coordinate {k} cannot be differentiated: {error}") from error
            mean = smooth_kinematic(series, model).mean
            smoothed[:, k], rates[:, k] = mean[:, 0], mean[:, 1]
            found[k] = model.noise_sd[0]
        self.noise_sd_ = found
        # of the type that was given: PySINDy's arrays know their axes
        self.smoothed_x_, out = np.array(x, dtype=np.float64, subok=True), np.array(x, dtype=np.float64, subok=True)
        self.smoothed_x_[...], out[...] = smoothed.reshape(samples.shape), rates.reshape(samples.shape)
        return out

    def _levels(self, coordinates: int) -> Floats | None:
        if self.noise_sd is None:
            return None
        levels = np.asarray(self.noise_sd, dtype=np.float64)
        if levels.shape not in ((), (coordinates,)) or not (np.isfinite(levels) & (levels > 0)).all():
            raise InputError(
                f"noise_sd must be a positive number, or one of each of the {coordinates} coordinates, got"
                f" {self.noise_sd!r}"
            )
        return np.broadcast_to(levels, (coordinates,))
