"""Tests whether periodic motion distinguishes the candidate terms (persistency of excitation, Ljung 1999).

In periodic motion, as of a structure under a steady sine, the states run along one closed curve again and again. The
record determines an equation on that curve only, where many terms are combinations of others: a = -omega^2 x holds for
every harmonic motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.expressions import Expression
from bayeq.expressions.functions import TIME
from bayeq.numerics.distributions import incomplete_beta
from bayeq.numerics.settings import SELECTION
from bayeq.states import Motion, MotionRows

# A harmonic counts if noise alone would make it with less than this probability.
CHANCE = 1e-3

# An input is not periodic if its harmonics leave more than this share of its variance.
MOST_NOISE = 0.5

# Number of frequencies tried within a line of the spectrum either way, then again and again in a narrower range.
FREQUENCIES, TIMES = 21, 4

# Deviations from the points of a map's cycle are at most this share of a state.
MOST_BESIDE = 0.5

# A map's cycle distinguishes its equation from others if it has this many more points than coefficients.
SPARE = 2

# Points of the closed curve; prior variance of a coefficient over that of the target, as in the record's likelihood.
POINTS, PRIOR = 720, 5.0


class Repeating(NamedTuple):
    """Periodic motion that does not distinguish the candidates."""

    frequency: float  # fundamental frequency [Hz], or per sample
    # rank of the candidates along the closed curve, as far as the noise shows; points of a map's cycle
    courses: int
    terms: int  # number of candidates
    single: bool = False  # whether the states have no other frequency


def repeating(motion: Motion, terms: Sequence[Expression]) -> Repeating | None:
    """The periodicity of a motion whose records all run along closed curves that do not distinguish the candidates, or
    of a map on a cycle of few points.

    None for other motion, and for terms that use the time.
    """
    drivers = motion.roles.inputs
    if not motion.timed or any(TIME in term.names for term in terms):
        return None
    if motion.roles.discrete:
        return _cycle(motion, len(terms))
    curves, frequency, noise, single = [], 0.0, math.inf, True
    for rows in motion.train:
        found = _closed_curve(rows, motion.roles.states, drivers, motion.roles.targets)
        if found is None:
            return None
        curve, frequency, share, alone = found
        single &= alone
        curves.append(evaluate_terms(list(terms), curve))
        noise = min(noise, share / rows.n)
    columns = np.concatenate(curves)
    columns = columns - columns.mean(axis=0)
    spread = columns.std(axis=0)
    known = np.isfinite(spread) & (spread > 0.0)
    unit = columns[:, known] / spread[known]
    # a combination of candidates counts if the target would show it above its noise
    values = np.linalg.eigvalsh(unit.T @ unit / len(unit))
    courses = int((values > noise / PRIOR).sum())
    return None if courses >= len(terms) else Repeating(frequency, courses, len(terms), single)


def _cycle(motion: Motion, terms: int) -> Repeating | None:
    """The shortest cycle that all states and inputs of a map are on, of at most as many points as it has `terms` and
    spare ones; what is beside the points is noise if the next sample does not follow it."""
    names = [*motion.roles.states, *motion.roles.inputs]
    pieces = [np.column_stack([rows.columns[name] for name in names]) for rows in motion.train]
    spread = np.concatenate(pieces).std(axis=0)
    for period in range(2, terms + SPARE + 1):
        if min(map(len, pieces)) < SELECTION.least_periods * period:
            return None
        beside, follows = [], 0.0
        for values in pieces:
            for phase in range(period):
                here, after = values[phase::period], values[phase + 1 :: period]
                beside.append(here - here.mean(axis=0))
                with np.errstate(invalid="ignore", divide="ignore"):  # nothing is beside the points
                    both = np.nan_to_num(np.corrcoef(here[: len(after)], after, rowvar=False))
                follows = max(follows, len(after) * float((both[: len(names), len(names) :] ** 2).max()))
        share = np.concatenate(beside).std(axis=0) / spread
        on_points = bool((share <= SELECTION.transient).all())
        if on_points or ((share < MOST_BESIDE).all() and follows < -2.0 * math.log(SELECTION.not_noise)):
            return Repeating(1.0 / period, period, terms)
    return None


def _closed_curve(
    rows: MotionRows, states: Sequence[str], inputs: Sequence[str], targets: Sequence[str]
) -> tuple[dict[str, Floats], float, float, bool] | None:
    """States, inputs and targets along the curve, its frequency [Hz], the least noise variance of a target over its
    variance, and whether the states have no higher harmonics; None if the motion is not periodic."""
    assert rows.time is not None
    if rows.n < 8 * SELECTION.least_periods:
        return None
    time = rows.time - rows.time[0]
    step = float(np.median(np.diff(time)))
    if np.abs(np.diff(time) - step).max() > 0.01 * step:
        return None
    names = [*states, *inputs, *targets]
    samples = {name: np.asarray(rows.samples.get(name, rows.columns[name]), dtype=np.float64) for name in names}
    samples = {name: np.where(np.isfinite(one), one, rows.columns[name]) for name, one in samples.items()}
    moving = (samples[name] for name in (*states, *inputs))
    frequency = _frequency(time, np.column_stack([(one - one.mean()) / (one.std() or 1.0) for one in moving]))
    if frequency is None:
        return None
    curve: dict[str, Floats] = {}
    noise, single = math.inf, True
    phases = np.linspace(0.0, 1.0 / frequency, POINTS, endpoint=False)
    for name, values in samples.items():
        harmonics = max(1, min(SELECTION.harmonics, int(0.25 / (step * frequency))))
        design = _harmonics(time, frequency, harmonics)
        coef = np.linalg.lstsq(design, values, rcond=None)[0]
        left = values - design @ coef
        if name in inputs and left.var() > MOST_NOISE * values.var():
            return None
        beside = name in rows.samples and not _is_noise(left, step, frequency * (harmonics + 0.5))
        if beside and left.std() > SELECTION.transient * values.std():
            return None
        level = float(left.var()) * len(values) / max(len(values) - len(coef), 1)
        power = 0.5 * len(values) * (coef[1::2] ** 2 + coef[2::2] ** 2)
        weak = np.repeat(power < -2.0 * math.log(CHANCE) * level, 2)
        coef[1:][weak] = 0.0
        curve[name] = _harmonics(phases, frequency, harmonics) @ coef
        single &= name not in states or not coef[3:].any()
        if name in targets:
            noise = min(noise, level / max(float(values.var()), 1e-300))
    return curve, frequency, noise, single


def _frequency(time: Floats, columns: Floats) -> float | None:
    """The frequency [Hz] whose harmonics explain most of the columns; None for too few periods, or samples in one."""
    n, length = len(time), float(time[-1]) * len(time) / (len(time) - 1)
    power = (np.abs(np.fft.rfft(columns, axis=0)) ** 2).sum(axis=1)
    power[0] = 0.0
    peak = int(np.argmax(power))
    if peak < SELECTION.least_periods or peak > n // 8:
        return None

    def left(frequency: float) -> float:
        """The sum of squares that three harmonics leave, less that of the columns."""
        design = _harmonics(time, frequency, 3)
        products = design.T @ columns
        return -float((products * np.linalg.solve(design.T @ design, products)).sum())

    best, width = peak / length, 1.0 / length
    for _ in range(TIMES):
        tried = best + width * np.linspace(-1.0, 1.0, FREQUENCIES)
        best = float(tried[np.argmin([left(f) for f in tried.tolist()])])
        width /= 0.25 * FREQUENCIES
    return best


def _harmonics(time: Floats, frequency: float, count: int) -> Floats:
    """Design matrix: a constant, then cosine and sine of every harmonic."""
    design, first = np.ones((1 + 2 * count, len(time))), np.exp(2j * np.pi * frequency * time)
    turned = first
    for k in range(count):
        design[1 + 2 * k], design[2 + 2 * k] = turned.real, turned.imag
        turned = turned * first
    return design.T


def _is_noise(left: Floats, step: float, below: float) -> bool:
    """Whether the residual of a channel has no more power below a frequency [Hz] than white noise has."""
    power = np.abs(np.fft.rfft(left)[1 : (len(left) + 1) // 2]) ** 2
    frequencies = np.arange(1, len(power) + 1) / (len(left) * step)
    inside = int((frequencies < below).sum())
    if inside < 8 or inside > len(power) - 8 or not power.sum() > 0.0:
        return True
    share = float(power[:inside].sum() / power.sum())
    return 1.0 - incomplete_beta(inside, len(power) - inside, share) > SELECTION.not_noise
