"""Missing samples, NaN in a record: which rows can be used, and what becomes of the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import RecordError
from bayeq.records import Record
from bayeq.states.bad_samples import listed
from bayeq.states.roles import Roles
from bayeq.states.unit_gains import bridged

__all__ = [
    "LEAST_USABLE",
    "bridged_record",
    "complete_rows",
    "missing_messages",
    "require_enough",
    "without_empty_rows",
]

Bools = NDArray[np.bool_]

# Fewer rows with all channels are no record.
LEAST_USABLE = 20

# Stretches of more than this many rows without an input, or without any sample of the chains, become gaps of time: the
# record is divided at those that are too long to be bridged.
SHORT = 2


def missing_messages(records: Sequence[Record], roles: Roles) -> list[str]:
    """A sentence for each channel of which samples are missing."""
    out = []
    for record in records:
        where = f"{record.name or 'record'}: " if len(records) > 1 else ""
        for name in (*roles.measured, *roles.inputs):
            rows = np.isnan(record[name])
            count = int(rows.sum())
            if count:
                samples = "1 sample is" if count == 1 else f"{count} samples are"
                share = f"{100 * count / record.n:.2g} %"
                out.append(f"{where}{name}: {samples} missing ({listed(rows)}: {share}); check the acquisition")
    return out


def _complete(record: Record, roles: Roles) -> Bools:
    """Rows with a sample of every channel that is used."""
    return np.all([np.isfinite(record[name]) for name in (*roles.measured, *roles.inputs)], axis=0)


def require_enough(records: Sequence[Record], roles: Roles) -> None:
    """Raise a RecordError unless 20 rows have a sample of every channel."""
    usable = sum(int(_complete(record, roles).sum()) for record in records)
    if usable < LEAST_USABLE:
        where, total = ", ".join(record.name or "record" for record in records[:3]), sum(r.n for r in records)
        rows = f"{usable} row{'s' * (usable != 1)}"
        usable_of = rows if usable == total else f"{rows} of {total} with a sample of every channel"
        raise RecordError(f"{where}: {usable_of}: too few for a regression (at least {LEAST_USABLE}); measure more")


def complete_rows(record: Record, roles: Roles) -> Record:
    """The record without rows in which a sample is missing."""
    kept = _complete(record, roles)
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
        for name in (*roles.measured, *roles.inputs)
        if name in record.channels
        and 0.0 < float(np.isnan(values := record[name]).mean()) <= most
        and not np.isinf(values).any()
    }
    if not changed:
        return record
    return record.with_channels(changed, {name: record.units[name] for name in changed if name in record.units})
