"""Does the search reach the evidence of the true terms? Oscillators with sign(x) or sign(v), displacement measured.

    python -m studies.evidence > docs/tables/evidence.csv

The same record is fitted with a dictionary of seven terms and with one of its true terms alone. The evidence of the
answer, without the prior of its model, is no lower in the larger dictionary than among the true terms, which are one of
its models: where it is lower the search ended too early, or elsewhere.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np

from bayeq.discovery import discover
from bayeq.errors import BayeqWarning
from bayeq.likelihood.model import of_motion
from bayeq.likelihood.record_fit import RecordFit
from studies.numbers_records import draw_sign_oscillator
from studies.resumable import Cell, Outcome, run_study

# Of each of the twelve kinds.
RECORDS = 9

# Differences below this are those of fits that have converged [nats].
LOWER = 2.0


def evidence_of(record: Any, question: Mapping[str, Any]) -> float:
    """ln p(motion | inputs, model) of the answer: inputs may be noisy in one fit only."""
    found: list[RecordFit] = []
    of = RecordFit.of

    def kept(*arguments: Any) -> RecordFit:
        found.append(of(*arguments))
        return found[-1]

    with patch.object(RecordFit, "of", kept), warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        discover(record, **question, holdout=0.0)
    task, fitted = found[-1].task, found[-1].fitted
    return of_motion(task, fitted) - task.prior(fitted.model)


def _measure(draw: Any, seed: int) -> Outcome:
    record, question, truth = draw(seed)
    alone = {**question, "dictionary": tuple(truth["ddx"])}
    return {"more": evidence_of(record, question) - evidence_of(record, alone)}


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    more = np.array([outcome["more"] for outcome in outcomes])
    yield {
        "lower": int((more < -LOWER).sum()),
        "least": f"{more.min():.1f}",
        "median": f"{np.median(more):.1f}",
        "most": f"{more.max():.1f}",
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell(
            {"terms": f"{sign}{' and ' if also else ''}{also}", "noise_percent": f"{100 * noise:g}"},
            RECORDS,
            partial(_measure, partial(draw_sign_oscillator, sign=sign, also=also, noise=noise)),
        )
        for sign in ("sign(v)", "sign(x)")
        for also in ("", "x**3", "v*abs(v)")
        for noise in (0.01, 0.05)
    ]
    run_study("evidence", "Evidence of answers against that of the true terms.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
