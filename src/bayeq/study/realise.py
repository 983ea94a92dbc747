"""One realisation of the Monte Carlo study, reproducible alone from (study seed, system, index)."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np

from bayeq.dictionary import Variables, build_dictionary
from bayeq.expressions import Expression
from bayeq.regression.by_likelihood import regressions_of
from bayeq.regression.design import build_design
from bayeq.regression.joint import record_of
from bayeq.states import Roles, Smooth, estimate_motion, parse_chains
from bayeq.study.algorithms import ALGORITHMS, Realisation
from bayeq.study.config import STUDY_SYSTEMS, StudyConfig
from bayeq.study.metrics import Result, measure
from bayeq.systems import System, get_system, simulate

__all__ = ["Realisation", "Task", "draw", "realise"]

# Behind (seed, system, index) in the seed of an algorithm, so that its random numbers are not the simulation's.
ALGORITHM_STREAM = 1

LONGEST_MESSAGE = 300


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
    """Simulate one realisation and form its Gram matrices.

    Parameters
    ----------
    config : StudyConfig
        The study.
    system : str
        One of `STUDY_SYSTEMS`.
    index : int
        Number of the realisation.
    """
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
        extras=dict(answer.extras),
    )


def _message(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST_MESSAGE]
