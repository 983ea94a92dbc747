"""``bayeq predict``: what saved equations predict of another record."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from bayeq.cli.options import FILE, MEASURED, WRITTEN, Command, option
from bayeq.cli.outputs import require_place
from bayeq.cli.progress import COMPILING, Progress
from bayeq.cli.reading import Reading, reading_options
from bayeq.cli.streams import say
from bayeq.errors import DataWarning, InputError, UnknownNameError
from bayeq.kernels import announce_compiling

__all__ = ["predict"]

EXAMPLES = """
Examples:

  The second half of a file, and the free run as a figure:

    bayeq predict eq.json run.csv --rows 2000: --forecast run.png

  A file with other names:

    bayeq predict eq.json shaker.csv --channel x=Weg --channel "u=Kraft [N]"
"""


@click.command(cls=Command, epilog=EXAMPLES)
@click.argument("equations", metavar="EQ.json", type=FILE)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@option(
    "--channel",
    "channels",
    group=MEASURED,
    multiple=True,
    help="Where a channel of the equations is in the file: x=Weg, or its path. Once per channel that has another name.",
)
@reading_options
@option("--draws", group=WRITTEN, type=int, default=200, help="Runs with coefficients from the posterior, for bands.")
@option("--seed", group=WRITTEN, type=int, default=0, help="Seed of these.")
@option("--json", "as_json", group=WRITTEN, is_flag=True, help="Print one JSON object and nothing else.")
@option(
    "--forecast",
    group=WRITTEN,
    type=FILE,
    help="Write the free run with its 95 % band: a table (.csv) or a figure (.png, .svg, .pdf).",
)
@option("--verbose", is_flag=True, help="Say on standard error what is being done, and how long it takes.")
def predict(
    equations: Path,
    files: tuple[Path, ...],
    channels: tuple[str, ...],
    draws: int,
    seed: int,
    as_json: bool,
    forecast: Path | None,
    verbose: bool,
    **options: Any,
) -> None:
    """Predict a record by saved equations, and say how far they hold.

    EQ.json holds equations that `bayeq discover --save` has written, FILE... one or several records with all of their
    channels; - is standard input.
    """
    reading = Reading.of(options)
    if draws < 0:
        raise InputError(f"--draws {draws}: give a number of runs, 0 or more")
    if seed < 0:
        raise InputError(f"--seed {seed}: a seed is a whole number, 0 or more")
    if forecast is not None:
        from bayeq.figures.style import require_suffix

        require_place(forecast, [equations, *files])
        require_suffix(forecast)
    announce_compiling(lambda: say(COMPILING))
    from bayeq.equation.load import load

    found = load(equations)
    names = found.roles.channels
    paths = _paths(channels, names)
    with Progress(verbose) as progress:
        records = reading.records(files, names, paths, progress)
        progress("predicting", 0, 1)
        from bayeq.equation.applied import apply_to

        prediction = apply_to(found, records, draws, seed)
        progress.close()
        for note in prediction.notes:
            warnings.warn(note, DataWarning, stacklevel=1)
        click.echo(json.dumps(prediction.to_dict(), allow_nan=False) if as_json else str(prediction))
        if forecast is not None:
            from bayeq.forecast.write import write_forecasts

            progress(f"writing {forecast.name}", 0, 1)
            write_forecasts(forecast, prediction.runs)


def _paths(texts: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Where every channel is in the files, from ``x=Weg``; empty if nothing is said."""
    given: dict[str, str] = {}
    for text in texts:
        name, equals, path = (part.strip() for part in text.partition("="))
        if not (name and equals and path):
            raise InputError(f"--channel {text[:60]!r}: write a channel of the equations and its name there, x=Weg")
        if name not in names:
            raise UnknownNameError("channel", name, names, "--channel: the equations")
        if name in given:
            raise InputError(f"--channel: {name!r} is given twice, {given[name]} and {path}")
        given[name] = path
    return {name: given.get(name, name) for name in names} if given else {}
