"""Starts of fits: samples, scales, priors, noise levels of the inputs, and the smoothed motion as the path."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import evaluate_terms
from bayeq.expressions import Expression
from bayeq.inference.collapsed.slab import likeliest_by_rows
from bayeq.inference.gram import Gram
from bayeq.likelihood.fit import State, adjoints, linearised, maximised
from bayeq.likelihood.layout import NOTHING, Candidates, Course, Layout, Series, Stated
from bayeq.likelihood.levels import LEAST_COURSE, LEAST_NOISE, Levels, Scales
from bayeq.likelihood.low_pass import Spectrum, mean_spectrum, spectrum_of, step_variance
from bayeq.likelihood.model import Fitted, Task
from bayeq.likelihood.search import Start
from bayeq.likelihood.steps import Flows
from bayeq.likelihood.unequal import in_proportion
from bayeq.numerics.rk4 import interpolant, with_time
from bayeq.numerics.settings import LIKELIHOOD
from bayeq.states import Motion, MotionRows, Roles

# Noise of channels at first, as a share of their variance.
FIRST_NOISE = 1e-3

# Numbers of an input's derivatives that are states: 0 for a random sequence joined by straight lines, else smooth.
# INPUT_ROWS samples of a record decide at first. Below eight samples per period a cubic course errs by more than the
# noise of a good record, which a course of degree five does not. Below five, where the corner of such a course is above
# CORNER, two more degrees do better (docs/tables/few_samples.csv) at a tenth of a fit's time.
SMOOTHNESS = (0, 1, 2, 3, 4, 5)
SMOOTHEST, CORNER = 7, 1.1  # corner [rad per sample]
INPUT_ROWS = 2000

# Courses between samples that are tried for any input, and those that are tried only for a random sequence.
OTHERWISE: tuple[Course, ...] = ("linear", "hold")
BENT: tuple[Course, ...] = ("cubic", "band-limited")

# Number of stretches in which long records are searched at first.
STRETCHES = 4

# Standard deviation of a tie as a share of that of its first coefficient's prior; log odds of that one alone: -ALONE.
TIED, ALONE = 1e-6, 3.0

# Bounds of the first value of the discrepancies' memory, which is the lag-1 correlation of the target.
LEAST_MEMORY, MOST_MEMORY = 0.05, 0.99


def start_from(
    motion: Motion,
    terms: Sequence[Expression],
    grams: Sequence[Gram],
    log_odds: Floats,
    tolerance: float | None,
    stated: tuple[Stated, ...] = (),
    conserved: Mapping[int, float] | None = None,
) -> tuple[Task, tuple[Start, ...]]:
    """The task of a dictionary on the training rows of a motion, and the starts of its fits.

    These are the regression of the smoothed rows, whose number of terms is halved until a fit can begin from it, and
    the motion with only stated laws. Arguments are those of `bayeq.likelihood.record_fit.fit_record`.
    """
    roles, pieces = motion.roles, motion.train
    known = _known_noise(motion)
    inputs = [_input(name, pieces, known.get(name), SMOOTHNESS) for name in roles.inputs]
    layout = _with_inputs(Layout(roles, tuple(terms), motion.unit_gains, drift=_drift(motion)), inputs)
    sensors, numbers = motion.sensors, {name: i for i, (name, _) in enumerate(layout.channels)}
    layout = replace(
        layout,
        late=tuple((i, sensors.lags[name]) for name, i in numbers.items() if name in sensors.lags),
        uncertain=tuple((i, sensors.gain(name)) for name, i in numbers.items() if sensors.gain_sd.get(name)),
    )
    series = tuple(_series(layout, rows) for rows in pieces)
    paths = tuple(_path(layout, rows, [one.paths[i] for one in inputs]) for i, rows in enumerate(pieces))
    readings = [np.column_stack([rows.columns[name] for name, _ in layout.channels]) for rows in pieces]
    series = in_proportion(layout, motion.sensors, series, readings)
    targets = _targets(roles, pieces)
    scales = _scales(layout, paths, targets.var(axis=0), series, _interval([one.intervals for one in series]))
    noise = FIRST_NOISE * scales.channels
    noise[len(noise) - len(inputs) :] = [one.noise for one in inputs]
    held = _set_known(noise, layout, scales, known)
    lag1 = [np.corrcoef(column[:-1], column[1:])[0, 1] for column in targets.T]
    levels = Levels(
        layout,
        scales,
        noise,
        scales.variance[layout.discrepancy],
        np.clip(lag1, LEAST_MEMORY, MOST_MEMORY),
        np.array([one.slope for one in inputs]),
        np.full(len(inputs), LIKELIHOOD.first_course),
        noise[: len(layout.drifts)],
        held=held,
    )
    precision, odds = precision_of_terms(motion, layout), log_odds.ravel().copy()
    of_law = np.repeat([chain.stated for chain in roles.chains], len(terms) + 1)
    laws = np.flatnonzero(of_law & (odds == np.inf))
    empty = State(layout.everything.take(laws), np.ones(len(laws)), paths, levels)
    ties, flows = [_tied(one, layout, precision, odds) for one in stated], None
    if conserved:
        flows = Flows(conserved, len(log_odds), len(terms) + 1)
        ties += flows.ties(precision)
    layout = replace(layout, stated=tuple(ties))
    empty = replace(empty, levels=replace(levels, layout=layout))
    task = Task(layout, series, precision, odds, tolerance=tolerance, flows=flows)
    first = _by_rows(task, empty, grams)
    halves = (len(first.theta) >> k for k in range(1, len(first.theta).bit_length()))
    return task, ((first, *(partial(_by_rows, task, empty, grams, most) for most in halves)), empty)


def _tied(stated: Stated, layout: Layout, precision: Floats, odds: Floats) -> Stated:
    """A tie as a sum that is known to TIED; the log odds of the first of its coefficients are raised to allow for this.

    The prior probability that the tie holds to TIED of a prior's standard deviation is about TIED, which these odds
    compensate. Without the others the first coefficient must be zero: odds of 1/20 are left for it.
    """
    if stated.sd > 0.0:
        return stated
    c, j, factor = stated.parts[0]
    first = c * (len(layout.terms) + 1) + j
    if odds[first] > -math.inf:
        odds[first] = -math.log(TIED) - ALONE
    return stated._replace(sd=TIED * abs(factor) / math.sqrt(float(precision[first])))


def _known_noise(motion: Motion) -> dict[str, float]:
    """Known standard deviations of the noise of channels: 0 for inputs that are constant in every record."""
    still = {
        name: 0.0 for name in motion.roles.inputs if all(np.ptp(rows.columns[name]) == 0.0 for rows in motion.records)
    }
    return still | dict(motion.sensors.noise)


def _set_known(noise: Floats, layout: Layout, scales: Scales, known: Mapping[str, float]) -> Bools:
    """Puts the known noise of channels into the variances `noise`, (M,); returns which channels these are."""
    held = np.array([name in known for name, _ in layout.channels])
    for i in np.flatnonzero(held):
        noise[i] = max(known[layout.channels[i][0]] ** 2, LEAST_NOISE * scales.channels[i])
    return held


def start_of_runs(motion: Motion, terms: Sequence[Expression], course: Course) -> tuple[Task, State]:
    """Start of free runs of the terms of all equations: inputs are exact and of one course, no term is in the model,
    and discrepancies have the variances of the targets and hardly any memory, until the caller sets them."""
    roles, count = motion.roles, len(motion.roles.inputs)
    bare = Layout(
        roles, tuple(terms), motion.unit_gains, (0,) * count, (0.0,) * count, (0.0,) * count, (course,) * count
    )
    series, paths = series_and_paths(bare, motion.train)
    for one, path in zip(series, paths, strict=True):
        path[:-1, bare.slope] = np.diff(path[:, bare.driven], axis=0) / one.intervals[:, None]
    interval = _interval([one.intervals for one in series])
    scales = _scales(bare, paths, _targets(roles, motion.train).var(axis=0), series, interval)
    layout = replace(bare, centres=tuple(scales.mean[bare.driven].tolist()))
    known, noise = motion.sensors.noise, FIRST_NOISE * scales.channels
    noise[layout.first_input :] = LEAST_NOISE * scales.channels[layout.first_input :]
    held = _set_known(noise, layout, scales, {name: known[name] for name in known if name not in roles.inputs})
    held[layout.first_input :] = True
    target = scales.variance[layout.discrepancy]
    slope = scales.variance[layout.driven] / interval**2
    memory, exact = np.full(layout.chains, LEAST_MEMORY), np.full(count, LEAST_COURSE)
    levels = Levels(layout, scales, noise, target, memory, slope, exact, np.zeros(0), held=held)
    precision = precision_of_terms(motion, layout)
    task = Task(layout, series, precision, np.zeros(len(precision)))
    return task, State(NOTHING, np.zeros(0), paths, levels)


def _by_rows(task: Task, empty: State, grams: Sequence[Gram], most: float = math.inf) -> State:
    """A start from the likeliest regression of each equation's smoothed rows, of `most` terms at most; in maps with the
    constant, without which noise would explain samples far from zero."""
    chains, terms, theta, left = [], [], [], []
    for c, gram in enumerate(grams):
        model, coef = likeliest_by_rows(gram, task.allowed[c], most)
        index = np.flatnonzero(model)
        chains += [c] * len(index)
        terms += index.tolist()
        theta += coef[model].tolist()
        if empty.levels.layout.discrete:
            chains.append(c)
            terms.append(task.allowed.shape[1])
            theta.append(float(gram.target_mean - gram.mean @ coef))
        left.append(min(gram.squared_error(coef) / gram.yty, 1.0) if gram.yty > 0.0 else 1.0)
    chosen = Candidates(np.array(chains, dtype=np.int64), np.array(terms, dtype=np.int64))
    levels = empty.levels
    size = levels.discrepancy * np.clip(left, 1e-4, 1.0)
    found = replace(empty, chosen=chosen, theta=np.array(theta), levels=replace(levels, discrepancy=size))
    if task.flows is None:
        return found
    whole = task.flows.wide(task.flows.narrow(task.model(chosen)))[task.number(chosen)]
    return replace(found, chosen=chosen.take(np.flatnonzero(whole)), theta=found.theta[whole])


class _Input(NamedTuple):
    """An input: its smoothness, mean, corner and course, as in `Layout`; variances of noise and steps, as in `Levels`;
    its states in each record."""

    smoothness: int
    centre: float
    corner: float
    course: Course
    noise: float
    slope: float
    paths: tuple[Floats, ...]


def _with_inputs(layout: Layout, inputs: Sequence[_Input]) -> Layout:
    return replace(
        layout,
        smoothness=tuple(one.smoothness for one in inputs),
        centres=tuple(one.centre for one in inputs),
        corners=tuple(one.corner for one in inputs),
        courses=tuple(one.course for one in inputs),
    )


def with_courses(motion: Motion, task: Task, fitted: Fitted, k: int) -> Iterator[list[tuple[Task, State]]]:
    """Tasks with other courses of input k, as smooth as it is, then as a random sequence; all start from the fit."""
    if task.layout.discrete:
        return
    inputs, name = _inputs_of(fitted.state), task.layout.roles.inputs[k]
    random = _input(name, motion.train, _known_noise(motion).get(name), (0,))._replace(noise=inputs[k].noise)
    for own, courses in ((inputs[k], OTHERWISE), (random, (*OTHERWISE, *BENT))):
        others = [own._replace(course=course) for course in courses]
        yield [_with_others(motion, task, fitted.state, [*inputs[:k], one, *inputs[k + 1 :]]) for one in others]


def with_exact_inputs(motion: Motion, task: Task, state: State, names: Collection[str]) -> tuple[Task, State]:
    """The task with inputs that have no noise, as smooth as their samples are then, and the fit as its start."""
    roles = task.layout.roles
    inputs = [
        _input(name, motion.train, 0.0, SMOOTHNESS)._replace(course=one.course) if name in names else one
        for name, one in zip(roles.inputs, _inputs_of(state), strict=True)
    ]
    task, state = _with_others(motion, task, state, inputs)
    exact = np.array([name in names for name, _ in task.layout.channels])
    return task, replace(state, levels=replace(state.levels, held=exact | ~state.levels.learned))


def _inputs_of(state: State) -> list[_Input]:
    levels, layout = state.levels, state.levels.layout
    noise = levels.channels[layout.first_input :]
    paths = [
        tuple(path[:, first : last + 1] for path in state.paths)
        for first, last in zip(layout.driven, layout.slope, strict=True)
    ]
    kinds = (layout.smoothness, layout.centres, layout.corners, layout.courses)
    return [_Input(*one) for one in zip(*kinds, noise.tolist(), levels.slope.tolist(), paths, strict=True)]


def _with_others(motion: Motion, task: Task, state: State, inputs: Sequence[_Input]) -> tuple[Task, State]:
    layout, levels = _with_inputs(task.layout, inputs), state.levels
    first = layout.before_inputs
    series = tuple(
        _series(layout, rows)._replace(spread=one.spread) for rows, one in zip(motion.train, task.series, strict=True)
    )
    paths = tuple(np.hstack([path[:, :first], *(one.paths[i] for one in inputs)]) for i, path in enumerate(state.paths))
    scales = _scales(layout, paths, levels.target, series, levels.scales.interval)
    scales.mean[:first], scales.variance[:first] = levels.scales.mean[:first], levels.scales.variance[:first]
    noise = np.append(levels.channels[: layout.first_input], [one.noise for one in inputs])
    slope = np.array([one.slope for one in inputs])
    courses = np.full(len(inputs), LIKELIHOOD.first_course)
    levels = replace(levels, layout=layout, scales=scales, channels=noise, slope=slope, courses=courses, hessian=None)
    return replace(task, layout=layout, series=series), replace(state, paths=paths, blurs=(), levels=levels)


def carried_over(motion: Motion, task: Task, fitted: Fitted, places: Sequence[tuple[int, int]]) -> tuple[Task, State]:
    """The task on the training rows of a motion, and as its start a fit of some of them; `places` are the record and
    the first row of each path of the fit."""
    series, paths = series_and_paths(task.layout, motion.train)
    for path, (record, first) in zip(fitted.state.paths, places, strict=True):
        paths[record][first : first + len(path)] = path
    spectra = [_spectrum(name, motion.train, task.layout.centres[k]) for k, name in enumerate(task.layout.roles.inputs)]
    return with_spectra(replace(task, series=series), replace(fitted.state, paths=paths, blurs=()), spectra)


def stretches(motion: Motion) -> tuple[Motion, list[tuple[int, int]]]:
    """The motion in stretches if it is long, else as it is, and the record and first row of each."""
    total = sum(rows.n for rows in motion.train)
    if total <= LIKELIHOOD.stretches_above:
        return motion, [(record, 0) for record in range(len(motion.train))]
    places, pieces = [], []
    longest = LIKELIHOOD.stretches_above // STRETCHES
    for record, count in _counts([rows.n for rows in motion.train], longest).items():
        rows = motion.train[record]
        length = min(longest, rows.n // count)
        for first in np.linspace(0, rows.n - length, count).round().astype(int).tolist():
            places.append((record, first))
            pieces.append(rows.part(slice(first, first + length)))
    cuts = tuple(rows.n for rows in pieces)
    return replace(motion, records=tuple(pieces), cuts=cuts, holdout=0.0), places


def _counts(rows: Sequence[int], longest: int) -> dict[int, int]:
    """Number of stretches of each record; of many records one stretch each of some, evenly chosen."""
    if len(rows) <= STRETCHES:
        return {k: max(1, round(STRETCHES * n / sum(rows))) for k, n in enumerate(rows)}
    most = -(-LIKELIHOOD.stretches_above // min(longest, int(np.median(rows))))
    return dict.fromkeys(np.linspace(0, len(rows) - 1, min(len(rows), most)).round().astype(int).tolist(), 1)


def series_and_paths(layout: Layout, pieces: Sequence[MotionRows]) -> tuple[tuple[Series, ...], tuple[Floats, ...]]:
    """Samples of some rows, and the smoothed motion as their paths."""
    paths = tuple(_path(layout, rows, [rows.columns[name][:, None] for name in layout.roles.inputs]) for rows in pieces)
    return tuple(_series(layout, rows) for rows in pieces), paths


def _series(layout: Layout, rows: MotionRows) -> Series:
    assert rows.time is not None
    samples = np.empty((rows.n, len(layout.channels)))
    for i, (name, _) in enumerate(layout.channels):
        samples[:, i] = rows.samples[name]
    given = np.zeros((rows.n, 0, 4))
    if layout.roles.timed:
        given = with_time(rows.time, given)
    bends = np.zeros((rows.n, len(layout.courses), 2))
    for k, (name, course) in enumerate(zip(layout.roles.inputs, layout.courses, strict=True)):
        if course == "cubic" or course == "band-limited":
            bends[:, k] = interpolant(rows.time, rows.columns[name][:, None], course)[:, 0, 2:]
    return Series(np.diff(rows.time), samples, given, np.ones(samples.shape), bends)


def _path(layout: Layout, rows: MotionRows, inputs: Sequence[Floats]) -> Floats:
    path = np.zeros((rows.n, layout.size))
    for i, name in enumerate(layout.roles.states):
        path[:, i] = rows.columns[name]
    for first, values in zip(layout.driven, inputs, strict=True):
        path[:, first : first + values.shape[1]] = values
    return path


def _scales(
    layout: Layout, paths: Sequence[Floats], targets: Floats, series: Sequence[Series], interval: float
) -> Scales:
    whole, samples = np.concatenate(paths), np.concatenate([one.samples for one in series])
    mean, variance = whole.mean(axis=0), whole.var(axis=0)
    mean[layout.motion :] = 0.0
    mean[layout.driven] = whole[:, layout.driven].mean(axis=0)
    variance[layout.discrepancy] = targets
    mean[layout.lags] = [-lag.value for _, lag in layout.late]
    variance[layout.lags] = [lag.prior_sd**2 for _, lag in layout.late]
    rounding = np.array([_rounding(column) for column in samples.T])
    rounding[layout.first_input :] = 0.0  # values of a switched force repeat without rounding
    return Scales(mean, np.maximum(variance, 1e-300), np.nanvar(samples, axis=0), interval, rounding)


def _drift(motion: Motion) -> float:
    """`Layout.drift`: 2 pi times the lower end [Hz] of the records' band times the interval [s]; 0 without a band."""
    low = motion.band[0] if motion.band else 0.0
    intervals = [np.diff(rows.time) for rows in motion.train if rows.time is not None]
    return 2.0 * math.pi * low * _interval(intervals) if low else 0.0


def _rounding(samples: Floats) -> float:
    """Variance of rounding to the finest step between any two samples; 0 if no value occurs twice."""
    samples = samples[np.isfinite(samples)]
    values = np.unique(samples)
    return float(np.diff(values).min() ** 2 / 12.0) if 1 < len(values) < len(samples) else 0.0


def precision_of_terms(motion: Motion, layout: Layout) -> Floats:
    """1/variance of every coefficient's prior, (C (P + 1),)."""
    columns = np.concatenate([evaluate_terms(layout.terms, rows.columns) for rows in motion.train])
    targets = _targets(layout.roles, motion.train)
    own = targets.mean(axis=0) ** 2 / np.maximum(targets.var(axis=0), 1e-300)
    spread = np.tile(np.append(columns.var(axis=0), 1.0), (layout.chains, 1))
    # a target far from zero, as of a falling body, is a constant first of all
    spread[:, -1] /= 1.0 + _offsets(motion, layout.terms) + np.where(own > LIKELIHOOD.far_from_zero, own, 0.0)
    return np.asarray(spread / (LIKELIHOOD.prior_share * targets.var(axis=0)[:, None])).ravel()


def _offsets(motion: Motion, terms: Sequence[Expression]) -> float:
    """Sum of squared means, in units of the variances, of channels far from zero: the constant compensates these."""
    total = 0.0
    for name in sorted(set().union(*(term.names for term in terms))):
        values = np.concatenate([rows.columns[name] for rows in motion.train])
        share = float(values.mean() ** 2 / max(values.var(), 1e-300))
        total += share if share > LIKELIHOOD.far_from_zero else 0.0
    return total


def _targets(roles: Roles, pieces: Sequence[MotionRows]) -> Floats:
    """Highest derivatives, as measured where available, because a smoother can mistake forcing for noise."""
    return np.concatenate([np.column_stack([rows.observed[t] for t in roles.targets]) for rows in pieces])


def _input(name: str, pieces: Sequence[MotionRows], known: float | None, orders: Sequence[int]) -> _Input:
    """An input of the smoothness, among `orders`, that makes its own samples likeliest."""
    found = [_alone(name, pieces, smoothness, known) for smoothness in orders]
    one = found[-1][1]
    if one.layout.corners[0] * _interval([part.intervals for part in one.series]) > CORNER:
        orders, found = (*orders, SMOOTHEST), [*found, _alone(name, pieces, SMOOTHEST, known)]
    # Schwarz (1978): a smooth input has two more parameters, corner and noise; it would take white samples for noise
    rows = sum(min(len(one.samples), INPUT_ROWS) for one in found[0][1].series)
    extra = math.log(rows) * np.sign(orders)
    return _smoothed(*found[int(np.argmax([one[0] for one in found] - extra))][1:])


def _spectrum(name: str, pieces: Sequence[MotionRows], mean: float) -> Spectrum:
    return mean_spectrum([rows.columns[name] - mean for rows in pieces])


def _interval(intervals: Sequence[Floats]) -> float:
    """The median interval between samples [s]."""
    return float(np.median(np.concatenate(intervals)))


def with_spectra(task: Task, state: State, spectra: Sequence[Spectrum]) -> tuple[Task, State]:
    """A task and a fit with the corners of the noisy inputs, and the variances of their steps, from spectra."""
    old, levels, corners, slope = task.layout, state.levels, [], []
    interval = _interval([one.intervals for one in task.series])
    for k, spectrum in enumerate(spectra):
        corner, change, order = old.corners[k], 1.0, int(old.widths[k])
        if old.smoothness[k] and spectrum.segments.any():
            corner, _, _ = spectrum_of(spectrum, order, interval, 1.0)
            change = step_variance(order, corner, interval, 1.0) / step_variance(order, old.corners[k], interval, 1.0)
        corners.append(corner)
        slope.append(change * levels.slope[k])
    layout = replace(old, corners=tuple(corners))
    levels = replace(levels, layout=layout, slope=np.array(slope))
    return replace(task, layout=layout), replace(state, levels=levels)


def _alone(name: str, pieces: Sequence[MotionRows], smoothness: int, known: float | None) -> tuple[float, Task, State]:
    """Log likelihood of an input's own samples alone, and the task and state with the levels that maximise it."""
    values = np.concatenate([rows.columns[name] for rows in pieces])
    mean, variance = float(values.mean()), float(values.var()) or 1.0
    step = _interval([np.diff(rows.time) for rows in pieces if rows.time is not None])
    noise, corner, slope = LIKELIHOOD.input_noise * variance, 0.0, variance / step**2
    sizes = [variance, slope]
    if smoothness:
        order = smoothness + 1
        corner, level, noise = spectrum_of(_spectrum(name, pieces, mean), order, step, variance)
        slope = step_variance(order, corner, step, level)
        sizes = [variance * corner ** (2 * k) for k in range(order)]
    if known is not None:
        noise = max(known**2, LEAST_NOISE * variance)
    layout = Layout(Roles((), (name,)), (), (), (smoothness,), (mean,), (corner,), ("smooth",))
    scales = Scales(np.array([mean, *[0.0] * (len(sizes) - 1)]), np.array(sizes), np.array([variance]))
    none = np.zeros(0)
    levels = Levels(layout, scales, np.array([noise]), none, none, np.array([slope]), np.ones(1), none)
    task = Task(layout, tuple(_series(layout, rows) for rows in pieces), none, none)
    state = State(NOTHING, none, tuple(np.zeros((rows.n, layout.size)) for rows in pieces), levels)
    short = [Series(one.intervals[: INPUT_ROWS - 1], *(part[:INPUT_ROWS] for part in one[1:])) for one in task.series]
    few_rows = replace(state, paths=tuple(path[:INPUT_ROWS] for path in state.paths))
    linears = linearised(layout, short, few_rows)
    # the noise of a white input is not identifiable
    held = np.array([not smoothness or known is not None, False, True])
    levels, found = maximised(linears, few_rows, none, held, steps=20)
    return found.value, task, replace(state, levels=levels)


def _smoothed(task: Task, state: State) -> _Input:
    """An input smoothed by its own samples alone; its paths are deviations from zero."""
    found = task.marginal(state)
    smoothed = adjoints(task.linearised(state), state.levels, found, found.delta)
    [one] = _inputs_of(state)
    return one._replace(paths=tuple(adj.deviation for adj in smoothed))
