"""The filter of a linearised record, and its adjoint, against the joint Gaussian, differences and simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayeq.dictionary import Variables, build_dictionary
from bayeq.likelihood.adjoint import adjoint
from bayeq.likelihood.blur import Blur
from bayeq.likelihood.determinant import determinant_of
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State, adjoints, bent_by, linearised, log_mean, marginal, maximised, quadratic
from bayeq.likelihood.layout import Candidates, Layout, Series
from bayeq.likelihood.levels import Levels, Scales
from bayeq.likelihood.linear import sources_of
from bayeq.likelihood.model import Task
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


def layout_of(smoothness=3, course="smooth", drift=0.0):
    """Chains of orders 2 and 1, the highest derivative of one measured; a smooth input, and another one; drifts."""
    roles = Roles.parse(chains=["x:v:a", "z"], inputs=["u", "w"])
    terms = build_dictionary("polynomial:2", Variables(roles.states, roles.inputs))
    gains = (np.array([1.0, 2.0, 0.5]), np.ones(2))
    return Layout(roles, terms, gains, (3, smoothness), (0.2, -0.1), (2.0, 1.5), ("smooth", course), drift)


def system(n, seed=0, step=0.1, gaps=0.15, smoothness=3, course="smooth", drift=0.0):
    """A layout, a record whose samples are near a path, and a fit that stands there."""
    layout, rng = layout_of(smoothness, course, drift), np.random.default_rng(seed)
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
    spread = rng.uniform(0.5, 3.0, samples.shape)
    unresolved = rng.exponential(0.01, samples.shape)
    bends = 0.1 * rng.normal(size=(n, 2, 2)) * (course == "cubic")
    series = Series(np.diff(time), samples, np.zeros((n, 0, 4)), spread, bends)
    scales = Scales(0.1 * rng.normal(size=layout.size), rng.uniform(0.5, 2.0, layout.size), np.ones(samples.shape[1]))
    levels = Levels(
        layout,
        scales,
        channels=rng.uniform(0.005, 0.05, samples.shape[1]),
        discrepancy=np.array([0.1, 0.05]),
        memory=np.array([0.8, 0.6]),
        slope=np.array([0.5, 0.2]),
        courses=np.array([0.3, 0.1]),
        drifts=rng.uniform(0.02, 0.2, len(layout.drifts)),
    )
    texts = [term.text for term in layout.terms]
    chosen = Candidates(np.array([c for c, _ in TRUTH]), np.array([texts.index(text) for _, text in TRUTH]))
    blur = Blur(np.zeros((n, 0)), unresolved, np.zeros((n - 1, 2)))
    return layout, series, State(chosen, np.array(list(TRUTH.values())), (path,), levels, (blur,))


def close(actual, wanted, tolerance):
    """Equal up to a share of the largest entry."""
    np.testing.assert_allclose(actual, wanted, rtol=tolerance, atol=tolerance * np.abs(wanted).max())


def some(chosen, seed):
    """The coefficients in a random order."""
    order = np.random.default_rng(seed).permutation(len(chosen.chain))
    return chosen.take(order)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), 2])
@pytest.mark.parametrize("which", ["chosen", "mixed", "every", "none"])
@pytest.mark.parametrize("pulled", [False, True])
def test_is_the_joint_gaussian_of_all_samples(seed, which, pulled):
    layout, series, state = system(12, seed, drift=0.9 * (seed == 2))
    [linear] = linearised(layout, [series], state)
    rng = np.random.default_rng(seed)
    linear = linear._replace(force=rng.exponential(size=linear.force.shape))
    if pulled:
        linear = linear._replace(pull=rng.normal(size=linear.path.shape) * rng.choice(2, linear.path.shape))
    chosen = {
        "chosen": state.chosen,
        "mixed": some(state.chosen, seed),
        "every": layout.everything,
        "none": state.chosen.take(np.arange(0)),
    }[which]
    noise = state.levels.noise
    level, slope, information, smoothed, covariance = reference.state_space_gaussian(linear, chosen, noise)
    found = run_filter(linear, chosen, noise)
    q = quadratic([found])
    assert q.level == pytest.approx(level, rel=1e-10)
    assert q.slope.shape == slope.shape
    assert q.information.shape == information.shape
    r = len(slope)
    if r:
        close(q.slope, slope, 1e-9)
        close(q.information, information, 1e-9)
    if pulled:  # a pull moves no path
        return
    delta = 0.1 * np.random.default_rng(seed).normal(size=r)
    adj = adjoint(linear, noise, found, delta, np.zeros((r, r)), smoothed=True)
    close(adj.deviation, smoothed(delta), 1e-9)
    close(adj.covariance, covariance, 1e-9)


def test_the_likeliest_levels_come_with_their_likelihood():
    layout, series, state = system(80, smoothness=2)
    linears = linearised(layout, [series], state)
    precision = np.ones(len(state.theta))
    levels, found = maximised(linears, state, precision)
    at_levels = marginal(linears, state, levels, precision)
    assert found.value == pytest.approx(at_levels.value, rel=1e-12)
    close(found.delta, at_levels.delta, 1e-9)
    assert found.value > marginal(linears, state, state.levels, precision).value
    # a search that starts there with what was learnt has nothing to do
    _, same = maximised(linears, replace(state, levels=levels), precision)
    assert same.value - found.value < 0.05


@pytest.mark.parametrize("needed", [0.0, 1e-3, 0.05, 0.6])
@pytest.mark.parametrize("rows", [30, 3000])
def test_the_average_over_sizes_looks_no_further_than_it_must(needed, rows):
    low, high, noise, asked = np.log(1e-4), np.log(3.2), 0.02, []

    def log_of(size):  # of independent samples with some variance, of which noise is a part
        asked.append(size)
        variance = noise**2 + np.exp(2.0 * size)
        return -0.5 * rows * (np.log(variance) + (noise**2 + needed**2) / variance)

    sizes = np.linspace(low, high, 20_001)
    peak = sizes[np.argmax([log_of(size) for size in sizes])]
    logs = np.array([log_of(size) for size in sizes])
    mean = float(np.logaddexp.reduce(logs) - np.log(len(sizes)))
    asked.clear()
    found, likeliest = log_mean(log_of, low, high, peak)
    assert len(asked) <= (16 if needed > noise else 7)
    assert found == pytest.approx(mean, abs=0.6)
    assert log_of(likeliest) >= logs.max() - 1e-6


def test_where_a_fit_has_stood_it_is_not_linearised_again():
    layout, series, state = system(20)
    width = layout.chains * (len(layout.terms) + 1)
    task = Task(layout, (series,), np.ones(width), np.zeros(width))
    one = task.linearised(state)
    assert task.linearised(replace(state, levels=state.levels.moved(state.levels.free + 0.1))) is one
    twice = replace(task, substeps=2)
    assert not np.array_equal(twice.linearised(state)[0].end, one[0].end)
    assert task.linearised(state) is one
    other = task.linearised(replace(state, theta=1.1 * state.theta))
    [slow] = linearised(layout, [series], replace(state, theta=1.1 * state.theta))
    np.testing.assert_array_equal(other[0].end, slow.end)
    assert len(task.recent) == 2


def test_several_records_add_up():
    layout, one, state = system(12, 1)
    _, other, second = system(9, 2)
    state = replace(state, paths=(state.paths[0], second.paths[0]), blurs=state.blurs + second.blurs)
    filtered = [run_filter(x, state.chosen, state.levels.noise) for x in linearised(layout, [one, other], state)]
    both, each = quadratic(filtered), [quadratic([x]) for x in filtered]
    assert both.level == pytest.approx(each[0].level + each[1].level, rel=1e-12)
    close(both.slope, each[0].slope + each[1].slope, 1e-12)
    close(both.information, each[0].information + each[1].information, 1e-12)


def test_long_records_are_filtered_in_parts(monkeypatch):
    layout, series, state = system(47)
    [linear] = linearised(layout, [series], state)
    noise, r = state.levels.noise, len(state.theta)
    root = 0.1 * np.random.default_rng(4).normal(size=(r, r))

    def results():
        found = run_filter(linear, state.chosen, noise)
        return [*found, *adjoint(linear, noise, found, root[0], root @ root.T, True, True)]

    whole = results()
    monkeypatch.setattr("bayeq.likelihood.filter.TOGETHER", 200)
    for one, other in zip(results(), whole, strict=True):
        close(one, other, 1e-10)


def test_the_path_and_the_directions_need_no_columns():
    layout, series, state = system(30)
    [linear] = linearised(layout, [series], state)
    noise, r = state.levels.noise, len(state.theta)
    found = run_filter(linear, state.chosen, noise)
    delta = 0.1 * np.random.default_rng(5).normal(size=r)
    whole, lean = (
        adjoint(linear, noise, found, delta, np.eye(r), True, True),
        adjoint(linear, noise, found, delta, None, True, True),
    )
    for one, other in zip(lean[5:], whole[5:], strict=True):
        close(one, other, 1e-10)
    assert not any(part.any() for part in lean[:5])


def test_sums_need_no_rows():
    layout, series, state = system(30)
    [linear] = linearised(layout, [series], state)
    found, lean = (run_filter(linear, layout.everything, state.levels.noise, keep=keep) for keep in (True, False))
    assert max(part.size for part in lean[:5]) == 0
    assert lean.log_variance == found.log_variance
    np.testing.assert_array_equal(lean.product, found.product)


def test_coefficients_of_no_uncertainty_leave_their_columns_out():
    layout, series, state = system(20)
    [linear] = linearised(layout, [series], state)
    noise, r = state.levels.noise, len(state.theta)
    found = run_filter(linear, state.chosen, noise)
    V = np.zeros((r, r))
    V[1, 1] = 0.04
    one = state.chosen.take(np.array([1]))
    alone = adjoint(linear, noise, run_filter(linear, one, noise), np.zeros(1), V[1:2, 1:2])
    for part, other in zip(adjoint(linear, noise, found, np.zeros(r), V), alone, strict=True):
        if other.size:
            close(part, other, 1e-10)


@pytest.mark.parametrize("drift", [0.0, 0.9])
def test_slopes_of_the_levels_are_those_of_the_marginal_likelihood(drift):
    layout, series, state = system(60, drift=drift)
    levels, linears = state.levels, linearised(layout, [series], state)
    precision = 1.0 / (1.0 + state.theta**2)
    found = marginal(linears, state, levels, precision)
    [adj] = adjoints(linears, levels, found, found.delta, found.covariance)
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
        adj = adjoint(linear, state.levels.noise, found, zero, np.outer(zero, zero), True)
        state, before = replace(state, paths=(state.paths[0] + adj.deviation,)), state
    return before, linear, found, adj


def parts(found):
    """What the determinant and the quadratic form add to the log likelihood, up to a constant."""
    used = found.variance > 0.0
    S, E = found.variance[used], found.innovation[used][:, 0]
    return -0.5 * np.array([np.log(S).sum(), (E**2 / S).sum()])


def errors_of_the_score(step, drift):
    """Of the determinant's and the quadratic form's derivatives by all coefficients, as shares of the largest."""
    layout, series, state = system(40, 3, step, drift=drift)
    # what courses err by scales with their coefficients as with its own size, which is learned
    state = replace(state, levels=replace(state.levels, courses=np.full(2, 1e-12)))
    every = layout.everything
    theta = np.zeros(len(every.chain))
    theta[state.chosen.chain * (len(layout.terms) + 1) + state.chosen.term] = state.theta
    state, linear, found, adj = settled(layout, series, replace(state, chosen=every, theta=theta))
    assert np.abs(adj.deviation).max() < 1e-6
    none, differences = every.take(np.arange(0)), []
    for j in range(len(theta)):
        move = 1e-4 * (np.arange(len(theta)) == j)
        up, down = (
            parts(run_filter(linearised(layout, [series], replace(state, theta=theta + s * move))[0], none, noise))
            for s, noise in [(1.0, state.levels.noise), (-1.0, state.levels.noise)]
        )
        differences.append((up - down) / 2e-4)
    scores = np.column_stack([determinant_of(layout, [linear], [adj]).slopes.ravel(), quadratic([found]).slope])
    return np.abs(scores - differences).max(axis=0) / np.abs(differences).max(axis=0)


@pytest.mark.parametrize("drift", [0.0, 0.9])
def test_the_score_of_all_coefficients_converges_to_differences_of_the_model_linearised_again(drift):
    coarse, fine = errors_of_the_score(0.05, drift), errors_of_the_score(0.0125, drift)
    # the determinant's gradient is taken in the middle of steps, the quadratic form's is exact
    assert coarse[0] < 0.03
    assert fine[0] < min(1e-3, coarse[0] / 4.0)
    assert max(coarse[1], fine[1]) < 1e-7


def shifted(layout, series, state, direction):
    """Steps and predictions a little to both sides of a path, as central differences along a direction."""
    ends, seen = [], []
    for sign in (1.0, -1.0):
        path = state.paths[0] + sign * 1e-5 * direction
        zero = series._replace(samples=np.zeros_like(series.samples))
        [linear] = linearised(layout, [zero], replace(state, paths=(path,)))
        ends.append(linear.end)
        seen.append(-linear.residual)
    return (ends[0] - ends[1]) / 2e-5, (seen[0] - seen[1]) / 2e-5


@pytest.mark.parametrize(
    ("smoothness", "course", "drift"),
    [
        (0, "linear", 0.0),
        (0, "cubic", 0.0),
        (1, "smooth", 0.9),
        (3, "smooth", 0.0),
        (3, "linear", 0.0),
        (2, "hold", 0.9),
    ],
)
def test_a_linearisation_has_the_derivatives_of_its_steps_and_predictions(smoothness, course, drift):
    layout, series, state = system(15, smoothness=smoothness, course=course, drift=drift)
    [linear] = linearised(layout, [series], state)
    np.testing.assert_array_equal(np.isnan(linear.residual), np.isnan(series.samples))
    for i in range(layout.size):
        unit = np.eye(layout.size)[i]
        by_end, by_seen = shifted(layout, series, state, unit)
        np.testing.assert_allclose(linear.transition[:, :, i], by_end, atol=1e-8)
        for channel, kind in enumerate(linear.kinds):
            wanted = linear.gradient[:, -1 - kind, i] if kind < 0 else np.full(15, unit[kind])
            np.testing.assert_allclose(by_seen[:, channel], wanted, atol=1e-8)


@pytest.mark.parametrize(("smoothness", "substeps"), [(0, 1), (1, 2), (3, 1)])
def test_sources_are_the_derivatives_of_steps_by_coefficients(smoothness, substeps):
    layout, series, state = system(15, 5, smoothness=smoothness)
    every = layout.everything
    theta = np.zeros(len(every.chain))
    theta[state.chosen.chain * (len(layout.terms) + 1) + state.chosen.term] = state.theta
    state = replace(state, chosen=every, theta=theta)
    [linear] = linearised(layout, [series], state, substeps)
    for j in range(len(theta)):
        move = 1e-4 * (np.arange(len(theta)) == j)
        up, down = (
            linearised(layout, [series], replace(state, theta=theta + s * move), substeps)[0].end for s in (1.0, -1.0)
        )
        change = (up - down) / 2e-4
        np.testing.assert_allclose(linear.sources[:, :, j], change[:, : layout.motion], atol=1e-7)
        assert not change[:, layout.motion :].any()
    # of other coefficients, and of some steps
    few = every.take(np.array([3, 11]))
    np.testing.assert_allclose(
        sources_of(linear, few, 2, 9), linear.sources[2:9][:, :, [3, 11]], rtol=1e-12, atol=1e-15
    )


def drawn(linear, chosen, noise, delta, rng):
    """The same model with samples that it drew at some deviations of the coefficients; NaN where there was none."""
    n, size = linear.path.shape
    sources = np.zeros((n, size))
    own = np.zeros((n, linear.gradient.shape[1]))
    sources[1:, : linear.steps.motion] = sources_of(linear, chosen, 0, n - 1) @ delta
    for c, t, change in zip(chosen.chain, chosen.term, delta, strict=True):
        own[:, c] += change * linear.terms[:, t]
    e = np.empty((n, size))
    e[0] = noise.mean - linear.path[0] + np.sqrt(noise.start) * rng.normal(size=size)
    for k in range(n - 1):
        push = linear.transition[k][:, linear.discrepancy] * (np.arange(size) < linear.steps.motion)[:, None]
        sources[k + 1] += push @ (np.sqrt(reference.force_of(linear, noise)[k]) * rng.normal(size=2))
        ahead = linear.end[k] + linear.transition[k] @ e[k] + sources[k + 1]
        e[k + 1] = noise.memory * ahead - linear.path[k + 1] + np.sqrt(noise.steps) * rng.normal(size=size)
    samples = np.sqrt(noise.channels * linear.spread + linear.unresolved) * rng.normal(size=linear.residual.shape)
    for channel, kind in enumerate(linear.kinds):
        c = -1 - kind
        samples[:, channel] += e[:, kind] if kind >= 0 else np.einsum("ki,ki->k", linear.gradient[:, c], e) + own[:, c]
    return linear._replace(residual=np.where(np.isnan(linear.residual), np.nan, samples))


def centred(scores):
    """Whether means of scores (draws, k) are zero within 4 standard errors."""
    error = scores.std(axis=0, ddof=1) / np.sqrt(len(scores))
    return (np.abs(scores.mean(axis=0)) < 4.0 * error).all()


@pytest.mark.statistical(short=100, full=200)
def test_scores_at_the_truth_are_those_of_draws_from_the_linear_model(number):
    layout, series, state = system(50)
    [linear] = linearised(layout, [series], state)
    linear = linear._replace(force=np.random.default_rng(6).exponential(0.3, linear.force.shape))
    noise, r, rng = state.levels.noise, len(state.theta), np.random.default_rng(7)
    delta = 0.1 * rng.normal(size=r)
    slopes, scores = [], []
    for _ in range(number):
        one = drawn(linear, state.chosen, noise, delta, rng)
        found = run_filter(one, state.chosen, noise)
        q = quadratic([found])
        scores.append(q.slope - q.information @ delta)
        slopes.append(state.levels.slopes(adjoint(one, noise, found, delta, np.zeros((r, r)))))
    assert centred(np.array(scores))
    assert centred(np.array(slopes))
    distance = sum(s @ np.linalg.solve(q.information, s) for s in scores)  # the information is that of every draw
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], number * r)
    assert low < distance < high


def solutions(layout, series, state, draws, rng):
    """States and samples of draws from the model itself, (draws, n, S) and (draws, n, M)."""
    noise, n = state.levels.noise, len(series.samples)
    paths, samples = np.empty((draws + 1, n, layout.size)), np.empty((draws + 1, n, len(layout.channels)))
    at = noise.mean + np.sqrt(noise.start) * rng.normal(size=(draws + 1, layout.size))
    for k in range(n):
        paths[:, k] = at
        step = series.intervals[min(k, n - 2)]
        zeros = np.zeros((draws + 1, samples.shape[2]))
        rows = Series(
            np.full(draws, step), zeros, series.inputs[[k] * (draws + 1)], 1.0 + zeros, series.bends[[k] * (draws + 1)]
        )
        [linear] = linearised(layout, [rows], replace(state, paths=(at,), blurs=()))
        sd = np.sqrt(noise.channels * series.spread[k] + state.blurs[0].unresolved[k])
        samples[:, k] = -linear.residual + sd * rng.normal(size=samples[:, k].shape)
        at = np.zeros_like(at)
        at[:draws] = noise.memory * linear.end + np.sqrt(noise.steps) * rng.normal(size=linear.end.shape)
    return paths[:draws], np.where(np.isnan(series.samples), np.nan, samples[:draws])


def from_model(seed, n=40, step=0.0125):
    """A layout, a record drawn from the model, and the state on the path that its coefficients make likeliest."""
    layout, series, state = system(n, 3, step)
    state = replace(state, levels=replace(state.levels, courses=np.full(2, 1e-12)))
    paths, samples = solutions(layout, series, state, 1, np.random.default_rng(seed))
    series = series._replace(samples=samples[0])
    return layout, series, settled(layout, series, replace(state, paths=(paths[0],)), 20)[0]


@pytest.mark.parametrize("seed", [8, 9])
def test_the_slope_of_the_log_determinant_counts_that_the_path_moves(seed):
    layout, series, state = from_model(seed)
    none, differences, theta = layout.everything.take(np.arange(0)), [], state.theta
    for j in range(len(theta)):
        move = 1e-4 * (np.arange(len(theta)) == j)
        up, down = (
            parts(run_filter(settled(layout, series, replace(state, theta=one), 20)[1], none, state.levels.noise))[0]
            for one in (theta + move, theta - move)
        )
        differences.append((up - down) / 2e-4)
    state, linear, found, adj = settled(layout, series, state, 1)
    bend, bent = bent_by(layout, [linear], state, [adj], [found])
    close(bent, np.array(differences), 5e-3)
    on_a_fixed_path = bend.slopes[state.chosen.chain, state.chosen.term]
    assert np.abs(on_a_fixed_path - differences).max() > 0.3 * np.abs(differences).max()


def test_a_linear_law_pulls_at_no_path():
    layout, series, state = system(40)
    linear_terms = np.flatnonzero([layout.terms[j].text.isidentifier() for j in state.chosen.term])
    state = replace(state, chosen=state.chosen.take(linear_terms), theta=state.theta[linear_terms])
    state, linear, found, adj = settled(layout, series, state, 1)
    bend, bent = bent_by(layout, [linear], state, [adj], [found])
    assert [len(pull) for pull in bend.pulls] == [0]
    assert np.array_equal(bent, bend.slopes[state.chosen.chain, state.chosen.term])


@pytest.mark.statistical(short=70, full=200)
def test_scores_at_the_truth_are_those_of_draws_from_the_model_itself(number):
    layout, series, state = system(50, step=0.05)
    start = np.where(np.isin(np.arange(layout.size), layout.discrepancy), 1.0, 1e-4)
    scales = replace(state.levels.scales, variance=start)
    state = replace(state, levels=replace(state.levels, scales=scales, courses=np.full(2, 1e-12)))
    scores, informations, without = [], [], []
    for path, samples in zip(*solutions(layout, series, state, number, np.random.default_rng(8)), strict=True):
        one = series._replace(samples=samples)
        here, linear, found, adj = settled(layout, one, replace(state, paths=(path,)), 4)
        q = quadratic([found])
        scores.append(q.slope + bent_by(layout, [linear], here, [adj])[1])
        without.append(q.slope)
        informations.append(q.information)
    assert centred(np.array(scores))
    assert not centred(np.array(without))
    # the information of a short record varies with its path: it is the variance of the scores on average
    scaled = np.linalg.solve(np.linalg.cholesky(np.mean(informations, axis=0)), np.array(scores).T)
    assert centred((scaled**2).sum(axis=0)[:, None] - len(state.theta))
