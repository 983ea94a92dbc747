"""Run a page of the documentation: its Python, its commands, and what these are said to print.

``python`` blocks of a page share their names. A ``text`` block directly after one holds parts of lines that it prints,
in this order. In a ``console`` block they follow their command. Numbers agree within 5 %, and ``...`` is anything.
"""

from __future__ import annotations

import io
import math
import re
import shlex
import warnings
from collections.abc import Iterable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from bayeq.cli.app import main

__all__ = ["Block", "blocks", "check_printed", "run_page"]

# Another computer may round otherwise, and an optimiser end a little beside.
TOLERANCE = 0.05

NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
RULE = re.compile(r"[-|─\s]+")


class Block(NamedTuple):
    """A block of code: its language, its text, and whether nothing but empty lines stand between it and the last."""

    language: str
    text: str
    follows: bool


def blocks(page: Path) -> list[Block]:
    """The blocks between fences of a page, in order."""
    found: list[Block] = []
    lines: list[str] | None = None
    language, follows = "", False
    for line in page.read_text(encoding="utf-8").splitlines():
        if lines is not None and line == "```":
            found.append(Block(language, "\n".join(lines) + "\n", follows))
            lines, follows = None, True
        elif lines is not None:
            lines.append(line)
        elif line.startswith("```"):
            language, lines = line.removeprefix("```"), []
        elif line.strip():
            follows = False
    if lines is not None:
        raise ValueError(f"{page}: the last block of {language} has no end")
    return found


def run_page(page: Path) -> None:
    """Run a page in the current folder.

    Raises
    ------
    AssertionError
        A command failed, or a block printed something else than the page says.
    """
    names: dict[str, object] = {"__name__": "__page__"}
    printed = ""
    for block in blocks(page):
        if block.language == "python":
            printed = _run_python(block.text, f"{page.name}, python block", names)
        elif block.language == "console":
            _run_console(block.text)
        elif block.language == "text" and block.follows and printed:
            check_printed(block.text.splitlines(), printed, page.name)
        printed = printed if block.language == "python" else ""


def check_printed(expected: Iterable[str], printed: str, what: str) -> None:
    """Whether each expected line is part of a printed line, in this order.

    Raises
    ------
    AssertionError
        One is not.
    """
    lines = iter(printed.splitlines())
    for line in expected:
        if not RULE.fullmatch(line) and line:
            assert any(_within(line.strip(), out) for out in lines), (
                f"{what}: no line with {line.strip()!r}:\n{printed}"
            )


def _within(said: str, line: str) -> bool:
    """Whether a line holds what was said, numbers within the tolerance and blanks of any width."""
    words = [re.sub(r"(\\ )+", r"\\s+", re.escape(word)).replace(r"\.\.\.", ".*") for word in NUMBER.split(said)]
    match = re.search(f"({NUMBER.pattern})".join(words), line)
    return match is not None and all(
        math.isclose(float(a), float(b), rel_tol=TOLERANCE)
        for a, b in zip(NUMBER.findall(said), match.groups(), strict=True)
    )


def _run_python(text: str, what: str, names: dict[str, object]) -> str:
    printed = io.StringIO()
    with redirect_stdout(printed), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(text, what, "exec"), names)  # noqa: S102
    return printed.getvalue()


def _run_console(text: str) -> None:
    for part in text.split("$ ")[1:]:
        command, *expected = part.splitlines()
        program, *arguments = shlex.split(command)
        assert program == "bayeq", command
        printed, said = io.StringIO(), io.StringIO()
        with redirect_stdout(printed), redirect_stderr(said):
            code = main(arguments)
        assert code == 0, f"{command}: exit code {code}\n{said.getvalue()}"
        check_printed(expected, printed.getvalue(), command)
