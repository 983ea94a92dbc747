"""What the schema cannot say of a saved file: lengths and names that go together, places that exist, covariances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bayeq.equation.equation import Equation
from bayeq.inference.posterior import LARGEST, Posterior
from bayeq.numerics.normal import Z95
from bayeq.states import Chain

Saved = Mapping[str, Any]

# Covariances of files written with all digits are symmetric, and have no negative eigenvalue, but for rounding; of
# matrices up to this size, which an eigenvalue decomposition takes no time for.
ROUNDING = 1e-6
MOST_DECOMPOSED = 200

# Columns of the terms that all of them have, or none.
ALL_OR_NONE = ("averaged_coef", "averaged_sd", "averaged_ci95", "printed_ci95", "likelihood_coef", "likelihood_sd")


def check_content(content: Saved, chains: Sequence[Chain]) -> None:
    """Check what the entries of a file, and the chains parsed from it, say of each other; the schema has been checked.

    ValueError: the first thing that is wrong, and where.
    """
    equations, posteriors, data = content["equations"], content["posteriors"], content["data"]
    for place, entries in (("equations", equations), ("posteriors", posteriors)):
        _require(len(entries) == len(chains), f"{place} has {len(entries)} entries, data.chains {len(chains)}")
    diagnostics = content["diagnostics"]["equations"]
    states = {name for chain in chains for name in chain.names} | set(data["inputs"])
    for k, (chain, saved) in enumerate(zip(chains, equations, strict=True)):
        target, place = chain.target, f"equations[{k}]"
        expected = f"{place}.target: {target!r} is expected, the highest derivative of the chain"
        _require(saved["target"] == target, expected)
        _require(target in diagnostics, f"diagnostics.equations.{target} is missing")
        gains, factors = saved.get("unit_gains", ()), chain.order + 1
        right = len(gains) in (0, factors) and 0.0 not in gains
        _require(right, f"{place}.unit_gains: {factors} factors other than 0 are expected, or none")
        _check_terms(saved["terms"], f"{place}.terms", posteriors[k]["shown"] is not None)
        _check_intervals(saved, place, ("intercept_ci95", "intercept_printed_ci95"))
        with_sd = saved.get("intercept_included", True) or "intercept_sd" in saved
        _require(with_sd, f"{place}.intercept_sd is missing")
        names = {term["name"] for term in saved["terms"]}
        _check_names(saved.get("undetermined", ()), names, f"{place}.undetermined")
        _check_diagnostics(diagnostics[target], names, states, f"diagnostics.equations.{target}")
        _check_posterior(posteriors[k], saved["terms"], f"posteriors[{k}]")
    scores = content["diagnostics"].get("scores") or {"one_step": (), "free_run": ()}
    for name, known in (("one_step", {chain.target for chain in chains}), ("free_run", states)):
        _check_names(scores[name], known, f"diagnostics.scores.{name}")
    measured = data.get("measured") or {"ranges": {}, "bands": {}}
    for of in ("ranges", "bands"):
        _check_intervals(measured[of], f"data.measured.{of}", measured[of])


def check_restored(equation: Equation) -> None:
    """Check that what is computed from an equation is finite.

    ValueError for numbers too large to compute with, BayeqError for units that cannot be read.
    """
    posteriors = [equation.posterior, equation.shown_posterior]
    with np.errstate(all="ignore"):
        finite = all(map(_is_finite, posteriors))
        ends = np.array([*equation.intercept_ci95, *equation.printed_intercept_ci95])
        finite = finite and bool((np.abs(ends) <= LARGEST).all())
    if not finite:
        raise ValueError(f"the equation of {equation.target} has numbers too large or too small to compute with")
    assert len(equation.coef_units) == len(equation.terms)


def _is_finite(p: Posterior) -> bool:
    ends = np.abs([*p.coef, p.intercept]) + Z95 * np.array([*p.sd, p.intercept_sd])
    return bool((ends <= LARGEST).all()) and bool(np.isfinite(p.noise_variance))


def _require(holds: bool, fault: str) -> None:
    if not holds:
        raise ValueError(fault)


def _check_names(found: Iterable[str], known: set[str], place: str) -> None:
    for name in found:
        _require(name in known, f"{place}: there is no {ascii(name)[:60]}")


def _check_intervals(saved: Saved, place: str, names: Iterable[str]) -> None:
    for name in names:
        low, high = saved.get(name, (0.0, 0.0))
        _require(low <= high, f"{place}.{name}: an interval from {low!r} down to {high!r}")


def _check_terms(terms: Sequence[Saved], place: str, simplified: bool) -> None:
    """Terms are distinct, and coefficients those of the models that they say."""
    seen: set[str] = set()
    for j, term in enumerate(terms):
        here, included, shown = f"{place}[{j}]", term["included"], term["shown"]
        _require(term["name"] not in seen, f"{here}.name: a term that was there before")
        seen.add(term["name"])
        _require(included or term["coef"] == 0, f"{here}.coef: 0 is expected of a term that is not included")
        explained = included == shown or (simplified and term["why"] is not None)
        _require(explained, f"{here}: a term is included or shown and not both without a reason")
        alike = all((name in term) == (name in terms[0]) for name in ALL_OR_NONE)
        _require(alike, f"{here}: {' and '.join(ALL_OR_NONE)} are those of all terms or of none")
        _check_intervals(term, here, ("ci95", "shown_ci95", "likelihood_ci95", "printed_ci95", "averaged_ci95"))


def _check_diagnostics(checks: Saved, names: set[str], states: set[str], place: str) -> None:
    for k, one in enumerate(checks["runners_up"]):
        here, changed = f"{place}.runners_up[{k}]", [one[key] for key in ("leaves", "enters") if one[key] is not None]
        _require(bool(changed), f"{here}: a term that enters or leaves is expected")
        _check_names(changed, names, here)
    _check_names([one["name"] for one in checks.get("left_out", ())], names, f"{place}.left_out")
    driver = checks["residuals"].get("driver")
    _check_names([driver["name"]] if driver else [], states, f"{place}.residuals.driver")


def _check_posterior(state: Saved, terms: Sequence[Saved], place: str) -> None:
    size = len(terms)
    _check_length(state["center"], size, f"{place}.center")
    _check_length(state.get("freedom") or terms, size, f"{place}.freedom")
    _check_covariance(state["covariance"], sum(term["included"] for term in terms), f"{place}.covariance")
    shown = [j for j, term in enumerate(terms) if term["shown"]]
    model, here = state.get("shown"), f"{place}.shown"
    if model is not None:
        members = model.get("terms", shown)
        _require(members == shown, f"{here}.terms: the terms that are shown are expected, {shown}")
        _check_length(model.get("center", terms), size, f"{here}.center")
        _check_length(model.get("freedom") or terms, size, f"{here}.freedom")
        _check_length(model.get("coef", shown), len(shown), f"{here}.coef")
        _check_covariance(model["covariance"], len(shown), f"{here}.covariance")
    _check_places(state["optimum"] or [], size, f"{place}.optimum")
    for k, model in enumerate(state.get("models", ())):
        _check_places(model["members"], size, f"{place}.models[{k}].members")
        _check_length(model["coef"], len(model["members"]), f"{place}.models[{k}].coef")
    if state["average"] is not None:
        _check_average(state["average"], size, f"{place}.average")


def _check_average(average: Saved, size: int, place: str) -> None:
    for k, model in enumerate(average["models"]):
        _check_places(model, size, f"{place}.models[{k}]")
    _check_length(average["probability"], len(average["models"]), f"{place}.probability")
    sums = abs(sum(average["probability"]) - 1.0) <= ROUNDING
    _require(sums, f"{place}.probability: probabilities that sum to 1 are expected")
    _check_places(average["terms"], size, f"{place}.terms")
    _check_covariance(average["covariance"], len(average["terms"]), f"{place}.covariance")


def _check_length(found: Sequence[Any], expected: int, place: str) -> None:
    _require(len(found) == expected, f"{place}: {expected} entries are expected, not {len(found)}")


def _check_places(places: Sequence[float], size: int, place: str) -> None:
    _require(list(places) == sorted(set(places)), f"{place}: places of terms in ascending order are expected")
    if places:
        _require(places[-1] < size, f"{place}: there is no term at {places[-1]}, only {size} terms")


def _check_covariance(rows: Sequence[Sequence[float]], size: int, place: str) -> None:
    """Square, symmetric and without negative variances."""
    square = len(rows) == size and all(len(row) == size for row in rows)
    _require(square, f"{place}: {size} rows of {size} numbers are expected")
    if not size:
        return
    matrix = np.array(rows, dtype=np.float64)
    variances = np.diagonal(matrix)
    _require(bool((variances >= 0).all()), f"{place}: a variance is negative")
    # correlations; covariances with what does not vary stay as they are
    sd = np.where(variances > 0, np.sqrt(variances), 1.0)
    with np.errstate(over="ignore"):
        scaled = matrix / sd[:, None] / sd
    symmetric = np.isfinite(scaled).all() and np.abs(scaled - scaled.T).max() <= ROUNDING
    _require(bool(symmetric), f"{place}: it is not symmetric")
    least = np.linalg.eigvalsh(scaled).min() if size <= MOST_DECOMPOSED else 0.0
    possible = np.abs(scaled).max() <= 1.0 + ROUNDING and least >= -ROUNDING * size
    _require(bool(possible), f"{place}: no variables have these covariances")
