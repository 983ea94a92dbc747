"""Averages over a study's realisations beside the paper's Tables 2 and 3."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from typing import Any

import numpy as np

from bayeq.study.config import STUDY_SYSTEMS
from bayeq.study.metrics import METRICS, Result
from bayeq.study.printed import PRINTED_ALGORITHMS, RUNTIMES, TABLE_2
from bayeq.study.store import Plan

__all__ = ["aggregate", "failure_messages", "runtimes"]

Row = dict[str, Any]

# Averages of zeros and ones.
RATES = ("exact", "superset")


def aggregate(results: Iterable[Result], plan: Plan | None = None) -> list[Row]:
    """Table 2: a row per system and algorithm, in the paper's order.

    Parameters
    ----------
    results : iterable of Result
        By system, algorithm and index, as `Store.results` gives them.
    plan : dict, optional
        (system, algorithm) -> realisations asked for.

    Returns
    -------
    list of dict
        Means over the `n` realisations that did not fail under the names of the metrics, `e_theta_median`,
        Monte Carlo standard errors in `se`, the paper's values (or None) in `paper`, mean `seconds`, and how many
        realisations failed, did not converge, or are still missing.
    """
    cells = {
        key: _cell(*key, list(group)) for key, group in groupby(results, key=lambda result: _key(result.system, result))
    }
    for (system, algorithm), asked in (plan or {}).items():
        cell = cells.setdefault((system, algorithm), _cell(system, algorithm, []))
        cell["missing"] = max(asked - cell["n"] - cell["failures"], 0)
    return [cells[key] for key in sorted(cells, key=_order)]


def _key(system: str, result: Result) -> tuple[str, str]:
    return system, result.algorithm


def _order(key: tuple[str, str]) -> tuple[int, str, int, str]:
    system, algorithm = key
    return (*_place(STUDY_SYSTEMS, system), *_place(PRINTED_ALGORITHMS, algorithm))


def _place(order: Sequence[str], name: str) -> tuple[int, str]:
    return (order.index(name) if name in order else len(order), name)


def _cell(system: str, algorithm: str, results: Sequence[Result]) -> Row:
    good = [r for r in results if r.metrics is not None]
    values = {name: np.array([getattr(r.metrics, name) for r in good], dtype=np.float64) for name in METRICS}
    seconds = np.array([r.seconds for r in good], dtype=np.float64)
    means = {name: _mean(column) for name, column in values.items()}
    return {
        "system": system,
        "algorithm": algorithm,
        "n": len(good),
        **means,
        "seconds": _mean(seconds),
        "e_theta_median": float(np.median(values["e_theta"])) if good else None,
        "se": {name: _standard_error(name, column) for name, column in values.items()},
        "paper": _paper(system, algorithm),
        "failures": len(results) - len(good),
        "unconverged": sum(r.converged is False for r in good),
        "missing": 0,
    }


def _mean(values: np.ndarray[Any, np.dtype[np.float64]]) -> float | None:
    return float(values.mean()) if values.size else None


def _standard_error(name: str, values: np.ndarray[Any, np.dtype[np.float64]]) -> float | None:
    """sd/sqrt(n), for rates sqrt(p (1 - p)/n); None where there are too few values."""
    n = values.size
    if n < 2:
        return None
    if name in RATES:
        p = float(values.mean())
        return math.sqrt(p * (1.0 - p) / n)
    return float(values.std(ddof=1)) / math.sqrt(n)


def _paper(system: str, algorithm: str) -> Row | None:
    printed = TABLE_2.get((system, algorithm))
    if printed is None:
        return None
    row = asdict(printed)
    approximate = list(row.pop("approximate"))
    return {**row, "seconds": RUNTIMES[algorithm], "approximate": approximate}


def failure_messages(results: Iterable[Result]) -> list[Row]:
    """What failed: a row per system, algorithm and message, with the count and the first index."""
    found: dict[tuple[str, str, str], Row] = {}
    for r in results:
        if r.failure is not None:
            key = (r.system, r.algorithm, r.failure)
            row = found.setdefault(
                key,
                {
                    "system": r.system,
                    "algorithm": r.algorithm,
                    "message": r.failure,
                    "count": 0,
                    "first_index": r.index,
                },
            )
            row["count"] += 1
    return [found[key] for key in sorted(found, key=lambda k: (_order(k[:2]), k[2]))]


def runtimes(rows: Sequence[Mapping[str, Any]], chains: int) -> list[Row]:
    """Table 3: mean seconds of a single run over all systems, and ratios to the RVM and to SS-VB.

    Parameters
    ----------
    rows : sequence of dict
        What `aggregate` returned.
    chains : int
        Chains of the Gibbs sampler: as in the paper its time is that of a single one.

    Returns
    -------
    list of dict
        `seconds` of a single run (`seconds_all_chains` as measured), `ratio_rvm`, `ratio_vb`, and the paper's
        three (or None) in `paper`.
    """
    totals: dict[str, list[float]] = {}
    for row in rows:
        if row["seconds"] is not None:
            total = totals.setdefault(row["algorithm"], [0, 0.0])
            total[0] += row["n"]
            total[1] += row["n"] * row["seconds"]
    measured = {name: total / n for name, (n, total) in totals.items()}
    single = {name: s / (chains if name == "gibbs" else 1) for name, s in measured.items()}
    return [
        {
            "algorithm": name,
            "n": int(totals[name][0]),
            "seconds": single[name],
            "seconds_all_chains": measured[name],
            **_ratios(single, name),
            "paper": {"seconds": RUNTIMES[name], **_ratios(RUNTIMES, name)} if name in RUNTIMES else None,
        }
        for name in sorted(single, key=lambda name: _place(PRINTED_ALGORITHMS, name))
    ]


def _ratios(seconds: Mapping[str, float], name: str) -> dict[str, float | None]:
    return {f"ratio_{other}": seconds[name] / seconds[other] if seconds.get(other) else None for other in ("rvm", "vb")}
