"""Adverse records: what is found where sensors fail, noise is not white, and the equation is not quite the truth.

One Duffing oscillator (`studies.adverse_records`), chain x:v:a, input u, the default dictionary. Exact: the included
terms are the true ones among those offered. The last fifth of the rows is held out, as by default.

    python -m studies.adverse > docs/tables/adverse.csv

Records of 70,000 and 1,000,000 rows are measured where they are asked for: ``--only "second force of 10 % 70000"``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from studies.adverse_records import CASES, Case, draw_record
from studies.judge import judged, timed, verdicts
from studies.resumable import Cell, Outcome, percent, run_study

RECORDS, LONG_RECORDS = 20, 3

# A term whose probability exceeds this is stated as certain.
CERTAIN = 0.99


def judged_with_verdict(truth: Mapping[str, Mapping[str, float]], eqs: Equations) -> dict[str, Any]:
    """The judgement of an answer with its certain and false terms, verdict and number of warnings."""
    false = sum(
        1
        for eq in eqs
        for term, pip in zip(eq.terms, eq.posterior.pip, strict=True)
        if pip > CERTAIN and term.text not in truth[eq.target]
    )
    return {**judged(eqs, truth), "false": false, "verdict": eqs.verdict.kind, "warnings": len(eqs.warnings)}


def _measure(case: Case, rows: int, seed: int) -> Outcome:
    record, terms = draw_record(case, rows, seed), case.terms
    assert record.truth is not None
    truth = {
        target: {name: value for name, value in own.items() if name in terms}
        for target, own in record.truth.coefficients.items()
    }
    dictionary = terms if case.without else "oscillator"
    fit = partial(discover, record, chains="x:v:a", inputs=["u"], dictionary=dictionary)
    outcome = timed(fit, partial(judged_with_verdict, truth))
    return {**outcome, "true": sum(map(len, truth.values()))}


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    n = len(outcomes)
    answered = [outcome for outcome in outcomes if outcome["cpu"] is not None]
    covers = [bool(term[2]) for outcome in answered for term in outcome["terms"].values()]
    certain = [outcome for outcome in answered if outcome["false"]]

    def mean(name: str) -> str:
        return f"{np.mean([outcome[name] for outcome in answered]):.2f}" if answered else ""

    yield {
        "exact": sum(outcome["exact"] for outcome in outcomes),
        "true_terms_included": f"{np.mean([len(outcome['terms']) for outcome in outcomes]):.2f}",
        "of": outcomes[0]["true"],
        "certain_false_terms": mean("false"),
        "with_certain_false_percent": percent(len(certain), n),
        "intervals": len(covers),
        "coverage_percent": percent(sum(covers), len(covers)),
        **verdicts(outcomes),
        "errors": n - len(answered),
        "warned_of_certain_false_percent": percent(sum(one["verdict"] != "found" for one in certain), n),
        "warnings": mean("warnings"),
        "median_cpu_seconds": f"{np.median([outcome['cpu'] for outcome in answered]):.2f}" if answered else "",
    }


def _cells() -> Iterator[Cell]:
    for line, case in CASES.items():
        for rows in case.rows:
            yield Cell({"line": line, "rows": rows}, RECORDS, partial(_measure, case, rows))
        for rows in case.on_request:
            yield Cell({"line": line, "rows": rows}, LONG_RECORDS, partial(_measure, case, rows), on_request=True)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    run_study("adverse", "What is found in adverse records.", list(_cells()), _summary, arguments)


if __name__ == "__main__":
    main()
