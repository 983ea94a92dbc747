"""Headers as laboratories write them, with data made for each: what `info` should propose, or ask.

The simulators are of these tests alone. `TUNED` were written before the rules for roles, `FRESH` after them; of the
latter 17 were right at first sight, 2 asked and 1 was wrong (the pivot of the German pendulum), for which a rule was
added: a displacement that jumps from row to row is noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from bayeq.inspection.contents import RecordInfo
from bayeq.records.names import clean_names

Signals = dict[str, np.ndarray]


@cache
def simulated(data: Callable[[], Signals]) -> Signals:
    """What a simulator gives, of which a file with and one without names are made."""
    return data()


@dataclass(frozen=True)
class Headers:
    """One file: its header, by the signal in each column, its data, and the roles that are true."""

    name: str
    columns: Mapping[str, str]  # header of each column, to the signal in it
    data: Callable[[], Signals]
    chains: tuple[tuple[str, ...], ...]  # signals: a coordinate and its derivatives ("" not measured), or one state
    inputs: tuple[tuple[str, ...], ...] = ()  # inputs; of each the signals that may stand for it

    def text(self) -> str:
        """The file, with semicolons."""
        signals = simulated(self.data)
        table = np.column_stack([signals[key] for key in self.columns.values()])
        rows = "\n".join(";".join(f"{value:.7g}" for value in row) for row in table)
        return ";".join(self.columns) + "\n" + rows + "\n"

    def without_names(self) -> Headers:
        """The same channels as ch1, ch2 ...; time keeps its name."""
        columns = {"t" if key == "t" else f"ch{k}": key for k, key in enumerate(self.columns.values())}
        return replace(self, columns=columns)

    def judge(self, found: RecordInfo) -> str:
        """``right``, ``asks`` (what is proposed is true, the rest is a question), ``silent`` or ``wrong: why``."""
        key_of = dict(zip(clean_names(self.columns)[0], self.columns.values(), strict=True))
        chains = [tuple(key_of[n] if n else "" for n in chain) for chain in found.guess.chains]
        inputs = [key_of[name] for name in found.guess.inputs]
        for chain in chains:
            if not any(
                len(chain) == len(true) and all(a in ("", b) for a, b in zip(chain, true, strict=True))
                for true in self.chains
            ):
                return f"wrong: chain {chain}"
        for true in self.chains:
            if sum(len(chain) == len(true) and bool(set(chain) & set(true) - {""}) for chain in chains) > 1:
                return f"wrong: {true} in two chains"
        for key in inputs:
            if not any(key in one for one in self.inputs):
                return f"wrong: input {key}"
        if any(len(set(one) & set(inputs)) > 1 for one in self.inputs):
            return f"wrong: one input twice, {inputs}"
        have = {key for chain in chains for key in chain} | set(inputs)
        lacking = [key for chain in self.chains for key in chain if key and key not in have]
        lacking += [one[0] for one in self.inputs if not have & set(one)]
        if not lacking:
            return "right"
        notes = " ".join(found.proposal.notes)
        name_of = {key: name for name, key in key_of.items()}
        named = [key for key in lacking if name_of[key] in notes]
        return "asks" if len(named) == len(lacking) or not chains else f"silent: {lacking}"


# --- simulators ------------------------------------------------------------------------------------------------------


def solve(rate: Callable[[float, np.ndarray], list[float]], start: list[float], t: np.ndarray) -> np.ndarray:
    """States at the times `t` by Runge and Kutta's fourth order, (n, states)."""
    out = np.empty((len(t), len(start)))
    out[0] = start
    for k in range(len(t) - 1):
        h, y = t[k + 1] - t[k], out[k]
        k1 = np.array(rate(t[k], y))
        k2 = np.array(rate(t[k] + h / 2, y + h / 2 * k1))
        k3 = np.array(rate(t[k] + h / 2, y + h / 2 * k2))
        k4 = np.array(rate(t[k] + h, y + h * k3))
        out[k + 1] = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return out


def noisy(signals: Signals, share: float = 0.01, seed: int = 0) -> Signals:
    """Signals with white noise, a share of each one's standard deviation; time as it is."""
    rng = np.random.default_rng(seed)
    return {k: v if k == "t" else v + share * np.std(v) * rng.normal(size=len(v)) for k, v in signals.items()}


def tones(t: np.ndarray, seed: int, low: float, high: float, count: int = 12) -> np.ndarray:
    """A sum of sines of random phase from `low` to `high` [Hz], of standard deviation 1."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(low, high, count), rng.uniform(0, 2 * np.pi, count)
    return np.sin(2 * np.pi * np.outer(t, f) + phase).sum(1) / np.sqrt(count / 2)


def oscillator(n: int = 3000, fs: float = 200.0, k: float = 400.0, c: float = 1.5, cubic: float = 2e5) -> Signals:
    """A mass of 1 kg on a hardening spring: metres, seconds, newtons."""
    t = np.arange(n) / fs
    force = 4.0 * tones(t, 1, 0.5, 8.0)
    y = solve(lambda s, y: [y[1], np.interp(s, t, force) - k * y[0] - c * y[1] - cubic * y[0] ** 3], [0.01, 0.0], t)
    a = force - k * y[:, 0] - c * y[:, 1] - cubic * y[:, 0] ** 3
    return {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a, "F": force}


def heavy(n: int = 3000, fs: float = 200.0) -> Signals:
    """A mass of 2 kg on a rail, pushed to and fro: the force is nearly mass times acceleration."""
    t = np.arange(n) / fs
    force = 4.0 * tones(t, 2, 0.8, 6.0)
    y = solve(lambda s, y: [y[1], np.interp(s, t, force) / 2.0 - 0.4 * y[1]], [0.0, 0.0], t)
    return {"t": t, "x": y[:, 0], "v": y[:, 1], "a": force / 2.0 - 0.4 * y[:, 1], "F": force}


def loop(n: int = 4000, fs: float = 200.0) -> Signals:
    """A motor with a load that follows a reference: r, voltage u, torque M of a current that lags, angle, speed."""
    t = np.arange(n) / fs
    r = 0.5 * tones(t, 3, 0.1, 1.5)

    def command(s: float, y: np.ndarray) -> float:
        return 8.0 * (np.interp(s, t, r) - y[0]) - 0.8 * y[1]

    def rate(s: float, y: np.ndarray) -> list[float]:
        return [y[1], (y[2] - 0.02 * y[1] - 0.05 * np.tanh(y[1] / 0.02)) / 0.02, (0.1 * command(s, y) - y[2]) / 0.004]

    y = solve(rate, [0.0, 0.0, 0.0], t)
    u = np.array([command(s, row) for s, row in zip(t, y, strict=True)])
    a = np.array([rate(s, row)[1] for s, row in zip(t, y, strict=True)])
    return {"t": t, "r": r, "u": u, "M": y[:, 2], "x": y[:, 0], "v": y[:, 1], "a": a, "e": r - y[:, 0]}


def pendulum(n: int = 4000, fs: float = 200.0) -> Signals:
    """A pendulum that swings out, on a pivot that shakes a little at random."""
    t = np.arange(n) / fs
    y = solve(lambda s, y: [y[1], -9.81 / 0.3 * np.sin(y[0]) - 0.15 * y[1]], [2.0, 0.0], t)
    rng = np.random.default_rng(4)
    px, py = 1e-4 * rng.normal(size=(2, n))
    a = -9.81 / 0.3 * np.sin(y[:, 0]) - 0.15 * y[:, 1]
    return {"t": t, "x": y[:, 0], "v": y[:, 1], "a": a, "px": px, "py": py}


def two_masses(n: int = 4000, fs: float = 200.0) -> Signals:
    """Two masses in a row, the second one pushed."""
    t = np.arange(n) / fs
    force = 5.0 * tones(t, 5, 0.5, 7.0)

    def rate(s: float, y: np.ndarray) -> list[float]:
        spring = 300.0 * (y[2] - y[0]) + 2.0 * (y[3] - y[1])
        return [y[1], spring - 200.0 * y[0] - y[1], y[3], (np.interp(s, t, force) - spring) / 0.7]

    y = solve(rate, [0.01, 0.0, -0.01, 0.0], t)
    a = np.array([rate(s, row) for s, row in zip(t, y, strict=True)])
    return {
        "t": t,
        "x1": y[:, 0],
        "v1": y[:, 1],
        "a1": a[:, 1],
        "x2": y[:, 2],
        "v2": y[:, 3],
        "a2": a[:, 3],
        "F": force,
    }


def oven(n: int = 2000, step: float = 5.0) -> Signals:
    """Temperature of a block with a heater that is switched: seconds, degrees, watts; a room whose warmth drifts."""
    t = step * np.arange(n)
    rng = np.random.default_rng(6)
    power = np.repeat(rng.integers(0, 5, n // 50 + 1) * 10.0, 50)[:n]
    room = 21.0 + 0.8 * np.sin(2 * np.pi * t / 9000.0)
    at = lambda s, values: np.interp(s, t, values)  # noqa: E731
    y = solve(lambda s, y: [(at(s, power) - 0.4 * (y[0] - at(s, room))) / 250.0], [21.0], t)
    return {"t": t, "T": y[:, 0], "P": power, "room": room}


def populations(years: int = 91) -> Signals:
    """Prey and predators in thousands, once a year."""
    fine = np.arange(0.0, years - 0.95, 0.05)
    rates = lambda s, y: [0.55 * y[0] - 0.026 * y[0] * y[1], 0.026 * y[0] * y[1] - 0.84 * y[1]]  # noqa: E731
    y = solve(rates, [30.0, 9.0], fine)[::20][:years]
    return {"t": 1900.0 + np.arange(years), "prey": y[:, 0], "predators": y[:, 1]}


def days(n: int = 120) -> Signals:
    """Prey and predators in a vessel, once a day."""
    fine = np.arange(0.0, n - 0.95, 0.05)
    rates = lambda s, y: [0.6 * y[0] * (1 - y[0] / 9) - 0.4 * y[0] * y[1], 0.3 * y[0] * y[1] - 0.5 * y[1]]  # noqa: E731
    y = solve(rates, [3.0, 0.5], fine)[::20][:n]
    return {"t": np.arange(float(n)), "prey": y[:, 0], "predators": y[:, 1]}


def tanks(n: int = 3000, step: float = 1.0) -> Signals:
    """Levels of two tanks, one above the other, in centimetres, and the voltage of the pump."""
    t = step * np.arange(n)
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(2.0, 8.0, n // 60 + 1), 60)[:n]

    def rate(s: float, y: np.ndarray) -> list[float]:
        out = [0.12 * np.sqrt(max(level, 0.0)) for level in y]
        return [0.08 * u[min(int(s / step), n - 1)] - out[0], out[0] - out[1]]

    y = solve(rate, [9.0, 9.0], t)
    return {"t": t, "h1": y[:, 0], "h2": y[:, 1], "u": u}


def scaled(made: Signals, **factors: float) -> Signals:
    """Signals in other units."""
    return {key: values * factors.get(key, 1.0) for key, values in made.items()}


def _with_foundation() -> Signals:
    """The oscillator with an accelerometer on its heavy foundation, which hardly moves."""
    made = noisy(oscillator())
    rng = np.random.default_rng(8)
    return scaled({**made, "base": 0.02 * rng.normal(size=len(made["t"]))}, x=1e3, a=1 / 9.81, F=1e-3)


TUNED = (
    Headers(
        "German, leftover words",
        {"Zeit [s]": "t", "Weg Laser [mm]": "x", "Beschleunigung [g]": "a", "Kraft [N]": "F"},
        lambda: scaled(noisy(oscillator()), x=1e3, a=1 / 9.81),
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "names of sensors",
        {"Time (s)": "t", "LVDT": "x", "Accel 1": "a", "Load cell": "F"},
        lambda: scaled(noisy(oscillator()), x=1e3, a=1 / 9.81),
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "numbers of channels, force first",
        {"t": "t", "ch1": "F", "ch2": "x", "ch3": "v"},
        lambda: noisy(oscillator()),
        (("x", "v", ""),),
        (("F",),),
    ),
    Headers(
        "closed loop",
        {"time": "t", "reference [rad]": "r", "command [V]": "u", "measured position [rad]": "x"},
        lambda: noisy(loop(), 0.003),
        (("x", "", ""),),
        (("u",),),
    ),
    Headers(
        "a controller's voltage beside the torque",
        {"Time [s]": "t", "Angle [deg]": "x", "Speed [rpm]": "v", "Motor Voltage [V]": "u", "Torque [Nm]": "M"},
        lambda: scaled(noisy(loop(), 0.003), x=180 / np.pi, v=30 / np.pi),
        (("x", "v", ""),),
        (("M", "u"),),
    ),
    Headers(
        "pivot jitter",
        {"t": "t", "theta [rad]": "x", "omega [rad/s]": "v", "pivot x [mm]": "px", "pivot y [mm]": "py"},
        lambda: scaled(noisy(pendulum(), 0.003), px=1e3, py=1e3),
        (("x", "v", ""),),
    ),
    Headers(
        "heater",
        {"Time [min]": "t", "Temperature [°C]": "T", "Heater Power [W]": "P"},
        lambda: scaled(noisy(oven(), 0.002), t=1 / 60),
        (("T",),),
        (("P",),),
    ),
    Headers(
        "populations by year",
        {"year": "t", "Hare": "prey", "Lynx": "predators"},
        lambda: noisy(populations(), 0.01),
        (("prey",), ("predators",)),
    ),
    Headers(
        "French",
        {
            "Temps [s]": "t",
            "Déplacement [mm]": "x",
            "Vitesse [mm/s]": "v",
            "Accélération [m/s²]": "a",
            "Effort [N]": "F",
        },
        lambda: scaled(noisy(oscillator()), x=1e3, v=1e3),
        (("x", "v", "a"),),
        (("F",),),
    ),
    Headers(
        "German closed loop",
        {"Zeit": "t", "Sollwinkel [°]": "r", "Istwinkel [°]": "x", "Strom [A]": "u"},
        lambda: scaled(noisy(loop(), 0.003), r=180 / np.pi, x=180 / np.pi),
        (("x", "", ""),),
        (("u",),),
    ),
    Headers(
        "a testing machine in inches",
        {"Time": "t", "Disp. (in)": "x", "Force (lbf)": "F"},
        lambda: scaled(noisy(oscillator()), x=39.37, F=0.2248),
        (("x", "", ""),),
        (("F",),),
    ),
    Headers(
        "two masses",
        {"t": "t", "x1 [mm]": "x1", "x2 [mm]": "x2", "a1 [g]": "a1", "a2 [g]": "a2", "F [N]": "F"},
        lambda: scaled(noisy(two_masses()), x1=1e3, x2=1e3, a1=1 / 9.81, a2=1 / 9.81),
        (("x1", "", "a1"), ("x2", "", "a2")),
        (("F",),),
    ),
    Headers(
        "German populations by day",
        {"Tag": "t", "Beute": "prey", "Räuber": "predators"},
        lambda: noisy(days(), 0.01),
        (("prey",), ("predators",)),
    ),
    Headers(
        "one of two accelerometers",
        {"Time (s)": "t", "LVDT (mm)": "x", "Acc 1 (g)": "base", "Acc 2 (g)": "a", "Load (kN)": "F"},
        _with_foundation,
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "letters of control",
        {"t": "t", "r": "r", "u": "u", "y": "x"},
        lambda: noisy(loop(), 0.003),
        (("x", "", ""),),
        (("u",),),
    ),
    Headers(
        "numbers of channels, a force like the acceleration",
        {"t": "t", "ch1": "x", "ch2": "F", "ch3": "a"},
        lambda: noisy(heavy(), 0.01),
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "command and measured torque",
        {"time": "t", "gyro z [deg/s]": "v", "encoder [deg]": "x", "torque cmd [Nm]": "u", "torque meas [Nm]": "M"},
        lambda: scaled(noisy(loop(), 0.003), x=180 / np.pi, v=180 / np.pi, u=0.1),
        (("x", "v", ""),),
        (("M", "u"),),
    ),
    Headers(
        "raw volts of sensors",
        {"Zeit [s]": "t", "Wegaufnehmer [V]": "x", "Beschleunigungsaufnehmer [V]": "a", "Kraftmessdose [V]": "F"},
        lambda: scaled(noisy(oscillator()), x=50.0, a=0.02, F=0.3),
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "tanks",
        {"Time [s]": "t", "Pump voltage [V]": "u", "Level 1 [cm]": "h1", "Level 2 [cm]": "h2"},
        lambda: noisy(tanks(), 0.002),
        (("h1",), ("h2",)),
        (("u",),),
    ),
    Headers(
        "French closed loop",
        {"temps": "t", "consigne": "r", "commande": "u", "position mesurée": "x"},
        lambda: noisy(loop(), 0.003),
        (("x", "", ""),),
        (("u",),),
    ),
)


def thermostat(n: int = 2500, step: float = 4.0) -> Signals:
    """A block under proportional and integral control: set point, per cent of the heater, temperature."""
    t = step * np.arange(n)
    rng = np.random.default_rng(9)
    wanted = np.repeat(rng.uniform(30.0, 70.0, n // 250 + 1), 250)[:n]
    T, integral, out = 21.0, 0.0, np.empty((n, 2))
    for k in range(n):
        drive = float(np.clip(4.0 * (wanted[k] - T) + 0.01 * integral, 0.0, 100.0))
        integral += step * (wanted[k] - T) * (0.0 < drive < 100.0)
        out[k] = drive, T
        T += step * (0.6 * drive - 0.4 * (T - 21.0)) / 250.0
    return {"t": t, "r": wanted, "u": out[:, 0], "T": out[:, 1]}


FRESH = (
    Headers(
        "German test rig",
        {"Zeit [ms]": "t", "Federweg vorne [mm]": "x", "Aufbaubeschleunigung [m/s²]": "a", "Zylinderkraft [kN]": "F"},
        lambda: scaled(noisy(oscillator(k=900.0), seed=11), t=1e3, x=1e3, F=1e-3),
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "sensors without units",
        {"Time": "t", "Displacement sensor 3": "x", "Accelerometer top": "a", "Impact hammer": "F"},
        lambda: scaled(noisy(oscillator(), seed=12), x=1e3, a=1 / 9.81),
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "units within names",
        {"t_s": "t", "pos_mm": "x", "vel_mm_s": "v", "acc_m_s2": "a", "force_N": "F"},
        lambda: scaled(noisy(oscillator(), seed=13), x=1e3, v=1e3),
        (("x", "v", "a"),),
        (("F",),),
    ),
    Headers(
        "four numbers of channels",
        {"Time": "t", "CH1": "a", "CH2": "F", "CH3": "x", "CH4": "v"},
        lambda: noisy(oscillator(cubic=0.0), seed=14),
        (("x", "v", "a"),),
        (("F",),),
    ),
    Headers(
        "German drive with wanted and actual speed",
        {
            "Zeit [s]": "t",
            "Winkel Soll [°]": "r",
            "Winkel Ist [°]": "x",
            "Drehzahl Ist [1/min]": "v",
            "Moment [Nm]": "M",
        },
        lambda: scaled(noisy(loop(), 0.003, 15), r=180 / np.pi, x=180 / np.pi, v=30 / np.pi),
        (("x", "v", ""),),
        (("M",),),
    ),
    Headers(
        "process control",
        {"time [s]": "t", "setpoint [°C]": "r", "controller output [%]": "u", "process value [°C]": "T"},
        lambda: noisy(thermostat(), 0.003, 16),
        (("T",),),
        (("u",),),
    ),
    Headers(
        "voltage, current and torque of one motor",
        {
            "t": "t",
            "U_Motor [V]": "u",
            "I_Motor [A]": "i",
            "M_Welle [Nm]": "M",
            "phi_Welle [rad]": "x",
            "om [rad/s]": "v",
        },
        lambda: noisy({**(made := loop()), "i": 10.0 * made["M"]}, 0.005, 17),
        (("x", "v", ""),),
        (("M", "i", "u"),),
    ),
    Headers(
        "German pendulum with a loose pivot",
        {"Zeit": "t", "Pendelwinkel [rad]": "x", "Aufhängung x [m]": "px", "Aufhängung y [m]": "py"},
        lambda: noisy(pendulum(), 0.003, 18),
        (("x", "", ""),),
    ),
    Headers(
        "a block in a room",
        {"Time (s)": "t", "T_block (degC)": "T", "T_ambient (degC)": "room", "Q_heater (W)": "P"},
        lambda: noisy(oven(), 0.002, 19),
        (("T",),),
        (("P",), ("room",)),
    ),
    Headers(
        "German populations by week",
        {"Woche": "t", "Hasen": "prey", "Füchse": "predators"},
        lambda: noisy({**days(), "t": 1.0 + np.arange(120.0)}, 0.01, 20),
        (("prey",), ("predators",)),
    ),
    Headers(
        "French populations by day",
        {"Jour": "t", "Proies (milliers)": "prey", "Prédateurs (milliers)": "predators"},
        lambda: noisy(days(), 0.02, 21),
        (("prey",), ("predators",)),
    ),
    Headers(
        "motor and load",
        {"time": "t", "motor_pos": "x2", "motor_vel": "v2", "load_pos": "x1", "load_vel": "v1", "motor_torque": "F"},
        lambda: noisy(two_masses(), 0.005, 22),
        (("x1", "v1", ""), ("x2", "v2", "")),
        (("F",),),
    ),
    Headers(
        "two displacements, one acceleration",
        {"Zeit [s]": "t", "Weg 1 [mm]": "x1", "Weg 2 [mm]": "x2", "Beschleunigung 2 [g]": "a2", "Kraft [N]": "F"},
        lambda: scaled(noisy(two_masses(), seed=23), x1=1e3, x2=1e3, a2=1 / 9.81),
        (("x1", "", ""), ("x2", "", "a2")),
        (("F",),),
    ),
    Headers(
        "a force and its command",
        {"Time (s)": "t", "Command force (N)": "cmd", "Measured force (N)": "F", "Stroke (mm)": "x"},
        lambda: scaled(noisy({**(made := oscillator()), "cmd": np.roll(made["F"], -3)}, seed=24), x=1e3),
        (("x", "", ""),),
        (("F", "cmd"),),
    ),
    Headers(
        "French hammer",
        {"Temps (s)": "t", "Position laser (µm)": "x", "Accéléromètre (g)": "a", "Marteau (N)": "F"},
        lambda: scaled(noisy(oscillator(), seed=25), x=1e6, a=1 / 9.81),
        (("x", "", "a"),),
        (("F",),),
    ),
    Headers(
        "letters with dots",
        {"t": "t", "f": "F", "x": "x", "xdot": "v", "xddot": "a"},
        lambda: noisy(oscillator(), seed=26),
        (("x", "v", "a"),),
        (("F",),),
    ),
    Headers(
        "angles of a servo",
        {
            "Time (s)": "t",
            "Reference angle (deg)": "r",
            "Actual angle (deg)": "x",
            "Angle error (deg)": "e",
            "Motor current (A)": "M",
        },
        lambda: scaled(noisy(loop(), 0.003, 27), r=180 / np.pi, x=180 / np.pi, e=180 / np.pi),
        (("x", "", ""),),
        (("M",),),
    ),
    Headers(
        "counts, gyro, drive",
        {"time_ms": "t", "Encoder counts": "x", "Gyro": "v", "Shaker drive (V)": "F"},
        lambda: scaled(noisy(oscillator(), seed=28), t=1e3, x=4e4, v=57.3, F=0.5),
        (("x", "v", ""),),
        (("F",),),
    ),
    Headers(
        "inputs of a card",
        {"t": "t", "AI0": "x", "AI1": "v"},
        lambda: noisy(pendulum(), 0.005, 29),
        (("x", "v", ""),),
    ),
    Headers(
        "accelerations alone",
        {"Zeit [s]": "t", "Kraft [N]": "F", "Beschleunigung 1 [g]": "a1", "Beschleunigung 2 [g]": "a2"},
        lambda: scaled(noisy(two_masses(), seed=30), a1=1 / 9.81, a2=1 / 9.81),
        (("", "", "a1"), ("", "", "a2")),
        (("F",),),
    ),
)
