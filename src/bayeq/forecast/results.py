"""What equations keep of having been run: `Scores`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["Scores", "percentages"]


@dataclass(frozen=True, slots=True)
class Scores:
    """How well equations do on some rows.

    Attributes
    ----------
    rows : int
        How many.
    one_step : mapping of str to float
        For each equation the root mean squared error of the target, given the states and inputs of each row, over the
        standard deviation of the target: the error of the equation.
    free_run : mapping of str to float
        For each measured state the same of free runs, one per record, from the state of its first row; infinite where
        a run blew up.
    blew_up_at : float or None
        Time [s] at which a free run left any reasonable range.
    """

    rows: int
    one_step: Mapping[str, float]
    free_run: Mapping[str, float]
    blew_up_at: float | None = None

    def __str__(self) -> str:
        """Both scores in a line each."""
        lines = [
            f"normalised RMS errors over {self.rows} rows",
            f"one step: {percentages(self.one_step)}",
            f"free run: {percentages(self.free_run)}",
        ]
        if self.blew_up_at is not None:
            lines.append(f"the free run blew up at {self.blew_up_at:.6g} s")
        return "\n".join(lines)


def percentages(errors: Mapping[str, float]) -> str:
    """Errors as text.

    Examples
    --------
    >>> percentages({"x": 0.0123, "v": 0.57})
    'x 1.2 %, v 57 %'
    """
    return ", ".join(f"{name} {_percent(100.0 * error)} %" for name, error in errors.items()) or "no state is measured"


def _percent(error: float) -> str:
    return f"{error:.0f}" if error >= 10 else f"{error:.2g}"
