"""Records that are read some rows at a time, because they are larger than memory or spread over files."""

from bayeq.records.stream.open import LARGE, in_order, open_streams, streamed_unasked
from bayeq.records.stream.rows import FileStream, RecordStream, Stream, units_between

__all__ = [
    "LARGE", "FileStream", "RecordStream", "Stream", "in_order", "open_streams", "streamed_unasked", "units_between",
]  # fmt: skip
