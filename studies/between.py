"""What is known between equations and records: ties that hold and that do not, and coefficients that differ by record.

    python -m studies.between --first-seed 320000 > docs/tables/between.csv

Two masses on springs, whose ratio of masses is told, rightly or twice as large; three records of a Duffing oscillator,
whose mass in the third is another one, or the same. Parameters are drawn; every channel has 2 % of noise. Exact is an
answer with the true terms: of ties that do not hold one without the tie, of records their differences too. The ratio is
that of the coupling's standard deviation with the tie to the better of those of the two equations without.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from bayeq.arrays import Floats
from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.errors import BayeqWarning
from bayeq.records import Record
from studies.judge import timed, verdict_lines, with_verdict
from studies.resumable import Cell, Outcome, run_study

RECORDS, ROWS, NOISE, RATE = 20, 1000, 0.02, 100.0
COUPLED = {"ddx1": "x1, dx1, x2-x1, u, x1**3", "ddx2": "x2, dx2, x1-x2, u, x2**3"}


def _forced(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Times, and frequencies and phases of a force."""
    return np.arange(ROWS) / RATE, rng.uniform(1.0, 20.0, 10), rng.uniform(0.0, 2.0 * np.pi, 10)


def _noisy(rng: np.random.Generator, channels: Mapping[str, Floats], time: Floats) -> Record:
    noise = {name: one + NOISE * one.std() * rng.standard_normal(len(one)) for name, one in channels.items()}
    return Record.from_arrays(noise, time=time)


def two_masses(seed: int) -> tuple[Record, dict[str, dict[str, float]], float]:
    """A record, the truth, and the ratio of the masses."""
    rng = np.random.default_rng([seed, 1])
    time, w, phase = _forced(rng)
    k1, k2, k3 = rng.uniform(50.0, 150.0, 3)
    c1, c2, ratio = rng.uniform(0.3, 1.5), rng.uniform(0.3, 1.5), rng.uniform(1.2, 3.0)

    def force(s: float | Floats) -> Floats:
        return np.asarray(10.0 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1))

    def rate(s: float, y: Floats) -> list[float]:
        x1, v1, x2, v2 = y.tolist()
        pull = k2 * (x2 - x1)
        return [v1, float(force(s)) - k1 * x1 - c1 * v1 + pull, v2, -k3 * x2 - c2 * v2 - ratio * pull]

    y = solve_ivp(rate, (0.0, time[-1]), [0.0] * 4, t_eval=time, rtol=1e-8, atol=1e-10).y
    truth = {
        "ddx1": {"x1": -k1, "dx1": -c1, "x2-x1": k2, "u": 1.0},
        "ddx2": {"x2": -k3, "dx2": -c2, "x1-x2": ratio * k2},
    }
    return _noisy(np.random.default_rng([seed, 2]), {"x1": y[0], "x2": y[2], "u": force(time)}, time), truth, ratio


def _sd(eqs: Equations) -> list[float]:
    """Relative standard deviations of the coupling in both equations."""
    pairs = [(eqs["ddx1"], "x2-x1"), (eqs["ddx2"], "x1-x2")]
    rows = [(eq.posterior, list(eq.posterior.names).index(name)) for eq, name in pairs]
    return [float(p.sd[j] / abs(p.coef[j])) if p.support[j] else np.inf for p, j in rows]


def _tied(holds: bool, seed: int) -> Outcome:
    record, truth, ratio = two_masses(seed)
    ask = partial(discover, record, chains=["x1::", "x2::"], inputs=["u"], dictionary=COUPLED)
    told = ratio if holds else 2.0 * ratio
    tie = f"ddx2: x1-x2 == {told:.6g}*(ddx1: x2-x1)"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        free = min(_sd(ask()))

    def judge(eqs: Equations) -> dict[str, object]:
        refused = any("contradicts" in one for one in eqs.warnings)
        return {**with_verdict(truth, eqs), "refused": refused, "ratio": min(_sd(eqs)) / free}

    return timed(partial(ask, constraints=[tie]), judge)


def _by_record(differs: bool, seed: int) -> Outcome:
    rng = np.random.default_rng([seed, 1])
    k, c, k3 = rng.uniform(50.0, 150.0), rng.uniform(0.5, 2.0), rng.uniform(200.0, 600.0)
    true, records = {"x": -k, "dx": -c, "x**3": -k3, "u": 1.0}, []
    for number in range(3):
        time, w, phase = _forced(rng)
        mass = 1.3 if differs and number == 2 else 1.0

        def force(s: float | Floats, w: Floats = w, phase: Floats = phase) -> Floats:
            return np.asarray(10.0 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1))

        def rate(s: float, y: Floats, mass: float = mass, force: object = force) -> list[float]:
            x, v = y.tolist()
            return [v, (float(force(s)) - k * x - c * v - k3 * x**3) / mass]  # type: ignore[operator]

        x = solve_ivp(rate, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-10).y[0]
        records.append(_noisy(np.random.default_rng([seed, 2, number]), {"x": x, "u": force(time)}, time))
    if differs:
        true |= {f"{name}*run3": value * (1.0 / 1.3 - 1.0) for name, value in list(true.items())}
    ask = partial(
        discover, records, chains="x::", inputs=["u"], dictionary="x, dx, x**3, u, x**2, dx*abs(dx)", differs="all"
    )
    return timed(ask, partial(with_verdict, {"ddx": true}))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    ratios = [one["ratio"] for one in outcomes if "ratio" in one]
    for line in verdict_lines(outcomes):
        yield {
            **line,
            "tie_refused": sum(one["refused"] for one in outcomes) if ratios else "",
            "median_sd_ratio": f"{np.median(ratios):.2f}" if ratios else "",
        }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"known": "a tie that holds"}, RECORDS, partial(_tied, True)),
        Cell({"known": "a tie that does not"}, RECORDS, partial(_tied, False)),
        Cell({"known": "one of three records differs"}, RECORDS, partial(_by_record, True)),
        Cell({"known": "none differs"}, RECORDS, partial(_by_record, False)),
    ]
    run_study("between", "Ties between equations, and differences between records.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
