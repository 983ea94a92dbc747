"""The filter of a linearised record, and its adjoint, against the joint Gaussian, differences and simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayeq.dictionary import Variables, build_dictionary
from bayeq.likelihood.filter import adjoint, run_filter
from bayeq.likelihood.fit import State, adjoints, corrections, linearised, marginal, quadratic
from bayeq.likelihood.layout import Candidates, Layout
from bayeq.likelihood.levels import Levels, Scales
from bayeq.likelihood.linear import Series
from bayeq.ode.rk4 import interpolant
from bayeq.states import Roles

from . import reference

# A driven oscillator that is coupled to a chain of first order: coefficients by equation and term.
TRUTH = {
    (0, "x"): -4.0,
    (0, "v"): -0.3,
    (0, "z"): 0.8,
    (0, "u"): 1.0,
    (0, "x**2"): -0.5,
    (1, "z"): -0.7,
    (1, "x"): 0.4,
    (1, "w"): 0.3,
    (1, "x*z"): 0.2,
}


def layout_of(terms="polynomial:2"):
    """Chains of orders 2 and 1, the highest derivative of one measured; an input with noise, and an exact one."""
    roles = Roles.parse(chains=["x:v:a", "z"], inputs=["u", "w"])
    terms = build_dictionary(terms, Variables(roles.states, roles.inputs))
    gains = (np.array([1.0, 2.0, 0.5]), np.ones(2))
    return Layout(roles, terms, gains, noisy=("u",), smoothness=(3,))


def system(n, seed=0, step=0.1, gaps=0.15):
    """A layout, a record whose samples are near a path, and a fit that stands there."""
    layout, rng = layout_of(), np.random.default_rng(seed)
    time = np.cumsum(step * rng.uniform(0.8, 1.2, n))
    path = np.zeros((n, layout.size))
    for i in range(layout.size):
        a, b, c = rng.normal(size=3)
        path[:, i] = 0.3 * a + np.sin(b + 1.5 * time) + 0.3 * np.cos(3.0 * time + c)
    path[:, layout.discrepancy] *= 0.1
    samples = np.empty((n, len(layout.channels)))
    for j, kind in enumerate(layout.kinds):
        samples[:, j] = path[:, kind] if kind >= 0 else np.cos(time)
    samples += 0.1 * rng.normal(size=samples.shape)
    samples[rng.random(samples.shape) < gaps] = np.nan
    series = Series(np.diff(time), samples, interpolant(time, np.sin(time)[:, None], "cubic"))
    scales = Scales(0.1 * rng.normal(size=layout.size), rng.uniform(0.5, 2.0, layout.size), np.ones(samples.shape[1]))
    levels = Levels(
        layout,
        scales,
        channels=rng.uniform(0.005, 0.05, samples.shape[1]),
        discrepancy=np.array([0.1, 0.05]),
        memory=np.array([0.8, 0.6]),
        slope=np.array([0.5]),
        slope_memory=np.array([0.9]),
    )
    texts = [term.text for term in layout.terms]
    chosen = Candidates(np.array([c for c, _ in TRUTH]), np.array([texts.index(text) for _, text in TRUTH]))
    return layout, series, State(chosen, np.array(list(TRUTH.values())), (path,), levels)


def close(actual, wanted, tolerance):
    """Equal up to a share of the largest entry."""
    np.testing.assert_allclose(actual, wanted, rtol=tolerance, atol=tolerance * np.abs(wanted).max())


def some(chosen, seed):
    """The coefficients in a random order."""
    order = np.random.default_rng(seed).permutation(len(chosen.chain))
    return chosen.take(order)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("which", ["chosen", "mixed", "every", "none"])
def test_is_the_joint_gaussian_of_all_samples(seed, which):
    layout, series, state = system(12, seed)
    [linear] = linearised(layout, [series], state)
    chosen = {
        "chosen": state.chosen,
        "mixed": some(state.chosen, seed),
        "every": layout.everything,
        "none": state.chosen.take(np.arange(0)),
    }[which]
    noise = state.levels.noise
    level, slope, information, smoothed = reference.state_space_gaussian(linear, chosen, noise)
    found = run_filter(linear, chosen, noise)
    q = quadratic([found])
    assert q.level == pytest.approx(level, rel=1e-10)
    assert q.slope.shape == slope.shape
    assert q.information.shape == information.shape
    r = len(slope)
    if r:
        close(q.slope, slope, 1e-9)
        close(q.information, information, 1e-9)
    delta = 0.1 * np.random.default_rng(seed).normal(size=r)
    deviation = adjoint(linear, noise, found, delta, np.zeros((r, r)), layout.last).deviation
    close(deviation, smoothed(delta), 1e-9)


def test_several_records_add_up():
    layout, one, state = system(12, 1)
    _, other, second = system(9, 2)
    state = replace(state, paths=(state.paths[0], second.paths[0]))
    filtered = [run_filter(x, state.chosen, state.levels.noise) for x in linearised(layout, [one, other], state)]
    both, each = quadratic(filtered), [quadratic([x]) for x in filtered]
    assert both.level == pytest.approx(each[0].level + each[1].level, rel=1e-12)
    close(both.slope, each[0].slope + each[1].slope, 1e-12)
    close(both.information, each[0].information + each[1].information, 1e-12)


def test_slopes_of_the_levels_are_those_of_the_marginal_likelihood():
    layout, series, state = system(60)
    levels, linears = state.levels, linearised(layout, [series], state)
    precision = 1.0 / (1.0 + state.theta**2)
    found = marginal(linears, state, levels, precision)
    [adj] = adjoints(linears, state, levels, found, found.delta)
    free, step, differences = levels.free, 1e-4, []
    for i in range(len(free)):
        move = step * (np.arange(len(free)) == i)
        up, down = (marginal(linears, state, levels.moved(free + s * move), precision).value for s in (1.0, -1.0))
        differences.append((up - down) / (2.0 * step))
    np.testing.assert_allclose(levels.slopes(adj), differences, rtol=1e-5, atol=1e-5)


def settled(layout, series, state, rounds=6):
    """The state with its path smoothed at its coefficients, and the model and adjoint there."""
    zero = np.zeros(len(state.theta))
    for _ in range(rounds):
        [linear] = linearised(layout, [series], state)
        found = run_filter(linear, state.chosen, state.levels.noise)
        adj = adjoint(linear, state.levels.noise, found, zero, np.outer(zero, zero), layout.last, True)
        state, before = replace(state, paths=(state.paths[0] + adj.deviation,)), state
    return before, linear, found, adj
