"""Constants inside terms: values that make the record likeliest, and how well these are known.

A constant psi of the terms of an equation has a column as a coefficient has one, sum_j theta_j d phi_j / d psi, on the
logarithm where it is a scale. Its values are first sought on a grid: in the smoothed rows, then in the likelihood of
all candidates about a fit. From the best of them Gauss-Newton steps move constants, coefficients and path together.
Constants have flat priors over their ranges, so that a term with one costs ln(range / (sqrt(2 pi) sd)) of its odds:
it is not favoured for being flexible. Of an either-or one member at a time is in the dictionary; the others are
fitted in its place, and the likeliest is kept.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import (
    JUMP_NODES,
    NODES,
    ConstantEstimate,
    Forms,
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
from bayeq.expressions import Binary, Expression, Node, Unknown, number
from bayeq.inference.collapsed.search import best_models, scores_of
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.likelihood.fit import Quadratic, State, adjoints, corrections, improved, information, maximised, solved
from bayeq.likelihood.layout import Candidates, Layout
from bayeq.likelihood.model import COARSE, MOST_HALVED, Fitted, Task, calmed, finished, fit, over_all_sizes
from bayeq.likelihood.search import settle
from bayeq.likelihood.start import precision_of_terms
from bayeq.numerics.distributions import Z95
from bayeq.states import Motion

# Smoothed rows in which values are sought, at most, where no term is a wave.
ROWS = 4000

# Values that are tried on the likelihood about a fit, those that explain most of the smoothed rows; of their peaks as
# many are fitted.
TRIED, PEAKS = 24, 2

# Where the likelihood about a fit finds another model likelier by more nats, at the values of the fit, it misleads: a
# term is next to infinite somewhere.
MISLEADS = 100.0

# Rounds of trying others and of moving; another value is taken where it is likelier by this many nats.
ROUNDS, BETTER = 3, 0.5

# Gauss-Newton steps, at most; they move a constant by no more than this share of its range, and end where none moves by
# more than this share of its standard deviation.
STEPS, FARTHEST, NEAR = 12, 0.25, 0.05

# Differences of terms by their constants are over this much of a logarithm, or share of the range.
STEP = 1e-4


def first_values(terms: Sequence[Expression], motion: Motion, allowed: Bools) -> tuple[Expression, ...]:
    """Terms with the constants that explain most of the smoothed rows; an InputError asks for a range."""
    found = tuple(terms)
    if not any(term.unknowns for term in terms):
        return found
    constants = located(terms, [rows.columns for rows in motion.train])
    known = {name for name, one in constants.items() if not math.isnan(one.value)}  # of laws of hidden states
    first = {name: one.value if name in known else middle(one) for name, one in constants.items()}
    found = _with(found, first, constants)
    for family in families(terms):
        if known.intersection(*(terms[j].unknowns for j in family)):
            continue
        values, _ = _ranked(found, motion, allowed, family)
        found = _with(found, values[0], constants)
    return found


def first_members(motion: Motion, terms: Sequence[Expression], log_odds: Floats) -> Floats:
    """Log odds, (C, P + 1), of which those of all members of an either-or are nothing but of one that explains most."""
    out = log_odds.copy()
    for members in _choices(terms).values():
        gains = [_ranked(terms, motion, log_odds[:, :-1] > -np.inf, [j])[1][0] for j in members]
        for j in members:
            if j != members[int(np.argmax(gains))]:
                out[:, j] = -np.inf
    return out


def with_constants(motion: Motion, task: Task, fitted: Fitted) -> tuple[Task, Fitted, Forms]:
    """A fit with its constants where they are likeliest, and the likeliest members of its choices.

    Odds of the task know how wide ranges are; the forms are the log posteriors of members that are finite on the
    motion.
    """
    terms = task.layout.terms
    choices = _choices(terms)
    if not choices and not task.layout.has_constants:
        return task, fitted, {}
    task, fitted = settled(motion, task, finished(task, fitted))
    forms: dict[str, dict[str, float]] = {}
    for choice, members in choices.items():
        active = next((j for j in members if _is_active(task, j)), members[0])
        first, found = (task, fitted), dict[str, float]()
        for j in (active, *(j for j in members if j != active)):
            try:
                other = first if j == active else settled(motion, *_instead(motion, *first, active, j))
                # ln p(data, model), constants integrated out
                score = other[1].evidence + min([0.0, *_costs(*other).values()])
            except np.linalg.LinAlgError:
                continue
            if score > max(found.values(), default=-math.inf):
                task, fitted = other
            found[terms[j].text] = score
        if not found:
            raise np.linalg.LinAlgError(f"{choice}: the likelihood of none is finite")
        forms[choice] = found
    return _with_odds(task, fitted), fitted, forms


def settled(motion: Motion, task: Task, fitted: Fitted) -> tuple[Task, Fitted]:
    """The fit after rounds of steps from its values and of others."""
    for _ in range(ROUNDS):
        before = fitted
        other = moved(task, fitted, motion)
        if other[1].evidence > fitted.evidence:
            task, fitted = other
        for family in families(task.layout.terms):
            if any(_is_active(task, j) for j in family) and not _of_law(task, family):
                task, fitted = _elsewhere(motion, task, fitted, family)
        if fitted is before or fitted.evidence < before.evidence + BETTER:
            break
    return task, fitted


def _elsewhere(motion: Motion, task: Task, fitted: Fitted, family: Sequence[int]) -> tuple[Task, Fitted]:
    """The fit, or one with other values of the constants of a family that the likelihood about it finds likelier."""
    now = {name: one.value for j in family for name, one in task.layout.terms[j].unknowns.items()}
    tried = [one for one in _by_rows(task, motion, family) if one != now]
    if not tried:
        return task, fitted
    here, *others = _on_gram(task, fitted, family, [now, *tried])
    least = BETTER + (here.score if here.score < here.fitted + MISLEADS else here.fitted)
    # where the model lacks the terms, derivatives by their constants stand for them, and cost nothing
    present = [_holds(task, one.model, family) for one in others]
    tried, others = list(itertools.compress(tried, present)), list(itertools.compress(others, present))
    peaks = [one for one in _peaks(tried, others) if one.score >= least]
    for node in sorted(peaks, key=lambda one: -one.score)[:PEAKS]:
        try:
            other = settle(*_at(motion, task, fitted, node))
        except np.linalg.LinAlgError:
            continue
        # of a model without these terms their values say nothing: those of its neighbours stay
        if other[1].evidence > fitted.evidence + (0.0 if _holds(task, other[1].model, family) else BETTER):
            return other
    return task, fitted


def _holds(task: Task, model: Bools, family: Sequence[int]) -> bool:
    """Whether a model has a term of a family in any equation."""
    return bool(model.reshape(task.layout.chains, -1)[:, list(family)].any())


def _peaks(tried: Sequence[Mapping[str, float]], nodes: Sequence[_Node]) -> list[_Node]:
    """Nodes that are likelier than those beside them, of one constant; of several the likeliest."""
    if not tried or len(tried[0]) > 1:
        return sorted(nodes, key=lambda one: -one.score)[:1]
    order = sorted(range(len(nodes)), key=lambda k: next(iter(tried[k].values())))
    scores = np.concatenate([[-np.inf], [nodes[k].score for k in order], [-np.inf]])
    top = (scores[1:-1] >= scores[:-2]) & (scores[1:-1] >= scores[2:])
    return [nodes[k] for k, one in zip(order, top, strict=True) if one]


def _instead(motion: Motion, task: Task, fitted: Fitted, active: int, j: int) -> tuple[Task, Fitted]:
    """A fit with another member of an either-or in place of the active one."""
    odds = task.log_odds.reshape(task.layout.chains, -1).copy()
    odds[:, j], odds[:, active] = odds[:, active], -np.inf
    task = replace(task, log_odds=odds.ravel(), recent=[])
    family = next((own for own in families(task.layout.terms) if j in own), [j])
    tried = _on_gram(task, fitted, family, _by_rows(task, motion, family))
    return settle(*_at(motion, task, fitted, max(tried, key=lambda one: one.score)))


class _Node(NamedTuple):
    """Values of some constants; log posterior of the likeliest model there, the model, its coefficients; log posterior
    of the fitted model."""

    values: Mapping[str, float]
    score: float
    model: Bools
    theta: Floats
    fitted: float


def _at(motion: Motion, task: Task, fitted: Fitted, node: _Node) -> tuple[Task, State]:
    """The task at other values, and the start of a fit there."""
    task = _with_terms(motion, task, _with(task.layout.terms, node.values))
    chosen = task.layout.everything.take(np.flatnonzero(node.model))
    return task, calmed(replace(_fresh(fitted.state, task.layout), chosen=chosen, theta=node.theta))


def _on_gram(task: Task, fitted: Fitted, family: Sequence[int], values: Sequence[Mapping[str, float]]) -> list[_Node]:
    """What the likelihood about a fit makes of other values of a family's constants; nothing where it is not finite.

    Beside each term stand its derivatives by its constants, so that a node of a grid covers its neighbourhood.
    """
    layout, P, C = task.layout, len(task.layout.terms), task.layout.chains
    names = [(j, name) for j in family for name in layout.terms[j].unknowns]
    others: list[Expression] = []
    for one in values:
        terms = _with(layout.terms, one)
        others += [terms[j] for j in family]
        others += [_derivative(terms[j], name) for j, name in names]
    q, precision, odds = _beside(task, fitted, others, [*family, *(j for j, _ in names)])
    wide, each = P + len(others) + 1, len(family) + len(names)
    out = []
    for k, one in enumerate(values):
        column = np.append(np.arange(P), wide - 1)
        column[list(family)] = P + k * each + np.arange(len(family))
        column = np.append(column, P + k * each + len(family) + np.arange(len(names)))
        at = (np.arange(C)[:, None] * wide + column).ravel()
        known = odds[at].reshape(C, -1)
        known[:, P + 1 :] = np.where(known[:, P + 1 :] > -np.inf, np.inf, -np.inf)
        own = replace(task, precision=precision[at], log_odds=known.ravel(), recent=[])
        try:
            problem = own.problem(Quadratic(q.level, q.slope[at], q.information[np.ix_(at, at)]))
        except np.linalg.LinAlgError:
            out.append(_Node(one, -math.inf, np.zeros(C * (P + 1), dtype=np.bool_), np.zeros(0), -math.inf))
            continue
        score, model = best_models(problem)[0]
        same = np.hstack([fitted.model.reshape(C, -1), known[:, P + 1 :] > -np.inf]).ravel()
        coef, _ = exact_posterior(problem, model, None)
        theta = (coef / np.sqrt(own.precision)).reshape(C, -1)
        found = model.reshape(C, -1)[:, : P + 1]
        moved = {}
        constants = constants_of(_with(layout.terms, one))
        for name in one:
            pairs = [(j, P + 1 + i) for i, (j, other) in enumerate(names) if other == name]
            size = np.array([theta[:, j] for j, _ in pairs])
            square, constant = float(np.sum(size**2)), constants[name]
            step = float(np.sum(size * np.array([theta[:, i] for _, i in pairs]))) / square if square else 0.0
            step = float(np.clip(step, -1.0, 1.0)) * min(1.0, extent(constant) / NODES / max(abs(step), 1e-300))
            moved[name] = _bounded(constant, to_scale(constant, constant.value) + step)
        before = float(scores_of(problem, same[None])[0])
        out.append(_Node(moved, score, found.ravel(), theta[:, : P + 1][found], before))
    return out


def _beside(
    task: Task, fitted: Fitted, others: Sequence[Expression], each: Sequence[int]
) -> tuple[Quadratic, Floats, Floats]:
    """The likelihood about zero of further terms too, and precision and log odds of all: those of the further terms,
    which come in groups as `each`, are as of these terms, by their variance."""
    layout, P = task.layout, len(task.layout.terms)
    own, state = extended(task, fitted.state, others)
    linears, found = own.linearised(state), own.marginal(state)
    smoothed = adjoints(linears, state.levels, found, found.delta, curved=True)
    q = information(own.layout, linears, state, corrections(own.layout, linears, smoothed)).raised(fitted.power)
    like = np.tile(each, len(others) // len(each))
    odds, precision = (values.reshape(layout.chains, -1) for values in (task.log_odds, task.precision))
    inside = np.concatenate([one.terms[:, P:-1] for one in linears]).var(axis=0)
    base = np.concatenate([one.terms[:, :P] for one in linears]).var(axis=0)[like]
    ratio = inside / np.maximum(base, 1e-300)
    precision = np.hstack([precision[:, :-1], precision[:, like] * ratio, precision[:, -1:]])
    odds = np.hstack([odds[:, :-1], odds[:, like], odds[:, -1:]])
    return q, precision.ravel(), odds.ravel()


def extended(task: Task, state: State, others: Sequence[Expression]) -> tuple[Task, State]:
    """The task with further terms behind its own, and a state of its own terms there; of precision they have none."""
    layout, P, width = task.layout, len(task.layout.terms), len(task.layout.terms) + len(others) + 1
    column = np.append(np.arange(P), width - 1)
    stated = [one._replace(parts=tuple((c, int(column[j]), w) for c, j, w in one.parts)) for one in layout.stated]
    layout = replace(layout, terms=(*layout.terms, *others), stated=tuple(stated))
    precision = np.zeros((layout.chains, width))
    precision[:, column] = task.precision.reshape(layout.chains, -1)
    own = replace(task, layout=layout, precision=precision.ravel(), log_odds=np.zeros(precision.size), recent=[])
    state = _fresh(state, layout)
    return own, replace(state, chosen=state.chosen._replace(term=column[state.chosen.term]))


def _fresh(state: State, layout: Layout) -> State:
    """The state for terms with other values: the widths of their jumps are not known if these are others."""
    same = layout.jumps == state.levels.layout.jumps
    return replace(state, levels=replace(state.levels, layout=layout), blurs=state.blurs if same else ())


class _Tangent(NamedTuple):
    """What the terms of an equation change by with a constant: its name, the number of the equation, the change."""

    name: str
    chain: int
    change: Expression


def tangents_of(layout: Layout, chosen: Candidates, theta: Floats) -> list[_Tangent]:
    """Of every constant of the terms of a model, on the scale of each, in every equation that it stands in."""
    sums: dict[tuple[str, int], Node] = {}
    for c, j, size in zip(chosen.chain.tolist(), chosen.term.tolist(), theta.tolist(), strict=True):
        if j == len(layout.terms):
            continue
        term = layout.terms[j]
        for name in term.unknowns:
            change: Node = Binary("*", number(size), _derivative(term, name).tree)
            key = name, c
            sums[key] = Binary("+", sums[key], change) if key in sums else change
    return [_Tangent(name, c, Expression(change)) for (name, c), change in sums.items()]


def _derivative(term: Expression, name: str) -> Expression:
    """The derivative of a term by one of its constants, on its scale."""
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


def _bounded(constant: Unknown, place: float) -> float:
    """A place on the scale of a constant, within its range, as a value."""
    low, high = to_scale(constant, constant.low), to_scale(constant, constant.high)
    return to_plain(constant, min(max(place, low), high))


def _with_tangents(task: Task, state: State) -> tuple[Task, State, list[_Tangent]]:
    """The task and a state with the constants of its model as further coefficients."""
    tangents = tangents_of(task.layout, state.chosen, state.theta)
    own, wide = extended(task, state, [one.change for one in tangents])
    count, constants = len(tangents), constants_of(task.layout.terms)
    further = Candidates(
        np.array([one.chain for one in tangents], dtype=np.int64), len(task.layout.terms) + np.arange(count)
    )
    own.precision[own.number(further)] = [12.0 / extent(constants[one.name]) ** 2 for one in tangents]
    chosen = Candidates(*(np.append(*both) for both in zip(wide.chosen, further, strict=True)))
    return own, replace(wide, chosen=chosen, theta=np.append(wide.theta, np.zeros(count))), tangents


def _as_one(
    tangents: Sequence[_Tangent], theta: Floats, covariance: Floats
) -> tuple[Floats, Floats, Mapping[str, int]]:
    """Coefficients with tangents behind them, and their covariance, given that a constant is the same in all equations;
    of each constant also the number of its first tangent among them."""
    first: dict[str, int] = {}
    differences = []
    for k, one in enumerate(tangents, len(theta) - len(tangents)):
        if first.setdefault(one.name, k) != k:
            row = np.zeros(len(theta))
            row[[first[one.name], k]] = 1.0, -1.0
            differences.append(row)
    if differences:
        D = np.array(differences)
        gain = solved(D @ covariance @ D.T, D @ covariance).T
        theta, covariance = theta - gain @ (D @ theta), covariance - gain @ D @ covariance
    return theta, covariance, first


def moved(task: Task, fitted: Fitted, motion: Motion | None = None) -> tuple[Task, Fitted]:
    """The fit with its constants moved to where they are likeliest, if the likelihood is finite on the way; priors are
    those of the terms in the rows of the motion, if it is given."""
    if not tangents_of(task.layout, fitted.state.chosen, fitted.state.theta):
        return task, fitted
    now, last, halved = (task, fitted.state), None, 0
    try:
        for _ in range(STEPS):
            try:
                then, farthest = _step(*now)
            except np.linalg.LinAlgError:
                halved += 1
                if last is None or halved > MOST_HALVED:
                    raise
                now = _halfway(last, now)
                continue
            last, now = now, then
            if farthest < NEAR:
                break
        own = now[0] if motion is None else _with_terms(motion, now[0], now[0].layout.terms)
        return own, over_all_sizes(own, fit(own, now[1]))
    except np.linalg.LinAlgError:
        return task, fitted


def _step(task: Task, state: State) -> tuple[tuple[Task, State], float]:
    """A Gauss-Newton step of a fit and its constants; how far the farthest of these goes, in standard deviations."""
    own, wide, tangents = _with_tangents(task, state)
    linears = own.linearised(wide)
    levels, found = maximised(linears, wide, own.precision_of(wide), **COARSE)
    wide, _ = improved(own.layout, task.series, linears, replace(wide, levels=levels), found)
    theta, covariance, first = _as_one(tangents, wide.theta, found.covariance)
    constants, farthest, values = constants_of(task.layout.terms), 0.0, {}
    for name, k in first.items():
        constant = constants[name]
        most = FARTHEST * extent(constant)
        step = min(max(float(theta[k]), -most), most)
        place = to_scale(constant, constant.value)
        values[name] = _bounded(constant, place + step)
        moved = abs(to_scale(constant, values[name]) - place)
        farthest = max(farthest, moved / math.sqrt(float(covariance[k, k])))
    return _at_values(task, replace(wide, chosen=state.chosen, theta=theta[: len(state.theta)]), values), farthest


def _at_values(task: Task, state: State, values: Mapping[str, float]) -> tuple[Task, State]:
    """The task and a state for other values of the constants; priors stay."""
    task = replace(task, layout=replace(task.layout, terms=_with(task.layout.terms, values)), recent=[])
    return task, _fresh(state, task.layout)


def _halfway(last: tuple[Task, State], now: tuple[Task, State]) -> tuple[Task, State]:
    """Halfway from where a fit with constants stands to where it stood."""
    before, after = (constants_of(task.layout.terms) for task, _ in (last, now))
    places = {name: [to_scale(one, one.value) for one in (before[name], after[name])] for name in after}
    values = {name: to_plain(after[name], 0.5 * sum(both)) for name, both in places.items()}
    return _at_values(now[0], now[1].towards(last[1]), values)


def joint_covariance(task: Task, state: State, power: float = 1.0) -> tuple[Floats, tuple[ConstantEstimate, ...]]:
    """Covariance of the coefficients of a fit whose constants are not known either, and what is known of these, both of
    a power of the likelihood."""
    own, wide, tangents = _with_tangents(task, state)
    _, covariance, first = _as_one(tangents, wide.theta, own.marginal(wide, keep=False).covariance)
    terms, estimates = task.layout.terms, []
    for name, constant in constants_of(terms).items():
        low, high, scale = constant.low, constant.high, is_scale(constant)
        at = first.get(name)
        present = [j for j in dict.fromkeys(state.chosen.term.tolist()) if j < len(terms)]
        used = range(len(terms)) if at is None else present
        inside = tuple(terms[j].text for j in used if name in terms[j].unknowns)
        sd, ends = None, [low, high]
        if at is not None:
            sd = math.sqrt(float(covariance[at, at]) / power)
            if any(jumps_at(terms[j], name) for j in used):
                sd = math.hypot(sd, extent(constant) / JUMP_NODES)  # where the term jumps is known no better
            place = to_scale(constant, constant.value)
            ends = [to_plain(constant, place + way * Z95 * sd) for way in (-1.0, 1.0)]
        ci95 = max(ends[0], low), min(ends[1], high)
        estimates.append(ConstantEstimate(name, constant.value, sd, ci95, low, high, scale, inside))
    return covariance[: len(state.theta), : len(state.theta)] / power, tuple(estimates)


def _with_odds(task: Task, fitted: Fitted) -> Task:
    """The task with log odds of terms with constants averaged over their ranges, by Laplace's method."""
    lost = np.zeros((task.layout.chains, len(task.layout.terms) + 1))
    for j, cost in _costs(task, fitted).items():
        lost[:, j] = cost
    before = 0.0 if task.ranges is None else task.ranges
    return replace(task, log_odds=task.log_odds + lost.ravel() - before, ranges=lost.ravel())


def _costs(task: Task, fitted: Fitted) -> dict[int, float]:
    """What each term with constants that is in the model loses of its log odds: at least the range is not narrower."""
    state, terms = fitted.state, task.layout.terms
    if not tangents_of(task.layout, state.chosen, state.theta):
        return {}
    _, estimates = joint_covariance(task, state)
    constants = constants_of(terms)
    lost = {
        one.name: min(0.0, math.log(math.sqrt(2.0 * math.pi) * one.sd / extent(constants[one.name])))
        for one in estimates
        if one.sd is not None
    }
    return {j: sum(lost.get(name, 0.0) for name in term.unknowns) for j, term in enumerate(terms) if term.unknowns}


def _by_rows(task: Task, motion: Motion, family: Sequence[int]) -> list[dict[str, float]]:
    """Values of a family's constants that explain most of the smoothed rows, beside the other terms and alone."""
    terms, allowed = task.layout.terms, _allowed(task)
    beside, alone = (_ranked(terms, motion, allowed, family, others)[0][:TRIED] for others in (True, False))
    return beside + [one for one in alone if one not in beside]


def _ranked(
    terms: Sequence[Expression], motion: Motion, allowed: Bools, family: Sequence[int], beside: bool = True
) -> tuple[list[dict[str, float]], list[float]]:
    """Values of a family's constants, those first that explain most of the smoothed rows, beside the other terms."""
    own = [terms[j] for j in family]
    rivals = {one.choice for one in own} - {""}
    waves = any("sin" in one.text or "cos" in one.text for one in own)
    total = sum(rows.n for rows in motion.train)
    step = 1 if waves else max(1, total // ROWS)
    parts = [rows.part(slice(None, None, step)) for rows in motion.train]
    others = [term for j, term in enumerate(terms) if beside and j not in family and term.choice not in rivals]
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
        now = _with(own, values, constants)
        with np.errstate(all="ignore"):
            columns = np.concatenate([evaluate_terms(now, rows.columns) for rows in parts])
            size = np.sqrt((columns**2).sum(axis=0))
        if not np.isfinite(size).all() or not (size > 0.0).all():
            continue
        rest = columns / size
        rest = rest - Q @ (Q.T @ rest)
        gain = left.T @ rest
        explained = np.einsum("ck,kc->c", gain, np.linalg.lstsq(rest.T @ rest, gain.T, rcond=1e-10)[0])
        share = np.clip(explained / square, 0.0, 1.0 - 1e-12)
        found.append((float(-0.5 * len(Y) * np.log1p(-share[used]).sum()), values))
    found.sort(key=lambda one: -one[0])
    if not found:
        return [{name: middle(one) for name, one in constants.items()}], [-math.inf]
    return [values for _, values in found], [score for score, _ in found]


def _with(
    terms: Sequence[Expression], values: Mapping[str, float], located: Mapping[str, Unknown] | None = None
) -> tuple[Expression, ...]:
    """The terms with other values of some constants; with the ranges that were found, where these are given."""
    constants = constants_of(terms) if located is None else {**constants_of(terms), **located}
    found = {name: replace(constants[name], value=value) for name, value in values.items() if name in constants}
    return tuple(term.with_unknowns(found) for term in terms)


def _with_terms(motion: Motion, task: Task, terms: tuple[Expression, ...]) -> Task:
    """The task with terms of other values; priors that were wider than at first stay so."""
    layout = replace(task.layout, terms=terms)
    former = precision_of_terms(motion, task.layout)
    wider = float(np.median(task.precision / former))
    return replace(task, layout=layout, precision=wider * precision_of_terms(motion, layout), recent=[])


def _choices(terms: Sequence[Expression]) -> dict[str, list[int]]:
    """Members of each either-or, as numbers of terms."""
    out: dict[str, list[int]] = {}
    for j, term in enumerate(terms):
        if term.choice:
            out.setdefault(term.choice, []).append(j)
    return {choice: members for choice, members in out.items() if len(members) > 1}


def _allowed(task: Task) -> Bools:
    return np.asarray(task.log_odds.reshape(task.layout.chains, -1)[:, :-1] > -np.inf)


def _of_law(task: Task, family: Sequence[int]) -> bool:
    """Whether terms of a family are laws of hidden states, which were found along the record."""
    stated = [chain.stated for chain in task.layout.roles.chains]
    return bool(_allowed(task)[np.ix_(stated, family)].any())


def _is_active(task: Task, j: int) -> bool:
    return bool(_allowed(task)[:, j].any())
