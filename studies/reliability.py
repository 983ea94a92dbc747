"""What is a stated probability worth on the paper's oscillators? Model averaging, and VB's own w beside it.

Of the terms with a probability near q a share q should be true. On problems drawn from the prior it is, see
`studies.calibration`; here are realisations of the paper's four systems, raw, with the noise of all channels in the
regressors, and with clean states, where only the acceleration is noisy and the model holds. Run as

    python -m studies.reliability --figures docs/figures > docs/tables/reliability.csv
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.cli.terminal import Progress
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.figures.style import BLACK, BLUE, ORANGE, new_panels, save, style
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from bayeq.study.config import STUDY_SYSTEMS, StudyConfig
from bayeq.systems import get_system, simulate
from studies.lines import print_table
from studies.tally import BINS, bin_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["METHODS", "STATES", "Curve", "draw_reliability", "reliability", "study_problem", "table"]

Floats = NDArray[np.float64]

NOISE = StudyConfig().noise

# Noise of the channels, relative to their standard deviations.
STATES: Mapping[str, float | Mapping[str, float]] = {"raw": NOISE, "clean": {"a": NOISE}}
METHODS = ("bma", "vb")
BATCH = 10

# Bins with fewer terms are not drawn.
LEAST_DRAWN = 10

# Height of the figure [mm].
HEIGHT = 138.0

# Room about the unit square of a panel, and its upper end, which leaves room for words.
MARGIN, CEILING = 0.05, 1.42

TITLES = {"linear": "linear", "duffing": "Duffing", "quadratic": "quadratic damping", "coulomb": "Coulomb friction"}
LOOKS = {
    "bma": ("o", BLUE, "PIP", "model averaging, PIP"),
    "vb": ("s", ORANGE, "$w$", "variational Bayes, $w$"),
}


@dataclass(frozen=True, slots=True)
class Curve:
    """Sums over realisations for each bin of the stated probability; curves add up.

    Attributes
    ----------
    terms, stated, true : (BINS,) arrays
        Number of terms, the sum of their probabilities, and how many of them are true.
    squared : (BINS,) array
        Sum over the realisations of (true - stated)^2: the terms of one are dependent.
    """

    terms: Floats
    stated: Floats
    true: Floats
    squared: Floats

    @classmethod
    def of(cls, probability: Floats, true: NDArray[np.bool_]) -> Curve:
        """One realisation's."""
        inside = np.eye(BINS)[bin_of(probability)]
        stated, number = probability @ inside, true @ inside
        return cls(inside.sum(axis=0), stated, number, (number - stated) ** 2)

    def __add__(self, other: Curve) -> Curve:
        return Curve(
            self.terms + other.terms, self.stated + other.stated, self.true + other.true, self.squared + other.squared
        )


def study_problem(system: str, states: str, seed: int, index: int) -> tuple[Gram, NDArray[np.bool_]]:
    """Gram of the training rows, and which terms are true: with raw states the study's own realisation.

    Parameters
    ----------
    system : str
        One of `STUDY_SYSTEMS`.
    states : "raw" or "clean"
        Noise on all channels, or on the acceleration only.
    seed, index : int
        Of the study, and the number of the realisation.
    """
    config, known = StudyConfig(seed=seed), get_system(system)
    record = simulate(
        known,
        n=config.train_rows + config.test_rows,
        seed=(seed, STUDY_SYSTEMS.index(system), index),
        noise=STATES[states],
        perturb=config.perturb,
    )
    terms = build_dictionary(config.dictionary, Variables(("x", "v"), ("u",)))
    names = [term.text for term in terms]
    train = {name: record[name][: config.train_rows] for name in ("x", "v", "u")}
    gram = Gram.from_data(evaluate_terms(terms, train), record["a"][: config.train_rows], names)
    return gram, np.array([name in known.terms["a"] for name in names])


def _batch(system: str, states: str, seed: int, start: int, stop: int) -> dict[str, Curve]:
    """Curves of both methods under the paper's prior."""
    total: dict[str, Curve] = {}
    for index in range(start, stop):
        gram, true = study_problem(system, states, seed, index)
        standard = gram.standardise().gram
        for name, fit in (("bma", spike_slab_bma(standard, Prior())), ("vb", spike_slab_vb(standard, Prior()))):
            curve = Curve.of(fit.pip, true)
            total[name] = total[name] + curve if name in total else curve
    return total


Curves = dict[tuple[str, str, str], Curve]


def reliability(realisations: int = 1000, seed: int = 0, jobs: int = 2) -> Curves:
    """The curve of each (states, system, method), and of the system "all"; the same for any number of `jobs`."""
    from joblib import Parallel, delayed

    parts = [
        (system, states, seed, start, min(start + BATCH, realisations))
        for states in STATES
        for system in STUDY_SYSTEMS
        for start in range(0, realisations, BATCH)
    ]
    curves: Curves = {}
    progress, done = Progress(), 0
    with Parallel(n_jobs=jobs, inner_max_num_threads=1, backend="loky", return_as="generator") as pool:
        for part, answer in zip(parts, pool(delayed(_batch)(*p) for p in parts), strict=True):
            for method, curve in answer.items():
                for system in (part[0], "all"):
                    key = part[1], system, method
                    curves[key] = curves[key] + curve if key in curves else curve
            done += part[4] - part[3]
            progress("realisations", done, len(STATES) * len(STUDY_SYSTEMS) * realisations)
    progress.close()
    return curves


def table(curves: Curves) -> list[dict[str, object]]:
    """A line per states, system, method and bin that is not empty."""
    return [
        {
            "states": states,
            "system": system,
            "method": method,
            "bin": f"{k / BINS:.1f}-{(k + 1) / BINS:.1f}",
            "terms": round(curve.terms[k]),
            "stated": f"{curve.stated[k] / curve.terms[k]:.5f}",
            "true": f"{curve.true[k] / curve.terms[k]:.5f}",
            "se": f"{math.sqrt(curve.squared[k]) / curve.terms[k]:.5f}",
        }
        for states in STATES
        for system in (*STUDY_SYSTEMS, "all")
        for method in METHODS
        for curve in (curves[states, system, method],)
        for k in np.flatnonzero(curve.terms)
    ]


def draw_reliability(curves: Curves) -> Figure:
    """Share of true terms against the stated probability, systems across, raw and clean states down."""
    figure, axes = new_panels(2, len(STUDY_SYSTEMS), height=HEIGHT, sharex=True, sharey=True)
    handles: list[Any] = []
    for row, (states, label) in enumerate((("raw", "noise on all channels"), ("clean", "clean states"))):
        for column, system in enumerate(STUDY_SYSTEMS):
            ax = axes[row, column]
            handles = _panel(ax, {method: curves[states, system, method] for method in METHODS})
            ax.set_title(f"({chr(97 + len(STUDY_SYSTEMS) * row + column)}) {TITLES[system]}")
            if column == 0:
                ax.set_ylabel(f"{label}\nshare of true terms", linespacing=1.5)
            if row == 1:
                ax.set_xlabel("stated probability")
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _panel(ax: Axes, curves: Mapping[str, Curve]) -> list[Any]:
    """One system; returns what the legend explains."""
    handles: list[Any] = [*ax.plot([0, 1], [0, 1], color=BLACK, linewidth=0.5, label="as stated")]
    words = ["false among those above 0.9:"]
    for k, (method, (marker, colour, symbol, label)) in enumerate(LOOKS.items()):
        curve = curves[method]
        at = np.flatnonzero(curve.terms >= LEAST_DRAWN)
        n = curve.terms[at]
        stated, true = curve.stated[at] / n, curve.true[at] / n
        reach = 2.0 * np.sqrt(curve.squared[at]) / n
        ends = np.stack([np.minimum(reach, true), np.minimum(reach, 1.0 - true)])
        handles.append(
            ax.errorbar(stated, true, ends, fmt=marker, color=colour, markersize=3.5, elinewidth=0.8, label=label)
        )
        handles[-1].lines[0].set_zorder(4 - k)
        if curve.terms[-1]:
            false = 100.0 * (1.0 - np.array([curve.true[-1], curve.stated[-1]]) / curve.terms[-1])
            words.append(f"{symbol}: {false[0]:.1f} % ({false[1]:.1f} % stated)")
    ax.text(0.03, 0.98, "\n".join(words), va="top", fontsize=7, transform=ax.transAxes, linespacing=1.3)
    ax.set_xlim(-MARGIN, 1.0 + MARGIN)
    ax.set_ylim(-MARGIN, CEILING)
    ax.set_xticks([0.0, 0.5, 1.0])
    ax.set_yticks([0.0, 0.5, 1.0])
    return handles


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output, and the figure."""
    import argparse

    parser = argparse.ArgumentParser(description="Reliability of stated probabilities on the paper's oscillators.")
    parser.add_argument("--realisations", type=int, default=1000, help="of each system")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--figures", type=Path, help="folder for reliability.png and .svg")
    given = parser.parse_args(arguments)
    curves = reliability(given.realisations, given.seed, given.jobs)
    print_table(table(curves))
    if given.figures is not None:
        with style():
            save(draw_reliability(curves), given.figures / "reliability")


if __name__ == "__main__":
    main()
