"""`Motion`: the states of all records, divided once into training rows and rows held out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import ChainError, RecordError
from bayeq.expressions.functions import TIME
from bayeq.expressions.parse import EARLIER
from bayeq.numerics.rk4 import Interpolation
from bayeq.numerics.settings import STATES
from bayeq.records import Record, counts_rows
from bayeq.states.derive import Smooth, derive_states, known, require_usable, usable
from bayeq.states.hidden import hidden_columns, hidden_rates
from bayeq.states.kinematic.chain_smoother import ChainSmoothing, smooth_chain, smooth_further
from bayeq.states.prepare import bridged_record, complete_rows, corrected, filled_in, has_all, on_grid
from bayeq.states.roles import NEXT, Chain, Roles
from bayeq.states.sensors import Sensors, bridged, unit_gains


@dataclass(frozen=True, eq=False)
class MotionRows:
    """Consecutive rows of one record; arrays are (n,)."""

    name: str  # of the record
    time: Floats | None  # [s]
    # data of the regressions: states and targets (smoothed if there was a smoother), inputs with missing samples
    # bridged, and t where terms use it
    columns: Mapping[str, Floats]
    observed: Mapping[str, Floats]  # targets by which equations are judged: as measured, or else as in `columns`
    samples: Mapping[str, Floats]  # measured channels of the chains, and inputs; NaN where a sample is missing
    known: Bools  # rows with a sample of every channel; the others are bridged

    @property
    def n(self) -> int:
        return len(self.known)

    @property
    def inside(self) -> slice:
        """All rows; for a map, the rows from the first that has its earlier samples to the last that has a next one."""
        if not any(name.endswith(NEXT) for name in self.observed):
            return slice(0, self.n)
        there = np.flatnonzero(self.known)
        return slice(int(there[0]), int(there[-1]) + 1) if len(there) else slice(0, 0)

    def part(self, rows: slice) -> MotionRows:
        time = None if self.time is None else self.time[rows]
        columns, observed, samples = (
            {name: values[rows] for name, values in some.items()}
            for some in (self.columns, self.observed, self.samples)
        )
        return MotionRows(self.name, time, columns, observed, samples, self.known[rows])


@dataclass(frozen=True, eq=False)
class Motion:
    """States, targets and inputs of records of one system."""

    roles: Roles
    records: tuple[MotionRows, ...]  # all rows of each
    cuts: tuple[int, ...]  # the first row of each record that is held out; its number of rows if none is
    smoothing: tuple[ChainSmoothing, ...]  # how each measured chain was smoothed; empty without a smoother
    unit_gains: tuple[Floats, ...]  # of each chain, (K+1,), see `bayeq.states.sensors`
    holdout: float  # share of the rows of each record, at its end, that is held out
    sensors: Sensors = field(default_factory=Sensors)  # what is known of the channels
    band: tuple[float, float] | None = None  # frequencies [Hz] to which the use of the records is limited
    # interpolation of inputs between samples, where they are not smooth
    courses: Mapping[str, Interpolation] = field(default_factory=dict)
    noise_sd: Mapping[str, float] = field(default_factory=dict)  # noise of channels, in their units, by the likelihood
    seams: tuple[int, ...] = ()  # row at which each record was divided for smoothing; empty if none was

    @cached_property
    def train(self) -> tuple[MotionRows, ...]:
        """The training rows of each record."""
        return tuple(rows.part(slice(0, cut)) for rows, cut in zip(self.records, self.cuts, strict=True))

    @cached_property
    def held_out(self) -> tuple[MotionRows, ...]:
        """The rows held out of each record that has some with a sample of every channel."""
        return tuple(
            rows.part(slice(cut, rows.n))
            for rows, cut in zip(self.records, self.cuts, strict=True)
            if rows.known[cut:].any()
        )

    @property
    def whole(self) -> Motion:
        """The same motion with no rows held out; the `seams` show that those rows were smoothed separately."""
        return replace(self, cuts=tuple(rows.n for rows in self.records), holdout=0.0, seams=self.cuts)

    def smoothed_pieces(self, i: int) -> list[slice]:
        """The training rows of record i, in the pieces that were smoothed."""
        seam = self.seams[i] if self.seams else 0
        return [slice(0, seam), slice(seam, self.cuts[i])] if 0 < seam < self.cuts[i] else [slice(0, self.cuts[i])]

    @property
    def counts(self) -> tuple[int, int]:
        """Measured rows used for training, and held out."""
        used, left = (sum(int(rows.known.sum()) for rows in part) for part in (self.train, self.held_out))
        return used, left

    @property
    def smoothed(self) -> bool:
        """Whether the likelihood of the record has a path to start from: smoothed states, or the samples of a map."""
        return bool(self.smoothing) or self.roles.discrete

    @property
    def timed(self) -> bool:
        """Whether every record has time."""
        return all(rows.time is not None for rows in self.records)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Derivatives that were not measured but estimated."""
        chains = [chain for chain in self.roles.chains if not chain.discrete]
        return tuple(name for chain in chains for name in chain.names if name not in chain.measured)

    def estimated_by(self, k: int) -> ChainSmoothing | None:
        """How the target of chain k was estimated; None where it was measured, or not smoothed."""
        estimated = k < len(self.smoothing) and self.roles.chains[k].measured[-1] is None
        return self.smoothing[k] if estimated else None


def held_out_share(holdout: float, rows: int) -> float:
    """Hold-out share: 0 for short records."""
    return holdout if rows >= STATES.rows_to_hold_out else 0.0


def cut_at(rows: int, share: float) -> int:
    """The first row held out, of `rows` rows of which the last `share` is held out."""
    return rows - int(share * rows)


def estimate_motion(
    records: Sequence[Record],
    roles: Roles,
    smooth: Smooth = "auto",
    share: float = 0.0,
    sensors: Sensors | None = None,
    band: tuple[float, float] | None = None,
) -> Motion:
    """States, targets and inputs of records of one system, which share their noise levels.

    With "auto" the kinematic smoother fuses all measured channels of a chain (`bayeq.states.kinematic`), and missing
    samples are bridged. Where nothing is smoothed, rows with a missing sample are left out; with "none" they are an
    error. Noise levels are learned from the training rows; the rows held out, the last `share` of each record, are
    smoothed separately. `band`, frequencies [Hz], limits the use of the records. An UnknownNameError, RecordError or
    ChainError names channels that are missing or cannot be used.
    """
    whole, sensors = smooth == "none", sensors or Sensors()
    if roles.hidden:
        return with_hidden(estimate_motion(records, roles.seen, smooth, share, sensors, band), roles)
    if roles.discrete:
        pieces = tuple(_of_map(record, roles) for record in records)
        cuts = tuple(cut_at(rows.n, share) for rows in pieces)
        gains = tuple(np.ones(chain.order + 1) for chain in roles.chains)
        return Motion(roles, pieces, cuts, (), gains, share, sensors, band)
    records = [corrected(record, sensors) for record in records]
    if all(record.time is not None for record in records) and sum(record.n for record in records) < STATES.few_rows:
        smooth = "none"
        records = records if whole else [complete_rows(record, roles) for record in records]
    smoothed = _smoothed(records, roles, smooth, share, sensors)
    smoothing: tuple[ChainSmoothing, ...] = ()
    if smoothed is None:
        records = records if whole else [complete_rows(record, roles) for record in records]
        pieces = tuple(_rows(one, roles, derive_states(one, roles.chains, roles.inputs)) for one in records)
        even = [on_grid(record, roles.measured) for record in records]
        cuts = tuple(cut_at(record.n, share) for record in even)
        gains = tuple(unit_gains(even, chain, cuts, sensors.gain_sd) for chain in roles.chains)
    else:
        pieces, smoothing = smoothed
        gains = tuple(one.unit_gains for one in smoothing)
    cuts = tuple(cut_at(rows.n, share) for rows in pieces)
    return Motion(roles, pieces, cuts, smoothing, gains, share, sensors, band)


def with_hidden(motion: Motion, roles: Roles) -> Motion:
    """The motion with the hidden states of the roles: laws without unknown constants, integrated along each record,
    which needs time.

    An InputError names laws that are not finite along a record.
    """
    records = tuple(with_columns(rows, hidden_columns(roles, rows.columns, rows.time)) for rows in motion.records)
    gains = motion.unit_gains[: len(roles.chains) - len(roles.hidden)]
    return replace(
        motion, roles=roles, records=records, unit_gains=(*gains, *(np.ones(chain.order + 1) for chain in roles.hidden))
    )


def with_columns(rows: MotionRows, found: Mapping[str, Floats]) -> MotionRows:
    return replace(rows, columns={**rows.columns, **found}, observed={**rows.observed, **found})


def with_paths(motion: Motion, paths: Sequence[Mapping[str, Floats]]) -> Motion:
    """The motion with other paths of its hidden states, one mapping for each record; rates follow from the laws."""
    records = []
    for rows, path in zip(motion.records, paths, strict=True):
        columns = {**rows.columns, **path}
        records.append(with_columns(rows, {**path, **hidden_rates(motion.roles, columns, rows.n)}))
    return replace(motion, records=tuple(records))


def further_rows(record: Record, motion: Motion) -> MotionRows:
    """Rows of a further, prepared record of the same system, smoothed with the models of the records in `motion`."""
    roles = motion.roles
    filled = on_grid(record, roles.channels)
    chains = zip(roles.chains, motion.smoothing, strict=True)
    return _smoothed_rows(filled, roles, [smooth_further(filled, chain, smoothing) for chain, smoothing in chains])


def _of_map(record: Record, roles: Roles) -> MotionRows:
    """Rows of a record from `in_samples`, missing samples bridged, with columns of earlier and next samples."""
    record = on_grid(record, roles.channels)
    if record.time is None or (np.diff(record.time) != 1.0).any():
        raise RecordError(f"{record.label}: most samples of a map are missing: give those without gaps, --rows")
    require_usable(bridged_record(record, roles), roles.channels)
    samples = {name: np.array(record[name]) for name in roles.channels}
    for name in roles.inputs:
        if found := EARLIER.fullmatch(name):
            samples[name][: int(found["back"])] = np.nan
    whole = dict(zip(roles.measured, likened([samples[name] for name in roles.measured]), strict=True))
    known = np.all([np.isfinite(samples[name]) for name in roles.inputs], axis=0)
    columns = {name: bridged(samples[name]) for name in roles.inputs}
    for chain in roles.chains:
        channel = str(chain.measured[-2])
        for back, name in enumerate(reversed(chain.names), -1):
            known &= np.isfinite(_moved(samples[channel], back))
            columns[name] = bridged(_moved(whole[channel], back))
    observed = {target: columns[target] for target in roles.targets}
    return MotionRows(record.name, record.time, columns, observed, samples, known)


# Neighbours of a missing sample, by rows back, that are compared with the same neighbours of other samples.
AROUND = (2, 1, -1, -2)


def likened(channels: Sequence[Floats]) -> list[Floats]:
    """Channels with missing samples taken from the row with the most similar neighbours, since maps may jump."""
    samples = np.column_stack(channels)
    scale = np.nanstd(samples, axis=0)
    around = np.hstack([np.column_stack([_moved(column, back) for column in samples.T]) for back in AROUND])
    around /= np.tile(np.where(scale > 0.0, scale, 1.0), len(AROUND))
    out = samples.copy()
    for row in np.flatnonzero(np.isnan(samples).any(axis=1)):
        seen = np.isfinite(around[row])
        apart = np.sum((around[:, seen] - around[row, seen]) ** 2, axis=1)
        for i in np.flatnonzero(np.isnan(samples[row])):
            alike = np.where(np.isnan(apart) | np.isnan(samples[:, i]), np.inf, apart)
            out[row, i] = samples[int(np.argmin(alike)), i] if np.isfinite(alike).any() else np.nan
    return [bridged(column) for column in out.T]


def _moved(values: Floats, back: int) -> Floats:
    """The channel delayed by `back` samples (advanced if negative), padded with NaN."""
    return np.pad(values, abs(back), constant_values=np.nan)[abs(back) - back :][: len(values)]


def _smoothed(
    records: Sequence[Record], roles: Roles, smooth: Smooth, share: float, sensors: Sensors
) -> tuple[tuple[MotionRows, ...], tuple[ChainSmoothing, ...]] | None:
    """Rows by the kinematic smoother; None where records are taken as measured."""
    timed = all(record.time is not None for record in records)
    wanted = timed and smooth != "none"
    # check channels before the smoothing, which takes longer
    whole = [chain for chain in roles.chains if chain.lowest == 0]
    present = records if smooth == "none" else [bridged_record(record, roles) for record in records]
    for record in present:
        derive_states(record, whole, roles.inputs)
    integrated = [chain for chain in roles.chains if chain.lowest > 0]
    for chain in integrated:
        _require_integrable(present, chain, smooth)
    if not wanted:
        return None
    filled = [on_grid(record, roles.channels) for record in records]
    cuts = [cut_at(record.n, share) for record in filled]
    try:
        found = [smooth_chain(filled, chain, cuts, sensors) for chain in roles.chains]
    except RecordError:
        if integrated:  # only the smoother can integrate
            raise
        return None
    pieces = (_smoothed_rows(record, roles, [means[i] for means, _ in found]) for i, record in enumerate(filled))
    return tuple(pieces), tuple(smoothing for _, smoothing in found)


def _smoothed_rows(record: Record, roles: Roles, means: Sequence[Floats]) -> MotionRows:
    """Rows of a record on its grid with the smoothed derivatives (n, K + 1) of each chain."""
    assert record.time is not None
    columns = {name: filled_in(record.time, record[name]) for name in roles.inputs}
    for chain, values in zip(roles.chains, means, strict=True):
        if chain.static:  # its target is no motion and may jump
            columns[chain.target] = filled_in(record.time, record[chain.target])
            continue
        columns.update((name, np.ascontiguousarray(own)) for name, own in zip(chain.names, values.T, strict=True))
    return _rows(record, roles, columns)


def _rows(record: Record, roles: Roles, columns: Mapping[str, Floats]) -> MotionRows:
    """Rows of a record whose states, targets and inputs are known."""
    samples = {name: np.asarray(record[name]) for name in roles.channels}
    if roles.timed:
        if record.time is None or counts_rows(record):
            raise RecordError(
                f"{record.label}: a term uses t, the time, but the record has none; name its time column"
                " (time=, --time) or give the sampling rate (fs=, --fs)"
            )
        columns = {**columns, TIME: np.asarray(record.time, dtype=np.float64)}
    observed = {}
    for target in roles.targets:
        own = samples.get(target, columns[target])
        observed[target] = np.where(np.isnan(own), columns[target], own)
    return MotionRows(record.name, record.time, columns, observed, samples, has_all(record, roles))


def _require_integrable(records: Sequence[Record], chain: Chain, smooth: Smooth) -> None:
    """Check the channels of a chain whose coordinate is not measured, and that it can be integrated."""
    for record in records:
        require_usable(record, [name for name in chain.measured if name is not None])
    where = records[0].label
    lacking = None
    if any(record.time is None for record in records):
        lacking = "a time column or fs"
    elif sum(record.n for record in records) < STATES.few_rows:
        lacking = f"{STATES.few_rows} rows or more"
    elif smooth == "none":
        lacking = "smooth='auto'"
    if lacking is not None:
        raise ChainError(f"{where}: chain {str(chain)!r} has to be integrated, which needs {lacking}")


# A filter is fitted to at least ROWS_PER_SAMPLE rows for each of its taps; more than MOST_ROWS rows are not needed.
ROWS_PER_SAMPLE = 10
MOST_ROWS = 20_000

# Noise smaller than this share of a channel cannot be distinguished from rounding.
ROUNDING_NOISE = 1e-4

# Eigenvalues of the covariance of neighbouring samples smaller than this share of the largest are rounding.
ROUNDING = 1e-13

# Differences of this order are mostly noise. Of those of the steps of a running integral, regression on those of the
# integrand leaves less than INTEGRATED: 0.00 for sums and trapezoids, 0.83 to 1.00 for a separate sensor.
DIFFERENCES, INTEGRATED, LEAST_STEPS = 8, 0.05, 40

# Shares of half the sampling rate above which spectra of noise are compared, and the log odds that decide. Of 144
# channels of a Duffing oscillator under 0.1 to 3 % of noise 4 were taken for the other kind.
ABOVE, NATS = (0.33, 0.4, 0.5), 3.0


def measured_apart(
    records: Sequence[Record], chains: Sequence[Chain], share: float = 0.0
) -> tuple[tuple[Chain, ...], list[str]]:
    """The chains without channels that were computed from a lower one, and a message for each chain that has some.

    Such channels keep their names and are to be estimated. Noise levels are learned without the last `share` of rows.
    """
    out, messages = [], []
    for chain in chains:
        computed = _computed(records, chain, share) if sum(m is not None for m in chain.measured) > 1 else {}
        if computed:
            for source in dict.fromkeys(computed.values()):
                own = [k for k, one in computed.items() if one == source]
                others = source if own[0] > chain.measured.index(source) else "the others"
                messages.append(
                    f"{', '.join(chain.names[k] for k in own)}: computed from {source}, not measured: estimated from"
                    f" {others} again (smooth='none': taken as it is)"
                )
            measured = tuple(None if k in computed else name for k, name in enumerate(chain.measured))
            chain = Chain(measured, tuple(None if m else chain.own_name(k) for k, m in enumerate(measured)))
        out.append(chain)
    return tuple(out), messages


def _computed(records: Sequence[Record], chain: Chain, share: float) -> dict[int, str]:
    """Orders of the channels that were computed from another one of the chain, and the channel that they are from."""
    names = [name for name in chain.measured if name is not None]
    if not all(name in record.channels and usable(known(record[name])) for record in records for name in names):
        # reported where channels are checked
        return {}
    even = [on_grid(record, names) for record in records]
    if not all(record.is_uniform() for record in even):
        return {}
    cuts = [cut_at(record.n, share) for record in even]
    integrals = {
        k: high
        for k, (low, high) in enumerate(itertools.pairwise(chain.measured))
        if low is not None and high is not None and _is_integral(even, cuts, low, high)
    }
    source = next(name for k, name in enumerate(chain.measured) if name is not None and k not in integrals)
    samples = [record[source][:cut] for record, cut in zip(even, cuts, strict=True)]
    noise = _rough_noise(samples)
    suspected = []
    for k, name in enumerate(chain.measured):
        if name is None or name == source or k in integrals:
            continue
        fitted = _filter(even, cuts, source, name)
        if fitted is not None and fitted[0] < STATES.computed * fitted[1] * noise:
            suspected.append((k, *fitted))
    if not suspected:
        return integrals
    # the noise of the lowest channel, estimated from it alone
    try:
        lowest = tuple(name if name == source else None for name in chain.measured)
        _, alone = smooth_chain(even, Chain(lowest), cuts)
    except RecordError:  # noise and motion cannot be told apart: neither can measured channels and computed ones
        return integrals
    noise = float(alone.model.noise_sd[chain.measured.index(source)] or 0.0)
    if noise / float(np.nanstd(np.concatenate(samples))) < ROUNDING_NOISE:
        return integrals
    return integrals | {k: source for k, left, gain in suspected if left < STATES.computed * gain * noise}


def _is_integral(records: Sequence[Record], cuts: Sequence[int], low: str, high: str) -> bool:
    """Whether a channel is the running integral of the next derivative: its steps then have the noise of that one.

    High differences are compared, so that offsets and drifts that were removed from the integral do not matter. A step
    of a sum or of a trapezoid is a combination of the two samples at its ends, that of an exact motion is not.
    """
    pieces = [record[high][:cut] for record, cut in zip(records, cuts, strict=True)]
    whole = np.concatenate(pieces)
    if not _rough_noise([whole]) > ROUNDING_NOISE * float(np.nanstd(whole)):  # smooth channels are alike
        return False
    if _of_differences(pieces):  # the steps of a channel are also the samples of its differences
        return False
    steps, ends = [], []
    for record, cut in zip(records, cuts, strict=True):
        steps.append(np.diff(record[low][:cut], 1 + DIFFERENCES))
        differences = np.diff(record[high][:cut], DIFFERENCES)
        ends.append(np.column_stack([differences[:-1], differences[1:]]))
    y, Z = np.concatenate(steps), np.concatenate(ends)
    usable = np.isfinite(y) & np.isfinite(Z).all(axis=1)
    if usable.sum() < LEAST_STEPS:
        return False
    y, Z = y[usable], Z[usable]
    left = y - Z @ np.linalg.lstsq(Z, y)[0]
    return float(left @ left) < INTEGRATED**2 * float(y @ y)


def _of_differences(pieces: Sequence[Floats]) -> bool:
    """Whether noise has the spectrum of differences of white noise, 2 - 2 cos w, and clearly not a flat one, by
    Whittle's likelihood (1953) of the frequencies above one of ABOVE: motion that reaches there looks flatter."""
    gains = np.zeros(len(ABOVE))
    for piece in pieces:
        power = np.abs(np.fft.rfft(np.nan_to_num(piece - np.nanmean(piece)) * np.hanning(len(piece)))) ** 2
        shape = 2.0 - 2.0 * np.cos(np.linspace(0.0, math.pi, len(power)))
        for k, share in enumerate(ABOVE):
            P, s = (one[int(share * len(power)) :] for one in (np.maximum(power, np.finfo(np.float64).tiny), shape))
            gains[k] += len(P) * math.log(P.mean() / (P / s).mean()) - float(np.log(s).sum())
    return bool(gains.max() > NATS)


def _rough_noise(pieces: Sequence[Floats]) -> float:
    """Upper bound of the standard deviation of white noise: differences of a high order are taken as noise alone."""
    differences = np.concatenate([np.diff(piece, DIFFERENCES) for piece in pieces])
    known = differences[np.isfinite(differences)]
    return float(np.sqrt(np.mean(known**2) / comb(2 * DIFFERENCES, DIFFERENCES))) if len(known) else 0.0


def _filter(records: Sequence[Record], cuts: Sequence[int], source: str, name: str) -> tuple[float, float] | None:
    """Least-squares filter from one channel to another: sd of the residual, gain for white noise; None: few rows."""
    blocks, targets = [], []
    rows = 0
    for record, cut in zip(records, cuts, strict=True):
        x, y = np.asarray(record[source][:cut]), np.asarray(record[name][:cut])
        if len(x) <= 2 * STATES.filter_reach or rows > MOST_ROWS:
            continue
        X = np.lib.stride_tricks.sliding_window_view(x[:MOST_ROWS], 2 * STATES.filter_reach + 1)
        Y = y[STATES.filter_reach : STATES.filter_reach + len(X)]
        known = np.isfinite(X).all(axis=1) & np.isfinite(Y)
        blocks.append(X[known])
        targets.append(Y[known])
        rows += int(known.sum())
    taps = 2 * STATES.filter_reach + 1
    if rows < ROWS_PER_SAMPLE * taps:
        return None
    X, Y = np.concatenate(blocks), np.concatenate(targets)
    centre, middle = X.mean(axis=0), Y.mean()
    # neighbouring samples are nearly the same: directions that are rounding are left out
    weights = np.linalg.lstsq((X - centre).T @ (X - centre), (X - centre).T @ (Y - middle), rcond=ROUNDING)[0]
    left = Y - middle - (X - centre) @ weights
    return float(np.sqrt(left @ left / (rows - taps - 1))), float(np.linalg.norm(weights))
