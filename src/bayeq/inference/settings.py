"""Constants of the engines that may decide an answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class InferenceSettings:
    """Listing of models, sampling in its place, and signs."""

    # fmt: off

    most_selected: int = setting(30, "Unit of the noise prior with fewer than max(10, 0.1 n) spare rows: the "
        "residual of a forward selection of n/4 terms, at most this many; else the residual of all terms.",
        unit="terms", cliff=True)
    most_left_out: float = setting(0.02, "Chains are sampled in place of a listing where inclusion probabilities "
        "would be off by more.", cliff=True)
    signs_contradicted: float = setting(math.log(100.0), "Data contradict known signs where the Bayes factor against "
        "these is larger: a warning; the search then goes by the weights with the signs.",
        "`tests/test_signs.py`", "nats")
    # fmt: on


INFERENCE = InferenceSettings()
