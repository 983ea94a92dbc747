"""Plain wording: README, documentation, help and docstrings keep to the words of the field and of plain English."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# What is not written, and what is written instead.
AVOIDED = {
    r"\b(told|tells|telling|warned) of\b": "reported, says, warns about",
    r"\b(is|are) told\b": "is reported, is passed",
    r"\b(is|are|was|were|be) had\b(?! been)": "is computed, are estimated",
    r"\banew\b": "again",
    r"\bstand(s|ing)? in for\b": "replaces, compensates for",
    r"\b(a|the) person\b": "the user, as text",
    r"\bof (no )?use\b(?! of)": "useful",
    r"\bhangs? on\b": "depends on",
    r"\b(by|in) turns\b": "alternately",
    r"\breckons? with\b": "accounts for",
    r"\bunseen forces?\b": "process noise, forces not in the record",
    r"\bso (many|much)\b(?! that)": "this many, a number of",
    r"\btrifle\b": "negligible",
    r"\bbeside the equation\b": "after the equation",
}

# The Kalman filter's arrays have a column of this name.
VARIABLES = {"anew": ("kalman.py", "rts.py", "rows.py", "smoother.py")}


def prose():
    files = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [*files, *sorted((ROOT / "src" / "bayeq").rglob("*.py"))]


@pytest.mark.parametrize("pattern", AVOIDED)
def test_no_dialect(pattern):
    found = []
    for path in prose():
        if any(word in pattern and path.name in names for word, names in VARIABLES.items()):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if re.search(pattern, line, re.IGNORECASE):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not found, f"write: {AVOIDED[pattern]}\n" + "\n".join(found)
