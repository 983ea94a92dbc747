"""`info`: summary of a record or a file in plain words, and the command to run next."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import BayeqError, InputError, LengthsError, RecordError, WordsError, in_digits, some_of
from bayeq.inspection.channels import ChannelInfo, describe_channels
from bayeq.inspection.contents import Proposal, Reading, RecordInfo, absolute_or_not, propose
from bayeq.inspection.first_order import of_first_order
from bayeq.inspection.links import (
    Link,
    absolute,
    correlations,
    drivers,
    find_links,
    first_order,
    follow,
    rough_channels,
    short_record,
    twins,
)
from bayeq.inspection.roles import INPUT, REFERENCE, Guess, clues_of, guess_roles, names_level
from bayeq.inspection.rows import Experiments, find_bad, gaps_of, sort_rows, starts_from_rest
from bayeq.records import Record, as_record, check_record, read
from bayeq.records.findings import Finding, without_copies
from bayeq.records.formats.nested import SHORT
from bayeq.records.names import conversion, gain_and_unit, is_time_name, time_unit
from bayeq.records.record import with_only
from bayeq.states.bad_samples import ADVICE
from bayeq.states.prepare import without_impossible

# In longer records, channels are checked against each other on this many rows in the middle.
CHECKED = 40_000

# Maximum number of bad rows that are listed.
LISTED = 3


def info(
    source: Any,
    *,
    time: str | None = None,
    fs: float | None = None,
    names: Sequence[str] | str | None = None,
    units: Mapping[str, str] | None = None,
    group: str | None = None,
    channels: Mapping[str, str] | None = None,
    skip: int = 0,
    rows: slice | None = None,
    sheet: str | None = None,
) -> RecordInfo:
    """Summarise a record or a file, and propose the command to run next.

    Parameters
    ----------
    source : Record, path, DataFrame or mapping of arrays
        The measured data. A file is read as by `bayeq.read`, and divided where its time starts over.
    time, fs, names, units, group, channels, skip : optional
        As in `bayeq.read`, for files.
    rows : slice, optional
        Rows of each record that are looked at.
    sheet : str, optional
        As in `bayeq.read`.

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
    how = {
        "time": time, "fs": fs, "names": names, "units": units, "group": group, "channels": channels, "skip": skip,
        "sheet": sheet, "rows": rows,
    }  # fmt: skip
    if isinstance(source, Record):
        used = [key for key, value in how.items() if value]
        if used:
            raise InputError(f"{used[0]} says how a file is read; a Record has been read")
        return _described(sort_rows(source), source.name, Reading(clocked=source.time is not None))
    if not isinstance(source, (str, os.PathLike)):
        return info(as_record(source))
    path = Path(source)
    listed = names if names is None or isinstance(names, str) else ",".join(names)
    reading = Reading((str(path),), time, fs, listed, group, dict(units or {}), dict(channels or {}), skip, rows, sheet)
    experiments, remarks = _numbers(path, how)
    found = _described(experiments, path.name, reading)
    return replace(found, findings=(*remarks, *found.findings))


def _numbers(path: Path, how: dict[str, Any]) -> tuple[Experiments, list[str]]:
    """Read a file by experiment, without columns of words and arrays of other lengths; also remarks on these."""
    remarks: list[str] = []
    words: list[str] = []
    while True:
        try:
            found = _opened(path, how)
            by_words = (_by_words(path, how, found, name) for name in words if how["group"] is None)
            found = next((one for one in by_words if one is not None), found)
            left = [f"{name} holds words, not numbers: left out" for name in words if name != found.column]
            return found, left + remarks
        except WordsError as error:
            how["columns"] = [name for name in error.others if name not in words]
            if how["names"] or how["channels"] or not how["columns"] or error.column in (how["time"], how["group"]):
                raise
            words.append(error.column)
        except LengthsError as error:
            if how["names"]:
                raise
            # the most frequent length, short arrays aside; the longest of equally frequent ones
            counts = Counter(size for size in error.sizes.values() if size > SHORT * max(error.sizes.values()))
            usual = max(counts.items(), key=lambda one: (one[1], one[0]))[0]
            how["columns"] = [name for name, size in error.sizes.items() if size == usual]
            others = some_of([f"{name} ({size})" for name, size in error.sizes.items() if size != usual], 30)
            remarks.append(f"of arrays of {usual} samples; there are others: {others} (--channel NAME)")


def _by_words(path: Path, how: Mapping[str, Any], found: Experiments, column: str) -> Experiments | None:
    """The file by the runs of a column of words, if these tell experiments apart; `found` is the file without it."""
    try:
        parts = read(path, **{**how, "group": column, "fs": 1.0, "time": None})
    except BayeqError:
        return None
    runs = np.repeat(np.arange(len(parts), dtype=np.float64), [part.n for part in parts])
    if how["rows"] is not None or len(runs) != sum(record.n for record in found.records):
        return None
    again = _opened(path, how, {column: runs})
    return again if again.column == column else None


def _opened(path: Path, how: Mapping[str, Any], also: Mapping[str, Floats] | None = None) -> Experiments:
    """Read a file by experiment, also one in which time starts over, which `read` refuses; with channels `also`."""
    time, group = how["time"], how["group"]
    found: list[Record] | Record
    try:
        found = read(path, **how)
        if isinstance(found, list):
            return Experiments(tuple(found), column=group)
        return sort_rows(found.with_channels(also or {}))
    except RecordError as error:
        if how["fs"] is not None or group is not None:
            raise
        # given a rate (any value), the time column is read as a channel
        record = read(path, **{**how, "fs": 1.0, "time": None})
        column = next((name for name in record.names if name == time or (time is None and is_time_name(name))), None)
        if column is None:
            raise
        try:
            return sort_rows(Record({**record.channels, **(also or {})}, None, record.units, record.name), column)
        except RecordError:
            raise error from None  # the first error names the row of the file


@np.errstate(all="ignore")  # of huge and tiny numbers
def _described(experiments: Experiments, name: str, reading: Reading) -> RecordInfo:
    experiments, copies = _without_copies(experiments)
    records, impossible = without_impossible(experiments.records, experiments.records[0].names)
    experiments = replace(experiments, records=tuple(records))
    channels = describe_channels(records)
    moving = [key for key, channel in channels.items() if not channel.constant]
    clues = clues_of({key: one.unit for key, one in channels.items()})
    short = short_record(records, channels)
    of_base = absolute(short, *([key for key in moving if clues[key].order in k] for k in ((0,), (2,), (2, INPUT))))
    moving = [key for key in moving if key not in of_base]
    for below, base in of_base.values():
        why = f"{clues[base].why}; of the base against which {below} is measured"
        clues = {**clues, base: replace(clues[base], order=INPUT, why=why)}
    bases = {base for _, base in of_base.values()}
    links = find_links(short, [key for key in moving if key not in bases])
    derived = {key for link in links for key in (link.below, link.above)}
    other = (INPUT, REFERENCE)
    free = [key for key in moving if key not in derived and clues[key].order not in other and not clues[key].by_unit]
    first = first_order(short, free, [key for key in moving if clues[key].order == INPUT])
    alike = correlations(short, moving)
    rough = rough_channels(short, moving)
    guess = guess_roles(moving, clues, links, first, alike, twins(short, alike), rough, short.dt or 0.0)
    second = [chain for chain in guess.chains if len(chain) == 3]
    if len(second) == 1 and not guess.inputs:
        unknown = [key for key in guess.undecided if clues[key].order is None]
        guess = guess.driven_by(drivers(short, second[0], unknown), alike)
    guess = of_first_order(guess, clues, short).without_absolute(of_base)
    bad, looked_at = find_bad(records, guess, moving)
    gaps = tuple(gaps_of(records))
    rates = [record for record in records if record.fs is not None]
    checks = _checks(records, guess)
    reading = _completed(reading, experiments, checks)
    # angles without a unit beyond -2 pi and 2 pi: in rad they would turn back and forth by whole turns
    whole = {key for key, one in channels.items() if one.least < -2.0 * math.pi and one.greatest > 2.0 * math.pi}
    turning = [key for key in moving if clues[key].angle and not channels[key].unit and key in whole]
    accelerations, ground = absolute_or_not(guess, clues)
    if ground is not None and follow(short, accelerations, ground):
        reading = replace(reading, absolute=dict.fromkeys(accelerations, ground))
    units = {**reading.units, **dict.fromkeys(turning, "deg")}
    one_unit = dict(_in_one_unit(guess, channels, units))
    reading = replace(reading, units={**units, **one_unit})
    clues = {key: replace(clue, degrees=clue.degrees or key in turning) for key, clue in clues.items()}
    how = "turns to and fro by more than 2 pi: taken in degrees; of radians leave out --units"
    said = [f"{key} {how}" for key in turning]
    if not reading.files:
        said += [f"{key} is to be in the unit of the others: {one}" for key, one in one_unit.items()]
    guess = replace(guess, questions=(*guess.questions, *said))
    for finding in checks:
        if finding.kind == "exchanged":
            guess = guess.exchanged(*finding.channels)
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
        proposal=propose(guess, clues, reading, sum(record.n for record in records), _levels(channels)),
        clues=clues,
        reading=reading,
    )
    parts = (_on_time, _on_experiments, _on_channels, _on_bad_samples)
    noticed = (text for part in parts for text in part(made))
    return replace(made, findings=(*noticed, *impossible, *(one.message for one in checks)))


def _in_one_unit(
    guess: Guess, channels: Mapping[str, ChannelInfo], stated: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Units that convert the channels of several masses to the unit of the first, since terms are their differences."""
    for alike in zip(*guess.chains, strict=False) if len(guess.chains) > 1 and len(guess.chains[0]) == 3 else ():
        known = [(name, channels[name].unit) for name in alike if name is not None and channels[name].unit]
        for name, unit in known[1:]:
            factor = conversion(unit, known[0][1])
            if factor not in (None, 1.0):
                gain, _ = gain_and_unit(stated.get(name, ""))
                yield name, f"{gain * factor:.12g} {known[0][1]}"


def _levels(channels: Mapping[str, ChannelInfo]) -> set[str]:
    """Names of liquid levels above 0 throughout: outflow is proportional to their square root."""
    return {name for name, one in channels.items() if names_level(name) and one.least > 0.0}


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
    kept = tuple(with_only(record, [name for name in record.names if name not in copies]) for record in records)
    return replace(experiments, records=kept), copies


def _completed(reading: Reading, experiments: Experiments, checks: Sequence[Finding]) -> Reading:
    """Options for reading a file again, with the time, experiments, signs and exchanged columns that were found."""
    records = experiments.records
    units, known = dict(reading.units), records[0].units
    for finding in checks:
        if finding.kind == "exchanged":
            p, q = finding.channels
            units.update({name: known[other] for name, other in ((p, q), (q, p)) if other in known})
    group = experiments.column if len(records) > 1 else None
    step = records[0].dt if experiments.step is not None else None
    found = experiments.time
    return replace(
        reading,
        time=reading.time or (None if found is None or is_time_name(found) else found),
        fs=reading.fs if step is None else 1.0 / step,
        group=reading.group or group,
        units=units,
        reversed=tuple(finding.channels[0] for finding in checks if finding.kind == "sign"),
        clocked=any(record.fs is not None for record in records),
        unnumbered=experiments.restarts and experiments.column is None,
    )


def _used(link: Link, guess: Guess) -> bool:
    """Whether a link agrees with a chain: the distance of its channels there is its order."""
    for chain in guess.chains:
        if link.below in chain and link.above in chain:
            return chain.index(link.above) - chain.index(link.below) == link.order
    return False


def _checks(records: Sequence[Record], guess: Guess) -> list[Finding]:
    """Findings of `check_record` in the longest experiment, without clipping, which `find_bad` looks for."""
    record = max(records, key=lambda one: one.n)
    if record.n > CHECKED:
        first = (record.n - CHECKED) // 2
        record = record.slice(first, first + CHECKED)
    chains = [chain for chain in guess.chains if len(chain) == 3]
    found = check_record(record, chains, guess.inputs) if chains else []
    return [finding for finding in found if finding.kind != "clipping"]


def proposal_for_all(found: Sequence[RecordInfo]) -> Proposal | None:
    """The command for all files; None for a single file, or if roles or options for reading differ."""
    first = found[0]
    alike = [(one.guess.chains, one.guess.inputs, replace(one.reading, files=(), absolute={})) for one in found]
    if len(found) < 2 or any(one != alike[0] for one in alike):
        return None
    files = tuple(file for one in found for file in one.reading.files)
    of_base = {name: base for one in found for name, base in one.reading.absolute.items()}
    rows = sum(one.rows for one in found)
    levels = _levels(first.channels).intersection(*(_levels(one.channels) for one in found))
    return propose(first.guess, first.clues, replace(first.reading, files=files, absolute=of_base), rows, levels)


def copies_among(found: Sequence[RecordInfo]) -> list[str]:
    """A sentence on each file with the samples of an earlier one."""
    records = [replace(one.experiments.records[0], name=one.name) for one in found if len(one.experiments.records) == 1]
    alike = [record for record in records if record.names == records[0].names]
    return without_copies(alike, alike[0].names)[1] if alike else []


# --- what was noticed, a sentence each ------------------------------------------------------------------------------


# Plurals of units of time that are not the unit with an s.
DURATIONS = {"d": "days", "h": "hours", "min": "minutes"}


def _on_time(found: RecordInfo) -> Iterator[str]:
    column = found.experiments.time
    if column is not None and not found.experiments.restarts:
        clock = time_unit(column) or found.experiments.records[0].clock
        named = DURATIONS.get(clock, clock.removesuffix("s") + "s")
        unit = "seconds unless its header has a unit" if clock == "s" else named
        yield f"time: no column has its name; {column}, which rises, is taken, in {unit}"
    if found.experiments.step is not None:
        yield f"time: {found.experiments.step} is constant and named as the time step [s]: taken for it"
    if found.experiments.counter is not None:
        yield f"{found.experiments.counter} counts the rows: it is no channel and no time"
    if found.fs is not None and not found.uniform:
        yield "steps of time are uneven: spectra are those of samples interpolated between them"
    if found.gaps:
        longest = max(found.gaps, key=lambda gap: gap.seconds)
        gaps = "1 gap" if len(found.gaps) == 1 else f"{len(found.gaps)} gaps, the longest"
        where = f"{gaps} of {longest.seconds:.4g} s after row {longest.row}"
        yield f"time: {where}; discover divides the record at long gaps"


def _on_experiments(found: RecordInfo) -> Iterator[str]:
    one = found.experiments
    if one.backwards:
        yield "time runs backwards: sort the rows by it"
    count = len(one.records)
    if count == 1:
        yield from [f"{one.column} numbers the experiments: there is one"] if one.column else _on_parts(found)
        return
    least, most = min(record.n for record in one.records), max(record.n for record in one.records)
    rows = f"{least} row{'s' * (least != 1)} each" if least == most else f"{least} to {most} rows each"
    first = 1 + one.records[0].n
    how = f": time starts over, first in row {first}; number them in a column (--group)"
    yield f"{count} experiments, {rows}" + (how if one.column is None else f", numbered by {one.column}")
    yield from without_copies(one.records, one.records[0].names)[1]


def _on_parts(found: RecordInfo) -> Iterator[str]:
    """A finding if one experiment may be several: time jumps, or the motion begins again from rest."""
    record = found.experiments.records[0]
    names = [name for chain in found.guess.chains if len(chain) == 3 for name in chain if name is not None]
    peaks = [power.peak for name in names if (power := found.channels[name].spectrum) is not None and power.peak > 0.0]
    again = starts_from_rest(record, [*names, *found.guess.inputs], 1.0 / min(peaks)) if peaks else []
    jumps = [gap.row + 1 for gap in found.gaps if gap.long]
    how, rows = ("time jumps before", jumps) if jumps else ("the motion begins again from rest at about", again)
    if rows:
        yield f"{how} {_listed(rows)}: perhaps {len(rows) + 1} experiments (--rows, --group)"


def _on_channels(found: RecordInfo) -> Iterator[str]:
    yield from (f"{name} is the same as {other}: left out" for name, other in found.copies.items())
    for name, channel in found.channels.items():
        if channel.missing == found.rows:
            yield f"{name} has no samples"
        elif channel.missing:
            share = f"{100.0 * channel.missing / found.rows:.3g}"
            samples = "1 sample is" if channel.missing == 1 else f"{channel.missing} samples are"
            yield f"{name}: {samples} missing ({share} %)"
        if channel.constant and channel.missing < found.rows:
            yield f"{name} is constant, {channel.least:.6g}: it says nothing of the motion"
        if channel.resolution is not None:
            yield f"{name} has few levels, {channel.resolution:.3g} apart: coarse against its range"
        if not channel.unit and any(file.lower().endswith(".wav") for file in found.reading.files):
            yield f"{name} has no unit: a WAV file holds shares of full scale; give both, as --units {name}=125mm/s"
        if channel.held is not None:
            how = "steps of a programme, or " * channel.stepped + "it is sampled slower than the file"
            yield f"{name} changes in every {in_digits(channel.held)} rows only: {how}"


def _listed(rows: Sequence[int]) -> str:
    shown = ", ".join(map(str, rows[:LISTED])) + (", ..." if len(rows) > LISTED else "")
    return f"row{'s' * (len(rows) > 1)} {shown}"


def _on_bad_samples(found: RecordInfo) -> Iterator[str]:
    for name, kinds in found.bad.items():
        for kind, rows in kinds.items():
            what = {"spikes": "spike" if len(rows) == 1 else "spikes"}.get(kind, f"{kind} samples")
            yield f"{name}: {len(rows)} {what}, {_listed(rows)}; discover leaves them out; {ADVICE[kind]}"
    if 0 < found.looked_at < found.rows:
        yield f"spikes and stuck samples were looked for in the most suspect {found.looked_at} of {found.rows} rows"
