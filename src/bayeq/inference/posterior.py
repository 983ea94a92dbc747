"""`Posterior`, which every engine returns, and intervals of coefficients over models."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError
from bayeq.inference.gram import GramLike, Standardised
from bayeq.kernels import kernel

# Present places of the fields of version 0.2; the former names are removed in 0.5.
MOVED = {
    **{name: f"details.{name}" for name in ("method", "n_iter", "converged", "slab_variance", "bounds")},
    **{name: f"details.{name}" for name in ("contradicted", "elbo", "elbo_trace", "optimum", "rhat")},
    "center": "constant.center",
    "target_mean": "constant.mean",
    "target_mean_variance": "constant.variance",
    "intercept_pip": "constant.pip",
    "left_out_intercept": "constant.left_out",
    "averaged_coef": "averaged.coef",
    "averaged_sd": "averaged.sd",
    "likelihood_coef": "projected.coef",
    "likelihood_sd": "projected.sd",
    "freedom": "projected.freedom",
    "error_share": "projected.error_share",
    "error_sd": "projected.error_sd",
}

# The squares (variances) of coefficients between these are floating-point numbers.
SMALLEST, LARGEST = 1e-150, 1e150


@dataclass(frozen=True, eq=False, slots=True)
class Draws:
    """Samples of the posterior by Markov chains, burn-in left out.

    Attributes
    ----------
    z : (chains, samples, P) bool array
        Indicators.
    theta : (chains, samples, P) array
        Coefficients, 0 where z is 0.
    noise_variance : (chains, samples) array
        sigma^2.
    log_posterior : (chains, samples) array
        ln p(y, z) of each sample's model, up to a constant.
    pip : (chains, P) array
        Rao-Blackwellised inclusion probabilities of each chain: means of p(z_i = 1 | z_-i, y).
    """

    z: Bools
    theta: Floats
    noise_variance: Floats
    log_posterior: Floats
    pip: Floats


@dataclass(frozen=True, eq=False, slots=True)
class ModelAverage:
    """The posterior over models.

    Attributes
    ----------
    models : (K, P) bool array
        Terms in each model, the likeliest model first.
    probability : (K,) array
        Posterior probabilities within the set; they sum to 1.
    left_out : float
        Estimate, erring upwards, of the posterior mass of all other models.
    terms : (Q,) int array
        Terms that are in at least one of the models (the likeliest thousand, if there are more).
    covariance : (Q, Q) array
        Posterior covariance of the coefficients of these terms over all models: that within models and that between.
    """

    models: Bools
    probability: Floats
    left_out: float
    terms: NDArray[np.intp]
    covariance: Floats

    def log_odds(self, model: Bools, others: Mapping[bytes, float]) -> list[float]:
        """Log posterior odds of other models against `model`.

        Parameters
        ----------
        model : (P,) bool array
            Terms in the model.
        others : mapping of bytes to float
            Other models, with log odds for use where `model` is not listed, and where the other model is not, up to
            those of the probability left out.
        """
        listed = {one.tobytes(): p for one, p in zip(self.models, self.probability.tolist(), strict=True)}
        own = math.log(listed.get(model.tobytes(), 0.0) or math.inf)
        if math.isinf(own):
            return list(others.values())
        most = math.log(self.left_out or math.inf) - own
        return [
            math.log(listed[key] or 1e-300) - own if key in listed else min(otherwise, most)
            for key, otherwise in others.items()
        ]

    def credible_groups(self, least: float = 0.05) -> list[tuple[tuple[int, ...], float]]:
        """Groups of terms that replace each other: undecided, and rarely in together.

        Two terms are linked if each has a PIP between `least` and 1 - `least` and they are in together less than half
        as often as if they were independent; a group is a connected set of linked terms.

        Returns
        -------
        list of (terms, probability)
            The members of each group and the probability that at least one of them is in.
        """
        pip = self.probability @ self.models
        undecided = np.flatnonzero((pip > least) & (pip < 1.0 - least))
        chosen = self.models[:, undecided]
        joint = (chosen * self.probability[:, None]).T @ chosen.astype(np.float64)
        apart = joint < 0.5 * np.outer(pip[undecided], pip[undecided])
        np.fill_diagonal(apart, False)
        groups: list[set[int]] = []
        for a, row in zip(undecided, apart, strict=True):
            linked = {int(b) for b in undecided[row]}
            if linked:
                touched = [g for g in groups if g & (linked | {int(a)})]
                merged = {int(a)}.union(linked, *touched)
                groups = [g for g in groups if g not in touched] + [merged]
        out = []
        for group in groups:
            members = sorted(group, key=lambda j: -pip[j])
            some = float(self.probability @ self.models[:, members].any(axis=1))
            out.append((tuple(members), some))
        return out


@dataclass(frozen=True, eq=False, slots=True)
class Averaged:
    """Coefficients averaged over all models, counted as 0 in a model without the term.

    Attributes
    ----------
    coef, sd : (P,) arrays
        Posterior means and standard deviations.
    draws : Draws or None
        Samples of models and coefficients, where they were kept.
    """

    coef: Floats
    sd: Floats
    draws: Draws | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Constant:
    """Quantities from which the intercept is computed.

    Attributes
    ----------
    center, mean : (P,) array, float
        Means of the columns and of the target.
    variance : float or None
        Variance of the target's mean, where it is not sigma^2/n.
    pip : float or None
        Probability that the intercept is not zero, where it was judged like a term.
    left_out : (float, float) or None
        Estimate and standard deviation of an intercept that is probably zero and therefore not in the model.
    """

    center: Floats
    mean: float = 0.0
    variance: float | None = None
    pip: float | None = None
    left_out: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Projected:
    """The likelihood's own coefficients, where the posterior projects the smoothed right-hand side on the terms.

    Attributes
    ----------
    coef, sd : (P,) arrays
        Coefficients and standard deviations by the likelihood, before the projection.
    freedom : (P,) array
        Degrees of freedom of the standard deviations by projection, infinite where these are known.
    error_share : float
        Root mean square of the model error (the part of the smoothed right-hand side that the terms do not explain),
        over the target's standard deviation.
    error_sd : float
        Root mean square of the model error, in the unit of the target.
    error_lines : tuple of float
        Frequencies [Hz] that divide the power of the model error into equal shares, in ascending order.
    """

    coef: Floats
    sd: Floats
    freedom: Floats
    error_share: float
    error_sd: float
    error_lines: tuple[float, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Details:
    """How an engine computed its posterior.

    Attributes
    ----------
    method : str
        The engine: "vb", "rvm" ...
    n_iter : int
        Sweeps or steps taken.
    converged : bool
        False if the engine stopped at its iteration limit.
    slab_variance : float or None
        v_s under which the posterior was computed.
    bounds : (P, 2) array or None
        Bounds at which intervals are cut, infinite for coefficients without bounds or of which only the sign is known.
    contradicted : tuple of str
        Terms whose known signs or bounds the data contradict.
    unsettled : tuple of str
        Terms whose probabilities are uncertain because the search over models stopped at its limit.
    elbo_trace : (n,) array
        Evidence lower bound of variational Bayes after each sweep.
    optimum : (P,) bool array or None
        Terms at the optimum of variational Bayes, where the support is another engine's.
    rhat : float or None
        Multivariate potential scale reduction factor of chains.
    """

    method: str
    n_iter: int = 0
    converged: bool = True
    slab_variance: float | None = None
    bounds: Floats | None = None
    contradicted: tuple[str, ...] = ()
    unsettled: tuple[str, ...] = ()
    elbo_trace: Floats = field(default_factory=lambda: np.empty(0))
    optimum: Bools | None = None
    rhat: float | None = None

    @property
    def elbo(self) -> float | None:
        """Evidence lower bound at the end of the ascent; None without variational Bayes."""
        return float(self.elbo_trace[-1]) if len(self.elbo_trace) else None


@dataclass(frozen=True, eq=False, slots=True)
class Posterior:
    """Posterior of a sparse linear regression, conditional on the selected terms.

    Attributes
    ----------
    names : tuple of str
        The P candidate terms.
    pip : (P,) array
        Posterior inclusion probability of each term as the engine states it (for the RVM: its gamma).
    support : (P,) bool array
        The selected terms, r of them.
    coef : (P,) array
        Posterior mean of the coefficients given the selected set, 0 for a term that is not selected.
    covariance : (r, r) array
        Posterior covariance of the selected coefficients.
    constant : Constant
        Quantities from which the intercept is computed.
    noise_variance : float
        Posterior estimate of sigma^2.
    n : float
        Rows that the posterior was computed from: an int, or the sum of their weights.
    details : Details
        How the engine computed it.
    averaged : Averaged or None
        The coefficients over all models, where models are averaged.
    average : ModelAverage or None
        The models that were averaged over, where they are listed.
    projected : Projected or None
        The likelihood's own coefficients, where `coef` and `covariance` are by projection.
    """

    names: tuple[str, ...]
    pip: Floats
    support: Bools
    coef: Floats
    covariance: Floats
    constant: Constant
    noise_variance: float
    n: float
    details: Details
    averaged: Averaged | None = None
    average: ModelAverage | None = None
    projected: Projected | None = None

    @property
    def draws(self) -> Draws | None:
        """Samples of models and coefficients; None if not kept."""
        return None if self.averaged is None else self.averaged.draws

    @property
    def error_lines(self) -> tuple[float, ...]:
        """`Projected.error_lines`; empty without a projection."""
        return () if self.projected is None else self.projected.error_lines

    @property
    def sd(self) -> Floats:
        """Posterior standard deviation of each coefficient given the selected set, (P,); 0 if not selected."""
        out = np.zeros(len(self.names))
        out[self.support] = np.sqrt(np.diagonal(self.covariance))
        return out

    @property
    def intercept(self) -> float:
        """b0 = mean(y) - mean(D) theta, under a flat prior."""
        return self.constant.mean - float(self.constant.center @ self.coef)

    @property
    def intercept_sd(self) -> float:
        """Standard deviation of the intercept, from the variances of the target's mean and of the coefficients.

        0 for an intercept that is not in the model.
        """
        known = self.constant
        if known.left_out is not None:
            return 0.0
        c = known.center[self.support]
        mean = self.noise_variance / self.n if known.variance is None else known.variance
        return float(np.sqrt(mean + c @ self.covariance @ c))

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A field of version 0.2 that has moved since, with a DeprecationWarning."""
            if name not in MOVED:
                raise AttributeError(f"'Posterior' object has no attribute {name!r}")
            part, place = MOVED[name].split(".")
            warnings.warn(f"posterior.{name} is posterior.{part}.{place} now", DeprecationWarning, stacklevel=2)
            return getattr(getattr(self, part), place, None)

    def rescaled(self, standard: Standardised) -> Posterior:
        """The posterior of a standardised regression in original units: theta_i = s_y theta_i^s / s_i.

        Parameters
        ----------
        standard : Standardised
            The Gram that this posterior comes from, and its scales.

        Raises
        ------
        InputError
            A coefficient that is too large or too small to square in the units of its column and of the target.
        """
        with np.errstate(over="ignore", under="ignore"):
            factor = standard.target_scale / standard.scale
            own = np.maximum(np.abs(self.coef), self.sd)
            size = own * factor
        far = np.flatnonzero((own > 0.0) & ~((size >= SMALLEST) & (size <= LARGEST)))
        if len(far):
            raise InputError(
                f"the coefficient of {self.names[far[0]]} is about {size[far[0]]:.0e}, too large or too small to"
                " square: give its column and the target in units in which they are about 1"
            )
        kept = factor[self.support]
        variance = standard.target_scale**2
        jacobian = standard.source.dof * float(np.log(standard.target_scale))
        details, averaged, draws, average = self.details, self.averaged, self.draws, self.average
        if draws is not None:
            draws = replace(draws, theta=draws.theta * factor, noise_variance=draws.noise_variance * variance)
        if averaged is not None:
            averaged = Averaged(averaged.coef * factor, averaged.sd * factor, draws)
        if average is not None:
            own = factor[average.terms]
            average = replace(average, covariance=average.covariance * np.outer(own, own))
        return replace(
            self,
            # the n of an engine is rounded, from the degrees of freedom
            n=standard.source.n,
            coef=self.coef * factor,
            covariance=self.covariance * kept[:, None] * kept,
            constant=replace(self.constant, center=standard.source.mean, mean=standard.source.target_mean),
            noise_variance=self.noise_variance * variance,
            details=replace(details, elbo_trace=details.elbo_trace - jacobian),
            averaged=averaged,
            average=average,
        )

    def predict(self, D: ArrayLike) -> Floats:
        """Predictive mean, eq. (29), at the rows of D (n*, P).

        Parameters
        ----------
        D : (n*, P) array
            Columns in original units.

        Returns
        -------
        (n*,) array
            Predictive means, in the unit of the target.
        """
        D = np.asarray(D, dtype=np.float64)
        kept = self.support
        return self.intercept + D[:, kept] @ self.coef[kept]

    def predictive_sd(self, D: ArrayLike) -> Floats:
        """Predictive standard deviation, eq. (30) with the intercept's uncertainty, at the rows of D (n*, P).

        Parameters
        ----------
        D : (n*, P) array
            Columns in original units.

        Returns
        -------
        (n*,) array
            Standard deviations, in the unit of the target.
        """
        kept = self.support
        Z = np.asarray(D, dtype=np.float64)[:, kept] - self.constant.center[kept]
        spread = np.einsum("ij,jk,ik->i", Z, self.covariance, Z)
        return np.sqrt(spread + self.noise_variance * (1.0 + 1.0 / self.n))


def of_standardised(
    gram: GramLike,
    pip: Floats,
    support: Bools,
    coef: Floats,
    covariance: Floats,
    noise_variance: float,
    details: Details,
    averaged: Averaged | None = None,
    average: ModelAverage | None = None,
) -> Posterior:
    """The posterior of a standardised regression: means are 0, and n = dof + 1, since the intercept took one row."""
    return Posterior(
        names=gram.names,
        pip=pip,
        support=support,
        coef=coef,
        covariance=covariance,
        constant=Constant(np.zeros(len(pip))),
        noise_variance=float(noise_variance),
        n=round(gram.dof) + 1,
        details=details,
        averaged=averaged,
        average=average,
    )


# Probability below a 95 % interval, and above it.
TAIL = 0.025

# Quantiles of a mixture are sought within this many standard deviations of its components: 1e-19 of each lies beyond.
REACH = 9.0


@kernel
def _quantiles(weight: Floats, mean: Floats, sd: Floats, probability: Floats) -> Floats:
    """Quantiles of mixtures of normals, a row (K,) each, by bisection; NaN for a `probability` not in (0, 1)."""
    out = np.full(len(probability), np.nan)
    for j in range(len(probability)):
        if not 0.0 < probability[j] < 1.0:
            continue
        low, high = np.inf, -np.inf
        for k in range(weight.shape[1]):
            if weight[j, k] > 0.0:
                low = min(low, mean[j, k] - REACH * sd[j, k])
                high = max(high, mean[j, k] + REACH * sd[j, k])
        while True:
            middle = 0.5 * low + 0.5 * high
            if not low < middle < high:
                break
            below = 0.0
            for k in range(weight.shape[1]):
                if weight[j, k] == 0.0:
                    continue
                away = middle - mean[j, k]
                if sd[j, k] > 0.0:
                    below += weight[j, k] * 0.5 * math.erfc(-away / sd[j, k] / math.sqrt(2.0))
                elif away >= 0.0:
                    below += weight[j, k]
            if below >= probability[j]:
                high = middle
            else:
                low = middle
        out[j] = high
    return out


@dataclass(frozen=True, eq=False, slots=True)
class Mixture:
    """The posterior of each of P coefficients over models: 0 if its term is out, else a mixture of K normals.

    Examples
    --------
    >>> one = Mixture(*np.array([[[0.5, 0.5]], [[1.0, 3.0]], [[0.1, 0.1]]]), pip=np.array([0.9]))
    >>> one.given_in().round(2), one.overall().round(2)
    (array([[0.84, 3.16]]), array([[0.  , 3.16]]))
    """

    weight: Floats  # (P, K), probability of each model given that the term is in; rows sum to 1
    mean: Floats  # (P, K), of the coefficient given the model
    sd: Floats  # (P, K), likewise; 0 for a point mass
    pip: Floats  # (P,), probability that the term is in

    def given_in(self) -> Floats:
        """95 % interval of each coefficient over the models that hold its term, (P, 2)."""
        tail = np.where(self.pip > 0.0, TAIL, np.nan)
        return np.nan_to_num(np.column_stack([self._quantiles(tail), self._quantiles(1.0 - tail)]))

    def overall(self) -> Floats:
        """95 % interval of each coefficient over all models, 0 in those without its term, (P, 2)."""
        return np.column_stack([self._with_zero(TAIL), self._with_zero(1.0 - TAIL)])

    def _with_zero(self, probability: float) -> Floats:
        """Quantiles of the mixture with the probability 1 - PIP of exactly 0."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            below = self._quantiles(probability / self.pip)
            above = self._quantiles((probability - (1.0 - self.pip)) / self.pip)
        return np.where(below < 0.0, below, np.where(above > 0.0, above, 0.0))

    def _quantiles(self, probability: Floats) -> Floats:
        return _quantiles(self.weight, self.mean, self.sd, probability)
