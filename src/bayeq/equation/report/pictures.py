"""Pictures of the report: which ones, still ones for print, and live ones with hover values by Bokeh."""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bayeq import figures
from bayeq.equation.answer import Answer
from bayeq.errors import BayeqError, needing
from bayeq.figures.picture import given_as, unit_text
from bayeq.figures.style import UNSIGNED, style
from bayeq.inference.engines import NOTEWORTHY_PIP
from bayeq.records import Record

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
        if record is not None and one.chain.order == 2 and not one.chain.discrete:
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


DASHES = {"-": "solid", "--": "dashed", "-.": "dashdot", ":": "dotted"}
MARKERS = {"o": "circle", ".": "circle", "s": "square", "D": "diamond", "+": "cross", "^": "triangle"}

# Pixels of a millimetre of a figure, and what the axes' labels and the legend take [pixels].
SCALE, AROUND = 4.0, 80
POINT = 96.0 / 72.0


def require_bokeh() -> None:
    """Check that live pictures can be made; MissingExtraError without Bokeh."""
    with needing("bokeh", "report", "a report with live pictures"):
        import bokeh.plotting  # noqa: F401


def without_maths(label: str) -> str:
    r"""A label as plain text.

    >>> without_maths(r"$x^{2} v\\,|x|$"), without_maths(r"$\\mathrm{sgn}(v)$ [m/s]")
    ('x² v |x|', 'sgn(v) [m/s]')
    """
    text = re.sub(r"_\{(\d+)\}", r"\1", label.replace(r"\$", "\0").replace(r"\,", " "))
    text = re.sub(r"\\(?:mathrm|operatorname|mathit|left|right)(?![a-z])|[${}\\]", "", text)
    return unit_text(text).replace("\0", "$")


def as_bokeh(axes: Sequence[Any]) -> Any:
    """A Bokeh model of axes of one matplotlib figure, one below the other, with the horizontal axis in common.

    Lines, filled bands, bars, images and texts at data are taken over; marks that have no label are drawn without hover
    values.
    """
    from bokeh.layouts import column

    plots: list[Any] = []
    for ax in axes:
        plots.append(_plot(ax, plots[0].x_range if plots else None))
    return column(plots, sizing_mode="stretch_width") if len(plots) > 1 else plots[0]


def _plot(ax: Any, x_range: Any) -> Any:
    from bokeh.models import BasicTickFormatter, Legend, Range1d
    from bokeh.plotting import figure

    inches = ax.figure.get_size_inches()[1] * ax.get_position().height
    plot = figure(
        height=int(inches * 25.4 * SCALE) + AROUND,
        sizing_mode="stretch_width",
        x_axis_type=ax.get_xscale() if ax.get_xscale() == "log" else "linear",
        y_axis_type=ax.get_yscale() if ax.get_yscale() == "log" else "linear",
        x_range=x_range or Range1d(*map(float, ax.get_xlim())),
        y_range=Range1d(*map(float, ax.get_ylim())),
        x_axis_label=without_maths(ax.get_xlabel()),
        y_axis_label=without_maths(ax.get_ylabel()),
        title=without_maths(ax.get_title(loc="left") or ax.get_title()),
        tools="pan,box_zoom,wheel_zoom,reset,save",
        active_scroll=None,
    )
    plot.toolbar.logo = None
    for axis, model in ((ax.xaxis, plot.xaxis[0]), (ax.yaxis, plot.yaxis[0])):
        _ticks(axis, model)
        model.axis_label_text_font_style, model.axis_label_standoff = "normal", 4
        if isinstance(model.formatter, BasicTickFormatter):
            model.formatter.power_limit_low = -5  # 0.0004, not 4.000e-4
    shown = [*_images(plot, ax), *_bands(plot, ax), *_bars(plot, ax), *_lines(plot, ax)]
    labels = [(without_maths(label), [glyph]) for label, glyph in shown if label and not label.startswith("_")]
    if labels and ax.get_legend() is not None:
        legend = Legend(items=labels, orientation="horizontal", border_line_color=None, padding=2, margin=0, spacing=8)
        legend.label_text_font_size, legend.glyph_width, legend.ncols = "12px", 18, "auto"
        legend.click_policy = "hide"
        plot.add_layout(legend, "above")
    return plot


def _ticks(axis: Any, model: Any) -> None:
    """Names at their places, where the axis has such."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    if not isinstance(axis.get_major_locator(), FixedLocator):
        return
    places = [float(place) for place in axis.get_majorticklocs()]
    model.ticker = places
    if isinstance(axis.get_major_formatter(), FuncFormatter):  # which set_ticks makes of names
        labels = [without_maths(label.get_text()) for label in axis.get_ticklabels()]
        # keys without a point, as numbers are written in the browser
        keys = [int(at) if at == int(at) else at for at in places]
        model.major_label_overrides = dict(zip(keys, labels, strict=True))
        if axis.axis_name == "x":
            model.major_label_orientation = "vertical"


def _hex(colour: Any) -> str:
    from matplotlib.colors import to_hex

    return to_hex(colour)


def _hover(plot: Any, renderer: Any, tooltips: list[tuple[str, str]]) -> None:
    from bokeh.models import HoverTool

    plot.add_tools(HoverTool(renderers=[renderer], tooltips=tooltips, visible=False))


def _lines(plot: Any, ax: Any) -> Iterator[tuple[str, Any]]:
    from bokeh.models import Span

    names = [(plot.xaxis[0].axis_label or "x", "x"), (plot.yaxis[0].axis_label or "y", "y")]
    for line in ax.lines:
        x, y = (np.asarray(values, dtype=np.float32) for values in (line.get_xdata(), line.get_ydata()))
        dashes, width = DASHES.get(str(line.get_linestyle()), "solid"), line.get_linewidth()
        look: dict[str, Any] = {"color": _hex(line.get_color()), "alpha": line.get_alpha() or 1.0}
        if line.get_transform() != ax.transData:  # a line across the axes
            at, dimension = (x, "height") if x[0] == x[-1] else (y, "width")
            stroke = {"line_color": look["color"], "line_width": max(width, 1.0), "line_dash": dashes}
            plot.add_layout(Span(location=float(at[0]), dimension=dimension, **stroke))
            continue
        if not len(x):
            continue
        marker, source = str(line.get_marker()), {"x": x, "y": y}
        if marker in MARKERS:
            size = max(line.get_markersize() * POINT * (0.55 if marker == "." else 1.0), 2.5)
            look["fill_alpha"] = 0.0 if str(line.get_markerfacecolor()) == "none" else look["alpha"]
            glyph = plot.scatter("x", "y", source=source, marker=MARKERS[marker], size=size, **look)
        else:
            glyph = plot.line("x", "y", source=source, line_width=max(width * POINT, 1.0), line_dash=dashes, **look)
        _hover(plot, glyph, [(name, f"@{axis}{{0,0.[00000]}}") for name, axis in names])
        yield line.get_label(), glyph


def _bands(plot: Any, ax: Any) -> Iterator[tuple[str, Any]]:
    """Filled bands, and the bars of intervals."""
    from matplotlib.collections import LineCollection, PolyCollection

    for made in ax.collections:
        segments, outlined = isinstance(made, LineCollection), isinstance(made, PolyCollection)
        if segments:
            ends = np.array([segment for segment in made.get_segments() if len(segment) == 2])
            if not len(ends):
                continue
            source = {"x0": ends[:, 0, 0], "y0": ends[:, 0, 1], "x1": ends[:, 1, 0], "y1": ends[:, 1, 1]}
            look = {"color": _hex(made.get_colors()[0]), "line_width": float(made.get_linewidths()[0]) * POINT}
            glyph = plot.segment("x0", "y0", "x1", "y1", source=source, **look)
            _hover(plot, glyph, [("from", "@x0{0,0.[000]}"), ("to", "@x1{0,0.[000]}")])
            yield made.get_label(), glyph
        elif outlined:
            colour = made.get_facecolor()[0]
            xs, ys = ([path.vertices[:, k].astype(np.float32) for path in made.get_paths()] for k in (0, 1))
            yield made.get_label(), plot.patches(xs, ys, color=_hex(colour), alpha=float(colour[3]), line_width=0)


def _bars(plot: Any, ax: Any) -> Iterator[tuple[str, Any]]:
    names = plot.yaxis[0].major_label_overrides
    for container in ax.containers:
        left, bottom, right, top = np.array([patch.get_bbox().extents for patch in container.patches]).T
        source = {"left": left, "right": right, "bottom": bottom, "top": top}
        source["name"] = [names.get(round(place), "") for place in 0.5 * (bottom + top)]
        colour = _hex(container.patches[0].get_facecolor())
        glyph = plot.quad(source=source, fill_color=colour, line_color="black")
        _hover(plot, glyph, [("term", "@name"), ("PIP", "@right{0.00000}")])
        yield container.get_label(), glyph


def _images(plot: Any, ax: Any) -> Iterator[tuple[str, Any]]:
    """Squares of a matrix, with the numbers that are written on them."""
    names = plot.yaxis[0].major_label_overrides
    for image in ax.images:
        values = np.asarray(image.get_array())
        row, col = (one.ravel() for one in np.indices(values.shape))
        source = {
            "x": col,
            "y": row,
            "value": values.ravel(),
            "colour": [_hex(image.cmap(image.norm(value))) for value in values.ravel()],
            "one": [names.get(int(k), "") for k in row],
            "other": [names.get(int(k), "") for k in col],
        }
        glyph = plot.rect("x", "y", 1, 1, source=source, fill_color="colour", line_color="white", line_width=0.5)
        _hover(plot, glyph, [("terms", "@one, @other"), ("correlation", "@value{0.000}")])
        yield "", glyph
        written = [(*text.get_position(), text.get_text(), _hex(text.get_color())) for text in ax.texts]
        look: dict[str, Any] = {"text_align": "center", "text_baseline": "middle", "text_font_size": "11px"}
        numbers = dict(zip(("x", "y", "text", "colour"), map(list, zip(*written, strict=True)), strict=True))
        plot.text("x", "y", "text", source=numbers, text_color="colour", **look)
