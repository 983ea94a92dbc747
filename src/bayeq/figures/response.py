"""The frequency response from an input to the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.errors import InputError, UnknownNameError
from bayeq.figures.answer import Answer, channel_of
from bayeq.figures.picture import GREY, above, bracketed, frequency_label, picture, plain, two_axes
from bayeq.figures.spectrum import cross_spectrum, even_rate, filled
from bayeq.figures.style import BLACK, BLUE, term_label
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["frequency_response"]

# Frequencies at which the input has less than this share of its largest power are not drawn: nothing is excited there.
DRIVEN = 1e-3

# Where less than this share of the motion follows the input (coherence), what is measured is drawn faint.
COHERENT = 0.5


@picture
def frequency_response(
    eq: Answer, record: Record, ax: Any = None, *, channel: str | None = None, force: str | None = None
) -> tuple[Axes, Axes]:
    """Magnitude and phase of the response of a state to an input, measured and of the free run (H1 estimate, Welch).

    Of a displacement to a force it is the receptance, of a velocity the mobility, of a motion to one of the ground the
    transmissibility. That of a nonlinear system belongs to the level of the record's excitation.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`, with an input.
    record : Record
        Times, evenly sampled, inputs and measured states.
    ax : pair of matplotlib.axes.Axes, optional
        For magnitude and phase; by default those of a new figure.
    channel, force : str, optional
        A measured state and an input; by default the first of each.

    Returns
    -------
    pair of matplotlib.axes.Axes
        Of the frequencies that the input excites; faint where the motion does not follow it (coherence below 0.5).

    Raises
    ------
    InputError
        As `Equations.simulate`; no input, no measured state, sampling that is not even, a free run that blew up.
    UnknownNameError
        Names that are not there.
    MissingExtraError
        matplotlib is not installed.
    """
    if not eq.inputs:
        raise InputError("the equations have no input: there is no response to it")
    source = force or eq.inputs[0]
    if source not in eq.inputs:
        raise UnknownNameError("input", source, eq.inputs)
    run = eq.simulate(record, draws=0)
    name = channel_of(run, channel)
    if run.blew_up_at is not None:
        raise InputError(f"the free run blew up at {run.blew_up_at:.6g} s: it has no frequency response")
    fs = even_rate(run.time, record.name or "record")
    rows = eq.motion(record)
    times = run.time if rows.time is None else rows.time
    u = np.interp(run.time, times, filled(rows.samples[source]))
    f, power = cross_spectrum(u, u, fs)
    driven = power.real >= DRIVEN * power.real.max()
    axes = two_axes(ax, upper=36.0, lower=22.0)
    looks: tuple[dict[str, Any], ...] = (
        {"color": BLACK, "linewidth": 1.4, "label": "measured"},
        {"color": BLUE, "linewidth": 0.9, "linestyle": (0, (4, 1.2)), "label": "free run"},
    )
    for values, look in zip((filled(run.measured[name]), run.mean[name]), looks, strict=True):
        cross = cross_spectrum(u, values, fs)[1]
        coherence = np.abs(cross) ** 2 / (power.real * cross_spectrum(values, values, fs)[1].real)
        response = np.where(driven, cross / power, np.nan)
        # from -270 to 90 degrees: that of an oscillator does not jump between 180 and -180
        phase = (np.degrees(np.angle(response)) + 270.0) % 360.0 - 270.0
        if look["label"] == "measured":  # what does not follow the input is there, but faint
            axes[0].semilogy(f, np.abs(response), color=GREY, linewidth=0.6, label=f"coherence below {COHERENT:g}")
            axes[1].plot(f, np.where(coherence < COHERENT, phase, np.nan), ".", color=GREY, markersize=2.5)
            response, phase = (np.where(coherence >= COHERENT, part, np.nan) for part in (response, phase))
        axes[0].semilogy(f, np.abs(response), **look)
        axes[1].plot(f, phase, **look)
    units = {key: unit for equation in eq.equations for key, unit in equation.units.items()}
    axes[0].set_ylabel(plain(f"|{name}/{source}|{_unit(units.get(name), units.get(source))}"))
    axes[1].set_ylabel("phase [°]")
    axes[1].set_yticks([-270, -180, -90, 0, 90])
    axes[1].set_ylim(-280.0, 100.0)
    axes[1].set_xlabel(frequency_label(eq))
    axes[1].set_xlim(0.0, float(f[driven].max()))
    axes[0].set_title(f"response of {term_label(name)} to {term_label(source)}")
    above(axes[0])
    return axes


def _unit(above_line: str | None, below: str | None) -> str:
    return f" [{bracketed(above_line)}/{bracketed(below)}]" if above_line and below else ""
