"""Which settings move an answer? Every field of docs/rules.md, halved and doubled, on twenty short records.

    python -m studies.sensitivity > docs/tables/sensitivity.csv

A value that an answer merely compares with others, with the same outcome at half and at twice of it, cannot move that
answer, and a field that it does not read cannot either: both are seen in one run, and only the others are run again.
"""

from __future__ import annotations

import operator
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from bayeq.discovery import discover
from bayeq.errors import BayeqError, BayeqWarning
from studies.overridden import overridden
from studies.resumable import Cell, Outcome, run_study
from studies.rules import STAGES
from studies.sensitivity_records import RECORDS, Question

__all__ = ["Answer", "Compared", "answered", "main", "moved"]

# By stage and name: the instance and the field.
FIELDS: Mapping[tuple[str, str], tuple[Any, Any]] = {
    (stage, one.name): (settings, one) for stage, settings in STAGES.items() for one in fields(settings)
}

FACTORS = ("half", "double")


def moved(value: float, unit: str = "") -> tuple[float, float]:
    """Half and twice of a value: whole numbers stay whole, shares below one, and factors between one and two above one.

    Examples
    --------
    >>> moved(5), moved(0.1), moved(0.9), moved(1.5), moved(1.5, "sd")
    ((2, 10), (0.05, 0.2), (0.45, 0.95), (1.25, 2.0), (0.75, 3.0))
    """
    if isinstance(value, int):
        return max(1, value // 2), 2 * value
    if not unit and 0.5 <= value < 1.0:
        return value / 2.0, (1.0 + value) / 2.0
    if not unit and 1.0 < value < 2.0:
        return 1.0 + (value - 1.0) / 2.0, 1.0 + (value - 1.0) * 2.0
    return value / 2.0, 2.0 * value


class Answer(NamedTuple):
    """What is compared: terms with standard deviation, coefficient and ends of its interval; verdict, and warnings."""

    terms: Mapping[str, tuple[float, ...]]
    verdict: str
    warnings: Sequence[str]


# --- what a field is read for ----------------------------------------------------------------------------------------


class Used(BaseException):
    """A value is used otherwise than in a comparison; no handler of the program catches it."""


class Compared:
    """Stands for a value: compares as it does, and sees where its half or double would compare otherwise.

    Parameters
    ----------
    key : tuple of str
        Of the field.
    value : number
    others : sequence of number
        Its half and its double.
    """

    def __init__(self, key: tuple[str, str], value: float, others: Sequence[float]):
        self.key, self.value, self.others = key, value, others
        self.differs = [False] * len(others)

    def _compare(self, how: Callable[[Any, Any], Any], other: Any) -> Any:
        usual = how(self.value, other)
        for k, value in enumerate(self.others):
            self.differs[k] |= not np.array_equal(how(value, other), usual)
        return usual

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **how: Any) -> Any:
        """A comparison with an array, from either side."""
        if ufunc not in MIRRORED or method != "__call__" or how:
            raise Used(self.key)
        first, second = inputs
        return self._compare(ufunc, second) if first is self else self._compare(MIRRORED[ufunc], first)


MIRRORED = {
    np.less: np.greater, np.greater: np.less, np.less_equal: np.greater_equal, np.greater_equal: np.less_equal,
}  # fmt: skip


# What else a number is asked for.
OTHERWISE = (
    "add radd sub rsub mul rmul truediv rtruediv floordiv rfloordiv mod rmod pow rpow neg pos abs float int index bool "
    "hash iter len round format str repr array getitem contains trunc floor ceil copy deepcopy reduce_ex getattr"
)


def _used(one: Compared, *_: Any, **__: Any) -> Any:
    raise Used(vars(one)["key"])


def _comparing(how: Callable[[Any, Any], Any]) -> Any:
    return lambda one, other: one._compare(how, other)


for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Compared, f"__{_name}__", _comparing(getattr(operator, _name)))
for _name in OTHERWISE.split():
    setattr(Compared, f"__{_name}__", _used)


class Reading(NamedTuple):
    """What fields mean to the answer for one record: those to try at half and at double, and how many are read."""

    tried: Mapping[tuple[str, str], tuple[bool, bool]]
    usual: Answer


# Fields that some record uses otherwise than in a comparison; found on the way.
USED: set[tuple[str, str]] = set()


def read_for(question: Question) -> Reading:
    """The default answer, and the fields that may move it."""
    usual = answered(question)
    while True:
        compared = {
            key: Compared(key, one.default, moved(one.default, one.metadata["unit"]))
            for key, (_, one) in FIELDS.items()
            if key not in USED
        }
        read: set[tuple[str, str]] = set()
        try:
            with ExitStack() as stack:
                for (stage, name), value in compared.items():
                    stack.enter_context(overridden(FIELDS[stage, name][0], **{name: value}))
                stack.enter_context(_listening(read))
                again = answered(question)
        except Used as used:
            USED.add(used.args[0])
            continue
        break
    assert not differences(usual, again), "a comparison was not seen"
    tried = {}
    for key in read:
        either = compared[key].differs if key in compared else (True, True)
        tried[key] = (bool(either[0]), bool(either[1]))
    return Reading(tried, usual)


@contextmanager
def _listening(read: set[tuple[str, str]]) -> Iterator[None]:
    """Note which fields are read: each instance is of a class that sees it."""
    kinds = {stage: (settings, type(settings)) for (stage, _), (settings, _) in FIELDS.items()}
    for stage, (settings, kind) in kinds.items():

        def noted(one: Any, name: str, stage: str = stage) -> Any:
            if (stage, name) in FIELDS:
                read.add((stage, name))
            return object.__getattribute__(one, name)

        object.__setattr__(settings, "__class__", type(kind.__name__, (kind,), {"__getattribute__": noted}))
    try:
        yield
    finally:
        for settings, kind in kinds.values():
            object.__setattr__(settings, "__class__", kind)


# --- answers ---------------------------------------------------------------------------------------------------------


def answered(question: Question) -> Answer:
    """The answer; a question that is refused has the verdict "refused"."""
    record, asked = question
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            eqs = discover(record, **asked)
        except (BayeqError, ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError) as error:
            return Answer({}, "refused", [type(error).__name__])
    terms = {}
    for eq in eqs:
        shown = eq.shown_posterior
        for name, coef, sd, ends, kept in zip(
            shown.names, shown.coef, shown.sd, eq.printed_ci95, shown.support, strict=True
        ):
            if kept:
                terms[f"{eq.target} {name}"] = (float(sd), float(coef), *map(float, ends))
        if eq.intercept_matters:
            coef, sd = eq.shown_model.intercept, eq.shown_model.intercept_sd
            terms[f"{eq.target} 1"] = (sd, coef, *eq.printed_intercept_ci95)
    # numbers in messages move with every coefficient
    said = sorted(re.sub(r"[-+\d.e]*\d[-+\d.e]*", "0", text) for text in eqs.warnings)
    return Answer(terms, str(eqs.verdict.kind), said)


def differences(usual: Answer, other: Answer) -> dict[str, float]:
    """Whether terms, verdict and warnings are others, and the largest change of a number or its interval [sd]."""
    changes = [
        abs(now - before) / sd
        for name, (sd, *numbers) in usual.terms.items()
        if name in other.terms and sd > 0.0
        for before, now in zip(numbers, other.terms[name][1:], strict=True)
    ]
    found = {
        "terms": float(set(usual.terms) != set(other.terms)),
        "verdict": float(usual.verdict != other.verdict),
        "warnings": float(list(usual.warnings) != list(other.warnings)),
        "sd": max(changes, default=0.0),
    }
    return found if any(found.values()) else {}


# --- the study -------------------------------------------------------------------------------------------------------


@cache
def _questions(seed: int) -> Mapping[str, tuple[Question, Reading]]:
    """Records that are there, the cheapest first, with their default answers."""
    drawn = {name: draw(seed) for name, draw in RECORDS.items()}
    return {name: (question, read_for(question)) for name, question in drawn.items() if question is not None}


def _measure(key: tuple[str, str], seed: int) -> Outcome:
    settings, one = FIELDS[key]
    values = moved(one.default, one.metadata["unit"])
    known, found = _questions(seed), []
    for name, (question, reading) in known.items():
        for factor, value, tried in zip(FACTORS, values, reading.tried.get(key, (False, False)), strict=True):
            if tried:
                with overridden(settings, **{key[1]: value}):
                    change = differences(reading.usual, answered(question))
                if change:
                    found.append({"record": name, "factor": factor, **change})
    read = sum(key in reading.tried for _, reading in known.values())
    return {"records": len(known), "read": read, "changes": found}


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    found = [change for outcome in outcomes for change in outcome["changes"]]
    worst = max(found, key=lambda change: (change["terms"] + change["verdict"], change["sd"]), default=None)
    yield {
        "records": sum(outcome["records"] for outcome in outcomes),
        "read": sum(outcome["read"] for outcome in outcomes),
        **{
            f"{what}_{factor}": sum(bool(one[what]) for one in found if one["factor"] == factor)
            for what in ("terms", "verdict", "warnings")
            for factor in FACTORS
        },
        "most_sd": f"{max((one['sd'] for one in found), default=0.0):.2g}",
        "where": f"{worst['record']}, {worst['factor']}" if worst else "",
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"stage": stage, "field": name, "default": one.default}, 1, partial(_measure, (stage, name)))
        for (stage, name), (_, one) in FIELDS.items()
    ]
    run_study("sensitivity", "Answers with every setting at half and at twice its value.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
