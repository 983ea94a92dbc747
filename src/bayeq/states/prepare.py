"""Records as all stages take them: what is no measurement left out, missing samples bridged or a gap of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import RecordError
from bayeq.records import Record, split_at_gaps
from bayeq.states.bad_samples import Learned, listed, without_bad_samples
from bayeq.states.derive import Smooth, require_usable
from bayeq.states.roles import Roles
from bayeq.states.uniform_grid import filled_in
from bayeq.states.unit_gains import bridged

__all__ = [
    "LEAST_USABLE",
    "bridged_record",
    "cleaned",
    "complete_rows",
    "divided_at_gaps",
    "has_all",
    "inputs_filled",
    "missing_messages",
    "require_enough",
    "without_empty_rows",
]

Bools = NDArray[np.bool_]

# Fewer rows with all channels are no record.
LEAST_USABLE = 10

# Stretches of more than this many rows without an input, or without any sample of the chains, become gaps of time: the
# record is divided at those that are too long to be bridged.
SHORT = 2


def cleaned(
    records: Sequence[Record], roles: Roles, smooth: Smooth, learned: Learned | None = None
) -> tuple[list[Record], list[str]]:
    """The records, row by row, with NaN in place of bad samples; with "none" as they are.

    Parameters
    ----------
    records : sequence of Record
        Of one system.
    roles : Roles
        Chains and inputs.
    smooth : "auto", "band" or "none"
        As `discover` takes it.
    learned : Learned, optional
        By what bad samples are judged, of other records of the system; what is missing there is added.

    Returns
    -------
    list of Record, list of str
        The records, and a message for each channel of which samples are missing or left out.

    Raises
    ------
    UnknownNameError, RecordError
        Channels that are missing, infinite, or too large to square.
    """
    if smooth == "none":
        return list(records), []
    missing = missing_messages(records, roles)
    for record in records:
        require_usable(bridged_record(record, roles), roles.channels)
    found, bad = without_bad_samples(records, roles, learned)
    return found, [*missing, *bad]


def divided_at_gaps(records: Sequence[Record], roles: Roles, smooth: Smooth) -> tuple[list[Record], list[str]]:
    """Cleaned records in pieces without gaps that are too long to bridge, and a message for each that had some.

    With "none" they stay whole.
    """
    if smooth == "none":
        return list(records), []
    return split_at_gaps(without_empty_rows(records, roles), roles.channels)


def missing_messages(records: Sequence[Record], roles: Roles) -> list[str]:
    """A sentence for each channel of which samples are missing."""
    out = []
    for record in records:
        where = f"{record.name or 'record'}: " if len(records) > 1 else ""
        for name in roles.channels:
            rows = np.isnan(record[name])
            count = int(rows.sum())
            if count:
                samples = "1 sample is" if count == 1 else f"{count} samples are"
                share = f"{100 * count / record.n:.2g} %"
                out.append(f"{where}{name}: {samples} missing ({listed(rows)}: {share}); check the acquisition")
    return out


def has_all(record: Record, roles: Roles) -> Bools:
    """Rows with a sample of every channel that is used, (n,)."""
    return np.all([np.isfinite(record[name]) for name in roles.channels], axis=0)


def require_enough(records: Sequence[Record], roles: Roles) -> None:
    """Raise a RecordError unless 10 rows have a sample of every channel."""
    usable = sum(int(has_all(record, roles).sum()) for record in records)
    if usable < LEAST_USABLE:
        where, total = ", ".join(record.name or "record" for record in records[:3]), sum(r.n for r in records)
        rows = f"{usable} row{'s' * (usable != 1)}"
        usable_of = rows if usable == total else f"{rows} of {total} with a sample of every channel"
        raise RecordError(f"{where}: {usable_of}: too few for a regression (at least {LEAST_USABLE}); measure more")


def complete_rows(record: Record, roles: Roles) -> Record:
    """The record without rows in which a sample is missing."""
    kept = has_all(record, roles)
    return record if kept.all() else record.take(kept)


def without_empty_rows(records: Sequence[Record], roles: Roles) -> list[Record]:
    """Records without rows that tell nothing of the motion, and so with a gap of time there.

    These are stretches of more than two rows without a sample of any chain, or without an input. Without time there is
    nothing to bridge by: rows without a sample of every channel go.
    """
    out = []
    for record in records:
        if record.time is None:
            out.append(complete_rows(record, roles))
            continue
        kept = ~_long(np.all([np.isnan(record[name]) for name in roles.measured], axis=0))
        for name in roles.inputs:
            kept &= ~_long(np.isnan(record[name]))
        out.append(record if kept.all() else record.take(kept))
    return out


def _long(missing: Bools) -> Bools:
    """Stretches of more than two."""
    out = np.zeros_like(missing)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(np.int8), [0]]))).reshape(-1, 2)
    for first, last in edges:
        out[first:last] = last - first > SHORT
    return out


def bridged_record(record: Record, roles: Roles, most: float = 1.0) -> Record:
    """The record with straight lines over missing samples, of channels that lack no more than a share of theirs."""
    changed = {
        name: bridged(values)
        for name in roles.channels
        if name in record.channels
        and 0.0 < float(np.isnan(values := record[name]).mean()) <= most
        and not np.isinf(values).any()
    }
    if not changed:
        return record
    return record.with_channels(changed, {name: record.units[name] for name in changed if name in record.units})


def inputs_filled(record: Record, inputs: Sequence[str]) -> Record:
    """The record with missing samples of inputs filled in, of which a free run needs every one.

    Raises
    ------
    RecordError
        A gap longer than half the shortest period, at which `discover` would divide the record, or at an end.
    """
    lacking = [name for name in inputs if np.isnan(record[name]).any()]
    if not lacking or record.time is None:
        return record
    gaps = np.any([_long(np.isnan(record[name])) for name in lacking], axis=0)
    if gaps.any() and (gaps[0] or gaps[-1] or len(split_at_gaps([record.take(~gaps)], inputs)[0]) > 1):
        raise RecordError(
            f"{record.name or 'record'}: {', '.join(lacking)}: samples are missing for too long to fill in"
            f" ({listed(gaps)} of those that are run over); run over rows before or after (start, rows)"
        )
    time = np.asarray(record.time)
    changed = {name: filled_in(time, np.asarray(record[name])) for name in lacking}
    return record.with_channels(changed, {name: record.units[name] for name in lacking if name in record.units})
