"""The study of planned records drives the system it says, and counts what it says."""

from __future__ import annotations

import numpy as np
import pytest
from studies.planning import ARMS, FS, TRUE, driven, summary


def test_second_records_obey_the_true_law():
    time = np.arange(500) / FS
    force = 100.0 * np.sin(2 * np.pi * 7 * time)
    record = driven(force, dict.fromkeys(("x", "v", "a", "u"), 0.0), np.random.default_rng(0))
    x, v, a = record["x"], record["v"], record["a"]
    np.testing.assert_allclose(np.gradient(x, time)[2:-2], v[2:-2], atol=1e-2 * np.abs(v).max())
    np.testing.assert_allclose(np.gradient(v, time)[2:-2], a[2:-2], atol=1e-2 * np.abs(a).max())
    law = TRUE["x"] * x + TRUE["v"] * v + TRUE["x**3"] * x**3 + force
    np.testing.assert_allclose(a, law, atol=1e-9 * np.abs(a).max())
    noisy = driven(force, dict.fromkeys(("x", "v", "a", "u"), 0.5), np.random.default_rng(0))
    assert (noisy["u"] - force).std() == pytest.approx(0.5, rel=0.1)


def test_the_table_counts_records():
    lines = [dict.fromkeys(ARMS, chance) for chance in (0.2, 0.6, 0.95)]
    for line in summary(lines):
        assert (line["records"], line["above_0.5"], line["above_0.9"]) == (3, 2, 1)
        assert line["median_probability"] == "0.600"
