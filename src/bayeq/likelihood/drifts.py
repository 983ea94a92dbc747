"""Motion without the drift of its channels, as a fit has it: what equations are judged by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayeq.likelihood.block import at_its_path
from bayeq.likelihood.record_fit import RecordFit
from bayeq.likelihood.start import series_and_paths
from bayeq.states import Motion, MotionRows

__all__ = ["without_drifts"]

Floats = NDArray[np.float64]


def without_drifts(motion: Motion, record: RecordFit | None) -> Motion:
    """The motion, what drifts in the samples of its channels taken out of them, of the rows held out too.

    A derivative that is not measured is taken to be that of the coordinate without its drift, which is slow.
    """
    if record is None or not record.task.layout.drift:
        return motion
    task, state = record.task, record.fitted.state
    with np.errstate(all="ignore"):
        series, paths = series_and_paths(task.layout, motion.records)
        own = replace(task, series=series, recent=[])
        try:
            state, _, found = at_its_path(own, replace(state, paths=paths, blurs=()))
        except np.linalg.LinAlgError:  # rows held out that the motion does not stay near
            return motion
    drifts = [
        path[:, task.layout.drifts] + one.deviation[:, task.layout.drifts]
        for path, one in zip(state.paths, found, strict=True)
    ]
    names = [name for name, _ in task.layout.channels]
    return replace(
        motion, records=tuple(_without(rows, names, drift) for rows, drift in zip(motion.records, drifts, strict=True))
    )


def _without(rows: MotionRows, names: list[str], drifts: Floats) -> MotionRows:
    of = dict(zip(names, drifts.T, strict=True))

    def freed(columns: Mapping[str, Floats]) -> dict[str, Floats]:
        return {name: values - of[name] if name in of else values for name, values in columns.items()}

    return replace(rows, columns=freed(rows.columns), observed=freed(rows.observed), samples=freed(rows.samples))
