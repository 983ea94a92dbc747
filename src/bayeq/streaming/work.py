"""What is computed of every unit of rows: moments of rows as they are, or the likelihood about a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import RecordError
from bayeq.expressions import Expression
from bayeq.likelihood.block import Block, block_of
from bayeq.likelihood.fit import State
from bayeq.likelihood.search import Task
from bayeq.records import Record
from bayeq.states import Motion, Roles
from bayeq.states.bad_samples import Learned
from bayeq.states.derive import derive_states
from bayeq.states.motion import further_rows
from bayeq.states.prepare import cleaned, divided_at_gaps
from bayeq.streaming.extent import Extent, Unit
from bayeq.streaming.moments import Folded, fold_columns

__all__ = ["BLOCK_ROWS", "AsMeasured", "ByLikelihood", "OfRows"]

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

#: Rows whose likelihood is computed together: of the state before them nothing is known, which costs what some hundred
#: rows tell; and the memory of 1 kB a row.
BLOCK_ROWS = 2**16


@dataclass(frozen=True)
class OfRows:
    """Moments of training rows and of rows held out, and the times between which they are.

    Attributes
    ----------
    train, held_out : Folded
        Their moments.
    extent : int
        The extent of the last row.
    first, last : float
        Times of the first row and of the last one; NaN where they are not known.
    """

    train: Folded
    held_out: Folded
    extent: int
    first: float
    last: float

    def __add__(self, other: OfRows) -> OfRows:
        if self.extent == other.extent and other.first <= self.last:
            raise RecordError(
                f"record {other.extent + 1}: time goes back from {self.last:.9g} to {other.first:.9g} s; sort the"
                " rows by time"
            )
        train, held_out = self.train + other.train, self.held_out + other.held_out
        return OfRows(train, held_out, other.extent, self.first, other.last)


class UnitColumns(NamedTuple):
    """States, inputs and targets of a unit of rows.

    Attributes
    ----------
    train, held_out : mapping of str to (n,) array
        Of rows for training, and held out.
    first, last
        As in `OfRows`.
    """

    train: dict[str, Floats]
    held_out: dict[str, Floats]
    first: float
    last: float


@dataclass(frozen=True)
class AsMeasured:
    """Moments of the rows as they are, states that are not measured by central differences.

    Attributes
    ----------
    extents : tuple of Extent
        The rows.
    roles : Roles
        Chains and inputs.
    terms : tuple of Expression
        The candidates.
    share : float
        Of the rows of each extent, the last, held out.
    """

    extents: tuple[Extent, ...]
    roles: Roles
    terms: tuple[Expression, ...]
    share: float

    @property
    def reach(self) -> int:
        """Rows beside a unit that central differences look at."""
        estimated = any(name is None for chain in self.roles.chains for name in chain.measured)
        return max(chain.order for chain in self.roles.chains) if estimated else 0

    def on(self, extents: Sequence[Extent]) -> AsMeasured:
        """The same of the same rows, kept elsewhere."""
        return replace(self, extents=tuple(extents))

    def __call__(self, unit: Unit) -> OfRows:
        rows = self.columns(unit)
        parts = [fold_columns(self.terms, columns, self.roles.targets) for columns in (rows.train, rows.held_out)]
        return OfRows(parts[0], parts[1], unit.extent, rows.first, rows.last)

    def columns(self, unit: Unit) -> UnitColumns:
        """The columns of a unit."""
        extent = self.extents[unit.extent]
        start, stop = max(unit.start - self.reach, extent.start), min(unit.stop + self.reach, extent.stop)
        record = extent.read(start, stop)
        own = slice(unit.start - start, unit.stop - start)
        first, last = (np.nan, np.nan) if record.time is None else map(float, record.time[own][[0, -1]])
        bounds = np.array([unit.start, max(unit.start, min(unit.stop, extent.cut(self.share))), unit.stop]) - start
        columns = derive_states(record, self.roles.chains, self.roles.inputs).columns
        begin, cut, end = bounds.tolist()
        train = {name: values[begin:cut] for name, values in columns.items()}
        held_out = {name: values[cut:end] for name, values in columns.items()}
        return UnitColumns(train, held_out, first, last)


@dataclass(frozen=True)
class ByLikelihood:
    """The likelihood of the rows about a fit to some of them.

    Attributes
    ----------
    extents : tuple of Extent
        The rows.
    motion : Motion
        How rows are smoothed; its own rows are not needed.
    task, state : Task, State
        The fit.
    learned : Learned
        What bad samples are judged by.
    """

    extents: tuple[Extent, ...]
    motion: Motion
    task: Task
    state: State
    learned: Learned

    @classmethod
    def of(cls, extents: Sequence[Extent], motion: Motion, task: Task, state: State, learned: Learned) -> ByLikelihood:
        """Without the rows and paths of the fit, so that it is small."""
        motion = replace(motion, records=(), cuts=())
        task = replace(task, series=(), recent=[])
        return cls(tuple(extents), motion, task, replace(state, paths=(), blurs=()), learned)

    @property
    def reach(self) -> int:
        """None: of the rows beside a unit nothing is known."""
        return 0

    def on(self, extents: Sequence[Extent]) -> ByLikelihood:
        """The same of the same rows, kept elsewhere."""
        return replace(self, extents=tuple(extents))

    def __call__(self, unit: Unit) -> Block:
        record, roles = self.extents[unit.extent].read(unit.start, unit.stop), self.motion.roles
        (clean,), _ = cleaned([record], roles, "auto", self.learned.copy())
        pieces, _ = divided_at_gaps([clean], roles, "auto")
        block = block_of(self.task, self.state, [further_rows(piece, self.motion) for piece in pieces if piece.n > 1])
        return replace(block, absent=_absent(record, clean, roles))


def _absent(record: Record, clean: Record, roles: Roles) -> Counts:
    """Samples of each channel that are missing, and that were left out as bad, (2, C)."""
    used = (*roles.measured, *roles.inputs)
    missing, absent = ([int(np.isnan(one[name]).sum()) for name in used] for one in (record, clean))
    return np.array([missing, np.subtract(absent, missing)])
