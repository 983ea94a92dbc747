"""Levels of all rows from sums over blocks: the curvature by differences, and the answer of all rows in memory."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import bayeq as bq
from bayeq.likelihood.block import _slopes, curvature, relearned
from bayeq.likelihood.low_pass import SEGMENT, mean_spectrum, of_segments, periodograms

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
DICTIONARY = "x, v, x**3, u"


def fitted(record):
    """The fit of all rows, and the equation."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = bq.discover(record, **OSCILLATOR, dictionary=DICTIONARY, holdout=0)[0]
    return found.fit.regression.record, found


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", n=12_000, seed=15)


@pytest.fixture(scope="module")
def whole(record):
    return fitted(record)


def test_levels_and_corners_are_those_of_all_rows(record, whole, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.entry.MOST_ROWS", 10_000)
    monkeypatch.setattr("bayeq.discovery.streaming.work.ROWS_EACH", 150)
    monkeypatch.setattr("bayeq.discovery.streaming.whole.BLOCK_ROWS", 4000)
    started = []

    def noted(task, state, *more):
        started.append((task, state))
        return relearned(task, state, *more)

    monkeypatch.setattr("bayeq.discovery.streaming.whole.relearned", noted)
    found, equation = fitted(record)
    task, state = started[0]
    # variances from 3,000 samples have a relative standard deviation of 2.6 %, those from 12,000 of 1.3 %
    few, all_rows, in_memory = (
        np.append(np.log(levels.channels), np.log(corners))
        for levels, corners in (
            (state.levels, task.layout.corners),
            (found.fitted.state.levels, found.task.layout.corners),
            (whole[0].fitted.state.levels, whole[0].task.layout.corners),
        )
    )
    assert np.abs(few - in_memory).max() > 0.01
    # within 0.6 of the standard deviation
    assert np.abs(all_rows - in_memory).max() < 0.6 * 0.013
    p, other = equation.posterior, whole[1].posterior
    assert equation.shown == whole[1].shown
    kept = p.support
    assert (np.abs(p.projected.coef - other.projected.coef)[kept] < 0.1 * other.sd[kept]).all()
    # by projection what is smoothed of a discrepancy that is next to nothing moves them too
    assert (np.abs(p.coef - other.coef)[kept] < 0.2 * other.sd[kept]).all()


def test_the_curvature_is_that_of_one_likelihood(whole):
    task, state = whole[0].task, whole[0].fitted.state
    levels, curve = state.levels, curvature(task, state)
    # in discrepancies, and what courses err by, the likelihood of a true equation is flat
    sharp = np.flatnonzero(~levels.optional[curve.moving])
    assert curve.moving[sharp].tolist() == np.flatnonzero(~levels.optional).tolist()
    hessian = curve.scores[np.ix_(sharp, sharp)]
    unit = np.sqrt(-np.diagonal(hessian))
    np.testing.assert_allclose(hessian / unit[:, None] / unit, (hessian / unit[:, None] / unit).T, atol=0.01)
    # slopes by coefficients, by levels, are slopes by levels, by coefficients; the largest is 0.024
    information = np.diagonal(whole[0].fitted.quadratic.information) / task.rows
    base = _slopes(task, state)[1]
    for k, j in enumerate(task.number(state.chosen)):
        step = 0.1 / np.sqrt(information[j] * task.rows)
        theta = state.theta + step * (np.arange(len(state.theta)) == k)
        moved = _slopes(task, replace(state, theta=theta))[1]
        by_theta = (moved - base)[curve.moving[sharp]] / step / task.rows
        scale = unit * np.sqrt(information[j])
        np.testing.assert_allclose(curve.slopes[j, sharp] / scale, by_theta / scale, atol=1e-3)


def test_a_spectrum_is_a_sum_over_segments():
    rng = np.random.default_rng(0)
    values = rng.standard_normal(3 * SEGMENT)
    # a window's power, and half of each segment overlapping the next
    starts = range(0, 2 * SEGMENT + 1, SEGMENT // 2)
    window = np.hanning(SEGMENT)
    bins = np.mean([np.abs(np.fft.rfft(values[k : k + SEGMENT] * window)) ** 2 for k in starts], axis=0)
    found = mean_spectrum([values])
    np.testing.assert_allclose(found.power, bins[1 : len(found.power) + 1] / (0.375 * SEGMENT))
    again = of_segments(*periodograms(values, SEGMENT), SEGMENT)
    np.testing.assert_array_equal(again.power, found.power)
    assert found.segments[0] == len(starts)
    assert found.power.mean() == pytest.approx(1.0, abs=0.03)
    # pieces that are shorter are segments of their own
    assert sorted(set(mean_spectrum([values[:500], values[:500], values[:SEGMENT]]).segments)) == [1, 2]
    assert len(mean_spectrum([values[:2]]).omega) == 0
