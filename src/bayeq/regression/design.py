"""The dictionary evaluated on motion, once: columns of the training rows, and Gram matrices of all targets.

Terms that cannot be used are left out here, each with its reason: not finite on the data, constant, or a copy of an
earlier column.

In a dictionary too large to compare all models, the simplest candidates are kept, and those that explain most.
Iterative sure independence screening (Fan and Lv 2008): the columns that correlate most with the target are taken, then
those that correlate most with its residual, after regression of both on the columns taken before, and so on. A term
that matters together with others and not alone comes in a later round. Where terms are nearly the same on the record,
as the monomials of ``(x2-x1)**3`` are, correlations do not show which of them is true: half of the places go to the
simplest terms whatever they explain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.families import degree
from bayeq.errors import InputError
from bayeq.expressions import Expression
from bayeq.inference.gram import Gram, grams_from_blocks
from bayeq.inference.posterior import Posterior
from bayeq.regression.residuals import Residuals
from bayeq.states import Motion, MotionRows

# Rows evaluated at a time where the columns are not kept.
BLOCK_ROWS = 65_536

# Columns of the training rows are kept up to this many numbers in all (400 MB), and evaluated again beyond.
MOST_KEPT = 50_000_000

# The largest value whose square can be summed over any number of rows, and the smallest that keeps its digits.
LARGEST = 1e150
SMALLEST = 1e-150

# Terms of a channel that is larger than this, or smaller than its inverse, are out of range because of its unit.
USUAL = 1e10

# A column counts as constant below this relative spread, and as a copy above this correlation: both are the
# rounding of the centred sums of squares.
CONSTANT_SPREAD = 1e-13
COPY_CORRELATION = 1.0 - 1e-13

# Largest number of rows by which candidates are screened, spread over the records.
ROWS = 4000

# A column is a combination of the columns taken before if regression on these leaves at most this share of its square.
NEARLY_NOTHING = 1e-8

# Rounds in which each equation takes its share.
ROUNDS = 20

# Reason for leaving out a term that equals another one on the data.
COPY = "a copy of {} on the data"


@dataclass(frozen=True, slots=True)
class DroppedTerm:
    """A candidate that was left out, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """A dictionary evaluated on the rows of a motion."""

    motion: Motion  # the rows
    terms: tuple[Expression, ...]  # the P candidates that can be used
    # statistics of the training rows and of the rows held out for each target, as measured where it was; `held_out` is
    # empty if no rows are held out. Rows that were bridged do not count.
    train: tuple[Gram, ...]
    held_out: tuple[Gram, ...]
    dropped: tuple[DroppedTerm, ...]  # candidates left out
    # (n, P), columns on the training rows of each record; empty where there would be too many numbers
    kept: tuple[Floats, ...]
    # (C, P), candidates of each equation; the others are in the dictionaries of other equations only
    allowed: Bools = field(default_factory=lambda: np.ones((1, 1), dtype=np.bool_))
    # where the motion has only some of the rows: a function of the number of an equation, a posterior and the
    # diagnostics of its residuals in these rows, which returns the diagnostics in all rows
    scan: Callable[[int, Posterior, Residuals], Residuals] | None = None

    def __post_init__(self) -> None:
        shape = len(self.motion.roles.chains), len(self.terms)
        object.__setattr__(self, "allowed", np.broadcast_to(self.allowed, shape))

    @property
    def names(self) -> tuple[str, ...]:
        """The candidates as text."""
        return tuple(term.text for term in self.terms)

    def columns(self, i: int) -> Floats:
        """Columns (n, P) on the training rows of record i, not to be written to."""
        return self.kept[i] if self.kept else evaluate_terms(self.terms, self.motion.train[i].columns)


def build_design(
    terms: Sequence[Expression],
    motion: Motion,
    progress: Callable[[int, int], None] | None = None,
    allowed: Bools | None = None,
) -> Design:
    """Evaluate terms on motion and add up their Gram matrices; `progress` is called with (rows done, rows in all).

    `allowed`, (C, P), are the candidates of each equation, by default all. An InputError says that no candidate can be
    used, or that one cannot because of the unit of a channel.
    """
    names, targets = tuple(term.text for term in terms), motion.roles.targets
    total, done = sum(rows.n for rows in motion.records), 0
    bad, kept = np.zeros(len(terms), dtype=np.int64), []

    def evaluated(rows: MotionRows) -> Floats:
        nonlocal done
        D = evaluate_terms(terms, rows.columns)
        for j in np.flatnonzero(~(np.abs(D).max(axis=0) <= LARGEST)):
            bad[j] += int(np.count_nonzero(~(np.abs(D[:, j]) <= LARGEST)))
            D[:, j] = 0.0
        done += rows.n
        if progress is not None:
            progress(done, total)
        return D

    def blocks(pieces: Sequence[MotionRows], keep: bool) -> Iterator[tuple[Floats, Floats]]:
        """Columns and targets of the rows that were measured; with `keep` the columns of all rows are kept."""
        for rows in pieces:
            if keep:
                kept.append(evaluated(rows))
            for start in range(0, rows.n, BLOCK_ROWS):
                chosen = slice(start, start + BLOCK_ROWS)
                block = rows.part(chosen)
                D = kept[-1][chosen] if keep else evaluated(block)
                Y = np.column_stack([block.observed[target] for target in targets])
                yield (D, Y) if block.known.all() else (D[block.known], Y[block.known])

    few = sum(rows.n for rows in motion.train) * len(terms) <= MOST_KEPT
    train = grams_from_blocks(blocks(motion.train, few), names, len(targets))
    held_out = grams_from_blocks(blocks(motion.held_out, False), names, len(targets)) if motion.held_out else ()
    every = np.ones((1, 1), dtype=np.bool_)
    found = Design(motion, tuple(terms), train, held_out, (), tuple(kept), every if allowed is None else allowed)
    return usable_terms(found, bad, total)


def usable_terms(design: Design, bad: Ints, rows: int) -> Design:
    """A dictionary without the candidates that cannot be used.

    `bad`, (P,), is the number of rows, of `rows` in all, in which each candidate is not finite, or too large to square.
    An InputError says that no candidate can be used, or that one cannot because of the unit of a channel.
    """
    terms, train, allowed = design.terms, design.train, design.allowed
    reasons = _reasons(train[0], bad, rows, allowed)
    size = np.abs(train[0].mean) + train[0].standard_deviation
    out_of_range = (bad > 0) | (size < SMALLEST) | _unwritable(train)
    _require_units([terms[int(j)] for j in np.flatnonzero(out_of_range)], design.motion)
    dropped = tuple(DroppedTerm(terms[j].text, why) for j, why in sorted(reasons.items()))
    kept = np.array([j for j in range(len(terms)) if j not in reasons], dtype=np.intp)
    if not len(kept):
        raise InputError(f"no usable term in the dictionary: {'; '.join(f'{d.name}: {d.reason}' for d in dropped[:5])}")
    if not dropped:
        return design
    return replace(
        design,
        terms=tuple(terms[j] for j in kept),
        train=tuple(gram.select(kept) for gram in train),
        held_out=tuple(gram.select(kept) for gram in design.held_out),
        dropped=dropped,
        kept=tuple(np.asfortranarray(columns[:, kept]) for columns in design.kept),
        allowed=allowed[:, kept],
    )


def _unwritable(grams: Sequence[Gram]) -> Bools:
    """Columns (P,) whose coefficient in one of the equations would be too large or too small to square."""
    target = np.array([[gram.target_deviation] for gram in grams])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = target / grams[0].standard_deviation
    varying = (target > 0) & np.isfinite(ratio)
    return np.asarray((varying & ((ratio < SMALLEST) | (ratio > LARGEST))).any(axis=0))


def _require_units(terms: Sequence[Expression], motion: Motion) -> None:
    """Raise an InputError if the unit of a channel is the reason why one of these terms is out of range."""
    for term in terms:
        for name in sorted(term.names):
            columns = [rows.columns[name] for rows in motion.records if name in rows.columns]
            size = max((float(np.abs(values).max(initial=0.0)) for values in columns), default=0.0)
            if size > USUAL or 0.0 < size < 1 / USUAL:
                raise InputError(
                    f"term {term.text} is out of range where {name} is about {size:.0e}: give {name} in a"
                    f" {'larger' if size > 1 else 'smaller'} unit, in which it is about 1, or leave the term out"
                )


def _reasons(gram: Gram, bad: Ints, rows: int, allowed: Bools) -> dict[int, str]:
    """Reasons for leaving out unusable columns; a copy is left out if all of its equations may have the original."""
    sd = gram.standard_deviation
    out: dict[int, str] = {}
    for j in range(len(sd)):
        if bad[j]:
            out[j] = f"not finite, or too large to square, in {bad[j]} of {rows} rows"
        elif not sd[j] > CONSTANT_SPREAD * abs(gram.mean[j]):
            out[j] = "constant on the data"
    usable = np.array([j for j in range(len(sd)) if j not in out], dtype=np.intp)
    scaled = gram.DtD[np.ix_(usable, usable)] / (sd[usable][:, None] * sd[usable] * gram.n)
    rows_of, columns_of = np.nonzero(np.triu(np.abs(scaled) >= COPY_CORRELATION, k=1))
    for a, b in zip(usable[rows_of], usable[columns_of], strict=True):
        if int(a) not in out and (allowed[:, a] >= allowed[:, b]).all():
            out.setdefault(int(b), COPY.format(gram.names[a]))
    return out


def screened(terms: Sequence[Expression], motion: Motion, allowed: Bools, forced: Bools, most: int) -> NDArray[np.intp]:
    """Indices (K,) of the candidates to keep, in order.

    Candidates of each equation are `allowed`, (C, P); those that are `forced`, (P,), are kept whatever they explain.
    Each equation has an equal share of the places among `most`.
    """
    D, Y = _rows(terms, motion)
    kept = forced.copy()
    simplest = sorted(range(len(terms)), key=lambda j: (degree(terms[j]), terms[j].size))
    kept[simplest[: min(most // 2, len(D) // 4)]] = True
    basis = _independent(D[:, kept])
    share = max((most - int(kept.sum())) // len(allowed), 1)
    found = [explaining(D, y, own & ~kept, basis, share) for own, y in zip(allowed, Y.T, strict=True)]
    kept[np.concatenate(found)] = True
    return np.flatnonzero(kept)


def explaining(D: Floats, y: Floats, free: Bools, basis: Floats, share: int) -> NDArray[np.intp]:
    """Indices of at most `share` of the `free` columns, those that explain most of y's residual on a basis (n, q)."""
    taken = np.zeros(0, dtype=np.intp)
    free, added, left = free.copy(), basis, y
    rest = np.ones(D.shape[1])  # squared length of what the basis leaves of each column
    while True:
        left = left - added @ (added.T @ left)
        rest -= ((added.T @ D) ** 2).sum(axis=0)
        free &= rest > NEARLY_NOTHING
        count = min(-(-share // ROUNDS), share - len(taken), int(free.sum()))
        if count <= 0:
            return taken
        gain = np.where(free, (left @ D) ** 2 / np.maximum(rest, NEARLY_NOTHING), -1.0)
        best = np.argsort(-gain, kind="stable")[:count]
        free[best] = False
        taken = np.append(taken, best)
        new = D[:, best] - basis @ (basis.T @ D[:, best])
        added = _independent(new - basis @ (basis.T @ new))
        basis = np.column_stack([basis, added])


def _independent(columns: Floats) -> Floats:
    """An orthonormal basis of some columns."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-10])


def _rows(terms: Sequence[Expression], motion: Motion) -> tuple[Floats, Floats]:
    """Centred columns of length 1 on some of the training rows, 0 for those not finite, and the centred targets."""
    step = max(1, -(-sum(rows.n for rows in motion.train) // ROWS))
    parts = [rows.part(slice(None, None, step)) for rows in motion.train]
    Y = np.concatenate(
        [np.column_stack([rows.observed[t] for t in motion.roles.targets])[rows.known] for rows in parts]
    )
    D = np.concatenate([evaluate_terms(terms, rows.columns)[rows.known] for rows in parts])
    with np.errstate(all="ignore"):
        D -= D.mean(axis=0)
        D /= np.sqrt(np.einsum("ij,ij->j", D, D))
    D[:, ~np.isfinite(D).all(axis=0)] = 0.0
    return D, Y - Y.mean(axis=0)
