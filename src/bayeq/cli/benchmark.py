"""``bayeq benchmark``: the row of a table for measured data with an official split into training and test."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from bayeq.cli import options as opt
from bayeq.cli.progress import Progress
from bayeq.cli.reading import Reading
from bayeq.cli.saved import paths_of
from bayeq.errors import InputError

EXAMPLES = """
Example:

  Both halves in one file, under names of their own:

    bayeq benchmark --train tanks.csv --test tanks.csv --skip 50 --fs 0.25 --chain yEst --input uEst --dictionary
    "yEst, sqrt(yEst), uEst" --channel yEst=yVal --channel uEst=uVal
"""


@click.command(cls=opt.Command, epilog=EXAMPLES)
@opt.option("--train", type=opt.FILE, required=True, help="Measured file, or equations of discover --save (.json).")
@opt.option("--test", "tests", type=opt.FILE, multiple=True, required=True, help="File of the test; once per file.")
@opt.option("--skip", type=int, default=50, help="Rows of the test from which the initial state is; not scored.")
@opt.measured("--chain", "chains", multiple=True, help="As for bayeq discover: x, x::, x:v:a. Once per coordinate.")
@opt.measured("--input", "inputs", multiple=True, help="Input channel; once per input.")
@opt.measured(
    "--channel", "channels", multiple=True, help="Where a channel is in the files of the test, x=xVal. Once per name."
)
@opt.measured("--time", help="Time column [s] of all files.")
@opt.measured("--fs", type=float, help="Sampling frequency [Hz], where there is no time column.")
@opt.in_terms("--dictionary", default="oscillator", help="Candidate terms, as for bayeq discover.")
@opt.in_terms("--law", "laws", multiple=True, help="Rate of a hidden state, as for bayeq discover. Once per state.")
@opt.json_option(group=opt.WRITTEN)
@opt.option("--verbose", is_flag=True, help="Say on standard error what is being done, and how long it takes.")
def benchmark(
    train: Path,
    tests: tuple[Path, ...],
    skip: int,
    chains: tuple[str, ...],
    inputs: tuple[str, ...],
    channels: tuple[str, ...],
    time: str | None,
    fs: float | None,
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
    reading = Reading(time=opt.path_of(time), fs=fs)
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
    if as_json:
        answer = {"equations": [eq.text for eq in found], "verdict": found.verdict.kind}
        click.echo(json.dumps(answer | {"tests": [asdict(one) for one in errors]}))
        return
    for eq in found:
        click.echo(f"{eq.verdict.kind}: {eq.text}")
    for one in errors:
        click.echo(str(one))
