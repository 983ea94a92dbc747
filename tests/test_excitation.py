"""Motion that repeats itself: candidates that a closed curve does not tell apart."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from studies.adverse_records import CASES, draw_record

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary
from bayeq.equation.selection.excitation import repeating
from bayeq.states import Roles, estimate_motion
from bayeq.states.prepare import in_samples


def judged(record, chains, inputs, dictionary):
    roles = Roles.parse(chains, None, None, None, None, inputs)
    terms = build_dictionary(dictionary, Variables(roles.states, roles.inputs))
    return repeating(estimate_motion([record], roles, "auto", 0.2), terms), terms


@pytest.mark.parametrize("seed", range(3))
def test_a_steady_sine_does_not_tell_an_oscillators_terms_apart(seed):
    record = draw_record(CASES["steady sine"], 2000, seed)
    found, terms = judged(record, ("x:v:a",), ["u"], "oscillator")
    assert found is not None
    assert found.courses < found.terms == len(terms)
    # the frequency of the force, whose samples hold its line
    power = np.abs(np.fft.rfft(record["u"], 16 * record.n)) ** 2
    assert found.frequency == pytest.approx(np.argmax(power) * record.fs / (16 * record.n), abs=0.03)
    # of a linear mass on a spring with a known mass a line tells two coefficients
    assert judged(record, ("x:v:a",), [], "x, v")[0] is None


@pytest.mark.parametrize(("transient", "closed"), [(0.02, True), (0.1, False)])
def test_a_transient_that_has_nearly_died_out_is_part_of_the_curve(transient, closed):
    time = np.arange(4000) * 0.005
    rng = np.random.default_rng(3)
    x = np.sin(11.0 * time) + np.sqrt(2.0) * transient * np.sin(7.0 * time)
    record = bq.Record.from_arrays(x=x + 1e-3 * rng.normal(size=4000), u=np.sin(11.0 * time + 0.4), time=time)
    found, _ = judged(record, ("x::",), ["u"], "oscillator")
    assert (found is not None) == closed
    if found is not None:
        assert found.single
        assert found.frequency == pytest.approx(11.0 / (2.0 * np.pi), rel=1e-3)


@pytest.mark.parametrize("case", ["clean", "white force"])
def test_other_motion_does_not_repeat_itself(case):
    assert judged(draw_record(CASES[case], 2000, 1), ("x:v:a",), ["u"], "oscillator")[0] is None


def test_a_static_law_of_independent_draws_does_not_repeat_itself():
    """Of 12 draws the largest line of their spectrum was more than chance in 2."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        p, q = 2.0 + 3.0 * rng.random(400), 0.5 + 1.5 * rng.random(400)
        record = bq.Record.from_arrays(p=p, q=q, Q=1.3 * q * np.sqrt(p), fs=10.0)
        roles = Roles.parse(("=Q",), None, None, None, None, ["p", "q"])
        terms = build_dictionary("p, q, p*q, q**2", Variables(roles.states, roles.inputs))
        assert repeating(estimate_motion([record], roles, "auto", 0.2), terms) is None


def test_a_limit_cycle_of_many_harmonics_tells_its_terms_apart():
    time = np.arange(4000) * 0.02
    clean = bq.simulate("vanderpol", n=8000, fs=50.0, noise=0.0, seed=1)
    rng = np.random.default_rng(1)
    channels = {name: clean[name][4000:] for name in clean.names if name in clean.truth.clean}
    channels = {name: v + 0.01 * v.std() * rng.normal(size=len(v)) for name, v in channels.items()}
    record = bq.Record.from_arrays(channels, time=time)
    found, terms = judged(record, tuple(record.names), [], "polynomial:3")
    assert found is None
    assert len(terms) == 9


def test_of_free_decay_nothing_repeats_itself():
    time = np.arange(3000) * 0.01
    x = np.exp(-0.02 * time) * np.sin(6.0 * time)
    record = bq.Record.from_arrays(x=x + 1e-3 * np.random.default_rng(2).normal(size=3000), time=time)
    assert judged(record, ("x::",), [], "oscillator")[0] is None


@pytest.mark.filterwarnings("ignore")  # of terms that the record cannot tell apart
@pytest.mark.parametrize("dictionary", ["polynomial:3 + v*abs(v)", pytest.param("oscillator", marks=pytest.mark.slow)])
def test_the_verdict_says_what_to_do(dictionary):
    # the posterior is sure of one law, since it has few terms
    record = draw_record(CASES["steady sine"], 4000, 30011)
    verdict = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=dictionary).verdict
    assert verdict.kind == "not determined"
    assert "repeats itself" in verdict.reason
    assert "multisine" in verdict.advice


def logistic(rate, n=200, noise=0.01, seed=0):
    """A logistic map where it has come to rest on its cycle, or goes on in chaos, with noise."""
    x = [0.4]
    for _ in range(5000 + n):
        x.append(rate * x[-1] * (1.0 - x[-1]))
    clean = np.array(x[-n:])
    return bq.Record.from_arrays(x=clean + noise * clean.std() * np.random.default_rng(seed).normal(size=n))


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
@pytest.mark.parametrize(("rate", "points"), [(3.2, 2), (3.5, 4), (3.61, None), (3.9, None)])
def test_a_map_is_on_a_cycle(rate, points, noise):
    """At 3.61 chaos fills two bands in turn: what is beside their means tells the map."""
    roles = Roles.parse(("x",), discrete=True)
    terms = build_dictionary("polynomial:3", Variables(roles.states, ()))
    record = in_samples(logistic(rate, noise=noise), roles)
    found = repeating(estimate_motion([record], roles, "auto", 0.2), terms)
    assert (found.courses if found else None) == points


@pytest.mark.parametrize(("rate", "verdict"), [(3.2, "not determined"), (3.5, "found"), (3.9, "found")])
def test_two_points_determine_no_map(rate, verdict):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eqs = bq.discover(logistic(rate), chains=["x"], discrete=True, dictionary="polynomial:3")
    assert eqs.equations[0].verdict.kind == verdict


def test_a_constant_that_may_be_0_alone_is_no_equation():
    """Of channels of white noise the smoothed motion is a line, whose slope says nothing."""
    rng = np.random.default_rng(12)
    record = bq.Record.from_arrays(x=rng.normal(size=200), y=rng.normal(size=200), fs=20.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eqs = bq.discover(record, chains=["x", "y"], dictionary="polynomial:2")
    assert [one.verdict.kind for one in eqs.equations] == ["none", "none"]
