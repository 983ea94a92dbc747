"""What the options of the commands have in common."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from bayeq.cli.memory import require_address_space

__all__ = ["ALTERED", "FILE", "MEASURED", "SURE", "TERMS", "WRITTEN", "Command", "option", "pair_of_numbers"]

#: Groups of options in the help.
MEASURED = "What is measured"
ALTERED = "What is done to it first"
TERMS = "What may be in the equation"
SURE = "How sure"
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


# Defaults are shown where there are any.
option = partial(click.option, show_default=True, cls=_Option)


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


def pair_of_numbers(where: str, text: str) -> tuple[float, float]:
    """``LO:HI`` as two numbers; an InputError if it is not."""
    from bayeq.errors import InputError

    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"{where} {text[:60]!r}: give two numbers with a colon between, as in 1:50")
    numbers = []
    for part in (low, high):
        try:
            numbers.append(float(part))
        except ValueError:
            raise InputError(f"{where}: {part[:60]!r} is no number") from None
    return numbers[0], numbers[1]
