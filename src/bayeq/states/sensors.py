"""Sensors of a chain: noise, gains, lags, and units: v in m/s with x in mm is 0.001 times dx/dt.

Where both units are stated their ratio is exact. Otherwise it is estimated from the spectra.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from bayeq.arrays import Complexes, Floats
from bayeq.errors import InputError, UnknownNameError, require_mapping
from bayeq.numerics.settings import STATES
from bayeq.records import Record
from bayeq.records.names import stated_gain
from bayeq.records.validate import even_step
from bayeq.states.roles import Chain, Roles

Tails = Literal["gauss", "student"]

# Noise of a channel said to have none, as a share of its standard deviation: the smoother divides by noise.
LEAST_SHARE = 1e-5

# A force counts as blows, made zero between them by a window, if less than this share of its samples is not zero.
MOST_IN_BLOWS = 0.5

# A larger standard deviation of a lag, as a share of the longest record, is taken for a mistake.
MOST_LAG = 0.1

_FORMS = {
    "noise": "a number in its unit, a share of its standard deviation such as '2%', or of every reading such as"
    " '5% of reading' ('% of reading': learned), not negative",
    "gain_sd": "a relative standard deviation, such as 0.01 for 1 %, not negative",
    "lag_sd": "a standard deviation in seconds, such as 0.002, above 0",
}


@dataclass(frozen=True)
class _Learned:
    """A calibration parameter of a channel, estimated from the record."""

    value: float  # estimate
    sd: float  # its standard deviation
    prior_sd: float  # standard deviation of its normal prior, as given

    unit: ClassVar[str] = ""

    def __str__(self) -> str:
        digits = max(0, 1 - math.floor(math.log10(self.sd))) if self.sd > 0.0 else 6
        return f"{self.value:.{digits}f} +- {self.sd:.{digits}f}{self.unit}"


@dataclass(frozen=True)
class Gain(_Learned):
    """The factor of a channel, about 1: a sample is this factor times the measured quantity."""


@dataclass(frozen=True)
class Lag(_Learned):
    """The delay of a channel [s]: its sample at time t belongs to time t less the lag; negative if it is early."""

    unit: ClassVar[str] = " s"


@dataclass(frozen=True)
class Sensors:
    """Known properties of the sensors of channels, by channel name."""

    # standard deviation of the noise in the channel's unit, where it was given; for noise in proportion to the reading,
    # the root mean square of that noise
    noise: Mapping[str, float] = field(default_factory=dict)
    gain_sd: Mapping[str, float] = field(default_factory=dict)  # sd of the factor of a sensor, 0.01 for 1 %
    tails: Tails = "gauss"  # of the noise: normal, or Student's t, whose tails are heavier
    lags: Mapping[str, Lag] = field(default_factory=dict)  # lags of channels that may be late
    # noise in proportion to the reading, as a share of it; 0 where that is to be learned
    of_reading: Mapping[str, float] = field(default_factory=dict)
    gains: Mapping[str, Gain] = field(default_factory=dict)  # factors estimated from other channels of the chain

    def gain(self, name: str) -> Gain:
        """The estimated factor of a channel in `gain_sd`; without an estimate its prior."""
        return self.gains.get(name, Gain(1.0, self.gain_sd[name], self.gain_sd[name]))


def check_sensors(
    noise: Mapping[str, float | str],
    gain_sd: Mapping[str, float | str],
    roles: Roles,
    lag_sd: Mapping[str, float | str],
) -> None:
    """Raise an UnknownNameError for a channel without a role, an InputError for a value out of range."""
    known = roles.channels
    for what, given in (("noise", noise), ("gain_sd", gain_sd), ("lag_sd", lag_sd)):
        require_mapping(given, what)
        for name, value in given.items():
            if name not in known:
                raise UnknownNameError("channel", name, known, where=what)
            _amount(what, name, (share_of_reading(value) if what == "noise" else None) or value)


def known_sensors(
    noise: Mapping[str, float | str],
    gain_sd: Mapping[str, float | str],
    roles: Roles,
    records: Sequence[Record],
    tails: Tails = "gauss",
    lag_sd: Mapping[str, float | str] | None = None,
) -> Sensors:
    """`Sensors` from a user's values, in units of the records; an InputError refuses too large noise and lags."""
    used = roles.channels
    levels, readings = dict[str, float](), dict[str, float]()
    gains = {name: _amount("gain_sd", name, v)[0] for name, v in gain_sd.items() if name in used}
    for name, value in noise.items():
        if name not in used:
            continue
        values = np.concatenate([np.asarray(record[name]) for record in records])
        text = share_of_reading(value)
        if text is not None:
            readings[name] = _amount("noise", name, text)[0]
            if readings[name] >= 1.0:
                raise InputError(f"noise: {name!r} needs less than 100 % of reading; got {value!r}")
            if readings[name]:
                levels[name] = readings[name] * float(np.sqrt(np.nanmean(values**2)))
            continue
        amount, share = _amount("noise", name, value)
        spread = float(np.nanstd(values))
        levels[name] = amount * spread if share else amount
        if levels[name] >= spread:
            raise InputError(
                f"noise: the noise of {name!r} is given as {levels[name]:g}, and the standard deviation of the channel"
                f" is {spread:g}: nothing else would be in it; check the unit"
            )
        blows = force_of_blows(name, records) if name in roles.inputs else None
        if blows is not None and levels[name]:
            # noise in the few rows of a blow acts like a factor of the force, and between blows there is none
            gains[name] = math.hypot(gains.get(name, 0.0), levels[name] / math.sqrt(float(blows @ blows)))
            levels[name] = 0.0
    late = {name: _amount("lag_sd", name, v)[0] for name, v in (lag_sd or {}).items() if name in used}
    longest = max((record.n / record.fs for record in records if record.fs is not None), default=math.inf)
    for name, sd in late.items():
        if sd > MOST_LAG * longest:
            raise InputError(
                f"lag_sd: {name!r} has {sd:g} s, more than a tenth of the longest record ({longest:.3g} s): it needs"
                f" {_FORMS['lag_sd']}"
            )
    return Sensors(levels, gains, tails, {name: Lag(0.0, sd, sd) for name, sd in late.items()}, readings)


def force_of_blows(name: str, records: Sequence[Record]) -> Floats | None:
    """The samples of a force that are not 0, if a window has made it 0 between blows; None for any other channel."""
    values = np.concatenate([np.asarray(record[name]) for record in records])
    values = values[np.isfinite(values)]
    blows = values[values != 0.0]
    if not 0 < len(blows) < MOST_IN_BLOWS * len(values) or len(np.unique(blows)) < 0.5 * len(blows):
        return None
    return blows


def share_of_reading(value: float | str) -> str | None:
    """The share in ``"5% of reading"`` as text, 0 % where none is given; None for other amounts."""
    share, words, rest = value.partition("of reading") if isinstance(value, str) else ("", "", "")
    if not words or rest.strip():
        return None
    return "0%" if share.strip() == "%" else share


def _amount(what: str, name: str, value: float | str) -> tuple[float, bool]:
    """A value and whether it is a share of the channel's standard deviation."""
    text = value.strip() if isinstance(value, str) else value
    share = isinstance(text, str) and text.endswith("%")
    try:
        if isinstance(text, bool):
            raise TypeError
        number = float(text[:-1]) / 100.0 if isinstance(text, str) and share else float(text)
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 <= number < math.inf or (what == "lag_sd" and (share or number == 0.0)):
        raise InputError(f"{what}: {name!r} needs {_FORMS[what]}; got {value!r}")
    return number, share


def scaled_with(chains: Sequence[Chain], channel: str) -> tuple[str, ...]:
    """Columns that a factor of a channel multiplies: its own, and derivatives that are estimated from it."""
    out = [channel]
    for chain in chains:
        present = [k for k, name in enumerate(chain.measured) if name is not None]
        for k, name in enumerate(chain.names):
            source = max((i for i in present if i < k), default=present[0])
            if k not in present and chain.measured[source] == channel:
                out.append(name)
    return tuple(out)


# An estimate is made from the strongest lines of the spectra: those above a share STRONG of the largest, at most
# SHARE_OF_LINES times the rows, at least LEAST_LINES. They show one motion if their squared coherence exceeds COHERENT.
# Two white channels, proportional to each other but compared as x and x'', have 5/9.
STRONG = 0.1
SHARE_OF_LINES = 1 / 100
LEAST_LINES = 5
COHERENT = 0.7

# More rows of a record are not needed: a thousand lines determine any factor.
MOST_ROWS = 100_000

# Share of independent lines in the transform of a Hann window.
INDEPENDENT = 2 / 3

# Error of an estimate: SIGNIFICANT standard errors; at least LEAST_ERROR, because of calibration and filters; and in
# records of n rows at least ENDS / n, because of the ends of the window.
SIGNIFICANT = 4.0
LEAST_ERROR = 0.005
ENDS = 2.0

# Straight lines over missing samples may cut off all peaks, as of a clipped channel: the amplitude is then smaller by
# about this many times their share, for peaks are three standard deviations high.
CUT_OFF = 9.0

# An estimate is used if the error of its logarithm is at most this.
MOST_ERROR = 1.0

# Ratios of units that are mixed without being stated, the most plausible first: none; prefixes; accelerations in g with
# lengths in m, mm, um or cm; degrees or turns with radians; other powers of ten.
GRAVITY = 9.80665
PREFIXES = (1e-3, 1e3, 1e-6, 1e6, 1e-2, 1e2)
IN_G = (1.0 / GRAVITY, 1e-3 / GRAVITY, 1e-6 / GRAVITY, 1e-2 / GRAVITY)
ANGLES = tuple(factor**sign for factor in (math.pi / 180.0, 2.0 * math.pi) for sign in (1, -1))
OTHERS = tuple(10.0**k for k in range(-18, 19))

# A factor between two channels below this cannot be due to units.
UNLIKE = 2.0

# Orders of derivatives that can be compared: the window's own derivatives are written out up to here.
MOST_ORDER = 2


def rates(chain: Chain, gains: Sequence[float]) -> tuple[float, ...]:
    """Factor from each channel above the coordinate's to the derivative by time of the channel below it, (K,).

    The gains of a chain of order K are those of `unit_gains`; empty where all are 1.

    Examples
    --------
    >>> from bayeq.states import parse_chain
    >>> rates(parse_chain("x:v:a"), (1.0, 0.001, 0.001))
    (1000.0, 1.0)
    """
    whole = tuple(gains) or (1.0,) * (chain.order + 1)
    return tuple(below / above for below, above in pairwise(whole))


def of_no_unit(chain: Chain, gains: Sequence[float], units: Mapping[str, str]) -> tuple[str, str, float] | None:
    """A channel, a lower one, and the factor of the first to the derivative of the second, if no unit explains it."""
    measured = [(k, name) for k, name in enumerate(chain.measured[: len(gains)]) if name is not None]
    for place, (k, name) in enumerate(measured[1:], 1):
        found = []
        for j, below in measured[:place]:
            stated = stated_gain(units, below, name, k - j) or 1.0
            found.append((below, abs(gains[k] / gains[j]) / stated))
        below, off = min(found, key=lambda one: abs(math.log(one[1])))
        if 1e-6 < abs(math.log(off)) < math.log(UNLIKE):
            return name, below, off
    return None


def unit_gains(
    records: Sequence[Record],
    chain: Chain,
    rows: Sequence[int] | None = None,
    gain_sd: Mapping[str, float] | None = None,
) -> Floats:
    """Factor of each derivative's channel to the derivative in the unit that the lowest measured one implies, (K+1,).

    A derivative that is not measured has the factor of the one below it; factors are negative for the opposite sign.
    They are learned from the first `rows` of each record, by default all. A factor that errors of calibration,
    `gain_sd`, may explain is not taken for one of units.
    """
    cuts = [record.n for record in records] if rows is None else list(rows)
    gains, gain_sd = np.ones(chain.order + 1), gain_sd or {}
    known = {chain.lowest: str(chain.measured[chain.lowest])}
    for k in range(chain.lowest + 1, chain.order + 1):
        name = chain.measured[k]
        if name is None:
            gains[k] = gains[k - 1]
            continue
        stated = {j: _stated(records, below, name, k - j) for j, below in known.items()}
        j = next((j for j, ratio in stated.items() if ratio is not None), max(known))
        found = _estimated(records, cuts, known[j], name, k - j)
        if found is not None:
            by_gain = SIGNIFICANT * math.hypot(gain_sd.get(known[j], 0.0), gain_sd.get(name, 0.0))
            found = found._replace(error=found.error + by_gain)
        gains[k] = gains[j] * _decided(stated[j], found, acceleration=k == 2)
        known[k] = name
    return gains


def _stated(records: Sequence[Record], below: str, above: str, order: int) -> float | None:
    """The ratio of the stated units; None where a record states none, or they disagree."""
    clocks = {record.units.get("t", "s") for record in records}
    found = {stated_gain(record.units, below, above, order) for record in records}
    return found.pop() if len(found) == 1 and clocks == {"s"} else None


class _Estimate(NamedTuple):
    gain: float
    # allowed error of ln |gain|
    error: float

    def distance(self, gain: float) -> float:
        return abs(math.log(abs(self.gain) / gain))


def _decided(stated: float | None, found: _Estimate | None, acceleration: bool) -> float:
    """The stated ratio, the first usual one that agrees with the estimate, or else the nearest or the estimate."""
    if found is None:
        return 1.0 if stated is None else stated
    usual = (1.0, *PREFIXES, *(IN_G if acceleration else ()), *ANGLES, *OTHERS)
    agreeing = [gain for gain in usual if found.distance(gain) <= found.error]
    ratio = (agreeing or [min(usual, key=found.distance)])[0]
    if stated is not None and found.distance(stated) <= STATES.calibration + found.error:
        ratio = stated
    return math.copysign(ratio, found.gain) if found.distance(ratio) <= STATES.calibration + found.error else found.gain


def _estimated(records: Sequence[Record], cuts: Sequence[int], below: str, above: str, order: int) -> _Estimate | None:
    """The ratio of the strongest lines of both spectra; None where they do not show one motion.

    By regression on one channel the ratio is too small because of that channel's noise, on the other too large: the
    estimate is the geometric mean of both, and its error covers both. Its random error is that of a frequency response
    (Bendat and Piersol 2010, section 9.2).
    """
    if order > MOST_ORDER:
        return None
    cross, power, expected, count, missing = 0.0, 0.0, 0.0, 0, 0.0
    pairs = list(zip(records, cuts, strict=True))
    # so that no power of the samples overflows
    sizes = [max(float(np.ptp(bridged(r[name][:cut]))) for r, cut in pairs) or 1.0 for name in (below, above)]
    for record, cut in pairs:
        if record.time is None or cut <= LEAST_LINES:
            continue
        cut = min(cut, MOST_ROWS)
        step = even_step(np.asarray(record.time)[:cut])
        if step is None:
            continue
        x, y = (bridged(record[name][:cut]) / size for name, size in zip((below, above), sizes, strict=True))
        lines, slopes, given = (_lines(values - values.mean(), step, k) for values, k in ((x, 0), (x, order), (y, 0)))
        missing += sum(float(np.isnan(record[name][:cut]).sum()) for name in (below, above))
        strength = np.abs(lines) * np.abs(given)
        many = min(int(SHARE_OF_LINES * cut), int(np.count_nonzero(strength >= STRONG * strength.max())))
        strongest = np.argsort(-strength)[: max(LEAST_LINES, many)]
        given, slopes = given[strongest], slopes[strongest]
        cross += float(np.real(np.vdot(slopes, given)))
        power += float(np.vdot(given, given).real)
        expected += float(np.vdot(slopes, slopes).real)
        count += len(strongest)
    coherence = cross**2 / (power * expected) if power * expected > 0.0 else 0.0
    if not coherence > COHERENT:
        return None
    random = math.sqrt(max(1.0 - coherence, 0.0) / (2.0 * coherence * INDEPENDENT * count))
    error = max(LEAST_ERROR, ENDS / sum(cuts), SIGNIFICANT * random - 0.5 * math.log(coherence))
    error += CUT_OFF * missing / sum(cuts)
    if error > MOST_ERROR:
        return None
    return _Estimate(math.copysign(math.sqrt(power / expected), cross) * sizes[1] / sizes[0], error)


def bridged(samples: Floats) -> Floats:
    """The samples, missing ones interpolated."""
    known = np.flatnonzero(np.isfinite(samples))
    return np.interp(np.arange(len(samples)), known, samples[known]) if len(known) else np.zeros(len(samples))


def _lines(samples: Floats, step: float, order: int) -> Complexes:
    """Transform of a Hann window times the derivative of a signal, from the signal by the product rule."""
    n = len(samples)
    phase = 2.0 * np.pi * (np.arange(n) + 0.5) / n
    rate = 2.0 * np.pi / (n * step)
    windows = (0.5 - 0.5 * np.cos(phase), 0.5 * rate * np.sin(phase), 0.5 * rate**2 * np.cos(phase))
    omega = 2j * np.pi * np.fft.rfftfreq(n, step)
    a, b, c = (np.fft.rfft(window * samples) for window in windows)
    return (a, omega * a - b, omega**2 * a - 2.0 * omega * b + c)[order][2:]
