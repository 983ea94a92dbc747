"""What the options of the commands have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click

from bayeq.cli.environment import require_address_space
from bayeq.errors import InputError

__all__ = [
    "FILE",
    "WRITTEN",
    "Command",
    "altered",
    "by_name",
    "cluster_client",
    "dask_option",
    "file_written",
    "in_terms",
    "json_option",
    "measured",
    "number",
    "option",
    "pair_of_numbers",
    "sure",
    "written",
]


WRITTEN = "What to write"


class _File(click.ParamType):  # type: ignore[type-arg]  # generic in the latest click only
    """The path of a file; whether it is there is checked where it is read or written."""

    name = "file"

    def convert(self, value: str | Path, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        if "\0" in str(value):
            self.fail("a null byte is no part of a file's name", param, ctx)
        return Path(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
        """Names of files."""
        return click.Path().shell_complete(ctx, param, incomplete)


FILE = _File()


class _Option(click.Option):
    """An option that belongs to a group of the help."""

    def __init__(self, *declarations: Any, group: str = "", **settings: Any) -> None:
        super().__init__(*declarations, **settings)
        self.group = group


# Options, of which defaults are shown where there are any, and those of the groups of the help.
option = partial(click.option, show_default=True, cls=_Option)
measured = partial(option, group="What is measured")
altered = partial(option, group="What is done to it first")
in_terms = partial(option, group="What may be in the equation")
sure = partial(option, group="How sure")
written = partial(option, group=WRITTEN)
file_written = partial(written, type=FILE)

json_option = partial(option, "--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")


def dask_option(text: str, **settings: Any) -> Callable[[Any], Any]:
    """The option ``--dask``; `text` is its help."""
    return option("--dask", metavar="ADDRESS", help=text, **settings)


@contextmanager
def cluster_client(address: str | None) -> Iterator[Any]:
    """The client of the Dask cluster at an address; None where none is given."""
    if address is None:
        yield None
        return
    from bayeq.streaming.cluster import connected

    with connected(address) as client:
        yield client


class Command(click.Command):
    """A command that needs numerical libraries; its help lists options in groups, and examples as they are written."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run it, if there is memory for it."""
        require_address_space()
        return super().invoke(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options by their groups."""
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
        """Write the examples, line by line."""
        for line in (self.epilog or "").splitlines():
            formatter.write(f"{line}\n")


def number(where: str, text: str) -> float:
    """A number; an InputError if it is not."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{where}: {text[:60]!r} is no number") from None


def pair_of_numbers(where: str, text: str) -> tuple[float, float]:
    """``LO:HI`` as two numbers; an InputError if it is not."""
    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"{where} {text[:60]!r}: give two numbers with a colon between, as in 1:50")
    return number(where, low), number(where, high)


def by_name(where: str, texts: Iterable[str], how: str, split: Callable[..., Any] = str.partition) -> dict[str, str]:
    """Values by name, of texts ``name=value``; an InputError says `how` to write them, or that one is given twice."""
    out: dict[str, str] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in split(text, "="))
        if not (name and equals and value):
            raise InputError(f"{where} {text.strip()[:60]!r}: {how}")
        if name in out:
            raise InputError(f"{where}: {name!r} is given twice, {out[name]} and {value}")
        out[name] = value
    return out
