"""`Levels`: variances of noise and discrepancies, and memories, as logarithms and logits that a search can move."""

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

# Bounds of variances: of noise as a share of the channel's, of a discrepancy as a share of the target's, and of the
# interpolation error of an input as a share of its squared bends.
LEAST_NOISE, MOST_NOISE = 1e-10, 1e2
MOST_DISCREPANCY, MOST_POSSIBLE = 1e2, 1e1
LEAST_COURSE = 1e-6

# Standard deviation of the offset that a drift begins with, as a share of the channel's.
DRIFT_OFFSET = 0.5

# Fields that a search moves, in the order of `Levels.free`.
PARTS = ("channels", "discrepancy", "memory", "slope", "courses", "drifts")

# Information on the log variance of an input's steps, as a share of its samples. On that of a small discrepancy it may
# be anywhere between about 1 and the number of samples: the geometric mean is taken.
STEP_SHARPNESS = 0.25


@dataclass(frozen=True, eq=False)
class Scales:
    """Means and variances that levels and their bounds are relative to."""

    mean: Floats  # (S,), of the states; 0 for discrepancies
    variance: Floats  # (S,), of the states; for a discrepancy the variance of its target
    channels: Floats  # (M,), variance of each channel
    # median interval between samples [s]; 0 leaves memories without the bound `Levels.longest`
    interval: float = 0.0
    # (M,) or 0, variance of each channel's rounding error, the least that its noise may have: a body at rest repeats
    # one value.
    rounding: Floats | float = 0.0


@dataclass(frozen=True, eq=False)
class Levels:
    """Variances of noise and discrepancies, and memories of discrepancies."""

    layout: Layout  # channels, equations and inputs that they belong to
    scales: Scales
    channels: Floats  # (M,), variances of the channels' noise
    discrepancy: Floats  # (C,), variance of each equation's discrepancy
    memory: Floats  # (C,), AR(1) coefficient of each discrepancy from sample to sample
    slope: Floats  # (L,), variance of the random steps of the highest derivative of each noisy input at samples
    # (L,), variance of the interpolation error of each noisy input between samples, as a share of its squared bends
    courses: Floats
    drifts: Floats  # (M,) or (0,), variance that the drift of each channel gains in 1/(2 pi f), f the band's lower end
    # (F, F), Hessian of minus the log likelihood in `free`, as estimated by the search that led here, in the units of
    # that search
    hessian: Floats | None = None
    held: Bools | None = None  # (M,), channels whose noise is known: it stays as it is

    @cached_property
    def noise(self) -> Noise:
        """The variances and memories of all states and channels, for the filter."""
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
        """The levels with another variance of the discrepancy of equation c, at least the first of `sizes`."""
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
        """Equations of hidden states, (C,): these have only the least discrepancy, whatever `discrepancy` is."""
        return np.array([chain.hidden for chain in self.layout.roles.chains], dtype=np.bool_)

    @property
    def longest(self) -> Floats:
        """Upper bound of each memory, (C,), from the time scale of its chain: sd of a coordinate over sd of its rate;
        if any equation is a static law, for all equations from the shortest time scale of chains and inputs."""
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
        """Least and largest variance of each discrepancy over which its prior extends, (C,) each."""
        return LIKELIHOOD.least_discrepancy * self.target, MOST_POSSIBLE * self.target

    @property
    def learned(self) -> Bools:
        """Channels whose noise is estimated, not known, (M,)."""
        return np.ones(len(self.channels), dtype=np.bool_) if self.held is None else ~self.held

    @property
    def known(self) -> Bools:
        """Entries of `free` that are known and held, (F,)."""
        parts: dict[str, Bools] = {"channels": ~self.learned, "discrepancy": self.stated, "memory": self.stated}
        return np.concatenate([parts.get(name, np.zeros(len(getattr(self, name)), dtype=np.bool_)) for name in PARTS])

    @property
    def optional(self) -> Bools:
        """Entries of `free` in which the likelihood may be flat, (F,): discrepancies, memories, courses and drifts."""
        return np.concatenate([np.full(len(getattr(self, name)), name not in ("channels", "slope")) for name in PARTS])

    @property
    def free(self) -> Floats:
        """The numbers that a search moves, (F,): logarithms of the variances of all `PARTS`, logits of the memories."""
        return np.concatenate([(_logit if name == "memory" else np.log)(getattr(self, name)) for name in PARTS])

    def moved(self, free: Floats) -> Levels:
        """The levels with other values of `free`."""
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
        """Lower and upper bounds of `free`, (F,) each."""
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
        """Approximate information on each entry of `free`, (F,): half of the samples for the noise of a channel."""
        samples = np.asarray(sum(np.isfinite(linear.residual).sum(axis=0) for linear in linears), dtype=np.float64)
        inputs = samples[len(samples) - len(self.slope) :]
        few = np.full(2 * len(self.discrepancy), np.sqrt(samples.mean()))
        drifts = np.sqrt(samples[: len(self.drifts)])
        return np.concatenate([0.5 * samples, few, STEP_SHARPNESS * inputs, np.sqrt(inputs), drifts])

    def slopes(self, found: Adjoint) -> Floats:
        """Derivatives of the log likelihood by `free`, (F,)."""
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
