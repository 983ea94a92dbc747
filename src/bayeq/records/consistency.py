"""Comparison of a channel with the derivative of another: sign, gain, delay, offset and drift.

If q is the m-th derivative of p, then for every smooth test function f that vanishes at both ends

    integral f q dt = (-1)^m integral f^(m) p dt,

exactly and without differentiating measured signals (the weak form, or modulating functions; Shinbrot 1957). With
windowed complex exponentials as test functions both sides are short-time spectra A and B of the same derivative,
without the leakage of differentiating a windowed signal. Their cross-spectrum gives delay, sign and gain at coherent
frequencies; their difference at zero frequency is the offset.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Complexes, Floats, Ints
from bayeq.numerics.settings import RECORDS

TINY = float(np.finfo(np.float64).tiny)

# The window sin^6, as a series in cos(2 pi k t/T): its first five derivatives vanish at the ends.
WINDOW = (10 / 32, -15 / 32, 6 / 32, -1 / 32)

# Samples of a frame: a power of two near 1/PART of the record, within these bounds.
SHORTEST, LONGEST = 64, 8192
PART = 8

# Frame starts per frame length; minimum number of frames for a comparison; maximum, to which they are thinned out.
OVERLAP = 4
LEAST_FRAMES = 12
MOST_FRAMES = 128

# Bins on either side over which spectra are averaged.
SMOOTHING = 2

# Noise bandwidth of the window, in bins.
BANDWIDTH = 924 / 400

# Minimum information for a comparison: the phase common to all bins is known to 1/sqrt of this [rad].
LEAST_WEIGHT = 100.0

# A detrended channel below this share of the original channel is rounding error.
ROUNDING = 1e-9

# Bins whose gain differs from the mean gain by at least this [ln] are left out, if enough others remain.
SAME_GAIN = math.log(1.4)

# Newton steps that refine a delay.
NEWTON = 20

# Upper bound of the squared coherence, so that a few noise-free bins do not dominate the weights.
MOST_COHERENT = 0.9999

# The grid of delays: up to this many samples on either side, at this many points per sample.
MOST_DELAY = 32
STEPS = 4

# The shortest delay that reaches this share of the best fit is taken: a single frequency fits again after a period.
AS_GOOD = 0.98

# Minimum partial correlation of a force with the acceleration, given x, v and x^3, for the force to decide a sign.
PUSHED = 0.7


class Frames(NamedTuple):
    """Frames of a record: overlapping windows of equal length."""

    starts: Ints  # first rows, (K,)
    length: int  # rows per frame
    dt: float  # time step [s]
    time: Floats  # of all rows [s]


class Shift(NamedTuple):
    """Offset and drift of a channel relative to the derivative of another."""

    offset: float  # value at the middle of the record
    drift: float  # change per second
    offset_t: float  # offset over its standard error
    drift_t: float  # drift over its standard error
    freedom: int  # degrees of freedom of both t values


class Relation(NamedTuple):
    """How a channel q follows the m-th derivative of a channel p: q(t) = sign x gain x p^(m)(t - delay) + shift."""

    sign: int  # +1 or -1
    gain: float  # ratio of amplitudes
    least_gain: float  # regressed on p, too small by the noise of p
    most_gain: float  # regressed on q, too large by the noise of q
    gain_error: float  # standard error of ln gain
    delay: float  # of q [s]
    delay_error: float  # standard error [s]
    fit: float  # share of the coherent part that a sign and a delay explain: 1 for a perfect derivative
    weight: float  # information: the phase common to all bins is known to 1/sqrt(weight) rad


def uniform_frames(time: Floats | None) -> Frames | None:
    """Frames within evenly sampled stretches; None if there are too few, or without time."""
    if time is None or len(time) < SHORTEST:
        return None
    n = len(time)
    length = SHORTEST
    while length < LONGEST and 2 * PART * length <= 1.5 * n:
        length *= 2
    steps = np.diff(time)
    even = np.abs(steps / np.median(steps) - 1.0) <= RECORDS.jitter  # uneven steps end a stretch
    dt = float(steps[even].mean())
    breaks = np.flatnonzero(~even) + 1
    hop = length // OVERLAP
    starts: list[int] = []
    for a, b in zip([0, *breaks], [*breaks, n], strict=True):
        starts.extend(range(int(a), int(b) - length + 1, hop))
    if len(starts) < LEAST_FRAMES:
        return None
    if len(starts) > MOST_FRAMES:
        starts = [starts[k] for k in np.linspace(0, len(starts) - 1, MOST_FRAMES).astype(int)]
    return Frames(np.array(starts, dtype=np.int64), length, dt, time)


def _windows(frames: Frames, order: int) -> Floats:
    """Derivatives 0 to `order` of the window, (order + 1, L)."""
    span = frames.length * frames.dt
    t = frames.dt * (np.arange(frames.length) + 0.5)
    window = np.zeros((order + 1, frames.length))
    for k, amplitude in enumerate(WINDOW):
        omega = 2.0 * math.pi * k / span
        for j in range(order + 1):
            window[j] += amplitude * omega**j * np.cos(omega * t + 0.5 * math.pi * j)
    return window


def _weak_derivative(values: Floats, frames: Frames, order: int) -> Complexes:
    """Short-time spectra of the `order`-th derivative of a channel, (K, bins)."""
    window, omega = _windows(frames, order), 2.0 * math.pi * np.fft.rfftfreq(frames.length, frames.dt)
    # a constant has no derivative; subtracting it first avoids its rounding error
    pieces = (values - values.mean() if order else values)[frames.starts[:, None] + np.arange(frames.length)]
    out = np.zeros((len(pieces), len(omega)), dtype=np.complex128)
    for j in range(order + 1):
        factor = math.comb(order, j) * (-1j * omega) ** (order - j)
        out += factor * np.fft.rfft(pieces * window[j], axis=1)
    return (-1.0) ** order * frames.dt * out


def derivative_name(name: str, order: int) -> str:
    """A derivative by time as text: dx/dt, d2x/dt2."""
    return f"d{name}/dt" if order == 1 else f"d{order}{name}/dt{order}"


def relate(p: Floats, q: Floats, order: int, frames: Frames) -> Relation | None:
    """Compare a channel q with the `order`-th derivative of p (neither constant); None if coherence is too low."""
    # scaled by their ranges, so that no power of them overflows
    size_p, size_q = float(np.ptp(p)), float(np.ptp(q))
    p, q = p / size_p, q / size_q
    # remove offset and drift of q, and from p the polynomial whose derivative they would be
    motion, other = (_detrended(frames.time, one, degree) for one, degree in ((p, 1 + order), (q, 1)))
    if any(np.abs(left).max() <= ROUNDING * np.abs(whole).max() for left, whole in ((motion, p), (other, q))):
        return None
    cross, power_a, power_b, omega, coherent = _spectra(motion, other, order, frames)
    if float(coherent.sum()) < LEAST_WEIGHT:
        return None
    phase = np.angle(cross)
    fit = _align(phase, coherent, omega, frames.dt)[2]
    # if one channel was computed from the other, bins of common noise show the gain of that filter: leave them out
    level = np.abs(cross) / np.maximum(power_b, TINY)
    usual = float(np.average(level, weights=power_a * (coherent > 0.0)))
    weight = np.where(np.abs(np.log(np.maximum(level, TINY) / usual)) < SAME_GAIN, coherent, 0.0)
    if float(weight.sum()) < LEAST_WEIGHT:  # no common gain
        weight = coherent
    total = float(weight.sum())
    sign, delay, _ = _align(phase, weight, omega, frames.dt)
    # phases that scatter about the line more than their variances predict: increase the standard errors
    rest = np.angle(sign * cross * np.exp(1j * omega * delay))
    misfit = max(1.0, float(weight @ rest**2) / max(float(np.count_nonzero(weight)) / BANDWIDTH, 1.0))
    aligned = np.abs(cross) * np.cos(rest)
    kept = np.flatnonzero((weight > 0.0) & (aligned > 0.0))
    share = weight[kept] / weight[kept].sum()
    least = float(share @ (aligned[kept] / power_b[kept]))
    most = float(share @ (power_a[kept] / aligned[kept]))
    gain, ratio = math.sqrt(least * most), size_q / size_p
    return Relation(
        sign=sign,
        gain=gain * ratio,
        least_gain=least * ratio,
        most_gain=most * ratio,
        gain_error=math.sqrt(misfit / total),
        delay=delay,
        delay_error=math.sqrt(misfit / float(weight @ omega**2)),
        fit=fit,
        weight=total,
    )


def _spectra(p: Floats, q: Floats, order: int, frames: Frames) -> tuple[Complexes, Floats, Floats, Floats, Floats]:
    """Cross-spectrum A B*, powers of A and B, mean frequency [rad/s] and phase weight of each bin.

    A is the spectrum of q, B that of the derivative of p, averaged over frames and neighbouring bins. The weight is the
    inverse variance of the phase of A B*, 0 where A and B are not coherent.
    """
    A = _weak_derivative(q, frames, 0)
    B, next_one = (_weak_derivative(p, frames, order + j) for j in (0, 1))
    cross, rate = (_smooth(np.mean(v * B.conj(), axis=0)) for v in (A, next_one))
    power_a, power_b = (_smooth(np.mean(np.abs(v) ** 2, axis=0) + 0j).real for v in (A, B))
    # a bin near a resonance mostly holds leakage from it: its phase shift is delay times mean frequency, not centre
    omega = rate.imag / np.maximum(power_b, TINY)
    # inverse variance of the phase of each bin, 0 where nothing is coherent (Hannan and Thomson 1973)
    independent = len(frames.starts) / OVERLAP
    averaged = independent * max((2 * SMOOTHING + 1) / BANDWIDTH, 1.0)
    coherence = np.abs(cross) ** 2 / np.maximum(power_a * power_b, TINY)
    # chance alone gives 1/averaged on average, and more than `chance` once in a thousand
    chance = 1.0 - 1e-3 ** (1.0 / max(averaged - 1.0, 1.0))
    corrected = np.clip((coherence - 1.0 / averaged) / (1.0 - 1.0 / averaged), 0.0, MOST_COHERENT)
    weight = 2.0 * independent * corrected / (1.0 - corrected)
    weight[(coherence < chance) | (power_a * power_b <= TINY)] = 0.0
    weight[-1] = 0.0  # the Nyquist frequency: real, and aliased
    return cross, power_a, power_b, omega, weight


def _detrended(time: Floats, values: Floats, degree: int) -> Floats:
    """A channel minus its least-squares polynomial of a degree."""
    basis = np.polynomial.legendre.legvander(2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0, degree)
    return np.asarray(values - basis @ np.linalg.solve(basis.T @ basis, basis.T @ values))


def _smooth(values: Complexes) -> Complexes:
    kernel = np.full(2 * SMOOTHING + 1, 1.0 / (2 * SMOOTHING + 1))
    return np.convolve(np.pad(values, SMOOTHING, mode="edge"), kernel, mode="valid")


def _align(phase: Floats, weight: Floats, omega: Floats, dt: float) -> tuple[int, float, float]:
    """Sign and delay that maximise the weighted mean of sign cos(phase + omega delay), and that maximum."""
    kept = weight > 0.0
    phase, weight, omega = phase[kept], weight[kept] / weight[kept].sum(), omega[kept]
    grid = np.arange(-MOST_DELAY * STEPS, MOST_DELAY * STEPS + 1) * (dt / STEPS)
    level = np.cos(phase[:, None] + omega[:, None] * grid).T @ weight
    found = []
    for sign in (1, -1):
        J = sign * level
        inner = J[1:-1]
        peaks = np.flatnonzero((inner >= J[:-2]) & (inner >= J[2:])) + 1
        found += [(float(J[k]), float(grid[k]), sign) for k in (peaks if len(peaks) else [int(np.argmax(J))])]
    best = max(J for J, _, _ in found)
    _, delay, sign = min((f for f in found if f[0] >= AS_GOOD * best), key=lambda f: (abs(f[1]), -f[2]))
    for _ in range(NEWTON):
        angle = phase + omega * delay
        slope = -sign * float(weight @ (omega * np.sin(angle)))
        curvature = sign * float(weight @ (omega**2 * np.cos(angle)))
        if not curvature > 0.0:
            break
        delay = float(np.clip(delay + np.clip(slope / curvature, -dt / STEPS, dt / STEPS), grid[0], grid[-1]))
    return sign, delay, sign * float(weight @ np.cos(phase + omega * delay))


def goes_with(dt: float, orders: tuple[int, int], p: Floats, q: Floats, force: Floats) -> bool:
    """Whether a force correlates with the acceleration (q or dq/dt) after regression of both on x, v and x^3."""
    x, v = (p, np.gradient(p, dt)) if orders[0] == 0 else (np.cumsum(p - p.mean()), p)
    a = q if orders[1] == 2 else np.gradient(q, dt)
    x, v, force, a = ((one - one.mean()) / (np.std(one) or 1.0) for one in (x, v, force, a))
    beside = np.stack([x, v, x**3], axis=1)
    force, a = (one - beside @ np.linalg.lstsq(beside, one, rcond=None)[0] for one in (force, a))
    return float(force @ a) > PUSHED * float(np.linalg.norm(force) * np.linalg.norm(a))


def shift_of(p: Floats, q: Floats, order: int, frames: Frames, gain: float, gain_error: float = 0.0) -> Shift:
    """Offset and drift of a channel q against `gain` times the `order`-th derivative of p."""
    some = frames._replace(starts=frames.starts[:: OVERLAP // 2])  # frames that overlap by half
    size, level = float(np.ptp(q)), float(q.mean())
    expected = _local_means(gain / size * p, order, some)
    means = _local_means((q - level) / size, 0, some) + level / size
    offset, drift = _line(means - expected, some)
    # an error of the gain adds to offset and drift if the derivative has a mean or a trend, as of a turning shaft
    mean_error, trend_error = (gain_error / gain * value for value in _line(expected, some))
    t = (some.starts - some.starts.mean()) * some.dt
    count = len(t)
    residual = means - expected - offset - drift * t
    variance = float(residual @ residual) / (count - 2)
    return Shift(
        offset=offset * size,
        drift=drift * size,
        offset_t=offset / math.sqrt(max(variance / count + mean_error**2, TINY)),
        drift_t=drift / math.sqrt(max(variance / float(t @ t) + trend_error**2, TINY)),
        freedom=count - 2,
    )


def _local_means(values: Floats, order: int, frames: Frames) -> Floats:
    """Means of the `order`-th derivative of a channel over the window of each frame, (K,)."""
    window = _windows(frames, 0)
    return np.asarray(_weak_derivative(values, frames, order)[:, 0].real / (window.sum() * frames.dt))


def _line(means: Floats, frames: Frames) -> tuple[float, float]:
    """Value at the middle of the frames, and change per second, of a line through local means."""
    t = (frames.starts - frames.starts.mean()) * frames.dt
    return float(means.mean()), float(t @ means / (t @ t))
