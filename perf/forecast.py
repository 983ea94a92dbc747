"""Speed of free runs: RK4 steps per millisecond of discovered equations on the tape, alone and with derivatives.

The Duffing equation (four terms and an intercept, forced) and the three of Lorenz. Beside them SciPy's `solve_ivp` with
the same right-hand side in Python, in evaluations of it over four: what an RK4 step takes.

    python -m perf.forecast

Writes perf/results/forecast.csv.
"""

from __future__ import annotations

import csv
import os
import platform
import time
import warnings
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits

import bayeq as bq
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.integrate import free_runs, interpolant
from bayeq.forecast.tangent import shoot
from perf.timing import medians

RESULTS = Path(__file__).parent / "results" / "forecast.csv"
ROWS = 20_000


def equations(system: str) -> tuple[bq.Equations, bq.Record]:
    """Equations of a system and a record of its inputs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if system == "duffing":
            record = bq.simulate("duffing", n=ROWS, seed=0)
            return bq.discover(record, chains=["x:v:a"], inputs=["u"]), record
        record = bq.simulate("lorenz", n=ROWS, fs=200.0, seed=0, noise=0.0)
        return bq.discover(record, chains=["x", "y", "z"], dictionary="polynomial:2", smooth="none"), record


def measure(system: str) -> dict[str, object]:
    """One line of the table."""
    eq, record = equations(system)
    posteriors = [e.posterior for e in eq]
    dynamics = Dynamics.of(eq.chains, eq.inputs, posteriors, [e.terms for e in eq])
    parameters, tape = dynamics.means(posteriors), dynamics.tape
    start = np.array([record[name][0] for name in eq.states])
    samples = np.column_stack([record[name] for name in eq.inputs]) if eq.inputs else np.empty((ROWS, 0))
    inputs = interpolant(record.time, samples, "cubic")
    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    out = np.empty((1, ROWS, len(start)))
    channels = np.arange(len(start), dtype=np.uint32)
    values = np.empty((ROWS, len(start)))
    jacobian = np.empty((ROWS, len(start), len(start) + dynamics.size))

    def run() -> None:
        free_runs(
            tape.code, tape.outputs, tape.registers(), parameters[None], start[None].copy(), np.zeros(1, np.uint32),
            inputs, record.time, record.dt, low, high, out,
        )  # fmt: skip

    def derivatives() -> None:
        shoot(
            tape.code, tape.outputs, tape.registers(), parameters, start, inputs, record.time, record.dt, low, high,
            channels, values, jacobian,
        )  # fmt: skip

    seconds = medians({"run": run, "derivatives": derivatives}, rounds=20)
    begin = time.perf_counter()
    span = (record.time[0], record.time[400])
    solved = solve_ivp(
        lambda t, s: eq.rhs(t, s, np.array([np.interp(t, record.time, u) for u in samples.T])),
        span,
        start,
        max_step=0.01,
    )
    python = (time.perf_counter() - begin) * 4.0 / solved.nfev
    return {
        "system": system,
        "instructions": len(tape.code),
        "parameters": dynamics.size,
        "steps_per_ms": round(1e-3 * (ROWS - 1) / seconds["run"]),
        "steps_with_derivatives_per_ms": round(1e-3 * (ROWS - 1) / seconds["derivatives"]),
        "steps_of_solve_ivp_per_ms": round(1e-3 / python, 2),
    }


def main() -> None:
    """Measure and write the table."""
    with threadpool_limits(1):
        rows = [measure(system) for system in ("duffing", "lorenz")]
    RESULTS.parent.mkdir(exist_ok=True)
    with RESULTS.open("w", newline="") as file:
        file.write(f"# python -m perf.forecast; {platform.machine()}, {os.cpu_count()} cores,")
        file.write(f" Python {platform.python_version()}, NumPy {np.__version__}; medians of 20 turns\n")
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    print(RESULTS.read_text(), end="")


if __name__ == "__main__":
    main()
