"""A batch in a few lines: verdicts, and for each term how far its coefficient varies over files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

__all__ = ["CONSTANT", "summary"]

# The constant, where an equation has one.
CONSTANT = "1"

DIFFERENT = (
    "The terms are not those of all files: the coefficient of one changes where another comes or goes; --common\n"
    "  (common=True) compares the coefficients of one equation."
)

UNITS = "The units of {} differ over files: state them with --units (read={{'units': ...}}) before comparing numbers."


class Summarised(Protocol):
    """What is summarised; see `bayeq.batches.result.Batch`."""

    @property
    def files(self) -> Sequence[Any]: ...
    @property
    def refused(self) -> Sequence[Any]: ...
    def rows(self) -> list[dict[str, Any]]: ...


def summary(batch: Summarised) -> str:
    """The text of `bayeq.batch`.

    Parameters
    ----------
    batch : Batch
        What is summarised.

    Returns
    -------
    str
        For each target a line per term: in how many files it is in the equation; the coefficient in the first and the
        last of these, and the median; half the 95 % interval (median); and the spread: the standard deviation of the
        coefficient over files divided by the root mean square of its sd, about 1 if it is the same in all files.
    """
    lines = [_count(len(batch.files), "file") + f", {len(batch.files) - len(batch.refused)} with equations"]
    rows = batch.rows()
    for target in dict.fromkeys(row["target"] for row in rows):
        own = [row for row in rows if row["target"] == target]
        verdicts = Counter(row["verdict"] for row in {row["order"]: row for row in own}.values())
        said = ", ".join(f"{kind} {count}" for kind, count in verdicts.most_common())
        lines += ["", f"{target}: {said}", ""]
        head = f"  {'term':<16} {'files':>5} {'first':>11} {'last':>11} {'median':>11} {'+-':>9} {'spread':>7}"
        lines += [head, *(_line(own, term) for term in dict.fromkeys(row["term"] for row in own))]
        if not all(row["shown"] for row in own if row["term"] != CONSTANT):
            lines += ["", f"  {DIFFERENT}"]
        units = {term: {row["unit"] for row in own if row["term"] == term} for term in {row["term"] for row in own}}
        mixed = sorted(term for term, found in units.items() if len(found) > 1)
        if mixed:
            lines += ["", f"  {UNITS.format(', '.join(mixed))}"]
    return "\n".join(lines)


def _line(rows: Sequence[dict[str, Any]], term: str) -> str:
    """A term over the files in whose equations it is."""
    own = [row for row in rows if row["term"] == term and row["shown"]]
    coef, sd = np.array([row["coef"] for row in own]), np.array([row["sd"] for row in own])
    half = np.median([(row["ci_high"] - row["ci_low"]) / 2.0 for row in own])
    rms = np.sqrt(np.mean(sd**2))
    spread = f"{np.std(coef, ddof=1) / rms:7.1f}" if len(own) > 1 and rms > 0.0 else f"{'-':>7}"
    numbers = f"{coef[0]:11.5g} {coef[-1]:11.5g} {np.median(coef):11.5g} {half:9.2g}"
    return f"  {term:<16} {len(own):5} {numbers} {spread}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
