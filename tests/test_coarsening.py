"""The likelihood raised to a power."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.equation.power_sensitivity import coarsening
from bayeq.errors import InputError
from bayeq.gram import Gram
from bayeq.inference import Prior

OSCILLATOR = {"chains": "x:v:a", "inputs": ["u"]}


def test_half_of_every_row_is_what_half_of_the_rows_say():
    rng = np.random.default_rng(5)
    D = rng.normal(size=(60, 4))
    y = D[:, 0] + 0.3 * D[:, 1] + rng.normal(size=60)
    twice = Gram.from_data(np.vstack([D, D]), np.append(y, y)).raised(0.5)
    once = Gram.from_data(D, y)
    for name in ("n", "DtD", "Dty", "yty", "dof", "mean"):
        np.testing.assert_allclose(getattr(twice, name), getattr(once, name), rtol=1e-12, atol=1e-12)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_the_curve_begins_with_the_equation_and_ends_with_less():
    rec = bq.simulate("duffing", n=1000, seed=1)
    eq = bq.discover(rec, **OSCILLATOR)[0]
    curve = eq.coarsening()
    np.testing.assert_allclose(curve.pip[0], eq.posterior.pip, atol=0.01)
    assert (curve.pip[-1] > 0.5).sum() < (curve.pip[0] > 0.5).sum() == 4
    assert list(curve.table().columns) == ["coarsen", "rows", "term", "pip", "left_out"]
    assert "u: " in str(curve)
    one = bq.discover(rec, **OSCILLATOR, coarsen=0.125)[0]
    k = list(curve.power).index(0.125)
    # the prior's v_s is learned again at that power
    np.testing.assert_allclose(curve.pip[k], one.posterior.pip, atol=0.2)


def test_intervals_widen_by_the_root_of_the_power():
    rec = bq.simulate("linear", n=1000, seed=1)
    kwargs = {**OSCILLATOR, "dictionary": ["x", "v", "u"]}
    full, quarter = (bq.discover(rec, **kwargs, coarsen=t)[0].posterior.sd for t in (1.0, 0.25))
    np.testing.assert_allclose(quarter, 2.0 * full, rtol=0.02)


@pytest.mark.parametrize("value", [0.0, -1.0, 1.5, np.nan])
def test_powers_out_of_range(value):
    with pytest.raises(InputError, match="power"):
        bq.discover(bq.simulate("linear", n=100), **OSCILLATOR, coarsen=value)
    gram = Gram.from_data(np.eye(5), np.arange(5.0)).standardise().gram
    with pytest.raises(InputError, match="powers"):
        coarsening(gram, Prior(), [value])


def test_the_figure_is_drawn():
    rec = bq.simulate("linear", n=500, seed=1)
    figure = bq.discover(rec, **OSCILLATOR)[0].coarsening().plot()
    assert figure.axes[0].get_xlabel() == "power of the likelihood"
