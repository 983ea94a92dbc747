"""Realisations of the Monte Carlo study, each reproducible alone from (seed, system, index), and their store.

A new algorithm is a function and a row of `ALGORITHMS`. Its arguments are one realisation, with the training Gram in
original units, the held-out Gram (used by SINDy alone, to choose its threshold as the paper does) and the regression
that they come from; the configuration of the study; and its own seed. It returns a posterior in original units.
"""

from __future__ import annotations

import json
import math
import sqlite3
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, fields
from functools import lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from threadpoolctl import threadpool_limits

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import Variables, build_dictionary
from bayeq.discovery.streaming.cluster import Cluster
from bayeq.equation.selection.select import Rules, select
from bayeq.errors import InputError, one_line, whole_number
from bayeq.expressions import Expression
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.collapsed.slab import learned
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.gram import Gram, Standardised
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.stlsq import sweep_stlsq
from bayeq.inference.vb import spike_slab_vb
from bayeq.regression.constraints import parse_constraints
from bayeq.regression.design import build_design
from bayeq.regression.fit import fit_equations, record_of
from bayeq.regression.regression import Regression, regressions_of
from bayeq.resumable.store import AHEAD, MAX_JOBS, Key, ResultStore, fill
from bayeq.states import Roles, Smooth, estimate_motion, parse_chains
from bayeq.study.config import DEFAULT_ALGORITHMS, STUDY_SYSTEMS, StudyConfig, choose
from bayeq.systems import System, get_system, simulate

# Appended to (seed, system, index) in the seed of an algorithm: its random numbers differ from the simulation's.
ALGORITHM_STREAM = 1

LONGEST_MESSAGE = 300

Answer = TypeVar("Answer")


@dataclass(frozen=True, eq=False, slots=True)
class Realisation:
    """The data of one realisation."""

    regression: Regression  # on the training rows
    # Gram matrices of the regression, and of the test rows, in original units
    train: Gram
    test: Gram
    truth: Floats  # (P,), true coefficients of the candidate terms


Algorithm = Callable[[Realisation, StudyConfig, tuple[int, ...]], Posterior]


def posed(train: Gram, config: StudyConfig) -> tuple[Standardised, Prior]:
    """The standardised problem and its prior: the paper's, or on smoothed records the defaults of `bayeq.discover`.

    Smoothing raises the signal-to-noise ratio, for which the paper's slab is too narrow: its variance is then learned,
    and the noise prior applies in units of the residual.
    """
    prior = Prior(config.slab_variance, config.prior_inclusion, config.noise_shape, config.noise_rate)
    if config.smooth == "none":
        return train.standardise(), prior
    return learned(train, prior, config.slab_variance)


def _rvm(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Posterior:
    """Relevance vector machine; the selected terms are those left in the machine."""
    standard = data.train.standardise()
    return rvm(standard.gram).rescaled(standard)


def _gibbs(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Posterior:
    """SS-MCMC: the collapsed Gibbs sampler, eqs. (33)-(34), as in the paper without exchange steps."""
    standard, prior = posed(data.train, config)
    chains = {"chains": config.chains, "samples": config.samples, "burn_in": config.burn_in}
    posterior = spike_slab_gibbs(standard.gram, prior, **chains, exchange=False, seed=seed, keep_draws=False)
    return posterior.rescaled(standard)


def _auto(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Posterior:
    """The equation that `bayeq.discover` shows by default, with its prior, noise model and selection."""
    regression = data.regression
    free = parse_constraints((), regression.design.terms, [regression.chain.target])
    (fit,) = fit_equations([regression], free, "auto", seed=seed)
    (selection,) = select([fit], Rules(), regression.motion)
    return fit.expanded(selection.shown)


def _spike_slab(
    engine: Callable[..., Posterior], data: Realisation, config: StudyConfig, seed: tuple[int, ...]
) -> Posterior:
    """Run an engine without random numbers on standardised columns."""
    standard, prior = posed(data.train, config)
    return engine(standard.gram, prior).rescaled(standard)


ALGORITHMS: dict[str, Algorithm] = {
    # sequential threshold least squares, the threshold swept on the held-out error
    "sindy": lambda data, config, seed: sweep_stlsq(data.train, held_out=data.test, columns="raw"),
    "sindy-std": lambda data, config, seed: sweep_stlsq(data.train, held_out=data.test, columns="standardised"),
    "rvm": _rvm,
    "gibbs": _gibbs,
    "auto": _auto,
    "bma": partial(_spike_slab, spike_slab_bma),  # exact weights; selected is the median probability model
    "vb": partial(_spike_slab, spike_slab_vb),
    "vb-rvm": partial(_spike_slab, partial(spike_slab_vb, init="rvm")),  # as the paper's section 3.2 says
    # a search that adds and drops terms but never swaps them
    "vb-greedy": partial(_spike_slab, partial(spike_slab_vb, init="greedy")),
}


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
    """Run the algorithms of a task; a failure is a result too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # convergence is in the result
        data, failure = _tried(draw, config, task.system, task.index)
        results = []
        for name in task.algorithms:
            result = None
            if data is not None:
                result, failure = _tried(_run, config, task, name, data)
            results.append(result or Result(task.system, task.index, name, failure=failure))
    return results


def _tried(work: Callable[..., Answer], *arguments: Any) -> tuple[Answer | None, str | None]:
    """The result of `work`, or the text of its exception: one bad realisation does not end a study of thousands."""
    try:
        return work(*arguments), None
    except (MemoryError, ImportError):
        raise
    except Exception as error:  # noqa: BLE001
        return None, one_line(f"{type(error).__name__}: {error}")[:LONGEST_MESSAGE]


def _run(config: StudyConfig, task: Task, name: str, data: Realisation) -> Result:
    seed = (*_seed(config, task.system, task.index), ALGORITHM_STREAM)
    algorithm = ALGORITHMS[name]
    start = time.perf_counter()
    answer = algorithm(data, config, seed)
    seconds = time.perf_counter() - start
    metrics = measure(data.train, data.test, data.truth, answer.support, answer.coef)
    if not np.isfinite(astuple(metrics)).all():
        raise FloatingPointError("coefficients that are not finite")
    details = answer.details
    selected = tuple(data.train.names[j] for j in np.flatnonzero(answer.support))
    said = {name: value for name in ("elbo", "rhat") if (value := getattr(details, name)) is not None}
    extras = {"n_iter": int(details.n_iter)} | {k: float(value) for k, value in said.items() if math.isfinite(value)}
    return Result(task.system, task.index, name, metrics, seconds, selected, bool(details.converged), extras)


# (system, algorithm) -> number of requested realisations.
Plan = dict[tuple[str, str], int]


@dataclass(frozen=True, slots=True)
class Metrics:
    """The errors of section 4.1."""

    # ||S_D (theta_hat - theta)|| / ||S_D theta||, S_D the standard deviations of the training columns
    e_theta_scaled: float
    e_theta: float  # ||theta_hat - theta|| / ||theta||
    e_p: float  # ||y* - D* theta_hat|| / ||y*|| on the test rows
    fdr: float  # false terms among the selected ones; 0 if none is selected
    exact: bool  # exactly the true terms are selected
    superset: bool  # all true terms are selected


METRICS = tuple(f.name for f in fields(Metrics))


@dataclass(frozen=True, slots=True)
class Result:
    """A row of the store."""

    # the realisation, and the algorithm that ran on it
    system: str
    index: int
    algorithm: str
    metrics: Metrics | None = None  # None if it failed
    seconds: float | None = None  # wall time of the algorithm alone, from the Gram to the estimate
    selected: tuple[str, ...] = ()  # the selected terms
    converged: bool | None = None  # as the algorithm reports
    extras: Mapping[str, Any] = field(default_factory=dict)  # further numbers: n_iter, elbo, rhat
    failure: str | None = None  # type and message of the exception


def prediction_error(test: Gram, estimate: Floats) -> float:
    """e_p = ||y* - D* theta_hat|| / ||y*|| of uncentred test rows: centred moments plus n times products of means."""
    squares = test.yty + test.n * test.target_mean**2
    return math.sqrt(test.squared_error(estimate, intercept=0.0) / squares)


def measure(train: Gram, test: Gram, truth: Floats, support: Bools, coef: Floats) -> Metrics:
    """All metrics of an estimate (P,) in original units; InputError without a true term in the dictionary."""
    true = truth != 0
    if not true.any():
        raise InputError("the dictionary holds no true term: weight errors are not defined")
    scale, chosen = train.standard_deviation, int(np.count_nonzero(support))
    return Metrics(
        e_theta_scaled=_relative_error(scale * coef, scale * truth),
        e_theta=_relative_error(coef, truth),
        e_p=prediction_error(test, coef),
        fdr=int(np.count_nonzero(support & ~true)) / chosen if chosen else 0.0,
        exact=bool(np.array_equal(support, true)),
        superset=bool(np.all(support[true])),
    )


def _relative_error(estimate: Floats, truth: Floats) -> float:
    return float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))


class Store(ResultStore):
    """File of a study, opened to run it if a configuration is given, else to read it; `config` is the stored one.

    Raises InputError, with the keys that differ, for a file of another configuration; other errors as `ResultStore`.
    """

    application, noun = 0x62797173, "a study"  # "byqs"
    schema = (
        "CREATE TABLE config (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
        """CREATE TABLE plan (
            system TEXT NOT NULL, algorithm TEXT NOT NULL, realisations INTEGER NOT NULL,
            PRIMARY KEY (system, algorithm)) WITHOUT ROWID""",
        f"""CREATE TABLE results (
            system TEXT NOT NULL, idx INTEGER NOT NULL, algorithm TEXT NOT NULL,
            {", ".join(f"{name} REAL" for name in METRICS)},
            seconds REAL, selected TEXT NOT NULL, converged INTEGER, extras TEXT NOT NULL, failure TEXT,
            PRIMARY KEY (system, algorithm, idx)) WITHOUT ROWID""",
    )
    table, key, again = "results", {"system": "TEXT", "idx": "INTEGER", "algorithm": "TEXT"}, "IGNORE"

    def __init__(self, path: str | Path, config: StudyConfig | None = None, any_thread: bool = False) -> None:
        super().__init__(path, config is not None, any_thread)
        try:
            if config is not None:
                rows = [(key, json.dumps(value)) for key, value in asdict(config).items()]
                with self._transaction():
                    if not self._one("SELECT count(*) FROM config"):
                        self._connection.executemany("INSERT INTO config VALUES (?, ?)", rows)
            with self._guard():
                stored = self._read("SELECT key, value FROM config")
                if not stored:  # killed before the first commit
                    raise sqlite3.DatabaseError("no configuration")
                self.config: dict[str, Any] = {key: json.loads(value) for key, value in stored}
            if config is not None and (differences := config.differences(self.config)):
                raise InputError(
                    f"{self.path}: holds a study of another configuration: {'; '.join(differences)}; repeat that"
                    " study's options, or name another store"
                )
        except BaseException:
            self.close()
            raise

    def plan(self, systems: Sequence[str], algorithms: Sequence[str], realisations: int) -> None:
        """Store the number of requested realisations of each system and algorithm; a larger stored number stays."""
        self._write(
            "INSERT INTO plan VALUES (?, ?, ?) ON CONFLICT (system, algorithm) DO UPDATE"
            " SET realisations = max(realisations, excluded.realisations)",
            *((system, algorithm, realisations) for system in systems for algorithm in algorithms),
        )

    def planned(self) -> Plan:
        rows = self._read("SELECT system, algorithm, realisations FROM plan")
        return {(system, algorithm): int(count) for system, algorithm, count in rows}

    def missing(
        self, systems: Sequence[str], algorithms: Sequence[str], realisations: int
    ) -> list[list[tuple[str, int, str]]]:
        """Keys without a row, grouped by realisation; systems alternate."""
        there = set(self._read("SELECT system, idx, algorithm FROM results"))
        groups = (
            [key for name in algorithms if (key := (system, index, name)) not in there]
            for index in range(realisations)
            for system in systems
        )
        return [group for group in groups if group]

    def add(self, results: Iterable[Result]) -> None:
        """Write rows in one transaction; one that is there already stays."""
        self.put(_row(result) for result in results)

    def results(self) -> Iterator[Result]:
        """All rows, by system, algorithm and index."""
        with self._guard():
            yield from map(_result, self._connection.execute("SELECT * FROM results ORDER BY system, algorithm, idx"))


def _row(result: Result) -> tuple[Any, ...]:
    values = [None] * len(METRICS) if result.metrics is None else map(float, astuple(result.metrics))
    selected, extras = json.dumps(list(result.selected)), json.dumps(dict(result.extras), sort_keys=True)
    about = (result.system, result.index, result.algorithm)
    return (*about, *values, result.seconds, selected, result.converged, extras, result.failure)


def _result(row: tuple[Any, ...]) -> Result:
    system, index, algorithm, *values, seconds, selected, converged, extras, failure = row
    metrics = None
    if failure is None:
        scaled, error, predicted, fdr, exact, superset = map(float, values)
        metrics = Metrics(scaled, error, predicted, fdr, bool(exact), bool(superset))
    seconds, converged = None if seconds is None else float(seconds), None if converged is None else bool(converged)
    selected, extras = tuple(json.loads(selected)), json.loads(extras)
    return Result(str(system), int(index), str(algorithm), metrics, seconds, selected, converged, extras, failure)


# Duration [s] of a batch that is sent to a worker, and most realisations in it: a kill loses no more than this.
BATCH_SECONDS = 0.25
LARGEST_BATCH = 64

# Most realisations; a larger number is taken for a typing mistake.
MAX_REALISATIONS = 100_000


@dataclass(frozen=True, slots=True)
class Outcome:
    """Summary of a run."""

    realisations: int  # how many were computed (or completed by an algorithm) in this run
    failures: int  # algorithms that failed in this run
    seconds: float  # wall time


def run_study(
    store: str | Path,
    *,
    systems: Sequence[str] = STUDY_SYSTEMS,
    algorithms: Sequence[str] = DEFAULT_ALGORITHMS,
    realisations: int = 1000,
    jobs: int = 2,
    config: StudyConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
    batch: int | None = None,
    client: Any = None,
) -> Outcome:
    """Run a Monte Carlo study, or the realisations that its SQLite store lacks.

    They are computed by `jobs` processes (1: this process) or by the workers of a Dask `client`, in batches of `batch`
    realisations (default: about 0.25 s each). Systems, algorithms and realisations may be added later; without `config`
    it is the paper's protocol with seed 0. `progress` is called with (realisations done in this run, their total).
    InputError for bad arguments, or a store of another configuration; BayeqError if a worker was killed.
    """
    config = config or StudyConfig()
    config.validate()
    systems = choose("system", systems, STUDY_SYSTEMS)
    algorithms = choose("algorithm", algorithms, ALGORITHMS)
    whole_number("realisations", realisations, 1, MAX_REALISATIONS)
    whole_number("jobs", jobs, 1, MAX_JOBS)
    started = time.monotonic()
    cluster = None if client is None else Cluster(client)
    with Store(store, config) as file, threadpool_limits(1):
        file.plan(systems, algorithms, realisations)
        missing = partial(file.missing, systems, algorithms, realisations)
        size = 1 if batch is None else whole_number("batch", batch, 1)
        if batch is None and (groups := missing()):
            largest = len(groups) // (AHEAD * (jobs if cluster is None else cluster.threads))
            size = max(1, min(_per_batch(config, _tasks(groups[0])[0]), LARGEST_BATCH, largest))
        failures: list[Result] = []

        def keep(results: Sequence[Result]) -> None:
            file.add(results)
            failures.extend(r for r in results if r.failure is not None)

        def realisations_in(results: Sequence[Result]) -> int:
            return len({(r.system, r.index) for r in results})

        work = partial(_work, config)
        done = fill(file, missing, work, keep, jobs, size, _tasks, realisations_in, cluster, progress)
    return Outcome(done, len(failures), time.monotonic() - started)


def _tasks(keys: Sequence[Key]) -> tuple[Task, ...]:
    groups = groupby(keys, key=lambda key: key[:2])
    return tuple(Task(system, index, tuple(key[2] for key in group)) for (system, index), group in groups)


def _per_batch(config: StudyConfig, task: Task) -> int:
    """Realisations per batch, from the measured time of one; this also compiles the kernels, or fills their cache."""
    _warm(config, task.algorithms)
    start = time.perf_counter()
    realise(config, task)
    return int(BATCH_SECONDS / (time.perf_counter() - start))


def _work(config: StudyConfig, batch: Sequence[Task]) -> list[Result]:
    results = []
    for task in batch:
        _warm(config, task.algorithms)
        results.extend(realise(config, task))
    return results


@lru_cache(maxsize=64)
def _warm(config: StudyConfig, algorithms: tuple[str, ...]) -> None:
    """Run the algorithms once to load libraries and kernels, so that this does not count as an algorithm's time."""
    realise(config, Task(STUDY_SYSTEMS[0], 0, algorithms))
