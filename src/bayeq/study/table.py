"""A study's averages beside the paper's Tables 2 and 3, as text, Markdown, CSV or JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from itertools import groupby
from typing import Any, Literal

import numpy as np

from bayeq.arrays import Floats
from bayeq.citation import PAPER
from bayeq.markup import aligned
from bayeq.study.config import STUDY_SYSTEMS
from bayeq.study.runner import METRICS, Plan, Result, Store

Row = dict[str, Any]
Format = Literal["text", "markdown", "csv", "json"]

CITATION = f"{PAPER}, Tables 2 and 3 (averages over 1000 realisations)"

# The paper's names for its algorithms, in its order.
LABELS = {"sindy": "SINDy", "rvm": "RVM", "gibbs": "SS-MCMC", "vb": "SS-VB"}

# Its Table 2, (system, algorithm) -> the metrics.
TABLE_2 = {
    ("linear", "sindy"): (0.168, 3e4, 0.302, 0.580, 0.190, 0.778),
    ("linear", "rvm"): (0.010, 502.261, 0.097, 0.576, 0.005, 0.999),
    ("linear", "gibbs"): (0.004, 5.863, 0.072, 0.002, 0.992, 1.000),
    ("linear", "vb"): (0.004, 0.164, 0.071, 0.003, 0.991, 0.997),
    ("duffing", "sindy"): (0.253, 609.134, 0.168, 0.558, 0.113, 0.742),
    ("duffing", "rvm"): (0.070, 47.377, 0.091, 0.560, 0.001, 0.976),
    ("duffing", "gibbs"): (0.026, 4.116, 0.078, 0.037, 0.846, 0.977),
    ("duffing", "vb"): (0.034, 4.631, 0.076, 0.041, 0.845, 0.971),
    ("quadratic", "sindy"): (0.147, 4e5, 0.097, 0.488, 0.106, 0.520),
    ("quadratic", "rvm"): (0.017, 1546.542, 0.073, 0.497, 0.003, 0.931),
    ("quadratic", "gibbs"): (0.017, 0.004, 0.072, 0.030, 0.859, 0.865),
    ("quadratic", "vb"): (0.012, 0.004, 0.071, 0.019, 0.886, 0.892),
    ("coulomb", "sindy"): (0.216, 4e5, 0.257, 0.592, 0.021, 0.371),
    ("coulomb", "rvm"): (0.013, 1034.780, 0.092, 0.496, 0.003, 0.993),
    ("coulomb", "gibbs"): (0.011, 0.004, 0.071, 0.018, 0.847, 0.850),
    ("coulomb", "vb"): (0.009, 0.026, 0.070, 0.003, 0.762, 0.765),
}

# Metrics from here on are printed as approximate.
APPROXIMATE = 1e4

# Its Table 3: seconds of a single run (SS-MCMC: of a single chain; SS-VB: with the RVM that it starts from).
RUNTIMES = {"sindy": 3.65, "rvm": 0.03, "gibbs": 34.23, "vb": 0.33}

# Metrics that are averages of zeros and ones.
RATES = ("exact", "superset")

# Failure messages that are listed below a table.
LISTED = 10

TABLE_2_HEAD = ("system", "algorithm", "n", "e_theta_s", "e_theta", "(median)", "e_p", "FDR", "exact", "superset")
TABLE_3_HEAD = ("algorithm", "n", "ms per run", "to RVM", "to SS-VB", "paper: s", "to RVM", "to SS-VB")
RATIOS = ("ratio_rvm", "ratio_vb")

# What the names of some algorithms mean.
NOTES = {
    "sindy": "threshold on raw columns, chosen by the held-out error",
    "sindy-std": "threshold on standardised columns, chosen by the held-out error",
    "bma": "median probability model of model averaging",
    "vb": "SS-VB from several starts, the highest ELBO kept",
    "vb-rvm": "SS-VB started from the RVM alone, as the paper's section 3.2 says",
    "vb-greedy": "SS-VB started from a greedy search that adds and drops terms but does not swap them",
}


def aggregate(results: Iterable[Result], plan: Plan | None = None) -> list[Row]:
    """Table 2: a row per system and algorithm, in the paper's order, of results in the order of `Store.results`.

    Means over the `n` realisations that did not fail, `e_theta_median`, standard errors in `se`, the paper's values (or
    None) in `paper`, `seconds`, and how many realisations failed, did not converge, or are missing of the plan.
    """
    groups = groupby(results, key=lambda r: (r.system, r.algorithm))
    cells = {key: _cell(*key, list(group)) for key, group in groups}
    for (system, algorithm), asked in (plan or {}).items():
        cell = cells.setdefault((system, algorithm), _cell(system, algorithm, []))
        cell["missing"] = max(asked - cell["n"] - cell["failures"], 0)
    return [cells[key] for key in sorted(cells, key=_order)]


def _order(key: Sequence[str]) -> tuple[int, str, int, str]:
    return (*_place(STUDY_SYSTEMS, key[0]), *_place([*LABELS], key[1]))


def _place(order: Sequence[str], name: str) -> tuple[int, str]:
    return (order.index(name) if name in order else len(order), name)


def _cell(system: str, algorithm: str, results: Sequence[Result]) -> Row:
    good = [r for r in results if r.metrics is not None]
    values = {name: np.array([getattr(r.metrics, name) for r in good], dtype=np.float64) for name in METRICS}
    seconds = np.array([r.seconds for r in good], dtype=np.float64)
    means = {name: _mean(column) for name, column in values.items()}
    return {
        "system": system,
        "algorithm": algorithm,
        "n": len(good),
        **means,
        "seconds": _mean(seconds),
        "e_theta_median": float(np.median(values["e_theta"])) if good else None,
        "se": {name: _standard_error(name, column) for name, column in values.items()},
        "paper": _paper(system, algorithm),
        "failures": len(results) - len(good),
        "unconverged": sum(r.converged is False for r in good),
        "missing": 0,
    }


def _mean(values: Floats) -> float | None:
    return float(values.mean()) if values.size else None


def _standard_error(name: str, values: Floats) -> float | None:
    """sd/sqrt(n), for rates sqrt(p (1 - p)/n); None where there are too few values."""
    n = values.size
    if n < 2:
        return None
    if name in RATES:
        p = float(values.mean())
        return math.sqrt(p * (1.0 - p) / n)
    return float(values.std(ddof=1)) / math.sqrt(n)


def _paper(system: str, algorithm: str) -> Row | None:
    if (system, algorithm) not in TABLE_2:
        return None
    row: Row = dict(zip(METRICS, TABLE_2[system, algorithm], strict=True))
    approximate = [name for name, value in row.items() if value >= APPROXIMATE]
    return {**row, "seconds": RUNTIMES[algorithm], "approximate": approximate}


def failure_messages(results: Iterable[Result]) -> list[Row]:
    """Failures: a row per system, algorithm and message, with the count and the first index."""
    found: dict[tuple[str, ...], Row] = {}
    for r in results:
        if r.failure is not None:
            about = {"system": r.system, "algorithm": r.algorithm, "message": r.failure}
            row = found.setdefault((*about.values(),), {**about, "count": 0, "first_index": r.index})
            row["count"] += 1
    return [found[key] for key in sorted(found, key=lambda k: (_order(k), k[2]))]


def runtimes(rows: Sequence[Mapping[str, Any]], chains: int) -> list[Row]:
    """Table 3, of the rows of `aggregate`: mean seconds of a single run over all systems, ratios to the RVM and SS-VB.

    As in the paper the time of the Gibbs sampler is that of a single one of its chains: `seconds` of a single run
    (`seconds_all_chains` as measured), `ratio_rvm`, `ratio_vb`, and the paper's three (or None) in `paper`.
    """
    totals: dict[str, list[float]] = {}
    for row in rows:
        if row["seconds"] is not None:
            total = totals.setdefault(row["algorithm"], [0, 0.0])
            total[0] += row["n"]
            total[1] += row["n"] * row["seconds"]
    measured = {name: total / n for name, (n, total) in totals.items()}
    single = {name: s / (chains if name == "gibbs" else 1) for name, s in measured.items()}
    return [
        {
            "algorithm": name,
            "n": int(totals[name][0]),
            "seconds": single[name],
            "seconds_all_chains": measured[name],
            **_ratios(single, name),
            "paper": {"seconds": RUNTIMES[name], **_ratios(RUNTIMES, name)} if name in RUNTIMES else None,
        }
        for name in sorted(single, key=lambda name: _place([*LABELS], name))
    ]


def _ratios(seconds: Mapping[str, float], name: str) -> dict[str, float | None]:
    return {f"ratio_{other}": seconds[name] / seconds[other] if seconds.get(other) else None for other in ("rvm", "vb")}


# --- as printed ------------------------------------------------------------------------------------------------------


def show(store: Store, form: Format = "text", table: Literal[2, 3] = 2) -> str:
    """The paper's Table 2 (errors and selection) or 3 (run times) of a study; CSV has the rows of the JSON."""
    failures = failure_messages(store.results())
    rows = aggregate(store.results(), store.planned())
    shown = rows if table == 2 else runtimes(rows, int(store.config.get("chains", 1)))
    if form == "json":
        answer = {"version": version("bayeq"), "config": store.config, "rows": shown, "failures": failures}
        return json.dumps(answer, allow_nan=False)
    if form == "csv":
        return _csv(shown)
    head, lines = (TABLE_2_HEAD, [*_table_2(rows)]) if table == 2 else (TABLE_3_HEAD, [*_table_3(shown)])
    what = "errors and model selection" if table == 2 else "run times"
    title = f"Table {table}: {what} (seed {store.config.get('seed')}, smooth {store.config.get('smooth')})"
    body = _markdown(head, lines) if form == "markdown" else _text(head, lines)
    return "\n\n".join([title, body, *_notes(rows, failures, table, store.config)])


def _table_2(rows: Sequence[Row]) -> Iterator[list[str]]:
    """Two lines a row: ours with its standard error, the paper's below."""
    for row in rows:
        ours = [_with_error(row[name], row["se"][name]) for name in METRICS]
        ours.insert(2, "-" if row["e_theta_median"] is None else _number(row["e_theta_median"]))
        yield [row["system"], row["algorithm"], str(row["n"]), *ours]
        paper = row["paper"]
        if paper is not None:
            printed = [_printed(paper, name) for name in METRICS]
            printed.insert(2, "")
            yield ["", f"  paper {LABELS[row['algorithm']]}", "", *printed]


def _table_3(rows: Sequence[Row]) -> Iterator[list[str]]:
    def ratio(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    for row in rows:
        paper = row["paper"] or {}
        printed = [f"{paper['seconds']:.2f}" if paper else "-", *(ratio(paper.get(name)) for name in RATIOS)]
        ours = [f"{1e3 * row['seconds']:.3g}", *(ratio(row[name]) for name in RATIOS)]
        yield [row["algorithm"], str(row["n"]), *ours, *printed]


def _notes(rows: Sequence[Row], failures: Sequence[Row], table: int, config: Mapping[str, Any]) -> Iterator[str]:
    if not rows:
        yield "No results yet."
    if table == 2:
        yield "Means ± Monte Carlo standard error; e_theta_s is the scaled weight error; (median) is e_theta's."
    elif any(row["algorithm"] == "gibbs" for row in rows):
        yield f"gibbs: time of {config.get('chains')} chains by their number; the paper's is of a single chain."
    yield from (f"{name}: {what}." for name, what in NOTES.items() if any(row["algorithm"] == name for row in rows))
    yield f"Paper: {CITATION}."
    for key, what in (("missing", "not done yet (repeat the command)"), ("unconverged", "not converged")):
        cells = [f"{row['system']}/{row['algorithm']} {row[key]}" for row in rows if row[key]]
        if cells:
            yield f"Realisations {what}: {', '.join(cells)}."
    yield from (
        f"Failed: {f['system']}/{f['algorithm']}, {f['count']} realisations from number {f['first_index']} on:"
        f" {f['message']}"
        for f in failures[:LISTED]
    )
    if len(failures) > LISTED:
        yield f"And {len(failures) - LISTED} other kinds of failure; --json lists them."


def _with_error(value: float | None, error: float | None) -> str:
    if value is None:
        return "-"
    return _number(value) if error is None else f"{_number(value)} ± {_number(error, like=value)}"


def _number(value: float, like: float | None = None) -> str:
    """A number with three decimals as in the paper, fewer if it is large; an error is rounded to suit its value `like`.

    >>> _number(0.0411), _number(502.261), _number(1546.5), _number(4e5)
    ('0.041', '502.3', '1546', '4.0e+05')
    >>> _number(0.0021, like=0.0411), _number(89.61, like=157.3), _number(2e4, like=4e5)
    ('0.0021', '89.6', '2.0e+04')
    """
    size = abs(value if like is None else like)
    if size >= 1e4:
        return f"{value:.1e}"
    if size >= 100:
        return f"{value:.{1 if size < 1000 else 0}f}"
    return f"{value:.{3 if like is None or abs(value) >= 10 else 4}f}"


def _printed(paper: Mapping[str, Any], name: str) -> str:
    return f"~{paper[name]:.0e}" if name in paper["approximate"] else f"{paper[name]:.3f}"


def _text(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    left = [k for k, name in enumerate(head) if name in ("system", "algorithm")]
    rule = ["-" * max(map(len, column)) for column in zip(head, *lines, strict=True)]
    return "\n".join(aligned([head, rule, *lines], left))


def _markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rule = ["---" if name in ("system", "algorithm") else "---:" for name in head]
    return "\n".join(f"| {' | '.join(cell.strip() for cell in line)} |" for line in (head, rule, *lines))


def _csv(rows: Sequence[Row]) -> str:
    """CSV text of the rows; nested values get columns such as se_exact and paper_exact."""
    import pandas as pd

    flat = []
    for row in rows:
        line: Row = {}
        for key, value in row.items():
            if isinstance(value, Mapping):
                line |= {f"{key}_{name}": v for name, v in value.items() if name != "approximate"}
            elif key != "paper":
                line[key] = value
        flat.append(line)
    return pd.DataFrame(flat, dtype=object).to_csv(index=False, lineterminator="\n").rstrip("\n")
