"""What the options of the commands have in common."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

__all__ = ["FILE", "option"]


class _File(click.ParamType):  # type: ignore[type-arg]  # generic in the latest click only
    """The path of a file; whether it is there is checked where it is read or written."""

    name = "file"

    def convert(self, value: str | Path, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        if "\0" in str(value):
            self.fail("a null byte is no part of a file's name", param, ctx)
        return Path(value)


FILE = _File()

# Defaults are shown where there are any.
option = partial(click.option, show_default=True)
