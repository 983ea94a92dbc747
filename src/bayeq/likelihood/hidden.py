"""Hidden states: first paths and constants, the equations that contain them, and laws that were found."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import evaluate_terms, slopes_of
from bayeq.dictionary.ranges import NODES, constants_of, middle, to_plain, to_scale
from bayeq.errors import InputError, some_of
from bayeq.expressions import Binary, Evaluator, Expression, Symbol, Unknown, number
from bayeq.expressions.implicit import product, total
from bayeq.expressions.nodes import replaced
from bayeq.inference.collapsed.slab import likeliest_by_rows
from bayeq.inference.gram import Gram
from bayeq.likelihood.fit import State
from bayeq.numerics.distributions import correlation
from bayeq.states import Chain, Motion, Roles
from bayeq.states.motion import with_columns, with_hidden

# About how many values of all constants are tried first; most rows of the regression that each is scored on.
GRID, ROWS = 400, 4000

# Searches start from the STARTS highest peaks of the grid, at most, that reach the share WORTH of the way from the
# lowest score to the highest. A peak is refined between its adjacent nodes by TRIES values; the highest counts as at an
# end of the grid beyond the share AT_END of the way there from the middle.
STARTS, WORTH, TRIES, AT_END = 3, 0.5, 100, 0.99

# A first path of a hidden state is the residual of the other terms plus one of these shares of the terms of coordinate
# and velocity: without the state these explain part of what it does. The force of dry friction, or of a damper in
# series with a spring, goes mostly with the velocity.
SHARES = ((0.0, 0.0), (0.3, 0.0), (0.6, 0.0), (0.9, 0.0), (0.3, 0.9), (0.6, 0.9))

# Grid for a hidden coordinate: springs within the factor STIFFNESS of the ratio of acceleration to displacement of a
# measured one, at FEWEST or more nodes; dampers at DAMPING times the root of that ratio, at DAMPERS nodes.
STIFFNESS, DAMPING, DAMPERS, FEWEST = 30.0, (0.01, 1.0), 4, 6

# Relaxation times are sought from this share of the sampling interval to this many times the length of the record.
FASTEST, SLOWEST = 0.5, 2.0


def with_first_laws(motion: Motion, roles: Roles, terms: Sequence[Expression], allowed: Bools) -> list[Motion]:
    """The motion with hidden states, integrated with first values of constants: one for each start of a search.

    The motion is without the hidden states, the roles are with them; `allowed`, (C, P), says which terms each equation
    may have. An InputError names a constant whose range has to be given, or laws that are finite for no values.
    """
    constants = _ranges(roles, motion)
    nodes = min(NODES, max(3, int(GRID ** (1.0 / max(len(constants), 1)))))
    found = _at_peaks(motion, roles, terms, allowed, constants, [nodes] * len(constants))
    if not found:
        law = roles.hidden[0].law
        raise InputError(
            f"law {law}: not finite along the record for any value of its constants; write abs() where a root or a"
            " power needs it, or other ranges"
        )
    return found


def law_constants(roles: Roles) -> dict[str, Unknown]:
    """The constants of the laws of hidden states, by name."""
    return constants_of([chain.law for chain in roles.hidden if chain.law is not None])


def with_values_of(terms: Sequence[Expression], motion: Motion) -> tuple[Expression, ...]:
    """The terms with the values that constants have in the laws of hidden states."""
    values = law_constants(motion.roles)
    return tuple(term.with_unknowns(values) for term in terms)


def _at_peaks(
    motion: Motion,
    roles: Roles,
    terms: Sequence[Expression],
    allowed: Bools,
    constants: Sequence[Unknown],
    nodes: Sequence[int],
    inner: Sequence[str] = (),
) -> list[Motion]:
    """The motion with hidden states at the likeliest values of `constants`, from a grid refined about its peaks; peaks
    at an end of the constants `inner` are left out. Empty if the laws are finite for no values."""

    def values(at: Sequence[float]) -> dict[str, Unknown]:
        return {one.name: replace(one, value=to_plain(one, x)) for one, x in zip(constants, at, strict=True)}

    def score(at: Sequence[float]) -> float:
        try:
            found = with_hidden(motion, at_values(roles, values(at)))
        except InputError:  # the law blows up
            return -math.inf
        return _explained(found, [term.with_unknowns(values(at)) for term in terms], allowed)

    if not constants:
        return [with_hidden(motion, roles)] if math.isfinite(score(())) else []
    ends = [(to_scale(one, one.low), to_scale(one, one.high)) for one in constants]
    places = [np.linspace(low, high, count) for (low, high), count in zip(ends, nodes, strict=True)]
    peaks = _peaks(score, places, np.array([one.name in inner for one in constants]))
    return [with_hidden(motion, at_values(roles, values(at))) for at in peaks]


def _peaks(
    score: Callable[[Sequence[float]], float], places: Sequence[Floats], inner: Bools
) -> list[tuple[float, ...]]:
    """Maxima of a score: peaks of a grid, refined between its nodes; none at an end of axes `inner`, (n,), counts."""
    from scipy.ndimage import maximum_filter
    from scipy.optimize import minimize

    def lost(at: Floats) -> float:
        return -score(at.tolist())

    scores = np.reshape([score(at) for at in itertools.product(*places)], [len(place) for place in places])
    finite = scores[np.isfinite(scores)]
    if not len(finite):
        return []
    least, most = finite.min(), finite.max()
    peaks = (scores == maximum_filter(scores, 3)) & (scores >= least + WORTH * (most - least))
    for axis in np.flatnonzero(inner):
        np.moveaxis(peaks, axis, 0)[[0, -1]] = False
    if not peaks.any():
        return [tuple(float(place.mean()) for place in places)]
    found: list[tuple[float, ...]] = []
    for at in sorted(np.argwhere(peaks).tolist(), key=lambda at: -scores[tuple(at)])[:STARTS]:
        step = np.array([place[1] - place[0] for place in places])
        start: Floats = np.array([place[k] for place, k in zip(places, at, strict=True)])
        ends = [(max(x - d, place[0]), min(x + d, place[-1])) for x, d, place in zip(start, step, places, strict=True)]
        best = minimize(lost, start, method="Nelder-Mead", bounds=ends, options={"maxfev": TRIES, "fatol": 0.1})
        found.append(tuple(best.x.tolist()))
    found.sort(key=lambda x: -score(x))
    first, last = (np.array([place[k] for place in places]) for k in (0, -1))
    at_end = np.abs((2.0 * np.array(found[:1]) - first - last) / (last - first)).ravel() > AT_END
    if at_end.any():  # the likelihood may have a peak on the way there
        half = np.unravel_index(np.nanargmin(np.abs(scores - 0.5 * (least + most))), scores.shape)
        found.append(tuple(float(place[k]) for place, k in zip(places, half, strict=True)))
        found.append(tuple(np.where(at_end, 0.5 * (first + last), found[0]).tolist()))
    return found[:STARTS]


class Seen(NamedTuple):
    """A term of a measured equation that a hidden state is in, as a factor or in a difference."""

    equation: int
    term: int
    scaled: bool  # whether the state is a factor: the coefficient is its scale


def seen_in(chain: Chain, roles: Roles, terms: Sequence[Expression], allowed: Bools) -> list[Seen]:
    """The term with a hidden state as a factor, preferably the state alone, which sets its scale; else all differences.

    An InputError says that there is neither, or that a state of second order occurs other than in differences.
    """
    z, found = chain.names[0], []
    for j, c in np.argwhere(allowed[: len(roles.seen.chains)].T).tolist():
        if z in terms[j].names and not terms[j].names & set(chain.names[1:]):
            without, once, twice = _at(terms[j], {z: np.arange(3.0)})
            if math.isclose(twice - once, once - without, rel_tol=1e-9):
                found.append(Seen(c, j, without == 0.0))
    apart = [one for one in found if _in_differences(terms[one.term], roles)]
    if chain.order == 1:
        alone = [one for one in found if terms[one.term].tree == Symbol(z)]
        scaled = [*alone, *(one for one in found if one.scaled)][:1]
        if not scaled and not apart:
            raise InputError(f"chain {chain}: no equation has {z} by itself as a term, which sets its scale: add it")
        return scaled or apart
    others = [term.text for term in terms if term.names & set(chain.names) and not _in_differences(term, roles)]
    if others or not apart:
        why = f"{some_of(others)} would do in any unit of it" if others else "no term uses it"
        raise InputError(f"chain {chain}: {why}: have it in differences alone, as in {roles.chains[0].names[0]}-{z}")
    return apart


def _at(term: Expression, columns: Mapping[str, Floats]) -> list[float]:
    """Three values of a term at the given `columns`, with arbitrary constants for all other names."""
    rng = np.random.default_rng(0)
    given = {name: np.full(3, rng.uniform(0.5, 1.5)) for name in sorted(term.names)}
    return np.broadcast_to(Evaluator({**given, **columns})(term), 3).tolist()


def _in_differences(term: Expression, roles: Roles) -> bool:
    """Whether a term is invariant to a common shift of all coordinates and to one of all velocities."""
    rng, columns = np.random.default_rng(1), dict[str, Floats]()
    for move in (np.array([0.0, 0.3, 0.7]), np.array([0.0, 0.5, 0.1])):
        at = 0 if not columns else 1
        columns |= {chain.names[at]: rng.uniform(1.5, 2.5) + move for chain in roles.chains if chain.order > at}
    return bool(np.ptp(np.array(_at(term, columns))) < 1e-9)


def with_first_paths(motion: Motion, roles: Roles, terms: Sequence[Expression], allowed: Bools) -> list[Motion]:
    """The motion with first paths of a hidden state whose law is to be found, one for each start of a search.

    A path is the residual of a regression, without the state, of the equation in which the state is a factor, plus
    shares of the terms of spring and damper if there are any. A state that is in differences alone starts as a
    coordinate on springs and a damper.
    """
    (chain,) = roles.hidden
    seen = seen_in(chain, roles, terms, allowed)
    if not seen[0].scaled:
        return _on_springs(motion, roles, terms, allowed)
    gains = (*motion.unit_gains[: len(roles.chains) - 1], np.ones(chain.order + 1))
    bare = replace(motion, roles=roles, unit_gains=gains)
    left, parts = _rest(bare, terms, allowed, seen[0].equation)
    used = list(dict.fromkeys(shares[: len(parts)] for shares in SHARES))
    rests = [
        [one + sum(share * part[k] for share, part in zip(shares, parts, strict=True)) for k, one in enumerate(left)]
        for shares in used
    ]
    return [_as_factor(bare, terms, allowed, seen[0], rest) for rest in rests]


def _on_springs(motion: Motion, roles: Roles, terms: Sequence[Expression], allowed: Bools) -> list[Motion]:
    """The motion with paths of a hidden coordinate, on springs and dampers that let other equations explain most."""
    chain, beside, rows = roles.chains[-1], max(roles.seen.chains, key=lambda one: one.order), motion.train
    sizes = [np.concatenate([one.columns[name] for one in rows]).std() for name in (beside.target, beside.names[0])]
    pace = float(sizes[0] / sizes[1]) ** (1.0 / beside.order)
    damper = Unknown("damper", *(pace * factor for factor in DAMPING))
    constants, parts = [], []
    for term in (term for term, mine in zip(terms, allowed[-1], strict=True) if mine):
        inside = [name for name in chain.states if name in term.names]
        slope = slopes_of(term, inside)
        if len(inside) != 1 or slope is None:
            continue
        constant = damper
        if inside[0] == chain.names[0]:
            spring = pace**chain.order
            constant = Unknown(f"spring {term.text}", spring / STIFFNESS, spring * STIFFNESS)
        constants += [] if constant in constants else [constant]
        parts.append(product(number(-math.copysign(1.0, slope[0])), Binary("*", constant, term.tree)))
    if not parts:
        raise InputError(
            f"chain {chain}: give {chain.target} a difference by itself, {beside.names[0]}-{chain.names[0]}"
        )
    stated = roles.with_chains([*roles.seen.chains, chain.with_law(Expression(total(parts)))])
    springs = [one.name for one in constants if one is not damper]
    nodes = max(FEWEST, int((GRID / DAMPERS) ** (1.0 / max(len(springs), 1))))
    counts = [DAMPERS if one is damper else nodes for one in constants]
    # at the ends of the springs' ranges a hidden mass is negligible, and its force may be any acceleration
    found = _at_peaks(motion, stated, terms, allowed, constants, counts, inner=springs)
    return [replace(one, roles=roles) for one in found]


def _rest(
    motion: Motion, terms: Sequence[Expression], allowed: Bools, c: int
) -> tuple[list[Floats], list[list[Floats]]]:
    """Residual of equation c in each record, from a regression of its smoothed rows on terms without the hidden state;
    also the fitted terms of coordinate and velocity, or of the two inputs of a static law that explain most."""
    roles = motion.roles
    seen, hidden = roles.chains[c], set(roles.chains[-1].names)
    others = [term for term, mine in zip(terms, allowed[c], strict=True) if mine and not term.names & hidden]
    with np.errstate(all="ignore"):
        columns = [evaluate_terms(others, rows.columns) for rows in motion.records]
    gram = Gram.from_data(
        np.concatenate([D[: rows.n] for D, rows in zip(columns, motion.train, strict=False)]),
        np.concatenate([rows.columns[seen.target] for rows in motion.train]),
        tuple(term.text for term in others),
    )
    unit = np.sqrt(np.maximum(gram.diagonal, 1e-300))
    coef = np.linalg.lstsq(gram.DtD / np.outer(unit, unit), gram.Dty / unit, rcond=1e-10)[0] / unit
    left = [
        rows.columns[seen.target] - gram.target_mean - (D - gram.mean) @ coef
        for rows, D in zip(motion.records, columns, strict=True)
    ]
    index = {term.text: i for i, term in enumerate(others) if isinstance(term.tree, Symbol)}
    places = [name for name in (roles.inputs if seen.static else seen.names[:2]) if name in index]
    if seen.static:
        places.sort(key=lambda name: -abs(coef[index[name]]) * unit[index[name]])
    return left, [[coef[index[name]] * D[:, index[name]] for D in columns] for name in places[:2]]


def _as_factor(
    motion: Motion, terms: Sequence[Expression], allowed: Bools, seen: Seen, rest: Sequence[Floats]
) -> Motion:
    """The motion with the path of a state that is a factor of a term, from the residual `rest` of the other terms."""
    from scipy.ndimage import gaussian_filter1d

    (chain,), paths = motion.roles.hidden, []
    own = [term for term, mine in zip(terms, allowed[-1], strict=True) if mine]
    for rows, left in zip(motion.records, rest, strict=True):
        factor = evaluate_terms([terms[seen.term]], {**rows.columns, chain.names[0]: np.ones(rows.n)})[:, 0]
        if np.ptp(factor) > 0.0:  # it may be zero at times
            width = max(1, _forgotten(left) // 4)
            weight = gaussian_filter1d(factor**2, width)
            left = gaussian_filter1d(factor * left, width) / np.maximum(weight, 1e-9 * weight.max())
        else:
            left = left / factor
        paths.append({chain.names[0]: left})
    rates = _rates(motion, own, paths)
    columns = [{**path, chain.target: rate} for path, rate in zip(paths, rates, strict=True)]
    return replace(motion, records=tuple(map(with_columns, motion.records, columns)))


def _rates(motion: Motion, terms: Sequence[Expression], paths: Sequence[Mapping[str, Floats]]) -> list[Floats]:
    """Rate of a hidden state in each record: regression of its path's changes on integrals of selected candidates."""
    from scipy.integrate import cumulative_trapezoid

    columns = [
        evaluate_terms(terms, {**rows.columns, **path}) for rows, path in zip(motion.records, paths, strict=True)
    ]
    changes, sums = [], []
    for rows, path, D in zip(motion.train, paths, columns, strict=False):
        assert rows.time is not None
        (values,) = path.values()
        ahead = _forgotten(values[: rows.n])
        first = np.arange(0, rows.n - ahead, max(1, ahead // 2))
        whole = cumulative_trapezoid(D[: rows.n], rows.time, axis=0, initial=0)
        changes.append(values[first + ahead] - values[first])
        sums.append(whole[first + ahead] - whole[first])
    gram = Gram.from_data(np.concatenate(sums), np.concatenate(changes), tuple(term.text for term in terms))
    _, coef = likeliest_by_rows(gram)
    return [D @ coef for D in columns]


def _forgotten(path: Floats) -> int:
    """Lag in samples at which a path's autocorrelation is half of that at lag 1, to which white noise adds nothing."""
    centred = [path - path.mean()]
    found = correlation(centred, centred)[1 : max(2, len(path) // 2)]
    return 1 + int(np.argmax(found < 0.5 * found[0]))


def with_found_laws(motion: Motion, terms: Sequence[Expression]) -> Motion:
    """The motion with its hidden states integrated at the values that constants have in `terms`."""
    return with_hidden(motion, at_values(motion.roles, constants_of(terms))) if motion.roles.hidden else motion


def with_laws_of(motion: Motion, terms: Sequence[Expression], state: State) -> Motion:
    """The motion with its hidden states integrated by the laws of a fit, unless a found law blows up from rest."""
    chains = list(motion.roles.chains)
    for c, chain in enumerate(chains):
        if chain.hidden and not chain.stated:
            pairs = [(x, terms[j]) for k, j, x in zip(*state.chosen, state.theta.tolist(), strict=True) if k == c]
            chains[c] = chain.with_found(pairs)
    motion = replace(motion, roles=motion.roles.with_chains(chains))
    try:
        return with_found_laws(motion, terms)
    except InputError:
        if all(chain.stated for chain in chains if chain.hidden):
            raise
        return motion


def at_values(roles: Roles, values: Mapping[str, Unknown]) -> Roles:
    """The roles with values of the constants of their laws."""
    return roles.with_chains(
        [one if one.law is None else one.with_law(one.law.with_unknowns(values)) for one in roles.chains]
    )


def _explained(motion: Motion, terms: Sequence[Expression], allowed: Bools) -> float:
    """The log likelihood of the measured equations' smoothed rows with all candidates, up to a constant."""
    known = [j for j, term in enumerate(terms) if not any(math.isnan(one.value) for one in term.unknowns.values())]
    step = max(1, sum(rows.n for rows in motion.train) // ROWS)
    pieces = [rows.part(slice(None, None, step)) for rows in motion.train]
    with np.errstate(all="ignore"):
        D = np.concatenate([evaluate_terms([terms[j] for j in known], rows.columns) for rows in pieces])
    total = 0.0
    for c, chain in enumerate(motion.roles.chains):
        if chain.hidden:
            continue
        y = np.concatenate([rows.observed[chain.target] for rows in pieces])
        own = D[:, allowed[c, known] & np.isfinite(D).all(axis=0)]
        own = np.column_stack([np.ones(len(y)), own / np.maximum(np.abs(own).max(axis=0), 1e-300)])
        left = y - own @ np.linalg.lstsq(own, y, rcond=1e-10)[0]
        total -= 0.5 * len(y) * math.log(max(float(np.mean(left**2)), 1e-300))
    return total


def _ranges(roles: Roles, motion: Motion) -> list[Unknown]:
    out: dict[str, Unknown] = {}
    for chain in roles.hidden:
        assert chain.law is not None
        missing = [one for one in chain.law.unknowns.values() if math.isnan(one.low)]
        for one in missing:
            ends = _relaxations(chain.names[0], chain.law, one, motion) if len(missing) == 1 else None
            if ends is None:
                raise InputError(
                    f"law {chain.law}: the record does not tell where {{{one.name}}} may be: give its range, as in"
                    f" {{{one.name}: 0.01..3}}"
                )
            out[one.name] = replace(one, low=ends[0], high=ends[1])
        out |= {name: one for name, one in chain.law.unknowns.items() if not math.isnan(one.low)}
    return list(out.values())


def _relaxations(name: str, law: Expression, constant: Unknown, motion: Motion) -> tuple[float, float] | None:
    """Range of a constant, from the slowest relaxation (SLOWEST) to the fastest (FASTEST); None if the law is not
    linear in its state and decaying, or if its rate is not a power of the constant."""
    others = {other.name: replace(other, value=middle(other)) for other in law.unknowns.values() if other != constant}
    columns: dict[str, Floats] = {key: np.full(1, values.mean()) for key, values in motion.train[0].columns.items()}

    def rate(value: float) -> float:
        tree = law.with_unknowns({**others, constant.name: replace(constant, value=value)}).tree
        at = [Expression(replaced(tree, {Symbol(name): number(x)})) for x in (0.0, 1.0, 2.0)]
        zero, one, two = (float(np.ravel(Evaluator(columns)(each))[0]) for each in at)
        return one - zero if math.isclose(two - one, one - zero, rel_tol=1e-6) else math.nan

    with np.errstate(all="ignore"):
        rates = [rate(value) for value in (1.0, 2.0, 4.0)]
    if not all(math.isfinite(one) and one < 0.0 for one in rates):
        return None
    power = math.log2(rates[1] / rates[0])
    if power == 0.0 or not math.isclose(power, math.log2(rates[2] / rates[1]), abs_tol=1e-6):
        return None
    time = motion.train[0].time
    assert time is not None
    slow, fast = 1.0 / (SLOWEST * float(time[-1] - time[0])), 1.0 / (FASTEST * float(np.median(np.diff(time))))
    ends = sorted((target / -rates[0]) ** (1.0 / power) for target in (slow, fast))
    return ends[0], ends[1]
