"""Which channel is the derivative of another: gain and delay, from spectra of both (`bayeq.records.consistency`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from bayeq.inspection.channels import ChannelInfo
from bayeq.records import Record
from bayeq.records.consistency import Frames, Relation, relate, uniform_frames
from bayeq.records.units import derivative_ratio

__all__ = ["Link", "find_links", "first_order", "short_record"]

Floats = NDArray[np.float64]

# Channels are compared on at most this many rows, the middle ones. A faster record is first averaged over blocks of
# rows, as many as leave this many to a period of the fastest channel: a block mean is a filter, alike for all channels,
# that leaves a derivative a derivative.
ROWS = 16_384
PER_PERIOD = 16.0

# More channels than these are not compared, each with each: that would take seconds.
MOST_CHANNELS = 16

# A channel is the derivative of another if a sign and a delay explain this share of what they have in common, this
# share of its power is common (the square of the coherence), and it is not later or earlier than this many rows.
LEAST_FIT = 0.9
LEAST_COHERENCE = 0.6
MOST_DELAY = 3.0

# ... and the gain is that of the units, or, where they are not known, of units that are often mixed, within this factor.
NEAR = 1.25
MIXED = (1.0, 1e-3, 1e3, 1e-2, 1e2, 9.80665, 2.0 * math.pi, 180.0 / math.pi)

# Any gain is accepted of channels that move over a band this wide: the factor of the derivative's mean frequency to
# that of the motion. A motion of one frequency is the derivative of anything that has it.
BROAD = 1.1
# Noise may bring the frequency of a derivative this near to that of the motion, or below.
NOT_SLOWER = 0.97

# A channel is a state of first order if this share of its changes is explained by the channels themselves and their
# products; of a coordinate of second order hardly any is, for its rate is a state of its own.
EXPLAINED = 0.8
MOST_STATES = 8
LEAST_ROWS = 16


@dataclass(frozen=True, slots=True)
class Link:
    """One channel is the derivative of another.

    Attributes
    ----------
    below, above : str
        The motion and its derivative.
    order : int
        1 or 2.
    gain : float
        above = gain times the derivative by seconds of below; negative where the sign is reversed.
    delay : float
        Of `above` [s].
    fit : float
        Share of what the channels have in common that this explains.
    expected : float or None
        The gain that their units say.
    """

    below: str
    above: str
    order: int
    gain: float
    delay: float
    fit: float
    expected: float | None

    @property
    def stands_for(self) -> str:
        """The derivative as text."""
        return f"d{self.below}/dt" if self.order == 1 else f"d{self.order}{self.below}/dt{self.order}"


def short_record(records: Sequence[Record], channels: Mapping[str, ChannelInfo]) -> Record:
    """The longest record at even steps of time, averaged over blocks and cut so that comparisons are quick."""
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
    """Channels interpolated at even steps of time: what is between samples is a guess, but alike for all channels."""
    step = record.dt
    if record.time is None or step is None or record.is_uniform():
        return record
    time = record.time[0] + step * np.arange(min(int((record.time[-1] - record.time[0]) / step) + 1, 2 * record.n))
    channels = {name: np.interp(time, record.time, values) for name, values in record.channels.items()}
    return Record(channels, time, record.units, record.name)


def find_links(record: Record, names: Sequence[str]) -> list[Link]:
    """Pairs of channels of which one is the first or second derivative of the other, the surest first.

    Parameters
    ----------
    record : Record
        A short one; without even steps of time nothing is found.
    names : sequence of str
        Channels to compare, the first 16.
    """
    frames = None if record.time is None else uniform_frames(record.time)
    if frames is None or record.time is None:
        return []
    used = [name for name in names[:MOST_CHANNELS] if np.isfinite(record[name]).all() and np.ptp(record[name]) > 0.0]
    rates = {name: _mean_frequency(record[name]) for name in used}
    found: list[tuple[float, Link]] = []
    for p, q in permutations(used, 2):
        if rates[q] < NOT_SLOWER * rates[p]:
            continue
        for order in (1, 2):
            expected = _expected(record, p, q, order)
            if expected is not None and math.isnan(expected):
                continue
            relation = relate(record.time, record[p], record[q], order, frames)
            if relation is not None and _is_derivative(relation, expected, rates[q] / rates[p], frames):
                gain = relation.sign * relation.gain
                link = Link(p, q, order, gain, relation.delay, relation.fit, expected)
                found.append((_doubt(relation, expected, frames), link))
    return [link for _, link in sorted(found, key=lambda one: one[0])]


def _mean_frequency(values: Floats) -> float:
    """Geometric mean of the frequencies of a channel, weighted by power above noise, in bins."""
    power = np.abs(np.fft.rfft(np.hanning(len(values)) * (values - values.mean())))[1:] ** 2
    power = np.maximum(power - min(float(np.median(band)) for band in np.array_split(power, 4)), 0.0)
    if not power.sum() > 0.0:
        return 1.0
    return math.exp(float(power @ np.log(np.arange(1, len(power) + 1))) / float(power.sum()))


def _expected(record: Record, p: str, q: str, order: int) -> float | None:
    """The gain that units say; None where one is not known, NaN where they contradict a derivative."""
    below, above = record.units.get(p), record.units.get(q)
    if below is None or above is None:
        return None
    ratio = derivative_ratio(below, above, order)
    return float("nan") if ratio is None else ratio


def _nearest(gain: float, expected: float | None) -> float:
    """How far a gain is from what units may make it, as a logarithm."""
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
    """Small for a derivative of the right sign and gain, without delay."""
    wrong = min(_nearest(relation.gain, expected), 3.0) + (1.0 if relation.sign < 0 else 0.0)
    return wrong + abs(relation.delay) / frames.dt + 5.0 * (1.0 - relation.fit)


def first_order(record: Record, names: Sequence[str], others: Sequence[str]) -> dict[str, float]:
    """Channels whose changes are explained by the channels themselves, each with the share that is explained.

    Changes over an eighth of a period are compared with integrals over the same time of the channels and their products:
    the equation of a first-order state, integrated, without differentiating what is measured.

    Parameters
    ----------
    record : Record
        A short one, with time.
    names : sequence of str
        Channels that may be states.
    others : sequence of str
        Inputs.
    """
    used = [name for name in (*names, *others) if np.isfinite(record[name]).all()]
    states = [name for name in names if name in used]
    if not states or record.time is None or len(used) > MOST_STATES:
        return {}
    scaled = {name: _standardised(record[name]) for name in used}
    peak = max(1, max(int(np.argmax(np.abs(np.fft.rfft(scaled[name]))[1:])) + 1 for name in states))
    width = max(1, round(record.n / (8 * peak)))
    rows = record.n - width
    terms = [scaled[name] for name in used]
    terms += [terms[i] * terms[j] for i in range(len(used)) for j in range(i + 1)]
    if rows < max(LEAST_ROWS, 2 * len(terms)):
        return {}
    steps = np.diff(record.time)
    design = [np.ones(rows)]
    for term in terms:
        area = np.concatenate([[0.0], np.cumsum(0.5 * (term[1:] + term[:-1]) * steps)])
        design.append(area[width:] - area[:-width])
    D = np.column_stack(design)
    out = {}
    for name in states:
        change = scaled[name][width:] - scaled[name][:-width]
        left = change - D @ np.linalg.lstsq(D, change, rcond=None)[0]
        lost = float(left @ left) / max(float(np.sum((change - change.mean()) ** 2)), 1e-300)
        share = 1.0 - lost * (rows - 1) / (rows - D.shape[1])
        if share > EXPLAINED:
            out[name] = share
    return out


def _standardised(values: Floats) -> Floats:
    scaled = values / (float(np.abs(values).max()) or 1.0)
    return np.asarray((scaled - scaled.mean()) / (float(scaled.std()) or 1.0))
