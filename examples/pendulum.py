"""The pendulum of Schmidt and Lipson: irregular samples, and accelerations that their authors smoothed."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import ellipk

import bayeq as bq
from examples.page import Example, draw

NAME = "pendulum"
FILE = "schmidt_lipson/real_pend_a_1.txt"


def run(example: Example, data: Path) -> None:
    """Discover, with each form of friction, from the channels as given and from the angle alone."""
    with example.block("found"):
        rec = bq.read(data / "schmidt_lipson/real_pend_a_1.txt")
        terms = ["o", "o**2", "o**3", "sin(o)", "cos(o)", "sin(2*o)", "w", "w*abs(w)", "sign(w)"]
        eq = bq.discover(rec, chains="o:w:a", dictionary=terms)
        print(eq)
    with example.block("friction"):
        given = bq.Prior(prior_inclusion=1.0, slab_variance=1e6)  # all terms are in, hardly shrunk
        forms = []
        for friction in ([], ["w"], ["w*abs(w)"], ["sign(w)"]):
            one = bq.discover(rec, chains="o:w:a", dictionary=["sin(o)", *friction], prior=given)
            forms.append(one)
            run = one.simulate(rec, draws=0)
            print(f"{one[0].text:40} free run of the whole record: o {100 * run.nrmse['o']:.0f} %")
    with example.block("period"):
        time = np.asarray(rec.time)
        angle = CubicSpline(time, rec["o"])
        zeros = angle.roots(extrapolate=False)
        exact = []
        for first, last in zip(zeros[:-2:6], zeros[2::6], strict=False):
            amplitude = np.ptp(angle(np.linspace(first, last, 400))) / 2
            stiffness = (4 * ellipk(np.sin(amplitude / 2) ** 2) / (last - first)) ** 2
            exact.append(stiffness)
            print(f"swing of amplitude {amplitude:.2f}: {stiffness:.3f}")
        rate = angle(time, 1)
        print(f"w is {rec['w'] @ rate / (rate @ rate):.3f} of do/dt")
        alone = bq.discover(rec, chains="o:~w:~a", dictionary=terms)
        print(f"from o alone: {alone[0].text}")

    low, high = eq[0].shown_ci95[list(eq[0].posterior.names).index("sin(o)")]
    found, true = -eq[0].shown_coef["sin(o)"], float(np.mean(exact))
    with warnings.catch_warnings(action="ignore"):
        raw = bq.discover(rec, chains="o:w:a", dictionary=terms, smooth="none")
    example.numbers |= {
        "smooth='none', all channels as given": raw[0].text,
        "the same, free run of the whole record, error of o": f"{100 * raw.simulate(rec, draws=0).nrmse['o']:.0f} %",
        "bound of the coefficient of w": f"{eq[0].table().set_index('term').loc['w', 'bound']:.3f}",
        "stiffness by periods, mean": f"{true:.3f}",
        "width of the interval of sin(o)": f"{100 * (high - low) / found:.1f} %",
        "coefficient of sin(o) against periods": f"{100 * (found / true - 1):+.1f} %",
        "the same from o alone": f"{100 * (-alone[0].shown_coef['sin(o)'] / true - 1):+.1f} %",
        "the same by least squares": f"{100 * (1.26 / true - 1):+.1f} %",
        "README of the record, coefficients of sin(o) and w": "-1.26, -0.010",
        "coefficient of sin(o), discovered": f"{eq[0].shown_coef['sin(o)']:.3f}",
    }
    example.figure = draw(
        [
            (f"as discovered: {eq[0].text}", eq.simulate(rec)),
            (f"given: {forms[2][0].text}", forms[2].simulate(rec)),
        ],
        "time [the record's unit]",
    )
