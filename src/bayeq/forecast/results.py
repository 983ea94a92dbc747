"""What equations keep of having been run: `Scores` and `Refinement`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

__all__ = ["Refinement", "Scores", "percentages"]


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
    """Errors as a person reads them.

    Examples
    --------
    >>> percentages({"x": 0.0123, "v": 0.57})
    'x 1.2 %, v 57 %'
    """
    return ", ".join(f"{name} {_percent(100.0 * error)} %" for name, error in errors.items()) or "no state is measured"


def _percent(error: float) -> str:
    return f"{error:.0f}" if error >= 10 else f"{error:.2g}"


@dataclass(frozen=True, slots=True)
class Refinement:
    """How equations were refined.

    Attributes
    ----------
    files : tuple of str
        Names of the records.
    n : int
        Rows used.
    segments, longest : int
        Free runs, and the rows of the longest.
    noise_sd : mapping of str to float
        For each measured channel the standard deviation of its noise.
    unseen_sd : mapping of str to float
        For each equation the standard deviation of forces that the record does not show (noise in a measured force,
        what the terms lack), as noise in samples of the target.
    interpolation : "cubic", "linear" or "hold"
        Of the inputs between their samples.
    converged : bool
        Whether the fit ended by itself.
    """

    files: tuple[str, ...]
    n: int
    segments: int
    longest: int
    noise_sd: Mapping[str, float]
    unseen_sd: Mapping[str, float]
    interpolation: Literal["cubic", "linear", "hold"]
    converged: bool

    def __str__(self) -> str:
        """In a line."""
        runs = "one run" if self.segments == 1 else f"{self.segments} runs"
        noise, unseen = (
            ", ".join(f"{name} {sd:.3g}" for name, sd in levels.items()) for levels in (self.noise_sd, self.unseen_sd)
        )
        how = f"{runs} of up to {self.longest} rows"
        return f"coefficients refined by output error: {how}, noise sd {noise}, unseen forces sd {unseen}"
