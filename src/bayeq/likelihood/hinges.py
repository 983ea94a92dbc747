"""Kinks that no candidate has: whether the law needs functions max(x - g, 0) of a state.

Powers, signs and absolute values fit a kink, as of a spring that meets a stop, to within the noise, and then no test of
what is left finds anything; but the slope at rest is not that of the spring. So the likelihood about the fit compares
the models of the candidates with models that also have hinges at quantiles of a state or input, and its sign.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import count, pairwise
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import constants_of
from bayeq.errors import in_digits
from bayeq.expressions import Binary, Expression, Symbol, parse
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.likelihood.fit import State, coefficients
from bayeq.likelihood.model import NOTICED, Fitted, Task, from_all_levels, with_model
from bayeq.likelihood.nodes import beside
from bayeq.likelihood.search import CLEARLY
from bayeq.numerics.settings import LIKELIHOOD

# Share of the samples on either side of all hinges, and their least number: fewer may be outliers.
OUTSIDE, BEYOND = 0.04, 10

# Most kinks that are named, and the share of the discrepancy that may be left: half of its power.
MOST, MOST_LEFT = 2, 0.7


class Kinks(NamedTuple):
    """Hinges that the likeliest law of an equation has beside candidates."""

    name: str  # of a state or input, or a difference of two, as they are written
    gain: float  # nats by which the laws are likelier than those without hinges
    places: tuple[float, ...]  # about where the largest kinks are
    terms: tuple[str, ...]  # candidates, with an unknown place each, that have these kinks and are 0 at rest
    alone: bool  # whether the law has no other kinks, and no other functions of the same alone
    left: float  # discrepancy that it leaves, as a share of the target's standard deviation
    jumps: bool = False  # whether it jumps at 0: the first of `terms` is then its sign


class _Proposal(NamedTuple):
    """The likeliest laws with hinges of one argument, by the likelihood about a fit without hinges."""

    argument: Expression
    gain: float
    grid: Floats  # (K + 2,), places of the least value, the hinges and the largest value
    sign: tuple[str, ...]  # of the argument, if it changes its sign and no candidate is that
    task: Task  # with the hinges, and the sign, after the candidates
    start: State


def kinks_of(task: Task, fitted: Fitted, lacking: bool) -> dict[int, Kinks]:
    """Kinks, by the number of the equation, that make the laws clearly likelier and explain most of what they lack:
    those of a state or input, of a difference that is a candidate, or of neighbouring coordinates.

    Unless laws are `lacking` what the motion needs, only arguments of which the fit has other functions are tried.
    Those of a function with a constant inside are not: hinges would compensate for an error of that constant.
    """
    layout = task.layout
    if task.flows is not None or not np.isfinite(task.log_odds).any():
        return {}
    own = [layout.terms[j] for j in set(fitted.state.chosen.term.tolist()) if j < len(layout.terms)]
    arguments = [parse(name, layout.names) for name in (*layout.roles.states, *layout.roles.inputs)]
    moving = [chain.names[0] for chain in layout.roles.chains if chain.order == 2]
    differences = [term for term in layout.terms if _is_difference(term)]
    arguments += differences or [parse(f"{a}-{b}", layout.names) for a, b in pairwise(moving)]
    held = [term.names for term in own if term.unknowns]
    proposals = list[_Proposal]()
    for argument in arguments:
        if argument.names not in held and (lacking or any(_function_of(argument, term) for term in own)):
            with suppress(np.linalg.LinAlgError):  # where the likelihood with hinges is not finite there is none
                one = _proposal(task, fitted, argument)
                proposals += [one] if one is not None else []
    for one in sorted(proposals, key=lambda one: -one.gain):
        with suppress(np.linalg.LinAlgError):
            best = _fit(one)
            if best.evidence > fitted.evidence + CLEARLY:
                found = _kinks(one, best, best.evidence - fitted.evidence)
                before = fitted.state.levels.kappa
                return {c: kinks for c, kinks in found.items() if kinks.left <= max(MOST_LEFT * before[c], NOTICED)}
    return {}


def _is_difference(term: Expression) -> bool:
    tree = term.tree
    return (
        isinstance(tree, Binary) and tree.op == "-" and isinstance(tree.left, Symbol) and isinstance(tree.right, Symbol)
    )


def _function_of(argument: Expression, term: Expression) -> bool:
    """Whether a term is another function of the names in an argument."""
    return term.names == argument.names and term.text != argument.text


def _kinks(one: _Proposal, best: Fitted, gain: float) -> dict[int, Kinks]:
    """The kinks of each equation: neighbouring hinges that bend the same way are one, about their centre. Their places
    are those of the equation that bends most, so that one constant each is offered to all."""
    found, most, layout, K = dict[int, tuple[bool, float, bool]](), 0.0, one.task.layout, len(one.grid) - 2
    model, P = best.model.reshape(layout.chains, -1), len(layout.terms) - K - len(one.sign)
    theta = coefficients(layout, best.state).reshape(layout.chains, -1)
    bent = [j for j, term in enumerate(layout.terms[:P]) if _function_of(one.argument, term)]
    offered: list[tuple[float, float, float]] = []
    for c, sizes in enumerate(theta[:, P : P + K]):
        inside = np.flatnonzero(sizes)
        apart = (np.diff(inside) > 1) | (np.diff(np.sign(sizes[inside])) != 0.0)
        groups = np.split(inside + 1, np.flatnonzero(apart) + 1) if len(inside) else []
        kinks = sorted(((abs(float(sizes[k - 1].sum())), k) for k in groups), key=lambda kink: -kink[0])
        kinks = [(bend, k) for bend, k in kinks if bend >= LIKELIHOOD.least_kink * kinks[0][0]]
        about = [(k, float(np.average(one.grid[k], weights=sizes[k - 1]))) for _, k in kinks[:MOST]]
        places = sorted((float(one.grid[k[0] - 1]), place, float(one.grid[k[-1] + 1])) for k, place in about)
        jumps = bool(model[c, P + K : -1].any())
        if places or jumps:
            found[c] = len(kinks) <= MOST and not model[c, bent].any(), float(best.state.levels.kappa[c]), jumps
            if kinks and kinks[0][0] > most:
                most, offered = kinks[0][0], places
    jumping = any(jumps for *_, jumps in found.values())
    at = (0.0,) * jumping + tuple(place for _, place, _ in offered)
    terms = one.sign * jumping + tuple(_offered(one, offered))
    return {c: Kinks(one.argument.text, gain, at, terms, *own) for c, own in found.items()}


def _offered(one: _Proposal, places: Sequence[tuple[float, float, float]]) -> Iterator[str]:
    """Candidates with kinks between the first and the last of each place, that are 0 at rest: at 0, or where the motion
    has its middle if it is beside 0."""
    low, rest, high = one.grid[[1, len(one.grid) // 2, -2]]
    rest = 0.0 if low < 0.0 < high else float(rest)
    text, taken = one.argument.text, {*one.task.layout.names, *constants_of(one.task.layout.terms)}
    letters = (name for k in count() for letter in "gh" if (name := f"{letter}{k or ''}") not in taken)
    for (first, place, last), letter in zip(places, letters, strict=False):
        way, of = (1.0, text) if place > rest else (-1.0, f"-{text}" if text.isidentifier() else f"-({text})")
        least, most = sorted((way * first, way * last))
        yield f"max({of}-{{{letter}:{in_digits(max(least, way * rest) + 0.0, 3)}..{in_digits(most, 3)}}},0)"


def _proposal(task: Task, fitted: Fitted, argument: Expression) -> _Proposal | None:
    """The likeliest laws with hinges beside candidates, or in place of other functions of the argument; None if they
    are not worth a fit."""
    layout, P, C = task.layout, len(task.layout.terms), task.layout.chains
    paths = (dict(zip(layout.names, path.T, strict=True)) for path in fitted.state.paths)
    values = np.concatenate([evaluate_terms([argument], path)[:, 0] for path in paths])
    outside = max(OUTSIDE, BEYOND / len(values))
    if outside >= 0.5:
        return None
    shares = np.concatenate([[0.0], np.linspace(outside, 1.0 - outside, LIKELIHOOD.kink_places), [1.0]])
    grid = np.quantile(values, shares)
    if not (np.diff(grid) > 0.0).all():
        return None
    hinges = [parse(f"max({argument.text}-({place!r}),0)", layout.names) for place in grid[1:-1].tolist()]
    jump = parse(f"sign({argument.text})", layout.names)
    if grid[1] < 0.0 < grid[-2] and all(term.text != jump.text for term in layout.terms):
        hinges.append(jump)
    like = next((j for j, term in enumerate(layout.terms) if term.text == argument.text), 0)
    q, own, state = beside(task, fitted, hinges, [like])
    odds = own.log_odds.reshape(C, -1)
    stated = np.array([chain.stated for chain in layout.roles.chains])
    odds[:, P:-1] = np.where(stated, -math.inf, np.median(task.log_odds[np.isfinite(task.log_odds)]))[:, None]
    without = odds.copy()
    without[:, P:-1] = -math.inf
    own = replace(own, log_odds=odds.ravel())
    here = own.model(state.chosen)
    others = np.array([not _function_of(argument, term) for term in layout.terms] + [True] * (len(hinges) + 1))
    bare = (here.reshape(C, -1) & others).ravel()
    problem = own.problem(q)
    before, _ = best_models(replace(own, log_odds=without.ravel()).problem(q), [here])[0]
    # a search from powers does not find hinges in their place
    instead = replace(own, log_odds=np.where(others, odds, -math.inf).ravel()).problem(q)
    found = [best_models(problem, [here])[0], best_models(instead, [bare])[0]]
    found = [(score, model) for score, model in found if model.reshape(C, -1)[:, P:-1].any()]
    score, model = max(found, key=lambda one: one[0], default=(-math.inf, here))
    if not score > before - LIKELIHOOD.neighbour_window:
        return None
    coef, _ = exact_posterior(problem, model, None)
    chosen = own.layout.everything.take(np.flatnonzero(model))
    start = replace(state, chosen=chosen, theta=(coef / np.sqrt(own.precision))[model])
    return _Proposal(argument, score - before, grid, tuple(one.text for one in hinges[len(grid) - 2 :]), own, start)


def _fit(one: _Proposal) -> Fitted:
    """The fit with hinges, moved to those that are the likeliest about it as long as this gains."""
    found = from_all_levels(one.task, one.start)
    while True:
        _, model = best_models(one.task.problem(found.quadratic), [found.model])[0]
        if (model == found.model).all():
            return found
        other = from_all_levels(one.task, with_model(one.task, found, model), found)
        if not other.evidence > found.evidence + CLEARLY:
            return max((found, other), key=lambda fit: fit.evidence)
        found = other
