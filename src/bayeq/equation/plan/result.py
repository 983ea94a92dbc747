"""`Plan`: the designs that were compared, the best first, as data, table, figure and text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayeq.arrays import Floats
from bayeq.equation.plan.designs import EXCITATIONS, Design
from bayeq.equation.written import finite
from bayeq.errors import in_digits
from bayeq.figures.style import BLACK, BLUE, FULL_WIDTH, ORANGE, RED, log_ticks, new_figure, picture
from bayeq.markup import printed, text_console
from bayeq.records.io import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PLAIN_WIDTH = 130

# Designs that the table lists; `Plan.table` and JSON have all.
LISTED = 12

# Designs that are drawn, the best from the top.
DRAWN = 16

# Figure: height of a design's row [mm], least number of rows, margins around them [mm].
ROW, LEAST_ROWS, AROUND = 4.4, 12, 18.0

# Colour and marker of each kind of excitation, repeated if there are more kinds.
LOOKS = ((BLUE, "o"), (ORANGE, "s"), (RED, "^"), (BLACK, "D"))

# The best excitation is drawn over this many periods of the middle of its band.
PERIODS = 20

# The axis of information rates begins no lower than this share of the best.
LEAST = 1e-4

# Times from this on [s], ten years, are written as never.
NEVER = 3e8


@dataclass(frozen=True, slots=True)
class Compared:
    """A model that a plan compares."""

    target: str  # target of its equation
    name: str  # the terms of a leading model; for a rival, how its terms differ from the leading model's
    # None for a leading model that is not among the likeliest: terms may have been left out within a tolerance
    probability: float | None


@dataclass(frozen=True, slots=True)
class Separation:
    """How well a design distinguishes the leading model from one rival."""

    rival: int  # index into the rivals of the plan
    # information rate: lambda per second, by which the wrong model cannot fit the true one's motion, in the less
    # favourable case; mean and standard deviation over realisations [nats/s]
    rate: float
    sd: float
    # mean rate if the leading model is true, and if the rival is (None if its runs diverge). Of nested models, `rate`
    # counts only the case that the larger is true
    if_leading: float
    if_rival: float | None
    # time [s] until the odds for the true model are expected to reach the odds wanted; the longer of both cases, or of
    # nested models the case that the larger is true
    seconds: float
    # for nested models, the time if the smaller is true: motion cannot show it, only the Occam factor grows; else None
    by_size: float | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """A design and the information that it is expected to give."""

    design: Design
    amplitudes: Mapping[str, float]  # amplitude of each input about its offset
    limited: bool  # whether limits on the motion reduced the amplitude
    # information rate [nats/s], mean and standard deviation over realisations: against the closest rival, or about the
    # coefficients
    rate: float
    sd: float
    # time [s] until all models are expected to be distinguished (of nested ones if the larger is true), or until the
    # standard deviations of the coefficients are halved
    seconds: float
    peaks: Mapping[str, float]  # largest magnitude of every state, averaged over realisations
    separations: tuple[Separation, ...] = ()  # the closest rival first; empty if the plan is for the coefficients


@dataclass(frozen=True, eq=False)
class Plan:
    """Designs compared by simulation, the one with the highest information rate first.

    Attributes
    ----------
    purpose : "models" or "coefficients"
        Whether the next measurement is to distinguish models or to learn coefficients.
    leading : tuple of Compared
        The likeliest model of each equation.
    rivals : tuple of Compared
        The models that the measurement is to distinguish from the leading ones.
    decided : Compared or None
        The likeliest other model, if none is within the odds wanted; the plan is then for the coefficients.
    outcomes : tuple of Outcome
        The designs, the best first.
    time : (n,) array
        Times of the best excitation [s].
    inputs : mapping of str to (n,) array
        First realisation of the best excitation.
    offsets : mapping of str to float
        Middle of each input.
    odds : float
        Odds at which two models count as distinguished.
    conditions : mapping
        Band, seconds, fs, noise, limits, realisations, seed.
    units : mapping of str to str
        Units of channels, as far as they are known.
    ranges : mapping of str to float
        Largest magnitude of the channels of the record.
    """

    purpose: Literal["models", "coefficients"]
    leading: tuple[Compared, ...]
    rivals: tuple[Compared, ...]
    decided: Compared | None
    outcomes: tuple[Outcome, ...]
    time: Floats = field(repr=False)
    inputs: Mapping[str, Floats] = field(repr=False)
    offsets: Mapping[str, float]
    odds: float
    conditions: Mapping[str, Any]
    units: Mapping[str, str]
    ranges: Mapping[str, float]

    @property
    def best(self) -> Outcome:
        """The design with the highest information rate."""
        return self.outcomes[0]

    def closest(self, outcome: Outcome) -> Compared | None:
        """The rival that a design distinguishes least; None if the plan is for the coefficients.

        Parameters
        ----------
        outcome : Outcome
            One of `outcomes`.

        Returns
        -------
        Compared or None
            The closest rival.
        """
        return self.rivals[outcome.separations[0].rival] if outcome.separations else None

    def __str__(self) -> str:
        """The advice, and a table of the designs: styled if standard output is a terminal, plain Markdown otherwise."""
        return render(self)

    def table(self) -> pd.DataFrame:
        """All designs, the best first: ``kind``, ``low`` and ``high`` of the band [Hz], ``amplitude`` (a column per
        input where there are several), ``rate`` and ``sd`` [nats/s], ``seconds``, ``closest`` rival, ``limited``."""
        import pandas as pd

        rows = []
        for one in self.outcomes:
            closest = self.closest(one)
            alone = len(one.amplitudes) == 1
            rows.append(
                {
                    "kind": one.design.kind,
                    "low": one.design.band[0],
                    "high": one.design.band[1],
                    **{"amplitude" if alone else f"amplitude_{name}": size for name, size in one.amplitudes.items()},
                    "rate": one.rate,
                    "sd": one.sd,
                    "seconds": one.seconds,
                    "closest": "" if closest is None else closest.name,
                    "limited": one.limited,
                }
            )
        return pd.DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """The plan as plain data; an infinite time is null."""
        names = [{"target": rival.target, "rival": rival.name} for rival in self.rivals]
        return {
            "advice": advice(self),
            "purpose": self.purpose,
            "odds": self.odds,
            "conditions": dict(self.conditions),
            "leading": [asdict(model) for model in self.leading],
            "rivals": [asdict(model) for model in self.rivals],
            "designs": [
                {
                    "kind": one.design.kind,
                    "band": list(one.design.band),
                    "amplitude": dict(one.amplitudes),
                    "offset": dict(self.offsets),
                    "limited": one.limited,
                    "rate": one.rate,
                    "sd": one.sd,
                    "seconds": finite(one.seconds),
                    "peaks": dict(one.peaks),
                    "rivals": [finite({**asdict(pair), **names[pair.rival]}) for pair in one.separations],
                }
                for one in self.outcomes
            ],
        }

    def plot(self) -> Figure:
        """Information rates of the designs; the spectrum and the beginning of the best excitation."""
        return _drawn(self)

    def write(self, file: str | Path) -> None:
        """Write the best excitation as CSV: ``time`` [s] and the inputs.

        Parameters
        ----------
        file : str or Path
            The file; it is replaced if it exists.
        """
        import pandas as pd

        with replacing(Path(file)) as part:
            pd.DataFrame({"time": self.time, **self.inputs}).to_csv(part, index=False)


def duration(seconds: float) -> str:
    """A time as text.

    >>> [duration(t) for t in (0.0, 0.0312, 12.4, 400.0, 9000.0, 1e30)]
    ['0 s', '0.031 s', '12 s', '6.7 min', '2.5 h', 'never']
    """
    if not seconds < NEVER:
        return "never"
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{in_digits(seconds / size)} {unit}"
    return f"{in_digits(seconds)} s"


def advice(plan: Plan) -> str:
    """The best excitation and the information expected from it, as a sentence."""
    best = plan.best
    low, high = best.design.band
    what = (
        f"excite {', '.join(best.amplitudes)} with {EXCITATIONS[best.design.kind].title}, {amplitudes(plan, best)},"
        f" from {in_digits(low, 3)} to {in_digits(high, 3)} Hz"
    )
    length = f"{in_digits(plan.conditions['seconds'], 3)} s of it"
    nats = best.rate * plan.conditions["seconds"]
    if plan.purpose == "models":
        rival = plan.closest(best)
        assert rival is not None
        until = (
            f"odds of {plan.odds:g}:1 for the true one, against every rival listed, are expected after"
            f" {duration(best.seconds)}"
            if best.seconds < NEVER
            else f"odds of {plan.odds:g}:1 are not to be expected"
        )
        by_size = [one.by_size for one in best.separations if one.by_size is not None]
        if by_size:
            until += f" (if the smaller of nested models is, after {duration(max(by_size))}, whatever the excitation)"
        where = f"{rival.target}: " if len(plan.leading) > 1 else ""
        leading = next(model for model in plan.leading if model.target == rival.target)
        told = f"{where}{leading.name} from the closest rival ({rival.name})"
        return f"{what}: {length} separates {told} by {in_digits(nats, 3)} nats; {until}"
    return (
        f"{what}: {length} brings {in_digits(nats, 3)} nats about the coefficients, whose"
        f" standard deviations are expected to be halved after {duration(best.seconds)}"
    )


def amplitudes(plan: Plan, outcome: Outcome) -> str:
    """The ranges of the inputs: ``+-0.5 N``, or ``2 .. 4 V`` about a middle that is not zero."""
    out = []
    for name, size in outcome.amplitudes.items():
        middle, unit = plan.offsets[name], f" {plan.units[name]}" if name in plan.units else ""
        around = f"+-{size:.3g}" if abs(middle) < 1e-9 * size else f"{middle - size:.3g} .. {middle + size:.3g}"
        out.append(f"{name} {around}{unit}" if len(outcome.amplitudes) > 1 else f"{around}{unit}")
    return ", ".join(out)


def render(plan: Plan) -> str:
    """See `Plan.__str__`."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    console = text_console(PLAIN_WIDTH)
    console.print(f"[bold]{escape(advice(plan))}[/bold]\n")
    for line in _models(plan):
        console.print(escape(line))
    table = Table(box=box.SIMPLE_HEAD if console.is_terminal else box.MARKDOWN, pad_edge=True)
    models = plan.purpose == "models"
    table.add_column("excitation")
    for name in ("band [Hz]", "amplitude", "nats/s", "sd", f"until {plan.odds:g}:1" if models else "until sd halved"):
        table.add_column(name, justify="right")
    if models:
        table.add_column("closest rival")
    for one in plan.outcomes[:LISTED]:
        low, high = one.design.band
        row = [
            one.design.kind,
            f"{in_digits(low, 3)} .. {in_digits(high, 3)}",
            amplitudes(plan, one) + (" (limit)" if one.limited else ""),
            f"{one.rate:.3g}",
            f"{one.sd:.2g}",
            duration(one.seconds),
        ]
        closest = plan.closest(one)
        table.add_row(*map(escape, row if closest is None else [*row, _short(plan, closest)]))
    console.print(table)
    console.print("")
    rest = len(plan.outcomes) - LISTED
    if rest > 0:
        console.print(f"{rest} more designs tell less")
    for line in _notes(plan):
        console.print(escape(line))
    return printed(console)


def _short(plan: Plan, rival: Compared) -> str:
    return f"{rival.target}: {rival.name}" if len(plan.leading) > 1 else rival.name


def _models(plan: Plan) -> list[str]:
    out = []
    for model in plan.leading:
        chance = "" if model.probability is None else f", probability {model.probability:.2g}"
        out.append(f"{model.target}: {model.name}{chance}")
        out += [
            f"    rival: {rival.name}, probability {rival.probability:.2g}"
            for rival in plan.rivals
            if rival.target == model.target
        ]
    if plan.decided is not None:
        out.append(
            f"no rival is within odds of {plan.odds:g}:1 (the likeliest: {_short(plan, plan.decided)}, probability"
            f" {plan.decided.probability:.2g}): the plan is for the coefficients"
        )
    elif not plan.rivals:
        out.append("no other model is known: the plan is for the coefficients")
    return [*out, ""]


def _notes(plan: Plan) -> Iterator[str]:
    """Notes on how far the motion exceeds that of the record, and on the conditions of the simulation."""
    peaks, c = plan.best.peaks, plan.conditions
    ratios = {name: peak / plan.ranges[name] for name, peak in peaks.items() if plan.ranges.get(name, 0.0) > 0}
    if ratios:
        listed = ", ".join(f"{name} {ratio:.2g}" for name, ratio in ratios.items())
        beyond = (
            ": beyond 1 the equation is extrapolated, and a limit keeps it lower" if max(ratios.values()) > 1 else ""
        )
        yield f"motion under the best, largest magnitude over that of the record: {listed}{beyond}"
    noise = ", ".join(f"{name} {sd:.3g}" for name, sd in c["noise"].items())
    limits = "".join(f", |{name}| at most {limit:g}" for name, limit in c["limits"].items())
    yield (
        f"simulated from rest: {c['seconds']:.4g} s at {c['fs']:.4g} Hz, noise sd {noise}{limits};"
        f" {c['realisations']} realisations each"
    )


@picture
def _drawn(plan: Plan) -> Figure:
    """Information rate of each design (left), spectrum and beginning of the best excitation (right)."""
    shown = plan.outcomes[:DRAWN]
    figure = new_figure(FULL_WIDTH, AROUND + ROW * max(len(shown), LEAST_ROWS), layout="constrained")
    axes = figure.subplot_mosaic([["rates", "spectrum"], ["rates", "start"]])
    _rates(axes["rates"], shown, plan.units, plan.purpose)
    spectrum, start = axes["spectrum"], axes["start"]
    n, dt, (low, high) = len(plan.time), float(plan.time[1] - plan.time[0]), plan.best.design.band
    frequency, first = np.fft.rfftfreq(n, dt), plan.time <= PERIODS * 2.0 / (low + high)
    # lines beyond the band hold only rounding errors and the skirts of a sweep
    near = (frequency >= low - 0.25 * (high - low)) & (frequency <= high + 0.25 * (high - low))
    for k, (name, samples) in enumerate(plan.inputs.items()):
        look: dict[str, Any] = {"color": LOOKS[k % len(LOOKS)][0], "linewidth": 0.8}
        size = 2.0 / n * np.abs(np.fft.rfft(samples - plan.offsets[name]))
        spectrum.vlines(frequency[near], 0.0, size[near], **look)
        start.plot(plan.time[first], samples[first], label=name, **look)
    units = {plan.units.get(name, "") for name in plan.inputs}
    unit = units.pop() if len(units) == 1 else ""
    for ax, along, up in (
        (spectrum, "frequency [Hz]", "amplitude of a line"),
        (start, "time [s]", ", ".join(plan.inputs)),
    ):
        ax.set(xlabel=along, ylabel=f"{up} [{unit}]" if unit else up)
    spectrum.set(ylim=(0.0, None), title="the best: spectrum")
    start.set_title(f"the best: {'all of it' if first.all() else 'its beginning'}")
    if len(plan.inputs) > 1:
        start.legend(loc="upper right", ncols=2, fontsize=7)
    return figure


def _rates(ax: Axes, shown: Sequence[Outcome], units: Mapping[str, str], purpose: str) -> None:
    """Draw a row per design: the mean rate and one standard deviation to either side."""
    kinds = sorted({one.design.kind for one in shown})
    best = max(shown[0].rate, np.finfo(float).tiny)
    # a spread that reaches zero ends at the left edge
    least = max(0.5 * min(one.rate for one in shown), LEAST * best)
    labels = []
    for row, one in enumerate(shown):
        pairs, (low, high) = one.amplitudes.items(), one.design.band
        sizes = ", ".join(f"\N{PLUS-MINUS SIGN}{value:.3g} {units.get(name, '')}".rstrip() for name, value in pairs)
        labels.append(f"{one.design.kind}, {in_digits(low, 3)} to {in_digits(high, 3)} Hz, {sizes}")
        colour, marker = LOOKS[kinds.index(one.design.kind) % len(LOOKS)]
        ax.plot([max(one.rate - one.sd, least), one.rate + one.sd], [row, row], color=colour, linewidth=1.0)
        ax.plot([max(one.rate, least)], [row], color=colour, marker=marker, markersize=3.6)
    ax.set(xscale="log", xlim=(least, 1.5 * max(one.rate + one.sd for one in shown)), ylim=(len(shown) - 0.4, -0.6))
    log_ticks(ax.xaxis)
    ax.set_yticks(range(len(shown)), labels)
    ax.grid(axis="y", linewidth=0.3, alpha=0.4)
    told = "against the closest rival" if purpose == "models" else "about the coefficients"
    ax.set_xlabel(f"information {told} [nats/s]")
    ax.set_title("designs, mean \N{PLUS-MINUS SIGN} sd over realisations")
