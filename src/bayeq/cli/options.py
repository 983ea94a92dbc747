"""Shared parts of the command options: help groups, parsing of values, channels by name, header or path."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial, reduce
from pathlib import Path
from typing import Any

import click

from bayeq.cli.beside import compile_beside
from bayeq.cli.terminal import COMPILING, require_address_space, say
from bayeq.errors import InputError
from bayeq.kernels import announce_compiling

# Help group of the options for output.
WRITTEN = "What to write"

# End of the help text of options that write a table or a figure.
TABLE_OR_FIGURE = ": a table (.csv) or a figure (.png, .svg, .pdf)."

#: Decorator that adds an option to the function of a command.
Decorator = Callable[[Any], Any]

# Options that name the channels of an oscillator.
ROLES = ("displacement", "velocity", "acceleration", "force")

# An index in the path of an array, such as [0] or [*]; names of channels have none.
_INDEX = re.compile(r"\[(?:\*|\d+(?:,\d+)?)\]")


class _File(click.Path):
    """The path of a file; whether it is there is checked where it is read or written."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if "\0" in str(value):
            self.fail("a null byte is no part of a file's name", param, ctx)
        return super().convert(value, param, ctx)


FILE = _File(readable=False, path_type=Path)
FILE.name = "file"


class _Option(click.Option):
    """An option that belongs to a group of the help."""

    def __init__(self, *declarations: Any, group: str = "", **settings: Any) -> None:
        super().__init__(*declarations, **settings)
        self.group = group


# Decorators for options, with defaults shown in the help; those below `option` set the help group.
option = partial(click.option, show_default=True, cls=_Option)
measured = partial(option, group="What is measured")
altered = partial(option, group="What is done to it first")
in_terms = partial(option, group="What may be in the equation")
sure = partial(option, group="How sure")
written = partial(option, group=WRITTEN)
file_written = partial(written, type=FILE)


def together(*options: Decorator) -> Decorator:
    """Combine the decorators of several options in one, in this order."""
    return lambda command: reduce(lambda made, add: add(made), reversed(options), command)


json_option = partial(option, "--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")


def cluster_client(address: str | None) -> AbstractContextManager[Any]:
    """Context with the client of the Dask cluster at an address; with None if no address is given."""
    if address is None:
        return nullcontext()
    from bayeq.discovery.streaming.cluster import connected

    return connected(address)


def _compile() -> None:
    """Say that kernels are compiled, and have half of them compiled by another process."""
    say(COMPILING)
    compile_beside()


class Command(click.Command):
    """A command that needs numerical libraries; its help lists options in groups, and examples as they are written."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command after a check of the memory limit; print a line before kernels are compiled."""
        require_address_space()
        announce_compiling(_compile)
        return super().invoke(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            if row is not None and isinstance(parameter, click.Option):
                groups.setdefault(getattr(parameter, "group", ""), []).append(row)
        others = groups.pop("", [])
        groups["Other" if groups else "Options"] = others
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for line in (self.epilog or "").splitlines():
            formatter.write(f"{line}\n")


def number(where: str, text: str) -> float:
    """Parse a number; an InputError if that fails."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{where}: {text[:60]!r} is no number") from None


def pair_of_numbers(where: str, text: str) -> tuple[float, float]:
    """Parse ``LO:HI`` as two numbers; an InputError for any other text."""
    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"{where} {text[:60]!r}: give two numbers with a colon between, as in 1:50")
    return number(where, low), number(where, high)


def by_name(where: str, texts: Iterable[str], how: str, split: Callable[..., Any] = str.partition) -> dict[str, str]:
    """Parse texts ``name=value``; InputError for a malformed text (it says `how` to write it) or a repeated name."""
    out: dict[str, str] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in split(text, "="))
        if not (name and equals and value):
            raise InputError(f"{where} {text.strip()[:60]!r}: {how}")
        if name in out:
            raise InputError(f"{where}: {name!r} is given twice, {out[name]} and {value}")
        out[name] = value
    return out


def named_channels(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Options with ``name=path`` replaced by the name, and the paths by name (empty if no option has a path).

    InputError for a name that terms cannot use, or one with two paths.
    """
    named = Names()
    out = dict(options)
    for role in ROLES:
        if out.get(role):
            out[role] = named.parts(out[role])
    out["inputs"] = [named.parts(text) for text in out.get("inputs") or ()]
    if out.get("target"):
        out["target"] = [named.parts(one) for text in out["target"] for one in text.split(",")]
    if out.get("chains"):
        out["chains"] = [named.parts(text) for text in out["chains"]]
    return out, named.paths if named.any_path else {}


def channel_name(name: str) -> str:
    """Name of a channel that is given by its name or by its header in the file, such as ``Displ. (m)``."""
    from bayeq.records.names import channel_name as of_header

    return of_header(name)


def path_of(text: str | None) -> str | None:
    """The path of a channel whose name is not used, such as time: ``Time_id[0]`` of ``t=Time_id[0]``.

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
        """Names of a chain, or of a single channel; paths are stored in `paths`."""
        return ":".join(map(self.name, text.split(":")))

    def name(self, text: str) -> str:
        """The name of a channel; its path is stored in `paths`."""
        from bayeq.records.names import clean_name

        mark = "~" if text.strip().startswith("~") else ""
        bare = text.strip().removeprefix("~")
        name, equals, path = bare.partition("=")
        if not equals:
            if not _INDEX.search(bare):
                called = channel_name(bare)
                if bare and not mark:
                    self._keep(called, bare)
                return mark + called
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
