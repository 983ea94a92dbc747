"""The encoder pendulum: sin(th) is certain, the form of the friction is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bayeq as bq
from examples.page import Example, draw

NAME = "encoder"
FILE = "multiarm_single_pendulum/SinglePendulumDataForParameterEstimation.mat"


def run(example: Example, data: Path) -> None:
    """Discover, doubt the friction, and compare its forms by free runs."""
    with example.block("found"):
        from scipy.io import loadmat

        content = loadmat(data / "multiarm_single_pendulum/SinglePendulumDataForParameterEstimation.mat")
        arrays = list(zip(content["Time_id"].ravel(), content["Y_id"].ravel(), strict=True))
        pieces = [bq.Record.from_arrays(time=t.ravel(), th=y[0], w=y[1]) for t, y in arrays]
        terms = ["th", "th**2", "th**3", "sin(th)", "cos(th)", "w", "w*abs(w)", "sign(w)"]
        eq = bq.discover(pieces, chains="th:w:", dictionary=terms)
        print(eq)
    with example.block("friction", shown=False):
        thin = [bq.Record.from_arrays(time=t.ravel()[::10], th=y[0, ::10], w=y[1, ::10]) for t, y in arrays]
        given = bq.Prior(prior_inclusion=1.0, slab_variance=1e6)  # all terms are in, hardly shrunk
        forms = []
        for friction in (
            ["w"],
            ["w*abs(w)"],
            ["sign(w)"],
            ["w", "sign(w)"],
            ["w*abs(w)", "sign(w)"],
            ["w", "w*abs(w)", "sign(w)"],
        ):
            one = bq.discover(thin, chains="th:w:", dictionary=["sin(th)", *friction], prior=given)
            forms.append(one)
            errors = [one.simulate(piece, draws=0).nrmse["th"] for piece in thin]
            print(f"{one[0].text:70}", *(f"{100 * error:5.1f} %" for error in errors))
        coef = forms[-1][0].shown_coef
        for w in (1, 3, 5, 10):
            total = coef["w"] * w + coef["w*abs(w)"] * w**2 + coef["sign(w)"]
            print(f"friction of all three at w = {w:2} rad/s: {total:+.2f} rad/s^2")

    pushing = forms[-1][0]
    low, high = pushing.shown_ci95[list(pushing.posterior.names).index("w")]
    example.numbers |= {
        "authors' parameters, A and B": "64.22, 0.067",
        "sin(th) against the authors'": f"{100 * (eq[0].shown_coef['sin(th)'] / 64.22 - 1):+.1f} %",
        "coefficient of sin(th), discovered": f"{eq[0].shown_coef['sin(th)']:.2f}",
        "PIP of sign(w)": f"{eq[0].table().set_index('term').loc['sign(w)', 'pip']:.2f}",
    }
    example.numbers["coefficient of w, given three forms, 95 % interval"] = f"{low:.3f} .. {high:.3f}"
    run = eq.simulate(pieces[0])
    example.figure = draw([(f"as discovered: {eq[0].text}", replace(run, mean={"th": run.mean["th"]}))], "time [s]")
