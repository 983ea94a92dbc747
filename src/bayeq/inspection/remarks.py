"""What was noticed in a file, a sentence each: what it is, where, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

from bayeq.inspection.contents import Contents
from bayeq.states.bad_samples import ADVICE

__all__ = ["remarks"]

# Rows that are listed.
LISTED = 3


def remarks(found: Contents, checks: Sequence[str]) -> list[str]:
    """Sentences about time, experiments, channels and samples, then what channels say of each other."""
    return [*_time(found), *_experiments(found), *_channels(found), *_bad(found), *checks]


def _time(found: Contents) -> list[str]:
    out = []
    column = found.experiments.time
    if column is not None and not found.experiments.restarts:
        out.append(
            f"time: no column has its name; {column}, which rises from row to row, is taken, in seconds unless its"
            " header has a unit"
        )
    if found.experiments.step is not None:
        out.append(f"time: {found.experiments.step} is constant and named as the time step [s]: taken for it")
    if found.experiments.counter is not None:
        out.append(f"{found.experiments.counter} counts the rows: it is no channel and no time")
    if found.fs is not None and not found.uniform:
        out.append("steps of time are uneven: spectra are those of samples interpolated between them")
    if found.gaps:
        longest = max(found.gaps, key=lambda gap: gap.seconds)
        count = len(found.gaps)
        what = "1 gap" if count == 1 else f"{count} gaps, the longest"
        out.append(
            f"time: {what} of {longest.seconds:.4g} s after row {longest.row}; discover divides the record at gaps"
            " that are too long to bridge"
        )
    return out


def _experiments(found: Contents) -> list[str]:
    one = found.experiments
    count = len(one.records)
    if count == 1:
        return [f"{one.column} numbers the experiments: there is one"] if one.column else []
    least, most = min(record.n for record in one.records), max(record.n for record in one.records)
    rows = f"{least} row{'s' * (least != 1)} each" if least == most else f"{least} to {most} rows each"
    if one.column is not None:
        return [f"{count} experiments, {rows}, numbered by {one.column}"]
    first = 1 + one.records[0].n
    return [
        f"{count} experiments, {rows}: time starts over, first in row {first}, and no column numbers them; add one and"
        " name it with --group, or write a file for each"
    ]


def _channels(found: Contents) -> list[str]:
    out = [f"{name} is the same as {other}: left out" for name, other in found.copies.items()]
    for name, channel in found.channels.items():
        if channel.missing == found.rows:
            out.append(f"{name} has no samples")
        elif channel.missing:
            share = f"{100.0 * channel.missing / found.rows:.3g}"
            samples = "1 sample is" if channel.missing == 1 else f"{channel.missing} samples are"
            out.append(f"{name}: {samples} missing ({share} %)")
        if channel.constant and channel.missing < found.rows:
            out.append(f"{name} is constant, {channel.least:.6g}: it says nothing of the motion")
        if channel.resolution is not None:
            out.append(f"{name} has few levels, {channel.resolution:.3g} apart: coarse against its range")
        if channel.held is not None:
            out.append(f"{name} changes in every {channel.held:.2g} rows only: it is sampled slower than the file")
    return out


def _bad(found: Contents) -> list[str]:
    out = []
    for name, kinds in found.bad.items():
        for kind, rows in kinds.items():
            listed = ", ".join(map(str, rows[:LISTED])) + (", ..." if len(rows) > LISTED else "")
            what = {"spikes": "spike" if len(rows) == 1 else "spikes", "stuck": "stuck samples"}
            out.append(
                f"{name}: {len(rows)} {what.get(kind, 'clipped samples')}, row{'s' * (len(rows) > 1)} {listed};"
                f" discover leaves them out; {ADVICE[kind]}"
            )
    if 0 < found.looked_at < found.rows:
        out.append(
            f"spikes and stuck samples were looked for in the most suspect {found.looked_at} of {found.rows} rows"
        )
    return out
