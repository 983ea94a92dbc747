"""Files of equations read back: numbers and the text of terms, which is parsed again."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayeq.equation.check_saved import check_content, check_restored
from bayeq.equation.equation import Equation, Fit, RunnerUp
from bayeq.equation.equations import DataSummary, Equations
from bayeq.equation.intervals import OverModels
from bayeq.equation.schema import first_fault
from bayeq.equation.several import EquationTuple
from bayeq.equation.to_json import FORMAT
from bayeq.equation.verdict import Verdict
from bayeq.errors import BayeqError, FileFormatError, as_path
from bayeq.expressions import parse
from bayeq.expressions.functions import TIME
from bayeq.forecast.results import Scores
from bayeq.inference.posterior import ModelAverage, Posterior
from bayeq.plan.conditions import Measured
from bayeq.plan.models import CandidateModel
from bayeq.records.validate import check_name
from bayeq.refine.results import Refinement
from bayeq.regression.design import DroppedTerm
from bayeq.regression.residuals import Driver, Residuals
from bayeq.selection.select import LeftOut
from bayeq.states import Chain, Roles, Sensors, Tails, check_sensors

__all__ = ["load", "restored"]

T = TypeVar("T", Fit, RunnerUp, LeftOut, Driver)


def _indicator(members: list[int], terms: int) -> NDArray[np.bool_]:
    out = np.zeros(terms, dtype=np.bool_)
    out[np.array(members, dtype=np.intp)] = True
    return out


def _restored_average(saved: Mapping[str, Any], terms: int) -> ModelAverage:
    index = np.array(saved["terms"], dtype=np.intp)
    return ModelAverage(
        models=np.array([_indicator(model, terms) for model in saved["models"]], dtype=np.bool_),
        probability=np.array(saved["probability"], dtype=np.float64),
        left_out=float(saved["left_out"]),
        terms=index,
        covariance=np.array(saved["covariance"], dtype=np.float64).reshape(len(index), len(index)),
    )


def load(path: str | Path) -> Equations:
    """Read equations that `Equations.save` wrote.

    Parameters
    ----------
    path : str or Path
        The JSON file.

    Returns
    -------
    Equations
        As they were saved; the record they were found from is not part of the file.

    Raises
    ------
    FileFormatError
        A file that is missing or not such a file, or whose content does not agree with `json_schema` or with itself.
    """
    path = as_path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a JSON file") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileFormatError(f"{path}: not a file of equations saved by bayeq (no format {FORMAT!r})")
    return restored(content, str(path))


def restored(content: Mapping[str, Any], where: str) -> Equations:
    """Equations from the content of a file of them.

    Parameters
    ----------
    content : mapping
        What `bayeq.equation.to_json.to_saved` made.
    where : str
        Where it was found, for the message.

    Raises
    ------
    FileFormatError
        It does not agree with `json_schema` or with itself.
    """
    try:
        fault = first_fault(content)
        if fault is not None:
            raise ValueError(fault)
        return _restore(content)
    except (ValueError, OverflowError, RecursionError, BayeqError) as error:
        raise FileFormatError(f"{where}: damaged: {error}") from error


def _restore(content: Mapping[str, Any]) -> Equations:
    """The equations of content that agrees with the schema."""
    data, diagnostics = content["data"], content["diagnostics"]
    files = data["file"]
    equations = []
    chains = Roles.parse(data["chains"], inputs=data["inputs"]).chains
    check_content(content, chains)
    names = [TIME, *data["inputs"]]
    for chain in chains:
        names += chain.names
    for name in names:
        check_name(name, "channels")
    for k, chain in enumerate(chains):
        saved = content["equations"][k]
        equations.append(
            _restore_equation(
                chain,
                saved,
                content["posteriors"][k],
                diagnostics["equations"][saved["target"]],
                content["method"],
                {str(name): str(unit) for name, unit in data.get("units", {}).items()},
                names,
            )
        )
    found = Equations(
        equations=EquationTuple(equations),
        inputs=tuple(str(name) for name in data["inputs"]),
        method=str(content["method"]),
        dictionary=str(data["dictionary"]),
        smooth=data["smooth"],
        data=DataSummary(
            files=(files,) if isinstance(files, str) else tuple(files),
            n=int(data["n"]),
            n_train=int(data["n_train"]),
            n_held_out=int(data["n_held_out"]),
            estimated=tuple(data["estimated"]),
            smoothed=bool(data["smoothed"]),
            holdout=float(data["holdout"]),
            refitted=bool(data.get("refitted", False)),
            stretches=int(data.get("stretches", 0)),
            measured=_restored_measured(data.get("measured")),
            sensors=_restored_sensors(data, equations),
            seconds=None if data.get("seconds") is None else float(data["seconds"]),
            rows_as_time=bool(data.get("rows_as_time", False)),
            band=_restored_band(data.get("band")),
        ),
        dropped=tuple(DroppedTerm(d["name"], d["reason"]) for d in diagnostics["dropped_terms"]),
        warnings=tuple(str(w) for w in diagnostics["warnings"]),
        constraints=tuple(str(c) for c in diagnostics.get("constraints", ())),
        scores=_restored_scores(diagnostics.get("scores")),
        refined=_restored_refinement(diagnostics.get("refined")),
    )
    found.known()  # constraints that cannot be read are damage
    for equation in found:
        check_restored(equation)
    return found


def _restored_sensors(data: Mapping[str, Any], equations: Sequence[Equation]) -> Sensors:
    """What was known of channels; nothing in a file of an earlier version."""
    tails: Tails = "student" if data.get("tails") == "student" else "gauss"
    sensors = Sensors(_numbers(data.get("noise")), _numbers(data.get("gain_sd")), tails)
    roles = Roles(tuple(equation.chain for equation in equations), tuple(str(name) for name in data["inputs"]))
    check_sensors(sensors.noise, sensors.gain_sd, roles)
    return sensors


def _restored_band(saved: Sequence[float] | None) -> tuple[float, float] | None:
    if saved is None:
        return None
    low, high = (float(end) for end in saved)
    if not 0.0 <= low < high < math.inf:
        raise ValueError(f"a band of {low!r} to {high!r} Hz")
    return low, high


def _numbers(saved: Mapping[str, Any] | None) -> dict[str, float]:
    return {str(name): float(value) for name, value in (saved or {}).items()}


def _restored_scores(saved: Mapping[str, Any] | None) -> Scores | None:
    if saved is None:
        return None

    def errors(found: Mapping[str, float | None]) -> dict[str, float]:
        return {str(name): math.inf if error is None else float(error) for name, error in found.items()}

    blew_up_at = saved["blew_up_at"]
    return Scores(
        rows=int(saved["rows"]),
        one_step=errors(saved["one_step"]),
        free_run=errors(saved["free_run"]),
        blew_up_at=None if blew_up_at is None else float(blew_up_at),
    )


def _restored_refinement(saved: Mapping[str, Any] | None) -> Refinement | None:
    if saved is None:
        return None
    return Refinement(
        files=tuple(str(name) for name in saved["files"]),
        n=int(saved["n"]),
        segments=int(saved["segments"]),
        longest=int(saved["longest"]),
        noise_sd={str(name): float(sd) for name, sd in saved["noise_sd"].items()},
        interpolation=saved["interpolation"],
        converged=bool(saved["converged"]),
        at_bound=tuple(str(name) for name in saved.get("at_bound", ())),
    )


def _column(terms: list[Mapping[str, Any]], name: str) -> Any:
    return np.array([float(t[name]) for t in terms]) if terms and name in terms[0] else None


def _intervals(terms: list[Mapping[str, Any]], name: str) -> NDArray[np.float64] | None:
    if not terms or name not in terms[0]:
        return None
    return np.array([term[name] for term in terms], dtype=np.float64)


def _record(kind: type[T], saved: Mapping[str, Any]) -> T:
    """A dataclass from the entries of its fields; further entries are those of a later version."""
    return kind(**{one.name: saved[one.name] for one in fields(kind)})


def _restore_equation(
    chain: Chain,
    saved: Mapping[str, Any],
    state: Mapping[str, Any],
    checks: Mapping[str, Any],
    method: str,
    units: Mapping[str, str],
    names: Sequence[str],
) -> Equation:
    terms = tuple(parse(term["name"], names) for term in saved["terms"])
    support = np.array([bool(term["included"]) for term in saved["terms"]], dtype=np.bool_)
    r = int(support.sum())
    posterior = Posterior(
        method=method,
        names=tuple(term.text for term in terms),
        pip=np.array([float(term["pip"]) for term in saved["terms"]]),
        support=support,
        coef=np.array([float(term["coef"]) for term in saved["terms"]]),
        covariance=np.array(state["covariance"], dtype=np.float64).reshape(r, r),
        center=np.array(state["center"], dtype=np.float64).reshape(len(terms)),
        target_mean=float(state["target_mean"]),
        noise_variance=float(state["noise_variance"]),
        target_mean_variance=None
        if state.get("target_mean_variance") is None
        else float(state["target_mean_variance"]),
        freedom=_restored_freedom(state.get("freedom")),
        n=state["n"] if isinstance(state["n"], int) else float(state["n"]),
        elbo=None if saved["elbo"] is None else float(saved["elbo"]),
        elbo_trace=np.array(state["elbo_trace"], dtype=np.float64),
        n_iter=int(state["n_iter"]),
        converged=bool(checks["converged"]),
        slab_variance=checks["slab_variance"],
        averaged_coef=_column(saved["terms"], "averaged_coef"),
        averaged_sd=_column(saved["terms"], "averaged_sd"),
        rhat=checks["rhat"],
        optimum=None if state["optimum"] is None else _indicator(state["optimum"], len(terms)),
        intercept_pip=None if saved.get("intercept_pip") is None else float(saved["intercept_pip"]),
        left_out_intercept=None
        if saved.get("intercept_included", True)
        else (float(saved["intercept"]), float(saved["intercept_sd"])),
        average=None if state["average"] is None else _restored_average(state["average"], len(terms)),
        likelihood_coef=_column(saved["terms"], "likelihood_coef"),
        likelihood_sd=_column(saved["terms"], "likelihood_sd"),
        error_share=None if saved.get("error_share") is None else float(saved["error_share"]),
        error_sd=None if saved.get("error_sd") is None else float(saved["error_sd"]),
        error_lines=tuple(float(line) for line in saved.get("error_lines", ())),
    )
    shown = _restored_shown(posterior, saved["terms"], state["shown"])
    held_out = checks["fit"]["held_out"]
    residuals = checks["residuals"]
    return Equation(
        chain=chain,
        terms=terms,
        posterior=posterior,
        shown_posterior=shown,
        verdict=_restored_verdict(saved["verdict"]),
        why={str(term["name"]): str(term["why"]) for term in saved["terms"] if term["why"] is not None},
        train=_record(Fit, checks["fit"]["train"]),
        held_out=None if held_out is None else _record(Fit, held_out),
        residuals=_restored_residuals(residuals),
        runners_up=tuple(_record(RunnerUp, r) for r in checks["runners_up"]),
        share=_restored_column(saved["terms"], "share"),
        bound=_restored_column(saved["terms"], "bound"),
        undetermined=tuple(str(name) for name in saved.get("undetermined", ())),
        left_out=tuple(_record(LeftOut, term) for term in checks.get("left_out", [])),
        units=units,
        unit_gains=tuple(float(gain) for gain in saved.get("unit_gains", ())),
        models=tuple(_restored_model(model) for model in state.get("models", ())),
        stored=OverModels(
            averaged=_intervals(saved["terms"], "averaged_ci95"),
            given_in=_intervals(saved["terms"], "printed_ci95"),
            intercept=np.array([float(bound) for bound in saved["intercept_printed_ci95"]])
            if "intercept_printed_ci95" in saved
            else None,
        ),
        error_probability=None if saved.get("error_probability") is None else float(saved["error_probability"]),
        tau=float(saved.get("tau", 0.0)),
    )


def _restored_model(saved: Mapping[str, Any]) -> CandidateModel:
    members, coef = tuple(int(j) for j in saved["members"]), tuple(float(c) for c in saved["coef"])
    return CandidateModel(float(saved["probability"]), members, coef, float(saved["intercept"]))


def _restored_measured(saved: Mapping[str, Any] | None) -> Measured:
    """What is known of the records; nothing in a file of an earlier version."""
    if saved is None:
        return Measured()

    def spans(of: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
        return {str(name): (float(low), float(high)) for name, (low, high) in of.items()}

    return Measured(
        fs=None if saved["fs"] is None else float(saved["fs"]),
        seconds=None if saved["seconds"] is None else float(saved["seconds"]),
        ranges=spans(saved["ranges"]),
        bands=spans(saved["bands"]),
    )


def _restored_shown(posterior: Posterior, terms: list[Mapping[str, Any]], saved: Mapping[str, Any] | None) -> Posterior:
    """The posterior given the terms shown, if these are others."""
    if saved is None:
        return posterior
    members = [j for j, term in enumerate(terms) if term["shown"]]
    coef = [float(terms[j]["shown_coef"]) for j in members]
    return _restored_posterior(posterior, {**saved, "terms": members, "coef": coef})


def _restored_posterior(like: Posterior, saved: Mapping[str, Any]) -> Posterior:
    """A posterior given another model."""
    support = _indicator(saved["terms"], len(like.names))
    coef, r = np.zeros(len(support)), int(support.sum())
    coef[support] = saved["coef"]
    mean_variance = saved.get("target_mean_variance", like.target_mean_variance)
    return replace(
        like,
        support=support,
        coef=coef,
        covariance=np.array(saved["covariance"], dtype=np.float64).reshape(r, r),
        noise_variance=float(saved["noise_variance"]),
        center=np.array(saved.get("center", like.center), dtype=np.float64).reshape(len(support)),
        target_mean=float(saved.get("target_mean", like.target_mean)),
        target_mean_variance=None if mean_variance is None else float(mean_variance),
        freedom=_restored_freedom(saved.get("freedom")),
    )


def _restored_freedom(saved: Sequence[float | None] | None) -> NDArray[np.float64] | None:
    return None if saved is None else np.array([math.inf if value is None else float(value) for value in saved])


def _restored_verdict(saved: Mapping[str, Any]) -> Verdict:
    return Verdict(saved["kind"], str(saved["reason"]), str(saved.get("advice", "")))


def _restored_residuals(saved: Mapping[str, Any]) -> Residuals:
    driver = saved.get("driver")
    return Residuals(
        n=int(saved["n"]),
        lag1=float(saved["lag1"]),
        n_eff=float(saved["n_eff"]),
        skewness=float(saved.get("skewness", 0.0)),
        kurtosis=float(saved.get("kurtosis", 0.0)),
        normality=float(saved.get("normality", 1.0)),
        driver=None if driver is None else _record(Driver, driver),
        discrepancy=None if saved.get("discrepancy") is None else float(saved["discrepancy"]),
    )


def _restored_column(terms: list[Mapping[str, Any]], name: str) -> NDArray[np.float64] | None:
    """Numbers of the terms, NaN where there is none; None if there are none at all."""
    if not any(term.get(name) is not None for term in terms):
        return None
    return np.array([math.nan if term.get(name) is None else float(term[name]) for term in terms])
