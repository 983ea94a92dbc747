"""`Coarsening`: how far the PIPs hang on every row counting in full."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.errors import InputError
from bayeq.figures.sensitivity import draw_coarsening
from bayeq.figures.style import require_matplotlib, style
from bayeq.gram import Gram
from bayeq.inference.auto import MOST_LEFT_OUT
from bayeq.inference.bma import average_models
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.prior import Prior

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Coarsening", "coarsening"]

Floats = NDArray[np.float64]

# Powers of the likelihood by default: each row counts as one, half of one ...
POWERS = 2.0 ** -np.arange(0.0, 13.0)

# A regression needs as many rows, coarsened.
LEAST_ROWS = 5.0


@dataclass(frozen=True, eq=False)
class Coarsening:
    """PIPs by model averaging with the likelihood raised to a power (Miller and Dunson 2019).

    Attributes
    ----------
    names : tuple of str
        The P candidate terms.
    power : (K,) array
        Descending. 1 is the likelihood that the equation was found with, which counts rows for what they are worth.
    rows : (K,) array
        Rows that the data then count for.
    pip : (K, P) array
        Posterior inclusion probabilities.
    left_out : (K,) array
        Posterior mass of models that were not listed, an estimate that errs upwards.
    """

    names: tuple[str, ...]
    power: Floats
    rows: Floats
    pip: Floats
    left_out: Floats

    def table(self) -> pd.DataFrame:
        """coarsen, rows, term, pip, left_out."""
        import pandas as pd

        terms = len(self.names)
        return pd.DataFrame(
            {
                "coarsen": np.repeat(self.power, terms),
                "rows": np.repeat(self.rows, terms),
                "term": list(self.names) * len(self.power),
                "pip": self.pip.ravel(),
                "left_out": np.repeat(self.left_out, terms),
            }
        )

    def plot(self) -> Figure:
        """PIPs against the power.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        require_matplotlib()
        with style():
            figure = draw_coarsening(self.names, self.power, self.pip, self.left_out <= MOST_LEFT_OUT)
            figure.draw_without_rendering()  # what is made on drawing is made in this style
        return figure

    def __str__(self) -> str:
        """Which terms are included down to which power, a line each."""
        lines = [f"included (PIP > 0.5) as the likelihood is raised to powers from 1 to {self.power[-1]:.2g}:"]
        inside = self.pip > 0.5
        for j in np.argsort(-inside.sum(axis=0), kind="stable"):
            powers = self.power[inside[:, j]]
            if len(powers) == len(self.power):
                lines.append(f"{self.names[j]}: always")
            elif len(powers):
                lines.append(f"{self.names[j]}: {powers[0]:.3g} to {powers[-1]:.3g}")
        return "\n".join(lines)


def coarsening(gram: Gram, prior: Prior, powers: ArrayLike | None = None) -> Coarsening:
    """PIPs as each row counts for less.

    Parameters
    ----------
    gram : Gram
        Standardised.
    prior : Prior
        On standardised columns, as it was used.
    powers : sequence of float, optional
        Above 0 and at most 1; by default halved from 1 to 1/4096, as far as 5 rows are left.

    Raises
    ------
    InputError
        Powers out of range.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> D = rng.normal(size=(500, 3))
    >>> y = D[:, 0] + 0.3 * D[:, 1] + rng.normal(size=500)
    >>> gram = Gram.from_data(D, y, names=("x", "v", "u")).standardise().gram
    >>> print(coarsening(gram, Prior(), [1.0, 0.5, 0.01]))
    included (PIP > 0.5) as the likelihood is raised to powers from 1 to 0.01:
    x: 1 to 0.5
    v: 1 to 1
    """
    given = POWERS if powers is None else np.unique(np.atleast_1d(np.asarray(powers, dtype=np.float64)))[::-1]
    if given.ndim != 1 or not len(given) or not ((given > 0.0) & (given <= 1.0)).all():
        raise InputError("powers of the likelihood must be above 0 and at most 1")
    kept = given[(given == given.max()) | (given * gram.n >= LEAST_ROWS)]
    pip, left_out = np.empty((len(kept), len(gram.names))), np.empty(len(kept))
    for k, power in enumerate(kept):
        found = average_models(Problem.of(gram.raised(float(power)), prior))
        pip[k], left_out[k] = np.minimum(found.weights @ found.models, 1.0), found.left_out
    return Coarsening(tuple(gram.names), kept, kept * gram.n, pip, left_out)
