"""Free runs as files: a table or a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bayeq.figures.runs import draw_forecasts
from bayeq.figures.style import write_output
from bayeq.forecast.run import Forecast

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["write_forecasts"]

# More records do not fit on a page.
MOST_DRAWN = 6


def write_forecasts(file: Path, runs: Sequence[tuple[str, Forecast]]) -> None:
    """Write a table (.csv) of the free runs of some records, or a figure (of the first six).

    Parameters
    ----------
    file : Path
        The suffix, which `bayeq.figures.style.require_suffix` has checked, says what to write.
    runs : sequence of (str, Forecast)
        With the names of the records.
    """
    several = len(runs) > 1

    def table() -> pd.DataFrame:
        import pandas as pd

        tables = [run.table() for _, run in runs]
        if several:
            for (name, _), one in zip(runs, tables, strict=True):
                one.insert(0, "record", name)
        return pd.concat(tables, ignore_index=True)

    def figure() -> Figure:
        return draw_forecasts([(name if several else "", run) for name, run in runs[:MOST_DRAWN]])

    write_output(file, table, figure)
