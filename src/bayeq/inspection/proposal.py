"""The command to run next, ready to paste, and the same in Python."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from bayeq.errors import some_of
from bayeq.inspection.roles import Clue, Guess

# Products of up to three states and inputs for first-order states; up to two where there are fewer rows for each term.
CUBIC, QUADRATIC = "polynomial:3", "polynomial:2"
ROWS_PER_TERM = 10


@dataclass(frozen=True, slots=True)
class Reading:
    """How the file is to be read; `time` to `rows` as the options of the same name, `channels` as name and path."""

    files: tuple[str, ...] = ()  # empty where the record is no file
    time: str | None = None
    fs: float | None = None
    names: str | None = None
    group: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    channels: Mapping[str, str] = field(default_factory=dict)
    skip: int = 0
    rows: slice | None = None
    sheet: str | None = None
    clocked: bool = True  # whether there is time at all
    unnumbered: bool = False  # whether time starts over and no column numbers the experiments


@dataclass(frozen=True, slots=True)
class Proposal:
    """What to run next."""

    command: str | None  # for a shell, quoted; None where the record is no file
    python: str  # the same as a line of Python
    complete: bool  # whether it can be run as it is, without a placeholder
    notes: tuple[str, ...]  # a sentence for each placeholder and each choice that may be another

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return {**asdict(self), "notes": list(self.notes)}


def propose(guess: Guess, clues: Mapping[str, Clue], reading: Reading, rows: int) -> Proposal:
    """Command and notes for what was found out about a file, or files, of this many rows."""
    options: list[tuple[str, str]] = []
    notes: list[str] = []
    if not reading.clocked and reading.files:
        notes.append(
            "RATE: there is no time in the file; write the sampling rate in Hz, or name the column of time (--time)"
        )
    elif not reading.clocked:
        notes.append("the record has no time: make it with time= or fs=, as in Record.from_arrays(x=x, fs=1000)")
    if reading.unnumbered:
        notes.append(
            "its time starts over: this works once a column numbers the experiments (--group), or with a file for each"
        )
    arguments = _roles(guess, options, notes)
    dictionary = _dictionary(guess, clues, rows)
    if dictionary is not None:
        options.append(("--dictionary", dictionary))
        arguments.append(f"dictionary={dictionary!r}")
    _say_undecided(guess, notes)
    command = None
    if reading.files:
        files = [name if not name.startswith("-") else f"./{name}" for name in reading.files]
        words = ["bayeq", "discover", *files]
        paths = {name: f"{name}={path}" for name, path in reading.channels.items() if name != path}
        roles = ((option, ":".join(paths.get(name, name) for name in value.split(":"))) for option, value in options)
        for option, value in (*_reading_options(reading), *roles):
            words += [option, value]
        command = " ".join(shlex.quote(word) for word in words)
    complete = reading.clocked and bool(guess.chains) and not reading.unnumbered
    return Proposal(command, _python(reading, arguments), complete, tuple(notes))


def _reading_options(reading: Reading) -> list[tuple[str, str]]:
    out = [(f"--{key}", value) for key in ("time", "names", "group") if (value := getattr(reading, key)) is not None]
    out += [("--units", ",".join(f"{name}={unit}" for name, unit in reading.units.items()))] if reading.units else []
    out += [("--skip", str(reading.skip))] if reading.skip else []
    out += [("--sheet", reading.sheet)] if reading.sheet else []
    if reading.rows is not None:
        first, last = ("" if end is None else end for end in (reading.rows.start, reading.rows.stop))
        out.append(("--rows", f"{first}:{last}"))
    if reading.fs is not None:
        out.append(("--fs", f"{reading.fs:.12g}"))
    elif not reading.clocked:
        out.append(("--fs", "RATE"))
    return out


def _roles(guess: Guess, options: list[tuple[str, str]], notes: list[str]) -> list[str]:
    """Options of chains and inputs; returns the same as Python arguments."""
    if not guess.chains:
        options.append(("--disp", "DISPLACEMENT"))
        notes.append(
            "DISPLACEMENT: no channel says what it is; write it, and --vel, --acc, --force (first order: --chain NAME)"
        )
        arguments = ["displacement='DISPLACEMENT'"]
    elif len(guess.chains) == 1 and len(guess.chains[0]) == 3:
        arguments = []
        for option, word, name in zip(
            ("--disp", "--vel", "--acc"), ("displacement", "velocity", "acceleration"), guess.chains[0], strict=True
        ):
            if name is not None:
                options.append((option, name))
                arguments.append(f"{word}={name!r}")
    else:
        texts = [":".join(name or "" for name in chain) for chain in guess.chains]
        options += [("--chain", text) for text in texts]
        arguments = [f"chains={texts!r}"]
    single = len(guess.inputs) == 1 and not (guess.chains and len(guess.chains[0]) == 1)
    if single and len(guess.chains) < 2:
        options.append(("--force", guess.inputs[0]))
        arguments.append(f"force={guess.inputs[0]!r}")
    elif guess.inputs:
        options += [("--input", name) for name in guess.inputs]
        arguments.append(f"inputs={list(guess.inputs)!r}")
    return arguments


def _dictionary(guess: Guess, clues: Mapping[str, Clue], rows: int) -> str | None:
    """Terms that suit the chains; None for the default, eq. (31)."""
    if not guess.chains:
        return None
    if any(len(chain) == 1 for chain in guess.chains):
        variables = len(guess.chains) + len(guess.inputs)
        return CUBIC if rows >= ROWS_PER_TERM * (math.comb(variables + 3, 3) - 1) else QUADRATIC
    if len(guess.chains) > 1:
        return QUADRATIC
    motion = guess.chains[0][0]
    if motion is not None and clues[motion].angle:
        return f"oscillator + sin({motion}) + cos({motion})"
    return None


def _say_undecided(guess: Guess, notes: list[str]) -> None:
    notes += guess.questions
    notes += [f"{name} is not used: it {guess.reasons[name]}" for name in guess.undecided if name in guess.reasons]
    open_ = [name for name in guess.undecided if name not in guess.reasons]
    if open_ and guess.chains:
        notes.append(
            f"not used: {some_of(open_, 30)}; an input: --input {shlex.quote(open_[0])}; a coordinate of its own:"
            f" --chain {shlex.quote(open_[0] + '::')}"
        )
    elif guess.chains and not guess.inputs:
        notes.append("no channel is known to be a force: without one the motion is taken as free")


def _python(reading: Reading, arguments: Sequence[str]) -> str:
    if not reading.files:
        return f"bq.discover(record, {', '.join(arguments)})"
    keys = ("time", "fs", "names", "group", "units", "channels", "skip", "sheet")
    options = [f"{key}={getattr(reading, key)!r}" for key in keys if getattr(reading, key)]
    if not reading.clocked and reading.fs is None:
        options.append("fs=RATE")
    read = [f"bq.read({', '.join([repr(file), *options])})" for file in reading.files]
    take = "" if reading.rows is None else f".take(slice({reading.rows.start}, {reading.rows.stop}))"
    if reading.group is not None:  # each is a list of trials
        records = " + ".join(f"[record{take} for record in {one}]" if take else one for one in read)
    else:
        read = [one + take for one in read]
        records = read[0] if len(read) == 1 else f"[{', '.join(read)}]"
    return f"bq.discover({records}, {', '.join(arguments)})"
