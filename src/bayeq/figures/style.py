"""Style of all figures, and writing of figures and tables: for print, in colour or grey, reproducible in each byte."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import BayeqError, InputError, UnknownNameError, needing
from bayeq.expressions import parse, to_sympy
from bayeq.inference.engines import NOTEWORTHY_PIP
from bayeq.markup import shortened
from bayeq.records.io import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

P = ParamSpec("P")
T = TypeVar("T")

# Widths of a journal's page, and of a quick look [mm].
SINGLE_COLUMN = 90.0
FULL_WIDTH = 190.0
QUICK = 160.0

MM_PER_INCH = 25.4
DPI = 300

# Metadata that matplotlib would write into a file (dates, its own name), left out.
UNSIGNED: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}

TABLE_OR_FIGURE = (".csv", *(f".{name}" for name in UNSIGNED))

# Colours that the colour-blind can tell apart (Okabe and Ito 2008) and that differ in lightness when printed in grey.
BLUE = "#0072B2"
ORANGE = "#E69F00"
RED = "#D50000"
PALE = "#E4E4E4"
BLACK = "#000000"
GREY = "#8A8A8A"  # of measured samples, where many lie upon each other

DASHED = (0, (4, 2))

# The font is matplotlib's own default: a figure is the same on every machine, and fits beside one of the user's.
RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "mathtext.fontset": "dejavusans",
    "font.size": 7.5,
    "axes.titlesize": 8.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.5,
    "legend.title_fontsize": 7.5,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.titlelocation": "left",
    "axes.titlepad": 3.0,
    "axes.labelpad": 2.0,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.major.size": 2.0,
    "ytick.major.size": 2.0,
    "xtick.major.pad": 2.0,
    "ytick.major.pad": 2.0,
    "lines.linewidth": 0.9,
    "patch.linewidth": 0.5,
    "hatch.linewidth": 0.5,
    "figure.facecolor": "white",
    "savefig.dpi": DPI,
    "figure.dpi": DPI,
    "svg.fonttype": "path",
    "svg.hashsalt": "bayeq",
}


def require_matplotlib() -> None:
    """Check that figures can be drawn, before anything is computed for them; MissingExtraError without matplotlib."""
    logger = logging.getLogger("matplotlib")
    if not logger.level:  # its messages, such as on a read-only home, do not concern the figure
        logger.setLevel(logging.ERROR)
    with needing("matplotlib", "plot", "drawing figures"):
        import matplotlib.figure  # noqa: F401


@contextmanager
def style() -> Iterator[None]:
    """The settings under which a figure is made and written; the caller's own are left as they were."""
    require_matplotlib()
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(RC)
        yield


def picture(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorator of drawing functions: they draw in this `style`, unless the caller gives axes by ``ax``."""
    arguments = signature(draw)

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        require_matplotlib()
        if arguments.bind(*args, **kwargs).arguments.get("ax") is not None:
            return draw(*args, **kwargs)
        with style():
            made = draw(*args, **kwargs)
            figure = np.ravel(np.array(made, dtype=object))[0].figure
            figure.draw_without_rendering()  # ticks are made on drawing, by the settings of that moment
        return made

    return drawn


def new_figure(width: float, height: float, *, pyplot: bool = False, **options: Any) -> Figure:
    """An empty figure of a size in mm; notebooks show one of `pyplot` by themselves."""
    size = (width / MM_PER_INCH, height / MM_PER_INCH)
    if pyplot:
        from matplotlib.pyplot import figure

        return figure(figsize=size, **options)
    from matplotlib.figure import Figure

    return Figure(figsize=size, **options)


def new_panels(
    rows: int, columns: int = 1, *, height: float, width: float = FULL_WIDTH, **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """A figure of a size in mm, and its (rows, columns) panels, placed so that all labels fit."""
    figure = new_figure(width, height, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def labelled(axes: Iterable[Axes]) -> list[Any]:
    """Legend handles of some axes, each label once."""
    handles = (artist for ax in axes for artist in ax.get_legend_handles_labels()[0])
    return list({artist.get_label(): artist for artist in handles}.values())


def log_ticks(axis: Axis, text: Callable[[float], str] = "{:g}".format) -> None:
    """Set readable ticks of a logarithmic axis, over many decades or half of one; its limits must be set before."""
    from matplotlib.ticker import FuncFormatter, Locator, LogLocator, MaxNLocator, NullFormatter

    low, high = axis.get_view_interval()
    locator: Locator = LogLocator(subs=(1.0,) if high > 300.0 * low else (1.0, 2.0, 5.0), numticks=8)
    if sum(low <= tick <= high for tick in locator.tick_values(low, high)) < 2:
        locator = MaxNLocator(4)
    axis.set_major_locator(locator)
    axis.set_major_formatter(FuncFormatter(lambda tick, _: text(tick)))
    axis.set_minor_formatter(NullFormatter())


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write a figure as PNG (300 dpi) and SVG, to a path without suffix, within `style`; InputError if that fails."""
    paths = []
    try:
        stem.parent.mkdir(parents=True, exist_ok=True)
        for suffix in ("png", "svg"):
            path = stem.with_name(f"{stem.name}.{suffix}")
            _write(figure, path)
            paths.append(path)
    except OSError as error:
        raise InputError(f"{error.filename or stem}: cannot write the figure: {error.strerror or error}") from error
    return paths


def _write(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the suffix names, whole or not at all."""
    suffix = path.suffix.lower()[1:]
    with replacing(path) as part:
        figure.savefig(part, format=suffix, metadata=UNSIGNED[suffix])


def require_suffix(file: Path) -> None:
    """Check that `write_output` can make such a file: InputError, or MissingExtraError where matplotlib is missing."""
    if file.suffix.lower() not in TABLE_OR_FIGURE:
        raise InputError(f"{file}: is to be written as a table or a figure: end it in {', '.join(TABLE_OR_FIGURE)}")
    if file.suffix.lower() != ".csv":
        require_matplotlib()


def write_output(file: Path, table: Callable[[], pd.DataFrame], figure: Callable[[], Figure]) -> None:
    """Write the table (.csv), or the figure in the style of the reports, whole or not at all; only that one is made."""
    if file.suffix.lower() == ".csv":
        made = table()
        with replacing(file) as part:
            made.to_csv(part, index=False)
        return
    with style():
        _write(figure(), file)


def joined(column: str, results: Iterable[tuple[str, Any]]) -> pd.DataFrame:
    """The tables of results below each other, with the name of each in a column in front."""
    import pandas as pd

    names, tables = zip(*((name, result.table()) for name, result in results), strict=True)
    return pd.concat(tables, keys=names, names=[column, None]).reset_index(level=0)


def mathtext(expression: str, order: tuple[str, ...] = ()) -> str:
    r"""Convert a term or a coefficient, in the syntax of `bayeq.expressions.parse`, to matplotlib mathtext.

    Factors are in the order of the names in `order`, others alphabetical.

    >>> print(mathtext("x**2*v", order=("x", "v")), mathtext("v*abs(x)"), mathtext("sign(v)"), mathtext("-cF/m"))
    $x^{2} v$ $v\,|x|$ $\mathrm{sgn}(v)$ $-c_{F}/m$
    """
    import sympy

    # SymPy sorts factors by name: stand-ins bring them into the wanted order.
    stand_in = {sympy.Symbol(name): sympy.Symbol(f"A{k:03d}") for k, name in enumerate(order)}
    names = {stand: sympy.latex(symbol) for symbol, stand in stand_in.items()}
    shown, options = to_sympy(parse(expression)).xreplace(stand_in), {"fold_short_frac": True, "symbol_names": names}
    text = sympy.latex(shown, **options)
    if re.search(r"(^|[({])- ", text):  # x2 - x1, not -x1 + x2
        text = sympy.latex(shown, order="rev-lex", **options)
    text = text.replace(r"\operatorname{sign}", r"\mathrm{sgn}").replace(" / ", "/")
    text = text.replace(r"\bmod", r"\,\mathrm{mod}\,").replace(r"\theta\left(", r"\mathrm{H}\left(")
    # matplotlib needs no brackets that grow, and sets them too wide
    text = re.sub(r"\{\\left\((\S+) \\right\)\}", r"(\1)", text)
    text = re.sub(r"\\left\|\{(\S+)\}\\right\|", r"|\1|", text)
    text = re.sub(r"\b([a-ce-z])([A-Z])\b", r"\1_{\2}", text)
    text = text.replace(" |", r"\,|")
    return f"${re.sub('^- ', '-', text)}$"


def plain(text: str) -> str:
    """Text with ``$`` escaped, which matplotlib prints literally."""
    return text.replace("$", r"\$")


def term_label(term: str, dictionary: Sequence[str] = (), longest: int = 18) -> str:
    """A term in mathtext; plain text if it is no expression (the name of a column); shortened if long.

    Factors are in the order in which names first appear in the dictionary, all terms. A term of more than `longest`
    characters is shortened, so that its label fits.
    """
    short = shortened(term, longest)
    order = tuple(dict.fromkeys(re.findall(r"[^\W\d]\w*", " ".join(dictionary))))
    try:
        set_text = mathtext(term, order) if short == term else plain(short)
    except BayeqError:
        return plain(short)
    return plain(short) if r"\begin" in set_text else set_text  # matplotlib sets no cases of where


# Terms that are drawn, at most.
MOST_TERMS = 24

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# More points than this are drawn as every second, third ... of them.
MOST_POINTS = 4000

# `bayeq.Forecast`, `bayeq.Equation` and `bayeq.Equations`, which stand above this folder and are not imported here.
Run: TypeAlias = Any
EquationLike: TypeAlias = Any
Answer: TypeAlias = Any


def equation_of(eq: Answer, target: str | None) -> EquationLike:
    """The equation of a target, by default the first; UnknownNameError if there is no such target."""
    by_target = {equation.target: equation for equation in eq.equations}
    return by_target[named("equation", target, by_target)]


def named(kind: str, name: str | None, known: Collection[str]) -> str:
    """The given name, by default the first known one; UnknownNameError if it is not known."""
    if name is not None and name not in known:
        raise UnknownNameError(kind, name, list(known))
    return next(iter(known)) if name is None else name


def channel_of(run: Run, channel: str | None) -> str:
    """A measured state of a free run, by default the first; InputError without any, UnknownNameError for another."""
    if not run.measured:
        raise InputError("no state of the equations is measured: there is nothing to compare the free run with")
    return named("measured state", channel, run.measured)


def likely_terms(equation: EquationLike) -> list[int]:
    """Numbers of the terms shown or included, then of the likeliest others; at most `MOST_TERMS`."""
    pip = equation.posterior.pip
    chosen = equation.shown_posterior.support | equation.posterior.support
    order = np.argsort(-pip, kind="stable").tolist()
    listed = [*np.flatnonzero(chosen).tolist(), *(j for j in order if not chosen[j] and pip[j] >= NOTEWORTHY_PIP)]
    return listed[:MOST_TERMS]


def axes_for(
    ax: Any, heights: Sequence[float], width: float, *, sharex: bool = False, pyplot: bool = False
) -> list[Axes]:
    """The axes that are given, or those of a new figure, one below the other.

    Heights are those of the panel of each of the axes, with its labels, and the width that of the figure [mm]. A figure
    of `pyplot` is shown by notebooks by itself. InputError if another number of axes is given than is needed.
    """
    if ax is not None:
        given = list(np.ravel(np.asarray(ax, dtype=object)))
        if len(given) != len(heights) or not all(hasattr(one, "plot") for one in given):
            got = len(given) if len(given) != len(heights) else type(given[0]).__name__
            raise InputError(f"ax: {len(heights)} matplotlib axes are needed, one for each panel, got {got}")
        return given
    figure = new_figure(width, sum(heights), pyplot=pyplot, layout="constrained")
    return list(figure.subplots(len(heights), squeeze=False, sharex=sharex, height_ratios=heights)[:, 0])


def unit_text(unit: str) -> str:
    """A unit with its powers raised.

    >>> unit_text("m/s^2"), unit_text("1/m^2/s^2")
    ('m/s²', '1/m²/s²')
    """
    return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(RAISED), unit)


def bracketed(unit: str) -> str:
    """A unit to be divided or raised: in brackets unless it is a single one.

    >>> bracketed("mm"), bracketed("m/s")
    ('mm', '(m/s)')
    """
    return unit if unit.isalpha() else f"({unit_text(unit)})"


def given_as(eq: Any, name: str) -> str:
    """Word for a channel in a picture: "estimated" for a derivative without a sensor, else "measured"."""
    return "estimated" if name in eq.data.estimated else "measured"


def label_of(name: str, units: Mapping[str, str], what: str = "{}") -> str:
    """Label of an axis: `what` with the name of a channel, and its unit if known."""
    unit = units.get(name, "")
    return plain(what.format(shortened(name)) + (f" [{unit_text(unit)}]" if unit else ""))


def time_label(eq: Answer) -> str:
    """Label of an axis of time, which is counted in rows where it is not known."""
    return "row" if eq.data.rows_as_time else f"time [{eq.data.clock}]"


def frequency_unit(eq: Answer) -> str:
    """Unit of frequencies, in which the clock counts."""
    clock = "row" if eq.data.rows_as_time else eq.data.clock
    return "Hz" if clock == "s" else f"1/{clock}"


def titled(ax: Axes, eq: Answer, target: str) -> None:
    """The target as title, where there are several equations."""
    if len(eq.equations) > 1:
        ax.set_title(term_label(target))


def thinned(n: int, most: int = MOST_POINTS) -> slice:
    """Rows to be drawn of n."""
    return slice(None, None, -(-n // most) or None)


def above(ax: Axes, columns: int = 4, **options: Any) -> None:
    """The legend in a line above the axes, at its right end."""
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2, "fontsize": 7}
    ax.legend(ncols=columns, **(place | {"handlelength": 1.8, "columnspacing": 1.2} | options))
