"""Equations that hold highest derivatives of each other: are double pendulums and cart-poles found from their angles?

A double pendulum of two rods, 1500 rows at 200 Hz of both angles; a cart with a pole under a force, 1500 rows at 100 Hz
of the position, the angle and the force. Parameters and starts are drawn; noise is a share of each channel's standard
deviation. The dictionary is the same for both equations: each has the other's highest derivative times sine and cosine.

    python -m studies.implicit > docs/tables/implicit.csv
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayeq.discovery import discover
from bayeq.records import Record
from bayeq.systems import BandLimitedForce
from bayeq.systems.simulate import band_limited_noise
from studies.judge import timed, verdict_lines, with_verdict
from studies.resumable import Outcome, by_noise, run_study

__all__ = ["SYSTEMS", "cart_pole", "double_pendulum", "main"]

Floats = NDArray[np.float64]
Truth = dict[str, dict[str, float]]

RECORDS, ROWS, FINER, G = 10, 1500, 8, 9.81
NOISES = (0.005, 0.01, 0.02)

_PENDULUM = (
    "sin(p), sin(q), cos(p), cos(q), dp, dq, dp**2*sin(p-q), dq**2*sin(p-q), dp**2*cos(p-q), dq**2*cos(p-q),"
    " ddp*cos(p-q), ddq*cos(p-q), ddp*sin(p-q), ddq*sin(p-q)"
)
_CART = (
    "x, dx, u, dq, sin(q), cos(q), dq**2*sin(q), dq**2*cos(q), u*cos(q), ddx*cos(q), ddq*cos(q), ddx*sin(q), ddq*sin(q)"
)


def _integrated(rate: Callable[[Floats, float], Floats], start: Floats, fs: float, force: Floats) -> Floats:
    """States at the samples, (ROWS, d), by Runge and Kutta; the force, (ROWS FINER + 1,), is straight in between."""
    h, y, out = 1.0 / (fs * FINER), start, np.empty((ROWS, len(start)))
    for i in range(ROWS * FINER):
        if i % FINER == 0:
            out[i // FINER] = y
        middle = 0.5 * (force[i] + force[i + 1])
        k1 = rate(y, force[i])
        k2 = rate(y + 0.5 * h * k1, middle)
        k3 = rate(y + 0.5 * h * k2, middle)
        k4 = rate(y + h * k3, force[i + 1])
        y = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return out


def double_pendulum(noise: float, seed: int) -> tuple[Record, Truth]:
    """Two point masses on rods, released at rest."""
    rng = np.random.default_rng([seed, 1])
    m1, m2 = rng.uniform(0.5, 1.5, 2)
    l1, l2 = rng.uniform(0.3, 0.7, 2)
    share = m2 * l2 / ((m1 + m2) * l1)

    def rate(y: Floats, _: float) -> Floats:
        p, q, dp, dq = y.tolist()
        c, s = np.cos(p - q), np.sin(p - q)
        mass = np.array([[1.0, share * c], [l1 / l2 * c, 1.0]])
        side = np.array([-share * dq**2 * s - G / l1 * np.sin(p), l1 / l2 * dp**2 * s - G / l2 * np.sin(q)])
        return np.concatenate([[dp, dq], np.linalg.solve(mass, side)])

    start = np.array([rng.uniform(0.8, 2.0), rng.uniform(-2.0, 2.0), 0.0, 0.0])
    y = _integrated(rate, start, 200.0, np.zeros(ROWS * FINER + 1))
    truth = {
        "ddp": {"sin(p)": -G / l1, "dq**2*sin(p-q)": -share, "ddq*cos(p-q)": -share},
        "ddq": {"sin(q)": -G / l2, "dp**2*sin(p-q)": l1 / l2, "ddp*cos(p-q)": -l1 / l2},
    }
    return _noisy({"p": y[:, 0], "q": y[:, 1]}, noise, 200.0, seed), truth


def cart_pole(noise: float, seed: int) -> tuple[Record, Truth]:
    """A cart with friction under a force, and a pole that hangs from it."""
    rng = np.random.default_rng([seed, 1])
    M, m = rng.uniform(0.8, 1.5), rng.uniform(0.2, 0.6)
    length, friction = rng.uniform(0.3, 0.6), rng.uniform(0.1, 0.4)
    total = M + m

    def rate(y: Floats, u: float) -> Floats:
        _, q, dx, dq = y.tolist()
        mass = np.array([[1.0, m * length / total * np.cos(q)], [np.cos(q) / length, 1.0]])
        side = np.array([(u - friction * dx + m * length * dq**2 * np.sin(q)) / total, -G / length * np.sin(q)])
        return np.concatenate([[dx, dq], np.linalg.solve(mass, side)])

    rows = ROWS * FINER + 1
    force = band_limited_noise(BandLimitedForce(4.0, (0.1, 2.0)), rows, 100.0 * FINER, rng)
    y = _integrated(rate, np.array([0.0, rng.uniform(-1.0, 1.0), 0.0, 0.0]), 100.0, force)
    truth = {
        "ddx": {
            "dx": -friction / total, "u": 1.0 / total, "dq**2*sin(q)": m * length / total,
            "ddq*cos(q)": -m * length / total,
        },
        "ddq": {"sin(q)": -G / length, "ddx*cos(q)": -1.0 / length},
    }  # fmt: skip
    return _noisy({"x": y[:, 0], "q": y[:, 1], "u": force[:-1:FINER]}, noise, 100.0, seed), truth


def _noisy(channels: Mapping[str, Floats], noise: float, fs: float, seed: int) -> Record:
    rng = np.random.default_rng([seed, 2])
    spoiled = {name: values + noise * values.std() * rng.standard_normal(ROWS) for name, values in channels.items()}
    return Record.from_arrays(spoiled, fs=fs)


SYSTEMS = {
    "double pendulum": (double_pendulum, {"chains": ["p::", "q::"], "dictionary": _PENDULUM}),
    "cart-pole": (cart_pole, {"chains": ["x::", "q::"], "inputs": ["u"], "dictionary": _CART}),
}


def _measure(name: str, noise: float, seed: int) -> Outcome:
    simulated, asked = SYSTEMS[name]
    record, truth = simulated(noise, seed)
    return timed(partial(discover, record, **asked), partial(with_verdict, truth))


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = by_noise(SYSTEMS, NOISES, RECORDS, _measure)
    run_study("implicit", "Equations that hold each other's highest derivatives.", cells, verdict_lines, arguments)


if __name__ == "__main__":
    main()
