"""Samples that are no measurement of the motion: spikes, stuck and clipped stretches, found before anything is fitted.

A spike is a sample that the other samples of its chain contradict, both those before it and those after it, while these
agree once it is left out. This distinguishes spikes from motion: a sample next to a jump of the acceleration agrees
with one side, and in a burst the smoother also misses the samples around the one that was left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError, in_digits
from bayeq.numerics.settings import STATES
from bayeq.records import Record
from bayeq.records.findings import clipped_levels, equal_runs
from bayeq.records.record import without_samples
from bayeq.states.kinematic.chain_smoother import series_of
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.smoother import ChainSeries, KinematicModel, leave_one_out, one_sided, smooth_kinematic
from bayeq.states.limits import FEW, Inputs, is_clipped
from bayeq.states.roles import Chain, Roles
from bayeq.states.sensors import unit_gains

# Kinds of bad samples, and what to do about them.
ADVICE = {"spikes": "check the sensor", "stuck": "check the sensor", "clipped": "measure in a wider range"}

# A spike errs by at least a share LEAST_SHARE of the channel's standard deviation (friction in records of 0.1 % noise
# jumps by 2 %, and a few samples that err by so little do no harm), and by LEVELS levels where these are few: fewer
# than FEW_LEVELS times the samples.
LEAST_SHARE = 0.03
LEVELS = 2.5
FEW_LEVELS = 0.5

# Errors are compared with their robust standard deviation in the whole record, or within LOCAL rows on either side if
# that is larger: a smoother's errors grow where the motion differs from its model. A fifth of them may be spikes.
LOCAL = 16
UPPER, UPPER_NORMAL = 0.8, 1.2816
MEDIAN_NORMAL = 0.6745

# Least factor of the model's standard deviations, where more than half of the samples are predicted exactly.
ROUNDING = 1e-9

# With a spike left out, the samples of its channel within NEAR rows err by less than a spike, or by a
# fraction 1/STANDS_OUT of the spike, and those of other channels by at most WORSE times their former error: at a jump
# half of the error would remain.
NEAR = 5
STANDS_OUT = 5.0
WORSE = 1.5

# Errors within TOGETHER rows of each other have one cause, of at most MOST_TOGETHER samples.
TOGETHER = 8
MOST_TOGETHER = 3

# A spike counts if, of the places where its channel errs as much or more, at least this share are spikes: otherwise the
# smoother misses the motion.
MOSTLY = 0.75

# Noise levels are learned again without the spikes found, in up to this many passes.
PASSES = 6

# A stretch may be stuck if it has LEAST_STUCK equal samples, and TIMES_USUAL times as many as the usual run of equals.
LEAST_STUCK = 10
TIMES_USUAL = 4.0

# It is stuck if the other channels of its chain say that it moved, by this many standard deviations on average.
MOVED = 3.0

# A channel with no others to compare is stuck if it stops without a jump and goes on with one of this many usual steps.
JUMP = 3.0

# A spike of an input is a blow if the motion responds within ANSWER rows; the response is no spike either. In a blow
# the input differs from its values before and after by more than BLOW times the BLOW_SHARE quantile of its changes.
ANSWER = 2
BLOW, BLOW_SHARE = 3.0, 0.9

# Where no response is measured, an input that is only noise between LEAST_BLOWS or more spikes is a series of blows.
LEAST_BLOWS = 3
ONLY_NOISE = 0.7

# Records of fewer rows are not searched.
LEAST_ROWS = 40

# More spikes than this share of a channel's samples are part of what it measures, and kept.
MOST_SPIKES = 0.05


@dataclass(frozen=True, eq=False)
class Learned:
    """Models and gains that channels were judged by, for further records of the same system."""

    # by names of channels, the model (motion and noise levels) of an input, a channel alone, or a chain
    models: dict[tuple[str | None, ...], KinematicModel] = field(default_factory=dict)
    gains: dict[tuple[str | None, ...], Floats] = field(default_factory=dict)  # of chains, (K+1,)


def find_bad_samples(
    records: Sequence[Record], roles: Roles, learned: Learned | None = None
) -> list[dict[str, dict[str, Bools]]]:
    """Masks (n,) of bad samples: for each record of one system, each channel that has some, and each kind.

    NaN is a missing sample. Records without time, or of fewer than 40 rows, are not searched. Models and gains are
    taken from `learned` if it has them; otherwise they are estimated and added to it.
    """
    out: list[dict[str, dict[str, Bools]]] = [{} for _ in records]
    timed = [i for i, record in enumerate(records) if record.time is not None and record.n >= LEAST_ROWS]
    if not timed:
        return out
    chosen = [records[i] for i in timed]
    learned = learned or Learned()
    inputs = [_Group(chosen, (name,), is_input=True).searched(learned) for name in roles.inputs]
    chains = [_Group.of_chain(chosen, chain, learned).searched(learned) for chain in roles.chains]
    _keep_answered(inputs, chains)
    _keep_limits(inputs, chains, learned)
    for group in (*inputs, *chains):
        for i, kinds in zip(timed, group.bad, strict=True):
            for k, name in enumerate(group.names):
                found = {kind: mask[:, k] for kind, mask in kinds.items() if mask[:, k].any()}
                if name is not None and found:
                    out[i][name] = found
    return out


def without_bad_samples(
    records: Sequence[Record], roles: Roles, learned: Learned | None = None
) -> tuple[list[Record], list[str]]:
    """The records with NaN in place of bad samples (`find_bad_samples`), and a message for each channel and kind."""
    out, messages = [], []
    for record, channels in zip(records, find_bad_samples(records, roles, learned), strict=True):
        bad_rows = {name: np.any(list(kinds.values()), axis=0) for name, kinds in channels.items()}
        out.append(without_samples(record, bad_rows))
        where = f"{record.label}: " if len(records) > 1 else ""
        messages += [where + _message(name, kind, rows) for name, bad in channels.items() for kind, rows in bad.items()]
    return out, messages


def clipped_shares(records: Sequence[Record], roles: Roles) -> dict[str, float]:
    """Share of the samples of each channel of a motion at a level at which it is clipped.

    An actuator may have reached its limit, so that inputs are left out, and samples of a map jump.
    """
    total = sum(record.n for record in records)
    return {
        name: sum(one.samples for record in records for one in clipped_levels(record[name])) / total
        for name in (() if roles.discrete else roles.measured)
    }


def _message(name: str, kind: str, rows: Bools) -> str:
    count = int(rows.sum())
    samples = f"{count} sample{'s' * (count > 1)} left out as {kind[:-1] if kind == 'spikes' and count == 1 else kind}"
    return f"{name}: {samples} ({listed(rows)}: {in_digits(100 * count / len(rows))} %); {ADVICE[kind]}"


# Largest number of stretches, and of characters, in a list of rows.
SHOWN, LISTED = 3, 24


def listed(rows: Bools) -> str:
    """Rows, counted from 1, in words."""
    numbers = np.flatnonzero(rows) + 1
    stretches = _places(numbers, 1)
    texts = [f"{s[0]}" if len(s) == 1 else f"{s[0]} to {s[-1]}" for s in stretches[:SHOWN]]
    while len(texts) > 1 and len(", ".join(texts)) > LISTED:
        texts.pop()
    more = ", ..." if len(stretches) > len(texts) else ""
    return f"row{'s' * (len(numbers) > 1)} {', '.join(texts)}{more}"


class _Group:
    """Channels that are judged by one smoother: those of a chain, or one input."""

    def __init__(
        self,
        records: Sequence[Record],
        names: Sequence[str | None],
        gains: Floats | Sequence[float] = (1.0,),
        is_input: bool = False,
    ) -> None:
        self.names, self.is_input = tuple(names), is_input
        self.series = [series_of(record, names).over(gains) for record in records]
        self.bad = [{kind: _nowhere(s) for kind in ADVICE} for s in self.series]
        # rows that the smoother misses, of each record
        self.missed: list[Bools] = [np.zeros(s.n, dtype=np.bool_) for s in self.series]

    @property
    def spikes(self) -> list[Bools]:
        return [kinds["spikes"] for kinds in self.bad]

    @property
    def without_bad(self) -> list[ChainSeries]:
        """The series without their bad samples."""
        marked = (np.any(list(kinds.values()), axis=0) for kinds in self.bad)
        return [s.without(bad) for s, bad in zip(self.series, marked, strict=True)]

    @classmethod
    def of_chain(cls, records: Sequence[Record], chain: Chain, learned: Learned) -> _Group:
        """A chain from its lowest measured derivative on, in consistent units, which are estimated without spikes."""
        names = chain.measured[chain.lowest :]
        if sum(name is not None for name in names) == 1:
            gains = np.ones(len(names))
        elif names in learned.gains:
            gains = learned.gains[names]
        else:
            alone = {name: cls(records, (name,)).searched(learned).spikes for name in names if name is not None}
            spikes = [{name: own[i][:, 0] for name, own in alone.items()} for i in range(len(records))]
            calm = [without_samples(record, own) for record, own in zip(records, spikes, strict=True)]
            gains = learned.gains[names] = unit_gains(calm, chain)[chain.lowest :]
        return cls(records, names, gains)

    def searched(self, learned: Learned) -> _Group:
        """The group itself with its bad samples marked, none of them if no noise level can be estimated."""
        doubtful = [_long_runs(s) for s in self.series]
        model = self._search_spikes(doubtful, learned.models.get(self.names))
        if model is None:
            return self
        learned.models[self.names] = model
        for i, (s, runs, bad) in enumerate(zip(self.series, doubtful, self.bad, strict=True)):
            calm = s.without(bad["spikes"] | runs)
            bad["clipped"] = _clipped(s.without(bad["spikes"]), self.is_input)
            bad["stuck"] = _stuck(s, runs & ~bad["clipped"] & ~(self.is_input & _at_zero(s)), calm, model)
            errors = leave_one_out(calm, model)
            self.missed[i] = np.any(_standard(errors) > STATES.spike * _factor(errors), axis=1)
        return self

    def _search_spikes(self, doubtful: Sequence[Bools], known: KinematicModel | None) -> KinematicModel | None:
        """Find spikes outside of doubtful stretches, until there are no more; the model without them, if not known."""
        least, model = _least(self.series), known
        for _ in range(PASSES):
            used = [s.without(spikes | d) for s, spikes, d in zip(self.series, self.spikes, doubtful, strict=True)]
            try:
                # noise levels that are not quite the likeliest do as well
                model = known or fit_kinematic(used, doubts=False)
            except InputError:  # too few samples, or a constant channel
                return None
            found = _standing_out([_judged(s, model, least) for s in used])
            for i, (row, k) in found:
                self.spikes[i][row, k] = True
            if not found:
                break
        total = np.sum([np.isfinite(s.samples).sum(axis=0) for s in self.series], axis=0)
        frequent = np.sum([mask.sum(axis=0) for mask in self.spikes], axis=0) > MOST_SPIKES * total
        for mask in self.spikes:
            mask[:, frequent] = False
        return model


def _keep_answered(inputs: Sequence[_Group], chains: Sequence[_Group]) -> None:
    """Unmark blows: spikes of an input to which a chain responds, and the responses of its highest derivative."""
    seen = [chain for chain in chains if chain.names[-1] is not None]
    for group in inputs:
        for i, spikes in enumerate(group.spikes):
            values = np.asarray(group.series[i].channels[0])
            blows, quiet = _blows(values), values[np.isfinite(values) & ~spikes[:, 0]]
            answered = np.zeros_like(blows)
            for chain in seen:
                answer = np.asarray(chain.series[i].channels[-1])
                answered |= _wider(chain.spikes[i][:, -1] | chain.missed[i] | _blows(answer))
                chain.spikes[i][_wider(blows), -1] = False
            places = _places(np.flatnonzero(spikes[:, 0]), ANSWER)
            # a force that a window made zero between blows has no other samples
            few = len(places) < LEAST_BLOWS and (not places or np.ptp(quiet) > 0.0)
            unseen = not seen and not few and _is_noise(quiet)
            for place in places:
                if unseen or answered[place].any():
                    spikes[place] = False


def _keep_limits(inputs: Sequence[_Group], chains: Sequence[_Group], learned: Learned) -> None:
    """Unmark extremes of inputs at which an actuator has reached its limit: no chain shows that a sensor is clipped."""
    moving = [(chain, learned.models[chain.names]) for chain in chains if chain.names in learned.models]
    for k, group in enumerate(inputs):
        extremes = [kinds["clipped"][:, 0] for kinds in group.bad]
        if not moving or np.concatenate(extremes).mean() <= FEW:
            continue
        columns = [np.column_stack([own.series[i].samples[:, 0] for own in inputs]) for i in range(len(extremes))]
        driven = [Inputs(u[:, k], at, np.delete(u, k, axis=1)) for u, at in zip(columns, extremes, strict=True)]
        if not any(is_clipped(driven, chain.without_bad, model) for chain, model in moving):
            for at in extremes:
                at[:] = False


def _is_noise(values: Floats) -> bool:
    """Whether a channel is only noise: the steps of white noise have twice its variance."""
    steps, spread = np.median(np.abs(np.diff(values))), np.median(np.abs(values - np.median(values)))
    return bool(steps >= ONLY_NOISE * math.sqrt(2.0) * spread)


def _places(rows: NDArray[np.intp], apart: int) -> list[NDArray[np.intp]]:
    """Rows, divided where neighbours are further apart than this."""
    return [part for part in np.split(rows, np.flatnonzero(np.diff(rows) > apart) + 1) if len(part)]


def _wider(rows: Bools) -> Bools:
    """The rows, and those within `ANSWER` rows of them."""
    return np.convolve(rows, np.ones(2 * ANSWER + 1), "same") > 0.0


def _blows(values: Floats) -> Bools:
    """Rows in which a channel is far from its values `ANSWER` + 1 rows before and after."""
    apart = np.abs(values[ANSWER + 1 :] - values[: -ANSWER - 1])
    known = apart[np.isfinite(apart)]
    usual = float(np.quantile(known, BLOW_SHARE)) if len(known) else np.inf
    before = np.pad(apart, (ANSWER + 1, 0), constant_values=np.inf)
    after = np.pad(apart, (0, ANSWER + 1), constant_values=np.inf)
    with np.errstate(invalid="ignore"):
        return np.fmin(before, after) > BLOW * usual


def _nowhere(series: ChainSeries) -> Bools:
    """An empty mask of samples, (n, K+1)."""
    return np.zeros((series.n, len(series.channels)), dtype=np.bool_)


# --- spikes ----------------------------------------------------------------------------------------------------------


def _standard(errors: Floats) -> Floats:
    """Absolute leave-one-out errors over their standard deviations; 0 without a sample."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nan_to_num(np.abs(errors[..., 0]) / errors[..., 1])


def _factor(errors: Floats) -> Floats:
    """Factor of the model's standard deviations in each channel by which the median error is that of a normal one."""
    standard = np.where(np.isfinite(errors[..., 0]), _standard(errors), np.nan)
    present = np.isfinite(standard).any(axis=0)
    out = np.ones(standard.shape[1])
    out[present] = np.nanmedian(standard[:, present], axis=0) / MEDIAN_NORMAL
    return np.maximum(out, ROUNDING)


def _least(series: Sequence[ChainSeries]) -> Floats:
    """Least error of a spike in each channel: a share of the channel's standard deviation, or some of its levels."""
    whole = np.concatenate([s.samples for s in series])
    out = np.zeros(whole.shape[1])
    for k, values in enumerate(whole.T):
        known = values[np.isfinite(values)]
        if len(known) < LEAST_ROWS:
            continue
        # from the quartiles, which spikes hardly change
        spread = float(np.subtract(*np.quantile(known, (0.75, 0.25)))) / (2.0 * MEDIAN_NORMAL)
        levels = np.unique(known)
        few = 1 < len(levels) < FEW_LEVELS * len(known)
        out[k] = max(LEAST_SHARE * spread, LEVELS * float(np.quantile(np.diff(levels), 0.1)) if few else 0.0)
    return out


# A sample: row and channel.
Place = tuple[int, int]


class _Verdict(NamedTuple):
    """A place where samples err: the largest error, its channel, and the samples there that are spikes."""

    error: float
    channel: int
    spikes: list[Place]


def _standing_out(judged: Sequence[Sequence[_Verdict]]) -> list[tuple[int, Place]]:
    """Record, row and channel of the spikes, without those with errors of a size that is mostly due to motion."""
    out = []
    for k in {verdict.channel for one in judged for verdict in one}:
        ranked = sorted(
            ((verdict, i) for i, one in enumerate(judged) for verdict in one if verdict.channel == k),
            key=lambda pair: -pair[0].error,
        )
        count = np.cumsum([bool(verdict.spikes) for verdict, _ in ranked])
        for rank, ((verdict, i), spikes) in enumerate(zip(ranked, count, strict=True), 1):
            if spikes >= MOSTLY * rank:
                out += [(i, at) for at in verdict.spikes]
    return out


def _judged(series: ChainSeries, model: KinematicModel, least: Floats) -> list[_Verdict]:
    """Places of a record where samples err; spikes are the cause if no sample nearby errs without them."""
    errors = leave_one_out(series, model)
    factor = _factor(errors)
    before = _standard(errors) / factor
    high = (before > STATES.spike) & (np.abs(np.nan_to_num(errors[..., 0])) > least)
    # at the ends there is only one side
    high[[0, -1]] = False
    rows = np.flatnonzero(high.any(axis=1))
    if not len(rows):
        return []
    worst = np.where(high, before, 0.0)
    # samples that may be the spikes of each place, at first the worst one
    causes = [[_largest(worst, int(part[0]), int(part[-1]))] for part in _places(rows, TOGETHER)]
    noise = np.array([np.nan if sd is None else sd for sd in model.noise_sd])
    samples, out = series.samples, []
    present = np.isfinite(samples)
    for _ in range(MOST_TOGETHER):
        trial = np.zeros_like(high)
        for at in (at for cause in causes for at in cause):
            trial[at] = True
        masked = series.without(trial)
        smoothed = smooth_kinematic(masked, model)
        predicted = (smoothed.mean, *one_sided(masked, model))
        after = _standard(leave_one_out(masked, model))
        rows, k = np.nonzero(trial)
        spread = np.hypot(smoothed.sd[rows, k], noise[k])
        after[rows, k] = np.abs(samples[rows, k] - smoothed.mean[rows, k]) / spread
        after /= factor
        going_on, free = [], present & ~trial
        for cause in causes:
            left = _left_over(cause, before, after)
            if left is not None and high[left] and len(cause) < MOST_TOGETHER:
                going_on.append([*cause, left])
                continue
            spikes = []
            if left is None:
                sudden = [at for at in cause if _stands_out(at, cause, after)]
                spikes = [at for at in sudden if not _goes_on(at, samples, predicted, free)]
            out.append(_Verdict(float(before[cause[0]]), cause[0][1], spikes))
        causes = going_on
        if not causes:
            break
    return out


def _largest(values: Floats, first: int, last: int) -> Place:
    """Row and channel of the largest value in some rows."""
    row, k = np.unravel_index(int(np.argmax(values[first : last + 1])), values[first : last + 1].shape)
    return int(row) + first, int(k)


def _goes_on(at: Place, samples: Floats, predicted: Sequence[Floats], usable: Bools) -> bool:
    """Whether a sample agrees with one side: with the prediction from it, or its channel's nearest sample there."""
    row, k = at
    beside = [np.flatnonzero(usable[max(row - LOCAL, 0) : row, k])[-1:] + max(row - LOCAL, 0)]
    beside += [np.flatnonzero(usable[row + 1 : row + 1 + LOCAL, k])[:1] + row + 1]
    sides = [*(samples[rows[0], k] for rows in beside if len(rows)), *(mean[at] for mean in predicted[1:])]
    return bool(np.abs(samples[at] - np.array(sides)).min() < STATES.agrees * abs(samples[at] - predicted[0][at]))


def _left_over(cause: Sequence[Place], before: Floats, after: Floats) -> Place | None:
    """The nearby sample with the largest error after leaving out those of the cause; None if all errors are small."""
    rows = [row for row, _ in cause]
    first, last = max(min(rows) - NEAR, 0), max(rows) + NEAR
    limit = np.maximum(STATES.spike, WORSE * before[first : last + 1])
    for k in {k for _, k in cause}:
        limit[:, k] = max(STATES.spike, min(after[at] for at in cause if at[1] == k) / STANDS_OUT)
    excess = after[first : last + 1] / limit
    for row, k in cause:
        excess[row - first, k] = 0.0
    row, k = _largest(excess, 0, len(excess) - 1)
    return (row + first, k) if excess[row, k] > 1.0 else None


def _stands_out(at: Place, cause: Sequence[Place], after: Floats) -> bool:
    """Whether a sample of a cause errs by much more than those around it."""
    row, k = at
    around = np.arange(max(row - LOCAL, 0), min(row + LOCAL + 1, len(after)))
    others = np.setdiff1d(around, [other for other, channel in cause if channel == k])
    usual = float(np.nanquantile(after[others, k], UPPER)) / UPPER_NORMAL
    return bool(after[at] > STATES.spike * max(1.0, usual))


# --- stretches -------------------------------------------------------------------------------------------------------


def _long_runs(series: ChainSeries) -> Bools:
    """Stretches of equal samples that are longer than the channel's usual ones."""
    out, samples = _nowhere(series), series.samples
    for k in series.measured:
        values = samples[:, k]
        starts, lengths = equal_runs(values)
        usual = float(np.median(np.repeat(lengths, lengths)))
        long = (lengths >= max(LEAST_STUCK, TIMES_USUAL * usual)) & np.isfinite(values[starts])
        out[:, k] = np.repeat(long, lengths)
    return out


def _at_zero(series: ChainSeries) -> Bools:
    """Samples of 0 in channels that are nowhere negative, or nowhere positive."""
    samples = series.samples
    one_sided = (np.nan_to_num(samples) >= 0.0).all(axis=0) | (np.nan_to_num(samples) <= 0.0).all(axis=0)
    return np.asarray((samples == 0.0) & one_sided)


def _stuck(series: ChainSeries, runs: Bools, calm: ChainSeries, model: KinematicModel) -> Bools:
    """The long stretches of equal samples in which a channel should have moved."""
    out = np.zeros_like(runs)
    if not runs.any():
        return out
    samples, seen = series.samples, calm.samples
    smoothed = smooth_kinematic(calm, model)
    for k in series.measured:
        values, sd, others = samples[:, k], float(model.noise_sd[k] or 0.0), [j for j in series.measured if j != k]
        steps = np.abs(np.diff(values))
        usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
        starts, lengths = equal_runs(values)
        long = runs[starts, k]
        for first, last in zip(starts[long], (starts + lengths)[long], strict=True):
            rows = slice(first, last)
            judged = np.isfinite(seen[rows][:, others]).any(axis=1) if others else np.zeros(0, dtype=np.bool_)
            if judged.sum() >= LEAST_STUCK:
                error = (values[rows] - smoothed.mean[rows, k]) / np.hypot(smoothed.sd[rows, k], sd)
                out[rows, k] = np.mean(error[judged] ** 2) > MOVED**2
            elif first > 0 and last < len(values):
                stops = abs(values[first] - values[first - 1]) <= JUMP * usual
                out[rows, k] = stops and abs(values[last] - values[last - 1]) > JUMP * usual
    return out


def _clipped(series: ChainSeries, shut: bool) -> Bools:
    """Samples at the levels at which a channel is clipped."""
    out, samples = _nowhere(series), series.samples
    for k in series.measured:
        for found in clipped_levels(samples[:, k], shut):
            out[:, k] |= samples[:, k] == found.level
    return out
