"""The table of an equation's terms as text, of which every account shows some columns; and long names shortened."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bayeq.equation.equation import Equation
from bayeq.equation.size_path import percent
from bayeq.equation.written import plain_sd, with_interval
from bayeq.inference.engines import NOTEWORTHY_PIP

_NAME = re.compile(r"[^\W\d]\w*")


@dataclass(frozen=True, slots=True)
class Row:
    """A term, a constant inside terms, or the intercept; texts are empty where there is nothing to say."""

    name: str  # the term, ``{name}`` of a constant, or ``intercept``
    coefficient: str = ""  # it, and the two that follow, are empty of a term that is not shown
    sd: str = ""
    interval: str = ""
    over_models: bool = False  # whether the interval is that over models
    absent: str = ""  # what is said of a term that is not shown
    pip: float = math.nan  # NaN of what is no term
    share: str = ""  # of the target's variance
    unit: str = ""

    @property
    def score(self) -> str:
        """The probability, or what stands in its column."""
        return "" if math.isnan(self.pip) else f"{self.pip:.3f}"


def rows_of(equation: Equation, conditional: bool = False) -> list[Row]:
    """Terms that are shown, included or likely, constants inside those shown, and last the intercept.

    Intervals are those that are printed; with `conditional` all are given the terms shown.
    """
    p, shown, rows = equation.posterior, equation.shown_posterior, list[Row]()
    intervals = equation.shown_ci95 if conditional else equation.printed_ci95
    for j, term in enumerate(equation.terms):
        pip = float(p.pip[j])
        if equation.chain.stated:  # all of it is in
            continue
        if shown.support[j]:
            numbers, over_models = (
                with_interval(shown.coef[j], shown.sd[j], intervals[j]),
                equation.printed_over_models[j],
            )
            share = math.nan if equation.share is None else equation.share[j]
            rows.append(
                Row(
                    term.text,
                    *numbers,
                    over_models=bool(over_models) and not conditional,
                    pip=pip,
                    share=percent(share) if math.isfinite(share) else "",
                    unit=equation.coef_units[j] or "",
                )
            )
        elif p.support[j] or pip >= NOTEWORTHY_PIP:
            rows.append(Row(term.text, absent="not shown" if p.support[j] else "not included", pip=pip))
    for one in equation.shown_constants:
        numbers, unit = with_interval(one.value, plain_sd(one), one.ci95), equation.constant_units.get(one.name, "")
        rows.append(Row(f"{{{one.name}}}", *numbers, unit=unit))
    ends = equation.intercept_ci95 if conditional else equation.printed_intercept_ci95
    over_models, unit = ends != equation.intercept_ci95, equation.units.get(equation.target, "")
    numbers = with_interval(*equation.intercept_estimate, ends)
    return [*rows, Row("intercept", *numbers, over_models=over_models, unit=unit)]


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
