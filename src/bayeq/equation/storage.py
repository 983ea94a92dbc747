"""Equations as JSON: what the command line prints, and files that can be read back.

A file holds numbers and term texts only; terms are parsed again when it is read.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayeq
from bayeq.dictionary import DroppedTerm
from bayeq.equation.equation import Equation, Fit, RunnerUp
from bayeq.equation.equations import DataSummary, Equations
from bayeq.errors import BayeqError, FileFormatError
from bayeq.expressions import parse
from bayeq.forecast.results import Refinement, Scores
from bayeq.inference.posterior import ModelAverage, Posterior
from bayeq.regression.residuals import Driver, Residuals
from bayeq.selection.limits import LeftOut
from bayeq.states import parse_chain

__all__ = ["FORMAT", "load", "to_dict", "to_saved"]

FORMAT = "bayeq-equations-1"


def to_dict(eq: Equations) -> dict[str, Any]:
    """The answer as plain data, every candidate term of every equation in it."""
    files = eq.data.files
    return {
        "version": bayeq.__version__,
        "method": eq.method,
        "data": {
            "file": files[0] if len(files) == 1 else list(files),
            "n": eq.data.n,
            "n_train": eq.data.n_train,
            "n_held_out": eq.data.n_held_out,
            "chains": [str(chain) for chain in eq.chains],
            "inputs": list(eq.inputs),
            "dictionary": eq.dictionary,
            "smooth": eq.smooth,
            "estimated": list(eq.data.estimated),
            "units": {name: unit for equation in eq.equations for name, unit in equation.units.items()},
        },
        "equations": [_equation(equation) for equation in eq.equations],
        "diagnostics": {
            "warnings": list(eq.warnings),
            "dropped_terms": [asdict(d) for d in eq.dropped],
            **({"constraints": list(eq.constraints)} if eq.constraints else {}),
            **({"scores": _scores(eq.scores)} if eq.scores else {}),
            **({"refined": asdict(eq.refined)} if eq.refined else {}),
            "equations": {equation.target: _diagnostics(equation) for equation in eq.equations},
        },
    }


def _scores(scores: Scores) -> dict[str, Any]:
    """Errors of the rows held out; None for the infinite one of a run that blew up."""

    def finite(errors: Mapping[str, float]) -> dict[str, float | None]:
        return {name: error if math.isfinite(error) else None for name, error in errors.items()}

    return {**asdict(scores), "one_step": finite(scores.one_step), "free_run": finite(scores.free_run)}


def _equation(equation: Equation) -> dict[str, Any]:
    p = equation.posterior
    ci = equation.ci95
    return {
        "target": equation.target,
        "intercept": p.intercept,
        "intercept_sd": p.intercept_sd,
        "intercept_ci95": list(equation.intercept_ci95),
        "noise_sd": equation.noise_sd,
        "elbo": p.elbo,
        "equation": equation.text,
        "latex": equation.to_latex(),
        "terms": [
            {
                "name": term.text,
                "coef": float(p.coef[j]),
                "sd": float(p.sd[j]),
                "ci95": [float(ci[j, 0]), float(ci[j, 1])],
                "pip": float(p.pip[j]),
                "included": bool(p.support[j]),
                **_averaged(p, j),
                "share": _share(equation, j),
                "unit": equation.coef_units[j],
            }
            for j, term in enumerate(equation.terms)
        ],
    }


def _share(equation: Equation, j: int) -> float | None:
    """Share of variance that a term explains; None for one that is not included."""
    return float(equation.share[j]) if equation.share is not None and equation.posterior.support[j] else None


def _averaged(p: Posterior, j: int) -> dict[str, float]:
    """Moments over all models, where models are averaged."""
    if p.averaged_coef is None or p.averaged_sd is None:
        return {}
    return {"averaged_coef": float(p.averaged_coef[j]), "averaged_sd": float(p.averaged_sd[j])}


def _average(p: Posterior) -> dict[str, Any] | None:
    """The models that were averaged over, in short."""
    if p.average is None:
        return None
    top = range(min(10, len(p.average.probability)))
    return {
        "models": len(p.average.probability),
        "left_out": p.average.left_out,
        "likeliest": [
            {
                "probability": float(p.average.probability[k]),
                "terms": [p.names[j] for j in np.flatnonzero(p.average.models[k])],
            }
            for k in top
        ],
        "groups": [
            {"terms": [p.names[j] for j in members], "probability": some}
            for members, some in p.average.credible_groups()
        ],
    }


def _diagnostics(equation: Equation) -> dict[str, Any]:
    return {
        "converged": equation.posterior.converged,
        "slab_variance": equation.posterior.slab_variance,
        "rhat": equation.posterior.rhat,
        "average": _average(equation.posterior),
        "fit": {
            "train": asdict(equation.train),
            "held_out": None if equation.held_out is None else asdict(equation.held_out),
        },
        "residuals": {
            **asdict(equation.residuals),
            "correlated": equation.residuals.correlated,
            "driven": equation.residuals.driven,
        },
        "runners_up": [asdict(r) for r in equation.runners_up],
        "left_out": [asdict(term) for term in equation.left_out],
    }


def to_saved(eq: Equations) -> dict[str, Any]:
    """`to_dict` and what else it takes to predict with the equations again."""
    return {
        "format": FORMAT,
        **to_dict(eq),
        "posteriors": [
            {
                "covariance": e.posterior.covariance.tolist(),
                "center": e.posterior.center.tolist(),
                "target_mean": e.posterior.target_mean,
                "noise_variance": e.posterior.noise_variance,
                "n": e.posterior.n,
                "n_iter": e.posterior.n_iter,
                "elbo_trace": e.posterior.elbo_trace.tolist(),
                "optimum": None if e.posterior.optimum is None else np.flatnonzero(e.posterior.optimum).tolist(),
                "average": None if e.posterior.average is None else _saved_average(e.posterior.average),
            }
            for e in eq.equations
        ],
    }


def _saved_average(average: ModelAverage) -> dict[str, Any]:
    return {
        "models": [np.flatnonzero(model).tolist() for model in average.models],
        "probability": average.probability.tolist(),
        "left_out": average.left_out,
        "terms": average.terms.tolist(),
        "covariance": average.covariance.tolist(),
    }


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

    Raises
    ------
    FileFormatError
        A file that is missing or not such a file.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a JSON file") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileFormatError(f"{path}: not a file of equations saved by bayeq (no format {FORMAT!r})")
    try:
        return _restore(content)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, BayeqError) as error:
        raise FileFormatError(f"{path}: damaged: {type(error).__name__}: {error}") from error


def _restore(content: Mapping[str, Any]) -> Equations:
    data, diagnostics = content["data"], content["diagnostics"]
    files = data["file"]
    equations = []
    for k, chain in enumerate(data["chains"]):
        saved = content["equations"][k]
        equations.append(
            _restore_equation(
                chain,
                saved,
                content["posteriors"][k],
                diagnostics["equations"][saved["target"]],
                content["method"],
                {str(name): str(unit) for name, unit in data.get("units", {}).items()},
            )
        )
    return Equations(
        equations=tuple(equations),
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
        ),
        dropped=tuple(DroppedTerm(d["name"], d["reason"]) for d in diagnostics["dropped_terms"]),
        warnings=tuple(str(w) for w in diagnostics["warnings"]),
        constraints=tuple(str(c) for c in diagnostics.get("constraints", ())),
        scores=_restored_scores(diagnostics.get("scores")),
        refined=_restored_refinement(diagnostics.get("refined")),
    )


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
        unseen_sd={str(name): float(sd) for name, sd in saved["unseen_sd"].items()},
        interpolation=saved["interpolation"],
        converged=bool(saved["converged"]),
    )


def _column(terms: list[Mapping[str, Any]], name: str) -> Any:
    return np.array([float(t[name]) for t in terms]) if terms and name in terms[0] else None


def _restore_equation(
    chain: str,
    saved: Mapping[str, Any],
    state: Mapping[str, Any],
    checks: Mapping[str, Any],
    method: str,
    units: Mapping[str, str],
) -> Equation:
    terms = tuple(parse(term["name"]) for term in saved["terms"])
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
        average=None if state["average"] is None else _restored_average(state["average"], len(terms)),
    )
    if not all(math.isfinite(v) for v in (*posterior.coef, *posterior.center, posterior.noise_variance)):
        raise ValueError("numbers that are not finite")
    held_out = checks["fit"]["held_out"]
    residuals = checks["residuals"]
    return Equation(
        chain=parse_chain(chain),
        terms=terms,
        posterior=posterior,
        train=Fit(**checks["fit"]["train"]),
        held_out=None if held_out is None else Fit(**held_out),
        residuals=_restored_residuals(residuals),
        runners_up=tuple(RunnerUp(**r) for r in checks["runners_up"]),
        share=_restored_share(saved["terms"]),
        left_out=tuple(LeftOut(**term) for term in checks.get("left_out", [])),
        units=units,
    )


def _restored_residuals(saved: Mapping[str, Any]) -> Residuals:
    driver = saved.get("driver")
    return Residuals(
        n=int(saved["n"]),
        lag1=float(saved["lag1"]),
        n_eff=float(saved["n_eff"]),
        skewness=float(saved.get("skewness", 0.0)),
        kurtosis=float(saved.get("kurtosis", 0.0)),
        normality=float(saved.get("normality", 1.0)),
        driver=None if driver is None else Driver(**driver),
        excess=None if saved.get("excess") is None else float(saved["excess"]),
    )


def _restored_share(terms: list[Mapping[str, Any]]) -> NDArray[np.float64] | None:
    if not any(term.get("share") is not None for term in terms):
        return None
    return np.array([math.nan if term.get("share") is None else float(term["share"]) for term in terms])
