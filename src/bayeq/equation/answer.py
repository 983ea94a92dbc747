"""What the text and the files of equations are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol, Self

from bayeq.equation.equation import Equation
from bayeq.equation.verdict import Verdict
from bayeq.forecast.score import Scores
from bayeq.plan.conditions import Measured
from bayeq.records import Record, counts_rows
from bayeq.refine.refine import Refinement
from bayeq.regression.design import DroppedTerm
from bayeq.states import Chain, Motion, Roles, Sensors, Smooth

if TYPE_CHECKING:
    from bayeq.forecast.dynamics import Dynamics
    from bayeq.regression.constraints import Constraints

__all__ = ["Answer", "DataSummary"]


@dataclass(frozen=True, slots=True)
class DataSummary:
    """What the equations were found from.

    Attributes
    ----------
    files : tuple of str
        Names of the records.
    n, n_train, n_held_out : int
        Measured rows in all, used, and held out.
    refitted : bool
        Whether, scored on the rows held out, the equations were then found once more, from all rows.
    estimated : tuple of str
        Derivatives that were not measured but estimated.
    smoothed : bool
        Whether by the kinematic smoother.
    holdout : float
        Share of the rows of each record that was held out.
    measured : Measured
        Rates and ranges, for the plan of a next measurement.
    sensors : Sensors
        What was known of the channels.
    seconds : float or None
        Length of all records together [s]; None where time is not known.
    rows_as_time : bool
        Whether the number of the row was taken for time, which was not known: coefficients are per sample.
    band : (float, float) or None
        Frequencies [Hz] between which the equations were to be fitted.
    stretches : int
        Number of stretches of long records that noise levels, verdict and free runs are of; 0 if of all rows.
    """

    files: tuple[str, ...]
    n: int
    n_train: int
    n_held_out: int
    estimated: tuple[str, ...] = ()
    smoothed: bool = False
    holdout: float = 0.0
    refitted: bool = False
    measured: Measured = field(default_factory=Measured)
    sensors: Sensors = field(default_factory=Sensors)
    seconds: float | None = None
    rows_as_time: bool = False
    band: tuple[float, float] | None = None
    stretches: int = 0

    def of_stretches(self, files: Sequence[str], used: int, held_out: int, stretches: int) -> Self:
        """The summary of all rows, this being that of some stretches of them."""
        n = used + held_out
        seconds = None if self.seconds is None else self.seconds * n / max(self.n, 1)
        return replace(
            self,
            files=tuple(dict.fromkeys(files)),
            n=n,
            n_train=used,
            n_held_out=held_out,
            seconds=seconds,
            stretches=stretches,
        )

    @property
    def fs(self) -> float | None:
        """Sampling rate [Hz] of the longest record; None where time is not known."""
        return None if self.rows_as_time else self.measured.fs

    @classmethod
    def of(cls, records: Sequence[Record], motion: Motion, refitted: bool = False) -> Self:
        """The summary of some records and their motion."""
        used, held_out = motion.counts
        rows_as_time = any(map(counts_rows, records))
        lengths = [0.0 if record.fs is None else record.n / record.fs for record in records]
        return cls(
            files=tuple(dict.fromkeys(record.name for record in records)),
            n=used + held_out,
            n_train=used,
            n_held_out=held_out,
            estimated=motion.estimated,
            smoothed=bool(motion.smoothing),
            holdout=motion.holdout,
            refitted=refitted,
            measured=Measured.of(records, motion.roles.measured, motion.roles.inputs),
            sensors=motion.sensors,
            seconds=None if rows_as_time or not motion.timed else sum(lengths),
            rows_as_time=rows_as_time,
            band=motion.band,
        )


class Answer(Protocol):
    """What other parts need of `bayeq.Equations`."""

    @property
    def equations(self) -> tuple[Equation, ...]: ...
    @property
    def inputs(self) -> tuple[str, ...]: ...
    @property
    def method(self) -> str: ...
    @property
    def dictionary(self) -> str: ...
    @property
    def smooth(self) -> Smooth: ...
    @property
    def data(self) -> DataSummary: ...
    @property
    def dropped(self) -> tuple[DroppedTerm, ...]: ...
    @property
    def warnings(self) -> tuple[str, ...]: ...
    @property
    def constraints(self) -> tuple[str, ...]: ...
    @property
    def scores(self) -> Scores | None: ...
    @property
    def refined(self) -> Refinement | None: ...
    @property
    def chains(self) -> tuple[Chain, ...]: ...
    @property
    def roles(self) -> Roles: ...
    @property
    def verdict(self) -> Verdict: ...
    def known(self) -> tuple[Constraints, ...]: ...
    def dynamics(self, intercepts: Sequence[bool] | None = None) -> Dynamics: ...
