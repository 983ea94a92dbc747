"""Spikes, stuck and clipped stretches: where a quick look at all rows suspects some, `find_bad_samples` decides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.inspection.roles import Guess
from bayeq.records import Record
from bayeq.records.findings import clipped_levels, equal_runs
from bayeq.states import Roles
from bayeq.states.bad_samples import BAD, find_bad_samples

__all__ = ["Bad", "find_bad"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Rows that are bad, counted from 1, by channel and kind ("spikes", "stuck", "clipped").
Bad = dict[str, dict[str, list[int]]]

# Files of up to this many rows are looked at as a whole. Of longer ones as many rows at most, in windows around what is
# suspect: a third difference, or a run of equal samples, beyond this many times the usual one.
WHOLE = 20_000
WINDOW = 2_000
SUSPECT = 30.0
LONG_RUN = 10

# A channel that stays at its greatest or least value for fewer rows is not clipped, and need not be sorted.
LEAST_RUN = 3


def find_bad(records: Sequence[Record], guess: Guess, names: Sequence[str]) -> tuple[Bad, int]:
    """Bad samples of the channels, and how many rows were looked at for spikes and stuck stretches.

    Parameters
    ----------
    records : sequence of Record
        Experiments of one file.
    guess : Guess
        Roles: channels of a chain are judged together, all others alone.
    names : sequence of str
        Channels that move.
    """
    found: Bad = {}
    total = sum(record.n for record in records)
    _clipped(records, names, found)
    timed = all(record.time is not None for record in records)
    if not names or not timed:
        return found, 0
    chains = [":".join(name or "" for name in chain) for chain in guess.chains if len(chain) == 3]
    alone = [name for name in names if not any(name in chain for chain in guess.chains if len(chain) == 3)]
    roles = Roles.parse(chains, inputs=alone) if chains else Roles((), tuple(alone))
    looked, first = 0, 0
    for record in records:
        windows = [(0, record.n)] if total <= WHOLE else _windows(record, names, WHOLE - looked)
        for a, b in windows:
            looked += b - a
            (bad,) = find_bad_samples([record.slice(a, b)], roles)
            for name, one in bad.items():
                for kind, rows in one.kinds.items():
                    if kind != "clipped":  # which were looked for everywhere
                        place = found.setdefault(name, {}).setdefault(kind, [])
                        place.extend((np.flatnonzero(rows) + first + a + 1).tolist())
        first += record.n
    order = {name: found[name] for name in names if name in found}
    return {name: {kind: one[kind] for kind in BAD if kind in one} for name, one in order.items()}, looked


def _clipped(records: Sequence[Record], names: Sequence[str], found: Bad) -> None:
    for name in names:
        values = np.concatenate([record[name] for record in records])
        known = values[np.isfinite(values)]
        if not any(_stays(known == level) for level in (known.max(), known.min())):
            continue
        for one in clipped_levels(known):
            rows = found.setdefault(name, {}).setdefault("clipped", [])
            rows.extend((np.flatnonzero(values == one.level) + 1).tolist())


def _stays(rows: Bools) -> bool:
    return bool((rows[: 1 - LEAST_RUN] & rows[1 : 2 - LEAST_RUN] & rows[LEAST_RUN - 1 :]).any())


def _windows(record: Record, names: Sequence[str], most: int) -> list[tuple[int, int]]:
    """Rows around the most suspect places of a long record, as many as may be looked at."""
    length = min(WINDOW, record.n)
    suspect = np.zeros(-(-record.n // length))
    for name in names:
        values = record[name]
        third = np.abs(np.diff(values, 3))
        third[~np.isfinite(third)] = 0.0
        usual = float(np.median(third[:: max(1, len(third) // 50_000)]))  # of a part: only its size matters
        ratio = third / usual if usual > 0.0 else np.where(third > 0.0, SUSPECT, 0.0)
        np.maximum.at(suspect, np.flatnonzero(ratio > SUSPECT) // length, ratio[ratio > SUSPECT])
        starts, lengths = equal_runs(values)
        long = lengths >= max(LONG_RUN, 4.0 * float(np.median(lengths)))
        np.maximum.at(suspect, starts[long] // length, SUSPECT * lengths[long] / LONG_RUN)
    places = [int(k) for k in np.argsort(-suspect, kind="stable") if suspect[k] > 0.0][: max(0, most // length)]
    return [(max(0, min(k * length, record.n - length)), min((k + 1) * length, record.n)) for k in sorted(places)]
