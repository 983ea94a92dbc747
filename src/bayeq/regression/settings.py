"""Constants of the regression that may decide an answer."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class RegressionSettings:
    """Prior odds of terms, what correlated residuals are worth, and intervals."""

    # fmt: off

    first_odds: float = setting(1.0, "Prior log odds of polynomial terms: this less `odds_per_degree` times the "
        "degree, and this of the constant. There are many more candidates of high degree; it matters at 30 % noise "
        "and above.", "set on simulated records", "nats")
    odds_per_degree: float = setting(2.0, "... of the many terms of high degree about as many are expected as of the "
        "few of low degree.", "set on simulated records", "nats")
    effective_share: float = setting(0.67, "Residuals of rows count as correlated where less of them is left as "
        "effective sample size: the likelihood is raised to that. Above, standard deviations are at most 18 % too "
        "small.", cliff=True)
    lag1_significant: float = setting(3.0, "... and the autocorrelation of neighbours exceeds this many of its "
        "standard errors.", unit="se", cliff=True)
    rejected: float = setting(0.5, "... by a model that leaves at most this share of the target's sum of squares; "
        "what a rejected model leaves is the motion itself, which is always correlated.", cliff=True)
    most_terms_to_thin: int = setting(500, "With more candidates all rows count: cost of the pilot fits.",
        unit="candidates", cliff=True)
    hidden_noise: float = setting(0.01, "Hidden noise of an input is worth a sentence where the lowest part of its "
        "spectrum leaves room for this share of its standard deviation, which attenuates by 0.01 %.")
    mixture_mass: float = setting(0.999, "Intervals over models take the likeliest of them up to this share: a tail "
        "of 2.5 % hardly moves.")
    # fmt: on


REGRESSION = RegressionSettings()
