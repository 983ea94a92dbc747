"""Records of systems whose terms the dictionary holds: does the verdict cry wolf, and are its tests exact?

The paper's four oscillators (all channels, 4,000 rows, parameters times 1 + 0.1 x standard normal), and from their
states alone Lorenz, Van der Pol and Lotka-Volterra as in `studies.states_only`, with noise of 1 to 5 % drawn for each
record. The last fifth of the rows is held out. Lines of the table: verdicts, exact answers among those found, and
Kolmogorov and Smirnov's test that the probabilities of the innovations' octaves are uniform.

    python -m studies.verdicts > docs/tables/verdicts.csv
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from scipy.stats import kstest

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.equation.verdict import KINDS
from bayeq.records import Record
from bayeq.systems import get_system, simulate
from studies import states_only
from studies.judge import judged, timed
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["draw_record", "main"]

OSCILLATORS = ("linear", "duffing", "quadratic", "coulomb")

# Seconds of the systems that are known by their states.
STATES = {"lorenz": 10.0, "vanderpol": 12.0, "lotka-volterra": 20.0}

RECORDS = 60
PERTURBED = 0.1
NOISE = (0.01, 0.05)


def draw_record(system: str, seed: int) -> Record:
    """A noisy record."""
    noise = float(np.random.default_rng([seed, 2]).uniform(*NOISE))
    if system in STATES:
        return states_only.draw_record(system, STATES[system], noise, seed)
    return simulate(get_system(system), seed=seed, noise=noise, perturb=PERTURBED)


def _judged(record: Record, eqs: Equations) -> dict[str, object]:
    assert record.truth is not None
    fit = eqs[0].fit
    adequacy = None if fit is None or fit.regression.record is None else fit.regression.record.adequacy
    return {
        **judged(eqs, record.truth.coefficients),
        "verdict": eqs.verdict.kind,
        "reason": eqs.verdict.reason,
        "octaves": [] if adequacy is None else [round(one.p, 6) for one in adequacy.octaves],
        "discrepancies": [] if adequacy is None else [round(one.p, 6) for one in adequacy.discrepancies],
    }


def _measure(system: str, seed: int) -> Outcome:
    record = draw_record(system, seed)
    if system in STATES:
        dictionary = f"polynomial:{states_only.ORDERS[system]}"
        fit = partial(discover, record, chains=list(record.names), dictionary=dictionary)
    else:
        fit = partial(discover, record, displacement="x", velocity="v", acceleration="a", force="u")
    return timed(fit, partial(_judged, record))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    known = [outcome for outcome in outcomes if outcome["cpu"] is not None]
    found = [outcome for outcome in known if outcome["verdict"] == "found"]
    octaves = [p for outcome in known for p in outcome["octaves"]]
    discrepancies = [p for outcome in known for p in outcome["discrepancies"]]
    yield {
        "exact": sum(outcome["exact"] for outcome in known),
        **{kind.replace(" ", "_"): sum(outcome["verdict"] == kind for outcome in known) for kind in KINDS},
        "found_percent": percent(len(found), len(outcomes)),
        "exact_of_found_percent": percent(sum(outcome["exact"] for outcome in found), len(found)),
        "errors": len(outcomes) - len(known),
        "octaves": len(octaves),
        "octaves_below_1_percent": percent(sum(p < 0.01 for p in octaves), len(octaves)),
        "uniform_p": f"{kstest(octaves, 'uniform').pvalue:.3g}" if octaves else "",
        "discrepancies_below_1_percent": percent(sum(p < 0.01 for p in discrepancies), len(discrepancies)),
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [Cell({"system": system}, RECORDS, partial(_measure, system)) for system in (*OSCILLATORS, *STATES)]
    run_study("verdicts", "Verdicts on systems whose terms the dictionary holds.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
