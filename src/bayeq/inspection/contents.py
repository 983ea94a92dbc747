"""`RecordInfo`: what was found out about a record or a file, as text, as HTML and as plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from bayeq.errors import printable
from bayeq.inspection.channels import ChannelInfo, bars
from bayeq.inspection.links import Link
from bayeq.inspection.proposal import Proposal, Reading
from bayeq.inspection.roles import Clue, Guess
from bayeq.inspection.rows import Bad, Experiments, Gap
from bayeq.markup import code, items, join, paragraph, table

HEADER = (
    "channel", "unit", "likely", "min", "max", "mean", "sd", "missing", "power by octave", "most at", "99 % below",
)  # fmt: skip
LEFT = (0, 1, 2, 8)

# Longer names and units are cut, so that rows stay rows.
LONGEST_TEXT = 24


@dataclass(frozen=True, eq=False)
class RecordInfo:
    """What is in a record or a file; print it, or take `to_dict`.

    Attributes
    ----------
    name : str
        File or label.
    rows : int
        In all experiments.
    experiments : Experiments
        The rows by experiment, and the columns that were taken for time and for numbers of experiments.
    fs : float or None
        Sampling rate [Hz], the median one where steps are uneven; None without time.
    uniform : bool
        Whether all steps of time are the same.
    duration : float or None
        Of all experiments together [s].
    gaps : tuple of Gap
        Steps of time longer than 2.5 usual ones.
    channels : mapping of str to ChannelInfo
        Numbers of each channel.
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
        What was noticed, a sentence each.
    proposal : Proposal
        What to run next.
    clues : mapping of str to Clue
        What unit and name of each channel say.
    reading : Reading
        How the file is to be read.
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
        rows = [_row(self, channel, False) for channel in self.channels.values()]
        parts = [paragraph(title(self), strong=True), table(HEADER, rows, LEFT)]
        for heading, texts in _sections(self):
            parts += [paragraph(heading), items(texts)]
        parts += [paragraph("next"), code(self.proposal.command or self.proposal.python)]
        return join(*parts, items(self.proposal.notes))

    def to_dict(self) -> dict[str, Any]:
        """What ``bayeq info --json`` prints.

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
            ``next``: ``command``, ``python``, ``complete``, ``notes``. What is not known is None.
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
        def known(value: float) -> float | None:
            return value if math.isfinite(value) else None

        found = channel.spectrum
        return {
            "name": channel.name,
            "unit": channel.unit or None,
            "role": self.guess.role_of(channel.name) or None,
            "why": self.guess.reasons.get(channel.name),
            "missing": channel.missing,
            "min": known(channel.least),
            "max": known(channel.greatest),
            "mean": known(channel.mean),
            "sd": known(channel.sd),
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
    lines += _aligned([HEADER, *(_row(found, channel, plain) for channel in found.channels.values())], plain)
    for heading, texts in _sections(found):
        lines += ["", heading, *(f"  {text}" for text in texts)]
    lines += ["", "next", f"  {found.proposal.command or found.proposal.python}"]
    lines += [f"  {note}" for note in found.proposal.notes]
    return "\n".join(printable(line.rstrip()) for line in lines)


def title(found: RecordInfo) -> str:
    """Name, rows, rate and duration in one line."""
    name = f"{found.name}: " if found.name else ""
    count = len(found.channels)
    channels = f"{count} channel{'s' * (count != 1)}"
    rows = f"{found.rows} row{'s' * (found.rows != 1)}"
    if found.fs is None or found.duration is None:
        return f"{name}{rows}, {channels}; no time in it: rate and duration are not known"
    rate = (
        f"at {found.fs:.6g} Hz"
        if found.uniform
        else f"at uneven steps, mostly {1 / found.fs:.4g} s ({found.fs:.4g} Hz)"
    )
    number = len(found.experiments.records)
    several = f" in {number} experiments" if number > 1 else ""
    return f"{name}{rows} {rate}, {found.duration:.6g} s{several}; {channels}"


def _sections(found: RecordInfo) -> list[tuple[str, Sequence[str]]]:
    out: list[tuple[str, Sequence[str]]] = []
    if found.guess.reasons:
        roles = ((name, found.guess.role_of(name), found.guess.reasons.get(name)) for name in found.channels)
        why = [f"{_cut(name)}: {role} ({reason})" for name, role, reason in roles if role and reason]
        out.append(("why", why))
    if found.findings:
        out.append(("noticed", found.findings))
    return out


def _row(found: RecordInfo, channel: ChannelInfo, plain: bool) -> tuple[str, ...]:
    numbers = (channel.least, channel.greatest, channel.mean, channel.sd)
    power = channel.spectrum
    spectrum = ("", "", "") if power is None else (bars(power, plain), _hertz(power.peak), _hertz(power.bandwidth))
    role = found.guess.role_of(channel.name) or ("constant" if channel.constant else "?")
    values = (f"{value:.4g}" if math.isfinite(value) else "" for value in numbers)
    return (_cut(channel.name), _cut(channel.unit), role, *values, str(channel.missing or ""), *spectrum)


def _hertz(value: float) -> str:
    return f"{value:.3g} Hz"


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 1]}…"


def _aligned(rows: Sequence[Sequence[str]], plain: bool) -> list[str]:
    """Columns under each other; those that are empty throughout are left out."""
    kept = [k for k in range(len(rows[0])) if k < 3 or any(row[k] for row in rows[1:])]
    widths = {k: max(len(row[k]) for row in rows) for k in kept}
    lines = ["  ".join(row[k].ljust(widths[k]) if k in LEFT else row[k].rjust(widths[k]) for k in kept) for row in rows]
    rule = "-" if plain else "─"
    return [lines[0], rule * max(map(len, lines)), *lines[1:]]
