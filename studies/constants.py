"""Constants inside terms: are terms with unknown constants found, and do the intervals of these cover?

An oscillator under a smooth force, 2000 rows at 100 Hz: tanh friction, a one-sided gap, a decaying force and a sine of
unknown frequency, each with parameters of its own; Michaelis-Menten kinetics, 400 rows with the inflow exact. Noise is
a share of each channel's standard deviation. `none` offers tanh friction to records that have none; `forms` offers four
look-alikes as an either-or, one of which is true: right is the true form, or that the form is undecided. `... beside
all` offers the term beside the 36 candidates of the dictionary `oscillator`, many of which are a series for it.

    python -m studies.constants > docs/tables/constants.csv
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.equation.text import forms_of
from bayeq.records import Record
from bayeq.systems import BandLimitedForce, System, simulate
from bayeq.systems.simulate import band_limited_noise
from studies.judge import judged, timed, verdicts
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["CASES", "Case", "draw_record", "judged_with_constants", "main", "summary"]

RECORDS = 20
ROWS, RATE, FINER = 2000, 100.0, 10
FORCE = BandLimitedForce(1.0, (0.2, 4.0))
BESIDE = "x, v, u, x**2, x**3, v**3, v*abs(v), sign(v)"
FORMS = ("tanh(v/{v0})", "v/sqrt(v**2+{v1}**2)", "atan(v/{v2})", "v/({v3}+abs(v))")

# Of cases that are not measured both with and without velocity and acceleration.
CHAINS = {"kinetics": ("x",), "forms": ("x:v:a",)}

Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Case:
    """What is in the acceleration beside ``8*u-100*x-c*v``, and what is offered.

    Attributes
    ----------
    added : str
        Text in parameters, to be added.
    truth : mapping of str to str
        Further true terms, with the parameter that is their coefficient.
    offered : str
        Candidates beside the usual ones.
    constants : mapping of str to str
        The parameter that is the true value of each constant.
    beside : str
        The usual candidates.
    draw : callable
        Draws the parameters.
    """

    added: str
    truth: Mapping[str, str]
    offered: str
    draw: Callable[[np.random.Generator], Parameters]
    constants: Mapping[str, str] = field(default_factory=dict)
    beside: str = BESIDE


def _between(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], Parameters]:
    """Log-uniform parameters."""
    return lambda rng: {name: float(np.exp(rng.uniform(*np.log(ends)))) for name, ends in ranges.items()}


_friction = _between(F=(2.0, 6.0), s=(0.05, 0.5))
_gap = Case(
    "-F*max(x-s,0)", {"max(x-{gap},0)": "-F"}, "max(x-{gap}, 0)", _between(F=(60.0, 300.0), s=(0.02, 0.1)),
    {"gap": "s"},
)  # fmt: skip
CASES = {
    "tanh": Case("-F*tanh(v/s)", {"tanh(v/{v0})": "-F"}, "tanh(v/{v0})", _friction, {"v0": "s"}),
    "gap": _gap,
    "decay": Case(
        "+F*q", {"exp(-{a}*t)": "F"}, "exp(-{a}*t)", _between(F=(10.0, 30.0), s=(0.15, 1.0)), {"a": "s"}
    ),
    "sine": Case(
        "+F*q", {"sin({w}*t+{p})": ""}, "sin({w}*t + {p})", _between(F=(2.0, 4.0), s=(3.0, 40.0)),
        {"w": "s"},
    ),
    "none": Case("", {}, "tanh(v/{v0})", _between(F=(1.0, 2.0))),
    "forms": Case("", {}, " | ".join(FORMS), _friction),
    "gap beside all": replace(_gap, beside="oscillator"),
    "exponential beside all": Case(
        "-F*exp(s*x)", {"exp({q}*x)": "-F"}, "exp({q}*x)", _between(F=(5.0, 20.0), s=(3.0, 10.0)), {"q": "s"},
        beside="oscillator",
    ),
    "power beside all": Case(
        "-F*sign(v)*abs(v)**s", {"sign(v)*abs(v)**{p}": "-F"}, "sign(v)*abs(v)**{p}",
        _between(F=(1.0, 4.0), s=(1.4, 2.8)), {"p": "s"}, beside="oscillator",
    ),
}  # fmt: skip

# What changes with time alone.
WAVES = {"decay": lambda s, t: np.exp(-s * t), "sine": lambda s, t: np.sin(s * t + 0.7)}

# Of the look-alikes, as they are simulated.
SIMULATED = ("tanh(v/s)", "v/sqrt(v**2+s**2)", "atan(v/s)", "v/(s+abs(v))")


def oscillator(added: str, parameters: Parameters) -> System:
    """The oscillator with something in its acceleration."""
    return System(
        name="oscillator-with-constants",
        title="Oscillator with a term that holds a constant",
        chains=("x:v:a",),
        rhs={"x": "v", "v": f"8*u-100*x-c*v{added}"},
        terms={"a": {}},
        parameters={"c": 0.4, **parameters},
        initial={"x": 0.0, "v": 0.0},
        inputs=("u", "q") if added.startswith("+F*q") else ("u",),
        force=FORCE,
        n=ROWS * FINER,
        fs=RATE * FINER,
        noise=0.0,
        citation="made for this study",
    )


def draw_record(kind: str, noise: float, seed: int) -> tuple[Record, dict[str, float], Parameters]:
    """A noisy record, its true coefficients and its parameters."""
    case, rng = CASES[kind], np.random.default_rng([seed, 1])
    parameters = dict(case.draw(rng))
    parameters["c"] = float(rng.uniform(0.3, 1.0))
    added, truth = case.added, dict(case.truth)
    if kind == "forms":
        which = int(rng.integers(len(FORMS)))
        added, truth = f"-F*{SIMULATED[which]}", {FORMS[which]: "-F"}
    system = oscillator(added, parameters)
    force = band_limited_noise(FORCE, system.n, system.fs, rng)[:, None]
    if kind in WAVES:
        force = np.column_stack([force, WAVES[kind](parameters["s"], np.arange(system.n) / system.fs)])
    clean = simulate(system, force=force).slice(None, None, FINER)
    own = np.random.default_rng([seed, 2])
    channels = {name: clean[name] + noise * clean[name].std() * own.standard_normal(ROWS) for name in "xvau"}
    values = {name: parameters[text.removeprefix("-")] * (-1.0 if text[0] == "-" else 1.0) if text else np.nan
              for name, text in truth.items()}  # fmt: skip
    true = {"x": -100.0, "v": -parameters["c"], "u": 8.0, **values}
    return Record.from_arrays(channels, fs=RATE), true, parameters


def kinetics(noise: float, seed: int) -> tuple[Record, dict[str, float], Parameters]:
    """Michaelis-Menten uptake with an inflow that is known exactly."""
    rng = np.random.default_rng([seed, 1])
    parameters = {"V": float(rng.uniform(0.6, 1.2)), "K": float(np.exp(rng.uniform(*np.log([0.15, 0.8]))))}
    system = System(
        name="kinetics",
        title="Michaelis-Menten kinetics",
        chains=("x",),
        rhs={"x": "u-V*x/(K+x)"},
        terms={"dx": {}},
        parameters=parameters,
        initial={"x": 1.0},
        inputs=("u",),
        n=4000,
        fs=100.0,
        noise=0.0,
        citation="made for this study",
    )
    t = np.arange(4000) / 100.0
    waves = sum(np.sin(rng.uniform(0.2, 2.0) * t + rng.uniform(0.0, 6.3)) for _ in range(4))
    clean = simulate(system, force=np.maximum(0.45 + 0.2 * waves, 0.0)).slice(None, None, 10)
    x = clean["x"] + noise * clean["x"].std() * np.random.default_rng([seed, 2]).standard_normal(400)
    record = Record.from_arrays({"x": x, "u": clean["u"]}, fs=10.0)
    return record, {"u": 1.0, "x/({K}+x)": -parameters["V"]}, parameters


def judged_with_constants(truth: Mapping[str, float], constants: Mapping[str, float], eqs: Equations) -> dict[str, Any]:
    """`judged` of one equation, with the errors of its constants, the verdict, and whether an either-or is open."""
    eq = eqs.equations[0]
    found = judged(eqs, {eq.target: truth})
    found["terms"] = {name: one for name, one in found["terms"].items() if one[0] == one[0]}
    for one in eq.shown_constants:
        if one.name in constants:
            value = constants[one.name]
            found["terms"][f"{{{one.name}}}"] = [one.value - value, one.sd, one.ci95[0] <= value <= one.ci95[1]]
    return {
        **found,
        "verdict": eqs.verdict.kind,
        "undecided": any(line.startswith("form undecided") for line in forms_of(eq)),
    }


def _measure(kind: str, chain: str, noise: float, seed: int) -> Outcome:
    if kind == "kinetics":
        record, truth, parameters = kinetics(noise, seed)
        constants = {"K": parameters["K"]}
        ask = partial(
            discover, record, chains="x", inputs=["u"], dictionary="x, x**2, x**3, u, x/({K}+x)", noise={"u": 0.0}
        )
    else:
        record, truth, parameters = draw_record(kind, noise, seed)
        case = CASES[kind]
        constants = {name: parameters[of] for name, of in case.constants.items()}
        dictionary = f"{case.beside}, {case.offered}"
        if chain == "x::":
            dictionary = dictionary.replace("v", "dx").replace("{dx", "{v")
            truth = {name.replace("v", "dx").replace("{dx", "{v"): value for name, value in truth.items()}
        ask = partial(discover, record, chains=chain, inputs=["u"], dictionary=dictionary)
    return timed(ask, partial(judged_with_constants, truth, constants))


def summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    """A line of the table."""
    answered = [one for one in outcomes if one["cpu"] is not None]
    covers = [bool(term[2]) for one in answered if one["exact"] for term in one["terms"].values()]
    inside = [bool(v[2]) for one in answered if one["exact"] for name, v in one["terms"].items() if name[0] == "{"]
    yield {
        "exact": sum(one["exact"] for one in outcomes),
        "exact_or_undecided": sum(one["exact"] or one.get("undecided", False) for one in outcomes),
        **verdicts(outcomes),
        "found_and_wrong": sum(
            one["verdict"] == "found" and not one["exact"] and not one["undecided"] for one in answered
        ),
        "intervals": len(covers),
        "coverage_percent": percent(sum(covers), len(covers)),
        "constants": len(inside),
        "constants_coverage_percent": percent(sum(inside), len(inside)),
        "errors": len(outcomes) - len(answered),
        "median_cpu_seconds": f"{np.median([one['cpu'] for one in answered]):.2f}" if answered else "",
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell(
            {"kind": kind, "chain": chain, "noise_percent": f"{100 * noise:g}"},
            RECORDS,
            partial(_measure, kind, chain, noise),
        )
        for kind in (*CASES, "kinetics")
        for chain in CHAINS.get(kind, ("x:v:a", "x::"))
        for noise in (0.02, 0.05)
    ]
    run_study("constants", "Terms with unknown constants: which are found, and how well.", cells, summary, arguments)


if __name__ == "__main__":
    main()
