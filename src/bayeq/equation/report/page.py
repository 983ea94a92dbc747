"""The report as one HTML page: the values for the template `page.html`, which escapes every text except maths."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import shlex
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bayeq import figures
from bayeq.dictionary import FAMILIES
from bayeq.dictionary.specification import without_names
from bayeq.equation.answer import Answer
from bayeq.equation.brief import checks, failed, law_in_symbols, sentence, tabled_parameters, what_to_try
from bayeq.equation.equation import Equation
from bayeq.equation.explain import explanation
from bayeq.equation.physical import own_parameters
from bayeq.equation.text import MARK, hidden_of, learned_of, rows_of, unseen
from bayeq.equation.written import round_to
from bayeq.errors import BayeqError, BayeqWarning, InputError, needing
from bayeq.expressions.parse import EARLIER
from bayeq.expressions.symbolic import mathml, number_mathml, step_mathml, symbol_mathml
from bayeq.figures.style import UNSIGNED, given_as, log_ticks, require_matplotlib, style, unit_text
from bayeq.inference.engines import ENGINES, NOTEWORTHY_PIP
from bayeq.records import Record
from bayeq.records.io import replacing
from bayeq.regression.constraints import CONSERVED

# Resolution of still pictures [dots per inch].
DPI = 200

# Label that matplotlib gives the axes of a colour bar.
COLOUR_BAR = "<colorbar>"


class Remembering:
    """An answer with cached `motion` and `simulate`: pictures of the same record share them."""

    def __init__(self, eq: Any) -> None:
        self._answer = eq
        self.motion = cache(self._answer.motion)
        self.simulate = cache(self._answer.simulate)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._answer, name)


def pictures(eq: Answer, record: Record | None) -> tuple[list[dict[str, Any]], list[str]]:
    """All pictures that the answer and the record allow, as data for the page, and why others could not be drawn."""
    made: list[dict[str, Any]] = []
    reasons: list[str] = []
    source = Remembering(eq)
    for name, options, caption in _wanted(eq, record):
        try:
            drawn = getattr(figures, name)(source, record, **options)
        except BayeqError as error:
            reasons.append(f"{caption}: {error}")
            continue
        axes = [ax for ax in np.ravel(np.array(drawn, dtype=object))[0].figure.axes if ax.get_label() != COLOUR_BAR]
        still, live = _still(axes[0].figure), _live(axes, len(made))
        made.append({"caption": caption, "still": still, "live": live, "narrow": len(axes) == 1})
    return made, reasons


def _wanted(eq: Answer, record: Record | None) -> Iterator[tuple[str, dict[str, Any], str]]:
    """The functions of `bayeq.figures` to call, by name, with their options and captions."""
    if eq.verdict.kind == "none":
        return
    for one in (one for one in eq.equations if not one.chain.stated):
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
            by = "inputs" if one.chain.static else "states"
            yield "one_step", which, f"One step: {one.target} by the {by} of the same row, and residual{of}"
            if len(one.terms) > 1:
                yield "candidate_correlation", which, f"Correlation of the likeliest candidate terms{of}"
    if record is None:
        return
    measured = [name for name in eq.states if name in record.channels]
    for name in measured:
        yield "free_run", {"channel": name}, f"Free run of {name}, its band, and residual"
    if len(eq.states) > 1:
        yield "phase_portrait", {}, "Phase portrait: record and free run"
    for name in measured[:1]:
        yield "spectra", {"channel": name}, f"Spectra of {name}: measured, free run and their difference"
        if eq.inputs:
            caption = f"Frequency response of {name} to {eq.inputs[0]}: measured and free run, and coherence"
            yield "frequency_response", {"channel": name}, caption


def _still(figure: Any) -> str:
    """The figure as a PNG in base64."""
    buffer = io.BytesIO()
    figure.set_layout_engine("none")  # its panels have been placed
    with style():
        figure.savefig(buffer, format="png", dpi=DPI, metadata=UNSIGNED["png"])
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _live(axes: Sequence[Any], k: int) -> str:
    """The picture in Bokeh's JSON with every "<" escaped; empty for a picture in three dimensions."""
    if any(ax.name == "3d" for ax in axes):
        return ""
    from bokeh.embed import json_item

    # the JSON is inside a script element, which "</script" would end
    return json.dumps(json_item(as_bokeh(axes), f"live{k}")).replace("<", "\\u003c")


DASHES = {"-": "solid", "--": "dashed", "-.": "dashdot", ":": "dotted"}
MARKERS = {"o": "circle", ".": "circle", "s": "square", "D": "diamond", "+": "cross", "^": "triangle"}

# Pixels per millimetre of a figure; pixels for the labels of the axes and the legend.
SCALE, AROUND = 4.0, 80
# Characters of a legend that fit a row on a phone; pixels per cell of a matrix.
LEGEND, SQUARE = 38, 30
# Approximate number of ticks per axis: horizontal labels such as -1.500e+6 then fit on a phone.
TICKS = {"x": 4, "y": 6}
POINT = 96.0 / 72.0


def without_maths(label: str) -> str:
    r"""A label as plain text.

    >>> without_maths(r"$x^{2} v\\,|x|$"), without_maths(r"$\\mathrm{sgn}(v)$ [m/s]")
    ('x² v |x|', 'sgn(v) [m/s]')
    """
    text = re.sub(r"_\{(\w+)\}", r"\1", label.replace(r"\$", "\0").replace(r"\,", " "))
    text = re.sub(r"\\(?:mathrm|operatorname|mathit|left|right)(?![a-z])|[${}\\]", "", text)
    return unit_text(text).replace("\0", "$")


def as_bokeh(axes: Sequence[Any]) -> Any:
    """A Bokeh model of the axes of a matplotlib figure, one below the other, with a common horizontal axis."""
    from bokeh.layouts import column

    plots: list[Any] = []
    for ax in axes:
        plots.append(_plot(ax, plots[0].x_range if plots else None))
    return column(plots, sizing_mode="stretch_width") if len(plots) > 1 else plots[0]


def _plot(ax: Any, x_range: Any) -> Any:
    from bokeh.models import BasicTickFormatter, HoverTool, Legend, Range1d
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
            model.formatter.power_limit_low, model.formatter.power_limit_high = -5, 6  # 0.0004, not 4.000e-4
    shown = [*_images(plot, ax), *_bands(plot, ax), *_bars(plot, ax), *_lines(plot, ax)]
    for _, glyph, values in shown:
        if values:
            plot.add_tools(HoverTool(renderers=[glyph], tooltips=values, visible=False))
    labels = [(without_maths(label), [glyph]) for label, glyph, _ in shown if label and not label.startswith("_")]
    if labels and ax.get_legend() is not None:
        legend = Legend(items=labels, orientation="horizontal", border_line_color=None, padding=2, margin=0, spacing=8)
        legend.label_text_font_size, legend.glyph_width = "12px", 18
        legend.ncols = len(labels) if sum(len(label) for label, _ in labels) <= LEGEND else 2
        legend.click_policy = "hide"
        plot.add_layout(legend, "above")
    return plot


def _ticks(axis: Any, model: Any) -> None:
    """Copy fixed ticks and their names, and those of few decades, from a matplotlib axis to the Bokeh axis `model`."""
    from bokeh.models import BasicTickFormatter
    from matplotlib.ticker import FixedLocator, FuncFormatter

    low, high = axis.get_view_interval()
    if axis.get_scale() == "log":
        if high < 100.0 * low:  # Bokeh's ticks in less than two decades are even, and overlap
            log_ticks(axis)
            model.ticker, model.formatter = axis.get_majorticklocs().tolist(), BasicTickFormatter()
        return
    if not isinstance(axis.get_major_locator(), FixedLocator):
        model.ticker.desired_num_ticks = TICKS[axis.axis_name]
        return
    places = [float(place) for place in axis.get_majorticklocs()]
    model.ticker = places
    if isinstance(axis.get_major_formatter(), FuncFormatter):  # set_ticks makes one from names
        labels = [without_maths(label.get_text()) for label in axis.get_ticklabels()]
        # whole numbers as int: the browser looks up 3, not 3.0
        keys = [int(at) if at == int(at) else at for at in places]
        model.major_label_overrides = dict(zip(keys, labels, strict=True))
        if axis.axis_name == "x":
            model.major_label_orientation = "vertical"


def _hex(colour: Any) -> str:
    from matplotlib.colors import to_hex

    return to_hex(colour)


# For each element its legend label, Bokeh glyph, and the names and formats of the values in its hover box.
Shown = Iterator[tuple[str, Any, list[tuple[str, str]]]]


def _lines(plot: Any, ax: Any) -> Shown:
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
        yield line.get_label(), glyph, [(name, f"@{axis}{{0,0.[00000]}}") for name, axis in names]


def _bands(plot: Any, ax: Any) -> Shown:
    """Draw filled bands, and the bars of intervals."""
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
            yield made.get_label(), glyph, [("from", "@x0{0,0.[000]}"), ("to", "@x1{0,0.[000]}")]
        elif outlined:
            colour = made.get_facecolor()[0]
            xs, ys = ([path.vertices[:, k].astype(np.float32) for path in made.get_paths()] for k in (0, 1))
            yield made.get_label(), plot.patches(xs, ys, color=_hex(colour), alpha=float(colour[3]), line_width=0), []


def _bars(plot: Any, ax: Any) -> Shown:
    names = plot.yaxis[0].major_label_overrides
    for container in ax.containers:
        left, bottom, right, top = np.array([patch.get_bbox().extents for patch in container.patches]).T
        source = {"left": left, "right": right, "bottom": bottom, "top": top}
        source["name"] = [names.get(round(place), "") for place in 0.5 * (bottom + top)]
        colour = _hex(container.patches[0].get_facecolor())
        glyph = plot.quad(source=source, fill_color=colour, line_color="black")
        yield container.get_label(), glyph, [("term", "@name"), ("PIP", "@right{0.00000}")]


def _images(plot: Any, ax: Any) -> Shown:
    """Draw the cells of a matrix with the numbers written on them, and a colour bar."""
    from bokeh.models import ColorBar, LinearColorMapper

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
        yield "", glyph, [("terms", "@one, @other"), ("correlation", "@value{0.000}")]
        written = [(*text.get_position(), text.get_text(), _hex(text.get_color())) for text in ax.texts]
        look: dict[str, Any] = {"text_align": "center", "text_baseline": "middle", "text_font_size": "11px"}
        numbers = dict(zip(("x", "y", "text", "colour"), map(list, zip(*written, strict=True)), strict=True))
        plot.text("x", "y", "text", source=numbers, text_color="colour", **look)
        plot.height, plot.frame_height = None, SQUARE * len(values)  # long names below do not shrink it
        colours = [_hex(image.cmap(level)) for level in range(image.cmap.N)]
        mapper = LinearColorMapper(palette=colours, low=image.norm.vmin, high=image.norm.vmax)
        plot.add_layout(ColorBar(color_mapper=mapper, width=10), "right")


HERE = Path(__file__).parent
STYLE = (HERE / "page.css").read_text(encoding="utf-8")
# Draws the live pictures one after the other, and shows them instead of the still ones once all are there.
START = (HERE / "page.js").read_text(encoding="utf-8")


def require_report() -> None:
    """Check that a report can be made, before anything is computed; MissingExtraError without matplotlib or Bokeh."""
    require_matplotlib()
    with needing("bokeh", "report", "a report with live pictures"):
        import bokeh.plotting  # noqa: F401


def write_report(
    path: Path, eq: Answer, records: Sequence[Record], files: Sequence[Path], command: str | None = None
) -> None:
    """Write the whole page or nothing, see `bayeq.Equations.report`; without files the samples of records are hashed.

    InputError if a file cannot be read or the page cannot be written; MissingExtraError without matplotlib or Bokeh.
    """
    require_report()
    try:
        digests = {}
        for file in files:
            with file.open("rb") as content:
                digests[file.name] = hashlib.file_digest(content, "sha256").hexdigest()
        digests |= {f"samples of {one.name or 'the record'}": samples_hash(one) for one in records if not files}
        text = _page(eq, records, digests, command)
        with replacing(path) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{error.filename or path}: {error.strerror or error}") from error


def _page(eq: Answer, records: Sequence[Record], digests: Mapping[str, str], command: str | None) -> str:
    """The HTML of the page; its content security policy allows its own scripts, by hash, and loads nothing."""
    from jinja2 import Environment, FileSystemLoader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)  # they are in the page already
        made, reasons = pictures(eq, records[0] if records else None)
    moves = any(one.chain.order == 2 and not one.chain.discrete for one in eq.equations)
    kind = "Equation of motion" if moves else "Governing equation"
    found, physical = own_parameters(eq), None
    if found is not None:
        law, also = law_in_symbols(eq, found), ", ".join(found.unexplained)
        physical = {"law": law, "rows": tabled_parameters(found), "also": also, "note": found.note}
    scripts = [_library(), START] if any(picture["live"] for picture in made) else []
    hashes = (hashlib.sha256(script.encode("utf-8")).digest() for script in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in hashes) or "'none'"
    environment = Environment(loader=FileSystemLoader(HERE), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["typeset"] = lambda number: number.replace(" .. ", " … ").replace("-", "\N{MINUS SIGN}")
    environment.filters["unit"] = unit_text
    return environment.get_template("page.html").render(
        title=f"{kind}: {', '.join(one.target for one in eq.equations)}",
        policy=f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:;"
        " font-src data:; base-uri 'none'; form-action 'none'",
        style=STYLE,
        verdict=eq.verdict,
        reason=sentence(eq) if eq.verdict.kind != "none" else what_to_try(eq),
        several=len(eq.equations) > 1,
        physical=physical,
        equations=[_equation(one, eq) for one in eq.equations],
        header=("term", "coefficient", "sd", "95 % interval", ENGINES[eq.method].score, "share", "unit"),
        noteworthy=f"{ENGINES[eq.method].score} below {NOTEWORTHY_PIP:g}",
        n_train=eq.data.n_train if eq.data.refitted else 0,
        warnings=eq.warnings,
        of=f" of {records[0].name}" if len(records) > 1 and records[0].name else "",
        pictures=made,
        reasons=reasons,
        words=_words(eq) if eq.verdict.kind != "none" else [],
        data=_data(eq),
        digests=digests,
        command=command or repeat_command(eq),
        complete=command is not None,
        version=version("bayeq"),
        scripts=scripts,
    )


def _equation(one: Equation, eq: Answer) -> dict[str, Any]:
    """An equation as maths and text, with its terms and checks."""
    if one.chain.discrete:
        names = {name: step_mathml(name) for name in (*eq.states, *eq.inputs, one.target)}
    else:
        chains = [(other.chain.names, other.in_seconds) for other in eq.equations]
        names = {
            name: symbol_mathml(own[0], dots) if dotted else symbol_mathml(name)
            for own, dotted in chains
            for dots, name in enumerate(own)
        }
    rows, rest = rows_of(one), 0
    if one.chain.stated:
        rows = rows[:-1]
    else:
        rest = len(one.terms) - sum(bool(row.score) for row in rows)
    return {
        "target": one.target,
        "verdict": str(one.verdict) if len({other.verdict.kind for other in eq.equations}) > 1 else "",
        "none": one.verdict.kind == "none",
        "checks": [
            *([checks(eq), *hidden_of(eq), *learned_of(eq)] if one is eq.equations[0] else []),
            *failed(one),
            *unseen(one),
        ],
        "starred": any(row.over_models for row in rows),
        "maths": _maths(one, names),
        "symbols": {
            name: names[name]
            for k, name in enumerate(one.chain.names)
            if k and name != "d" * k + one.chain.names[0] and one.in_seconds and not one.chain.discrete
        },
        "text": one.text,
        "rows": rows,
        "rest": rest,
    }


def _maths(one: Equation, names: Mapping[str, str]) -> str:
    """An equation as MathML, one element for each term, so that lines break between terms."""
    pieces = [f"<mrow>{names[one.target]}<mo>=</mo></mrow>"]
    summands = [] if one.chain.stated else one.summands
    if one.chain.law is not None and one.chain.stated:
        pieces.append(mathml(one.chain.law, names))
    for k, (value, sd, term) in enumerate(summands):
        text = round_to(value, sd)
        sign = "\N{MINUS SIGN}" if text.startswith("-") else "+" if k else ""
        form = 'form="prefix"' if not k else 'form="infix"'
        front = f"<mo {form}>{sign}</mo>" if sign else ""
        factor = "" if term is None else mathml(term, names, factor=True)
        number = number_mathml(text.removeprefix("-")) + "<mspace width='0.17em'></mspace>"
        pieces.append(f"<mrow>{front}{'' if factor and text in ('1', '-1') else number}{factor}</mrow>")
    if len(pieces) == 1:
        pieces.append("<mn>0</mn>")
    return "".join(f"<math>{piece}</math> " for piece in pieces)


def _words(eq: Answer) -> list[str]:
    """Paragraphs of `explanation`, without those on warnings and marks, which the page explains in place."""
    _, _, *paragraphs = explanation(eq).split("\n\n")
    lines = (" ".join(paragraph.split()) for paragraph in paragraphs)
    return [line for line in lines if not line.startswith(("warnings:", f"{MARK}:", "too small to be seen here:"))]


def _data(eq: Answer) -> dict[str, str]:
    """Data and settings as text, by label; the page leaves out empty ones."""
    source, known = eq.data, eq.data.sensors
    # the checks may cover fewer rows than were held out: only rows with all channels, without ends
    counts = {one.held_out.n for one in eq.equations if one.held_out is not None}
    checked = f", checked on {max(counts)} of these" if counts and max(counts) != source.n_held_out else ""
    return {
        "records": ", ".join(name for name in source.files if name) or "not named",
        "rows": f"{source.n}, {source.n_train} used, {source.n_held_out} held out{checked}"
        + (", then all used" if source.refitted else ""),
        "sampling": _sampling(eq),
        "chains": ", ".join(str(chain) for chain in eq.chains),
        "inputs": ", ".join(eq.inputs),
        "dictionary": eq.dictionary,
        "method": f"{eq.method} (bayeq discover -h)",
        "smoothing": eq.smooth,
        "band": "" if source.band is None else f"{source.band[0]:g} to {source.band[1]:g} Hz",
        "estimated": ", ".join(source.estimated),
        "noise given": ", ".join(f"{name} {sd:.3g}" for name, sd in known.noise.items()),
        "calibration": ", ".join(f"{name} {100 * sd:.3g} %" for name, sd in known.gain_sd.items()),
        "factors": ", ".join(f"{name} {gain}" for name, gain in known.gains.items()),
        "lags": ", ".join(f"{name} {lag}" for name, lag in known.lags.items()),
        "tails": "" if known.tails == "gauss" else known.tails,
        "constraints": "; ".join(eq.constraints),
        "refined": "" if eq.refined is None else str(eq.refined),
        "left out": "; ".join(f"{term.name}: {term.reason}" for term in eq.dropped),
    }


def _sampling(eq: Answer) -> str:
    """How the records were sampled, as far as known."""
    if eq.roles.discrete:
        return "counted in samples"
    if eq.data.rows_as_time:
        return "time not known, rows counted"
    if eq.data.sampling is None:
        return "" if eq.data.fs is None else f"{eq.data.fs:.6g} Hz"
    return "{}, {} in all".format(*eq.data.sampling)


def _library() -> str:
    """Bokeh's script with ``</script`` escaped, which would end its element."""
    from bokeh.resources import Resources

    scripts = Resources(mode="inline", components=["bokeh"]).js_raw
    library = [text for text in scripts if not text.startswith("Bokeh.set_log_level")]  # which writes to the console
    return "\n".join(library).replace("</script", "<\\/script")


def samples_hash(record: Record) -> str:
    """SHA-256 of a record, hexadecimal: time, then each channel, its name and its numbers (8 bytes, little-endian)."""
    digest = hashlib.sha256()
    columns = {} if record.time is None else {"t": record.time}
    for name, values in (*columns.items(), *record.channels.items()):
        digest.update(name.encode("utf-8"))
        digest.update(values.astype("<f8").tobytes())
    return digest.hexdigest()


def _with_ranges(law: str, eq: Answer) -> str:
    """A stated law with the ranges in which its constants were sought, unless the dictionary gives them."""
    ranges = {f"{{{one.name}}}": f"{{{one.name}: {one.low:.6g}..{one.high:.6g}}}" for one in eq.constants}
    for name, ranged in ranges.items():
        law = law if name[:-1] in eq.dictionary else law.replace(name, ranged)
    return law


def repeat_command(eq: Answer) -> str:
    """A `bayeq discover` command that finds the equations again, made from their settings."""
    words = ["bayeq", "discover", *(name or "FILE" for name in eq.data.files)]
    for chain in eq.chains:
        text = str(chain.measured[-2]) if chain.discrete else str(chain)
        if chain.stated:
            words += ["--law", f"{chain.target} = {_with_ranges(str(chain.law), eq)}"]
        else:
            words += ["--target", chain.target] if chain.static else ["--chain", text]
    words += ["--discrete"] * eq.roles.discrete
    refused = {one.state for one in eq.hidden} - {*eq.states}
    gone = {"d" * k + state for state in refused for k in range(3)}  # the hidden states and their rates
    sensors = eq.data.sensors
    noise = {name: f"{f'{100 * share:.6g}' if share else ''}% of reading" for name, share in sensors.of_reading.items()}
    asked = [name for name in (*eq.inputs, *sensors.noise) if not EARLIER.fullmatch(name)]  # not earlier samples
    noise |= {name: f"{sd:.6g}" for name, sd in sensors.noise.items() if name in asked and name not in noise}
    options: dict[str, Sequence[str]] = {
        "--input": [name for name in eq.inputs if name in asked and name not in eq.numbers],
        "--dictionary": [without_names(eq.dictionary, gone, FAMILIES.keys())],
        "--method": [eq.method],
        "--smooth": [eq.smooth],
        "--differs": [", ".join(eq.differing)] if eq.numbers else [],
        "--constraint": [text for text in eq.constraints if not text.endswith(CONSERVED)],
        "--conserve": [text.removesuffix(CONSERVED) for text in eq.constraints if text.endswith(CONSERVED)],
        "--noise": [f"{name}={value}" for name, value in noise.items()],
        "--gain-sd": [f"{name}={sd:.6g}" for name, sd in sensors.gain_sd.items()],
        "--lag-sd": [f"{name}={lag.prior_sd:.6g}" for name, lag in sensors.lags.items()],
        "--tails": [sensors.tails] if sensors.tails != "gauss" else [],
        "--band": [] if eq.data.band is None else ["{:g}:{:g}".format(*eq.data.band)],
    }
    words += [word for option, values in options.items() for value in values for word in (option, value)]
    return shlex.join([*words, "--refine"] if eq.refined else words)
