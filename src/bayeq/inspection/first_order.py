"""Channels that are states of first order for their unit, name or course, where no motion is known among them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import some_of
from bayeq.inspection.roles import INPUT, Clue, Guess, clue_of
from bayeq.records import Record

# Speeds of rotation; electrical quantities, pressures and shares, of which no inertia is known. Symbols of these as
# names without a unit, of which v, a or x are none.
ROTATION = {"rpm", "1/min", "U/min", "min^-1"}
UNITS = ROTATION | {"V", "mV", "kV", "uV", "µV", "A", "mA", "kA", "bar", "mbar", "%"}
SYMBOLS = re.compile(r"([VUIT](_.*)?|[uin])(_?\d+)?")

# A channel only decays where means over this many stretches fall, but for a share of the first one, to this share of it
# or less, and leave less of its variance than this.
STRETCHES, UNEVEN, DECAYED, LEFT = 16, 0.02, 0.8, 0.02


def of_first_order(guess: Guess, clues: Mapping[str, Clue], record: Record) -> Guess:
    """The same with states of first order where there are no coordinates, or a speed alone that needs none."""
    units = record.units
    speed = next((chain[1] for chain in guess.chains if chain[::2] == (None, None)), None)
    reasons, questions = dict(guess.reasons), list(guess.questions)
    if guess.chains and (speed is None or len(guess.chains) > 1):
        return guess
    bare = _without_prefix([*guess.undecided, *guess.inputs])
    alike = [n for n in bare if units.get(n) in UNITS or (n not in units and SYMBOLS.fullmatch(bare[n]))]
    states = [name for name in alike if name in guess.undecided and name not in reasons]
    if speed is not None:
        if not guess.inputs and only_decays(record[speed]):
            reasons[speed] = f"{clues[speed].why}; it only decays and no force is known: its rate is what is sought"
        elif units.get(speed) in ROTATION:
            reasons[speed] = f"{clues[speed].why}, a speed of rotation, whose rate is sought"
        else:
            return guess
    driving = [name for name in states if clue_of(bare[name], units.get(name, "")).order == INPUT]
    if len(driving) == len(states) and speed is None:
        driving = driving[:-1]
        states = states or [name for name in guess.inputs if len(alike) == 1 and name in alike]
    inputs = [*(name for name in guess.inputs if name not in states), *driving]
    states = [name for name in states if name not in driving]
    if not states and speed is None:
        return guess
    for name in (*states, *driving):
        reasons[name] = f"its unit {units[name]}" if name in units else "its name"
    unknown = [name for name in (*states, *driving) if name not in units]
    if len(unknown) > 1:
        questions.append(
            f"{some_of(unknown, 30)} have no units: which are in V, A or rpm? What is applied is an --input, what it"
            " drives a --chain"
        )
    if states:
        one = states[0]
        questions.append(f"{one} is taken as of first order; if it is a motion: --disp, --vel or --acc {one}")
    chains = tuple((name,) for name in (*([speed] if speed else []), *states))
    undecided = tuple(name for name in guess.undecided if name not in (*states, *driving))
    return replace(
        guess, chains=chains, inputs=tuple(inputs), undecided=undecided, reasons=reasons, questions=tuple(questions)
    )


def _without_prefix(names: Sequence[str]) -> dict[str, str]:
    """Names without what stands before the last underscore in all: u and i of meas_u and meas_i."""
    shared = len(names) > 1 and len({name.rpartition("_")[0] for name in names}) == 1
    return {name: name.rpartition("_")[2] if shared else name for name in names}


def only_decays(values: Floats) -> bool:
    """Whether a channel falls to zero, or part of the way, without turning back.

    Examples
    --------
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
