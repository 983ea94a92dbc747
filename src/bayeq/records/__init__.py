"""Records: measured channels, and the files they come from.

`read` goes by a file's content, `write` by its suffix; `Record` holds the channels, their time and units; `Truth` what
is known about a simulated one. Nothing here imports pandas or pyarrow before it is needed.
"""

from bayeq.records.findings import Finding, check_record
from bayeq.records.io import as_record, as_records, read, write
from bayeq.records.record import Record, Truth
from bayeq.records.repair import correct_delay, counts_rows, join, remove_offset, with_row_numbers

__all__ = [
    "Finding", "Record", "Truth", "as_record", "as_records", "check_record", "correct_delay", "counts_rows", "join",
    "read", "remove_offset", "with_row_numbers", "write",
]  # fmt: skip
