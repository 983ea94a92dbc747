"""Verdicts on equations whose first rows, or channels, say something else."""

import numpy as np
import pytest

import bayeq as bq
from bayeq.discovery.cautions import with_other_terms
from bayeq.errors import AmbiguityWarning, DataWarning, WarningLog
from bayeq.likelihood import model
from bayeq.regression.fit import with_model_of


def duffing(amplitude, seed, noise, rows=1500, interval=0.02):
    """Displacement and force of x" = u - 40 x - x' - 400 x^3, the force with an amplitude of its own at each row."""
    rng = np.random.default_rng(seed)
    frequencies, phases = rng.uniform(0.2, 2.5, 20), rng.uniform(0.0, 2.0 * np.pi, 20)
    fine, time = 10, interval * np.arange(rows)

    def force(t):
        return np.interp(t, time, amplitude) * np.cos(2.0 * np.pi * frequencies * t + phases).sum() / np.sqrt(10.0)

    def rate(t, y):
        return np.array([y[1], force(t) - 40.0 * y[0] - y[1] - 400.0 * y[0] ** 3])

    y, out, h = np.zeros(2), np.zeros((rows, 2)), interval / fine
    for row in range(1, rows):
        for k in range(fine):
            t = time[row - 1] + k * h
            a = rate(t, y)
            b = rate(t + h / 2, y + h / 2 * a)
            c = rate(t + h / 2, y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + rate(t + h, y + h * c))
        out[row] = y
    x, u = out[:, 0], np.array([force(t) for t in time])
    x, u = (one + noise * one.std() * rng.standard_normal(rows) for one in (x, u))
    return bq.Record.from_arrays({"x": x, "u": u}, time=time)


def test_terms_that_the_first_rows_refuse_are_not_found():
    """Four fifths of the record hardly leave the linear range: x**3 is in the equation of all rows only."""
    small, large = np.full(1230, 0.6), np.full(270, 2.0)
    asked = {"chains": "x::", "inputs": "u", "dictionary": "x, dx, x**2, x**3, u"}
    with pytest.warns(AmbiguityWarning, match="the first rows alone give other terms"):
        found = bq.discover(duffing(np.concatenate([small, large]), seed=4, noise=0.05), **asked)
    assert set(found[0].shown) - set(found[0].scored.shown) == {"x**3"}
    assert found.verdict.kind == "found"  # the first rows find it about as likely
    log = WarningLog()
    [refused] = with_other_terms(found.equations, True, log)
    assert not log.messages
    assert refused.verdict.kind == "not determined"
    assert refused.verdict.reason == "the first rows alone give other terms than all of them (x, dx, u)"
    throughout = bq.discover(duffing(np.full(1500, 4.0), seed=0, noise=0.01), **asked)
    assert throughout.verdict.kind == "found"
    assert with_other_terms(throughout.equations, True, log) == tuple(throughout.equations)
    assert set(throughout[0].shown) == {"x", "dx", "x**3", "u"}


def test_models_of_more_rows_are_compared_on_these(monkeypatch):
    eqs = bq.discover(
        duffing(np.full(600, 4.0), seed=0, noise=0.01, rows=600), chains="x::", inputs="u", dictionary="x, dx, x**3, u"
    )
    record = eqs[0].fit.regression.record
    without = record.fitted.model.copy()
    without[[term.text for term in record.task.layout.terms].index("x**3")] = False
    fewer = record.about(without)
    found, gain = with_model_of(fewer, record)
    assert gain > 100.0
    assert (found.fitted.model == record.fitted.model).all()
    same, gain = with_model_of(record, fewer)
    assert same is record
    assert gain < -100.0

    def fails(*_):
        raise np.linalg.LinAlgError("not finite")

    monkeypatch.setattr("bayeq.likelihood.record_fit.RecordFit.of", fails)
    same, gain = with_model_of(fewer, record)
    assert same is fewer
    assert gain == 0.0


def test_no_equation_names_the_offset_that_hides_it():
    record = bq.simulate("linear", n=400, noise=0.01, seed=3)
    channels = {name: record[name] for name in "xu"} | {"a": record["a"] + 100.0 * record["a"].std()}
    shifted = bq.Record.from_arrays(channels, time=record.time)
    with pytest.warns(DataWarning) as said:
        found = bq.discover(shifted, chains="x::a", inputs="u", dictionary="x, dx, x**3, u")
    assert any("is off d2x/dt2" in str(one.message) for one in said)
    assert found.verdict.kind == "none"
    assert "--remove-offset a=" in found.verdict.advice


def test_a_mean_over_sizes_is_below_its_maximum(monkeypatch):
    """On short overdamped records linearised fits of many terms promised up to 58,000 nats at other sizes."""
    found = bq.discover(
        bq.simulate("linear", n=300, noise=0.02, seed=1), chains="x:v:a", inputs="u", dictionary="x, v, u"
    )
    record = found[0].fit.regression.record
    task, fitted = record.task, record.fitted
    promised = np.array([5.8e4])
    monkeypatch.setattr(model, "_over_sizes", lambda *_: (promised, fitted.state))
    assert model.over_all_sizes(task, fitted).averages == pytest.approx(model.FLAT)
