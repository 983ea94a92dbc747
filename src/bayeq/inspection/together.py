"""One command for several files of the same system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bayeq.inspection.contents import Contents
from bayeq.inspection.proposal import Proposal, propose

__all__ = ["proposal_for_all"]


def proposal_for_all(found: Sequence[Contents]) -> Proposal | None:
    """The command for all files; None for one, or where channels, roles or the way to read them differ."""
    first = found[0]
    alike = [(one.guess.chains, one.guess.inputs, replace(one.reading, files=())) for one in found]
    if len(found) < 2 or any(one != alike[0] for one in alike):
        return None
    files = tuple(file for one in found for file in one.reading.files)
    return propose(first.guess, first.clues, replace(first.reading, files=files), sum(one.rows for one in found))
