"""Constants of the plan of a next measurement."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class PlanSettings:
    """Rivals, and the inputs that are planned."""

    # fmt: off

    models_within: float = setting(12.0, "... without averaging, those one move and as far away.", unit="nats")
    most_rivals: int = setting(4, "Rivals within the odds asked for that are compared, each simulated under every "
        "design; without one the plan is for the coefficients.", unit="models", cliff=True)
    power_below: float = setting(0.005, "The band of an input holds all of its power but this share below,")
    power_above: float = setting(0.05, "... and this above: noise of the channel is spread there.")
    signed: float = setting(0.5, "An input has both signs where the smaller of its extremes is more than this share "
        "of the larger: the range is then even about zero. Extremes of 100 samples of noise are.")
    # fmt: on


PLAN = PlanSettings()
