"""What a package adds to bayeq: an engine, a family of terms, a file format and a system."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from bayeq.dictionary import Family, Variables
from bayeq.errors import FileFormatError
from bayeq.inference.engines import Engine
from bayeq.inference.gram import GramLike, dense
from bayeq.inference.posterior import Constant, Details, Posterior
from bayeq.inference.prior import Prior
from bayeq.records.columns import Columns, Headers, Names, Select
from bayeq.records.formats import Format
from bayeq.systems import BandLimitedForce, System


def forward(gram: GramLike, prior: Prior | None = None) -> Posterior:
    """Add the term that lowers the residual most, while n times its logarithm falls by more than ln n."""
    if prior is not None:
        prior.refuse_signs("forward")
    K, Dty, n = dense(gram), gram.Dty, gram.dof
    least, support = 1e-14 * gram.yty + 1e-300, np.zeros(len(Dty), dtype=bool)

    def left(j: int | None = None) -> float:
        """The residual sum of squares of the chosen terms, and of another one."""
        chosen = support.copy()
        if j is not None:
            chosen[j] = True
        solution = np.linalg.lstsq(K[np.ix_(chosen, chosen)], Dty[chosen], rcond=1e-9)[0]
        return max(gram.yty - Dty[chosen] @ solution, least)

    while support.sum() < n - 1 and not support.all():
        best = min(np.flatnonzero(~support), key=left)
        if n * np.log(left() / left(best)) <= np.log(n):
            break
        support[best] = True
    information = K[np.ix_(support, support)]
    noise = left() / max(n - support.sum(), 1.0)
    coef = np.zeros(len(Dty))
    coef[support] = np.linalg.solve(information, Dty[support])
    return Posterior(
        names=gram.names,
        pip=support.astype(float),
        support=support,
        coef=coef,
        covariance=noise * np.linalg.inv(information),
        constant=Constant(np.zeros(len(Dty))),
        noise_variance=noise,
        n=round(n) + 1,
        details=Details("forward"),
    )


def friction(variables: Variables, argument: str | None = None) -> list[str]:
    """The state of each chain, the sign and the signed square of its velocity, and the inputs."""
    velocities = [states[-1] for states in variables.chains]
    return [
        *variables.states,
        *(f"sign({v})" for v in velocities),
        *(f"{v}*abs({v})" for v in velocities),
        *variables.inputs,
    ]


def read_columns(path: Path, *, names: Names = None, chosen: Select | None = None) -> Columns:
    """Read a file of JSON Lines, an object per row; null and what a row lacks are missing samples."""
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
        table = np.array([[np.nan if row.get(key) is None else float(row[key]) for key in rows[0]] for row in rows])
    except (ValueError, AttributeError, IndexError, TypeError) as error:
        raise FileFormatError(f"{path}: an object of numbers is expected in every line ({error})") from error
    return Columns.build(Headers.parse(list(rows[0]), str(path)).renamed(names), lambda i: table[:, i], chosen)


FORWARD = Engine(forward, "forward selection by the Bayesian information criterion", score="in")
FRICTION = Family(friction)
JSON_LINES = Format(
    "JSON Lines", (".jsonl",), lambda path, head: head.startswith(b'{"'), flat=sys.modules[__name__], keeps="units"
)
SOFTENING = System(
    name="softening",
    title="Oscillator with a softening spring",
    chains=("x:v:a",),
    inputs=("u",),
    rhs={"x": "v", "v": "(u-c*v-k*x+k3*x**3)/m"},
    terms={"a": {"x": "-k/m", "v": "-c/m", "x**3": "k3/m", "u": "1/m"}},
    parameters={"m": 1.0, "c": 2.0, "k": 1e3, "k3": 2e3},
    fixed=("m",),
    initial={"x": 0.0, "v": 0.0},
    force=BandLimitedForce(std=50.0, band=(0.0, 100.0)),
    n=2000,
    fs=1000.0,
    noise=0.05,
    units={"x": "m", "v": "m/s", "a": "m/s^2", "u": "N"},
    citation="A. H. Nayfeh and D. T. Mook, Nonlinear Oscillations (1979), section 2.1",
)
