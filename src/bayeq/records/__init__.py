"""Records: measured channels, and the files they come from.

`read` goes by a file's content, `write` by its suffix (`FORMATS`); `Record` holds the channels, their time and units;
`Truth` what is known about a simulated one. Nothing here imports pandas or pyarrow before it is needed.
"""

from bayeq.records.findings import Finding, check_messages, check_record, without_copies
from bayeq.records.formats import FORMATS, Format
from bayeq.records.io import as_record, as_records, read, write
from bayeq.records.names import RESERVED, clean_name, clean_names
from bayeq.records.record import Record, Truth
from bayeq.records.repair import (
    SAMPLES,
    UNKNOWN_TIME,
    correct_delay,
    counts_rows,
    join,
    remove_offset,
    split_at_gaps,
    with_row_numbers,
)

__all__ = [
    "FORMATS", "RESERVED", "SAMPLES", "UNKNOWN_TIME", "Finding", "Format", "Record", "Truth", "as_record",
    "as_records", "check_messages", "check_record", "clean_name", "clean_names", "correct_delay", "counts_rows", "join",
    "read", "remove_offset", "split_at_gaps", "with_row_numbers", "without_copies", "write",
]  # fmt: skip
