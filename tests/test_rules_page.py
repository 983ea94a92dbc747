"""docs/rules.md is what the settings say, and what they rest on is there."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest
from studies.rules import PAGE, STAGES, moves, page, sensitivity

ROOT = Path(__file__).parent.parent
EVERY = [pytest.param(stage, one, id=f"{stage}.{one.name}") for stage, own in STAGES.items() for one in fields(own)]


def test_the_page_is_written_from_the_settings():
    text = PAGE.read_text(encoding="utf-8")
    assert page(text) == text, "python -m studies.rules"
    assert set(STAGES) < set(re.findall(r"<!-- settings: (\w+) -->", text))


@pytest.mark.parametrize(("stage", "one"), EVERY)
def test_what_a_field_rests_on_is_there(stage, one):
    head = PAGE.read_text(encoding="utf-8").split("\n## ")[0].lower()
    for word in one.metadata["rests_on"].split("; "):
        word = re.sub(r" \(.*\)$", "", word)
        if word.startswith("`"):
            name = word.strip("`")
            assert (ROOT / ("docs/tables" if name.endswith(".csv") else "") / name).is_file(), name
        else:
            assert word.lower() in head, word
    assert one.metadata["about"][0].isupper() or one.metadata["about"].startswith("...")


def test_few_settings_and_fewer_that_move_an_answer():
    lines = sensitivity()
    assert len(EVERY) <= 120
    assert sum(moves(lines.get((stage, one.name))) for stage, own in STAGES.items() for one in fields(own)) <= 25
