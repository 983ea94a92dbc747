"""What a term family is given."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.expressions.functions import TIME

__all__ = ["Variables"]


@dataclass(frozen=True, slots=True)
class Variables:
    """The variables that terms are made of.

    Attributes
    ----------
    states : tuple of str
        Coordinates and their derivatives below the target.
    inputs : tuple of str
        Forces and other inputs.
    chains : tuple of tuples of str
        The states chain by chain; empty where that is not known.
    own : int or None
        The chain whose equation the terms are for; None for all.
    targets : tuple of str
        Highest derivatives, which terms of other equations may be proportional to.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    chains: tuple[tuple[str, ...], ...] = ()
    own: int | None = None
    targets: tuple[str, ...] = ()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The lowest state of each chain; all states where chains are not known."""
        return tuple(chain[0] for chain in self.chains if chain) if self.chains else self.states

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.states, *self.inputs)

    @property
    def known(self) -> tuple[str, ...]:
        """The names, those of the targets, and t, the time."""
        names = (*self.names, *self.targets)
        return names if TIME in names else (*names, TIME)
