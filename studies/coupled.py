"""Coupled oscillators: three masses with a cubic spring, five storeys on shaken ground, and ten masses.

Three unit masses in a row, springs of 400 between neighbours and to both walls, a damper of 0.6 beside each, a cubic
spring force 4e4 (x1 - x2)^3; a force of sd 20 up to 12 Hz on the first. Five unit masses one above the other on
springs of 900 and dampers of 1; the ground's acceleration, of sd 3 up to 10 Hz, is measured; displacements and
accelerations are relative to the ground. From rest, 1,500 rows at 200 Hz, all used, taken from a simulation ten times
as fine; 5 % noise on all channels. Exact: the terms of the expanded equations, springs and dampers as x_i and dx_i,
and no constant.

Ten unit masses like the three, without the cubic spring: 3,000 rows, of which discovery holds some out, displacements,
velocities and accelerations. The candidates are these states and the differences of neighbours, of which the first and
the last mass need any two of three. Exact: the shown terms are as few as possible, and can say the law.

    python -m studies.coupled > docs/tables/coupled.csv
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equation import Equation
from bayeq.records import Record
from bayeq.systems import BandLimitedForce, System, simulate
from bayeq.systems.simulate import band_limited_noise
from studies.judge import Truth, judged, rates, timed
from studies.resumable import Cell, Outcome, run_study

__all__ = ["CASES", "draw_record", "main"]

ROWS, RATE, FINER = 1500, 200.0, 10
NOISE = 0.05
RECORDS = 20

MASSES = System(
    name="three-masses",
    title="Three masses in a row, a cubic spring between the first two",
    chains=("x1:dx1:a1", "x2:dx2:a2", "x3:dx3:a3"),
    rhs={
        "x1": "dx1",
        "dx1": "u-800*x1+400*x2-1.2*dx1+0.6*dx2-40000*(x1-x2)**3",
        "x2": "dx2",
        "dx2": "400*x1-800*x2+400*x3+0.6*dx1-1.2*dx2+0.6*dx3+40000*(x1-x2)**3",
        "x3": "dx3",
        "dx3": "400*x2-800*x3+0.6*dx2-1.2*dx3",
    },
    terms={
        "a1": {"x1": "-800", "x2": "400", "dx1": "-1.2", "dx2": "0.6", "(x1-x2)**3": "-40000", "u": "1"},
        "a2": {
            "x1": "400",
            "x2": "-800",
            "x3": "400",
            "dx1": "0.6",
            "dx2": "-1.2",
            "dx3": "0.6",
            "(x1-x2)**3": "40000",
        },
        "a3": {"x2": "400", "x3": "-800", "dx2": "0.6", "dx3": "-1.2"},
    },
    parameters={},
    initial=dict.fromkeys(("x1", "dx1", "x2", "dx2", "x3", "dx3"), 0.0),
    inputs=("u",),
    force=BandLimitedForce(std=20.0, band=(0.0, 12.0)),
    n=ROWS,
    fs=RATE,
    noise=NOISE,
    citation="made for this study",
)
MASSES_TERMS = (
    "u",
    *(f"{state}{i}{power}" for power in ("", "**2", "**3") for state in ("x", "dx") for i in (1, 2, 3)),
    *(f"dx{i}*abs(dx{i})" for i in (1, 2, 3)),
    "(x1-x2)**3",
    "(x2-x3)**3",
    "(dx1-dx2)**3",
)

STOREYS = 5


def _storeys() -> System:
    rhs, terms = {}, {}
    for i in range(1, STOREYS + 1):
        top = i == STOREYS
        own: dict[str, str] = {}
        for state, gain in (("x", 900), ("dx", 1)):
            own[f"{state}{i}"] = str(-gain if top else -2 * gain)
            if i > 1:
                own[f"{state}{i - 1}"] = str(gain)
            if not top:
                own[f"{state}{i + 1}"] = str(gain)
        own["ag"] = "-1"
        rhs[f"x{i}"] = f"dx{i}"
        rhs[f"dx{i}"] = "+".join(f"({value})*{name}" for name, value in own.items())
        terms[f"a{i}"] = own
    return System(
        name="five-storeys",
        title="Five storeys on shaken ground",
        chains=tuple(f"x{i}:dx{i}:a{i}" for i in range(1, STOREYS + 1)),
        rhs=rhs,
        terms=terms,
        parameters={},
        initial=dict.fromkeys(rhs, 0.0),
        inputs=("ag",),
        force=BandLimitedForce(std=3.0, band=(0.0, 10.0)),
        n=ROWS,
        fs=RATE,
        noise=NOISE,
        citation="made for this study",
    )


FLOORS = range(1, STOREYS + 1)
STOREYS_TERMS = (
    "ag",
    *(f"{state}{i}{power}" for power in ("", "**3") for state in ("x", "dx") for i in FLOORS),
    *(f"dx{i}*abs(dx{i})" for i in FLOORS),
)

TEN = range(1, 11)


def _ten() -> System:
    rhs, terms = {}, {}
    for i in TEN:
        own = {"u": 1.0} if i == 1 else {}
        for state, gain in (("x", 400.0), ("dx", 0.6)):
            own[f"{state}{i}"] = -2.0 * gain
            own |= {f"{state}{k}": gain for k in (i - 1, i + 1) if k in TEN}
        rhs[f"x{i}"] = f"dx{i}"
        rhs[f"dx{i}"] = "+".join(f"({value!r})*{name}" for name, value in own.items())
        terms[f"a{i}"] = {name: repr(value) for name, value in own.items()}
    return replace(
        MASSES,
        name="ten-masses",
        title="Ten masses in a row",
        chains=tuple(f"x{i}:dx{i}:a{i}" for i in TEN),
        rhs=rhs,
        terms=terms,
        initial=dict.fromkeys(rhs, 0.0),
        n=2 * ROWS,
    )


TEN_TERMS = (
    "u",
    *(f"{state}{i}-{state}{i + 1}" for state in ("x", "dx") for i in TEN[:-1]),
    *(f"{state}{i}" for state in ("x", "dx") for i in TEN),
)

# System, chains that are measured, terms, by the name of the case.
CASES = {
    "three masses, displacements": (MASSES, [f"x{i}::" for i in (1, 2, 3)], MASSES_TERMS),
    "three masses, displacements and accelerations": (MASSES, [f"x{i}::a{i}" for i in (1, 2, 3)], MASSES_TERMS),
    "five storeys, displacements and accelerations": (_storeys(), [f"x{i}::a{i}" for i in FLOORS], STOREYS_TERMS),
    "ten masses, all states": (_ten(), [f"x{i}:dx{i}:a{i}" for i in TEN], TEN_TERMS),
}


def draw_record(system: System, seed: int) -> Record:
    """A noisy record, from a finer simulation."""
    assert system.force is not None
    rate, rows = RATE * FINER, system.n * FINER
    force = band_limited_noise(system.force, rows, rate, np.random.default_rng([seed, system.n]))
    return simulate(system, fs=rate, seed=seed, noise=NOISE, force=force).slice(0, None, FINER)


def said(eqs: Iterable[Equation], truth: Truth) -> dict[str, Any]:
    """`judged` for the shown terms of ten masses, in the form of the law that these can say."""
    terms, wrong = {}, []
    for eq, true in zip(eqs, truth.values(), strict=True):
        parts = [name.split("-") for name in eq.shown]  # a state, or the difference of two
        names = sorted({*true, *(name for part in parts for name in part)})
        columns = np.array([[(name == part[0]) - float(name in part[1:]) for part in parts] for name in names])
        law = np.array([true.get(name, 0.0) for name in names])
        values, _, rank, _ = np.linalg.lstsq(columns, law, rcond=None)
        fewest = 4 + ("u" in true)
        if rank != len(parts) or len(parts) != fewest or not np.allclose(columns @ values, law) or eq.intercept_matters:
            wrong.append(f"{eq.target}: {', '.join(eq.shown)}")
            continue
        for name, value in zip(eq.shown, values.tolist(), strict=True):
            k = eq.posterior.names.index(name)
            low, high = eq.shown_ci95[k].tolist()
            sd = float(eq.shown_posterior.sd[k])
            terms[f"{eq.target} {name}"] = [eq.shown_coef[name] - value, sd, low <= value <= high]
    return {"exact": not wrong, "terms": terms, "wrong": wrong}


def _measure(case: str, seed: int) -> Outcome:
    system, chains, terms = CASES[case]
    full = draw_record(system, seed)
    assert full.truth is not None
    truth = full.truth.coefficients
    measured = [name for chain in chains for name in chain.split(":") if name]
    record = Record.from_arrays({name: full[name] for name in (*measured, *system.inputs)}, time=full.time)
    ten = system.name == "ten-masses"
    holdout = 0.2 if ten else 0.0
    fit = partial(discover, record, chains=chains, inputs=list(system.inputs), dictionary=terms, holdout=holdout)
    return timed(fit, lambda eqs: (said if ten else judged)(eqs, truth))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    yield rates(outcomes)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [Cell({"case": case, "method": "auto"}, RECORDS, partial(_measure, case)) for case in CASES]
    run_study("coupled", "Exact rates of coupled oscillators.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
