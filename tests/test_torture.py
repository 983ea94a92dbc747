"""Numbers at the edge: a right answer or one clear line, never a crash, a silent NaN or a wrong answer."""

from __future__ import annotations

import warnings
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.errors import BayeqError, DataWarning, InputError
from bayeq.expressions import Evaluator, parse
from tests.draws import draws

ROLES = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
TERMS = ["x", "v", "x**3", "u"]
POWERS = {"x": (1, 0), "v": (1, 1), "a": (1, 2), "u": (1, 2)}  # of the unit of length, and of 1/time
METHODS = ["auto", "vb", "bma", "gibbs", "rvm", "stlsq"]
SMOOTH = ["none", "auto"]

quiet = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")


@pytest.fixture(scope="module")
def whole() -> bq.Record:
    return bq.simulate("duffing", n=160, seed=1)


def in_units(record: bq.Record, length: float, time: float) -> bq.Record:
    """The same motion with other units of length and time."""
    channels = {name: record[name] * length**p / time**q for name, (p, q) in POWERS.items()}
    return bq.Record.from_arrays(channels, time=np.asarray(record.time) * time)


def found(record: bq.Record, **options: object) -> bq.Equations:
    return bq.discover(record, **{**ROLES, "dictionary": TERMS, **options})  # type: ignore[arg-type]


# --- scales ----------------------------------------------------------------------------------------------------------


@quiet
@pytest.mark.parametrize(
    ("method", "smooth"),
    [
        ("auto", "auto"),
        *((method, "none") for method in METHODS),
        *(pytest.param(method, "auto", marks=pytest.mark.slow) for method in METHODS[1:]),
    ],
)
def test_units_that_are_powers_of_two_change_no_answer(whole, smooth, method):
    first = found(whole, smooth=smooth, method=method)[0]
    for length, time in ((2.0**-130, 2.0**-15), (2.0**100, 2.0**25)):
        other = found(in_units(whole, length, time), smooth=smooth, method=method)[0]
        assert other.included == first.included
        unit = {"x": time**-2, "v": 1 / time, "x**3": time**-2 * length**-2, "u": 1.0}
        scaled = [other.coef[name] / unit[name] for name in TERMS]
        # what rounds differently: sums of squares, and the ends of searches
        np.testing.assert_allclose(scaled, [first.coef[name] for name in TERMS], rtol=2e-4, atol=1e-9)


@quiet
@pytest.mark.parametrize("smooth", SMOOTH)
@pytest.mark.parametrize("exponent", [-310, -300, -150, -100, 60, 100, 150, 300])
def test_channels_out_of_range_are_refused(whole, smooth, exponent):
    channels = {**whole.channels, "x": np.asarray(whole["x"]) * 10.0**exponent}
    record = bq.Record.from_arrays(channels, time=whole.time)
    with pytest.raises(InputError, match=r"channel 'x' (varies by|is) .*give the channel in a (larger|smaller) unit"):
        found(record, smooth=smooth)


@quiet
@pytest.mark.parametrize("smooth", SMOOTH)
@pytest.mark.parametrize("time", [1e-150, 1e-50, 1e50, 1e150])
def test_steps_of_time_out_of_range_are_refused(whole, smooth, time):
    record = bq.Record.from_arrays(dict(whole.channels), time=np.asarray(whole.time) * time)
    with pytest.raises(InputError, match=r"steps of time are about .* out of range"):
        found(record, smooth=smooth)


@quiet
def test_terms_that_a_unit_puts_out_of_range_are_refused(whole):
    large, small = in_units(whole, 1e45, 1.0), in_units(whole, 1e-45, 1.0)
    with pytest.raises(InputError, match=r"term x\*\*5 is out of range where x is about .*larger unit"):
        found(large, dictionary=[*TERMS, "x**5"])
    with pytest.raises(InputError, match=r"term x\*\*5 is out of range where x is about .*smaller unit"):
        found(small, dictionary=[*TERMS, "x**5"])
    # a pole is no matter of units
    assert "1/(x-x)" in {d.name for d in found(whole, dictionary=[*TERMS, "1/(x-x)"]).dropped}


@quiet
def test_derivatives_that_are_estimated_out_of_range_are_refused():
    t = np.arange(60) * 1e-19
    record = bq.Record.from_arrays({"x": 1e30 * np.sin(1e18 * t)}, time=t)
    with pytest.raises(InputError, match="out of range"):
        bq.discover(record, chains="x::", dictionary=["x"])


# --- offsets ---------------------------------------------------------------------------------------------------------


@quiet
@pytest.mark.parametrize("smooth", SMOOTH)
def test_an_input_far_from_zero_changes_no_term(smooth):
    record = bq.simulate("duffing", n=400, seed=1)
    first = found(record, smooth=smooth)[0]
    for offset in (100, 1e4) if smooth != "auto" else (1e3,):
        u = np.asarray(record["u"])
        other = found(record.with_channels({"u": u + offset * u.std()}), smooth=smooth)[0]
        assert other.included == first.included == tuple(TERMS)
        assert other.coef["u"] == pytest.approx(first.coef["u"], rel=0.02)
        assert other.coef["x"] == pytest.approx(first.coef["x"], rel=0.05)


@quiet
@pytest.mark.parametrize("channel", ["x", "v", "a", "u"])
def test_offsets_that_leave_too_few_digits_are_refused(whole, channel):
    values = np.asarray(whole[channel])
    record = whole.with_channels({channel: values + 1e9 * values.std()})
    with pytest.raises(InputError, match=rf"channel '{channel}' lies .* times its range from zero.*--remove-offset"):
        found(record)


# --- few rows, copies, zeros -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_one_to_three_rows_are_refused(whole, rows):
    with pytest.raises(InputError, match="too few for a regression"):
        found(whole.slice(0, rows))


@quiet
@pytest.mark.parametrize("smooth", SMOOTH)
def test_a_target_of_zeros_is_refused(whole, smooth):
    with pytest.raises(InputError, match="channel 'a' is constant"):
        found(whole.with_channels({"a": np.zeros(whole.n)}), smooth=smooth)


@quiet
@pytest.mark.parametrize("noise", [0.0, 1e-14])
def test_copies_are_left_out_and_named(whole, noise):
    v = np.asarray(whole["v"])
    copy = v * (1 + noise * np.random.default_rng(0).normal(size=whole.n))
    record = whole.with_channels({"w": copy})
    answer = found(record, inputs=["w"], dictionary=[*TERMS, "w"], smooth="none")
    assert {d.name: d.reason for d in answer.dropped} == {"w": "a copy of v on the data"}
    assert answer[0].included == tuple(TERMS)


@lru_cache(maxsize=1)
def base():
    """A record, simulated when the first test asks for it."""
    return bq.simulate("duffing", n=160, seed=1)


class Tortured:
    """Draws of channels that are no measurement."""

    kinds = st.sampled_from(
        ["as it is"] * 6 + ["scaled", "zero", "offset", "copy", "near copy", "denormal", "signs", "spike"]
    )

    @staticmethod
    @st.composite
    def record(draw: st.DrawFn) -> bq.Record:
        rows = draw(st.sampled_from([1, 2, 3, 19, 20, 41, 160]))
        rng = np.random.default_rng(draw(st.integers(0, 1000)))
        length, time = 10.0 ** draw(st.integers(-55, 55)), 10.0 ** draw(st.integers(-22, 22))
        record = in_units(base(), *((length, time) if draw(st.booleans()) else (1.0, 1.0)))
        channels = {name: np.array(values[:rows]) for name, values in record.channels.items()}
        with np.errstate(all="ignore"):
            for name in channels:
                kind = draw(Tortured.kinds)
                if kind == "scaled":
                    channels[name] *= 10.0 ** draw(st.integers(-160, 160))
                elif kind == "zero":
                    channels[name] *= 0.0
                elif kind == "offset":
                    channels[name] += 10.0 ** draw(st.integers(0, 12)) * channels[name].std()
                elif kind == "copy":
                    channels[name] = channels["v"].copy()
                elif kind == "near copy":
                    channels[name] = channels["v"] * (1 + 1e-12 * rng.normal(size=rows))
                elif kind == "denormal":
                    channels[name] = channels[name] / (np.abs(channels[name]).max() or 1.0) * 5e-321
                elif kind == "signs":
                    channels[name] = np.sign(channels[name])
                elif kind == "spike":
                    channels[name][int(rng.integers(rows))] *= 1e30
        assert record.time is not None
        return bq.Record.from_arrays(channels, time=np.asarray(record.time)[:rows])


@quiet
@settings(max_examples=draws(25), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    record=Tortured.record(),
    chain=st.sampled_from(["x:v:a", "x::", "x:v:", "x:v", "::a"]),
    dictionary=st.sampled_from(["polynomial:3", "oscillator", "x, x**3, exp(x), 1/x, sin(x)"]),
    smooth=st.sampled_from(SMOOTH),
    method=st.sampled_from(METHODS),
)
def test_any_numbers_give_finite_coefficients_or_one_line(record, chain, dictionary, smooth, method):
    try:
        answer = bq.discover(record, chains=chain, inputs=["u"], dictionary=dictionary, smooth=smooth, method=method)
    except BayeqError as refused:
        lines = str(refused).splitlines()
    else:
        lines = []
    if lines:
        assert len(lines) == 1
        return
    assert " nan" not in str(answer)
    for equation in answer:
        numbers = [*equation.coef.values(), *equation.shown_coef.values(), equation.noise_sd]
        assert np.isfinite(numbers).all()


# --- estimators ------------------------------------------------------------------------------------------------------

ESTIMATORS = [bq.SpikeSlabVB, bq.SpikeSlabGibbs, bq.SpikeSlabBMA, bq.RVM]


def problem() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    D = rng.normal(size=(60, 4))
    return D, 2 * D[:, 0] - D[:, 2] + 0.1 * rng.normal(size=60)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("exponent", [-460, -200, 200, 460])
def test_units_of_columns_change_no_fit(estimator, exponent):
    D, y = problem()
    unit = np.array([2.0**exponent, 1.0, 2.0 ** (-exponent), 1.0])
    first, other = estimator().fit(D, y), estimator().fit(D * unit, y)
    np.testing.assert_allclose(other.pip_, first.pip_, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(other.coef_ * unit, first.coef_, rtol=1e-9)
    mean, sd = other.predict(D * unit, return_std=True)
    np.testing.assert_allclose(mean, first.predict(D), rtol=1e-9)
    assert np.isfinite(sd).all()


@pytest.mark.parametrize("estimator", [*ESTIMATORS, bq.STLSQ])
def test_columns_and_targets_without_squares_are_refused(estimator):
    D, y = problem()
    for small in (1e-160, 1e-200, 1e-310):
        with pytest.raises(ValueError, match="too small to square in x1: multiply"):
            estimator().fit(D * [1.0, small, 1.0, 1.0], y)
        with pytest.raises(ValueError, match="too small to square in the target"):
            estimator().fit(D, y * small)
    with pytest.raises(ValueError, match="squares that overflow"):
        estimator().fit(D * 1e160, y)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_coefficients_without_squares_are_refused(estimator):
    D, y = problem()
    with pytest.raises(ValueError, match=r"the coefficient of x0 is about .e\+2.., too large or too small to square"):
        estimator(**({} if estimator is bq.RVM else {"noise_rate": 1e200})).fit(D * 1e-100, y * 1e120)


def test_a_target_that_the_noise_prior_hides_is_warned_of():
    D, y = problem()
    with pytest.warns(DataWarning, match="takes for noise: divide it by its sd"):
        assert not bq.SpikeSlabVB().fit(D, y * 1e-6).coef_.any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bq.SpikeSlabVB().fit(D, y)
        bq.SpikeSlabVB().fit(D, np.zeros(60))  # nothing to find


@pytest.mark.parametrize("estimator", [*ESTIMATORS, bq.STLSQ])
@pytest.mark.parametrize("case", ["offset", "copy", "near copy", "N < P", "2 rows", "3 rows", "zero target", "zeros"])
def test_odd_problems_have_finite_answers(estimator, case):
    D, y = problem()
    noise = np.random.default_rng(1).normal(size=60)
    D, y = {
        "offset": (D + 1e9, y + 1e9),
        "copy": (D[:, [0, 0, 2, 3]], y),
        "near copy": (np.column_stack([D, D[:, 0] * (1 + 1e-12 * noise)]), y),
        "N < P": (np.random.default_rng(2).normal(size=(5, 20)), y[:5]),
        "2 rows": (D[:2], y[:2]),
        "3 rows": (D[:3], y[:3]),
        "zero target": (D, 0 * y),
        "zeros": (0 * D, y),
    }[case]
    fit = estimator().fit(D, y)
    mean, sd = fit.predict(D, return_std=True)
    for values in (fit.coef_, fit.pip_, fit.covariance_, fit.noise_variance_, mean, sd):
        assert np.isfinite(values).all()
    assert (sd >= 0).all()
    if case == "offset":
        np.testing.assert_allclose(fit.coef_[[0, 2]], [2.0, -1.0], atol=0.05)


# --- the evaluator ---------------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(
    text=st.sampled_from(["x**3", "x**-3", "x*abs(x)", "sign(x)*v", "x*v - v*x", "sqrt(abs(x))", "x/v", "max(x, v)"]),
    values=st.lists(st.floats(0.5, 2.0), min_size=2, max_size=4),
    exponent=st.integers(-300, 300),
)
def test_terms_of_scaled_columns_are_scaled_terms(text, values, exponent):
    degree = {"x**3": 3, "x**-3": -3, "x*abs(x)": 2, "sign(x)*v": 1, "x*v - v*x": 2, "sqrt(abs(x))": 0.5, "x/v": 0,
              "max(x, v)": 1}[text]  # fmt: skip
    exponent -= exponent % 2
    x, v = np.array(values), -np.array(values[::-1])
    once = Evaluator({"x": x, "v": v})(parse(text))
    scaled = Evaluator({"x": np.ldexp(x, exponent), "v": np.ldexp(v, exponent)})(parse(text))
    np.testing.assert_array_equal(scaled, np.ldexp(once, int(degree * exponent)))


@pytest.mark.parametrize("value", [5e-324, 1e-310, 1e-300, 1e300, 1.7e308, np.inf, np.nan])
def test_extreme_values_are_those_of_ieee(value):
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("error")
        columns = {"x": np.array([value, -value])}
        np.testing.assert_array_equal(Evaluator(columns)(parse("x*x")), columns["x"] * columns["x"])
        np.testing.assert_array_equal(Evaluator(columns)(parse("1/x")), 1 / columns["x"])
        np.testing.assert_array_equal(Evaluator(columns)(parse("exp(x)")), np.exp(columns["x"]))
