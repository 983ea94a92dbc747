"""Channels as options name them: ``x``, a header such as ``Displ. (m)``, or a path in a file, ``th=Y_id[0].0``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from bayeq.errors import InputError

__all__ = ["ROLES", "channel_name", "named_channels", "path_of"]

ROLES = ("displacement", "velocity", "acceleration", "force")
# An index of a path, which no name has.
_INDEX = re.compile(r"\[(?:\*|\d+(?:,\d+)?)\]")


def named_channels(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """The options of a command with channels by their names, and the paths of those written ``name=path``.

    The paths, by name, are those of every channel that is used; there are none if no channel is written so.

    Raises
    ------
    InputError
        A name that terms cannot use, or one with two paths.
    """
    named = Names()
    out = dict(options)
    for role in ROLES:
        if out.get(role):
            out[role] = named.parts(out[role])
    out["inputs"] = [named.parts(text) for text in out.get("inputs") or ()]
    if out.get("chains"):
        out["chains"] = [named.parts(text) for text in out["chains"]]
    return out, named.paths if named.any_path else {}


def channel_name(name: str) -> str:
    """A channel by its name or by its header in the file, such as ``Displ. (m)``.

    Examples
    --------
    >>> channel_name("x"), channel_name("Displ. (m)"), channel_name("x:v")
    ('x', 'Displ', 'x:v')
    """
    if not name or name.isidentifier() or ":" in name:
        return name
    from bayeq.records import clean_name

    return clean_name(name)[0]


def path_of(text: str | None) -> str | None:
    """The path of a channel whose name does not matter, as of time: ``t=Time_id[0]`` is that of ``Time_id[0]``.

    Examples
    --------
    >>> path_of("t=Time_id[0]"), path_of("Time [s]"), path_of(None)
    ('Time_id[0]', 'Time [s]', None)
    """
    name, equals, path = (text or "").partition("=")
    return path.strip() if equals and name.strip().isidentifier() and path.strip() else text


class Names:
    """Names of channels and where they are found, collected from the texts of options."""

    def __init__(self) -> None:
        self.paths: dict[str, str] = {}
        self.any_path = False

    def parts(self, text: str) -> str:
        """A chain, or a single channel, without the paths."""
        return ":".join(map(self.name, text.split(":")))

    def name(self, text: str) -> str:
        """The name of a channel, whose path is kept."""
        from bayeq.records import clean_name

        mark = "~" if text.strip().startswith("~") else ""
        bare = text.strip().removeprefix("~")
        name, equals, path = bare.partition("=")
        if not equals:
            if not _INDEX.search(bare):
                if bare and not mark:
                    self._keep(bare if bare.isidentifier() else clean_name(bare)[0], bare)
                return text
            name, path = clean_name(bare.replace("[", "_").replace("]", ""))[0], bare
        name, path = name.strip(), path.strip()
        if clean_name(name)[0] != name or not path:
            raise InputError(f"{text.strip()[:60]!r}: write name=path, such as th=Y_id[0].0; the name is used in terms")
        self.any_path = True
        self._keep(name, path)
        return mark + name

    def _keep(self, name: str, path: str) -> None:
        if self.paths.setdefault(name, path) != path:
            raise InputError(f"the name {name!r} is given to two channels, {self.paths[name]} and {path}")
