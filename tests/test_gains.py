"""Factors of channels that may be off: learned from the other channels of a chain, one number for all records."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, filtfilt, lfilter

import bayeq as bq
from bayeq.equation.brief import brief
from bayeq.likelihood.channels import calibration_of
from bayeq.states import Gain

TRUE = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}  # of the simulated Duffing oscillator
FACTORS = {"x": 1.008, "v": 0.994, "a": 1.012, "u": 0.995}
ASKED = {"chains": "x:v:a", "inputs": ["u"], "dictionary": [*TRUE, "x**2", "v*abs(v)"]}


def drawn(seed):
    """A record of sensors that are off by `FACTORS`."""
    clean = bq.simulate("duffing", n=900, seed=seed, noise=0.02)
    channels = {name: factor * clean[name] for name, factor in FACTORS.items()}
    return bq.Record.from_arrays(channels, time=clean.time, units={**clean.units})


def quietly(*arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(*arguments, **{**ASKED, "gain_sd": dict.fromkeys("xvau", 0.01), **options})


@pytest.fixture(scope="module")
def answers():
    """Of one record, and of two."""
    return quietly(drawn(3)), quietly([drawn(3), drawn(4)])


def test_factors_are_found_as_far_as_channels_tell_them(answers):
    one, both = answers
    for answer in answers:
        found = answer.data.sensors.gains
        assert set(found) == set("xva")
        for a, b in ("xv", "va", "xa"):
            assert found[a].value / found[b].value == pytest.approx(FACTORS[a] / FACTORS[b], abs=2e-3)
        # the three have a factor in common, of which the record tells nothing: that of three independent ones
        assert [gain.sd for gain in found.values()] == pytest.approx([0.01 / 3**0.5] * 3, rel=0.05)
    assert one.verdict.kind == both.verdict.kind == "found"


def test_coefficients_that_a_common_factor_leaves_are_as_well_known_as_without(answers):
    exact = quietly(bq.simulate("duffing", n=900, seed=3, noise=0.02), gain_sd=None)[0]
    # two factors of the motion in x**3; that of u, and that of the motion, in u
    shares = {"x": 0.0, "v": 0.0, "x**3": 0.02 / 3**0.5, "u": (4 / 3) ** 0.5 * 0.01}
    for (equation,) in answers:
        assert set(equation.shown) == set(TRUE)
        names, sds = equation.posterior.names, equation.shown_posterior.sd
        for name, sd, others in zip(names, sds, exact.shown_posterior.sd, strict=True):
            if name in TRUE:
                assert abs(equation.shown_coef[name] - TRUE[name]) < 3.0 * sd
                assert sd < 1.3 * np.hypot(others, shares[name] * abs(TRUE[name]))
                assert sd > 0.95 * shares[name] * abs(TRUE[name])


def test_calibration_against_the_marginal_likelihood_of_moved_samples(answers):
    record = answers[0][0].fit.regression.record
    task, state = record.task, record.fitted.state
    found, known = calibration_of(task, state), [gain for _, gain in task.layout.uncertain]
    seen = [[s.samples - one.residual for s, one in zip(task.series, task.linearised(state), strict=True)]][0]

    def value(factors):
        moved = np.zeros(len(task.layout.channels))
        moved[[i for i, _ in task.layout.uncertain]] = factors
        series = tuple(s._replace(samples=s.samples - moved * at) for s, at in zip(task.series, seen, strict=True))
        beside = [(gain.value * (1.0 + f) - 1.0) / gain.prior_sd for gain, f in zip(known, factors, strict=True)]
        return replace(task, series=series).value(state) - 0.5 * float(np.square(beside).sum())

    # the likelihood of a linearised model is quadratic in factors
    step, axes = 1e-3, np.eye(len(known))
    slope = np.array([value(step * e) - value(-step * e) for e in axes]) / (2 * step)
    bend = [[sum(s * t * value(step * (s * e + t * f)) for s in (1, -1) for t in (1, -1)) for e in axes] for f in axes]
    covariance = np.linalg.inv(-np.array(bend) / (4 * step**2))
    taken = np.array([gain.value for gain in known])
    np.testing.assert_allclose(found.covariance, covariance * np.outer(taken, taken), rtol=1e-3, atol=1e-9)
    values = [gain.value for gain in found.gains.values()]
    np.testing.assert_allclose(values, taken * (1.0 + covariance @ slope), atol=1e-6)


def test_factors_are_printed_saved_and_taken_out_of_other_records(answers, tmp_path):
    answer = answers[0]
    line = f"factor of v: {answer.data.sensors.gains['v']} (learned)"
    assert line in str(answer)
    assert line in brief(answer)
    answer.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again.data.sensors == answer.data.sensors
    assert isinstance(again.data.sensors.gains["v"], Gain)
    assert str(again) == str(answer)
    forgotten = replace(answer, data=replace(answer.data, sensors=replace(answer.data.sensors, gains={})))
    ours, theirs = (eq.score(drawn(5)).one_step["a"] for eq in (answer, forgotten))
    assert ours < theirs


def test_of_one_channel_of_a_chain_nothing_tells_the_factor():
    answer = quietly(drawn(3), chains="x::", dictionary=["x", "dx", "u", "x**3"], gain_sd={"x": 0.01})
    assert not answer.data.sensors.gains
    assert "gains" not in answer.to_dict()["data"]


@pytest.mark.parametrize(
    ("off", "words"),
    [
        ({"v": lambda v: v + 0.1}, r"v may be 0.1\d* too large throughout: --remove-offset v=0.\d+"),
        ({"v": lambda v: 1.02 * v}, r"v may be [12]\.?\d* % too large: --gain-sd v=0.0[23] learns that"),
        pytest.param(
            {"a": lambda a: 0.97 * a},
            r"a may be [23]\.?\d* % too small: --gain-sd a=0.0[34] learns that",
            marks=pytest.mark.slow,  # of a velocity: above
        ),
        (
            {"v": lambda v: np.where(np.arange(len(v)) % 97, np.roll(v, 3), np.nan)},
            r"v may be 0.00[23]\d* s late: --lag-sd v=0.003 learns that",
        ),
        ({"u": lambda u: np.roll(u, -1)}, r"u may be 0.00[01]\d* s early: --lag-sd u=0.00[12] learns that"),
    ],
)
def test_a_law_that_is_nearly_true_names_the_channel_that_is_off(off, words):
    clean = bq.simulate("duffing", n=2000, seed=6, noise=0.02)
    record = clean.with_channels({name: change(clean[name]) for name, change in off.items()}, clean.units)
    answer = quietly(record, gain_sd=None, dictionary=list(TRUE))
    assert answer.verdict.kind == "nearly true"
    assert re.search(words, answer.verdict.advice), answer.verdict


@pytest.mark.parametrize("factor", [1.01, 0.99])
def test_a_wrong_sampling_rate_is_named_and_no_channel_is_blamed(factor):
    clean = bq.simulate("duffing", n=2000, seed=6, noise=0.02)
    record = replace(clean, time=factor * clean.time)
    advice = quietly(record, gain_sd=None, dictionary=list(TRUE)).verdict.advice
    assert re.search(rf"the sampling rate may be (1|0.9\d*|1.0\d*) % too {'low' if factor > 1.0 else 'high'}", advice)


@pytest.mark.parametrize("name", ["x", "a"])
def test_of_two_channels_either_may_be_off(name):
    clean = bq.simulate("duffing", n=2000, seed=6, noise=0.02)
    record = clean.with_channels({name: 0.97 * clean[name]}, clean.units)
    answer = quietly(record, chains="x::a", gain_sd=None, dictionary=[term.replace("v", "dx") for term in TRUE])
    other = "a" if name == "x" else "x"
    assert answer.verdict.kind == "nearly true"
    for words in (f"{name} .* too small", f"{other} .* too large", "sampling rate"):
        assert re.search(words, answer.verdict.advice), answer.verdict


def test_rows_that_a_logger_lost_are_named_with_the_time():
    clean = bq.simulate("duffing", n=3000, fs=300.0, seed=6, noise=0.01)
    kept = np.delete(np.arange(3000), np.concatenate([np.arange(1200, 1203), np.arange(2100, 2103)]))
    lost = bq.Record.from_arrays({name: clean[name][kept] for name in clean.channels}, fs=300.0)
    for record, named in ((lost, True), (clean, False)):
        for chain in ("x:v:a", "x::"):
            terms = list(TRUE) if chain == "x:v:a" else [term.replace("v", "dx") for term in TRUE]
            verdict = quietly(record, chains=chain, gain_sd=None, dictionary=terms).verdict
            said = re.search(
                r"rows seem to be lost, as after (4|3.99\d*|6.98\d*|6.99\d*) s: check the logger", str(verdict)
            )
            assert (said is not None) == named, verdict
            assert (verdict.kind == "found") != named


def test_a_channel_that_is_coupled_ac_is_not_only_called_early():
    clean = bq.simulate("duffing", n=4000, seed=6, noise=0.01)
    record = clean.with_channels({"u": lfilter(*butter(1, 1.0, "high", fs=1000.0), clean["u"])}, clean.units)
    advice = quietly(record, gain_sd=None, dictionary=list(TRUE)).verdict.advice
    assert re.search(r"u may be (0.00\d+ s early, or )?AC-coupled \(a high-pass at (0.[89]|1.?)\d* Hz\)", advice), (
        advice
    )


@pytest.mark.parametrize("coupled", [True, False])
def test_an_accelerometer_alone_that_is_coupled_ac_is_told_from_a_late_force(coupled):
    clean = bq.simulate("duffing", n=4000, seed=6, noise=0.01)
    if coupled:
        changed = {"a": lfilter(*butter(1, 1.0, "high", fs=1000.0), clean["a"])}
    else:
        changed = {"u": np.interp(clean.time - 3e-4, clean.time, clean["u"])}
    record = clean.with_channels(changed, clean.units)
    terms = [term.replace("v", "dx") for term in TRUE]
    advice = quietly(record, chains="::a", inputs=["u"], gain_sd=None, dictionary=terms).verdict.advice
    named = r"a may be AC-coupled \(a high-pass at 0.[89]\d* Hz\)" if coupled else r"u may be 0.000(3|2\d*) s late"
    assert re.search(named, advice), advice


def test_channels_that_were_filtered_are_named_with_a_band_by_which_the_law_is_found():
    clean, (b, a) = bq.simulate("duffing", n=2500, seed=6, noise=0.02), butter(4, 0.4)
    record = clean.with_channels({name: filtfilt(b, a, clean[name]) for name in clean.channels}, clean.units)
    answer = quietly(record, gain_sd=None, dictionary=list(TRUE))
    assert answer.verdict.kind == "nearly true"
    found = re.search(r"channels look filtered above 250 Hz: --band (0.4):(250) allows", answer.verdict.advice)
    again = quietly(record, gain_sd=None, dictionary=list(TRUE), band=tuple(map(float, found.groups())))
    assert again.verdict.kind == "found"
    assert set(again[0].shown) == set(TRUE)


def test_inconsistency_beyond_a_tenth_is_no_unit_where_factors_may_explain_it():
    clean = bq.simulate("duffing", n=1500, seed=6, noise=0.02)
    record = clean.with_channels({"x": 0.94 * clean["x"], "v": 1.06 * clean["v"]}, clean.units)
    answer = quietly(record, gain_sd={"x": 0.06, "v": 0.06})
    assert {name: gain.value for name, gain in answer.data.sensors.gains.items()} == pytest.approx(
        {"x": 0.94, "v": 1.06}, rel=5e-3
    )
    assert answer[0].shown_coef["x"] == pytest.approx(TRUE["x"], rel=0.01)


def test_factors_that_contradict_what_was_said_of_them_are_not_found():
    clean = bq.simulate("duffing", n=1500, seed=6, noise=0.02)
    answer = quietly(clean.with_channels({"v": 1.1 * clean["v"]}, clean.units))  # 1 % was said
    assert answer.verdict.kind == "nearly true"
    assert "-sd" in answer.verdict.advice


def test_a_law_that_lacks_a_term_accuses_no_channel():
    answer = quietly(bq.simulate("coulomb", n=2000, seed=6, noise=0.02), gain_sd=None, dictionary=["x", "v", "u"])
    assert answer.verdict.kind == "nearly true"
    assert "-sd" not in answer.verdict.advice
