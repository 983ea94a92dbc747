"""A plan as text: the advice in one sentence, and the designs in a table."""

from __future__ import annotations

import io
import sys

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bayeq.plan.excitations import EXCITATIONS
from bayeq.plan.outcome import Compared, Outcome, Planned

__all__ = ["advice", "duration", "render"]

PLAIN_WIDTH = 130

# Designs that the table lists; `Plan.table` and JSON have all.
LISTED = 12

# Longer than this [s], ten years, no measurement takes.
NEVER = 3e8


def duration(seconds: float) -> str:
    """A time as text.

    Examples
    --------
    >>> [duration(t) for t in (0.0, 0.0312, 12.4, 400.0, 9000.0, 1e30)]
    ['0 s', '0.031 s', '12 s', '6.7 min', '2.5 h', 'never']
    """
    if not seconds < NEVER:
        return "never"
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.2g} {unit}" if seconds < 100.0 * size else f"{seconds / size:.0f} {unit}"
    return f"{seconds:.2g} s" if seconds < 99.5 else f"{seconds:.0f} s"


def advice(plan: Planned) -> str:
    """Which excitation to use and what it is expected to tell, as a sentence."""
    best = plan.best
    low, high = best.design.band
    what = (
        f"excite {', '.join(best.amplitudes)} with {EXCITATIONS[best.design.kind].title}, {amplitudes(plan, best)},"
        f" from {low:.3g} to {high:.3g} Hz"
    )
    length = f"{plan.conditions['seconds']:.3g} s of it"
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
        return f"{what}: {length} separates {_of(plan, rival)} by {nats:.3g} nats; {until}"
    return (
        f"{what}: {length} brings {nats:.3g} nats about the coefficients, whose"
        f" standard deviations are expected to be halved after {duration(best.seconds)}"
    )


def amplitudes(plan: Planned, outcome: Outcome) -> str:
    """The ranges of the inputs: ``+-0.5 N``, or ``2 .. 4 V`` about a middle that is not zero."""
    out = []
    for name, size in outcome.amplitudes.items():
        middle, unit = plan.offsets[name], f" {plan.units[name]}" if name in plan.units else ""
        around = f"+-{size:.3g}" if abs(middle) < 1e-9 * size else f"{middle - size:.3g} .. {middle + size:.3g}"
        out.append(f"{name} {around}{unit}" if len(outcome.amplitudes) > 1 else f"{around}{unit}")
    return ", ".join(out)


def _of(plan: Planned, rival: Compared) -> str:
    """The two models that are compared."""
    where = f"{rival.target}: " if len(plan.leading) > 1 else ""
    leading = next(model for model in plan.leading if model.target == rival.target)
    return f"{where}{leading.name} from the closest rival ({rival.name})"


def render(plan: Planned) -> str:
    """The plan: styled if standard output is a terminal, plain Markdown otherwise."""
    terminal = sys.stdout.isatty()
    buffer = io.StringIO()
    console = Console(
        file=buffer, force_terminal=terminal, no_color=not terminal, width=None if terminal else PLAIN_WIDTH,
        highlight=False, soft_wrap=True,
    )  # fmt: skip
    console.print(f"[bold]{escape(advice(plan))}[/bold]\n")
    for line in _models(plan):
        console.print(escape(line))
    table = Table(box=box.SIMPLE_HEAD if terminal else box.MARKDOWN, pad_edge=True)
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
            f"{low:.3g} .. {high:.3g}",
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
    for line in (*_extrapolation(plan), *_conditions(plan)):
        console.print(escape(line))
    lines = [line.rstrip() for line in buffer.getvalue().rstrip().splitlines()]
    return "\n".join(line for k, line in enumerate(lines) if line or (k and lines[k - 1]))


def _short(plan: Planned, rival: Compared) -> str:
    return f"{rival.target}: {rival.name}" if len(plan.leading) > 1 else rival.name


def _models(plan: Planned) -> list[str]:
    """The models compared."""
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


def _extrapolation(plan: Planned) -> list[str]:
    """How far the motion goes beyond the record."""
    ratios = {
        name: peak / plan.ranges[name] for name, peak in plan.best.peaks.items() if plan.ranges.get(name, 0.0) > 0
    }
    if not ratios:
        return []
    listed = ", ".join(f"{name} {ratio:.2g}" for name, ratio in ratios.items())
    beyond = ": beyond 1 the equation is extrapolated, and a limit keeps it lower" if max(ratios.values()) > 1.0 else ""
    return [f"motion under the best, largest magnitude over that of the record: {listed}{beyond}"]


def _conditions(plan: Planned) -> list[str]:
    c = plan.conditions
    noise = ", ".join(f"{name} {sd:.3g}" for name, sd in c["noise"].items())
    limits = "".join(f", |{name}| at most {limit:g}" for name, limit in c["limits"].items())
    return [
        f"simulated from rest: {c['seconds']:.4g} s at {c['fs']:.4g} Hz, noise sd {noise}{limits};"
        f" {c['realisations']} realisations each"
    ]
