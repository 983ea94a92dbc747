"""Constants that may decide an answer: those of each stage are the fields of one frozen dataclass.

`python -m studies.rules` writes docs/rules.md from them, and `python -m studies.sensitivity` varies each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeVar

T = TypeVar("T")


def setting(default: T, about: str, rests_on: str = "choice", unit: str = "", cliff: bool = False) -> T:
    """A field of a settings class: its value, what it decides (`about`), and the evidence for the value (`rests_on`).

    The evidence is tables of docs/tables and tests, in backquotes, or words that docs/rules.md explains, joined by
    semicolons. Without a unit it is a share, a probability or a count. At a `cliff` the answer may jump.
    """
    metadata = {"about": about, "rests_on": rests_on, "unit": unit, "cliff": cliff}
    made: T = field(default=default, metadata=metadata)
    return made


# fmt: off


@dataclass(frozen=True)
class RecordSettings:
    """Gaps, times, and reports of channels that contradict each other."""

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
    significant: float = setting(4.0, "... and each only if it differs from none by this many standard errors.",
        "set on simulated records", "se")
    least_fit: float = setting(0.9, "Two channels are not a signal and its derivative where sign and delay explain a "
        "smaller share of the coherent signal.", "set on simulated records")


RECORDS = RecordSettings()


@dataclass(frozen=True)
class StateSettings:
    """Bad samples, computed channels, held-out rows, and the smoother of a chain."""

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


STATES = StateSettings()


@dataclass(frozen=True)
class LikelihoodSettings:
    """Priors, levels, the search over models, and the tests of its answer."""

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

    # Levels: noise, discrepancies and the course of inputs between samples
    shortest_memory: float = setting(0.02, "Least memory of a discrepancy, its lag-1 autocorrelation: nearly white. "
        "In fits the bound on the memory is at least twice this.")
    longest_memory: float = setting(0.999, "Largest memory of a discrepancy, its lag-1 autocorrelation: nearly "
        "constant.")
    memory_share: float = setting(0.4, "In fits a discrepancy remembers at most this share of the motion's own "
        "time, sd(x)/sd(dx/dt): one of longer memory relaxes as a law does and replaces it, one of shorter memory "
        "leaves a slow force that nobody measured to false terms.", "`memory.csv`")
    least_discrepancy: float = setting(1e-8, "Least variance of a discrepancy, as a share of the target's; less excess "
        "power over white noise is ignored in an octave: rounding and integration of channels without noise.",
        "`forces.csv`")
    most_course: float = setting(1.0, "Largest interpolation error variance of inputs between samples, over the "
        "square of their bends: no course is further off than a straight line.", "`forces.csv`")
    first_course: float = setting(1e-2, "... and its first value.", "`forces.csv`")
    input_noise: float = setting(2.5e-3, "Variance of an input's noise at first, as a share of its own, where its "
        "spectrum does not show it and where another course is tried: a fit that starts from less takes the noise "
        "for a discrepancy.")

    # The search over models
    neighbour_window: float = setting(6.0, "Models one flip or swap away within this on the Gram matrix are fitted; "
        "where the included terms fit worse than that, only models that were fitted are averaged.",
        "set on simulated records", "nats")
    kink_places: int = setting(20, "Hinges of a state that are tried beside the candidates, at even quantiles.",
        "`kinks.csv`")
    least_kink: float = setting(0.25, "A kink is named from this share of the largest change of slope on.",
        "`kinks.csv`")
    neighbours: int = setting(8, "Neighbours of a model that are fitted, at most.", "set on simulated records")
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

    # Model error, and the power that the likelihood is raised to
    batch: float = setting(5.0, "A batch of what terms leave out lasts this many times as long as the scores are "
        "correlated: batches are then independent.", "`tests/test_projection.py`", "times")
    enough_batches: int = setting(16, "... and this many at least: also of a slow force the scores with fast terms "
        "are hardly correlated.", "`tests/test_projection.py`")
    correlated_by: float = setting(3.0, "Where scores of the coefficients state their covariance too small by this "
        "many standard errors, as with noise at the resonance, the likelihood is raised to a power: intervals held "
        "in 30 % without it.", "`adverse.csv`", "se")
    correlated_lags: float = setting(5.0, "The sum over lags behind that ends at this many times itself (Sokal "
        "1997).", "literature", "times")

    # Functions that a law may lack
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


LIKELIHOOD = LikelihoodSettings()


@dataclass(frozen=True)
class RegressionSettings:
    """Prior odds of terms, effective sample size of correlated residuals, and intervals."""

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


REGRESSION = RegressionSettings()


@dataclass(frozen=True)
class InferenceSettings:
    """Listing of models, sampling instead of a listing, and known signs."""

    most_selected: int = setting(30, "Unit of the noise prior with fewer than max(10, 0.1 n) spare rows: the "
        "residual of a forward selection of n/4 terms, at most this many; else the residual of all terms.",
        unit="terms", cliff=True)
    most_left_out: float = setting(0.02, "Chains are sampled in place of a listing where inclusion probabilities "
        "would be off by more.", cliff=True)
    signs_contradicted: float = setting(math.log(100.0), "Data contradict known signs where the Bayes factor against "
        "these is larger: a warning; the search then goes by the weights with the signs.",
        "`tests/test_signs.py`", "nats")


INFERENCE = InferenceSettings()


@dataclass(frozen=True)
class SelectionSettings:
    """Nearly true laws, terms that are not determined, and motion that repeats itself."""

    tolerance: float = setting(0.005, "Terms of a nearly true law are left out, one by one, while free runs are "
        "worse by no more, a share of the states' spread, or `tolerance=`; an equation is not determined where "
        "others predict otherwise by more. Half of the 1 % to which sensors are calibrated; with 1 % Coulomb "
        "friction of 0.7 to 1.2 % was left out in 31 of 100 records.", "`tests/test_selection.py`", cliff=True)
    damping: float = setting(0.1, "... or where their damping differs by more than this share of it: on a ring-down of "
        "a damping ratio of 0.1 % all forms explain less than the tolerance.", "`tests/test_ring_down.py`")
    short_run: float = setting(1.0, "Length of the free runs that are compared: chaotic motion can be followed so "
        "long,", "`tests/test_selection.py`", "periods")
    long_run: float = setting(10.0, "... and so long, at most half a record: keeps damping of a ratio of 0.1 %.",
        "`tests/test_selection.py`", "periods")
    follows: float = setting(0.5, "They count where the run of all terms errs by less than this share of the spread: "
        "runs that are out of step tell nothing.", "`tests/test_selection.py`")
    least_periods: float = setting(5.0, "Motion repeats itself over this many periods or more.",
        "`tests/test_excitation.py`", "periods")
    harmonics: int = setting(12, "... along a curve of this many harmonics, at most: 12 of 12 steady sines, none of "
        "40 other records.", "`tests/test_excitation.py`")
    not_noise: float = setting(1e-6, "... where power beside them has this chance.", "`tests/test_excitation.py`")
    transient: float = setting(0.03, "... and up to this share of a channel is beside the curve: a transient tells "
        "the candidates no better apart.", "`tests/test_excitation.py`")


SELECTION = SelectionSettings()


@dataclass(frozen=True)
class EquationSettings:
    """Verdict, intervals and neighbours of the equation that is shown."""

    least_r2: float = setting(0.5, "An equation that explains a smaller share of what stands above its target's "
        "noise is `none`: more is unexplained than explained.", cliff=True)
    as_the_mean: float = setting(1.0, "Runs over windows of a period that err by this much, over the spread and "
        "noise of the whole motion, beside what noise in the first state explains, are `none`: the mean would do as "
        "well.", unit="times")
    nothing_else: float = setting(0.02, "A kink is why there is no equation if it leaves less of the target.",
        "`tests/test_hinges.py`")
    at_rest: float = setting(0.1, "Rows held out are at rest where their signal is below this share of that of the "
        "whole motion: R2 is then by the variance of the whole motion.", "`tests/test_verdict.py`")
    doubt: float = setting(0.05, "An equation is not determined where models that predict otherwise have more "
        "probability: well determined records had 0 to 2 % (8 records each of five systems).", "`adverse.csv`")
    independent: float = setting(0.5, "Residuals of rows as measured are not white where less than this share of "
        "them are independent: filters, of zero phase too, leave what looks like a law.", "`tests/test_adequacy.py`")
    different: float = setting(0.2, "The interval over models is printed where its width or an end differs from the "
        "conditional one by a larger share of the width: an end that is this much too near leaves out 12 % in place "
        "of 2.5 %. Hoeting et al. (1999).", "literature; `tests/test_mixture.py`", cliff=True)
    clipped: float = setting(0.05, "A law is at best nearly true where a channel is clipped in a larger share of its "
        "rows: with 7 % of a Duffing oscillator's acceleration clipped its intervals left out the mass and the cubic "
        "stiffness, with 24 % it had a term too many.", "`tests/test_verdict.py`")


EQUATION = EquationSettings()


@dataclass(frozen=True)
class RefineSettings:
    """Conditions for using free runs, and for accepting refined coefficients."""

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
    noisy_input: float = setting(0.003, "... and clearly better where an input's noise is above this share of its "
        "standard deviation: with 0.2 % refined laws were right, with 1 to 5 % intervals held the truth in 23 of 37.",
        "set on simulated records")


REFINE = RefineSettings()


@dataclass(frozen=True)
class PlanSettings:
    """Rival models, and the inputs of a planned experiment."""

    models_within: float = setting(12.0, "... without averaging, those one move and as far away.", unit="nats")
    most_rivals: int = setting(4, "Rivals within the odds asked for that are compared, each simulated under every "
        "design; without one the plan is for the coefficients.", unit="models", cliff=True)
    power_below: float = setting(0.005, "The band of an input holds all of its power but this share below,")
    power_above: float = setting(0.05, "... and this above: noise of the channel is spread there.")
    signed: float = setting(0.5, "An input has both signs where the smaller of its extremes is more than this share "
        "of the larger: the range is then even about zero. Extremes of 100 samples of noise are.")


PLAN = PlanSettings()


@dataclass(frozen=True)
class StreamingSettings:
    """Stretches, blocks and lags."""

    stretches: int = setting(20, "Stretches of 5,000 rows, spread evenly, that are looked at first. Of a million "
        "rows 15 of 15 coefficients were within 0.1 sd of those in memory, the furthest 0.07 off; twenty seconds.",
        "`long_records.csv`")
    near: float = setting(0.05, "A further pass is made where a noise level or a standard deviation moves by a "
        "larger share.", "`tests/test_streaming.py`")


STREAMING = StreamingSettings()
