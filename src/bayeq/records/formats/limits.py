"""What a damaged or hostile file may cost: claimed sizes are checked before anything is allocated."""

from __future__ import annotations

import json
import math
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from bayeq.errors import FULL, BayeqError, FileFormatError

#: A file may unpack to this many times its size ...
MOST_RATIO = 100
#: ... or to this many bytes, whichever is more,
SMALL_BYTES = 64 * 2**20
#: and never to more than this.
MOST_BYTES = 4 * 2**30
#: Columns of a table, the width of an Excel sheet.
MOST_COLUMNS = 16_384


def check_claim(where: str, what: str, claimed: int, stored: int) -> None:
    """Refuse what claims to unpack to more than 4 GiB, or to more than 64 MiB and 100 times what the file holds.

    `where` and `what`, the file and the part of it, are for the message; sizes are in bytes.
    """
    if claimed > MOST_BYTES:
        raise FileFormatError(f"{where}: {what} takes {in_words(claimed)}; at most {in_words(MOST_BYTES)} are read")
    if claimed > max(SMALL_BYTES, MOST_RATIO * stored):
        raise FileFormatError(
            f"{where}: {what} claims {in_words(claimed)} in a file of {in_words(stored)}; more than {MOST_RATIO} times"
            " the file's size is not read: the file is damaged, or unpack it yourself first"
        )


def check_array(where: str, what: str, shape: Sequence[int], itemsize: int, stored: int) -> None:
    """Refuse an array whose shape claims far more than the file holds."""
    if any(length < 0 for length in shape):
        raise FileFormatError(f"{where}: {what} has the shape {tuple(shape)}; the file is damaged")
    # as float64, which every channel becomes
    check_claim(where, what, math.prod(int(length) for length in shape) * max(itemsize, 8), stored)


def in_words(size: int) -> str:
    """A number of bytes as text.

    Examples
    --------
    >>> in_words(2_400_000_000), in_words(2048)
    ('2.24 GiB', '2 KiB')
    """
    for unit, factor in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size} bytes"


def stored_units(text: str | bytes) -> dict[str, str]:
    """Units by name that bayeq wrote into a file as JSON; none of other JSON."""
    found = json.loads(text)
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, dict) else {}


@contextmanager
def reading(where: str, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into a FileFormatError with the first line of its message.

    Its warnings are dropped in the main thread. Filters of warnings belong to all threads: of several that change them
    and put them back, one leaves behind what it found of another, and warnings of ours would be lost.
    """
    try:
        if threading.current_thread() is threading.main_thread():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield
        else:
            yield
    except (BayeqError, FileNotFoundError, PermissionError, IsADirectoryError):
        raise
    except MemoryError:
        raise FileFormatError(f"{where}: not a readable {kind} (it claims more than there is memory)") from None
    except Exception as error:  # parsers of others raise anything on damaged bytes
        if isinstance(error, OSError) and error.errno in FULL:  # a copy of what the file holds
            raise
        lines = [line for line in str(error).splitlines() if line.strip()]
        text = "".join(c for c in lines[0] if c.isprintable())[:120] if lines else ""
        reason = f"{type(error).__name__}: {text}" if text else type(error).__name__
        raise FileFormatError(f"{where}: not a readable {kind} ({reason})") from None
