"""First-order systems of which noisy states are all that is measured: which noise can the true terms be found in?

Lorenz (order 2 of the polynomials), Van der Pol (3), Roessler (2) and Lotka-Volterra (3), the constant among the
candidates. Noise is a ratio of the standard deviation of all states together about one common mean (Fung 2025), and for
Lotka-Volterra of each state's own. All rows are used. Exact: the true terms in every equation, no other, and no
constant but Roessler's. Beside the default stands PySINDy's STLSQ with smoothed differences and in weak form at the
threshold, of 20, that is best in the cell: chosen by the truth.

    python -m studies.states_only > docs/tables/states_only.csv
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from bayeq.discovery import discover
from bayeq.records import Record
from bayeq.systems import System, get_system, simulate
from studies.judge import CONSTANT, judged, rates, timed
from studies.resumable import Cell, Outcome, run_study

__all__ = ["CELLS", "ORDERS", "draw_record", "main"]

ROESSLER = System(
    name="roessler",
    title="Roessler's band",
    chains=("x", "y", "z"),
    rhs={"x": "-y-z", "y": "x+a*y", "z": "b+z*(x-c)"},
    terms={"dx": {"y": "-1", "z": "-1"}, "dy": {"x": "1", "y": "a"}, "dz": {CONSTANT: "b", "z": "-c", "x*z": "1"}},
    parameters={"a": 0.2, "b": 0.2, "c": 5.7},
    initial={"x": -6.0, "y": 5.0, "z": 0.0},
    n=601,
    fs=20.0,
    noise=0.1,
    noise_scale="pooled",
    substeps=10,
    citation="O. E. Roessler, An equation for continuous chaos, Phys. Lett. A 57 (1976) 397-398",
)

LOTKA_VOLTERRA = System(
    name="lotka-volterra",
    title="Lotka-Volterra predator and prey",
    chains=("x", "y"),
    rhs={"x": "1.1*x-0.4*x*y", "y": "0.1*x*y-0.4*y"},
    terms={"dx": {"x": "1.1", "x*y": "-0.4"}, "dy": {"y": "-0.4", "x*y": "0.1"}},
    parameters={},
    initial={"x": 10.0, "y": 5.0},
    n=401,
    fs=20.0,
    noise=0.1,
    substeps=10,
    citation="A. J. Lotka, Elements of Physical Biology (1925)",
)

SYSTEMS: Mapping[str, System] = {
    "lorenz": get_system("lorenz"),
    "vanderpol": get_system("vanderpol"),
    "roessler": ROESSLER,
    "lotka-volterra": LOTKA_VOLTERRA,
}

# Order of the polynomials.
ORDERS = {"lorenz": 2, "vanderpol": 3, "roessler": 2, "lotka-volterra": 3}

# System, seconds, noise ratios.
CELLS = (
    ("lorenz", 10.0, (0.1, 0.2, 0.3, 0.4)),
    ("lorenz", 7.0, (0.3,)),
    ("vanderpol", 12.0, (0.2, 0.4)),
    ("roessler", 30.0, (0.1, 0.2, 0.3)),
    ("lotka-volterra", 20.0, (0.1, 0.2, 0.3)),
)

RECORDS = {"auto": 64, "pysindy differences": 20, "pysindy weak": 20}

THRESHOLDS = np.geomspace(0.01, 5.0, 20)

# Test functions of the weak form.
TEST_FUNCTIONS = 500


def draw_record(system: str, seconds: float, noise: float, seed: int) -> Record:
    """A noisy record, its last row at `seconds`."""
    known = SYSTEMS[system]
    return simulate(known, n=round(seconds * known.fs) + 1, seed=seed, noise=noise)


def _truth(record: Record) -> Mapping[str, Mapping[str, float]]:
    assert record.truth is not None
    return record.truth.coefficients


def _measure(system: str, seconds: float, noise: float, seed: int) -> Outcome:
    record = draw_record(system, seconds, noise, seed)
    fit = partial(
        discover,
        record,
        chains=list(record.names),
        dictionary=f"polynomial:{ORDERS[system]}",
        holdout=0.0,
    )
    return timed(fit, lambda eqs: judged(eqs, _truth(record)))


def _measure_sindy(system: str, seconds: float, noise: float, weak: bool, seed: int) -> Outcome:
    """Which of the thresholds give exactly the true terms; CPU seconds of a single fit."""
    import pysindy

    record = draw_record(system, seconds, noise, seed)
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of thresholds that leave no term, and of its own arrays' axes
        columns, targets, names = _prepared(record, ORDERS[system], weak, seed)
        prepared = time.process_time() - start
        fits = [
            pysindy.STLSQ(threshold=float(threshold), alpha=0.0, unbias=False).fit(columns, targets)
            for threshold in THRESHOLDS
        ]
    fitted = time.process_time() - start - prepared
    true = [set(terms) for terms in _truth(record).values()]
    exact = [[{n for n, c in zip(names, row, strict=True) if c} for row in fit.coef_] == true for fit in fits]
    return {"exact": exact, "cpu": prepared + fitted / len(THRESHOLDS)}


def _prepared(record: Record, order: int, weak: bool, seed: int) -> tuple[Any, Any, list[str]]:
    """PySINDy's columns, targets, and the columns' names as in this package."""
    import pysindy

    assert record.time is not None
    library: Any = pysindy.PolynomialLibrary(degree=order)
    if weak:
        np.random.seed(seed)  # noqa: NPY002 (where PySINDy takes the places of its test functions from)
        library = pysindy.WeakPDELibrary(library, spatiotemporal_grid=record.time, K=TEST_FUNCTIONS)
    samples = pysindy.AxesArray(np.column_stack([record[name] for name in record.names]), {"ax_time": 0, "ax_coord": 1})
    states, targets = library.calc_trajectory(pysindy.SmoothedFiniteDifference(), samples, record.time)
    columns = library.fit_transform([states])[0]
    names = library.get_feature_names(list(record.names))
    return columns, targets, [name.replace(" ", "*").replace("^", "**") for name in names]


def _best_threshold(outcomes: Sequence[Outcome]) -> dict[str, object]:
    hits = np.sum([outcome["exact"] for outcome in outcomes], axis=0)
    best = int(np.argmax(hits))
    at_best = [{"exact": outcome["exact"][best], "terms": {}, "cpu": outcome["cpu"]} for outcome in outcomes]
    return {**rates(at_best), "threshold": f"{THRESHOLDS[best]:.3g}" if hits[best] else ""}


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    sindy = isinstance(outcomes[0]["exact"], list)
    yield _best_threshold(outcomes) if sindy else {**rates(outcomes), "threshold": ""}


def _cells() -> Iterator[Cell]:
    for method, records in RECORDS.items():
        for system, seconds, ratios in CELLS:
            for noise in ratios:
                labels = {"system": system, "seconds": seconds, "noise_percent": 100 * noise, "method": method}
                if method == "auto":
                    measure = partial(_measure, system, seconds, noise)
                else:
                    measure = partial(_measure_sindy, system, seconds, noise, method == "pysindy weak")
                yield Cell(labels, records, measure)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    run_study("states_only", "Exact rates where noisy states are all there is.", list(_cells()), _summary, arguments)


if __name__ == "__main__":
    main()
