"""A plausible equation where PIPs are shared out among columns that hardly differ."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.expressions import parse
from bayeq.gram import Gram
from bayeq.inference import ENGINES, Prior
from bayeq.inference.collapsed.path import model_log_posterior
from bayeq.inference.collapsed.problem import Problem
from bayeq.selection.plausible import plausible

PRIOR = Prior()


def shared_out(copies, noise=0.5, seed=0):
    """A target that follows x and what five columns hold alike, each as good as another."""
    rng = np.random.default_rng(seed)
    x, hidden = rng.normal(size=(2, 400))
    D = np.column_stack([x, *(hidden + 0.02 * rng.normal(size=400) for _ in range(copies))])
    y = x + 0.5 * hidden + noise * rng.normal(size=400)
    return Gram.from_data(D - D.mean(axis=0), y - y.mean())


def test_one_of_the_group_stands_in_for_it_the_simplest():
    gram = shared_out(5)
    terms = [parse(text) for text in ("x", "v*abs(v)", "v**3", "v", "sign(v)", "x**2*v")]
    found = ENGINES["auto"].run(gram, PRIOR)
    # the case that is meant: none of the five reaches a half, and yet one of them is in for certain
    assert list(np.flatnonzero(found.support)) == [0]
    assert found.average is not None
    assert found.average.models[:, 1:].any(axis=1) @ found.average.probability > 0.999
    shown = plausible(gram, PRIOR, found, terms)
    assert [terms[j].text for j in np.flatnonzero(shown.support)] == ["x", "v"]
    np.testing.assert_array_equal(shown.pip, found.pip)
    problem = Problem.of(gram, PRIOR)
    best = model_log_posterior(problem, found.average.models[0])
    assert best - model_log_posterior(problem, found.support) > np.log(100)
    assert best - model_log_posterior(problem, shown.support) < np.log(10)
    # coefficients are those of least squares on the shown columns, hardly shrunk
    kept = np.flatnonzero(shown.support)
    expected = np.linalg.solve(gram.DtD[np.ix_(kept, kept)], gram.Dty[kept])
    np.testing.assert_allclose(shown.coef[kept], expected, rtol=1e-2)


def test_a_plausible_equation_stays():
    gram = shared_out(1)
    found = ENGINES["auto"].run(gram, PRIOR)
    assert plausible(gram, PRIOR, found, [parse("x"), parse("v")]) is found
    sampled = ENGINES["gibbs"].run(gram, PRIOR, seed=0)
    assert plausible(gram, PRIOR, sampled, [parse("x"), parse("v")]) is sampled


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_free_decay_keeps_its_damping():
    t = np.arange(700) / 30.0
    rng = np.random.default_rng(4)
    x = 100 * np.exp(-0.0067 * t) * np.cos(2.494 * t) + 0.3 * rng.standard_normal(700)
    eq = bq.discover(bq.Record.from_arrays(time=t, x=x), chains="x::")
    assert "x" in eq[0].included
    assert {term for term in eq[0].included if "dx" in term}
