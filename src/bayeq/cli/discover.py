"""``bayeq discover``: read records, find equations, print and write them."""

from __future__ import annotations

import sys
import time as clock
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayeq.cli.channels import named_channels, path_of
from bayeq.cli.options import FILE, option
from bayeq.cli.outputs import OUTPUTS, Outputs
from bayeq.cli.reading import join_records, read_records
from bayeq.cli.streams import say
from bayeq.errors import InputError
from bayeq.inference.engines import ENGINES
from bayeq.kernels import announce_compiling

if TYPE_CHECKING:
    from bayeq.records import Record

__all__ = ["COMPILING", "discover"]

COMPILING = "compiling what runs for the first time after installation: up to a minute ..."

# Work that takes longer shows its progress [s].
PATIENCE = 1.0

# Options about reading; what is neither these nor outputs goes to `bayeq.discover` as it is.
READING = ("time", "fs", "names", "group")


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


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@option("--time", help="Time column [s], or the path of an array.")
@option("--fs", type=float, help="Sampling frequency [Hz], where there is no time column.")
@option("--names", help="Column names, separated by commas, for a file without header.")
@option("--group", help="Column that numbers the trials within a file.")
@option("--join", is_flag=True, help="FILE... are channels of one motion: join them on the time of the first.")
@option("--disp", "displacement", help="Displacement channel: its name, or name=path in files of many arrays.")
@option("--vel", "velocity", help="Velocity channel.")
@option("--acc", "acceleration", help="Acceleration channel.")
@option("--force", help="Force channel.")
@option(
    "--chain",
    "chains",
    multiple=True,
    help="A coordinate and its measured derivatives: x:v:a, x:: (only x measured), ::a (only a), x (first order),"
    " x:xdot. Once per coordinate.",
)
@option("--input", "inputs", multiple=True, help="Input channel; once per input.")
@option(
    "--dictionary",
    "dictionaries",
    multiple=True,
    help="Candidate terms: oscillator, polynomial:3, fourier:2, neighbours, a file of terms, or terms separated by"
    " commas; 'oscillator + sin(x) - x**5' joins and leaves out. 'a1: oscillator' is for equation a1 alone, once per"
    " equation. By default oscillator.",
)
@option(
    "--method",
    type=click.Choice(list(ENGINES)),
    default="auto",
    help="Engine; auto: optimum by VB, probabilities by model averaging.",
)
@option(
    "--smooth",
    type=click.Choice(["auto", "band", "none"]),
    default="auto",
    help="Likelihood of the record (auto), regression of smoothed rows (band), or channels as measured (none).",
)
@option(
    "--constraint",
    "constraints",
    multiple=True,
    help="What is known of coefficients, by the names of terms: 'u == 1', 'v <= 0', 'a: x*abs(x) == 0.5*x**3' (of"
    " equation a). Once per constraint.",
)
@option(
    "--noise",
    multiple=True,
    help="Known noise of a channel: standard deviation in its unit (u=0.1) or share of the channel's (u=2%). Once per"
    " channel.",
)
@option(
    "--gain-sd",
    "gain_sd",
    multiple=True,
    help="Uncertainty of a sensor's calibration, which intervals take in: x=0.01 for 1 %. Once per channel.",
)
@option(
    "--tails",
    type=click.Choice(["gauss", "student"]),
    default="gauss",
    help="Distribution of the noise: normal, or Student's t, for noise of many outliers.",
)
@option("--holdout", type=float, default=0.2, help="Share of the rows, the last, to judge the equation by.")
@option("--max-terms", type=int, help="Show at most this number of terms: the likeliest equation within it.")
@option(
    "--tolerance",
    type=float,
    help="What makes no practical difference: the smallest equation is shown whose predictions and free runs are worse"
    " than the full model's by no more than this share (0.01); 0 shows the included terms.",
)
@option(
    "--coarsen",
    type=float,
    default=1.0,
    help="Power (0 to 1) of the likelihood, for models that are only nearly true.",
)
@option(
    "--conditional",
    is_flag=True,
    help="Print the intervals given the terms shown, also where those over all models differ. --json has both.",
)
@option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
@option("--save", type=FILE, help="Write the equations to a JSON file, for bayeq.load.")
@option(
    "--sensitivity",
    type=FILE,
    help="Write the PIPs under other v_s and p_0: a table (.csv) or a figure (.png, .svg, .pdf).",
)
@option(
    "--path",
    type=FILE,
    help="Write the best equation of each size, with evidence and errors: a table (.csv) or a figure (.png, .svg,"
    " .pdf).",
)
@option(
    "--forecast",
    type=FILE,
    help="Write the free run over the held-out rows, with its 95 % band: a table (.csv) or a figure (.png, .svg,"
    " .pdf).",
)
@option("--refine", is_flag=True, help="Coefficients by output error: those whose free run is closest to the record.")
@option("--physical", is_flag=True, help="Also mass, damping, stiffness ... of a second-order equation.")
@option("--seed", type=int, default=0, help="Seed of methods that draw random numbers (gibbs).")
def discover(files: tuple[Path, ...], as_json: bool, **options: Any) -> None:
    """Find the equation of motion of a measured record.

    FILE... are one or several records: text (CSV ...), MATLAB, HDF5, universal files, TDMS, LabVIEW, Excel, WAV,
    Parquet, NumPy. A channel of a file of many arrays is named by its path: --disp th=Y_id[0].0 is the first row of the
    first cell of Y_id, th=Y_id[*].0 one record for each cell.
    """
    outputs = Outputs(**{name: options.pop(name) for name in OUTPUTS})
    reading = {name: options.pop(name) for name in READING}
    reading["time"], reading["group"] = path_of(reading["time"]), path_of(reading["group"])
    joined = options.pop("join")
    options, paths = named_channels(options)
    outputs.check(files, options)
    for k, file in enumerate(files):
        if file.exists() and any(other.exists() and file.samefile(other) for other in files[:k]):
            raise InputError(f"{file}: named twice; the same rows twice are not twice the evidence")
    options = _cleaned(options)
    announce_compiling(lambda: say(COMPILING))
    progress = Progress()
    try:
        parts: list[list[Record]] = []
        for k, file in enumerate(files):
            progress("reading", k, len(files))
            parts.append(read_records(file, _used(options), paths, reading, joined))
        records = join_records(parts) if joined else [record for part in parts for record in part]
        if not options["chains"]:  # which may be badly written
            _require_channels(records, _used(options))
        outputs.check_records(records)
        from bayeq.discovery import discover as run  # once the files are known to be readable

        answer = run(records, **options, progress=progress)
    finally:
        progress.close()
    outputs.write(answer, records, options["holdout"], as_json)


def _cleaned(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options as `bayeq.discover` takes them: channels by their names, without those that were not given."""
    out = {name: value for name, value in options.items() if value is not None}
    for role in ("displacement", "velocity", "acceleration", "force"):
        if role in out:
            out[role] = _channel(out[role])
    out["inputs"] = [name for name in map(_channel, out["inputs"]) if name]
    out["chains"] = list(out["chains"]) or None
    dictionaries = out.pop("dictionaries") or ("oscillator",)
    if len(dictionaries) > 1 and not all(":" in text for text in dictionaries):
        raise InputError(
            "--dictionary is given more than once: join families and terms with +, terms with commas, or write the"
            " target of each equation in front, as in --dictionary 'a1: oscillator'"
        )
    out["dictionary"] = "; ".join(dictionaries)
    for name in ("noise", "gain_sd"):
        out[name] = dict(_pair(name, text) for text in out[name])
    return out


def _channel(name: str) -> str:
    """A channel by its name or by its header in the file, such as ``Displ. (m)``."""
    if not name or name.isidentifier() or ":" in name:
        return name
    from bayeq.records import clean_name

    return clean_name(name)[0]


def _pair(option: str, text: str) -> tuple[str, str]:
    """A channel and what is known of it, written as ``u=0.1``."""
    name, equals, value = text.rpartition("=")
    if not equals or not name.strip() or not value.strip():
        raise InputError(f"--{option.replace('_', '-')} {text[:60]!r}: write a channel and a value, such as u=0.01")
    return _channel(name.strip()), value.strip()


def _used(options: Mapping[str, Any]) -> list[str]:
    """Channels that the options name."""
    single = (options.get(role, "") for role in ("displacement", "velocity", "acceleration", "force"))
    texts = (*(options["chains"] or ()), *single, *options["inputs"])
    return [name for text in texts for name in text.split(":") if name and not name.startswith("~")]


def _require_channels(records: Sequence[Record], names: Sequence[str]) -> None:
    """Refuse channels that a record lacks: before the import of what would find it out."""
    for name in names:
        for record in records:
            _ = record[name]
