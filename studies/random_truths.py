"""Oscillators with terms drawn at random: are the probabilities and intervals of the default pipeline right?

A unit mass on a spring under the paper's force, with none to three further terms of the 36 and coefficients that give
each a share of the acceleration, log-uniform, in the motion of the mass on the spring alone; drawn again until the
motion is stable, not held by friction, and resolved by the integration and the samples. 4,000 rows at 1 kHz, noise on
displacement, velocity, acceleration and force, all rows used. "auto": terms of 1 to 55 % of the standard deviation, 5 %
noise; "weak": one to three terms without jumps of 0.05 to 40 %, noise log-uniform from 0.5 to 10 %; "signs": the same,
one of them with a jump; "::a", ":v:", ":v:a": as "auto", with these channels and the force alone. Lines of the table:
candidates by their posterior inclusion probability, with the share of them that is true and its standard error (records
are the units of chance); the terms above 0.99; and the intervals of included terms, and those that are printed of the
terms shown, those of false terms among them, which ought to cover zero. An answer is right if it shows no false term,
and every true one or a bound that it is below.

    python -m studies.random_truths > docs/tables/random_truths.csv
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.errors import InputError
from bayeq.expressions import parse
from bayeq.expressions.nodes import jumps_of
from bayeq.records import Record
from bayeq.states import parse_chain
from bayeq.systems import simulate
from bayeq.systems.system import BandLimitedForce, System
from studies.judge import timed
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["draw_record", "draw_system", "main"]

Floats = NDArray[np.float64]

RECORDS = 300
ROWS, RATE = 4000, 1000.0
SUBSTEPS = 4
STIFFNESS, DAMPING = 1000.0, 2.0
FORCE = BandLimitedForce(50.0, (0.0, 100.0))


@dataclass(frozen=True)
class Kind:
    """Numbers of further terms; the share of the acceleration's standard deviation that each is to have; noise.

    `signs`: whether one of them jumps, or none; None for any. `chain`: what is measured of the motion.
    """

    terms: tuple[int, int] = (0, 3)
    share: tuple[float, float] = (0.01, 0.55)
    noise: tuple[float, float] = (0.05, 0.05)
    signs: bool | None = None
    chain: str = "x:v:a"


WEAK = Kind((1, 3), (0.0005, 0.4), (0.005, 0.1), False)
KINDS = {"auto": Kind(), "weak": WEAK, "signs": replace(WEAK, signs=True)}
KINDS |= {chain: Kind(chain=chain) for chain in ("::a", ":v:", ":v:a")}

# Motion further than this multiple of that of the mass on the spring is not stable.
MOST_RANGE = 5.0

# Motion whose velocity changes its sign in a larger share of the samples is held by friction: there the acceleration is
# what the integration's steps make of a jump.
MOST_CHANGES = 0.1

# Steps this many times smaller change the motion by no more than this share of the noise, else it is not what the
# equation says; velocities are those of the sampled accelerations to this share of their standard deviation.
FINER, SAME, SAMPLED = 8, 0.1, 0.05

BINS = np.linspace(0.0, 1.0, 11)
CERTAIN = 0.99


def _system(coefficients: Mapping[str, float], noise: float = 0.0) -> System:
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
        noise=noise,
        substeps=SUBSTEPS,
        citation="none",
    )


def draw_system(seed: int, kind: Kind) -> System:
    """An oscillator whose clean motion under the force of the same seed is stable."""
    rng = np.random.default_rng([seed, 1])
    noise = float(np.exp(rng.uniform(*np.log(kind.noise))))
    alone = simulate(_system({"x": -STIFFNESS, "v": -DAMPING, "u": 1.0}), seed=seed, noise=0.0)
    terms = [
        term for term in build_dictionary("oscillator", Variables(("x", "v"), ("u",))) if term.text not in ("x", "u")
    ]
    spread = evaluate_terms(terms, {name: alone[name] for name in ("x", "v", "u")}).std(axis=0) / alone["a"].std()
    jumps = np.array([any(True for _ in jumps_of(term.tree)) for term in terms])
    while True:
        chosen = rng.choice(len(terms), size=rng.integers(*kind.terms, endpoint=True), replace=False)
        if kind.signs is not None and jumps[chosen].sum() != kind.signs:
            continue
        shares = np.exp(rng.uniform(*np.log(kind.share), len(chosen)))
        values = rng.choice([-1.0, 1.0], len(chosen)) * shares / spread[chosen]
        found = {"x": -STIFFNESS, "u": 1.0} | {terms[j].text: float(v) for j, v in zip(chosen, values, strict=True)}
        system = _system(found, noise)
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
        if np.std(finer[name] - clean[name]) > SAME * system.noise * clean[name].std():
            return False
    missed = np.diff(clean["v"]) - 0.5 / RATE * (clean["a"][1:] + clean["a"][:-1])
    return bool(np.sqrt(np.mean(missed**2)) < SAMPLED * clean["v"].std())


def draw_record(seed: int, kind: Kind) -> Record:
    """A noisy record of the oscillator of that seed."""
    return simulate(draw_system(seed, kind), seed=seed)


def _judged(eqs: Equations, truth: Mapping[str, float]) -> dict[str, object]:
    (eq,) = eqs
    pip, support, shown = eq.posterior.pip, eq.posterior.support, eq.shown_posterior.support
    true = [truth.get(term.text, 0.0) for term in eq.terms]

    def covers(ci: Floats, kept: Sequence[bool]) -> list[bool]:
        return [low <= value <= high for (low, high), value, k in zip(ci.tolist(), true, kept, strict=True) if k]

    shown_true = dict(zip((term.text for term in eq.terms), true, strict=True))
    unseen = {name: value for name, value in truth.items() if name not in eq.shown}
    limits = np.full(len(eq.terms), np.nan) if eq.bound is None else eq.bound
    bound = dict(zip((term.text for term in eq.terms), np.nan_to_num(limits).tolist(), strict=True))
    return {
        "right": all(shown_true[name] for name in eq.shown)
        and all(abs(value) <= bound.get(name, 0.0) for name, value in unseen.items()),
        "unseen": len(unseen),
        "below": sum(abs(value) <= bound.get(name, 0.0) for name, value in unseen.items()),
        "pips": [[round(float(p), 6), value != 0.0] for p, value in zip(pip, true, strict=True)],
        "covers": covers(eq.ci95, support.tolist()),
        "printed": covers(eq.printed_ci95, shown.tolist()),
        "exact": set(eq.included) == set(truth),
        "verdict": eq.verdict.kind,
    }


def _renamed(term: str, names: Mapping[str, str]) -> str:
    """A term with other names of the states."""
    return parse(re.sub(r"\b[xv]\b", lambda found: names[found[0]], term)).text


def _measure(kind: Kind, seed: int) -> Outcome:
    record = draw_record(seed, kind)
    assert record.truth is not None
    chain = parse_chain(kind.chain)
    names = {"x": chain.names[0], "v": chain.names[1]}
    truth = {_renamed(term, names): value for term, value in record.truth.coefficients["a"].items()}
    measured = {name: record[name] for name in (*filter(None, chain.measured), "u")}
    seen = Record.from_arrays(measured, time=record.time)
    fit = partial(discover, seen, chains=[kind.chain], inputs=["u"], holdout=0.0)
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
    unseen = sum(int(outcome["unseen"]) for outcome in known)
    below = sum(int(outcome["below"]) for outcome in known)
    yield {
        "line": "true terms not shown, below their bound, per cent",
        "count": unseen,
        "found": percent(below, unseen),
    }
    for kind in sorted({str(outcome["verdict"]) for outcome in known}):
        some = [outcome for outcome in known if outcome["verdict"] == kind]
        yield {
            "line": f"of verdict {kind}: exactly the true terms, per cent",
            "count": len(some),
            "found": percent(sum(bool(outcome["exact"]) for outcome in some), len(some)),
        }
        yield {
            "line": f"of verdict {kind}: right, per cent",
            "count": len(some),
            "found": percent(sum(bool(outcome["right"]) for outcome in some), len(some)),
        }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [Cell({"method": name}, RECORDS, partial(_measure, kind)) for name, kind in KINDS.items()]
    run_study(
        "random_truths", "Probabilities and intervals where terms are drawn at random.", cells, _summary, arguments
    )


if __name__ == "__main__":
    main()
