"""Constants of the record's likelihood that may decide an answer."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class LikelihoodSettings:
    """Priors, levels, the search over models, and the tests of its answer."""

    # fmt: off

    most_candidates: int = setting(1000, "Candidates in all equations; of more, those that explain most are kept: of "
        "four channels and 4000 rows they take a minute.", cliff=True)
    stretches_above: int = setting(16_000, "Longer records are searched at first in four stretches of as many rows "
        "in all; coefficients agree within 0.1 standard deviations.", "`tests/test_likelihood.py`", "rows")

    # Priors
    prior_share: float = setting(5.0, "Prior variance of a coefficient: its term explains this many times the "
        "variance of the target. Terms of chaotic systems cancel each other: with 1 some are split, with 3 to 10 the "
        "same equations were found.", "set on simulated records", "times")
    unshrunk: float = setting(1e-3, "Coefficients that are reported have this share of the prior's precision: no "
        "difference where the record tells them; shrinks them where it hardly does.",
        "`tests/test_projection.py` (growth of 26 rows)")
    far_from_zero: float = setting(10.0, "Where a squared mean is above this many times the variance, the prior of "
        "the constant allows for the offset too: an input of 100 standard deviations from zero lost its equation.",
        "`tests/test_torture.py`; set on simulated records", "times")
    first_state_sd: float = setting(10.0, "The first state is known to this many standard deviations of each state, "
        "and no better.", unit="sd")

    # Levels: noise, discrepancies and what inputs do between samples
    shortest_memory: float = setting(0.02, "Of a discrepancy this much is left after a sample, at least; in fits "
        "twice of it: it is nearly white.")
    longest_memory: float = setting(0.999, "Of a discrepancy this much is left after a sample, at most: nearly "
        "constant.")
    memory_share: float = setting(0.4, "In fits a discrepancy forgets in this share of the motion's own time, "
        "sd(x)/sd(dx/dt): one of longer memory relaxes as a law does and replaces it, one of shorter memory leaves a "
        "slow force that nobody measured to false terms.", "`memory.csv`")
    least_discrepancy: float = setting(1e-8, "Of discrepancies, a share of the target's variance; octaves that have "
        "less, more than white noise, are compared with nothing: rounding and integration of channels without noise.",
        "`forces.csv`")
    most_course: float = setting(1.0, "What courses of inputs between samples err by, at most, as a share of the "
        "square of their bends: none is further off than a straight line.", "`forces.csv`")
    first_course: float = setting(1e-2, "... and at first.", "`forces.csv`")
    input_noise: float = setting(2.5e-3, "Variance of an input's noise at first, as a share of its own, where its "
        "spectrum does not tell it and where another course is tried: from less a discrepancy explains what is "
        "noise.")
    slowest_drift: float = setting(0.1, "A drift is a random walk down to this share of the lowest frequency that is "
        "believed, below it a level: a drift has an offset, too.", "`tests/test_band.py`")

    # The search over models
    neighbour_window: float = setting(6.0, "Models one flip or swap away within this on the Gram matrix are fitted; "
        "where the included terms fit worse than that, only models that were fitted are averaged.",
        "set on simulated records", "nats")
    neighbours: int = setting(8, "... at most this many of them from each model.", "set on simulated records")
    most_growth: float = setting(3.0, "A first model is cut down where a deviation from the path grows by more than "
        "this factor in a sample, or a step ends further from the path in standard deviations: no motion that was "
        "sampled does that.", unit="times")
    jump_steps: int = setting(8, "Steps of an interval in which a term of the model jumps: it is located among them.")
    adequate: float = setting(0.05, "A further start is tried where a discrepancy above this share of its target is "
        "left.")
    calmed: float = setting(10.0, "A neighbour is fitted from a discrepancy this many times smaller: with the right "
        "terms little of it is left.", "set on simulated records", "times")
    explains_much: float = setting(0.3, "... and from `hardly_any` of it where it was above this share of the "
        "target, held there for `calm_steps` where a model is fitted from both: fits of spiking neurons at 20 % "
        "noise ended in a wrong maximum.", "set on simulated records")
    discrepancy_sizes: int = setting(8, "Sizes of a discrepancy that are averaged over, on a logarithmic scale from "
        "1e-4 to 3.2 of the target's standard deviation: a model that needs none is as likely at any small one.")
    size_step: float = setting(1.5, "... halved beside the peak until the likelihood changes by less from one to the "
        "next.", unit="nats")
    unresolved: float = setting(0.5, "A sample is on neither side of a jump where the mean leaves more than this "
        "share of the square of the jump's half; where both sides lead to the jump it holds its argument: a body "
        "that friction holds.", "`tests/test_holding.py`")

    # What terms leave out, and how far the likelihood is believed
    batch: float = setting(5.0, "A batch of what terms leave out lasts this many times as long as the scores are "
        "correlated: batches are then independent.", "`tests/test_projection.py`", "times")
    enough_batches: int = setting(16, "... and this many at least: also of a slow force the scores with fast terms "
        "are hardly correlated.", "`tests/test_projection.py`")
    correlated_by: float = setting(3.0, "Where scores of the coefficients state their covariance too small by this "
        "many standard errors, as with noise at the resonance, the likelihood is raised to a power: intervals held "
        "in 30 % without it.", "`adverse.csv`", "se")
    correlated_lags: float = setting(5.0, "The sum over lags behind that ends at this many times itself (Sokal "
        "1997).", "literature", "times")

    # What a law may lack
    misfit_least: float = setting(1e-4, "A law lacks no function of the states with probability 1/2, else one of "
        "`misfit_sizes` sizes, log-uniform from this share of the target,", "`tests/test_spike.py`")
    misfit_most: float = setting(0.04, "... to at most this: a larger function would replace terms,",
        "`tests/test_spike.py`")
    misfit_per_direction: float = setting(0.0065, "... and to this times the root of the directions of its span.",
        "`tests/test_spike.py`")
    misfit_sizes: int = setting(10, "Sizes between them.", "`tests/test_spike.py`")
    misfit_along: float = setting(0.5, "In a direction more than this share of the power is from the motion along "
        "the path, the rest from the uncertainty of the states: what changes more there cannot be told from their "
        "noise.", "`tests/test_spike.py`")
    misfit_few: int = setting(15, "Equations of fewer candidates have hidden ones, monomials of the states, as many "
        "degrees as give more: what few candidates span is no general function.", unit="candidates")
    nearly_true: float = setting(0.01, "The law is only nearly true where it lacks no function with a lower "
        "probability: terms may then be left out of what is shown, and neighbours are not fitted.",
        "`tests/test_spike.py`", cliff=True)

    # Tests of the answer
    test_level: float = setting(0.01, "Level of the tests of discrepancy and innovations, all together (Holm 1979). "
        "True models gave likelihood ratios up to 4, an unmeasured force of 10 % 2e4.", "`adverse.csv`")
    least_gain: float = setting(4.0, "Twice the nats by which the likelihood must be greater with a discrepancy than "
        "without.", "`forces.csv`", "2 nats")
    noisier: float = setting(1.5, "Noise of an input is raised by such factors in the test of a discrepancy, up to "
        "the power of the octave in which the input has least, while the motion becomes likelier: what its samples "
        "show is that of a convenient model of its course.", "`forces.csv`")
    octaves: int = setting(9, "Octaves below half the sampling rate that are tested.")
    # fmt: on


LIKELIHOOD = LikelihoodSettings()
