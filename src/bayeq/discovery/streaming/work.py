"""Units of rows, and the statistics computed of each: moments, products of residuals, or the likelihood."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bayeq.arrays import Floats, Ints
from bayeq.errors import RecordError
from bayeq.expressions import Evaluator, Expression, Tape
from bayeq.expressions.evaluate import registers_for, run_on_rows
from bayeq.inference.gram import Moments
from bayeq.inference.gram_products import add_products, block_for
from bayeq.kernels import kernel
from bayeq.likelihood.block import Block, block_of
from bayeq.likelihood.fit import State
from bayeq.likelihood.model import Task
from bayeq.numerics.distributions import correlation
from bayeq.numerics.settings import STREAMING
from bayeq.records import Record, counts_rows, with_row_numbers
from bayeq.records.stream import Stream, units_between
from bayeq.resumable import Progress
from bayeq.states import Motion, Roles
from bayeq.states.bad_samples import Learned
from bayeq.states.derive import derive_states
from bayeq.states.motion import cut_at, further_rows
from bayeq.states.prepare import cleaned, divided_at_gaps

Of = TypeVar("Of")

#: Rows of each of the stretches that are fitted first.
ROWS_EACH = 5000


@dataclass(frozen=True)
class Extent:
    """Rows `start` to `stop` of a stream."""

    stream: Stream
    start: int
    stop: int

    @property
    def n(self) -> int:
        return self.stop - self.start

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop` of the stream; the row number is the time if there is no other."""
        (record,) = with_row_numbers([self.stream.read(start, stop)])
        if record.time is None or not counts_rows(record):
            return record
        return Record(record.channels, record.time + start, record.units, record.name)

    def cut(self, share: float) -> int:
        """The first row that is held out."""
        return self.start + cut_at(self.n, share)


@dataclass(frozen=True, order=True)
class Unit:
    """Rows `start` to `stop` of the extent with number `extent`, which are read together."""

    extent: int
    start: int
    stop: int

    @property
    def n(self) -> int:
        return self.stop - self.start


def units_of(extents: Sequence[Extent], most: int | None = None) -> list[Unit]:
    """The units of some extents, in order, divided into parts of at most `most` rows if that is given."""
    out = []
    for k, one in enumerate(extents):
        for start, stop in units_between(one.stream.bounds, one.start, one.stop):
            parts = 1 if most is None else -(-(stop - start) // most)
            bounds = np.linspace(start, stop, parts + 1).round().astype(int).tolist()
            out += [Unit(k, a, b) for a, b in pairwise(bounds)]
    return out


def of_channels(extents: Sequence[Extent], channels: Sequence[str]) -> tuple[Extent, ...]:
    """These rows, restricted to the given channels and time; all channels if none is given."""
    if not channels:
        return tuple(extents)
    return tuple(replace(one, stream=one.stream.of(list(channels))) for one in extents)


def stretches(extents: Sequence[Extent]) -> list[Record]:
    """Records of stretches spread evenly over the extents; short extents are taken whole."""
    total = sum(one.n for one in extents)
    out: list[Record] = []
    for one in extents:
        length = min(ROWS_EACH, one.n) if total > STREAMING.stretches * ROWS_EACH else one.n
        if length == one.n:
            out.append(one.read(one.start, one.stop))
            continue
        count = max(1, round(STREAMING.stretches * one.n / total))
        for first in np.linspace(one.start, one.stop - length, count).round().astype(int).tolist():
            record = one.read(first, first + length)
            name = f"{record.name}, rows {first + 1:,} to {first + record.n:,}"
            out.append(Record(record.channels, record.time, record.units, name))
    return out


@dataclass(frozen=True)
class Work(ABC, Generic[Of]):
    """A statistic of units of rows whose values can be added; it can be sent to other processes."""

    extents: tuple[Extent, ...]

    @property
    def reach(self) -> int:
        """How many rows before and after a unit are read."""
        return 0

    def on(self, extents: Sequence[Extent]) -> Self:
        """The same work on other storage of the same rows."""
        return replace(self, extents=tuple(extents))

    @abstractmethod
    def __call__(self, unit: Unit) -> Of:
        """The statistic of a unit."""


#: Computes a `Work` for units; yields, in order, a number of consecutive units and the sum of their statistics.
Executor = Callable[[Work[Any], Sequence[Unit]], Iterator[tuple[int, Any]]]


def by_threads(work: Work[Of], units: Sequence[Unit], workers: int | None = None) -> Iterator[tuple[int, Of]]:
    """An `Executor`: threads of this process, by default as many as cores; few units are in memory at a time."""
    from joblib import cpu_count  # which takes a while to import

    workers = workers or cpu_count()
    waiting: deque[Any] = deque()
    with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
        try:
            for unit in units:
                waiting.append(pool.submit(work, unit))
                if len(waiting) > workers:
                    yield 1, waiting.popleft().result()
            yield from ((1, one.result()) for one in waiting)
        finally:
            pool.shutdown(cancel_futures=True)


def fold(
    work: Work[Of], units: Sequence[Unit], executor: Executor, progress: Progress, stage: str, kept: Any = None
) -> Of:
    """The sum of a statistic over at least one unit; a Checkpoint `kept`, if given, saves intermediate sums."""
    # One tuple, so that number and sum agree wherever an interrupt falls.
    so_far: tuple[int, Any] = (0, None) if kept is None else kept.load()
    rows = [0, *accumulate(unit.n for unit in units)]
    progress(stage, rows[so_far[0]], rows[-1])
    try:
        for count, part in executor(work, units[so_far[0] :]):
            done, total = so_far
            so_far = done + count, part if total is None else total + part
            progress(stage, rows[so_far[0]], rows[-1])
            if kept is not None:
                kept.save(*so_far, last=so_far[0] == len(units))
    except BaseException:
        if kept is not None and so_far[0]:
            kept.save(*so_far, last=True)
        raise
    found: Of = so_far[1]
    return found


#: Rows whose likelihood is computed together. The state before them is unknown, which costs the information of some
#: hundred rows; each row takes 1 kB of memory.
BLOCK_ROWS = 2**16

# Rows whose terms are evaluated together: a block of some 40 columns, 0.6 MB, stays in the second-level cache.
ROWS = 2048

# The largest value whose square can be summed over any number of rows, and the square itself.
LARGEST = 1e150
LARGEST_SQUARE = LARGEST**2

# Number of lags; the correlation of residuals rarely reaches further.
LAGS = 4096


@dataclass(frozen=True, eq=False, slots=True)
class Folded:
    """Moments of some rows, and counts of unusable values."""

    # count, means and centred products of the columns of the dictionary and the targets; None without rows
    moments: Moments | None
    bad: Ints  # (P,), rows in which each term is not finite, or too large to square

    def __add__(self, other: Folded) -> Folded:
        if self.moments is None or other.moments is None:
            moments = self.moments if other.moments is None else other.moments
        else:
            moments = self.moments + other.moments
        return Folded(moments, self.bad + other.bad)


@kernel
def _centred(
    code: NDArray[np.uint32], outputs: NDArray[np.uint32], registers: Floats, rows: int, shift: Floats, z: Floats
) -> None:
    """Evaluate the terms on the registers, and write them, less `shift`, to the first rows of z (C, R)."""
    run_on_rows(code, registers, rows, None)
    for i in range(len(outputs)):
        value, out, centre = registers[outputs[i]], z[i], shift[i]
        for j in range(rows):
            out[j] = value[j] - centre


def fold_columns(terms: Sequence[Expression], columns: Mapping[str, Floats], targets: Sequence[str]) -> Folded:
    """Moments of P terms and of targets over the n rows of the columns: states, inputs and targets."""
    names = sorted({name for term in terms for name in term.names})
    tape = Tape.compile([*terms], [*names, *(t for t in targets if t not in names)])
    bad = np.zeros(len(terms), dtype=np.int64)
    given = [columns[name] for name in tape.variables]
    n = len(given[0])
    if not n:
        return Folded(None, bad)
    place = [tape.variables.index(t) for t in targets]
    outputs = np.concatenate([tape.outputs, np.array(place, dtype=np.uint32)])
    registers = registers_for(tape, min(ROWS, n))
    size = len(outputs)
    z, shift = block_for(size, registers.shape[1]), np.zeros(size)
    sums = np.zeros((len(z), len(z)))
    with np.errstate(all="ignore"):
        for start in range(0, n, ROWS):
            rows = min(ROWS, n - start)
            for register, values in zip(registers, given, strict=False):
                register[:rows] = values[start : start + rows]
            if not start:
                shift = _first_means(tape, outputs, registers, rows)
            _centred(tape.code, outputs, registers, rows, shift, z)
            products = np.zeros_like(sums)
            add_products(z, rows, products)
            if not (np.diagonal(products) <= LARGEST_SQUARE).all():
                # values too large to square, or not finite, are counted and replaced by zero
                own, about = z[: len(terms), :rows], shift[: len(terms), None]
                wrong = ~(np.abs(own + about) <= LARGEST)
                bad += wrong.sum(axis=1)
                np.copyto(own, -about, where=wrong)
                products[:] = 0.0
                add_products(z, rows, products)
            sums += products
    rest = sums[size, :size]
    cross = np.tril(sums[:size, :size])
    cross += np.tril(cross, -1).T - np.outer(rest, rest / n)
    return Folded(Moments(n, shift + rest / n, cross), bad)


def _first_means(tape: Tape, outputs: NDArray[np.uint32], registers: Floats, rows: int) -> Floats:
    """Means over the first block (0 if not finite), about which products are summed."""
    z = np.zeros((len(outputs), rows))
    _centred(tape.code, outputs, registers, rows, np.zeros(len(outputs)), z)
    mean = z.mean(axis=1)
    return np.where(np.abs(mean) <= LARGEST, mean, 0.0)


@dataclass(frozen=True)
class OfRows:
    """Moments of training rows and of held-out rows, and times of the first and last row."""

    # moments of both
    train: Folded
    held_out: Folded
    extent: int  # the extent of the last row
    # times of the first and the last row [s]; NaN if unknown
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


@dataclass(frozen=True)
class _Rows(Work[Of]):
    """A statistic of rows as measured; states that are not measured are estimated by central differences."""

    roles: Roles
    terms: tuple[Expression, ...]  # terms to evaluate
    share: float  # share of the rows of each extent, the last ones, that is held out

    @property
    def reach(self) -> int:
        """Rows before and after a unit that central differences need."""
        estimated = any(name is None for chain in self.roles.chains for name in chain.measured)
        return max(chain.order for chain in self.roles.chains) if estimated else 0

    def columns(self, unit: Unit) -> tuple[dict[str, Floats], dict[str, Floats], float, float]:
        """States, inputs and targets of the rows for training and held out; times of the first and last row, or NaN."""
        extent = self.extents[unit.extent]
        start, stop = max(unit.start - self.reach, extent.start), min(unit.stop + self.reach, extent.stop)
        record = extent.read(start, stop)
        begin, end = unit.start - start, unit.stop - start
        first, last = (np.nan, np.nan) if record.time is None else map(float, record.time[[begin, end - 1]])
        cut = max(unit.start, min(unit.stop, extent.cut(self.share))) - start
        columns = derive_states(record, self.roles.chains, self.roles.inputs)
        train = {name: values[begin:cut] for name, values in columns.items()}
        held_out = {name: values[cut:end] for name, values in columns.items()}
        return train, held_out, first, last


@dataclass(frozen=True)
class AsMeasured(_Rows[OfRows]):
    """Moments of the terms and targets; see `_Rows`."""

    def __call__(self, unit: Unit) -> OfRows:
        *columns, first, last = self.columns(unit)
        train, held_out = (fold_columns(self.terms, one, self.roles.targets) for one in columns)
        return OfRows(train, held_out, unit.extent, first, last)


@dataclass(frozen=True, eq=False)
class Lagged:
    """Sums of products of residuals some rows apart."""

    products: Floats  # (LAGS,), sum of e(t + k) e(t) over the rows, at lags k
    # the first and the last residuals of the rows, up to LAGS - 1 each
    first: Floats
    last: Floats
    # the extent of the last row, and the number of rows
    extent: int
    n: int

    @classmethod
    def of(cls, e: Floats, extent: int) -> Lagged:
        """Sums for the residuals e (n,) of consecutive rows."""
        return cls(_products(e, e), e[: LAGS - 1], e[-(LAGS - 1) :], extent, len(e))

    def __add__(self, other: Lagged) -> Lagged:
        products = self.products + other.products
        first, last = self.first, other.last
        if self.extent == other.extent:
            both = np.concatenate([self.last, other.first])
            products = products + _products(both, both) - _products(self.last, self.last)
            products -= _products(other.first, other.first)
            if len(other.last) < LAGS - 1:
                last = np.concatenate([self.last, other.last])[-(LAGS - 1) :]
        return Lagged(products, first, last, other.extent, self.n + other.n)


def _products(a: Floats, b: Floats) -> Floats:
    """Sum of a(t + k) b(t) at each lag."""
    found = correlation([a], [b])[:LAGS]
    return np.pad(found, (0, LAGS - len(found)))


@dataclass(frozen=True, eq=False)
class LaggedResiduals(_Rows[Lagged]):
    """Products of the residuals of the training rows of a model with these `terms`; see `_Rows`."""

    target: str
    coef: Floats  # (r,); coefficients of the terms
    constant: float  # subtracted from the residuals, so that their mean is zero

    def __call__(self, unit: Unit) -> Lagged:
        columns = self.columns(unit)[0]
        evaluate = Evaluator(columns)
        e = columns[self.target] - self.constant
        for term, theta in zip(self.terms, self.coef.tolist(), strict=True):
            e = e - theta * evaluate(term)
        return Lagged.of(e, unit.extent)


@dataclass(frozen=True)
class ByLikelihood(Work[Block]):
    """The likelihood of the rows, expanded about a fit to some of them."""

    motion: Motion  # settings of the smoother; its records are removed
    task: Task
    state: State  # of the fit
    learned: Learned  # models of channels, to find bad samples

    @classmethod
    def of(cls, extents: Sequence[Extent], motion: Motion, task: Task, state: State, learned: Learned) -> Self:
        """The work without the records and paths of the fit, so that it is small to send."""
        motion = replace(motion, records=(), cuts=())
        task = replace(task, series=())
        return cls(tuple(extents), motion, task, replace(state, paths=(), blurs=()), learned)

    def __call__(self, unit: Unit) -> Block:
        record, roles = self.extents[unit.extent].read(unit.start, unit.stop), self.motion.roles
        (clean,), _ = cleaned([record], roles, "auto", deepcopy(self.learned))
        pieces, _ = divided_at_gaps([clean], roles, "auto")
        block = block_of(self.task, self.state, [further_rows(piece, self.motion) for piece in pieces if piece.n > 1])
        missing, absent = ([int(np.isnan(one[name]).sum()) for name in roles.channels] for one in (record, clean))
        # samples of each channel that are missing, and that were left out as bad
        return replace(block, absent=np.array([missing, np.subtract(absent, missing)]))
