"""``bayeq discover``: read records, find equations, print and write them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bayeq.cli import options as opt
from bayeq.cli.outputs import OUTPUTS, Outputs
from bayeq.cli.reading import STANDARD_INPUT, Reading, plain_files, reading_options
from bayeq.cli.terminal import Progress
from bayeq.errors import InputError
from bayeq.inference.engines import ENGINES

if TYPE_CHECKING:
    from bayeq.records import Record

EXAMPLES = """
Examples:

  A vibrating mass, all channels measured; displacement in mm, acceleration in g:

    bayeq discover run.csv --disp x --vel v --acc a --force u --units x=mm,a=g

  Displacement alone, from a MATLAB file, with terms of one's own; the equation is saved,
  and tried on another measurement:

    bayeq discover pendulum.mat --disp "th=Y_id[0].0" --fs 1000 --dictionary "sin(th), dth" --save eq.json
    bayeq predict eq.json second.mat --channel "th=Y_id[1].0" --fs 1000

  Two masses, several files, hum of the mains left out, free runs as a figure:

    bayeq discover a.csv b.csv --chain x1:v1:a1 --chain x2:v2:a2 --input f --dictionary neighbours \\
        --band 0.5:40 --forecast runs.png
"""


class _Method(click.Choice):  # type: ignore[type-arg]  # generic in the latest click only
    """The name of an engine; engines of other packages are loaded only for a name that bayeq does not have."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value not in ENGINES:
            self.choices = tuple(ENGINES.load())
        return str(super().convert(value, param, ctx))


@click.command(cls=opt.Command, epilog=EXAMPLES)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=opt.FILE)
@opt.measured("--disp", "displacement", help="Displacement channel: its name, or name=path in files of many arrays.")
@opt.measured("--vel", "velocity", help="Velocity channel.")
@opt.measured("--acc", "acceleration", help="Acceleration channel.")
@opt.measured("--force", help="Force channel.")
@opt.measured(
    "--chain",
    "chains",
    multiple=True,
    help="A coordinate and its measured derivatives: x:v:a, x:: (only x measured), ::a (only a), x (first order),"
    " x:xdot; ~r: is a hidden state with a dictionary, ~x2:: a hidden mass. Once per coordinate.",
)
@opt.measured("--input", "inputs", multiple=True, help="Input channel; once per input.")
@opt.measured(
    "--target",
    multiple=True,
    help="Channel that is no derivative, as the force of a damper, of which the law is static: a function of inputs."
    " Once per equation, or F1,F2.",
)
@opt.measured(
    "--discrete",
    is_flag=True,
    help="The equation gives the next sample, x[+1], in place of the rate (maps, sequences); terms may have earlier"
    " samples, x[-1], u[-2]. Each chain is a channel.",
)
@reading_options
@opt.in_terms(
    "--dictionary",
    "dictionaries",
    multiple=True,
    help="Candidate terms: oscillator, polynomial:3, fourier:2, neighbours, a file of terms, or terms separated by"
    " commas; 'oscillator + sin(x) - x**5' joins and leaves out. {name} or {name: low..high} is an unknown constant"
    " inside a term, 'tanh(v/{v0})'; of 'tanh(v/{v0}) | sign(v)' at most one is in. 'a1: oscillator' is for equation a1"
    " alone, once per equation. By default oscillator.",
)
@opt.sure(
    "--method",
    type=_Method(list(ENGINES)),
    default="auto",
    help="Engine; auto: model averaging, with the lower bound of variational Bayes.",
)
@opt.sure(
    "--smooth",
    type=click.Choice(["auto", "band", "none"]),
    default="auto",
    help="Likelihood of the record (auto, formerly band), or channels as measured (none).",
)
@opt.sure("--band", help="Frequencies in which the record is believed, LO:HI [Hz], where hum or drift lie outside.")
@opt.in_terms(
    "--constraint",
    "constraints",
    multiple=True,
    help="What is known of coefficients, by the names of terms: 'u == 1', 'v <= 0', 'a: x*abs(x) == 0.5*x**3' (of"
    " equation a), '0 <= a: x**3 <= 5' (bounds). Once per constraint.",
)
@opt.in_terms(
    "--conserve", help="A sum of states that does not change, 'S + I + R': terms are flows between two of them."
)
@opt.in_terms(
    "--differs",
    help="Terms whose coefficients may differ between the records, 'x, v', or all: differences are candidates.",
)
@opt.in_terms(
    "--law",
    multiple=True,
    help="Rate of a hidden state, which no channel measures: 'df = (u - f)/{tau}'. Once per state.",
)
@opt.sure(
    "--noise",
    multiple=True,
    help="Known noise of a channel: standard deviation in its unit (u=0.1), share of the channel's (u=2%), or of every"
    " reading ('u=5% of reading'; 'u=% of reading': learned). Once per channel.",
)
@opt.sure(
    "--gain-sd",
    "gain_sd",
    multiple=True,
    help="Uncertainty of a sensor's calibration: x=0.01 for 1 %. Other channels of its chain tell the factor; intervals"
    " take in the rest. Once per channel.",
)
@opt.sure(
    "--lag-sd",
    "lag_sd",
    multiple=True,
    help="Channel that may be late, with the standard deviation of its lag [s], which is learned: u=0.002. Once per"
    " channel.",
)
@opt.sure(
    "--tails",
    type=click.Choice(["gauss", "student"]),
    default="gauss",
    help="Distribution of the noise: normal, or Student's t, for noise of many outliers.",
)
@opt.sure("--holdout", type=float, default=0.2, help="Share of the rows, the last, to judge the equation by.")
@opt.in_terms("--max-terms", type=int, help="Show at most this number of terms: the likeliest equation within it.")
@opt.sure(
    "--tolerance",
    type=float,
    help="What the law may lack beside the terms, as a share of the target's standard deviation (0.01); learned by"
    " default, 0: nothing.",
)
@opt.sure(
    "--coarsen", type=float, default=1.0, help="Power (0 to 1) of the likelihood, for models that are only nearly true."
)
@opt.written(
    "--conditional",
    is_flag=True,
    help="Print the intervals given the terms shown, also where those over all models differ. --json has both.",
)
@opt.json_option(group=opt.WRITTEN)
@opt.file_written("--save", help="Write the equations to a JSON file, for bayeq.load.")
@opt.file_written("--sensitivity", help=f"Write the PIPs under other v_s and p_0{opt.TABLE_OR_FIGURE}")
@opt.file_written("--path", help=f"Write the best equation of each size, with evidence and errors{opt.TABLE_OR_FIGURE}")
@opt.file_written(
    "--forecast", help=f"Write the free run over the held-out rows, with its 95 % band{opt.TABLE_OR_FIGURE}"
)
@opt.file_written(
    "--report",
    help="Write a page (.html) that loads nothing and prints well: verdict, equations, pictures, warnings, hashes of"
    " files, this command.",
)
@opt.written(
    "--refine", is_flag=True, help="Coefficients by output error: those whose free run is closest to the record."
)
@opt.written("--physical", is_flag=True, help="Also mass, damping, stiffness ... of a second-order equation.")
@opt.file_written(
    "--checkpoint",
    help="Folder for sums over the rows of long files, kept on the way: a run that is killed goes on where it was. By"
    " default one in the user's cache.",
)
@opt.written(
    "--dask",
    metavar="ADDRESS",
    help="Read the files and sum over their rows on a Dask cluster: the address of its scheduler, tcp://host:8786, or"
    " the file that it wrote. Files are then read some rows at a time.",
)
@opt.sure("--seed", type=int, default=0, help="Seed of methods that draw random numbers (gibbs).")
@opt.written("--explain", is_flag=True, help="Explain below the answer, in plain words, what is printed.")
@opt.option(
    "--verbose",
    is_flag=True,
    help="Print all of the answer: fits, residuals, bounds, runners-up; say on standard error what is being done.",
)
def discover(files: tuple[Path, ...], dask: str | None, **options: Any) -> None:
    """Find the equation of motion of a measured record.

    FILE... are one or several records: text (CSV ...), MATLAB, HDF5, universal files, TDMS, LabVIEW, Excel, WAV,
    Parquet, NumPy; - is standard input. A channel of a file of many arrays is named by its path: --disp th=Y_id[0].0 is
    the first row of the first cell of Y_id, th=Y_id[*].0 one record for each cell.
    """
    outputs = Outputs(**{name: options.pop(name) for name in OUTPUTS})
    reading = Reading.of(options)
    options, paths = opt.named_channels(options)
    outputs.check(plain_files(files), options)
    options = cleaned(options)
    from bayeq.records.io import state_of

    if dask is not None:
        reading = reading.clustered()
        files = tuple(file if file == STANDARD_INPUT else file.absolute() for file in files)
    read = {file: state_of(file) for file in plain_files(files)}
    with opt.cluster_client(dask) as client, Progress(outputs.verbose) as progress:
        records, source = source_of(reading, files, used_channels(options), paths, outputs.refine, progress)
        if not options["chains"] and not options["target"]:  # `discover` reports malformed ones
            for name in used_channels(options):  # refuse an absent channel before the import below
                for record in records:
                    _ = record[name]
        outputs.check_records(records, options["discrete"])
        from bayeq.discovery import discover as run  # once the files are known to be readable

        said: list[warnings.WarningMessage] = []
        try:
            with warnings.catch_warnings(record=True) as said:
                answer = run(source, **options, progress=progress, client=client, stream=reading.stream)
            outputs.write(answer, records, read, options["holdout"], progress)
        finally:  # warnings follow the verdict
            for one in said:
                warnings.showwarning(one.message, one.category, one.filename, one.lineno)


def source_of(
    reading: Reading,
    files: Sequence[Path],
    used: Sequence[str],
    paths: Mapping[str, str],
    refine: bool,
    progress: Callable[[str, int, int], None],
) -> tuple[Sequence[Record], Any]:
    """Records for checks and outputs, and the `records` of `bayeq.discover`: these, or the extents of long files."""
    if not reading.streamed(files):
        records = reading.records(files, used, paths, progress)
        return records, records
    if refine:
        raise InputError("--refine runs over whole records: leave it out, or use some rows (--no-stream --rows A:B)")
    from bayeq.discovery.streaming.work import of_channels, stretches

    extents = of_channels(reading.extents(files, paths), used)
    return stretches(extents), extents


def cleaned(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options as `bayeq.discover` takes them, without those that were not given."""
    out = {name: value for name, value in options.items() if value is not None}
    for name, example in (("conserve", "a sum, 'S + I'"), ("differs", "terms, 'x, v', or all")):
        if not out.get(name, example).strip():
            raise InputError(f"--{name} is empty: write {example}, or leave it out")
    out["inputs"] = list(filter(None, out["inputs"]))
    out["chains"] = list(out["chains"]) or None
    out["target"] = list(out["target"]) or None
    dictionaries = out.pop("dictionaries") or ("oscillator",)
    if len(dictionaries) > 1 and not all(":" in text for text in dictionaries):
        raise InputError(
            "--dictionary is given more than once: join families and terms with +, terms with commas, or write the"
            " target of each equation in front, as in --dictionary 'a1: oscillator'"
        )
    out["dictionary"] = "; ".join(dictionaries)
    for name in ("noise", "gain_sd", "lag_sd"):
        flag = f"--{name.replace('_', '-')}"
        known = opt.by_name(flag, out[name], "write a channel and a value, such as u=0.01", str.rpartition)
        out[name] = {opt.channel_name(channel): value for channel, value in known.items()}
    if "band" in out:
        out["band"] = opt.pair_of_numbers("--band", out["band"])
    return out


def used_channels(options: Mapping[str, Any]) -> list[str]:
    """Channels that the options name."""
    single = (options.get(role, "") for role in opt.ROLES)
    texts = (*(options["chains"] or ()), *single, *options["inputs"], *(options["target"] or ()))
    return [name for text in texts for name in text.split(":") if name and not name.startswith("~")]
