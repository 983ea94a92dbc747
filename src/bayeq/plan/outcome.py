"""What a plan is made of: models, how designs tell them apart, and what its text needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from bayeq.plan.designs import Design

__all__ = ["Compared", "Outcome", "Planned", "Separation"]


@dataclass(frozen=True, slots=True)
class Compared:
    """A model that a plan compares.

    Attributes
    ----------
    target : str
        Of its equation.
    name : str
        The terms, of the leading model; for a rival, in what it differs from that.
    probability : float or None
        None of a leading model that is not among the likeliest: the terms shown may leave out some within a tolerance.
    """

    target: str
    name: str
    probability: float | None


@dataclass(frozen=True, slots=True)
class Separation:
    """How a design tells the leading model from one rival.

    Attributes
    ----------
    rival : int
        Place among the rivals of the plan.
    rate, sd : float
        What the wrong one of the two cannot imitate of the true one, lambda per second, in the less favourable case;
        mean and standard deviation over realisations [nats/s].
    if_leading, if_rival : float or None
        The same if the leading model is true, and if the rival is. None of a rival whose run leaves every range; where
        one model contains the other, only the case counts in which the larger is true.
    seconds : float
        Until the odds for the true one of the two are expected to reach those wanted; the longer of both cases. Where
        one contains the other, if the larger is true.
    by_size : float or None
        Where one contains the other, the same time if the smaller is true: motion cannot show that, and only the Occam
        factor grows.
    """

    rival: int
    rate: float
    sd: float
    if_leading: float
    if_rival: float | None
    seconds: float
    by_size: float | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """A design and what it is expected to tell.

    Attributes
    ----------
    design : Design
    amplitudes : mapping of str to float
        Of each input about its middle.
    limited : bool
        Whether a limit decided the amplitude.
    rate, sd : float
        Information by second [nats/s], mean and standard deviation over realisations: against the closest rival, or of
        the coefficients.
    seconds : float
        Until the models can be told apart (if the larger of nested ones is true), or until standard deviations of the
        coefficients are halved.
    peaks : mapping of str to float
        Largest magnitude of every state, in the mean over realisations.
    separations : tuple of Separation
        The closest rival first; empty where the coefficients are planned for.
    """

    design: Design
    amplitudes: Mapping[str, float]
    limited: bool
    rate: float
    sd: float
    seconds: float
    peaks: Mapping[str, float]
    separations: tuple[Separation, ...] = ()


class Planned(Protocol):
    """The fields of `bayeq.Plan` that its text and its figure show."""

    @property
    def purpose(self) -> Literal["models", "coefficients"]: ...
    @property
    def leading(self) -> tuple[Compared, ...]: ...
    @property
    def rivals(self) -> tuple[Compared, ...]: ...
    @property
    def decided(self) -> Compared | None: ...
    @property
    def outcomes(self) -> tuple[Outcome, ...]: ...
    @property
    def time(self) -> NDArray[np.float64]: ...
    @property
    def inputs(self) -> Mapping[str, NDArray[np.float64]]: ...
    @property
    def offsets(self) -> Mapping[str, float]: ...
    @property
    def odds(self) -> float: ...
    @property
    def conditions(self) -> Mapping[str, Any]: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def ranges(self) -> Mapping[str, float]: ...
    @property
    def best(self) -> Outcome: ...
    def closest(self, outcome: Outcome) -> Compared | None: ...
