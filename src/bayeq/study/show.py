"""A study's tables as text, Markdown, CSV or JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, Literal

from bayeq.study.metrics import METRICS
from bayeq.study.store import Store
from bayeq.study.table import CITATION, LABELS, Row, aggregate, failure_messages, runtimes

__all__ = ["Format", "show"]

Format = Literal["text", "markdown", "csv", "json"]

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


def show(store: Store, form: Format = "text", table: Literal[2, 3] = 2) -> str:
    """A table of a study.

    Parameters
    ----------
    store : Store
        The study.
    form : "text", "markdown", "csv" or "json"
        JSON is an object with "version", "config", "rows" and "failures"; CSV has one row per row of the JSON.
    table : 2 or 3
        The paper's Table 2 (errors and selection) or Table 3 (run times).
    """
    failures = failure_messages(store.results())
    rows = aggregate(store.results(), store.planned())
    shown = rows if table == 2 else runtimes(rows, int(store.config.get("chains", 1)))
    if form == "json":
        answer = {"version": version("bayeq"), "config": store.config, "rows": shown, "failures": failures}
        return json.dumps(answer, allow_nan=False)
    if form == "csv":
        return _csv(shown)
    head, lines = (TABLE_2_HEAD, _table_2(rows)) if table == 2 else (TABLE_3_HEAD, _table_3(shown))
    body = _markdown(head, lines) if form == "markdown" else _text(head, lines)
    return "\n\n".join([_title(store.config, table), body, *_notes(rows, failures, table, store.config)])


def _title(config: Mapping[str, Any], table: int) -> str:
    what = "errors and model selection" if table == 2 else "run times"
    return f"Table {table}: {what} (seed {config.get('seed')}, smooth {config.get('smooth')})"


def _table_2(rows: Sequence[Row]) -> list[list[str]]:
    """Two lines a row: ours with its standard error, the paper's below."""
    lines = []
    for row in rows:
        ours = [_with_error(row[name], row["se"][name]) for name in METRICS]
        ours.insert(2, "-" if row["e_theta_median"] is None else _number(row["e_theta_median"]))
        lines.append([row["system"], row["algorithm"], str(row["n"]), *ours])
        paper = row["paper"]
        if paper is not None:
            printed = [_printed(paper, name) for name in METRICS]
            printed.insert(2, "")
            lines.append(["", f"  paper {LABELS[row['algorithm']]}", "", *printed])
    return lines


def _table_3(rows: Sequence[Row]) -> list[list[str]]:
    def ratio(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    lines = []
    for row in rows:
        paper = row["paper"] or {}
        printed = [f"{paper['seconds']:.2f}" if paper else "-", *(ratio(paper.get(name)) for name in RATIOS)]
        ours = [f"{1e3 * row['seconds']:.3g}", *(ratio(row[name]) for name in RATIOS)]
        lines.append([row["algorithm"], str(row["n"]), *ours, *printed])
    return lines


def _notes(rows: Sequence[Row], failures: Sequence[Row], table: int, config: Mapping[str, Any]) -> list[str]:
    notes = []
    if not rows:
        notes.append("No results yet.")
    if table == 2:
        notes.append("Means ± Monte Carlo standard error; e_theta_s is the scaled weight error; (median) is e_theta's.")
    elif any(row["algorithm"] == "gibbs" for row in rows):
        notes.append(f"gibbs: time of {config.get('chains')} chains by their number; the paper's is of a single chain.")
    notes.extend(f"{name}: {what}." for name, what in NOTES.items() if any(row["algorithm"] == name for row in rows))
    notes.append(f"Paper: {CITATION}.")
    for key, what in (("missing", "not done yet (repeat the command)"), ("unconverged", "not converged")):
        cells = [f"{row['system']}/{row['algorithm']} {row[key]}" for row in rows if row[key]]
        if cells:
            notes.append(f"Realisations {what}: {', '.join(cells)}.")
    notes.extend(
        f"Failed: {f['system']}/{f['algorithm']}, {f['count']} realisations from number {f['first_index']} on:"
        f" {f['message']}"
        for f in failures[:LISTED]
    )
    if len(failures) > LISTED:
        notes.append(f"And {len(failures) - LISTED} other kinds of failure; --json lists them.")
    return notes


def _with_error(value: float | None, error: float | None) -> str:
    if value is None:
        return "-"
    return _number(value) if error is None else f"{_number(value)} ± {_number(error, like=value)}"


def _number(value: float, like: float | None = None) -> str:
    """Three decimals as the paper prints, fewer of what is large; of an error, according to its value.

    Examples
    --------
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
    widths = [max(len(line[k]) for line in (head, *lines)) for k in range(len(head))]
    left = [k for k, name in enumerate(head) if name in ("system", "algorithm")]

    def render(line: Sequence[str]) -> str:
        cells = (c.ljust(w) if k in left else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True)))
        return "  ".join(cells).rstrip()

    return "\n".join([render(head), "  ".join("-" * w for w in widths), *map(render, lines)])


def _markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rule = ["---" if name in ("system", "algorithm") else "---:" for name in head]
    return "\n".join(f"| {' | '.join(cell.strip() for cell in line)} |" for line in (head, rule, *lines))


def _csv(rows: Sequence[Row]) -> str:
    """Nested values under names such as se_exact and paper_exact."""
    flat = []
    for row in rows:
        line: Row = {}
        for key, value in row.items():
            if isinstance(value, Mapping):
                line |= {f"{key}_{name}": v for name, v in value.items() if name != "approximate"}
            elif key != "paper":
                line[key] = value
        flat.append(line)
    columns = list(dict.fromkeys(name for line in flat for name in line))
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(flat)
    return out.getvalue().rstrip("\n")
