"""One realisation of the Monte Carlo study, reproducible alone from (study seed, system, index), and what runs on it.

The algorithms are a table: a new one is a function and a row of `ALGORITHMS`. Each sees one realisation: the training
Gram in original units, the held-out Gram (only SINDy looks at it, to choose its threshold as the paper does) and the
regression that they come from; the study's numbers; and a seed of its own. It answers in original units.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Literal, cast

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import Variables, build_dictionary
from bayeq.errors import one_line
from bayeq.expressions import Expression
from bayeq.gram import Gram, Standardised
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.stlsq import sweep_stlsq
from bayeq.inference.vb import spike_slab_vb
from bayeq.regression.by_likelihood import regressions_of
from bayeq.regression.constraints import parse_constraints
from bayeq.regression.design import build_design
from bayeq.regression.joint import fit_equations, record_of
from bayeq.regression.regression import Regression
from bayeq.selection.select import Rules, select
from bayeq.states import Roles, Smooth, estimate_motion, parse_chains
from bayeq.study.config import STUDY_SYSTEMS, StudyConfig
from bayeq.study.store import Result, measure
from bayeq.systems import System, get_system, simulate

# Behind (seed, system, index) in the seed of an algorithm, so that its random numbers are not the simulation's.
ALGORITHM_STREAM = 1

LONGEST_MESSAGE = 300


@dataclass(frozen=True, slots=True)
class Realisation:
    """The data of one realisation."""

    regression: Regression  # of the first rows
    # what counts as data of the first rows, and the last rows, in original units
    train: Gram
    test: Gram
    truth: Floats  # (P,), true coefficients of the candidate terms


Algorithm = Callable[[Realisation, StudyConfig, tuple[int, ...]], Posterior]


def _posed(train: Gram, config: StudyConfig) -> tuple[Standardised, Prior]:
    """The standardised problem and its prior: the paper's, or on smoothed records the defaults of `bayeq.discover`.

    Smoothing raises the signal-to-noise ratio, for which the paper's slab is too narrow: its variance is then learned,
    and the noise prior applies in units of the residual.
    """
    prior = Prior(config.slab_variance, config.prior_inclusion, config.noise_shape, config.noise_rate)
    if config.smooth == "none":
        return train.standardise(), prior
    standard = train.standardise(residual_scale(train))
    return standard, replace(prior, slab_variance=learn_slab_variance(standard.gram, prior, config.slab_variance))


def _sindy(
    columns: Literal["raw", "standardised"], data: Realisation, config: StudyConfig, seed: tuple[int, ...]
) -> Posterior:
    """Sequential threshold least squares, its threshold on raw or standardised columns swept on the held-out error."""
    return sweep_stlsq(data.train, held_out=data.test, columns=columns)


def _rvm(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Posterior:
    """Relevance vector machine; selected is what is left in the machine."""
    standard = data.train.standardise()
    return rvm(standard.gram).rescaled(standard)


def _gibbs(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Posterior:
    """SS-MCMC: the collapsed Gibbs sampler, eqs. (33)-(34), as in the paper without exchange steps."""
    standard, prior = _posed(data.train, config)
    chains = {"chains": config.chains, "samples": config.samples, "burn_in": config.burn_in}
    posterior = spike_slab_gibbs(standard.gram, prior, **chains, exchange=False, seed=seed, keep_draws=False)
    return posterior.rescaled(standard)


def _auto(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Posterior:
    """What `bayeq.discover` shows by default: its prior, its noise model and its selection."""
    regression = data.regression
    free = parse_constraints((), regression.design.terms, [regression.chain.target])
    (fit,) = fit_equations([regression], free, "auto", seed=seed)
    (selection,) = select([fit], Rules(), regression.motion)
    return fit.expanded(selection.shown)


def _bma(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Posterior:
    """Model averaging with exact weights; selected is the median probability model."""
    standard, prior = _posed(data.train, config)
    return spike_slab_bma(standard.gram, prior).rescaled(standard)


def _vb(
    init: Literal["search", "greedy", "rvm"], data: Realisation, config: StudyConfig, seed: tuple[int, ...]
) -> Posterior:
    """SS-VB, from one start or several."""
    standard, prior = _posed(data.train, config)
    return spike_slab_vb(standard.gram, prior, init=init).rescaled(standard)


ALGORITHMS: dict[str, Algorithm] = {
    "sindy": partial(_sindy, "raw"),
    "sindy-std": partial(_sindy, "standardised"),
    "rvm": _rvm,
    "gibbs": _gibbs,
    "auto": _auto,
    "bma": _bma,
    "vb": partial(_vb, "search"),
    "vb-rvm": partial(_vb, "rvm"),  # as the paper's section 3.2 says
    "vb-greedy": partial(_vb, "greedy"),  # a search that adds and drops terms but never swaps them
}


# --- a realisation ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Task:
    """A realisation and the algorithms that are to run on it."""

    system: str
    index: int
    algorithms: tuple[str, ...]


@lru_cache(maxsize=32)
def _terms(dictionary: str, variables: Variables) -> tuple[Expression, ...]:
    return build_dictionary(dictionary, variables)


def _seed(config: StudyConfig, system: str, index: int) -> tuple[int, int, int]:
    return config.seed, STUDY_SYSTEMS.index(system), index


def draw(config: StudyConfig, system: str, index: int) -> Realisation:
    """Simulate a realisation, by its number, of one of `STUDY_SYSTEMS`, and form its Gram matrices."""
    known: System = get_system(system)
    record = simulate(
        known,
        n=config.train_rows + config.test_rows,
        seed=_seed(config, system, index),
        noise=config.noise,
        perturb=config.perturb,
    )
    roles = Roles(parse_chains(known.chains), known.inputs)
    terms = _terms(config.dictionary, Variables(roles.states, roles.inputs))
    # half a row more, so that rounding down leaves the number of test rows
    share = (config.test_rows + 0.5) / record.n
    design = build_design(terms, estimate_motion([record], roles, cast(Smooth, config.smooth), share))
    (regression,) = regressions_of(design, record_of(design, config.smooth, config.dictionary))
    assert record.truth is not None
    true = record.truth.coefficients[roles.targets[0]]
    if absent := [term for term in true if term not in design.names]:
        raise ValueError(f"the dictionary lacks the true term {', '.join(absent)}")
    truth = np.array([true.get(name, 0.0) for name in design.names])
    return Realisation(regression, regression.gram, design.held_out[0], truth)


def realise(config: StudyConfig, task: Task) -> list[Result]:
    """Run the algorithms of a task; what fails is a result too.

    Only running out of memory, a package that is missing, and the user stop it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what they say, not having converged, is in the result
        try:
            data = draw(config, task.system, task.index)
        except (MemoryError, ImportError):
            raise
        except Exception as error:  # noqa: BLE001 - one bad realisation must not end a study of thousands
            failure = _message(error)
            return [Result(task.system, task.index, name, failure=failure) for name in task.algorithms]
        return [_run(config, task, name, data) for name in task.algorithms]


def _run(config: StudyConfig, task: Task, name: str, data: Realisation) -> Result:
    """One algorithm on one realisation, timed."""
    seed = (*_seed(config, task.system, task.index), ALGORITHM_STREAM)
    algorithm = ALGORITHMS[name]
    try:
        start = time.perf_counter()
        answer = algorithm(data, config, seed)
        seconds = time.perf_counter() - start
        metrics = measure(data.train, data.test, data.truth, answer.support, answer.coef)
        if not metrics.finite:
            raise FloatingPointError("coefficients that are not finite")
    except (MemoryError, ImportError):
        raise
    except Exception as error:  # noqa: BLE001 - as above: recorded with its type and message
        return Result(task.system, task.index, name, failure=_message(error))
    return Result(
        system=task.system,
        index=task.index,
        algorithm=name,
        metrics=metrics,
        seconds=seconds,
        selected=tuple(data.train.names[j] for j in np.flatnonzero(answer.support)),
        converged=bool(answer.converged),
        extras=_extras(answer),
    )


def _extras(posterior: Posterior) -> dict[str, Any]:
    """What else an algorithm says, as plain numbers."""
    found = {name: getattr(posterior, name) for name in ("elbo", "rhat")}
    known = {name: float(value) for name, value in found.items() if value is not None and math.isfinite(value)}
    return {"n_iter": int(posterior.n_iter), **known}


def _message(error: Exception) -> str:
    return one_line(f"{type(error).__name__}: {error}")[:LONGEST_MESSAGE]
