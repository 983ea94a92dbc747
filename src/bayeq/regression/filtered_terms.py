"""Terms as the smoother would show them: what an estimated target is to be compared with.

A target that was estimated holds what the smoother follows of the motion; an input, and the products of states, hold
more. In the band regression both sides see the same filter, bin by bin (`bayeq.gram.band`). Here the same is done to
rows, so that fits, residuals and shares of variance are those of an equation both sides of which went through it. The
rows at either end, where a smoother knows least, are left out of the judgement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import Design, evaluate_terms
from bayeq.expressions import Expression
from bayeq.gram.gram import Gram, grams_from_blocks
from bayeq.states import Chain, ChainSmoothing

__all__ = ["evaluate_seen", "seen_design", "unsmoothed"]

Floats = NDArray[np.float64]

# Rows filtered at a time.
BLOCK_ROWS = 65_536


def unsmoothed(terms: Sequence[Expression], chains: Sequence[Chain]) -> list[int]:
    """Terms that are not states: the smoother's gain is in the states and in the target, but not in these.

    An input is as measured. A product such as x**3 is that of smoothed states, which follow the motion where it is
    strong, so that its harmonics stand there at full height.
    """
    states = {name for chain in chains for name in chain.states}
    return [j for j, term in enumerate(terms) if term.text not in states]


def evaluate_seen(
    terms: Sequence[Expression], piece: Mapping[str, Floats], chains: Sequence[Chain], smoothing: ChainSmoothing | None
) -> Floats:
    """Terms on the rows of a piece, (n, P); through the smoother, where one is given."""
    D = evaluate_terms(terms, piece)
    if smoothing is not None:
        filtered = unsmoothed(terms, chains)
        D[:, filtered] = smoothing.follow(D[:, filtered])
    return D


def seen_design(
    design: Design,
    chains: Sequence[Chain],
    smoothings: Sequence[ChainSmoothing | None],
    train: Sequence[Mapping[str, Floats]],
    held_out: Sequence[Mapping[str, Floats]],
) -> Design:
    """The design with the Grams of estimated targets as the smoother shows their terms.

    Parameters
    ----------
    design : Design
        Of plain terms.
    chains : sequence of Chain
        One per target.
    smoothings : sequence of (ChainSmoothing or None)
        How each target was estimated; None where it was measured.
    train, held_out : sequence of mapping of str to (n,) array
        Columns of each piece.
    """

    def grams(pieces: Sequence[Mapping[str, Floats]], plain: Sequence[Gram]) -> tuple[Gram, ...]:
        return tuple(
            old if one is None else _gram(design, pieces, chains, chain.target, one)
            for old, chain, one in zip(plain, chains, smoothings, strict=True)
        )

    if all(one is None for one in smoothings):
        return design
    held = grams(held_out, design.held_out) if design.held_out else ()
    return replace(design, train=grams(train, design.train), held_out=held)


def _gram(
    design: Design,
    pieces: Sequence[Mapping[str, Floats]],
    chains: Sequence[Chain],
    target: str,
    smoothing: ChainSmoothing,
) -> Gram:
    def blocks() -> Iterator[tuple[Floats, Floats]]:
        for piece in pieces:
            rows = smoothing.inner(len(piece[target]))
            for start in range(rows.start, rows.stop, BLOCK_ROWS):
                chosen = slice(start, min(start + BLOCK_ROWS, rows.stop))
                block = {name: values[chosen] for name, values in piece.items()}
                yield evaluate_seen(design.terms, block, chains, smoothing), block[target][:, None]

    return grams_from_blocks(blocks(), tuple(term.text for term in design.terms))[0]
