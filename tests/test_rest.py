"""Free vibrations that are held before their release, or rest after it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import bayeq as bq
from bayeq.states import Roles
from bayeq.states.rest import moving_rows, without_rest

RATE, FREQUENCY, DAMPING, START = 200.0, 6.0, 2.0, 0.02


def released(held=0.0, friction=0.0, seconds=16.0, zeta=DAMPING, noise=0.01, seed=1):
    """Displacement and acceleration (n, 2), by a half period of a linear oscillator after another, and the law."""
    t, w = np.arange(round(seconds * RATE)) / RATE, 2.0 * np.pi * FREQUENCY
    wd, rest = np.sqrt(w * w - zeta * zeta / 4.0), friction / (w * w)
    x, a, start, begin = np.full(len(t), START), np.zeros(len(t)), START, held
    while abs(start) > rest and begin < t[-1]:
        towards = np.sign(start) * rest
        s = t - begin
        now = (s >= 0.0) & (s <= np.pi / wd) if friction else s >= 0.0
        decay = (start - towards) * np.exp(-zeta * s[now] / 2.0)
        y, v = (
            decay * (np.cos(wd * s[now]) + zeta / 2.0 / wd * np.sin(wd * s[now])),
            -decay * w * w / wd * np.sin(wd * s[now]),
        )
        x[now], a[now] = towards + y, -w * w * y - zeta * v
        if not friction:
            break
        begin += np.pi / wd
        start = towards - (start - towards) * np.exp(-zeta * np.pi / 2.0 / wd)
        x[t > begin], a[t > begin] = start, 0.0
    both = np.column_stack([x, a])
    both += noise * both.std(axis=0) * np.random.default_rng(seed).standard_normal(both.shape)
    return both, {"x": -w * w, "dx": -zeta, "sign(dx)": -friction}


@pytest.mark.parametrize(("held", "friction"), [(0.0, 1.5), (0.7, 0.0), (0.7, 1.5)])
def test_a_law_is_of_the_rows_that_move(held, friction):
    both, law = released(held, friction)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record = bq.Record.from_arrays(x=both[:, 0], a=both[:, 1], fs=RATE)
        eq = bq.discover(record, chains="x::a", dictionary="oscillator")[0]
    assert any("at rest, so left out" in str(one.message) for one in caught)
    assert set(eq.shown) == {name for name, value in law.items() if value}
    for name, value in eq.shown_coef.items():
        sd = eq.shown_posterior.sd[eq.shown_posterior.names.index(name)]
        assert abs(value - law[name]) < 5.0 * sd  # five in 10 draws of a million


def test_where_the_motion_begins_and_ends():
    rows = len(released()[0])
    assert moving_rows(released(seconds=2.0)[0]) == (0, 400)  # it has not died out
    start, stop = moving_rows(released(held=0.7)[0])
    assert 0.7 * RATE <= start <= 0.7 * RATE + 3 * 16
    assert stop < rows
    # held at first, and still moving at the end
    start, stop = moving_rows(released(held=0.7, zeta=0.2)[0])
    assert 0.7 * RATE <= start <= 0.7 * RATE + 3 * 16
    assert stop == rows


def test_motion_that_grows_is_no_rest():
    t = np.arange(4000) / 100.0
    grown = np.exp(0.1 * t) * np.sin(5.0 * t)
    noisy = grown + 0.01 * grown.std() * np.random.default_rng(2).standard_normal(4000)
    assert moving_rows(np.column_stack([noisy])) == (0, 4000)


def test_driven_motion_is_kept():
    record = bq.Record.from_arrays(x=released(held=0.7)[0][:, 0], u=np.zeros(3200), fs=RATE)
    assert without_rest([record], Roles.parse("x::", inputs=["u"]))[1] == []
