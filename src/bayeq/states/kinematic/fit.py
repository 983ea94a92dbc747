"""Noise levels and roughness of a chain by maximum likelihood, its order by the leave-one-out density."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import ConvergenceWarning, InputError
from bayeq.numerics.minimise import minimise
from bayeq.numerics.settings import STATES
from bayeq.states.kinematic.kalman import LONG_GAP
from bayeq.states.kinematic.smoother import ChainSeries, KinematicModel, Rows, Sizes, prepare, sizes_of

# Fewer samples than this say nothing about the noise of a channel.
LEAST_SAMPLES = 10

# The order that the search starts from, less that of the highest derivative.
FIRST_EXTRA = 3

# Noise variances as shares of the channel's variance: least and most.
LEAST_VARIANCE, MOST_VARIANCE = 1e-12, 10.0

# Bandwidths of the prior [rad per step]: the widest in the grid of starts, the grid's ratio, and the bounds.
WIDEST, RATIO = 3.0, 3.0
BANDWIDTHS = (1e-8, 1e4)

# Bands of a channel's spectrum (of about BINS bins or more); the noise starts at the level of the lowest band.
BANDS, BINS = 16, 8
# Share of a channel's variance that its noise starts at where there are too few samples for a spectrum.
FALLBACK = 0.01

# Of more than MANY rows USED are used, in STRETCHES or more. On irregular rows gains do not settle, which is slower:
# where there are more than one in SPARSE of them, these numbers of rows are divided by SLOWER.
MANY, USED, STRETCHES = 50_000, 40_000, 8
SLOWER, SPARSE = 5, 300

# Gradient of the log-likelihood per sample: the search stops below the first; a warning says so if it ends above the
# second.
STATIONARY, DOUBTFUL = 1e-6, 1e-3


def fit_kinematic(
    series: Sequence[ChainSeries],
    *,
    order: int | None = None,
    noise_sd: Sequence[float | None] | None = None,
    doubts: bool = True,
) -> KinematicModel:
    """Noise levels and spectral density of maximum likelihood, shared by some records of one chain.

    The search starts at the floors of the channels' spectra and ends in the maximum next to them. The likelihood does
    not choose the order: it is dominated by low frequencies, where every prior is far too wide and smoothing hardly
    depends on it. The order is chosen by the leave-one-out density of the samples, which measures smoothing.

    Records are cut at gaps of more than 20 median steps. Where they have more than 50,000 rows together, 8 or more
    stretches spread over them are used instead, 40,000 rows in all (8,000 of more than 10,000 where steps are
    irregular or samples missing).

    The `order` m, from K+1 to K+4 for a chain of K derivatives, and known standard deviations of the noise of each
    derivative, `noise_sd`, may be given; with `doubts` a warning says that noise levels may be off. Log-likelihood and
    leave-one-out density of the model are those of the rows used. An InputError refuses fewer than 10 samples of a
    channel, a constant channel, and noise that is not positive.

    Examples
    --------
    >>> from bayeq.states.kinematic.smoother import smooth_kinematic
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(2000) / 100
    >>> noisy = ChainSeries(t, (np.sin(t) + 0.1 * rng.normal(size=2000), np.cos(t) + 0.2 * rng.normal(size=2000)))
    >>> model = fit_kinematic([noisy])
    >>> [round(sd, 1) for sd in model.noise_sd]
    [0.1, 0.2]
    >>> smoothed = smooth_kinematic(noisy, model)
    >>> bool(np.std(smoothed.mean[:, 0] - np.sin(t)) < 0.02)
    True
    """
    series = list(series)
    known = _known(len(series[0].channels), noise_sd)
    for k in {k for s in series for k in s.measured if np.isnan(known[k])}:
        _require_noisy(series, k)
    sizes = sizes_of(series, least=noise_sd)
    pieces = [piece for s in series for piece in _pieces(s)]
    used = _stretches([prepare(piece, sizes.initial_sd(len(known))) for piece in pieces])
    floors = _floors(used, sizes)

    def fitted(m: int) -> KinematicModel:
        return _Likelihood(used, sizes, m, known).maximise(floors, doubts)

    if order is not None:
        return fitted(order)
    # uphill by the leave-one-out density
    highest = len(known) - 1
    start = best = fitted(highest + FIRST_EXTRA)
    for direction in (1, -1):
        at = start.order + direction
        while highest < at <= highest + STATES.most_extra and (other := fitted(at)).left_out > best.left_out:
            best, at = other, at + direction
        if best is not start:
            break
    return best


def _known(derivatives: int, noise_sd: Sequence[float | None] | None) -> Floats:
    """The noise levels that are given, NaN where they are not."""
    given = [None] * derivatives if noise_sd is None else noise_sd
    for k, sd in enumerate(given):
        if sd is not None and not 0 < sd < math.inf:
            raise InputError(f"the noise of derivative {k} must be positive and finite, not {sd!r}")
    return np.array([math.nan if sd is None else sd for sd in given], dtype=np.float64)


def _require_noisy(series: Sequence[ChainSeries], k: int) -> None:
    """Raise unless the noise of derivative k can be estimated."""
    pieces = [piece[np.isfinite(piece)] for s in series if (piece := s.channels[k]) is not None]
    rows = sum(map(len, pieces))
    if rows < LEAST_SAMPLES:
        raise InputError(
            f"derivative {k} has {rows} samples, too few to estimate its noise (at least {LEAST_SAMPLES});"
            " give noise_sd, or leave the channel out"
        )
    if all(piece.min() == piece.max() for piece in pieces if len(piece)):
        raise InputError(f"derivative {k} is constant: its noise cannot be estimated; give noise_sd, or leave it out")


def _pieces(series: ChainSeries) -> list[ChainSeries]:
    """The record without rows that have no sample, cut at long gaps, across which the state loses all digits."""
    filled = np.flatnonzero(np.isfinite(series.samples).any(axis=1))
    if len(filled) < 2:
        return []
    steps = np.diff(series.times[filled])
    ends = np.flatnonzero(steps > LONG_GAP * np.median(steps)) + 1
    return [series.take(part) for part in np.split(filled, ends) if len(part) > 1]


def _stretches(rows: Sequence[Rows]) -> Sequence[Rows]:
    """The rows, or where there are too many of them, stretches spread over them."""
    total = sum(len(r.steps) for r in rows)
    slower = SLOWER if SPARSE * sum(np.count_nonzero(~r.regular[1:]) for r in rows) > total else 1
    if total * slower <= MANY:
        return rows
    longest = USED // (slower * STRETCHES)
    pieces = []
    for r in rows:
        cuts = np.linspace(0, len(r.steps), math.ceil(len(r.steps) / longest) + 1).astype(int)
        pieces += [r.take(slice(a, b)) for a, b in pairwise(cuts)]
    return pieces[:: math.ceil(total * slower / USED)]


def _floors(rows: Sequence[Rows], sizes: Sizes) -> Floats:
    """Noise variances to start from, (K+1,): the median over the records of the lowest level of each spectrum."""
    levels: list[list[float]] = [[] for _ in sizes.variance]
    for r in rows:
        times = np.cumsum(r.steps)
        for j, k in enumerate(r.measured):
            present = r.present[:, j]
            if np.count_nonzero(present) >= BINS:
                levels[k].append(lowest_level(times[present], r.samples[present, j]) * float(r.units(k)) ** 2)
    shares = [
        np.median(level) / variance if level and variance > 0 else FALLBACK
        for level, variance in zip(levels, sizes.variance, strict=True)
    ]
    return sizes.variance * np.clip(shares, 10 * LEAST_VARIANCE, 1.0)


def lowest_level(times: Floats, samples: Floats) -> float:
    """Least level of the periodogram in any of its bands: white noise in the samples has at most this variance."""
    samples = np.interp(np.linspace(times[0], times[-1], len(times)), times, samples)
    window = np.hanning(len(samples))
    spectrum = np.abs(np.fft.rfft((samples - samples.mean()) * window)) ** 2 / (window @ window)
    bands = np.array_split(spectrum[1:], min(BANDS, max(1, len(spectrum) // BINS)))
    return min(float(band.mean()) for band in bands)


class _Likelihood:
    """Log-likelihood of records as a function of the logarithms of the parameters.

    The parameters are ln(R_k / variance of channel k) of each channel with unknown noise, then ln(Q / unit): Q = square
    of the highest channel's size times (bandwidth per step)^power.
    """

    def __init__(self, rows: Sequence[Rows], sizes: Sizes, order: int, known: Floats) -> None:
        self.rows, self.sizes, self.order, self.known = rows, sizes, order, known
        self.free = np.array([k for k in sizes.measured if np.isnan(known[k])], dtype=np.intp)
        self.initial = sizes.initial_sd(order)
        top = int(sizes.measured[-1])
        self.power = 2 * (order - top) - 1
        self.unit = float(sizes.size[top] ** 2 / sizes.step**self.power)
        self.count = sum(r.count for r in rows)

    def unpack(self, parameters: Floats) -> tuple[float, Floats]:
        noise_sd = self.known.copy()
        noise_sd[self.free] = np.sqrt(self.sizes.variance[self.free] * np.exp(parameters[: len(self.free)]))
        return self.unit * math.exp(parameters[-1]), noise_sd

    @property
    def bounds(self) -> Floats:
        """Lower and upper bounds of the parameters, (2, F)."""
        noise = np.tile(np.log([[LEAST_VARIANCE], [MOST_VARIANCE]]), len(self.free))
        return np.column_stack([noise, self.power * np.log(BANDWIDTHS)])

    def value(self, parameters: Floats) -> float:
        density, noise_sd = self.unpack(parameters)
        return sum(r.filter(self.order, density, noise_sd, self.initial).log_likelihood for r in self.rows)

    def scored(self, parameters: Floats) -> tuple[float, Floats, float]:
        """The log-likelihood, its gradient and the leave-one-out density."""
        density, noise_sd = self.unpack(parameters)
        value, gradient, left_out = 0.0, np.zeros(len(noise_sd) + 1), 0.0
        for rows in self.rows:
            filtered = rows.filter(self.order, density, noise_sd, self.initial)
            own_gradient, own_left_out = rows.score(filtered, noise_sd)
            value += filtered.log_likelihood
            gradient += own_gradient
            left_out += own_left_out
        return value, gradient[[*self.free, len(noise_sd)]], left_out

    def start(self, floors: Floats) -> Floats:
        """Noise at the floors, and the best bandwidth of a coarse grid, from wide to narrow."""
        noise = np.log(floors[self.free] / self.sizes.variance[self.free])
        bandwidth = WIDEST
        best = np.append(noise, self.power * math.log(bandwidth))
        highest = self.value(best)
        while bandwidth > BANDWIDTHS[0]:
            bandwidth /= RATIO
            parameters = np.append(noise, self.power * math.log(bandwidth))
            value = self.value(parameters)
            if not value > highest:
                break
            best, highest = parameters, value
        return best

    def maximise(self, floors: Floats, doubts: bool) -> KinematicModel:
        """The model at the maximum next to the floors of the spectra."""

        def loss(at: Floats) -> tuple[float, Floats]:
            value, gradient, _ = self.scored(at)
            return -value / self.count, -gradient / self.count

        found = minimise(loss, self.start(floors), *self.bounds, gradient_tolerance=STATIONARY)
        value, gradient, left_out = self.scored(found.x)
        uphill = np.clip(found.x + gradient / self.count, *self.bounds) - found.x
        if doubts and not found.converged and np.abs(uphill).max(initial=0.0) > DOUBTFUL:
            warnings.warn(
                f"noise levels of order {self.order} may be off, the search stopped short: give them (noise=), or look"
                " for bad samples",
                ConvergenceWarning,
                stacklevel=3,
            )
        density, noise_sd = self.unpack(found.x)
        return KinematicModel(
            order=self.order,
            spectral_density=density,
            noise_sd=tuple(None if np.isnan(sd) else float(sd) for sd in noise_sd),
            initial_sd=tuple(map(float, self.initial)),
            log_likelihood=value,
            left_out=left_out,
        )
