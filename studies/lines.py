"""Tables of studies on standard output, line by line as they come."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable, Mapping

__all__ = ["print_table"]


def print_table(lines: Iterable[Mapping[str, object]]) -> None:
    """Write lines as CSV, each as soon as it is there; the first names the columns."""
    writer: csv.DictWriter[str] | None = None
    for line in lines:
        if writer is None:
            writer = csv.DictWriter(sys.stdout, list(line), lineterminator="\n")
            writer.writeheader()
        writer.writerow(line)
        sys.stdout.flush()
