"""What is a table or a figure, by the suffix of the file that it is written to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from bayeq.errors import InputError
from bayeq.figures.style import UNSIGNED, require_matplotlib, style
from bayeq.records.atomic import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["by_target", "require_suffix", "write_output"]

SUFFIXES = (".csv", *(f".{name}" for name in UNSIGNED))


def require_suffix(file: Path, what: str) -> None:
    """Check that `write_output` can make such a file, before anything is computed for it.

    Parameters
    ----------
    file : Path
        The suffix says what to write.
    what : str
        For the message: what is a table or a figure.

    Raises
    ------
    InputError
        A suffix that is not known.
    MissingExtraError
        matplotlib is needed and not installed.
    """
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{file}: {what} a table or a figure: end it in {', '.join(SUFFIXES)}")
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


def by_target(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Tables of several equations under each other, the target of each in front."""
    import pandas as pd

    return pd.concat(list(tables.values()), keys=list(tables), names=["target", None]).reset_index(level=0)
