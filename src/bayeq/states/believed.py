"""Records that are believed up to a frequency: hum, lines of the spectra above it, is taken out of them.

What is faster and no line stays: it is the noise of a channel, or harmonics of the motion, which tell terms
apart. What varies slower than is believed is a state of the likelihood (`bayeq.likelihood.layout`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import RecordError
from bayeq.records import Record
from bayeq.records.record import with_only, with_samples
from bayeq.records.validate import even_step
from bayeq.states.prepare import on_grid
from bayeq.states.settings import STATES

# ... and this share of the channel's power: less is nothing, which channels without noise have much of.
LEAST = 1e-6

# Bins on either side, without the nearest, which a line reaches with Hann's window.
BESIDE, LOBE = 50, 3

# Lines of a record, at most: one whose amplitude varies takes several. Shorter records have one in ROWS_EACH rows.
MOST_LINES, ROWS_EACH = 20, 100

# Lines that a message lists.
SHOWN = 6

# Turns of the refinement of a frequency between bins.
TURNS = 40


def without_hum(
    records: Sequence[Record], names: Sequence[str], low: float, high: float
) -> tuple[list[Record], list[str]]:
    """Some channels of records without the lines that stand out of their spectra above what is believed, and a message.

    `low` and `high` are frequencies [Hz], NaN a missing sample. A RecordError says that a record is not sampled evenly,
    or slower than the band.
    """
    found, heard = [], set[float]()
    for record in records:
        where, even = record.name or "record", on_grid(record, names)
        step = None if even.time is None else even_step(np.asarray(even.time))
        if step is None:
            raise RecordError(
                f"{where}: a band of frequencies needs records that are sampled evenly; leave the band out, or resample"
            )
        fs = 1.0 / step
        if low >= 0.5 * fs:
            raise RecordError(
                f"{where}: the band {low:g} to {high:g} Hz is above half of the sampling rate, {0.5 * fs:g} Hz"
            )
        values = np.column_stack([np.asarray(even[name], dtype=np.float64) for name in names])
        values, lines = _without_lines(values, high / fs)
        heard.update(round(fs * line, 2) for line in lines)
        found.append(with_samples(with_only(even, names), dict(zip(names, values.T, strict=True))))
    some = sorted(heard)[:SHOWN]
    listed = ", ".join(f"{line:g}" for line in some) + (f" and {len(heard) - SHOWN} more" if len(heard) > SHOWN else "")
    return found, [f"hum above the band was taken out of all channels, at {listed} Hz"] if heard else []


def _without_lines(values: Floats, above: float) -> tuple[Floats, list[float]]:
    """Channels (n, M) without what they have at the frequencies of lines, and these [cycles per sample].

    The same is taken out of all: an equation that is linear there stays as it is.
    """
    known, rows = np.isfinite(values), np.arange(len(values), dtype=np.float64)
    window, rest, lines = np.hanning(len(values) + 2)[1:-1], values, list[float]()
    while len(lines) < min(MOST_LINES, len(values) // ROWS_EACH):
        whole = np.column_stack(
            [np.interp(rows, rows[seen], own[seen]) for own, seen in zip(rest.T, known.T, strict=True)]
        )
        windowed = window[:, None] * (whole - whole.mean(axis=0))
        power = np.abs(np.fft.rfft(windowed, axis=0)) ** 2
        ratios = np.column_stack([_above_both_sides(own) for own in power.T])
        ratios[: int(np.ceil(above * len(values)))] = 0.0
        best, channel = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
        if not ratios[best, channel] > STATES.hum_line:
            break
        lines.append(_refined(windowed[:, channel], float(best) / len(values)))
        waves = 2.0 * np.pi * rows[:, None] * np.array(lines)
        both = np.hstack([np.cos(waves), np.sin(waves)])
        # amplitudes and phases may vary in proportion to time: so do those of a frequency that is a little off
        basis = np.hstack([both, np.linspace(-1.0, 1.0, len(rows))[:, None] * both, np.ones((len(rows), 1))])
        rest = np.empty_like(values)
        for i, seen in enumerate(known.T):
            # with the window, or what is slow and strong would leave a trace at the lines
            weight = window[seen, None]
            fitted = np.linalg.lstsq(weight * basis[seen], weight[:, 0] * values[seen, i])[0]
            rest[:, i] = values[:, i] - basis[:, :-1] @ fitted[:-1]
    return rest, lines


def _above_both_sides(power: Floats) -> Floats:
    """Power of each bin over the larger median of the bins on either side."""
    padded = np.pad(power, BESIDE + LOBE, mode="reflect")
    sides = np.median(np.lib.stride_tricks.sliding_window_view(padded, BESIDE), axis=1)
    level = np.maximum(sides[: len(power)], sides[BESIDE + 2 * LOBE + 1 :][: len(power)])
    seen = (level > 0.0) & (power > LEAST * power.sum())
    return np.where(seen, power / np.where(seen, level, 1.0), 0.0)


def _refined(windowed: Floats, near: float) -> float:
    """The frequency within a bin at which the transform is greatest, by golden sections."""
    rows, golden = np.arange(len(windowed)), 0.5 * (np.sqrt(5.0) - 1.0)

    def power(frequency: float) -> float:
        return float(abs(np.exp(-2j * np.pi * frequency * rows) @ windowed))

    low, high = near - 1.0 / len(rows), near + 1.0 / len(rows)
    for _ in range(TURNS):
        left, right = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, right) if power(left) > power(right) else (left, high)
    return 0.5 * (low + high)
