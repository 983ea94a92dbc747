"""``bayeq study``: Monte Carlo campaigns on the command line."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import click

from bayeq.cli.options import FILE, Command, cluster_client, json_option, number, option, together
from bayeq.cli.terminal import Progress, say
from bayeq.errors import InputError, InterruptedRun
from bayeq.study.config import DEFAULT_ALGORITHMS, STUDY_SYSTEMS, StudyConfig

if TYPE_CHECKING:
    from bayeq.study.table import Format

# Options that several commands have.
_systems = option("--systems", default=",".join(STUDY_SYSTEMS), help="Systems, separated by commas.")
_jobs = option("--jobs", type=int, default=2, help="Worker processes; the results do not depend on it.")


@click.group(invoke_without_command=True)
@click.pass_context
def study(context: click.Context) -> None:
    """Monte Carlo studies: the paper's tables, run and shown."""
    if context.invoked_subcommand is None:
        raise InputError(f"no command given; there are: {', '.join(study.commands)} (see bayeq study --help)")


@study.command(cls=Command)
@option("--realisations", type=int, default=1000, help="Realisations of each system.")
@_jobs
@option(
    "--dask",
    metavar="ADDRESS",
    help="Workers of a Dask cluster instead of --jobs: the address of its scheduler, or its file.",
)
@option("--seed", type=int, default=0, help="Seed of the study.")
@option(
    "--store", type=FILE, default=Path("study.db"), help="File of results; a study that was stopped continues in it."
)
@_systems
@option("--algorithms", default=",".join(DEFAULT_ALGORITHMS), help="Algorithms, separated by commas.")
@option(
    "--smooth",
    type=click.Choice(["none", "auto", "band"]),
    default="none",
    help="The paper's raw noisy channels (none), or the likelihood of the record (auto, formerly band).",
)
def table2(dask: str | None, seed: int, store: Path, systems: str, algorithms: str, smooth: str, **how: Any) -> None:
    """Run the Monte Carlo study of the paper's Tables 2 and 3, or what is missing of it."""
    with Progress() as progress:
        try:
            from bayeq.states.derive import current
            from bayeq.study.runner import run_study

            with cluster_client(dask) as client:
                outcome = run_study(
                    store,
                    systems=_names(systems),
                    algorithms=_names(algorithms),
                    config=StudyConfig(seed=seed, smooth=current(smooth)),
                    progress=partial(progress, "realisations"),
                    client=client,
                    **how,
                )
        except KeyboardInterrupt:
            raise InterruptedRun(
                f"interrupted: {progress.done} realisations were added to {store}; the same command continues"
            ) from None
    if outcome.realisations:
        rate = outcome.realisations / outcome.seconds
        say(f"{store}: {outcome.realisations} realisations in {outcome.seconds:.1f} s ({rate:.3g}/s)")
    if outcome.failures:
        say(f"bayeq: warning: {outcome.failures} runs failed, see below the table")
    _print_table(store)


def _print_table(store: Path, form: Format = "text", table: Literal[2, 3] = 2) -> None:
    from bayeq.study.runner import Store
    from bayeq.study.table import show as render

    with Store(store) as file:
        click.echo(render(file, form, table))


@study.command(cls=Command)
@click.argument("store", type=FILE)
@option(
    "--format", "form", type=click.Choice(["text", "markdown", "csv"]), default="text", help="How to write the table."
)
@json_option()
@option("--table", type=int, default=2, help="The paper's table 2 (errors) or 3 (run times).")
def show(store: Path, form: Literal["text", "markdown", "csv"], as_json: bool, table: int) -> None:
    """Show the results of a study beside the paper's.

    STORE is its file of results.
    """
    if table not in (2, 3):
        raise InputError(f"there is no table {table}; choose --table 2 or --table 3")
    if as_json and form != "text":
        raise InputError(f"--json and --format {form} exclude each other; give one of them")
    _print_table(store, "json" if as_json else form, cast(Literal[2, 3], table))


@study.command(cls=Command)
@click.argument("folder", type=FILE, default=Path("figures"))
@option("--seed", type=int, default=0, help="Seed of the realisation that is drawn.")
@_systems
def figures(folder: Path, seed: int, systems: str) -> None:
    """Draw the paper's figures 4 and 5 from one realisation, as PNG and SVG.

    FOLDER is where they are written; it is made if it does not exist.
    """
    from bayeq.study.figures import write_figures

    for path in write_figures(folder, seed=seed, systems=_names(systems)):
        click.echo(str(path))


# Options of the published benchmarks (dysts, ODEBench).
_of_others = together(
    option("--systems", help="Systems, separated by commas; by default all."),
    option("--seeds", "records", type=int, default=1, help="Number of seeds; each draws new records for every case."),
    option("--seed", "first_seed", type=int, default=0, help="Seed of the first record."),
    _jobs,
    option(
        "--store",
        type=FILE,
        default=Path("benchmark.db"),
        help="File of results; a benchmark that was stopped continues in it.",
    ),
    option("--each", is_flag=True, help="A line for every system, failures first, instead of all together."),
    option("--format", "form", type=click.Choice(["text", "csv"]), default="text", help="How to write the table."),
)


@study.command(cls=Command)
@_of_others
@option("--noise", default="0,0.1,1,10,25,50", help="Noise in per cent, separated by commas.")
@option("--methods", default="bayeq", help="Of bayeq, bayeq told, stlsq, weak; the last two need PySINDy.")
def dysts(noise: str, methods: str, **how: Any) -> None:
    """Find 70 chaotic systems in noisy states (Kaptanoglu et al. 2023)."""
    from bayeq.study import dysts as benchmark

    given = {"noises": [number("--noise", one) for one in _names(noise)], "methods": _names(methods)}
    _run_of_others("dysts", benchmark, given, **how)


@study.command(cls=Command)
@_of_others
@option(
    "--noise", default="none 0,multiplied 1,multiplied 5,added 1,added 5", help="Kinds and per cent, between commas."
)
@option("--points", default="1,0.5", help="Shares of the 512 points that are kept.")
@option("--dictionaries", default="blind,informed", help="Monomials to degree 3, or the system's own functions.")
@option("--methods", default="bayeq", help="Of bayeq, proportional, stlsq; the last one needs PySINDy.")
def odebench(noise: str, points: str, dictionaries: str, methods: str, **how: Any) -> None:
    """Find the 63 systems of ODEBench in one noisy trajectory each (d'Ascoli et al. 2024)."""
    from bayeq.study import odebench as benchmark

    given = {
        "noises": _names(noise),
        "points": [number("--points", one) for one in _names(points)],
        "dictionaries": _names(dictionaries),
        "methods": _names(methods),
    }
    _run_of_others("odebench", benchmark, given, **how)


def _run_of_others(
    name: str,
    benchmark: Any,
    given: dict[str, Any],
    systems: str | None,
    store: Path,
    each: bool,
    form: str,
    **how: Any,
) -> None:
    from bayeq.study.cells import run_cells

    names = None if systems is None else _names(systems)
    with Progress() as progress:
        how["progress"] = partial(progress, "records")
        try:
            done = run_cells(store, name, benchmark.cells_of(names, **given), benchmark.measure, **how)
        except KeyboardInterrupt:
            raise InterruptedRun(f"interrupted: what was done is in {store}; the same command continues") from None
    import pandas as pd

    table = pd.DataFrame(list((benchmark.each if each else benchmark.summary)(done)))
    if form == "csv":
        click.echo(table.to_csv(index=False, lineterminator="\n").rstrip("\n"))
    else:
        click.echo(table.to_string(index=False))


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]
