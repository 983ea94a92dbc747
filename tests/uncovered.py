"""The environment of a command that coverage does not watch.

Coverage writes a file when the command ends, and complains where the disk is full; an interrupt that comes while it
holds its lock makes it wait for that lock without end.
"""

from __future__ import annotations

import os

__all__ = ["WITHOUT_PYC", "uncovered"]

#: Where the disk is full: compiled modules that are cut off would be found by whoever runs next.
WITHOUT_PYC = {"PYTHONDONTWRITEBYTECODE": "1"}


def uncovered() -> dict[str, str]:
    """What `os.environ` holds, without what starts coverage in a child process."""
    return {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE_PROCESS_")}
