"""Maps: equations that give the next sample, from the linearisation to the command line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayeq.dictionary import Variables, build_dictionary
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State, corrections, linearised, quadratic
from bayeq.likelihood.layout import Candidates, Layout, Series
from bayeq.likelihood.levels import Levels, Scales
from bayeq.states import Roles

from .test_likelihood_filter import close, parts, settled

# --- the model and its linearisation ---------------------------------------------------------------------------------

# Two maps, of x with an earlier sample and of z, that share an input.
LAW = {
    (0, "1"): 0.9,
    (0, "x**2"): -1.2,
    (0, "x[-1]"): 0.3,
    (0, "z"): 0.2,
    (1, "z"): 0.5,
    (1, "x*z"): -0.1,
    (1, "u"): 0.4,
}


def two_maps(n: int = 40) -> tuple[Layout, Series, State]:
    """A layout, samples with gaps of a run of `LAW`, and a fit that stands at its coefficients and states."""
    rng = np.random.default_rng(1)
    variables = Variables(("x", "z"), ("u",), discrete=True)
    terms = build_dictionary("x, x**2, x[-1], z, x*z, u", variables)
    roles = Roles.parse(["x", "z"], inputs=["u"], discrete=True).for_terms(terms)
    layout = Layout(roles, terms, (np.ones(3), np.ones(2)), (0,), (0.0,), (0.0,), ("smooth",))
    u, x, z = rng.standard_normal(n), np.zeros(n), np.zeros(n)
    for k in range(1, n - 1):
        x[k + 1] = 0.9 - 1.2 * x[k] ** 2 + 0.3 * x[k - 1] + 0.2 * z[k]
        z[k + 1] = 0.5 * z[k] - 0.1 * x[k] * z[k] + 0.4 * u[k]
    samples = np.column_stack([x, z, u]) + 0.03 * rng.standard_normal((n, 3))
    samples[rng.random(samples.shape) < 0.1] = np.nan
    path = np.zeros((n, layout.size))
    path[1:, 0], path[:, 1], path[:, 2], path[:, layout.driven[0]] = x[:-1], x, z, u
    path[:-1, layout.slope[0]] = np.diff(u)
    series = Series(np.ones(n - 1), samples, np.zeros((n, 0, 4)), np.ones((n, 3)), np.zeros((n, 1, 2)))
    scales = Scales(path.mean(axis=0), np.maximum(path.var(axis=0), 0.1), np.ones(3), 1.0)
    sizes = np.full(2, 1e-3)
    levels = Levels(layout, scales, np.full(3, 1e-3), sizes, np.full(2, 0.1), np.ones(1), np.ones(1), np.zeros(0))
    texts = [*(term.text for term in terms), "1"]
    chosen = Candidates(np.array([c for c, _ in LAW]), np.array([texts.index(text) for _, text in LAW]))
    return layout, series, State(chosen, np.array(list(LAW.values())), (path,), levels)


def test_earlier_values_move_on_and_a_discrepancy_is_added_once_a_sample() -> None:
    layout, series, state = two_maps()
    assert layout.names[:5] == ("x[-1]", "x", "z", "d[0]", "d[1]")
    assert [name for name, _ in layout.channels] == ["x", "z", "u"]
    [linear] = linearised(layout, [series], state)
    path = state.paths[0]
    np.testing.assert_array_equal(linear.end[:, 0], path[:-1, 1])
    np.testing.assert_allclose(linear.end[1:, 1:3], path[2:, 1:3], atol=1e-12)  # that is how it was made
    np.testing.assert_array_equal(linear.transition[:, 1, layout.discrepancy[0]], 1.0)
    np.testing.assert_array_equal(linear.transition[:, 2, layout.discrepancy[0]], 0.0)


def test_the_transition_and_the_columns_are_those_of_differences() -> None:
    layout, series, state = two_maps()
    [linear] = linearised(layout, [series], state)
    size, step = layout.size, 1e-6

    def end(path, theta):
        return linearised(layout, [series], replace(state, paths=(path,), theta=theta))[0].end

    for i in range(layout.motion + layout.chains):
        move = step * (np.arange(size) == i)
        up, down = (end(state.paths[0] + way * move, state.theta) for way in (1.0, -1.0))
        close(linear.transition[:, : layout.motion, i], (up - down)[:, : layout.motion] / (2.0 * step), 1e-8)
    for j in range(len(state.theta)):
        move = step * (np.arange(len(state.theta)) == j)
        up, down = (end(state.paths[0], state.theta + way * move) for way in (1.0, -1.0))
        close(linear.sources[:, :, j], (up - down)[:, : layout.motion] / (2.0 * step), 1e-8)


def test_scores_of_all_coefficients_are_differences_of_the_model_linearised_again() -> None:
    """Of a map, which is not integrated, the derivative of the determinant too is exact."""
    layout, series, state = two_maps()
    every = layout.everything
    theta = np.zeros(len(every.chain))
    theta[state.chosen.chain * (len(layout.terms) + 1) + state.chosen.term] = state.theta
    state, linear, found, adj = settled(layout, series, replace(state, chosen=every, theta=theta), 30)
    assert np.abs(adj.deviation).max() < 1e-6
    none, differences = every.take(np.arange(0)), []
    for j in range(len(theta)):
        move = 1e-5 * (np.arange(len(theta)) == j)
        up, down = (
            parts(run_filter(linearised(layout, [series], replace(state, theta=theta + s * move))[0], none, noise))
            for s, noise in [(1.0, state.levels.noise), (-1.0, state.levels.noise)]
        )
        differences.append((up - down) / 2e-5)
    scores = np.column_stack([corrections(layout, [linear], [adj]).ravel(), quadratic([found]).slope])
    close(scores[:, 0], np.array(differences)[:, 0], 1e-5)
    close(scores[:, 1], np.array(differences)[:, 1], 1e-5)
