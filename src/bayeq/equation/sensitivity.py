"""Sensitivity of posterior inclusion probabilities to v_s, to p_0 and to the power of the likelihood.

Curves by model averaging, with their tables and their figure.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Bools, Floats
from bayeq.errors import ConvergenceWarning, InputError
from bayeq.figures.style import BLACK, BLUE, ORANGE, PALE, RED, log_ticks, new_panels, picture, term_label
from bayeq.inference.bma import average_models
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.engines import ENGINES, spike_slab_methods
from bayeq.inference.gram import Gram, GramLike
from bayeq.inference.prior import Prior
from bayeq.numerics.settings import INFERENCE

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Axis labels of the quantity that varies, by its column in tables.
LABELS = {
    "slab_variance": "slab variance $v_s$",
    "prior_inclusion": "prior inclusion probability $p_0$",
    "coarsen": "power of the likelihood",
}

# Terms whose PIP stays below this run along the axis and are not drawn.
NOTEWORTHY = 0.05

# Each term that is included at only some values gets a colour and a marker, until these run out. Markers distinguish
# terms in grey print; colours are from the palette of all figures.
GREY, GREEN, PURPLE, SKY = "#6E6E6E", "#009E73", "#CC79A7", "#56B4E9"
COLOURS = [RED, ORANGE, GREEN, PURPLE, SKY, BLACK, RED, ORANGE]
LOOKS = [{"color": colour, "marker": marker} for colour, marker in zip(COLOURS, "os^Dv<>P", strict=True)]

# In the legend names of a group take at most this many lines of this many characters: it is then as high as a panel.
LINES, WIDTH = 2, 26

# Figure [mm]: height of a row; widths of the first panel with its scale, of other panels, of the legend.
HEIGHT, FIRST, PANEL, LEGEND = 65.0, 72.0, 66.0, 52.0

# v_s varies over two decades either way. A term costs 1/2 ln v_s, so that its log-odds vary by 2.3 nats either way.
FACTORS = 10.0 ** np.linspace(-2.0, 2.0, 9)
# A slab of variance v_s shrinks coefficients as 1/v_s rows of zeros would: with more than ten it does more than select.
LEAST_SLAB_VARIANCE = 0.1
# From one term in a hundred, which suits large dictionaries, to one in two, where small models are no longer preferred.
INCLUSIONS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
# A row counts as one, as a half ... as 1/4096, which leaves 25 rows of a long record of 100,000.
POWERS = 2.0 ** -np.arange(0.0, 13.0)
# An equation of four terms and its noise cannot be learned from fewer rows.
LEAST_ROWS = 5.0


@dataclass(frozen=True, eq=False)
class PipCurve:
    """Posterior inclusion probabilities (PIPs) by model averaging as one number varies."""

    # the quantity that varies, its column in tables: "slab_variance" (v_s), "prior_inclusion" (p_0), "coarsen" (the
    # power of the likelihood)
    axis_name: str
    names: tuple[str, ...]  # the P candidate terms
    values: Floats  # (K,), values of the quantity that varies, ascending
    pip: Floats  # (K, P), PIPs at these values
    left_out: Floats  # (K,), posterior mass of models not listed, rather overestimated: PIPs err by no more
    current: int  # index of the value that the equation was found with
    rows: Floats | None = None  # (K,), effective number of rows at each value, if it varies

    @property
    def listed(self) -> Bools:
        """Values at which the models listed hold at least 98 % of the posterior mass, (K,)."""
        return self.left_out <= INFERENCE.most_left_out

    def table(self) -> pd.DataFrame:
        """A row for each value and term; columns: `axis_name` (the value), rows (if they vary), term, pip, left_out."""
        import pandas as pd

        terms = len(self.names)
        columns = {self.axis_name: np.repeat(self.values, terms)}
        if self.rows is not None:
            columns["rows"] = np.repeat(self.rows, terms)
        return pd.DataFrame(columns).assign(
            term=list(self.names) * len(self.values), pip=self.pip.ravel(), left_out=np.repeat(self.left_out, terms)
        )

    def changes(self) -> pd.DataFrame:
        """Terms that are included (PIP > 0.5) at some values and not at others; see `PriorSensitivity.changes`."""
        return _changes([self])

    def plot(self) -> Figure:
        """PIPs against the value.

        Shown are the terms that are included as used and those whose PIP exceeds 0.05 anywhere; those that are included
        at some values only stand out.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        return draw_pip_curves({"": [self]})

    def __str__(self) -> str:
        """The terms that are always included, and between which values others are, a line each."""
        inside = self.pip[self.listed] > 0.5
        values = self.values[self.listed]
        count = inside.sum(axis=0)
        always = [name for name, k in zip(self.names, count, strict=True) if 0 < k == len(values)]
        what = LABELS[self.axis_name].replace("$", "")
        lines = [
            f"included (PIP > 0.5), {what} from {self.values[0]:.3g} to {self.values[-1]:.3g}"
            f" (used: {self.values[self.current]:.3g})",
            f"always: {', '.join(always) or 'none'}",
        ]
        for j in np.argsort(-count, kind="stable"):
            if 0 < count[j] < len(values):
                at = np.flatnonzero(inside[:, j])
                runs = np.split(values[at], np.flatnonzero(np.diff(at) > 1) + 1)
                between = ", ".join(" to ".join(f"{end:.3g}" for end in np.unique(run[[0, -1]])) for run in runs)
                lines.append(f"{self.names[j]}: {between}; PIP {self.pip[self.current, j]:.2f} as used")
        if missing := len(self.values) - len(values):
            lines.append(f"not counted: {missing} values at which too many models share the posterior mass")
        return "\n".join(lines)


class PriorSensitivity(NamedTuple):
    """Prior sensitivity of the PIPs: one of v_s and p_0 varies while the other has the value used.

    Attributes
    ----------
    slab_variance : PipCurve
        PIPs against v_s.
    prior_inclusion : PipCurve
        PIPs against p_0. Where terms have p_0 of their own, the log-odds of all are shifted by the same amount, and the
        value is the probability of their mean; where p_0 ~ Beta(a, b), it is a/(a + b), and a + b stays. Terms forced
        in or kept out remain so.
    """

    slab_variance: PipCurve
    prior_inclusion: PipCurve

    def table(self) -> pd.DataFrame:
        """A row per prior and term: slab_variance, prior_inclusion, term, pip, left_out; the prior used once."""
        import pandas as pd

        keys = [curve.axis_name for curve in self]
        tables = [curve.table() for curve in self]
        for table, other in zip(tables, reversed(self), strict=True):
            table[other.axis_name] = other.values[other.current]
        joined = pd.concat(tables)[[*keys, "term", "pip", "left_out"]].drop_duplicates([*keys, "term"])
        return joined.sort_values(keys, kind="stable", ignore_index=True)

    def changes(self) -> pd.DataFrame:
        """Terms that some of the priors include (PIP > 0.5) and others do not.

        Priors that are not `PipCurve.listed` do not count.

        Returns
        -------
        DataFrame
            ``term``, ``pip`` under the prior used (NaN if it is not listed), ``lowest`` and ``highest`` PIP; the widest
            range first.
        """
        return _changes(self)

    def plot(self) -> Figure:
        """PIPs against v_s and against p_0, side by side; see `PipCurve.plot`."""
        return draw_pip_curves({"": self})

    def __str__(self) -> str:
        return "\n".join(str(curve) for curve in self)


def _changes(curves: Sequence[PipCurve]) -> pd.DataFrame:
    """Terms that change over all values of the curves, which share the value used; see `PriorSensitivity.changes`."""
    import pandas as pd

    first = curves[0]
    pip = np.concatenate([curve.pip[curve.listed] for curve in curves])
    out = pd.DataFrame(
        {
            "term": first.names,
            "pip": np.where(first.listed[first.current], first.pip[first.current], np.nan),
            # if no value is listed, no term changes
            "lowest": pip.min(axis=0, initial=1.0),
            "highest": pip.max(axis=0, initial=0.0),
        }
    )
    out = out[(out.lowest <= 0.5) & (out.highest > 0.5)]
    widest_first = np.argsort((out.lowest - out.highest).to_numpy(), kind="stable")
    return out.iloc[widest_first].reset_index(drop=True)


def require_spike_slab(method: str) -> None:
    """Check that a method has a v_s and a p_0; the InputError lists the methods that have."""
    if not ENGINES[method].spike_slab:
        known = ", ".join(spike_slab_methods())
        raise InputError(f"method {method!r} has no v_s and p_0 to vary; take one of: {known}")


def prior_sensitivity(
    gram: GramLike,
    prior: Prior,
    slab_variances: ArrayLike | None = None,
    prior_inclusions: ArrayLike | None = None,
    *,
    tolerance: float = 5e-3,
) -> PriorSensitivity:
    """PIPs by model averaging: v_s varies at the prior's p_0, then p_0 at its v_s; see `Equation.sensitivity`.

    `gram` is standardised; the averaging may leave out `tolerance` of the posterior mass.

    InputError: values out of range, or every term forced or forbidden.

    >>> import numpy as np
    >>> from bayeq.inference.gram import Gram
    >>> rng = np.random.default_rng(1)
    >>> D = rng.normal(size=(50, 3))
    >>> gram = Gram.from_data(D, D[:, 0] + 0.3 * D[:, 1] + rng.normal(size=50), names=("x", "v", "u"))
    >>> print(prior_sensitivity(gram.standardise().gram, Prior()))
    included (PIP > 0.5), slab variance v_s from 0.1 to 1e+03 (used: 10)
    always: x
    v: 0.1 to 100; PIP 0.77 as used
    included (PIP > 0.5), prior inclusion probability p_0 from 0.01 to 0.5 (used: 0.1)
    always: x
    v: 0.05 to 0.5; PIP 0.77 as used
    """
    terms = len(gram.names)
    used = Problem.of(gram, prior)
    v_s, p_0 = float(prior.slab_variance), common_inclusion(prior, terms)
    if slab_variances is None:
        slab_variances = [value for value in v_s * FACTORS if value >= LEAST_SLAB_VARIANCE]
    slabs = _axis("slab_variances", slab_variances, v_s, np.inf)
    inclusions = _axis("prior_inclusions", INCLUSIONS if prior_inclusions is None else prior_inclusions, p_0, 1.0)

    def at(inclusion: float) -> Problem:
        # all problems share the rows of D'D that were computed for one
        shifted = prior if inclusion == p_0 else with_inclusion(prior, terms, inclusion)
        return Problem.of(gram, shifted)._replace(columns=used.columns)

    return PriorSensitivity(
        _curve("slab_variance", gram, prior, slabs, v_s, map(used.with_slab_variance, slabs.tolist()), tolerance),
        _curve("prior_inclusion", gram, prior, inclusions, p_0, map(at, inclusions.tolist()), tolerance),
    )


def power_sensitivity(gram: Gram, prior: Prior, powers: ArrayLike | None = None) -> PipCurve:
    """PIPs by model averaging as a standardised likelihood gets powers below 1: coarsening (Miller and Dunson 2019)."""
    values = _axis("powers", POWERS if powers is None else powers, 1.0, 1.0)
    values = values[(values == 1.0) | (values * gram.n >= LEAST_ROWS)]
    problems = (Problem.of(gram.raised(float(power)), prior) for power in values)
    return replace(_curve("coarsen", gram, prior, values, 1.0, problems), rows=values * gram.n)


def _axis(name: str, values: ArrayLike, used: float, upper: float) -> Floats:
    """Values in ascending order, the one used among them."""
    given = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if given.ndim > 1:
        raise InputError(f"{name} must be a list of numbers, got an array of shape {given.shape}")
    # a value that differs from the one used by rounding is the one used
    others = given[~np.isclose(given, used, rtol=1e-9, atol=0.0)]
    wrong = others[~((others > 0.0) & (others < upper))]
    if len(wrong):
        below = f"at most {upper:g}" if used == upper else f"less than {upper:g}"
        allowed = "positive numbers" if upper == np.inf else f"greater than 0 and {below}"
        raise InputError(f"{name} must be {allowed}, got {wrong[0]:g}")
    return np.unique(np.append(others, used))


def _curve(
    axis_name: str,
    gram: GramLike,
    prior: Prior,
    values: Floats,
    used: float,
    problems: Iterable[Problem],
    tolerance: float = 5e-3,
) -> PipCurve:
    """The curve of the problems that the values pose; a warning if the PIPs at the value used are not reliable."""
    pip, left_out = np.empty((len(values), len(gram.names))), np.empty(len(values))
    for k, problem in enumerate(problems):
        found = average_models(problem, prior.limits, tolerance=tolerance)
        pip[k], left_out[k] = found.pip(tolerance)[0], found.left_out
    curve = PipCurve(axis_name, tuple(gram.names), values, pip, left_out, int(np.searchsorted(values, used)))
    if not curve.listed[curve.current]:
        warnings.warn(
            "too many models share the posterior mass: PIPs are over those of about"
            f" {100 * (1 - left_out[curve.current]):.0f} % of it (left_out); give fewer terms",
            ConvergenceWarning,
            stacklevel=4,
        )
    return curve


def common_inclusion(prior: Prior, terms: int) -> float:
    """p_0 as one number: that of the mean log-odds if it differs between terms, a/(a + b) if p_0 ~ Beta(a, b)."""
    log_odds = prior.log_odds(terms)
    free = np.isfinite(log_odds)
    if not free.any():
        raise InputError("every term is forced in or kept out: their PIPs are 1 and 0 under any v_s and p_0")
    if prior.inclusion_beta is not None:
        a, b = prior.inclusion_beta
        return float(a / (a + b))
    if np.ndim(prior.prior_inclusion) == 0:
        return float(np.asarray(prior.prior_inclusion))
    return float(1.0 / (1.0 + np.exp(-log_odds[free].mean())))


def with_inclusion(prior: Prior, terms: int, inclusion: float) -> Prior:
    """The prior with another `common_inclusion`: terms keep their odds against each other, Beta(a, b) its a + b."""
    if prior.inclusion_beta is not None:
        weight = sum(prior.inclusion_beta)
        return replace(prior, inclusion_beta=(weight * inclusion, weight * (1.0 - inclusion)))
    common = common_inclusion(prior, terms)
    ratio = inclusion / (1.0 - inclusion) * (1.0 - common) / common
    p_0 = np.asarray(prior.prior_inclusion, dtype=np.float64)
    return replace(prior, prior_inclusion=p_0 * ratio / (p_0 * ratio + (1.0 - p_0)))


@picture
def draw_pip_curves(rows: Mapping[str, Sequence[PipCurve]]) -> Figure:
    """A row per equation, by title (may be empty): a panel per curve, equally many in each row, and a legend."""
    panels = max(len(curves) for curves in rows.values())
    width = FIRST + (panels - 1) * PANEL + LEGEND
    figure, axes = new_panels(len(rows), panels, width=width, height=HEIGHT * len(rows), sharey=True)
    for in_row, (title, curves) in zip(axes, rows.items(), strict=True):
        for ax, curve in zip(in_row, curves, strict=True):
            _frame(ax, curve)
        in_row[0].set_ylabel("PIP")
        in_row[0].set_title(term_label(title), pad=13)
        _draw(in_row, curves)
    return figure


def _frame(ax: Axes, curve: PipCurve) -> None:
    """Set the scales and labels, and mark the value used."""
    x, used = curve.values, float(curve.values[curve.current])
    margin = (x[-1] / x[0]) ** 0.03 if len(x) > 1 else 2.0
    limits = (x[0] / margin, x[-1] * margin)
    ax.set(xscale="log", xlim=limits, ylim=(-0.03, 1.03), xlabel=LABELS[curve.axis_name])
    log_ticks(ax.xaxis)
    ax.axhline(0.5, color=BLACK, linestyle=(0, (4, 2)), linewidth=0.6)
    ax.axvline(used, color=BLACK, linestyle=(0, (1, 1.5)), linewidth=0.9)
    above: dict[str, Any] = {"xycoords": ax.get_xaxis_transform(), "ha": "center", "va": "bottom", "fontsize": 7}
    ax.annotate(f"used: {used:.4g}", (used, 1.02), **above)


def _draw(axes: Sequence[Axes], curves: Sequence[PipCurve]) -> None:
    """Draw curves that are always, sometimes and never above 0.5, and the legend."""
    names, used = curves[0].names, curves[0].pip[curves[0].current]
    listed = np.concatenate([curve.listed for curve in curves])
    whole = np.concatenate([curve.pip for curve in curves])
    inside = whole[listed | ~listed.any()] > 0.5
    always, ever = inside.all(axis=0), inside.any(axis=0)
    changing = sorted(np.flatnonzero(ever & ~always).tolist(), key=lambda j: (-used[j], j))
    never = np.flatnonzero(~ever & (whole.max(axis=0) > NOTEWORTHY)).tolist()
    certain, more = np.flatnonzero(always).tolist(), changing[len(LOOKS) :]
    groups: list[tuple[list[int], str, dict[str, Any]]] = [
        (certain, f"always: {_names(certain, names)}", {"color": BLUE, "linewidth": 1.5}),
        *(([j], _names([j], names), look | {"markersize": 2.8}) for j, look in zip(changing, LOOKS, strict=False)),
        (more, f"{len(more)} more", {"color": PALE}),
        (never, f"never: {_names(never, names)}", {"color": GREY, "linewidth": 0.6}),
    ]
    open_mark: dict[str, Any] = {"linestyle": "none", "marker": "o", "markerfacecolor": "white", "markersize": 3.6}
    handles, labels = [], []
    for k, (terms, label, look) in enumerate(group for group in groups if group[0]):
        for ax, curve in zip(axes, curves, strict=True):
            x, pip, crowded = curve.values, curve.pip[:, terms], ~curve.listed
            alone: dict[str, Any] = {"marker": "o", "markersize": 2.8} if len(x) == 1 else {}
            lines = ax.plot(x, pip, zorder=3 - 0.01 * k, **(alone | look))  # the first above the others
            ax.plot(x[crowded], pip[crowded], color=look["color"], **open_mark)
        handles.append(lines[0])
        labels.append(label)
    if not listed.all():
        handles += axes[-1].plot([], [], color=GREY, **open_mark)
        labels.append("too many models to list")
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0), "borderaxespad": 0.0}
    place |= {"fontsize": 7, "labelspacing": 0.25}
    axes[-1].legend(handles, labels, title="included (PIP > 0.5)", alignment="left", **place)


def _names(terms: Sequence[int], names: Sequence[str]) -> str:
    """Terms separated by commas, as many as a few lines hold."""
    lines: list[list[str]] = [[]]
    for j in terms:
        if lines[-1] and sum(len(term) + 2 for term in lines[-1]) + len(names[j]) > WIDTH:
            if len(lines) == LINES:
                lines[-1].append("…")
                break
            lines.append([])
        lines[-1].append(names[j])
    return ",\n".join(", ".join(term_label(term, names) for term in line) for line in lines)
