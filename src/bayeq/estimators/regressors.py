"""scikit-learn estimators of the engines.

Each estimator builds a `Gram`, standardises it (eq. (32)), runs its engine and transforms the answer back to the
units of D and y. The prior applies in the units of y, as in the paper. The fields of a class are its parameters, those
of its base first; the constructor stores them.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted, validate_data

from bayeq.adapters.arviz import to_arviz
from bayeq.arrays import Floats
from bayeq.equation.sensitivity import PriorSensitivity, prior_sensitivity
from bayeq.errors import DataWarning, InputError, some_of
from bayeq.estimators.base import SparseRegressor, SpikeSlabRegressor
from bayeq.inference.bma import sample_average, spike_slab_bma
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.gram import Gram, GramLike, LazyGram
from bayeq.inference.posterior import Draws, Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.stlsq import stlsq
from bayeq.inference.vb import spike_slab_vb


@dataclass(eq=False, repr=False)
class SpikeSlabVB(SpikeSlabRegressor):
    """Sparse linear regression by variational Bayes with spike-and-slab priors.

    Parameters
    ----------
    slab_variance : float
        v_s: slab variance of a coefficient of a standardised column, relative to the noise variance.
    prior_inclusion : float or (P,) array
        p_0; 1 forces a term in, 0 keeps it out.
    noise_shape, noise_rate : float
        a_sigma, b_sigma of the inverse-Gamma prior of the noise variance, in squared units of y.
    inclusion_beta : (a, b), optional
        Take p_0 as unknown, Beta(a, b): a beta-binomial prior of the number of terms. (1, P) suits large dictionaries.
    init : "search", "greedy", "rvm" or (P,) array
        Start of the ascent: several points, keeping the highest ELBO; the paper's RVM start; or given w.
    tol : float
        Stop when the ELBO rises by less.
    max_iter : int
        Limit on the sweeps.
    forgetting : float
        Share of its weight that a row keeps with each later row of `partial_fit`; 1 forgets nothing.

    Attributes
    ----------
    coef_ : (P,) array
        Posterior means given the selected terms, in the units of y per unit of D; 0 if not selected.
    intercept_ : float
    pip_ : (P,) array
        Posterior inclusion probabilities, the variational w.
    support_ : (P,) bool array
        `pip_` > 0.5.
    covariance_ : (r, r) array
        Posterior covariance of the selected coefficients.
    noise_variance_ : float
    elbo_ : float
        Evidence lower bound.
    elbo_trace_ : array of length `n_iter_`
        The ELBO after each sweep.
    n_iter_ : int
    n_effective_ : float
        Number of rows that the fit counts: the sum of their weights.
    posterior_ : Posterior
    posteriors_ : tuple of Posterior
        One per target. These are the shapes of one target; `fit` says what they are for several, which have no
        `posterior_`.

    References
    ----------
    R. Nayek, K. Worden, E. J. Cross, Equation Discovery Using an Efficient Variational Bayesian Approach with
    Spike-and-Slab Priors.

    R. Giordano, T. Broderick, M. I. Jordan (2018), Covariances, Robustness, and Variational Bayes, Journal of Machine
    Learning Research 19 (linear response).

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> D = rng.normal(size=(200, 5))
    >>> y = D @ [0, 2, 0, 0, -1] + 0.1 * rng.normal(size=200)
    >>> SpikeSlabVB().fit(D, y).support_.tolist()
    [False, True, False, False, True]
    """

    init: Literal["search", "greedy", "rvm"] | Floats = "search"
    tol: float = 1e-6
    max_iter: int = 1000
    forgetting: float = 1.0

    def _engine(self, gram: GramLike) -> Posterior:
        return spike_slab_vb(gram, self._prior(), init=self.init, tolerance=self.tol, max_iter=self.max_iter)

    def _keep(self, grams: tuple[Gram | LazyGram, ...]) -> None:
        super()._keep(grams)
        self.elbo_ = self._read("details.elbo")
        self.elbo_trace_ = self._read("details.elbo_trace", listed=True)


@dataclass(eq=False, repr=False)
class SpikeSlabGibbs(SpikeSlabRegressor):
    """Sparse linear regression by collapsed Gibbs sampling with spike-and-slab priors.

    Parameters
    ----------
    slab_variance, prior_inclusion, noise_shape, noise_rate, inclusion_beta : optional
        The prior, as in `SpikeSlabVB`.
    chains, samples, burn_in : int
        The paper's 4 chains of 5000 samples, the first 1000 left out.
    exchange : bool
        Let chains exchange one term for another in one step; False is the paper's sampler.
    random_state : int or sequence of int
        Seed.
    forgetting : float
        Share of its weight that a row keeps with each later row of `partial_fit`; 1 forgets nothing.

    Attributes
    ----------
    pip_ : (P,) array
        Rao-Blackwellised posterior inclusion probabilities.
    coef_, covariance_ : (P,) array, (r, r) array
        Mean and covariance in the median probability model, exact given the model.
    averaged_coef_, averaged_sd_ : (P,) array
        Mean and standard deviation over all samples.
    rhat_ : float
        Multivariate potential scale reduction factor of the coefficients (Brooks and Gelman 1998).
    draws_ : Draws
        Samples of z, theta (original units) and sigma^2.
    intercept_, support_, noise_variance_, n_iter_, n_effective_, posterior_, posteriors_
        As in `SpikeSlabVB`.
    """

    chains: int = 4
    samples: int = 5000
    burn_in: int = 1000
    exchange: bool = True
    random_state: int | Sequence[int] = 0
    forgetting: float = 1.0

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

    def _keep(self, grams: tuple[Gram | LazyGram, ...]) -> None:
        super()._keep(grams)
        self.averaged_coef_, self.averaged_sd_ = map(self._read, ("averaged.coef", "averaged.sd"))
        self.rhat_ = self._read("details.rhat")
        self.draws_ = self._read("draws", listed=True)

    def to_arviz(
        self,
        D: ArrayLike | None = None,
        y: ArrayLike | None = None,
        *,
        target: int | None = None,
        random_state: int | Sequence[int] = 0,
    ) -> Any:
        """The draws as ArviZ keeps them, for its summaries, plots and files.

        Parameters
        ----------
        D : (n, P) array or DataFrame, optional
            Rows at which y is drawn from the posterior predictive distribution: a number per chain, sample and row.
        y : (n,) array, optional
            Values observed at these rows.
        target : int, optional
            Which target, of a fit to several.
        random_state : int or sequence of int
            Seed of the draws of the intercept and of y.

        Returns
        -------
        InferenceData, or DataTree from ArviZ 1.0 on
            As `bayeq.adapters.arviz.to_arviz` says.

        Raises
        ------
        MissingExtraError
            ArviZ is not installed.
        """
        k = self._target(target)
        if D is not None:
            D = validate_data(self, D, dtype=np.float64, reset=False)
        return to_arviz(self.posteriors_[k], D=D, y=y, rng=np.random.default_rng(random_state))


@dataclass(eq=False, repr=False)
class SpikeSlabBMA(SpikeSlabRegressor):
    """Sparse linear regression by Bayesian model averaging with spike-and-slab priors: exact weights, no sampling.

    Parameters
    ----------
    slab_variance, prior_inclusion, noise_shape, noise_rate, inclusion_beta : optional
        The prior, as in `SpikeSlabVB`.
    signs : (P,) array of -1, 0 and +1, optional
        Known signs of the coefficients, 0 for unknown: given inclusion a coefficient of known sign is half normal.
    tolerance : float
        Posterior mass that the search over models may leave out.
    enumerate_up_to : int
        Number of free terms up to which all models are enumerated instead.
    forgetting : float
        Share of its weight that a row keeps with each later row of `partial_fit`; 1 forgets nothing.

    Attributes
    ----------
    pip_ : (P,) array
        Posterior inclusion probabilities over all models.
    coef_, covariance_ : (P,) array, (r, r) array
        Mean and covariance in the median probability model, exact given the model.
    averaged_coef_, averaged_sd_ : (P,) array
        Mean and standard deviation over all models, zeros included.
    average_ : ModelAverage
        The models with their probabilities, the mass left out and the covariance over all models.
    intercept_, support_, noise_variance_, n_iter_, n_effective_, posterior_, posteriors_
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

    signs: ArrayLike | None = None
    tolerance: float = 5e-3
    enumerate_up_to: int = 14
    forgetting: float = 1.0

    def _prior(self) -> Prior:
        return replace(super()._prior(), signs=self.signs)

    def _engine(self, gram: GramLike) -> Posterior:
        found = spike_slab_bma(gram, self._prior(), tolerance=self.tolerance, enumerate_up_to=self.enumerate_up_to)
        contradicted = found.details.contradicted
        if contradicted:
            warnings.warn(
                f"the data contradict the known sign of {some_of(contradicted, 30)} (odds above 100): check it,"
                " or drop it",
                DataWarning,
                stacklevel=5,
            )
        return found

    def _keep(self, grams: tuple[Gram | LazyGram, ...]) -> None:
        super()._keep(grams)
        self.averaged_coef_, self.averaged_sd_ = map(self._read, ("averaged.coef", "averaged.sd"))
        self.average_ = self._read("average", listed=True)
        # copies for `sample`: parameters may be set again, and arrays written to, before the next fit
        prior = self._prior()
        inclusion = np.array(prior.prior_inclusion, dtype=np.float64)
        signs = None if prior.signs is None else np.array(prior.signs)
        self._sampled = (grams, replace(prior, prior_inclusion=inclusion, signs=signs))

    def _draw(self, target: int, n: int, rng: np.random.Generator) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """theta (n, P), sigma^2 (n,) and the model (n,) of each draw."""
        grams, prior = self._sampled
        standard = grams[target].standardise()
        average = self.posteriors_[target].average
        assert average is not None
        theta, noise, which = sample_average(Problem.of(standard.gram, prior), average, n, rng, prior.limits)
        return theta / standard.scale, noise, which

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
            Coefficients, 0 for a term that is not in the draw's model, in original units; of shape (n, T, P) and (n, T)
            after a fit to y of shape (n, T).
        """
        check_is_fitted(self, "coef_")
        rng = np.random.default_rng(random_state)
        draws = [self._draw(k, n, rng)[:2] for k in range(len(self.posteriors_))]
        if not self._several:
            return draws[0]
        return np.stack([theta for theta, _ in draws], axis=1), np.stack([noise for _, noise in draws], axis=1)

    def sensitivity(
        self,
        slab_variances: ArrayLike | None = None,
        prior_inclusions: ArrayLike | None = None,
        *,
        target: int | None = None,
    ) -> PriorSensitivity:
        """Prior sensitivity of the PIPs: model averaging under other v_s and p_0, one at a time.

        Parameters
        ----------
        slab_variances, prior_inclusions : array-like, optional
            As in `Equation.sensitivity`.
        target : int, optional
            Which target, of a fit to several.
        """
        k = self._target(target)
        grams, prior = self._sampled
        gram = grams[k].standardise().gram
        return prior_sensitivity(gram, prior, slab_variances, prior_inclusions, tolerance=self.tolerance)

    def to_arviz(
        self,
        D: ArrayLike | None = None,
        y: ArrayLike | None = None,
        *,
        draws: int = 1000,
        target: int | None = None,
        random_state: int | Sequence[int] = 0,
    ) -> Any:
        """Independent draws as ArviZ keeps them, for its summaries, plots and files.

        Parameters
        ----------
        D : (n, P) array or DataFrame, optional
            Rows at which y is drawn from the posterior predictive distribution: a number per draw and row.
        y : (n,) array, optional
            Values observed at these rows.
        draws : int
            Number of draws, as one chain.
        target : int, optional
            Which target, of a fit to several.
        random_state : int or sequence of int
            Seed.

        Returns
        -------
        InferenceData, or DataTree from ArviZ 1.0 on
            As `bayeq.adapters.arviz.to_arviz` says; among the ``sample_stats`` also ``model``, the row of
            `average_.models` that a draw is from, and ``lp`` is the logarithm of its probability.

        Raises
        ------
        MissingExtraError
            ArviZ is not installed.
        """
        k = self._target(target)
        if D is not None:
            D = validate_data(self, D, dtype=np.float64, reset=False)
        rng = np.random.default_rng(random_state)
        theta, noise, which = self._draw(k, draws, rng)
        posterior = self.posteriors_[k]
        average = posterior.average
        assert average is not None
        chain = Draws(
            z=average.models[which][None],
            theta=theta[None],
            noise_variance=noise[None],
            log_posterior=np.log(average.probability[which])[None],
            pip=posterior.pip[None],
        )
        return to_arviz(posterior, chain, D=D, y=y, rng=rng, statistics={"model": which[None]})


@dataclass(eq=False, repr=False)
class STLSQ(SparseRegressor):
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
    forgetting : float
        Share of its weight that a row keeps with each later row of `partial_fit`; 1 forgets nothing.

    Attributes
    ----------
    pip_ : (P,) array
        1 for a term that is in, 0 for one that is out: there are no probabilities.
    coef_, intercept_, support_, covariance_, noise_variance_, n_iter_, n_effective_, posterior_, posteriors_
        As in `SpikeSlabVB`.

    References
    ----------
    S. L. Brunton, J. L. Proctor, J. N. Kutz, Discovering governing equations from data by sparse identification of
    nonlinear dynamical systems, PNAS 113 (2016).
    """

    threshold: float = 0.1
    ridge: float = 0.05
    standardise: bool = False
    fit_intercept: bool = True
    max_iter: int = 20
    forgetting: float = 1.0

    def _solve(self, gram: Gram | LazyGram) -> Posterior:
        if self.standardise and not self.fit_intercept:
            raise InputError("standardised columns are centred: they go with fit_intercept=True")
        return super()._solve(gram) if self.standardise else self._engine(gram)

    def _engine(self, gram: GramLike) -> Posterior:
        return stlsq(
            gram, threshold=self.threshold, ridge=self.ridge, centred=self.fit_intercept, max_iter=self.max_iter
        )


@dataclass(eq=False, repr=False)
class RVM(SparseRegressor):
    """Relevance vector machine: Student-t sparsity by automatic relevance determination.

    Parameters
    ----------
    max_iter : int
        Limit on the add, re-estimate and delete steps.
    forgetting : float
        Share of its weight that a row keeps with each later row of `partial_fit`; 1 forgets nothing.

    Attributes
    ----------
    pip_ : (P,) array
        gamma_i = 1 - alpha_i Sigma_ii, how well the data determine each weight: not a probability.
    coef_, intercept_, support_, covariance_, noise_variance_, n_iter_, n_effective_, posterior_, posteriors_
        As in `SpikeSlabVB`; every term left in the machine is in the support.

    References
    ----------
    M. E. Tipping, A. C. Faul, Fast marginal likelihood maximisation for sparse Bayesian models, AISTATS 2003.
    """

    max_iter: int = 10_000
    forgetting: float = 1.0

    def _engine(self, gram: GramLike) -> Posterior:
        return rvm(gram, max_iter=self.max_iter)
