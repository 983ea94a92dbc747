"""A sum of states that is said not to change, compared with its samples."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bayeq.errors import DataWarning, WarningLog
from bayeq.states import Motion

# Means over this many parts of each record vary by no more than the noise within the parts leaves, unless that has less
# than this probability, and they vary by this share of the largest state.
PARTS, CHANCE, MATTERS = 10, 1e-6, 0.05


def warn_of_changes(conserve: str, weights: Mapping[int, float], motion: Motion, log: WarningLog) -> None:
    """Say where the samples of a sum, its weights by the number of the equation, contradict that it does not change."""
    from scipy.special import fdtrc

    names = {motion.roles.chains[c].states[0]: weight for c, weight in weights.items()}
    between, within, parts, left, largest = 0.0, 0.0, 0, 0, 0.0
    for rows in motion.train:
        if not names.keys() <= rows.samples.keys():
            return
        columns = {name: weight * rows.samples[name] for name, weight in names.items()}
        total = sum(columns.values(), np.zeros(rows.n))
        total = total[np.isfinite(total)]
        if len(total) < 3 * PARTS:
            continue
        largest = max(largest, *(float(np.nanstd(column)) for column in columns.values()))
        pieces = np.array_split(total, PARTS)
        means = np.array([piece.mean() for piece in pieces])
        sizes = np.array([len(piece) for piece in pieces])
        between += float(sizes @ (means - total.mean()) ** 2)
        within += float(sum(np.sum((piece - mean) ** 2) for piece, mean in zip(pieces, means, strict=True)))
        parts, left = parts + PARTS - 1, left + len(total) - PARTS
    if not parts:
        return
    ratio = (between / parts) / max(within / left, 1e-300)
    sd = math.sqrt(between / (left + parts))
    if fdtrc(parts, left, ratio) < CHANCE and sd > MATTERS * largest:
        log.warn(
            f"the record contradicts that {conserve} does not change: it varies with a sd of {sd:.3g}; check units, or"
            " leave conserve out",
            DataWarning,
        )
