"""The study of missing channels draws what it says, and its cells can be computed."""

from __future__ import annotations

import numpy as np
from studies.channels import ROWS, draw_record, measure_cell


def test_records_have_the_rate_and_the_band_they_should():
    record = draw_record("duffing", 200.0, seed=1)
    assert record.n == ROWS
    assert record.fs == 200.0
    power = np.abs(np.fft.rfft(record.truth.clean["u"][:ROWS])) ** 2
    frequency = np.fft.rfftfreq(ROWS, 1 / 200.0)
    assert power[frequency > 55.0].sum() < 0.01 * power.sum()
    assert draw_record("duffing", 200.0, seed=1, dropped=True).n == round(0.9 * ROWS)
    np.testing.assert_array_equal(draw_record("duffing", 200.0, seed=1)["x"], record["x"])


def test_displacement_alone_is_enough_where_differences_fail():
    smoothed = measure_cell("linear", "x", 1000.0, "smoother", 2)
    naive = measure_cell("linear", "x", 1000.0, "differences", 2)
    assert smoothed["exact"] == 2
    assert naive["exact"] == 0
    assert smoothed["term1"] == "x"
    assert abs(float(smoothed["bias1_percent"])) < 1.0
