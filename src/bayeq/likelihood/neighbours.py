"""Models that are a single move away from a fitted one, each compared by the evidence of its own fit."""

from __future__ import annotations

import numpy as np

from bayeq.inference.collapsed.search import neighbours
from bayeq.likelihood.model import Fitted, Task, calmed, fit, over_all_sizes, with_model
from bayeq.likelihood.search import MOST_TO_MOVE
from bayeq.likelihood.settings import LIKELIHOOD
from bayeq.likelihood.spike import soft_of
from bayeq.likelihood.unknowns import moved

# Moves to a neighbour, at most.
MOVES = 5


def among_neighbours(task: Task, best: Fitted) -> tuple[Task, Fitted]:
    """The model that single moves lead to, each compared by its own fit; with many samples the Gram suffices.

    Constants inside terms are where each model has them likeliest.
    """
    if task.rows > MOST_TO_MOVE:
        return task, best
    constants = task.layout.has_constants
    tried = {best.model.tobytes(): best.evidence}
    for _ in range(MOVES):
        better = task, best
        soft = soft_of(task, best) if constants else None
        q = best.quadratic if soft is None else soft.quadratic((0.0,) * task.layout.chains)[0]
        chosen = task.narrow(best.model)
        moves = neighbours(task.problem(q), chosen, LIKELIHOOD.neighbour_window)
        for move in moves[: LIKELIHOOD.neighbours]:
            model = task.wide(move.apply(chosen))
            if model.tobytes() in tried:
                continue
            try:
                fitted = over_all_sizes(task, fit(task, calmed(with_model(task, best, model))), best)
            except np.linalg.LinAlgError:
                continue
            other = moved(task, fitted) if constants else (task, fitted)
            other = max((task, fitted), other, key=lambda pair: pair[1].evidence)
            tried[model.tobytes()] = other[1].evidence
            better = max(better, other, key=lambda pair: pair[1].evidence)
        if better[1] is best:
            break
        task, best = better
    best.tried.update(tried)
    task.recent.clear()
    return task, best
