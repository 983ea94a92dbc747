"""What was found out about a record or a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bayeq.inspection.channels import ChannelInfo
from bayeq.inspection.links import Link
from bayeq.inspection.proposal import Proposal, Reading
from bayeq.inspection.roles import Clue, Guess
from bayeq.inspection.samples import Bad
from bayeq.inspection.timing import Experiments, Gap

__all__ = ["Contents"]


@dataclass(frozen=True, eq=False)
class Contents:
    """What is in a record or a file.

    Attributes
    ----------
    name : str
        File or label.
    rows : int
        In all experiments.
    experiments : Experiments
        The rows by experiment, and the columns that were taken for time and for numbers of experiments.
    fs : float or None
        Sampling rate [Hz], the median one where steps are uneven; None without time.
    uniform : bool
        Whether all steps of time are the same.
    duration : float or None
        Of all experiments together [s].
    gaps : tuple of Gap
        Steps of time longer than 2.5 usual ones.
    channels : mapping of str to ChannelInfo
        Numbers of each channel.
    bad : mapping
        Rows (counted from 1) that are spikes, stuck or clipped, by channel and kind.
    looked_at : int
        Rows that were searched for spikes and stuck stretches: all of a record of up to 20,000 rows and 16 channels,
        the most suspect stretches of a larger one.
    copies : mapping of str to str
        Channels that are the same as another one, which is described instead.
    links : tuple of Link
        Channels that are derivatives of each other.
    guess : Guess
        Likely roles of the channels.
    findings : tuple of str
        What was noticed, a sentence each.
    proposal : Proposal
        What to run next.
    clues : mapping of str to Clue
        What unit and name of each channel say.
    reading : Reading
        How the file is to be read.
    """

    name: str
    rows: int
    experiments: Experiments
    fs: float | None
    uniform: bool
    duration: float | None
    gaps: tuple[Gap, ...]
    channels: Mapping[str, ChannelInfo]
    bad: Bad
    looked_at: int
    copies: Mapping[str, str]
    links: tuple[Link, ...]
    guess: Guess
    findings: tuple[str, ...]
    proposal: Proposal
    clues: Mapping[str, Clue]
    reading: Reading
