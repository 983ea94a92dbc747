"""``fill``: what a store lacks is computed by worker processes and kept as it is ready.

Ctrl-C stops without noise, and a kill leaves no workers.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

from bayeq.errors import BayeqError
from bayeq.posix import POSIX, interrupts_later
from bayeq.resumable.store import Claims, Key, ResultStore

Task = TypeVar("Task")
Answer = TypeVar("Answer")

# Tasks that wait for each worker.
AHEAD = 3

# How often a worker looks whether its parent is alive [s].
WATCH = 0.5

# How often it is looked whether other processes have done what they claimed [s].
LOOK = 0.5

# More is a mistake of typing.
MAX_JOBS = 512


def fill(
    store: ResultStore,
    missing: Callable[[], Sequence[Sequence[Key]]],
    work: Callable[[Any], Answer],
    jobs: int = 1,
    size: int = 1,
    tasks: Callable[[Sequence[Key]], Any] = tuple,
    count: Callable[[Answer], int] = lambda answer: 1,
    cluster: Any = None,
) -> Generator[tuple[Answer, int, int], None, None]:
    """Compute the results that a store lacks; the caller puts each answer into it.

    A result depends on nothing but its key, so that neither the number of workers, nor batches, nor a kill changes it;
    several processes may fill a store. `missing` gives the keys that it lacks now, in groups that are computed
    together, and is asked until there are none. `tasks` turns the keys of `size` groups into a task, `work` a task
    into its answer, and `count` gives the number of groups in an answer. Tasks and answers are sent between processes:
    `jobs` of them compute, with 1 this process alone, or else the workers of a `bayeq.streaming.cluster.Cluster`.

    Yields an answer as it is ready, the number of groups done, with it, and of these and what was missing when it was
    last looked.
    """
    done = 0
    with Claims(store) as claims:
        while groups := missing():
            before, total = done, done + len(groups)
            batches = ([key for group in groups[k : k + size] for key in group] for k in range(0, len(groups), size))
            todo = (tasks(free) for batch in batches if (free := claims.free(batch)))
            answers = (
                compute(work, todo, min(jobs, -(-len(groups) // size)), store.path)
                if cluster is None
                else cluster.unordered(work, todo)
            )
            with closing(answers):
                for answer in answers:
                    done += count(answer)
                    yield answer, done, total
            if done == before:  # others have claimed all of it
                time.sleep(LOOK)


def compute(
    work: Callable[[Task], Answer], tasks: Iterable[Task], jobs: int, store: Path
) -> Generator[Answer, None, None]:
    """The answer to each task, as it is ready; tasks are asked for as workers are free.

    With one job all is done in this process. BayeqError where a worker was killed, which names the store.
    """
    if jobs == 1:
        for task in tasks:
            yield work(task)
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
            answers = parallel(delayed(_in_worker)(work, task, os.getpid()) for task in tasks)
        try:
            for answer in answers:  # noqa: UP028 - `yield from` would close it before the warning is silenced
                yield answer
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


def _in_worker(work: Callable[[Task], Answer], task: Task, parent: int) -> Answer:
    _stop_with(parent)
    return work(task)


def _thread_failed(hook: Callable[[threading.ExceptHookArgs], object], failure: threading.ExceptHookArgs) -> None:
    """Report an exception in a thread, unless it is loky's manager that finds its queue taken away when stopped."""
    name = failure.thread.name if failure.thread is not None else ""
    if not (name.startswith("ExecutorManager") and issubclass(failure.exc_type, KeyError)):
        hook(failure)


@contextmanager
def _born_quiet() -> Iterator[None]:
    """Processes started here inherit that Ctrl-C is for the parent alone, and say nothing of what a stop leaves."""
    from multiprocessing.resource_tracker import ensure_running

    warned = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (warned, "ignore:resource_tracker")))
    try:
        if POSIX:
            ensure_running()  # which lets interrupts through at its end, in Python 3.11
        with interrupts_later():
            yield
    finally:
        if warned is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = warned


@lru_cache(maxsize=1)
def _stop_with(parent: int) -> None:
    """Leave Ctrl-C, which a terminal sends to all, to the parent; end soon after it has been killed, instead of waiting
    for work for minutes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=look, daemon=True, name="watch-parent").start()
