"""`info`: what is in a record or a file, in words that an engineer reads, and the command to run next."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import InputError, RecordError, WordsError
from bayeq.inspection.channels import ChannelInfo, describe_channels
from bayeq.inspection.contents import Contents
from bayeq.inspection.dynamics import drivers, first_order
from bayeq.inspection.links import Link, find_links, short_record
from bayeq.inspection.proposal import Reading, propose
from bayeq.inspection.remarks import remarks
from bayeq.inspection.roles import INPUT, Guess, clue_of, guess_roles
from bayeq.inspection.samples import find_bad
from bayeq.inspection.text import as_html, as_text
from bayeq.inspection.timing import Experiments, gaps_of, sort_rows
from bayeq.records import Record, as_record, check_record, read
from bayeq.records.names import is_time_name

__all__ = ["RecordInfo", "info"]

# Of longer records channels are checked against each other on this many rows, the middle ones.
CHECKED = 40_000


class RecordInfo(Contents):
    """What is in a record or a file; print it, or take `to_dict`. Attributes are those of `Contents`."""

    def __str__(self) -> str:
        return as_text(self)

    def __repr__(self) -> str:
        return f"<RecordInfo of {self.name or 'a record'}: {self.rows} rows, {len(self.channels)} channels>"

    def _repr_html_(self) -> str:
        return as_html(self)

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


def info(
    source: Any,
    *,
    time: str | None = None,
    fs: float | None = None,
    names: Sequence[str] | str | None = None,
    units: Mapping[str, str] | None = None,
    group: str | None = None,
) -> RecordInfo:
    """What is in a record or a file, and what to run next.

    Parameters
    ----------
    source : Record, path, DataFrame or mapping of arrays
        What was measured. A file is opened as `bayeq.read` does; where its time starts over it is divided there.
    time, fs, names, units, group : optional
        As in `bayeq.read`, for files.

    Returns
    -------
    RecordInfo
        Print it; in a notebook it shows itself as a table. ``to_dict()`` holds it as plain data.

    Raises
    ------
    InputError
        A file that cannot be read, or options for something that is no file.

    Examples
    --------
    >>> t = np.arange(2000) / 100
    >>> x, v = np.sin(3 * t) + np.sin(8 * t), 3 * np.cos(3 * t) + 8 * np.cos(8 * t)
    >>> found = info(Record({"x": x, "v": v}, t, {"x": "m", "v": "m/s"}))
    >>> print(found.proposal.python)
    bq.discover(record, displacement='x', velocity='v')
    """
    if isinstance(source, Record):
        given = {"time": time, "fs": fs, "names": names, "units": units, "group": group}
        if any(value is not None for value in given.values()):
            used = next(key for key, value in given.items() if value is not None)
            raise InputError(f"{used} says how a file is read; a Record has been read")
        return _described(sort_rows(source), source.name, Reading(clocked=source.time is not None))
    if not isinstance(source, (str, os.PathLike)):
        return info(as_record(source))
    path = Path(source)
    listed = names if names is None or isinstance(names, str) else ",".join(names)
    reading = Reading((str(path),), time, fs, listed, group)
    experiments, words = _numbers(path, time, fs, group, {"names": names, "units": units})
    found = _described(experiments, path.name, reading)
    return replace(found, findings=(*(f"{name} holds words, not numbers: left out" for name in words), *found.findings))


def _numbers(
    path: Path, time: str | None, fs: float | None, group: str | None, how: Mapping[str, Any]
) -> tuple[Experiments, list[str]]:
    """A file by experiment without its columns of words, and their names."""
    words: list[str] = []
    how = dict(how)
    while True:
        try:
            return _opened(path, time, fs, group, how), words
        except WordsError as error:
            how["columns"] = [name for name in error.others if name not in words]
            if how["names"] is not None or not how["columns"] or error.column in (time, group):
                raise
            words.append(error.column)


def _opened(path: Path, time: str | None, fs: float | None, group: str | None, how: Mapping[str, Any]) -> Experiments:
    """A file by experiment, also one in which time starts over, which `read` refuses."""
    if group is not None:
        return Experiments(tuple(read(path, time=time, fs=fs, group=group, **how)), column=group)
    try:
        return sort_rows(read(path, time=time, fs=fs, **how))
    except RecordError as error:
        if fs is not None:
            raise
        # with a rate, any will do, the column of time is a channel as the others
        record = read(path, fs=1.0, **how)
        column = next((name for name in record.names if name == time or (time is None and is_time_name(name))), None)
        if column is None:
            raise
        try:
            return sort_rows(Record(record.channels, None, record.units, record.name), column)
        except RecordError:
            raise error from None  # which names the row of the file


def _described(experiments: Experiments, name: str, reading: Reading) -> RecordInfo:
    experiments, copies = _without_copies(experiments)
    records = experiments.records
    channels = describe_channels(records)
    moving = [key for key, channel in channels.items() if not channel.constant]
    clues = {key: clue_of(key, channels[key].unit) for key in channels}
    short = short_record(records, channels)
    links = find_links(short, moving)
    derived = {key for link in links for key in (link.below, link.above)}
    free = [key for key in moving if key not in derived and clues[key].order != INPUT and not clues[key].by_unit]
    first = first_order(short, free, [key for key in moving if clues[key].order == INPUT])
    guess = guess_roles(moving, clues, links, first)
    second = [chain for chain in guess.chains if len(chain) == 3]
    if len(second) == 1 and not guess.inputs:
        guess = guess.driven_by(drivers(short, second[0], guess.undecided))
    bad, looked_at = find_bad(records, guess, moving)
    gaps = tuple(gaps_of(records))
    rates = [record for record in records if record.fs is not None]
    reading = _completed(reading, experiments)
    made = RecordInfo(
        name=name,
        rows=sum(record.n for record in records),
        experiments=experiments,
        fs=float(np.median([record.fs for record in rates])) if rates else None,
        uniform=bool(rates) and all(record.is_uniform() for record in records),
        duration=sum(float(r.time[-1] - r.time[0]) for r in records if r.time is not None) if rates else None,
        gaps=gaps,
        channels=channels,
        bad=bad,
        looked_at=looked_at,
        copies=copies,
        links=tuple(link for link in links if _used(link, guess)),
        guess=guess,
        findings=(),
        proposal=propose(guess, clues, reading, sum(record.n for record in records)),
        clues=clues,
        reading=reading,
    )
    return replace(made, findings=tuple(remarks(made, _checks(records, guess))))


def _without_copies(experiments: Experiments) -> tuple[Experiments, dict[str, str]]:
    """Leave out channels that are the same as an earlier one, sample by sample; constant ones stay."""
    records = experiments.records
    seen: dict[tuple[bytes, ...], str] = {}
    copies = {}
    for name in records[0].names:
        # a part shows almost every difference, and is compared first
        key = tuple(record[name][:64].tobytes() for record in records)
        other = seen.setdefault(key, name)
        same = other != name and all(np.array_equal(r[name], r[other], equal_nan=True) for r in records)
        if same and any(np.ptp(r[name]) > 0.0 for r in records):
            copies[name] = other
    if not copies:
        return experiments, copies
    kept = tuple(
        Record({k: v for k, v in r.channels.items() if k not in copies}, r.time,
               {k: u for k, u in r.units.items() if k not in copies}, r.name)
        for r in records
    )  # fmt: skip
    return replace(experiments, records=kept), copies


def _completed(reading: Reading, experiments: Experiments) -> Reading:
    """How to read a file again, with what was found out about its time and experiments."""
    records = experiments.records
    group = experiments.column if len(records) > 1 else None
    step = records[0].dt if experiments.step is not None else None
    found = experiments.time
    return replace(
        reading,
        time=reading.time or (None if found is None or is_time_name(found) else found),
        fs=reading.fs if step is None else 1.0 / step,
        group=reading.group or group,
        clocked=any(record.fs is not None for record in records),
        unnumbered=experiments.restarts and experiments.column is None,
    )


def _used(link: Link, guess: Guess) -> bool:
    """Whether a link is between neighbours of a chain."""
    for chain in guess.chains:
        if link.below in chain and link.above in chain:
            return chain.index(link.above) - chain.index(link.below) == link.order
    return False


def _checks(records: Sequence[Record], guess: Guess) -> list[str]:
    """What channels say of each other, of the longest experiment; clipping is looked for elsewhere."""
    record = max(records, key=lambda one: one.n)
    if record.n > CHECKED:
        first = (record.n - CHECKED) // 2
        record = record.slice(first, first + CHECKED)
    chains = [chain for chain in guess.chains if len(chain) == 3]
    found = check_record(record, chains, guess.inputs) if chains else []
    return [finding.message for finding in found if finding.kind != "clipping"]
