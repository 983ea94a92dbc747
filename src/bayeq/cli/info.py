"""``bayeq info``: what is in a file, and the command to run next."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayeq.cli.options import FILE, Command, json_option, option

if TYPE_CHECKING:
    from bayeq.inspection.info import RecordInfo

__all__ = ["info"]


@click.command(cls=Command)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@option("--time", help="Time column [s].")
@option("--fs", type=float, help="Sampling frequency [Hz], where there is no time column.")
@option("--names", help="Column names, separated by commas, for a file without header.")
@option("--group", help="Column that numbers the trials within a file.")
@json_option()
def info(files: tuple[Path, ...], as_json: bool, **reading: Any) -> None:
    """Say what is in a file: channels, rate, units, power, bad samples, likely roles, and what to run next.

    FILE... are one or several records: CSV, TSV, text, Parquet or NPZ.
    """
    from importlib.metadata import version

    from bayeq.inspection.info import info as describe
    from bayeq.inspection.info import proposal_for_all

    found: list[RecordInfo] = []
    for file in files:
        found.append(describe(file, **reading))
        if not as_json:
            click.echo(("\n" if len(found) > 1 else "") + _text(found[-1]))
    together = proposal_for_all(found)
    if as_json:
        parts = [one.to_dict() for one in found]
        whole = parts[0] if len(parts) == 1 else {"files": parts, "next": together and together.to_dict()}
        click.echo(json.dumps({"version": version("bayeq"), **whole}, allow_nan=False))
    elif together is not None:
        click.echo(f"\nnext, for all {len(found)} files\n  {together.command}")
    elif len(found) > 1:
        click.echo("\nthe files differ in channels or roles: they are not proposed to be used together")


def _text(found: RecordInfo) -> str:
    """The summary in characters that standard output can write."""
    from bayeq.inspection.contents import as_text

    text = as_text(found)
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return as_text(found, plain=True)
    return text
