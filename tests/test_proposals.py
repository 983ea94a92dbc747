"""What `info` proposes for channels of a base, a fall, angles without a unit, a tank, two masses and a wrong rate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayeq as bq
from bayeq.arrays import Floats


def forced(right, initial, n=3000, fs=200.0, seed=0, top=12.0):
    """States of dy/dt = right(y, u(t)) for u of lines up to `top` Hz; time, states (S, n), u."""
    rng = np.random.default_rng(seed)
    lines = 2.0 * np.pi * np.linspace(0.5, top, 25)
    phases = rng.uniform(0.0, 2.0 * np.pi, 25)
    t = np.arange(n) / fs

    def u(at: float | Floats) -> Floats:
        return np.asarray(np.sin(np.multiply.outer(at, lines) + phases).sum(axis=-1))

    run = solve_ivp(lambda at, y: right(y, float(u(at))), (0.0, t[-1]), initial, "DOP853", t, rtol=1e-9, atol=1e-10)
    return t, run.y, u(t)


def noisy(t, seed=1, noise=0.01, **channels):
    rng = np.random.default_rng(seed)
    return bq.Record.from_arrays(
        {name: one + noise * one.std() * rng.standard_normal(len(t)) for name, one in channels.items()}, time=t
    )


def test_an_absolute_acceleration_beside_that_of_its_base_is_not_used() -> None:
    t, (z, w), base = forced(lambda y, u: [y[1], -u - 1.6 * y[1] - 1500.0 * y[0]], [0.0, 0.0])
    found = bq.info(noisy(t, rel_disp=z, mass_acc=-1.6 * w - 1500.0 * z, base_acc=base))
    assert found.proposal.python == "bq.discover(record, displacement='rel_disp', force='base_acc')"
    assert (
        "mass_acc - base_acc is the second derivative of rel_disp; as rel_disp::mass_acc: --remove-offset"
        " mass_acc=base_acc" in " ".join(str(found).split())
    )
    lost = noisy(t, rel_disp=z, mass_acc=-1.6 * w - 1500.0 * z, base_acc=base)
    gap = np.where(np.arange(len(t)) == 7, np.nan, lost["base_acc"])
    assert bq.info(lost.with_channels({"base_acc": gap})).proposal.complete
    # an acceleration against the base is the second derivative of the displacement by itself
    relative = bq.info(noisy(t, rel_disp=z, mass_acc=-base - 1.6 * w - 1500.0 * z, base_acc=base))
    assert "acceleration='mass_acc'" in relative.proposal.python


def test_a_speed_that_hardly_turns_back_is_of_first_order() -> None:
    def proposed(v: Floats, force: Floats) -> str:
        record = noisy(t, velocity=v, force=force)
        return bq.info(bq.Record(record.channels, t, {"velocity": "m/s"})).proposal.python

    t, (v,), u = forced(lambda y, u: [0.2 * (u + 30.0) - 0.1 * y[0] - 0.02 * y[0] ** 2], [0.0])
    assert proposed(v, u + 30.0).startswith("bq.discover(record, chains=['velocity'], inputs=['force']")
    t, (_, v), u = forced(lambda y, u: [y[1], u - 0.5 * y[1] - 200.0 * y[0]], [0.0, 0.0])
    assert proposed(v, u) == "bq.discover(record, velocity='velocity', force='force')"


@pytest.mark.parametrize(("unit", "asked"), [("rad", False), ("deg", True)])
def test_an_angle_without_a_unit_that_would_turn_to_and_fro_is_in_degrees(unit: str, asked: bool) -> None:
    t, (x, _), _ = forced(lambda y, u: [y[1], -0.15 * y[1] - 21.8 * np.sin(y[0])], [1.6, 0.0])
    found = bq.info(noisy(t, theta=x * (180.0 / np.pi if asked else 1.0)))
    assert ("taken in degrees" in str(found)) == asked
    assert ("sin(pi*theta/180)" in found.proposal.python) == asked


def test_a_level_above_zero_has_a_root_among_its_terms() -> None:
    t, (level,), u = forced(lambda y, u: [0.03 * (u + 25.0) - 0.12 * np.sqrt(y[0])], [40.0], n=1500, fs=1.0, top=0.02)
    assert "dictionary='polynomial:3 + sqrt(level)'" in bq.info(noisy(t, level=level, inflow=u + 25.0)).proposal.python
    below = noisy(t, level=level - level.mean(), inflow=u + 25.0)
    assert "sqrt" not in bq.info(below).proposal.python


def test_masses_in_a_row_are_offered_their_neighbours() -> None:
    t, y, u = forced(
        lambda y, u: [y[2], y[3], u - 900 * y[0] + 500 * (y[1] - y[0]), -800 * (y[1] - y[0]) - y[3]], [0.0] * 4
    )
    record = noisy(t, x1=y[0], x2=y[1], u=u)
    found = bq.info(bq.Record(record.channels, t, {"x1": "mm", "x2": "mm"}))
    assert "neighbours" not in bq.info(record).proposal.python  # which may be angles
    assert "dictionary='neighbours'" in found.proposal.python


def storeys(seed=0):
    """Displacements [mm] against the ground and accelerations [m/s^2] of three storeys in their first mode, ground."""
    rows = np.array([[1500.0, -700.0, 0.0], [-700.0, 1200.0, -500.0], [0.0, -625.0, 625.0]])
    t, y, u = forced(lambda y, u: [*y[3:], *(-u - rows @ y[:3] - 0.002 * rows @ y[3:])], [0.0] * 6, seed=seed)
    return t, 1e3 * y[:3], -rows @ y[:3] - 0.002 * rows @ y[3:], u


def test_storeys_of_one_mode_are_coordinates_and_a_sensor_twice_is_not() -> None:
    t, x, _, ground = storeys()
    record = noisy(t, ag=ground, x1=x[0], x2=x[1], x3=x[2])
    expected = "chains=['x1::', 'x2::', 'x3::'], inputs=['ag'], dictionary='neighbours')"
    assert bq.info(record).proposal.python == f"bq.discover(record, {expected}"
    delayed = bq.Record({"F": ground, "Weg_1": x[0], "Weg_2": np.roll(x[0], 3)}, t)
    assert "Weg_2 moves nearly as Weg_1 does: if both measure one point" in str(bq.info(delayed))
    twice = noisy(t, ag=ground, Floor_1=x[0], Floor_2=x[1], Floor_2_laser=x[1])
    found = bq.info(bq.Record(twice.channels, t, dict.fromkeys(("Floor_1", "Floor_2", "Floor_2_laser"), "mm")))
    assert found.guess.chains == (("Floor_1", None, None), ("Floor_2", None, None))
    other = "--chain Floor_1:: --chain Floor_2:: --chain Floor_2_laser:: --input ag --dictionary neighbours"
    assert f"Floor_2_laser is not used: it moves as Floor_2 does; as a coordinate: {other}" in found.proposal.notes
    rounded = bq.Record(
        {"F": ground, "Weg_1": x[0], "Weg_2": x[0].round(1)}, t, {"Weg_1": "mm", "Weg_2": "mm", "F": "N"}
    )
    assert bq.info(rounded).guess.chains == (("Weg_1", None, None),)


@pytest.mark.parametrize("unit", ["g", ""])
def test_accelerations_of_storeys_are_neighbours_and_may_be_absolute(unit) -> None:
    t, _, a, ground = storeys()
    record = noisy(t, Acc_ground=ground, Acc_1=a[0], Acc_2=a[1], Acc_3=a[2])
    found = bq.info(bq.Record(record.channels, t, dict.fromkeys(record.channels, unit) if unit else {}))
    expected = "chains=['::Acc_1', '::Acc_2', '::Acc_3'], inputs=['Acc_ground'], dictionary='neighbours')"
    assert found.proposal.python == f"bq.discover(record, {expected}"
    absolute = "the law is of motion against the base: if Acc_1, Acc_2, Acc_3 are absolute, subtract Acc_ground first"
    told = str(found).replace("\n    ", " ")
    assert f"{absolute}: --remove-offset Acc_1=Acc_ground --remove-offset Acc_2=Acc_ground" in told
    alone = bq.info(bq.Record({name: record[name] for name in ("Acc_ground", "Acc_3")}, t))
    assert "if Acc_3 is absolute, subtract Acc_ground first" in str(alone)


def test_accelerations_that_follow_their_base_at_low_frequency_are_absolute(tmp_path) -> None:
    t, (z, w), base = forced(lambda y, u: [y[1], -u - 2.0 * y[1] - 1500.0 * y[0]], [0.0, 0.0])
    absolute = -2.0 * w - 1500.0 * z
    record = noisy(t, base_acc=base, mass_acc=absolute)
    found = bq.info(record)
    read = "bq.discover(bq.remove_offset(record, 'mass_acc', 'base_acc'), acceleration='mass_acc', force='base_acc')"
    assert found.proposal.python == read
    assert any("mass_acc follows base_acc at low frequency" in note for note in found.proposal.notes)
    bq.write(record, tmp_path / "run.csv")
    part = bq.info(tmp_path / "run.csv", rows=slice(0, 2900)).proposal
    assert "run.csv --remove-offset mass_acc=base_acc --rows 0:2900 --acc mass_acc" in str(part.command)
    assert ".take(slice(0, 2900)), 'mass_acc', 'base_acc'), acceleration='mass_acc'" in part.python
    # against the base, or from above the resonance on, it is not known
    relative = bq.info(noisy(t, base_acc=base, mass_acc=absolute - base))
    assert relative.proposal.python == "bq.discover(record, acceleration='mass_acc', force='base_acc')"
    assert any("if mass_acc is absolute, subtract base_acc first" in note for note in relative.proposal.notes)
    t, (z, w), base = forced(lambda y, u: [y[1], -u - 0.3 * y[1] - 2.0 * y[0]], [0.0, 0.0])
    assert "remove_offset" not in bq.info(noisy(t, base_acc=base, mass_acc=-0.3 * w - 2.0 * z)).proposal.python


@pytest.mark.parametrize("name", ["shaker_table_acc", "Tisch_Beschl", "acc_floor0", "platform_acc"])
def test_a_base_above_the_resonance_is_no_reversed_acceleration(name) -> None:
    t, (x, v), ground = forced(lambda y, u: [y[1], -u - 0.7 * y[1] - 190.0 * y[0]], [0.0, 0.0], top=15.0)
    record = noisy(t, **{name: ground / 9.80665, "roof_rel_disp": 1e3 * x, "roof_rel_vel": 1e3 * v})
    found = bq.info(bq.Record(record.channels, t, {name: "g", "roof_rel_disp": "mm", "roof_rel_vel": "mm/s"}))
    expected = f"displacement='roof_rel_disp', velocity='roof_rel_vel', force='{name}')"
    assert found.proposal.python == f"bq.discover(record, {expected}"
    assert ("is reversed: --vel roof_rel_vel" in str(found)) == (name == "platform_acc")
    # of the same place it is reversed, and a base that alone moves is no base
    own = bq.Record({"roof_disp": 1e3 * x, "roof_acc": (ground + 0.7 * v + 190.0 * x) / 9.80665}, t)
    assert "opposite sign" in str(bq.info(own))
    moving = bq.Record({"table_pos": x, "table_acc": -ground - 0.7 * v - 190.0 * x, "F": ground}, t, {"F": "N"})
    assert bq.info(moving).guess.chains == (("table_pos", None, "table_acc"),)


@pytest.mark.parametrize("unit", ["rpm", "1/min", "deg/s"])
def test_a_speed_of_rotation_is_no_derivative_of_a_length(unit) -> None:
    t, (x, v), u = forced(lambda y, u: [y[1], u - 0.7 * y[1] - 190.0 * y[0]], [0.0, 0.0])
    record = noisy(t, Brg_disp=1e6 * x, Brg_acc=u - 0.7 * v - 190.0 * x, Speed=1800 + 60 * t, Force=u)
    units = {"Brg_disp": "um", "Brg_acc": "m/s^2", "Speed": unit, "Force": "N"}
    found = bq.info(bq.Record(record.channels, t, units))
    assert found.guess.chains == (("Brg_disp", None, "Brg_acc"),)
    assert found.guess.inputs == ("Force",)
    assert "not used: Speed; an input" in str(found)


@pytest.mark.parametrize(("name", "unit"), [("base_laser", "mm"), ("Weg_Fundament", "mm"), ("table_disp", "")])
def test_the_displacement_of_a_base_is_an_input(name, unit) -> None:
    t, (x, _), u = forced(lambda y, u: [y[1], -0.7 * y[1] - 190.0 * (y[0] - u)], [0.0, 0.0], top=8.0)
    record = noisy(t, **{name: u, "roof_laser": x})
    units = {"roof_laser": "mm", **({name: unit} if unit else {})}
    found = bq.info(bq.Record(record.channels, t, units))
    assert found.proposal.python == f"bq.discover(record, displacement='roof_laser', force='{name}')"
    alone = bq.info(bq.Record({name: x, "F": u}, t, {"F": "N"}))
    assert alone.guess.chains == ((name, None, None),)


def test_pressures_beside_a_displacement_are_inputs() -> None:
    t, y, _ = forced(
        lambda y, u: [y[1], 900 * (y[2] - y[3]) - 3 * y[1], u - y[2] - 0.2 * y[1], -u - y[3] + 0.2 * y[1]], [0.0] * 4
    )
    record = noisy(t, Weg=y[0], Kammer_1=5 + y[2], Kammer_2=5 + y[3])
    found = bq.info(bq.Record(record.channels, t, {"Weg": "mm", "Kammer_1": "bar", "Kammer_2": "bar"}))
    assert found.proposal.python == "bq.discover(record, displacement='Weg', inputs=['Kammer_1', 'Kammer_2'])"
    alone = bq.info(bq.Record({name: record[name] for name in ("Kammer_1", "Kammer_2")}, t, {"Kammer_1": "bar"}))
    assert alone.guess.inputs == ()


def test_angles_of_two_inertias_are_neighbours_in_one_unit(tmp_path) -> None:
    t, y, u = forced(
        lambda y, u: [y[2], y[3], 50 * u - 6000 * (y[0] - y[1]) - y[2], 2400 * (y[0] - y[1]) - y[3]], [0.0] * 4
    )
    record = noisy(t, noise=0.0005, motor_angle=y[0], load_angle=np.degrees(y[1]), torque=u)
    record = bq.Record(record.channels, t, {"motor_angle": "rad", "load_angle": "deg", "torque": "Nm"})
    bq.write(record, tmp_path / "run.csv")
    command = bq.info(tmp_path / "run.csv").proposal.command
    assert command is not None
    options = "--chain motor_angle:: --chain load_angle:: --input torque --dictionary neighbours"
    assert command.endswith(f" --units 'load_angle=0.0174532925199 rad' {options}")
    assert "load_angle is to be in the unit of the others: 0.0174532925199 rad" in bq.info(record).proposal.notes


@pytest.mark.parametrize(
    ("channels", "chains"),
    [
        ({"Wagenweg": "mm", "Lastweg": "mm"}, ("Wagenweg::", "Lastweg::")),
        ({"Kranposition": "m", "Seilwinkel": "°"}, ("Kranposition::", "Seilwinkel::")),
        ({"Weg": "mm", "Winkel": "°"}, ("Weg::", "Winkel::")),
        ({"Seilwinkel": "°", "Kranweg": "m", "Krangeschwindigkeit": "m/s", "Seilwinkelgeschwindigkeit": "°/s"}, (
            "Seilwinkel:Seilwinkelgeschwindigkeit:", "Kranweg:Krangeschwindigkeit:"
        )),
        ({"Drehwinkel": "°", "Winkelgeschwindigkeit": "°/s"}, ("Drehwinkel:Winkelgeschwindigkeit:",)),
    ],
)  # fmt: skip
def test_stems_of_compounds_tell_coordinates_apart(channels, chains) -> None:
    noise = np.random.default_rng(0).standard_normal((len(channels), 600))
    found = bq.info(bq.Record(dict(zip(channels, noise, strict=True)), np.arange(600) / 50, channels))
    assert found.to_dict()["roles"]["chains"] == list(chains)


def test_derivatives_at_another_rate_name_that_rate() -> None:
    t, (x, v), u = forced(lambda y, u: [y[1], u - 0.5 * y[1] - 200.0 * y[0]], [0.0, 0.0])
    a = u - 0.5 * v - 200.0 * x
    at_double = noisy(t / 2.0, x=x, v=v, a=a)
    [finding] = bq.check_record(at_double, ["x:v:a"])
    assert finding.kind == "clock"
    assert finding.value == pytest.approx(200.0, rel=0.01)
    assert "v and a are derivatives of x at" in finding.message
    assert bq.check_record(noisy(t, x=x, v=v, a=a), ["x:v:a"]) == []
    [gain] = bq.check_record(noisy(t, x=x, v=v, a=2.0 * a), ["x:v:a"])
    assert gain.kind == "gain"


def test_exchanged_names_of_force_and_acceleration_are_a_question() -> None:
    t, (x, v), u = forced(lambda y, u: [y[1], u - 0.5 * y[1] - 200.0 * y[0]], [0.0, 0.0])
    a = u - 0.5 * v - 200.0 * x
    assert "F is d2x/dt2 more closely than a is: are their names exchanged?" in str(bq.info(noisy(t, x=x, a=u, F=a)))
    assert "exchanged" not in str(bq.info(noisy(t, x=x, a=a, F=u)))
