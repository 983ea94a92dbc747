"""What the schema cannot say of a saved file: lengths and names that go together, places that exist, covariances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.equation.equation import Equation
from bayeq.inference.posterior import LARGEST, Posterior
from bayeq.numerics.normal import Z95
from bayeq.states import Chain

__all__ = ["check_content", "check_restored"]

Saved = Mapping[str, Any]

# Covariances of files written with all digits are symmetric, and have no negative eigenvalue, but for rounding; of
# matrices up to this size, which an eigenvalue decomposition takes no time for.
ROUNDING = 1e-6
MOST_DECOMPOSED = 200

# Columns of the terms that all of them have, or none.
ALL_OR_NONE = ("averaged_coef", "averaged_sd", "averaged_ci95", "printed_ci95", "likelihood_coef", "likelihood_sd")


def check_content(content: Saved, chains: Sequence[Chain]) -> None:
    """Check what the entries of a file say of each other; the schema has been checked.

    Parameters
    ----------
    content : mapping
        Of the file.
    chains : sequence of Chain
        Parsed from it.

    Raises
    ------
    ValueError
        The first thing that is wrong, and where.
    """
    equations, posteriors = content["equations"], content["posteriors"]
    _same_length("equations", equations, "data.chains", chains)
    _same_length("posteriors", posteriors, "data.chains", chains)
    diagnostics = content["diagnostics"]["equations"]
    states = {name for chain in chains for name in chain.names} | set(content["data"]["inputs"])
    for k, chain in enumerate(chains):
        saved, place = equations[k], f"equations[{k}]"
        if saved["target"] != chain.target:
            raise ValueError(f"{place}.target: {chain.target!r} is expected, the highest derivative of the chain")
        if chain.target not in diagnostics:
            raise ValueError(f"diagnostics.equations.{chain.target} is missing")
        if len(saved.get("unit_gains", ())) not in (0, chain.order + 1) or 0.0 in saved.get("unit_gains", ()):
            raise ValueError(f"{place}.unit_gains: {chain.order + 1} factors other than 0 are expected, or none")
        _check_terms(saved["terms"], f"{place}.terms", posteriors[k]["shown"] is not None)
        _check_intervals(saved, place, ("intercept_ci95", "intercept_printed_ci95"))
        names = {term["name"] for term in saved["terms"]}
        _check_names(saved.get("undetermined", ()), names, f"{place}.undetermined")
        _check_diagnostics(diagnostics[chain.target], names, states, f"diagnostics.equations.{chain.target}")
        _check_posterior(posteriors[k], saved["terms"], f"posteriors[{k}]")
    if content["diagnostics"].get("scores") is not None:
        scores = content["diagnostics"]["scores"]
        _check_names(scores["one_step"], {chain.target for chain in chains}, "diagnostics.scores.one_step")
        _check_names(scores["free_run"], states, "diagnostics.scores.free_run")
    measured = content["data"].get("measured") or {"ranges": {}, "bands": {}}
    for of in ("ranges", "bands"):
        _check_intervals(measured[of], f"data.measured.{of}", measured[of])


def check_restored(equation: Equation) -> None:
    """Check that what is computed from an equation is finite.

    Raises
    ------
    ValueError
        Numbers too large to compute with.
    BayeqError
        Units that cannot be read.
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


def _same_length(place: str, one: Sequence[Any], other_place: str, other: Sequence[Any]) -> None:
    if len(one) != len(other):
        raise ValueError(f"{place} has {len(one)} entries, {other_place} {len(other)}")


def _check_names(found: Sequence[str] | Mapping[str, Any], known: set[str], place: str) -> None:
    for name in found:
        if name not in known:
            raise ValueError(f"{place}: there is no {ascii(name)[:60]}")


def _check_intervals(saved: Saved, place: str, names: Sequence[str] | Mapping[str, Any]) -> None:
    for name in names:
        low, high = saved.get(name, (0.0, 0.0))
        if low > high:
            raise ValueError(f"{place}.{name}: an interval from {low!r} down to {high!r}")


def _check_terms(terms: Sequence[Saved], place: str, simplified: bool) -> None:
    """Terms are distinct, and coefficients those of the models that they say."""
    seen: set[str] = set()
    for j, term in enumerate(terms):
        here = f"{place}[{j}]"
        if term["name"] in seen:
            raise ValueError(f"{here}.name: a term that was there before")
        seen.add(term["name"])
        if term["coef"] != 0 and not term["included"]:
            raise ValueError(f"{here}.coef: 0 is expected of a term that is not included")
        if term["included"] != term["shown"] and (term["why"] is None or not simplified):
            raise ValueError(f"{here}: a term is included or shown and not both without a reason")
        if any((name in term) != (name in terms[0]) for name in ALL_OR_NONE):
            raise ValueError(f"{here}: {' and '.join(ALL_OR_NONE)} are those of all terms or of none")
        _check_intervals(term, here, ("ci95", "shown_ci95", "likelihood_ci95", "printed_ci95", "averaged_ci95"))


def _check_diagnostics(checks: Saved, names: set[str], states: set[str], place: str) -> None:
    for k, one in enumerate(checks["runners_up"]):
        changed = [name for name in (one["leaves"], one["enters"]) if name is not None]
        if not changed:
            raise ValueError(f"{place}.runners_up[{k}]: a term that enters or leaves is expected")
        _check_names(changed, names, f"{place}.runners_up[{k}]")
    _check_names([one["name"] for one in checks.get("left_out", ())], names, f"{place}.left_out")
    driver = checks["residuals"].get("driver")
    _check_names([] if driver is None else [driver["name"]], states, f"{place}.residuals.driver")


def _check_posterior(state: Saved, terms: Sequence[Saved], place: str) -> None:
    size = len(terms)
    _check_length(state["center"], size, f"{place}.center")
    _check_length(state.get("freedom") or terms, size, f"{place}.freedom")
    _check_covariance(state["covariance"], sum(term["included"] for term in terms), f"{place}.covariance")
    shown = [j for j, term in enumerate(terms) if term["shown"]]
    model, here = state.get("shown"), f"{place}.shown"
    if model is not None:
        members = model.get("terms", shown)
        if list(members) != shown:
            raise ValueError(f"{here}.terms: the terms that are shown are expected, {shown}")
        _check_places(members, size, f"{here}.terms")
        _check_length(model.get("center", state["center"]), size, f"{here}.center")
        _check_length(model.get("freedom") or terms, size, f"{here}.freedom")
        if "coef" in model:
            _check_length(model["coef"], len(members), f"{here}.coef")
        _check_covariance(model["covariance"], len(members), f"{here}.covariance")
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
    if abs(sum(average["probability"]) - 1.0) > ROUNDING:
        raise ValueError(f"{place}.probability: probabilities that sum to 1 are expected")
    _check_places(average["terms"], size, f"{place}.terms")
    _check_covariance(average["covariance"], len(average["terms"]), f"{place}.covariance")


def _check_length(found: Sequence[Any], expected: int, place: str) -> None:
    if len(found) != expected:
        raise ValueError(f"{place}: {expected} entries are expected, not {len(found)}")


def _check_places(places: Sequence[float], size: int, place: str) -> None:
    if list(places) != sorted(set(places)):
        raise ValueError(f"{place}: places of terms in ascending order are expected")
    if places and places[-1] >= size:
        raise ValueError(f"{place}: there is no term at {places[-1]}, only {size} terms")


def _check_covariance(rows: Sequence[Sequence[float]], size: int, place: str) -> None:
    """Square, symmetric and without negative variances."""
    if len(rows) != size or any(len(row) != size for row in rows):
        raise ValueError(f"{place}: {size} rows of {size} numbers are expected")
    if not size:
        return
    matrix = np.array(rows, dtype=np.float64)
    variances = np.diagonal(matrix)
    if (variances < 0).any():
        raise ValueError(f"{place}: a variance is negative")
    scaled = _correlations(matrix, variances)
    if not np.isfinite(scaled).all() or np.abs(scaled - scaled.T).max() > ROUNDING:
        raise ValueError(f"{place}: it is not symmetric")
    least = np.linalg.eigvalsh(scaled).min() if size <= MOST_DECOMPOSED else 0.0
    if np.abs(scaled).max() > 1.0 + ROUNDING or least < -ROUNDING * size:
        raise ValueError(f"{place}: no variables have these covariances")


def _correlations(matrix: NDArray[np.float64], variances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariances over standard deviations; those with what does not vary stay as they are."""
    sd = np.where(variances > 0, np.sqrt(variances), 1.0)
    with np.errstate(over="ignore"):
        return np.asarray(matrix / sd[:, None] / sd)
