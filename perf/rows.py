"""The table of the comparison as a file: a line per contestant and case, below lines that say where it was measured."""

from __future__ import annotations

import csv
import math
import os
import platform
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from threadpoolctl import threadpool_info

__all__ = ["Row", "machine", "read_rows", "write_rows"]

PACKAGES = (
    "numpy", "scipy", "scikit-learn", "numba", "pysindy", "jax", "numpyro",
    "millipede-regression", "torch", "pysusie", "abess", "skglm",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Row:
    """A contestant on a case.

    Attributes
    ----------
    case, rows, columns, contestant : str, int, int, str
        Which.
    status : str
        "ok", or why there are no numbers.
    seconds : float
        Median time of a whole fit.
    rounds : int
        Fits that it is the median of.
    problems : int
        Problems that the accuracy is an average of.
    exact, false, missed, error, evidence : float
        As in `perf.accuracy.Accuracy`.
    peak_mb, extra_mb : float
        As in `perf.worker.Outcome`; nan where contestants shared a process.
    """

    case: str
    rows: int
    columns: int
    contestant: str
    status: str
    seconds: float = math.nan
    rounds: int = 0
    problems: int = 0
    exact: float = math.nan
    false: float = math.nan
    missed: float = math.nan
    error: float = math.nan
    evidence: float = math.nan
    peak_mb: float = math.nan
    extra_mb: float = math.nan


NUMBERS = {"rows": int, "columns": int, "rounds": int, "problems": int}
TEXTS = ("case", "contestant", "status")


def _installed(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} not installed"


def _processor() -> str:
    """The processor's name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{platform.machine()} ({names[0]})" if names else platform.machine()


def machine(threads: int) -> list[str]:
    """Where and with what is measured: a few lines."""
    blas = {f"{lib['internal_api']} {lib['version']}" for lib in threadpool_info() if lib["user_api"] == "blas"}
    return [
        f"{_processor()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        f"BLAS threads: {threads} ({', '.join(sorted(blas))})",
        ", ".join(_installed(package) for package in PACKAGES),
    ]


def _text(value: object) -> object:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.4g}"
    return value


def write_rows(path: Path, remarks: Iterable[str], rows: Iterable[Row]) -> None:
    """Write the table; nan is left empty."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        file.writelines(f"# {remark}\n" for remark in remarks)
        writer = csv.DictWriter(file, [field.name for field in fields(Row)], lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _text(value) for key, value in asdict(row).items()} for row in rows)


def read_rows(path: Path) -> tuple[list[str], list[Row]]:
    """The remarks and the table of `write_rows`."""
    lines = path.read_text().splitlines()
    remarks = [line[2:] for line in lines if line.startswith("# ")]
    table = csv.DictReader(line for line in lines if not line.startswith("#"))

    def value(key: str, text: str) -> object:
        if key in TEXTS:
            return text
        return NUMBERS.get(key, float)(text) if text else math.nan

    return remarks, [Row(**{key: value(key, text) for key, text in line.items()}) for line in table]  # type: ignore[arg-type]
