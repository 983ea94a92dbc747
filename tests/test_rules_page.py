"""docs/rules.md names constants by file and name: they are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
ROW = re.compile(r"^\|([^|]*)\|([^|]*)\|", re.MULTILINE)


def named():
    """The rule, the file and the constants of every row."""
    for rule, where in ROW.findall((ROOT / "docs/rules.md").read_text(encoding="utf-8")):
        file = None
        for word in re.findall(r"`([^`]+)`", where):
            if word.endswith(".py"):
                file = ROOT / "src/bayeq" / word
            elif file is not None and re.fullmatch(r"[A-Z][A-Z_0-9]*", word):
                yield rule.strip(), file, word


def test_constants_of_the_rules_are_in_their_files():
    found = list(named())
    assert len(found) > 150
    missing = [
        (rule, file.name, name)
        for rule, file, name in found
        if not file.exists() or not re.search(rf"^[A-Z_0-9, ]*\b{name}\b[A-Z_0-9, ]*(:[^=]*)?=", file.read_text(), re.M)
    ]
    assert not missing
