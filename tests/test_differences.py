"""A velocity computed from the displacement by differences, or a displacement by sums of the velocity."""

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import DataWarning

TRUTH = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}


@pytest.mark.parametrize("noise", [0.001, 0.01])
@pytest.mark.parametrize("chain", ["x:v:a", "x:v:"])
def test_differences_are_computed_from_the_displacement(chain, noise):
    """The velocity was kept, whose differences lag by half a row, and the displacement left out: none, or far off."""
    record = bq.simulate("duffing", n=2000, noise=noise, seed=5)
    channels = {name: record[name] for name in (*chain.strip(":").split(":"), "u")}
    channels["v"] = np.diff(record["x"], prepend=2.0 * record["x"][0] - record["x"][1]) * record.fs
    made = bq.Record.from_arrays(channels, time=record.time)
    with pytest.warns(DataWarning, match="v: computed from x, not measured"):
        eq = bq.discover(made, chains=chain, inputs="u", dictionary="x, v, x**2, x**3, v*abs(v), u")[0]
    table = eq.table().query("shown").set_index("term")
    assert set(table.index) == set(TRUTH)
    for term, value in TRUTH.items():
        assert abs(table.coef[term] - value) < 4.0 * table.sd[term]


def test_sums_are_computed_from_the_velocity():
    record = bq.simulate("duffing", n=2000, noise=0.01, seed=6)
    summed = np.cumsum(record["v"]) / record.fs
    made = bq.Record.from_arrays({"x": summed, "v": record["v"], "u": record["u"]}, time=record.time)
    with pytest.warns(DataWarning, match="x: computed from v, not measured"):
        bq.discover(made, chains="x:v:", inputs="u", dictionary="x, v, x**3, u")
