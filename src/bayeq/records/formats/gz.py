"""Text compressed by gzip: ``run.csv.gz``."""

from __future__ import annotations

import gzip
import math
import shutil
import tempfile
from pathlib import Path

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns, Names, Select
from bayeq.records.formats import text
from bayeq.records.formats.layout import encodings
from bayeq.records.formats.protocol import check_claim, reading
from bayeq.records.record import Record

_BYTES_AT_ONCE = 2**20


def read_columns(
    path: Path,
    *,
    names: Names = None,
    chosen: Select | None = None,
    skip: int = 0,
    enough: float = math.inf,
    group: str | None = None,
) -> Columns:
    """Unpack into a temporary file, as far as the limits allow, and read that as text, below `skip` lines."""
    where = str(path)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "unpacked"
        stored, written = path.stat().st_size, 0
        with reading(where, ".gz file"), gzip.open(path) as source, plain.open("wb") as out:
            while block := source.read(_BYTES_AT_ONCE):
                written += len(block)
                check_claim(where, "the text", written, stored)
                out.write(block)
        try:
            return text.read_columns(
                plain, names=names, chosen=chosen, where=where, skip=skip, enough=enough, group=group
            )
        except FileFormatError as error:
            if not encodings(plain):
                raise FileFormatError(f"{where}: what it holds is not text; unpack it first") from error
            raise


def write(record: Record, path: Path) -> None:
    """Write a record as compressed text; the same record gives the same bytes."""
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "plain.csv"
        text.write(record, plain)
        # neither the time of day nor the name of the file is written
        with plain.open("rb") as source, path.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=0) as out:
            shutil.copyfileobj(source, out)
