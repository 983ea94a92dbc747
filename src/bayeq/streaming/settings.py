"""Constants of long records that may decide an answer."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class StreamingSettings:
    """Stretches, blocks and lags."""

    # fmt: off

    stretches: int = setting(20, "Stretches of 5,000 rows, spread evenly, that are looked at first. Of a million "
        "rows 15 of 15 coefficients were within 0.1 sd of those in memory, the furthest 0.07 off; twenty seconds.",
        "`long_records.csv`")
    near: float = setting(0.05, "A further pass is made where a noise level or a standard deviation moves by a "
        "larger share.", "`tests/test_streaming.py`")
    # fmt: on


STREAMING = StreamingSettings()
