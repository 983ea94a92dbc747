"""Long names of channels, shortened in tables so that every row still says which term it is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

__all__ = ["short_names", "with_names"]

_NAME = re.compile(r"[^\W\d]\w*")


def short_names(texts: Sequence[str], longest: int) -> dict[str, str]:
    """A shorter spelling of every name in some terms that has more than `longest` characters.

    Beginning and end are kept. Names that would look alike are shortened less.

    Examples
    --------
    >>> short_names(["x", "displacement_of_mass_1**3", "displacement_of_mass_2"], 12)
    {'displacement_of_mass_1': 'displa…ass_1', 'displacement_of_mass_2': 'displa…ass_2'}
    """
    names = list(dict.fromkeys(name for text in texts for name in _NAME.findall(text)))
    for length in range(longest, max(map(len, names), default=0)):
        out = {name: _shortened(name, length) for name in names}
        if len(set(out.values())) == len(names):
            return {name: short for name, short in out.items() if short != name}
    return {}


def _shortened(name: str, length: int) -> str:
    if len(name) <= length:
        return name
    front = length // 2
    return f"{name[:front]}…{name[len(name) - (length - front - 1) :]}"


def with_names(text: str, names: Mapping[str, str]) -> str:
    """A term with some of its names replaced.

    Examples
    --------
    >>> with_names("displacement**3*dis", {"displacement": "dis…ent"})
    'dis…ent**3*dis'
    """
    return _NAME.sub(lambda found: names.get(found.group(), found.group()), text)
