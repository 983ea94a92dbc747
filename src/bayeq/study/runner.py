"""All realisations of a study, in parallel, continued where an earlier run was stopped.

Workers compute, the parent alone writes. A realisation depends on nothing but the configuration, its system and
its index, so that neither the number of workers, nor the batches, nor a kill changes a result. Several runs on one
store share what is missing: each claims a batch before it computes it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from bayeq.resumable.workers import AHEAD, MAX_JOBS, compute, one_thread
from bayeq.streaming.cluster import Cluster
from bayeq.study.algorithms import ALGORITHMS
from bayeq.study.claims import Claims
from bayeq.study.config import DEFAULT_ALGORITHMS, STUDY_SYSTEMS, StudyConfig, choose, whole
from bayeq.study.realise import Task, realise
from bayeq.study.result import Result
from bayeq.study.store import Store

__all__ = ["Outcome", "run_study"]

Batch = tuple[Task, ...]

# Work that is sent to a worker at a time [s], and realisations at most: a kill loses no more than this.
BATCH_SECONDS = 0.25
LARGEST_BATCH = 64

# How often it is looked whether others have done what they claimed [s].
LOOK = 0.5

# More is a mistake of typing.
MAX_REALISATIONS = 100_000


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run did.

    Attributes
    ----------
    realisations : int
        How many were computed (or completed by an algorithm) in this run.
    failures : int
        Algorithms that failed in this run.
    seconds : float
        Wall time.
    """

    realisations: int
    failures: int
    seconds: float


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
    """Run a Monte Carlo study, or what is missing of it.

    Parameters
    ----------
    store : path
        SQLite file; made if it is not there.
    systems, algorithms : sequence of str
        Of `STUDY_SYSTEMS` and `ALGORITHMS`; others may be added to the same store later.
    realisations : int
        Of each system; more may be added to the same store later.
    jobs : int
        Worker processes; with 1 all is done in this process.
    config : StudyConfig, optional
        By default the paper's protocol with seed 0.
    progress : callable, optional
        Called with (realisations done, these and the missing ones).
    batch : int, optional
        Realisations that a worker does at a time; by default as many as take a quarter of a second.
    client : dask.distributed.Client, optional
        A cluster whose workers compute, instead of `jobs` processes.

    Raises
    ------
    InputError
        A name or number that cannot be used, or a store of another configuration.
    BayeqError
        A worker process was killed.
    KeyboardInterrupt
        Stopped by the user; what was done is in the store.
    """
    config = config or StudyConfig()
    config.validate()
    systems = choose("system", systems, STUDY_SYSTEMS)
    algorithms = choose("algorithm", algorithms, ALGORITHMS)
    whole("realisations", realisations, 1, MAX_REALISATIONS)
    whole("jobs", jobs, 1, MAX_JOBS)
    started = time.monotonic()
    cluster = None if client is None else Cluster(client)
    with Store.create(store, config) as file, Claims(Path(store)) as claims, one_thread():
        file.plan(systems, algorithms, realisations)
        done = failures = 0
        size = None if batch is None else whole("batch", batch, 1)
        work = partial(_work, config)
        while tasks := _missing(file, systems, algorithms, realisations):
            if size is None:
                size = _batch_size(config, tasks, jobs if cluster is None else cluster.threads)
            total, before = done + len(tasks), done
            batches = claims.batches(tasks, size)
            answers = (
                compute(work, batches, min(jobs, -(-len(tasks) // size)), Path(store))
                if cluster is None
                else cluster.unordered(work, ((batch,) for batch in batches))
            )
            with closing(answers):
                for results in answers:
                    file.add(results)
                    done += len({(r.system, r.index) for r in results})
                    failures += sum(r.failure is not None for r in results)
                    if progress is not None:
                        progress(done, total)
            if done == before:  # others have claimed all of it
                time.sleep(LOOK)
    return Outcome(done, failures, time.monotonic() - started)


def _missing(store: Store, systems: Sequence[str], algorithms: tuple[str, ...], realisations: int) -> list[Task]:
    """What the store lacks, the systems side by side."""
    done = {system: store.done(system) for system in systems}
    tasks = []
    for index in range(realisations):
        for system in systems:
            have = done[system].get(index)
            lacking = algorithms if have is None else tuple(a for a in algorithms if a not in have)
            if lacking:
                tasks.append(Task(system, index, lacking))
    return tasks


def _batch_size(config: StudyConfig, tasks: Sequence[Task], jobs: int) -> int:
    """Realisations per batch, from the time that one takes; compiles the kernels, or fills their cache, too."""
    _warm(config, tasks[0].algorithms)
    start = time.perf_counter()
    realise(config, tasks[0])
    seconds = time.perf_counter() - start
    return max(1, min(int(BATCH_SECONDS / seconds), LARGEST_BATCH, len(tasks) // (AHEAD * jobs)))


def _work(config: StudyConfig, batch: Batch) -> list[Result]:
    """A batch, in a worker or in this process."""
    results = []
    for task in batch:
        _warm(config, task.algorithms)
        results.extend(realise(config, task))
    return results


@lru_cache(maxsize=64)
def _warm(config: StudyConfig, algorithms: tuple[str, ...]) -> None:
    """Load what is loaded at the first call, so that it is not counted as an algorithm's time."""
    realise(config, Task(STUDY_SYSTEMS[0], 0, algorithms))
