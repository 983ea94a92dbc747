"""What the kinematic smoother works on: the samples of a chain, their sizes, and the model of motion and noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.numerics.settings import STATES

# Standard deviations of the first state, in the size of the measured derivatives: it is unknown.
DIFFUSE = 1e3

# Samples in a stretch that is short beside a drift.
STRETCH = 128

# Samples beyond have no square in floating point.
LARGEST = 1e150


@dataclass(frozen=True, slots=True, eq=False)
class ChainSeries:
    """Samples of one chain in one record.

    An InputError refuses shapes that do not match, times that do not increase, infinite samples, and nothing measured.

    Examples
    --------
    >>> t = np.arange(5) / 10
    >>> ChainSeries(t, (np.sin(t), None, -np.sin(t))).measured
    (0, 2)
    """

    times: Floats  # (n,), increasing [s], at least 2
    channels: tuple[Floats | None, ...]  # (n,) of each derivative from 0 up, None where not measured; NaN: missing

    def __post_init__(self) -> None:
        times = np.ascontiguousarray(self.times, dtype=np.float64)
        if times.ndim != 1 or len(times) < 2:
            raise InputError(f"times must be one array of at least 2 rows, not of shape {times.shape}")
        if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
            raise InputError("times must be finite and increase from row to row")
        channels: list[Floats | None] = []
        for k, channel in enumerate(self.channels):
            samples = None if channel is None else np.ascontiguousarray(channel, dtype=np.float64)
            if samples is not None and samples.shape != times.shape:
                raise InputError(f"derivative {k} has shape {samples.shape}, but times have {times.shape}")
            if samples is not None and (large := np.flatnonzero(np.abs(samples) > LARGEST)).size:
                raise InputError(
                    f"derivative {k} is {samples[large[0]]:g} in row {large[0] + 1}, which has no square;"
                    " give NaN where a sample is missing"
                )
            channels.append(samples)
        if all(channel is None for channel in channels):
            raise InputError("no derivative of the chain is measured: give the samples of at least one")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "channels", tuple(channels))

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.times)

    @property
    def measured(self) -> tuple[int, ...]:
        """The derivatives that have a channel."""
        return tuple(k for k, channel in enumerate(self.channels) if channel is not None)

    @property
    def step(self) -> float:
        """Median time step [s]."""
        return float(np.median(np.diff(self.times)))

    def take(self, rows: slice | NDArray[np.intp]) -> ChainSeries:
        """Some of the rows."""
        return ChainSeries(self.times[rows], tuple(None if c is None else c[rows] for c in self.channels))


@dataclass(frozen=True, slots=True)
class KinematicModel:
    """A coordinate q whose m-th derivative is white noise, and white noise on each of its channels.

    An InputError refuses an order that does not suit the chain, and values that are not positive.
    """

    order: int  # m; the state is q, q', ..., q^(m-1)
    # Q of the driving noise: the variance of q^(m-1) grows by Q t in a time t [unit of q squared per s^(2m-1)]
    spectral_density: float
    noise_sd: tuple[float | None, ...]  # of each derivative in its own unit, None where not measured
    # of the state at the first row, about zero (that of q about its channel's mean, where it has one); by default 1e3
    # times the size of each derivative in the data, which is as good as unknown
    initial_sd: tuple[float, ...] | None = None
    log_likelihood: float | None = None  # of the samples that the model was fitted to
    left_out: float = -math.inf  # sum over these of the log density that all others predict; -inf if it was not fitted

    def __post_init__(self) -> None:
        check_order(self.order, len(self.noise_sd))
        if not 0 < self.spectral_density < math.inf:
            raise InputError(f"the spectral density must be positive and finite, not {self.spectral_density!r}")
        for k, sd in enumerate(self.noise_sd):
            if sd is not None and not 0 < sd < math.inf:
                raise InputError(f"the noise of derivative {k} must be positive and finite, not {sd!r}")
        initial = self.initial_sd
        if initial is not None and not (len(initial) == self.order and all(0 < s < math.inf for s in initial)):
            raise InputError(f"initial_sd needs {self.order} positive and finite values, not {initial!r}")


def check_order(order: int, derivatives: int) -> None:
    """Raise an InputError unless a chain of this many derivatives, q included, can have this order."""
    if not derivatives <= order < derivatives + STATES.most_extra:
        raise InputError(
            f"a chain of {derivatives - 1} derivatives has an order from {derivatives} to"
            f" {derivatives + STATES.most_extra - 1}, not {order!r}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """How large the derivatives of a chain are in some records."""

    # (K+1,), of each channel about its mean in stretches of 128 samples, which drifts do not add to; NaN: not measured
    variance: Floats
    size: Floats  # (K+1,), root mean square of each channel, that of q about its mean
    step: float  # the median one [s]
    duration: float  # of the longest record [s]

    @property
    def measured(self) -> NDArray[np.intp]:
        """The derivatives measured in any record."""
        return np.flatnonzero(np.isfinite(self.variance))

    def initial_sd(self, order: int) -> Floats:
        """Standard deviations of a first state about which nothing is known, (m,).

        A derivative that is not measured is at most of the size of the one below it over a step; one below all
        that are measured, of the size of the lowest one over the record.
        """
        sizes, lowest = np.empty(order), int(self.measured[0])
        for k in range(lowest, order):
            known = k < len(self.size) and np.isfinite(self.size[k])
            sizes[k] = self.size[k] if known else sizes[k - 1] / self.step
        for k in range(lowest - 1, -1, -1):
            sizes[k] = sizes[k + 1] * self.duration
        return DIFFUSE * sizes


def sizes_of(series: Sequence[ChainSeries], least: Sequence[float | None] | None = None) -> Sizes:
    """Sizes of the derivatives in some records, each at least the one of `least`; an InputError without samples."""
    derivatives = len(series[0].channels)
    variance, size = np.full(derivatives, np.nan), np.full(derivatives, np.nan)
    for k in range(derivatives):
        pieces = [s.channels[k] for s in series]
        present = [piece[np.isfinite(piece)] for piece in pieces if piece is not None]
        present = [piece for piece in present if len(piece)]
        if present:
            rows = sum(map(len, present))
            spread = sum(len(piece) * float(piece.var()) for piece in present) / rows
            square = spread if k == 0 else sum(float(piece @ piece) for piece in present) / rows
            size[k] = max(math.sqrt(square), (least[k] if least is not None else None) or 0.0)
            variance[k] = sum(len(piece) * _local_variance(piece) for piece in present) / rows or spread
    if np.isnan(variance).all():
        raise InputError("the channels have no samples at all: every one is NaN")
    step = float(np.median([s.step for s in series]))
    return Sizes(variance, size, step, max(float(s.times[-1] - s.times[0]) for s in series))


def _local_variance(samples: Floats) -> float:
    """Mean variance of stretches of the samples."""
    whole = len(samples) // STRETCH * STRETCH
    return float(np.var(samples[:whole].reshape(-1, STRETCH) if whole else samples[None], axis=1).mean())
