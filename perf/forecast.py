"""Speed of free runs: steps per millisecond of the Duffing equation, as `Equations.simulate` runs it.

One step of classical Runge-Kutta per sample, 20,000 samples at 1 kHz, the force interpolated by a cubic spline. Beside
it

- the same with derivatives by initial state and parameters, which `refine` needs,
- 200 runs with coefficients from the posterior,
- a Runge-Kutta loop written by hand for this equation and compiled by numba: what an interpreter cannot beat,
- SciPy's `solve_ivp` (RK45) with a right-hand side that SymPy has made a Python function, in samples per millisecond,
  at the accuracy that its own step control gives for rtol = 1e-6.

    python -m perf.forecast

Writes perf/results/forecast.csv.
"""

from __future__ import annotations

import csv
import os
import platform
import warnings
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import sympy
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from threadpoolctl import threadpool_limits

import bayeq as bq
from bayeq.numerics.rk4 import Drive, free_runs, interpolant, shoot
from perf.timing import medians

RESULTS = Path(__file__).parent / "results" / "forecast.csv"
ROWS = 20_000
DRAWS = 200
ROWS_OF_DRAWS = 2_000
ROWS_OF_SCIPY = 500


@numba.njit
def by_hand(theta, start, inputs, h, out):
    """RK4 of the Duffing equation, the coefficients in the order intercept, x, v, x**3, u."""
    b, k, c, k3, g = theta
    x, v = start
    for row in range(len(out)):
        out[row, 0], out[row, 1] = x, v
        p = inputs[row, 0]
        u0, u2 = p[0], p[1]
        u1 = 0.5 * (p[0] + p[1]) + 0.25 * (p[2] + 0.5 * p[3])
        a1 = b + k * x + c * v + k3 * x * x * x + g * u0
        x2, v2 = x + 0.5 * h * v, v + 0.5 * h * a1
        a2 = b + k * x2 + c * v2 + k3 * x2 * x2 * x2 + g * u1
        x3, v3 = x + 0.5 * h * v2, v + 0.5 * h * a2
        a3 = b + k * x3 + c * v3 + k3 * x3 * x3 * x3 + g * u1
        x4, v4 = x + h * v3, v + h * a3
        a4 = b + k * x4 + c * v4 + k3 * x4 * x4 * x4 + g * u2
        x += h / 6.0 * (v + 2.0 * (v2 + v3) + v4)
        v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


def contestants() -> tuple[dict[str, Callable[[], object]], dict[str, int]]:
    """What is timed, and how many steps each takes."""
    record = bq.simulate("duffing", n=ROWS, seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eq = bq.discover(record, chains=["x:v:a"], inputs=["u"], dictionary=["x", "v", "x**3", "u"])
    dynamics = eq.dynamics()
    theta, many = dynamics.mean, dynamics.draw(DRAWS, np.random.default_rng(0))
    start = np.array([record["x"][0], record["v"][0]])
    inputs = interpolant(record.time, record["u"][:, None], "cubic")
    wide = np.full(2, np.inf)
    drive = Drive.over(record.time, inputs, -wide, wide)
    one, band = np.empty((1, ROWS, 2)), np.empty((DRAWS, ROWS_OF_DRAWS, 2))
    hand, values, jacobian = np.empty((ROWS, 2)), np.empty((ROWS, 2)), np.empty((ROWS, 2, 7))

    def runs(parameters: np.ndarray, rows: int, out: np.ndarray) -> None:
        count = len(parameters)
        current, stopped = np.tile(start, (count, 1)), np.zeros(count, np.uint32)
        free_runs(dynamics.program(), drive.part(0, rows), parameters, current, stopped, out)

    def derivatives() -> None:
        shoot(dynamics.program(), drive, theta, start, np.arange(2, dtype=np.uint32), values, jacobian)

    x, v, u = sympy.symbols("x v u")
    terms = zip(theta[1:], (x, v, x**3, u), strict=True)
    acceleration = sympy.lambdify((x, v, u), theta[0] + sum(c * t for c, t in terms))
    force = CubicSpline(record.time, record["u"])
    span = record.time[:ROWS_OF_SCIPY]

    def scipy_run() -> np.ndarray:
        def law(t: float, s: np.ndarray) -> tuple[float, float]:
            return s[1], acceleration(s[0], s[1], force(t))

        return solve_ivp(law, span[[0, -1]], start, t_eval=span, rtol=1e-6, atol=1e-9).y

    # they all run the same
    runs(theta[None], ROWS, one)
    by_hand(theta, start, inputs, record.dt, hand)
    np.testing.assert_allclose(one[0], hand, rtol=0, atol=1e-8)
    np.testing.assert_allclose(one[0, :ROWS_OF_SCIPY].T, scipy_run(), rtol=0, atol=1e-3)
    timed = {
        "one run": lambda: runs(theta[None], ROWS, one),
        "one run with derivatives": derivatives,
        "200 draws": lambda: runs(many, ROWS_OF_DRAWS, band),
        "by hand, numba": lambda: by_hand(theta, start, inputs, record.dt, hand),
        "solve_ivp, lambdify": scipy_run,
    }
    steps = dict.fromkeys(timed, ROWS) | {"200 draws": DRAWS * ROWS_OF_DRAWS, "solve_ivp, lambdify": ROWS_OF_SCIPY}
    return timed, steps


def main() -> None:
    """Measure and write the table."""
    with threadpool_limits(1):
        timed, steps = contestants()
        seconds = medians(timed, rounds=20)
    RESULTS.parent.mkdir(exist_ok=True)
    with RESULTS.open("w", newline="") as file:
        file.write(f"# python -m perf.forecast; {platform.machine()}, {os.cpu_count()} cores,")
        file.write(f" Python {platform.python_version()}, NumPy {np.__version__}; medians of 20 turns\n")
        writer = csv.writer(file)
        writer.writerow(["run", "steps", "milliseconds", "steps_per_ms"])
        for name, value in seconds.items():
            writer.writerow([name, steps[name], f"{1e3 * value:.2f}", f"{1e-3 * steps[name] / value:.4g}"])
    print(RESULTS.read_text(), end="")


if __name__ == "__main__":
    main()
