"""The command line: parse, call, write.

Results go to standard output, progress and warnings to standard error. Exit code 0: done, 2: the input or the
arguments are wrong (one line says what and where), 1: anything else, 130: interrupted.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from io import UnsupportedOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import get_completion_class, shell_complete

from bayeq.cli.batch import batch
from bayeq.cli.discover import discover
from bayeq.cli.options import FILE, Command, Names, json_option, measured, option
from bayeq.cli.reading import Reading, file_options
from bayeq.cli.saved import benchmark, plan, predict, show
from bayeq.cli.study import study
from bayeq.cli.terminal import INTERRUPTED, no_memory, prepare_streams, say
from bayeq.errors import (
    FULL,
    BayeqError,
    BayeqWarning,
    InputError,
    InterruptedRun,
    MissingExtraError,
    one_line,
    printable,
)
from bayeq.resumable.posix import address_space

if TYPE_CHECKING:
    from bayeq.inspection.contents import RecordInfo

# Environment variable by which the script of `bayeq completion` asks for completions, named by click's rule.
COMPLETE = "_BAYEQ_COMPLETE"


@click.group(invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="bayeq", message="%(version)s", help="Print the version and stop.")
@click.option("--cite", is_flag=True, help="Print what to cite, also as BibTeX, and stop.")
@click.pass_context
def app(context: click.Context, cite: bool) -> None:
    """Bayesian equation discovery: measured motion in, governing equation with honest uncertainty out."""
    if cite:
        from bayeq.citation import citation

        click.echo(citation())
        context.exit()
    if context.invoked_subcommand is None:
        raise InputError(f"no command given; there are: {', '.join(app.commands)} (see bayeq --help)")


@click.command(cls=Command)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@file_options
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


@click.command(cls=Command)
@click.argument("system")
@option("--output", "-o", type=FILE, required=True, help="File to write: .csv, .tsv, .parquet or .npz.")
@option("--n", type=int, help="Samples (oscillators: 4000).")
@option("--fs", type=float, help="Sampling frequency [Hz] (oscillators: 1000).")
@option("--noise", type=float, default=0.05, help="Noise on every channel, as a ratio of its standard deviation.")
@option("--perturb", type=float, default=0.0, help="Relative random change of the parameters (the paper: 0.1).")
@option("--seed", type=int, default=0, help="Seed.")
def simulate(system: str, output: Path, **options: Any) -> None:
    """Simulate a known system and write the noisy record to a file.

    SYSTEM is the name of a known system, see `bayeq systems`.
    """
    from bayeq.records import write
    from bayeq.systems import simulate as run

    record = run(system, **options)
    write(record, output)
    say(f"{output}: {record.n} rows of {', '.join(record.names)}")


@click.command(cls=Command)
@option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def systems(as_json: bool) -> None:
    """List the known systems and their equations."""
    from bayeq.systems import SYSTEMS

    known = SYSTEMS.load().values()
    if as_json:
        names = ("name", "title", "chains", "inputs", "parameters", "terms", "citation")
        click.echo(json.dumps({"systems": [{name: getattr(s, name) for name in names} for s in known]}, default=dict))
        return
    for s in known:
        click.echo(f"{s.name}: {s.title}")
        for target, terms in s.terms.items():
            right = " + ".join(f"({coefficient})*{term}" for term, coefficient in terms.items())
            click.echo(f"    {target} = {right}")
        click.echo(f"    {', '.join(f'{k} = {v:g}' for k, v in s.parameters.items())}")


@click.command("app")
@click.argument("file", required=False, type=FILE)
@option("--port", type=int, default=0, help="Port to listen to on this computer; 0 for a free one.")
@option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
def local_page(file: Path | None, port: int, no_browser: bool) -> None:
    """Show a page in the browser: drop a file, choose roles, press Discover, read and keep the result.

    FILE is opened where it is. The page is for this computer alone: no data leave it. It needs bayeq[app].
    """
    from bayeq.app.server import serve

    serve(file, port, not no_browser, click.echo)


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script by which SHELL completes commands and options.

    Load it where the shell starts: eval "$(bayeq completion bash)" in ~/.bashrc, the same with zsh in ~/.zshrc, or
    bayeq completion fish > ~/.config/fish/completions/bayeq.fish.
    """
    found = get_completion_class(shell)
    assert found is not None
    click.echo(found(context.find_root().command, {}, "bayeq", COMPLETE).source())


COMMANDS = (info, discover, batch, show, predict, plan, simulate, systems, study, benchmark, local_page, completion)
for command in COMMANDS:
    app.add_command(command)


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if category is RuntimeWarning:  # an intermediate overflow: the final result is checked for finite values
        return
    label = "warning" if issubclass(category, BayeqWarning) else category.__name__
    say(f"bayeq: {label}: {printable(one_line(message))}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    prepare_streams()
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", BayeqWarning)
    try:
        if arguments is None and (asked := os.environ.get(COMPLETE)):
            return shell_complete(app, {}, "bayeq", COMPLETE, asked)
        given = sys.argv[1:] if arguments is None else list(arguments)
        with app.make_context("bayeq", list(given), obj=given) as context:
            app.invoke(context)
    except (InputError, MissingExtraError) as error:
        return _fail(str(error), 2)
    except InterruptedRun as stop:
        say(f"bayeq: {printable(one_line(stop))}")
        return INTERRUPTED
    except BayeqError as error:
        return _fail(str(error), 1)
    except click.ClickException as error:
        return _fail(error.format_message(), error.exit_code)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except (KeyboardInterrupt, click.Abort) as stop:
        said = ("interrupted", *getattr(stop, "__notes__", ()))  # what was kept, and where
        say(f"bayeq: {printable(one_line(': '.join(said)))}")
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of the pipe has gone (`bayeq ... | head`): nothing is left to say to it, now or at the exit.
        sys.stdout = None
        return 0
    except MemoryError:
        return _fail(no_memory(), 1)
    except ImportError:
        if address_space() is None:
            raise
        return _fail(no_memory(), 1)  # a library that could not be loaded
    except UnsupportedOperation:
        return _fail("standard output is closed: the result cannot be printed", 1)
    except OSError as error:
        if error.filename:
            return _fail(f"{error.filename}: {error.strerror or error}", 2)
        full = error.errno in FULL
        return _fail(f"{'the result cannot be written: ' if full else ''}{error.strerror or error}", 1)
    return 0


def _fail(message: str, code: int) -> int:
    if message:
        say(f"bayeq: error: {printable(one_line(message))}")
    return code
