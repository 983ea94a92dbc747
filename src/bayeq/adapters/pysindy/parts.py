"""Parts of a model of PySINDy: bayeq's inference as its optimizer, and its smoother as its differentiation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pysindy.differentiation.base import BaseDifferentiation
from pysindy.optimizers import BaseOptimizer

from bayeq.adapters.pysindy.series import LEAST_FLOOR, UNSEEN, UNSEEN_ROWS, pieces_of, row_gram, series_grams
from bayeq.arrays import Bools, Floats
from bayeq.errors import DataWarning, InputError, RecordError, UnknownNameError
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.engines import ENGINES, spike_slab_methods
from bayeq.inference.gram import Gram, checked_weights
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.smoother import ChainSeries, smooth_kinematic

# Engines with the spike-and-slab prior.
METHODS = spike_slab_methods()


@dataclass(eq=False, repr=False)
class SpikeSlabOptimizer(BaseOptimizer):  # type: ignore[misc]
    """Sparse regression with spike-and-slab priors, for ``pysindy.SINDy(optimizer=SpikeSlabOptimizer())``.

    There is no threshold, and no scale of the library matters. A column of ones is a candidate like the others; nothing
    is centred. Rows in order of time are treated as a time series, which allows for the error of a numerical derivative
    and for noise that is not white (docs/pysindy.md); subdomains of a weak form, rows in no order and rows with weights
    count as they are.

    Parameters
    ----------
    slab_variance : float, optional
        v_s: variance of a coefficient of a column of unit size, relative to the noise variance. By default the one that
        maximises the evidence of each target, at least 10.
    prior_inclusion : float or (P,) array
        p_0; 1 forces a term in, 0 keeps it out. Of columns that are multiples of one another the first counts (of the
        greatest p_0), for no data tell them apart; the others have probability 0.
    noise_shape, noise_rate : float
        a_sigma, b_sigma of the inverse-Gamma prior of the noise variance, in units of the least-squares residual.
    inclusion_beta : (a, b), optional
        Take p_0 as unknown, Beta(a, b).
    method : "auto", "vb", "bma" or "gibbs"
        Engine, as of `discover`.
    noise_floor : float or (K,) array, optional
        Least standard deviation, in units of the derivative, of the white noise of each target. By default it is
        estimated from differences for a time series; rows in no order, as those of a weak form, are assumed to have an
        error of 1 % of the target that averages out over no more than 10 rows; 0 leaves the latter out.
    random_state : int
        Seed of ``"gibbs"``.
    unbias : bool
        Must be False: coefficients are posterior means given the included terms, and a least-squares fit in their place
        would not belong to the covariance and the probabilities that are reported.
    copy_X : bool
        As in other optimizers; the library is never written to.
    normalize_columns : bool
        As in other optimizers; it has no effect, since columns are always scaled to unit size.
    verbose : bool
        Print a line about each target when it is fitted.

    Attributes
    ----------
    coef_ : (K, P) array
        Posterior means given the included terms; exactly 0 for the others.
    ind_ : (K, P) bool array
        Included terms, those whose probability exceeds 0.5.
    pip_ : (K, P) array
        Posterior inclusion probabilities.
    posteriors_ : tuple of Posterior
        One per target, in the units of library and target: `pip`, `sd`, `covariance`, `noise_variance` ...
    complexity : int
        Number of included terms of all targets.

    Raises
    ------
    InputError
        When fitting: ``unbias=True``, parameters out of range, weights or shapes that do not match.

    Warns
    -----
    DataWarning
        Targets without any included term.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> library = rng.normal(size=(200, 4))
    >>> target = library[:, [1]] * 2.0 + 0.1 * rng.normal(size=(200, 1))
    >>> SpikeSlabOptimizer().fit(library, target).ind_.tolist()
    [[False, True, False, False]]
    """

    slab_variance: float | None = None
    prior_inclusion: ArrayLike = 0.1
    noise_shape: float = 1e-4
    noise_rate: float = 1e-4
    inclusion_beta: tuple[float, float] | None = None
    method: str = "auto"
    noise_floor: ArrayLike | None = None
    random_state: int = 0
    unbias: bool = False
    copy_X: bool = True
    normalize_columns: bool = False
    verbose: bool = False

    def __post_init__(self) -> None:
        super().__init__(unbias=self.unbias, copy_X=self.copy_X, normalize_columns=self.normalize_columns)

    def set_params(self, **params: Any) -> Self:
        """Set parameters, as scikit-learn's estimators do."""
        super().set_params(**params)
        return self

    def fit(self, x_: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Fit to a library and the derivatives.

        Parameters
        ----------
        x_ : (n, P) array
            Library. Rows with NaN, in it or in `y`, are left out, and what follows them is another piece.
        y : (n,) or (n, K) array
            Derivatives.
        sample_weight : float or (n,) array, optional
            How often each row counts. Rows of different weights are not treated as a time series.
        """
        if self.unbias:
            raise InputError(
                "unbias must be False: coefficients are posterior means given the included terms, and least squares in"
                " their place would not belong to the covariance and the probabilities that are reported"
            )
        if self.method not in METHODS:
            raise UnknownNameError("method", self.method, METHODS)
        D, Y = _arrays(x_, y)
        given = np.asarray(1.0 if sample_weight is None else sample_weight, dtype=np.float64)
        weights = checked_weights(np.full(len(D), given) if given.ndim == 0 else given, len(D))
        even = bool((weights == 1.0).all())
        known = np.isfinite(D).all(axis=1) & np.isfinite(Y).all(axis=1)
        # earlier results are removed, even if this fit fails
        for name in [name for name in vars(self) if name.endswith("_") and not name.startswith("_")]:
            delattr(self, name)
        gaps = np.diff(np.cumsum(~known)[known], prepend=0) > 0
        D, Y, weights = D[known], Y[known], weights[known]
        if weights.sum() < 2:
            raise InputError(
                f"{weights.sum():g} usable rows: a fit needs at least 2 without NaN, or weights that sum to 2"
            )
        self.n_features_in_ = D.shape[1]
        self.Theta_ = D
        self._reduce(D, Y, weights, gaps if even else None)
        self.history_ = [self.coef_]
        empty = ", ".join(str(k) for k in np.flatnonzero(~self.ind_.any(axis=1)))
        if empty:
            warnings.warn(
                f"no term is included in the equation of target {empty}, counted from 0: smooth it"
                " (KinematicDerivative), or add terms",
                DataWarning,
                stacklevel=2,
            )
        # intercepts are columns of the library
        self.intercept_ = 0.0
        return self

    def _reduce(self, x: Floats, y: Floats, weights: Floats, gaps: Bools | None) -> None:
        """Set `posteriors_` and what follows from them; without gaps the rows are no time series."""
        size, target_size = _sizes(x), _sizes(y)
        Z, T = x / size, y / target_size
        given = 0.0 if self.noise_floor is None else self.noise_floor
        floors = _of_each("noise_floor", given, y.shape[1], "targets", "a standard deviation, 0 or more")
        floors = np.maximum(floors / target_size, LEAST_FLOOR)
        varying = [k for k in range(y.shape[1]) if np.any(y[:, k])]
        pieces = None if gaps is None else pieces_of(Z, gaps)
        unseen = LEAST_FLOOR
        if self.noise_floor is None:  # white noise with the weight of an error that unordered rows do not show
            unseen = UNSEEN * float(np.sqrt(max(float(weights.sum()) / UNSEEN_ROWS, 1.0)))
        grams = {k: row_gram(Z, T[:, k], weights, max(floors[k], unseen)) for k in range(y.shape[1])}
        if pieces is not None and varying:
            grams.update(zip(varying, series_grams(Z, T[:, varying], pieces, floors[varying]), strict=True))
        inclusion = self._inclusion(Z)
        posteriors = []
        for k, gram in sorted(grams.items()):
            original = gram.in_units(1.0 / size, 1.0 / target_size[k]).gram
            found = self._posterior(original, inclusion, size, target_size[k])
            # noise variance of the rows, not of the bins
            left = float(weights @ (y[:, k] - x @ found.coef) ** 2)
            noise = left / max(float(weights.sum()) - found.support.sum(), 1.0)
            posteriors.append(replace(found, noise_variance=noise))
        self.posteriors_ = tuple(posteriors)
        self.coef_ = np.array([p.coef for p in self.posteriors_])
        self.ind_ = np.array([p.support for p in self.posteriors_])
        self.pip_ = np.array([p.pip for p in self.posteriors_])
        if self.verbose:
            self._say("rows in no order" if pieces is None else f"time series of {len(pieces)} pieces")

    def _say(self, rows: str) -> None:
        """Print a line for each target, with the kind of rows."""
        for k, posterior in enumerate(self.posteriors_):
            nearest = np.abs(posterior.pip - 0.5).argmin()
            print(
                f"target {k}: {posterior.support.sum()} of {len(posterior.pip)} terms, noise"
                f" {np.sqrt(posterior.noise_variance):.3g}, least certain column {nearest}"
                f" (probability {posterior.pip[nearest]:.3f}); {rows}"
            )

    def _inclusion(self, Z: Floats) -> Floats:
        """p_0 of each column (P,); 0 for a column that is a multiple of another one."""
        inclusion = _of_each("prior_inclusion", self.prior_inclusion, Z.shape[1], "columns", "a probability").copy()
        order = np.argsort(-inclusion, kind="stable")
        # columns have unit size: the correlation of two that differ by rounding is 1 less half the square of that
        alike = np.abs(Z.T @ Z)[np.ix_(order, order)] / len(Z) > 1.0 - LEAST_FLOOR**2
        inclusion[order[np.tril(alike, -1).any(axis=1)]] = 0.0
        return inclusion

    def _posterior(self, gram: Gram, inclusion: Floats, size: Floats, target_size: float) -> Posterior:
        """The posterior of one target, as `discover` finds it for rows as measured."""
        unit = gram.in_units(size, target_size)
        scale = residual_scale(unit.gram)
        spread = np.sqrt(np.maximum(unit.gram.diagonal, 0.0) / gram.n)
        standard = gram.in_units(size * np.where(spread > 0, spread, 1.0), target_size * scale)
        prior = Prior(
            10.0 if self.slab_variance is None else self.slab_variance,
            inclusion,
            self.noise_shape,
            self.noise_rate,
            self.inclusion_beta,
        )
        prior.validate(len(gram.names))
        if self.slab_variance is None:
            prior = replace(prior, slab_variance=learn_slab_variance(standard.gram, prior))
        engine = ENGINES[self.method]
        options = {"seed": self.random_state} if engine.random else {}
        return engine.run(standard.gram, prior, **options).rescaled(standard)


def _of_each(name: str, given: ArrayLike, count: int, of: str, what: str) -> Floats:
    """Values (count,), from one for each or one for all; InputError if negative or not finite."""
    values = np.asarray(given, dtype=np.float64)
    if values.shape not in ((), (count,)) or not (np.isfinite(values) & (values >= 0)).all():
        raise InputError(f"{name} must be {what} and finite, or one of each of the {count} {of}, got {given!r}")
    return np.broadcast_to(values, count)


def _arrays(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    D, Y = np.array(x, dtype=np.float64), np.array(y, dtype=np.float64)
    Y = Y[:, None] if Y.ndim == 1 else Y
    if D.ndim != 2 or Y.ndim != 2 or len(D) != len(Y) or not D.shape[1] or not Y.shape[1]:
        raise InputError(f"need a library (n, P) and derivatives (n,) or (n, K), got {D.shape} and {np.shape(y)}")
    for name, values in (("the library", D), ("the derivatives", Y)):
        if np.isinf(values).any():
            raise InputError(f"{name}: infinite value in row {int(np.argmax(np.isinf(values).any(axis=1))) + 1}")
    return D, Y


def _sizes(values: Floats) -> Floats:
    """Root mean square of each column, 1 of a column of zeros."""
    most = np.abs(values).max(axis=0)
    most[most == 0] = 1.0
    found = np.sqrt(np.mean((values / most) ** 2, axis=0))
    return np.asarray(most * np.where(found > 0.0, found, 1.0))


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

        InputError for samples of more than two dimensions, times that do not increase, or a noise level that is not
        positive; RecordError for too few samples to tell noise from motion.
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
        levels = _of_each("noise_sd", self.noise_sd, coordinates, "coordinates", "a positive number")
        if not levels.all():
            raise InputError(f"noise_sd must be positive, got {self.noise_sd!r}")
        return levels
