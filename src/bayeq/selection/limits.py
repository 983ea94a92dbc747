"""What a user may choose in place of the method: at most so many terms, none that explains less than so much."""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.gram import Gram, GramLike
from bayeq.inference import ENGINES, Prior
from bayeq.inference.collapsed.conditional import exact_posterior
from bayeq.inference.collapsed.path import best_of_each_size, partial_shares, path_sizes
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.tableau import swept
from bayeq.inference.posterior import Posterior

__all__ = ["Choice", "LeftOut", "given_terms"]

Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A term that the method includes and the equation does not.

    Attributes
    ----------
    name : str
        The term.
    pip : float
        Its posterior inclusion probability.
    share : float
        What R2 loses on the training rows when it is left out of the method's equation and the others are refitted.
    reason : str
        What left it out: ``"max_terms"``, ``"min_share"``, or ``"negligible"`` where it makes no practical difference
        (`bayeq.selection.negligible`).
    """

    name: str
    pip: float
    share: float
    reason: str


@dataclass(frozen=True, slots=True)
class Choice:
    """Limits of the equation that is shown; probabilities are not touched by them.

    Parameters
    ----------
    max_terms : int, optional
        If the method includes more terms, the likeliest model of at most so many takes the place of its model.
    min_share : float, optional
        Terms whose share of the target's variance is smaller are left out, the smallest first and the others refitted
        each time.
    """

    max_terms: int | None = None
    min_share: float | None = None

    @property
    def given(self) -> bool:
        """Whether there are any limits."""
        return self.max_terms is not None or self.min_share is not None

    def check(self, method: str) -> None:
        """Check the limits, and that the method's models can be compared.

        Raises
        ------
        InputError
            Values out of range, or a method without spike-and-slab prior.
        """
        if self.max_terms is not None:
            try:
                whole = operator.index(self.max_terms)
            except TypeError:
                raise InputError(f"max_terms must be a whole number of terms, got {self.max_terms!r}") from None
            if isinstance(self.max_terms, bool) or whole < 1:
                raise InputError(f"max_terms must be at least 1, got {self.max_terms!r}")
        if self.min_share is not None:
            number = isinstance(self.min_share, (int, float, np.number)) and not isinstance(self.min_share, bool)
            if not (number and 0 <= self.min_share < 1):
                raise InputError(f"min_share is a share of the variance, 0 <= min_share < 1, got {self.min_share!r}")
        if self.given and not ENGINES[method].spike_slab:
            known = ", ".join(name for name, engine in ENGINES.items() if engine.spike_slab)
            raise InputError(
                f"max_terms and min_share compare models by their posterior, which method {method!r} does not have;"
                f" take one of: {known}"
            )

    def apply(
        self, gram: GramLike, prior: Prior, rows: Gram, posterior: Posterior
    ) -> tuple[Posterior, tuple[LeftOut, ...]]:
        """The posterior given the model that keeps the limits, and the terms left out.

        Parameters
        ----------
        gram : GramLike
            What the posterior comes from, standardised.
        prior : Prior
            On standardised columns.
        rows : Gram
            Statistics of the training rows, which shares of variance are of.
        posterior : Posterior
            The method's, in units of `gram`.

        Raises
        ------
        InputError
            More terms are forced in than `max_terms`.
        """
        problem = Problem.of(gram, prior)
        active = posterior.support
        if self.max_terms is not None:
            path_sizes(problem, self.max_terms)  # refuses fewer than are forced in
            active = self._fewer(problem, active)
        few = active
        if self.min_share is not None:
            active = _without_small(rows, active, np.isposinf(problem.log_odds), self.min_share)
        out = np.flatnonzero(posterior.support & ~active)
        if not len(out) and bool((active == posterior.support).all()):
            return posterior, ()
        shares = partial_shares(rows, posterior.support)
        names = posterior.names
        left_out = tuple(
            LeftOut(names[j], float(posterior.pip[j]), float(shares[j]), "min_share" if few[j] else "max_terms")
            for j in out
        )
        return given_terms(gram, prior, posterior, active), left_out

    def _fewer(self, problem: Problem, active: Bools) -> Bools:
        """The likeliest model of at most `max_terms` terms, if `active` has more."""
        if self.max_terms is None or int(active.sum()) <= self.max_terms:
            return active
        return max(best_of_each_size(problem, self.max_terms, [active]), key=lambda found: found[1])[0]


def given_terms(gram: GramLike, prior: Prior, posterior: Posterior, active: Bools) -> Posterior:
    """The posterior given a model of other terms.

    Parameters
    ----------
    gram, prior
        What the posterior comes from.
    posterior : Posterior
        Probabilities and all else are left as they are.
    active : (P,) bool array
        The terms.
    """
    problem = Problem.of(gram, prior)
    coef, covariance = exact_posterior(problem, active)
    s = max(float(swept(problem, active).diagonal[-1]), problem.floor)
    noise = 0.5 * s / max(problem.h - 1.0, 0.5)
    return replace(posterior, support=active, coef=coef, covariance=covariance, noise_variance=noise)


def _without_small(rows: Gram, active: Bools, forced: Bools, least: float) -> Bools:
    """Terms left when those with a share below `least` have gone, one at a time; forced ones stay."""
    active = active.copy()
    while True:
        shares = np.where(forced, np.inf, partial_shares(rows, active))
        if not active.any() or not np.nanmin(shares) < least:
            return active
        active[np.nanargmin(shares)] = False
