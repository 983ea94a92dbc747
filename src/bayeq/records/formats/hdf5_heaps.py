"""Heaps of strings in HDF5 files, looked at before h5py is: HDF5 2.0 walks one with a free object of no size for ever.

Such a heap is what a run that was cut off may leave, and Ctrl-C does not reach a loop of machine code. The layout is
that of section III.E, "Disk Format: Level 1E - Global Heap", of the HDF5 file format specification.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

from bayeq.errors import FileFormatError

__all__ = ["require_sound_heaps"]

# Larger files are not looked through.
LARGEST = 2**30

# With the version; the three bytes that follow are reserved, and HDF5 does not look at them.
_SIGNATURE = b"GCOL\x01"
_OBJECT = struct.Struct("<HHIQ")


def require_sound_heaps(path: Path) -> None:
    """Refuse a file with a heap that does not end.

    Raises
    ------
    FileFormatError
        With the place of the heap.
    """
    if not 0 < path.stat().st_size <= LARGEST:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_SIGNATURE)
        while start >= 0:
            if not _ends(content, start):
                raise FileFormatError(f"{path}: damaged: the strings at byte {start} have no end; write the file again")
            start = content.find(_SIGNATURE, start + len(_SIGNATURE))


def _ends(content: mmap.mmap, start: int) -> bool:
    """Whether the objects of a heap lead to its end."""
    if start + 16 > len(content):
        return True  # which HDF5 says itself
    stop = min(start + struct.unpack_from("<Q", content, start + 8)[0], len(content))
    at = start + 16
    while at + _OBJECT.size <= stop:
        index, _, _, size = _OBJECT.unpack_from(content, at)
        needed = _OBJECT.size + -(-size // 8) * 8 if index else size
        if needed % 2**64 == 0:
            return False
        at += needed
    return True
