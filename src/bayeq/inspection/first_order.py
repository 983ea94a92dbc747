"""First-order states, recognised by unit, name or time course, in records without a known motion."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import some_of
from bayeq.inspection.roles import INPUT, Clue, Guess, clue_of
from bayeq.records import Record
from bayeq.records.names import REVOLUTIONS

# Units of first-order states; names that are symbols of such states (v, a, x are motions).
UNITS = REVOLUTIONS | {"V", "mV", "kV", "uV", "µV", "A", "mA", "kA", "bar", "mbar", "%"}
CURRENTS = {"A", "mA", "kA"}
SYMBOLS = re.compile(r"([VUIT](_.*)?|[uin])(_?\d+)?")

# A channel only decays if the means of STRETCHES stretches never rise by more than UNEVEN of the first one, end at
# DECAYED of it or below, and, interpolated, leave at most LEFT of the variance.
STRETCHES, UNEVEN, DECAYED, LEFT = 16, 0.02, 0.8, 0.02

# A speed keeps its direction if a share ONE_WAY of its samples exceeds a share MOVING of the largest.
ONE_WAY, MOVING = 0.8, 0.1


def of_first_order(guess: Guess, clues: Mapping[str, Clue], record: Record) -> Guess:
    """The guess with first-order states, if it has no chains, or only that of a speed that needs no coordinate."""
    units, reasons, questions = record.units, dict(guess.reasons), list(guess.questions)
    speed = next((chain[1] for chain in guess.chains if chain[::2] == (None, None)), None)
    by_force = any(clues[name].by_unit for name in guess.inputs)
    if (guess.chains or by_force) if speed is None else len(guess.chains) > 1:
        return guess
    # names without a prefix that all share: u and i of meas_u and meas_i
    names = [*guess.undecided, *guess.inputs]
    shared = len(names) > 1 and len({name.rpartition("_")[0] for name in names}) == 1
    bare = {name: name.rpartition("_")[2] if shared else name for name in names}
    alike = [
        name
        for name in bare
        if (units[name] in UNITS if name in units else SYMBOLS.fullmatch(bare[name]) or SYMBOLS.fullmatch(name))
        and (name not in reasons or name in guess.inputs or (speed is None and clues[name].order == INPUT))
    ]
    if speed is not None and not guess.inputs and only_decays(record[speed]):
        reasons[speed] = f"{clues[speed].why}; it only decays and no force is known: its rate is what is sought"
    elif speed is not None and one_way(record[speed]):
        reasons[speed] = f"{clues[speed].why}; it hardly turns back, as nothing on a spring does: its rate is sought"
    elif speed is not None and units.get(speed) in REVOLUTIONS:
        reasons[speed] = f"{clues[speed].why}, a speed of rotation, whose rate is sought"
    elif speed is not None or not alike:
        return guess
    applied = [n for n in alike if n in guess.inputs or clue_of(bare[n], units.get(n, "")).order == INPUT]
    if speed is None and applied == alike:  # a current is the state, a voltage the input
        applied.remove(next((name for name in applied if units.get(name) in CURRENTS), applied[-1]))
    states = [name for name in alike if name not in applied]
    inputs = [*(name for name in guess.inputs if name not in (*states, *applied)), *applied]
    for name in alike:
        reasons[name] = f"its unit {units[name]}" if name in units else "its name"
    chains = [*([speed] if speed is not None else []), *states]
    questions += _questions(chains, applied, [name for name in alike if name not in units])
    return replace(
        guess,
        chains=tuple((name,) for name in chains),
        inputs=tuple(inputs),
        undecided=tuple(name for name in guess.undecided if name not in alike),
        reasons=reasons,
        questions=tuple(questions),
    )


def _questions(states: Sequence[str], applied: Sequence[str], unknown: Sequence[str]) -> list[str]:
    """Questions about other possible roles of the channels."""
    if len(states) + len(applied) < 2:
        return [f"{states[0]} is taken as of first order; if it is a motion: --disp, --vel or --acc {states[0]}"]
    out = [f"{some_of(unknown, 30)}: no unit is known; which are in V, A or rpm?"] if len(unknown) > 1 else []
    other = [f"--chain {name}" for name in applied] + [f"--input {name}" for name in states]
    if applied:
        out.append(f"what is applied is an input, what follows a state; the other way round: {' '.join(other)}")
    return out


def one_way(values: Floats) -> bool:
    """Whether a speed goes on in one direction nearly always.

    >>> t = np.linspace(0.0, 3.0, 200)
    >>> one_way(1.0 - np.exp(-t)), one_way(np.exp(-5.0 * t)), one_way(np.exp(-t) * np.cos(9.0 * t))
    (True, False, False)
    """
    forwards = values * np.sign(np.median(values))
    return bool(np.isfinite(values).all() and np.mean(forwards > MOVING * np.abs(values).max()) > ONE_WAY)


def only_decays(values: Floats) -> bool:
    """Whether a channel falls to zero, or part of the way, without turning back.

    >>> t = np.linspace(0.0, 3.0, 200)
    >>> only_decays(np.exp(-t)), only_decays(-np.exp(-t)), only_decays(np.exp(-t) * np.cos(9.0 * t))
    (True, True, False)
    """
    if len(values) < 4 * STRETCHES or not np.isfinite(values).all():
        return False
    values = values / (float(np.abs(values).max()) or 1.0)
    parts = np.array_split(np.arange(len(values)), STRETCHES)
    means = np.array([values[part].mean() for part in parts])
    size = abs(float(means[0]))
    falls = np.diff(means) * np.sign(means[0]) <= UNEVEN * size
    rest = values - np.interp(np.arange(len(values)), [part.mean() for part in parts], means)
    smooth = float(rest.var()) <= LEFT * float(values.var())
    return bool(falls.all()) and abs(float(means[-1])) <= DECAYED * size and smooth
