"""The numbers that equations show, over records of many kinds (`studies.numbers_records`): how far off, how sure?

`discover` is asked as a user would, by default settings. A coefficient that is not shown counts as 0 in relative
errors, and has no part in coverage and in rms errors in standard deviations. Found and wrong: the verdict is "found",
and the included terms are not the true ones, or a number shown is off by more than five of the standard deviations
that its printed interval stands for.

    python -m studies.numbers_study > docs/tables/numbers.csv

Other noise ratios of the systems of the paper are measured where they are asked for, by a part of their labels:
``--only "paper duffing free x:: 2 true"``. Another program answers the same records with its ``src`` first on
PYTHONPATH, and a ``--store`` of its own; lines of a store bear the commit of the ``src`` that answered.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equation import Equation
from bayeq.equation.equations import Equations
from bayeq.errors import InputError
from bayeq.numerics.distributions import Z95
from studies import numbers_records as kinds
from studies.adverse import judged_with_verdict
from studies.judge import CONSTANT, timed, verdicts
from studies.numbers_records import Drawn
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["main"]

RECORDS = 10

# A printed number that is off by more than this, in standard deviations, is wrong.
FAR = 5.0


def _shown_numbers(eq: Equation) -> dict[str, list[float]]:
    """Estimate, standard deviation and printed interval of everything shown."""
    p = eq.shown_posterior
    # what is printed was once always `shown_ci95`
    intervals = getattr(eq, "printed_ci95", eq.shown_ci95)
    shown = {
        term.text: [float(p.coef[k]), float(p.sd[k]), *map(float, intervals[k])]
        for k, term in enumerate(eq.terms)
        if p.support[k]
    }
    if eq.intercept_matters:
        interval = getattr(eq, "printed_intercept_ci95", eq.intercept_ci95)
        shown[CONSTANT] = [*map(float, (eq.shown_model.intercept, eq.shown_model.intercept_sd)), *map(float, interval)]
    return shown


def _judged(truth: Mapping[str, Mapping[str, float]], eqs: Equations) -> dict[str, Any]:
    """The usual judgement, and of every true term what is shown of it and its true coefficient."""
    numbers = {}
    for eq in eqs:
        shown = _shown_numbers(eq)
        for name, value in truth[eq.target].items():
            numbers[f"{eq.target} {name}"] = [*shown.get(name, [0.0] * 4), value]
    return {**judged_with_verdict(truth, eqs), "numbers": numbers}


def _measure(draw: Callable[[int], Drawn], seed: int) -> Outcome:
    """A question that is refused, as records that are too short may be, counts among the errors."""
    records, question, truth = draw(seed)
    try:
        return timed(partial(discover, records, **question), partial(_judged, truth))
    except InputError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return {"exact": False, "terms": {}, "wrong": [f"{type(error).__name__}: {error}"], "cpu": None}


# --- what a cell's line says -----------------------------------------------------------------------------------------


def _far(numbers: Mapping[str, Sequence[float]]) -> bool:
    """Whether a number shown is off by more than five standard deviations of its printed interval."""
    return any(
        abs(estimate - true) > FAR * (high - low) / (2.0 * Z95)
        for estimate, sd, low, high, true in numbers.values()
        if sd > 0.0
    )


def _z(numbers: Sequence[Sequence[float]]) -> list[float]:
    """Errors in standard deviations, of what is shown."""
    return [(estimate - true) / sd for estimate, sd, _, _, true in numbers if sd > 0.0]


def _rms(values: Sequence[float]) -> str:
    return f"{np.sqrt(np.mean(np.square(values))):.2f}" if values else ""


def _relative(numbers: Sequence[Sequence[float]]) -> str:
    """Median and 90th percentile of sizes of relative errors, in per cent."""
    off = [100.0 * abs(one[0] / one[4] - 1.0) for one in numbers]
    return "/".join(f"{value:.3g}" for value in np.quantile(off, [0.5, 0.9]))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    answered = [outcome for outcome in outcomes if outcome["cpu"] is not None]
    by_name: dict[str, list[Sequence[float]]] = {}
    for outcome in answered:
        for name, one in outcome["numbers"].items():
            by_name.setdefault(name, []).append(one)
    # the target is the same in most questions
    targets = {name.partition(" ")[0] for name in by_name}
    if len(targets) == 1:
        by_name = {name.partition(" ")[2]: numbers for name, numbers in by_name.items()}
    z = {name: _z(numbers) for name, numbers in by_name.items()}
    everything = [one for numbers in by_name.values() for one in numbers]
    shown = [one for one in everything if one[1] > 0.0]
    worst = max((name for name in z if z[name]), key=lambda name: float(np.mean(np.square(z[name]))), default="")
    found = [outcome for outcome in answered if outcome["verdict"] == "found"]
    yield {
        "exact": sum(outcome["exact"] for outcome in outcomes),
        **verdicts(outcomes),
        "found_and_wrong": sum(not one["exact"] or _far(one["numbers"]) for one in found),
        "certain_false_terms": sum(outcome["false"] for outcome in answered),
        "errors": len(outcomes) - len(answered),
        "rms_z": _rms([one for values in z.values() for one in values]),
        "worst_rms_z": _rms(z.get(worst, [])),
        "worst": worst,
        "intervals": len(shown),
        "coverage_percent": percent(sum(low <= true <= high for _, _, low, high, true in shown), len(shown)),
        "relative_error_percent": "; ".join(f"{name} {_relative(numbers)}" for name, numbers in by_name.items()),
        "median_cpu_seconds": f"{np.median([one['cpu'] for one in answered]):.2f}" if answered else "",
    }


# --- cells -----------------------------------------------------------------------------------------------------------


def _cell(
    kind: str,
    case: object,
    chain: str,
    noise: float,
    dictionary: str,
    draw: Callable[[int], Drawn],
    on_request: bool = False,
) -> Cell:
    labels = {
        "kind": kind,
        "case": str(case),
        "chain": chain,
        "noise_percent": f"{100 * noise:g}",
        "dictionary": dictionary,
    }
    return Cell(labels, RECORDS, partial(_measure, draw), on_request)


SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")
CHAINS = ("x::", "x::a", "x:v:", "x:v:a", ":v:", ":v:a", "::a")

# Those of all ratios that are measured without being asked for, by whether the motion is free.
USUAL_NOISE = {False: (0.05, 0.002), True: (0.01,)}


def _paper() -> Iterator[Cell]:
    for free in (False, True):
        for system in SYSTEMS:
            for chain in CHAINS:
                for noise in (0.05, 0.02, 0.01, 0.002):
                    for name in ("true", "oscillator"):
                        case = f"{system} {'free' if free else 'forced'}"
                        draw = partial(
                            kinds.draw_paper,
                            system=system,
                            chain=chain,
                            noise=noise,
                            free=free,
                            all_terms=name == "oscillator",
                        )
                        yield _cell("paper", case, chain, noise, name, draw, noise not in USUAL_NOISE[free])


def _friction() -> Iterator[Cell]:
    for sign in ("sign(v)", "sign(x)"):
        for also in ("", "x**3", "v*abs(v)"):
            for noise in (0.01, 0.05):
                draw = partial(kinds.draw_sign_oscillator, sign=sign, also=also, noise=noise)
                case = f"{sign} and {also}" if also else sign
                yield _cell("sign_oscillator", case, "x::", noise, "7 terms", draw)
    yield _cell("stribeck", "forced", "x::", 0.02, "true", partial(kinds.draw_stribeck, noise=0.02))
    yield _cell("pendulum", "4096 lines", "th::", 0.0, "true", kinds.draw_pendulum)
    for rate in (100.0, 250.0, 500.0, 1000.0):
        for loop in (rate, 2000.0):
            draw = partial(kinds.draw_drive, rate=rate, loop=loop)
            yield _cell("drive", f"{rate:g} Hz of a loop of {loop:g} Hz", "q::", 0.0, "4 terms", draw)


def _first_order() -> Iterator[Cell]:
    for lag in (0.0, 2.0, 5.0, 10.0, 20.0):
        yield _cell("heater", f"lag {lag:g} s", "T", 0.1 / 31, "polynomial:1", partial(kinds.draw_heater, lag=lag))
    for rows in (26, 40, 60, 0):
        case = f"{rows} rows" if rows else "pooled"
        yield _cell("growth", case, "N", 0.05, "polynomial:2", partial(kinds.draw_growth, rows=rows))
    for system, known in kinds.SETTLING.items():
        for noise, rows in ((0.01, 400), (0.02, 300), (0.03, 200)):
            draw = partial(kinds.draw_settling, system=system, noise=noise, rows=rows)
            yield _cell("settling", system, " ".join(known.terms), noise, f"polynomial:{known.degree}", draw)


def _others() -> Iterator[Cell]:
    for noise in (1e-3, 3e-4, 1e-4):
        yield _cell("circuit", "low-pass", "y::", noise, "true", partial(kinds.draw_circuit, noise=noise))
    for zeta in (0.02, 0.2):
        for noise in (0.003, 0.01, 0.03):
            for name in ("true", "oscillator"):
                draw = partial(kinds.draw_ringdown, zeta=zeta, noise=noise, all_terms=name == "oscillator")
                yield _cell("ringdown", f"zeta {zeta:g}", "::a", noise, name, draw)
    for slow in (True, False):
        for share in (0.1, 0.3):
            for noise in (0.005, 0.05):
                case = f"{100 * share:g} % {'with memory 0.998' if slow else 'to 15 Hz'}"
                draw = partial(kinds.draw_second_force, slow=slow, share=share, noise=noise)
                yield _cell("second_force", case, "x:v:a", noise, "oscillator", draw)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [*_friction(), *_first_order(), *_others(), *_paper()]
    run_study("numbers_study", "The numbers that equations show.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
