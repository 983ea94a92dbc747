"""Rows of a free vibration at rest: before the release, and after the motion has died out or friction holds it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Floats
from bayeq.records import Record
from bayeq.states.roles import Roles

# A record is examined in blocks of at least ROWS rows, of which there are about BLOCKS; it needs LEAST of them.
ROWS, BLOCKS, LEAST = 16, 250, 20

# The last blocks that are examined for rest, as a share of all.
TAIL = 0.25

# A tail is at rest if its mean square is below this share of the largest, and changes by STEADY standard
# errors at most from its first half to its second.
SMALL, STEADY = 0.01, 3.0

# Median of the magnitude of a standard normal variable.
NORMAL = 0.6745

# A block moves if its mean square is ABOVE times the largest of the tail, or NOISY times that of white noise.
ABOVE, NOISY = 1.5, 3.0


def without_rest(records: Sequence[Record], roles: Roles) -> tuple[list[Record], list[str]]:
    """The records of free vibrations without rows at rest at either end, and a message for each that is shortened.

    There the law says little: before a release something holds the body, and afterwards static friction may. No record
    is shortened if an input drives the motion, or if a chain is no oscillator: a state of first order approaches its
    equilibrium, which is part of its law.
    """
    free = not roles.drivers and not roles.discrete and not roles.hidden
    if not free or any(chain.order != 2 for chain in roles.chains):
        return list(records), []
    kept, messages = list[Record](), list[str]()
    for record in records:
        start, stop = moving_rows(np.column_stack([record[name] for name in roles.measured]))
        kept.append(record if stop - start == record.n else record.slice(start, stop))
        parts = [f"{start} rows before the motion"] if start else []
        parts += [f"{record.n - stop} rows after it"] if stop < record.n else []
        if parts:
            messages.append(f"{record.label}: at rest, so left out: {' and '.join(parts)}")
    return kept, messages


def moving_rows(values: Floats) -> tuple[int, int]:
    """The first row of channels (n, C) that move, and the row after the last one; all rows if neither end rests."""
    n = len(values)
    width = max(ROWS, n // BLOCKS)
    count = n // width
    if count < LEAST or not np.isfinite(values).all():
        return 0, n
    first, tail = n - count * width, math.ceil(TAIL * count)
    blocks = values[first:].reshape(count, width, -1)
    power = np.mean((blocks - blocks[-tail:].mean(axis=(0, 1))) ** 2, axis=1)
    ends = power[-tail:]
    halves = ends[: tail // 2], ends[tail // 2 :]
    error = np.sqrt(sum(half.var(axis=0) / len(half) for half in halves))
    steady = np.abs(halves[0].mean(axis=0) - halves[1].mean(axis=0)) <= STEADY * error
    limit, stop = ABOVE * ends.max(axis=0), n
    if (steady & (ends.mean(axis=0) < SMALL * power.max(axis=0))).all():
        last = int(np.flatnonzero((power > limit).any(axis=1))[-1])
        stop = min(first + (last + 2) * width, n)
    else:
        third = np.median(np.abs(np.diff(values, 3, axis=0)), axis=0)
        limit = NOISY * third**2 / (20.0 * NORMAL**2)  # the variance of third differences of white noise is 20
    moves = (np.mean((blocks - blocks[0].mean(axis=0)) ** 2, axis=1) > limit).any(axis=1)
    start = int(np.argmax(moves)) + 1
    # a free vibration that is released at its first row, as most are, leaves that state within a block or two
    return (first + start * width if start > 2 else 0), stop
