"""Sensitivity of posterior inclusion probabilities: model averaging under other v_s, p_0 and powers."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats
from bayeq.equation.pip_curve import PipCurve, PriorSensitivity
from bayeq.errors import ConvergenceWarning, InputError
from bayeq.gram import Gram, GramLike
from bayeq.inference.bma import average_models
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.engines import ENGINES
from bayeq.inference.prior import Prior

# v_s varies over two decades either way. A term costs 1/2 ln v_s, so that its log-odds vary by 2.3 nats either way.
FACTORS = 10.0 ** np.linspace(-2.0, 2.0, 9)
# A slab of variance v_s shrinks coefficients as 1/v_s rows of zeros would: with more than ten it does more than select.
LEAST_SLAB_VARIANCE = 0.1
# From one term in a hundred, which suits large dictionaries, to one in two, where small models are no longer preferred.
INCLUSIONS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
# A row counts as one, as a half ... as 1/4096, which leaves 25 rows of a long record of 100,000.
POWERS = 2.0 ** -np.arange(0.0, 13.0)
# An equation of four terms and its noise cannot be learned from fewer rows.
LEAST_ROWS = 5.0


def require_spike_slab(method: str) -> None:
    """Check that a method has a v_s and a p_0; the InputError says which methods have."""
    if not ENGINES[method].spike_slab:
        known = ", ".join(name for name, engine in ENGINES.items() if engine.spike_slab)
        raise InputError(f"method {method!r} has no v_s and p_0 to vary; take one of: {known}")


def prior_sensitivity(
    gram: GramLike,
    prior: Prior,
    slab_variances: ArrayLike | None = None,
    prior_inclusions: ArrayLike | None = None,
    *,
    tolerance: float = 5e-3,
) -> PriorSensitivity:
    """PIPs by model averaging as v_s varies at the p_0 of a prior, and p_0 at its v_s; see `Equation.sensitivity`.

    `gram` is standardised; the averaging may leave out `tolerance` of the posterior mass.

    InputError: values out of range, or every term forced or forbidden.

    Examples
    --------
    >>> import numpy as np
    >>> from bayeq.gram import Gram
    >>> rng = np.random.default_rng(1)
    >>> D = rng.normal(size=(50, 3))
    >>> gram = Gram.from_data(D, D[:, 0] + 0.3 * D[:, 1] + rng.normal(size=50), names=("x", "v", "u"))
    >>> print(prior_sensitivity(gram.standardise().gram, Prior()))
    included (PIP > 0.5), slab variance v_s from 0.1 to 1e+03 (used: 10)
    always: x
    v: 0.1 to 100; PIP 0.77 as used
    included (PIP > 0.5), prior inclusion probability p_0 from 0.01 to 0.5 (used: 0.1)
    always: x
    v: 0.05 to 0.5; PIP 0.77 as used
    """
    terms = len(gram.names)
    used = Problem.of(gram, prior)
    v_s, p_0 = float(prior.slab_variance), common_inclusion(prior, terms)
    if slab_variances is None:
        slab_variances = [value for value in v_s * FACTORS if value >= LEAST_SLAB_VARIANCE]
    slabs = _axis("slab_variances", slab_variances, v_s, np.inf)
    inclusions = _axis("prior_inclusions", INCLUSIONS if prior_inclusions is None else prior_inclusions, p_0, 1.0)

    def at(inclusion: float) -> Problem:
        # rows of D'D that one problem has asked for serve all of them
        shifted = prior if inclusion == p_0 else with_inclusion(prior, terms, inclusion)
        return Problem.of(gram, shifted)._replace(columns=used.columns)

    return PriorSensitivity(
        _curve("slab_variance", gram, prior, slabs, v_s, map(used.with_slab_variance, slabs.tolist()), tolerance),
        _curve("prior_inclusion", gram, prior, inclusions, p_0, map(at, inclusions.tolist()), tolerance),
    )


def power_sensitivity(gram: Gram, prior: Prior, powers: ArrayLike | None = None) -> PipCurve:
    """PIPs by model averaging as the likelihood is raised to a power, so that each row counts for less.

    See `Equation.coarsening`; `gram` is standardised. Miller and Dunson (2019) call this coarsening. InputError for
    powers out of range.
    """
    values = _axis("powers", POWERS if powers is None else powers, 1.0, 1.0)
    values = values[(values == 1.0) | (values * gram.n >= LEAST_ROWS)]
    problems = (Problem.of(gram.raised(float(power)), prior) for power in values)
    return replace(_curve("coarsen", gram, prior, values, 1.0, problems), rows=values * gram.n)


def _axis(name: str, values: ArrayLike, used: float, upper: float) -> Floats:
    """Values in ascending order, the one used among them."""
    given = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if given.ndim > 1:
        raise InputError(f"{name} must be a list of numbers, got an array of shape {given.shape}")
    # a value that differs from the one used by rounding is the one used
    others = given[~np.isclose(given, used, rtol=1e-9, atol=0.0)]
    wrong = others[~((others > 0.0) & (others < upper))]
    if len(wrong):
        below = f"at most {upper:g}" if used == upper else f"less than {upper:g}"
        allowed = "positive numbers" if upper == np.inf else f"greater than 0 and {below}"
        raise InputError(f"{name} must be {allowed}, got {wrong[0]:g}")
    return np.unique(np.append(others, used))


def _curve(
    axis_name: str,
    gram: GramLike,
    prior: Prior,
    values: Floats,
    used: float,
    problems: Iterable[Problem],
    tolerance: float = 5e-3,
) -> PipCurve:
    """The curve of the problems that the values pose; a warning if the PIPs at the value used are not reliable."""
    pip, left_out = np.empty((len(values), len(gram.names))), np.empty(len(values))
    for k, problem in enumerate(problems):
        found = average_models(problem, prior.limits, tolerance=tolerance)
        pip[k], left_out[k] = found.pip(tolerance)[0], found.left_out
    curve = PipCurve(axis_name, tuple(gram.names), values, pip, left_out, int(np.searchsorted(values, used)))
    if not curve.listed[curve.current]:
        warnings.warn(
            "too many models share the posterior mass to list them: PIPs are averages over models that hold about"
            f" {100 * (1 - left_out[curve.current]):.0f} % of it; see left_out, or give fewer terms",
            ConvergenceWarning,
            stacklevel=4,
        )
    return curve


def common_inclusion(prior: Prior, terms: int) -> float:
    """The number that p_0 is, or that represents it where terms have p_0 of their own or p_0 ~ Beta(a, b)."""
    log_odds = prior.log_odds(terms)
    free = np.isfinite(log_odds)
    if not free.any():
        raise InputError("every term is forced in or kept out: their PIPs are 1 and 0 under any v_s and p_0")
    if prior.inclusion_beta is not None:
        a, b = prior.inclusion_beta
        return float(a / (a + b))
    if np.ndim(prior.prior_inclusion) == 0:
        return float(np.asarray(prior.prior_inclusion))
    return float(1.0 / (1.0 + np.exp(-log_odds[free].mean())))


def with_inclusion(prior: Prior, terms: int, inclusion: float) -> Prior:
    """The prior with another `common_inclusion`.

    Terms keep their odds relative to each other, and forced and forbidden ones remain so; of p_0 ~ Beta(a, b) the mean
    moves and a + b stays.
    """
    if prior.inclusion_beta is not None:
        weight = sum(prior.inclusion_beta)
        return replace(prior, inclusion_beta=(weight * inclusion, weight * (1.0 - inclusion)))
    common = common_inclusion(prior, terms)
    ratio = inclusion / (1.0 - inclusion) * (1.0 - common) / common
    p_0 = np.asarray(prior.prior_inclusion, dtype=np.float64)
    return replace(prior, prior_inclusion=p_0 * ratio / (p_0 * ratio + (1.0 - p_0)))
