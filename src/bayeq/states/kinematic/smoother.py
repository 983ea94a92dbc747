"""Kinematic smoother: a coordinate and its derivatives from noisy samples of any of them.

The coordinate is an integrated Wiener process, whose derivatives are exact (`KinematicModel`); `fit_kinematic`
finds its noise levels, `smooth_kinematic` its states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.errors import InputError
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.model import ChainSeries, KinematicModel, sizes_of
from bayeq.states.kinematic.rows import Filtered, Rows, prepare
from bayeq.states.kinematic.rts import smooth

__all__ = [
    "ChainSeries",
    "KinematicModel",
    "SmoothedStates",
    "fit_kinematic",
    "kinematic_log_likelihood",
    "leave_one_out",
    "one_sided",
    "smooth_kinematic",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedStates:
    """States of a record given all of its samples.

    Attributes
    ----------
    mean : (n, m) array
        q, q', ..., q^(m-1) in their own units.
    innovations : (n, K+1) array
        One-step prediction errors over their standard deviations, each channel predicted from the rows before and
        from the lower derivatives in its own row: independent N(0, 1) if the model holds. NaN without a sample.
    covariances : (u, m, m) array
        The covariances that occur: those of uniform sampling away from ends and gaps are one.
    entry : (n,) array of int
        Which of them belongs to each row.
    """

    mean: Floats
    innovations: Floats
    covariances: Floats
    entry: NDArray[np.int64]

    def covariance_at(self, rows: ArrayLike | slice) -> Floats:
        """Covariances of the states in some rows, (..., m, m)."""
        return self.covariances[self.entry[rows if isinstance(rows, slice) else np.asarray(rows)]]

    @property
    def sd(self) -> Floats:
        """Standard deviations of the states, (n, m)."""
        return np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))[self.entry]


def smooth_kinematic(series: ChainSeries, model: KinematicModel) -> SmoothedStates:
    """States of a record given its samples: the kinematic smoother.

    A derivative below all that are measured (the displacement, where only the acceleration is) is known up to a
    polynomial of the record's time, and its standard deviation says so. After a gap of more than 20 median steps in
    which the lowest measured derivative spreads beyond 1e8 noise levels and beyond `KinematicModel.initial_sd`, the
    state starts again from the latter: rounding would have left nothing of what was known.

    Parameters
    ----------
    series : ChainSeries
        The record.
    model : KinematicModel
        From `fit_kinematic`, or with levels of your own.

    Raises
    ------
    InputError
        A record of another chain, or a channel that the model has no noise level for.

    Examples
    --------
    >>> t = np.arange(200) / 100
    >>> smoothed = smooth_kinematic(ChainSeries(t, (np.sin(t), None)), KinematicModel(3, 1.0, (1e-4, None)))
    >>> bool(np.allclose(smoothed.mean[:, 1], np.cos(t), atol=0.01))
    True
    >>> smoothed.covariance_at([0, 100]).shape
    (2, 3, 3)
    """
    rows, filtered = _filtered(series, model, all_states=True)
    tables, mean = filtered.tables, filtered.tables.means
    n, m = mean.shape
    covariances, entry = np.empty((n, m, m)), np.empty(n, np.int64)
    entries = smooth(rows.steps, tables, filtered.steady, filtered.noise, covariances, entry)
    units = rows.units(np.arange(m))
    mean *= units
    mean[:, 0] += rows.centre
    kept = covariances[:entries].copy() if entries < n else covariances
    kept *= np.outer(units, units)
    innovations = np.full((n, len(series.channels)), np.nan)
    standard = tables.innovations * np.sqrt(tables.inverse)[tables.entry]
    innovations[:, rows.measured] = np.where(rows.present, standard, np.nan)
    return SmoothedStates(mean, innovations, kept, entry)


def kinematic_log_likelihood(series: Sequence[ChainSeries], model: KinematicModel) -> float:
    """Log density of the samples of some records, in the data's units; long gaps as in `smooth_kinematic`.

    Raises
    ------
    InputError
        As `smooth_kinematic`.
    """
    return sum(_filtered(s, model, keep=False)[1].log_likelihood for s in series)


def leave_one_out(series: ChainSeries, model: KinematicModel) -> Floats:
    """Each sample against what all others of the record predict, the same channel's and those of its derivatives.

    Parameters
    ----------
    series : ChainSeries
        The record.
    model : KinematicModel
        From `fit_kinematic`, or with levels of your own.

    Returns
    -------
    (n, K+1, 2) array
        Sample less prediction, and the standard deviation that this has under the model; NaN without a sample.

    Raises
    ------
    InputError
        As `smooth_kinematic`.
    """
    rows, filtered = _filtered(series, model)
    out = np.full((series.n, len(series.channels), 2), np.nan)
    out[:, rows.measured] = rows.left_out(filtered)
    return out


def one_sided(series: ChainSeries, model: KinematicModel) -> tuple[Floats, Floats]:
    """States given the samples up to each row, and given those from each row on: (n, m) each.

    Parameters
    ----------
    series : ChainSeries
        The record.
    model : KinematicModel
        From `fit_kinematic`, or with levels of your own.

    Raises
    ------
    InputError
        As `smooth_kinematic`.
    """
    signs = (-1.0) ** np.arange(len(series.channels))
    channels = (None if c is None else sign * c[::-1] for sign, c in zip(signs, series.channels, strict=True))
    after = _filtered_means(ChainSeries(-series.times[::-1], tuple(channels)), model)
    return _filtered_means(series, model), after[::-1] * (-1.0) ** np.arange(model.order)


def _filtered_means(series: ChainSeries, model: KinematicModel) -> Floats:
    rows, filtered = _filtered(series, model, all_states=True)
    mean = filtered.tables.means * rows.units(np.arange(model.order))
    mean[:, 0] += rows.centre
    return mean


def _filtered(
    series: ChainSeries, model: KinematicModel, *, all_states: bool = False, keep: bool = True
) -> tuple[Rows, Filtered]:
    if len(series.channels) != len(model.noise_sd):
        raise InputError(
            f"the model is of a chain of {len(model.noise_sd) - 1} derivatives, the record of one of"
            f" {len(series.channels) - 1}"
        )
    for k in series.measured:
        if model.noise_sd[k] is None:
            raise InputError(f"derivative {k} is measured, but the model has no noise level for it")
    noise_sd = np.array([np.nan if sd is None else sd for sd in model.noise_sd], dtype=np.float64)
    if model.initial_sd is None:
        initial = sizes_of([series], least=model.noise_sd).initial_sd(model.order)
    else:
        initial = np.array(model.initial_sd, dtype=np.float64)
    rows = prepare(series, initial, all_states)
    return rows, rows.filter(model.order, model.spectral_density, noise_sd, initial, keep)
