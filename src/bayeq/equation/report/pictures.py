"""Which pictures stand in the report: still ones for print, and live ones with hover values by Bokeh."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bayeq import figures
from bayeq.equation.answer import Answer
from bayeq.equation.report.interactive import as_bokeh
from bayeq.errors import BayeqError
from bayeq.figures.picture import given_as
from bayeq.figures.style import UNSIGNED, style
from bayeq.inference.engines import NOTEWORTHY_PIP
from bayeq.records import Record

__all__ = ["Picture", "pictures"]

# Resolution of still pictures [dots per inch].
DPI = 200

# What matplotlib calls the axes of one.
COLOUR_BAR = "<colorbar>"


class Remembering:
    """An answer that prepares a record once, and runs once over the same rows, however many pictures ask for it."""

    def __init__(self, eq: Any) -> None:
        self._answer = eq
        self.motion = cache(self._answer.motion)
        self.simulate = cache(self._answer.simulate)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._answer, name)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of the report."""

    caption: str
    still: str  # PNG as text (base64)
    live: str  # Bokeh's model as JSON without a "<"; empty where there is none
    narrow: bool  # whether it is of a column's width


def pictures(eq: Answer, record: Record | None) -> tuple[list[Picture], list[str]]:
    """All pictures that the answer and the record allow, and why others could not be drawn."""
    made: list[Picture] = []
    reasons: list[str] = []
    source = Remembering(eq)
    for name, options, caption in _wanted(eq, record):
        try:
            drawn = getattr(figures, name)(source, record, **options)
        except BayeqError as error:
            reasons.append(f"{caption}: {error}")
            continue
        axes = [ax for ax in np.ravel(np.array(drawn, dtype=object))[0].figure.axes if ax.get_label() != COLOUR_BAR]
        made.append(Picture(caption, _still(axes[0].figure), _live(axes, len(made)), len(axes) == 1))
    return made, reasons


def _wanted(eq: Answer, record: Record | None) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Names of pictures, their options and captions."""
    if eq.verdict.kind == "none":
        return
    for one in eq.equations:
        of = f" ({one.target})" if len(eq.equations) > 1 else ""
        which = {"target": one.target}
        if record is not None and one.chain.order == 2:
            x, v = one.chain.names[:2]
            yield "restoring_force_surface", which, f"Restoring force over displacement and velocity{of}"
            source = given_as(eq, one.target)
            yield "restoring_force_curve", which, f"Restoring force over {x}, discovered and {source}{of}"
            yield "restoring_force_curve", which | {"over": v}, f"Damping force over {v}, discovered and {source}{of}"
        pip = one.posterior.pip
        if np.any((pip > NOTEWORTHY_PIP) & (pip < 1.0 - NOTEWORTHY_PIP)):
            yield "pip_bars", which, f"Posterior inclusion probability of each term{of}"
        if one.shown:
            yield "coefficient_forest", which, f"Coefficients and their 95 % intervals, each over its own size{of}"
        if record is not None:
            yield "measured_against_predicted", which, f"{given_as(eq, one.target).capitalize()} against predicted{of}"
            yield "one_step", which, f"One step: {one.target} by the states of the same row, and residual{of}"
            if len(one.terms) > 1:
                yield "candidate_correlation", which, f"Correlation of the likeliest candidate terms{of}"
    if record is None:
        return
    states = [name for one in eq.equations for name in one.chain.states]
    measured = [name for name in states if name in record.channels]
    for name in measured:
        yield "free_run", {"channel": name}, f"Free run of {name}, its band, and residual"
    if len(states) > 1:
        yield "phase_portrait", {}, "Phase portrait: record and free run"
    for name in measured[:1]:
        yield "spectra", {"channel": name}, f"Spectra of {name}: measured, free run and their difference"
        if eq.inputs:
            caption = f"Frequency response of {name} to {eq.inputs[0]}: measured and free run, and coherence"
            yield "frequency_response", {"channel": name}, caption


def _still(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.set_layout_engine("none")  # its panels have been placed
    with style():
        figure.savefig(buffer, format="png", dpi=DPI, metadata=UNSIGNED["png"])
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _live(axes: Sequence[Any], k: int) -> str:
    """The picture in Bokeh's JSON; nothing for one of three dimensions."""
    if any(ax.name == "3d" for ax in axes):
        return ""
    from bokeh.embed import json_item

    # no end of a script can stand in JSON that is in one
    return json.dumps(json_item(as_bokeh(axes), f"live{k}")).replace("<", "\\u003c")
