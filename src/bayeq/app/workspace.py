"""The private folder of the page: files that were dropped, and results; it goes when the page ends."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

__all__ = ["LARGEST", "Workspace", "safe_name"]

#: Largest file that is taken from the browser [bytes]; larger ones are opened where they are.
LARGEST = 200_000_000

# Longest name of a file [characters], with its ending.
LONGEST_NAME = 80


class Workspace:
    """A folder that only this user can read.

    Attributes
    ----------
    path : Path
        The folder, of mode 0700.
    """

    def __init__(self) -> None:
        # resolved, as messages of commands that are run in it have no other name for it
        self.path = Path(tempfile.mkdtemp(prefix="bayeq-app-")).resolve()  # mkdtemp makes it private
        self._count = 0

    def new_folder(self) -> Path:
        """An empty folder in it, for a file or a result."""
        self._count += 1
        folder = self.path / str(self._count)
        folder.mkdir(mode=0o700)
        return folder

    def remove(self, folder: Path | None = None) -> None:
        """Remove a folder in it, or all of it.

        Raises
        ------
        ValueError
            The folder is not in it.
        """
        folder = folder or self.path
        if folder != self.path and self.path not in folder.parents:
            raise ValueError(f"{folder} is not in {self.path}")
        shutil.rmtree(folder, ignore_errors=True)


def safe_name(name: str) -> str:
    """A name of a file that came from a browser, as one that can be used: no folder, no sign that means something.

    The ending stays, since it says the format.

    Examples
    --------
    >>> safe_name("../../etc/run 1.csv"), safe_name("-rf <b>.mat"), safe_name("..")
    ('run 1.csv', 'rf _b_.mat', 'record')
    """
    base = name.replace("\\", "/").rsplit("/", 1)[-1]
    clean = re.sub(r"[^\w .()+-]", "_", base).lstrip(" .-").rstrip(" .")
    stem, ending = os.path.splitext(clean or "record")
    if ending.lower() == ".gz":
        stem, inner = os.path.splitext(stem)
        ending = inner + ending
    ending = ending[:LONGEST_NAME]
    # most file systems count bytes, of which a letter may have four
    kept = stem.encode()[: max(LONGEST_NAME - len(ending), 1)].decode(errors="ignore")
    return (kept + ending).rstrip(" .") or "record"
