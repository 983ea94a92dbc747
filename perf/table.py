"""The measured rows as tables: plain for the screen, Markdown for docs/performance.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from perf.peers import CONTESTANTS
from perf.problems import CASES
from perf.rows import Row

__all__ = ["duration", "markdown_tables", "plain_table", "put_between", "write_docs"]

DOCS = Path(__file__).parents[1] / "docs" / "performance.md"
BEGIN, END = "<!-- begin: python -m perf.compare --docs -->", "<!-- end -->"

DENSE = "dense"

# Variants that the page leaves out; compare.csv has them.
VARIANTS = {"stlsq-swept", "ard-raw", "pysindy-swept", "pysindy-ssr", "pysindy-ensemble", "pysindy-sbr"}


def duration(seconds: float) -> str:
    """A time to three digits, in the unit that suits it.

    >>> duration(0.000853), duration(0.0124), duration(2.5)
    ('0.853 ms', '12.4 ms', '2.50 s')
    """
    value, unit = (1e3 * seconds, "ms") if seconds < 1.0 else (seconds, "s")
    digits = max(0, 2 - math.floor(math.log10(value))) if value > 0 else 0
    return f"{value:.{min(digits, 3)}f} {unit}"


def _number(value: float) -> str:
    """Three digits, but never a power of ten.

    >>> _number(0.0), _number(-4.52), _number(-131874.8)
    ('0', '-4.52', '-131,875')
    """
    return f"{value:.3g}" if abs(value) < 100 else f"{value:,.0f}"


def _time(row: Row) -> str:
    return duration(row.seconds)


def _exact(row: Row) -> str:
    return f"{round(row.exact * row.problems)}/{row.problems} ({_number(row.false)}, {_number(row.missed)})"


def _error(row: Row) -> str:
    return _number(100.0 * row.error)


def _evidence(row: Row) -> str:
    return DENSE if math.isnan(row.evidence) else _number(round(row.evidence, 2) + 0.0)


def _memory(row: Row) -> str:
    return f"{max(row.extra_mb, 0.0):.0f}"


def _short(status: str) -> str:
    """Why there is no number, short enough for a cell."""
    if status.startswith("not tried"):
        return "not tried"
    return "failed" if status.startswith("failed") else status


def _grid(rows: Sequence[Row], cases: Sequence[str], cell: Callable[[Row], str]) -> list[str]:
    """Contestants down, cases across; the table of times says why there is no number."""
    at = {(row.contestant, row.case): row for row in rows}
    lines = [
        "| | " + " | ".join(CASES[name].title for name in cases) + " |",
        "| --- |" + " ---: |" * len(cases),
    ]
    for name, contestant in CONTESTANTS.items():
        found = [at.get((name, case)) for case in cases]
        if any(found):
            cells = [_cell(row, cell) for row in found]
            title = f"**{contestant.title}**" if contestant.ours else contestant.title
            lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return lines


def _cell(row: Row | None, cell: Callable[[Row], str]) -> str:
    if row is None:
        return ""
    if row.status == "ok":
        return cell(row)
    return _short(row.status) if cell is _time else "–"


# Sections of the page: title, text, cell, cases. Other cases, coefficients, evidence and memory are in perf/results.
SECTIONS: tuple[tuple[str, str, Callable[[Row], str], tuple[str, ...]], ...] = (
    ("Time", "Median time of a whole fit.", _time, ("linear", "p200", "p2000", "n2000000")),
    (
        "Terms",
        "Problems on which exactly the true terms were selected, and in brackets how many false terms were selected "
        "and how many true ones missed, on average.",
        _exact,
        ("linear", "duffing", "quadratic", "coulomb"),
    ),
)


def markdown_tables(remarks: Iterable[str], rows: Sequence[Row]) -> str:
    """The sections as Markdown."""
    lines = ["Measured with:", "", *(f"- {remark}" for remark in remarks), ""]
    for title, text, cell, shown in SECTIONS:
        present = [name for name in shown if any(row.case == name for row in rows)]
        small = [name for name in present if CASES[name].columns == 36 and CASES[name].rows == 2000]
        lines += [f"### {title}", "", text, ""]
        for cases in (small, [name for name in present if name not in small]):
            if cases:
                lines += [*_grid(rows, cases, cell), ""]
    failures = [f"- {row.contestant}, {row.case}: {row.status}" for row in rows if row.status.startswith("failed")]
    if failures:
        lines += ["Failures:", "", *failures, ""]
    return "\n".join(lines)


def plain_table(rows: Sequence[Row]) -> str:
    """For the screen: a line per row."""
    form = "{:<10} {:<17} {:>10} {:>8} {:>7} {:>7} {:>10} {:>10} {:>8}"
    lines = [form.format("case", "contestant", "time", "exact", "false", "missed", "error [%]", "evidence", "MiB")]
    for row in rows:
        if row.status != "ok":
            lines.append(f"{row.case:<10} {row.contestant:<17} {row.status}")
            continue
        exact = f"{round(row.exact * row.problems)}/{row.problems}"
        memory = "" if math.isnan(row.extra_mb) else _memory(row)
        cells = (_time(row), exact, _number(row.false), _number(row.missed), _error(row), _evidence(row), memory)
        lines.append(form.format(row.case, row.contestant, *cells).rstrip())
    return "\n".join(lines)


def put_between(text: str, content: str) -> str:
    """A page with what stands between its markers replaced."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n\n{content.strip()}\n\n{END}{after}"


def write_docs(remarks: Iterable[str], rows: Sequence[Row], page: Path = DOCS) -> None:
    """Put the tables into docs/performance.md, without variants of a contestant."""
    content = markdown_tables(remarks, [row for row in rows if row.contestant not in VARIANTS])
    page.write_text(put_between(page.read_text(), content))
