"""Channels that were computed from a lower derivative of their chain, not measured.

A velocity may be a sensor's, or somebody differentiated and smoothed the displacement. The second kind tells nothing
that the displacement does not, and its errors are the displacement's, filtered: to fuse both as if their errors were
independent counts the same noise twice, and the filter's gain, below 1, is taken for the motion. They are distinguished
by a filter of the lower channel fitted to the higher one. Of a sensor's velocity it leaves the sensor's noise and,
besides, the displacement's own noise, which the filter lets through and the velocity does not have. Of a computed
velocity it leaves next to nothing, less than that noise of the displacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import RecordError
from bayeq.records import Record
from bayeq.states.derive import known, usable
from bayeq.states.kinematic.chain_smoother import smooth_chain
from bayeq.states.motion import cut_at
from bayeq.states.prepare import on_grid
from bayeq.states.roles import Chain
from bayeq.states.settings import STATES

# A filter is fitted to this many rows for each sample that it takes in, at least; more than this many are not needed.
ROWS_PER_SAMPLE = 10
MOST_ROWS = 20_000

# Noise smaller than this share of a channel is not told from rounding.
ROUNDING_NOISE = 1e-4

# Directions of neighbouring samples smaller than this share of the largest are rounding.
ROUNDING = 1e-13

# Differences of this order are mostly noise.
DIFFERENCES = 8


def measured_apart(
    records: Sequence[Record], chains: Sequence[Chain], share: float = 0.0
) -> tuple[tuple[Chain, ...], list[str]]:
    """The chains without channels that were computed from a lower one, and a message for each chain that has some.

    Such channels keep their names and are to be estimated. Noise levels are not learned from a `share` of the rows, the
    last of each record.
    """
    out, messages = [], []
    for chain in chains:
        computed = _computed(records, chain, share) if sum(m is not None for m in chain.measured) > 1 else []
        if computed:
            source = chain.measured[chain.lowest]
            messages.append(
                f"{', '.join(chain.names[k] for k in computed)}: computed from {source}, not measured: estimated from"
                f" {source} again (smooth='none': taken as it is)"
            )
            measured = tuple(None if k in computed else name for k, name in enumerate(chain.measured))
            called = tuple(name if k in computed else chain.own_name(k) for k, name in enumerate(chain.measured))
            chain = Chain(measured, tuple(None if m else c for m, c in zip(measured, called, strict=True)))
        out.append(chain)
    return tuple(out), messages


def _computed(records: Sequence[Record], chain: Chain, share: float) -> list[int]:
    """Orders of the derivatives that were computed from the lowest measured one."""
    names = [name for name in chain.measured if name is not None]
    if not all(name in record.channels and usable(known(record[name])) for record in records for name in names):
        # reported where channels are checked
        return []
    even = [on_grid(record, names) for record in records]
    if not all(record.is_uniform() for record in even):
        return []
    cuts = [cut_at(record.n, share) for record in even]
    source = names[0]
    samples = [record[source][:cut] for record, cut in zip(even, cuts, strict=True)]
    noise = _rough_noise(samples)
    suspected = []
    for k, name in enumerate(chain.measured):
        if name is None or name == source:
            continue
        fitted = _filter(even, cuts, source, name)
        if fitted is not None and fitted[0] < STATES.computed * fitted[1] * noise:
            suspected.append((k, *fitted))
    if not suspected:
        return []
    # the noise of the lowest channel as it is known alone
    try:
        lowest = tuple(name if name == source else None for name in chain.measured)
        _, alone = smooth_chain(even, Chain(lowest), cuts)
    except RecordError:  # noise and motion cannot be told apart: neither can measured channels and computed ones
        return []
    noise = float(alone.model.noise_sd[chain.lowest] or 0.0)
    if noise / float(np.nanstd(np.concatenate(samples))) < ROUNDING_NOISE:
        return []
    return [k for k, left, gain in suspected if left < STATES.computed * gain * noise]


def _rough_noise(pieces: Sequence[Floats]) -> float:
    """Standard deviation of white noise, if differences of a high order held nothing else: an upper bound."""
    differences = np.concatenate([np.diff(piece, DIFFERENCES) for piece in pieces])
    known = differences[np.isfinite(differences)]
    return float(np.sqrt(np.mean(known**2) / comb(2 * DIFFERENCES, DIFFERENCES))) if len(known) else 0.0


def _filter(records: Sequence[Record], cuts: Sequence[int], source: str, name: str) -> tuple[float, float] | None:
    """Least-squares filter from one channel to another: standard deviation of what it leaves, and its gain for white
    noise; None of too few rows."""
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
