"""The paper's Figs. 4 and 5: one realisation of each system with nominal parameters, computed and drawn."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Bools, Floats
from bayeq.equation.written import quotient_unit
from bayeq.expressions import parse
from bayeq.figures import style
from bayeq.figures.style import mathtext, require_matplotlib, save
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.posterior import Posterior
from bayeq.inference.vb import spike_slab_vb
from bayeq.records.names import multiply_units, parse_unit
from bayeq.study.config import STUDY_SYSTEMS, StudyConfig, choose
from bayeq.study.runner import ALGORITHM_STREAM, draw, posed
from bayeq.systems import System, get_system

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Coefficients from this size on are divided by a power of ten on the axis.
LARGE = 1e4

# Share of a coefficient's draws that its axis spans, so that a few stray ones do not shrink all others to a dot.
SPAN = 0.998

# Margin beyond that at each end, as a share of the axis length.
MARGIN = 0.06

FIG_4_TERMS = "candidate term ($x$ displacement, $v$ velocity, $u$ force)"
FIG_5_NOTE = (
    "Coefficients of the acceleration (term: coefficient [unit]);\n"
    f"axes span the central {100 * SPAN:.1f} % of the SS-MCMC samples"
)

# Points on the outline of an ellipse.
OUTLINE = 200

# Height of the triangle of a system [mm].
BLOCK = 90.0

# Marker styles of VB's mean and of the truth.
MEAN: dict[str, Any] = {"color": style.BLACK, "markersize": 5, "markeredgewidth": 1.1}
TRUTH: dict[str, Any] = {"color": style.RED, "markerfacecolor": "none", "markersize": 6, "markeredgewidth": 1.3}


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """MCMC and VB on the same realisation, in original units."""

    system: System  # the system, with nominal parameters
    truth: Floats  # (P,), true coefficients of the candidate terms
    # posteriors by `spike_slab_gibbs`, with draws, and by `spike_slab_vb`
    mcmc: Posterior
    vb: Posterior


@dataclass(frozen=True, slots=True, eq=False)
class JointPosterior:
    """Joint posterior of p coefficients, with n draws, plotted pair by pair."""

    title: str  # the system
    labels: tuple[str, ...]  # p, labels of the axes in mathtext
    names: tuple[str, ...]  # p, the terms in mathtext
    samples: Floats  # (n, p), draws of the coefficients by MCMC
    included: Bools  # (n, p), terms in the draw's model; a pair's cloud is the draws with both terms
    same_model: Bools  # (n,), whether a draw's model is the one that VB selects
    truth: Floats  # (p,)
    vb_mean: Floats  # (p,)
    vb_included: Bools  # (p,), the coefficients that VB selects
    ellipses: Mapping[tuple[int, int], Floats]  # (2, k), VB's confidence region of coefficients i < j that it selects
    limits: Floats  # (p, 2), ends of the axes


def compare(name: str, config: StudyConfig) -> Comparison:
    """Infer a realisation of one of `STUDY_SYSTEMS` by MCMC and by VB; `perturb` is 0 for nominal parameters."""
    data = draw(config, name, 0)
    standard, prior = posed(data.train, config)
    mcmc = spike_slab_gibbs(
        standard.gram,
        prior,
        chains=config.chains,
        samples=config.samples,
        burn_in=config.burn_in,
        seed=(config.seed, STUDY_SYSTEMS.index(name), 0, ALGORITHM_STREAM),
    )
    vb = spike_slab_vb(standard.gram, prior)
    return Comparison(get_system(name), data.truth, mcmc.rescaled(standard), vb.rescaled(standard))


def confidence_ellipse(mean: ArrayLike, covariance: ArrayLike, level: float = 0.95) -> Floats:
    """Outline (2, 200) of the region that holds a share `level` of a bivariate Gaussian, of mean (2,) and covariance C.

    On it ``(t - mean)' C^-1 (t - mean)`` is the chi-square quantile with 2 degrees of freedom, ``-2 ln(1 - level)``.

    >>> outline = confidence_ellipse([0.0, 0.0], [[1.0, 0.0], [0.0, 4.0]])
    >>> outline.max(axis=1).round(2)
    array([2.45, 4.9 ])
    """
    radius = math.sqrt(-2.0 * math.log1p(-level))
    angle = np.linspace(0.0, 2.0 * np.pi, OUTLINE)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(mean, dtype=np.float64)[:, None] + radius * np.linalg.cholesky(np.asarray(covariance)) @ circle


def joint_posterior(comparison: Comparison) -> JointPosterior:
    """The triangle of Fig. 5: the coefficients of the true terms, large ones divided by a power of ten."""
    system, vb, draws = comparison.system, comparison.vb, comparison.mcmc.draws
    assert draws is not None
    true = np.flatnonzero(comparison.truth)
    sizes = np.abs(comparison.truth[true])
    scale = np.where(sizes < LARGE, 1.0, 10.0 ** np.floor(np.log10(sizes)))
    ((target, symbols),) = system.terms.items()
    names = tuple(vb.names[j] for j in true)
    mean = vb.coef[true] / scale
    place = {int(j): k for k, j in enumerate(np.flatnonzero(vb.support))}
    ellipses = {}
    for i, j in combinations([k for k, term in enumerate(true) if vb.support[term]], 2):
        rows, pair = [place[int(true[k])] for k in (i, j)], [i, j]
        covariance = vb.covariance[np.ix_(rows, rows)] / np.outer(scale[pair], scale[pair])
        ellipses[i, j] = confidence_ellipse(mean[pair], covariance)
    z = draws.z.reshape(-1, len(vb.names))
    samples = draws.theta.reshape(z.shape)[:, true] / scale
    truth = comparison.truth[true] / scale
    return JointPosterior(
        title=system.title,
        labels=tuple(
            _label(system, target, name, symbols[name], size) for name, size in zip(names, scale, strict=True)
        ),
        names=tuple(mathtext(name, order=system.states) for name in names),
        samples=samples,
        included=z[:, true],
        same_model=np.all(z == vb.support, axis=1),
        truth=truth,
        vb_mean=mean,
        vb_included=vb.support[true],
        ellipses=ellipses,
        limits=np.array([_limits(samples[z[:, j], k], k, truth[k], ellipses) for k, j in enumerate(true)]),
    )


def _limits(draws: Floats, k: int, truth: float, ellipses: Mapping[tuple[int, int], Floats]) -> Floats:
    """Ends of the axis of coefficient `k`: the central draws, the truth and the ellipses."""
    values = [np.atleast_1d(truth), *(outline[pair.index(k)] for pair, outline in ellipses.items() if k in pair)]
    if len(draws):
        values.append(np.quantile(draws, [0.5 - SPAN / 2, 0.5 + SPAN / 2]))
    ends = np.array([min(v.min() for v in values), max(v.max() for v in values)])
    room = MARGIN * (ends[1] - ends[0]) or abs(truth)
    return ends + np.array([-room, room])


def _label(system: System, target: str, term: str, coefficient: str, scale: float) -> str:
    """Term, coefficient in physical parameters, and its unit."""
    power = rf"$10^{{{round(math.log10(scale))}}}$ " if scale != 1.0 else ""
    powers = parse_unit(quotient_unit(target, parse(term), system.units) or "")  # in SI base units
    multiply_units(powers, {"kg": Fraction(1), "m": Fraction(1), "s": Fraction(-2)}, powers.pop("N", 0))
    unit = power + " ".join(name if p == 1 else f"{name}$^{{{p}}}$" for name, p in sorted(powers.items()))
    return f"{mathtext(term, order=system.states)}:  {mathtext(coefficient)}\n[{unit.strip() or '1'}]"


def draw_inclusion(panels: Sequence[Comparison]) -> Figure:
    """Rao-Blackwellised probabilities of all terms by MCMC beside VB's w, a panel per system (Fig. 4)."""
    terms = [mathtext(name, order=panels[-1].system.states) for name in panels[-1].vb.names]
    figure, axes = style.new_panels(1, len(panels), height=26.0 + 3.7 * len(terms), sharey=True)
    for k, (ax, panel) in enumerate(zip(axes[0], panels, strict=True)):
        explained = _bars(ax, panel)
        ax.set_title(textwrap.fill(f"({chr(97 + k)}) {panel.system.title}", 24))
    axes[0, 0].set_yticks(np.arange(len(terms)), terms)
    axes[0, 0].set_ylim(len(terms) - 0.4, -0.6)
    axes[0, 0].set_ylabel(FIG_4_TERMS)
    figure.legend(handles=explained, loc="outside upper right", ncols=4)
    return figure


def _bars(ax: Axes, panel: Comparison) -> list[Any]:
    """A panel of inclusion probabilities; returns the handles for the legend."""
    at = np.arange(len(panel.truth))
    look: dict[str, Any] = {"edgecolor": style.BLACK, "linewidth": 0.4}
    true = [ax.axhspan(j - 0.5, j + 0.5, color=style.PALE, linewidth=0, zorder=0) for j in np.flatnonzero(panel.truth)]
    mcmc = ax.barh(at - 0.19, panel.mcmc.pip, 0.38, color=style.BLUE, label="SS-MCMC", **look)
    vb = ax.barh(at + 0.19, panel.vb.pip, 0.38, color=style.ORANGE, hatch="/////", label="SS-VB", **look)
    half = ax.axvline(0.5, color=style.RED, linestyle=style.DASHED, linewidth=0.8, label="PIP = 0.5", zorder=3)
    ax.set_xlim(0.0, 1.05)
    ax.set_xticks([0.0, 0.5, 1.0])
    ax.set_xlabel("PIP")
    if true:
        true[0].set_label("true term")
    return [mcmc, vb, half, *true[:1]]


def draw_joint(systems: Sequence[JointPosterior]) -> Figure:
    """Pairwise joint posteriors, a triangle per system: cloud of MCMC, mean and ellipse of VB, truth (Fig. 5)."""
    from matplotlib.lines import Line2D

    across = min(len(systems), 2)
    rows = -(-len(systems) // across)
    spare = across == 2 and len(systems) % 2 == 1  # a place for the legend
    below = 0.0 if spare else 27.0 if across == 2 else 34.0
    width = style.FULL_WIDTH if across == 2 else style.SINGLE_COLUMN
    figure = style.new_figure(width, rows * BLOCK + below, layout="constrained")
    blocks = figure.subfigures(rows, across, squeeze=False).flat
    for k, (block, system) in enumerate(zip(blocks, systems, strict=False)):
        _triangle(block, system, f"({chr(97 + k)}) {system.title}")
    where: dict[str, Any] = {"loc": "outside lower center", "ncols": across, "labelspacing": 0.5}
    if spare:
        where = {"loc": "center left", "bbox_to_anchor": (0.5 + 10.0 / width, 0.5 / rows), "labelspacing": 0.9}
    samples = {"linestyle": "none", "color": style.BLUE, "marker": "o", "markersize": 3.0}
    looks: dict[str, dict[str, Any]] = {
        "SS-MCMC samples, the model that SS-VB selects": samples,
        "SS-MCMC samples, other models": samples | {"color": style.ORANGE, "marker": "^", "markersize": 4.0},
        "SS-VB mean": {"linestyle": "none", "marker": "x", **MEAN},
        "SS-VB 95 % confidence ellipse": {"color": style.BLACK, "linewidth": 1.0},
        "true values": {"linestyle": "none", "marker": "o", **TRUTH},
    }
    handles = [Line2D([], [], label=label, **look) for label, look in looks.items()]
    legend = figure.legend(handles=handles, columnspacing=1.5, title=FIG_5_NOTE, **where)
    legend.set_alignment("left")
    return figure


def _triangle(block: Any, system: JointPosterior, title: str) -> None:
    """The pairs of one system: coefficient i on the horizontal axis, j > i on the vertical one, with shared axes."""
    side = len(system.labels) - 1
    axes = block.subplots(side, side, squeeze=False, sharex="col", sharey="row")
    for j, i in np.ndindex(side, side):
        ax = axes[j, i]
        if i > j:
            ax.remove()
            continue
        _pair(ax, system, i, j + 1)
        if j == side - 1:
            ax.set_xlabel(system.labels[i], linespacing=1.3)
        if i == 0:
            ax.set_ylabel(system.labels[j + 1], linespacing=1.3)
    block.align_ylabels(axes[:, 0])
    axes[0, 0].set_title(title).set_in_layout(False)  # it may be longer than its panel is wide


def _pair(ax: Axes, system: JointPosterior, i: int, j: int) -> None:
    from matplotlib.patheffects import withStroke

    cloud = system.included[:, i] & system.included[:, j]
    for chosen, marker, colour, size, alpha in (
        (cloud & ~system.same_model, "^", style.ORANGE, 2.0, 0.4),
        (cloud & system.same_model, "o", style.BLUE, 1.2, 0.08),
    ):
        x, y = system.samples[chosen, i], system.samples[chosen, j]
        ax.plot(x, y, marker, color=colour, markersize=size, markeredgewidth=0, alpha=alpha, rasterized=True)
    # light rims, so that the marks stand out from a dark cloud in grey too
    rim = [withStroke(linewidth=2.4, foreground="white")]
    ax.plot(system.truth[i], system.truth[j], "o", path_effects=rim, zorder=3, **TRUTH)
    if (i, j) in system.ellipses:
        ax.plot(*system.ellipses[i, j], color=style.BLACK, linewidth=1.0, path_effects=rim)
        ax.plot(system.vb_mean[i], system.vb_mean[j], "x", path_effects=rim, zorder=4, **MEAN)
    else:
        absent = ", ".join(system.names[a] for a in (i, j) if not system.vb_included[a])
        place: dict[str, Any] = {"ha": "center", "va": "top", "transform": ax.transAxes}
        ax.text(0.5, 0.96, f"not in SS-VB: {absent}", fontsize=7, path_effects=rim, **place)
    ax.set_xlim(*system.limits[i])
    ax.set_ylim(*system.limits[j])
    ax.set_xticks(_ticks(system.limits[i], 2, 0.15))
    ax.set_yticks(_ticks(system.limits[j], 4, 0.07))
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.tick_params(labelsize=6.0)


def _ticks(limits: Floats, intervals: int, margin: float) -> Floats:
    """Round values away from the ends of an axis, so that the numbers of neighbouring panels do not meet."""
    from matplotlib.ticker import MaxNLocator

    room = margin * (limits[1] - limits[0])
    low, high = float(limits[0] + room), float(limits[1] - room)
    ticks = np.asarray(MaxNLocator(intervals).tick_values(low, high))
    return ticks[(ticks >= low) & (ticks <= high)]


def write_figures(folder: Path, *, seed: int = 0, systems: Iterable[str] = STUDY_SYSTEMS) -> list[Path]:
    """Compute and draw the paper's Figs. 4 and 5: one realisation per system by the protocol of section 4.

    Nominal parameters, 5 % noise, 2000 rows. Fig. 4 has the inclusion probabilities of all terms, Fig. 5, of nonlinear
    systems, the pairwise posteriors of the true ones; as ``.png`` and ``.svg`` in a folder that is made if missing. The
    same seed gives the same bytes. MissingExtraError without matplotlib; InputError for bad arguments or paths.
    """
    require_matplotlib()
    names = choose("system", systems, STUDY_SYSTEMS)
    config = StudyConfig(seed=seed, perturb=0.0)
    config.validate()
    results = {name: compare(name, config) for name in names}
    nonlinear = [found for name, found in results.items() if name != "linear"]
    with style.style():
        figure = draw_inclusion(list(results.values()))
        paths = save(figure, Path(folder) / "fig4_inclusion")
        if nonlinear:
            figure = draw_joint([joint_posterior(found) for found in nonlinear])
            paths += save(figure, Path(folder) / "fig5_joint")
    return paths
