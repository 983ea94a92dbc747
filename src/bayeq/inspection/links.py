"""Search for channels that are derivatives of others, first-order states, or inputs that drive a motion.

Derivatives are found from spectra of both channels (`bayeq.records.consistency`), states of first order and inputs by
least squares on integrals: the change of a channel over a window is the integral of its rate, so that an equation of
motion, integrated over windows, needs no derivative of measured channels. These fits decide roles, not results.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations, product

import numpy as np

from bayeq.arrays import Floats
from bayeq.inspection.channels import ChannelInfo
from bayeq.records import Record
from bayeq.records.consistency import Frames, Relation, derivative_name, relate, uniform_frames
from bayeq.records.names import stated_gain
from bayeq.records.record import with_samples

# Channels are compared on at most ROWS rows in the middle. Longer records are first averaged over blocks, at least
# PER_PERIOD per period of the fastest channel: the same filter on all channels keeps derivatives derivatives.
ROWS = 16_384
PER_PERIOD = 16.0

# Missing samples are interpolated in a channel of which more than this share of the samples is present.
MOSTLY = 0.8

# Maximum number of channels that are compared in pairs: more would take seconds.
MOST_CHANNELS = 16
# Maximum number of combinations of a displacement and a difference of two accelerations that are compared.
MOST_PAIRS = 60

# A channel is the derivative of another if sign and delay explain at least LEAST_FIT of their coherent part, their
# squared coherence is at least LEAST_COHERENCE, and the delay is at most MOST_DELAY rows either way.
LEAST_FIT = 0.9
LEAST_COHERENCE = 0.6
MOST_DELAY = 3.0

# The gain must be that of the units, or of often mixed units if they are unknown, within a factor NEAR; within NAMELESS
# for channels without a meaningful name, because an input is proportional to the derivative of what integrates it.
NEAR, NAMELESS = 1.25, 1.1
MIXED = (1.0, 1e-3, 1e3, 1e-2, 1e2, 9.80665, 9806.65, 2.0 * math.pi, 180.0 / math.pi)

# Any gain is accepted if the derivative's mean frequency exceeds that of the motion by this factor, as in a broad band:
# motions of a single common frequency always fit as derivatives of each other.
BROAD = 1.1
# Minimum ratio of a derivative's mean frequency to that of the motion: below 1, because of noise.
NOT_SLOWER = 0.97

# A channel is a first-order state if the channels and their products explain this share of its changes (a coordinate
# would need its rate). For at least one state the products must reduce the residual variance by the factor CLEARLY:
# smooth channels, as of a controller, are explained by linear sums of each other.
EXPLAINED = 0.8
CLEARLY = 2.0
MOST_STATES = 8
LEAST_ROWS = 16

# A channel drives a motion if it explains this share of the residual of the states and their products.
DRIVES = 0.5

# Correlation, at any lag, of two channels that may measure one motion.
SAME = 0.98

# Accelerations follow their base if the mean square of the difference is below FOLLOWS of their own in both halves of
# the lowest octave in which the base has MOVED of its greatest power, from bin LEAST_BIN on, in a mean of SEGMENTS
# spectra. FOLLOWS is the ratio at 0.7 of the resonance, for motion against the base its inverse.
FOLLOWS, MOVED, LEAST_BIN, SEGMENTS = 0.25, 0.01, 3, 8

# Length of the windows as a share of the period of the fastest state.
WINDOW = 1 / 8


@dataclass(frozen=True, slots=True)
class Link:
    """One channel is the derivative of another."""

    below: str  # the motion
    above: str  # its derivative
    order: int  # 1 or 2
    gain: float  # above = gain times the derivative by seconds of below; negative where the sign is reversed
    delay: float  # delay of `above` [s]
    fit: float  # share of the coherent part of both channels that sign and delay explain
    expected: float | None  # the gain that their units imply

    @property
    def stands_for(self) -> str:
        """The derivative as text."""
        return derivative_name(self.below, self.order)

    @property
    def usual(self) -> bool:
        """Whether the gain is within a factor NAMELESS of that of the units, or of often mixed units."""
        return _nearest(abs(self.gain), self.expected) < math.log(NAMELESS)


def short_record(records: Sequence[Record], channels: Mapping[str, ChannelInfo]) -> Record:
    """The longest record at even steps of time, averaged over blocks and cut to ROWS rows if it is longer."""
    record = _even(max(records, key=lambda one: one.n))
    peaks = [info.spectrum.peak for info in channels.values() if info.spectrum is not None]
    if record.fs is None or not peaks or not record.is_uniform() or record.n <= ROWS:
        return record
    block = int(min(record.fs / (PER_PERIOD * max(peaks)), record.n / ROWS))
    if block > 1:
        assert record.time is not None
        rows = record.n // block * block
        means = {name: values[:rows].reshape(-1, block).mean(axis=1) for name, values in record.channels.items()}
        record = Record(means, record.time[:rows].reshape(-1, block).mean(axis=1), record.units, record.name)
    first = max(0, (record.n - ROWS) // 2)
    return record.slice(first, first + ROWS)


def _even(record: Record) -> Record:
    """The record at even time steps: all channels are interpolated alike, also where a few samples are missing."""
    step = record.dt
    if record.time is None or step is None:
        return record
    known = {name: np.isfinite(values) for name, values in record.channels.items()}
    gappy = {name: rows for name, rows in known.items() if MOSTLY < rows.mean() < 1.0}
    own = record.time
    record = with_samples(record, {name: np.interp(own, own[r], record[name][r]) for name, r in gappy.items()})
    if record.is_uniform():
        return record
    time = own[0] + step * np.arange(min(int((own[-1] - own[0]) / step) + 1, 2 * record.n))
    channels = {name: np.interp(time, own, values) for name, values in record.channels.items()}
    return Record(channels, time, record.units, record.name)


def find_links(record: Record, names: Sequence[str]) -> list[Link]:
    """Pairs of channels of which one is the first or second derivative of the other, the surest first."""
    frames = uniform_frames(record.time)
    if frames is None:
        return []
    used = [name for name in names[:MOST_CHANNELS] if _is_whole(record[name])]
    rates = {name: _mean_frequency(record[name]) for name in used}
    found: list[tuple[float, Link]] = []
    for p, q in permutations(used, 2):
        if rates[q] < NOT_SLOWER * rates[p]:
            continue
        for order in (1, 2):
            expected = stated_gain(record.units, p, q, order)
            if expected is None and p in record.units and q in record.units:  # no units of a motion and this derivative
                continue
            relation = relate(record[p], record[q], order, frames)
            if relation is not None and _is_derivative(relation, expected, rates[q] / rates[p], frames):
                gain = relation.sign * relation.gain
                link = Link(p, q, order, gain, relation.delay, relation.fit, expected)
                found.append((_doubt(relation, expected, frames), link))
    return [link for _, link in sorted(found, key=lambda one: one[0])]


def absolute(
    record: Record, displacements: Sequence[str], accelerations: Sequence[str], bases: Sequence[str]
) -> dict[str, tuple[str, str]]:
    """Absolute accelerations, each with the displacement and the base acceleration that belong to it.

    Acceleration minus base acceleration is the second derivative of the displacement, and fits it clearly better than
    either of them alone.
    """
    frames = uniform_frames(record.time)
    found: dict[str, tuple[str, str]] = {}
    usable = [[name for name in own if _is_whole(record[name])] for own in (displacements, accelerations, bases)]
    pairs = [(q, base) for q, base in product(*usable[1:]) if q != base]
    if frames is None or len(usable[0]) * len(pairs) > MOST_PAIRS:
        return found
    for p in usable[0]:
        for q, base in pairs:
            if record.units.get(q) != record.units.get(base):
                continue
            alone = [relate(record[p], record[one], 2, frames) for one in (q, base)]
            both = relate(record[p], record[q] - record[base], 2, frames)
            expected = stated_gain(record.units, p, q, 2)
            left = [1.0 - one.fit for one in alone if one is not None]
            if both is None or both.sign < 0 or abs(both.delay) > MOST_DELAY * frames.dt:
                continue
            clearly = both.fit > LEAST_FIT and CLEARLY * (1.0 - both.fit) < min(left, default=1.0)
            if clearly and _nearest(both.gain, expected) < math.log(NEAR):
                found[q] = p, base
    return found


def follow(record: Record, accelerations: Sequence[str], base: str) -> bool:
    """Whether accelerations follow that of their base at low frequency, as absolute ones do.

    Well below the resonance there is little motion against the base: an absolute acceleration is that of the base, one
    against the base is nearly zero. Near the resonance a narrow band may look like either, but not both halves of an
    octave.
    """
    names, width = [base, *accelerations], 2 * record.n // (SEGMENTS + 1)
    alike = all(record.units.get(name) == record.units.get(base) and _is_whole(record[name]) for name in names)
    if not alike or uniform_frames(record.time) is None or width < LEAST_ROWS:
        return False

    def power(values: Floats) -> Floats:
        pieces = np.stack([values[k * width // 2 :][:width] for k in range(SEGMENTS)])
        spectra = np.fft.rfft(np.hanning(width) * (pieces - pieces.mean(axis=1, keepdims=True)))
        return np.asarray((np.abs(spectra) ** 2).sum(axis=0))

    strength = power(record[base])[LEAST_BIN:]
    first = LEAST_BIN + int(np.argmax(strength > MOVED * strength.max()))
    middle = math.ceil(math.sqrt(2.0) * first)
    return all(
        power(record[name] - record[base])[a:b].sum() < FOLLOWS * power(record[name])[a:b].sum()
        for name in accelerations
        for a, b in ((first, middle), (middle, 2 * first))
    )


def _is_whole(values: Floats) -> bool:
    """Whether a channel moves, and has all its samples."""
    return bool(np.isfinite(values).all() and np.ptp(values) > 0.0)


def _mean_frequency(values: Floats) -> float:
    """Geometric mean of the frequencies of a channel, weighted by power above noise, in bins."""
    power = np.abs(np.fft.rfft(np.hanning(len(values)) * (values - values.mean())))[1:] ** 2
    power = np.maximum(power - min(float(np.median(band)) for band in np.array_split(power, 4)), 0.0)
    if not power.sum() > 0.0:
        return 1.0
    return math.exp(float(power @ np.log(np.arange(1, len(power) + 1))) / float(power.sum()))


def _nearest(gain: float, expected: float | None) -> float:
    """Distance of ln gain from that of the `expected` gain, or else from that of the nearest often mixed units."""
    if expected is not None:
        return abs(math.log(gain / expected))
    return min(abs(math.log(gain * factor)) for size in MIXED for factor in (size, 1.0 / size))


def _is_derivative(relation: Relation, expected: float | None, faster: float, frames: Frames) -> bool:
    if relation.fit < LEAST_FIT or relation.least_gain < LEAST_COHERENCE * relation.most_gain:
        return False
    if abs(relation.delay) > MOST_DELAY * frames.dt:
        return False
    return faster > BROAD or _nearest(relation.gain, expected) < math.log(NEAR)


def _doubt(relation: Relation, expected: float | None, frames: Frames) -> float:
    """Penalty of a relation: small for a derivative of the right sign and gain, without delay."""
    wrong = min(_nearest(relation.gain, expected), 3.0) + (1.0 if relation.sign < 0 else 0.0)
    return wrong + abs(relation.delay) / frames.dt + 5.0 * (1.0 - relation.fit)


def correlations(record: Record, names: Sequence[str]) -> dict[frozenset[str], float]:
    """Largest absolute correlation over all lags of each pair of channels; empty without even time."""
    if uniform_frames(record.time) is None:
        return {}
    length = 2 * record.n
    spectra = {name: np.fft.rfft(values, length) for name, values in _scaled(record, names[:MOST_CHANNELS]).items()}
    return {
        frozenset((p, q)): float(np.abs(np.fft.irfft(spectra[p] * spectra[q].conj(), length)).max()) / record.n
        for p, q in combinations(spectra, 2)
    }


def twins(record: Record, alike: Mapping[frozenset[str], float]) -> set[frozenset[str]]:
    """Pairs of channels that measure one motion: correlated, and what is left of one given the other is no motion.

    It is noise, or at most one level of the coarser channel. Masses in one mode are as well correlated, but leave a
    motion. The rate in the regression allows for a lag; its derivative would allow for the inertia of a second mass.
    """
    out = set()
    for pair in (pair for pair, largest in alike.items() if largest > SAME):
        p, q = _scaled(record, sorted(pair)).values()
        terms = np.column_stack([np.ones(len(p)), p, np.gradient(p)])
        rest = q - terms @ np.linalg.lstsq(terms, q, rcond=None)[0]
        level = max(float(np.diff(np.unique(values)).min()) for values in (p, q))
        if _is_rough(rest) or float(np.abs(rest).max()) <= level:
            out.add(pair)
    return out


def rough_channels(record: Record, names: Sequence[str]) -> set[str]:
    """Channels that are as rough as noise."""
    return {name for name, values in _scaled(record, names).items() if _is_rough(values)}


def _is_rough(values: Floats) -> bool:
    """Whether the lag-1 autocorrelation is below 0.5, as of noise."""
    return bool(values[1:] @ values[:-1] < 0.5 * (values @ values))


# --- least squares on integrals --------------------------------------------------------------------------------------


def first_order(record: Record, names: Sequence[str], others: Sequence[str]) -> dict[str, float]:
    """First-order states: channels whose changes these channels and inputs `others` explain, each with the share."""
    scaled = _scaled(record, (*names, *others))
    states = [name for name in names if name in scaled]
    if not states or record.time is None or record.n < LEAST_ROWS or len(scaled) > MOST_STATES:
        return {}
    width = _width(scaled, states)
    terms = _products(list(scaled.values()))
    rows = record.n - width
    if rows < max(LEAST_ROWS, 2 * len(terms)):
        return {}
    D = _integrals(terms, record.time, width)
    out, products = {}, False
    for name in states:
        change = scaled[name][width:] - scaled[name][:-width]
        sums, left = (_left(A, change) / (rows - A.shape[1]) for A in (D[:, : 1 + len(scaled)], D))
        spread = max(float(np.sum((change - change.mean()) ** 2)), float(np.finfo(np.float64).tiny))
        share = 1.0 - left / spread * (rows - 1)
        products |= sums > CLEARLY * left
        if share > EXPLAINED:
            out[name] = share
    return out if products else {}


def drivers(record: Record, chain: Sequence[str | None], candidates: Sequence[str]) -> dict[str, float]:
    """Candidates that explain the residual of a chain's own dynamics (x, v, a), each with the share it explains."""
    displacement, velocity, acceleration = chain
    states = [name for name in (displacement, velocity) if name is not None]
    scaled = _scaled(record, [*states, *filter(None, [acceleration]), *candidates])
    target = acceleration or velocity
    if record.time is None or record.n < LEAST_ROWS or target is None or not states:
        return {}
    if any(name not in scaled for name in (*states, target)):
        return {}
    width = _width(scaled, states)
    terms = _products([scaled[name] for name in states]) + [scaled[name] ** 3 for name in states]
    if record.n - width < max(LEAST_ROWS, 4 * len(terms)):
        return {}
    if acceleration is not None:
        change = _integrals([scaled[acceleration]], record.time, width)[:, 1]
    else:
        change = scaled[target][width:] - scaled[target][:-width]
    D = _integrals(terms, record.time, width)
    before = _left(D, change)
    out = {}
    for name in candidates:
        if name in scaled and before > 0.0:
            more = np.column_stack([D, _integrals([scaled[name]], record.time, width)[:, 1]])
            share = 1.0 - _left(more, change) / before
            if share > DRIVES:
                out[name] = share
    return out


def _scaled(record: Record, names: Sequence[str]) -> dict[str, Floats]:
    """Channels without missing samples, of mean 0 and standard deviation 1."""
    out = {}
    for name in names:
        values = record[name]
        if np.isfinite(values).all():
            values = values / (float(np.abs(values).max()) or 1.0)
            out[name] = np.asarray((values - values.mean()) / (float(values.std()) or 1.0))
    return out


def _width(scaled: dict[str, Floats], states: Sequence[str]) -> int:
    peaks = [int(np.argmax(np.abs(np.fft.rfft(scaled[name]))[1:])) + 1 for name in states]
    return max(1, round(WINDOW * len(scaled[states[0]]) / max(peaks)))


def _products(channels: Sequence[Floats]) -> list[Floats]:
    """Channels, their squares and their products."""
    return [*channels, *(channels[i] * channels[j] for i in range(len(channels)) for j in range(i + 1))]


def _integrals(terms: Sequence[Floats], time: Floats, width: int) -> Floats:
    """Integrals over windows from row to row, (n - width, P + 1); the first column is that of a constant."""
    steps = np.diff(time)
    columns = [np.ones(len(time) - width)]
    for term in terms:
        area = np.concatenate([[0.0], np.cumsum(0.5 * (term[1:] + term[:-1]) * steps)])
        columns.append(area[width:] - area[:-width])
    return np.column_stack(columns)


def _left(D: Floats, y: Floats) -> float:
    """Residual sum of squares of a least-squares fit."""
    rest = y - D @ np.linalg.lstsq(D, y, rcond=None)[0]
    return float(rest @ rest)
