"""Results as files: a table or a figure, by the suffix of the file that is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from bayeq.errors import InputError
from bayeq.figures.style import UNSIGNED, require_matplotlib, style
from bayeq.records.files import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["require_suffix", "write_by_target", "write_output"]

SUFFIXES = (".csv", *(f".{name}" for name in UNSIGNED))


class Tabulated(Protocol):
    """What has a table."""

    def table(self) -> pd.DataFrame: ...


T = TypeVar("T", bound=Tabulated)


def require_suffix(file: Path) -> None:
    """Check that `write_output` can make such a file, before anything is computed for it.

    Raises
    ------
    InputError
        A suffix that is not known.
    MissingExtraError
        matplotlib is needed and not installed.
    """
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{file}: is to be written as a table or a figure: end it in {', '.join(SUFFIXES)}")
    if file.suffix.lower() != ".csv":
        require_matplotlib()


def write_output(file: Path, table: Callable[[], pd.DataFrame], figure: Callable[[], Figure]) -> None:
    """Write the table (.csv), or the figure; only that one is made. The suffix has been checked.

    Parameters
    ----------
    file : Path
        Replaced whole, or not at all.
    table, figure : callable
        Make the one or the other; the figure in the style of the reports.
    """
    suffix = file.suffix.lower()[1:]
    if suffix == "csv":
        made = table()
        with replacing(file) as part:
            made.to_csv(part, index=False)
        return
    with style():
        drawn = figure()
        with replacing(file) as part:
            drawn.savefig(part, format=suffix, metadata=UNSIGNED[suffix])


def write_by_target(file: Path, results: Mapping[str, T], draw: Callable[[Mapping[str, T]], Figure]) -> None:
    """`write_output` of results by the target of their equation: tables joined, the target in front, or one figure."""

    def table() -> pd.DataFrame:
        import pandas as pd

        tables = {target: result.table() for target, result in results.items()}
        return pd.concat(tables, names=["target", None]).reset_index(level=0)

    write_output(file, table, lambda: draw(results))
