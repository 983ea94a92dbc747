"""Constants inside terms: values that make the record likeliest, and how well these are known.

Like a coefficient, a constant psi inside the terms of an equation has a column, sum_j theta_j d phi_j / d psi, with ln
psi in place of psi if it is a scale. Its values are first sought on a grid: in the smoothed rows, then in the
likelihood of all candidates about a fit. From the best of them Gauss-Newton steps move constants, coefficients and path
together. Constants have flat priors over their ranges, so that a term with one costs ln(range / (sqrt(2 pi) sd)) of its
odds: it is not favoured for being flexible. Of an either-or one member at a time is in the dictionary; the others are
fitted in its place, and the likeliest is kept.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import (
    JUMP_NODES,
    ConstantEstimate,
    Forms,
    constants_of,
    extent,
    families,
    is_scale,
    jumps_at,
    to_plain,
    to_scale,
)
from bayeq.expressions import Binary, Expression, Node, Symbol, Unknown, number
from bayeq.inference.collapsed.search import best_models
from bayeq.likelihood.fit import State, improved, maximised, solved
from bayeq.likelihood.hidden import law_constants
from bayeq.likelihood.layout import Candidates, Layout
from bayeq.likelihood.model import (
    COARSE,
    MOST_HALVED,
    Fitted,
    Task,
    finished,
    fit,
    over_all_sizes,
    with_model,
)
from bayeq.likelihood.nodes import (
    TRIED,
    GridNode,
    bounded,
    by_rows,
    choices_of,
    derivative,
    extended,
    fresh,
    on_gram,
    ranked,
    start_at,
    with_terms,
    with_values,
)
from bayeq.likelihood.search import CLEARLY, settle
from bayeq.numerics.distributions import Z95
from bayeq.states import Motion

# Peaks of the likelihood about a fit that are fitted, at most.
PEAKS = 2

# The likelihood about a fit is not trusted if, at the values of the fit, it finds another model likelier by more nats:
# some term is then nearly infinite somewhere.
MISLEADS = 100.0

# A series of terms and a term that can replace it are both reported if they are this close, in nats.
CLOSE = 3.0

# Most rounds of moving constants and trying other values; another value must be likelier by this many nats.
ROUNDS, BETTER = 3, 0.5

# Gauss-Newton steps, at most; they move a constant by no more than this share of its range, and end where none moves by
# more than this share of its standard deviation.
STEPS, FARTHEST, NEAR = 12, 0.25, 0.05

# Values of a constant count as different if they are further apart than this share of its range.
APART = 0.01

# Rounding of a sum of terms, as a share of its size.
SAME = 1e-9

# A step changes the logarithm of a coefficient by this at most.
MOST_RESIZED = 20.0


def with_constants(motion: Motion, task: Task, fitted: Fitted) -> tuple[Task, Fitted, Forms]:
    """A fit with its constants where they are likeliest, and the likeliest members of its choices.

    Log odds of the task include the cost of the constants' ranges; the forms are the log posteriors of the members
    whose likelihood is finite.
    """
    terms = task.layout.terms
    choices = choices_of(terms)
    if not choices and not task.layout.has_constants:
        return task, fitted, {}
    task, fitted = settled(motion, task, finished(task, fitted))
    forms: dict[str, dict[str, float]] = {}
    for choice, members in choices.items():
        active = next((j for j in members if task.allowed[:, j].any()), members[0])
        first, found = (task, fitted), dict[str, float]()
        for j in (active, *(j for j in members if j != active)):
            try:
                other = first if j == active else settled(motion, *_instead(motion, *first, active, j))
                # ln p(data, model), constants integrated out
                score = _averaged(*other)
            except np.linalg.LinAlgError:
                continue
            if score > max(found.values(), default=-math.inf):
                task, fitted = other
            found[terms[j].text] = score
        if not found:
            raise np.linalg.LinAlgError(f"{choice}: the likelihood of none is finite")
        forms[choice] = found
    for family in _sought(task):
        task, fitted, found = _beside_a_series(motion, task, fitted, family)
        forms |= {" | ".join(found): found} if found else {}
    return _with_odds(task, fitted), fitted, forms


def settled(motion: Motion, task: Task, fitted: Fitted) -> tuple[Task, Fitted]:
    """The fit after rounds of moving its constants and of trying other values of them."""
    for _ in range(ROUNDS):
        before = fitted
        task, fitted = moved(task, fitted, motion)
        for family in _sought(task):
            task, fitted = _elsewhere(motion, task, fitted, family)
        for values in _exchanged(motion, task, fitted):
            with suppress(np.linalg.LinAlgError):
                family = [j for j, term in enumerate(task.layout.terms) if values.keys() & term.unknowns.keys()]
                other = settle(*start_at(motion, task, fitted, on_gram(task, fitted, family, [values])[0]))
                task, fitted = max((task, fitted), other, key=lambda one: one[1].evidence)
        if fitted is before or fitted.evidence < before.evidence + BETTER:
            break
    return task, fitted


def _beside_a_series(
    motion: Motion, task: Task, fitted: Fitted, family: Sequence[int]
) -> tuple[Task, Fitted, dict[str, float]]:
    """The fit, or one with either a family or other functions of its variables; log posteriors of those that are close.

    Of these the one with the fewest terms is taken. Many terms together may be a series expansion of the family, in
    which case the likelihood about the fit gives no reason to include the family.
    """
    terms = task.layout.terms
    names = frozenset[str]().union(*(terms[j].names for j in family))
    bent = [
        j
        for j, one in enumerate(terms)
        if j not in family and one.names & names and not one.unknowns and not isinstance(one.tree, Symbol)
    ]
    series, fits = [j for j in bent if terms[j].names <= names], [(task, fitted)]
    if _holds(task, fitted.model, series):
        with suppress(np.linalg.LinAlgError):
            fits.append(_alone(motion, _without(task, bent), fitted, family))
    if _holds(task, fitted.model, family):
        bare = _without(task, family)
        with suppress(np.linalg.LinAlgError):
            (now, _), (least, model) = (best_models(one.problem(fitted.quadratic))[0] for one in (task, bare))
            if least > now - MISLEADS:  # otherwise no other terms can replace the family
                fits.append(settle(bare, with_model(bare, fitted, bare.wide(model))))
    scores, forms = [_averaged(*one) for one in fits], [_listed(*one, [*family, *series]) for one in fits]
    told = all(forms)  # otherwise the family is not needed, as its probability says
    close = [k for k, score in enumerate(scores) if score > max(scores) - (CLOSE if told else BETTER)]
    best = min(close, key=lambda k: (fits[k][1].model.sum(), -scores[k])) if told else close[0]
    likely = {forms[k]: scores[k] for k in sorted(close, key=lambda k: scores[k])}
    found, fitted = fits[best]
    return replace(found, log_odds=task.log_odds), fitted, likely if told and len(likely) > 1 else {}


def _alone(motion: Motion, task: Task, fitted: Fitted, family: Sequence[int]) -> tuple[Task, Fitted]:
    """A fit of a task from the values of a family's constants that explain most together with its other candidates."""
    values, _ = ranked(task.layout.terms, motion, task.allowed, family)
    nodes = on_gram(task, fitted, family, values[:TRIED])
    return moved(*settle(*start_at(motion, task, fitted, max(nodes, key=lambda one: one.score))), motion)


def _without(task: Task, terms: Sequence[int]) -> Task:
    """The task without some of its candidates."""
    odds = task.log_odds.reshape(task.layout.chains, -1).copy()
    odds[:, list(terms)] = -np.inf
    return replace(task, log_odds=odds.ravel())


def _listed(task: Task, fitted: Fitted, some: Sequence[int]) -> str:
    """Texts of the terms of `some` that a model has in any equation, separated by commas."""
    return ", ".join(task.layout.terms[j].text for j in some if _holds(task, fitted.model, [j]))


def _averaged(task: Task, fitted: Fitted) -> float:
    """The log evidence of a fit, averaged over the ranges of its constants."""
    return fitted.evidence + sum(_lost(task, fitted).values())


def _elsewhere(motion: Motion, task: Task, fitted: Fitted, family: Sequence[int]) -> tuple[Task, Fitted]:
    """The fit, or one with other values of the constants of a family that the likelihood about it finds likelier."""
    now = {name: one.value for j in family for name, one in task.layout.terms[j].unknowns.items()}
    tried = [one for one in by_rows(task, motion, family) if one != now]
    if not tried:
        return task, fitted
    here, *others = on_gram(task, fitted, family, [now, *tried])
    least = BETTER + (here.score if here.score < here.fitted + MISLEADS else here.fitted)
    peaks = [one for one in _peaks(tried, others) if one.score >= least]
    for node in sorted(peaks, key=lambda one: -one.score)[:PEAKS]:
        try:
            other = settle(*start_at(motion, task, fitted, node))
        except np.linalg.LinAlgError:
            continue
        # a model without these terms does not depend on their values: they are changed only if it is clearly better
        if other[1].evidence > fitted.evidence + (0.0 if _holds(task, other[1].model, family) else BETTER):
            return other
    return task, fitted


def at_other_peaks(motion: Motion, task: Task, fitted: Fitted) -> Iterator[tuple[dict[str, float], Fitted]]:
    """Fits, with the values of their constants, at peaks of the likelihood about a fit that are nearly as high as its
    own and away from it."""
    for family in _sought(task):
        if not _holds(task, fitted.model, family):
            continue
        constants = constants_of([task.layout.terms[j] for j in family])
        now = {name: one.value for name, one in constants.items()}
        tried = [one for one in by_rows(task, motion, family) if one != now]
        here, *nodes = on_gram(task, fitted, family, [now, *tried])
        for node in sorted(_peaks(tried, nodes), key=lambda one: -one.score):
            if node.score > here.score - CLOSE and distance(constants, now, node.values) > APART:
                with suppress(np.linalg.LinAlgError):
                    other, best = moved(*settle(*start_at(motion, task, fitted, node)), motion)
                    found = {name: constants_of(other.layout.terms)[name].value for name in now}
                    if distance(constants, now, found) > APART:
                        yield found, best


def as_likely(task: Task, fitted: Fitted, others: Sequence[tuple[Task, Fitted]]) -> tuple[Mapping[str, float], ...]:
    """Values of constants in laws of hidden states, different from the fit's, at which others are nearly as likely."""
    constants, found = constants_of(task.layout.terms), []
    now = {name: constants[name].value for name in law_constants(task.layout.roles)}
    for there, other in others:
        values = {name: constants_of(there.layout.terms)[name].value for name in now}
        if other.evidence > fitted.evidence - CLEARLY and distance(constants, now, values) > APART:
            found.append(values)
    return tuple(found)


def distance(constants: Mapping[str, Unknown], one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Largest distance of the values of a constant, as a share of its range on its scale; 0 without constants."""
    places = [(constants[name], value, other[name]) for name, value in one.items()]
    return max((abs(to_scale(c, a) - to_scale(c, b)) / extent(c) for c, a, b in places), default=0.0)


def _exchanged(motion: Motion, task: Task, fitted: Fitted) -> Iterator[dict[str, float]]:
    """Exchanged values of the constants of two kinks, as of ``max(x - {g}, 0)`` and ``max(-x - {h}, 0)``.

    With the variable and a constant the law is the same, as max(x + h, 0) = x + h + max(-x - h, 0), but one of the two
    needs fewer terms, and a search that moves one constant at a time does not lead to it.
    """
    columns = motion.train[0].columns
    held = [term for j, term in enumerate(task.layout.terms) if _holds(task, fitted.model, [j])]
    for pair in itertools.combinations([term for term in held if len(term.unknowns) == 1], 2):
        (g, first), (h, second) = (next(iter(term.unknowns.items())) for term in pair)
        if g == h or len(pair[0].names) != 1 or pair[0].names != pair[1].names:
            continue
        affine = np.column_stack([columns[next(iter(pair[0].names))], np.ones(motion.train[0].n)])
        for way in (1.0, -1.0):
            rising, falling = evaluate_terms(with_values(pair, {g: first.value, h: way * first.value}), columns).T
            for both in (rising - falling, rising + falling) if np.isfinite(rising + falling).all() else ():
                left = both - affine @ np.linalg.lstsq(affine, both)[0]
                values = {g: way * second.value, h: way * first.value}
                if np.ptp(left) <= SAME * np.ptp(rising) and all(
                    one.low <= values[name] <= one.high for name, one in ((g, first), (h, second))
                ):
                    yield values


def _holds(task: Task, model: Bools, family: Sequence[int]) -> bool:
    """Whether a model has a term of a family in any equation."""
    return bool(model.reshape(task.layout.chains, -1)[:, list(family)].any())


def _peaks(tried: Sequence[Mapping[str, float]], nodes: Sequence[GridNode]) -> list[GridNode]:
    """Local maxima over the nodes of one constant; of several constants only the likeliest node."""
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
    task = replace(task, log_odds=odds.ravel())
    family = next((own for own in families(task.layout.terms) if j in own), [j])
    tried = on_gram(task, fitted, family, by_rows(task, motion, family))
    for node in sorted(tried, key=lambda one: -one.score)[:PEAKS]:
        with suppress(np.linalg.LinAlgError):
            return settle(*start_at(motion, task, fitted, node))
    raise np.linalg.LinAlgError(f"{task.layout.terms[j].text}: no start leads to a fit")


class Tangent(NamedTuple):
    """Derivative of an equation's terms by a constant: its name, the number of the equation, the derivative."""

    name: str
    chain: int
    change: Expression


def tangents_of(layout: Layout, chosen: Candidates, theta: Floats) -> list[Tangent]:
    """Tangents for every constant in a model's terms, on the constant's scale, in every equation that contains it."""
    sums: dict[tuple[str, int], Node] = {}
    for c, j, size in zip(chosen.chain.tolist(), chosen.term.tolist(), theta.tolist(), strict=True):
        if j == len(layout.terms):
            continue
        term = layout.terms[j]
        for name in term.unknowns:
            change: Node = Binary("*", number(size), derivative(term, name).tree)
            key = name, c
            sums[key] = Binary("+", sums[key], change) if key in sums else change
    return [Tangent(name, c, Expression(change)) for (name, c), change in sums.items()]


def with_tangents(task: Task, state: State, held: str = "") -> tuple[Task, State, list[Tangent]]:
    """The task and a state with the constants of its model, but the one `held`, as further coefficients."""
    tangents = [one for one in tangents_of(task.layout, state.chosen, state.theta) if one.name != held]
    own, wide = extended(task, state, [one.change for one in tangents])
    count, constants = len(tangents), constants_of(task.layout.terms)
    further = Candidates(
        np.array([one.chain for one in tangents], dtype=np.int64), len(task.layout.terms) + np.arange(count)
    )
    own.precision[own.number(further)] = [12.0 / extent(constants[one.name]) ** 2 for one in tangents]
    chosen = Candidates(*(np.append(*both) for both in zip(wide.chosen, further, strict=True)))
    return own, replace(wide, chosen=chosen, theta=np.append(wide.theta, np.zeros(count))), tangents


def as_one(tangents: Sequence[Tangent], theta: Floats, covariance: Floats) -> tuple[Floats, Floats, Mapping[str, int]]:
    """Coefficients, tangents last, and their covariance, conditioned on each constant being the same in all equations;
    also the number of each constant's first tangent among them."""
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
    """The fit, or a likelier one with its constants moved to where they are likeliest; priors are those of the terms in
    the rows of the motion, if it is given."""
    if not tangents_of(task.layout, fitted.state.chosen, fitted.state.theta):
        return task, fitted
    now, last, halved = (task, fitted.state), None, 0
    try:
        for _ in range(STEPS):
            try:
                then, farthest = stepped(*now)
            except np.linalg.LinAlgError:
                halved += 1
                if last is None or halved > MOST_HALVED:
                    raise
                now = _halfway(last, now)
                continue
            last, now = now, then
            if farthest < NEAR:
                break
        own = now[0]
        if motion is not None:
            own = replace(own, precision=with_terms(motion, task, own.layout.terms).precision)
        other = over_all_sizes(own, fit(own, now[1]))
    except np.linalg.LinAlgError:
        return task, fitted
    return (own, other) if other.evidence > fitted.evidence else (task, fitted)


def stepped(task: Task, state: State, held: str = "") -> tuple[tuple[Task, State], float]:
    """A Gauss-Newton step of a fit and its constants; the largest step of a constant, in standard deviations. The
    constant `held` stays.

    Coefficients are those likeliest at the former constants, in proportion to the size of their terms at the new ones:
    a joint step may reverse their signs, as those of powers of numbers far from 1 change by orders of magnitude.
    """
    own, wide, tangents = with_tangents(task, state, held)
    linears = own.linearised(wide)
    levels, found = maximised(linears, wide, own.precision_of(wide), **COARSE)
    wide = improved(own.layout, task.series, linears, replace(wide, levels=levels), found)[0]
    theta, covariance, first = as_one(tangents, wide.theta, found.covariance)
    constants, farthest, values, steps = constants_of(task.layout.terms), 0.0, {}, {}
    for name, k in first.items():
        constant = constants[name]
        most = FARTHEST * extent(constant)
        step = min(max(float(theta[k]), -most), most)
        place = to_scale(constant, constant.value)
        values[name] = bounded(constant, place + step)
        steps[name] = to_scale(constant, values[name]) - place
        farthest = max(farthest, abs(steps[name]) / math.sqrt(float(covariance[k, k])))
    r, columns = len(state.theta), np.concatenate([one.terms for one in linears])
    theta = theta[:r] - covariance[:r, r:] @ solved(covariance[r:, r:], theta[r:])
    theta *= _resized(task, state, tangents, columns, steps)
    return at_values(task, replace(wide, chosen=state.chosen, theta=theta), values), farthest


def _resized(
    task: Task, state: State, tangents: Sequence[Tangent], columns: Floats, steps: Mapping[str, float]
) -> Floats:
    """Factor of each coefficient, (r,), that keeps the size of terms where their constants move by `steps`; `columns`
    (n, P + T + 1) are candidates and tangents along the path."""
    terms, out = task.layout.terms, np.zeros(len(state.theta))
    pairs = list(zip(state.chosen.chain.tolist(), state.chosen.term.tolist(), strict=True))
    for k, (name, chain, _) in enumerate(tangents, len(terms)):
        own = [i for i, (c, j) in enumerate(pairs) if c == chain and j < len(terms) and name in terms[j].unknowns]
        sums = columns[:, state.chosen.term[own]] @ state.theta[own]
        out[own] -= steps[name] * float(sums @ columns[:, k]) / max(float(sums @ sums), 1e-300)
    return np.asarray(np.exp(np.clip(out, -MOST_RESIZED, MOST_RESIZED)))


def at_values(task: Task, state: State, values: Mapping[str, float]) -> tuple[Task, State]:
    """The task and a state for other values of the constants; priors stay."""
    task = replace(task, layout=replace(task.layout, terms=with_values(task.layout.terms, values)))
    return task, fresh(state, task.layout)


def _halfway(last: tuple[Task, State], now: tuple[Task, State]) -> tuple[Task, State]:
    """The task and state halfway back from `now` to `last`, constants included."""
    before, after = (constants_of(task.layout.terms) for task, _ in (last, now))
    places = {name: [to_scale(one, one.value) for one in (before[name], after[name])] for name in after}
    values = {name: to_plain(after[name], 0.5 * sum(both)) for name, both in places.items()}
    return at_values(now[0], now[1].towards(last[1]), values)


def joint_covariance(task: Task, state: State, power: float = 1.0) -> tuple[Floats, tuple[ConstantEstimate, ...]]:
    """Covariance of a fit's coefficients with constants estimated jointly, and estimates of the constants, both from
    the likelihood raised to `power`."""
    own, wide, tangents = with_tangents(task, state)
    _, covariance, first = as_one(tangents, wide.theta, own.marginal(wide, keep=False).covariance)
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
                sd = math.hypot(sd, extent(constant) / JUMP_NODES)  # the place of a jump is known no better
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
    """Change of the log odds of each term with constants: the sum of `_lost` over its constants."""
    lost = _lost(task, fitted)
    names = {j: term.unknowns for j, term in enumerate(task.layout.terms) if term.unknowns} if lost else {}
    return {j: sum(lost.get(name, 0.0) for name in own) for j, own in names.items()}


def _lost(task: Task, fitted: Fitted) -> dict[str, float]:
    """Change of the log evidence [nats] by averaging over the range of each constant in the model, 0 at most."""
    state = fitted.state
    if not tangents_of(task.layout, state.chosen, state.theta):
        return {}
    _, estimates = joint_covariance(task, state)
    constants = constants_of(task.layout.terms)
    return {
        one.name: min(0.0, math.log(math.sqrt(2.0 * math.pi) * one.sd / extent(constants[one.name])))
        for one in estimates
        if one.sd is not None
    }


def _sought(task: Task) -> list[list[int]]:
    """Families allowed in some equation, except those of stated laws of hidden states, found along the record."""
    allowed, stated = task.allowed, [chain.stated for chain in task.layout.roles.chains]
    return [
        own for own in families(task.layout.terms) if allowed[:, own].any() and not allowed[np.ix_(stated, own)].any()
    ]
