"""Commands about saved equations: `bayeq show`, `predict`, `plan`; and `benchmark`, for data with an official test."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from bayeq.cli import options as opt
from bayeq.cli.outputs import require_output, show_equations
from bayeq.cli.reading import Reading, plain_files, reading_options, units_of
from bayeq.cli.terminal import Progress
from bayeq.errors import DataWarning, InputError, UnknownNameError

EXAMPLES = """
Examples:

  The second half of a file, and the free run as a figure:

    bayeq predict eq.json run.csv --rows 2000: --forecast run.png

  A file with other names:

    bayeq predict eq.json shaker.csv --channel x=Weg --channel "u=Kraft [N]"
"""

BENCHMARK = """
Example:

  Both halves in one file, under names of their own:

    bayeq benchmark --train tanks.csv --test tanks.csv --skip 50 --fs 0.25 --chain yEst --input uEst --dictionary
    "yEst, sqrt(yEst), uEst" --channel yEst=yVal --channel uEst=uVal
"""

_verbose = opt.option(
    "--verbose", is_flag=True, help="Say on standard error what is being done, and how long it takes."
)

# Advice on values by name of `bayeq plan`.
_HOW = "give a name and a value, as in x=0.01"


@click.command(cls=opt.Command)
@click.argument("file", metavar="EQ.json", type=opt.FILE)
@opt.json_option()
@opt.option("--conditional", is_flag=True, help="Print the intervals given the terms shown. --json has both.")
@opt.option("--physical", is_flag=True, help="Also mass, damping, stiffness ... of a second-order equation.")
@opt.option("--latex", is_flag=True, help="Print the equations alone, as LaTeX.")
@opt.option("--explain", is_flag=True, help="Explain below the answer, in plain words, what is printed.")
@opt.option("--verbose", is_flag=True, help="Print all of the answer: fits, residuals, bounds, runners-up.")
def show(
    file: Path, as_json: bool, conditional: bool, physical: bool, latex: bool, explain: bool, verbose: bool
) -> None:
    """Print saved equations as they were printed when they were found.

    EQ.json holds equations that `bayeq discover --save` has written.
    """
    if as_json and (latex or explain):
        raise InputError(f"--json and --{'latex' if latex else 'explain'} exclude each other; give one of them")
    if latex and (explain or physical):
        raise InputError("--latex prints the equations alone; leave out --explain and --physical")
    from bayeq.equation.load import load

    equations = load(file)
    if latex:
        click.echo(equations.to_latex())
        return
    for message in equations.warnings:
        warnings.warn(message, DataWarning, stacklevel=1)
    show_equations(equations, as_json, conditional, physical, explain, verbose)


@click.command(cls=opt.Command, epilog=EXAMPLES)
@click.argument("equations", metavar="EQ.json", type=opt.FILE)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=opt.FILE)
@opt.measured(
    "--channel",
    "channels",
    multiple=True,
    help="Where a channel of the equations is in the file: x=Weg, or its path. Once per channel that has another name.",
)
@reading_options
@opt.written("--draws", type=int, default=200, help="Runs with coefficients from the posterior, for bands.")
@opt.written("--seed", type=int, default=0, help="Seed of these.")
@opt.json_option(group=opt.WRITTEN)
@opt.file_written("--forecast", help=f"Write the free run with its 95 % band{opt.TABLE_OR_FIGURE}")
@_verbose
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
    require_output(forecast, [equations, *plain_files(files)], "table or figure")
    from bayeq.equation.load import load

    found = load(equations)
    if forecast is not None:
        from bayeq.equation.along import require_states

        require_states(found)
    names = [name for name in found.roles.channels if name not in found.numbers]
    paths = paths_of(channels, names)
    with Progress(verbose) as progress:
        from bayeq.equation.applied import apply_to

        try:
            records = reading.records(files, names, paths, progress)
            progress("predicting", 0, 1)
            prediction = apply_to(found, records, draws, seed)
        except UnknownNameError as error:
            if channels or error.name not in names:
                raise
            raise InputError(f"{error}; say where it is: --channel {error.name}=NAME") from None
        progress.close()
        for note in prediction.notes:
            warnings.warn(note, DataWarning, stacklevel=1)
        click.echo(json.dumps(prediction.to_dict(), allow_nan=False) if as_json else str(prediction))
        if forecast is not None:
            from bayeq.forecast.free_run import write_forecasts

            progress(f"writing {forecast.name}", 0, 1)
            write_forecasts(forecast, prediction.runs)


def paths_of(texts: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Header or path of every channel in the files, from texts ``x=Weg``; empty if no text is given."""
    given = opt.by_name("--channel", texts, "write a channel of the equations and its name there, x=Weg")
    for name in given:
        if name not in names:
            raise UnknownNameError("channel", name, names, "--channel: the equations")
    return {name: given.get(name, name) for name in names} if given else {}


@click.command(cls=opt.Command, epilog=BENCHMARK)
@opt.option("--train", type=opt.FILE, required=True, help="Measured file, or equations of discover --save (.json).")
@opt.option("--test", "tests", type=opt.FILE, multiple=True, required=True, help="Test file; repeat for each file.")
@opt.option("--skip", type=int, default=50, help="Rows of the test from which the initial state is; not scored.")
@opt.measured("--chain", "chains", multiple=True, help="As for bayeq discover: x, x::, x:v:a. Once per coordinate.")
@opt.measured("--input", "inputs", multiple=True, help="Input channel; once per input.")
@opt.measured(
    "--channel", "channels", multiple=True, help="Where a channel is in the files of the test, x=xVal. Once per name."
)
@opt.measured("--time", help="Time column [s] of all files.")
@opt.measured("--fs", type=float, help="Sampling frequency [Hz], where there is no time column.")
@opt.measured("--units", multiple=True, help="Units of channels instead of those in the files, x=mm,a=g.")
@opt.in_terms("--dictionary", default="oscillator", help="Candidate terms, as for bayeq discover.")
@opt.in_terms("--law", "laws", multiple=True, help="Rate of a hidden state, as for bayeq discover. Once per state.")
@opt.json_option(group=opt.WRITTEN)
@_verbose
def benchmark(
    train: Path,
    tests: tuple[Path, ...],
    skip: int,
    chains: tuple[str, ...],
    inputs: tuple[str, ...],
    channels: tuple[str, ...],
    time: str | None,
    fs: float | None,
    units: tuple[str, ...],
    dictionary: str,
    laws: tuple[str, ...],
    as_json: bool,
    verbose: bool,
) -> None:
    """Find equations in one record and score them by a free run over another.

    The error is the RMSE of the states from the input alone, after the first rows of the test, as in
    nonlinearbenchmark.org. All rows of the training record are used. Equations with other options: bayeq discover
    --holdout 0 --save EQ.json, and --train EQ.json.
    """
    reading = Reading(time=opt.path_of(time), fs=fs, units=units_of(units))
    if train.suffix == ".json" and (chains or inputs):
        raise InputError("--train: saved equations know their channels; leave out --chain and --input")
    if train.suffix != ".json" and not chains:
        raise InputError("no --chain given: say which channel is measured, as for bayeq discover")
    with Progress(verbose) as progress:
        if train.suffix == ".json":
            from bayeq.equation.load import load

            found = load(train)
        else:
            used = [name for text in (*chains, *inputs) for name in text.split(":") if name]
            records = reading.records([train], used, {}, progress)
            from bayeq.discovery import discover

            found = discover(
                records,
                chains=list(chains),
                inputs=list(inputs),
                dictionary=dictionary,
                law=laws,
                holdout=0.0,
                progress=progress,
            )
        names = found.roles.channels
        others = reading.records(tests, names, paths_of(channels, names), progress)
        from bayeq.equation.applied import test_errors

        errors = test_errors(found, others, skip)
    for note in dict.fromkeys(note for one in errors for note in one.notes):
        warnings.warn(note, DataWarning, stacklevel=1)
    if as_json:
        answer = {"equations": [eq.text for eq in found], "verdict": found.verdict.kind}
        click.echo(json.dumps(answer | {"tests": [asdict(one) for one in errors]}))
        return
    for eq in found:
        click.echo(f"{eq.verdict.kind}: {eq.text}")
    for one in errors:
        click.echo(str(one))


@click.command(cls=opt.Command)
@click.argument("file", metavar="EQ.json", type=opt.FILE)
@opt.option(
    "--amplitude",
    "amplitudes",
    multiple=True,
    help="Largest magnitude of the input, 5, or its range, 0:5; of one of several inputs, u=5. By default the range in"
    " the record.",
)
@opt.option("--band", help="Frequencies that may be excited, LO:HI [Hz]; by default where the power of the input was.")
@opt.option(
    "--seconds", type=float, help="Length of the measurement [s]; by default that of the record, up to 4000 samples."
)
@opt.option("--fs", type=float, help="Sampling rate [Hz]; by default that of the record.")
@opt.option("--noise", "noises", multiple=True, help="Noise sd of a target, a=0.1; by default that of the equation.")
@opt.option(
    "--limit", "limits", multiple=True, help="Largest magnitude of a state, x=0.01: amplitudes are lowered to keep it."
)
@opt.option("--odds", type=float, default=100.0, help="Odds at which two models count as told apart.")
@opt.option("--realisations", type=int, default=5, help="Of every excitation.")
@opt.option("--seed", type=int, default=0, help="Seed.")
@opt.json_option()
@opt.option("--figure", type=opt.FILE, help="Write the comparison as a figure: .png, .svg or .pdf.")
@opt.option("--output", "-o", type=opt.FILE, help="Write the best excitation as CSV: time and the inputs.")
def plan(
    file: Path,
    amplitudes: tuple[str, ...],
    band: str | None,
    noises: tuple[str, ...],
    limits: tuple[str, ...],
    as_json: bool,
    figure: Path | None,
    output: Path | None,
    **options: Any,
) -> None:
    """Plan the next measurement: which excitation tells the likeliest models apart best.

    EQ.json holds equations that `bayeq discover --save` has written. Band-limited noise, sweep and multisine are
    simulated and compared by the information that they are expected to bring by second.
    """
    require_output(figure, [file], "figure")
    require_output(output, [file], "table")
    given = {
        "amplitude": _amplitude(amplitudes),
        "band": None if band is None else opt.pair_of_numbers("--band", band),
        "noise": _numbers("--noise", noises),
        "limits": _numbers("--limit", limits),
    }
    from bayeq.equation.load import load

    equations = load(file)
    with Progress() as progress:
        found = equations.plan(**given, **options, progress=progress)
    click.echo(json.dumps(found.to_dict(), allow_nan=False) if as_json else str(found))
    if figure is not None:
        from bayeq.figures.style import write_output

        write_output(figure, found.table, found.plot)
    if output is not None:
        found.write(output)


def _numbers(where: str, texts: Sequence[str]) -> dict[str, float]:
    given = opt.by_name(where, texts, _HOW)
    return {opt.channel_name(name): opt.number(f"{where} {name}", value) for name, value in given.items()}


def _amplitude(texts: Sequence[str]) -> Any:
    """Parse amplitudes: a number, a range, a mapping of these by input, or None without texts."""

    def value(text: str) -> float | tuple[float, float]:
        return opt.pair_of_numbers("--amplitude", text) if ":" in text else opt.number("--amplitude", text)

    if not texts:
        return None
    if len(texts) == 1 and "=" not in texts[0]:
        return value(texts[0])
    return {opt.channel_name(name): value(text) for name, text in opt.by_name("--amplitude", texts, _HOW).items()}
