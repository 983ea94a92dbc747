"""Records that equations are applied to, prepared as `discover` prepares those that it finds equations from."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import DataWarning
from bayeq.records import Record
from bayeq.states import Roles, Sensors, Smooth, estimate_motion
from bayeq.states.prepare import cleaned, divided_at_gaps, has_all

__all__ = ["prepared", "rows_of_record"]

Floats = NDArray[np.float64]


def prepared(
    records: Sequence[Record],
    roles: Roles,
    smooth: Smooth,
    said: Collection[str],
    divide: bool = False,
    level: int = 3,
) -> list[Record]:
    """Records without bad samples, and if wanted divided at gaps.

    Parameters
    ----------
    records : sequence of Record
        As they were measured.
    roles, smooth
        Those of the equations.
    said : collection of str
        Warnings that were given before, which are not given again.
    divide : bool
        Whether records are divided at long gaps; else they keep their rows.
    level : int
        Whose line the warnings name, as in `warnings.warn`; by default that of the caller's caller.

    Warns
    -----
    DataWarning
        Samples that are missing or left out, and gaps.
    """
    found, messages = cleaned(records, roles, smooth)
    if divide:
        found, more = divided_at_gaps(found, roles, smooth)
        messages += more
    for message in dict.fromkeys(messages):
        named = f"{records[0].name or 'record'}: {message}"  # as it is said of several records
        if message not in said and (len(records) > 1 or named not in said):
            warnings.warn(message, DataWarning, stacklevel=level)
    return found


def rows_of_record(record: Record, roles: Roles, smooth: Smooth, sensors: Sensors) -> dict[str, Floats]:
    """States and inputs at every row of a record (n,), with straight lines where `estimate_motion` has no row."""
    rows = estimate_motion([record], roles, smooth, sensors=sensors).records[0]
    if rows.n == record.n:
        return dict(rows.columns)
    if record.time is None or rows.time is None:
        places, there = np.arange(record.n), np.flatnonzero(has_all(record, roles))
    else:
        places, there = np.asarray(record.time), np.asarray(rows.time)
    return {name: np.interp(places, there, values) for name, values in rows.columns.items()}
