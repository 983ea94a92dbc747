"""The tables of docs/rules.md, from the settings of every stage and docs/tables/sensitivity.csv.

python -m studies.rules
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

from bayeq.numerics.settings import (
    EQUATION,
    INFERENCE,
    LIKELIHOOD,
    PLAN,
    RECORDS,
    REFINE,
    REGRESSION,
    SELECTION,
    STATES,
    STREAMING,
)

__all__ = ["PAGE", "STAGES", "moves", "page", "sensitivity"]

ROOT = Path(__file__).resolve().parents[1]
PAGE, TABLE = ROOT / "docs/rules.md", ROOT / "docs/tables/sensitivity.csv"

# Of the instances, by name.
STAGES: Mapping[str, Any] = {
    "RECORDS": RECORDS, "STATES": STATES, "LIKELIHOOD": LIKELIHOOD, "REGRESSION": REGRESSION, "INFERENCE": INFERENCE,
    "SELECTION": SELECTION, "EQUATION": EQUATION, "REFINE": REFINE, "PLAN": PLAN,
    "STREAMING": STREAMING,
}  # fmt: skip

# What stands between two marks is written anew.
MARKED = re.compile(r"(<!-- settings: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

# Coefficients that move by a standard deviation make another answer.
ANOTHER = 1.0

Lines = Mapping[tuple[str, str], Mapping[str, str]]


def sensitivity() -> Lines:
    """Lines of the study, by stage and field."""
    text = TABLE.read_text(encoding="utf-8").splitlines()
    return {(line["stage"], line["field"]): line for line in csv.DictReader(text[1:])}


def moves(line: Mapping[str, str] | None) -> bool:
    """Whether a field moves an answer: its terms, its verdict, or a coefficient by a standard deviation."""
    if line is None:
        return False
    counted = [line[f"{what}_{factor}"] for what in ("terms", "verdict") for factor in ("half", "double")]
    return any(map(int, counted)) or float(line["most_sd"]) >= ANOTHER


def _said(line: Mapping[str, str] | None) -> str:
    if line is None:
        return "not tried"
    if line["read"] == "0":
        return "not read"
    parts = [
        f"{what} {' and '.join(counted)}"
        for what in ("terms", "verdict", "warnings")
        if (counted := [line[f"{what}_{factor}"] for factor in ("half", "double")]) != ["0", "0"]
    ]
    parts += [f"{line['most_sd']} sd"] if float(line["most_sd"]) >= 0.01 else []
    text = ", ".join(parts) or "no"
    return f"**{text}**" if moves(line) else text


def _value(one: Field[Any]) -> str:
    """The default as it is written, with its unit."""
    value = one.default
    text = f"{value:,}" if isinstance(value, int) else f"{value:g}"
    if isinstance(value, float) and value == math.exp(-1.0):
        text = "1/e"
    return f"{text} {one.metadata['unit']}".strip()


def _rests(one: Field[Any]) -> str:
    return re.sub(r"`(\w+\.csv)`", r"[\1](tables/\1)", one.metadata["rests_on"])


def _rows(stage: str, lines: Lines) -> Iterator[str]:
    if stage == "MOVING":
        yield "| field | default | at half and at twice | what speaks for it |\n|---|---|---|---|"
        for name, settings in STAGES.items():
            for one in fields(settings):
                if moves(lines.get((name, one.name))):
                    yield f"| `{name}.{one.name}` | {_value(one)} | {_said(lines[name, one.name])} | {_rests(one)} |"
        return
    yield "| field | default | what it decides | rests on | moves |\n|---|---|---|---|---|"
    for one in fields(STAGES[stage]):
        about = one.metadata["about"] + (" **Cliff.**" if one.metadata["cliff"] else "")
        line = lines.get((stage, one.name))
        said = "**above**" if moves(line) else _said(line)
        yield f"| `{one.name}` | {_value(one)} | {about} | {_rests(one)} | {said} |"


def page(text: str) -> str:
    """The page with its tables written anew."""
    lines = sensitivity()
    return MARKED.sub(lambda mark: mark[1] + "\n".join(_rows(mark[2], lines)) + "\n" + mark[3], text)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
