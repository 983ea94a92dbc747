"""Equations as plain data, for ``bayeq discover --json`` and for saved files."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np

from bayeq.dictionary.ranges import ConstantEstimate
from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.intervals import Model
from bayeq.equation.physical import own_parameters
from bayeq.equation.written import finite, plain_sd
from bayeq.inference.posterior import Posterior

FORMAT = "bayeq-equations-1"


def _plain(value: Any) -> Any:
    """Arrays and tuples as lists."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _attributes(of: object, *names: str) -> dict[str, Any]:
    """Attributes of an object by their names, as plain data."""
    return {name: _plain(getattr(of, name)) for name in names}


def to_dict(eq: Answer) -> dict[str, Any]:
    """The answer as plain data, with every candidate term of every equation."""
    files, found = eq.data.files, own_parameters(eq)
    constants: dict[str, dict[str, Any]] = {}  # constants inside terms, each once
    for equation in eq.equations:
        for constant in equation.constants:
            constants.setdefault(constant.name, _constant(equation, constant))
    return {
        "version": version("bayeq"),
        "method": eq.method,
        "verdict": asdict(eq.verdict),
        "data": {
            "file": files[0] if len(files) == 1 else list(files),
            **_attributes(eq.data, "n", "fs", "seconds", "rows_as_time", "n_train", "n_held_out"),
            "chains": [str(chain) for chain in eq.chains],
            **_attributes(eq, "inputs", "dictionary", "smooth"),
            **_attributes(eq.data, "band", "estimated", "smoothed", "holdout", "refitted", "stretches"),
            **{name: value for name, value in _attributes(eq.data, "noise_sd", "interpolation").items() if value},
            **({} if eq.data.clock == "s" else {"clock": eq.data.clock}),
            "measured": asdict(eq.data.measured),
            **{
                name: value
                for name, value in asdict(eq.data.sensors).items()
                if name not in ("lags", "gains", "of_reading") or value
            },
            "units": eq.units,
        },
        "equations": [_equation(equation, eq) for equation in eq.equations],
        **({"constants": list(constants.values())} if eq.constants else {}),
        **({"hidden": finite(list(map(asdict, eq.hidden)))} if eq.hidden else {}),
        "parameters": [
            {
                "name": one.symbol,
                "meaning": one.meaning,
                "value": one.mean,
                "sd": one.sd,
                "ci95": [one.low, one.high],
                "unit": one.unit,
            }
            for one in found or ()
        ],
        "modes": [
            {
                "frequency": one.frequency.mean,
                "frequency_sd": one.frequency.sd,
                "damping_ratio": one.damping_ratio.mean,
                "damping_ratio_sd": one.damping_ratio.sd,
                "shape": dict(one.shape),
            }
            for one in (() if found is None else found.modes)
        ],
        "diagnostics": {
            "warnings": list(eq.warnings),
            "dropped_terms": [asdict(d) for d in eq.dropped],
            **({"constraints": list(eq.constraints)} if eq.constraints else {}),
            **({"scores": finite(asdict(eq.scores))} if eq.scores else {}),  # None for the infinite error of a blow-up
            **({"refined": asdict(eq.refined)} if eq.refined else {}),
            "equations": {equation.target: _diagnostics(equation) for equation in eq.equations},
        },
    }


def _equation(equation: Equation, eq: Answer) -> dict[str, Any]:
    shown = equation.shown_posterior
    return {
        "target": equation.target,
        "verdict": asdict(equation.verdict),
        "intercept": equation.shown_model.intercept,
        "intercept_sd": equation.shown_model.intercept_sd,
        "intercept_included": shown.constant.left_out is None,
        "intercept_ci95": list(equation.intercept_ci95),
        "intercept_printed_ci95": list(equation.printed_intercept_ci95),
        "intercept_printed_over_models": equation.intercept_over_models,
        "intercept_pip": shown.constant.pip,
        **_attributes(equation, "noise_sd", "error_share"),
        "error_sd": shown.projected and shown.projected.error_sd,
        **_attributes(shown, "error_lines"),
        "elbo": equation.posterior.details.elbo,
        "equation": equation.text,
        "full_equation": None,  # as earlier versions had it
        **_attributes(equation, "error_probability", "tau"),
        "latex": equation.to_latex(chains=eq.in_dots),
        **_attributes(equation, "unit_gains", "undetermined"),
        **({"constants": [_constant(equation, one) for one in equation.constants]} if equation.constants else {}),
        **({"forms": {choice: dict(found) for choice, found in equation.forms.items()}} if equation.forms else {}),
        "terms": _terms(equation),
    }


def _constant(equation: Equation, one: ConstantEstimate) -> dict[str, Any]:
    unit = equation.constant_units.get(one.name)
    sd = {"value_sd": None if one.sd is None else plain_sd(one)}  # `sd` may be that of the logarithm
    return {**asdict(one), **sd, "ci95": list(one.ci95), "terms": list(one.terms), "unit": unit}


def _terms(equation: Equation) -> list[dict[str, Any]]:
    p, shown, names = equation.posterior, equation.shown_posterior, [term.text for term in equation.terms]
    columns: dict[str, Any] = {
        "name": names,
        **_model("", equation.included_model),
        "pip": p.pip,
        "included": p.support,
        "shown": shown.support,
        "why": [equation.why.get(name) for name in names],
        "effective": [False] * len(names),  # as earlier versions had it
        **_model("shown_", equation.shown_model),
    }
    if equation.likelihood_model is not None:
        columns |= _model("likelihood_", equation.likelihood_model)
    columns |= _attributes(equation, "printed_ci95", "printed_over_models")
    if equation.averaged_model is not None:
        columns |= _model("averaged_", equation.averaged_model)
    absent = np.full(len(names), np.nan)
    bound = absent if equation.bound is None else equation.bound
    share = absent if equation.share is None else np.where(shown.support, equation.share, np.nan)
    columns |= {
        "share": finite(share.tolist()),  # only of terms shown
        "unit": equation.coef_units,
        "bound": finite(bound.tolist()),  # only of terms not included
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*map(_plain, columns.values()), strict=True)]


def _model(prefix: str, model: Model) -> dict[str, Any]:
    """Coefficients of all candidates, their standard deviations and intervals."""
    return {f"{prefix}{name}": getattr(model, name) for name in ("coef", "sd", "ci95")}


def _average(p: Posterior) -> dict[str, Any] | None:
    """Summary of the model average: number of models, the ten likeliest, groups of terms that replace each other."""
    if p.average is None:
        return None
    likeliest = zip(p.average.probability[:10].tolist(), p.average.models[:10], strict=True)
    return {
        "models": len(p.average.probability),
        "left_out": p.average.left_out,
        "likeliest": [
            {"probability": probability, "terms": [p.names[j] for j in np.flatnonzero(model)]}
            for probability, model in likeliest
        ],
        "groups": [
            {"terms": [p.names[j] for j in members], "probability": some}
            for members, some in p.average.credible_groups()
        ],
    }


def _diagnostics(equation: Equation) -> dict[str, Any]:
    return {
        **_attributes(equation.posterior.details, "converged", "slab_variance", "rhat"),
        "average": _average(equation.posterior),
        "fit": {
            "train": asdict(equation.train),
            "held_out": None if equation.held_out is None else asdict(equation.held_out),
        },
        "residuals": {
            **asdict(equation.residuals),
            "excess": None,  # no longer computed, as earlier versions had it
            **_attributes(equation.residuals, "correlated", "driven"),
        },
        "runners_up": [asdict(r) for r in equation.runners_up],
        "left_out": [asdict(term) for term in equation.left_out],
    }


def to_saved(eq: Answer) -> dict[str, Any]:
    """`to_dict` and the posteriors, which are needed to predict with the equations again."""
    return {"format": FORMAT, **to_dict(eq), "posteriors": [_saved_posterior(e) for e in eq.equations]}


def _saved_posterior(equation: Equation) -> dict[str, Any]:
    p, shown = equation.posterior, equation.shown_posterior
    average, details, members = p.average, p.details, np.flatnonzero(shown.support)
    given = {"terms": members.tolist(), "coef": shown.coef[members].tolist(), **_given_terms(shown)}
    return {
        # the posterior given the terms shown; None if these are the included terms
        "shown": None if shown is p else given,
        **_given_terms(p),
        "n": p.n,
        **_attributes(details, "n_iter", "elbo_trace"),
        "optimum": None if details.optimum is None else np.flatnonzero(details.optimum).tolist(),
        "average": average
        and {
            "models": [np.flatnonzero(model).tolist() for model in average.models],
            **_attributes(average, "probability", "left_out", "terms", "covariance"),
        },
        "models": [asdict(model) for model in equation.models],
    }


def _given_terms(p: Posterior) -> dict[str, Any]:
    """A posterior given its terms, without the coefficients: covariance, noise, means, degrees of freedom."""
    return {
        "covariance": p.covariance.tolist(),
        "noise_variance": p.noise_variance,
        "center": p.constant.center.tolist(),
        "target_mean": p.constant.mean,
        "target_mean_variance": p.constant.variance,
        # None for infinite degrees of freedom
        "freedom": None if p.projected is None else finite(p.projected.freedom.tolist()),
    }
