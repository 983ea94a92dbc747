"""Constants of reading and checking records that may decide an answer."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class RecordSettings:
    """Gaps, times, and what is said of channels that contradict each other."""

    # fmt: off

    longest_gap: float = setting(0.5, "A gap is bridged up to this share of a channel's shortest period, one over "
        "the frequency that `gap_power` of its power lies below: samples that near on either side still fix the wave "
        "between them. What is filled in is wrong by up to 3 % (states) and 7 % (derivatives) of the standard "
        "deviation at half a period, by 20 and 50 % at a whole one.",
        "set on simulated records", "periods", cliff=True)
    gap_power: float = setting(0.99, "Share of a channel's power that lies below the frequency of its shortest "
        "period.", "set on simulated records")
    jitter: float = setting(0.05, "Times that are off an even grid by less are put on it: 5 % move a sample of 75 "
        "per period by less than half a per cent.", unit="steps")
    least_offset: float = setting(0.01, "An offset, or half the change by drift, is reported from this share of the "
        "channel's standard deviation on: smaller ones hardly change an equation.", "set on simulated records")
    least_delay: float = setting(0.2, "A delay is reported from this on.", "set on simulated records", "samples")
    least_gain: float = setting(1.03, "A gain is reported from this factor on.",
        "set on simulated records; one record (pendulum: 5 % gain)")
    significant: float = setting(4.0, "... and each of them if it is so far from nothing.",
        "set on simulated records", "se")
    least_fit: float = setting(0.9, "Two channels are not a signal and its derivative where sign and delay explain a "
        "smaller share of the coherent signal.", "set on simulated records")
    # fmt: on


RECORDS = RecordSettings()
