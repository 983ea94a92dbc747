"""Constants of `refine` that may decide an answer."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class RefineSettings:
    """Which runs are believed, and which coefficients are accepted."""

    # fmt: off

    lost: float = setting(0.5, "A run follows the record where it leaves less than this share of a channel's spread: "
        "out of step, least squares ends in a meaningless minimum.", "`refinement.csv`")
    wider_chance: float = setting(0.01, "... with this probability.", "`tests/test_refine.py`")
    misfit: float = setting(1.75, "Known noise is not believed where runs leave more than this many times its power: "
        "adequate equations left 0.9 to 1.3 times it.", unit="times")
    closer: float = setting(10.0, "Runs contradict a known sign where 2 ln of the likelihood ratio is above this: "
        "very strong evidence (Kass and Raftery 1995).", "literature", "2 nats")
    windows: float = setting(10.0, "Refined coefficients are accepted where runs over windows of this length are not "
        "worse.", "`refinement.csv`", "periods")
    worse_chance: float = setting(0.025, "... by a sign test at this level: better coefficients, too, run worse over "
        "half of the windows where both are close.", "`refinement.csv`")
    # fmt: on


REFINE = RefineSettings()
