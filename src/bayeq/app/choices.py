"""Choices on the page, and the command made from them: a list of arguments for a process, never a shell line."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bayeq.errors import InputError

#: Names of the files that are written.
EQUATION, REPORT = "equation.json", "report.html"

#: Reading options, and their labels on the page.
READING = {
    "--time": "Time column",
    "--group": "Column of trial numbers",
    "--names": "Column names: t, x, u",
    "--sheet": "Sheet of an Excel file",
    "--skip": "Lines to skip at the top",
}

# Text to type as an offset to subtract the mean of a channel.
MEAN = "mean"

DISPLACEMENT, VELOCITY, ACCELERATION = "displacement", "velocity", "acceleration"
STATE, RATE, INPUT = "state", "rate", "input"

#: Roles of channels, and their labels on the page.
ROLES = {
    "": "not used",
    DISPLACEMENT: "displacement or angle",
    VELOCITY: "velocity",
    ACCELERATION: "acceleration",
    INPUT: "force or other input",
    STATE: "state of first order",
    RATE: "rate of that state",
}
MOTION = (DISPLACEMENT, VELOCITY, ACCELERATION)


@dataclass
class Choice:
    """Choices for a channel: its role, a key of `ROLES`, and the number of its coordinate, counted from 1.

    Texts as typed: a unit, which replaces that of the file, and an offset to subtract, a number or ``mean``.
    """

    role: str = ""
    coordinate: int = 1
    unit: str = ""
    offset: str = ""


def chains_of(choices: Mapping[str, Choice]) -> list[str]:
    """The chains that roles make, as ``--chain`` takes them; InputError for none, or roles that contradict each other.

    Examples
    --------
    >>> chains_of({"x": Choice("displacement"), "a": Choice("acceleration"), "u": Choice("input")})
    ['x::a']
    >>> chains_of({"hare": Choice("state"), "lynx": Choice("state")})
    ['hare', 'lynx']
    """
    out: list[str] = []
    for number in sorted({choice.coordinate for choice in choices.values() if choice.role not in ("", INPUT)}):
        of = {name: choice.role for name, choice in choices.items() if choice.coordinate == number}
        names = [_only(of, role, number) for role in MOTION]
        if any(names):
            out.append(":".join(names))
        rate = _only(of, RATE, number)
        states = [name for name, role in of.items() if role == STATE]
        if rate and len(states) != 1:
            raise InputError(
                f"{rate} is the rate of a state: give it and that state, and no other state, the same number of"
                " coordinate"
            )
        out += [f"{name}:{rate}" if rate else name for name in states]
    if not out:
        raise InputError("no channel has a role: say which one is the displacement, velocity, acceleration or state")
    return out


def _only(of: Mapping[str, str], role: str, number: int) -> str:
    """The channel of a role in a coordinate; empty if there is none, InputError for several."""
    names = [name for name, its in of.items() if its == role]
    if len(names) > 1:
        *first, last = names
        raise InputError(
            f"{', '.join(first)} and {last} have both the role {role!r} of coordinate {number}: leave one out, or give"
            " them different numbers of coordinate"
        )
    return names[0] if names else ""


@dataclass
class Choices:
    """All choices on the page; texts as typed, empty if nothing is chosen.

    Roles by channel, candidate terms, rows ``A:B``, band ``LO:HI`` and sampling rate [Hz], as the options of the
    command take them, constraints, one in a line, and the options of `READING` that say how the file is read.
    """

    roles: dict[str, Choice] = field(default_factory=dict)
    dictionary: str = "oscillator"
    rows: str = ""
    band: str = ""
    fs: str = ""
    constraints: str = ""
    reading: dict[str, str] = field(default_factory=lambda: dict.fromkeys(READING, ""))

    @property
    def words(self) -> list[str]:
        """Command-line arguments of the reading options."""
        return [word for option, text in self.reading.items() if text.strip() for word in (option, text.strip())]

    @classmethod
    def proposed(cls, info: Mapping[str, Any]) -> Choices:
        """The choices that `info`, the output of ``bayeq info --json``, proposes."""
        roles = {channel["name"]: Choice() for channel in info["channels"]}
        number = 0
        for chain in info["roles"]["chains"]:
            names = chain.split(":")
            number += len(names) > 1  # single states keep number 1: the page then hides numbers
            for name, role in zip(names, MOTION if len(names) == len(MOTION) else (STATE, RATE), strict=False):
                if name in roles:
                    roles[name] = Choice(role, number if len(names) > 1 else 1)
        roles |= {name: Choice(INPUT) for name in info["roles"]["inputs"] if name in roles}
        words = shlex.split(info["next"]["command"] or "")[3:]
        options = dict(zip(words[::2], words[1::2], strict=False))
        made = cls(roles)
        made.dictionary = options.get("--dictionary", made.dictionary)
        made.reading |= {option: options[option] for option in READING if option in options}
        rate = options.get("--fs", "")
        made.fs = rate if rate != "RATE" else ""
        return made


def discover_command(files: Sequence[str], choices: Choices) -> list[str]:
    """The command that finds the equations and writes `EQUATION` and `REPORT`; InputError for roles without a chain."""
    chosen = [("--chain", chain) for chain in chains_of(choices.roles)]
    chosen += [("--input", name) for name, choice in choices.roles.items() if choice.role == INPUT]
    for name, choice in choices.roles.items():
        unit, offset = choice.unit.strip(), choice.offset.strip()
        chosen += [("--units", f"{name}={unit}")] if unit else []
        chosen += [("--remove-offset", name if offset == MEAN else f"{name}={offset}")] if offset else []
    chosen += [("--fs", choices.fs), ("--dictionary", choices.dictionary)]
    chosen += [("--rows", choices.rows), ("--band", choices.band)]
    chosen += [("--constraint", line) for line in choices.constraints.splitlines()]
    words = [word for option, text in chosen if text.strip() for word in (option, text.strip())]
    return ["discover", *files, *choices.words, *words, "--save", EQUATION, "--report", REPORT]
