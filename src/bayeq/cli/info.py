"""``bayeq info``: what is in a file, and the command to run next."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayeq.cli.options import FILE, Command, Names, json_option, measured
from bayeq.cli.reading import Reading, reading_options

if TYPE_CHECKING:
    from bayeq.inspection.info import RecordInfo

__all__ = ["info"]


@click.command(cls=Command)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@partial(reading_options, of_files=True)
@measured(
    "--channel", "channels", multiple=True, help="Channel that is read, x or name=path. Once per channel; else all."
)
@json_option()
def info(files: tuple[Path, ...], as_json: bool, channels: tuple[str, ...], **options: Any) -> None:
    """Say what is in a file: channels, rate, units, power, bad samples, likely roles, and what to run next.

    FILE... are one or several records: text (CSV ...), MATLAB, HDF5, universal files, TDMS, LabVIEW, Excel, WAV,
    Parquet, NumPy.
    """
    from importlib.metadata import version

    from bayeq.inspection.info import copies_among, proposal_for_all
    from bayeq.inspection.info import info as describe

    reading, named = Reading.of(options), Names()
    for text in channels:
        named.name(text)
    found: list[RecordInfo] = []
    for file in files:
        found.append(describe(file, channels=named.paths or None, rows=reading.rows, **reading.of_file))
        if not as_json:
            click.echo(("\n" if len(found) > 1 else "") + _text(found[-1]))
    together = proposal_for_all(found)
    if as_json:
        parts = [one.to_dict() for one in found]
        whole = parts[0] if len(parts) == 1 else {"files": parts, "next": together and together.to_dict()}
        click.echo(json.dumps({"version": version("bayeq"), **whole}, allow_nan=False))
        return
    for line in copies_among(found):
        click.echo(f"\n{line}")
    if together is not None:
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
