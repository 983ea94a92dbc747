"""The kinematic smoother against a dense Gaussian process, a textbook recursion, and theorems."""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.errors import InputError
from bayeq.states.kinematic.fit import _Likelihood, _pieces, _stretches, fit_kinematic
from bayeq.states.kinematic.smoother import (
    ChainSeries,
    KinematicModel,
    filtered,
    leave_one_out,
    one_sided,
    prepare,
    sizes_of,
    smooth_kinematic,
)
from tests.draws import draws


def log_likelihood(series, model):
    """Log density of the samples of some records."""
    return sum(filtered(s, model)[1].log_likelihood for s in series)


def covariances(smoothed):
    """Of the states in every row, (n, m, m)."""
    return smoothed.covariances[smoothed.entry]


def transition(h, m):
    return [[h ** (j - i) / math.factorial(j - i) if j >= i else 0 * h for j in range(m)] for i in range(m)]


def driven(h, m, Q):
    """Covariance that white noise of spectral density Q in the m-th derivative adds over h."""
    f = math.factorial
    return [
        [Q * h ** (2 * m - 1 - i - j) / ((2 * m - 1 - i - j) * f(m - 1 - i) * f(m - 1 - j)) for j in range(m)]
        for i in range(m)
    ]


def centre_of(series):
    q = series.channels[0]
    return float(np.mean(q[np.isfinite(q)])) if q is not None and np.isfinite(q).any() else 0.0


def dense(series, model):
    """Mean (n, m), covariances (n, m, m) and log density from the joint Gaussian of all states and samples.

    With 50 digits: the joint covariance is far from well-conditioned.
    """
    n, m = series.n, model.order
    with mpmath.workdps(50):
        t = [mpmath.mpf(float(v)) for v in series.times - series.times[0]]
        start = mpmath.diag([mpmath.mpf(s) ** 2 for s in model.initial_sd])
        Q = mpmath.mpf(model.spectral_density)
        C = mpmath.matrix(n * m, n * m)
        for a in range(n):
            F = mpmath.matrix(transition(t[a], m))
            own = F * start * F.T + mpmath.matrix(driven(t[a], m, Q))
            for b in range(a, n):
                block = mpmath.matrix(transition(t[b] - t[a], m)) * own
                for i in range(m):
                    for j in range(m):
                        C[b * m + i, a * m + j] = C[a * m + j, b * m + i] = block[i, j]
        found = [
            (a * m + k, channel[a] - (centre_of(series) if k == 0 else 0.0), model.noise_sd[k])
            for a in range(n)
            for k, channel in enumerate(series.channels)
            if channel is not None and np.isfinite(channel[a])
        ]
        states = [s for s, _, _ in found]
        S = mpmath.matrix(len(found), len(found))
        for p, (s, _, sd) in enumerate(found):
            for q, other in enumerate(states):
                S[p, q] = C[s, other] + (mpmath.mpf(sd) ** 2 if p == q else 0)
        lower = mpmath.cholesky(S)
        y = mpmath.matrix([v for _, v, _ in found])
        white = mpmath.lu_solve(lower, y)
        log_density = -sum(w**2 for w in white) / 2 - sum(
            mpmath.log(lower[p, p]) + mpmath.log(2 * mpmath.pi) / 2 for p in range(len(found))
        )
        inverse = S**-1
        mean, covariance = np.empty((n, m)), np.empty((n, m, m))
        for a in range(n):
            cross = mpmath.matrix([[C[a * m + i, s] for s in states] for i in range(m)])
            posterior = C[a * m : (a + 1) * m, a * m : (a + 1) * m] - cross * inverse * cross.T
            estimate = cross * inverse * y
            mean[a] = [float(v) for v in estimate]
            covariance[a] = [[float(posterior[i, j]) for j in range(m)] for i in range(m)]
    mean[:, 0] += centre_of(series)
    return mean, covariance, float(log_density)


def textbook(series, model):
    """Kalman filter and Rauch-Tung-Striebel smoother as in the books, every row computed."""
    n, m = series.n, model.order
    x, P = np.zeros(m), np.diag(np.square(model.initial_sd))
    means, filtered, predicted, covariances, F = [], [], [], [], np.eye(m)
    for a in range(n):
        if a:
            h = series.times[a] - series.times[a - 1]
            F = np.array(transition(h, m))
            x, P = F @ x, F @ P @ F.T + np.array(driven(h, m, model.spectral_density))
        predicted.append((F, x, P))
        for k, channel in enumerate(series.channels):
            if channel is not None and np.isfinite(channel[a]):
                R = model.noise_sd[k] ** 2
                gain = P[:, k] / (P[k, k] + R)
                x = x + gain * (channel[a] - (centre_of(series) if k == 0 else 0.0) - x[k])
                A = np.eye(m) - np.outer(gain, np.eye(m)[k])
                P = A @ P @ A.T + R * np.outer(gain, gain)
        filtered.append((x, P))
    for a in range(n - 1, -1, -1):
        if a < n - 1:
            F, ahead, P_ahead = predicted[a + 1]
            J = np.linalg.solve(P_ahead, F @ filtered[a][1]).T
            x = filtered[a][0] + J @ (x - ahead)
            P = filtered[a][1] + J @ (P - P_ahead) @ J.T
        means.append(x)
        covariances.append(P)
    mean = np.array(means[::-1])
    mean[:, 0] += centre_of(series)
    return mean, np.array(covariances[::-1])


def drawn(model, times, seed, channels=None):
    """A record drawn from the model, and its states; the first state is N(0, 1) each."""
    rng = np.random.default_rng(seed)
    n, m = len(times), model.order
    states = np.empty((n, m))
    states[0] = rng.normal(size=m)
    roots = {}
    for a in range(1, n):
        h = round(times[a] - times[a - 1], 9)
        if h not in roots:
            roots[h] = np.array(transition(h, m)), np.linalg.cholesky(driven(h, m, model.spectral_density))
        F, root = roots[h]
        states[a] = F @ states[a - 1] + root @ rng.normal(size=m)
    samples = [None if sd is None else states[:, k] + sd * rng.normal(size=n) for k, sd in enumerate(model.noise_sd)]
    return ChainSeries(np.asarray(times), tuple(samples)), states


def agree(smoothed, mean, covariance, tolerance):
    """Means to a share of their standard deviations, covariances to one of their variances."""
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.max(np.abs(smoothed.mean - mean) / sd) < tolerance
    got = covariances(smoothed)
    assert np.max(np.abs(got - covariance) / (sd[:, :, None] * sd[:, None, :])) < tolerance
    np.testing.assert_allclose(smoothed.sd, sd, rtol=tolerance)


SUBSETS = [
    (0.1, 0.2, 0.5),
    (0.1, None, None),
    (None, 0.2, None),
    (None, None, 0.5),
    (0.1, None, 0.5),
    (0.1, 0.2),
    (0.1, None),
    (0.1,),
]


@pytest.mark.parametrize("noise_sd", SUBSETS)
@pytest.mark.parametrize("extra", [1, 3])
def test_equals_a_dense_gaussian_process(noise_sd, extra):
    m = len(noise_sd) - 1 + extra
    model = KinematicModel(m, 2.0, noise_sd)
    rng = np.random.default_rng(m)
    times = np.cumsum([0.3, 0.5, 0.5, 0.5, 1.7, 0.5, 0.01, 0.5])
    series, _ = drawn(model, times, 1)
    for channel in series.channels:
        if channel is not None:
            channel[rng.integers(len(times), size=2)] = np.nan
    diffuse = sizes_of([series], least=noise_sd).initial_sd(m)
    for initial in (tuple(diffuse), tuple(diffuse / 1e3)):
        model = replace(model, initial_sd=initial)
        mean, covariance, log_density = dense(series, model)
        agree(smooth_kinematic(series, model), mean, covariance, 1e-6)
        assert log_likelihood([series], model) == pytest.approx(log_density, rel=1e-9, abs=1e-9)
    # without a given start it is diffuse
    again = smooth_kinematic(series, replace(model, initial_sd=None))
    np.testing.assert_array_equal(
        again.mean, smooth_kinematic(series, replace(model, initial_sd=tuple(map(float, diffuse)))).mean
    )


@settings(max_examples=draws(25), deadline=None)
@given(data=st.data())
def test_any_pattern_of_samples_equals_a_dense_gaussian_process(data):
    noise_sd = data.draw(st.sampled_from(SUBSETS))
    m = len(noise_sd) - 1 + data.draw(st.integers(1, 4))
    steps = data.draw(st.lists(st.sampled_from([1.0, 1.0, 1.0, 0.1, 5.0]), min_size=1, max_size=5))
    n = len(steps) + 1
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    masks = data.draw(st.lists(st.lists(st.booleans(), min_size=n, max_size=n), min_size=3, max_size=3))
    channels = tuple(
        None if sd is None else np.where(mask, rng.normal(size=n), np.nan)
        for sd, mask in zip(noise_sd, masks, strict=False)
    )
    assume(any(np.isfinite(c).any() for c in channels if c is not None))
    series = ChainSeries(np.cumsum([0.0, *steps]), channels)
    model = KinematicModel(m, 0.3, noise_sd, initial_sd=(10.0,) * m)
    mean, covariance, log_density = dense(series, model)
    agree(smooth_kinematic(series, model), mean, covariance, 1e-6)
    assert log_likelihood([series], model) == pytest.approx(log_density, rel=1e-9, abs=1e-9)


def gappy(kind):
    """900 rows: regular, with two gaps in time, with samples missing, or at times of their own."""
    times = np.arange(900) * 0.1
    if kind == "gaps":
        times[300:] += 3.73
        times[600:] += 0.05
    if kind == "irregular":
        times += np.random.default_rng(0).uniform(-0.02, 0.02, size=900)
    model = KinematicModel(3, 1000.0, (0.1, 0.2, 0.4), initial_sd=(30.0,) * 3)
    series, states = drawn(model, times, 3)
    if kind == "missing":
        for channel, rows in zip(series.channels, ([200], range(400, 420), [410, 700, 701]), strict=True):
            channel[list(rows)] = np.nan
    return series, states, model


@pytest.mark.parametrize("kind", ["uniform", "gaps", "missing", "irregular"])
def test_settled_gains_equal_the_full_recursion(kind):
    series, _, model = gappy(kind)
    smoothed = smooth_kinematic(series, model)
    # q reaches 1e7 of its standard deviations, which leaves 1e-8 of the digits
    agree(smoothed, *textbook(series, model), 1e-7)
    # in few rows is a covariance of their own needed, unless no row is regular
    assert len(smoothed.covariances) == 900 if kind == "irregular" else len(smoothed.covariances) < 600
    if kind == "uniform":
        assert len(np.unique(smoothed.entry[150:750])) == 1


@pytest.mark.parametrize("kind", ["uniform", "gaps", "missing", "irregular"])
@pytest.mark.parametrize("order", [3, 6])
def test_score_is_the_gradient_and_the_settled_one_too(kind, order):
    series, _, _ = gappy(kind)
    sizes = sizes_of([series])
    likelihood = _Likelihood([prepare(series, sizes.initial_sd(order))], sizes, order, np.full(3, np.nan))
    at = np.array([-4.0, -5.0, -3.0, -2.0])
    _, gradient, _ = likelihood.scored(at)
    for j, step in enumerate(1e-4 * np.eye(4)):
        slope = (likelihood.value(at + step) - likelihood.value(at - step)) / 2e-4
        assert gradient[j] == pytest.approx(slope, rel=1e-5, abs=1e-3)


def test_leave_one_out_density_is_what_it_says():
    model = KinematicModel(3, 2.0, (0.1, 0.2, None), initial_sd=(20.0,) * 3)
    series, _ = drawn(model, np.cumsum([0.5, 0.5, 0.5, 0.8, 0.5, 0.5, 0.5, 0.5]), 2)
    fitted = fit_kinematic([series], order=3, noise_sd=model.noise_sd)
    total = 0.0
    for k in (0, 1):
        for row in range(series.n):
            channels = [None if c is None else c.copy() for c in series.channels]
            sample, channels[k][row] = channels[k][row], np.nan
            # the start of q is centred where the whole channel is, so that leaving one out does not move it
            shift = centre_of(series)
            channels[0] -= shift
            anchor = ChainSeries(series.times, tuple(channels))
            moved = smooth_kinematic(anchor, replace(fitted, initial_sd=tuple(1e3 * np.array(fitted.initial_sd))))
            error = sample - (shift if k == 0 else 0.0) - moved.mean[row, k]
            variance = covariances(moved)[row, k, k] + model.noise_sd[k] ** 2
            total -= 0.5 * (math.log(2 * math.pi * variance) + error**2 / variance)
    assert fitted.left_out == pytest.approx(total, rel=1e-4)


def test_errors_of_samples_that_are_left_out_are_those_without_them():
    model = KinematicModel(4, 2.0, (0.1, 0.2, 0.3), initial_sd=(20.0,) * 4)
    series, _ = drawn(model, np.cumsum([0.5] * 30 + [0.8] + [0.5] * 30), 3)
    channels = [c - (centre_of(series) if k == 0 else 0.0) for k, c in enumerate(series.channels)]
    channels[1][7] = np.nan
    whole = ChainSeries(series.times, tuple(channels))
    errors = leave_one_out(whole, model)
    assert np.isnan(errors[7, 1]).all()
    for k in range(3):
        for row in range(0, whole.n, 6):
            one = [c.copy() for c in channels]
            one[k][row] = np.nan
            without = smooth_kinematic(ChainSeries(whole.times, tuple(one)), model)
            # the mean of q moves by what is missing, and the vague start with it
            assert errors[row, k, 0] == pytest.approx(channels[k][row] - without.mean[row, k], rel=2e-3, abs=1e-3)
            spread = math.hypot(without.sd[row, k], model.noise_sd[k])
            assert errors[row, k, 1] == pytest.approx(spread, rel=1e-4)


def test_one_sided_states_are_those_of_the_samples_on_that_side():
    model = KinematicModel(3, 2.0, (0.1, 0.2, None), initial_sd=(1e3,) * 3)
    series, _ = drawn(model, np.cumsum([0.5] * 40), 4)
    before, after = one_sided(series, model)
    for row in (10, 20, 30):
        left = smooth_kinematic(series.take(slice(0, row + 1)), model).mean[-1]
        right = smooth_kinematic(series.take(slice(row, series.n)), model).mean[0]
        np.testing.assert_allclose(before[row], left, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(after[row], right, rtol=1e-3, atol=1e-3)


def test_records_add_up():
    model = KinematicModel(3, 1.0, (0.2, 0.1, None), initial_sd=(10.0,) * 3)
    records = [drawn(model, np.arange(n) * h, n)[0] for n, h in ((300, 0.1), (200, 0.15), (2, 1.0))]
    each = [log_likelihood([record], model) for record in records]
    assert log_likelihood(records, model) == pytest.approx(sum(each), rel=1e-12)
    together = fit_kinematic(records, order=3)
    assert together.log_likelihood == pytest.approx(log_likelihood(records, together), rel=1e-12)
    # the joint maximum is no better for a record than its own
    for record in records[:2]:
        own = fit_kinematic([record], order=3)
        joint = replace(together, initial_sd=own.initial_sd)
        assert log_likelihood([record], joint) < own.log_likelihood


def log_parameters(model):
    return np.log([sd**2 for sd in model.noise_sd if sd is not None] + [model.spectral_density])


def from_logs(model, logs):
    values = iter(np.exp(logs[:-1]))
    sd = tuple(None if s is None else math.sqrt(next(values)) for s in model.noise_sd)
    return replace(model, noise_sd=sd, spectral_density=math.exp(logs[-1]))


@pytest.mark.parametrize("noise_sd", [(0.3, 0.2, 0.4), (0.3, None, None), (None, 0.2, None), (0.3, 0.2)])
def test_parameters_are_recovered_within_their_standard_errors(noise_sd):
    m = len(noise_sd) + 1
    truth = KinematicModel(m, 1000.0, noise_sd)
    series, _ = drawn(truth, np.arange(3000) * 0.01, 5)
    fitted = fit_kinematic([series], order=m)
    at, step = log_parameters(fitted), 0.02

    def value(logs):
        return log_likelihood([series], from_logs(fitted, logs))

    # the maximum is one: value() is concave there, with a gradient of nearly nothing
    E = step * np.eye(len(at))
    hessian = np.array(
        [[(value(at + a + b) - value(at + a - b) - value(at - a + b) + value(at - a - b)) / 4 for b in E] for a in E]
    )
    covariance = np.linalg.inv(-hessian / step**2)
    assert np.linalg.eigvalsh(covariance).min() > 0
    gradient = np.array([(value(at + a) - value(at - a)) / (2 * step) for a in E])
    assert gradient @ covariance @ gradient < 1e-2
    assert np.all(np.abs(at - log_parameters(truth)) < 3 * np.sqrt(np.diagonal(covariance)))


def test_a_channel_without_a_sample_in_a_record_is_one_that_is_not_measured():
    model = KinematicModel(3, 1000.0, (0.1, 0.2, 0.4), initial_sd=(30.0,) * 3)
    series, _ = drawn(model, np.arange(300) * 0.1, 3)
    x, v, a = series.channels
    for without in ((x, None, a), (None, v, a)):
        empty = tuple(np.full(300, np.nan) if channel is None else channel for channel in without)
        missing, absent = ChainSeries(series.times, empty), ChainSeries(series.times, without)
        np.testing.assert_array_equal(smooth_kinematic(missing, model).mean, smooth_kinematic(absent, model).mean)
        # and the other records tell its noise
        together = fit_kinematic([series, missing], order=3)
        np.testing.assert_allclose(together.noise_sd, fit_kinematic([series, absent], order=3).noise_sd, rtol=1e-9)


def test_given_values_are_kept():
    series, _ = drawn(KinematicModel(3, 0.5, (0.3, 0.2, None)), np.arange(500) * 0.3, 6)
    fitted = fit_kinematic([series], order=3, noise_sd=(None, 0.25, None))
    assert fitted.noise_sd[1:] == (0.25, None)
    assert fitted.noise_sd[0] == pytest.approx(0.3, rel=0.2)
    everything = fit_kinematic([series], order=3, noise_sd=(0.3, 0.25, None))
    assert everything.log_likelihood < fitted.log_likelihood


def test_errors_have_the_stated_covariance():
    model = KinematicModel(4, 1000.0, (0.3, None, 0.4), initial_sd=(1e4,) * 4)
    times, draws = np.arange(40) * 0.01, 400
    for row in (0, 20):
        distances = []
        for seed in range(draws):
            series, states = drawn(model, times, seed)
            smoothed = smooth_kinematic(series, model)
            error = smoothed.mean[row] - states[row]
            distances.append(error @ np.linalg.solve(covariances(smoothed)[row], error))
        # chi-square with 4 degrees of freedom
        assert abs(np.mean(distances) - 4) < 4 * math.sqrt(8 / draws)


def test_innovations_are_white():
    series, _ = drawn(KinematicModel(4, 1000.0, (0.3, None, 0.4)), np.arange(4000) * 0.01, 7)
    _, given = filtered(series, fit_kinematic([series], order=4))
    innovations = given.tables.innovations * np.sqrt(given.tables.inverse)[given.tables.entry]
    for k in (0, 1):
        e = innovations[50:, k]
        assert np.mean(e**2) == pytest.approx(1, abs=4 * math.sqrt(2 / len(e)))
        assert abs(np.mean(e[1:] * e[:-1])) < 4 / math.sqrt(len(e))
    assert abs(np.mean(innovations[50:, 0] * innovations[50:, 1])) < 4 / math.sqrt(len(innovations))


def test_smoothed_derivatives_are_derivatives():
    model = KinematicModel(4, 500.0, (0.3, 0.2, 0.4), initial_sd=(30.0,) * 4)
    series, _ = drawn(model, np.arange(300) * 0.02, 3)
    delta = 1e-4
    times = np.sort(np.concatenate([series.times[1:-1] - delta, series.times, series.times[1:-1] + delta]))
    rows = np.searchsorted(times, series.times)
    channels = []
    for channel in series.channels:
        between = np.full(len(times), np.nan)
        between[rows] = channel
        channels.append(between)
    fine = smooth_kinematic(ChainSeries(times, tuple(channels)), model)
    # rows without samples change nothing elsewhere
    np.testing.assert_allclose(fine.mean[rows], smooth_kinematic(series, model).mean, rtol=1e-7, atol=1e-8)
    inner = rows[1:-1]
    for k in range(2):
        slope = (fine.mean[inner + 1, k] - fine.mean[inner - 1, k]) / (2 * delta)
        curvature = np.max(np.abs(fine.mean[:, k + 2])) + 1
        np.testing.assert_allclose(slope, fine.mean[inner, k + 1], atol=delta * curvature)


def duffing(n=1500, noise=0.05, seed=1):
    record = bq.simulate("duffing", n=n, seed=seed, noise=noise)
    return record, ChainSeries(record.time, tuple(record[c] for c in ("x", "v", "a")))


def test_units_and_the_origin_of_time_do_not_matter():
    _, series = duffing()
    fitted = fit_kinematic([series])
    smoothed = smooth_kinematic(series, fitted)

    def moved(length, seconds, later, tolerance):
        factors = [length / seconds**k for k in range(fitted.order)]
        other = ChainSeries(
            series.times * seconds + later, tuple(f * c for f, c in zip(factors, series.channels, strict=False))
        )
        model = fit_kinematic([other])
        assert model.order == fitted.order
        result = smooth_kinematic(other, model)
        np.testing.assert_allclose(model.noise_sd, np.multiply(fitted.noise_sd, factors[:3]), rtol=tolerance)
        size = np.sqrt(np.mean(smoothed.mean**2, axis=0))
        np.testing.assert_allclose(result.mean / factors / size, smoothed.mean / size, rtol=0, atol=tolerance)
        np.testing.assert_allclose(result.sd / factors, smoothed.sd, rtol=tolerance)
        jacobian = -series.n * np.sum(np.log(factors[:3]))
        assert model.log_likelihood == pytest.approx(fitted.log_likelihood + jacobian, rel=1e-9)

    moved(2.0**10, 1.0, 0.0, 1e-13)  # exact in floating point
    moved(1e3, 1.0, 0.0, 1e-5)  # metres to millimetres
    moved(1.0, 1e3, 0.0, 1e-5)  # seconds to milliseconds
    moved(1.0, 1.0, 1234.5, 1e-5)


def test_an_offset_of_the_coordinate_shifts_it():
    _, series = duffing()
    shifted = ChainSeries(series.times, (series.channels[0] + 1e4, *series.channels[1:]))
    model = fit_kinematic([series], order=5)
    there, here = smooth_kinematic(shifted, model), smooth_kinematic(series, model)
    # 1e4 holds x only to 1e-12
    np.testing.assert_allclose(there.mean[:, 0] - 1e4, here.mean[:, 0], atol=1e-10)
    np.testing.assert_allclose(there.mean[:, 1:], here.mean[:, 1:], rtol=1e-6, atol=1e-6)


def test_smoothing_a_simulated_oscillator():
    record, series = duffing(n=4000)
    model = fit_kinematic([series])
    smoothed = smooth_kinematic(series, model)
    for k, name in enumerate("xva"):
        raw = record.truth.noise_sd[name]
        error = smoothed.mean[:, k] - record.truth.clean[name]
        # 4000 samples tell a standard deviation to 1.1 %
        assert model.noise_sd[k] == pytest.approx(raw, rel=0.06)
        # prototypes left 11 to 16 % of the noise of x and v; a has none to spare below its 100 Hz pass band
        assert np.std(error) < (0.16, 0.16, 0.7)[k] * raw
        assert 0.75 < np.mean((error / smoothed.sd[:, k]) ** 2) < 1.4


def test_the_order_has_the_best_leave_one_out_density():
    _, series = duffing()
    every = {m: fit_kinematic([series], order=m).left_out for m in range(3, 7)}
    chosen = fit_kinematic([series])
    assert chosen.order == max(every, key=every.get)
    only = ChainSeries(series.times, (series.channels[0], None, None))
    every = {m: fit_kinematic([only], order=m).left_out for m in range(3, 7)}
    assert fit_kinematic([only]).order == max(every, key=every.get)
    assert fit_kinematic([only]).order < chosen.order


def test_noise_levels_start_below_the_pass_band_also_where_it_is_nearly_full():
    # a force up to 100 Hz sampled at 250: differences of a are signal, its spectrum has a floor nevertheless
    record = bq.simulate("duffing", n=16_000, seed=0, noise=0.05).take(slice(None, None, 4))
    series = ChainSeries(record.time, tuple(record[c] for c in ("x", "v", "a")))
    model = fit_kinematic([series])
    for sd, name in zip(model.noise_sd, "xva", strict=True):
        assert sd == pytest.approx(record.truth.noise_sd[name], rel=0.1)


def test_channels_without_noise_are_followed():
    record, series = duffing(noise=0.0)
    model = fit_kinematic([series])
    smoothed = smooth_kinematic(series, model)
    for k, name in enumerate("xva"):
        size = np.std(record[name])
        assert model.noise_sd[k] > 1e-8 * size  # the least is 1e-6 of the local size
        np.testing.assert_allclose(smoothed.mean[:, k], record[name], atol=0.02 * size)
    assert np.isfinite(smoothed.sd).all()


def test_noise_is_found_under_a_drift_ten_million_times_as_large():
    # the angle of a shaft that turns for long
    rng = np.random.default_rng(0)
    times = np.arange(20_000) / 1000
    angle = 1e3 * times + np.sin(30 * times)
    model = fit_kinematic([ChainSeries(times, (angle + 1e-3 * rng.normal(size=20_000), None))])
    assert model.noise_sd[0] == pytest.approx(1e-3, rel=0.03)


def test_only_the_acceleration_leaves_position_open():
    model = KinematicModel(3, 0.5, (None, None, 0.4))
    series, states = drawn(model, np.arange(400) * 0.3, 9)
    fitted = fit_kinematic([series], order=3)
    smoothed = smooth_kinematic(series, fitted)
    assert smoothed.sd[:, 0].min() > 100 * np.std(states[:, 0])
    standardised = (smoothed.mean[:, 2] - states[:, 2]) / smoothed.sd[:, 2]
    assert 0.7 < np.mean(standardised**2) < 1.4


def test_long_records_are_estimated_from_stretches():
    # a Wiener process is quickly drawn
    rng = np.random.default_rng(0)
    n, times = 120_000, np.arange(120_000) / 100
    wiener = np.cumsum(np.sqrt(2.0 / 100) * rng.normal(size=n))
    noisy = wiener + 0.1 * rng.normal(size=n)
    series = ChainSeries(times, (noisy,))
    model = fit_kinematic([series], order=1)
    assert model.noise_sd[0] == pytest.approx(0.1, rel=0.03)
    assert model.spectral_density == pytest.approx(2.0, rel=0.1)
    rows = [prepare(series, sizes_of([series]).initial_sd(1))]
    used = _stretches(rows)
    assert 35_000 < sum(len(r.steps) for r in used) <= 40_000
    assert len(used) >= 8
    dropped = np.sort(rng.permutation(n)[: n // 2])
    rare = _stretches([prepare(series.take(dropped), sizes_of([series]).initial_sd(1))])
    assert 7_000 < sum(len(r.steps) for r in rare) <= 8_000
    short = [rows[0].take(slice(0, 50_000))]
    assert _stretches(short) is short


def test_the_state_starts_anew_after_a_gap_that_leaves_no_digits():
    noise_sd = (0.1, 0.2)
    gap, rng = 1e6, np.random.default_rng(0)
    times = np.concatenate([np.arange(20), gap + np.arange(20)])
    series = ChainSeries(times, (np.sin(times) + 0.1 * rng.normal(size=40), np.cos(times) + 0.2 * rng.normal(size=40)))
    model = KinematicModel(5, 1.0, noise_sd, initial_sd=(1e3,) * 5)
    both = smooth_kinematic(series, model)
    for part in (slice(0, 20), slice(20, 40)):
        alone = smooth_kinematic(series.take(part), model)
        np.testing.assert_allclose(both.sd[part], alone.sd, rtol=1e-9)
        # the mean of q that the start is about is another one
        np.testing.assert_allclose(both.mean[part], alone.mean, atol=1e-4)
    # rows without samples in a gap: sure near the ends, unsure and finite in between
    samples = np.full(400, np.nan)
    samples[:20], samples[-20:] = np.sin(np.arange(20) / 5), np.cos(np.arange(20) / 5)
    bridged = smooth_kinematic(ChainSeries(np.arange(400), (samples, None)), replace(model, noise_sd=(1e-3, None)))
    assert np.isfinite(bridged.sd).all()
    assert bridged.sd[19, 0] < bridged.sd[25, 0] < 1e12
    assert bridged.sd[380, 0] < bridged.sd[374, 0] < bridged.sd[200, 0]


def test_records_are_cut_at_long_gaps_and_lose_empty_rows():
    times = np.concatenate([np.arange(50), 1e6 + np.arange(30), [2e6]]) / 10
    q, v = np.sin(times), np.cos(times)
    q[:20] = v[:20:2] = np.nan
    q[40] = v[40] = np.nan
    pieces = _pieces(ChainSeries(times, (q, v)))
    assert [piece.n for piece in pieces] == [50 - 10 - 1, 30]
    assert pieces[0].times[0] == times[1]
    rng = np.random.default_rng(0)
    noisy = ChainSeries(times, (q + 0.1 * rng.normal(size=81), v + 0.1 * rng.normal(size=81)))
    model = fit_kinematic([noisy])
    smoothed = smooth_kinematic(noisy, model)
    assert np.isfinite(smoothed.mean).all()
    assert np.isfinite(smoothed.sd).all()
    assert model.noise_sd[1] == pytest.approx(0.1, rel=0.5)


def test_what_cannot_be_used_is_refused():
    times, wave = np.arange(50) / 10, np.sin(np.arange(50) / 10)
    series = ChainSeries(times, (wave, None))
    nothing = np.full(50, np.nan)
    with pytest.raises(InputError, match="increase"):
        ChainSeries(times[::-1], (wave,))
    with pytest.raises(InputError, match="2 rows"):
        ChainSeries(times[:1], (wave[:1],))
    with pytest.raises(InputError, match="shape"):
        ChainSeries(times, (wave[:-1],))
    with pytest.raises(InputError, match="row 4"):
        ChainSeries(times, (np.where(np.arange(50) == 3, np.inf, wave),))
    with pytest.raises(InputError, match="noise of derivative 0"):
        fit_kinematic([series], noise_sd=(0.0, None))
    with pytest.raises(InputError, match="9 samples"):
        fit_kinematic([series.take(slice(0, 9))])
    with pytest.raises(InputError, match="constant"):
        fit_kinematic([ChainSeries(times, (wave, np.ones(50)))])
    with pytest.raises(InputError, match="0 samples"):
        fit_kinematic([ChainSeries(times, (wave, nothing))])
    with pytest.raises(InputError, match="every one is NaN"):
        smooth_kinematic(ChainSeries(times, (nothing,)), KinematicModel(1, 1.0, (0.1,)))


def test_a_constant_channel_can_be_smoothed_with_given_noise():
    times = np.arange(50) / 10
    model = fit_kinematic([ChainSeries(times, (np.ones(50), np.sin(times)))], order=2, noise_sd=(0.1, None))
    assert model.noise_sd[0] == 0.1
    at_rest = smooth_kinematic(ChainSeries(times, (np.ones(50), None)), KinematicModel(2, 1.0, (0.1, None)))
    np.testing.assert_allclose(at_rest.mean, np.tile([1.0, 0.0], (50, 1)), atol=1e-12)
