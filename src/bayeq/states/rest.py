"""Rows of a free vibration at rest: before the release, and after the motion has died out or friction holds it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Floats
from bayeq.records import Record
from bayeq.states.bad_samples import MEDIAN_NORMAL
from bayeq.states.roles import Roles

# A record is examined in blocks of at least ROWS rows, of which there are about BLOCKS; it needs LEAST of them.
ROWS, BLOCKS, LEAST = 16, 250, 20

# The last blocks, TAIL of all, are at rest if their mean square is below a share SMALL of the largest, and in their
# second half above a share STEADY of that in the first: of an exponential decay to SMALL only half would be left.
TAIL, SMALL, STEADY = 0.25, 0.01, 0.75

# A block moves if its mean square is ABOVE times the largest of the tail, or NOISY times that of white noise; a row
# moves FAR standard deviations of the noise from the level at first (docs/tables/rest.csv).
ABOVE, NOISY, FAR = 1.5, 3.0, 5.0

# Variance of third differences of white noise.
THIRD = 20.0


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
    before, after = power[-tail : -(tail // 2)].mean(axis=0), power[-(tail // 2) :].mean(axis=0)
    limit, noise, stop = ABOVE * power[-tail:].max(axis=0), power[-tail:].mean(axis=0), n
    if ((after > STEADY * before) & (noise < SMALL * power.max(axis=0))).all():
        stop = min(first + (int(np.flatnonzero((power > limit).any(axis=1))[-1]) + 2) * width, n)
    else:
        noise = np.median(np.abs(np.diff(values, 3, axis=0)), axis=0) ** 2 / (THIRD * MEDIAN_NORMAL**2)
        limit = NOISY * noise
    moves = (np.mean((blocks - blocks[0].mean(axis=0)) ** 2, axis=1) > limit).any(axis=1)
    block = int(np.argmax(moves))
    if block < 2:  # released at its first row, as most free vibrations are, it leaves that state within a block or two
        return 0, stop
    level = blocks[: block - 1].mean(axis=(0, 1))
    near = values[first + (block - 1) * width : first + (block + 1) * width]
    far = (np.abs(near - level) > FAR * np.sqrt(noise)).any(axis=1)
    return first + (block - 1) * width + (int(np.argmax(far)) if far.any() else 2 * width), stop
