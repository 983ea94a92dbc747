"""`Problem`: a Gram and a prior as the flat numbers that compiled kernels take."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats, Ints
from bayeq.inference.gram import GramLike, LazyGram, dense
from bayeq.inference.prior import Prior
from bayeq.kernels import kernel

NOTHING = np.empty((0, 0))

# A row of D'D computed alone, which is bound by memory, takes about as long as WHOLE_AFTER rows in blocks of BLOCK.
WHOLE_AFTER = 20
BLOCK = 256

# Share of y'y below which a residual sum of squares is rounding of the Gram: in data without noise, terms that fit the
# rounding would otherwise be added. It corresponds to noise of 1e-6 of the signal.
ROUNDING = 1e-12


class Columns(NamedTuple):
    """D'D as an argument of kernels: complete, or with rows that are computed when needed."""

    diagonal: Floats  # (P,), sums of squares of the columns
    rows: Floats  # (P, P), rows of D'D in the order of their computation; the rest is uninitialised
    slot: Ints  # (P,), index in `rows` of the row of each term, -1 if it is not computed yet
    used: Ints  # (1,), number of computed rows
    data: Floats  # (n, P), the centred D, from which missing rows are computed; empty if D'D is complete


@kernel
def fetch(columns: Columns, j: int) -> None:
    """Compute the missing row j of D'D, or all missing rows once single rows have cost as much as these will."""
    data, slot, terms = columns.data, columns.slot, len(columns.slot)
    used = columns.used[0]
    row = columns.rows[used]
    for k in range(terms):
        row[k] = 0.0
    for i in range(len(data)):
        own = data[i]
        for k in range(terms):
            row[k] += own[j] * own[k]
    slot[j] = used
    used += 1
    if used >= max(terms // WHOLE_AFTER, BLOCK):
        chosen = np.empty((BLOCK, len(data)))
        first = used
        for k in range(terms):
            if slot[k] < 0:
                for i in range(len(data)):
                    chosen[used - first, i] = data[i, k]
                slot[k] = used
                used += 1
            if used - first == BLOCK or k == terms - 1:
                np.dot(chosen[: used - first], data, columns.rows[first:used])
                first = used
    columns.used[0] = used


def gram_block(columns: Columns, index: Ints) -> Floats:
    """D'D of some terms, (r, r)."""
    for j in index:
        # a row may have been computed together with one before it
        if columns.slot[j] < 0:
            fetch(columns, int(j))
    return columns.rows[np.ix_(columns.slot[index], index)]


def gram_columns(gram: GramLike) -> Columns:
    """D'D of any Gram: a `LazyGram` gives its rows as they are needed."""
    terms = len(gram.names)
    if not isinstance(gram, LazyGram):
        DtD = np.ascontiguousarray(dense(gram))
        return Columns(DtD.diagonal().copy(), DtD, np.arange(terms), np.array([terms]), NOTHING)
    return Columns(
        np.ascontiguousarray(gram.diagonal),
        np.empty((terms, terms)),
        np.full(terms, -1),
        np.zeros(1, dtype=np.int64),
        gram.data,
    )


class Problem(NamedTuple):
    """A sparse regression with its prior, built by `of`; one argument of kernels."""

    # statistics of the (standardised) Gram
    columns: Columns
    Dty: Floats
    yty: float
    dof: float
    log_odds: Floats  # (P,), logit(p_0); +inf forces a term in, -inf keeps it out
    size_prior: Floats  # (P+1,), log prior of the number of terms beside `log_odds`: 0 unless beta-binomial
    inclusion_beta: Floats  # (2,), a and b of p_0 ~ Beta(a, b); empty where p_0 is given
    slab_variance: float  # v_s
    noise_shape: float  # a_sigma
    noise_rate: float  # b_sigma
    half_log_slab: float  # 1/2 ln v_s, the price of a term
    h: float  # a_sigma + N/2
    floor: float  # least value of s = 2 b_sigma + RSS that is above the rounding of y'y

    @classmethod
    def of(cls, gram: GramLike, prior: Prior) -> Problem:
        """The problem of a Gram and a prior; an InputError refuses prior parameters out of range."""
        terms = len(gram.names)
        prior.validate(terms)
        return cls(
            columns=gram_columns(gram),
            Dty=np.ascontiguousarray(gram.Dty),
            yty=float(gram.yty),
            dof=float(gram.dof),
            log_odds=prior.log_odds(terms),
            size_prior=prior.size_prior(terms),
            inclusion_beta=np.array(prior.inclusion_beta or (), dtype=np.float64),
            slab_variance=float(prior.slab_variance),
            noise_shape=float(prior.noise_shape),
            noise_rate=float(prior.noise_rate),
            half_log_slab=0.5 * math.log(prior.slab_variance),
            h=float(prior.noise_shape) + 0.5 * float(gram.dof),
            floor=max(2.0 * float(prior.noise_rate), ROUNDING * float(gram.yty)),
        )

    @property
    def DtD(self) -> Floats:
        """D'D as one array."""
        return gram_block(self.columns, np.arange(len(self.columns.slot)))

    def with_slab_variance(self, slab_variance: float) -> Problem:
        """The same problem with another v_s."""
        return self._replace(slab_variance=slab_variance, half_log_slab=0.5 * math.log(slab_variance))
