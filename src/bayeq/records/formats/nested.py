"""Files of many arrays: each is a channel, named by its path (docs/files.md); a record takes those of one length."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError, LengthsError, UnknownNameError, some_of
from bayeq.records.columns import RATE_NAMES, STEP_NAMES, Columns, Headers, Names, Request
from bayeq.records.names import clean_name, is_time_name
from bayeq.records.validate import SECONDS

#: Maximum number of rows of a matrix that are listed as channels, of arrays in a file, and of levels of nesting.
MOST_ROWS = 1000
MOST_ARRAYS = 100_000
DEEPEST = 64
#: Without requested names, arrays longer than this share of a record must have its length. Shorter ones are left out,
#: with a warning if they hold more numbers than this.
SHORT, SETTINGS = 0.1, 16

#: All rows.
EVERY = slice(None)


@dataclass(frozen=True, slots=True)
class Channel:
    """An array of a file."""

    path: str  # place in the file
    size: int  # number of samples
    values: Callable[[slice], Any]  # the samples of a slice of the rows
    label: str | None = None  # name, before cleaning; None for the path
    unit: str | None = None
    step: float | None = None  # time step [s] that the file states
    start: float = 0.0  # time of the first sample [s]
    main: bool = True  # whether it is read where no channel is named

    @property
    def is_time(self) -> bool:
        """Whether the last word of the path, or the label, is a name of time."""
        return is_time_name(_word(self.path)) or (self.label is not None and is_time_name(clean_name(self.label)[0]))


def _word(path: str) -> str:
    """The last word of a path, which says what an array is."""
    return path.rpartition(".")[2].split("[")[0]


def channels_of(tree: Any, where: str) -> list[Channel]:
    """Every array of a tree of mappings (fields), lists (cells) and arrays, in order.

    Entries next to an array describe it: text called unit or units is its unit, text called name its name (if it is the
    only array), and a number called dt, Ts, fs ... gives the time step. Too many arrays or levels are refused.
    """
    found = list(islice(_walk(tree, "", {}, where, 0), MOST_ARRAYS + 1))
    if len(found) > MOST_ARRAYS:
        raise FileFormatError(f"{where}: more than {MOST_ARRAYS} arrays; that is no record")
    return found


def _walk(node: Any, path: str, about: Mapping[str, Any], where: str, depth: int) -> Iterator[Channel]:
    if depth > DEEPEST:
        raise FileFormatError(f"{where}: {path[:40]!r} is nested deeper than {DEEPEST} levels")
    if isinstance(node, Mapping):
        here = {**{key: value for key, value in about.items() if key not in ("unit", "label")}, **about_of(node)}
        for name, child in node.items():
            inner = f"{path}{name}" if str(name).startswith("[") else f"{path}.{name}" if path else str(name)
            yield from _walk(child, inner, here, where, depth + 1)
    elif isinstance(node, list):
        for k, child in enumerate(node):
            yield from _walk(child, f"{path}[{k}]", about, where, depth + 1)
    elif hasattr(node, "shape"):
        if is_time_name(_word(path)):  # the unit beside it is that of the channels
            about = {key: value for key, value in about.items() if key not in ("unit", "label")}
        yield from _rows(node, path, {**about, **dict(getattr(node, "about", {}))})


def about_of(node: Mapping[str, Any]) -> dict[str, Any]:
    """Unit and time step stated by entries of a struct or group, and the label of its array if it is the only one."""
    out: dict[str, Any] = {}
    arrays = [name for name, value in node.items() if math.prod(getattr(value, "shape", ())) > 1]
    alone = len(arrays) == 1 or sum(not is_time_name(name) for name in arrays) == 1
    for name, value in node.items():
        if name.casefold() in ("unit", "units") and isinstance(value, str):
            out["unit"] = value
        elif name.casefold() == "name" and isinstance(value, str) and value.strip() and alone:
            out["label"] = value
        elif name in (*STEP_NAMES, *RATE_NAMES) and math.prod(getattr(value, "shape", (0,))) == 1:
            step = step_of(name, value[...])
            if step is not None:
                out["step"] = step
    return out


def step_of(name: str, value: Any) -> float | None:
    """The time step [s] from a step or a rate called `name`; None if it is not a positive number.

    >>> step_of("dt", 0.5), step_of("fs", [4]), step_of("fs", "fast")
    (0.5, 0.25, None)
    """
    array = np.ravel(value)
    if array.size != 1 or array.dtype.kind not in "iuf" or not 0 < array[0] < np.inf:
        return None
    return float(array[0]) if name in STEP_NAMES else 1.0 / float(array[0])


def _rows(array: Any, path: str, about: Mapping[str, Any]) -> Iterator[Channel]:
    """The channels of an array: itself, or the rows of a matrix; none for scalars and three or more dimensions."""
    shape = tuple(int(length) for length in array.shape)
    if array.dtype.kind not in "biufcmM":
        return
    unit, step = about.get("unit"), about.get("step")
    long = max(shape, default=0)
    enough = long > 1 or (long == 1 and about.get("single"))
    if enough and long == np.prod(shape, dtype=float):  # of one dimension, as a row or as a column
        # a matrix of one row or column is read whole
        read = (lambda rows: array[rows]) if shape == (long,) else (lambda rows: np.ravel(array[...])[rows])
        yield Channel(path, long, read, about.get("label"), unit, step)
    elif len(shape) == 2 and 1 < min(shape) <= MOST_ROWS:
        across = shape[0] > shape[1]
        for k in range(min(shape)):
            # `k=k` binds the row now, not when the channel is read
            read = (lambda rows, k=k: array[rows, k]) if across else (lambda rows, k=k: array[k, rows])
            yield Channel(f"{path}.{k}", long, read, unit=unit, step=step)


def read_pieces(
    channels: Sequence[Channel], where: str, request: Request, names: Names = None, rows: slice = EVERY
) -> list[tuple[Request, Columns]]:
    """The columns of each requested record, with the request for that record alone.

    A request without names reads all channels of one length; `names` then renames these, in order. Only `rows` are
    read. FileFormatError without arrays, or for different lengths or rates; UnknownNameError for an unknown channel.
    """
    if not channels:
        raise FileFormatError(f"{where}: holds no array of numbers that could be a channel")
    requests = request.each([channel.path for channel in channels], where)
    return [(one, _columns(list(channels), where, one, names, rows)) for one in requests]


def _columns(channels: list[Channel], where: str, request: Request, names: Names, part: slice) -> Columns:
    labels = [channel.label or channel.path.replace("[", "_").replace("]", "") for channel in channels]
    headers = Headers.parse(labels, where)
    pairs = zip(channels, headers.units, strict=True)
    units = [unit if channel.unit is None else channel.unit or None for channel, unit in pairs]
    headers = Headers([channel.path for channel in channels], headers.names, units, where)
    doubts: tuple[str, ...] = ()
    if names is not None:
        rows, _ = _main(channels, headers, Request(fs=request.fs))
        channels = [channels[i] for i in rows]
        headers = headers.at(rows).renamed(names)
    if request.names is None:
        rows, doubts = _main(channels, headers, request)
    else:
        rows = _asked(channels, headers, request)
    chosen = [channels[i] for i in rows]
    if len({channel.size for channel in chosen}) > 1:
        shown = ", ".join(f"{c.path} ({c.size})" for c in chosen[:12])
        raise FileFormatError(f"{where}: channels of several lengths: {shown}; name channels of one length")
    time = None
    if request.time is None and request.fs is None and names is None:
        time = next((k for k, channel in enumerate(chosen) if channel.is_time), None)
    steps = {channel.step for channel in chosen if channel.step is not None}
    if time is None and request.time is None and len(steps) > 1:
        rates = ", ".join(f"{c.path} {1 / c.step:g} Hz" for c in chosen[:8] if c.step)
        raise FileFormatError(
            f"{where}: channels of several rates: {rates}; name channels of one rate, and join the rest"
        )
    values = {i: np.asanyarray(channels[i].values(part)) for i in rows}
    for i, array in values.items():
        if array.dtype.hasobject:
            raise FileFormatError(f"{where}: {channels[i].path} holds objects, not numbers; they are refused")
    data = Columns.build(headers, values.__getitem__, lambda _: rows)
    step = steps.pop() if len(steps) == 1 and time is None and request.time is None else None
    return replace(data, doubts=doubts, time=time, step=step, start=chosen[0].start)


def _find(headers: Headers, key: str) -> int:
    try:
        return headers.find(key)
    except UnknownNameError:
        raise UnknownNameError("column", key, headers.texts, headers.where) from None


def _asked(channels: Sequence[Channel], headers: Headers, request: Request) -> list[int]:
    """Indices of the requested channels, and of the nearest array of their length that is time by name or unit."""
    rows = {_find(headers, name) for name in request.names or ()}
    first = min(rows, default=0)
    rows.update(_find(headers, name) for name in (request.time, request.group) if name is not None)
    if request.time is None and request.fs is None:
        path = channels[first].path
        times = [
            i
            for i, channel in enumerate(channels)
            if channel.size == channels[first].size and (channel.is_time or headers.units[i] in SECONDS)
        ]
        if times:
            rows.add(max(times, key=lambda i: (channels[i].is_time, _shared(channels[i].path, path))))
    return sorted(rows)


def _shared(path: str, other: str) -> int:
    """Length of the common beginning of two paths."""
    return next((k for k, (a, b) in enumerate(zip(path, other, strict=False)) if a != b), min(len(path), len(other)))


def _main(channels: Sequence[Channel], headers: Headers, request: Request) -> tuple[list[int], tuple[str, ...]]:
    """Indices of the channels read without names, as long as time or else the longest; a warning about others."""
    pool = [i for i, channel in enumerate(channels) if channel.main]
    if not pool:
        paths = ", ".join(channel.path for channel in channels[:12])
        raise FileFormatError(f"{headers.where}: name the channels to read; there are: {paths}")
    length = max(channels[i].size for i in pool)
    if request.time is not None:
        length = channels[_find(headers, request.time)].size
    rows = [i for i in pool if channels[i].size == length]
    least = min(SHORT * length, SETTINGS)
    others = [i for i in pool if channels[i].size != length and channels[i].size > least]
    if request.time is None and any(channels[i].size > SHORT * length for i in others):
        several = [channels[i] for i in (*rows, *others)]
        shown = ", ".join(f"{c.path} ({c.size})" for c in several[:12]) + (", ..." if len(several) > 12 else "")
        error = LengthsError(f"{headers.where}: arrays of several lengths: {shown}; name the channels to read")
        error.sizes = {headers.names[i]: channels[i].size for i in (*rows, *others)}
        raise error
    shown = some_of([f"{channels[i].path} ({channels[i].size})" for i in others], 30)
    doubt = f"{headers.where}: of arrays of {length} samples; there are others: {shown} (--channel NAME, columns=)"
    return rows, (doubt,) if others else ()
