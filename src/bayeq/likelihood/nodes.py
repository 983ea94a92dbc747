"""Grid searches for constants inside terms: on the smoothed rows, and on the likelihood about a fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import (
    JUMP_NODES,
    NODES,
    constants_of,
    extent,
    families,
    grids,
    is_scale,
    jumps_at,
    located,
    middle,
    to_plain,
    to_scale,
)
from bayeq.expressions import Binary, Expression, Unknown, number
from bayeq.inference.collapsed.search import best_models, scores_of
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.likelihood.fit import Quadratic, State, adjoints, bent_by, information
from bayeq.likelihood.layout import Layout
from bayeq.likelihood.model import Fitted, Task, calmed
from bayeq.likelihood.start import precision_of_terms
from bayeq.states import Motion

# About how many smoothed rows a grid search uses at most, unless a term has a sine or cosine.
ROWS = 4000

# Number of values, those that explain most of the smoothed rows, that are tried on the likelihood about a fit.
TRIED = 24

# Values for which a term is a linear combination of others, but for this share of it, are skipped.
COPIED = 1e-6

# Step of finite differences of terms by their constants: in the logarithm of a scale, else as a share of the range.
STEP = 1e-4


def first_values(terms: Sequence[Expression], motion: Motion, allowed: Bools) -> tuple[Expression, ...]:
    """Terms with the constants that explain most of the smoothed rows; an InputError asks for a range."""
    found = tuple(terms)
    if not any(term.unknowns for term in terms):
        return found
    constants = located(terms, [rows.columns for rows in motion.train])
    known = {name for name, one in constants.items() if not math.isnan(one.value)}  # of laws of hidden states
    first = {name: one.value if name in known else middle(one) for name, one in constants.items()}
    found = with_values(found, first, constants)
    for family in families(terms):
        if known.intersection(*(terms[j].unknowns for j in family)):
            continue
        values, _ = ranked(found, motion, allowed, family)
        found = with_values(found, values[0], constants)
    return found


def first_members(motion: Motion, terms: Sequence[Expression], log_odds: Floats) -> Floats:
    """Log odds, (C, P + 1), with -inf for all members of an either-or except the one that explains most."""
    out = log_odds.copy()
    for members in choices_of(terms).values():
        gains = [ranked(terms, motion, log_odds[:, :-1] > -np.inf, [j])[1][0] for j in members]
        for j in members:
            if j != members[int(np.argmax(gains))]:
                out[:, j] = -np.inf
    return out


class GridNode(NamedTuple):
    """Values of some constants; log posterior of the likeliest model there, the model, its coefficients; log posterior
    of the fitted model."""

    values: Mapping[str, float]
    score: float
    model: Bools
    theta: Floats
    fitted: float


def start_at(motion: Motion, task: Task, fitted: Fitted, node: GridNode) -> tuple[Task, State]:
    """The task at a node's values of constants, and the start of a fit there."""
    task = with_terms(motion, task, with_values(task.layout.terms, node.values))
    chosen = task.layout.everything.take(np.flatnonzero(node.model))
    return task, calmed(replace(fresh(fitted.state, task.layout), chosen=chosen, theta=node.theta))


def on_gram(task: Task, fitted: Fitted, family: Sequence[int], values: Sequence[Mapping[str, float]]) -> list[GridNode]:
    """Scores, by the likelihood about a fit, of other values of a family's constants; -inf where it is not finite.

    Models have the terms of the family that the fit has, or else one of them in one equation, with derivatives by its
    constants, so that a node of a grid covers its neighbourhood.
    """
    layout, P, C = task.layout, len(task.layout.terms), task.layout.chains
    names = [(j, name) for j in family for name in layout.terms[j].unknowns]
    others: list[Expression] = []
    for one in values:
        terms = with_values(layout.terms, one)
        others += [terms[j] for j in family]
        others += [derivative(terms[j], name) for j, name in names]
    q, whole, _ = beside(task, fitted, others, [*family, *(j for j, _ in names)])
    wide, each, held = P + len(others) + 1, len(family) + len(names), fitted.model.reshape(C, -1)
    pairs = [(c, j) for c, j in itertools.product(range(C), family) if task.allowed[c, j]]
    inside = [(c, j) for c, j in pairs if held[c, j]]
    out = []
    for k, one in enumerate(values):
        column = np.append(np.arange(P), wide - 1)
        column[list(family)] = P + k * each + np.arange(len(family))
        column = np.append(column, P + k * each + len(family) + np.arange(len(names)))
        at = (np.arange(C)[:, None] * wide + column).ravel()
        own = replace(task, precision=whole.precision[at], log_odds=whole.log_odds[at])
        here = Quadratic(q.level, q.slope[at], q.information[np.ix_(at, at)])
        found = [GridNode(one, -math.inf, np.zeros(C * (P + 1), dtype=np.bool_), np.zeros(0), -math.inf)]
        for forced in [inside] if inside else [[pair] for pair in pairs]:
            with suppress(np.linalg.LinAlgError):
                found.append(_node(own, here, fitted, one, forced, names))
        out.append(max(found, key=lambda node: node.score))
    return out


def _node(
    task: Task,
    here: Quadratic,
    fitted: Fitted,
    values: Mapping[str, float],
    forced: Sequence[tuple[int, int]],
    names: Sequence[tuple[int, str]],
) -> GridNode:
    """A node where models have the terms `forced`, pairs of equation and term, and their derivatives by constants.

    The `task` has its own terms, then derivatives, each of one term by one constant, numbered by `names`.
    """
    P, C = len(task.layout.terms), task.layout.chains
    odds = task.log_odds.reshape(C, -1)
    known, price = odds.copy(), 0.0
    known[:, P + 1 :] = -np.inf
    for c, j in forced:
        price += float(odds[c, j])
        known[c, [j, *(P + 1 + i for i, (own, _) in enumerate(names) if own == j)]] = np.inf
    own = replace(task, log_odds=known.ravel())
    problem = own.problem(here)
    score, model = best_models(problem)[0]
    coef, _ = exact_posterior(problem, model, None)
    theta = (coef / np.sqrt(own.precision)).reshape(C, -1)
    parts = here.information.reshape(C, known.shape[1], C, known.shape[1])
    constants, moved = constants_of(with_values(task.layout.terms, values)), {}
    for name in values:
        change, size = [], []
        for i, (j, other) in enumerate(names, P + 1):
            for c in range(C) if other == name else ():
                # a term's size with its derivative projected on it: for a power of numbers far from 1 the size at the
                # node may have the other sign
                change.append(theta[c, i])
                size.append(theta[c, j] + theta[c, i] * parts[c, j, c, i] / max(parts[c, j, c, j], 1e-300))
        square, constant = float(np.dot(size, size)), constants[name]
        step = float(np.dot(size, change)) / square if square else 0.0
        step = float(np.clip(step, -1.0, 1.0)) * min(1.0, extent(constant) / NODES / max(abs(step), 1e-300))
        moved[name] = bounded(constant, to_scale(constant, constant.value) + step)
    found, held = model.reshape(C, -1)[:, : P + 1], fitted.model.reshape(C, -1)
    same = np.hstack([held, (known[:, P + 1 :] == np.inf) & all(held[c, j] for c, j in forced)])
    before = float(scores_of(problem, same.ravel()[None])[0])
    return GridNode(moved, score + price, found.ravel(), theta[:, : P + 1][found], before)


def beside(
    task: Task, fitted: Fitted, others: Sequence[Expression], each: Sequence[int]
) -> tuple[Quadratic, Task, State]:
    """The likelihood, about zero, with further terms `others`, the task with these, and the state there. Further terms
    come in groups like the terms `each`, and have their priors, with precision in proportion to the variance."""
    layout, P = task.layout, len(task.layout.terms)
    own, state = extended(task, fitted.state, others)
    linears, found = own.linearised(state), own.marginal(state)
    smoothed = adjoints(linears, state.levels, found, found.delta, curved=True)
    bend, _ = bent_by(own.layout, linears, state, smoothed, found.filtered)
    q = information(own.layout, linears, state, bend).raised(fitted.power)
    like = np.tile(each, len(others) // len(each))
    odds, precision = (values.reshape(layout.chains, -1) for values in (task.log_odds, task.precision))
    inside = np.concatenate([one.terms[:, P:-1] for one in linears]).var(axis=0)
    base = np.concatenate([one.terms[:, :P] for one in linears]).var(axis=0)[like]
    ratio = inside / np.maximum(base, 1e-300)
    precision = np.hstack([precision[:, :-1], precision[:, like] * ratio, precision[:, -1:]])
    odds = np.hstack([odds[:, :-1], odds[:, like], odds[:, -1:]])
    return q, replace(own, precision=precision.ravel(), log_odds=odds.ravel()), state


def extended(task: Task, state: State, others: Sequence[Expression]) -> tuple[Task, State]:
    """The task with further terms after its own, of prior precision 0, and the state of its own terms there."""
    layout, P, width = task.layout, len(task.layout.terms), len(task.layout.terms) + len(others) + 1
    column = np.append(np.arange(P), width - 1)
    stated = [one._replace(parts=tuple((c, int(column[j]), w) for c, j, w in one.parts)) for one in layout.stated]
    layout = replace(layout, terms=(*layout.terms, *others), stated=tuple(stated))
    precision = np.zeros((layout.chains, width))
    precision[:, column] = task.precision.reshape(layout.chains, -1)
    own = replace(task, layout=layout, precision=precision.ravel(), log_odds=np.zeros(precision.size))
    state = fresh(state, layout)
    return own, replace(state, chosen=state.chosen._replace(term=column[state.chosen.term]))


def fresh(state: State, layout: Layout) -> State:
    """The state for a layout whose terms have other values: widths of jumps are kept only if the jumps are the same."""
    same = layout.jumps == state.levels.layout.jumps
    return replace(state, levels=replace(state.levels, layout=layout), blurs=state.blurs if same else ())


def derivative(term: Expression, name: str) -> Expression:
    """The derivative of a term by one of its constants, on the constant's scale."""
    constant = term.unknowns[name]
    step = STEP * (1.0 if is_scale(constant) else constant.high - constant.low)
    if jumps_at(term, name):
        step = extent(constant) / JUMP_NODES  # between two nodes of the grid
    place = to_scale(constant, constant.value)
    up, down = (
        term.with_unknowns({name: replace(constant, value=to_plain(constant, place + way * step))}).tree
        for way in (1.0, -1.0)
    )
    return Expression(Binary("*", number(0.5 / step), Binary("-", up, down)))


def bounded(constant: Unknown, place: float) -> float:
    """The value of a constant at a place on its scale, clipped to its range."""
    low, high = to_scale(constant, constant.low), to_scale(constant, constant.high)
    return to_plain(constant, min(max(place, low), high))


def by_rows(task: Task, motion: Motion, family: Sequence[int]) -> list[dict[str, float]]:
    """Values of a family's constants that explain most of the smoothed rows, with the other terms and without."""
    terms, allowed = task.layout.terms, task.allowed
    beside, alone = (ranked(terms, motion, allowed, family, others)[0][:TRIED] for others in (True, False))
    return beside + [one for one in alone if one not in beside]


def ranked(
    terms: Sequence[Expression], motion: Motion, allowed: Bools, family: Sequence[int], beside: bool = True
) -> tuple[list[dict[str, float]], list[float]]:
    """Values of a family's constants, best on the smoothed rows first, and scores; with other terms if `beside`."""
    own = [terms[j] for j in family]
    rivals = {one.choice for one in own} - {""}
    waves = any("sin" in one.text or "cos" in one.text for one in own)
    total = sum(rows.n for rows in motion.train)
    step = 1 if waves else max(1, total // ROWS)
    parts = [rows.part(slice(None, None, step)) for rows in motion.train]
    others = [
        term
        for j, term in enumerate(terms)
        if beside and j not in family and term.choice not in rivals and allowed[:, j].any()
    ]
    Y = np.concatenate([np.column_stack([rows.columns[t] for t in motion.roles.targets]) for rows in parts])
    D = np.ones((len(Y), 1))
    if others:
        D = np.hstack([D, np.concatenate([evaluate_terms(others, rows.columns) for rows in parts])])
    D = D[:, np.isfinite(D).all(axis=0)]
    Q, _ = np.linalg.qr(D / np.maximum(np.abs(D).max(axis=0), 1e-300))
    left = Y - Q @ (Q.T @ Y)
    square = np.maximum((left**2).sum(axis=0), 1e-300)
    used = allowed[:, list(family)].any(axis=1)
    constants = constants_of(own)
    found: list[tuple[float, dict[str, float]]] = []
    for values in grids(own, constants, [rows.columns for rows in motion.train]) if constants else iter([{}]):
        now = with_values(own, values, constants)
        with np.errstate(all="ignore"):
            columns = np.concatenate([evaluate_terms(now, rows.columns) for rows in parts])
            size = np.sqrt((columns**2).sum(axis=0))
        if not np.isfinite(size).all() or not (size > 0.0).all():
            continue
        rest = columns / size
        rest = rest - Q @ (Q.T @ rest)
        if (rest**2).sum(axis=0).min() < COPIED**2:
            continue
        gain = left.T @ rest
        explained = np.einsum("ck,kc->c", gain, np.linalg.lstsq(rest.T @ rest, gain.T, rcond=1e-10)[0])
        share = np.clip(explained / square, 0.0, 1.0 - 1e-12)
        found.append((float(-0.5 * len(Y) * np.log1p(-share[used]).sum()), values))
    found.sort(key=lambda one: -one[0])
    if not found:
        return [{name: middle(one) for name, one in constants.items()}], [-math.inf]
    return [values for _, values in found], [score for score, _ in found]


def with_values(
    terms: Sequence[Expression], values: Mapping[str, float], located: Mapping[str, Unknown] | None = None
) -> tuple[Expression, ...]:
    """The terms with other values of some constants, and with the ranges of `located` if it is given."""
    constants = constants_of(terms) if located is None else {**constants_of(terms), **located}
    found = {name: replace(constants[name], value=value) for name, value in values.items() if name in constants}
    return tuple(term.with_unknowns(found) for term in terms)


def with_terms(motion: Motion, task: Task, terms: tuple[Expression, ...]) -> Task:
    """The task with terms of other values. Their priors are scaled with their variances in the rows of the motion.
    Other terms keep theirs, which may have been widened, or be those of fewer rows."""
    layout = replace(task.layout, terms=terms)
    former = precision_of_terms(motion, task.layout)
    ratio = task.precision / np.where(former > 0.0, former, np.nan)  # a term may be constant at the former values
    ratio = np.where(np.isnan(ratio), np.nanmedian(ratio), ratio)
    return replace(task, layout=layout, precision=ratio * precision_of_terms(motion, layout))


def choices_of(terms: Sequence[Expression]) -> dict[str, list[int]]:
    """Members of each either-or, as numbers of terms."""
    out: dict[str, list[int]] = {}
    for j, term in enumerate(terms):
        if term.choice:
            out.setdefault(term.choice, []).append(j)
    return {choice: members for choice, members in out.items() if len(members) > 1}
