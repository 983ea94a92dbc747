"""docs/terms.md lists the language as it is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bayeq.dictionary import FAMILIES, Variables, build_dictionaries
from bayeq.expressions import parse
from bayeq.expressions.functions import ALIASES, CONSTANTS, FUNCTIONS, TIME
from bayeq.expressions.parse import MAX_DEPTH, MAX_LENGTH, MAX_NODES

PAGE = (Path(__file__).parents[1] / "docs" / "terms.md").read_text(encoding="utf-8")


def rows(header: str) -> list[list[str]]:
    """The cells of the table with this header."""
    _, _, rest = PAGE.partition(f"| {header} |")
    lines = rest.partition("\n\n")[0].splitlines()[2:]
    assert lines, header
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def written(name: str) -> str:
    least, most = FUNCTIONS[name].arguments
    arguments = "c, a, b" if name == "where" else ", ".join("ab"[:least]) + (", ..." if most is None else "")
    return f"`{name}({arguments})`"


def test_every_function_is_listed_with_its_meaning_and_spellings():
    expected = {
        written(name): (one.meaning, {alias for alias, of in ALIASES.items() if of == name})
        for name, one in FUNCTIONS.items()
    }
    listed = {
        call: (meaning, set(re.findall(r"`(\w+)`", other)))
        for call, meaning, other in rows("function | value | other spellings")
    }
    assert listed == expected
    assert list(listed) == list(expected)


def test_names_families_and_limits():
    assert {name.strip("`") for name, _ in rows("name | meaning")} == {*CONSTANTS, TIME}
    assert {re.findall(r"`(\w+)", cell)[0] for cell, _ in rows("family | terms")} == set(FAMILIES)
    assert f"{MAX_LENGTH} characters, {MAX_DEPTH} levels and {MAX_NODES} operations" in PAGE


# in a table | has a backslash
WRITTEN = [cell.strip("`").replace("\\|", "|") for cell, _ in rows("written | is") if ".txt" not in cell]


@pytest.mark.parametrize("text", WRITTEN)
def test_the_dictionaries_written_there_are_read(text):
    if ";" in text:
        variables = Variables(("x1", "v1", "x2", "v2"), (), (("x1", "v1"), ("x2", "v2")))
        terms, allowed = build_dictionaries(text, ("a1", "a2"), variables)
        assert allowed.shape == (2, len(terms))
    else:
        variables = Variables(("x", "v"), ("u",), (("x", "v"),))
        assert len(build_dictionaries(text, ("a",), variables)[0]) > 1


def test_the_terms_written_there_are_read():
    for text in ("sin(3*t)", "where(x > 0.1, x - 0.1, 0)", "where(x > 0, log(x), 0)", "square(a)"):
        assert text in PAGE
        parse(text)
