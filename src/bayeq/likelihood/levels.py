"""`Levels`: sizes of everything random in a record, as numbers without constraints that a search can move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.likelihood.adjoint import Adjoint
from bayeq.likelihood.filter import Noise
from bayeq.likelihood.layout import Layout
from bayeq.likelihood.linear import Linear
from bayeq.numerics.settings import LIKELIHOOD

# Bounds: of noise and discrepancy as shares of the variance of channel and target, and of what the course of an input
# errs by, as a share of what it bends.
LEAST_NOISE, MOST_NOISE = 1e-10, 1e2
MOST_DISCREPANCY, MOST_POSSIBLE = 1e2, 1e1
LEAST_COURSE = 1e-6

# Standard deviation of the offset that a drift begins with, as a share of the channel's.
DRIFT_OFFSET = 0.5

# What a search moves, in this order.
PARTS = ("channels", "discrepancy", "memory", "slope", "courses", "drifts")

# The likelihood is about as sharp in the size of an input's steps as this share of its samples makes it. On a small
# discrepancy it may carry anywhere from no information to that of all samples: their geometric mean is taken.
STEP_SHARPNESS = 0.25


@dataclass(frozen=True, eq=False)
class Scales:
    """Units in which levels are stated."""

    mean: Floats  # (S,), of the states; of discrepancies 0
    variance: Floats  # (S,), of the states; of discrepancies that of their target
    channels: Floats  # (M,), variance of each channel
    # between samples, mostly [s]; 0 where memories of discrepancies are to be as long as the record has them
    interval: float = 0.0
    # (M,) or 0, variance of each channel's rounding. Its noise is no less: a body at rest gives one value again and
    # again.
    rounding: Floats | float = 0.0


@dataclass(frozen=True, eq=False)
class Levels:
    """Sizes of noise and discrepancies."""

    layout: Layout  # what they are sizes of
    scales: Scales
    channels: Floats  # (M,), variances of the channels' noise
    discrepancy: Floats  # (C,), variance of each equation's discrepancy
    memory: Floats  # (C,), what is left of a discrepancy after a sample
    slope: Floats  # (L,), variance of what is added to the highest derivative of each noisy input at a sample
    # (L,), variance of what the course of each noisy input between samples errs by, as a share of the square of its
    # bends
    courses: Floats
    drifts: Floats  # (M,) or (0,), variance that the drift of each channel gains in 1/(2 pi f), f the band's lower end
    # (F, F), how the likelihood curves downwards in `free`, as the search that led here has found it, in the units of
    # that search
    hessian: Floats | None = None
    held: Bools | None = None  # (M,), channels whose noise is known: it stays as it is

    @cached_property
    def noise(self) -> Noise:
        """The variances as the filter takes them."""
        layout = self.layout
        memory, steps = np.ones(layout.size), np.zeros(layout.size)
        start = LIKELIHOOD.first_state_sd**2 * self.scales.variance
        sizes = np.where(self.stated, self.sizes[0], self.discrepancy)
        memory[layout.discrepancy] = self.memory
        steps[layout.discrepancy] = sizes * (1.0 - self.memory**2)
        start[layout.discrepancy] = sizes
        steps[layout.drifts] = self.drifts * layout.drift
        start[layout.drifts] = DRIFT_OFFSET**2 * self.scales.channels[: len(layout.drifts)]
        steps[layout.slope] = self.slope
        start[layout.lags] = self.scales.variance[layout.lags]
        return Noise(self.channels, memory, steps, self.scales.mean, start, self.courses)

    def with_noise(self, i: int, variance: float) -> Levels:
        """The levels with another variance of the noise of channel i."""
        channels = self.channels.copy()
        channels[i] = variance
        return replace(self, channels=channels)

    def with_discrepancy(self, c: int, variance: float) -> Levels:
        """The levels with another variance of the discrepancy of equation c, or the least there is."""
        sizes = self.discrepancy.copy()
        sizes[c] = max(variance, self.sizes[0][c])
        return replace(self, discrepancy=sizes)

    @property
    def target(self) -> Floats:
        """Variance of the target of each equation, (C,)."""
        return np.asarray(self.scales.variance[self.layout.discrepancy])

    @property
    def kappa(self) -> Floats:
        """Standard deviation of each discrepancy as a share of its target's, (C,)."""
        return np.sqrt(np.where(self.stated, self.sizes[0], self.discrepancy) / self.target)

    @property
    def stated(self) -> Bools:
        """Equations that are stated laws, (C,): they have no discrepancy."""
        return np.array([chain.hidden for chain in self.layout.roles.chains], dtype=np.bool_)

    @property
    def longest(self) -> Floats:
        """Longest memory of each discrepancy, (C,), by the own time of its chain, a coordinate's spread over that of
        its rate; of a static law the shortest of the inputs and of other chains."""
        layout, times = self.layout, []
        for c, chain in enumerate(layout.roles.chains):
            if chain.static:
                times.append(np.inf)
                continue
            first = int(layout.last[c]) + 1 - chain.order
            spreads = np.sqrt([*self.scales.variance[first : first + chain.order], self.target[c]])
            k = min(chain.lowest, chain.order - 1)
            times.append(spreads[k] / (abs(layout.rates[c][k]) * spreads[k + 1]))
        if any(chain.static for chain in layout.roles.chains):
            variance, i = self.scales.variance, layout.driven
            times = np.minimum(times, np.min([*times, *np.sqrt(variance[i] / variance[i + 1])])).tolist()
        return np.clip(
            np.exp(-self.scales.interval / (LIKELIHOOD.memory_share * np.array(times))),
            2.0 * LIKELIHOOD.shortest_memory,
            LIKELIHOOD.longest_memory,
        )

    @property
    def unbounded(self) -> Levels:
        """The levels without the bound of `longest` on memories."""
        return replace(self, scales=replace(self.scales, interval=0.0))

    @property
    def sizes(self) -> tuple[Floats, Floats]:
        """Least and most variance of a discrepancy that is taken to be possible, (C,)."""
        return LIKELIHOOD.least_discrepancy * self.target, MOST_POSSIBLE * self.target

    @property
    def learned(self) -> Bools:
        """Channels whose noise is not known, (M,)."""
        return np.ones(len(self.channels), dtype=np.bool_) if self.held is None else ~self.held

    @property
    def known(self) -> Bools:
        """Which of `free` are known and stay, (F,)."""
        parts: dict[str, Bools] = {"channels": ~self.learned, "discrepancy": self.stated, "memory": self.stated}
        return np.concatenate([parts.get(name, np.zeros(len(getattr(self, name)), dtype=np.bool_)) for name in PARTS])

    @property
    def optional(self) -> Bools:
        """Which of `free` may vanish, where the likelihood is flat in them: discrepancies, courses, drifts; (F,)."""
        return np.concatenate([np.full(len(getattr(self, name)), name not in ("channels", "slope")) for name in PARTS])

    @property
    def free(self) -> Floats:
        """The numbers that a search moves, (F,): logarithms of the variances of all `PARTS`, logits of the memories."""
        return np.concatenate([(_logit if name == "memory" else np.log)(getattr(self, name)) for name in PARTS])

    def moved(self, free: Floats) -> Levels:
        """The levels of other numbers."""
        ends = np.cumsum([len(getattr(self, name)) for name in PARTS[:-1]])
        parts = dict(zip(PARTS, np.split(free, ends), strict=True))
        found: dict[str, Any] = {
            name: 1.0 / (1.0 + np.exp(-x)) if name == "memory" else np.exp(x) for name, x in parts.items()
        }
        if self.held is not None:
            found["channels"] = np.where(self.held, self.channels, found["channels"])
        return replace(self, hessian=None, **found)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Least and most of `free`."""
        target = self.target
        slope, drifting = self.scales.variance[self.layout.slope], self.scales.channels[: len(self.drifts)]
        low = [
            np.log(np.maximum(LEAST_NOISE * self.scales.channels, self.scales.rounding)),
            np.log(LIKELIHOOD.least_discrepancy * target),
            np.full(len(target), _logit(np.array(LIKELIHOOD.shortest_memory))),
            np.log(LIKELIHOOD.least_discrepancy * slope),
            np.full(len(slope), np.log(LEAST_COURSE)),
            np.log(LEAST_NOISE * drifting),
        ]
        high = [
            np.log(MOST_NOISE * self.scales.channels),
            np.log(MOST_DISCREPANCY * target),
            _logit(self.longest),
            np.log(1e4 * slope),
            np.full(len(slope), np.log(LIKELIHOOD.most_course)),
            np.log(MOST_NOISE * drifting),
        ]
        return np.concatenate(low), np.concatenate(high)

    def curvature(self, linears: Sequence[Linear]) -> Floats:
        """About how sharply the likelihood peaks in each of `free`: half of the samples for the noise of a channel."""
        samples = np.asarray(sum(np.isfinite(linear.residual).sum(axis=0) for linear in linears), dtype=np.float64)
        inputs = samples[len(samples) - len(self.slope) :]
        few = np.full(2 * len(self.discrepancy), np.sqrt(samples.mean()))
        drifts = np.sqrt(samples[: len(self.drifts)])
        return np.concatenate([0.5 * samples, few, STEP_SHARPNESS * inputs, np.sqrt(inputs), drifts])

    def slopes(self, found: Adjoint) -> Floats:
        """Derivatives of the likelihood by `free`."""
        d, b, s = self.layout.discrepancy, self.layout.drifts, self.layout.slope
        size, memory = self.discrepancy, self.memory
        by_size = found.steps[d] * (1.0 - memory**2) + found.start[d]
        by_memory = found.memory[d] - 2.0 * memory * size * found.steps[d]
        return np.concatenate(
            [
                found.channels * self.channels,
                by_size * size,
                by_memory * memory * (1.0 - memory),
                found.steps[s] * self.slope,
                found.courses * self.courses,
                found.steps[b] * self.layout.drift * self.drifts,
            ]
        )


def _logit(p: Floats) -> Floats:
    return np.asarray(np.log(p) - np.log1p(-p))
