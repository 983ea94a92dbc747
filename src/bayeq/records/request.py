"""``Request``: which columns of a file are asked for, and by which names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from bayeq.errors import InputError, UnknownNameError
from bayeq.records.columns import Columns, Headers, listed
from bayeq.records.validate import SECONDS

__all__ = ["STAR", "Request"]

#: In a path: each of several arrays, one record for each.
STAR = "[*]"


@dataclass(frozen=True, slots=True)
class Request:
    """What `bayeq.records.read` is asked for.

    Parameters
    ----------
    columns : list of str, or str, optional
        Columns to keep, under their own names.
    channels : mapping of str to str, optional
        Columns to keep, new name to path or header.
    time, group : str, optional
        The columns that are time and number of the trial.
    fs : float, optional
        Sampling rate [Hz]; no column is time then.
    """

    columns: Sequence[str] | str | None = None
    channels: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    group: str | None = None
    fs: float | None = None

    @property
    def names(self) -> list[str] | None:
        """The columns that are asked for, time and group aside; None for all of them."""
        if self.columns is None and not self.channels:
            return None
        return [*listed(self.columns or []), *self.channels.values()]

    def rows(self, headers: Headers) -> list[int]:
        """Which columns to read: those asked for, time (or what may be time) and the group."""
        if self.names is None:
            return list(range(len(headers)))
        needed = {headers.find(name) for name in self.names}
        needed.update(headers.find(name) for name in (self.time, self.group) if name is not None)
        if self.time is None and self.fs is None:
            if headers.time is not None:
                needed.add(headers.time)
            else:
                needed.update(i for i, unit in enumerate(headers.units) if unit in SECONDS)
        return sorted(needed)

    def kept(self, data: Columns) -> list[str] | None:
        """The names of the record's channels, after `renamed`; None for all of them."""
        if self.names is None:
            return None
        return [*(data.names[data.headers.find(name)] for name in listed(self.columns or [])), *self.channels]

    def renamed(self, data: Columns) -> Columns:
        """The columns under the names that `channels` gives them; one named twice comes twice."""
        if not self.channels:
            return data
        headers = data.headers
        found = {name: headers.find(path) for name, path in self.channels.items()}
        others = [i for i in range(len(headers)) if i not in found.values()]
        rows = [*others, *found.values()]
        names = [*(headers.names[i] for i in others), *found]
        again = sorted({name for name in names if names.count(name) > 1})
        if again:
            raise InputError(f"{headers.where}: the name {again[0]!r} is given to one column and is that of another")
        new = Headers([headers.texts[i] for i in rows], names, [headers.units[i] for i in rows], headers.where)
        time = None if data.time is None else rows.index(data.time)
        return replace(data, headers=new, values=[data.values[i] for i in rows], time=time)

    def each(self, paths: Sequence[str], where: str) -> list[Request]:
        """This request for each of the arrays that ``[*]`` stands for; itself where no path has one.

        Parameters
        ----------
        paths : list of str
            Paths of all arrays of the file.
        where : str
            The file, for messages.

        Raises
        ------
        InputError
            Two stars in one path, or numbers that one path has and another has not.
        UnknownNameError
            No array has such a path.
        """
        starred = [p for p in (*(self.names or ()), self.time, self.group) if p is not None and STAR in p]
        numbers: dict[str, set[int]] = {}
        for path in starred:
            if path.count(STAR) > 1:
                raise InputError(f"{where}: {path!r} has two stars; write one")
            before, after = map(re.escape, path.split(STAR))
            pattern = re.compile(rf"{before}\[(\d+)\]{after}")
            numbers[path] = {int(match[1]) for p in paths if (match := pattern.fullmatch(p))}
            if not numbers[path]:
                raise UnknownNameError("array", path, paths, where)
        if not starred:
            return [self]
        every = set().union(*numbers.values())
        for path, have in numbers.items():
            if have != every:
                lacking = min(every - have)
                raise InputError(
                    f"{where}: there is no {path.replace(STAR, f'[{lacking}]')}; name one record at a time"
                )
        return [self._numbered(k) for k in sorted(every)]

    def _numbered(self, k: int) -> Request:
        def at(path: str | None) -> str | None:
            return None if path is None else path.replace(STAR, f"[{k}]")

        columns = None if self.columns is None else [str(at(name)) for name in listed(self.columns)]
        channels = {name: str(at(path)) for name, path in self.channels.items()}
        return Request(columns, channels, at(self.time), at(self.group), self.fs)
