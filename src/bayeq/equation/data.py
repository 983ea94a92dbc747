"""What `Equations` holds: the single equations and where they come from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bayeq.dictionary import DroppedTerm
from bayeq.equation.equation import Equation
from bayeq.forecast.results import Refinement, Scores
from bayeq.states import Chain, Smooth

__all__ = ["DataSummary", "EquationsBase"]


@dataclass(frozen=True, slots=True)
class DataSummary:
    """What the equations were found from.

    Attributes
    ----------
    files : tuple of str
        Names of the records.
    n, n_train, n_held_out : int
        Rows in all, used, and held out.
    estimated : tuple of str
        Derivatives that were not measured but estimated.
    """

    files: tuple[str, ...]
    n: int
    n_train: int
    n_held_out: int
    estimated: tuple[str, ...] = ()


@dataclass(frozen=True)
class EquationsBase:
    """Fields of `bayeq.Equations`, and the single equations by position and name."""

    equations: tuple[Equation, ...]
    inputs: tuple[str, ...]
    method: str
    dictionary: str
    smooth: Smooth
    data: DataSummary
    dropped: tuple[DroppedTerm, ...] = ()
    warnings: tuple[str, ...] = ()
    constraints: tuple[str, ...] = ()
    scores: Scores | None = None
    refined: Refinement | None = None

    def __len__(self) -> int:
        return len(self.equations)

    def __iter__(self) -> Iterator[Equation]:
        return iter(self.equations)

    def __getitem__(self, key: int | str) -> Equation:
        """By position, or by the name of the target."""
        if isinstance(key, str):
            for equation in self.equations:
                if equation.target == key:
                    return equation
            raise KeyError(key)
        return self.equations[key]

    @property
    def chains(self) -> tuple[Chain, ...]:
        """The kinematic chains."""
        return tuple(equation.chain for equation in self.equations)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the first-order state vector, the order of `rhs`."""
        return tuple(name for chain in self.chains for name in chain.states)
