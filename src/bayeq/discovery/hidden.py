"""Stated laws of hidden states among the candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Bools
from bayeq.dictionary.build import MOST_UNKNOWN
from bayeq.dictionary.ranges import with_ranges
from bayeq.errors import InputError
from bayeq.expressions import Expression
from bayeq.states import Roles


def with_law_terms(
    terms: Sequence[Expression], allowed: Bools, roles: Roles
) -> tuple[tuple[Expression, ...], Bools, Roles]:
    """Candidates of all equations with the laws of hidden states among them, and the roles with the same constants.

    Parameters
    ----------
    terms : sequence of Expression
        Of the equations of measured states.
    allowed : (C, P) bool array
        Which of them each may have.
    roles : Roles
        With hidden states.

    Raises
    ------
    InputError
        No term uses a hidden state; a law with too many constants, or two ranges of one.
    """
    laws = [chain.law for chain in roles.hidden if chain.law is not None]
    if not laws:
        return tuple(terms), allowed, roles
    used = frozenset[str]().union(*(one.names for one in (*terms, *laws)))
    for chain in roles.hidden:
        if chain.names[0] not in used:
            raise InputError(f"law: no term uses {chain.names[0]}: name it in the dictionary")
    for law in laws:
        if len(law.unknowns) > MOST_UNKNOWN:
            raise InputError(f"law {law}: at most {MOST_UNKNOWN} constants; write numbers, or two laws")
    whole = tuple(dict.fromkeys(with_ranges([*terms, *laws])))
    out = np.zeros((len(roles.chains), len(whole)), dtype=np.bool_)
    out[: len(allowed), : len(terms)] = allowed
    written = with_ranges([*terms, *laws])[len(terms) :]
    chains = list(roles.seen.chains)
    for c, (chain, law) in enumerate(zip(roles.hidden, written, strict=True), len(chains)):
        out[c, whole.index(law)] = True
        chains.append(chain.with_law(law))
    return whole, out, roles.with_chains(chains)


def without_hidden(terms: Sequence[Expression], allowed: Bools, roles: Roles) -> tuple[tuple[Expression, ...], Bools]:
    """The candidates of the equations of measured states that no hidden state is in."""
    hidden, count = {name for chain in roles.hidden for name in chain.names}, len(roles.seen.chains)
    kept = [j for j, term in enumerate(terms) if not hidden & term.names and allowed[:count, j].any()]
    return tuple(terms[j] for j in kept), allowed[:count, kept]
