"""What is known of channels: their noise, the calibration of sensors; and what a record does not determine."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import DataWarning, InputError, UnknownNameError
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.regression.regression import changes_by_noise
from bayeq.states import parse_chain
from bayeq.states.sensors import scaled_with

OSCILLATOR = {"chains": ["x:v:a"], "inputs": ["u"], "holdout": 0.0}
TERMS = ["x", "v", "x**3", "u"]


def quietly(*arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(*arguments, **options)


def noisy(of_force, seed=3, n=1000, of_others=0.05):
    """A Duffing record, noise as shares of each channel's standard deviation; and that of the force."""
    clean, rng = bq.simulate("duffing", n=n, seed=seed, noise=0.0), np.random.default_rng(seed)
    shares = {"x": of_others, "v": of_others, "a": of_others, "u": of_force}
    levels = {name: share * clean[name].std() for name, share in shares.items()}
    channels = {name: clean[name] + sd * rng.standard_normal(n) for name, sd in levels.items()}
    return bq.Record.from_arrays(channels, time=clean.time), levels["u"]


def error_of_force(eq):
    """Of the coefficient of u, which is 1, and its standard deviation."""
    p = eq[0].posterior
    return p.coef[p.names.index("u")] - 1.0, p.sd[p.names.index("u")]


@pytest.mark.parametrize("share", [pytest.param(0.05, marks=pytest.mark.slow), 0.2])
def test_known_noise_of_a_force_stays_what_was_given(share):
    record, sd = noisy(share)
    eq = quietly(record, **OSCILLATOR, dictionary=TERMS, noise={"u": sd})
    error, own = error_of_force(eq)
    assert abs(error) < 3 * own
    found = eq[0].fit.regression.record
    assert found.fitted.state.levels.channels[-1] == sd**2
    assert eq.data.sensors.noise == {"u": sd}


def test_force_taken_as_exact_is_attenuated():
    record, _ = noisy(0.2)
    eq = quietly(record, **OSCILLATOR, dictionary=TERMS, noise={"u": 0})
    assert eq[0].fit.regression.record.fitted.state.levels.channels[-1] < 1e-9 * record["u"].var()
    # 1/(1 + 0.2^2) of a white regressor
    assert error_of_force(eq)[0] == pytest.approx(-0.04, abs=0.015)


def test_known_noise_in_regressions():
    record, sd = noisy(0.2, of_others=0.001)
    given = quietly(record, **OSCILLATOR, dictionary=TERMS, smooth="none", noise={"u": sd})
    error, own = error_of_force(given)
    assert abs(error) < 3 * own
    exact = quietly(record, **OSCILLATOR, dictionary=TERMS, smooth="none", noise={"u": "0%"})
    assert error_of_force(exact)[0] < error - own


def test_known_noise_of_a_state_reaches_the_smoother():
    record, _ = noisy(0.05)
    eq = quietly(record, **OSCILLATOR, dictionary=TERMS, noise={"x": "3%"})
    sd = 0.03 * record["x"].std()
    regression = eq[0].fit.regression
    assert regression.motion.smoothing[0].model.noise_sd[0] == pytest.approx(sd)
    assert regression.record.fitted.state.levels.channels[0] == pytest.approx(sd**2, rel=1e-12)


def test_noise_of_a_force_beside_clean_states_is_accounted_for():
    record, sd = noisy(0.2, of_others=0.0)
    eq = quietly(record, **OSCILLATOR, dictionary=TERMS, noise={"u": sd})
    error, own = error_of_force(eq)
    assert abs(error) < 3 * own


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"noise": {"uu": 1.0}}, UnknownNameError, "did you mean 'u'"),
        ({"noise": {"u": -1.0}}, InputError, "not negative"),
        ({"noise": {"u": "much"}}, InputError, "needs a number"),
        ({"noise": {"u": True}}, InputError, "needs a number"),
        ({"noise": {"u": float("nan")}}, InputError, "needs a number"),
        ({"noise": {"u": "150%"}}, InputError, "check the unit"),
        ({"gain_sd": {"y": 0.01}}, UnknownNameError, "no channel named 'y'"),
        ({"gain_sd": {"x": "nan"}}, InputError, "relative standard deviation"),
    ],
)
def test_what_cannot_be_used_is_refused(options, error, words):
    with pytest.raises(error, match=words):
        bq.discover(bq.simulate("duffing", n=100, seed=0), **OSCILLATOR, **options)


def test_noise_of_states_that_are_taken_as_measured_is_not_used():
    record = bq.simulate("duffing", n=600, seed=1)
    with pytest.warns(DataWarning, match="noise given of x, v is not used"):
        bq.discover(record, **OSCILLATOR, dictionary=TERMS, smooth="none", noise={"x": "5%", "v": "5%", "u": "5%"})


def test_what_hidden_noise_of_an_input_would_do():
    rng = np.random.default_rng(0)
    record = bq.simulate("duffing", n=1500, seed=3, force=50 * rng.standard_normal(1500))
    eq = quietly(record, **OSCILLATOR, dictionary=TERMS)
    # the motion shows it
    assert not any("cannot be read" in message for message in eq.warnings)
    equation = eq[0]
    changes = changes_by_noise(equation.fit.regression, equation.shown_posterior, "u", (0.01, 0.05))
    # 1/(1 + r^2) of a white force, which no state of the motion follows
    np.testing.assert_allclose(changes["u"], (-0.0001, -0.0025), rtol=0.1)


@pytest.mark.parametrize("channel", ["x", "v", "a", "u"])
def test_calibration_against_records_with_other_factors(channel):
    clean = bq.simulate("duffing", n=2000, seed=3, noise=0.0)

    def coefficients(factor=1.0, **options):
        channels = {name: clean[name] * (factor if name == channel else 1.0) for name in "xvau"}
        record = bq.Record.from_arrays(channels, time=clean.time)
        return quietly(record, **OSCILLATOR, dictionary=TERMS, smooth="none", **options)[0].posterior

    moved = 0.5 * (coefficients(1.01).coef - coefficients(0.99).coef)
    p = coefficients(gain_sd={channel: 0.01})
    # 1 % of x is 3 % of x**3; the second order of a factor's 1 % is below a thousandth
    assert p.sd == pytest.approx(np.abs(moved), rel=2e-3, abs=2e-5 * np.abs(p.coef).max())
    expected = {"x": [1, 0, 3, 0], "v": [0, 1, 0, 0], "a": [1, 1, 1, 1], "u": [0, 0, 0, 1]}[channel]
    assert 100 * p.sd / np.abs(p.coef) == pytest.approx(expected, abs=2e-3)


def test_calibration_is_added_to_what_the_record_leaves():
    record = bq.simulate("duffing", n=1000, seed=2)
    asked = {**OSCILLATOR, "chains": ["x::"], "dictionary": ["x", "dx", "x**3", "u"]}  # no channel tells x's factor
    without, given = (quietly(record, **asked, gain_sd=gain_sd) for gain_sd in ({}, {"x": 0.01, "u": 0.005}))
    before, after = without[0].posterior, given[0].posterior
    added = np.array([[0.0, 0.0, 0.02, 0.01], [0.0, 0.0, 0.0, 0.005]]) * after.coef
    assert after.coef == pytest.approx(before.coef, rel=1e-12)
    # the equation holds on the smoothed rows but for what noise leaves
    assert after.sd == pytest.approx(np.sqrt(before.sd**2 + (added**2).sum(axis=0)), rel=0.05)
    assert given[0].shown_posterior.sd == pytest.approx(after.sd)
    assert (after.averaged.sd >= before.averaged.sd).all()
    assert "intervals include the calibration: x 1 %, u 0.5 %" in str(given)


def test_estimated_derivatives_have_the_calibration_of_what_they_come_from():
    chains = [parse_chain("x::"), parse_chain("y:w:"), parse_chain("::b")]
    assert scaled_with(chains, "x") == ("x", "dx", "ddx")
    assert scaled_with(chains, "y") == ("y",)
    assert scaled_with(chains, "w") == ("w", "ddy")
    assert scaled_with(chains, "b")[0] == "b"
    assert len(scaled_with(chains, "b")) == 3


@pytest.fixture(scope="module")
def faint():
    """A Duffing record in which x**3 is 1 % of the noise."""
    force = 0.02 * bq.simulate("duffing", n=2000, seed=1, noise=0.0)["u"]
    return quietly(
        bq.simulate("duffing", n=2000, seed=1, force=force), **OSCILLATOR, dictionary=[*TERMS, "x**2", "x*v"]
    )


def test_a_cubic_term_of_small_amplitude_is_not_determined(faint):
    (one,) = faint
    assert set(one.included) == {"x", "v", "u"}
    assert abs(one.coef["x"] + 1000.0) < 3 * one.posterior.sd[one.posterior.names.index("x")]
    assert "x**3" in one.undetermined
    row = one.table().set_index("term").loc["x**3"]
    assert row["bound"] > 1e5  # the true one
    line = next(line for line in str(faint).splitlines() if line.startswith("too small to be seen"))
    assert f"x**3 below {row['bound']:.2g}" in line
    assert np.isnan(one.table().set_index("term").loc[list(one.included), "bound"]).all()


@pytest.mark.parametrize("smooth", ["auto", "none"])
def test_bounds_against_fits_with_the_term(smooth):
    asked = {**OSCILLATOR, "dictionary": "x, v, x**2, x**3, x*v, v**2, v**3, v*abs(v), u"}
    (one,) = quietly(bq.simulate("duffing", n=1000, seed=4), **asked, smooth=smooth)
    fit = one.fit
    for j in np.flatnonzero(~one.posterior.support):
        model = one.posterior.support.copy()
        model[j] = True
        coef, covariance = exact_posterior(fit.problem, model, None)
        sd = np.sqrt(covariance[model[:j].sum(), model[:j].sum()])
        bound = (abs(coef[j]) + 1.96 * sd) * fit.standard.target_scale / fit.standard.scale[j]
        # the noise is that without the term, hardly more
        assert one.bound[j] == pytest.approx(bound, rel=0.02)


def test_bounds_and_what_was_known_are_saved(faint, tmp_path):
    record = bq.simulate("duffing", n=600, seed=2)
    eq = quietly(record, **OSCILLATOR, dictionary=[*TERMS, "x**2"], noise={"u": "5%"}, gain_sd={"x": 0.01})
    for one in (faint, eq):
        one.save(tmp_path / "eq.json")
        again = bq.load(tmp_path / "eq.json")
        assert again[0].undetermined == one[0].undetermined
        assert np.array_equal(again[0].bound, one[0].bound, equal_nan=True)
        assert again.data.sensors == one.data.sensors
        assert str(again) == str(one)


def test_command_line(tmp_path, capsys):
    bq.write(bq.simulate("duffing", n=400, seed=2), tmp_path / "run.csv")
    run = ["discover", str(tmp_path / "run.csv"), "--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]
    run += ["--dictionary", ",".join(TERMS)]
    options = ["--noise", "u=5%", "--noise", "a=4.0", "--gain-sd", "x=0.01"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main([*run, *options, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)["data"]
    assert data["noise"]["a"] == 4.0
    assert set(data["noise"]) == {"u", "a"}
    assert data["gain_sd"] == {"x": 0.01}
    for bad in (["--noise", "u"], ["--noise", "q=1"], ["--noise", "u=-1"], ["--gain-sd", "x=one"]):
        assert main([*run, *bad]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
