"""The command line: parse, call, write.

Results go to standard output, progress and warnings to standard error. Exit code 0: done, 2: the input or the
arguments are wrong (one line says what and where), 1: anything else, 130: interrupted.
"""

from __future__ import annotations

import json as json_format
import sys
import time as clock
import warnings
from enum import StrEnum
from io import UnsupportedOperation
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.exceptions import TyperException

from bayeq.cli.outputs import ForecastFile, Outputs, PathFile, Physical, Refine, SensitivityFile
from bayeq.cli.streams import prepare_streams, say
from bayeq.cli.study import study_app
from bayeq.errors import BayeqError, BayeqWarning, FileFormatError, InputError, InterruptedRun, MissingExtraError
from bayeq.inference.engines import ENGINES

if TYPE_CHECKING:
    from bayeq.records import Record

__all__ = ["app", "main"]

app = typer.Typer(
    name="bayeq",
    help="Bayesian equation discovery: measured motion in, governing equation with honest uncertainty out.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

app.add_typer(study_app, name="study")

# Exit code of an interrupted command, as shells count it.
INTERRUPTED = 130

COMPILING = "compiling, once after installation: up to a minute ..."

# Work that takes longer shows its progress.
PATIENCE = 1.0


class Smoothing(StrEnum):
    """How derivatives that are not measured are estimated."""

    auto = "auto"
    none = "none"


class Progress:
    """A progress line on standard error, once the work has taken longer than `PATIENCE`."""

    def __init__(self) -> None:
        self.started = clock.monotonic()
        self.bar: Any = None
        self.task: Any = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        if self.bar is None:
            if clock.monotonic() - self.started < PATIENCE or not sys.stderr.isatty():
                return
            from rich.console import Console
            from rich.progress import Progress as Bar

            self.bar = Bar(console=Console(stderr=True), transient=True)
            self.bar.start()
            self.task = self.bar.add_task(stage)
        self.bar.update(self.task, description=stage, completed=done, total=total)

    def close(self) -> None:
        """Take the line away."""
        if self.bar is not None:
            self.bar.stop()


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.", is_eager=True)] = False,
    cite: Annotated[bool, typer.Option("--cite", help="Print what to cite, also as BibTeX, and stop.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as version_of

        typer.echo(version_of("bayeq"))
        raise typer.Exit
    if cite:
        from bayeq.citation import citation

        typer.echo(citation())
        raise typer.Exit
    if context.invoked_subcommand is None:
        names = [c.name or c.callback.__name__ for c in app.registered_commands if c.callback]
        known = ", ".join([*names, *(g.name for g in app.registered_groups if g.name)])
        raise InputError(f"no command given; there are: {known} (see bayeq --help)")


@app.command()
def discover(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Record(s): CSV, TSV, text, Parquet, NPZ.")],
    time: Annotated[str | None, typer.Option(help="Time column [s].")] = None,
    fs: Annotated[float | None, typer.Option(help="Sampling frequency [Hz], where there is no time column.")] = None,
    names: Annotated[
        str | None, typer.Option(help="Column names, separated by commas, for a file without header.")
    ] = None,
    group: Annotated[str | None, typer.Option(help="Column that numbers the trials within a file.")] = None,
    disp: Annotated[str | None, typer.Option(help="Displacement channel.")] = None,
    vel: Annotated[str | None, typer.Option(help="Velocity channel.")] = None,
    acc: Annotated[str | None, typer.Option(help="Acceleration channel.")] = None,
    force: Annotated[str | None, typer.Option(help="Force channel.")] = None,
    chain: Annotated[
        list[str] | None,
        typer.Option(
            help="A coordinate and its measured derivatives: x:v:a, x:: (only x measured), ::a (only a), x (first"
            " order), x:xdot. Once per coordinate.",
        ),
    ] = None,
    inputs: Annotated[list[str] | None, typer.Option("--input", help="Input channel; once per input.")] = None,
    dictionary: Annotated[
        str,
        typer.Option(help="Candidate terms: oscillator, polynomial:3, a file of terms, or terms separated by commas."),
    ] = "oscillator",
    method: Annotated[
        str,
        typer.Option(metavar="|".join(ENGINES), help="Engine; auto: optimum by VB, probabilities by model averaging."),
    ] = "auto",
    smooth: Annotated[
        Smoothing,
        typer.Option(help="Derivatives not measured: smoothed (auto) or differences (none)."),
    ] = Smoothing.auto,
    constraint: Annotated[
        list[str] | None,
        typer.Option(
            help="What is known of coefficients, by the names of terms: 'u == 1', 'v <= 0', 'a: x*abs(x) == 0.5*x**3'"
            " (of equation a). Once per constraint."
        ),
    ] = None,
    holdout: Annotated[float, typer.Option(help="Share of the rows, the last, to judge the equation by.")] = 0.2,
    max_terms: Annotated[
        int | None, typer.Option(help="Show at most this number of terms: the likeliest equation within it.")
    ] = None,
    negligible: Annotated[
        float | None,
        typer.Option(
            help="Terms that together explain a smaller share of the variance than this (0.00004) and make no"
            " difference to free runs stand beside the equation; 0 keeps them in it."
        ),
    ] = None,
    coarsen: Annotated[
        float, typer.Option(help="Power (0 to 1) of the likelihood, for models that are only nearly true.")
    ] = 1.0,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
    save: Annotated[Path | None, typer.Option(help="Write the equations to a JSON file, for bayeq.load.")] = None,
    sensitivity: SensitivityFile = None,
    path: PathFile = None,
    forecast: ForecastFile = None,
    refine: Refine = False,
    physical: Physical = False,
    seed: Annotated[int, typer.Option(help="Seed of methods that draw random numbers (gibbs).")] = 0,
) -> None:
    """Find the equation of motion of a measured record."""
    from bayeq.discovery import discover as run
    from bayeq.selection.negligible import NEGLIGIBLE

    outputs = Outputs(save, sensitivity, path, forecast, refine, physical)
    outputs.check(files, method, disp is not None, chain or ())
    for k, file in enumerate(files):
        if file.exists() and any(other.exists() and file.samefile(other) for other in files[:k]):
            raise InputError(f"{file}: named twice; the same rows twice are not twice the evidence")
    disp, vel, acc, force = (_channel(name) for name in (disp, vel, acc, force))
    inputs = [name for name in map(_channel, inputs or ()) if name]
    columns = [c.strip() for c in names.split(",")] if names is not None else None
    used = [
        c
        for text in (*(chain or ()), disp, vel, acc, force, *(inputs or ()))
        for c in (text or "").split(":")
        if c and not c.startswith("~")
    ]
    from bayeq.kernels import announce_compiling

    announce_compiling(lambda: say(COMPILING))
    records: list[Record] = []
    progress = Progress()
    try:
        for k, file in enumerate(files):
            progress("reading", k, len(files))
            records.extend(_read(file, used, time=time, fs=fs, names=columns, group=group))
        outputs.check_records(records)
        answer = run(
            records,
            chains=chain or None,
            displacement=disp,
            velocity=vel,
            acceleration=acc,
            force=force,
            inputs=inputs or (),
            dictionary=dictionary,
            method=method,
            smooth=smooth.value,
            holdout=holdout,
            max_terms=max_terms,
            coarsen=coarsen,
            seed=seed,
            progress=progress,
            constraints=constraint or (),
            negligible=NEGLIGIBLE if negligible is None else negligible,
        )
    finally:
        progress.close()
    outputs.write(answer, records, holdout, json)


def _read(file: Path, used: list[str], **options: Any) -> list[Record]:
    from bayeq.records import read

    try:
        found = read(file, **options)
    except FileFormatError:
        # Perhaps it is in a column that is not used, where words are welcome.
        found = read(file, columns=used or None, **options)
    records = found if isinstance(found, list) else [found]
    if options.get("fs") is not None:
        for record in records:
            for name in ("t", "time", "Time"):
                if name in record.names:
                    _require_rate(record, name)
    return records


def _require_rate(record: Record, name: str) -> None:
    """Refuse an --fs that contradicts a column that looks like time (with --fs it is read as a channel)."""
    import numpy as np

    with np.errstate(invalid="ignore"):  # of infinite times
        steps = np.diff(record[name])
    step = float(np.median(steps)) if len(steps) else 0.0
    if record.fs is not None and step > 0 and not 0.99 < record.fs * step < 1.01:
        raise InputError(
            f"{record.name}: --fs {record.fs:g} contradicts column {name!r}, whose median step is {step:g}; leave --fs"
            f" out to use the column, or rename it if it is not time"
        )


def _channel(name: str | None) -> str | None:
    """A channel by its name or by its header in the file, such as ``Displ. (m)``."""
    if not name or name.isidentifier() or ":" in name:
        return name
    from bayeq.records import clean_name

    return clean_name(name)[0]


@app.command()
def simulate(
    system: Annotated[str, typer.Argument(metavar="SYSTEM", help="Name of a known system, see `bayeq systems`.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .csv, .tsv, .parquet or .npz.")],
    n: Annotated[int | None, typer.Option(help="Samples (oscillators: 4000).")] = None,
    fs: Annotated[float | None, typer.Option(help="Sampling frequency [Hz] (oscillators: 1000).")] = None,
    noise: Annotated[float, typer.Option(help="Noise on every channel, as a ratio of its standard deviation.")] = 0.05,
    perturb: Annotated[float, typer.Option(help="Relative random change of the parameters (the paper: 0.1).")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed.")] = 0,
) -> None:
    """Simulate a known system and write the noisy record to a file."""
    from bayeq.records import write
    from bayeq.systems import simulate as run

    record = run(system, n=n, fs=fs, noise=noise, perturb=perturb, seed=seed)
    write(record, output)
    say(f"{output}: {record.n} rows of {', '.join(record.names)}")


@app.command()
def systems(json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False) -> None:
    """List the known systems and their equations."""
    from bayeq.systems import SYSTEMS

    if json:
        rows = [
            {
                "name": s.name,
                "title": s.title,
                "chains": list(s.chains),
                "inputs": list(s.inputs),
                "parameters": dict(s.parameters),
                "terms": {target: dict(terms) for target, terms in s.terms.items()},
                "citation": s.citation,
            }
            for s in SYSTEMS.values()
        ]
        typer.echo(json_format.dumps({"systems": rows}))
        return
    for s in SYSTEMS.values():
        typer.echo(f"{s.name}: {s.title}")
        for target, terms in s.terms.items():
            right = " + ".join(f"({coefficient})*{term}" for term, coefficient in terms.items())
            typer.echo(f"    {target} = {right}")
        typer.echo(f"    {', '.join(f'{k} = {v:g}' for k, v in s.parameters.items())}")


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    label = "warning" if issubclass(category, BayeqWarning) else category.__name__
    say(f"bayeq: {label}: {_one_line(str(message))}")


def _one_line(text: str) -> str:
    """A message without line breaks and without what a terminal would obey."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    prepare_streams()
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", BayeqWarning)
    try:
        code = app(arguments, prog_name="bayeq", standalone_mode=False)
    except (InputError, MissingExtraError) as error:
        return _fail(str(error), 2)
    except InterruptedRun as stop:
        say(f"bayeq: {_one_line(str(stop))}")
        return INTERRUPTED
    except BayeqError as error:
        return _fail(str(error), 1)
    except TyperException as error:
        return _fail(error.format_message(), error.exit_code)
    except typer.Exit as stop:
        return int(stop.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except (BrokenPipeError, SystemExit):
        # The reader of the pipe has gone (`bayeq ... | head`), which typer turns into an exit; nothing is left to
        # say to it.
        sys.stdout = None
        return 0
    except MemoryError:
        return _fail("not enough memory; use fewer samples or fewer terms", 1)
    except UnsupportedOperation:
        return _fail("standard output is closed: the result cannot be printed", 1)
    except OSError as error:
        return _fail(f"{error.filename or 'system'}: {error.strerror or error}", 2 if error.filename else 1)
    if code == INTERRUPTED:  # typer turns the interrupt into this code
        say("bayeq: interrupted")
    return code if isinstance(code, int) else 0


def _fail(message: str, code: int) -> int:
    if message:
        say(f"bayeq: error: {_one_line(message)}")
    return code


if __name__ == "__main__":
    sys.exit(main())
