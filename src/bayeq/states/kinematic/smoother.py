"""Kinematic smoother: a coordinate and its derivatives from noisy samples of any of them.

The coordinate is an integrated Wiener process, whose derivatives are exact (`KinematicModel`); `fit_kinematic` finds
its noise levels, `smooth_kinematic` its states. Records are taken to units of their own (time in median steps, the
coordinate in its size over a step), so that the numbers in the kernels are near 1 whatever the units of the data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.errors import InputError
from bayeq.records.validate import is_step
from bayeq.states.kinematic.kalman import Tables, filter_gains, filter_means, score, smooth

# Standard deviations of the first state, which is unknown, over the sizes of the derivatives.
DIFFUSE = 1e3

# Samples in a stretch, so short that a drift adds little to its variance.
STRETCH = 128

# Samples beyond have no square in floating point.
LARGEST = 1e150


@dataclass(frozen=True, slots=True, eq=False)
class ChainSeries:
    """Samples of one chain in one record.

    An InputError refuses shapes that do not match, times that do not increase, and infinite samples.

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
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "channels", tuple(channels))

    @property
    def n(self) -> int:
        return len(self.times)

    @property
    def measured(self) -> tuple[int, ...]:
        """The derivatives that have a channel."""
        return tuple(k for k, channel in enumerate(self.channels) if channel is not None)

    @property
    def step(self) -> float:
        """Median time step [s]."""
        return float(np.median(np.diff(self.times)))

    @property
    def samples(self) -> Floats:
        """Samples of all derivatives, (n, K+1), NaN where not measured or missing."""
        return np.column_stack([np.full(self.n, np.nan) if c is None else c for c in self.channels])

    def take(self, rows: slice | NDArray[np.intp]) -> ChainSeries:
        return ChainSeries(self.times[rows], tuple(None if c is None else c[rows] for c in self.channels))

    def over(self, gains: Floats | Sequence[float]) -> ChainSeries:
        """The series with each channel divided by its gain, in consistent units."""
        channels = (None if c is None else c / gain for c, gain in zip(self.channels, gains, strict=True))
        return ChainSeries(self.times, tuple(channels))

    def without(self, mask: Bools) -> ChainSeries:
        """The series with NaN in place of the samples in a mask, (n, K+1)."""
        channels = (None if c is None else np.where(mask[:, k], np.nan, c) for k, c in enumerate(self.channels))
        return ChainSeries(self.times, tuple(channels))


@dataclass(frozen=True, slots=True)
class KinematicModel:
    """A coordinate q whose m-th derivative is white noise, and white noise on each of its channels."""

    order: int  # m; the state is q, q', ..., q^(m-1)
    # Q of the driving noise: the variance of q^(m-1) grows by Q t in a time t [unit of q squared per s^(2m-1)]
    spectral_density: float
    noise_sd: tuple[float | None, ...]  # of each derivative in its own unit, None where not measured
    # prior sd of the state at the first row, about zero (of q about its channel's mean, where it has one); by default
    # 1e3 times the size of each derivative in the data, so that it is practically unknown
    initial_sd: tuple[float, ...] | None = None
    log_likelihood: float | None = None  # of the samples that the model was fitted to
    left_out: float = -math.inf  # sum over these of each sample's log density given all others; -inf if not fitted


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """How large the derivatives of a chain are in some records."""

    # (K+1,), of each channel about its mean in stretches of 128 samples, without drift; NaN: not measured
    variance: Floats
    size: Floats  # (K+1,), root mean square of each channel, that of q about its mean
    step: float  # median time step [s]
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
    """Sizes of the derivatives in some records, each size at least its `least`; an InputError without samples."""
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


# --- the filter on a record -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """Results of the filter's forward passes over a record."""

    noise: Floats  # lower root of Qd over a regular step
    steady: int
    tables: Tables
    log_likelihood: float


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A record in units of its own, and the filter on it. States below `lowest` are left out."""

    samples: Floats  # (n, c), 0 where missing
    present: Bools  # (n, c)
    steps: Floats  # (n,), time step before each row in units of `step`, 1 where regular
    regular: Bools  # (n,), whether a row follows a regular step and has all samples
    measured: Ints  # (c,), measured derivatives
    lowest: int
    step: float
    scale: float
    centre: float

    @property
    def count(self) -> int:
        return int(np.count_nonzero(self.present))

    def take(self, rows: slice) -> Rows:
        names = ("samples", "present", "steps", "regular")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def units(self, derivatives: ArrayLike) -> Floats:
        """The record's own units of some derivatives, in units of the data."""
        return self.scale / self.step ** np.asarray(derivatives, dtype=np.float64)

    @property
    def log_jacobian(self) -> float:
        """Log density of the samples in units of the data, less that in the record's own units."""
        return -float(self.present.sum(axis=0) @ np.log(self.units(self.measured)))

    def filter(self, order: int, density: float, noise_sd: Floats, initial_sd: Floats, keep: bool = False) -> Filtered:
        """The record filtered by a model of order m, density Q and sds of noise, (K+1,), and first state, (m,)."""
        (n, c), m = self.samples.shape, order - self.lowest
        orders = self.measured - self.lowest
        variances = (noise_sd[self.measured] / self.units(self.measured)) ** 2
        start = initial_sd[self.lowest :] / self.units(np.arange(self.lowest, order))
        noise = math.sqrt(density) * self.step ** (order - 0.5) / self.scale * _unit_root(m)
        tables = Tables(
            entry=np.empty(n, np.int64),
            anew=np.empty(n, np.bool_),
            gains=np.zeros((n, c, m)),
            inverse=np.zeros((n, c)),
            roots=np.empty((n * keep, m, m)),
            innovations=np.empty((n, c)),
            means=np.empty((n * keep, m)),
        )
        entries, steady, logs = filter_gains(
            self.steps, self.present, self.regular, orders, variances, noise, np.diag(start), tables
        )
        deviance = logs + filter_means(self.samples, self.steps, orders, tables)
        value = -0.5 * (deviance + self.count * math.log(2.0 * math.pi)) + self.log_jacobian
        filled = {name: getattr(tables, name)[:entries] for name in ("gains", "inverse", "roots")}
        return Filtered(noise, steady, tables._replace(**filled), value)

    def score(self, filtered: Filtered, noise_sd: Floats) -> tuple[Floats, float]:
        """Derivatives of the log-likelihood by ln R_k, K+1 of them, and ln Q; the leave-one-out log density."""
        own, gradient = np.zeros(len(self.measured) + 1), np.zeros(len(noise_sd) + 1)
        orders = self.measured - self.lowest
        left_out = score(self.steps, orders, filtered.tables, filtered.steady, filtered.noise, own, np.empty((0, 0, 2)))
        gradient[self.measured] = own[:-1] * (noise_sd[self.measured] / self.units(self.measured)) ** 2
        gradient[-1] = own[-1]
        return gradient, left_out + self.log_jacobian


def prepare(series: ChainSeries, initial_sd: Floats, all_states: bool = False) -> Rows:
    """A record for the filter, in units by the sizes `initial_sd` of the derivatives, (m,); with `all_states` also
    those below the lowest measured derivative, which never settle."""
    seen = [k for k, channel in enumerate(series.channels) if channel is not None and np.isfinite(channel).any()]
    measured = np.array(seen or series.measured, dtype=np.int64)
    step = series.step
    steps = np.append(0.0, np.where(is_step(series.times, step, 0.0), 1.0, np.diff(series.times) / step))
    samples = np.stack([channel for k in measured if (channel := series.channels[k]) is not None], axis=1)
    present = np.isfinite(samples)
    centre, scale = 0.0, float(initial_sd[measured[0]]) * step ** int(measured[0])
    if measured[0] == 0 and present[:, 0].any():
        centre = float(samples[present[:, 0], 0].mean())
        samples[:, 0] -= centre
    samples[~present] = 0.0
    regular, lowest = (steps == 1.0) & present.all(axis=1), 0 if all_states else int(measured[0])
    rows = Rows(samples, present, steps, regular, measured, lowest, step, scale, centre)
    samples /= rows.units(measured)
    return rows


def _unit_root(m: int) -> Floats:
    """Lower root of Qd over a step of 1 with Q = 1: Qd_ij = 1/((2m-1-i-j) (m-1-i)! (m-1-j)!)."""
    back = np.arange(m - 1, -1, -1)
    factorials = np.array([math.factorial(k) for k in back], dtype=np.float64)
    return np.asarray(np.linalg.cholesky(1.0 / ((back[:, None] + back + 1) * np.outer(factorials, factorials))))


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedStates:
    """States of a record given all of its samples."""

    mean: Floats  # (n, m): q, q', ..., q^(m-1) in their own units
    covariances: Floats  # (u, m, m), distinct ones: with uniform sampling one for all rows away from ends and gaps
    entry: Ints  # (n,), index in `covariances` of each row's

    @property
    def sd(self) -> Floats:
        """Standard deviations of the states, (n, m)."""
        return np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))[self.entry]


def smooth_kinematic(series: ChainSeries, model: KinematicModel) -> SmoothedStates:
    """States of a record given its samples: the kinematic smoother.

    A derivative below all that are measured (the displacement, where only the acceleration is) is known up to a
    polynomial of the record's time, and its standard deviation is accordingly large. After a gap of more than 20 median
    steps in which the standard deviation of the lowest measured derivative grows beyond 1e8 noise levels and beyond
    `KinematicModel.initial_sd`, the state starts again from the latter: rounding would leave no digit of it.

    Examples
    --------
    >>> t = np.arange(200) / 100
    >>> smoothed = smooth_kinematic(ChainSeries(t, (np.sin(t), None)), KinematicModel(3, 1.0, (1e-4, None)))
    >>> bool(np.allclose(smoothed.mean[:, 1], np.cos(t), atol=0.01))
    True
    >>> smoothed.sd.shape
    (200, 3)
    """
    rows, given = filtered(series, model, states=True)
    mean = given.tables.means
    n, m = mean.shape
    covariances, entry = np.empty((n, m, m)), np.empty(n, np.int64)
    entries = smooth(rows.steps, given.tables, given.steady, given.noise, covariances, entry)
    units = rows.units(np.arange(m))
    mean *= units
    mean[:, 0] += rows.centre
    kept = covariances[:entries].copy() if entries < n else covariances
    kept *= np.outer(units, units)
    return SmoothedStates(mean, kept, entry)


def leave_one_out(series: ChainSeries, model: KinematicModel) -> Floats:
    """Errors of each sample's prediction from all other samples of the record, in all channels of the chain.

    (n, K+1, 2): sample less prediction, and the standard deviation of this under the model; NaN without a sample.
    """
    rows, given = filtered(series, model)
    errors, gradient = np.full((*rows.samples.shape, 2), np.nan), np.zeros(len(rows.measured) + 1)
    score(rows.steps, rows.measured - rows.lowest, given.tables, given.steady, given.noise, gradient, errors)
    out = np.full((series.n, len(series.channels), 2), np.nan)
    out[:, rows.measured] = errors * rows.units(rows.measured)[:, None]
    return out


def one_sided(series: ChainSeries, model: KinematicModel) -> tuple[Floats, Floats]:
    """States given the samples up to each row, and given those from each row on: (n, m) each."""
    signs = (-1.0) ** np.arange(len(series.channels))
    channels = (None if c is None else sign * c[::-1] for sign, c in zip(signs, series.channels, strict=True))
    after = _filtered_means(ChainSeries(-series.times[::-1], tuple(channels)), model)
    return _filtered_means(series, model), after[::-1] * (-1.0) ** np.arange(model.order)


def _filtered_means(series: ChainSeries, model: KinematicModel) -> Floats:
    rows, given = filtered(series, model, states=True)
    mean = given.tables.means * rows.units(np.arange(model.order))
    mean[:, 0] += rows.centre
    return mean


def filtered(series: ChainSeries, model: KinematicModel, states: bool = False) -> tuple[Rows, Filtered]:
    """A record in its own units, and the results of the filter; with `states` also roots and means of all states."""
    noise_sd = np.array([np.nan if sd is None else sd for sd in model.noise_sd], dtype=np.float64)
    initial = np.array(model.initial_sd or sizes_of([series], least=model.noise_sd).initial_sd(model.order))
    rows = prepare(series, initial, states)
    return rows, rows.filter(model.order, model.spectral_density, noise_sd, initial, states)
