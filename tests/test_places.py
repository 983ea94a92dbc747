"""What `info` proposes for sensors at different places: by names that say where they are, and by the motion."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.records.names import clean_names
from tests.headers import noisy, oscillator, two_masses


def command_of(channels, data, t, tmp_path):
    """What is proposed for these headers, without the file."""
    path = tmp_path / "run.csv"
    table = np.column_stack([t, *(data[key] for key in channels.values())])
    lines = [",".join(["Time [s]", *channels])] + [",".join(f"{value:.7g}" for value in row) for row in table]
    path.write_text("\n".join(lines) + "\n")
    return bq.info(path).proposal.command.partition("run.csv ")[2]


def places(late=0, gain=1.0):
    """A motion, one that accelerates `gain` times as much, `late` rows behind, one at right angles, and a force."""
    made = oscillator()
    other = noisy(two_masses(len(made["t"])), seed=1)
    a = gain * np.roll(made["a"], late)
    return {**noisy({**made, "late": a}), "y": other["x2"], "by": other["a2"]}


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ("roof laser [m]", "floor1 acc [m/s2]"),
        ("Main LVDT [m]", "Absorber acc [m/s2]"),
        ("d3 [m]", "a2 [m/s2]"),
        ("load pos [m]", "motor acc [m/s2]"),
        ("disp x [m]", "acc y [m/s2]"),
    ],
)
@pytest.mark.parametrize(("late", "gain"), [(0, 1.5), (0, -1.0), (2, 1.0)])
def test_two_places_are_one_only_if_the_motion_says_so(low, high, late, gain, tmp_path):
    data = places(late, gain)
    (p, q), _ = clean_names([low, high])
    said = command_of({low: "x", high: "late", "Force [N]": "F"}, data, data["t"], tmp_path)
    assert said == f"--chain {p}:: --chain ::{q} --input Force --dictionary neighbours"
    said = command_of({low: "x", high: "a", "Force [N]": "F"}, data, data["t"], tmp_path)
    assert said == f"--disp {p} --acc {q} --force Force"


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ("Weg Laser [m]", "Beschleunigung [m/s2]"),
        ("LVDT [m]", "Acc 1 [m/s2]"),
        ("x [m]", "acc top [m/s2]"),
        ("body 1 disp [m]", "body acc [m/s2]"),
        ("xb [m]", "ab [m/s2]"),
        ("pos theta [m]", "acc x [m/s2]"),
    ],
)
def test_names_of_one_place_at_most_need_no_gain(low, high, tmp_path):
    data = places(2, 1.5)
    (p, q), _ = clean_names([low, high])
    said = command_of({low: "x", high: "late", "Force [N]": "F"}, data, data["t"], tmp_path)
    assert said == f"--disp {p} --acc {q} --force Force"


@pytest.mark.parametrize("names", [("x", "y"), ("posx", "posy"), ("disp x", "disp y"), ("z", "x")])
def test_axes_are_coordinates(names, tmp_path):
    data = places()
    channels = {f"{names[0]} [m]": "x", f"{names[1]} [m]": "y", "Fx [N]": "F"}
    said = command_of(channels, data, data["t"], tmp_path)
    p, q = clean_names(names)[0]
    assert said == f"--chain {p}:: --chain {q}:: --input Fx --dictionary neighbours"


def test_axes_and_their_derivatives_belong_together(tmp_path):
    data = places()
    channels = {"x [m]": "x", "y [m]": "y", "ax [m/s2]": "a", "ay [m/s2]": "by", "Fx [N]": "F"}
    said = command_of(channels, data, data["t"], tmp_path)
    assert said == "--chain x::ax --chain y::ay --input Fx --dictionary neighbours"


def test_a_road_drives_what_has_accelerations_at_other_places(tmp_path):
    data = places(3, 1.5)
    channels = {"road [m]": "x", "body acc [m/s2]": "by", "wheel acc [m/s2]": "late"}
    said = command_of(channels, data, data["t"], tmp_path)
    assert said == "--chain ::body_acc --chain ::wheel_acc --input road --dictionary neighbours"
