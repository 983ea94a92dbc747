"""Parameters of known models from noisy states: do 95 % intervals cover, and is the bias small beside the stated sd?

Logistic growth, Lotka-Volterra, FitzHugh-Nagumo and Hindmarsh-Rose as in Bortz, Messenger and Dukic (2023), which
WENDy's later studies took over (arXiv 2502.08881, 2510.03365): their parameters, initial states and spans of time, at
512 samples. Noise on every state, in per cent of its own standard deviation. The dictionary holds the true terms of
all equations of a system. Exact: the true terms in each equation, and the constant where there is one; intervals
are those of the equations that are.

    python -m studies.known_terms > docs/tables/known_terms.csv
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from bayeq.discovery import discover
from bayeq.records import Record
from bayeq.systems import System, simulate
from studies.judge import CONSTANT, coefficient_lines, judged, timed
from studies.resumable import Cell, Outcome, run_study

__all__ = ["SYSTEMS", "draw_record", "main"]

ROWS = 512
NOISES = (0.01, 0.05, 0.1, 0.2)
RECORDS = 40

WENDY = "D. M. Bortz, D. A. Messenger, V. Dukic, Bull. Math. Biol. 85 (2023) 110"


def _system(
    name: str, terms: Mapping[str, Mapping[str, float]], initial: Mapping[str, float], span: float, substeps: int
) -> System:
    """A system of first-order equations from its coefficients."""
    return System(
        name=name,
        title=name,
        chains=tuple(terms),
        rhs={state: "+".join(f"({value!r})*{term}" for term, value in own.items()) for state, own in terms.items()},
        terms={f"d{state}": {term: repr(value) for term, value in own.items()} for state, own in terms.items()},
        parameters={},
        initial=initial,
        n=ROWS,
        fs=(ROWS - 1) / span,
        noise=NOISES[0],
        substeps=substeps,
        citation=WENDY,
    )


SYSTEMS = {
    "logistic": _system("logistic", {"x": {"x": 1.0, "x**2": -1.0}}, {"x": 0.01}, 10.0, 4),
    "lotka-volterra": _system(
        "lotka-volterra",
        {"x": {"x": 3.0, "x*y": -1.0}, "y": {"y": -6.0, "x*y": 1.0}},
        {"x": 1.0, "y": 1.0},
        5.0,
        4,
    ),
    "fitzhugh-nagumo": _system(
        "fitzhugh-nagumo",
        {"x": {"x": 3.0, "x**3": -3.0, "y": 3.0}, "y": {CONSTANT: 17 / 150, "x": -1 / 3, "y": 1 / 15}},
        {"x": 0.0, "y": 0.1},
        25.0,
        20,
    ),
    "hindmarsh-rose": _system(
        "hindmarsh-rose",
        {
            "x": {"y": 10.0, "x**3": -10.0, "x**2": 30.0, "z": -10.0},
            "y": {CONSTANT: 10.0, "x**2": -50.0, "y": -10.0},
            "z": {"x": 0.04, CONSTANT: 0.0319, "z": -0.01},
        },
        {"x": -1.31, "y": -7.6, "z": -0.2},
        10.0,
        40,
    ),
}


def draw_record(system: str, noise: float, seed: int) -> Record:
    """A noisy record."""
    return simulate(SYSTEMS[system], seed=seed, noise=noise)


def _measure(system: str, noise: float, seed: int) -> Outcome:
    record = draw_record(system, noise, seed)
    assert record.truth is not None
    truth = record.truth.coefficients
    candidates = {term: None for own in truth.values() for term in own if term != CONSTANT}
    fit = partial(discover, record, chains=list(record.names), dictionary=list(candidates), holdout=0.0)
    return timed(fit, lambda eqs: judged(eqs, truth))


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"system": system, "noise_percent": 100 * noise}, RECORDS, partial(_measure, system, noise))
        for system in SYSTEMS
        for noise in NOISES
    ]
    run_study("known_terms", "Coverage and bias where the terms are known.", cells, coefficient_lines, arguments)


if __name__ == "__main__":
    main()
