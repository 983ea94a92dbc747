"""``bayeq study``: Monte Carlo campaigns on the command line."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, cast

import typer

from bayeq.cli.streams import say
from bayeq.errors import InputError, InterruptedRun

__all__ = ["study_app"]

study_app = typer.Typer(
    name="study",
    help="Monte Carlo studies: the paper's tables, run and shown.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


class StudySmoothing(StrEnum):
    """How states are had from the channels."""

    none = "none"
    auto = "auto"


class TableFormat(StrEnum):
    """How a table is written."""

    text = "text"
    markdown = "markdown"
    csv = "csv"


@study_app.callback(invoke_without_command=True)
def _root(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        known = ", ".join(c.name or c.callback.__name__ for c in study_app.registered_commands if c.callback)
        raise InputError(f"no command given; there are: {known} (see bayeq study --help)")


@study_app.command()
def table2(
    realisations: Annotated[int, typer.Option(help="Realisations of each system.")] = 1000,
    jobs: Annotated[int, typer.Option(help="Worker processes; the results do not depend on it.")] = 2,
    seed: Annotated[int, typer.Option(help="Seed of the study.")] = 0,
    store: Annotated[Path, typer.Option(help="File of results; a study that was stopped continues in it.")] = Path(
        "study.db"
    ),
    systems: Annotated[str, typer.Option(help="Systems, separated by commas.")] = "linear,duffing,quadratic,coulomb",
    algorithms: Annotated[str, typer.Option(help="Algorithms, separated by commas.")] = "sindy,rvm,gibbs,vb,vb-rvm",
    smooth: Annotated[
        StudySmoothing, typer.Option(help="The paper's raw noisy channels (none), or smoothed ones (auto).")
    ] = StudySmoothing.none,
) -> None:
    """Run the Monte Carlo study of the paper's Tables 2 and 3, or what is missing of it."""
    from bayeq.study.progress import StudyProgress

    progress = StudyProgress()
    try:
        with _interrupts_held():  # an import that is interrupted fails in ways of its own
            from bayeq.study.config import StudyConfig
            from bayeq.study.runner import run_study
            from bayeq.study.show import show as render
            from bayeq.study.store import Store
        outcome = run_study(
            store,
            systems=_names(systems),
            algorithms=_names(algorithms),
            realisations=realisations,
            jobs=jobs,
            config=StudyConfig(seed=seed, smooth=smooth.value),
            progress=progress,
        )
    except KeyboardInterrupt:
        progress.close()
        raise InterruptedRun(
            f"interrupted: {progress.done} realisations were added to {store}; the same command continues"
        ) from None
    finally:
        progress.close()
    if outcome.realisations:
        rate = outcome.realisations / outcome.seconds
        say(f"{store}: {outcome.realisations} realisations in {outcome.seconds:.1f} s ({rate:.3g}/s)")
    if outcome.failures:
        say(f"bayeq: warning: {outcome.failures} runs failed, see below the table")
    with Store.open(store) as file:
        typer.echo(render(file))


@study_app.command()
def show(
    store: Annotated[Path, typer.Argument(metavar="STORE", help="File of results.")],
    form: Annotated[TableFormat, typer.Option("--format", help="How to write the table.")] = TableFormat.text,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
    table: Annotated[int, typer.Option(help="The paper's table 2 (errors) or 3 (run times).")] = 2,
) -> None:
    """Show the results of a study beside the paper's."""
    from bayeq.study.show import show as render
    from bayeq.study.store import Store

    if table not in (2, 3):
        raise InputError(f"there is no table {table}; choose --table 2 or --table 3")
    if json and form is not TableFormat.text:
        raise InputError(f"--json and --format {form.value} exclude each other; give one of them")
    with Store.open(store) as file:
        typer.echo(render(file, "json" if json else form.value, cast(Literal[2, 3], table)))


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C takes effect at the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived = []
    handler = signal.signal(signal.SIGINT, lambda *_: arrived.append(True))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if arrived:
        raise KeyboardInterrupt


@study_app.command()
def figures(
    folder: Annotated[Path, typer.Argument(help="Folder to write to; made if it does not exist.")] = Path("figures"),
    seed: Annotated[int, typer.Option(help="Seed of the realisation that is drawn.")] = 0,
    systems: Annotated[str, typer.Option(help="Systems, separated by commas.")] = "linear,duffing,quadratic,coulomb",
) -> None:
    """Draw the paper's figures 4 and 5 from one realisation, as PNG and SVG."""
    from bayeq.study.figures import write_figures

    for path in write_figures(folder, seed=seed, systems=_names(systems)):
        typer.echo(str(path))


def _names(text: str) -> list[str]:
    """The names in a list separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]
