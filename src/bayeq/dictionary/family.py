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
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()

    @property
    def known(self) -> tuple[str, ...]:
        """The same, and t, the time."""
        return self.names if TIME in self.names else (*self.names, TIME)

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.states, *self.inputs)
