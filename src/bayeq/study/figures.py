"""The paper's Figs. 4 and 5: one realisation of each system with nominal parameters, computed and drawn."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats
from bayeq.equation.written import quotient_unit
from bayeq.expressions import parse
from bayeq.figures.paper import Inclusion, JointPosterior, draw_inclusion, draw_joint
from bayeq.figures.style import mathtext, require_matplotlib, save, style
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.posterior import Posterior
from bayeq.inference.vb import spike_slab_vb
from bayeq.records.names import multiply_units, parse_unit
from bayeq.study.config import STUDY_SYSTEMS, StudyConfig, choose
from bayeq.study.runner import ALGORITHM_STREAM, draw, posed
from bayeq.systems import System, get_system

# Values from here on are given in powers of ten on the axis.
LARGE = 1e4

# Share of a coefficient's draws that its axis spans, so that a few stray ones do not shrink all others to a dot.
SPAN = 0.998

# Room beyond that, of the axis' length.
MARGIN = 0.06

FIG_4_TERMS = "candidate term ($x$ displacement, $v$ velocity, $u$ force)"
FIG_5_NOTE = (
    "Coefficients of the acceleration (term: coefficient [unit]);\n"
    f"axes span the central {100 * SPAN:.1f} % of the SS-MCMC samples"
)

# Points on the outline of an ellipse.
OUTLINE = 200


@dataclass(frozen=True, slots=True)
class Comparison:
    """MCMC and VB on the same realisation, in original units."""

    system: System  # the system, with nominal parameters
    truth: Floats  # (P,), true coefficients of the candidate terms
    # by `spike_slab_gibbs`, with draws, and by `spike_slab_vb`
    mcmc: Posterior
    vb: Posterior


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
    """Outline (2, 200), a closed curve, of the region that holds a share `level` of a bivariate Gaussian.

    The points where ``(t - mean)' C^-1 (t - mean)`` is the chi-square quantile with 2 degrees of freedom,
    ``-2 ln(1 - level)``; mean (2,) and covariance (2, 2), positive definite.

    Examples
    --------
    >>> outline = confidence_ellipse([0.0, 0.0], [[1.0, 0.0], [0.0, 4.0]])
    >>> outline.max(axis=1).round(2)
    array([2.45, 4.9 ])
    """
    radius = math.sqrt(-2.0 * math.log1p(-level))
    angle = np.linspace(0.0, 2.0 * np.pi, OUTLINE)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(mean, dtype=np.float64)[:, None] + radius * np.linalg.cholesky(np.asarray(covariance)) @ circle


def inclusion(comparison: Comparison) -> Inclusion:
    """The panel of Fig. 4: Rao-Blackwellised probabilities of MCMC beside VB's w."""
    states = comparison.system.states
    return Inclusion(
        title=comparison.system.title,
        terms=tuple(mathtext(name, order=states) for name in comparison.vb.names),
        true=comparison.truth != 0.0,
        mcmc=comparison.mcmc.pip,
        vb=comparison.vb.pip,
    )


def joint_posterior(comparison: Comparison) -> JointPosterior:
    """The triangle of Fig. 5: the coefficients of the true terms, in original units.

    Draws in which a coefficient is out of the model are in no pair of that coefficient. Large values are
    divided by a power of ten, which the label names.
    """
    system, vb, draws = comparison.system, comparison.vb, comparison.mcmc.draws
    assert draws is not None
    true = np.flatnonzero(comparison.truth)
    scale = np.array([_power_of_ten(value) for value in comparison.truth[true]])
    ((target, symbols),) = system.terms.items()
    names = tuple(vb.names[j] for j in true)
    mean = vb.coef[true] / scale
    place = {int(j): k for k, j in enumerate(np.flatnonzero(vb.support))}
    ellipses = {}
    for j, term in enumerate(true):
        for i, other in enumerate(true[:j]):
            if vb.support[term] and vb.support[other]:
                rows = [place[int(other)], place[int(term)]]
                covariance = vb.covariance[np.ix_(rows, rows)] / np.outer(scale[[i, j]], scale[[i, j]])
                ellipses[i, j] = confidence_ellipse(mean[[i, j]], covariance)
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


def _power_of_ten(value: float) -> float:
    return float(10.0 ** math.floor(math.log10(abs(value)))) if abs(value) >= LARGE else 1.0


def _label(system: System, target: str, term: str, coefficient: str, scale: float) -> str:
    """Term, coefficient in physical parameters, and its unit."""
    power = rf"$10^{{{round(math.log10(scale))}}}$ " if scale != 1.0 else ""
    unit = f"{power}{_unit(system, target, term)}".strip()
    return f"{mathtext(term, order=system.states)}:  {mathtext(coefficient)}\n[{unit or '1'}]"


def _unit(system: System, target: str, term: str) -> str:
    """Unit of a term's coefficient: of the target over that of the term, in SI base units."""
    powers = parse_unit(quotient_unit(target, parse(term), system.units) or "")
    multiply_units(powers, {"kg": Fraction(1), "m": Fraction(1), "s": Fraction(-2)}, powers.pop("N", 0))
    return " ".join(name if power == 1 else f"{name}$^{{{power}}}$" for name, power in sorted(powers.items()))


def write_figures(folder: Path, *, seed: int = 0, systems: Iterable[str] = STUDY_SYSTEMS) -> list[Path]:
    """Compute and draw the paper's Figs. 4 and 5: one realisation per system by the protocol of section 4.

    Nominal parameters, 5 % noise, 2000 rows, columns standardised by eq. (32), the paper's prior and chains. Fig. 4
    shows the inclusion probabilities of all terms, Fig. 5 the pairwise posteriors of the true terms' coefficients of
    the nonlinear systems; without such systems there is none. The files ``fig4_inclusion`` and ``fig5_joint``, each as
    ``.png`` and ``.svg``, go into a folder that is made if missing; the same seed gives the same bytes.

    MissingExtraError without matplotlib; InputError for an argument out of range, a system that is not known, or files
    that cannot be written.
    """
    require_matplotlib()
    names = choose("system", systems, STUDY_SYSTEMS)
    config = StudyConfig(seed=seed, perturb=0.0)
    config.validate()
    results = {name: compare(name, config) for name in names}
    nonlinear = [found for name, found in results.items() if name != "linear"]
    with style():
        figure = draw_inclusion([inclusion(found) for found in results.values()], FIG_4_TERMS)
        paths = save(figure, Path(folder) / "fig4_inclusion")
        if nonlinear:
            figure = draw_joint([joint_posterior(found) for found in nonlinear], FIG_5_NOTE)
            paths += save(figure, Path(folder) / "fig5_joint")
    return paths
