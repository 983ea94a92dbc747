"""Row numbers in place of a time that nobody knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayeq.records.record import Record

__all__ = ["SAMPLES", "UNKNOWN_TIME", "counts_rows", "with_row_numbers"]

#: The unit of time of a record whose time is the number of the row.
SAMPLES = "samples"

UNKNOWN_TIME = (
    "time is not known: row numbers are used as time, derivatives that are not measured and their coefficients are per"
    " sample; give the sampling rate (fs=, --fs) or the column of time (time=, --time)"
)

# Rows are in order of time if a sample of some channel says this much of the next one.
IN_ORDER = 0.5


def counts_rows(record: Record) -> bool:
    """Whether the time of a record is the number of the row.

    Examples
    --------
    >>> [counts_rows(one) for one in with_row_numbers([Record({"x": [1.0, 2.0, 3.0, 5.0, 6.0, 7.0]})])]
    [True]
    """
    return record.units.get("t") == SAMPLES and "t" not in record.channels


def with_row_numbers(records: Sequence[Record]) -> list[Record]:
    """The records with row numbers as time, if none of them has a time; else as they are.

    So are records whose rows follow no order, such as a table of single tests, and those with a channel called t.

    Parameters
    ----------
    records : sequence of Record
        The records.
    """
    if any(record.time is not None or "t" in record.channels or not _in_order(record) for record in records):
        return list(records)
    return [
        Record(
            record.channels,
            np.arange(record.n, dtype=np.float64),
            {**record.units, "t": SAMPLES},
            record.name,
            record.truth,
        )
        for record in records
    ]


def _in_order(record: Record) -> bool:
    """Whether neighbouring samples of a channel are alike, as those of a motion are."""
    for values in record.channels.values():
        known = values[np.isfinite(values)]
        if len(known) < 3:
            continue
        scale = float(np.abs(known).max()) or 1.0
        centred = known / scale - float(np.mean(known / scale))
        if float(centred[1:] @ centred[:-1]) > IN_ORDER * float(centred @ centred) > 0.0:
            return True
    return False
