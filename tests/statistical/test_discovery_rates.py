"""How often `discover` finds exactly the true terms, and whether its intervals cover."""

from __future__ import annotations

import numpy as np
import pytest
from studies.channels import draw_record

import bayeq as bq
from bayeq.inference.bma import spike_slab_bma
from bayeq.study.config import StudyConfig
from bayeq.study.runner import draw
from tests.statistical.limits import assert_coverage, fewest

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")


@pytest.mark.statistical(short=1, full=50)
@pytest.mark.parametrize(
    ("system", "rate"),
    [
        ("duffing", 0.96),
        *(pytest.param(system, 0.99, marks=pytest.mark.slow) for system in ("coulomb", "linear", "quadratic")),
    ],
)
def test_the_paper_s_oscillators_at_five_per_cent_noise(system, rate, number):
    # Of 50 seeds all are exact but 2 of the Duffing oscillator. Without smoothing the rates are 0.75 to 0.9 for the
    # nonlinear ones (docs/reproduction.md).
    exact = 0
    for seed in range(number):
        record = bq.simulate(system, seed=seed)
        eq = bq.discover(record, chains="x:v:a", inputs=["u"])[0]
        exact += set(eq.included) == set(record.truth.coefficients["a"])
    assert exact >= fewest(number, rate)


@pytest.mark.statistical(short=1, full=40)
# the least noise is the hardest; the largest is that of the test above
@pytest.mark.parametrize("noise", [0.001, *(pytest.param(noise, marks=pytest.mark.slow) for noise in (0.05, 0.01))])
def test_clean_states_at_any_noise_of_the_acceleration(noise, number):
    # All of 80 seeds are exact. With v_s fixed at 10 the rate is 0.9 at 1 % noise and 0.58 at 0.1 %.
    exact, ratios, inside = 0, [], []
    for seed in range(number):
        record = bq.simulate("duffing", seed=seed, noise={"a": noise})
        truth = record.truth.coefficients["a"]
        eq = bq.discover(record, chains="x:v:a", inputs=["u"])[0]
        exact += set(eq.included) == set(truth)
        ratios.append(eq.noise_sd / record.truth.noise_sd["a"])
        interval = dict(zip([t.text for t in eq.terms], eq.ci95, strict=True))
        inside += [interval[term][0] <= value <= interval[term][1] for term, value in truth.items()]
        inside.append(eq.intercept_ci95[0] <= 0 <= eq.intercept_ci95[1])
    assert exact >= fewest(number, 0.995)
    # a standard deviation of 3200 residuals has a standard error of 1.25 %
    assert np.all(np.abs(np.array(ratios) - 1) < 0.05)
    assert_coverage(inside)


@pytest.mark.statistical(short=6, full=80)
def test_smoothing_restores_what_noise_takes_in_the_paper_s_protocol(number):
    # Coulomb records: exact on raw channels in about 3 of 4 (the paper, Table 2), smoothed in 98 of 100
    exact, smoothed = {"auto": 0, "none": 0}, number // 2
    for smooth, count in (("auto", smoothed), ("none", number)):
        for index in range(count):
            data = draw(StudyConfig(smooth=smooth), "coulomb", index)
            found = spike_slab_bma(data.train.standardise().gram).support
            exact[smooth] += bool((found == (data.truth != 0)).all())
    assert exact["auto"] >= fewest(smoothed, 0.98)
    # the study is about records that noise spoils: raw, not all are exact (all of 10 at 0.75: 6 %; of 40: 1e-5)
    assert exact["none"] < number


@pytest.mark.statistical(short=1, full=20)
def test_products_of_states_are_filtered_as_the_target_is(number):
    # at 100 Hz the third harmonic is near the edge of the band: exact in 19 of 20; unfiltered columns lost 6 of 10
    exact = 0
    for seed in range(number):
        eq = bq.discover(draw_record("duffing", 100.0, seed), chains="x:v:a", inputs=["u"])
        exact += set(eq[0].included) == {"x", "v", "x**3", "u"}
    assert exact >= fewest(number, 0.95)
