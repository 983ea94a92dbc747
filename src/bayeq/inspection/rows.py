"""The rows of a file: time, experiments and gaps; suspect rows, which `find_bad_samples` judges."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Floats
from bayeq.inspection.roles import Guess
from bayeq.records import Record
from bayeq.records.columns import STEP_NAMES
from bayeq.records.findings import clipped_levels, equal_runs
from bayeq.records.names import is_time_name, time_unit
from bayeq.records.repair import GAP, LONG_GAP
from bayeq.records.validate import SECONDS, in_seconds
from bayeq.states import Roles
from bayeq.states.bad_samples import ADVICE, find_bad_samples
from bayeq.states.derive import LARGEST

Ints = NDArray[np.intp]

# Words for time, and for the number of an experiment, as parts of column names in the usual languages.
TIME_WORDS = ("time", "zeit", "temps", "tiempo", "tempo", "tijd", "year", "jahr", "date", "stamp", "second", "sekunde")
# Words in the names of columns that count time in whole numbers, with or without a plural s.
COUNTED = (
    "day week month quarter hour minute tag tage woche wochen monat monate quartal jahre stunde stunden minuten jour"
    " semaine mois heure annee année an dia día semana mes hora año ano giorno settimana mese ora anno"
)
STEPS_NAMED = frozenset(map(str.casefold, STEP_NAMES))
TRIAL_WORDS = ("trial", "run", "experiment", "exp", "test", "group", "segment", "versuch", "messung", "essai", "set")

# Minimum number of rows of an experiment: a column that changes more often is a signal.
LEAST_ROWS = 20

# A channel rests in a stretch of one period if its standard deviation is below REST of the 90 % quantile over all
# stretches; a motion lasts at least MOVES stretches and exceeds twice that, unlike one that slowly grows or dies out.
REST, MOVES = 0.05, 4

# Minimum number of rows to judge that a column rises steadily.
LEAST_RISING = 8


@dataclass(frozen=True, slots=True)
class Gap:
    """A time step of more than 2.5 median steps."""

    row: int  # last row before it, counted from 1
    seconds: float  # length of the step
    long: bool  # whether it is more than 20 median steps


@dataclass(frozen=True, slots=True)
class Experiments:
    """The rows of a file sorted by experiment."""

    records: tuple[Record, ...]  # with time if known, without the columns of time and of experiment numbers
    time: str | None = None  # column taken for time; None if the record has a time already
    column: str | None = None  # the column that numbers the experiments
    counter: str | None = None  # a column that counts the rows
    step: str | None = None  # a constant column that is the time step, of a file without time
    restarts: bool = False  # whether time starts over within the file
    backwards: bool = False  # whether time falls from row to row


def sort_rows(record: Record, time: str | None = None) -> Experiments:
    """Find the time column (or take `time`) and the column of experiments, and divide the rows by experiment."""
    counter = step = unit = None
    clock: Floats | None = record.time
    if clock is None:
        counter = next(
            (name for name in record.names if _counts_rows(record[name]) and _doubt(record, name) == 2), None
        )
        if not time:  # the column that rises steadily, or starts over: by its unit, its name, or the first there is
            rising = [name for name in record.names if name != counter and _rises(record[name])]
            time = min(rising, key=lambda name: _doubt(record, name), default=None)
        if time is not None:
            clock, unit, _ = in_seconds(record[time], record.units.get(time) or time_unit(time), time)
        elif (step := next((name for name in record.names if _is_step(record, name)), None)) is not None:
            clock = np.asarray(np.arange(record.n) * float(np.nanmax(record[step])), dtype=np.float64)
    backwards = clock is not None and record.n > 2 and bool((np.diff(clock) < 0.0).all())
    if backwards:
        clock = None
    restarts = np.zeros(0, dtype=np.intp) if clock is None else np.flatnonzero(np.diff(clock) < 0.0) + 1
    column = _trial_column(record, restarts, clock, {time, counter, step})
    starts = restarts if column is None else np.union1d(restarts, equal_runs(record[column])[0][1:])
    left_out = {name for name in (time, counter, step, column) if name is not None}
    channels = {name: values for name, values in record.channels.items() if name not in left_out}
    if not channels:
        return Experiments((record,))
    units = {name: unit for name, unit in record.units.items() if name in channels or name == "t"}
    if clock is None or time is not None:
        units.pop("t", None)
    if unit not in (None, "s"):
        units["t"] = unit
    bounds = [0, *starts.tolist(), record.n]
    records = []
    for k, (a, b) in enumerate(pairwise(bounds)):
        name = record.name if len(bounds) == 2 else f"{record.name} [experiment {k + 1}]".strip()
        piece = {key: values[a:b] for key, values in channels.items()}
        records.append(Record(piece, None if clock is None else clock[a:b], units, name, None))
    return Experiments(
        tuple(records), None if backwards else time, column, counter, step, bool(len(restarts)), backwards
    )


def _is_step(record: Record, name: str) -> bool:
    """Whether a column is named as the time step and holds one number, in every row or in the first alone."""
    known = record[name][np.isfinite(record[name])]
    named = name.casefold() in STEPS_NAMED and record.units.get(name, "s") == "s"
    return named and len(known) > 0 and bool(known[0] > 0.0 and (known == known[0]).all())


def _counts_rows(values: Floats) -> bool:
    """Whether a column is 0, 1, 2 ... or 1, 2, 3 ..."""
    return len(values) >= LEAST_RISING and bool(values[0] in (0.0, 1.0) and (np.diff(values) == 1.0).all())


def _doubt(record: Record, name: str) -> int:
    """Doubt that a column is time: 0 if its unit is one of time, 1 if its name is, 2 for neither."""
    if record.units.get(name) in SECONDS:
        return 0
    folded = name.casefold()
    words = {part.removesuffix("s") for part in re.split(r"[\W\d_]+", folded)}
    counted = not words.isdisjoint(word.removesuffix("s") for word in COUNTED.split())
    return 1 if counted or is_time_name(name) or any(word in folded for word in TIME_WORDS) else 2


def _rises(values: Floats) -> bool:
    """Whether a column rises from row to row, except where it starts over."""
    if len(values) < LEAST_RISING or not np.isfinite(values).all():
        return False
    falls = np.flatnonzero(np.diff(values) <= 0.0)
    if not len(falls):
        return True
    back = values[falls + 1] < values[falls]
    lengths = np.diff([0, *(falls + 1), len(values)])
    return bool(back.all() and lengths.min() >= LEAST_ROWS)


def _trial_column(record: Record, restarts: Ints, clock: Floats | None, others: set[str | None]) -> str | None:
    """The column of whole numbers that change where time starts over or has a long gap, or named like trials."""
    for name, values in record.channels.items():
        if name in others or not np.isfinite(values).all() or not (values == np.round(values)).all():
            continue
        named = any(name.casefold().strip("_0123456789") == word for word in TRIAL_WORDS)
        starts, lengths = equal_runs(values)
        if len(starts) == 1:
            if named:
                return name
            continue
        once = len(np.unique(values)) == len(starts)  # a number that comes back is a switch, not a count
        if not once or lengths.min() < LEAST_ROWS:
            continue
        steps = np.zeros(record.n - 1) if clock is None else np.diff(clock)
        at_gaps = bool((steps[starts[1:] - 1] > LONG_GAP * np.median(steps)).all())
        if named or (len(restarts) and set(restarts) <= set(starts)) or at_gaps:
            return name
    return None


def gaps_of(records: Sequence[Record]) -> Iterator[Gap]:
    """Time steps of more than 2.5 median steps in each record; rows are counted over all records."""
    first = 0
    for record in records:
        if record.time is not None and record.n > 2:
            steps = np.diff(record.time)
            usual = float(np.median(steps))
            for row in np.flatnonzero(steps > GAP * usual).tolist():
                yield Gap(first + row + 1, float(steps[row]), bool(steps[row] > LONG_GAP * usual))
        first += record.n


def starts_from_rest(record: Record, names: Sequence[str], period: float) -> list[int]:
    """Rows, from 1, at which channels move again after all rested for a `period` [s]: perhaps another experiment."""
    step = record.dt
    width = max(LEAST_ROWS, math.ceil(period / step)) if step else 0
    channels = [record[name] for name in names if np.isfinite(record[name]).all()]
    if not width or not channels or record.n < 3 * MOVES * width:
        return []
    rows = record.n // width * width
    spreads = [values[:rows].reshape(-1, width).std(axis=1) for values in channels]
    most = np.max([spread / (REST * np.quantile(spread, 0.9)) for spread in spreads], axis=0)
    starts, lengths = equal_runs(most < 1.0)
    moves = [int(a) for a, n in zip(starts, lengths, strict=True) if n >= MOVES and most[a : a + n].max() >= 2.0]
    return [1 + width * start for start in moves[1:]]


# --- bad samples -----------------------------------------------------------------------------------------------------


#: Rows that are bad, counted from 1, by channel and kind ("spikes", "stuck", "clipped").
Bad = dict[str, dict[str, list[int]]]

# Files of up to WHOLE rows and MANY channels are searched whole, larger ones on at most MOST rows: in windows, extended
# by a margin, with third differences beyond SUSPECT times their median or with long runs of equal samples.
WHOLE, MANY, MOST = 20_000, 16, 8_000
WINDOW, MARGIN = 1_600, 200
SUSPECT = 30.0
LONG_RUN = 10


def find_bad(records: Sequence[Record], guess: Guess, names: Sequence[str]) -> tuple[Bad, int]:
    """Bad samples of channels `names`, and the number of rows searched for anything but clipping."""
    found: Bad = defaultdict(lambda: defaultdict(list))
    total = sum(record.n for record in records)
    motion = {name for chain in guess.chains for name in chain}
    for name in names:
        values = np.concatenate([record[name] for record in records])
        for clipping in clipped_levels(values, shut=name not in motion):
            found[name]["clipped"] += (np.flatnonzero(values == clipping.level) + 1).tolist()
    timed = all(record.time is not None for record in records)
    # squares of larger values overflow, those of smaller ones underflow
    sizes = {name: max(float(np.nanmax(np.abs(r[name]), initial=0.0)) for r in records) for name in names}
    every, names = names, [name for name in names if 1 / LARGEST <= sizes[name] <= LARGEST]
    if not names or not timed:
        return _in_order(found, every), 0
    looked, first = 0, 0
    for record in records:
        whole = [(0, record.n, set(names))]
        small = total <= WHOLE and len(names) <= MANY
        for a, b, suspects in whole if small else _windows(record, names, MOST - looked):
            looked += b - a
            (bad,) = find_bad_samples([record.slice(a, b)], _roles(guess, names, suspects))
            for name, one in bad.items():
                for kind, rows in one.items():
                    if kind != "clipped":  # clipping was searched in all rows
                        of_file = (np.flatnonzero(rows) + first + a + 1).tolist()
                        found[name][kind] = sorted({*found[name][kind], *of_file})
        first += record.n
    return _in_order(found, every), looked


def _in_order(found: Bad, names: Sequence[str]) -> Bad:
    """Bad samples by channel, in the order of `names`, and by kind, in the order of `ADVICE`."""
    kept = {name: found[name] for name in names if name in found}
    return {name: {kind: one[kind] for kind in ADVICE if kind in one} for name, one in kept.items()}


def _roles(guess: Guess, names: Sequence[str], suspects: set[str]) -> Roles:
    """Roles of the chains that contain suspects, and the other suspects as inputs."""
    chains = [chain for chain in guess.chains if len(chain) == 3 and set(filter(None, chain)) <= set(names)]
    alone = [name for name in names if name in suspects and not any(name in chain for chain in chains)]
    texts = [":".join(name or "" for name in chain) for chain in chains if suspects.intersection(filter(None, chain))]
    return Roles.parse(texts, inputs=alone) if texts else Roles((), tuple(alone))


def _windows(record: Record, names: Sequence[str], most: int) -> list[tuple[int, int, set[str]]]:
    """First rows and ends of the most suspect stretches of a long record, and the channels that are suspect there."""
    places: dict[int, float] = {}
    suspects: dict[int, set[str]] = {}
    for name in names:
        for row, size in _suspicious(record[name]):
            place = row // WINDOW
            places[place] = max(places.get(place, 0.0), size)
            suspects.setdefault(place, set()).add(name)
    worst = sorted(places, key=lambda place: (-places[place], place))[: max(0, most // (WINDOW + 2 * MARGIN))]
    return [(max(0, k * WINDOW - MARGIN), min((k + 1) * WINDOW + MARGIN, record.n), suspects[k]) for k in sorted(worst)]


def _suspicious(values: Floats) -> list[tuple[int, float]]:
    """Rows of sudden changes and of long runs of equal samples, each with its size relative to the usual one."""
    third = np.abs(np.diff(values, 3))
    third[~np.isfinite(third)] = 0.0
    usual = float(np.median(third[:: max(1, len(third) // 50_000)]))  # of a subsample: its magnitude is enough
    limit = SUSPECT * usual if usual > 0.0 else np.inf
    rows = np.flatnonzero(third > limit)
    out = [(int(row) + 1, float(third[row]) / usual) for row in rows[:: max(1, len(rows) // 1000)]]
    starts, lengths = equal_runs(values)
    long = np.flatnonzero(lengths >= max(LONG_RUN, 4.0 * float(np.median(lengths))))
    return out + [(int(starts[k]), SUSPECT * float(lengths[k]) / LONG_RUN) for k in long[:1000]]
