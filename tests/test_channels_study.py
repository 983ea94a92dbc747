"""The study of missing channels draws what it says, and its cells can be computed."""

from __future__ import annotations

import numpy as np
import pytest
from studies.channels import CHAINS, FILTER, METHODS, ROWS, _cells, _differentiated, draw_record, measure_cell

import bayeq as bq


def test_records_have_the_rate_and_the_band_they_should():
    record = draw_record("duffing", 200.0, seed=1)
    assert record.n == ROWS
    assert record.fs == 200.0
    power = np.abs(np.fft.rfft(record.truth.clean["u"][:ROWS])) ** 2
    frequency = np.fft.rfftfreq(ROWS, 1 / 200.0)
    assert power[frequency > 55.0].sum() < 0.01 * power.sum()
    assert draw_record("duffing", 200.0, seed=1, dropped=True).n == round(0.9 * ROWS)
    np.testing.assert_array_equal(draw_record("duffing", 200.0, seed=1)["x"], record["x"])


def test_displacement_alone_is_enough_where_differences_fail(monkeypatch):
    monkeypatch.setattr("studies.channels.ROWS", 600)
    smoothed = measure_cell("linear", "x", 1000.0, "likelihood", 2)
    naive = measure_cell("linear", "x", 1000.0, "differences", 2)
    assert smoothed["exact"] == 2
    assert naive["exact"] == 0
    assert [smoothed[f"term{k}"] for k in (1, 2, 3, 4)] == ["x", "v", "u", ""]
    assert abs(float(smoothed["bias1_percent"])) < 1.0
    assert {naive[f"{kind}1_percent"] for kind in ("bias", "rms")} == {""}


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
@pytest.mark.parametrize("channels", ["x, a", pytest.param("x, v, a, 10 % of rows dropped", marks=pytest.mark.slow)])
def test_bias_and_rms_are_those_of_the_discoveries_of_the_cell(channels, monkeypatch):
    monkeypatch.setattr("studies.channels.ROWS", 400)
    line = measure_cell("linear", channels, 500.0, "likelihood", 2)
    errors = []
    for seed in range(2):
        record = draw_record("linear", 500.0, seed, dropped="dropped" in channels)
        eq = bq.discover(record, chains=CHAINS[channels], inputs=["u"], holdout=0.0)[0]
        found = {term.replace("dx", "v"): value for term, value in eq.shown_coef.items()}
        truth = record.truth.coefficients["a"]
        assert found.keys() == truth.keys()
        errors.append([100 * (found[term] / value - 1.0) for term, value in truth.items()])
    assert line["exact"] == 2
    for k, column in enumerate(np.transpose(errors), 1):
        assert float(line[f"bias{k}_percent"]) == pytest.approx(column.mean(), abs=6e-3)
        assert float(line[f"rms{k}_percent"]) == pytest.approx(np.sqrt(np.mean(column**2)), abs=6e-3)


def test_integrals_by_the_trapezoidal_rule_are_the_motion_without_its_drift():
    t = np.arange(4000) / 500.0
    record = bq.Record.from_arrays(time=t, a=-400.0 * np.cos(20.0 * t) + 3.0, u=t)
    # the constant integrates to a parabola, which is taken out with the drift
    ready = _differentiated(record, "::a", "differences")
    inner = slice(400, -400)
    # trapezoids of width h lose (20 h)^2/12 of the amplitude, and the polynomial follows ends of waves by some per cent
    np.testing.assert_allclose(ready["x"][inner], np.cos(20.0 * t)[inner], atol=0.05)
    np.testing.assert_allclose(ready["dx"][inner], -20.0 * np.sin(20.0 * t)[inner], atol=0.05 * 20.0)


def test_the_table_has_a_line_for_what_can_be_computed():
    cells = list(_cells(3, METHODS))
    assert len(set(cells)) == len(cells) == 4 * 4 * (6 * 3 - 2)
    assert ("linear", "a", 1000.0, FILTER, 3) not in cells
    assert len(list(_cells(3, ["likelihood"]))) == 4 * 4 * 6
    assert ("coulomb", "x, v, a, 10 % of rows dropped", 100.0, FILTER, 3) in cells
