"""All realisations of a study, in parallel, continued where an earlier run was stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from bayeq.errors import whole_number
from bayeq.resumable.store import Key
from bayeq.resumable.workers import AHEAD, MAX_JOBS, fill
from bayeq.streaming.cluster import Cluster
from bayeq.study.config import DEFAULT_ALGORITHMS, STUDY_SYSTEMS, StudyConfig, choose
from bayeq.study.realise import ALGORITHMS, Task, realise
from bayeq.study.store import Result, Store

# Work that is sent to a worker at a time [s], and realisations at most: a kill loses no more than this.
BATCH_SECONDS = 0.25
LARGEST_BATCH = 64

# More is a mistake of typing.
MAX_REALISATIONS = 100_000


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run did."""

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
    """Run a Monte Carlo study, or what is missing of it.

    The store is an SQLite file, made if it is not there, to which further systems, algorithms and realisations of each
    system may be added later. Without `config` it is the paper's protocol with seed 0. `jobs` processes compute, with 1
    this process alone, or the workers of a Dask `client`; a worker does as many realisations at a time as take a
    quarter of a second, or a `batch`. `progress` is called with (realisations done, these and the missing ones).

    InputError for a name or number that cannot be used, or a store of another configuration; BayeqError where a worker
    process was killed. What was done before KeyboardInterrupt is in the store.
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
        done = failures = 0
        work = partial(_work, config)
        with closing(fill(file, missing, work, jobs, size, _tasks, _realisations, cluster)) as answers:
            for results, done, total in answers:
                file.add(results)
                failures += sum(r.failure is not None for r in results)
                if progress is not None:
                    progress(done, total)
    return Outcome(done, failures, time.monotonic() - started)


def _tasks(keys: Sequence[Key]) -> tuple[Task, ...]:
    """The realisations of consecutive keys."""
    groups = groupby(keys, key=lambda key: key[:2])
    return tuple(Task(system, index, tuple(key[2] for key in group)) for (system, index), group in groups)


def _realisations(results: Sequence[Result]) -> int:
    return len({(r.system, r.index) for r in results})


def _per_batch(config: StudyConfig, task: Task) -> int:
    """Realisations per batch, from the time that one takes; compiles the kernels, or fills their cache, too."""
    _warm(config, task.algorithms)
    start = time.perf_counter()
    realise(config, task)
    return int(BATCH_SECONDS / (time.perf_counter() - start))


def _work(config: StudyConfig, batch: Sequence[Task]) -> list[Result]:
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
