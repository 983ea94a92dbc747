"""Base classes of the scikit-learn estimators: validation of data, Gram matrices, fitted attributes."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from numbers import Real
from operator import attrgetter
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.metadata_routing import UNUSED
from sklearn.utils.validation import check_is_fitted, validate_data

from bayeq.arrays import Floats
from bayeq.errors import DataWarning, InputError
from bayeq.inference.gram import Gram, GramLike, LazyGram, checked_weights, grams_from_data, grams_of
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior


class _SeveralTargetsError(InputError, AttributeError):
    """An attribute that a fit to several targets does not have: also an AttributeError, as `hasattr` expects."""


class SparseRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A sparse linear regression: a subclass names its parameters and its engine."""

    posteriors_: tuple[Posterior, ...]
    forgetting: float

    # scikit-learn looks for data under the name X and would take D for metadata to be routed
    __metadata_request__fit: ClassVar[dict[str, str]] = {"D": UNUSED}
    __metadata_request__partial_fit: ClassVar[dict[str, str]] = {"D": UNUSED}
    __metadata_request__predict: ClassVar[dict[str, str]] = {"D": UNUSED}

    def _engine(self, gram: GramLike) -> Posterior:
        raise NotImplementedError

    def _solve(self, gram: Gram | LazyGram) -> Posterior:
        standard = gram.standardise()
        return self._engine(standard.gram).rescaled(standard)

    def _validated(self, D: Any, y: Any, sample_weight: Any) -> tuple[Floats, Floats]:
        """The data, validated by scikit-learn; arrays of the right type and shape need fewer checks."""
        if (
            type(D) is type(y) is np.ndarray
            and D.dtype == y.dtype == np.float64
            and D.ndim == 2
            and y.ndim == 1
            and D.shape[1] > 0
            and len(D) == len(y) > 1
            and sample_weight is None
        ):
            self.n_features_in_ = D.shape[1]
            if hasattr(self, "feature_names_in_"):
                del self.feature_names_in_
            return D, y
        return self._validated_thoroughly(D, y)

    def _validated_thoroughly(self, D: Any, y: Any, reset: bool = True, rows: int = 2) -> tuple[Floats, Floats]:
        D, y = validate_data(
            self, D, y, dtype=np.float64, multi_output=True, y_numeric=True, reset=reset, ensure_min_samples=rows
        )
        # scikit-learn lets sparse targets pass
        return D, np.asarray(y.toarray() if hasattr(y, "toarray") else y, dtype=np.float64)

    def fit(self, D: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Fit to a dictionary matrix and one target, or several that share it.

        All rows count alike, whatever their order: `forgetting` is for `partial_fit`.

        Parameters
        ----------
        D : (n, P) array or DataFrame
            Dictionary matrix.
        y : (n,) or (n, T) array
            Target, or targets: each is a regression of its own on the same D'D. With y of shape (n, T), T = 1
            included, `coef_`, `intercept_` and other numbers have a leading axis of length T, and what differs in size
            or kind from target to target (`covariance_` ...) is a list of length T.
        sample_weight : (n,) array, optional
            How often each row counts: k is the row k times over, 0 leaves it out. Noise variances that are known up to
            a factor are stated by weights proportional to 1/variance that sum to the number of rows; `noise_variance_`
            and the predictive standard deviation are then those of a row of weight 1.

        Raises
        ------
        ValueError
            Shapes that do not match, non-finite values, weights that are negative, not finite or sum to less than 2
            rows, or parameters out of range.
        """
        D, y = self._validated(D, y, sample_weight)
        several = y.ndim == 2
        try:
            grams = grams_of(D, y if several else y[:, None], getattr(self, "feature_names_in_", None), sample_weight)
        except InputError:
            # scikit-learn's own error for values that are not finite
            self._validated_thoroughly(D, y)
            raise
        if grams[0].n < 2:
            raise InputError(
                f"sample_weight sums to {grams[0].n:g}: weights count rows, and a fit needs at least 2; scale them to "
                "sum to the number of rows"
            )
        return self._fitted(grams, several)

    def _fitted(self, grams: tuple[Gram | LazyGram, ...], several: bool) -> Self:
        """Set the attributes of a fit."""
        self.posteriors_ = tuple([self._solve(gram) for gram in grams])
        self._several = several
        self._keep(grams)
        self.n_effective_ = float(grams[0].n)
        # Grams that `partial_fit` adds to; a lazy one holds the data themselves, which are not kept
        self._sums = tuple([gram for gram in grams if isinstance(gram, Gram)])
        return self

    def partial_fit(self, D: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Fit to these rows and those of earlier calls, of which only the Gram matrix is kept.

        Rows are in the order of time. A row that is k rows older than the last one counts ``forgetting**k`` times, in
        whatever blocks the rows come, so that the fit is that of `fit` with these weights. With ``forgetting=1`` it is
        that of `fit` on all rows. The count of rows, `n_effective_`, is the sum of the weights: it tends to
        ``1 / (1 - forgetting)``, which is also the mean age of what the coefficients are an average of.

        Parameters
        ----------
        D : (n, P) array or DataFrame
            The next rows of the dictionary matrix, one or more.
        y : (n,) or (n, T) array
            Target, or targets, as many as in the first call.
        sample_weight : (n,) array, optional
            Further weight of each row, as in `fit`. A row of weight 0 is left out; time passes all the same.

        Raises
        ------
        ValueError
            As `fit`; `forgetting` out of range, other columns or targets than before, or fewer than 2 rows in all.
        """
        first = not hasattr(self, "coef_")
        D, y = self._validated_thoroughly(D, y, reset=first, rows=1)
        kept: Any = self.forgetting
        if not (isinstance(kept, Real) and 0.0 < float(kept) <= 1.0):
            raise InputError(f"forgetting is the share of its weight that a row keeps, 0 < forgetting <= 1: {kept!r}")
        weights = np.power(float(kept), np.arange(len(D) - 1, -1, -1, dtype=np.float64))
        if sample_weight is not None:
            weights = weights * checked_weights(sample_weight, len(D))
        several = y.ndim == 2
        if not (first or self._sums):
            raise InputError(
                "partial_fit: this was fitted to fewer rows than columns, whose D'D is not kept; begin with partial_fit"
                " on an estimator that is not fitted"
            )
        names = getattr(self, "feature_names_in_", None) if first else self._sums[0].names
        grams = grams_from_data(D, y if several else y[:, None], names, weights)
        if not first:
            now, before = y.shape[1:], self.coef_.shape[:-1]
            if now != before:
                shapes = [f"(n, {shape[0]})" if shape else "(n,)" for shape in (now, before)]
                raise InputError(f"partial_fit: y has shape {shapes[0]}, that of the rows before was {shapes[1]}")
            left = self.forgetting ** len(D)
            grams = tuple([old.raised(left) + new for old, new in zip(self._sums, grams, strict=True)])
        if grams[0].n < 2:
            raise InputError(
                f"partial_fit: the rows so far count {grams[0].n:g} times, and a fit needs at least 2; give more rows"
                " at a time, or a forgetting closer to 1"
            )
        return self._fitted(grams, several)

    def _read(self, field: str, listed: bool = False) -> Any:
        """A field of the posterior, as ``details.n_iter``; for several targets stacked, or as a list if `listed`."""
        values = list(map(attrgetter(field), self.posteriors_))
        return values[0] if not self._several else values if listed else np.array(values)

    def _keep(self, grams: tuple[Gram | LazyGram, ...]) -> None:
        """Set the fitted attributes; a subclass adds its own."""
        del grams
        self.coef_, self.intercept_, self.pip_ = map(self._read, ("coef", "intercept", "pip"))
        self.support_, self.noise_variance_ = map(self._read, ("support", "noise_variance"))
        self.covariance_ = self._read("covariance", listed=True)
        self.n_iter_ = max([posterior.details.n_iter for posterior in self.posteriors_])

    @property
    def posterior_(self) -> Posterior:
        """The posterior of a fit to one target.

        Raises
        ------
        InputError
            Several targets: `posteriors_` holds one of each.
        """
        check_is_fitted(self, "coef_")
        if len(self.posteriors_) > 1:
            raise _SeveralTargetsError(
                f"posterior_ is that of a fit to one target, and this one has {len(self.posteriors_)}: take one of "
                "posteriors_"
            )
        return self.posteriors_[0]

    def predict(self, D: ArrayLike, return_std: bool = False) -> Any:
        """Predictive mean (29), and with `return_std` the predictive standard deviation (30), at rows of D.

        Parameters
        ----------
        D : (n, P) array or DataFrame
            The columns that the estimator was fitted to.
        return_std : bool
            Also return the standard deviation.

        Returns
        -------
        (n,) or (n, T) array, or a pair of them
            Shape as that of the fitted y.
        """
        check_is_fitted(self, "coef_")
        D = validate_data(self, D, dtype=np.float64, reset=False)
        mean = self._columns([posterior.predict(D) for posterior in self.posteriors_])
        if not return_std:
            return mean
        return mean, self._columns([posterior.predictive_sd(D) for posterior in self.posteriors_])

    def _columns(self, values: list[Floats]) -> Floats:
        """Values of each target in the shape that y had."""
        return np.column_stack(values) if self._several else values[0]

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.regressor_tags.poor_score = True  # a sparse prior rightly refuses dense test problems
        return tags


@dataclass(eq=False, repr=False)
class SpikeSlabRegressor(SparseRegressor):
    """An estimator with the spike-and-slab prior among its parameters."""

    slab_variance: float = 10.0
    prior_inclusion: ArrayLike = 0.1
    noise_shape: float = 1e-4
    noise_rate: float = 1e-4
    inclusion_beta: tuple[float, float] | None = None

    def _prior(self) -> Prior:
        return Prior(self.slab_variance, self.prior_inclusion, self.noise_shape, self.noise_rate, self.inclusion_beta)

    def _solve(self, gram: Gram | LazyGram) -> Posterior:
        # even a perfect fit gains no more than n y'y / (4 noise_rate) nats, too few for any term
        if 0.0 < gram.n * gram.yty < 4.0 * self.noise_rate:
            warnings.warn(
                f"the target varies by {math.sqrt(gram.yty / gram.n):.1g} only, which noise_rate={self.noise_rate:g}"
                " takes for noise: divide it by its sd, or give a smaller one",
                DataWarning,
                stacklevel=3,
            )
        return super()._solve(gram)

    def _target(self, target: int | None) -> int:
        """Index of the given target, 0 in a fit to one; InputError if it has to be given, or is out of range."""
        check_is_fitted(self, "coef_")
        count = len(self.posteriors_)
        if target is None and count > 1:
            raise InputError(f"this fit has {count} targets: say which, target=0 to {count - 1}")
        if target is not None and not 0 <= target < count:
            raise InputError(f"no target {target}: this fit has {count}, counted from 0")
        return target or 0
