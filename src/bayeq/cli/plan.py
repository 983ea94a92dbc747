"""``bayeq plan``: which excitation of a next measurement would tell the likeliest models apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from bayeq.cli.options import FILE, Command, option, pair_of_numbers
from bayeq.cli.outputs import require_place
from bayeq.cli.progress import COMPILING, Progress
from bayeq.cli.streams import say
from bayeq.errors import InputError
from bayeq.kernels import announce_compiling

__all__ = ["plan"]


@click.command(cls=Command)
@click.argument("file", metavar="EQ.json", type=FILE)
@option(
    "--amplitude",
    "amplitudes",
    multiple=True,
    help="Largest magnitude of the input, 5, or its range, 0:5; of one of several inputs, u=5. By default the range in"
    " the record.",
)
@option("--band", help="Frequencies that may be excited, LO:HI [Hz]; by default where the power of the input was.")
@option(
    "--seconds", type=float, help="Length of the measurement [s]; by default that of the record, up to 4000 samples."
)
@option("--fs", type=float, help="Sampling rate [Hz]; by default that of the record.")
@option("--noise", "noises", multiple=True, help="Noise sd of a target, a=0.1; by default that of the equation.")
@option(
    "--limit", "limits", multiple=True, help="Largest magnitude of a state, x=0.01: amplitudes are lowered to keep it."
)
@option("--odds", type=float, default=100.0, help="Odds at which two models count as told apart.")
@option("--realisations", type=int, default=5, help="Of every excitation.")
@option("--seed", type=int, default=0, help="Seed.")
@option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
@option("--figure", type=FILE, help="Write the comparison as a figure: .png, .svg or .pdf.")
@option("--output", "-o", type=FILE, help="Write the best excitation as CSV: time and the inputs.")
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
    _check_outputs(file, figure, output)
    given = {
        "amplitude": _amplitude(amplitudes),
        "band": None if band is None else pair_of_numbers("--band", band),
        "noise": _by_name("--noise", noises),
        "limits": _by_name("--limit", limits),
    }
    announce_compiling(lambda: say(COMPILING))
    from bayeq.equation.load import load

    equations = load(file)
    progress = Progress()
    try:
        found = equations.plan(**given, **options, progress=progress)
    finally:
        progress.close()
    click.echo(found.to_json() if as_json else found.text)
    if figure is not None:
        from bayeq.figures.style import write_output

        write_output(figure, found.table, found.plot)
    if output is not None:
        found.write(output)


def _check_outputs(file: Path, figure: Path | None, output: Path | None) -> None:
    """Refuse, before the work, what could not be written after it."""
    for path in (figure, output):
        if path is not None:
            require_place(path, [file])
    if figure is not None:
        from bayeq.figures.style import UNSIGNED, require_matplotlib

        if figure.suffix.lower()[1:] not in UNSIGNED:
            raise InputError(
                f"{figure}: is to be written as a figure: end it in {', '.join('.' + s for s in UNSIGNED)}"
            )
        require_matplotlib()
    if output is not None and output.suffix.lower() != ".csv":
        raise InputError(f"{output}: the excitation is written as a table: end it in .csv")


def _number(where: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{where}: {text!r} is no number") from None


def _split(where: str, text: str) -> tuple[str, str]:
    """``name=value``."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise InputError(f"{where} {text!r}: give a name and a value, as in x=0.01")
    return name, value


def _by_name(where: str, texts: Sequence[str]) -> dict[str, float]:
    out: dict[str, float] = {}
    for name, value in (_split(where, text) for text in texts):
        if name in out:
            raise InputError(f"{where}: {name} is given twice")
        out[name] = _number(f"{where} {name}", value)
    return out


def _amplitude(texts: Sequence[str]) -> Any:
    """A number, a range, or a mapping of them by input."""

    def value(text: str) -> float | tuple[float, float]:
        return pair_of_numbers("--amplitude", text) if ":" in text else _number("--amplitude", text)

    if not texts:
        return None
    if len(texts) == 1 and "=" not in texts[0]:
        return value(texts[0])
    return {name: value(text) for name, text in (_split("--amplitude", text) for text in texts)}
