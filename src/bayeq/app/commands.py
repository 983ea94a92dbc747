"""The commands that the page runs, from what was chosen: words for a process, never a line for a shell."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bayeq.app.roles import Choice, chains_of, inputs_of, proposed

__all__ = [
    "EQUATION",
    "EXAMPLE",
    "REPORT",
    "Choices",
    "as_typed",
    "discover_command",
    "example_command",
    "info_command",
]

#: Names of the files that are written.
EQUATION, REPORT, EXAMPLE = "equation.json", "report.html", "example.csv"

# What a proposal says of reading, and is kept as it is.
READING = ("--time", "--names", "--group")


@dataclass
class Choices:
    """What was chosen on the page; texts as they were typed.

    Attributes
    ----------
    roles : dict of str to Choice
        By channel.
    dictionary : str
        Candidate terms, as ``--dictionary`` takes them.
    rows, band, fs : str
        Rows ``A:B``, frequencies ``LO:HI`` [Hz], sampling rate [Hz]; empty where none is chosen.
    reading : list of str
        Options that say how the file is read.
    """

    roles: dict[str, Choice] = field(default_factory=dict)
    dictionary: str = "oscillator"
    rows: str = ""
    band: str = ""
    fs: str = ""
    reading: list[str] = field(default_factory=list)

    @classmethod
    def proposed(cls, info: Mapping[str, Any]) -> Choices:
        """What ``bayeq info --json`` proposes to run."""
        words = shlex.split(info["next"]["command"] or "")[3:]
        options = dict(zip(words[::2], words[1::2], strict=False))
        made = cls(roles=proposed(info))
        made.dictionary = options.get("--dictionary", made.dictionary)
        made.reading = [word for key in READING if key in options for word in (key, options[key])]
        rate = options.get("--fs", "")
        made.fs = rate if rate != "RATE" else ""
        return made


def info_command(file: str) -> list[str]:
    """What says what is in a file."""
    return ["info", file, "--json"]


def example_command() -> list[str]:
    """What makes a record to try the page with."""
    return ["simulate", "duffing", "--n", "2000", "-o", EXAMPLE]


def discover_command(file: str, choices: Choices) -> list[str]:
    """What finds the equations; it writes `EQUATION` and `REPORT` where it is run.

    Raises
    ------
    InputError
        Roles that make no chain.
    """
    words = ["discover", file, *choices.reading]
    for chain in chains_of(choices.roles):
        words += ["--chain", chain]
    for name in inputs_of(choices.roles):
        words += ["--input", name]
    for option, text in (
        ("--fs", choices.fs),
        ("--dictionary", choices.dictionary),
        ("--rows", choices.rows),
        ("--band", choices.band),
    ):
        if text.strip():
            words += [option, text.strip()]
    return [*words, "--save", EQUATION, "--report", REPORT]


def as_typed(words: Sequence[str]) -> str:
    """A command as a shell takes it.

    Examples
    --------
    >>> as_typed(["discover", "run 1.csv", "--chain", "x:v:a"])
    "bayeq discover 'run 1.csv' --chain x:v:a"
    """
    return shlex.join(["bayeq", *words])
