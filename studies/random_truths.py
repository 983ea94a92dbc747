"""Oscillators with terms drawn at random: are the probabilities and intervals of the default pipeline right?

A unit mass on a spring under the paper's force, with none to three further terms of the 36 and coefficients that give
each a share of the acceleration's variance, log-uniform from 1e-4 to 0.3, in the motion of the mass on the spring
alone; drawn again until the motion is stable, not held by friction, and resolved by the integration and the samples.
4,000 rows at 1 kHz, 5 % noise on displacement, velocity, acceleration and force, all rows used. Lines of the table:
candidates by their posterior inclusion probability, with the share of them that is true and its standard error
(records are the units of chance); the terms above 0.99; and the intervals of included terms, and those that are
printed of the terms shown, those of false terms
among them, which ought to cover zero.

    python -m studies.random_truths > docs/tables/random_truths.csv
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.errors import InputError
from bayeq.records import Record
from bayeq.states import Smooth
from bayeq.systems import simulate
from bayeq.systems.force import BandLimitedForce
from bayeq.systems.system import System
from studies.judge import timed
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["draw_record", "draw_system", "main"]

Floats = NDArray[np.float64]

RECORDS = 300
ROWS, RATE, NOISE = 4000, 1000.0, 0.05
SUBSTEPS = 4
STIFFNESS, DAMPING = 1000.0, 2.0
FORCE = BandLimitedForce(50.0, (0.0, 100.0))

# Further terms, and the share of the acceleration's variance that each is to have.
MOST_MORE = 3
LEAST_SHARE, MOST_SHARE = 1e-4, 0.3

# Motion further than this multiple of that of the mass on the spring is not stable.
MOST_RANGE = 5.0

# Motion whose velocity changes its sign in a larger share of the samples is held by friction: there the acceleration is
# what the integration's steps make of a jump.
MOST_CHANGES = 0.1

# Steps this many times smaller change the motion by no more than this share of the noise, else it is not what the
# equation says.
FINER, SAME = 8, 0.1

BINS = np.linspace(0.0, 1.0, 11)
CERTAIN = 0.99


def _system(coefficients: Mapping[str, float]) -> System:
    law = "+".join(f"({value!r})*({term})" for term, value in coefficients.items())
    return System(
        name="random",
        title="An oscillator of random terms",
        chains=("x:v:a",),
        rhs={"x": "v", "v": law},
        terms={"a": {term: repr(value) for term, value in coefficients.items()}},
        parameters={},
        initial={"x": 0.0, "v": 0.0},
        inputs=("u",),
        force=FORCE,
        n=ROWS,
        fs=RATE,
        noise=NOISE,
        substeps=SUBSTEPS,
        citation="none",
    )


def draw_system(seed: int) -> System:
    """An oscillator whose clean motion under the force of the same seed is stable."""
    rng = np.random.default_rng([seed, 1])
    alone = simulate(_system({"x": -STIFFNESS, "v": -DAMPING, "u": 1.0}), seed=seed, noise=0.0)
    terms = [
        term for term in build_dictionary("oscillator", Variables(("x", "v"), ("u",))) if term.text not in ("x", "u")
    ]
    spread = evaluate_terms(terms, {name: alone[name] for name in ("x", "v", "u")}).std(axis=0) / alone["a"].std()
    while True:
        chosen = rng.choice(len(terms), size=rng.integers(0, MOST_MORE, endpoint=True), replace=False)
        shares = np.exp(rng.uniform(np.log(LEAST_SHARE), np.log(MOST_SHARE), len(chosen)))
        values = rng.choice([-1.0, 1.0], len(chosen)) * np.sqrt(shares) / spread[chosen]
        found = {"x": -STIFFNESS, "u": 1.0} | {terms[j].text: float(v) for j, v in zip(chosen, values, strict=True)}
        system = _system(found)
        try:
            clean = simulate(system, seed=seed, noise=0.0)
        except InputError:  # it diverges
            continue
        moves = np.mean(np.diff(np.signbit(clean["v"]))) < MOST_CHANGES
        if (
            moves
            and np.abs(clean["x"]).max() < MOST_RANGE * np.abs(alone["x"]).max()
            and _resolved(system, clean, seed)
        ):
            return system


def _resolved(system: System, clean: Record, seed: int) -> bool:
    """Whether the motion is that of the equation, and of its samples: much smaller steps of integration hardly change
    it, and the trapezoidal rule takes the accelerations sampled to the velocities to within the noise."""
    try:
        finer = simulate(replace(system, substeps=FINER * SUBSTEPS), seed=seed, noise=0.0)
    except InputError:  # it diverges
        return False
    for name in ("x", "v"):
        if np.std(finer[name] - clean[name]) > SAME * NOISE * clean[name].std():
            return False
    missed = np.diff(clean["v"]) - 0.5 / RATE * (clean["a"][1:] + clean["a"][:-1])
    return bool(np.sqrt(np.mean(missed**2)) < NOISE * clean["v"].std())


def draw_record(seed: int) -> Record:
    """A noisy record of the oscillator of that seed."""
    return simulate(draw_system(seed), seed=seed)


def _judged(eqs: Equations, truth: Mapping[str, float]) -> dict[str, object]:
    (eq,) = eqs
    pip, support, shown = eq.posterior.pip, eq.posterior.support, eq.shown_posterior.support
    true = [truth.get(term.text, 0.0) for term in eq.terms]

    def covers(ci: Floats, kept: Sequence[bool]) -> list[bool]:
        return [low <= value <= high for (low, high), value, k in zip(ci.tolist(), true, kept, strict=True) if k]

    return {
        "pips": [[round(float(p), 6), value != 0.0] for p, value in zip(pip, true, strict=True)],
        "covers": covers(eq.ci95, support.tolist()),
        "printed": covers(eq.printed_ci95, shown.tolist()),
        "exact": set(eq.included) == set(truth),
        "verdict": eq.verdict.kind,
    }


def _measure(smooth: Smooth, seed: int) -> Outcome:
    record = draw_record(seed)
    assert record.truth is not None
    truth = record.truth.coefficients["a"]
    fit = partial(
        discover,
        record,
        displacement="x",
        velocity="v",
        acceleration="a",
        force="u",
        smooth=smooth,
        holdout=0.0,
    )
    return timed(fit, lambda eqs: _judged(eqs, truth))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    known = [outcome for outcome in outcomes if "pips" in outcome]
    pips = [np.array([p for p, _ in outcome["pips"]]) for outcome in known]
    true = [np.array([t for _, t in outcome["pips"]]) for outcome in known]
    for low, high in pairwise(BINS.tolist()):
        inside = [(p >= low) & ((p < high) | (high == 1.0)) for p in pips]
        count = sum(int(i.sum()) for i in inside)
        if not count:
            continue
        stated = sum(float(p[i].sum()) for p, i in zip(pips, inside, strict=True)) / count
        share = sum(int(t[i].sum()) for t, i in zip(true, inside, strict=True)) / count
        # records are drawn independently, terms of one are not
        errors = [float((t[i] - share).sum()) for t, i in zip(true, inside, strict=True)]
        yield {
            "line": f"PIP {low:.1f} to {high:.1f}",
            "count": count,
            "stated": f"{stated:.4f}",
            "found": f"{share:.4f}",
            "se": f"{np.sqrt(np.sum(np.square(errors))) / count:.4f}",
        }
    certain = [p > CERTAIN for p in pips]
    yield {
        "line": f"false above PIP {CERTAIN}",
        "count": sum(int(c.sum()) for c in certain),
        "stated": f"{sum(float((1.0 - p[c]).sum()) for p, c in zip(pips, certain, strict=True)):.2f}",
        "found": sum(int((c & ~t).sum()) for c, t in zip(certain, true, strict=True)),
    }
    lines = {
        "intervals of included terms given these, per cent": ("covers", known),
        "printed intervals of terms shown, per cent": ("printed", known),
        "those of verdict found, per cent": ("printed", [one for one in known if one["verdict"] == "found"]),
    }
    for line, (name, some) in lines.items():
        covers = [bool(c) for outcome in some for c in outcome[name]]
        yield {"line": line, "count": len(covers), "stated": "95", "found": percent(sum(covers), len(covers))}
    yield {
        "line": "exactly the true terms, per cent",
        "count": len(known),
        "found": percent(sum(bool(outcome["exact"]) for outcome in known), len(known)),
    }
    for kind in sorted({str(outcome["verdict"]) for outcome in known}):
        some = [outcome for outcome in known if outcome["verdict"] == kind]
        yield {
            "line": f"of verdict {kind}: exactly the true terms, per cent",
            "count": len(some),
            "found": percent(sum(bool(outcome["exact"]) for outcome in some), len(some)),
        }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [Cell({"method": smooth}, RECORDS, partial(_measure, smooth)) for smooth in ("auto", "band")]
    run_study(
        "random_truths", "Probabilities and intervals where terms are drawn at random.", cells, _summary, arguments
    )


if __name__ == "__main__":
    main()
