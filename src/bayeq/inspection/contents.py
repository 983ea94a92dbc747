"""`RecordInfo`: summary of a record or a file as text, HTML and plain data; `Proposal`: the command to run next."""

from __future__ import annotations

import math
import shlex
import textwrap
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from bayeq.errors import in_digits, printable, some_of
from bayeq.inspection.channels import ChannelInfo, bars
from bayeq.inspection.links import Link
from bayeq.inspection.roles import INPUT, TITLES, Clue, Guess
from bayeq.inspection.rows import Bad, Experiments, Gap
from bayeq.markup import code, items, join, paragraph, shortened, table
from bayeq.records.names import gain_and_unit, rate_and_length

HEADER = (
    "channel", "unit", "likely", "min", "max", "mean", "sd", "missing", "power by octave", "most at", "99 % below",
)  # fmt: skip
LEFT = (0, 1, 2, 8)

# Maximum width of a line; commands, which are copied, and tables of many wide numbers may exceed it.
WIDTH = 100

# Digits of numbers, characters of names and units, and blanks between columns: the first set that fits WIDTH is used.
SIZES = ((4, 24, 2), (3, 24, 2), (3, 24, 1), (3, 16, 1), (3, 12, 1), (3, 8, 1))
SHORT = {"power by octave": "octaves", TITLES[INPUT]: "input"}


@dataclass(frozen=True, slots=True)
class Reading:
    """Options for reading the files: `time` to `sheet` as in `bayeq.read`, `channels` from name to path."""

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
    reversed: tuple[str, ...] = ()  # channels of the opposite sign
    absolute: Mapping[str, str] = field(default_factory=dict)  # acceleration of the base, by absolute acceleration
    unnumbered: bool = False  # whether time starts over and no column numbers the experiments


@dataclass(frozen=True, slots=True)
class Proposal:
    """The proposed command to run next."""

    command: str | None  # for a shell, quoted; None where the record is no file
    python: str  # the same as a line of Python
    complete: bool  # whether it can be run as it is, without a placeholder
    notes: tuple[str, ...]  # a sentence for each placeholder and each uncertain choice

    def to_dict(self) -> dict[str, Any]:
        """The proposal as plain data."""
        return {**asdict(self), "notes": list(self.notes)}


@dataclass(frozen=True, eq=False)
class RecordInfo:
    """Summary of a record or a file; print it, or take `to_dict`.

    Attributes
    ----------
    name : str
        File or label.
    rows : int
        Number of rows in all experiments.
    experiments : Experiments
        The rows by experiment, and the columns that were taken for time and for numbers of experiments.
    fs : float or None
        Sampling rate [Hz], the median one where steps are uneven; None without time.
    uniform : bool
        Whether all steps of time are the same.
    duration : float or None
        Duration of all experiments together [s].
    gaps : tuple of Gap
        Time steps longer than 2.5 median steps.
    channels : mapping of str to ChannelInfo
        Statistics of each channel.
    bad : mapping
        Rows (counted from 1) that are spikes, stuck or clipped, by channel and kind.
    looked_at : int
        Rows that were searched for spikes and stuck stretches: all of a record of up to 20,000 rows and 16 channels,
        the most suspect stretches of a larger one.
    copies : mapping of str to str
        Channels that are the same as another one, which is described instead.
    links : tuple of Link
        Channels that are derivatives of each other.
    guess : Guess
        Likely roles of the channels.
    findings : tuple of str
        Findings, a sentence each.
    proposal : Proposal
        The command to run next.
    clues : mapping of str to Clue
        Role of each channel according to its unit and name.
    reading : Reading
        Options for reading the file.
    """

    name: str
    rows: int
    experiments: Experiments
    fs: float | None
    uniform: bool
    duration: float | None
    gaps: tuple[Gap, ...]
    channels: Mapping[str, ChannelInfo]
    bad: Bad
    looked_at: int
    copies: Mapping[str, str]
    links: tuple[Link, ...]
    guess: Guess
    findings: tuple[str, ...]
    proposal: Proposal
    clues: Mapping[str, Clue]
    reading: Reading

    def __str__(self) -> str:
        return as_text(self)

    def __repr__(self) -> str:
        return f"<RecordInfo of {self.name or 'a record'}: {self.rows} rows, {len(self.channels)} channels>"

    def _repr_html_(self) -> str:
        rows = [_row(self, channel, False, *SIZES[0][:2]) for channel in self.channels.values()]
        parts = [paragraph(title(self), strong=True), table(HEADER, rows, LEFT)]
        for heading, texts in _sections(self):
            parts += [paragraph(heading), items(texts)]
        parts += [paragraph("next"), code(self.proposal.command or self.proposal.python)]
        return join(*parts, items(self.proposal.notes))

    def to_dict(self) -> dict[str, Any]:
        """The summary as plain data, as ``bayeq info --json`` prints it.

        Returns
        -------
        dict
            ``file``, ``rows``;
            ``time``: ``column`` (None unless one was taken for time), ``step_column``, ``fs`` [Hz], ``uniform``,
            ``duration`` [s], ``gaps`` (``row``, ``seconds``, ``long``);
            ``experiments``: ``count``, ``rows`` of each, ``column``, ``time_starts_over``;
            ``channels``: ``name``, ``unit``, ``role``, ``why``, ``missing``, ``min``, ``max``, ``mean``, ``sd``,
            ``constant``, ``resolution``, ``held``, ``bad`` (``samples`` and ``first_row`` by kind) and ``spectrum``
            (``octaves`` [Hz], ``shares``, ``peak`` and ``bandwidth`` [Hz]); ``copies``;
            ``derivatives``: ``below``, ``above``, ``order``, ``gain``, ``delay`` [s], ``fit``, ``expected``;
            ``roles``: ``chains``, ``inputs``, ``undecided``; ``findings``;
            ``next``: ``command``, ``python``, ``complete``, ``notes``. Unknown values are None.
        """
        return {
            "file": self.name,
            "rows": self.rows,
            "time": {
                "column": self.experiments.time,
                "step_column": self.experiments.step,
                "fs": self.fs,
                "uniform": self.uniform,
                "duration": self.duration,
                "gaps": [asdict(gap) for gap in self.gaps],
            },
            "experiments": {
                "count": len(self.experiments.records),
                "rows": [record.n for record in self.experiments.records],
                "column": self.experiments.column,
                "time_starts_over": self.experiments.restarts,
            },
            "channels": [self._channel(channel) for channel in self.channels.values()],
            "copies": dict(self.copies),
            "derivatives": [asdict(link) for link in self.links],
            "roles": {
                "chains": [":".join(name or "" for name in chain) for chain in self.guess.chains],
                "inputs": list(self.guess.inputs),
                "undecided": list(self.guess.undecided),
            },
            "findings": list(self.findings),
            "next": self.proposal.to_dict(),
        }

    def _channel(self, channel: ChannelInfo) -> dict[str, Any]:
        found = channel.spectrum
        numbers = {"min": channel.least, "max": channel.greatest, "mean": channel.mean, "sd": channel.sd}
        return {
            "name": channel.name,
            "unit": channel.unit or None,
            "role": self.guess.role_of(channel.name) or None,
            "why": self.guess.reasons.get(channel.name),
            "missing": channel.missing,
            **{key: value if math.isfinite(value) else None for key, value in numbers.items()},
            "constant": channel.constant,
            "resolution": channel.resolution,
            "held": channel.held,
            "bad": {
                kind: {"samples": len(rows), "first_row": rows[0]}
                for kind, rows in self.bad.get(channel.name, {}).items()
            },
            "spectrum": None if found is None else {**asdict(found), "octaves": list(found.octaves)},
        }


def as_text(found: RecordInfo, plain: bool = False) -> str:
    """The summary; with `plain` in characters that every terminal has."""
    lines = [title(found), ""]
    for digits, longest, blanks in SIZES:
        rows = [HEADER, *(_row(found, channel, plain, digits, longest) for channel in found.channels.values())]
        if digits < SIZES[0][0]:
            rows = [tuple(SHORT.get(cell, cell) for cell in row) for row in rows]
        aligned = _aligned(rows, plain, " " * blanks)
        if len(aligned[0]) <= WIDTH:
            break
    lines += aligned
    for heading, texts in _sections(found):
        lines += ["", heading, *(line for text in texts for line in _wrapped(text))]
    lines += ["", "next", f"  {found.proposal.command or found.proposal.python}"]
    lines += [line for note in found.proposal.notes for line in _wrapped(note)]
    return "\n".join(printable(line.rstrip()) for line in lines)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(
        printable(text), WIDTH, initial_indent="  ", subsequent_indent="    ", break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def title(found: RecordInfo) -> str:
    """Name, rows, rate and duration in one line."""
    name = f"{found.name}: " if found.name else ""
    count = len(found.channels)
    channels = f"{count} channel{'s' * (count != 1)}"
    rows = f"{found.rows} row{'s' * (found.rows != 1)}"
    if found.fs is None or found.duration is None:
        return f"{name}{rows}, {channels}; no time in it: rate and duration are not known"
    clock = found.experiments.records[0].clock
    rate, duration = rate_and_length(f"{found.fs:.6g}", f"{found.duration:.6g}", clock)
    if found.uniform:
        rate = f"at {rate}"
    else:
        rate, step = rate_and_length(f"{found.fs:.4g}", f"{1 / found.fs:.4g}", clock)
        rate = f"at uneven steps, mostly {step} ({rate})"
    number = len(found.experiments.records)
    several = f" in {number} experiments" if number > 1 else ""
    return f"{name}{rows} {rate}, {duration}{several}; {channels}"


def _sections(found: RecordInfo) -> Iterator[tuple[str, Sequence[str]]]:
    if found.guess.reasons:
        roles = ((name, found.guess.role_of(name), found.guess.reasons.get(name)) for name in found.channels)
        why = [f"{shortened(name, SIZES[0][1])}: {role} ({reason})" for name, role, reason in roles if role and reason]
        yield "why", why
    if found.findings:
        yield "noticed", found.findings


def _row(found: RecordInfo, channel: ChannelInfo, plain: bool, digits: int, longest: int) -> tuple[str, ...]:
    numbers = (channel.least, channel.greatest, channel.mean, channel.sd)
    power = channel.spectrum
    spectrum = ("", "", "")
    if power is not None:
        clock = found.experiments.records[0].clock
        unit = "Hz" if clock == "s" else f"1/{clock}"
        peak, below = (f"{in_digits(f, 3)} {unit}" for f in (power.peak, power.bandwidth))
        spectrum = (bars(power, plain), peak, below)
    role = found.guess.role_of(channel.name) or ("constant" if channel.constant else "?")
    values = (f"{value:.{digits}g}" if math.isfinite(value) else "" for value in numbers)
    names = (shortened(text, longest) for text in (channel.name, channel.unit))
    return (*names, role, *values, str(channel.missing or ""), *spectrum)


def _aligned(rows: Sequence[Sequence[str]], plain: bool, gap: str) -> list[str]:
    """Lines of a table with aligned columns; columns that are empty throughout are left out."""
    kept = [k for k in range(len(rows[0])) if k < 3 or any(row[k] for row in rows[1:])]
    widths = {k: max(len(row[k]) for row in rows) for k in kept}
    lines = [gap.join(row[k].ljust(widths[k]) if k in LEFT else row[k].rjust(widths[k]) for k in kept) for row in rows]
    rule = "-" if plain else "─"
    return [lines[0], rule * max(map(len, lines)), *lines[1:]]


# --- the command to run next, ready to paste, and the same in Python --------------------------------------------------

# Dictionaries for first-order states: products of up to three states and inputs, or up to two with few rows per term.
CUBIC, QUADRATIC = "polynomial:3", "polynomial:2"
# Dictionary for displacements of several masses.
NEIGHBOURS = "neighbours"
ROWS_PER_TERM = 10

# What is asked for: the option of the command, the argument of `discover`, and the value or values of both.
Asked = list[tuple[str, str, str | list[str]]]


def propose(
    guess: Guess, clues: Mapping[str, Clue], reading: Reading, rows: int, levels: Collection[str] = ()
) -> Proposal:
    """Propose a command, with notes, for files with these roles, clues and `rows`; `levels` are levels of liquids."""
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
    if not guess.chains:
        notes.append(
            "DISPLACEMENT: no channel says what it is; write it, and --vel, --acc, --force (first order: --chain NAME)"
        )

    paths = {name: f"{name}={path}" for name, path in reading.channels.items() if name != path}

    def asked_of(guess: Guess) -> Asked:
        dictionary = _dictionary(guess, clues, rows, levels)
        return _roles(guess) + ([("--dictionary", "dictionary", dictionary)] if dictionary is not None else [])

    asked = asked_of(guess)
    _say_absolute(guess, clues, reading.absolute, notes)
    _say_undecided(
        guess, clues, notes, lambda *chains: shlex.join(_words(asked_of(replace(guess, chains=chains)), paths))
    )
    command = None
    if reading.files:
        files = [name if not name.startswith("-") else f"./{name}" for name in reading.files]
        words = ["bayeq", "discover", *files]
        for pair in _reading_options(reading):
            words += pair
        command = shlex.join(words + _words(asked, paths))
    complete = reading.clocked and bool(guess.chains) and not reading.unnumbered
    arguments = ", ".join(f"{argument}={value!r}" for _, argument, value in asked)
    return Proposal(command, f"bq.discover({_read_in_python(reading)}, {arguments})", complete, tuple(notes))


def _reading_options(reading: Reading) -> list[tuple[str, str]]:
    out = [(f"--{key}", value) for key in ("time", "names", "group") if (value := getattr(reading, key)) is not None]
    out += [("--units", ",".join(f"{name}={unit}" for name, unit in reading.units.items()))] if reading.units else []
    out += [("--scale", f"{name}=-1") for name in reading.reversed]
    out += [("--remove-offset", f"{name}={base}") for name, base in reading.absolute.items()]
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


def _words(asked: Asked, paths: Mapping[str, str]) -> list[str]:
    """Options for a shell, with a channel's path in the place of its name."""
    each = ((option, one) for option, _, value in asked for one in ([value] if isinstance(value, str) else value))
    return [w for option, one in each for w in (option, ":".join(paths.get(name, name) for name in one.split(":")))]


def _roles(guess: Guess) -> Asked:
    """Options of chains and inputs."""
    out: Asked = []
    if not guess.chains:
        out.append(("--disp", "displacement", "DISPLACEMENT"))
    elif len(guess.chains) == 1 and len(guess.chains[0]) == 3:
        places = (("--disp", "displacement"), ("--vel", "velocity"), ("--acc", "acceleration"))
        out += [(*place, name) for place, name in zip(places, guess.chains[0], strict=True) if name is not None]
    else:
        out.append(("--chain", "chains", [":".join(name or "" for name in chain) for chain in guess.chains]))
    first_order = bool(guess.chains) and len(guess.chains[0]) == 1
    if len(guess.inputs) == 1 and len(guess.chains) < 2 and not first_order:
        out.append(("--force", "force", guess.inputs[0]))
    elif guess.inputs:
        out.append(("--input", "inputs", list(guess.inputs)))
    return out


def _dictionary(guess: Guess, clues: Mapping[str, Clue], rows: int, levels: Collection[str]) -> str | None:
    """The dictionary that suits the chains; None for the default, eq. (31)."""
    if not guess.chains:
        return None
    if any(len(chain) == 1 for chain in guess.chains):
        variables = len(guess.chains) + len(guess.inputs)
        powers = CUBIC if rows >= ROWS_PER_TERM * (math.comb(variables + 3, 3) - 1) else QUADRATIC
        return " + ".join([powers, *(f"sqrt({name})" for (name, *_) in guess.chains if name in levels)])
    if len(guess.chains) > 1:
        low = [clues[next(name for name in chain if name is not None)] for chain in guess.chains]
        # they may be angles of a double pendulum, which no torque drives, but not on a base
        based = any(clues[name].base is not None for name in guess.inputs)
        driven = [clue.by_unit and (not clue.angle or bool(guess.inputs)) for clue in low]
        known = based or all(one or clue.order in (1, 2) for one, clue in zip(driven, low, strict=True))
        return NEIGHBOURS if known and len({clue.angle for clue in low} - {None}) < 2 else QUADRATIC
    motion = guess.chains[0][0]
    if motion is not None and clues[motion].angle:
        angle = f"pi*{motion}/180" if clues[motion].degrees else motion
        return f"oscillator + sin({angle}) + cos({angle})"
    return None


def absolute_or_not(guess: Guess, clues: Mapping[str, Clue]) -> tuple[list[str], str | None]:
    """Accelerations that are all that is known of the motion, and that of the base that drives it, if there is one."""
    accelerations = [chain[-1] for chain in guess.chains if chain[:-1] == (None, None) and chain[-1] is not None]
    known = guess.inputs if len(accelerations) == len(guess.chains) else ()
    return accelerations, next((name for name in known if clues[name].base == 2), None)


def _say_absolute(guess: Guess, clues: Mapping[str, Clue], known: Mapping[str, str], notes: list[str]) -> None:
    """Notes on accelerations beside that of their base; `known` are those that it is subtracted from."""
    accelerations, base = absolute_or_not(guess, clues)
    if base is None:
        return
    those, several = some_of(accelerations, 30), len(accelerations) > 1
    if known:
        notes.append(
            f"{those} {'follow' if several else 'follows'} {base} at low frequency, as absolute accelerations do: it is"
            " subtracted, as the law is of motion against the base"
        )
        return
    how = " ".join(f"--remove-offset {shlex.quote(f'{name}={base}')}" for name in accelerations)
    those += " are" if several else " is"
    notes.append(f"the law is of motion against the base: if {those} absolute, subtract {base} first: {how}")


def _say_undecided(guess: Guess, clues: Mapping[str, Clue], notes: list[str], options: Callable[..., str]) -> None:
    """Notes on questions and channels that are not used; `options` are those of the command with other chains."""
    notes += guess.questions
    second = bool(guess.chains) and len(guess.chains[0]) == 3
    for name in (name for name in guess.undecided if name in guess.reasons):
        other = ""
        if second and clues[name].order == 0:
            other = f"; as a coordinate: {options(*guess.chains, (name, None, None))}"
        notes.append(f"{name} is not used: it {guess.reasons[name]}{other}")
    open_ = [name for name in guess.undecided if name not in guess.reasons]
    if open_ and guess.chains:
        place = max(clues[open_[0]].order or 0, 0)
        own = tuple(open_[0] if k == place else None for k in range(3)) if second else (open_[0],)
        notes.append(
            f"not used: {some_of(open_, 30)}; an input: --input {shlex.quote(open_[0])};"
            f" {'a coordinate' if second else 'a state'} of its own: {options(own, *guess.chains)}"
        )
    elif guess.chains and not guess.inputs:
        notes.append("no channel is known to be a force: the motion is taken to be free")


def _read_in_python(reading: Reading) -> str:
    def changed(record: str) -> str:
        record += "" if reading.rows is None else f".take(slice({reading.rows.start}, {reading.rows.stop}))"
        for name, base in reading.absolute.items():
            record = f"bq.remove_offset({record}, {name!r}, {base!r})"
        return record

    if not reading.files:
        return changed("record")
    gains = {name: gain_and_unit(reading.units.get(name, "")) for name in reading.reversed}
    units = {name: f"{-gain:g} {unit or ''}".strip() for name, (gain, unit) in gains.items()}
    reading = replace(reading, units={**reading.units, **units})
    keys = ("time", "fs", "names", "group", "units", "channels", "skip", "sheet")
    options = [f"{key}={getattr(reading, key)!r}" for key in keys if getattr(reading, key)]
    if not reading.clocked and reading.fs is None:
        options.append("fs=RATE")
    read = [f"bq.read({', '.join([repr(file), *options])})" for file in reading.files]
    if reading.group is not None:  # each is a list of trials
        each = changed("record")
        return " + ".join(one if each == "record" else f"[{each} for record in {one}]" for one in read)
    read = [changed(one) for one in read]
    return read[0] if len(read) == 1 else f"[{', '.join(read)}]"
