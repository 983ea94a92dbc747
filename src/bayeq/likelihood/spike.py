"""Laws that are only nearly true: included terms plus a small function of the states, whose size is estimated.

In units of their priors the coefficients of equation c are ``gamma N(0, I) + zeta``: slabs, plus a soft spike
``zeta ~ N(0, tau^2 R R')``. R makes the function phi'zeta isotropic in the span of all candidates on the record, with a
root mean square of tau times the target's standard deviation. Integrating zeta out changes only the likelihood of the
slabs' coefficients, so that models are compared as if spikes were hard.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats
from bayeq.dictionary.families import count, monomials
from bayeq.dictionary.ranges import constants_of, extent
from bayeq.expressions import Expression, parse
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.collapsed.listing import ModelSet, distinct, list_models
from bayeq.inference.collapsed.search import Move, best_models, neighbours, scores_of
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import Posterior
from bayeq.likelihood.adjoint import Adjoint, root_of
from bayeq.likelihood.fit import (
    Quadratic,
    State,
    adjoints,
    bent_by,
    candidates,
    coefficients,
    information,
    solved,
)
from bayeq.likelihood.layout import Candidates, Layout
from bayeq.likelihood.model import NOTICED, Fitted, Task, calmed, finished, fit, over_all_sizes, with_model
from bayeq.likelihood.nodes import extended
from bayeq.likelihood.search import MOST_TO_MOVE
from bayeq.likelihood.unknowns import moved, tangents_of
from bayeq.numerics.settings import LIKELIHOOD

Sizes = tuple[float, ...]

# Number of samples, evenly chosen, on which functions are made isotropic: the larger of this and of this per candidate.
ROWS, ROWS_PER_TERM = 4000, 10

# Most rounds over the equations; with more than this many candidates all equations have one size.
ROUNDS, MOST_APART = 3, 300

# Directions whose singular value or eigenvalue is below this share of the largest are left out.
CUT = 1e-7

# Hidden candidates are monomials of this degree at most.
MOST_DEGREE = 6

# Sizes are not averaged over if their likeliest model is less likely than that of the best size by more nats.
NEGLIGIBLE = 10.0


@dataclass(frozen=True, eq=False)
class Nearly:
    """Sizes of the functions that the equations lack, and the probabilities that they lack none."""

    tau: Sizes  # the most probable size of each equation's function, as a share of the target's standard deviation
    # the probability that there is none, or none larger than the tolerance; NaN where it is not known
    exact: tuple[float, ...]

    @classmethod
    def unknown(cls, chains: int) -> Nearly:
        """Sizes of 0 and unknown probabilities, for a fit whose likelihood with functions cannot be evaluated."""
        return cls((0.0,) * chains, (np.nan,) * chains)


def softened(level: float, root: Floats, c: Floats, spread: Floats) -> Quadratic:
    """The likelihood about p coefficients with deviations N(0, S S') integrated out, S = `spread`, (p, K).

    It is given as its level, the information A = F F' with `root` F, (p, r), and the slope F c (`coordinates`). With
    F'S = U diag(s) V' the result has the information F (I - U U') F' + F U diag(1/(1 + s^2)) U' F'. The equivalent
    A - A S (I + S'A S)^-1 S'A loses all digits if noise is low.
    """
    U, s, _ = np.linalg.svd(root.T @ spread, full_matrices=False)
    left, inside = 1.0 / (1.0 + s**2), root @ U
    across, within = root - inside @ U.T, inside * np.sqrt(left)
    along = U.T @ c
    outside = c - U @ along
    outside -= U @ (U.T @ outside)  # removes rounding errors that the first difference leaves
    slope = root @ outside + inside @ (left * along)
    level += 0.5 * float(np.sum(s**2 * left * along**2)) + 0.5 * float(np.log(left).sum())
    return Quadratic(level, slope, across @ across.T + within @ within.T)


def coordinates(root: Floats, slope: Floats) -> Floats:
    """c, (r,), of a slope F c, for the `root` F of the information."""
    return np.asarray(np.linalg.lstsq(root, slope, rcond=None)[0])


def isotropic(columns: Floats, moved: Sequence[Floats], deviation: float) -> Floats:
    """R, (p, K), of isotropic functions, of root mean square `deviation`, of columns in units of coefficients' priors.

    Columns, (n, p), are along the path; `moved` are their changes by one standard deviation of each state: directions
    that have more power from these than from the path are left out as noise.
    """
    unit = np.sqrt(len(columns)) * deviation
    _, size, axes = np.linalg.svd(np.linalg.qr(np.vstack([columns, *moved]), mode="r") / unit, full_matrices=False)
    kept = size > CUT * size[0]
    alike = axes[kept].T / size[kept]
    _, share, turned = np.linalg.svd(np.linalg.qr(columns @ alike, mode="r") / unit, full_matrices=False)
    known = share**2 > LIKELIHOOD.misfit_along
    if not known.any():
        raise np.linalg.LinAlgError("no function of the states is known")
    return np.asarray(alike @ turned[known].T / np.sqrt(known.sum()))


def softened_rows(gram: Gram, size: float) -> Gram:
    """The Gram, with noise of variance 1, after integrating out a function of the columns of this relative size."""
    squares, axes = np.linalg.eigh(gram.DtD / gram.n)
    kept = squares > CUT * squares[-1]
    R = axes[:, kept] * np.sqrt(gram.yty / gram.n / squares[kept] / kept.sum())
    root = root_of(gram.DtD)
    q = softened(0.0, root, coordinates(root, gram.Dty), size * R)
    left = gram.yty - float(gram.Dty @ solved(gram.DtD, gram.Dty))
    yty = left + float(q.slope @ solved(q.information, q.slope))
    return replace(gram, DtD=q.information, Dty=q.slope, yty=yty)


def sizes_of(tolerance: float | None, rank: int) -> Floats:
    """Sizes that a function in a space of dimension `rank` may have; the first has half of the prior probability."""
    first = tolerance or 0.0
    if tolerance == 0.0:
        return np.zeros(1)
    most = min(LIKELIHOOD.misfit_most, LIKELIHOOD.misfit_per_direction * np.sqrt(rank))
    grid = np.geomspace(LIKELIHOOD.misfit_least, most, LIKELIHOOD.misfit_sizes)
    return np.append(first, grid[grid > first])


def hidden_terms(layout: Layout, fewest: int) -> tuple[Expression, ...]:
    """Monomials of the states that extend the span of functions if some equation has few candidates, `fewest`."""
    if fewest >= LIKELIHOOD.misfit_few:
        return ()
    states, own = layout.roles.variables, {term.text for term in layout.terms}
    degree = next(
        d for d in range(1, MOST_DEGREE + 1) if count(len(states), d) > LIKELIHOOD.misfit_few or d == MOST_DEGREE
    )
    return tuple(parse(text, states) for text in monomials(states, degree) if text not in own)


class Freed(NamedTuple):
    """Derivative of a term of a model by one of its constants."""

    name: str  # of the constant
    of: tuple[int, int]  # numbers of the equation and of the term
    change: Expression  # derivative, on the scale of the constant, times the coefficient
    column: int  # number of the derivative among all candidates of an equation
    deviation: float  # standard deviation of the constant's prior


def freed(layout: Layout, state: State, first: int) -> list[Freed]:
    """The derivatives of every term of a fit by its constants; their columns are numbered from `first` on."""
    constants, out = constants_of(layout.terms), list[Freed]()
    for k, of in enumerate(zip(state.chosen.chain.tolist(), state.chosen.term.tolist(), strict=True)):
        for one in tangents_of(layout, state.chosen.take(np.array([k])), state.theta[[k]]):
            deviation = extent(constants[one.name]) / np.sqrt(12.0)
            out.append(Freed(one.name, of, one.change, first + len(out), deviation))
    return out


@dataclass(eq=False)
class Soft:
    """The likelihood of all candidates about a fit, hidden ones too if they are few, with functions integrated out."""

    task: Task  # task of the fit
    fitted: Fitted
    visible: NDArray[np.intp]  # (C (P + 1),), the candidates' numbers among all, hidden ones included
    whole: Quadratic  # the likelihood of all candidates; its level is that at the fit
    about: Floats  # all coefficients of the fit
    # (p, K), S of functions of size 1 in each equation: deviations of all coefficients are N(0, tau^2 S S')
    spreads: list[Floats]
    # derivatives by constants inside the fit's terms: in models with these terms the constants are integrated out
    constants: Sequence[Freed] = ()
    likeliest: dict[Sizes, float] = field(default_factory=dict)
    sets: dict[Sizes, ModelSet] = field(default_factory=dict)
    costs: dict[bytes, float] = field(default_factory=dict)

    @classmethod
    def of(cls, task: Task, fitted: Fitted) -> Soft:
        """The likelihood about a fit, with hidden candidates and derivatives by constants added."""
        layout, state = task.layout, fitted.state
        allowed = task.log_odds.reshape(layout.chains, -1) > -np.inf
        P, constants = len(layout.terms), list[Freed]()
        hidden: Sequence[Expression] = ()
        if task.counted is None:
            hidden = hidden_terms(layout, int(allowed[~state.levels.stated, :-1].sum(axis=1).min()))
            constants = freed(layout, state, P + len(hidden))
        own, state = extended(task, state, [*hidden, *(one.change for one in constants)])
        layout, functions = own.layout, np.arange(P, P + len(hidden))
        width = len(layout.terms) + 1
        column = np.append(np.arange(P), width - 1)
        linears, found = own.linearised(state), own.marginal(state)
        smoothed = adjoints(linears, state.levels, found, found.delta, curved=True, smoothed=True)
        bend, _ = bent_by(layout, linears, state, smoothed, found.filtered)
        whole = fitted.quadratic
        if width > P + 1:
            whole = information(layout, linears, state, bend).raised(fitted.power)
        # the log determinant curves downwards, since growth of deviations only tells more of the motion's start: for
        # J = exp(-a t) over a time T -ln(mean J^2) is a T - (a T)^2/6, with the curvature slope^2/3 per state
        about = coefficients(layout, state)
        curved = np.outer(bend.slopes, bend.slopes) / (3.0 * max(layout.motion, 1))
        whole = replace(whole, information=whole.information + curved, slope=whole.slope + curved @ about)
        step = max(1, sum(map(len, state.paths)) // max(ROWS, ROWS_PER_TERM * width))
        columns = np.concatenate(candidates(layout, task.series, state, step))
        moved = moved_columns(own, state, smoothed, columns, step)
        spreads = []
        for c in range(layout.chains):
            if state.levels.stated[c]:
                spreads.append(np.zeros((layout.chains * width, 0)))
                continue
            unit, deviation = np.zeros(width), float(np.sqrt(state.levels.target[c]))
            unit[functions] = deviation / np.sqrt(np.mean(columns[:, functions] ** 2, axis=0))
            unit[column] = np.where(allowed[c], task.precision.reshape(allowed.shape)[c] ** -0.5, 0.0)
            used = np.flatnonzero(unit)
            R = isotropic(columns[:, used] * unit[used], [one[:, used] * unit[used] for one in moved], deviation)
            spread = np.zeros((layout.chains, width, R.shape[1]))
            spread[c, used] = unit[used, None] * R
            spreads.append(spread.reshape(-1, R.shape[1]))
        visible = (np.arange(layout.chains)[:, None] * width + column).ravel()
        return cls(task, fitted, visible, whole, about, spreads, constants)

    @property
    def known(self) -> list[Bools]:
        """The model of the fit, a further start of searches over models."""
        return [self.task.narrow(self.fitted.model)]

    @cached_property
    def root(self) -> Floats:
        """Square root F of the information matrix A = F F' on all candidates, hidden functions and constants."""
        return root_of(self.whole.information)

    @cached_property
    def at_fit(self) -> tuple[Quadratic, Floats]:
        """The likelihood about the fit, and c of its slope F c."""
        slope = self.whole.slope - self.whole.information @ self.about
        return replace(self.whole, slope=slope), coordinates(self.root, slope)

    def quadratic(self, tau: Sizes, constants: Sequence[Freed] | None = None) -> tuple[Quadratic, float]:
        """The likelihood of all candidates about zero, functions and constants integrated out; ln of its maximum."""
        q, c = self.at_fit
        spreads = [size * spread for size, spread in zip(tau, self.spreads, strict=True) if size > 0.0]
        spreads += spreads_of(self.constants if constants is None else constants, len(self.about), len(tau))
        if spreads:
            q = softened(q.level, self.root, c, np.hstack(spreads))
        A, b = q.information[np.ix_(self.visible, self.visible)], q.slope[self.visible]
        return Quadratic(q.level, b + A @ self.about[self.visible], A), q.level + 0.5 * float(b @ solved(A, b))

    def best(self, tau: Sizes) -> float:
        """ln p(data, model | sizes) of the likeliest model, up to a constant."""
        if self.constants:
            return float(self.models(tau).log_posterior[0])
        if tau not in self.likeliest:
            q, largest = self.quadratic(tau)
            self.likeliest[tau] = best_models(self.task.problem(q), self.known)[0][0] + largest
        return self.likeliest[tau]

    def models(self, tau: Sizes) -> ModelSet:
        """The models given sizes, with ln p(data, model | sizes) up to the same constant."""
        if tau not in self.sets:
            q, largest = self.quadratic(tau)
            found = list_models(self.task.problem(q), known=self.known)
            finite = np.isfinite(found.log_posterior)  # terms that are equal up to rounding may overflow
            if not finite.any():
                raise np.linalg.LinAlgError("no model's evidence is finite")
            found = _sorted(found, found.models[finite], found.log_posterior[finite] + largest)
            self.sets[tau] = self._with_constants(tau, found) if self.constants else found
        return self.sets[tau] if any(tau) else as_fitted(self.sets[tau], self.task, self.fitted)

    def _with_constants(self, tau: Sizes, found: ModelSet) -> ModelSet:
        wide = np.array([self.task.wide(one) for one in found.models])
        return _sorted(found, found.models, self._integrated(tau, wide))

    def exact(self, wide: Bools) -> Floats:
        """ln p(data, model) of the models `wide` as exact laws, up to the constant of `models`."""
        return self._integrated((0.0,) * len(self.spreads), wide)

    def _integrated(self, tau: Sizes, wide: Bools) -> Floats:
        """ln p of models with the constants of their own terms integrated out, and the cost `_lost` added back."""
        has = wide[:, self.task.number(Candidates(*np.array([one.of for one in self.constants]).T))]
        values = np.empty(len(wide))
        for pattern in np.unique(has, axis=0):
            rows = (has == pattern).all(axis=1)
            values[rows] = self._scores(tau, wide[rows], self._inside(pattern)) + self._lost(pattern)
        return values

    def _inside(self, pattern: Bools) -> list[Freed]:
        return [one for one, held in zip(self.constants, pattern, strict=True) if held]

    def _lost(self, pattern: Bools) -> float:
        """Nats that the fit's model, as an exact law, loses by integrating out the constants of `pattern`."""
        key = pattern.tobytes()
        if key not in self.costs:
            exact, own = (0.0,) * len(self.spreads), self.fitted.model[None]
            given, free = (self._scores(exact, own, some)[0] for some in ([], self._inside(pattern)))
            self.costs[key] = float(given - free)
        return self.costs[key]

    def _scores(self, tau: Sizes, wide: Bools, constants: Sequence[Freed]) -> Floats:
        """ln p(data, model | sizes) of the models `wide`, with these constants integrated out."""
        q, largest = self.quadratic(tau, constants)
        return scores_of(self.task.problem(q), np.array([self.task.narrow(one) for one in wide])) + largest

    def evidence(self, tau: Sizes) -> float:
        """ln p(data | sizes) up to the same constant."""
        return float(np.logaddexp.reduce(self.models(tau).log_posterior))


def spreads_of(constants: Sequence[Freed], size: int, chains: int) -> list[Floats]:
    """S, (p, 1), of each constant: by its prior the deviations of all coefficients are N(0, S S')."""
    out: dict[str, Floats] = {}
    for one in constants:
        place = one.of[0] * (size // chains) + one.column
        out.setdefault(one.name, np.zeros((size, 1)))[place] = one.deviation
    return list(out.values())


def moved_columns(task: Task, state: State, smoothed: Sequence[Adjoint], columns: Floats, step: int) -> list[Floats]:
    """Changes of the columns, at every `step`-th sample, as each state moves by its standard deviation."""
    layout, out = task.layout, []
    spread = [np.sqrt(np.maximum(np.diagonal(one.covariance, axis1=1, axis2=2), 0.0)) for one in smoothed]
    for unit in np.delete(np.eye(layout.size), layout.discrepancy, axis=0):
        paths = tuple(path + np.where(unit, sd, 0.0) for path, sd in zip(state.paths, spread, strict=True))
        moved = candidates(layout, task.series, replace(state, paths=paths), step)
        out.append(np.concatenate(moved) - columns)
    return out


def as_fitted(found: ModelSet, task: Task, fitted: Fitted) -> ModelSet:
    """The models, with the evidence of their own fit for those that were fitted."""
    fits = {fitted.model.tobytes(): fitted.evidence} | fitted.tried
    own = {task.narrow(np.frombuffer(wide, dtype=np.bool_)).tobytes(): value for wide, value in fits.items()}
    places = {model.tobytes(): k for k, model in enumerate(found.models)}
    here = places.get(task.narrow(fitted.model).tobytes())
    if here is None or fitted.power < 1.0:
        return found
    values = found.log_posterior.copy()
    level = values[here] - fitted.evidence
    for model, evidence in own.items():
        if model in places:
            values[places[model]] = level + evidence
    return _sorted(found, found.models, values)


def among_fitted(found: ModelSet, task: Task, fitted: Fitted) -> ModelSet:
    """Only the models that were fitted, with the evidence of their fits."""
    tried = fitted.tried or {fitted.model.tobytes(): fitted.evidence}
    models = np.array([task.narrow(np.frombuffer(key, dtype=np.bool_)) for key in tried])
    return _sorted(found, models, np.array([*tried.values()]))


def _sorted(found: ModelSet, models: Bools, values: Floats) -> ModelSet:
    order = np.argsort(-values, kind="stable")
    return replace(found, models=models[order], log_posterior=values[order], inclusion=None)


def soft_of(task: Task, fitted: Fitted) -> Soft | None:
    """`Soft` of a fit; None if laws are to be exact and have no constants, or if it cannot be evaluated."""
    try:
        return None if task.tolerance == 0.0 and not task.layout.has_constants else Soft.of(task, fitted)
    except np.linalg.LinAlgError:
        return None


def averaged(task: Task, fitted: Fitted, soft: Soft | None) -> tuple[Posterior, Nearly]:
    """The posterior averaged over models and over the size of each function, the others at their most probable."""
    chains = task.layout.chains
    nearly = Nearly((0.0,) * chains, (1.0,) * chains) if task.tolerance == 0.0 else Nearly.unknown(chains)
    if soft is not None:
        try:
            tau, exact, lines = _most_probable(soft)
            mixed = partial(_mixed, search=soft, lines=lines)
            return of_gram(task, soft.quadratic(tau)[0], mixed), Nearly(tau, tuple(exact.tolist()))
        except np.linalg.LinAlgError:
            nearly = Nearly.unknown(chains)
    return of_gram(task, fitted.quadratic, partial(as_fitted, task=task, fitted=fitted)), nearly


def of_gram(task: Task, q: Quadratic, revise: Callable[[ModelSet], ModelSet]) -> Posterior:
    """The posterior of all coefficients, averaged over models whose weights `revise` changes."""
    found = spike_slab_bma(task.gram(q), task.selected, revise=revise)
    return found if task.flows is None else task.flows.paired(found, task.precision)


def _most_probable(search: Soft) -> tuple[Sizes, Floats, dict[Sizes, float]]:
    """The most probable sizes, equation by equation; P(first size) of each; ln prior of sizes to average over."""
    chains = len(search.spreads)
    together = len(search.task.precision) > MOST_APART or search.task.flows is not None
    free = np.flatnonzero(~search.fitted.state.levels.stated).tolist()
    groups = [free] if together else [[c] for c in free]
    grids = [sizes_of(search.task.tolerance, min(search.spreads[c].shape[1] for c in group)) for group in groups]
    tau = [0.0] * chains
    for group, grid in zip(groups, grids, strict=True):
        for c in group:
            tau[c] = float(grid[0])
    lines: dict[int, dict[Sizes, float]] = {}
    for _ in range(ROUNDS):
        before = tuple(tau)
        for k, (group, grid) in enumerate(zip(groups, grids, strict=True)):
            prior = np.log(np.append(0.5, np.full(len(grid) - 1, 0.5 / max(len(grid) - 1, 1))))
            at = [tuple(float(size) if c in group else tau[c] for c in range(chains)) for size in grid]
            quick = np.array([search.best(one) for one in at]) + prior
            lines[k] = {one: p for one, p, b in zip(at, prior, quick, strict=True) if b >= quick.max() - NEGLIGIBLE}
            best = max(lines[k], key=lambda one: search.evidence(one) + lines[k][one])
            tau = list(best)
        if tuple(tau) == before:
            break
    exact = np.ones(chains)
    for k, (group, grid) in enumerate(zip(groups, grids, strict=True)):
        logs = np.array([search.evidence(one) + p for one, p in lines[k].items()])
        first = np.array([one[group[0]] == grid[0] for one in lines[k]])
        exact[group] = np.exp(logs - np.logaddexp.reduce(logs))[first].sum()
    # relative to the prior of the most probable sizes
    star = {one: p - line[tuple(tau)] for line in lines.values() for one, p in line.items() if tuple(tau) in line}
    return tuple(tau), exact, star


def _mixed(found: ModelSet, search: Soft, lines: dict[Sizes, float]) -> ModelSet:
    """The models of all sizes together, weighted by the prior of sizes; `found` are those of the most probable ones."""
    sets = [search.models(tau) for tau in lines]
    models = np.concatenate([one.models for one in sets])
    values = np.concatenate([one.log_posterior + prior for one, prior in zip(sets, lines.values(), strict=True)])
    first, same = distinct(models)
    largest = np.full(len(first), -np.inf)
    np.maximum.at(largest, same, values)
    together = largest + np.log(np.bincount(same, np.exp(values - largest[same])))
    evidence = np.array([search.evidence(tau) + prior for tau, prior in lines.items()])
    weights = np.exp(evidence - np.logaddexp.reduce(evidence))
    left_out = float(weights @ [one.left_out for one in sets])
    return replace(_sorted(found, models[first], together), left_out=left_out)


# Most moves from a model to a neighbour.
MOVES = 5

# Columns whose squared correlation is nearer to 1 are the same up to rounding.
SAME = 1e-9


def _spans_the_same(information: Floats, chosen: Bools, move: Move) -> bool:
    """Whether a model spans the same functions of the motion before and after a move: its likelihood then stays."""
    pair = [k for k in (move.leaves, move.enters) if k is not None]
    rest = [k for k in np.flatnonzero(chosen).tolist() if k not in pair]
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(information), np.finfo(np.float64).tiny))
    A = information * unit[:, None] * unit
    left = A[np.ix_(pair, pair)] - A[np.ix_(pair, rest)] @ solved(A[np.ix_(rest, rest)], A[np.ix_(rest, pair)])
    needless = np.diagonal(left) < SAME
    if len(pair) == 1 or needless.any():
        return bool(needless.all())
    return bool(left[0, 0] * left[1, 1] - left[0, 1] ** 2 < SAME * left[0, 0] * left[1, 1])


def among_neighbours(task: Task, best: Fitted, fewer: bool = False) -> tuple[Task, Fitted]:
    """The best model reached by single moves, each judged by its own fit with its own constants.

    With many samples it is `best` itself. With `fewer` moves only leave terms out, however unlikely by the Gram.
    """
    if task.rows > MOST_TO_MOVE:
        return task, best
    constants = task.layout.has_constants
    exact = not constants and task.flows is None
    tried = {best.model.tobytes(): best.evidence}
    for _ in range(MOVES):
        better = task, best
        soft = soft_of(task, best) if constants else None
        q = best.quadratic if soft is None else soft.quadratic((0.0,) * task.layout.chains)[0]
        chosen = task.narrow(best.model)
        moves = neighbours(task.problem(q), chosen, math.inf if fewer else LIKELIHOOD.neighbour_window)
        moves = [move for move in moves if not fewer or move.enters is None]
        for move in moves[: LIKELIHOOD.neighbours]:
            model = task.wide(move.apply(chosen))
            if model.tobytes() in tried:
                continue
            if exact and move.gain < 0.0 and _spans_the_same(q.information, chosen, move):
                tried[model.tobytes()] = best.evidence + move.gain
                continue
            try:
                fitted = over_all_sizes(task, fit(task, calmed(with_model(task, best, model))), best)
            except np.linalg.LinAlgError:
                continue
            other = moved(task, fitted) if constants else (task, fitted)
            tried[model.tobytes()] = other[1].evidence
            better = max(better, other, key=lambda pair: pair[1].evidence)
        if better[1] is best:
            break
        task, best = better
    best.tried.update(tried)
    task.recent.clear()
    return task, best


def among_all_neighbours(pairs: Sequence[tuple[Task, Fitted]]) -> list[tuple[Task, Fitted]]:
    """Fits of a hidden state from several first paths, likeliest first, moved to better neighbours as long as the best
    one leaves a noticeable discrepancy: along a poor path the terms of the law do not show."""
    found: list[tuple[Task, Fitted]] = []
    for task, fitted in sorted(pairs, key=lambda pair: -pair[1].evidence):
        found.append(among_neighbours(task, finished(task, fitted)))
        if max(found, key=lambda pair: pair[1].evidence)[1].state.levels.kappa.max() < NOTICED:
            break
    return found
