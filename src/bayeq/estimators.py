"""scikit-learn faces of the engines.

Each estimator builds a `Gram`, standardises it (eq. (32)), runs its engine and transforms the answer back to the
units of D and y. The prior applies in the units of y, as in the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from bayeq.errors import InputError
from bayeq.gram import Gram, GramLike
from bayeq.inference.bma import sample_average, spike_slab_bma
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.prior import Prior
from bayeq.inference.problem import Problem
from bayeq.inference.rvm import rvm
from bayeq.inference.stlsq import stlsq
from bayeq.inference.vb import spike_slab_vb
from bayeq.posterior import Posterior

__all__ = ["RVM", "STLSQ", "SpikeSlabBMA", "SpikeSlabGibbs", "SpikeSlabVB"]

Floats = NDArray[np.float64]


class _SparseRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """What all estimators share: data in, engine, fitted attributes out."""

    posterior_: Posterior

    def _engine(self, gram: GramLike) -> Posterior:
        raise NotImplementedError

    def _solve(self, gram: Gram) -> Posterior:
        standard = gram.standardise()
        return standard.restore(self._engine(standard.gram))

    def _validated(self, D: Any, y: Any) -> tuple[Floats, Floats]:
        """The data as scikit-learn validates them; arrays of the right type and shape need less of it."""
        if (
            type(D) is type(y) is np.ndarray
            and D.dtype == y.dtype == np.float64
            and D.ndim == 2
            and y.ndim == 1
            and D.shape[1] > 0
            and len(D) == len(y) > 1
        ):
            self.n_features_in_ = D.shape[1]
            if hasattr(self, "feature_names_in_"):
                del self.feature_names_in_
            return D, y
        D, y = validate_data(self, D, y, dtype=np.float64, y_numeric=True, ensure_min_samples=2)
        return D, y

    def fit(self, D: ArrayLike, y: ArrayLike) -> Self:
        """Fit to a dictionary matrix D (n, P) and a target y (n,).

        Raises
        ------
        ValueError
            Shapes that do not match, non-finite values, or parameters out of range.
        """
        D, y = self._validated(D, y)
        try:
            gram = Gram.from_data(D, y, getattr(self, "feature_names_in_", None))
        except InputError:
            # values that are not finite, in scikit-learn's own words
            validate_data(self, D, y, dtype=np.float64, y_numeric=True)
            raise
        posterior = self._solve(gram)
        self.posterior_ = posterior
        self.coef_ = posterior.coef
        self.intercept_ = posterior.intercept
        self.pip_ = posterior.pip
        self.support_ = posterior.support
        self.covariance_ = posterior.covariance
        self.noise_variance_ = posterior.noise_variance
        self.n_iter_ = posterior.n_iter
        return self

    def predict(self, D: ArrayLike, return_std: bool = False) -> Any:
        """Predictive mean (29), and with `return_std` the predictive standard deviation (30), at rows of D."""
        check_is_fitted(self)
        D = validate_data(self, D, dtype=np.float64, reset=False)
        mean = self.posterior_.predict(D)
        return (mean, self.posterior_.predictive_sd(D)) if return_std else mean

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # a sparse prior rightly refuses dense test problems
        return tags


class _SpikeSlabRegressor(_SparseRegressor):
    """An estimator with the spike-and-slab prior among its parameters."""

    slab_variance: float
    prior_inclusion: ArrayLike
    noise_shape: float
    noise_rate: float

    def _prior(self) -> Prior:
        return Prior(self.slab_variance, self.prior_inclusion, self.noise_shape, self.noise_rate)


class SpikeSlabVB(_SpikeSlabRegressor):
    """Sparse linear regression by variational Bayes with spike-and-slab priors.

    Parameters
    ----------
    slab_variance : float
        v_s: slab variance of a coefficient of a standardised column, relative to the noise variance.
    prior_inclusion : float or (P,) array
        p_0; 1 forces a term in, 0 keeps it out.
    noise_shape, noise_rate : float
        a_sigma, b_sigma of the inverse-Gamma prior of the noise variance, in squared units of y.
    init : "search", "rvm" or (P,) array
        Start of the ascent: several points, keeping the highest ELBO; the paper's RVM start; or given w.
    tol : float
        Stop when the ELBO rises by less.
    max_iter : int
        Limit on the sweeps.

    Attributes
    ----------
    coef_ : (P,) array
        Posterior means given the selected terms, in the units of y per unit of D; 0 if not selected.
    intercept_ : float
    pip_ : (P,) array
        Posterior inclusion probabilities, the variational w.
    support_ : (P,) bool array
        pip_ > 0.5.
    covariance_ : (r, r) array
        Posterior covariance of the selected coefficients.
    noise_variance_ : float
    elbo_ : float
        Evidence lower bound.
    elbo_trace_ : (n_iter_,) array
    n_iter_ : int
    posterior_ : Posterior

    References
    ----------
    R. Nayek, K. Worden, E. J. Cross, Equation Discovery Using an Efficient Variational Bayesian Approach with
    Spike-and-Slab Priors.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> D = rng.normal(size=(200, 5))
    >>> y = D @ [0, 2, 0, 0, -1] + 0.1 * rng.normal(size=200)
    >>> SpikeSlabVB().fit(D, y).support_.tolist()
    [False, True, False, False, True]
    """

    def __init__(
        self,
        slab_variance: float = 10.0,
        prior_inclusion: ArrayLike = 0.1,
        noise_shape: float = 1e-4,
        noise_rate: float = 1e-4,
        init: Literal["search", "rvm"] | Floats = "search",
        tol: float = 1e-6,
        max_iter: int = 1000,
    ) -> None:
        self.slab_variance = slab_variance
        self.prior_inclusion = prior_inclusion
        self.noise_shape = noise_shape
        self.noise_rate = noise_rate
        self.init = init
        self.tol = tol
        self.max_iter = max_iter

    def _engine(self, gram: GramLike) -> Posterior:
        return spike_slab_vb(gram, self._prior(), init=self.init, tolerance=self.tol, max_iter=self.max_iter)

    def fit(self, D: ArrayLike, y: ArrayLike) -> Self:
        super().fit(D, y)
        self.elbo_ = self.posterior_.elbo
        self.elbo_trace_ = self.posterior_.elbo_trace
        return self

    fit.__doc__ = _SparseRegressor.fit.__doc__


class SpikeSlabGibbs(_SpikeSlabRegressor):
    """Sparse linear regression by collapsed Gibbs sampling with spike-and-slab priors.

    Parameters
    ----------
    slab_variance, prior_inclusion, noise_shape, noise_rate
        The prior, as in `SpikeSlabVB`.
    chains, samples, burn_in : int
        The paper's 4 chains of 5000 samples, the first 1000 left out.
    exchange : bool
        Let chains exchange one term for another in one step; False is the paper's sampler.
    random_state : int or sequence of int
        Seed.

    Attributes
    ----------
    pip_ : (P,) array
        Rao-Blackwellised posterior inclusion probabilities.
    coef_, covariance_ : (P,) array, (r, r) array
        Of the median probability model, exact given the model.
    averaged_coef_, averaged_sd_ : (P,) array
        Over all samples.
    rhat_ : float
        Multivariate potential scale reduction factor of the coefficients (Brooks and Gelman 1998).
    draws_ : Draws
        Samples of z, theta (original units) and sigma^2.
    intercept_, support_, noise_variance_, n_iter_, posterior_
        As in `SpikeSlabVB`.
    """

    def __init__(
        self,
        slab_variance: float = 10.0,
        prior_inclusion: ArrayLike = 0.1,
        noise_shape: float = 1e-4,
        noise_rate: float = 1e-4,
        chains: int = 4,
        samples: int = 5000,
        burn_in: int = 1000,
        exchange: bool = True,
        random_state: int | Sequence[int] = 0,
    ) -> None:
        self.slab_variance = slab_variance
        self.prior_inclusion = prior_inclusion
        self.noise_shape = noise_shape
        self.noise_rate = noise_rate
        self.chains = chains
        self.samples = samples
        self.burn_in = burn_in
        self.exchange = exchange
        self.random_state = random_state

    def _engine(self, gram: GramLike) -> Posterior:
        return spike_slab_gibbs(
            gram,
            self._prior(),
            chains=self.chains,
            samples=self.samples,
            burn_in=self.burn_in,
            exchange=self.exchange,
            seed=self.random_state,
        )

    def fit(self, D: ArrayLike, y: ArrayLike) -> Self:
        super().fit(D, y)
        self.averaged_coef_ = self.posterior_.averaged_coef
        self.averaged_sd_ = self.posterior_.averaged_sd
        self.rhat_ = self.posterior_.rhat
        self.draws_ = self.posterior_.draws
        return self

    fit.__doc__ = _SparseRegressor.fit.__doc__


class SpikeSlabBMA(_SpikeSlabRegressor):
    """Sparse linear regression by Bayesian model averaging with spike-and-slab priors: exact weights, no sampling.

    Parameters
    ----------
    slab_variance, prior_inclusion, noise_shape, noise_rate
        The prior, as in `SpikeSlabVB`.
    tolerance : float
        Posterior mass that the search over models may leave out.
    enumerate_up_to : int
        Number of free terms up to which all models are enumerated instead.

    Attributes
    ----------
    pip_ : (P,) array
        Posterior inclusion probabilities over all models.
    coef_, covariance_ : (P,) array, (r, r) array
        Of the median probability model, exact given the model.
    averaged_coef_, averaged_sd_ : (P,) array
        Over all models, zeros included.
    average_ : ModelAverage
        The models with their probabilities, the mass left out and the covariance over all models.
    intercept_, support_, noise_variance_, n_iter_, posterior_
        As in `SpikeSlabVB`.

    References
    ----------
    D. Madigan, A. E. Raftery, Model selection and accounting for model uncertainty in graphical models using Occam's
    window, JASA 89 (1994).

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> x = rng.normal(size=200)
    >>> D = np.column_stack([x, x + 0.02 * rng.normal(size=200)])
    >>> fit = SpikeSlabBMA().fit(D, x + rng.normal(size=200))
    >>> [members for members, probability in fit.average_.credible_groups()]
    [(0, 1)]
    """

    def __init__(
        self,
        slab_variance: float = 10.0,
        prior_inclusion: ArrayLike = 0.1,
        noise_shape: float = 1e-4,
        noise_rate: float = 1e-4,
        tolerance: float = 5e-3,
        enumerate_up_to: int = 14,
    ) -> None:
        self.slab_variance = slab_variance
        self.prior_inclusion = prior_inclusion
        self.noise_shape = noise_shape
        self.noise_rate = noise_rate
        self.tolerance = tolerance
        self.enumerate_up_to = enumerate_up_to

    def _solve(self, gram: Gram) -> Posterior:
        self._standard = gram.standardise()
        return self._standard.restore(self._engine(self._standard.gram))

    def _engine(self, gram: GramLike) -> Posterior:
        return spike_slab_bma(gram, self._prior(), tolerance=self.tolerance, enumerate_up_to=self.enumerate_up_to)

    def fit(self, D: ArrayLike, y: ArrayLike) -> Self:
        super().fit(D, y)
        self.averaged_coef_ = self.posterior_.averaged_coef
        self.averaged_sd_ = self.posterior_.averaged_sd
        self.average_ = self.posterior_.average
        return self

    fit.__doc__ = _SparseRegressor.fit.__doc__

    def sample(self, n: int = 1000, random_state: int | Sequence[int] = 0) -> tuple[Floats, Floats]:
        """Independent draws from the exact mixture over models.

        Parameters
        ----------
        n : int
            Number of draws.
        random_state : int or sequence of int
            Seed.

        Returns
        -------
        theta, noise_variance : (n, P) array, (n,) array
            Coefficients, 0 for a term that is not in the draw's model, in original units.
        """
        check_is_fitted(self)
        problem = Problem.of(self._standard.gram, self._prior())
        rng = np.random.default_rng(random_state)
        average = self.posterior_.average
        assert average is not None
        theta, noise, _ = sample_average(problem, average, n, rng)
        return theta / self._standard.scale, noise


class STLSQ(_SparseRegressor):
    """Sequentially thresholded least squares (SINDy).

    Parameters
    ----------
    threshold : float
        Terms with a smaller coefficient are dropped.
    ridge : float
        Added to the diagonal of D'D.
    standardise : bool
        Compare the threshold with coefficients of standardised columns instead of raw ones.
    fit_intercept : bool
        Estimate an intercept; False regresses on the raw columns about zero, as PySINDy does.
    max_iter : int
        Limit on the regressions.

    Attributes
    ----------
    pip_ : (P,) array
        1 for a term that is in, 0 for one that is out: there are no probabilities.
    coef_, intercept_, support_, covariance_, noise_variance_, n_iter_, posterior_
        As in `SpikeSlabVB`.

    References
    ----------
    S. L. Brunton, J. L. Proctor, J. N. Kutz, Discovering governing equations from data by sparse identification of
    nonlinear dynamical systems, PNAS 113 (2016).
    """

    def __init__(
        self,
        threshold: float = 0.1,
        ridge: float = 0.05,
        standardise: bool = False,
        fit_intercept: bool = True,
        max_iter: int = 20,
    ) -> None:
        self.threshold = threshold
        self.ridge = ridge
        self.standardise = standardise
        self.fit_intercept = fit_intercept
        self.max_iter = max_iter

    def _solve(self, gram: Gram) -> Posterior:
        if self.standardise and not self.fit_intercept:
            raise InputError("standardised columns are centred: they go with fit_intercept=True")
        return super()._solve(gram) if self.standardise else self._engine(gram)

    def _engine(self, gram: GramLike) -> Posterior:
        return stlsq(
            gram, threshold=self.threshold, ridge=self.ridge, centred=self.fit_intercept, max_iter=self.max_iter
        )


class RVM(_SparseRegressor):
    """Relevance vector machine: Student-t sparsity by automatic relevance determination.

    Parameters
    ----------
    max_iter : int
        Limit on the add, re-estimate and delete steps.

    Attributes
    ----------
    pip_ : (P,) array
        gamma_i = 1 - alpha_i Sigma_ii, how well the data determine each weight: not a probability.
    coef_, intercept_, support_, covariance_, noise_variance_, n_iter_, posterior_
        As in `SpikeSlabVB`; every term left in the machine is in the support.

    References
    ----------
    M. E. Tipping, A. C. Faul, Fast marginal likelihood maximisation for sparse Bayesian models, AISTATS 2003.
    """

    def __init__(self, max_iter: int = 10_000) -> None:
        self.max_iter = max_iter

    def _engine(self, gram: GramLike) -> Posterior:
        return rvm(gram, max_iter=self.max_iter)
