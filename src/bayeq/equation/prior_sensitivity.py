"""`PriorSensitivity`: how far the PIPs, and with them the answer, hang on the prior."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.errors import ConvergenceWarning, InputError
from bayeq.figures.sensitivity import PipCurves, draw_sensitivity
from bayeq.figures.style import style
from bayeq.figures.write import by_target, require_suffix, write_output
from bayeq.gram import GramLike
from bayeq.inference import ENGINES
from bayeq.inference.auto import MOST_LEFT_OUT
from bayeq.inference.prior import Prior
from bayeq.inference.sensitivity import inclusion_axis, pip_grid, slab_axis

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["PriorSensitivity", "prior_sensitivity", "require_spike_slab", "require_writable", "write_sensitivity"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PriorSensitivity:
    """Posterior inclusion probabilities (PIPs) by model averaging under priors of other v_s and p_0.

    Attributes
    ----------
    names : tuple of str
        The P candidate terms.
    slab_variance : (V,) array
        Values of v_s, ascending.
    prior_inclusion : (Q,) array
        Values of p_0, ascending. Where terms have p_0 of their own, the log-odds of all are shifted by the same amount,
        and this is the probability of their mean; where p_0 ~ Beta(a, b), it is a/(a + b), and a + b stays. Terms
        forced in or kept out remain so.
    base : (int, int)
        Where the prior that was used stands among them.
    pip : (V, Q, P) array
        NaN at pairs that were not computed (see `prior_sensitivity`).
    left_out : (V, Q) array
        Posterior mass of models that were not listed, an estimate that errs upwards: a PIP is off by no more. NaN at
        pairs that were not computed.
    """

    names: tuple[str, ...]
    slab_variance: Floats
    prior_inclusion: Floats
    base: tuple[int, int]
    pip: Floats
    left_out: Floats

    @property
    def listed(self) -> NDArray[np.bool_]:
        """Pairs that were computed and where the models listed hold at least 98 % of the posterior mass, (V, Q)."""
        return self.left_out <= MOST_LEFT_OUT

    def table(self) -> pd.DataFrame:
        """All PIPs computed: slab_variance, prior_inclusion, term, pip, left_out."""
        import pandas as pd

        v, q = np.nonzero(np.isfinite(self.left_out))
        terms = len(self.names)
        return pd.DataFrame(
            {
                "slab_variance": np.repeat(self.slab_variance[v], terms),
                "prior_inclusion": np.repeat(self.prior_inclusion[q], terms),
                "term": list(self.names) * len(v),
                "pip": self.pip[v, q].ravel(),
                "left_out": np.repeat(self.left_out[v, q], terms),
            }
        )

    def changes(self) -> pd.DataFrame:
        """Terms that some of the priors include (PIP > 0.5) and others do not.

        Pairs that are not `listed` do not count.

        Returns
        -------
        DataFrame
            ``term``, ``pip`` under the prior used (NaN if it is not `listed`), ``lowest`` and ``highest`` PIP; the
            widest range first.
        """
        import pandas as pd

        low, high = self._range()
        chosen = np.flatnonzero(self._changing())
        chosen = chosen[np.argsort(low[chosen] - high[chosen], kind="stable")]
        return pd.DataFrame(
            {
                "term": [self.names[j] for j in chosen],
                "pip": np.where(self.listed[self.base], self.pip[self.base], np.nan)[chosen],
                "lowest": low[chosen],
                "highest": high[chosen],
            }
        )

    def plot(self) -> Figure:
        """PIPs against v_s at the p_0 used, and against p_0 at the v_s used.

        Shown are the terms included by the prior used and those whose PIP exceeds 0.05 along either curve. Those of
        `changes` stand out; a term may change at a pair off both curves (``every_pair``).

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        return _figure({"": self})

    def __str__(self) -> str:
        """What changes and what does not, in a few lines."""
        v, q = self.base
        computed = np.isfinite(self.left_out)
        low, high = self._range()
        # without any that is listed, low is 1 and high 0
        always = [self.names[j] for j in np.flatnonzero((low > 0.5) & (high > 0.5))]
        changing = [
            f"{c.term} (PIP {c.pip:.2f}, {c.lowest:.2f} to {c.highest:.2f})" for c in self.changes().itertuples()
        ]
        lines = [
            f"{int(computed.sum())} priors: v_s {self.slab_variance[0]:.3g} to {self.slab_variance[-1]:.3g}"
            f" (used: {self.slab_variance[v]:.3g}), p_0 {self.prior_inclusion[0]:.3g} to {self.prior_inclusion[-1]:.3g}"
            f" (used: {self.prior_inclusion[q]:.3g})",
            f"included by all: {', '.join(always) or 'none'}",
            f"included by some: {', '.join(changing) or 'none'}",
        ]
        if missing := int((computed & ~self.listed).sum()):
            lines.append(f"not counted: {missing} priors under which too many models share the posterior mass")
        return "\n".join(lines)

    def _range(self) -> tuple[Floats, Floats]:
        """Least and greatest PIP of each term where models were listed."""
        pip = self.pip[self.listed]
        return pip.min(axis=0, initial=1.0), pip.max(axis=0, initial=0.0)

    def _changing(self) -> NDArray[np.bool_]:
        low, high = self._range()
        return (low <= 0.5) & (high > 0.5)

    def _curves(self, title: str) -> PipCurves:
        v, q = self.base
        return PipCurves(
            title=title,
            terms=self.names,
            changing=self._changing(),
            base=(float(self.slab_variance[v]), float(self.prior_inclusion[q])),
            used=self.pip[v, q],
            axes=(self.slab_variance, self.prior_inclusion),
            pip=(self.pip[:, q], self.pip[v]),
            listed=(self.listed[:, q], self.listed[v]),
        )


def prior_sensitivity(
    gram: GramLike,
    prior: Prior,
    slab_variances: ArrayLike | None = None,
    prior_inclusions: ArrayLike | None = None,
    *,
    every_pair: bool = False,
    tolerance: float = 5e-3,
) -> PriorSensitivity:
    """PIPs by model averaging as v_s and p_0 vary about a prior.

    Parameters
    ----------
    gram : GramLike
        Sufficient statistics, standardised.
    prior : Prior
        The prior used; its v_s and p_0 are added to the values where they are not among them.
    slab_variances : sequence of float, optional
        v_s; by default nine values from a hundredth to a hundred times the prior's, but not below 0.1.
    prior_inclusions : sequence of float, optional
        p_0 of terms neither forced nor forbidden; by default 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5.
    every_pair : bool
        Compute all pairs. By default one of the two varies while the other is the prior's: the curves of the figure.
        Pairs of a small v_s with a large p_0 cost most, a second or more each, for very many models share the
        posterior mass there.
    tolerance : float
        Posterior mass that the averaging may leave out.

    Raises
    ------
    InputError
        Values out of range, or every term forced or forbidden.

    Warns
    -----
    ConvergenceWarning
        Under the prior itself too many models share the posterior mass to list them.

    Examples
    --------
    >>> import numpy as np
    >>> from bayeq.gram import Gram
    >>> rng = np.random.default_rng(1)
    >>> D = rng.normal(size=(50, 3))
    >>> gram = Gram.from_data(D, D[:, 0] + 0.3 * D[:, 1] + rng.normal(size=50), names=("x", "v", "u"))
    >>> print(prior_sensitivity(gram.standardise().gram, Prior()))
    15 priors: v_s 0.1 to 1e+03 (used: 10), p_0 0.01 to 0.5 (used: 0.1)
    included by all: x
    included by some: v (PIP 0.77, 0.23 to 0.97)
    """
    slabs, v = slab_axis(prior, slab_variances)
    inclusions, q = inclusion_axis(prior, len(gram.names), prior_inclusions)
    wanted = np.full((len(slabs), len(inclusions)), every_pair)
    wanted[v], wanted[:, q] = True, True
    pip, left_out = pip_grid(gram, prior, slabs, inclusions, wanted, tolerance=tolerance)
    if left_out[v, q] > MOST_LEFT_OUT:
        warnings.warn(
            f"too many models share the posterior mass to list them: PIPs are averages over models that hold about"
            f" {100 * (1 - left_out[v, q]):.0f} % of it; see left_out",
            ConvergenceWarning,
            stacklevel=3,
        )
    return PriorSensitivity(tuple(gram.names), slabs, inclusions, (v, q), pip, left_out)


def _figure(results: Mapping[str, PriorSensitivity]) -> Figure:
    with style():
        figure = draw_sensitivity([result._curves(title) for title, result in results.items()])
        figure.draw_without_rendering()  # what is made on drawing is made in this style
    return figure


def require_spike_slab(method: str) -> None:
    """Check that a method has a v_s and a p_0.

    Raises
    ------
    InputError
        It has none; the message says which methods have.
    """
    if not ENGINES[method].spike_slab:
        known = ", ".join(name for name, engine in ENGINES.items() if engine.spike_slab)
        raise InputError(f"method {method!r} has no v_s and p_0 to vary; take one of: {known}")


def require_writable(path: Path) -> None:
    """Check that `write_sensitivity` can make such a file, before anything is computed for it.

    Raises
    ------
    InputError
        A suffix that is not known.
    MissingExtraError
        matplotlib is needed and not installed.
    """
    require_suffix(path, "a sensitivity is written to")


def write_sensitivity(path: Path, results: Mapping[str, PriorSensitivity]) -> None:
    """Write a table (.csv), or a figure, of the sensitivities of one or several equations.

    Parameters
    ----------
    path : Path
        The suffix says what to write.
    results : mapping of str to PriorSensitivity
        By the target of the equation.

    Raises
    ------
    InputError, MissingExtraError
        As `require_writable`.
    """
    require_writable(path)
    write_output(
        path,
        lambda: by_target({target: result.table() for target, result in results.items()}),
        lambda: _figure(results),
    )
