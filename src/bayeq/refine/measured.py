"""What is measured, as free runs are fitted to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayeq.expressions.tape import IndexArray
from bayeq.forecast.dynamics import Dynamics
from bayeq.refine.known import Known

__all__ = ["Measured", "Piece"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows of a record that parameters are estimated from.

    Attributes
    ----------
    time : (n,) array
        [s].
    inputs : (n, k, 4) array
        From `bayeq.ode.rk4.interpolant`.
    states : (n, d) array
        Measured or estimated states, from which the initial states of segments are taken at first.
    channels : (n, m) array
        What is measured of states and targets; NaN where a sample is missing.
    """

    time: Floats
    inputs: Floats
    states: Floats
    channels: Floats


@dataclass(frozen=True, eq=False)
class Measured:
    """What free runs are fitted to.

    Attributes
    ----------
    dynamics : Dynamics
    pieces : sequence of Piece
        One per record.
    names : tuple of str
        States and targets that the pieces' channels are.
    step : float
        Longest step of integration [s].
    low, high : (d,) arrays
        Range of the states; a run that leaves it has infinite cost.
    given : Known or None
        What is known of the parameters; None where all are free.
    noise : mapping of str to float
        Standard deviations of channels whose noise is known.
    """

    dynamics: Dynamics
    pieces: Sequence[Piece]
    names: tuple[str, ...]
    step: float
    low: Floats
    high: Floats
    given: Known | None = None
    noise: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def known(self) -> Known:
        """What is known of the parameters."""
        return self.given or Known.nothing(self.dynamics.size)

    @cached_property
    def channels(self) -> IndexArray:
        """The channels as numbers, (m,): state i is i, target k is d + k."""
        states = self.dynamics.states
        places = {name: i for i, name in enumerate(states)}
        places |= {target: len(states) + k for k, target in enumerate(self.dynamics.targets)}
        return np.array([places[name] for name in self.names], dtype=np.uint32)

    @cached_property
    def longest(self) -> int:
        """Rows of the longest piece."""
        return max(len(piece.time) for piece in self.pieces)

    @cached_property
    def rows(self) -> int:
        """Rows of all pieces."""
        return sum(len(piece.time) for piece in self.pieces)

    @cached_property
    def samples(self) -> NDArray[np.intp]:
        """Measured samples of each channel, (m,)."""
        return np.asarray(np.sum([np.isfinite(piece.channels).sum(axis=0) for piece in self.pieces], axis=0))

    @cached_property
    def spread(self) -> Floats:
        """Standard deviation of each channel over all pieces, (m,)."""
        return np.asarray(np.nanstd(np.concatenate([piece.channels for piece in self.pieces]), axis=0))

    @cached_property
    def known_noise(self) -> Floats:
        """Known standard deviation of each channel's noise, (m,); NaN where it is not known."""
        return np.array([self.noise.get(name, np.nan) for name in self.names])
