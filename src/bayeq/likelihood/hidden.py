"""First values of the constants of stated laws, by which hidden states begin."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import NODES, constants_of, middle, to_plain, to_scale
from bayeq.errors import InputError
from bayeq.expressions import Evaluator, Expression, Symbol, Unknown, number
from bayeq.expressions.nodes import replaced
from bayeq.gram import Gram
from bayeq.likelihood.fit import State
from bayeq.likelihood.start import likeliest_by_rows
from bayeq.states import Chain, Motion, Roles, with_columns, with_hidden

# Values of all constants that are tried first, about; rows of the regression that each is judged by, at most; halvings
# of the steps from the best of them.
GRID, ROWS, HALVINGS = 400, 4000, 6

# Shares of the coordinate's coefficient that a hidden state has at first beside what the other terms leave.
SHARES = (0.0, 0.3, 0.6, 0.9)

# A relaxation is sought from this share of the sampling interval to this many times the record.
FASTEST, SLOWEST = 0.5, 2.0


def with_first_laws(
    motion: Motion, roles: Roles, terms: Sequence[Expression], allowed: Bools
) -> tuple[Motion, tuple[Expression, ...]]:
    """The motion with hidden states, and the terms with the constants of their laws.

    Of values on a grid those are taken whose hidden states let the candidates of the other equations, together, explain
    most of the smoothed rows. The motion is without the hidden states, the roles are with them, the P terms with their
    laws; `allowed`, (C, P), says which of these each equation may have. An InputError refuses a constant whose range
    has to be written, and laws that are finite for no values of their constants.
    """
    constants = _ranges(roles, motion)
    nodes = min(NODES, max(3, int(GRID ** (1.0 / max(len(constants), 1)))))
    places = [np.linspace(to_scale(one, one.low), to_scale(one, one.high), nodes) for one in constants]

    def tried(at: Sequence[float]) -> tuple[float, Motion | None, dict[str, Unknown]]:
        values = {one.name: replace(one, value=to_plain(one, x)) for one, x in zip(constants, at, strict=True)}
        try:
            found = with_hidden(motion, at_values(roles, values))
        except InputError:
            return -math.inf, None, values
        return _explained(found, [term.with_unknowns(values) for term in terms], allowed), found, values

    best = max(map(tried, itertools.product(*places)), key=lambda one: one[0])
    step = np.array([place[1] - place[0] for place in places])
    low, high = np.array([[place[0], place[-1]] for place in places]).reshape(-1, 2).T
    for _ in range(HALVINGS if constants else 0):
        step = 0.5 * step
        for move in np.vstack([np.diag(step), -np.diag(step)]):
            here = np.array([to_scale(one, best[2][one.name].value) for one in constants])
            best = max(best, tried(np.clip(here + move, low, high).tolist()), key=lambda one: one[0])
    if best[1] is None:
        law = roles.hidden[0].law
        raise InputError(
            f"law {law}: not finite along the record for any value of its constants; write abs() where a root or a"
            " power needs it, or other ranges"
        )
    return best[1], tuple(term.with_unknowns(best[2]) for term in terms)


def seen_in(chain: Chain, roles: Roles, terms: Sequence[Expression], allowed: Bools) -> tuple[int, int]:
    """The first measured equation that has a hidden state by itself as a candidate, and that: they set its scale.

    An InputError says that there is none.
    """
    name = chain.names[0]
    for j, term in enumerate(terms):
        seen = np.flatnonzero(allowed[: len(roles.seen.chains), j])
        if term.tree == Symbol(name) and len(seen):
            return int(seen[0]), j
    raise InputError(f"chain {chain}: no equation has {name} by itself as a term, which sets its scale: add it")


def with_first_paths(
    motion: Motion, roles: Roles, terms: Sequence[Expression], allowed: Bools, shares: Sequence[float]
) -> tuple[Motion, ...]:
    """The motion with first paths of a hidden state whose law is to be found, one for each start of a search.

    A path is what a regression of the equation that the state is seen in leaves, and a share of its spring, if it has
    one: the state may be one, too. Rates are those by the likeliest candidates for its changes over the time in which
    it forgets, for rates of what is left are mostly noise.
    """
    (chain,) = roles.hidden
    (z, dz), (c, _) = chain.names, seen_in(chain, roles, terms, allowed)
    seen, gains = roles.chains[c], (*motion.unit_gains[: len(roles.chains) - 1], np.ones(2))
    others = [term for term, mine in zip(terms, allowed[c], strict=True) if mine and z not in term.names]
    own = [term for term, mine in zip(terms, allowed[-1], strict=True) if mine]
    with np.errstate(all="ignore"):
        columns = [evaluate_terms(others, rows.columns) for rows in motion.records]
    gram = Gram.from_data(
        np.concatenate([D[: rows.n] for D, rows in zip(columns, motion.train, strict=False)]),
        np.concatenate([rows.columns[seen.target] for rows in motion.train]),
        tuple(term.text for term in others),
    )
    unit = np.sqrt(np.maximum(gram.diagonal, 1e-300))
    coef = np.linalg.lstsq(gram.DtD / np.outer(unit, unit), gram.Dty / unit, rcond=1e-10)[0] / unit
    places = roles.inputs if seen.static else seen.names[:1]
    springs = [i for i, term in enumerate(others) if isinstance(term.tree, Symbol) and term.text in places]
    spring = max(springs, key=lambda i: abs(coef[i]) * unit[i], default=None)
    found = []
    for share in shares if spring is not None else [one for one in shares if one == 0.0]:
        paths = []
        for rows, D in zip(motion.records, columns, strict=True):
            left = rows.columns[seen.target] - gram.target_mean - (D - gram.mean) @ coef
            paths.append({z: left if spring is None else left + share * coef[spring] * D[:, spring]})
        records = [
            with_columns(rows, {**path, dz: rate})
            for rows, path, rate in zip(motion.records, paths, _rates(motion, own, paths), strict=True)
        ]
        found.append(replace(motion, roles=roles, records=tuple(records), unit_gains=gains))
    return tuple(found)


def _rates(motion: Motion, terms: Sequence[Expression], paths: Sequence[Mapping[str, Floats]]) -> list[Floats]:
    """The rate of a hidden state by those of its candidates that its changes ask for, from its path in each record."""
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
    _, coef = likeliest_by_rows(gram, np.ones(len(terms), dtype=np.bool_))
    return [D @ coef for D in columns]


def _forgotten(path: Floats) -> int:
    """After how many samples a path's correlation is half of that of the next one, which noise has no part in."""
    spectrum = np.abs(np.fft.rfft(path - path.mean(), 2 * len(path))) ** 2
    correlation = np.fft.irfft(spectrum)[1 : max(2, len(path) // 2)]
    return 1 + int(np.argmax(correlation < 0.5 * correlation[0]))


def with_found_laws(motion: Motion, terms: Sequence[Expression]) -> Motion:
    """The motion with its hidden states integrated at the values that constants have in some terms."""
    return with_hidden(motion, at_values(motion.roles, constants_of(terms))) if motion.roles.hidden else motion


def with_laws_of(motion: Motion, terms: Sequence[Expression], state: State) -> Motion:
    """The motion with its hidden states integrated as a fit has it, by the terms that were found or as it was stated.

    A law that was found and that blows up from rest is not integrated: where it starts is what the record tells.
    """
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
    """The log likelihood of the measured equations' smoothed rows, all candidates in, up to a constant."""
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
    """The constants of the laws, with ranges."""
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
    """Values for which a law relaxes, at the slowest over the record and at the fastest between two samples.

    None where that does not follow: the law is not linear in its state, or its rate is no power of the constant.
    """
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
