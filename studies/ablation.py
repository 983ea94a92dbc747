"""What the paper's SS-VB depends on: one factor changed at a time.

The paper starts VB from the RVM's gamma (section 3.2). Here that start is run by a literal NumPy transcription of
eqs. (20)-(28), and each variant changes one named factor of it: the start, the order or simultaneity of the
updates, eq. (28) as printed, the excitation, the noise, the prior. The table says how many realisations end in
exactly the true model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammaln, logit, xlogy

from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import greedy_model
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.vb import spike_slab_vb
from bayeq.study.config import STUDY_SYSTEMS
from bayeq.systems import BandLimitedForce, get_system, simulate
from studies.lines import print_table

__all__ = ["VARIANTS", "Variant", "literal_vb", "run_ablation"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

ROWS = 2000
MAX_SWEEPS = 500


@dataclass(frozen=True, slots=True)
class Variant:
    """One change of one factor.

    Attributes
    ----------
    factor, change : str
        What is changed, and to what.
    select : callable
        From the standardised Gram to the selected terms (P,).
    noise : float
        Noise ratio on every channel.
    force : callable or None
        Another excitation: from a generator to N samples.
    """

    factor: str
    change: str
    select: Callable[[Gram], Bools]
    noise: float = 0.05
    force: Callable[[np.random.Generator, int], Floats] | None = None


def literal_vb(
    gram: Gram,
    w: Floats,
    *,
    tau: float = 1000.0,
    v_s: float = 10.0,
    p0: float = 0.1,
    together: bool = False,
    printed_bound: bool = False,
    indicators_first: bool = False,
) -> Floats:
    """Eqs. (20)-(28) on full matrices; returns w.

    Parameters
    ----------
    gram : Gram
        Standardised.
    w, tau : (P,) array, float
        Start.
    v_s, p0 : float
        Prior; a_sigma = b_sigma = 1e-4.
    together : bool
        Update all w_i from the old ones, not one after another.
    printed_bound : bool
        Stop by eq. (28) with a ln Gamma(b), as it is printed, instead of a ln b.
    indicators_first : bool
        Update w before b and tau, not after the bound.
    """
    G, c, n = gram.DtD, gram.Dty, float(gram.n)
    terms = len(c)
    a = b = 1e-4
    shape = a + 0.5 * n + 0.5 * terms
    w, last = w.copy(), -math.inf
    bound: float
    for _ in range(MAX_SWEEPS):
        A = _system(G, w, v_s)
        inverse = np.asarray(np.linalg.inv(A), dtype=np.float64)
        mu, sigma = inverse @ (w * c), inverse / tau
        if indicators_first:
            w = _indicators(G, c, w, mu, sigma, tau, p0, together)
            A = _system(G, w, v_s)
        rate = float(b + 0.5 * (gram.yty - 2.0 * mu @ (w * c) + np.sum(A * (np.outer(mu, mu) + sigma))))
        tau = shape / rate
        bound = 0.5 * float(np.linalg.slogdet(sigma)[1]) - shape * (
            float(gammaln(rate)) if printed_bound else math.log(rate)
        )
        bound += float(np.sum(xlogy(w, p0) - xlogy(w, w) + xlogy(1 - w, 1 - p0) - xlogy(1 - w, 1 - w)))
        if bound - last < 1e-6:
            break
        last = bound
        if not indicators_first:
            w = _indicators(G, c, w, mu, sigma, tau, p0, together)
    return w


def _system(G: Floats, w: Floats, v_s: float) -> Floats:
    omega = np.outer(w, w)
    np.fill_diagonal(omega, w)
    return G * omega + np.eye(len(w)) / v_s


def _indicators(
    G: Floats, c: Floats, w: Floats, mu: Floats, sigma: Floats, tau: float, p0: float, together: bool
) -> Floats:
    """Eqs. (25)-(26)."""
    out = w.copy()
    for i in range(len(w)):
        weight = (w if together else out) * (mu * mu[i] + sigma[:, i])
        weight[i] = 0.0
        eta = logit(p0) - 0.5 * tau * (mu[i] ** 2 + sigma[i, i]) * G[i, i] + tau * (mu[i] * c[i] - G[i] @ weight)
        out[i] = expit(eta)
    return out


def _from_rvm(**options: Any) -> Callable[[Gram], Bools]:
    return lambda gram: literal_vb(gram, rvm(gram).pip, **options) > 0.5


def _unit_target(gram: Gram) -> Bools:
    sd = math.sqrt(gram.yty / gram.n)
    return _from_rvm()(gram.standardise(sd).gram)


def _no_transient_filter(rng: np.random.Generator, n: int) -> Floats:
    """White noise through an eighth-order Butterworth low-pass at 100 Hz, std 50: a band without sharp edges."""
    from scipy.signal import butter, sosfilt

    settle = 1000
    filtered = sosfilt(butter(8, 100.0, fs=1000.0, output="sos"), rng.normal(size=n + settle))[settle:]
    return np.asarray(50.0 * filtered / filtered.std())


def _greedy(gram: Gram) -> Bools:
    start = greedy_model(Problem.of(gram, Prior())).astype(np.float64)
    return spike_slab_vb(gram, init=start).support


def _start(w: Callable[[Gram], Floats]) -> Callable[[Gram], Bools]:
    return lambda gram: literal_vb(gram, w(gram)) > 0.5


VARIANTS: tuple[Variant, ...] = (
    Variant("none", "the paper's: RVM start, eqs. (20)-(28) with a ln b", _from_rvm()),
    Variant("start", "search on (34), several starts, highest ELBO", lambda g: spike_slab_vb(g).support),
    Variant("start", "greedy search on (34) that adds and drops but never swaps", _greedy),
    Variant("start", "all terms, w = 1", _start(lambda g: np.ones(len(g.names)))),
    Variant("start", "w = 0.5", _start(lambda g: np.full(len(g.names), 0.5))),
    Variant("start", "no ascent: the RVM's terms with gamma > 0.5", lambda g: rvm(g, least_gamma=0.5).support),
    Variant("eq. (28)", "as printed, a ln Gamma(b)", _from_rvm(printed_bound=True)),
    Variant("updates", "all w_i together", _from_rvm(together=True)),
    Variant("updates", "w before b and tau", _from_rvm(indicators_first=True)),
    Variant("excitation", "Butterworth low-pass at 100 Hz", _from_rvm(), force=_no_transient_filter),
    Variant("noise", "1 % instead of 5 %", _from_rvm(), noise=0.01),
    Variant("prior", "y scaled to unit variance", _unit_target),
    Variant("prior", "v_s = 1000", lambda g: literal_vb(g, rvm(g).pip, v_s=1000.0) > 0.5),
    Variant("prior", "p_0 = 0.01", lambda g: literal_vb(g, rvm(g).pip, p0=0.01) > 0.5),
    Variant("search", "v_s = 1000", lambda g: spike_slab_vb(g, Prior(slab_variance=1000.0)).support),
    Variant("search", "p_0 = 0.01", lambda g: spike_slab_vb(g, Prior(prior_inclusion=0.01)).support),
    Variant("search", "Butterworth low-pass", lambda g: spike_slab_vb(g).support, force=_no_transient_filter),
    Variant("search", "noise 1 %", lambda g: spike_slab_vb(g).support, noise=0.01),
)


def _realise(system: str, variant: Variant, seed: tuple[int, ...]) -> tuple[Gram, frozenset[str]]:
    """Standardised Gram of the training rows in the paper's convention, and the true terms."""
    known = get_system(system)
    force = None
    if variant.force is not None:
        assert isinstance(known.force, BandLimitedForce)
        force = variant.force(np.random.default_rng([*seed, 1]), 2 * ROWS)
    record = simulate(system, n=2 * ROWS, seed=seed, noise=variant.noise, perturb=0.1, force=force)
    terms = build_dictionary("oscillator", Variables(("x", "v"), ("u",)))
    D = evaluate_terms(terms, record.channels)[:ROWS]
    gram = Gram.from_data(D, record["a"][:ROWS], [term.text for term in terms]).standardise().gram
    return gram.with_dof(gram.n), frozenset(known.terms["a"])


def _cell(system: str, variant: Variant, seed: int, realisations: int) -> tuple[int, float]:
    exact, false = 0, 0.0
    for index in range(realisations):
        gram, true = _realise(system, variant, (seed, STUDY_SYSTEMS.index(system), index))
        support = variant.select(gram)
        chosen = {name for name, kept in zip(gram.names, support, strict=True) if kept}
        exact += chosen == true
        false += len(chosen - true) / max(len(chosen), 1)
    return exact, false


def run_ablation(realisations: int = 200, seed: int = 0, jobs: int = 2) -> Iterator[Mapping[str, object]]:
    """Rows (factor, change, and per system the exact rate and the FDR), variant by variant.

    Parameters
    ----------
    realisations : int
        Of each system; the same ones for every variant.
    seed : int
        Seed of the realisations.
    jobs : int
        Worker processes; the results do not depend on it.
    """
    from joblib import Parallel, delayed

    with Parallel(n_jobs=jobs, inner_max_num_threads=1, backend="loky") as pool:
        for k in range(len(VARIANTS)):
            cells = pool(delayed(_indexed_cell)(system, k, seed, realisations) for system in STUDY_SYSTEMS)
            row: dict[str, object] = {"factor": VARIANTS[k].factor, "change": VARIANTS[k].change}
            for system, (exact, false) in zip(STUDY_SYSTEMS, cells, strict=True):
                row[f"{system}_exact"] = f"{exact / realisations:.3f}"
                row[f"{system}_fdr"] = f"{false / realisations:.3f}"
            yield row


def _indexed_cell(system: str, variant: int, seed: int, realisations: int) -> tuple[int, float]:
    """A variant by its number: functions made on the fly do not travel to workers."""
    return _cell(system, VARIANTS[variant], seed, realisations)


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output."""
    import argparse

    parser = argparse.ArgumentParser(description="One factor of the paper's SS-VB changed at a time.")
    parser.add_argument("--realisations", type=int, default=200, help="realisations of each system")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes; the results do not depend on it")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    print_table(run_ablation(given.realisations, given.seed, given.jobs))


if __name__ == "__main__":
    main()
