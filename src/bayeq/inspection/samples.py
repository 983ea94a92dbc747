"""Spikes, stuck and clipped stretches: where a quick look at all rows suspects some, `find_bad_samples` decides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.inspection.roles import Guess
from bayeq.records import Record
from bayeq.records.findings import clipped_levels, equal_runs
from bayeq.records.truth import FloatArray
from bayeq.states import Roles
from bayeq.states.bad_samples import BAD, find_bad_samples
from bayeq.states.kinematic.model import LARGEST

__all__ = ["Bad", "find_bad"]

Bools = NDArray[np.bool_]

#: Rows that are bad, counted from 1, by channel and kind ("spikes", "stuck", "clipped").
Bad = dict[str, dict[str, list[int]]]

# Files of up to WHOLE rows and MANY channels are looked at whole. In larger ones windows around what is most suspect,
# of MOST rows in all: a third difference, or a run of equal samples, beyond SUSPECT times the usual one. Beside a
# window there are MARGIN more rows, for a sample is judged by those on both sides of it.
WHOLE, MANY, MOST = 20_000, 16, 8_000
WINDOW, MARGIN = 1_600, 200
SUSPECT = 30.0
LONG_RUN = 10

# A channel that stays at its greatest or least value for fewer rows is not clipped, and need not be sorted.
LEAST_RUN = 3


def find_bad(records: Sequence[Record], guess: Guess, names: Sequence[str]) -> tuple[Bad, int]:
    """Bad samples of channels that move, and how many rows were searched for spikes and stuck stretches.

    The records are experiments of one file; channels of a chain are judged together, all others alone.
    """
    found: Bad = {}
    total = sum(record.n for record in records)
    _clipped(records, names, found)
    timed = all(record.time is not None for record in records)
    # a square of what is larger is infinite
    names = [name for name in names if all(np.nanmax(np.abs(r[name]), initial=0.0) <= LARGEST for r in records)]
    if not names or not timed:
        return found, 0
    looked, first = 0, 0
    for record in records:
        whole = [(0, record.n, set(names))]
        small = total <= WHOLE and len(names) <= MANY
        for a, b, suspects in whole if small else _windows(record, names, MOST - looked):
            looked += b - a
            (bad,) = find_bad_samples([record.slice(a, b)], _roles(guess, names, suspects))
            for name, one in bad.items():
                for kind, rows in one.items():
                    if kind != "clipped":  # which were looked for everywhere
                        place = found.setdefault(name, {}).setdefault(kind, [])
                        found[name][kind] = sorted({*place, *(np.flatnonzero(rows) + first + a + 1).tolist()})
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


def _roles(guess: Guess, names: Sequence[str], suspects: set[str]) -> Roles:
    """Chains and single channels that have suspects among them."""
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


def _suspicious(values: FloatArray) -> list[tuple[int, float]]:
    """Rows of sudden changes and of long runs of equal samples, and how far they are from the usual."""
    third = np.abs(np.diff(values, 3))
    third[~np.isfinite(third)] = 0.0
    usual = float(np.median(third[:: max(1, len(third) // 50_000)]))  # of a part: only its size matters
    limit = SUSPECT * usual if usual > 0.0 else np.inf
    rows = np.flatnonzero(third > limit)
    out = [(int(row) + 1, float(third[row]) / usual) for row in rows[:: max(1, len(rows) // 1000)]]
    starts, lengths = equal_runs(values)
    long = np.flatnonzero(lengths >= max(LONG_RUN, 4.0 * float(np.median(lengths))))
    return out + [(int(starts[k]), SUSPECT * float(lengths[k]) / LONG_RUN) for k in long[:1000]]
