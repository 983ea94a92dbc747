"""t, the time, in terms: on rows, in the likelihood, in free runs, in files."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import bayeq as bq
from bayeq.equation.written import quotient_unit
from bayeq.errors import InputError, RecordError
from bayeq.expressions import parse


def quietly(records, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


LAW = {"x": -40.0, "v": -0.8, "cos(3*t)": 12.0}
TERMS = "x, v, x**3, cos(3*t), sin(3*t), t"
CHANNELS = {"displacement": "x", "velocity": "v", "acceleration": "a"}


def driven(begin=0.0, n=1200, h=0.02):
    """A spring pulled in time, by steps of a fourth-order method."""

    def slope(t, state):
        return np.array([state[1], -40.0 * state[0] - 0.8 * state[1] + 12.0 * np.cos(3.0 * t)])

    time = begin + h * np.arange(n)
    states = np.empty((n, 2))
    states[0] = 1.0, 0.0
    for k, t in enumerate(time[:-1]):
        s = states[k]
        k1 = slope(t, s)
        k2 = slope(t + 0.5 * h, s + 0.5 * h * k1)
        k3 = slope(t + 0.5 * h, s + 0.5 * h * k2)
        k4 = slope(t + h, s + h * k3)
        states[k + 1] = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    a = np.array([slope(t, s)[1] for t, s in zip(time, states, strict=True)])
    rng = np.random.default_rng(0)
    clean = {"x": states[:, 0], "v": states[:, 1], "a": a}
    noisy = {name: values + 0.02 * values.std() * rng.normal(size=n) for name, values in clean.items()}
    return bq.Record.from_arrays(noisy, time=time), clean


@pytest.fixture(scope="module", params=["auto", "none"])
def found(request):
    record, clean = driven()
    return quietly(record, **CHANNELS, dictionary=TERMS, smooth=request.param), record, clean


def test_the_law_is_found_and_run(found, tmp_path):
    eq, record, clean = found
    (one,) = eq
    assert set(one.shown) == set(LAW)
    for name, value in LAW.items():
        assert one.shown_coef[name] == pytest.approx(value, rel=0.05)
    assert eq.inputs == ()
    state = [0.3, -0.2]
    for t in (0.0, 1.3):
        expected = one.shown_posterior.intercept + sum(
            one.shown_coef[name] * value for name, value in {"x": 0.3, "v": -0.2, "cos(3*t)": np.cos(3.0 * t)}.items()
        )
        assert eq.rhs(t, state)[1] == pytest.approx(expected)
    run = eq.simulate(record, draws=3)
    assert run.nrmse["x"] < 0.1
    # from another row on: the clock goes with the record
    assert eq.simulate(record, draws=0, start=333, rows=400).nrmse["x"] < 0.1
    assert np.corrcoef(eq.predict(record), clean["a"])[0, 1] > 0.99
    assert eq.score(record).free_run["x"] < 0.1
    eq.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    np.testing.assert_array_equal(again.rhs(1.3, state), eq.rhs(1.3, state))
    assert again.simulate(record, draws=0).nrmse["x"] == pytest.approx(run.nrmse["x"])


UNITS = {"x": "mm", "v": "m/s", "a": "m/s^2", "t": "s"}


@pytest.mark.parametrize(
    ("term", "unit"),
    [
        ("t", "m/s^3"),
        ("cos(2*pi*t)", "m/s^2"),
        ("pi*x", "m/s^2/mm"),
        ("relu(x)", "m/s^2/mm"),
        ("max(x,0)", "m/s^2/mm"),
        ("min(x,v)", None),
        ("where(x>v,x,0)", "m/s^2/mm"),
        ("where(x>v,1,2)", "m/s^2"),
        ("mod(x,v)", "m/s^2/mm"),
        ("atan2(x,v)", "m/s^2"),
        ("heaviside(x)*v", "1/s"),
        ("cbrt(x**3)", "m/s^2/mm"),
    ],
)
def test_units_of_coefficients(term, unit):
    assert quotient_unit("a", parse(term), UNITS) == unit


def test_a_clock_that_does_not_begin_at_zero():
    record, _ = driven(begin=100.0, n=800)
    (one,) = quietly(record, **CHANNELS, dictionary=TERMS)
    assert set(one.shown) == set(LAW)
    assert one.shown_coef["cos(3*t)"] == pytest.approx(12.0, rel=0.05)


def test_refined_with_time():
    record, _ = driven(n=600)
    eq = quietly(record, **CHANNELS, dictionary=TERMS).refine(record)
    assert eq[0].shown_coef["cos(3*t)"] == pytest.approx(12.0, rel=0.03)


def test_a_channel_of_that_name_wins():
    record, _ = driven(n=600)
    force = np.cos(3.0 * record.time)
    own = bq.Record.from_arrays({**{n: record[n] for n in "xva"}, "t": force}, time=record.time)
    eq = quietly(own, **CHANNELS, force="t", dictionary="x, v, x**3, t")
    assert eq[0].shown_coef["t"] == pytest.approx(12.0, rel=0.1)
    assert eq.rhs(5.0, [0.0, 0.0], [2.0])[1] == pytest.approx(2.0 * eq[0].shown_coef["t"], rel=0.1)
    with pytest.raises(InputError, match="t is the time, but the record has a channel 't' that is no input"):
        quietly(own, **CHANNELS, dictionary="x, v, t")
    own = bq.Record.from_arrays({**{n: record[n] for n in "xva"}, "e": force}, time=record.time)
    with pytest.raises(InputError, match=r"e is the number 2\.718, but the record has a channel 'e'"):
        quietly(own, **CHANNELS, dictionary="x, v, e*x")
    eq = quietly(own, **CHANNELS, force="e", dictionary="x, v, e")
    assert eq[0].shown_coef["e"] == pytest.approx(12.0, rel=0.1)
    assert {"e"} <= {symbol.name for symbol in eq.to_sympy().rhs.free_symbols}


def test_records_without_time_are_refused():
    record, _ = driven(n=600)
    bare = bq.Record.from_arrays({name: record[name] for name in "xva"})
    with pytest.raises(RecordError, match="a term uses t, the time, but the record has none; name its time column"):
        quietly(bare, **CHANNELS, dictionary=TERMS)
    eq = quietly(record, **CHANNELS, dictionary=TERMS)
    with pytest.raises(RecordError, match="a term uses t"):
        eq.predict(bare)


def test_no_measurement_is_planned_in_time():
    record, _ = driven(n=600)
    own = bq.Record.from_arrays({**{n: record[n] for n in "xva"}, "u": np.cos(7 * record.time)}, time=record.time)
    eq = quietly(own, **CHANNELS, force="u", dictionary=f"{TERMS}, u")
    with pytest.raises(InputError, match="use t, the time"):
        eq.plan()
