"""The 70 polynomial chaotic systems of Kaptanoglu et al. (arXiv 2302.10787), by their protocol (docs/benchmarks.md).

Methods: ``bayeq``, which knows nothing but the states; ``bayeq told``, which knows the true terms, as a lower bound of
the error E; PySINDy's ``stlsq``, from smoothed differences and in ``weak`` form, with the threshold that minimises the
AICc on clean derivatives of further trajectories (the paper's rule), or E itself (the oracle). MIOSR needs a commercial
solver: its published figures are listed for comparison.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import needing
from bayeq.records import Record
from bayeq.study import cells
from bayeq.study.cells import CONSTANT, Cell, Cells, Law, Outcome
from bayeq.study.config import choose
from bayeq.systems import System, simulate

#: Noise in per cent of the root mean square of all states.
NOISES = (0.0, 0.1, 1.0, 10.0, 25.0, 50.0)
METHODS = ("bayeq", "bayeq told", "stlsq", "weak")

RUNS, ROWS, PER_PERIOD, DEGREE = 5, 1000, 100, 4

# Integration steps per period; periods left out as transient, and periods from which initial states are drawn.
STEPS, TRANSIENT, LONG = 5000, 10, 30

# Keys of the published figures by method; each lists values in the order of NOISES.
PUBLISHED = {"stlsq": "stlsq_differences", "weak": "stlsq_weak"}
BEST_PUBLISHED = "miosr_weak"

# PySINDy's thresholds, and its test functions of the weak form per trajectory.
THRESHOLDS = np.geomspace(1e-3, 10.0, 60)
TEST_FUNCTIONS = 200


def systems() -> list[str]:
    return list(cells.facts()["dysts"])


@lru_cache(maxsize=128)
def _system(name: str) -> tuple[System, Sequence[Law]]:
    known = cells.facts()["dysts"][name]
    system = cells.system_of(
        name,
        known["states"],
        ["+".join(f"({c!r})*{term}" for term, c in law.items()) for law in known["terms"]],
        known["initial"],
        title=name,
        n=ROWS,
        fs=PER_PERIOD / known["period"],
        substeps=STEPS // PER_PERIOD,
        citation=cells.facts()["dysts_source"],
    )
    return system, known["terms"]


@lru_cache(maxsize=8)
def _clean(name: str, seed: int, further: bool = False) -> list[Record]:
    """Trajectories without noise; `further` ones are those that PySINDy's thresholds are chosen on."""
    system, _ = _system(name)
    long = simulate(system, n=(TRANSIENT + LONG) * PER_PERIOD)
    rng = np.random.default_rng([seed, systems().index(name)])
    rows = rng.choice(np.arange(TRANSIENT * PER_PERIOD, (TRANSIENT + LONG) * PER_PERIOD), 2 * RUNS, replace=False)
    own = rows[RUNS:] if further else rows[:RUNS]
    return [simulate(replace(system, initial={s: float(long[s][row]) for s in system.states})) for row in own]


def draw(name: str, noise: float, seed: int) -> list[Record]:
    """Noisy trajectories of a system, with noise in per cent; the seed draws the starts and the noise."""
    clean = _clean(name, seed)
    states = clean[0].channels
    size = np.sqrt(np.mean([np.square(one[state]) for one in clean for state in states]))
    rng = np.random.default_rng([seed, systems().index(name), 1])
    out = []
    for one in clean:
        noisy = {state: one[state] + 0.01 * noise * size * rng.standard_normal(ROWS) for state in states}
        out.append(Record.from_arrays(noisy, time=one.time))
    return out


def measure(cell: Cell, seed: int) -> Outcome:
    """The outcome of a cell (system, noise in per cent, method) for a seed."""
    name, noise, method = str(cell[0]), float(cell[1]), str(cell[2])
    if not method.startswith("bayeq"):
        return _stlsq(name, noise, seed, weak=method == "weak")
    from bayeq.discovery import discover

    system, laws = _system(name)
    records = draw(name, noise, seed)
    how: dict[str, Any] = {"dictionary": f"polynomial:{DEGREE}"}
    if method == "bayeq told":
        own = {f"d{s}": [t for t in law if t != CONSTANT] for s, law in zip(system.states, laws, strict=True)}
        # an equation that is a constant alone gets one candidate
        how["dictionary"] = {target: terms or [system.states[0]] for target, terms in own.items()}
    return cells.timed(
        lambda: discover(records, chains=list(system.states), holdout=0.0, **how), lambda eqs: cells.judged(eqs, laws)
    )


def _rates(laws: Sequence[Law], record: Record, states: Sequence[str]) -> Floats:
    from bayeq.expressions import Evaluator, parse

    evaluate = Evaluator(record.channels)
    return np.column_stack(
        [sum((value * evaluate(parse(term, states)) for term, value in law.items()), np.zeros(ROWS)) for law in laws]
    )


def _aicc(residuals: Floats, terms: int) -> float:
    rows = len(residuals)
    level = rows * np.log(max(float(np.mean(residuals**2)), np.finfo(np.float64).tiny))
    return float(level + 2 * terms + 2 * terms * (terms + 1) / (rows - terms - 1))


def _stlsq(name: str, noise: float, seed: int, weak: bool) -> Outcome:
    """PySINDy's STLSQ at the thresholds that the rule and the oracle choose; MissingExtraError without PySINDy."""
    _, laws = _system(name)
    records, test = draw(name, noise, seed), _clean(name, seed, further=True)
    states = list(records[0].channels)
    library, terms, coefficients, cpu = _fits(records, states, seed, weak)
    rates = np.concatenate([_rates(laws, one, states) for one in test])
    columns = np.concatenate([np.asarray(library.transform(_samples(one, states))) for one in test])
    true = np.array([[law.get(t, 0.0) for t in terms] for law in laws])
    errors = [cells.matrix_error(coef, true) for coef in coefficients]
    scores = [_aicc(rates - columns @ coef.T, int(np.count_nonzero(coef))) for coef in coefficients]
    rule, oracle = int(np.argmin(scores)), int(np.argmin(errors))
    exact = [bool(np.array_equal(coef != 0.0, true != 0.0)) for coef in coefficients]
    return {"cpu": cpu, "E": errors[rule], "exact": exact[rule], "E_oracle": errors[oracle], "any_exact": any(exact)}


def _samples(record: Record, states: Sequence[str]) -> Any:
    import pysindy

    return pysindy.AxesArray(np.column_stack([record[s] for s in states]), {"ax_time": 0, "ax_coord": 1})


def _fits(
    records: Sequence[Record], states: Sequence[str], seed: int, weak: bool
) -> tuple[Any, list[str], list[Floats], float]:
    """The library, its terms, coefficients (C, P) at each threshold, and the seconds of CPU that one model takes."""
    with needing("pysindy", "pysindy", "PySINDy's fits"):
        import pysindy
    start = time.process_time()
    plain: Any = pysindy.PolynomialLibrary(degree=DEGREE)
    samples = [_samples(one, states) for one in records]
    plain.fit(samples[0])
    rows, targets = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about thresholds that leave no term, and axes of its arrays
        for one, values in zip(records, samples, strict=True):
            library = plain
            if weak:
                np.random.seed(seed)  # noqa: NPY002 (seeds the places of PySINDy's test functions)
                library = pysindy.WeakPDELibrary(
                    pysindy.PolynomialLibrary(degree=DEGREE), spatiotemporal_grid=one.time, K=TEST_FUNCTIONS
                )
            prepared, target = library.calc_trajectory(pysindy.SmoothedFiniteDifference(), values, one.time)
            rows.append(np.asarray(library.fit_transform([prepared])[0]))
            targets.append(np.asarray(target))
        names = [name.replace(" ", "*").replace("^", "**") for name in plain.get_feature_names(list(states))]
        columns, target = np.concatenate(rows), np.concatenate(targets)
        prepared_at = time.process_time()
        models = [pysindy.STLSQ(threshold=float(t), alpha=1e-5).fit(columns, target) for t in THRESHOLDS]
    each = (time.process_time() - prepared_at) / len(models)
    return plain, names, [np.asarray(model.coef_) for model in models], prepared_at - start + each


def cells_of(names: Sequence[str] | None, noises: Sequence[float], methods: Sequence[str]) -> list[Cell]:
    """The cells of some systems (None: all), noises in per cent, and `METHODS`; names that are not known are errors."""
    chosen = choose("system", names, systems())
    kinds = choose("method", methods, METHODS)
    return [(name, float(noise), method) for name in chosen for noise in noises for method in kinds]


def summary(done: Cells) -> Iterator[dict[str, object]]:
    """A line for every noise and method: all systems together."""
    groups = done.grouped(lambda cell: cell[1:])
    for noise, method in sorted(groups, key=lambda key: (key[0], METHODS.index(str(key[1])))):
        yield _line(float(noise), str(method), groups[noise, method])


def each(done: Cells) -> Iterator[dict[str, object]]:
    """A line for every cell, failures first: fewest exact answers, largest E."""
    lines = [
        {
            "system": name,
            **_line(float(noise), str(method), [(str(name), one) for one in found]),
            "wrong": cells.wrong_in(found),
        }
        for (name, noise, method), found in zip(done.cells, done.outcomes, strict=True)
        if found
    ]
    yield from sorted(lines, key=lambda line: (float(str(line["exact_percent"])), -float(str(line["median_E"]))))


def _line(noise: float, method: str, found: Sequence[tuple[str, Outcome]]) -> dict[str, object]:
    """A line of a table: rates over the outcomes, with the published figures of their systems."""
    names = [name for name, _ in found]
    return {
        "noise_percent": f"{noise:g}",
        "method": method,
        "records": len(found),
        **_rates_of([one for _, one in found]),
        "published_E": _published(PUBLISHED.get(method), noise, names),
        "published_E_miosr_weak": _published(BEST_PUBLISHED, noise, names),
    }


def _published(kind: str | None, noise: float, names: Sequence[str]) -> str:
    """The published E of a method, median over systems; empty if none was published."""
    if kind is None or noise not in NOISES[:3]:
        return ""
    values = [cells.facts()["dysts"][name]["published"][kind][NOISES.index(noise)] for name in dict.fromkeys(names)]
    return f"{np.median(values):.2e}"


def _rates_of(outcomes: Sequence[Outcome]) -> dict[str, object]:
    """Errors, exact answers, verdicts and coverage; a failed answer counts as E = 1."""
    errors = np.array([one.get("E", 1.0) for one in outcomes])
    oracle = [one["E_oracle"] for one in outcomes if "E_oracle" in one]
    return {
        "median_E": f"{np.median(errors):.2e}",
        "median_E_oracle": f"{np.median(oracle):.2e}" if oracle else "",
        "E_below_1_percent": cells.percent(errors < 0.01),
        "E_below_10_percent": cells.percent(errors < 0.1),
        "exact_percent": cells.percent(one.get("exact", False) for one in outcomes),
        "any_exact_percent": cells.percent(one["any_exact"] for one in outcomes) if oracle else "",
        **cells.rates_of_verdicts(outcomes, outcomes),
    }
