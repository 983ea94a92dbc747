"""Records as all stages take them: what is no measurement left out, and divided where nothing can bridge a gap."""

from __future__ import annotations

from collections.abc import Sequence

from bayeq.records import Record, split_at_gaps
from bayeq.states.bad_samples import Learned, without_bad_samples
from bayeq.states.derive import Smooth, require_usable
from bayeq.states.missing import bridged_record, missing_messages, without_empty_rows
from bayeq.states.roles import Roles

__all__ = ["cleaned", "divided_at_gaps"]


def cleaned(
    records: Sequence[Record], roles: Roles, smooth: Smooth, learned: Learned | None = None
) -> tuple[list[Record], list[str]]:
    """The records, row by row, with NaN in place of bad samples; with "none" as they are.

    Parameters
    ----------
    records : sequence of Record
        Of one system.
    roles : Roles
        Chains and inputs.
    smooth : "auto", "band" or "none"
        As `discover` takes it.
    learned : Learned, optional
        By what bad samples are judged, of other records of the system; what is missing there is added.

    Returns
    -------
    list of Record, list of str
        The records, and a message for each channel of which samples are missing or left out.

    Raises
    ------
    UnknownNameError, RecordError
        Channels that are missing, infinite, or too large to square.
    """
    if smooth == "none":
        return list(records), []
    missing = missing_messages(records, roles)
    for record in records:
        require_usable(bridged_record(record, roles), [*roles.measured, *roles.inputs])
    found, bad = without_bad_samples(records, roles, learned)
    return found, [*missing, *bad]


def divided_at_gaps(records: Sequence[Record], roles: Roles, smooth: Smooth) -> tuple[list[Record], list[str]]:
    """Cleaned records in pieces without gaps that are too long to bridge, and a message for each that had some.

    With "none" they stay whole.
    """
    if smooth == "none":
        return list(records), []
    return split_at_gaps(without_empty_rows(records, roles), [*roles.measured, *roles.inputs])
