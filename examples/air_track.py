"""The air-track oscillator of Schmidt and Lipson: a linear law with next to no damping."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import bayeq as bq
from examples.page import Example, draw

NAME = "air_track"
FILE = "schmidt_lipson/real_linear_a_1.txt"


def run(example: Example, data: Path) -> None:
    """Discover, also under an exact law and from the channels as given, and compare forms of damping."""
    with example.block("found"):
        rec = bq.read(data / "schmidt_lipson/real_linear_a_1.txt")
        eq = bq.discover(rec, displacement="x", velocity="v", acceleration="a")
        print(eq)
    with example.block("exact", shown=False):
        exact = bq.discover(rec, displacement="x", velocity="v", acceleration="a", tolerance=0)
        print(f"verdict: {exact.verdict}")
        print(exact[0].text)
    with example.block("damping"):
        given = bq.Prior(prior_inclusion=1.0, slab_variance=1e6)  # all terms are in, hardly shrunk
        compared = []
        for damping in ([], ["v"], ["v*abs(v)"], ["sign(v)"]):
            one = bq.discover(rec, chains="x:v:a", dictionary=["x", *damping], prior=given)
            compared.append(one)
            print(f"{one[0].text:36} {100 * one.simulate(rec, draws=0).nrmse['x']:5.1f} %")

    with example.block("period", shown=False):
        time, x = np.asarray(rec.time), rec["x"]
        position = CubicSpline(time, x - x.mean())
        zeros = position.roots(extrapolate=False)
        periods = (len(zeros) - 1) // 2
        stiffness = (2 * np.pi * periods / (zeros[2 * periods] - zeros[0])) ** 2
        print(f"(2 pi / period)**2 = {stiffness:.3f}")
        rate = position(time, 1)
        print(f"v is {rec['v'] @ rate / (rate @ rate):.3f} of dx/dt")

    whole = eq.simulate(rec)
    with warnings.catch_warnings(action="ignore"):
        raw = bq.discover(rec, displacement="x", velocity="v", acceleration="a", smooth="none")
    run = compared[1].simulate(rec)
    low, high = compared[1][0].shown_ci95[list(compared[1][0].posterior.names).index("v")]
    example.numbers |= {
        "free run of the whole record, discovered equation, error of x": f"{100 * whole.nrmse['x']:.0f} %",
        "free run of the whole record, x and v given, error of x": f"{100 * run.nrmse['x']:.1f} %",
        "smooth='none', all channels as given": raw[0].text,
        "the same, free run of the whole record, error of x": f"{100 * raw.simulate(rec, draws=0).nrmse['x']:.0f} %",
        "the same, stiffness against the period": f"{100 * (raw[0].shown_coef['x'] / -stiffness - 1):+.1f} %",
        "bound of the coefficient of v": f"{eq[0].table().set_index('term').loc['v', 'bound']:.3f}",
        "tau": f"{100 * eq[0].tau:.1f} %",
        "coefficient of v, x and v given, 95 % interval": f"{low:.4f} .. {high:.4f}",
        "sampling rate [Hz]": f"{(rec.n - 1) / (time[-1] - time[0]):.2f}",
        "amplitude of the second harmonic [tracking units]": f"{_second_harmonic(rec, stiffness):.1f}",
        "stiffness against the period": f"{100 * (eq[0].shown_coef['x'] / -stiffness - 1):+.2f} %",
        "README of the record, coefficients of x and v": "-6.04, -0.012",
    }
    example.figure = draw(
        [
            (f"as discovered: {eq[0].text}", whole),
            (f"x and v given: {compared[1][0].text}", run),
        ],
        "time [s]",
    )


def _second_harmonic(rec: bq.Record, stiffness: float) -> float:
    """Amplitude of x at twice its frequency, beside a polynomial and the decaying fundamental."""
    time = np.asarray(rec.time) - np.mean(rec.time)
    omega, slow = np.sqrt(stiffness), [np.ones_like(time), time, time**2]
    columns = [s * wave for s in slow for wave in (np.cos(omega * time), np.sin(omega * time), np.ones_like(time))]
    columns += [np.cos(2 * omega * time), np.sin(2 * omega * time)]
    fitted = np.linalg.lstsq(np.column_stack(columns), rec["x"])[0]
    return float(np.hypot(*fitted[-2:]))
