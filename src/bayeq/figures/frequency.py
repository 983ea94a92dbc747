"""Frequencies: spectra of measured and simulated motion, and the frequency response from an input to the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.arrays import Complexes, Floats
from bayeq.errors import InputError
from bayeq.figures import style
from bayeq.figures.runs import DRAWN, MEASURED
from bayeq.records import Record
from bayeq.states.sensors import bridged

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Number of segments of a spectrum, which overlap by half.
SEGMENTS = 8

# Segments of a frequency response: fewer, as a resonance needs long ones; in long records sqrt(n/ROWS_PER_SEGMENT).
LEAST_SEGMENTS, ROWS_PER_SEGMENT = 5, 160
LEAST_ROWS = 32

# Spectra end at this multiple of the last frequency at which the run is above the residual.
TAIL = 2.0

# Frequencies at which the input has less than this share of its largest power are not drawn: nothing is excited there.
DRIVEN = 1e-3

# The measured response is drawn faint where its coherence with the input is below this.
COHERENT = 0.5


def _whole_run(eq: style.Answer, record: Record, channel: str | None, what: str) -> tuple[style.Run, str, float]:
    """The free run over the whole record, the state asked for, and the sampling rate [Hz]."""
    run = eq.simulate(record, draws=0)
    name = style.channel_of(run, channel)
    if run.blew_up_at is not None:
        raise InputError(f"the free run blew up at {run.blew_up_at:.6g} s: it has no {what}")
    where = record.label
    if len(run.time) < LEAST_ROWS:
        raise InputError(f"{where}: a spectrum needs {LEAST_ROWS} rows or more, there are {len(run.time)}")
    steps = np.diff(run.time)
    step = float(np.median(steps))
    if float(np.abs(steps - step).max()) > 1e-3 * step:  # even to a thousandth
        raise InputError(f"{where}: a spectrum needs even sampling; resample the record first")
    return run, name, 1.0 / step


def _cross_spectrum(x: Floats, y: Floats, fs: float, segments: int = SEGMENTS) -> tuple[Floats, Complexes]:
    """Frequencies [Hz] above zero and the cross spectral density of two channels, by Welch's method (1967).

    Hann windows over segments that overlap by half, each less its mean; densities are one-sided.
    """
    from scipy.signal import csd

    length = max(LEAST_ROWS, int(2.0 * len(x) / (segments + 1)))
    f, density = csd(x, y, fs=fs, nperseg=min(length, len(x)))
    return np.asarray(f[1:]), np.asarray(density[1:], dtype=np.complex128)


@style.picture
def spectra(eq: style.Answer, record: Record, ax: Any = None, *, channel: str | None = None) -> Axes:
    """Power spectral densities of a measured state, of the free run over the whole record, and of their difference.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record
        Times, evenly sampled, inputs and measured states.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    channel : str, optional
        A measured state; by default the first.

    Returns
    -------
    matplotlib.axes.Axes
        Densities by Welch's method, eight segments that overlap by half.

    Raises
    ------
    InputError
        As `Equations.simulate`; no state is measured, sampling that is not even, a free run that blew up.
    UnknownNameError
        A channel that is no measured state.
    MissingExtraError
        matplotlib is not installed.
    """
    run, name, fs = _whole_run(eq, record, channel, "spectrum")
    measured, simulated = bridged(run.measured[name]), run.mean[name]
    (ax,) = style.axes_for(ax, [70.0], style.SINGLE_COLUMN)
    curves = (
        (measured, MEASURED),
        (simulated, {**DRAWN, "label": "free run"}),
        (measured - simulated, {"color": style.ORANGE, "linewidth": 0.8, "label": "difference"}),
    )
    densities = []
    for values, look in curves:
        f, density = _cross_spectrum(values, values, fs)
        ax.semilogy(f, density.real, **look)
        densities.append(density.real)
    whole, run_s, left = densities
    above_noise = np.flatnonzero(run_s > left)  # beyond, the run is below the residual
    last = TAIL * float(f[above_noise[-1]]) if len(above_noise) else fs
    highest, least = float(whole.max()), float(np.minimum(whole, left)[f <= last].min())
    ax.set(xlim=(0.0, min(last, fs / 2.0)), ylim=(max(0.1 * least, 1e-12 * highest), 3.0 * highest))
    per = style.frequency_unit(eq)
    ax.set_xlabel(f"frequency [{per}]")
    unit = eq.units.get(name, "")
    unit = f"{style.bracketed(unit)}²/{style.bracketed(per)}" if unit else per[2:] or "1/Hz"
    ax.set_ylabel(style.plain(f"PSD of {name} [{unit}]"))
    style.above(ax)
    return ax


@style.picture
def frequency_response(
    eq: style.Answer, record: Record, ax: Any = None, *, channel: str | None = None, force: str | None = None
) -> tuple[Axes, Axes]:
    """Magnitude and phase of the response of a state to an input, measured and of the free run (H1 estimate, Welch).

    For a force, it is the receptance of a displacement and the mobility of a velocity; for a motion of the ground, the
    transmissibility. For a nonlinear system it holds at the level of the record's excitation.

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
        Magnitude and phase at the frequencies that the input excites; faint where the coherence is below 0.5. A new
        figure has the coherence in a third panel.

    Raises
    ------
    InputError
        As `Equations.simulate`; no input, no measured state, sampling that is not even, a free run that blew up.
    UnknownNameError
        No such input or measured state.
    MissingExtraError
        matplotlib is not installed.
    """
    if not eq.inputs:
        raise InputError("the equations have no input: there is no response to it")
    source = style.named("input", force, eq.inputs)
    run, name, fs = _whole_run(eq, record, channel, "frequency response")
    rows = eq.motion(record)
    times = run.time if rows.time is None else rows.time
    u = np.interp(run.time, times, bridged(rows.samples[source]))
    count = max(LEAST_SEGMENTS, int(np.sqrt(len(u) / ROWS_PER_SEGMENT)))
    f, power = _cross_spectrum(u, u, fs, count)
    driven = power.real >= DRIVEN * power.real.max()
    heights = [52.0, 32.0] if ax is not None else [48.0, 28.0, 22.0]
    upper, lower, *third = style.axes_for(ax, heights, style.FULL_WIDTH, sharex=True)
    looks: tuple[dict[str, Any], ...] = (MEASURED, {**DRAWN, "label": "free run"})
    for values, look in zip((bridged(run.measured[name]), run.mean[name]), looks, strict=True):
        cross = _cross_spectrum(u, values, fs, count)[1]
        coherence = np.abs(cross) ** 2 / (power.real * _cross_spectrum(values, values, fs, count)[1].real)
        for one in third:
            one.plot(f, np.where(driven, coherence, np.nan), **look)
        response = np.where(driven, cross / power, np.nan)
        # from -270 to 90 degrees: that of an oscillator does not jump between 180 and -180
        phase = (np.degrees(np.angle(response)) + 270.0) % 360.0 - 270.0
        if look["label"] == "measured":  # incoherent parts are drawn faint
            faint = MEASURED | {"color": style.PALE, "label": f"coherence below {COHERENT:g}"}
            upper.plot(f, np.abs(response), **faint)
            lower.plot(f, np.where(coherence < COHERENT, phase, np.nan), ".", color=style.GREY, markersize=2.5)
            response, phase = (np.where(coherence >= COHERENT, part, np.nan) for part in (response, phase))
        upper.plot(f, np.abs(response), **look)
        lower.plot(f, phase, **look)
    over, below = (eq.units.get(one) for one in (name, source))
    unit = f" [{style.bracketed(over)}/{style.bracketed(below)}]" if over and below else ""
    title = f"response of {style.term_label(name)} to {style.term_label(source)}"
    upper.set(yscale="log", ylabel=style.plain(f"|{name}/{source}|{unit}"), title=title)
    lower.set(ylabel="phase [°]", yticks=[-270, -180, -90, 0, 90], ylim=(-280.0, 100.0))
    for one in third:
        one.set(ylabel="coherence", ylim=(0.0, 1.05))
    last = (third or [lower])[0]
    across = f"frequency [{style.frequency_unit(eq)}], resolved to {float(f'{f[0]:.2g}'):g}"
    last.set(xscale="log", xlim=(float(f[0]), float(f[driven].max())), xlabel=across)
    style.log_ticks(last.xaxis)
    style.above(upper)
    return upper, lower
