"""Coefficients that differ by record: each term has a candidate difference in every record but the first.

A record's number is an input that is 1 there and 0 elsewhere: ``x*run2`` is what the coefficient of x has in the second
record beside that in the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Bools
from bayeq.dictionary.specification import split_at_commas
from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions import Binary, Expression, Symbol, parse
from bayeq.records import Record

#: What stands for all terms.
ALL = "all"

# Records whose differences are sought, at most.
MOST_RECORDS = 20


def with_differences(
    differs: str | Sequence[str], records: Sequence[Record], terms: Sequence[Expression], allowed: Bools
) -> tuple[list[Record], tuple[str, ...], tuple[Expression, ...], Bools]:
    """Records with the inputs that number them, the names of these, and the candidates with the differences.

    Parameters
    ----------
    differs : str or sequence of str
        Terms whose coefficients may differ, or "all".
    records : sequence of Record
        Of the same system.
    terms, allowed : sequence of Expression, (C, P) bool array
        Candidates, and which of them each equation may have.

    Raises
    ------
    InputError
        One record only, or very many; a term that is no candidate; a channel with the name of a record's number.
    """
    if not 1 < len(records) <= MOST_RECORDS:
        raise InputError(
            f"differs: coefficients differ between records: 2 to {MOST_RECORDS} are needed, not {len(records)}"
        )
    names = [f"run{k}" for k in range(2, len(records) + 1)]
    taken = next((name for name in names for record in records if name in record.channels), None)
    if taken is not None:
        raise InputError(f"differs: {taken} numbers a record and is a channel too: give the channel another name")
    texts = split_at_commas(differs) if isinstance(differs, str) else [str(one) for one in differs]
    known = {term.text: j for j, term in enumerate(terms)}
    chosen = list(range(len(terms)))
    if texts != [ALL]:
        chosen = []
        for text in texts:
            name = parse(text).text
            if name not in known:
                raise UnknownNameError("candidate term", name, known, where="differs")
            chosen.append(known[name])
    found = list(terms)
    found += [Expression(Binary("*", terms[j].tree, Symbol(name))) for name in names for j in chosen]
    numbered = [
        record.with_channels({name: np.full(record.n, float(name == f"run{k}")) for name in names})
        for k, record in enumerate(records, 1)
    ]
    return numbered, tuple(names), tuple(found), np.hstack([allowed, *[allowed[:, chosen]] * len(names)])
