"""Noise of an input, or process noise: a record may not tell which, and coefficients differ between the two.

The noise of an input that is itself a random sequence is not visible in its samples, and drives the motion like a force
that is independent from sample to sample. Where both explain the record equally well, the coefficient of the input is
known only up to the factor by which its noise weakens it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bayeq.arrays import Floats, Ints
from bayeq.likelihood.model import Fitted, Task, fit
from bayeq.likelihood.search import CLEARLY
from bayeq.likelihood.start import with_exact_inputs
from bayeq.numerics.settings import LIKELIHOOD
from bayeq.states import Motion

# Noise of an input matters where it weakens a coefficient by more than this many of its standard deviations.
MATTERS = 1.0


@dataclass(frozen=True, eq=False)
class ExactInputs:
    """A fit as likely as another one of the same model, in which inputs have no noise."""

    inputs: tuple[str, ...]
    chain: Ints  # (r,), numbers of the equation and of the term of each coefficient
    term: Ints
    theta: Floats  # (r,), coefficients
    apart: Floats  # (r,), their distance from those of the other fit, in its standard deviations

    def farthest(self, c: int) -> tuple[int, float, float]:
        """Term, coefficient and distance of the coefficient of equation c that differs most; term -1 if it has none."""
        own = np.flatnonzero(self.chain == c)
        if not len(own):
            return -1, 0.0, 0.0
        k = own[int(np.argmax(self.apart[own]))]
        return int(self.term[k]), float(self.theta[k]), float(self.apart[k])


def exact_inputs(motion: Motion, task: Task, fitted: Fitted, covariance: Floats) -> ExactInputs | None:
    """The fit of the same model to a motion with exact inputs and discrepancies instead; None if it is clearly less
    likely, or if no input's noise matters."""
    state, layout = fitted.state, task.layout
    sd, share = np.sqrt(np.diagonal(covariance)), state.levels.channels / state.levels.scales.channels
    names, unexplained = list[str](), np.zeros(layout.chains)
    for i, name in enumerate(layout.roles.inputs, layout.first_input):
        if layout.smoothness[i - layout.first_input]:  # its samples tell its noise
            continue
        own = [k for k, j in enumerate(state.chosen.term) if j < len(layout.terms) and name in layout.terms[j].names]
        if state.levels.learned[i] and any(share[i] * abs(state.theta[k]) > MATTERS * sd[k] for k in own):
            names.append(name)
            np.add.at(unexplained, state.chosen.chain[own], state.theta[own] ** 2 * state.levels.channels[i])
    if not names:
        return None
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        there, start = with_exact_inputs(motion, task, state, names)
        levels = start.levels
        memory = np.where(unexplained > levels.discrepancy, 2.0 * LIKELIHOOD.shortest_memory, levels.memory)
        sizes = np.maximum(levels.discrepancy, unexplained)
        other = fit(there, replace(start, levels=replace(levels, discrepancy=sizes, memory=memory)))
        before = fitted.evidence - (0.0 if fitted.averages is None else float(fitted.averages.sum()))
        if other.evidence > before - CLEARLY:
            apart = np.abs(other.state.theta - state.theta) / sd
            return ExactInputs(tuple(names), *state.chosen, other.state.theta, apart)
    return None
