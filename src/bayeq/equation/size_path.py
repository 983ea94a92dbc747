"""`ParsimonyPath`: the best model of each size, to see where more terms stop to pay."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayeq.figures.size_path import Elbow, draw_paths
from bayeq.figures.style import style
from bayeq.figures.write import by_target, require_suffix, write_output
from bayeq.gram import Gram, Standardised
from bayeq.inference.collapsed.conditional import exact_posterior
from bayeq.inference.collapsed.path import (
    DEFAULT_MOST,
    best_of_each_size,
    model_log_posterior,
    partial_shares,
)
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.prior import Prior

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["ParsimonyPath", "parsimony_path", "percent", "require_writable", "write_paths"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# By default a path goes at least so many terms beyond the chosen equation.
BEYOND = 3


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
    r2 : (K,) array
        Share of the target's variance explained on the training rows.
    held_out_r2 : (K,) array or None
        The same on the rows held out.
    chosen : (P,) bool array
        The terms of the equation that the path belongs to. It need not lie on the path: the terms that are each
        likelier in than out may not make the likeliest model of their number.
    chosen_log_evidence, chosen_r2, chosen_held_out_r2 : float, float, float or None
        Its evidence and fit.
    share : (P,) array
        What R2 loses on the training rows when a term is left out of the equation and the others are refitted by least
        squares; NaN for a term that is not in it.
    """

    target: str
    names: tuple[str, ...]
    models: Bools
    coef: Floats
    intercept: Floats
    log_evidence: Floats
    r2: Floats
    held_out_r2: Floats | None
    chosen: Bools
    chosen_log_evidence: float
    chosen_r2: float
    chosen_held_out_r2: float | None
    share: Floats

    @property
    def size(self) -> NDArray[np.int64]:
        """Number of terms of each model, (K,)."""
        return self.models.sum(axis=1)

    @property
    def is_chosen(self) -> Bools:
        """Which of the models is the equation, (K,); none if it is off the path."""
        same: Bools = (self.models == self.chosen).all(axis=1)
        return same

    def added(self, k: int) -> tuple[str, ...]:
        """Terms of model k that the model before it lacks."""
        before = self.models[k - 1] if k else np.zeros(len(self.names), dtype=np.bool_)
        return self._named(self.models[k] & ~before)

    def removed(self, k: int) -> tuple[str, ...]:
        """Terms of the model before model k that it lacks."""
        return self._named(self.models[k - 1] & ~self.models[k]) if k else ()

    def with_fit(self, r2: float, held_out_r2: float | None) -> ParsimonyPath:
        """The path with all errors and shares relative to a target of which the equation explains so much.

        Equalities between coefficients leave the errors of a regression as they are, and change what they are a share
        of.
        """
        ratio = (1.0 - r2) / (1.0 - self.chosen_r2) if self.chosen_r2 < 1.0 else 1.0
        path = replace(self, r2=1.0 - ratio * (1.0 - self.r2), chosen_r2=r2, share=ratio * self.share)
        if held_out_r2 is None or self.held_out_r2 is None or self.chosen_held_out_r2 is None:
            return path
        ratio = (1.0 - held_out_r2) / (1.0 - self.chosen_held_out_r2) if self.chosen_held_out_r2 < 1.0 else 1.0
        return replace(path, held_out_r2=1.0 - ratio * (1.0 - self.held_out_r2), chosen_held_out_r2=held_out_r2)

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

        held_out = np.full(len(self.models), np.nan) if self.held_out_r2 is None else self.held_out_r2
        rows = range(len(self.models))
        return pd.DataFrame(
            {
                "size": self.size,
                "added": [", ".join(self.added(k)) for k in rows],
                "removed": [", ".join(self.removed(k)) for k in rows],
                "log_evidence": self.log_evidence,
                "r2": self.r2,
                "nrmse": np.sqrt(1.0 - self.r2),
                "held_out_r2": held_out,
                "held_out_nrmse": np.sqrt(1.0 - held_out),
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
        return _figure({"": self})

    def __str__(self) -> str:
        """The elbow in print: a line per size, an arrow at the chosen equation."""
        best = float(self.log_evidence.max())
        lines = [f"{self.target}: best model of each size; evidence in nats below the best"]
        lines.append(f"{'terms':>7} {'evidence':>11} {'training':>9} {'held-out':>9}  against the line above")
        chosen = self.is_chosen
        for k, size in enumerate(self.size):
            lines.append(
                f"{'->' if chosen[k] else '':2}{size:5} {self.log_evidence[k] - best:11.1f}"
                f" {_error(self.r2[k])} {_error(None if self.held_out_r2 is None else self.held_out_r2[k])}"
                f"  {_steps(self.added(k), self.removed(k))}".rstrip()
            )
        if not chosen.any():
            lines.append(
                f"{'->':2}{int(self.chosen.sum()):5} {self.chosen_log_evidence - best:11.1f} {_error(self.chosen_r2)}"
                f" {_error(self.chosen_held_out_r2)}  the equation: {', '.join(self._named(self.chosen)) or 'no terms'}"
            )
        lines.append("errors: RMS over the standard deviation of the target")
        if self.chosen.any():
            order = sorted(np.flatnonzero(self.chosen), key=lambda j: -self.share[j])
            shares = ", ".join(f"{self.names[j]} {percent(self.share[j])}" for j in order)
            lines.append(f"variance that the fit loses without a term: {shares}")
        return "\n".join(lines)

    def _elbow(self, title: str) -> Elbow:
        return Elbow(
            title=title,
            size=self.size,
            steps=tuple((self.added(k), self.removed(k)) for k in range(len(self.models))),
            symbols=tuple(dict.fromkeys(re.findall(r"[^\W\d]\w*", " ".join(self.names)))),
            log_evidence=self.log_evidence,
            error=np.sqrt(1.0 - self.r2),
            held_out=None if self.held_out_r2 is None else np.sqrt(1.0 - self.held_out_r2),
            chosen=(
                int(self.chosen.sum()),
                self.chosen_log_evidence,
                float(np.sqrt(1.0 - self.chosen_r2)),
                None if self.chosen_held_out_r2 is None else float(np.sqrt(1.0 - self.chosen_held_out_r2)),
            ),
        )


def percent(share: float) -> str:
    """A share of variance as a percentage of two significant digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"


def _error(r2: float | None) -> str:
    if r2 is None:
        return " " * 9
    value = 100.0 * np.sqrt(1.0 - r2)
    text = f"{value:.1f}" if value >= 10 else f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"
    return f"{text:>7} %"


def _steps(added: Sequence[str], removed: Sequence[str]) -> str:
    return " ".join([*(f"+ {name}" for name in added), *(f"- {name}" for name in removed)])


def parsimony_path(
    target: str,
    standard: Standardised,
    prior: Prior,
    chosen: Bools,
    rows: Gram,
    held_out: Gram | None = None,
    most: int | None = None,
) -> ParsimonyPath:
    """The path of one regression.

    Parameters
    ----------
    target : str
        Left-hand side.
    standard : Standardised
        Statistics that models are compared on, and the way back to original units.
    prior : Prior
        On standardised columns.
    chosen : (P,) bool array
        The terms of the equation.
    rows, held_out : Gram
        Statistics of the training rows and of those held out, in original units, which fits are judged on.
    most : int, optional
        Largest size; by default 12, or three more than the equation has.

    Raises
    ------
    InputError
        `most` is less than the number of forced terms.
    """
    problem = Problem.of(standard.gram, prior)
    if most is None:
        most = max(DEFAULT_MOST, int(chosen.sum()) + BEYOND)
    found = best_of_each_size(problem, most, [chosen])
    models = np.array([model for model, _ in found])
    coef = np.array([exact_posterior(problem, model)[0] for model in (*models, chosen)])
    coef *= standard.target_scale / standard.scale
    intercept = standard.source.target_mean - coef @ standard.source.mean
    r2 = np.array([_r2(rows, theta, b0) for theta, b0 in zip(coef, intercept, strict=True)])
    tested = None if held_out is None else [_r2(held_out, theta, b0) for theta, b0 in zip(coef, intercept, strict=True)]
    jacobian = standard.source.dof * float(np.log(standard.target_scale))
    return ParsimonyPath(
        target=target,
        names=tuple(standard.gram.names),
        models=models,
        coef=coef[:-1],
        intercept=intercept[:-1],
        log_evidence=np.array([value for _, value in found]) - jacobian,
        r2=r2[:-1],
        held_out_r2=None if tested is None else np.array(tested[:-1]),
        chosen=chosen,
        chosen_log_evidence=model_log_posterior(problem, chosen) - jacobian,
        chosen_r2=float(r2[-1]),
        chosen_held_out_r2=None if tested is None else tested[-1],
        share=partial_shares(rows, chosen),
    )


def _r2(gram: Gram, coef: Floats, intercept: float) -> float:
    return 1.0 - gram.squared_error(coef, intercept) / gram.yty if gram.yty > 0 else 0.0


def _figure(paths: Mapping[str, ParsimonyPath]) -> Figure:
    with style():
        figure = draw_paths([path._elbow(title) for title, path in paths.items()])
        figure.draw_without_rendering()  # what is made on drawing is made in this style
    return figure


def require_writable(file: Path) -> None:
    """Check that `write_paths` can make such a file, before anything is computed for it.

    Raises
    ------
    InputError
        A suffix that is not known.
    MissingExtraError
        matplotlib is needed and not installed.
    """
    require_suffix(file, "a path of equations is")


def write_paths(file: Path, paths: Mapping[str, ParsimonyPath]) -> None:
    """Write a table (.csv), or a figure, of the paths of one or several equations.

    Parameters
    ----------
    file : Path
        The suffix says what to write.
    paths : mapping of str to ParsimonyPath
        By the target of the equation.

    Raises
    ------
    InputError, MissingExtraError
        As `require_writable`.
    """
    require_writable(file)
    write_output(
        file,
        lambda: by_target({target: path.table() for target, path in paths.items()}),
        lambda: _figure(paths),
    )
