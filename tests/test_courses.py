"""Inputs between their samples: the motion tells how they go, and what cannot be known of it is no discrepancy."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from studies.forces import draw_record

import bayeq as bq
from bayeq.errors import BayeqWarning
from bayeq.expressions import parse
from bayeq.selection.excitation import repeating
from bayeq.states import Roles, estimate_motion


@pytest.mark.parametrize(
    ("kind", "noise", "course"),
    [
        ("straight", 0.003, "linear"),
        ("held", 0.003, "hold"),
        ("taps", 0.02, None),
        pytest.param("blows", 0.0, None, marks=pytest.mark.slow),
    ],
)
def test_an_exact_law_is_found_whatever_its_force_does(kind, noise, course):
    record, truth = draw_record(kind, (noise, noise), 21)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        eq = bq.discover(record, chains="x:v:a", inputs=["u"])
    assert set(eq[0].included) == set(truth["a"])
    assert eq.verdict.kind == "found"
    found = eq[0].fit.regression.record
    assert found.kappa[0] < 0.01
    if course is not None:
        assert found.task.layout.courses == (course,)
    p = eq[0].posterior
    for name, value in truth["a"].items():
        j = p.names.index(name)
        assert abs(p.coef[j] - value) < 5.0 * p.sd[j]


def test_a_force_that_is_smaller_than_the_noise_of_the_input_is_none():
    # noise of u alone: by the model of its course it is as well a force
    record, truth = draw_record("straight", (0.0, 0.0), 4)
    u = record["u"] + 0.003 * record["u"].std() * np.random.default_rng(3).standard_normal(record.n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        eq = bq.discover(record.with_channels({"u": u}), chains="x:v:a", inputs=["u"])
    assert set(eq[0].included) == set(truth["a"])
    assert eq[0].fit.regression.record.adequacy.lacks(0) is None


def test_a_single_row_has_no_frequency():
    motion = estimate_motion([bq.simulate("duffing", n=12, seed=1)], Roles.parse("x:v:a", inputs=["u"]))
    assert repeating(replace(motion, cuts=(1,)), [parse("x", ["x"])]) is None
