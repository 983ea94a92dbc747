"""ODEBench, the 63 systems of d'Ascoli et al. (arXiv 2310.05573), by their protocol (docs/benchmarks.md).

Equations are scored by the R2, over all states, of a free run from the clean first state and of one from a second
initial state that is not in the data. Dictionaries: "blind", all monomials to degree 3; "informed", monomials to the
system's own degree, at least 2, and its other functions, with unknown constants inside if it has any. Methods:
``bayeq``; ``proportional``, which knows that the noise is a share of the reading; and PySINDy's ``stlsq`` with the
settings of the authors' grid that predict the last 30 % of the trajectory best.
"""

from __future__ import annotations

import itertools
import re
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import BayeqError, BayeqWarning, needing
from bayeq.records import Record
from bayeq.study import cells
from bayeq.study.cells import CONSTANT, Cell, Cells, Outcome
from bayeq.study.config import choose
from bayeq.systems import simulate

#: Kinds of noise, with its size in per cent.
NOISES = ("none 0", "multiplied 1", "multiplied 5", "added 1", "added 5")
DICTIONARIES = ("blind", "informed")
METHODS = ("bayeq", "proportional", "stlsq")

ROWS, SECONDS = 512, 10.0
SUBSTEPS = 50

# A free run with a higher R2 follows the trajectory.
FOLLOWS = 0.9

# PySINDy: thresholds, ridges, orders of differences, windows of smoothing, degrees; the share of rows for its fits.
GRID = ((0.05, 0.1, 0.15), (0.025, 0.05, 0.075), (2, 3, 4), (None, 15), (1, 2, 3))
TRAINED = 0.7

# A free run of PySINDy is stopped when a state exceeds this magnitude.
FARTHEST = 1e6


@lru_cache(maxsize=1)
def _known() -> Mapping[str, Any]:
    return {str(one["id"]): one for one in cells.facts()["odebench"]}


def systems() -> list[str]:
    """Numbers of the systems, as text."""
    return list(_known())


@lru_cache(maxsize=256)
def _clean(name: str, start: int) -> Record:
    """The trajectory from one of the two initial states."""
    known = _known()[name]
    system = cells.system_of(
        f"odebench-{name}",
        known["states"],
        known["rhs"],
        known["initial"][start],
        title=known["name"],
        n=ROWS,
        fs=(ROWS - 1) / SECONDS,
        substeps=SUBSTEPS,
        citation=cells.facts()["odebench_source"],
    )
    return simulate(system)


def draw(name: str, start: int, noise: str, points: float, seed: int) -> Record:
    """A noisy trajectory; the seed draws the noise, and the share `points` of rows kept (always with the first)."""
    clean = _clean(name, start)
    kind, size = noise.split()
    rng = np.random.default_rng([seed, int(name), start])
    keep = np.ones(ROWS, dtype=np.bool_)
    if points < 1.0:
        keep[rng.choice(np.arange(1, ROWS), round((1.0 - points) * ROWS), replace=False)] = False
    noisy = {}
    for state in clean.channels:
        values = clean[state]
        scale = values if kind == "multiplied" else np.std(values)
        noisy[state] = (values + 0.01 * float(size) * scale * rng.standard_normal(ROWS))[keep]
    assert clean.time is not None
    return Record.from_arrays(noisy, time=clean.time[keep])


def measure(cell: Cell, seed: int) -> Outcome:
    """The outcome of a cell (system, start, noise, share of points, dictionary, method) for a seed."""
    name, start, noise, points = str(cell[0]), int(cell[1]), str(cell[2]), float(cell[3])
    dictionary, method = str(cell[4]), str(cell[5])
    record = draw(name, start, noise, points, seed)
    truth = (_clean(name, start), _clean(name, 1 - start))
    if method == "stlsq":
        return _stlsq(record, truth, dictionary == "informed" and _known()[name]["class"] != "P")
    from bayeq.discovery import discover

    known = _known()[name]
    laws = known["terms"] or known["laws"]
    how: dict[str, Any] = {"dictionary": "polynomial:3" if dictionary == "blind" else informed(name)}
    if method == "proportional":
        how["noise"] = dict.fromkeys(known["states"], "% of reading")

    def judge(eqs: Any) -> Outcome:
        failed = any(eq.verdict.kind == "none" for eq in eqs)
        scores = [0.0 if failed else _explained(eqs, clean) for clean in truth]
        return {**cells.judged(eqs, laws), "R2": scores}

    return cells.timed(lambda: discover(record, chains=known["states"], holdout=0.0, **how), judge)


def informed(name: str) -> list[str]:
    known = _known()[name]
    if known["terms"] is None:  # the law has unknown constants inside terms
        return ["polynomial:2", *known["unknowns_in"]]
    names = list(dict.fromkeys(term for law in known["terms"] for term in law if term != CONSTANT))
    degrees = {term: _degree(term, known["states"]) for term in names}
    degree = max([2, *(d for d in degrees.values() if d is not None)])
    return [f"polynomial:{degree}", *(term for term in names if degrees[term] is None)]


def _degree(term: str, states: Sequence[str]) -> int | None:
    """Degree of a monomial in the states; None for any other term."""
    power = rf"({'|'.join(states)})(\*\*(\d))?"
    if not re.fullmatch(rf"{power}(\*{power})*", term):
        return None
    return sum(int(found[3] or 1) for found in re.finditer(power, term))


def _explained(eqs: Any, clean: Record) -> float:
    """R2 of the free run from the first state of a clean trajectory."""
    initial = {state: float(clean[state][0]) for state in clean.channels}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        try:
            run = eqs.simulate(clean, initial=initial, draws=0)
        except BayeqError:
            return 0.0
    return _r2(np.column_stack([run.mean[state] for state in clean.channels]), clean)


def _r2(run: Floats, clean: Record) -> float:
    """R2 of a run (n, C) over all states, at least 0; 0 for runs that are not finite or too short."""
    true = np.column_stack([clean[state] for state in clean.channels])
    if run.shape != true.shape or not np.isfinite(run).all():
        return 0.0
    return float(max(1.0 - np.square(run - true).sum() / np.square(true - true.mean(axis=0)).sum(), 0.0))


def _stlsq(record: Record, truth: Sequence[Record], functions: bool) -> Outcome:
    """PySINDy by the authors' grid, with sin, cos and exp if asked for; the best by R2 of the last 30 %."""
    with needing("pysindy", "pysindy", "PySINDy's fits"):
        import pysindy
    start = time.process_time()
    values, times = np.column_stack([record[name] for name in record.channels]), np.asarray(record.time)
    split = round(TRAINED * len(times))
    highest, best = -np.inf, None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for numbers in itertools.product(*GRID, (False, True) if functions else (False,)):
            model = _model(pysindy, *numbers)
            try:
                model.fit(values[:split], t=times[:split])
                score = float(model.score(values[split:], t=times[split:]))
            except (ValueError, np.linalg.LinAlgError):  # no terms left, or a column is not finite
                continue
            if score > highest:
                highest, best = score, model
    cpu = time.process_time() - start
    if best is None:
        return {"error": "no model", "cpu": cpu}
    return {"cpu": cpu, "R2": [_r2(_run(best, one), one) for one in truth]}


def _model(pysindy: Any, threshold: Any, alpha: Any, order: Any, window: Any, degree: Any, functions: bool) -> Any:
    library = pysindy.PolynomialLibrary(degree=degree)
    if functions:
        own = [lambda v: np.sin(v), lambda v: np.cos(v), lambda v: np.exp(v)]
        library = library + pysindy.CustomLibrary(library_functions=own)
    differences = pysindy.FiniteDifference(order=order)
    if window is not None:
        differences = pysindy.SmoothedFiniteDifference(order=order, smoother_kws={"window_length": window})
    return pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=threshold, alpha=alpha),
        feature_library=library,
        differentiation_method=differences,
    )


def _run(model: Any, clean: Record) -> Floats:
    """Free run (n, C) of a model from the first state of a record; fewer rows if a state exceeds `FARTHEST`."""
    from scipy.integrate import solve_ivp

    def inside(t: float, y: Floats) -> float:
        return FARTHEST - float(np.abs(y).max())

    inside.terminal = True  # type: ignore[attr-defined]
    times = np.asarray(clean.time)
    out = solve_ivp(
        lambda t, y: model.predict(y[None])[0],
        (times[0], times[-1]),
        np.array([clean[state][0] for state in clean.channels]),
        t_eval=times,
        method="LSODA",
        events=inside,
    )
    return np.asarray(out.y.T)


def cells_of(
    names: Sequence[str] | None,
    noises: Sequence[str],
    points: Sequence[float],
    dictionaries: Sequence[str],
    methods: Sequence[str],
) -> list[Cell]:
    """The cells of some systems (None: all), `NOISES`, shares of the points, `DICTIONARIES` and `METHODS`, checked."""
    return [
        (name, start, noise, float(share), dictionary, method)
        for name in choose("system", names, systems())
        for start in (0, 1)
        for noise in choose("noise", noises, NOISES)
        for share in points
        for dictionary in choose("dictionary", dictionaries, DICTIONARIES)
        for method in choose("method", methods, METHODS)
    ]


def summary(done: Cells) -> Iterator[dict[str, object]]:
    """A line for every noise, share of points, dictionary and method, apart for records that come to rest."""
    for about, found in done.grouped(_kind).items():
        yield {**_about(*about), "records": len(found), **_rates_of([one for _, one in found])}


def _kind(cell: Cell) -> Cell:
    """Key of a line: the cell without system and start, and whether its record comes to rest."""
    return (*cell[2:], bool(_known()[str(cell[0])]["rest"][int(cell[1])]))


def _about(noise: Any, points: Any, dictionary: Any, method: Any, rests: Any) -> dict[str, object]:
    return {
        "noise": noise,
        "points": f"{100 * points:g} %",
        "dictionary": dictionary,
        "method": method,
        "comes_to_rest": "yes" if rests else "no",
    }


def each(done: Cells) -> Iterator[dict[str, object]]:
    """A line for every cell, failures first."""
    lines: list[tuple[bool, bool, dict[str, object]]] = []
    for cell, one in ((cell, one) for cell, found in zip(done.cells, done.outcomes, strict=True) for one in found):
        scores = one.get("R2", [0.0, 0.0])
        line: dict[str, object] = {
            "system": cell[0],
            "start": cell[1],
            **_about(*_kind(cell)),
            "R2": f"{scores[0]:.4f}",
            "R2_other_start": f"{scores[1]:.4f}",
            "verdicts": ", ".join(one.get("verdicts", [])),
            "wrong": cells.wrong_in([one]),
            "cpu_seconds": f"{one['cpu']:.2f}",
        }
        lines.append((scores[0] > FOLLOWS, scores[1] > FOLLOWS, line))
    yield from (line for *_, line in sorted(lines, key=lambda entry: entry[:2]))


def _rates_of(outcomes: Sequence[Outcome]) -> dict[str, object]:
    scores = np.array([one.get("R2", [0.0, 0.0]) for one in outcomes])
    known = [one for one in outcomes if "exact" in one]
    rates = cells.rates_of_verdicts(outcomes, [one for one in known if one["exact"]])
    return {
        "reconstructed_percent": cells.percent(scores[:, 0] > FOLLOWS),
        "other_start_percent": cells.percent(scores[:, 1] > FOLLOWS),
        "with_known_terms": len(known),
        "exact_percent": cells.percent(one["exact"] for one in known),
        "found_percent": rates.pop("found_percent"),
        "none_percent": cells.percent("none" in one["verdicts"] for one in outcomes if "verdicts" in one),
        **rates,
    }
