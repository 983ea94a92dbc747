"""Is there a better model than the one that is found? Everybody's selected terms under the same log evidence.

On many random correlated problems and on the oscillators: how often the true terms, or those that a contestant
selects, have a higher ln p(y, z) than the best model of `SpikeSlabBMA`, or than the terms of `SpikeSlabVB`.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import bayeq as bq
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.collapsed.path import model_log_posterior
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.vb import spike_slab_vb
from perf.peers import CONTESTANTS
from perf.problems import LARGEST_CORRELATION, SYSTEMS, Data, oscillator

__all__ = ["Count", "count_better", "random_problem", "read_counts", "write_counts"]

# Contestants that are quick enough for hundreds of problems.
CANDIDATES = ("vb", "rvm", "stlsq-swept", "gibbs", "ard", "lasso", "pysindy-swept", "abess", "mcp")

# Log evidences nearer than this are the same: rounding.
SAME = 1e-6


@dataclass(slots=True)
class Count:
    """How often somebody's model is better.

    Attributes
    ----------
    candidate : str
        "truth", or the name of a contestant.
    problems : int
        Problems it was compared on.
    same : int
        How often its terms are those of the best model.
    above_bma, above_vb : int
        How often they have a higher ln p(y, z) than the best model of `SpikeSlabBMA`, and than `SpikeSlabVB`'s.
    most_above_bma, most_above_vb : float
        By how much at most [nats]; 0 if never.
    failed : int
        Problems on which it gave no answer.
    """

    candidate: str
    problems: int = 0
    same: int = 0
    above_bma: int = 0
    above_vb: int = 0
    most_above_bma: float = 0.0
    most_above_vb: float = 0.0
    failed: int = 0


def random_problem(seed: int) -> Data:
    """10 to 40 autoregressive columns, neighbours correlated by up to 0.98, and 50 to 2000 rows.

    One to eight true terms, from hardly visible to plain.
    """
    rng = np.random.default_rng((seed, 1))
    columns, rows = int(rng.integers(10, 41)), int(np.exp(rng.uniform(np.log(50), np.log(2000))))
    r = rng.uniform(0.0, LARGEST_CORRELATION) * rng.choice([-1.0, 1.0], size=columns)
    D = rng.standard_normal((rows, columns))
    for j in range(1, columns):
        D[:, j] = r[j] * D[:, j - 1] + np.sqrt(1.0 - r[j] ** 2) * D[:, j]
    coef = np.zeros(columns)
    true = rng.choice(columns, size=int(rng.integers(1, 9)), replace=False)
    coef[true] = rng.choice([-1.0, 1.0], size=len(true)) * rng.uniform(0.05, 1.5, size=len(true))
    return Data(D, D @ coef + rng.standard_normal(rows), coef)


def _problems(random: int, oscillators: int) -> Iterator[Data]:
    yield from (random_problem(seed) for seed in range(random))
    yield from (oscillator(system, seed) for system in SYSTEMS for seed in range(oscillators))


def count_better(random: int, oscillators: int, progress: Callable[[int], None] = lambda done: None) -> list[Count]:
    """Compare everybody's terms on `random` random problems and `oscillators` of each system."""
    counts = {name: Count(name) for name in ("truth", *CANDIDATES) if name == "truth" or CONTESTANTS[name].installed}
    prior = bq.Prior()
    for done, data in enumerate(_problems(random, oscillators)):
        gram = bq.Gram.from_data(data.D, data.y).standardise().gram
        problem = Problem.of(gram, prior)
        average = spike_slab_bma(gram, prior).average
        assert average is not None
        best, vb = average.models[0], spike_slab_vb(gram, prior).support
        tops = model_log_posterior(problem, best), model_log_posterior(problem, vb)
        for name, count in counts.items():
            terms = data.true if name == "truth" else _selected(name, data, float(prior.prior_inclusion))  # type: ignore[arg-type]
            if terms is None:
                count.failed += 1
            else:
                _add(count, bool(np.array_equal(terms, best)), model_log_posterior(problem, terms), *tops)
        progress(done + 1)
    return list(counts.values())


def _selected(name: str, data: Data, p0: float) -> NDArray[np.bool_] | None:
    """The terms that a contestant selects; None if it cannot."""
    try:
        return np.asarray(CONTESTANTS[name](data.D, data.y, p0).support, dtype=np.bool_)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return None


def _add(count: Count, same: bool, value: float, bma: float, vb: float) -> None:
    count.problems += 1
    count.same += same
    count.above_bma += value > bma + SAME
    count.above_vb += value > vb + SAME
    count.most_above_bma = max(count.most_above_bma, value - bma if value > bma + SAME else 0.0)
    count.most_above_vb = max(count.most_above_vb, value - vb if value > vb + SAME else 0.0)


def write_counts(path: Path, remarks: Iterable[str], counts: Iterable[Count]) -> None:
    """Write the counts."""
    with path.open("w", newline="") as file:
        file.writelines(f"# {remark}\n" for remark in remarks)
        writer = csv.DictWriter(file, [field.name for field in fields(Count)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: f"{value:.4g}" if isinstance(value, float) else value for key, value in asdict(count).items()}
            for count in counts
        )


def read_counts(path: Path) -> list[Count]:
    """The counts of `write_counts`."""
    lines = csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#"))
    kinds = {field.name: type(getattr(Count(""), field.name)) for field in fields(Count)}
    return [Count(**{key: kinds[key](text) for key, text in line.items()}) for line in lines]
