"""All realisations of a study, in parallel, continued where an earlier run was stopped.

Workers compute, the parent alone writes. A realisation depends on nothing but the configuration, its system and
its index, so that neither the number of workers, nor the batches, nor a kill changes a result. Several runs on one
store share what is missing: each claims a batch before it computes it.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from bayeq.errors import BayeqError
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

# Batches that wait for each worker.
AHEAD = 3

# How often it is looked whether others have done what they claimed [s].
LOOK = 0.5

# How often a worker looks whether its parent is alive [s].
WATCH = 0.5

# More is a mistake of typing.
MAX_REALISATIONS = 100_000
MAX_JOBS = 512


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
    with Store.create(store, config) as file, Claims(Path(store)) as claims, _one_thread():
        file.plan(systems, algorithms, realisations)
        done = failures = 0
        size = None if batch is None else whole("batch", batch, 1)
        while tasks := _missing(file, systems, algorithms, realisations):
            if size is None:
                size = _batch_size(config, tasks, jobs if cluster is None else cluster.threads)
            total, before = done + len(tasks), done
            batches = claims.batches(tasks, size)
            with closing(_compute(config, batches, min(jobs, -(-len(tasks) // size)), Path(store), cluster)) as answers:
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


@contextmanager
def _one_thread() -> Iterator[None]:
    """BLAS in this process with one thread, as in the workers, so that sums are rounded alike."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield


def _compute(
    config: StudyConfig, batches: Iterator[Batch], jobs: int, store: Path, cluster: Cluster | None
) -> Generator[list[Result]]:
    """Results of each batch, in the order in which they are ready."""
    if cluster is not None:
        yield from cluster.unordered(partial(_work, config), ((batch,) for batch in batches))
        return
    if jobs == 1:
        for batch in batches:
            yield _work(config, batch)
        return
    from joblib import Parallel, delayed, parallel_config

    with parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(
            n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch=AHEAD * jobs, max_nbytes=None
        )
    hook = threading.excepthook
    threading.excepthook = partial(_thread_failed, hook)
    try:
        with _born_quiet():
            answers = parallel(delayed(_work)(config, batch, os.getpid()) for batch in batches)
        try:
            for results in answers:  # noqa: UP028 - `yield from` would close it before the warning is silenced
                yield results
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "generator was not exhausted": it is meant not to be
                answers.close()
    except BrokenProcessPool:
        raise BayeqError(
            f"a worker process was killed (out of memory?); what was done is in {store}: the same command continues,"
            " fewer jobs need less memory"
        ) from None
    finally:
        threading.excepthook = hook


def _thread_failed(hook: Callable[[threading.ExceptHookArgs], object], failure: threading.ExceptHookArgs) -> None:
    """Report an exception in a thread, unless it is loky's manager that finds its queue taken away when stopped."""
    name = failure.thread.name if failure.thread is not None else ""
    if not (name.startswith("ExecutorManager") and issubclass(failure.exc_type, KeyError)):
        hook(failure)


@contextmanager
def _born_quiet() -> Iterator[None]:
    """Processes started here inherit that Ctrl-C is for the parent alone, and say nothing of what a stop leaves."""
    warned = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (warned, "ignore:resource_tracker")))
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)
        if warned is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = warned


def _work(config: StudyConfig, batch: Batch, parent: int | None = None) -> list[Result]:
    """A batch, in a worker (whose parent is given) or in this process."""
    if parent is not None:
        _watch(parent)
    results = []
    for task in batch:
        _warm(config, task.algorithms)
        results.extend(realise(config, task))
    return results


@lru_cache(maxsize=64)
def _warm(config: StudyConfig, algorithms: tuple[str, ...]) -> None:
    """Load what is loaded at the first call, so that it is not counted as an algorithm's time."""
    realise(config, Task(STUDY_SYSTEMS[0], 0, algorithms))


@lru_cache(maxsize=1)
def _watch(parent: int) -> None:
    """End this worker soon after its parent has been killed, instead of waiting for work for minutes."""

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=look, daemon=True, name="watch-parent").start()
