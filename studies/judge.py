"""An answer beside the truth: are the terms exactly the true ones, and do the intervals cover?"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayeq.equation.equation import Equation
from bayeq.equation.equations import Equations
from bayeq.errors import BayeqError, BayeqWarning, InputError
from bayeq.study.cells import CONSTANT
from studies.resumable import Outcome, percent

Truth = Mapping[str, Mapping[str, float]]

# In the order of the columns.
VERDICTS = ("found", "nearly true", "not determined", "none")


def judged(eqs: Iterable[Equation], truth: Truth) -> dict[str, Any]:
    """What is kept of an answer.

    Parameters
    ----------
    eqs : iterable of Equation
        The answer.
    truth : mapping of str to mapping of str to float
        Target -> term -> coefficient, the constant under `CONSTANT`.

    Returns
    -------
    dict
        ``exact``: the included terms of every equation are the true ones, and the constant is written where it is one
        of them and nowhere else. ``terms``: by "target term" the error, the stated sd and whether the 95 % interval
        covers, for true terms that are included. ``wrong``: "+term" and "-term" of an equation that is not exact.
    """
    terms, wrong = {}, []
    for eq, true in zip(eqs, truth.values(), strict=True):
        posterior = eq.posterior
        found = {
            t.text: (float(c), float(s), float(low), float(high))
            for t, c, s, (low, high), kept in zip(
                eq.terms, posterior.coef, posterior.sd, eq.ci95, posterior.support, strict=True
            )
            if kept
        }
        if eq.intercept_matters:
            found[CONSTANT] = (eq.shown_model.intercept, eq.shown_model.intercept_sd, *eq.intercept_ci95)
        wrong += [f"{eq.target}: +{name}" for name in found if name not in true]
        wrong += [f"{eq.target}: -{name}" for name in true if name not in found]
        for name, value in true.items():
            if name in found:
                estimate, sd, low, high = found[name]
                terms[f"{eq.target} {name}"] = [estimate - value, sd, bool(low <= value <= high)]
    return {"exact": not wrong, "terms": terms, "wrong": wrong}


def timed(discover: Callable[[], Equations], judge: Callable[[Equations], Mapping[str, Any]]) -> Outcome:
    """The judgement of an answer, and the seconds of CPU that the answer took.

    An error is an answer that is wrong, unless it says that the study does not ask properly.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        start = time.process_time()
        try:
            eqs = discover()
        except InputError:
            raise
        except (BayeqError, np.linalg.LinAlgError) as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
            return {"exact": False, "terms": {}, "wrong": [f"{type(error).__name__}: {error}"], "cpu": None}
        cpu = time.process_time() - start
        return {**judge(eqs), "cpu": cpu}


def rates(outcomes: Sequence[Outcome]) -> dict[str, object]:
    """Exact answers, the standard error of their rate, coverage of intervals in exact answers, and CPU seconds."""
    n, exact = len(outcomes), [outcome for outcome in outcomes if outcome["exact"]]
    share = len(exact) / n
    covers = [bool(term[2]) for outcome in exact for term in outcome["terms"].values()]
    cpu = [outcome["cpu"] for outcome in outcomes if outcome["cpu"] is not None]
    return {
        "exact": len(exact),
        "exact_percent": percent(len(exact), n),
        "se_percent": f"{100 * math.sqrt(share * (1 - share) / n):.1f}",
        "intervals": len(covers),
        "covering": sum(covers),
        "coverage_percent": percent(sum(covers), len(covers)),
        "errors": n - len(cpu),
        "median_cpu_seconds": f"{np.median(cpu):.2f}" if cpu else "",
    }


def with_verdict(truth: Truth, eqs: Equations) -> dict[str, Any]:
    """`judged`, and the verdict."""
    return {**judged(eqs, truth), "verdict": eqs.verdict.kind}


def verdicts(outcomes: Sequence[Outcome]) -> dict[str, object]:
    """How many answers have each verdict."""
    kinds = [one["verdict"] for one in outcomes if one["cpu"] is not None]
    return {kind.replace(" ", "_"): kinds.count(kind) for kind in VERDICTS}


def verdict_lines(outcomes: Sequence[Outcome]) -> Iterator[dict[str, object]]:
    """A line of `rates`, of `verdicts`, and of answers that are found and wrong."""
    wrong = sum(one["cpu"] is not None and one["verdict"] == "found" and not one["exact"] for one in outcomes)
    yield {**rates(outcomes), **verdicts(outcomes), "found_and_wrong": wrong}


def coefficient_lines(outcomes: Sequence[Outcome]) -> list[dict[str, object]]:
    """Lines for all coefficients of equations with exactly the true terms together, and for each: coverage, and bias.

    ``exact`` counts answers of which every equation is exact, ``intervals`` those of the equations that are.
    """
    exact = sum(outcome["exact"] for outcome in outcomes)
    found: dict[str, list[Sequence[float]]] = {}
    for outcome in outcomes:
        wrong = {text.partition(":")[0] for text in outcome["wrong"]}
        for name, term in outcome["terms"].items():
            if name.partition(" ")[0] not in wrong:
                found.setdefault(name, []).append(term)
    together = _line("all", [term for terms in found.values() for term in terms], exact, bias=False)
    return [together, *(_line(name, found[name], exact, bias=True) for name in sorted(found))]


def _line(name: str, terms: Sequence[Sequence[float]], exact: int, bias: bool) -> dict[str, object]:
    error, sd, covers = (np.array([term[i] for term in terms]) for i in range(3))
    known = len(terms) > 0
    return {
        "exact": exact,
        "coefficient": name,
        "intervals": len(terms),
        "covering": int(covers.sum()),
        "coverage_percent": percent(int(covers.sum()), len(terms)),
        "bias_over_sd": f"{error.mean() / sd.mean():.2f}" if bias and known else "",
        "rms_error_over_sd": f"{np.sqrt(np.mean((error / sd) ** 2)):.2f}" if known else "",
    }
