"""Files to records, as the options of a command say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayeq.errors import FileFormatError, InputError, UnknownNameError

if TYPE_CHECKING:
    from bayeq.records import Record

__all__ = ["join_records", "read_records"]


def read_records(
    file: Path, used: Sequence[str], paths: Mapping[str, str], options: Mapping[str, Any], some: bool = False
) -> list[Record]:
    """The records of a file.

    Parameters
    ----------
    file : Path
        The file.
    used : list of str
        Channels that are used; others need not be numbers.
    paths : mapping of str to str
        Paths of channels, if any are named so.
    options : mapping
        `time`, `fs`, `names` and `group` of `bayeq.read`.
    some : bool
        Whether the file may lack some of the channels, which are in other files.

    Raises
    ------
    InputError
        A file that cannot be read, a channel that is not there, a rate that contradicts the file.
    """
    from bayeq.records import read
    from bayeq.records.names import is_time_name

    names = options["names"]
    options = {**options, "names": None if names is None else [name.strip() for name in names.split(",")]}
    found: Record | list[Record]
    if some:
        found = _read_those_there(file, dict(paths) or {name: name for name in used}, options)
    elif paths:
        found = read(file, channels=paths, **options)
        if options["fs"] is not None:
            _require_rate_of_file(file, paths, options)
    else:
        try:
            found = read(file, **options)
        except FileFormatError:
            # Perhaps it is in a column that is not used, where words are welcome.
            found = read(file, columns=used or None, **options)
    records = found if isinstance(found, list) else [found]
    if options["fs"] is not None:
        for record in records:
            for name in filter(is_time_name, record.names):
                _require_rate(record, name)
    return records


def _read_those_there(file: Path, paths: dict[str, str], options: Mapping[str, Any]) -> Record | list[Record]:
    """The channels that a file has, of those of several files."""
    from bayeq.records import read

    while paths:
        try:
            return read(file, channels=paths, **options)
        except UnknownNameError as error:
            lacking = [name for name, path in paths.items() if path == error.name]
            if not lacking:
                raise
            for name in lacking:
                del paths[name]
    raise InputError(f"{file}: none of the channels named is in it")


def join_records(parts: Sequence[Sequence[Record]]) -> list[Record]:
    """Join the records of several files, the first of each with the first of the others and so on."""
    from bayeq.records import join

    if len(parts) < 2:
        raise InputError("--join needs at least two files")
    if len({len(part) for part in parts}) > 1:
        counts = ", ".join(str(len(part)) for part in parts)
        raise InputError(f"--join: the files hold different numbers of records: {counts}")
    return [join(*together) for together in zip(*parts, strict=True)]


def _require_rate_of_file(file: Path, paths: Mapping[str, str], options: Mapping[str, Any]) -> None:
    """Refuse an --fs that contradicts the time of a file, of which only the channels that are named are read."""
    from bayeq.records import read

    try:
        found = read(file, channels=paths, **{**options, "fs": None})
    except InputError:
        return  # what looks like time is none: the rate that is given is all there is
    for record in found if isinstance(found, list) else [found]:
        if record.fs is not None and not 0.99 < record.fs / options["fs"] < 1.01:
            raise InputError(
                f"{record.name}: --fs {options['fs']:g} contradicts the time in the file, sampled at {record.fs:g} Hz;"
                " leave --fs out to use it"
            )


def _require_rate(record: Record, name: str) -> None:
    """Refuse an --fs that contradicts a column that looks like time (with --fs it is read as a channel)."""
    import numpy as np

    from bayeq.records.validate import SECONDS

    with np.errstate(invalid="ignore"):  # of infinite times
        steps = np.diff(record[name])
    # a unit such as ms is that of the column, which is a channel here
    step = float(np.median(steps)) * SECONDS.get(record.units.get(name, "s"), 1.0) if len(steps) else 0.0
    if record.fs is not None and step > 0 and not 0.99 < record.fs * step < 1.01:
        raise InputError(
            f"{record.name}: --fs {record.fs:g} contradicts column {name!r}, whose median step is {step:g}; leave --fs"
            f" out to use the column, or rename it if it is not time"
        )
