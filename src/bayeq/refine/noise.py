"""Levels of noise, of channels and unseen forces, by maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Noise", "likeliest_noise"]

Floats = NDArray[np.float64]

# Unseen forces have samples from the largest allowed down to this share of them; so many levels are tried at first.
LEAST_UNSEEN = 1e-6
TRIED = 12

# Steps at most, the relative change of the log likelihood at which they end, and the step of its derivatives by the
# logarithms of variances: large against rounding.
MOST_STEPS = 40
ENOUGH = 1e-8
DIFFERENCE = 1e-4


@dataclass(frozen=True, eq=False)
class Noise:
    """Levels of noise.

    Attributes
    ----------
    channels : (m,) array
        Variance of each channel's noise.
    unseen : (K,) array
        Variance of samples of the unseen force in each equation.
    """

    channels: Floats
    unseen: Floats


def likeliest_noise(
    cost: Callable[[Noise], float],
    left: Sequence[Floats],
    floor: Floats,
    largest: Floats,
    samples: int,
    near: Noise | None = None,
) -> Noise:
    """Levels of noise that make records likeliest.

    Parameters
    ----------
    cost : callable
        -2 log likelihood, from `filter_run`.
    left : sequence of (m,) arrays
        Root mean squares of what free runs leave of the channels: long ones, which unseen forces have driven away, and
        short ones, which they have not.
    floor : (m,) array
        Least noise of the channels.
    largest : (K,) array
        Of unseen forces, as standard deviations.
    samples : int
        How many there are; the cost is of about that size.
    near : Noise, optional
        Levels to start from.
    """
    from scipy.optimize import minimize

    lowest = 2.0 * np.log(np.maximum(floor, 1e-150))
    starts = [np.maximum(2.0 * np.log(np.maximum(rms, 1e-150)), lowest) for rms in left]
    high = 2.0 * np.log(largest)
    low = high + 2.0 * math.log(LEAST_UNSEEN)
    m = len(floor)

    def levels(unknown: Floats) -> Noise:
        return Noise(np.exp(unknown[:m]), np.exp(unknown[m:]))

    def objective(unknown: Floats) -> float:
        value = cost(levels(unknown))
        return value / samples if math.isfinite(value) else 1e300

    if near is None:
        shares = np.linspace(0.0, 1.0, TRIED)
        tried = [np.concatenate([start, low + share * (high - low)]) for start in starts for share in shares]
        first = min(tried, key=objective)
    else:
        first = np.log(np.concatenate([near.channels, near.unseen]))
    above = np.max(starts, axis=0) + 1.0
    bounds = list(zip(np.concatenate([lowest, low]), np.concatenate([above, high]), strict=True))
    first = np.clip(first, *np.array(bounds).T)
    found = minimize(
        objective,
        first,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": MOST_STEPS, "ftol": ENOUGH, "gtol": 0.0, "eps": DIFFERENCE},
    )
    return levels(np.asarray(found.x if found.fun <= objective(first) else first))
