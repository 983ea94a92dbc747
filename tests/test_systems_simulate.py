"""Simulation: the integrator's order and accuracy, the force's spectrum, seeds, noise and arguments."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions import Tape, parse
from bayeq.numerics.rk4 import Drive, free_runs, interpolant
from bayeq.systems import BandLimitedForce, System, get_system, simulate
from bayeq.systems.simulate import band_limited_noise


def with_substeps(name: str, substeps: int) -> System:
    return dataclasses.replace(get_system(name), substeps=substeps)


def clean(system: str | System, **arguments: object) -> dict[str, np.ndarray]:
    truth = simulate(system, noise=0.0, **arguments).truth  # type: ignore[arg-type]
    assert truth is not None
    return dict(truth.clean)


@pytest.mark.parametrize(("name", "fs", "n"), [("duffing", 250.0, 100), ("lorenz", 50.0, 40), ("vanderpol", 20.0, 80)])
def test_the_order_of_convergence_is_four(name: str, fs: float, n: int) -> None:
    # The force is sampled and interpolated, so that steps are refined inside the sampling intervals.
    force = {"force": 50 * np.sin(np.arange(n) / 5.0)} if name == "duffing" else {}
    runs = [clean(with_substeps(name, s), fs=fs, n=n, **force)["x"] for s in (1, 2, 4, 64)]
    errors = [np.max(np.abs(run - runs[-1])) for run in runs[:-1]]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all((orders > 3.6) & (orders < 4.6)), (errors, orders)


@pytest.mark.parametrize("name", ["linear", "duffing", "quadratic"])
def test_oscillators_agree_with_an_adaptive_integrator(name: str) -> None:
    n, fs = 300, 1000.0
    ours = clean(with_substeps(name, 8), n=n, fs=fs, seed=5)
    system, time = get_system(name), np.arange(n) / fs
    p = dict(system.parameters)
    g = {
        "linear": lambda x, v: 0.0,
        "duffing": lambda x, v: p["k3"] * x**3,
        "quadratic": lambda x, v: p["c2"] * v * abs(v),
    }[name]

    def law(t: float, s: np.ndarray) -> list[float]:
        u = np.interp(t, time, ours["u"])
        return [s[1], (u - p["c"] * s[1] - p["k"] * s[0] - g(s[0], s[1])) / p["m"]]

    theirs = solve_ivp(law, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-10, atol=1e-12, max_step=1 / fs)
    np.testing.assert_allclose(ours["x"], theirs.y[0], rtol=0, atol=1e-6 * np.std(ours["x"]))
    np.testing.assert_allclose(ours["v"], theirs.y[1], rtol=0, atol=1e-6 * np.std(ours["v"]))


def test_lorenz_agrees_with_an_adaptive_integrator() -> None:
    ours = clean(with_substeps("lorenz", 20), n=200)

    def law(t: float, s: np.ndarray) -> list[float]:
        x, y, z = s
        return [10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z]

    time = np.arange(200) / 100
    theirs = solve_ivp(law, (0, time[-1]), [-8, 8, 27], t_eval=time, rtol=1e-11, atol=1e-11, method="DOP853")
    for name, column in zip("xyz", theirs.y, strict=True):
        np.testing.assert_allclose(ours[name], column, atol=1e-5)


def test_the_compiled_integrator_equals_the_obvious_one() -> None:
    tape = Tape.compile([parse("v"), parse("u-k*sin(x)-v*abs(v)")], ["x", "v", "u", "k"])
    u = np.random.default_rng(0).standard_normal((50, 1))
    out, stopped, wide = np.empty((1, 50, 2)), np.zeros(1, np.uint32), np.full(2, 1e9)
    drive = Drive(interpolant(np.arange(50) / 10, u, "linear"), np.full(49, 0.1), 0.05, -wide, wide)
    free_runs(tape.program(), drive, np.array([[9.81]]), np.array([[1.0, 0.0]]), stopped, out)
    assert stopped[0] == 0

    def law(s: np.ndarray, force: float) -> np.ndarray:
        return np.array([s[1], force - 9.81 * np.sin(s[0]) - s[1] * abs(s[1])])

    s, h, expected = np.array([1.0, 0.0]), 0.05, []
    for row in range(49):
        expected.append(s)
        for step in (0, 1):
            u0, u1, u2 = (np.interp(row + (step + f) / 2, np.arange(50), u[:, 0]) for f in (0, 0.5, 1))
            k1 = law(s, u0)
            k2 = law(s + h / 2 * k1, u1)
            k3 = law(s + h / 2 * k2, u1)
            k4 = law(s + h * k3, u2)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    np.testing.assert_allclose(out[0, :49], expected, rtol=1e-12, atol=1e-13)


def test_a_run_that_diverges_stops_and_names_the_row() -> None:
    tape = Tape.compile([parse("x**2")], ["x"])
    out, stopped, wide = np.empty((1, 100, 1)), np.zeros(1, np.uint32), np.full(1, 1e300)
    drive = Drive(np.empty((100, 0, 4)), np.full(99, 0.1), 0.1, -wide, wide)
    free_runs(tape.program(), drive, np.empty((1, 0)), np.array([[1.0]]), stopped, out)
    row = int(stopped[0]) - 1
    assert 10 <= row < 20
    assert np.all(np.isfinite(out[0, :row]))
    assert np.all(np.isnan(out[0, row:]))
    with pytest.raises(InputError, match=r"'duffing' diverged at .* s \(row \d+\): raise fs"):
        simulate("duffing", fs=30.0, force=5000 * np.ones(100))


def test_the_force_is_band_limited_gaussian_with_the_given_std() -> None:
    force = BandLimitedForce(50.0, (0.0, 100.0))
    rng = np.random.default_rng(0)
    draws = np.array([band_limited_noise(force, 2000, 1000.0, rng) for _ in range(200)])
    spectrum = np.mean(np.abs(np.fft.rfft(draws)) ** 2, axis=0)
    frequency = np.fft.rfftfreq(2000, 1e-3)
    inside = (frequency > 0) & (frequency <= 100)
    assert np.max(spectrum[~inside]) < 1e-20 * np.max(spectrum)
    assert np.std(spectrum[inside]) / np.mean(spectrum[inside]) < 0.1  # flat: 1/sqrt(200)
    assert np.sqrt(np.mean(draws**2)) == pytest.approx(50, rel=0.01)
    standard = draws.ravel() / 50
    assert np.mean(standard**4) == pytest.approx(3, rel=0.03)
    assert np.mean(standard**3) == pytest.approx(0, abs=0.03)


@pytest.mark.parametrize(
    ("n", "fs", "band"),
    [(500, 150.0, (0, 100)), (501, 150.0, (0, 100)), (5, 1000.0, (0, 100)), (8, 50.0, (0, 100)), (9, 1e9, (20, 90))],
)
def test_the_force_keeps_its_std_where_the_band_meets_nyquist_or_the_record_is_short(
    n: int, fs: float, band: tuple[float, float]
) -> None:
    rng = np.random.default_rng(1)
    draws = [band_limited_noise(BandLimitedForce(2.0, band), n, fs, rng) for _ in range(3000)]
    assert np.sqrt(np.mean(np.square(draws))) == pytest.approx(2, rel=0.04)
    with pytest.raises(InputError, match="not below half the sampling rate"):
        band_limited_noise(BandLimitedForce(1.0, (80.0, 90.0)), n, 150.0, rng)


def test_each_source_of_randomness_has_its_own_stream() -> None:
    base = simulate("duffing", n=200, seed=1)
    quiet = simulate("duffing", n=200, seed=1, noise={"v": 0.2})
    assert base.truth is not None
    assert quiet.truth is not None
    for name in ("x", "v", "a", "u"):
        np.testing.assert_array_equal(base.truth.clean[name], quiet.truth.clean[name])
    np.testing.assert_array_equal(quiet["x"], quiet.truth.clean["x"])
    noise, louder = base["v"] - base.truth.clean["v"], quiet["v"] - quiet.truth.clean["v"]
    np.testing.assert_allclose(louder, 4 * noise, atol=1e-12)
    perturbed = simulate("duffing", n=200, seed=1, perturb=0.1)
    assert perturbed.truth is not None
    np.testing.assert_array_equal(perturbed.truth.clean["u"], base.truth.clean["u"])
    assert perturbed.truth.parameters["m"] == 1.0
    given = simulate("duffing", n=200, seed=1, perturb=0.1, parameters={"k": 900.0})
    assert given.truth is not None
    assert given.truth.parameters == {**perturbed.truth.parameters, "k": 900.0}
    assert given.truth.coefficients["a"]["x"] == -900.0
    factors = [v / base.truth.parameters[k] for k, v in perturbed.truth.parameters.items() if k != "m"]
    assert len(set(factors)) == 3


def test_perturbations_have_the_given_spread() -> None:
    ks = [
        t.parameters["k"]
        for i in range(400)
        if (t := simulate("linear", n=2, seed=(7, i), perturb=0.1).truth) is not None
    ]
    assert np.mean(ks) == pytest.approx(1000, abs=20)
    assert np.std(ks) == pytest.approx(100, rel=0.12)


def test_seeds_may_be_sequences() -> None:
    one, two = simulate("vanderpol", n=10, seed=(1, 2)), simulate("vanderpol", n=10, seed=[1, 2])
    assert one["x"].tobytes() == two["x"].tobytes()
    assert one["x"].tobytes() != simulate("vanderpol", n=10, seed=(2, 1))["x"].tobytes()
    assert simulate("linear", n=10, seed=5)["x"].tobytes() == simulate("linear", n=10, seed=np.int64(5))["x"].tobytes()


def test_noise_scales() -> None:
    lorenz = simulate("lorenz", noise=0.1).truth
    assert lorenz is not None
    pooled = 0.1 * np.std([lorenz.clean[s] for s in "xyz"])
    assert dict(lorenz.noise_sd) == pytest.approx(dict.fromkeys("xyz", pooled))
    duffing = simulate("duffing", noise=0.1).truth
    assert duffing is not None
    assert dict(duffing.noise_sd) == pytest.approx({c: 0.1 * np.std(duffing.clean[c]) for c in "xvau"})


def test_an_own_force_is_taken_as_it_is() -> None:
    u = np.sin(np.arange(30) / 3)
    record = simulate("linear", force=u, noise=0.0)
    assert record["u"].tobytes() == u.tobytes()
    assert record["a"][0] == u[0]
    u[0] = 9.0
    assert record["u"][0] == 0.0


def test_a_force_that_is_held_acts_over_the_whole_interval() -> None:
    record = simulate("linear", force=[1.0, 0.0, 0.0], fs=100.0, noise=0.0, interpolation="hold")
    straight = simulate("linear", force=[1.0, 0.0, 0.0], fs=100.0, noise=0.0)
    # from rest a constant force for a hundredth of a second, beside one that falls to nothing within it
    assert record["v"][1] == pytest.approx(0.01 * record["a"][0], rel=0.1)
    assert straight["v"][1] == pytest.approx(0.5 * record["v"][1], rel=0.05)


def test_an_own_system_with_two_coupled_coordinates() -> None:
    system = System(
        name="pair",
        title="Two masses",
        chains=("x:xd:xdd", "y:yd:ydd"),
        rhs={"x": "xd", "xd": "k*(y-x)+f", "y": "yd", "yd": "k*(x-y)+g"},
        terms={"xdd": {"x": "-k", "y": "k", "f": "1"}, "ydd": {"x": "k", "y": "-k", "g": "1"}},
        parameters={"k": 3.0},
        initial={"x": 1.0, "xd": 0.0, "y": 0.0, "yd": 0.0},
        inputs=("f", "g"),
        n=50,
        fs=50.0,
        noise=0.0,
        citation="test",
    )
    with pytest.raises(InputError, match="no force of its own"):
        simulate(system)
    force = np.zeros((50, 2))
    record = simulate(system, force=force)
    assert tuple(record.channels) == ("x", "xd", "xdd", "y", "yd", "ydd", "f", "g")
    time = np.arange(50) / 50
    np.testing.assert_allclose(record["x"], 0.5 + 0.5 * np.cos(np.sqrt(6) * time), atol=1e-6)
    copied = pickle.loads(pickle.dumps(system))  # noqa: S301
    assert simulate(copied, force=force)["x"].tobytes() == record["x"].tobytes()


def test_what_overflows_after_the_last_step_is_a_divergence_too() -> None:
    growing = System(
        name="growing",
        title="Exponential growth",
        chains=("x",),
        rhs={"x": "k*x"},
        terms={"dx": {"x": "k"}},
        parameters={"k": 1.0},
        initial={"x": 1e200},
        n=10,
        fs=10.0,
        noise=0.0,
        citation="test",
    )
    with pytest.raises(InputError, match="'growing' diverged"):
        simulate(growing)


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        ({"system": "dufing"}, UnknownNameError, "no system named 'dufing'; did you mean 'duffing'"),
        ({"n": 1}, InputError, "n must be at least 2, not 1"),
        ({"n": 10.5}, InputError, "n must be a whole number, not 10.5"),
        ({"fs": 0}, InputError, "fs must be positive, not 0"),
        ({"fs": float("nan")}, InputError, "fs must be finite"),
        ({"fs": "fast"}, InputError, "fs must be a number, not 'fast'"),
        ({"noise": -0.1}, InputError, "noise is a ratio of the signal"),
        ({"noise": {"x": float("inf")}}, InputError, "noise must be finite"),
        ({"noise": {"w": 0.1}}, UnknownNameError, "no channel named 'w'"),
        ({"parameters": {"k9": 1.0}}, UnknownNameError, "no parameter named 'k9'"),
        ({"parameters": {"k": None}}, InputError, "parameter 'k' must be a number"),
        ({"perturb": float("inf")}, InputError, "perturb must be finite"),
        ({"seed": -1}, InputError, "seed must be"),
        ({"seed": 1.5}, InputError, "seed must be"),
        ({"seed": "1"}, InputError, "seed must be"),
        ({"interpolation": "steps"}, InputError, "interpolation must be one of cubic, linear, hold, band-limited"),
        ({"force": np.ones(10), "n": 11}, InputError, r"not shape \(10, 1\)"),
        ({"force": np.ones((10, 2))}, InputError, r"not shape \(10, 2\)"),
        ({"force": 3.0}, InputError, "force must have"),
        ({"force": [1.0]}, InputError, "force must have"),
        ({"force": [1.0, np.nan]}, InputError, "not finite"),
        ({"system": "lorenz", "force": np.ones(10)}, InputError, "takes no force"),
    ],
)
def test_wrong_arguments_are_refused(arguments: dict[str, object], error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        simulate(**{"system": "duffing", **arguments})  # type: ignore[arg-type]
