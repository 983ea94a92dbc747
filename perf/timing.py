"""Side-by-side timing: the contestants take turns, so that a noisy machine is noisy for all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

__all__ = ["medians"]


def medians(contestants: Mapping[str, Callable[[], object]], rounds: int = 200, calls: int = 1) -> dict[str, float]:
    """Median seconds of each contestant's calls over `rounds` turns of some calls each, after a warm-up turn.

    With several calls in a turn most of them find the processor's caches as they left them, and not as the contestant
    before did.
    """
    for run in contestants.values():
        run()
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, run in contestants.items():
            for _ in range(calls):
                start = time.perf_counter()
                run()
                seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(times)) for name, times in seconds.items()}
