"""How even the steps of time are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.records.truth import FloatArray

# Steps that differ by a smaller share are the same: a sample of 6 per period is then wrong by 0.1 % of the amplitude.
EVEN = 1e-3


def is_step(time: FloatArray, step: float, tolerance: float = EVEN) -> NDArray[np.bool_]:
    """Which steps of time are `step` to a share `tolerance`, and the rounding of the times, (n - 1,)."""
    rounding = 4.0 * float(np.finfo(np.float64).eps) * float(np.abs(time).max(initial=0.0))
    return np.asarray(np.abs(np.diff(time) - step) <= tolerance * step + rounding)


def even_step(*times: FloatArray) -> float | None:
    """The step of even sampling, the same in all records; None of uneven steps, or where there is no step.

    Examples
    --------
    >>> even_step(np.array([0.0, 0.1, 0.2])), even_step(np.array([0.0, 0.1, 0.3]))
    (0.1, None)
    """
    count = sum(len(time) - 1 for time in times)
    if not count:
        return None
    # the mean step is less touched by the rounding of the times than any single one
    step = sum(float(time[-1] - time[0]) for time in times) / count
    return step if all(is_step(time, step).all() for time in times) else None
