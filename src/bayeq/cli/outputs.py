"""What `bayeq discover` makes of the equations it has found: files, refinement, physical parameters, and the print."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from bayeq.cli.progress import Progress
from bayeq.errors import InputError

if TYPE_CHECKING:
    from bayeq.equation.equations import Equations
    from bayeq.equation.physical import PhysicalParameters
    from bayeq.records import Record
    from bayeq.records.files import FileState

Kind = Literal["any", "table", "figure", "table or figure", "page"]

# What parameters of several coordinates together are called.
MODES = "modes"

# What a file is for, and of which kind it is, by option.
PURPOSES: Mapping[str, tuple[str, Kind]] = {
    "save": ("to save the equations to", "any"),
    "sensitivity": ("for their sensitivity", "table or figure"),
    "path": ("for the path of best equations", "table or figure"),
    "forecast": ("for the free run", "table or figure"),
    "report": ("for the report", "page"),
}


@dataclass(frozen=True, slots=True)
class Outputs:
    """What was asked for; see the options."""

    save: Path | None
    sensitivity: Path | None
    path: Path | None
    forecast: Path | None
    report: Path | None
    refine: bool
    physical: bool
    conditional: bool = False
    explain: bool = False

    def check(self, files: Sequence[Path], options: Mapping[str, Any], as_json: bool = False) -> None:
        """Refuse, before the work, what could not be done after it; `files` are the records that are read.

        InputError for a file that cannot be written, is one of the records or is named twice, or for a method or an
        order that does not go with what is asked for; MissingExtraError for what is not installed.
        """
        if self.explain and as_json:
            raise InputError("--explain explains the text, and --json prints none; leave one of them out")
        if self.refine and options.get("target"):
            raise InputError("--refine: output error is of free runs, which static laws (--target) do not have")
        if (self.refine or self.physical) and options.get("discrete"):
            raise InputError(f"--{'refine' if self.refine else 'physical'}: not of maps (--discrete); leave it out")
        seen: dict[Path, str] = {}
        for name, (purpose, kind) in PURPOSES.items():
            output: Path | None = getattr(self, name)
            if output is None:
                continue
            if output in seen:
                raise InputError(f"{output}: named twice, {seen[output]} and {purpose}")
            seen[output] = purpose
            require_output(output, [*files, *_files_of_terms(options)], kind)
        if self.sensitivity is not None:
            from bayeq.equation.sensitivity import require_spike_slab

            require_spike_slab(options["method"])

    def check_records(self, records: Sequence[Record], discrete: bool) -> None:
        """Refuse records without time where it is needed, which it is not of maps."""
        from bayeq.records import counts_rows

        if self.physical and any(map(counts_rows, records)):
            raise InputError("--physical: parameters are per second, and time is not known: give --fs or --time")
        if discrete or (not self.refine and self.forecast is None):
            return
        from bayeq.forecast.rows import require_time

        for wanted, option in ((self.refine, "--refine"), (self.forecast is not None, "--forecast")):
            for record in records if wanted else ():
                require_time(record, option)

    def write(
        self,
        found: Equations,
        records: Sequence[Record],
        files: Mapping[Path, FileState | None],
        holdout: float,
        as_json: bool,
        progress: Progress,
        verbose: bool = False,
    ) -> None:
        """Print the equations, then write the files; `files`, those that were read, come with their state before.

        Each is done whatever becomes of the others: what was found is printed although a file cannot be written, which
        is an InputError at the end.
        """
        if self.refine:
            progress("refining", 0, 1)
        answer = found.refine(records, holdout=holdout) if self.refine else found
        progress.close()
        try:
            show_equations(answer, as_json, self.conditional, self.physical, self.explain, verbose)
        finally:
            self._write_files(found, answer, records, files, holdout, progress)

    def _write_files(
        self,
        found: Equations,
        answer: Equations,
        records: Sequence[Record],
        files: Mapping[Path, FileState | None],
        holdout: float,
        progress: Progress,
    ) -> None:
        """Write the files that were named; sensitivity and path are about the regression, before any refinement."""
        failures = []
        for path, write in (
            (self.save, answer.save),
            (self.sensitivity, lambda file: _write_curves(file, found, "sensitivity")),
            (self.path, lambda file: _write_curves(file, found, "path")),
            (self.forecast, lambda file: _write_forecast(file, answer, records, holdout)),
            (self.report, lambda file: _write_report(file, answer, records, files)),
        ):
            if path is None:
                continue
            progress(f"writing {path.name}", 0, 1)
            try:
                write(path)
            except OSError as error:
                failures.append(f"{path}: cannot be written: {error.strerror or error}")
            except InputError as error:
                failures.append(str(error))
        if failures:
            raise InputError("; ".join(failures))


def _write_report(
    path: Path, answer: Equations, records: Sequence[Record], files: Mapping[Path, FileState | None]
) -> None:
    """The report, with the command as it was typed where that is known; standard input has no file to be hashed."""
    from bayeq.records.files import require_unchanged

    for file, before in files.items():
        require_unchanged(file, before)  # a hash of other rows would be a lie
    given = click.get_current_context().obj
    command = None if given is None else shlex.join(["bayeq", *given])
    answer.report(path, records, files=[file for file in files if file.is_file()], command=command)


def show_equations(
    answer: Equations,
    as_json: bool,
    conditional: bool,
    physical: bool,
    explain: bool = False,
    verbose: bool = False,
) -> None:
    """Print equations in a few lines, in full where that or more than them is asked for, or as one JSON object."""
    if as_json:
        out = answer.to_dict()
        if physical:
            out["physical"] = {target: _plain(parameters) for target, parameters in _physical(answer).items()}
        click.echo(json.dumps(out, allow_nan=False))
        return
    if not (verbose or conditional or physical or explain):
        from bayeq.equation.brief import brief

        click.echo(brief(answer))
        return
    from bayeq.equation.text import render

    click.echo(render(answer, with_warnings=False, conditional=conditional))
    for target, parameters in _physical(answer).items() if physical else ():
        where = "all equations together" if target == MODES else f"the equation of {target}"
        click.echo(f"\nphysical parameters, from {where}\n\n{parameters}")
    if explain:
        from bayeq.equation.explain import explanation

        click.echo(f"\n{explanation(answer, conditional)}")


def _write_curves(path: Path, found: Equations, what: Literal["sensitivity", "path"]) -> None:
    """The sensitivity or the path of each equation."""
    from bayeq.equation.sensitivity import draw_pip_curves
    from bayeq.equation.size_path import draw_paths
    from bayeq.figures.style import write_by_target

    draw = draw_pip_curves if what == "sensitivity" else draw_paths
    write_by_target(path, {equation.target: getattr(equation, what)() for equation in found}, draw)


def _write_forecast(path: Path, answer: Equations, records: Sequence[Record], holdout: float) -> None:
    """Free runs over the rows held out, or over whole records where none are."""
    from bayeq.forecast.run import write_forecasts

    share = holdout if answer.data.n_held_out else 0.0
    starts = [record.n - int(share * record.n) for record in records]
    runs = [
        (record.name, answer.simulate(record, start=start if start < record.n - 1 else 0))
        for record, start in zip(records, starts, strict=True)
    ]
    write_forecasts(path, runs)


# The options that are outputs.
OUTPUTS = tuple(field.name for field in fields(Outputs))


def require_output(path: Path, files: Sequence[Path], kind: Kind) -> None:
    """Refuse, before the work, a file that could not be written after it.

    It cannot be there, is one of the `files` that are read, or ends otherwise than its kind; or what makes it is not
    installed.
    """
    _require_place(path, files)
    suffix = path.suffix.lower()
    if kind == "table" and suffix != ".csv":
        raise InputError(f"{path}: is to be written as a table: end it in .csv")
    if kind == "page":
        if suffix not in (".html", ".htm"):
            raise InputError(f"{path}: a report is an HTML page: end it in .html")
        from bayeq.equation.report.page import require_report

        require_report()
    if "figure" in kind:
        from bayeq.figures.style import UNSIGNED, require_suffix

        if kind == "figure" and suffix[1:] not in UNSIGNED:
            endings = ", ".join(f".{name}" for name in UNSIGNED)
            raise InputError(f"{path}: is to be written as a figure: end it in {endings}; tables have their own option")
        require_suffix(path)


def _require_place(path: Path, files: Sequence[Path]) -> None:
    """Refuse a file to write that cannot be there, or that is read."""
    if path.is_dir():
        raise InputError(f"{path}: is a directory; name a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written: there is no directory {path.parent}")
    if not path.exists() or path.is_file():  # others, as pipes, are not replaced
        target = path.resolve()
        if not os.access(target.parent, os.W_OK):
            raise InputError(f"{path}: cannot be written: {target.parent} is read-only; name a file elsewhere")
    if path.exists() and any(file.exists() and path.samefile(file) for file in _with_contents(files)):
        raise InputError(f"{path}: is a file that is read; name another file to write to")


def _with_contents(paths: Sequence[Path]) -> Iterator[Path]:
    """Files, and those in folders."""
    for path in paths:
        yield from path.iterdir() if path.is_dir() else (path,)


def _files_of_terms(options: Mapping[str, Any]) -> list[Path]:
    """Files among what dictionaries name."""
    parts = (part.strip() for text in options["dictionaries"] for part in (text, text.partition(":")[2]))
    return [Path(part) for part in parts if part and os.path.isfile(part)]


def _physical(answer: Equations) -> dict[str, PhysicalParameters]:
    """Of the only equation of second order, of all of several together, or of states of first order."""
    second = [equation.target for equation in answer if equation.chain.order == 2]
    if len(second) == 1:
        return {second[0]: answer.physical(target=second[0])}
    return {MODES if second else ", ".join(equation.target for equation in answer): answer.physical()}


def _plain(parameters: PhysicalParameters) -> list[dict[str, Any]]:
    return [
        {"symbol": q.symbol, "meaning": q.meaning, "mean": q.mean, "sd": q.sd, "ci95": [q.low, q.high], "unit": q.unit}
        for q in parameters
    ]
