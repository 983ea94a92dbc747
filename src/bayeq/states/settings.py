"""Constants of the states of motion that may decide an answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class StateSettings:
    """Bad samples, computed channels, what is held out, and the smoother of a chain."""

    # fmt: off

    spike: float = setting(6.0, "A sample is a spike where its leave-one-out error is larger: two Gaussian samples "
        "in 1e9 are; none of 4e5 was left out.", "`tests/test_bad_samples.py`", "sd", cliff=True)
    agrees: float = setting(0.5, "... and where neither the sample on one side nor what all of that side predict "
        "comes within this share of its error: before and after a jump one side does.", "`tests/test_bad_samples.py`")
    computed: float = setting(0.5, "A channel was computed from a lower one where a filter leaves less than this "
        "share of the noise that it lets through. Computed channels left 0.06 to 0.15, sensors 1.15 to 2.5 (four "
        "oscillators, 0.5 and 5 % noise).", "set on simulated records; one record (air track)", cliff=True)
    filter_reach: int = setting(16, "Samples on either side that this filter takes in.",
        "set on simulated records; one record (air track)", "samples")
    farthest: float = setting(1e4, "A channel that lies this many times its range from zero is refused: at 100,000 "
        "standard deviations the smoother's matrices are singular, at 10,000 answers are right.",
        "set on a simulated record", "times")
    calibration: float = setting(math.log(1.1), "The ratio of units within a chain is the declared one, else a usual "
        "factor, if the measured one is as near (a logarithm): 10 % is calibration, not another unit.")
    few_rows: int = setting(10, "Fewer rows in all records together are differentiated as they are: nothing "
        "distinguishes noise from motion.", unit="rows", cliff=True)
    rows_per_order: int = setting(5, "A chain takes this many training rows for each of its derivatives and the "
        "coordinate. A growth curve of 26 rows has its law.", "`tests/test_projection.py`", "rows", cliff=True)
    rows_to_hold_out: int = setting(50, "Of fewer rows none is held out: scores of ten rows say little.",
        unit="rows", cliff=True)
    least_gain: float = setting(0.9, "The band of rows is where the smoother's gain is at least this: beyond, both "
        "sides lose signal.", "`coverage_smoothed.csv`")
    most_extra: int = setting(4, "Order of the motion model above the highest derivative, at most, by the "
        "leave-one-out density.", "`channels.csv`")
    emerged: float = setting(3.0, "Where the displacement is not measured the band begins where the density is this "
        "many times that of the noise, without a break from there to the highest peak: a line that stands out far "
        "below the peak is chance or drift, and the path integrated from there would drift.",
        "`channels.csv`", "times")
    emerged_chance: float = setting(1e-3, "... and more than chance gives with this probability.", "`channels.csv`")
    hum_line: float = setting(30.0, "Hum is a bin of more power than this many medians of the bins on both sides: "
        "white noise makes such a bin once in 2^30.", "`tests/test_band.py`", "times")
    # fmt: on


STATES = StateSettings()
