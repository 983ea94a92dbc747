"""`ParsimonyPath`: the likeliest model of each size, which shows where further terms stop paying, and its figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.figures.style import BLACK, BLUE, ORANGE, PALE, RED, labelled, log_ticks, new_panels, picture, term_label
from bayeq.forecast.score import percent
from bayeq.inference.collapsed.path import DEFAULT_MOST, best_of_each_size, model_log_posterior, partial_shares
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.inference.gram import Gram
from bayeq.regression.fit import RegressionFit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Terms added, and terms removed.
Step = tuple[tuple[str, ...], tuple[str, ...]]

# By default a path goes this many terms beyond the chosen equation: enough to see its evidence fall.
BEYOND = 3

# Figure [mm]: height of a panel, of the margins around it, and of a character of the vertical term labels below it.
HEIGHT, AROUND, CHARACTER = 46.0, 22.0, 1.0

# Longer terms are shortened, and only the first few of a step are named, or the page would be mostly names.
LONGEST = 24
NAMED = 3

# Log evidence is drawn on a linear scale down to this many nats below the best, odds of 1 to 22,000, and on a
# logarithmic one beyond, where only its order of magnitude matters.
LINEAR = 10.0

# Errors are drawn as at least this share of the largest training error: zeros of a noise-free record do not show.
LEAST_ERROR = 1e-6

HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "D", "markersize": 3.4, "markerfacecolor": "white"}
RING: dict[str, Any] = {"color": RED, "marker": "o", "markersize": 7.5, "markerfacecolor": "none", "linestyle": "none"}


@dataclass(frozen=True, eq=False)
class ParsimonyPath:
    """The likeliest model of each size, with its fit; K models from the smallest to the largest.

    Attributes
    ----------
    target : str
        Left-hand side.
    names : tuple of str
        The P candidate terms.
    models : (K, P) bool array
        The terms of each model.
    coef, intercept : (K, P) array, (K,) array
        Posterior means given the model, in original units.
    log_evidence : (K,) array
        ln p(y, model): eq. (34) and the prior of the model; y in original units.
    r2, held_out_r2 : (K,) array
        Share of the target's variance explained on the training rows, and on the rows held out (NaN without any).
    chosen : (P,) bool array
        The terms of the equation that the path belongs to. It need not lie on the path: the terms that are each
        likelier in than out may not make the likeliest model of their number.
    chosen_log_evidence, chosen_r2, chosen_held_out_r2 : float
        Log evidence and fit of the chosen equation.
    share : (P,) array
        Loss of R2 on the training rows when a term is left out of the equation and the others are refitted by least
        squares; NaN for a term that is not in the equation.
    """

    target: str
    names: tuple[str, ...]
    models: Bools
    coef: Floats
    intercept: Floats
    log_evidence: Floats
    r2: Floats
    held_out_r2: Floats
    chosen: Bools
    chosen_log_evidence: float
    chosen_r2: float
    chosen_held_out_r2: float
    share: Floats

    @property
    def size(self) -> Ints:
        """Number of terms of each model, (K,)."""
        return self.models.sum(axis=1)

    @property
    def is_chosen(self) -> Bools:
        """Whether each model is the chosen equation, (K,); all False if the equation is not on the path."""
        return np.asarray((self.models == self.chosen).all(axis=1))

    @property
    def steps(self) -> list[Step]:
        """Terms added and terms removed by each model against the one before, K pairs of tuples of str."""
        before = np.vstack([np.zeros_like(self.chosen), self.models[:-1]])
        return [
            (self._named(new & ~old), self._named(old & ~new)) for old, new in zip(before, self.models, strict=True)
        ]

    def _named(self, members: Bools) -> tuple[str, ...]:
        return tuple(self.names[j] for j in np.flatnonzero(members))

    def table(self) -> pd.DataFrame:
        """A row per size.

        Returns
        -------
        DataFrame
            ``size``, ``added`` and ``removed`` (terms, against the row before), ``log_evidence``, ``r2`` and ``nrmse``
            (root mean squared error over the target's standard deviation) on the training rows, ``held_out_r2`` and
            ``held_out_nrmse`` (NaN where no rows were held out), ``chosen``.
        """
        import pandas as pd

        return pd.DataFrame(
            {
                "size": self.size,
                "added": [", ".join(added) for added, _ in self.steps],
                "removed": [", ".join(removed) for _, removed in self.steps],
                "log_evidence": self.log_evidence,
                "r2": self.r2,
                "nrmse": np.sqrt(1.0 - self.r2),
                "held_out_r2": self.held_out_r2,
                "held_out_nrmse": np.sqrt(1.0 - self.held_out_r2),
                "chosen": self.is_chosen,
            }
        )

    def plot(self) -> Figure:
        """Log evidence and normalised errors against the number of terms, the chosen equation marked.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        return draw_paths({"": self})

    def __str__(self) -> str:
        """A line per size, an arrow at the chosen equation."""
        best = float(self.log_evidence.max())

        def line(chosen: bool, size: int, log_evidence: float, r2: float, held_out_r2: float) -> str:
            errors = f"{_error(r2)} {_error(held_out_r2)}"
            return f"{'->' if chosen else '':2}{size:5} {log_evidence - best:11.1f} {errors}  "

        rows = zip(self.is_chosen, self.size, self.log_evidence, self.r2, self.held_out_r2, strict=True)
        steps = (" ".join([*(f"+ {name}" for name in new), *(f"- {name}" for name in old)]) for new, old in self.steps)
        lines = [
            f"{self.target}: best model of each size; evidence in nats below the best",
            f"{'terms':>7} {'evidence':>11} {'training':>9} {'held-out':>9}  against the line above",
            *((line(*row) + step).rstrip() for row, step in zip(rows, steps, strict=True)),
        ]
        named = self._named(self.chosen)
        if not self.is_chosen.any():
            off = line(True, len(named), self.chosen_log_evidence, self.chosen_r2, self.chosen_held_out_r2)
            lines.append(f"{off}the equation: {', '.join(named) or 'no terms'}")
        lines.append("errors: RMS over the standard deviation of the target")
        if named:
            order = sorted(np.flatnonzero(self.chosen), key=lambda j: -self.share[j])
            shares = ", ".join(f"{self.names[j]} {percent(self.share[j])}" for j in order)
            lines.append(f"variance that the fit loses without a term: {shares}")
        return "\n".join(lines)


def _error(r2: float) -> str:
    if np.isnan(r2):
        return " " * 9
    value = 100.0 * np.sqrt(1.0 - r2)
    text = f"{value:.1f}" if value >= 10 else f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"
    return f"{text:>7} %"


def parsimony_path(fit: RegressionFit, shown: Bools, most: int | None = None) -> ParsimonyPath:
    """Size path of a regression, the equation's terms being `shown`, (P,); see `Equation.path`, also for errors."""
    regression, standard, problem = fit.regression, fit.standard, fit.problem
    limits = fit.prior.limits
    # equalities between coefficients have eliminated terms and subtracted their part from the target
    chosen = shown[fit.constraints.equalities.kept]
    held_out = None if regression.held_out is None else fit.constraints.equalities.reduce(regression.held_out)
    if most is None:
        most = max(DEFAULT_MOST, int(chosen.sum()) + BEYOND)
    found = best_of_each_size(problem, most, [chosen], limits)
    models = np.array([model for model, _ in found])
    coef = np.array([exact_posterior(problem, model, limits)[0] for model in (*models, chosen)])
    coef *= standard.target_scale / standard.scale
    intercept = standard.source.target_mean - coef @ standard.source.mean
    r2 = _r2(fit.rows, regression.rows, coef, intercept)
    held_out_r2 = _r2(held_out, regression.held_out, coef, intercept)
    jacobian = standard.source.dof * float(np.log(standard.target_scale))
    return ParsimonyPath(
        target=regression.chain.target,
        names=tuple(standard.gram.names),
        models=models,
        coef=coef[:-1],
        intercept=intercept[:-1],
        log_evidence=np.array([value for _, value in found]) - jacobian,
        r2=r2[:-1],
        held_out_r2=held_out_r2[:-1],
        chosen=chosen,
        chosen_log_evidence=model_log_posterior(problem, chosen, limits) - jacobian,
        chosen_r2=float(r2[-1]),
        chosen_held_out_r2=float(held_out_r2[-1]),
        share=partial_shares(fit.rows, chosen) * (fit.rows.yty / (regression.rows.yty or 1.0)),
    )


def _r2(reduced: Gram | None, whole: Gram | None, coef: Floats, intercept: Floats) -> Floats:
    """R2 of K models, (K,): errors on the Gram reduced by equalities, over the variance of the whole target."""
    if reduced is None or whole is None:
        return np.full(len(coef), np.nan)
    errors = np.array([reduced.squared_error(theta, b0) for theta, b0 in zip(coef, intercept, strict=True)])
    return 1.0 - errors / whole.yty if whole.yty > 0 else np.zeros(len(coef))


@picture
def draw_paths(rows: Mapping[str, ParsimonyPath]) -> Figure:
    """Log evidence (left) and errors (right) against the number of terms; a row per equation, keyed by its title."""
    lengths = [
        max(sum(2 + len(name[:LONGEST]) for names in step for name in names[:NAMED]) for step in path.steps)
        for path in rows.values()
    ]
    heights = [HEIGHT + AROUND + CHARACTER * length for length in lengths]
    figure, axes = new_panels(len(rows), 2, height=sum(heights), height_ratios=heights)
    for (left, right), (title, path) in zip(axes, rows.items(), strict=True):
        _draw_evidence(left, path)
        _draw_errors(right, path)
        for ax in (left, right):
            _number_sizes(ax, path)
        left.set_title(term_label(title, longest=LONGEST))
    figure.legend(handles=labelled(axes.flat), loc="outside upper right", ncols=4, columnspacing=1.6, handlelength=2.2)
    return figure


def _draw_evidence(ax: Axes, path: ParsimonyPath) -> None:
    best = float(path.log_evidence.max())
    ax.plot(path.size, path.log_evidence - best, color=BLACK, marker="s", markersize=3.0, label="log evidence")
    _mark(ax, path, [path.chosen_log_evidence - best])
    ax.set_yscale("symlog", linthresh=LINEAR, linscale=1.0)
    low = min(float(path.log_evidence.min()), path.chosen_log_evidence) - best
    ax.set_ylim(1.6 * low if low < -LINEAR else -1.1 * LINEAR, 0.15 * LINEAR)
    decades = range(1, int(np.log10(max(-low, LINEAR))) + 1)
    ticks = [*(-float(10**k) for k in reversed(decades)), -0.5 * LINEAR, 0.0]
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks([], minor=True)
    ax.axhspan(-LINEAR, ax.get_ylim()[1], color=PALE, alpha=0.5, linewidth=0, zorder=0)
    ax.set_ylabel("log evidence below the best [nats]")


def _draw_errors(ax: Axes, path: ParsimonyPath) -> None:
    error, held_out = np.sqrt(1.0 - path.r2), np.sqrt(1.0 - path.held_out_r2)
    # smaller errors are rounding
    least = LEAST_ERROR * max(float(error.max()), LEAST_ERROR)
    ax.plot(path.size, np.maximum(error, least), color=BLUE, marker="o", markersize=3.0, label="training rows")
    label = "held-out rows" if np.isfinite(held_out).any() else None
    ax.plot(path.size, np.maximum(held_out, least), linestyle=(0, (4, 1.5)), label=label, **HELD_OUT)
    chosen = np.maximum(np.sqrt([1.0 - path.chosen_r2, 1.0 - path.chosen_held_out_r2]), least)
    _mark(ax, path, chosen, "the equation")
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    if high < 10.0 * low:  # room for at least a few labelled ticks
        middle = np.sqrt(low * high)
        ax.set_ylim(middle / np.sqrt(10.0), middle * np.sqrt(10.0))
    log_ticks(ax.yaxis, lambda value: f"{100.0 * value:g} %")
    ax.set_ylabel("RMS error / sd of the target")


def _mark(ax: Axes, path: ParsimonyPath, values: Sequence[float] | Floats, label: str | None = None) -> None:
    """A line at the size of the chosen equation and rings about its values."""
    size = int(path.chosen.sum())
    ax.axvline(size, color=RED, linewidth=0.8, linestyle=(0, (1, 1.5)), zorder=1)
    ax.plot([size] * len(values), values, zorder=4, markeredgewidth=1.2, label=label, **RING)


def _number_sizes(ax: Axes, path: ParsimonyPath) -> None:
    """Label the horizontal axis: number of terms, and below it the terms added and removed."""
    ax.set(xlim=(path.size[0] - 0.5, path.size[-1] + 0.5), xticks=path.size)
    ax.xaxis.remove_overlapping_locs = False  # minor ticks at the places of major ones
    changes = []
    for step in path.steps:
        parts: list[str] = []
        for sign, names in zip("+\N{MINUS SIGN}", step, strict=True):
            parts += [sign + term_label(name, path.names, LONGEST) for name in names[:NAMED]]
            parts += [f"{sign}…"] * (len(names) > NAMED)
        changes.append(" ".join(parts))
    ax.set_xticks(path.size, changes, minor=True, rotation=90)
    ax.tick_params(axis="x", which="minor", length=0, pad=13)
    ax.set_xlabel("number of terms, and what changes with each")
