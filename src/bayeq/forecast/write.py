"""Free runs as files: a table or a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayeq.errors import InputError
from bayeq.files import replacing
from bayeq.forecast.run import Forecast
from bayeq.report.forecast import draw_forecasts
from bayeq.report.style import UNSIGNED, require_matplotlib, style

__all__ = ["require_writable", "write_forecasts"]

SUFFIXES = (".csv", *(f".{name}" for name in UNSIGNED))

# More records do not fit on a page.
MOST_DRAWN = 6


def require_writable(file: Path) -> None:
    """Check that `write_forecasts` can make such a file, before anything is computed for it.

    Raises
    ------
    InputError
        A suffix that is not known.
    MissingExtraError
        matplotlib is needed and not installed.
    """
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{file}: a free run is written to a table or a figure: end it in {', '.join(SUFFIXES)}")
    if file.suffix.lower() != ".csv":
        require_matplotlib()


def write_forecasts(file: Path, runs: Sequence[tuple[str, Forecast]]) -> None:
    """Write a table (.csv) of the free runs of some records, or a figure (of the first six).

    Parameters
    ----------
    file : Path
        The suffix says what to write.
    runs : sequence of (str, Forecast)
        With the names of the records.

    Raises
    ------
    InputError, MissingExtraError
        As `require_writable`.
    """
    require_writable(file)
    suffix = file.suffix.lower()[1:]
    if suffix == "csv":
        import pandas as pd

        tables = [run.table() for _, run in runs]
        if len(runs) > 1:
            for (name, _), table in zip(runs, tables, strict=True):
                table.insert(0, "record", name)
        with replacing(file) as part:
            pd.concat(tables, ignore_index=True).to_csv(part, index=False)
        return
    with replacing(file) as part, style():
        drawn = [run.strip(name if len(runs) > 1 else "") for name, run in runs[:MOST_DRAWN]]
        draw_forecasts(drawn).savefig(part, format=suffix, metadata=UNSIGNED[suffix])
