"""Constants of free runs that may decide an answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class ForecastSettings:
    """Windows of runs that are compared."""

    # fmt: off

    fallen: float = setting(math.exp(-1.0), "Windows of motion that nothing drives end where the autocorrelation has "
        "fallen to this.", "`tests/test_verdict.py`")
    returns: float = setting(3.0, "... where it does not come back above it within this, else after a period: Van "
        "der Pol's (mu 5) came back within 2, Roessler's within 3 (14 systems without noise, one record each).",
        "`tests/test_verdict.py`", "periods")
    # fmt: on


FORECAST = ForecastSettings()
