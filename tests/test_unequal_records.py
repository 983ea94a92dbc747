"""Records with noise of different size: a variance of each channel in every record."""

from dataclasses import replace

import numpy as np
import pytest

import bayeq as bq
from bayeq.likelihood import record_fit

SIZES = (0.002, 0.01, 0.1)


def discovered(monkeypatch, sizes, n=800, **options):
    """The equations of Duffing records, the fit's task and state, and the noise that was drawn (records, channels)."""
    fits, drawn = [], [bq.simulate("duffing", n=n, noise=size, seed=i) for i, size in enumerate(sizes)]
    records = [bq.Record.from_arrays({"x": one["x"], "u": one["u"]}, time=one.time) for one in drawn]
    asked = record_fit.with_unequal_noise
    monkeypatch.setattr(record_fit, "with_unequal_noise", lambda *given: fits.append(asked(*given)) or fits[-1])
    terms = ["x", "dx", "x**2", "x**3", "dx**2", "dx**3", "u"]
    eqs = bq.discover(records, chains="x::", inputs="u", dictionary=terms, **options)
    return eqs, *fits[-1], np.array([[one.truth.noise_sd[name] for name in "xu"] for one in drawn])


def test_intervals_use_the_records_with_little_noise(monkeypatch):
    eqs, task, state, drawn = discovered(monkeypatch, SIZES)
    ratios = np.array([one.spread[0] for one in task.series])
    np.testing.assert_allclose(np.sqrt(state.levels.channels * ratios), drawn, rtol=0.15)

    def changed(k, factor):
        series = list(task.series)
        series[k] = series[k]._replace(spread=factor * series[k].spread)
        return replace(task, series=tuple(series)).marginal(state, keep=False).value

    for k in range(len(SIZES)):
        assert changed(k, 1.0) > max(changed(k, 0.8), changed(k, 1.25))
    assert eqs.verdict.kind == "found"
    truth = {"x": -1000.0, "dx": -2.0, "x**3": -1e5, "u": 1.0}
    table = eqs.table().query("shown").set_index("term")
    assert set(table.index) == set(truth)
    for term, value in truth.items():
        assert abs(table.coef[term] - value) < 4.0 * table.sd[term]
        # of a common variance: 0.4 % of u, 0.4 % of x
        assert table.sd[term] < abs(value) * (0.003 if term == "dx" else 0.002)


def test_equal_noise_stays_common(monkeypatch):
    _, task, _, _ = discovered(monkeypatch, (0.02, 0.02, 0.02))
    assert all((one.spread == 1.0).all() for one in task.series)


@pytest.mark.parametrize("known", ["x", "u"])
def test_known_noise_stays(monkeypatch, known):
    noise = bq.simulate("duffing", n=400, noise=SIZES[1], seed=1).truth.noise_sd[known]
    _, task, _, _ = discovered(monkeypatch, SIZES, n=400, noise={known: noise})
    spread = np.array([one.spread[0] for one in task.series])
    assert (spread[:, "xu".index(known)] == 1.0).all()
    assert np.ptp(spread[:, "ux".index(known)]) > 1.0
