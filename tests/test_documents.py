"""Pages that are run: their Python, their commands, and what these are said to print."""

from __future__ import annotations

import re
import shlex
import warnings
from pathlib import Path

import pytest

from bayeq.cli.app import main

DOCUMENTS = Path(__file__).parents[1] / "docs"

# Each block of the language, in order.
BLOCK = re.compile(r"^```(python|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page):
    return BLOCK.findall((DOCUMENTS / page).read_text(encoding="utf-8"))


def run_console(text, capsys):
    """Commands after $; the lines that follow are parts of lines of their output, in this order."""
    for part in text.split("$ ")[1:]:
        command, *expected = [line for line in part.splitlines() if line.strip()]
        program, *arguments = shlex.split(command)
        assert program == "bayeq"
        assert main(arguments) == 0, capsys.readouterr().err
        printed = iter(capsys.readouterr().out.splitlines())
        for line in expected:
            assert any(line.strip() in out for out in printed), f"{command}: no line with {line.strip()!r}"


@pytest.mark.parametrize("page", ["your_own_file.md", "matlab.md", "batch.md", "tracking.md"])
def test_a_page_does_what_it_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    found = blocks(page)
    assert {language for language, _ in found} >= {"python"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for language, text in found:
            if language == "python":
                exec(compile(text, page, "exec"), names)  # noqa: S102
            else:
                run_console(text, capsys)


def test_a_page_that_says_what_is_not_so_fails(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match="no line with 'no such system'"):
        run_console("$ bayeq systems\nno such system\n", capsys)
