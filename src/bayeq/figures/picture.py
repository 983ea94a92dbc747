"""What pictures need of an answer, and what they have in common: axes that are given or made, labels, thinning."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions import Expression
from bayeq.figures.style import new_figure, plain, shortened, term_label
from bayeq.inference.engines import NOTEWORTHY_PIP
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from bayeq.inference.posterior import Posterior
    from bayeq.states import Chain
    from bayeq.states.motion import MotionRows

# Terms that are drawn, at most.
MOST_TERMS = 24

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# More points than this are drawn as every second, third ... of them.
MOST_POINTS = 4000


class Run(Protocol):
    """A free run; see `bayeq.Forecast`."""

    @property
    def time(self) -> Floats: ...
    @property
    def mean(self) -> Mapping[str, Floats]: ...
    @property
    def low(self) -> Mapping[str, Floats]: ...
    @property
    def high(self) -> Mapping[str, Floats]: ...
    @property
    def measured(self) -> Mapping[str, Floats]: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def blew_up_at(self) -> float | None: ...


class EquationLike(Protocol):
    """One equation; see `bayeq.Equation`."""

    @property
    def chain(self) -> Chain: ...
    @property
    def terms(self) -> tuple[Expression, ...]: ...
    @property
    def posterior(self) -> Posterior: ...
    @property
    def shown_posterior(self) -> Posterior: ...
    @property
    def printed_ci95(self) -> Floats: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def coef_units(self) -> tuple[str | None, ...]: ...
    @property
    def target(self) -> str: ...
    def predict(self, columns: Mapping[str, Floats], return_std: bool = False) -> Any: ...


class Answer(Protocol):
    """Equations; see `bayeq.Equations`."""

    @property
    def equations(self) -> Sequence[EquationLike]: ...
    @property
    def inputs(self) -> tuple[str, ...]: ...
    @property
    def data(self) -> Any: ...  # the summary of the data: holdout, rows_as_time, estimated
    def motion(self, record: Record) -> MotionRows: ...
    def simulate(self, record: Record, *, draws: int = 200, start: int = 0, rows: int | None = None) -> Run: ...


def equation_of(eq: Answer, target: str | None) -> EquationLike:
    """The equation of a target, by default the first; UnknownNameError if there is no such target."""
    by_target = {equation.target: equation for equation in eq.equations}
    return by_target[named("equation", target, by_target)]


def named(kind: str, name: str | None, known: Collection[str]) -> str:
    """The name that is asked for, by default the first of those known; UnknownNameError of another one."""
    if name is not None and name not in known:
        raise UnknownNameError(kind, name, list(known))
    return next(iter(known)) if name is None else name


def channel_of(run: Run, channel: str | None) -> str:
    """A state of a free run that is measured, by default the first.

    InputError if no state is measured, UnknownNameError if this one is not.
    """
    if not run.measured:
        raise InputError("no state of the equations is measured: there is nothing to compare the free run with")
    return named("measured state", channel, run.measured)


def likely_terms(equation: EquationLike) -> list[int]:
    """Terms shown or included, then the likeliest of the others."""
    pip = equation.posterior.pip
    chosen = equation.shown_posterior.support | equation.posterior.support
    order = np.argsort(-pip, kind="stable").tolist()
    listed = [*np.flatnonzero(chosen).tolist(), *(j for j in order if not chosen[j] and pip[j] >= NOTEWORTHY_PIP)]
    return listed[:MOST_TERMS]


def axes_for(
    ax: Any, heights: Sequence[float], width: float, *, sharex: bool = False, pyplot: bool = False
) -> list[Axes]:
    """The axes that are given, or those of a new figure, one below the other.

    `ax` is what the caller gives: matplotlib axes, a sequence of them, or None. Heights are those of the panel of each
    of the axes, with its labels, and the width that of the figure [mm]; with `sharex` the horizontal axis is the same.
    A figure of `pyplot` is shown by notebooks by itself. InputError if another number of axes is given than is needed.
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
    """What a channel is called in a picture: a derivative that no sensor gave is not called measured."""
    return "estimated" if name in eq.data.estimated else "measured"


def label_of(name: str, units: Mapping[str, str], what: str = "{}") -> str:
    """Label of an axis: what is shown of a channel, and its unit where that is known."""
    unit = units.get(name, "")
    return plain(what.format(shortened(name)) + (f" [{unit_text(unit)}]" if unit else ""))


def units_of(eq: Answer) -> dict[str, str]:
    """Units of all channels, as far as they are known."""
    return {name: unit for equation in eq.equations for name, unit in equation.units.items()}


def time_label(eq: Answer) -> str:
    """Label of an axis of time, which is counted in rows where it is not known."""
    return "row" if eq.data.rows_as_time else "time [s]"


def frequency_label(eq: Answer) -> str:
    """Label of an axis of frequency."""
    return "frequency [1/row]" if eq.data.rows_as_time else "frequency [Hz]"


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
