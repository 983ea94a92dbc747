"""`Sensors`: what is known of the channels before the record is looked at, noise levels and calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError, require_mapping
from bayeq.records import Record
from bayeq.states.roles import Chain, Roles

Tails = Literal["gauss", "student"]

# Noise of nothing, as a share of the standard deviation of a channel: the smoother divides by it.
LEAST_SHARE = 1e-5

# Of a force that a window has made zero between blows the blows are less than this share of the samples.
MOST_IN_BLOWS = 0.5

_FORMS = {
    "noise": "a number in its unit, a share of its standard deviation such as '2%', or of every reading such as"
    " '5% of reading' ('% of reading': learned), not negative",
    "gain_sd": "a relative standard deviation, such as 0.01 for 1 %, not negative",
    "lag_sd": "a standard deviation in seconds, such as 0.002, above 0",
}


@dataclass(frozen=True, slots=True)
class Lag:
    """How late a channel is: its sample at time t is of time t less the lag."""

    value: float  # the likeliest lag [s], negative of a channel that is early
    sd: float  # its standard deviation
    prior_sd: float  # what was given: the standard deviation of its normal prior of mean 0

    def __str__(self) -> str:
        digits = max(0, 1 - math.floor(math.log10(self.sd))) if self.sd > 0.0 else 6
        return f"{self.value:.{digits}f} +- {self.sd:.{digits}f} s"


@dataclass(frozen=True)
class Sensors:
    """What is known of channels, by their names."""

    # standard deviation of the noise in the channel's unit, where it was given; of noise in proportion to the reading
    # its root mean square
    noise: Mapping[str, float] = field(default_factory=dict)
    gain_sd: Mapping[str, float] = field(default_factory=dict)  # sd of the factor of a sensor, 0.01 for 1 %
    tails: Tails = "gauss"  # of the noise: normal, or Student's t, whose tails are heavier
    lags: Mapping[str, Lag] = field(default_factory=dict)  # of channels that may be late
    # share of noise that is in proportion to what is measured; 0 where it is to be learned
    of_reading: Mapping[str, float] = field(default_factory=dict)

    def noisy(self, name: str) -> bool:
        """Whether noise was given that is not zero."""
        return self.noise.get(name, 0.0) > 0.0 or name in self.of_reading


def check_sensors(
    noise: Mapping[str, float | str],
    gain_sd: Mapping[str, float | str],
    roles: Roles,
    lag_sd: Mapping[str, float | str] | None = None,
) -> None:
    """Refuse what cannot be used, before any work.

    That is a channel that plays no part (UnknownNameError), or a value that is no number, negative or infinite
    (InputError).
    """
    known = roles.channels
    for what, given in (("noise", noise), ("gain_sd", gain_sd), ("lag_sd", {} if lag_sd is None else lag_sd)):
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
    """What was given of the channels of some records, in their units.

    Channels that are not measured apart (`bayeq.states.measured_apart`) are left out. An InputError refuses noise that
    exceeds what was measured.
    """
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
            # noise of a few rows acts as a factor of the force, and between blows there is none
            gains[name] = math.hypot(gains.get(name, 0.0), levels[name] / math.sqrt(float(blows @ blows)))
            levels[name] = 0.0
    late = {name: _amount("lag_sd", name, v)[0] for name, v in (lag_sd or {}).items() if name in used}
    return Sensors(levels, gains, tails, {name: Lag(0.0, sd, sd) for name, sd in late.items()}, readings)


def force_of_blows(name: str, records: Sequence[Record]) -> Floats | None:
    """Samples of blows, of a force that a window has made 0 between them; None of any other channel.

    Their values hardly repeat, and those between them are one and the same.
    """
    values = np.concatenate([np.asarray(record[name]) for record in records])
    values = values[np.isfinite(values)]
    blows = values[values != 0.0]
    if not 0 < len(blows) < MOST_IN_BLOWS * len(values) or len(np.unique(blows)) < 0.5 * len(blows):
        return None
    return blows


def share_of_reading(value: float | str) -> str | None:
    """The share of ``"5% of reading"``, 0 where none is given; None of other amounts."""
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
    """Columns that a factor of a channel multiplies: its own, and derivatives that are estimated from it.

    A derivative that is not measured comes from the next lower one that is; where there is none, from the next higher.
    """
    out = [channel]
    for chain in chains:
        present = [k for k, name in enumerate(chain.measured) if name is not None]
        for k, name in enumerate(chain.names):
            if k in present:
                continue
            lower = [i for i in present if i < k]
            source = lower[-1] if lower else present[0]
            if chain.measured[source] == channel:
                out.append(name)
    return tuple(out)
