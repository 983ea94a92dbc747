"""``bayeq batch``: the equations of many files, by the options of ``bayeq discover``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayeq.cli import options as opt
from bayeq.cli.discover import cleaned, discover, source_of, used_channels
from bayeq.cli.outputs import require_output
from bayeq.cli.reading import STANDARD_INPUT, Reading
from bayeq.cli.terminal import Progress, say
from bayeq.errors import BayeqError, InputError, InterruptedRun

if TYPE_CHECKING:
    from bayeq.batches.result import Batch, BatchFile

MANY = "Many files"

# Files without equations that are named, at most; --json names all.
NAMED = 20

EXAMPLES = """
Examples:

  A bridge, a file a day; the same command goes on where it was stopped, and takes in new files:

    bayeq batch days/ --disp x --vel v --acc a --force u --jobs 8 --table drift.csv --figure drift.png

  One equation of all files, and its coefficients in each:

    bayeq batch day*.csv --common --chain x:v:a --input u --store common.db --figure drift.png
"""


@click.command(cls=opt.Command, epilog=EXAMPLES)
@click.argument("files", metavar="FILES...", nargs=-1, required=True, type=opt.FILE)
@opt.option(
    "--store",
    group=MANY,
    type=opt.FILE,
    default=Path("batch.db"),
    help="File of results. Files that have been done with the same options are not done again, unless they changed.",
)
@opt.option("--jobs", group=MANY, type=int, default=1, help="Worker processes; the results do not depend on it.")
@opt.option(
    "--common",
    group=MANY,
    is_flag=True,
    help="Find one equation from all files together; each file then has the coefficients of its terms.",
)
@opt.file_written("--table", help="Write the coefficients over files: a table (.csv).")
@opt.file_written("--figure", help="Write a figure of the coefficients over files (.png, .svg, .pdf).")
@opt.json_option(group=opt.WRITTEN)
def batch(
    files: tuple[Path, ...],
    store: Path,
    jobs: int,
    common: bool,
    table: Path | None,
    figure: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Find the equations of many files, one each, and how their coefficients drift.

    FILES... are one record each, in this order; a folder means all files of known formats in it. Results are kept in a
    file as they are found, so that a run that is stopped goes on where it was. A file that cannot be used does not stop
    the others: it is named at the end, and the exit code is 1. It is 2 if the arguments are wrong, or no file could be
    used.
    """
    options["join"] = False
    reading = Reading.of(options)  # removes the reading options from `options`
    options, paths = opt.named_channels(options)
    options = cleaned(options)
    if STANDARD_INPUT in files:
        raise InputError("-: a batch is of files, which it knows again; write standard input to one")
    from bayeq.batches.result import files_of

    given = files_of(files)
    require_output(store, given, "any")
    require_output(table, given, "table")
    require_output(figure, given, "figure")
    from bayeq.batches.run import FILES, run_batch

    if common and reading.stream is None:
        reading = replace(reading, stream=reading.streamed(given))
    read = _FileReading(reading, tuple(used_channels(options)), paths)
    with Progress() as progress:
        try:
            found = run_batch(given, options, read, store, jobs, common, progress)
        except KeyboardInterrupt:
            done = progress.done if progress.stage == FILES else 0
            raise InterruptedRun(
                f"interrupted: {done} files were added to {store}; the same command continues"
            ) from None
    _show(found, store, as_json)
    if len(found.refused) < len(found):
        from bayeq.figures.style import write_output

        for path in filter(None, (table, figure)):
            write_output(path, found.table, found.plot)
    _name_refused(found.refused, len(found))


# The options of `discover` in groups of the help, without those for output and without --join.
batch.params[1:1] = [
    one for one in discover.params if getattr(one, "group", "") not in ("", opt.WRITTEN) and one.name != "join"
]


@dataclass(frozen=True)
class _FileReading:
    """Reads one file by the options; its `repr` enters the digest that distinguishes batches."""

    reading: Reading
    used: tuple[str, ...]
    paths: Mapping[str, str]

    def __call__(self, path: Path) -> Any:
        from bayeq.resumable import silent

        _, source = source_of(self.reading, [path], self.used, self.paths, False, silent)
        return source


def _show(found: Batch, store: Path, as_json: bool) -> None:
    if not as_json:
        click.echo(str(found))
        return
    from importlib.metadata import version

    common = found.common
    out = {
        "version": version("bayeq"),
        "store": str(store),
        "done": found.done,
        "files": [_file(one) for one in found],
        "common": None if common is None else common.to_dict(),
        "table": found.rows(),
    }
    click.echo(json.dumps(out, allow_nan=False))


def _file(one: BatchFile) -> dict[str, Any]:
    content = one.content or {}
    return {
        "file": one.path,
        "status": one.status,
        "message": one.message,
        "verdict": content.get("verdict"),
        "equations": {equation["target"]: equation["equation"] for equation in content.get("equations", ())},
        "warnings": list(content["diagnostics"]["warnings"]) if content else [],
    }


def _name_refused(refused: Sequence[BatchFile], files: int) -> None:
    """Say which files have no equations, and end with the exit code for it."""
    for one in refused[:NAMED]:
        named = one.path in one.message or Path(one.path).name in one.message
        say(f"bayeq: {one.status}: {one.message if named else f'{one.path}: {one.message}'}")
    if len(refused) > NAMED:
        say(f"bayeq: and {len(refused) - NAMED} more, see --json")
    if len(refused) == files:
        raise InputError(f"none of the {files} files could be used; bayeq info FILE says what is in one")
    if refused:
        raise BayeqError(f"{len(refused)} of {files} files could not be used; the others are done")
