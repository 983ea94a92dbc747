"""Records as test rigs give them: blows of a windowed force, records given twice, a velocity alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

import bayeq as bq
from bayeq.records.findings import clipped_levels, without_copies

AMONG_SIX = {"chains": "x::", "inputs": ["u"], "dictionary": "x, dx, x**2, x**3, dx*abs(dx), u"}


def _hammer(seed: int, rows: int = 12) -> bq.Record:
    """A mass of 2 kg on a spring of 3200 N/m, hit twice; the force's noise of 1 % of its peak only in the blows."""
    rng, fs, n = np.random.default_rng(seed), 400.0, 2000
    u = np.zeros(n)
    for start in (100, 1000):
        u[start : start + rows] = 200.0 * np.sin(np.pi * np.arange(rows) / rows)
    t, over = np.arange(n) / fs, 10
    fine = np.arange((n - 1) * over + 1) / (fs * over)
    system = StateSpace([[0, 1], [-1600.0, -2.0]], [[0], [0.5]], np.eye(2), np.zeros((2, 1)))
    x = lsim(system, np.interp(fine, t, u), fine)[1][::over, 0]
    measured = np.where(u != 0.0, u + 2.0 * rng.standard_normal(n), 0.0)
    return bq.Record.from_arrays({"x": x + 0.01 * x.std() * rng.standard_normal(n), "u": measured}, time=t)


@pytest.mark.filterwarnings("ignore::bayeq.errors.AmbiguityWarning")
def test_noise_in_blows_widens_the_interval_of_the_force() -> None:
    record = _hammer(0)
    with pytest.warns(bq.errors.DataWarning, match="u is exactly 0 between blows, its noise is not seen"):
        unknown = bq.discover(record, **AMONG_SIX, holdout=0.0)
    known = bq.discover(record, **AMONG_SIX, noise={"u": 2.0}, holdout=0.0)
    for eq in (unknown, known):
        assert eq.verdict.kind == "found"
        assert set(eq[0].shown) == {"x", "dx", "u"}
    sd = known.table().set_index("term").sd["u"]
    assert sd > 3.0 * unknown.table().set_index("term").sd["u"]
    assert abs(known[0].coef["u"] - 0.5) < 3.0 * sd


def test_blows_are_no_clipping_and_no_spikes() -> None:
    record = _hammer(1, rows=3)
    assert clipped_levels(_hammer(1)["u"]) == []
    with pytest.warns(bq.errors.DataWarning, match="exactly 0"):
        eq = bq.discover(record, **AMONG_SIX, holdout=0.0)
    assert not any("left out" in message for message in eq.warnings)
    assert eq[0].shown


def test_records_given_twice() -> None:
    record = bq.simulate("duffing", n=500, seed=1)
    kept, messages = without_copies([record, bq.simulate("duffing", n=500, seed=2), record], ["x", "u"])
    assert len(kept) == 2
    assert messages == [f"{record.name or 'record 3'} has the same samples as {record.name or 'record 1'}: left out"]
    again = record.with_channels({name: np.tile(record[name][:250], 2) for name in record.names}, {})
    (found,) = (one for one in bq.check_record(again, ["x:v:a"], ["u"]) if one.kind == "again")
    assert found.message == "rows 251 to 500 have the same samples as rows 1 to 250: leave them out (--rows)"
    assert found.value == 250


def test_a_velocity_alone() -> None:
    record = bq.simulate("linear", n=400, seed=1)
    asked = {"dictionary": "polynomial:1", "holdout": 0.0}
    eq = bq.discover(record, velocity="v", force="u", **asked)
    same = bq.discover(record, chains=":v:", inputs=["u"], **asked)
    assert eq[0].coef == same[0].coef
    renamed = bq.Record.from_arrays({"x": record["v"], "u": record["u"]}, time=record.time)
    assert bq.discover(renamed, chains=":x:", inputs=["u"], **asked)[0].chain.names == ("x_x", "x", "ddx_x")
