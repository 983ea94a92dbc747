"""The peers, and the table of all contestants: dictionary matrix in, coefficients and selected terms out.

A peer is used as its documentation says, with its defaults unless stated; what it needs beforehand (columns of zero
mean and unit variance) is part of its fit. A package is imported where it is used.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from perf import ours
from perf.ours import BURN_IN, SAMPLES
from perf.problems import SYSTEMS, Case, Fitted

__all__ = ["CONTESTANTS", "Contestant"]

Floats = NDArray[np.float64]

# Thresholds and penalties that are tried where a peer leaves their choice to the user, who takes the least extended
# BIC: the plain one fails with more columns than rows.
THRESHOLDS = 20
PENALTIES = 50


Fit = Callable[[Floats, Floats, float], Fitted]


@dataclass(frozen=True, slots=True)
class Contestant:
    """A row of the table.

    Attributes
    ----------
    name, title : str
        What one types, and what the tables show.
    fit : callable
        ``fit(D, y, p0) -> Fitted``.
    package : str
        Module that must be there.
    apart : bool
        Whether it always gets a process of its own, since it brings a runtime with threads of its own.
    only : tuple of str
        The cases in which it takes part; empty for all.
    """

    name: str
    title: str
    fit: Fit
    package: str = "bayeq"
    apart: bool = False
    only: tuple[str, ...] = ()

    @property
    def ours(self) -> bool:
        """Whether it is part of bayeq."""
        return self.package == "bayeq"

    @property
    def installed(self) -> bool:
        """Whether its package is there."""
        return find_spec(self.package) is not None

    def takes_part(self, case: Case) -> bool:
        """Whether it is run on a case."""
        return not self.only or case.name in self.only

    def __call__(self, D: Floats, y: Floats, p0: float) -> Fitted:
        """Fit, whatever it warns of (not having converged shows in the result)."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return self.fit(D, y, p0)


def _standardised(D: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Columns and target of zero mean and unit variance, and the factors that restore coefficients."""
    Z = D - D.mean(axis=0)
    scale = np.sqrt(np.einsum("ij,ij->j", Z, Z) / len(Z))
    Z /= scale
    t = y - y.mean()
    sd = float(t.std())
    t /= sd
    return Z, t, sd / scale


def _nonzero(coef: Floats, unit: Floats | float = 1.0) -> Fitted:
    coef = np.ravel(coef)
    return Fitted(coef * unit, coef != 0.0)


def _least_ebic(Z: Floats, t: Floats, candidates: list[Floats]) -> Floats:
    """Of the candidate coefficients those with the least extended BIC (Chen and Chen 2008, gamma = 1)."""
    n, columns = Z.shape

    def criterion(coef: Floats) -> float:
        kept = np.flatnonzero(coef)
        rest = t - Z[:, kept] @ coef[kept]
        return float(n * np.log(rest @ rest / n) + len(kept) * (np.log(n) + 2.0 * np.log(columns)))

    return min(candidates, key=criterion)


def _lstsq(D: Floats, y: Floats, p0: float) -> Fitted:
    del p0
    return _nonzero(np.linalg.lstsq(D, y, rcond=None)[0])


def _ard(D: Floats, y: Floats, p0: float) -> Fitted:
    from sklearn.linear_model import ARDRegression

    del p0
    Z, t, unit = _standardised(D, y)
    return _nonzero(ARDRegression().fit(Z, t).coef_, unit)


def _ard_raw(D: Floats, y: Floats, p0: float) -> Fitted:
    from sklearn.linear_model import ARDRegression

    del p0
    return _nonzero(ARDRegression().fit(D, y).coef_)


def _lasso(D: Floats, y: Floats, p0: float) -> Fitted:
    from sklearn.linear_model import LassoCV

    del p0
    Z, t, unit = _standardised(D, y)
    return _nonzero(LassoCV().fit(Z, t).coef_, unit)


def _pysindy_stlsq(D: Floats, y: Floats, p0: float) -> Fitted:
    import pysindy

    del p0
    Z, t, unit = _standardised(D, y)
    return _nonzero(pysindy.STLSQ().fit(Z, t[:, None]).coef_, unit)


def _pysindy_swept(D: Floats, y: Floats, p0: float) -> Fitted:
    import pysindy

    del p0
    Z, t, unit = _standardised(D, y)
    full = np.abs(np.ravel(pysindy.STLSQ(threshold=0.0).fit(Z, t[:, None]).coef_))
    thresholds = np.geomspace(full[full > 0].min(), full.max(), THRESHOLDS)
    candidates = [np.ravel(pysindy.STLSQ(threshold=value).fit(Z, t[:, None]).coef_) for value in thresholds]
    return _nonzero(_least_ebic(Z, t, candidates), unit)


def _pysindy_ssr(D: Floats, y: Floats, p0: float) -> Fitted:
    import pysindy

    del p0
    Z, t, unit = _standardised(D, y)
    # by default it ends after 20 terms have been dropped
    return _nonzero(pysindy.SSR(max_iter=Z.shape[1]).fit(Z, t[:, None]).coef_, unit)


def _pysindy_ensemble(D: Floats, y: Floats, p0: float) -> Fitted:
    import pysindy

    del p0
    Z, t, unit = _standardised(D, y)
    np.random.seed(0)  # noqa: NPY002 - PySINDy draws its bootstrap samples from NumPy's global state
    return _nonzero(pysindy.EnsembleOptimizer(pysindy.STLSQ(), bagging=True).fit(Z, t[:, None]).coef_, unit)


def _pysindy_sbr(D: Floats, y: Floats, p0: float) -> Fitted:
    """Selected are the terms whose central 95 % of the posterior draws leave out zero: a horseshoe has no zeros."""
    from pysindy.optimizers import SBR

    del p0
    Z, t, unit = _standardised(D, y)
    sampler = SBR(num_warmup=1000, num_samples=SAMPLES, mcmc_kwargs={"progress_bar": False}).fit(Z, t[:, None])
    draws = np.asarray(sampler.mcmc_.get_samples()["beta"], dtype=np.float64)[:, 0]
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    return Fitted(np.ravel(sampler.coef_) * unit, (low > 0.0) | (high < 0.0))


def _millipede(D: Floats, y: Floats, p0: float) -> Fitted:
    """The same prior as ours: tau = 1/v_s, S = p_0 P, and nearly the same prior of the noise."""
    import pandas as pd
    from millipede import NormalLikelihoodVariableSelector

    Z, t, unit = _standardised(D, y)
    frame = pd.DataFrame(np.column_stack([Z, t]), columns=[*(f"x{j}" for j in range(Z.shape[1])), "y"])
    selector = NormalLikelihoodVariableSelector(
        frame,
        "y",
        S=p0 * Z.shape[1],
        tau=0.1,
        include_intercept=False,
        nu0=2e-4,
        lambda0=1.0,
        precompute_XX=Z.shape[1] <= len(Z),
    )
    selector.run(T=SAMPLES, T_burnin=BURN_IN, verbosity=None, seed=0)
    return Fitted(selector.beta.to_numpy() * unit, selector.pip.to_numpy() > 0.5)


def _susie(D: Floats, y: Floats, p0: float) -> Fitted:
    import pysusie

    del p0
    fit = pysusie.susie(D, y)
    return Fitted(np.asarray(pysusie.coef_susie(fit))[1:], np.asarray(fit.pip) > 0.5)


def _abess(D: Floats, y: Floats, p0: float) -> Fitted:
    from abess.linear import LinearRegression

    del p0
    Z, t, unit = _standardised(D, y)
    return _nonzero(LinearRegression().fit(Z, t).coef_, unit)


def _skglm_mcp(D: Floats, y: Floats, p0: float) -> Fitted:
    from skglm import MCPRegression

    del p0
    Z, t, unit = _standardised(D, y)
    Z = np.asfortranarray(Z)
    penalties = float(np.abs(Z.T @ t).max()) / len(t) * np.geomspace(1.0, 1e-3, PENALTIES)
    path = MCPRegression(fit_intercept=False).path(Z, t, penalties)[1]
    return _nonzero(_least_ebic(Z, t, list(path.T)), unit)


CONTESTANTS: dict[str, Contestant] = {
    contestant.name: contestant
    for contestant in (
        Contestant("vb", "SpikeSlabVB", ours.vb),
        Contestant("bma", "SpikeSlabBMA", ours.bma),
        Contestant("auto", "engine auto", ours.auto),
        Contestant("gibbs", "SpikeSlabGibbs", ours.gibbs),
        Contestant("rvm", "RVM", ours.rvm),
        Contestant("stlsq", "STLSQ", ours.stlsq),
        Contestant("stlsq-swept", "STLSQ, swept", ours.swept_stlsq),
        Contestant("lstsq", "numpy.linalg.lstsq", _lstsq, "numpy"),
        Contestant("ard", "scikit-learn ARDRegression", _ard, "sklearn"),
        Contestant("ard-raw", "ARDRegression, raw columns", _ard_raw, "sklearn", only=SYSTEMS),
        Contestant("lasso", "scikit-learn LassoCV", _lasso, "sklearn"),
        Contestant("pysindy-stlsq", "PySINDy STLSQ", _pysindy_stlsq, "pysindy"),
        Contestant("pysindy-swept", "PySINDy STLSQ, swept", _pysindy_swept, "pysindy"),
        Contestant("pysindy-ssr", "PySINDy SSR", _pysindy_ssr, "pysindy"),
        Contestant("pysindy-ensemble", "PySINDy ensemble of STLSQ", _pysindy_ensemble, "pysindy"),
        Contestant("pysindy-sbr", "PySINDy SBR", _pysindy_sbr, "numpyro", apart=True, only=("duffing",)),
        Contestant("millipede", "millipede", _millipede, "millipede", apart=True),
        Contestant("susie", "pysusie", _susie, "pysusie"),
        Contestant("abess", "abess", _abess, "abess"),
        Contestant("mcp", "skglm MCP", _skglm_mcp, "skglm"),
    )
}
