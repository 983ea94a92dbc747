"""Studies that go on where they were killed: every record is written to a file of JSON lines as soon as it is finished.

A table is made of what that file holds for the present state of `src`; records of another state are measured again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from studies.lines import print_table

__all__ = ["FIRST_SEED", "Cell", "Outcome", "Store", "percent", "run_study"]

Outcome = Mapping[str, Any]

# Nothing in the package was tuned on records of seeds from here on.
FIRST_SEED = 10_000


@dataclass(frozen=True)
class Cell:
    """Records of one kind, fitted in one way.

    Attributes
    ----------
    labels : mapping of str to str or number
        What stands in front of its lines in the table; no two cells have the same.
    records : int
        How many are measured unless the command says otherwise.
    measure : callable
        From a seed to what is kept of that record, as JSON can hold it.
    on_request : bool
        Whether the cell takes part only where ``--only`` chooses it.
    """

    labels: Mapping[str, str | float]
    records: int
    measure: Callable[[int], Outcome]
    on_request: bool = False

    def chosen_by(self, only: str) -> bool:
        """Whether the cell is one of those that are asked for; no word asks for all that need none."""
        if not only:
            return not self.on_request
        return only in " ".join(map(str, self.labels.values()))


class Store:
    """Finished records in a file of JSON lines, by cell and seed.

    Parameters
    ----------
    path : Path
        Made with the first record. A last line that was cut short by a kill is passed over.
    code : str
        State of the program; lines of others are kept and not used.
    """

    def __init__(self, path: Path, code: str):
        self.path, self.code = path, code
        self._known: dict[tuple[str, int], Outcome] = {}
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        for number, text in enumerate(lines):
            try:
                line = json.loads(text)
            except json.JSONDecodeError:
                if number < len(lines) - 1:
                    raise
                # so that the next line starts on its own
                path.write_text("".join(f"{whole}\n" for whole in lines[:-1]), encoding="utf-8")
                continue
            if line["code"] == code:
                self._known[_key(line["cell"]), line["seed"]] = line["outcome"]

    def get(self, cell: Cell, seed: int) -> Outcome | None:
        """What is known of a record."""
        return self._known.get((_key(cell.labels), seed))

    def add(self, cell: Cell, seed: int, outcome: Outcome) -> None:
        """Write a finished record down."""
        line = {"code": self.code, "cell": cell.labels, "seed": seed, "outcome": outcome}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        self._known[_key(cell.labels), seed] = outcome


def _key(labels: Mapping[str, str | float]) -> str:
    return json.dumps(labels, sort_keys=True)


def by_noise(
    systems: Iterable[str], noises: Iterable[float], records: int, measure: Callable[[str, float, int], Outcome]
) -> list[Cell]:
    """A cell for every system and noise, a share of the channels' standard deviation; from system, noise and seed."""
    return [
        Cell({"system": name, "noise_percent": f"{100 * noise:g}"}, records, partial(measure, name, noise))
        for name, noise in itertools.product(systems, tuple(noises))
    ]


def run_study(
    name: str,
    about: str,
    cells: Sequence[Cell],
    summary: Callable[[Sequence[Outcome]], Iterable[Mapping[str, object]]],
    arguments: list[str] | None = None,
) -> None:
    """Measure what the store does not hold, and write the table to standard output.

    Parameters
    ----------
    name : str
        Of the module; also of the store, unless one is given.
    about : str
        One line for ``--help``.
    cells : sequence of Cell
        In the order of the table.
    summary : callable
        From the outcomes of a cell to its lines in the table, without the labels.
    arguments : list of str, optional
        By default those of the command.
    """
    parser = argparse.ArgumentParser(prog=f"python -m studies.{name}", description=about)
    parser.add_argument("--records", type=int, help="records of every cell (default: each cell's own number)")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="seed of the first record of every cell")
    parser.add_argument(
        "--store", type=Path, default=Path(f"{name}.jsonl"), help="finished records, default %(default)s"
    )
    parser.add_argument("--only", default="", help="cells whose labels, joined by spaces, contain this")
    parser.add_argument("--show", action="store_true", help="the table of what the store holds; nothing is measured")
    given = parser.parse_args(arguments)
    store = Store(given.store, code_state())
    chosen = [cell for cell in cells if cell.chosen_by(given.only)]
    if not given.show:
        for cell in chosen:
            _measure(cell, given.records or cell.records, given.first_seed, store)
    limits = "".join(
        f" --{option} {value}"
        for option, value in (("records", given.records), ("first-seed", given.first_seed), ("only", given.only))
        if value
    )
    print(f"# python -m studies.{name}{limits}; src as of commit {store.code}", flush=True)
    print_table(_lines(chosen, given.records, given.first_seed, store, summary))


def _measure(cell: Cell, records: int, first_seed: int, store: Store) -> None:
    for seed in range(first_seed, first_seed + records):
        if store.get(cell, seed) is None:
            store.add(cell, seed, cell.measure(seed))
    print(f"done: {' '.join(map(str, cell.labels.values()))}", file=sys.stderr, flush=True)


def _lines(
    cells: Sequence[Cell],
    records: int | None,
    first_seed: int,
    store: Store,
    summary: Callable[[Sequence[Outcome]], Iterable[Mapping[str, object]]],
) -> Iterable[Mapping[str, object]]:
    for cell in cells:
        known = (store.get(cell, seed) for seed in range(first_seed, first_seed + (records or cell.records)))
        outcomes = [outcome for outcome in known if outcome is not None]
        if outcomes:
            for line in summary(outcomes):
                yield {**cell.labels, "records": len(outcomes), **line}


def percent(count: int, of: int) -> str:
    """A share in per cent; nothing of nothing.

    Examples
    --------
    >>> percent(3, 8), percent(0, 0)
    ('37.5', '')
    """
    return f"{100 * count / of:.1f}" if of else ""


def code_state() -> str:
    """The last commit that changed the `src` that is imported, which may be that of another checkout than the studies'.

    With a + where `src` has changed since; the package's version without git.
    """
    import bayeq

    root = Path(bayeq.__file__).resolve().parents[2]
    try:
        commit = _git(root, "log", "-1", "--format=%h", "--", "src")
        if commit:
            return commit + ("+" if _git(root, "status", "--porcelain", "--", "src") else "")
    except (OSError, subprocess.CalledProcessError):
        pass
    return bayeq.__version__


def _git(root: Path, *words: str) -> str:
    return subprocess.run(["git", *words], cwd=root, check=True, capture_output=True, text=True).stdout.strip()
