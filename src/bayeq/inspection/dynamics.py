"""Which channels are states of first order, and which drive a motion: by least squares on integrals of the channels.

The change of a channel over a window is the integral of its rate: an equation of motion, integrated over windows, needs
no derivative of what is measured. What is fitted here decides a role, it is no result.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.records import Record

__all__ = ["drivers", "first_order"]

Floats = NDArray[np.float64]

# A channel is a state of first order if this share of its changes is explained by the channels themselves and their
# products; of a coordinate of second order hardly any is, for its rate is a state of its own.
EXPLAINED = 0.8
MOST_STATES = 8
LEAST_ROWS = 16

# A channel drives a motion if it explains this share of what the states and their products leave.
DRIVES = 0.5

# Windows are this part of the period of the fastest channel.
WINDOW = 1 / 8


def first_order(record: Record, names: Sequence[str], others: Sequence[str]) -> dict[str, float]:
    """Channels whose changes are explained by the channels themselves, each with the share that is explained.

    Parameters
    ----------
    record : Record
        A short one, with even steps of time.
    names : sequence of str
        Channels that may be states.
    others : sequence of str
        Inputs.
    """
    scaled = _scaled(record, (*names, *others))
    states = [name for name in names if name in scaled]
    if not states or record.time is None or record.n < LEAST_ROWS or len(scaled) > MOST_STATES:
        return {}
    width = _width(scaled, states)
    terms = _products(list(scaled.values()))
    rows = record.n - width
    if rows < max(LEAST_ROWS, 2 * len(terms)):
        return {}
    D = _integrals(terms, record.time, width)
    out = {}
    for name in states:
        change = scaled[name][width:] - scaled[name][:-width]
        share = 1.0 - _left(D, change) / _spread(change) * (rows - 1) / (rows - D.shape[1])
        if share > EXPLAINED:
            out[name] = share
    return out


def drivers(record: Record, chain: Sequence[str | None], candidates: Sequence[str]) -> dict[str, float]:
    """Channels that explain what the states of a chain leave of its motion, each with the share.

    Parameters
    ----------
    record : Record
        A short one, with even steps of time.
    chain : sequence of str or None
        Displacement, velocity, acceleration; one of the last two is needed.
    candidates : sequence of str
        Channels that may be inputs.
    """
    displacement, velocity, acceleration = chain
    states = [name for name in (displacement, velocity) if name is not None]
    scaled = _scaled(record, [*states, *filter(None, [acceleration]), *candidates])
    target = acceleration or velocity
    if record.time is None or record.n < LEAST_ROWS or target is None or not states:
        return {}
    if any(name not in scaled for name in (*states, target)):
        return {}
    width = _width(scaled, states)
    terms = _products([scaled[name] for name in states]) + [scaled[name] ** 3 for name in states]
    if record.n - width < max(LEAST_ROWS, 4 * len(terms)):
        return {}
    if acceleration is not None:
        change = _integrals([scaled[acceleration]], record.time, width)[:, 1]
    else:
        change = scaled[target][width:] - scaled[target][:-width]
    D = _integrals(terms, record.time, width)
    before = _left(D, change)
    out = {}
    for name in candidates:
        if name in scaled and before > 0.0:
            more = np.column_stack([D, _integrals([scaled[name]], record.time, width)[:, 1]])
            share = 1.0 - _left(more, change) / before
            if share > DRIVES:
                out[name] = share
    return out


def _scaled(record: Record, names: Sequence[str]) -> dict[str, Floats]:
    """Channels without missing samples, of mean 0 and standard deviation 1."""
    out = {}
    for name in names:
        values = record[name]
        if np.isfinite(values).all():
            values = values / (float(np.abs(values).max()) or 1.0)
            out[name] = np.asarray((values - values.mean()) / (float(values.std()) or 1.0))
    return out


def _width(scaled: dict[str, Floats], states: Sequence[str]) -> int:
    """Rows of a window."""
    peaks = [int(np.argmax(np.abs(np.fft.rfft(scaled[name]))[1:])) + 1 for name in states]
    return max(1, round(WINDOW * len(scaled[states[0]]) / max(peaks)))


def _products(channels: Sequence[Floats]) -> list[Floats]:
    """Channels, their squares and their products."""
    return [*channels, *(channels[i] * channels[j] for i in range(len(channels)) for j in range(i + 1))]


def _integrals(terms: Sequence[Floats], time: Floats, width: int) -> Floats:
    """Integrals over windows from row to row, (n - width, P + 1); the first column is that of a constant."""
    steps = np.diff(time)
    columns = [np.ones(len(time) - width)]
    for term in terms:
        area = np.concatenate([[0.0], np.cumsum(0.5 * (term[1:] + term[:-1]) * steps)])
        columns.append(area[width:] - area[:-width])
    return np.column_stack(columns)


def _left(D: Floats, y: Floats) -> float:
    """Sum of squares that least squares leave."""
    rest = y - D @ np.linalg.lstsq(D, y, rcond=None)[0]
    return float(rest @ rest)


def _spread(y: Floats) -> float:
    return max(float(np.sum((y - y.mean()) ** 2)), float(np.finfo(np.float64).tiny))
