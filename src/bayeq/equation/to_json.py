"""Equations as plain data: what the command line prints, and what files hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.forecast.results import Scores
from bayeq.inference.posterior import ModelAverage, Posterior
from bayeq.numerics.normal import Z95

__all__ = ["FORMAT", "to_dict", "to_saved"]

FORMAT = "bayeq-equations-1"


def to_dict(eq: Answer) -> dict[str, Any]:
    """The answer as plain data, every candidate term of every equation in it."""
    files = eq.data.files
    return {
        "version": version("bayeq"),
        "method": eq.method,
        "verdict": asdict(eq.verdict),
        "data": {
            "file": files[0] if len(files) == 1 else list(files),
            "n": eq.data.n,
            "fs": eq.data.fs,
            "seconds": eq.data.seconds,
            "rows_as_time": eq.data.rows_as_time,
            "n_train": eq.data.n_train,
            "n_held_out": eq.data.n_held_out,
            "chains": [str(chain) for chain in eq.chains],
            "inputs": list(eq.inputs),
            "dictionary": eq.dictionary,
            "smooth": eq.smooth,
            "band": None if eq.data.band is None else list(eq.data.band),
            "estimated": list(eq.data.estimated),
            "smoothed": eq.data.smoothed,
            "holdout": eq.data.holdout,
            "refitted": eq.data.refitted,
            "stretches": eq.data.stretches,
            "measured": asdict(eq.data.measured),
            "noise": dict(eq.data.sensors.noise),
            "gain_sd": dict(eq.data.sensors.gain_sd),
            "tails": eq.data.sensors.tails,
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
    p, shown = equation.posterior, equation.shown_posterior
    return {
        "target": equation.target,
        "verdict": asdict(equation.verdict),
        "intercept": equation.intercept_estimate[0],
        "intercept_sd": equation.intercept_estimate[1],
        "intercept_included": shown.left_out_intercept is None,
        "intercept_ci95": list(equation.intercept_ci95),
        "intercept_printed_ci95": list(equation.printed_intercept_ci95),
        "intercept_printed_over_models": equation.intercept_over_models,
        "intercept_pip": shown.intercept_pip,
        "noise_sd": equation.noise_sd,
        "error_share": equation.error_share,
        "error_sd": shown.error_sd,
        "error_lines": list(shown.error_lines),
        "elbo": p.elbo,
        "equation": equation.text,
        "full_equation": None,  # as earlier versions had it
        "error_probability": equation.error_probability,
        "tau": equation.tau,
        "latex": equation.to_latex(),
        "unit_gains": list(equation.unit_gains),
        "undetermined": list(equation.undetermined),
        "terms": [_term(equation, j) for j in range(len(equation.terms))],
    }


def _term(equation: Equation, j: int) -> dict[str, Any]:
    p, shown, name = equation.posterior, equation.shown_posterior, equation.terms[j].text
    return {
        "name": name,
        "coef": float(p.coef[j]),
        "sd": float(p.sd[j]),
        "ci95": equation.ci95[j].tolist(),
        "pip": float(p.pip[j]),
        "included": bool(p.support[j]),
        "shown": bool(shown.support[j]),
        "why": equation.why.get(name),
        "effective": False,  # as earlier versions had it
        "shown_coef": float(shown.coef[j]),
        "shown_sd": float(shown.sd[j]),
        "shown_ci95": equation.shown_ci95[j].tolist(),
        **_likelihood(equation, j),
        "printed_ci95": equation.printed_ci95[j].tolist(),
        "printed_over_models": bool(equation.printed_over_models[j]),
        **_averaged(equation, j),
        # of a term that is shown
        "share": _known(equation.share, j) if shown.support[j] else None,
        "unit": equation.coef_units[j],
        # of a coefficient that is not included
        "bound": _known(equation.bound, j),
    }


def _likelihood(equation: Equation, j: int) -> dict[str, Any]:
    """Of a term shown, the likelihood's own coefficient, where the other is its projection."""
    shown = equation.shown_posterior
    if shown.likelihood_coef is None or shown.likelihood_sd is None:
        return {}
    value, sd = float(shown.likelihood_coef[j]), float(shown.likelihood_sd[j])
    return {
        "likelihood_coef": value,
        "likelihood_sd": sd,
        "likelihood_ci95": [value - Z95 * sd, value + Z95 * sd],
    }


def _known(column: NDArray[np.float64] | None, j: int) -> float | None:
    """An entry of a column; None where there is none, or NaN."""
    return None if column is None or not math.isfinite(column[j]) else float(column[j])


def _averaged(equation: Equation, j: int) -> dict[str, Any]:
    """Moments and interval over all models, where models are averaged."""
    p, interval = equation.posterior, equation.averaged_ci95
    if p.averaged_coef is None or p.averaged_sd is None or interval is None:
        return {}
    return {
        "averaged_coef": float(p.averaged_coef[j]),
        "averaged_sd": float(p.averaged_sd[j]),
        "averaged_ci95": interval[j].tolist(),
    }


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
            "excess": None,  # of a regression that is gone
            "correlated": equation.residuals.correlated,
            "driven": equation.residuals.driven,
        },
        "runners_up": [asdict(r) for r in equation.runners_up],
        "left_out": [asdict(term) for term in equation.left_out],
    }


def to_saved(eq: Answer) -> dict[str, Any]:
    """`to_dict` and what else it takes to predict with the equations again."""
    return {
        "format": FORMAT,
        **to_dict(eq),
        "posteriors": [
            {
                "covariance": e.posterior.covariance.tolist(),
                "shown": _shown(e),
                "center": e.posterior.center.tolist(),
                "target_mean": e.posterior.target_mean,
                "noise_variance": e.posterior.noise_variance,
                "target_mean_variance": e.posterior.target_mean_variance,
                "freedom": _freedom(e.posterior),
                "n": e.posterior.n,
                "n_iter": e.posterior.n_iter,
                "elbo_trace": e.posterior.elbo_trace.tolist(),
                "optimum": None if e.posterior.optimum is None else np.flatnonzero(e.posterior.optimum).tolist(),
                "average": None if e.posterior.average is None else _saved_average(e.posterior.average),
                "models": [asdict(model) for model in e.models],
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


def _shown(equation: Equation) -> dict[str, Any] | None:
    """What is known of the terms shown beside their coefficients; None where these are the included ones."""
    shown = equation.shown_posterior
    if shown is equation.posterior:
        return None
    return _saved_model(shown)


def _saved_model(p: Posterior) -> dict[str, Any]:
    """A posterior given a model, without what all models of the equation have in common."""
    return {
        "terms": np.flatnonzero(p.support).tolist(),
        "coef": p.coef[p.support].tolist(),
        "covariance": p.covariance.tolist(),
        "noise_variance": p.noise_variance,
        "center": p.center.tolist(),
        "target_mean": p.target_mean,
        "target_mean_variance": p.target_mean_variance,
        "freedom": _freedom(p),
    }


def _freedom(p: Posterior) -> list[float | None] | None:
    """Degrees of freedom of all terms; None for infinitely many."""
    return None if p.freedom is None else [value if math.isfinite(value) else None for value in p.freedom.tolist()]
