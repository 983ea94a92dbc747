"""What users of NumPy and pandas hand over: masks, dates as an index, other units, rates, records that warn."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest

import bayeq as bq
from bayeq.errors import BayeqWarning, DataWarning, InputError

ASKED = {"chains": "x:v:a", "inputs": ["u"], "dictionary": "x, v, x**3, u", "holdout": 0.0}


@pytest.fixture(scope="module")
def record() -> bq.Record:
    return bq.simulate("duffing", n=800, seed=1)


@pytest.fixture(scope="module")
def answer(record: bq.Record) -> bq.Equations:
    return bq.discover(record, **ASKED)


def test_masked_samples_of_a_mapping_are_missing(record: bq.Record) -> None:
    x = np.ma.array(record["x"].copy(), mask=False)
    x[100:104] = 1e3
    x.mask[100:104] = True
    with pytest.warns(DataWarning, match="x: 4 samples are missing"):
        eq = bq.discover({"t": record.time, **record.channels, "x": x}, **ASKED)
    assert eq[0].coef["x"] == pytest.approx(-1000.0, rel=0.05)


@pytest.mark.parametrize("kind", ["dates", "zone", "durations"])
def test_an_index_of_dates_is_time_without_a_name(record: bq.Record, kind: str) -> None:
    index: pd.Index = pd.to_timedelta(record.time, unit="s")
    if kind != "durations":
        index = pd.Timestamp("2024-03-01", tz="UTC" if kind == "zone" else None) + index
    frame = pd.DataFrame(dict(record.channels), index=index)
    assert bq.Record.from_dataframe(frame).fs == pytest.approx(1000.0)
    assert bq.Record.from_dataframe(pd.DataFrame(dict(record.channels))).time is None
    # a column that is named time is that, as ever
    named = bq.Record.from_dataframe(frame.assign(t=2.0 * np.asarray(record.time)))
    assert named.fs == pytest.approx(500.0)
    assert set(named.names) == set(record.names)


def test_other_units_of_a_record_are_converted(record: bq.Record, answer: bq.Equations) -> None:
    other = record.with_channels({"x": 1e3 * record["x"]}, {"x": "mm"})
    np.testing.assert_allclose(answer.predict(other), answer.predict(record), rtol=1e-9, atol=1e-9)
    assert str(answer.score(other)) == str(answer.score(record))
    wrong = record.with_channels({"x": record["x"]}, {"x": "kg"})
    with pytest.raises(InputError, match="x is in kg, in the equations in m"):
        answer.score(wrong)


def test_records_in_other_units_become_one(record: bq.Record) -> None:
    second = bq.simulate("duffing", n=800, seed=2)
    other = second.with_channels({"x": 1e3 * second["x"]}, {"x": "mm"})
    with pytest.warns(DataWarning, match="duffing: x was converted from mm to m"):
        found = bq.discover([record, other], **ASKED)
    assert found[0].units["x"] == "m"
    assert found[0].coef == pytest.approx(bq.discover([record, second], **ASKED)[0].coef, rel=1e-6)


def test_a_rate_that_is_not_that_of_the_time_left_as_a_channel_is_said(record: bq.Record) -> None:
    other = bq.Record.from_arrays({"t": record.time, **record.channels}, fs=500)
    with pytest.warns(BayeqWarning) as said:
        bq.discover(other, chains="x:v:a", inputs=["u"], smooth="none")
    assert any("t rises by 0.001 s a row, and fs = 500 was given: check fs" in str(one.message) for one in said)


def test_answers_are_compared_by_identity(answer: bq.Equations) -> None:
    assert answer in [answer]
    assert answer != bq.Equations.__new__(bq.Equations)
    assert len({answer, bq.Equations.__new__(bq.Equations)}) == 2


def test_what_cannot_be_computed_for_a_warning_ends_no_answer() -> None:
    """Noise of u, were there any, would make 1/u**2 infinite: its products with less of it are no positive matrix."""
    rng = np.random.default_rng(0)
    v, u = 2.0 * rng.normal(size=600), rng.normal(size=600)
    a = 2.5 / u**2 - 1.5 * v + 0.7 * u + 1e-3 * rng.normal(size=600)
    columns = {"x": rng.normal(size=600), "v": v, "a": a, "u": u}
    record = bq.Record.from_arrays(columns, time=np.arange(600) / 100.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        eq = bq.discover(record, chains="x:v:a", inputs=["u"], smooth="none", dictionary="1/u**2, v, u", holdout=0.0)
    assert eq[0].coef["1/u**2"] == pytest.approx(2.5, rel=0.01)


@pytest.mark.parametrize(("name", "value"), [("max_iter", 0), ("max_iter", "x"), ("tol", "x"), ("tol", float("nan"))])
def test_parameters_of_estimators_are_refused_by_name(name: str, value: object) -> None:
    D = np.random.default_rng(0).normal(size=(50, 3))
    with pytest.raises(InputError, match=f"{name} must be"):
        bq.SpikeSlabVB(**{name: value}).fit(D, D[:, 0])


@pytest.mark.parametrize("name", ["w", "theta", "d", "l", "b", "force"])
def test_inputs_may_have_any_name(record: bq.Record, name: str) -> None:
    channels = {key if key != "u" else name: values for key, values in record.channels.items()}
    eq = bq.discover(bq.Record(channels, record.time), chains="x:v:a", inputs=[name], dictionary="oscillator:3")
    assert set(eq[0].shown) == {"x", "v", "x**3", name}
    assert eq.simulate(bq.Record(channels, record.time)).blew_up_at is None


@pytest.mark.parametrize(
    ("factors", "said"), [({"x": 1e3, "v": 1e3, "a": 1e3}, True), ({"u": 1e-3}, True), ({}, False)]
)
def test_records_in_different_units_are_noticed(factors, said):
    first, second = (bq.simulate("linear", n=400, seed=seed) for seed in (1, 3))
    scaled = {name: factors.get(name, 1.0) * second[name] for name in second.channels}
    records = [first, bq.Record.from_arrays(scaled, time=second.time)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        bq.discover(records, chains="x:v:a", inputs="u", dictionary="x, v, u", smooth="none")
    assert any("times between records: give their units" in str(one.message) for one in caught) == said
