"""Records: measured channels, and the files they come from.

`read` recognises a format by content, `write` by suffix; `Record` holds the channels, their time and units; `Truth` the
known equation and clean signals of a simulated record. pandas and pyarrow are imported only when needed.
"""

from bayeq.records.findings import Finding, check_record
from bayeq.records.io import as_record, as_records, read, write
from bayeq.records.record import Record, Truth
from bayeq.records.repair import correct_delay, counts_rows, join, remove_offset, with_row_numbers

__all__ = [
    "Finding", "Record", "Truth", "as_record", "as_records", "check_record", "correct_delay", "counts_rows", "join",
    "read", "remove_offset", "with_row_numbers", "write",
]  # fmt: skip
