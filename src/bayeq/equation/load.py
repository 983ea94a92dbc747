"""Files of equations read back: numbers and the text of terms, which is parsed again.

A file is first checked against `schema.json`. Entries that are fields of a dataclass are converted by its annotations;
this module restores the rest.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.equation.answer import DataSummary, EquationTuple, HiddenState, with_shown
from bayeq.equation.equation import Equation
from bayeq.equation.equations import Equations
from bayeq.equation.intervals import OverModels
from bayeq.equation.schema import Saved, check_content, first_fault
from bayeq.equation.to_json import FORMAT
from bayeq.errors import BayeqError, FileFormatError, as_path
from bayeq.expressions import Unknown, parse
from bayeq.expressions.functions import TIME
from bayeq.inference.posterior import LARGEST, Averaged, Constant, Details, ModelAverage, Posterior, Projected
from bayeq.numerics.distributions import Z95
from bayeq.records.io import near_files
from bayeq.records.validate import check_name
from bayeq.states import Chain, Roles, check_sensors
from bayeq.states.roles import NEXT

#: Longer files are refused; the largest dictionary makes 40 MB.
MOST_BYTES = 256 * 2**20


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
        A file that is missing, not saved by bayeq, or whose content does not agree with `json_schema` or with itself.
    """
    path = as_path(path)
    try:
        with path.open("rb") as file:
            text = file.read(MOST_BYTES + 1)  # a device may have no end
        content = json.loads(text.decode()) if len(text) <= MOST_BYTES else None
    except FileNotFoundError:
        raise FileFormatError(f"no such file: {path}{near_files(path)}") from None
    except OSError as error:
        raise FileFormatError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a JSON file") from error
    if len(text) > MOST_BYTES:
        raise FileFormatError(f"{path}: longer than {MOST_BYTES // 2**20} MiB: not a file of equations")
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileFormatError(f"{path}: not a file of equations saved by bayeq (no format {FORMAT!r})")
    return restored(content, str(path))


def restored(content: Saved, where: str) -> Equations:
    """Equations from the data of `to_saved`; a FileFormatError names `where` they are from if they are damaged."""
    try:
        fault = first_fault(content)
        if fault is not None:
            raise ValueError(fault)
        return _restore(content)
    except (ValueError, OverflowError, RecursionError, BayeqError) as error:
        raise FileFormatError(f"{where}: damaged: {error}") from error


_hints = cache(get_type_hints)


def _value(kind: Any, saved: Any) -> Any:
    """A saved entry converted to the annotation `kind` of its field; null is infinity if `kind` does not allow None."""
    inside, origin = get_args(kind), get_origin(kind)
    if NoneType in inside:
        return None if saved is None else _value(inside[0], saved)
    if origin is np.ndarray:
        return np.array([math.inf if item is None else item for item in saved], dtype=get_args(inside[1])[0])
    if origin is tuple:
        return tuple(_value(inside[0], item) for item in saved)
    if origin is Mapping:
        return {name: _value(inside[1], item) for name, item in saved.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        return kind(**_fields(kind, saved))
    if kind is float and saved is None:
        return math.inf
    return kind(saved) if kind in (int, float) else saved


def _fields(kind: Any, saved: Saved, *names: str) -> dict[str, Any]:
    """Fields of a dataclass from entries of the same names, all or `names`; the others keep their defaults."""
    hints = _hints(kind)
    return {name: _value(hints[name], saved[name]) for name in names or hints if name in saved}


def _restore(content: Saved) -> Equations:
    diagnostics = content["diagnostics"]
    data = {name: value for name, value in content["data"].items() if value is not None}
    roles = Roles.parse(data["chains"], inputs=data["inputs"])
    check_content(content, roles.chains)
    names = [TIME, *data["inputs"], *(name for chain in roles.chains for name in chain.names)]
    for name in names:
        check_name(name.removesuffix(NEXT), "channels")
    equations = [_restored_equation(content, k, chain, names) for k, chain in enumerate(roles.chains)]
    files = [data["file"]] if isinstance(data["file"], str) else data["file"]
    summary = DataSummary(**_fields(DataSummary, {**data, "files": files, "sensors": data}))
    late = {name: lag.prior_sd for name, lag in summary.sensors.lags.items()}
    check_sensors({**summary.sensors.noise, **summary.sensors.of_reading}, summary.sensors.gain_sd, roles, late)
    if summary.band is not None and not summary.band[0] < summary.band[1]:
        raise ValueError("a band of {!r} to {!r} Hz".format(*summary.band))
    noted = ("dropped", "warnings", "constraints", "scores", "refined")
    found = Equations(
        equations=EquationTuple(equations),
        data=summary,
        **_fields(Equations, content, "method"),
        **_fields(Equations, data, "inputs", "dictionary", "smooth"),
        **_fields(Equations, {**diagnostics, "dropped": diagnostics["dropped_terms"]}, *noted),
        hidden=tuple(
            HiddenState(one["state"], _log_odds(one, roles.states), one.get("stated", True))
            for one in content.get("hidden", ())
        ),
    )
    bounds = [one.bounds for one in found.known()]  # constraints that cannot be read are damage
    found = replace(found, equations=EquationTuple(map(_bounded, found.equations, bounds)))
    for equation in found:
        _check_restored(equation)
    return found


def _log_odds(saved: Saved, states: Sequence[str]) -> float:
    """Log odds without a hidden state; null is -inf if the equations have the state, else +inf."""
    odds: float | None = saved["log_odds_without"]
    return odds if odds is not None else -math.inf if saved["state"] in states else math.inf


def _restored_equation(content: Saved, k: int, chain: Chain, names: Sequence[str]) -> Equation:
    """Equation k, of this chain; `names` are the names of all channels, for parsing terms."""
    saved, state = content["equations"][k], content["posteriors"][k]
    checks = content["diagnostics"]["equations"][saved["target"]]
    constants = saved.get("constants", ())
    values = {one["name"]: Unknown(one["name"], one["low"], one["high"], one["value"]) for one in constants}
    terms = tuple(parse(term["name"], names).with_unknowns(values) for term in saved["terms"])
    posterior = _restored_posterior(content["method"], tuple(term.text for term in terms), saved, state, checks)
    column = partial(_column, saved["terms"])
    shown = _restored_shown(posterior, saved, state["shown"])
    law = next((term for term, entry in zip(terms, saved["terms"], strict=True) if entry["included"]), None)
    if any(one["state"] == chain.names[0] and not one.get("stated", True) for one in content.get("hidden", ())):
        chain = with_shown(replace(chain, found=True), terms, shown)
    elif chain.hidden and law is not None:
        chain = chain.with_law(law)
    return Equation(
        chain=chain,
        terms=terms,
        posterior=posterior,
        shown_posterior=shown,
        why={term["name"]: term["why"] for term in saved["terms"] if term["why"] is not None},
        share=column("share", known=True),
        bound=column("bound", known=True),
        units=content["data"].get("units", {}),
        stored=OverModels(
            averaged=column("averaged_ci95"),
            given_in=column("printed_ci95"),
            **_fields(OverModels, {"intercept": saved.get("intercept_printed_ci95")}),
        ),
        **_fields(
            Equation, saved, "verdict", "undetermined", "unit_gains", "error_probability", "tau", "constants", "forms"
        ),
        **_fields(Equation, state, "models"),
        **_fields(Equation, checks["fit"], "train", "held_out"),
        **_fields(Equation, checks, "residuals", "runners_up", "left_out"),
    )


def _restored_posterior(method: str, names: tuple[str, ...], saved: Saved, state: Saved, checks: Saved) -> Posterior:
    terms, listed, average = saved["terms"], state["average"], None
    if listed is not None:
        average = ModelAverage(
            models=np.array([_indicator(model, len(names)) for model in listed["models"]], dtype=np.bool_),
            covariance=_square(listed["covariance"]),
            **_fields(ModelAverage, listed, "probability", "left_out", "terms"),
        )
    over_models = _column(terms, "averaged_coef"), _column(terms, "averaged_sd")
    return Posterior(
        names=names,
        pip=_column(terms, "pip"),
        support=np.array([term["included"] for term in terms], dtype=np.bool_),
        coef=_column(terms, "coef"),
        n=state["n"],
        details=Details(
            method=method,
            optimum=None if state["optimum"] is None else _indicator(state["optimum"], len(names)),
            **_fields(Details, state, "n_iter", "elbo_trace"),
            **_fields(Details, checks, "converged", "slab_variance", "rhat"),
        ),
        averaged=None if any(one is None for one in over_models) else Averaged(*over_models),
        average=average,
        **_given_terms(saved, state),
    )


def _restored_shown(like: Posterior, saved: Saved, given: Saved | None) -> Posterior:
    """The posterior given the terms shown; `like`, given the included terms, if they are the same."""
    if given is None:
        return like
    terms = saved["terms"]
    return replace(
        like,
        support=np.array([term["shown"] for term in terms], dtype=np.bool_),
        coef=np.array([term["shown_coef"] if term["shown"] else 0.0 for term in terms], dtype=np.float64),
        **_given_terms(saved, given, like),
    )


def _bounded(equation: Equation, ends: Floats | None) -> Equation:
    included, shown = equation.posterior, equation.shown_posterior
    details = replace(included.details, bounds=ends)
    posterior, other = (replace(one, details=details) for one in (included, shown))
    return replace(equation, posterior=posterior, shown_posterior=posterior if shown is included else other)


def _given_terms(saved: Saved, given: Saved, like: Posterior | None = None) -> dict[str, Any]:
    """Fields of a posterior given its terms, without the coefficients; entries not saved are those of `like`."""
    left_out = None if saved.get("intercept_included", True) else (saved["intercept"], saved["intercept_sd"])
    if like is not None:
        own = like.constant
        known = {"center": own.center, "target_mean": own.mean, "target_mean_variance": own.variance}
        given = {**known, "noise_variance": like.noise_variance, **given}
    constant = Constant(
        np.array(given["center"], dtype=np.float64),
        given["target_mean"],
        given.get("target_mean_variance"),
        saved.get("intercept_pip"),
        left_out,
    )
    freedom, projected = _value(Floats | None, given.get("freedom")), None
    coef, sd = (_column(saved["terms"], f"likelihood_{name}") for name in ("coef", "sd"))
    if freedom is not None and coef is not None and sd is not None:
        share, size, lines = (saved.get(f"error_{name}") for name in ("share", "sd", "lines"))
        projected = Projected(coef, sd, freedom, share or 0.0, size or 0.0, tuple(lines or ()))
    return {
        "covariance": _square(given["covariance"]),
        "constant": constant,
        "noise_variance": given["noise_variance"],
        "projected": projected,
    }


def _square(rows: Sequence[Sequence[float]]) -> Floats:
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(rows))


def _indicator(members: Sequence[int], terms: int) -> Bools:
    out = np.zeros(terms, dtype=np.bool_)
    out[np.array(members, dtype=np.intp)] = True
    return out


def _column(terms: Sequence[Saved], name: str, known: bool = False) -> Any:
    """An entry of all terms, (P,); None if any lacks it, or with `known` if all do (NaN for those that lack it)."""
    values = [term.get(name) for term in terms]
    if values.count(None) == len(values) if known else None in values:
        return None
    return np.array(values, dtype=np.float64)


def _check_restored(equation: Equation) -> None:
    """Check that computed numbers are not too large (ValueError) and that units can be parsed (BayeqError)."""
    ends = [np.array([*equation.intercept_ci95, *equation.printed_intercept_ci95])]
    with np.errstate(all="ignore"):
        for p in (equation.posterior, equation.shown_posterior):
            ends.append(np.abs([*p.coef, p.intercept]) + Z95 * np.array([*p.sd, p.intercept_sd]))
            ends.append(np.array([0.0 if math.isfinite(p.noise_variance) else math.inf]))
    if not (np.abs(np.concatenate(ends)) <= LARGEST).all():
        raise ValueError(f"the equation of {equation.target} has numbers too large or too small to compute with")
    assert len(equation.coef_units) == len(equation.terms)
