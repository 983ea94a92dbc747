"""Hidden states, compared with equations without them, and coefficients that differ between records."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Bools
from bayeq.dictionary import Specification, Variables, build_dictionaries, of_equations
from bayeq.dictionary.build import MOST_UNKNOWN
from bayeq.dictionary.ranges import with_ranges
from bayeq.dictionary.specification import split_at
from bayeq.equation.answer import HiddenState
from bayeq.errors import ChainError, InputError, UnknownNameError
from bayeq.expressions import Binary, Expression, Symbol, parse
from bayeq.likelihood.hidden import seen_in
from bayeq.likelihood.record_fit import RecordFit
from bayeq.records import Record
from bayeq.regression.constraints import Constraints
from bayeq.regression.design import Design, build_design
from bayeq.states import Roles
from bayeq.states.prepare import numbered


def dictionaries_of(
    dictionary: Specification, roles: Roles, variables: Variables
) -> tuple[tuple[Expression, ...], Bools]:
    """Candidates of all equations without a stated law; ChainError for a hidden state without either."""
    targets = roles.sought
    found = roles.hidden[: len(targets) - len(roles.seen.chains)]
    if found and of_equations(dictionary, targets) is None:
        raise ChainError(
            f'chain {found[0]} has no measured channel: state its rate, --law "{targets[-1]} = ...", or give each'
            f' equation a dictionary, "{targets[0]}: ...; {targets[-1]}: ..."'
        )
    return build_dictionaries(dictionary, targets, variables)


def check_scales(roles: Roles, terms: Sequence[Expression], allowed: Bools, constraints: Sequence[Constraints]) -> None:
    """Raise InputError for a hidden state whose scale no term sets, or a constraint but ``~`` on its coefficient 1."""
    for chain in roles.hidden:
        if not chain.stated:
            c, j, scaled = seen_in(chain, roles, terms, allowed)[0]
            if scaled and replace(constraints[c], stated=()).concerned[j]:
                raise InputError(
                    f"constraints: {terms[j]} has the coefficient 1: write '{terms[j]} ~ -1 +- 1e-6' for another scale"
                )


def with_law_terms(
    terms: Sequence[Expression], allowed: Bools, roles: Roles
) -> tuple[tuple[Expression, ...], Bools, Roles]:
    """Candidates, `allowed` (C, P) and roles with the laws of hidden states as further terms.

    InputError for a hidden state that no term uses, a law of constants alone or of too many, or two ranges of one.
    """
    laws = [chain.law for chain in roles.hidden if chain.law is not None]
    if not laws:
        return tuple(terms), allowed, roles
    used = frozenset[str]().union(*(one.names for one in terms))
    for _ in laws:  # a state may be used only by the law of another one
        others = (chain.law.names for chain in roles.hidden if chain.law is not None and chain.names[0] in used)
        used = used.union(*others)
    for chain in roles.hidden:
        if chain.names[0] not in used:
            raise InputError(f"law: no term uses {chain.names[0]}: name it in the dictionary")
    for law in laws:
        if not law.names:
            raise InputError(
                f"law {law}: the rate of a hidden state depends on states or inputs: name one, as in 'u - f'"
            )
        if len(law.unknowns) > MOST_UNKNOWN:
            raise InputError(f"law {law}: at most {MOST_UNKNOWN} constants; write numbers, or two laws")
    written = with_ranges([*terms, *laws])
    whole = tuple(dict.fromkeys(written))
    out = np.zeros((len(roles.chains), len(whole)), dtype=np.bool_)
    out[: len(allowed), : len(terms)] = allowed
    chains = list(roles.seen.chains)
    for c, (chain, law) in enumerate(zip(roles.hidden, written[len(terms) :], strict=True), len(chains)):
        out[c, whole.index(law)] = True
        chains.append(chain.with_law(law))
    return whole, out, roles.with_chains(chains)


def without_hidden(terms: Sequence[Expression], allowed: Bools, roles: Roles) -> tuple[tuple[Expression, ...], Bools]:
    """Candidates of the equations of measured states, without those that contain a hidden state."""
    hidden, count = {name for chain in roles.hidden for name in chain.names}, len(roles.seen.chains)
    kept = [j for j, term in enumerate(terms) if not hidden & term.names and allowed[:count, j].any()]
    return tuple(terms[j] for j in kept), allowed[:count, kept]


def hidden_states(
    design: Design, record: RecordFit | None, likelihood: Callable[[Design], RecordFit | None]
) -> tuple[HiddenState, ...]:
    """The hidden states of a design, with log odds of the equations without them, from the `likelihood` of both."""
    motion = design.motion
    if not motion.roles.hidden:
        return ()
    odds = math.inf
    if record is not None:
        terms, allowed = without_hidden(design.terms, design.allowed, motion.roles)
        seen = replace(motion, roles=motion.roles.seen, unit_gains=motion.unit_gains[: len(allowed)])
        without = likelihood(build_design(terms, seen, allowed=allowed))
        odds = -math.inf if without is None else without.of_motion - record.of_motion
    return tuple(HiddenState(chain.names[0], odds, chain.stated) for chain in motion.roles.hidden)


# Most records between which coefficients may differ.
MOST_RECORDS = 20


def with_differences(
    differs: str | Sequence[str], records: Sequence[Record], terms: Sequence[Expression], allowed: Bools
) -> tuple[list[Record], tuple[str, ...], tuple[Expression, ...], Bools]:
    """Records with indicator inputs (run2, ...), their names, and candidates with a product term per difference.

    InputError for one record or very many, a term that is no candidate, or a channel with the name of an indicator.
    """
    if not 1 < len(records) <= MOST_RECORDS:
        raise InputError(
            f"differs: coefficients differ between records: 2 to {MOST_RECORDS} are needed, not {len(records)}; bayeq"
            " discover FILES --differs takes each file as one"
        )
    names = [f"run{k}" for k in range(2, len(records) + 1)]
    taken = next((name for name in names for record in records if name in record.channels), None)
    if taken is not None:
        raise InputError(f"differs: {taken} numbers a record and is a channel too: give the channel another name")
    texts = split_at(differs) if isinstance(differs, str) else [str(one) for one in differs]
    known = {term.text: j for j, term in enumerate(terms)}
    chosen = list(range(len(terms)))
    if texts != ["all"]:
        chosen = []
        for text in texts:
            name = parse(text).text
            if name not in known:
                raise UnknownNameError("candidate term", name, known, where="differs")
            chosen.append(known[name])
    found = list(terms)
    found += [Expression(Binary("*", terms[j].tree, Symbol(name))) for name in names for j in chosen]
    wide = np.hstack([allowed, *[allowed[:, chosen]] * len(names)])
    return numbered(records, names), tuple(names), tuple(found), wide
