"""The outputs of `bayeq discover` and `show`: printed equations and parameters, files, and checks of their paths."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from bayeq.cli.terminal import Progress
from bayeq.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayeq.equation.equations import Equations
    from bayeq.equation.quantities import PhysicalParameters
    from bayeq.records import Record
    from bayeq.records.io import FileState

Kind = Literal["any", "table", "figure", "table or figure", "page"]

# Key of the parameters of several coordinates together.
MODES = "modes"

# Purpose (for messages) and kind of the output file of each option.
PURPOSES: Mapping[str, tuple[str, Kind]] = {
    "save": ("to save the equations to", "any"),
    "sensitivity": ("for their sensitivity", "table or figure"),
    "path": ("for the path of best equations", "table or figure"),
    "forecast": ("for the free run", "table or figure"),
    "report": ("for the report", "page"),
}


@dataclass(frozen=True, slots=True)
class Outputs:
    """Requested outputs; see the options of `bayeq discover`."""

    save: Path | None
    sensitivity: Path | None
    path: Path | None
    forecast: Path | None
    report: Path | None
    refine: bool
    physical: bool
    conditional: bool
    explain: bool
    as_json: bool
    verbose: bool

    def check(self, files: Sequence[Path], options: Mapping[str, Any]) -> None:
        """Raise InputError, before the work, for outputs that cannot be made after it; `files` are the input files."""
        if self.explain and self.as_json:
            raise InputError("--explain explains the text, and --json prints none; leave one of them out")
        if self.refine and options.get("target"):
            raise InputError("--refine: output error is of free runs, which static laws (--target) do not have")
        moving = any(options.get(name) for name in ("chains", "displacement", "velocity", "acceleration"))
        asked = "--physical" if self.physical else "--forecast" if self.forecast is not None else None
        if asked and options.get("target") and not moving:
            raise InputError(f"{asked}: static laws (--target) have no motion; leave it out")
        if (self.refine or self.physical) and options.get("discrete"):
            raise InputError(f"--{'refine' if self.refine else 'physical'}: not of maps (--discrete); leave it out")
        parts = (part.strip() for text in options["dictionaries"] for part in (text, text.partition(":")[2]))
        read = [*files, *(Path(part) for part in parts if part and os.path.isfile(part))]  # with files of terms
        seen: dict[Path, str] = {}
        for name, (purpose, kind) in PURPOSES.items():
            output: Path | None = getattr(self, name)
            if output is None:
                continue
            if output in seen:
                raise InputError(f"{output}: named twice, {seen[output]} and {purpose}")
            seen[output] = purpose
            require_output(output, read, kind)
        if self.sensitivity is not None:
            from bayeq.equation.sensitivity import require_spike_slab

            require_spike_slab(options["method"])

    def check_records(self, records: Sequence[Record], discrete: bool) -> None:
        """Raise InputError for records without time if an output needs it; outputs of maps do not."""
        from bayeq.records import counts_rows

        if self.physical and any(map(counts_rows, records)):
            raise InputError("--physical: parameters are per second, and time is not known: give --fs or --time")
        if discrete or (not self.refine and self.forecast is None):
            return
        from bayeq.forecast.rows import require_time

        for wanted, option in ((self.refine, "--refine"), (self.forecast, "--forecast")):
            for record in records if wanted else ():
                require_time(record, option)

    def write(
        self,
        found: Equations,
        records: Sequence[Record],
        files: Mapping[Path, FileState | None],
        holdout: float,
        progress: Progress,
    ) -> None:
        """Print the equations, then write the outputs; `files` are the input files with their state before reading.

        A failed output does not stop the others; InputError at the end for all that cannot be written.
        """
        from bayeq.states.prepare import numbered

        records = numbered(records, found.numbers)
        if self.refine:
            progress("refining", 0, 1)
        answer = found.refine(records, holdout=holdout) if self.refine else found
        progress.close()
        writers: tuple[tuple[Path | None, Callable[[Path], object]], ...] = (
            (self.save, answer.save),
            # about the regression, before any refinement
            (self.sensitivity, partial(_write_curves, found, "sensitivity")),
            (self.path, partial(_write_curves, found, "path")),
            (self.forecast, partial(_write_forecast, answer, records, holdout)),
            (self.report, partial(_write_report, answer, records, files)),
        )
        try:
            folder = next(iter(files), Path()).parent
            form = self.as_json, self.conditional, self.physical, self.explain, self.verbose
            show_equations(answer, *form, folder)
        finally:
            failures = [said for path, write in writers if path is not None and (said := _tried(path, write, progress))]
            if failures:
                raise InputError("; ".join(failures))


# Names of the output options.
OUTPUTS = tuple(field.name for field in fields(Outputs))


def _tried(path: Path, write: Callable[[Path], object], progress: Progress) -> str:
    """Write a file; returns the reason if that fails, else an empty text."""
    progress(f"writing {path.name}", 0, 1)
    try:
        write(path)
    except OSError as error:
        return f"{path}: cannot be written: {error.strerror or error}"
    except InputError as error:
        return str(error)
    return ""


def _write_report(
    answer: Equations, records: Sequence[Record], files: Mapping[Path, FileState | None], path: Path
) -> None:
    """Write the report, with the command as typed if it is known, and hashes of the input files but standard input."""
    from bayeq.records.io import require_unchanged

    for file, before in files.items():
        require_unchanged(file, before)  # the hash must be that of the rows that were used
    given = click.get_current_context().obj
    command = None if given is None else shlex.join(["bayeq", *given])
    answer.report(path, records, files=[file for file in files if file.is_file()], command=command)


def show_equations(
    answer: Equations,
    as_json: bool,
    conditional: bool,
    physical: bool,
    explain: bool,
    verbose: bool,
    folder: Path = Path(),
) -> None:
    """Print equations as one JSON object, in full (`verbose`, or with further parts), or else in a few lines.

    Commands that are proposed name the input file with its `folder`.
    """
    if as_json:
        out = answer.to_dict()
        try:
            if physical:
                out["physical"] = {target: _plain(parameters) for target, parameters in _physical(answer).items()}
        finally:  # equations are printed even if parameters fail
            click.echo(json.dumps(out, allow_nan=False))
        return
    if not (verbose or conditional or physical or explain):
        from bayeq.equation.brief import brief

        click.echo(brief(answer, folder))
        return
    from bayeq.equation.text import render

    click.echo(render(answer, with_warnings=False, conditional=conditional))
    for target, parameters in _physical(answer).items() if physical else ():
        where = "all equations together" if target == MODES else f"the equation of {target}"
        click.echo(f"\nphysical parameters, from {where}\n\n{parameters}")
    if explain:
        from bayeq.equation.explain import explanation

        click.echo(f"\n{explanation(answer, conditional)}")


def _write_curves(found: Equations, what: Literal["sensitivity", "path"], path: Path) -> None:
    from bayeq.equation.sensitivity import draw_pip_curves
    from bayeq.equation.size_path import draw_paths
    from bayeq.figures.style import joined, write_output

    draw: Callable[[Mapping[str, Any]], Figure] = draw_pip_curves if what == "sensitivity" else draw_paths
    results = {equation.target: getattr(equation, what)() for equation in found}
    write_output(path, lambda: joined("target", results.items()), lambda: draw(results))


def _write_forecast(answer: Equations, records: Sequence[Record], holdout: float, path: Path) -> None:
    """Write free runs over the held-out rows, or over whole records if none were held out."""
    from bayeq.forecast.free_run import write_forecasts

    share = holdout if answer.data.n_held_out else 0.0
    starts = [record.n - int(share * record.n) for record in records]
    runs = [
        (record.name, answer.simulate(record, start=start if start < record.n - 1 else 0))
        for record, start in zip(records, starts, strict=True)
    ]
    write_forecasts(path, runs)


def require_output(path: Path | None, files: Sequence[Path], kind: Kind) -> None:
    """Refuse, before the work, an unwritable path, a wrong suffix, or a file whose writer (a package) is missing."""
    if path is None:
        return
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
    """Raise InputError for an output path that cannot be written to, or that is an input file."""
    if path.is_dir():
        raise InputError(f"{path}: is a directory; name a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written: there is no directory {path.parent}")
    if not path.exists() or path.is_file():  # pipes and devices are written to, not replaced
        target = path.resolve()
        if not os.access(target.parent, os.W_OK):
            raise InputError(f"{path}: cannot be written: {target.parent} is read-only; name a file elsewhere")
    read = (one for file in files for one in (file.iterdir() if file.is_dir() else (file,)))
    if path.exists() and any(file.exists() and path.samefile(file) for file in read):
        raise InputError(f"{path}: is a file that is read; name another file to write to")


def _physical(answer: Equations) -> dict[str, PhysicalParameters]:
    """Parameters of the only second-order equation, or else of all equations together, by target or `MODES`."""
    if answer.verdict.kind == "none":
        raise InputError("no equation was found, so that there are no physical parameters: see the verdict")
    second = [equation.target for equation in answer if equation.chain.order == 2]
    if len(second) == 1:
        return {second[0]: answer.physical(target=second[0])}
    return {MODES if second else ", ".join(equation.target for equation in answer): answer.physical()}


def _plain(parameters: PhysicalParameters) -> list[dict[str, Any]]:
    return [
        {"symbol": q.symbol, "meaning": q.meaning, "mean": q.mean, "sd": q.sd, "ci95": [q.low, q.high], "unit": q.unit}
        for q in parameters
    ]
