"""Does PySINDy find the right terms with the plug-in, without a threshold?

Lorenz, Van der Pol, Duffing, Lotka-Volterra and Roessler with polynomials of third degree, records of several lengths,
rates and starts; clean ones with differences of second and fourth order, noisy ones with the kinematic derivative too;
and Burgers' equation in its weak form. Beside it STLSQ at ten thresholds from 0.01 to 1: how often it is right at its
default, 0.1, and at the best threshold of each record, which nobody knows.

    python -m studies.pysindy_plugin > docs/tables/pysindy.csv
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["SYSTEMS", "draw_field", "draw_motion", "main"]

Floats = NDArray[np.float64]
THRESHOLDS = np.geomspace(0.01, 1.0, 10)
DEFAULT = 0.1
RECORDS = 6
NOISES = (0.0, 0.001, 0.01)
# Powers of ten that columns are multiplied by.
SCALES = 6


class Known(NamedTuple):
    """A system with its start, step [s], length [s], and the terms of each equation."""

    rhs: Callable[[float, Floats], Sequence[float]]
    start: tuple[float, ...]
    step: float
    length: float
    terms: tuple[set[str], ...]


SYSTEMS = {
    "lorenz": Known(
        lambda t, z: (10 * (z[1] - z[0]), z[0] * (28 - z[2]) - z[1], z[0] * z[1] - 8 / 3 * z[2]),
        (-8.0, 8.0, 27.0),
        0.002,
        10.0,
        ({"x0", "x1"}, {"x0", "x1", "x0 x2"}, {"x2", "x0 x1"}),
    ),
    "van der pol": Known(
        lambda t, z: (z[1], 2 * (1 - z[0] ** 2) * z[1] - z[0]),
        (2.0, 0.5),
        0.01,
        20.0,
        ({"x1"}, {"x0", "x1", "x0^2 x1"}),
    ),
    "duffing": Known(
        lambda t, z: (z[1], -0.1 * z[1] - z[0] - 2 * z[0] ** 3), (2.0, 0.0), 0.01, 20.0, ({"x1"}, {"x0", "x1", "x0^3"})
    ),
    "lotka-volterra": Known(
        lambda t, z: (z[0] - 0.5 * z[0] * z[1], -z[1] + 0.4 * z[0] * z[1]),
        (2.0, 1.0),
        0.01,
        20.0,
        ({"x0", "x0 x1"}, {"x1", "x0 x1"}),
    ),
    "roessler": Known(
        lambda t, z: (-z[1] - z[2], z[0] + 0.2 * z[1], 0.2 + z[2] * (z[0] - 5.7)),
        (3.0, 5.0, 0.3),
        0.01,
        50.0,
        ({"x1", "x2"}, {"x0", "x1"}, {"1", "x2", "x0 x2"}),
    ),
}
BURGERS = ({"x0_11", "x0x0_1"},)


def draw_motion(system: str, noise: float, seed: int) -> tuple[Floats, Floats]:
    """Times [s] and samples of a record: start, step (1 to 5 times) and length (0.6 to 2 times) by chance."""
    from scipy.integrate import solve_ivp

    known, rng = SYSTEMS[system], np.random.default_rng(seed)
    start = np.array(known.start) * (1.0 + 0.3 * rng.uniform(-1.0, 1.0, len(known.start)))
    step, length = known.step * 5.0 ** rng.uniform(), known.length * rng.uniform(0.6, 2.0)
    t = np.arange(0.0, length, step)
    x = solve_ivp(known.rhs, (0.0, t[-1]), start, t_eval=t, method="LSODA", rtol=1e-12, atol=1e-12).y.T
    return t, x + noise * x.std(axis=0) * rng.standard_normal(x.shape)


def draw_field(noise: float, seed: int) -> tuple[Floats, Floats, Floats]:
    """Burgers' equation u_t = -u u_x + 0.1 u_xx on 16 m, 128 or 256 points, a bump of any place and height."""
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(seed)
    n, length, t = int(rng.choice([128, 256])), 16.0, np.linspace(0.0, 10.0, 101)
    x = np.arange(n) * length / n - length / 2
    k = 2 * np.pi * np.fft.rfftfreq(n, length / n)
    kept = k < 2 / 3 * k.max()

    def rhs(_: float, u: Floats) -> Floats:
        h, square = np.fft.rfft(u), np.fft.rfft(u * u)
        return np.asarray(np.fft.irfft(-0.5j * k * kept * square - 0.1 * k * k * h, n))

    u0 = rng.uniform(0.8, 1.2) * np.exp(-((x - rng.uniform(-3, -1)) ** 2))
    u = solve_ivp(rhs, (0.0, 10.0), u0, t_eval=t, method="LSODA", rtol=1e-9, atol=1e-11).y
    return x, t, u + noise * u.std() * rng.standard_normal(u.shape)


class _Capture:
    """The library matrix and the derivatives that PySINDy gives to its optimizer."""

    def __init__(self, model: Any) -> None:
        self.model = model

    def of(self, x: Floats, t: Floats) -> tuple[Floats, Floats, list[str]]:
        import pysindy

        kept: list[tuple[Floats, Floats]] = []

        class Keep(pysindy.STLSQ):  # type: ignore[misc]
            def fit(self, x_: Any, y: Any, **rest: Any) -> Any:
                kept.append((np.asarray(x_), np.asarray(y)))
                return super().fit(x_, y, **rest)

        # not by set_params: a WeakPDELibrary does not have all parameters that it names
        self.model.optimizer = Keep(threshold=0.0)
        self.model.fit(x, t=t)
        return *kept[0], self.model.get_feature_names()


def _judged(D: Floats, y: Floats, names: list[str], truth: Sequence[set[str]], seed: int) -> Outcome:
    import pysindy

    from bayeq.adapters.pysindy import SpikeSlabOptimizer

    def found(coef: Floats) -> list[set[str]]:
        return [{names[j] for j in np.flatnonzero(row)} for row in coef]

    own = SpikeSlabOptimizer().fit(D, y)
    got = found(own.coef_)
    scale = 10.0 ** np.random.default_rng(seed).uniform(-SCALES, SCALES, D.shape[1])
    scaled = SpikeSlabOptimizer().fit(D * scale, y)
    right = [found(pysindy.STLSQ(threshold=float(h)).fit(D, y).coef_) == list(truth) for h in THRESHOLDS]
    return {
        "right": got == list(truth),
        "false": sum(len(g - t) for g, t in zip(got, truth, strict=True)),
        "missed": sum(len(t - g) for g, t in zip(got, truth, strict=True)),
        "same_scaled": bool((scaled.ind_ == own.ind_).all()),
        "stlsq_default": found(pysindy.STLSQ(threshold=DEFAULT).fit(D, y).coef_) == list(truth),
        "stlsq": right,
    }


def _measure(system: str, derivative: str, noise: float, seed: int) -> Outcome:
    import pysindy

    from bayeq.adapters.pysindy import KinematicDerivative

    warnings.simplefilter("ignore")
    if system == "burgers":
        x, t, u = draw_field(noise, seed)
        grid = np.stack(np.meshgrid(x, t, indexing="ij"), axis=-1)
        np.random.seed(seed % 2**32)  # noqa: NPY002  the subdomains are drawn from the global generator
        library = pysindy.WeakPDELibrary(
            pysindy.PolynomialLibrary(2, include_bias=False), derivative_order=3, spatiotemporal_grid=grid, K=300
        )
        parts = _Capture(pysindy.SINDy(feature_library=library)).of(u[..., None], t)
        return _judged(*parts, BURGERS, seed)
    method = {
        "differences of order 2": pysindy.FiniteDifference(order=2),
        "differences of order 4": pysindy.FiniteDifference(order=4),
        "kinematic": KinematicDerivative(),
    }[derivative]
    t, x = draw_motion(system, noise, seed)
    model = pysindy.SINDy(feature_library=pysindy.PolynomialLibrary(3), differentiation_method=method)
    return _judged(*_Capture(model).of(x, t), SYSTEMS[system].terms, seed)


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    n = len(outcomes)

    def share(key: str) -> str:
        return percent(sum(o[key] for o in outcomes), n)

    by_threshold = np.array([o["stlsq"] for o in outcomes])
    yield {
        "right": share("right"),
        "false_terms": sum(o["false"] for o in outcomes),
        "missed_terms": sum(o["missed"] for o in outcomes),
        "same_when_scaled": share("same_scaled"),
        "stlsq_0.1_right": share("stlsq_default"),
        "stlsq_best_one_right": percent(int(by_threshold.sum(axis=0).max()), n),
        "stlsq_any_right": percent(int(by_threshold.any(axis=1).sum()), n),
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    ways = [(s, d) for s in SYSTEMS for d in ("differences of order 2", "differences of order 4", "kinematic")]
    cells = [
        Cell({"system": s, "derivative": d, "noise": f"{100 * e:g} %"}, RECORDS, partial(_measure, s, d, e))
        for s, d in [*ways, ("burgers", "weak form")]
        for e in NOISES
    ]
    run_study("pysindy_plugin", "The right terms through PySINDy.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
