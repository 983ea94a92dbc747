"""What is in a file: numbers of channels, time, experiments, roles, and the command to run next."""

from __future__ import annotations

import json
import math
import re
import shlex

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import DataWarning, FileFormatError, InputError, RecordError
from bayeq.inspection.channels import bars, spectrum
from bayeq.inspection.roles import INPUT, REFERENCE, STATE, clue_of
from bayeq.records.names import clean_names
from tests.data import measured, pendulum_record
from tests.draws import draws
from tests.headers import noisy, oscillator

FS = 200.0


def motion(n=4000, fs=FS, seed=0, noise=0.01):
    """Displacement, velocity and acceleration of several frequencies, which are exact derivatives but for noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / fs
    w, phase = 2 * np.pi * np.array([1.1, 2.3, 4.7, 9.1]), rng.uniform(0, 6, 4)
    x, v, a = (
        sum(np.sin(w_k * t + p + m * np.pi / 2) * w_k**m for w_k, p in zip(w, phase, strict=True)) for m in range(3)
    )
    return t, *(values + noise * values.std() * rng.normal(size=n) for values in (x, v, a))


def duffing(units=True, n=1000, **renamed):
    record = bq.simulate("duffing", n=n, seed=1)
    channels = {renamed.get(name, name): values for name, values in record.channels.items()}
    return bq.Record(channels, record.time, {k: record.units[k] for k in channels if units and k in record.units}, "d")


# --- the command that is proposed ------------------------------------------------------------------------------------


def found_terms(command, capsys, *options):
    """Terms of the equations that a proposed command finds with some options."""
    words = shlex.split(command)
    assert words[:2] == ["bayeq", "discover"]
    capsys.readouterr()
    assert main([*words[1:], *options, "--json"]) == 0
    equations = json.loads(capsys.readouterr().out)["equations"]
    return {e["target"]: {t["name"] for t in e["terms"] if t["shown"]} for e in equations}


@pytest.mark.parametrize(
    ("system", "units"),
    [
        *(("duffing", True), ("lorenz", True), ("linear", False)),
        *(pytest.param(system, True, marks=pytest.mark.slow) for system in ("linear", "quadratic", "coulomb")),
        *(pytest.param(system, False, marks=pytest.mark.slow) for system in ("duffing", "quadratic", "coulomb")),
    ],
)
def test_the_proposed_command_finds_the_equation(system, units, tmp_path, capsys):
    path = tmp_path / f"a file of {system}.csv"
    record = bq.simulate(system, n=1600 if system == "coulomb" else 800, seed=1)  # 800 rows do not tell friction
    bq.write(record if units else bq.Record(record.channels, record.time), path)
    assert main(["info", str(path), "--json"]) == 0
    proposal = json.loads(capsys.readouterr().out)["next"]
    assert proposal["complete"]
    truth = {target: set(terms) for target, terms in bq.SYSTEMS[system].terms.items()}
    assert found_terms(proposal["command"], capsys) == truth


def test_two_first_order_states_that_are_a_motion_and_its_velocity(tmp_path, capsys):
    path = tmp_path / "vdp.csv"
    bq.write(bq.simulate("vanderpol", n=1000, seed=1), path)
    proposal = bq.info(path).proposal
    terms = ("--dictionary", "x, y, x**2, x*y, x**3, x**2*y, y**3")
    assert found_terms(proposal.command, capsys, *terms) == {"ddx": {"x", "y", "x**2*y"}}


def test_names_that_say_nothing(tmp_path, capsys):
    path = tmp_path / "duffing.csv"
    bq.write(duffing(units=False, n=4000, u="ch1", a="ch2", x="ch3", v="ch4"), path)
    found = bq.info(path)
    assert found.guess.chains == (("ch3", "ch4", "ch2"),)
    assert found.guess.inputs == ("ch1",)
    assert found_terms(found.proposal.command, capsys, "--smooth", "none") == {"ch2": {"ch3", "ch4", "ch3**3", "ch1"}}


def test_the_line_of_python_is_the_same_command():
    record = duffing()
    line = bq.info(record).proposal.python
    assert line == "bq.discover(record, displacement='x', velocity='v', acceleration='a', force='u')"
    assert bq.info(record).proposal.command is None


def test_names_of_files_are_quoted(tmp_path):
    path = tmp_path / "-it's; rm $HOME.csv"
    bq.write(duffing(), path)
    assert shlex.split(bq.info(path).proposal.command)[2] == str(path)


def test_several_files_of_one_system_have_one_command(tmp_path, capsys):
    paths = [tmp_path / f"{seed}.csv" for seed in (0, 1)]
    for seed, path in enumerate(paths):
        bq.write(bq.simulate("linear", n=1000, seed=seed), path)
    assert main(["info", *map(str, paths)]) == 0
    assert f"bayeq discover {paths[0]} {paths[1]} --disp x" in capsys.readouterr().out
    assert main(["info", *map(str, paths), "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert [one["file"] for one in out["files"]] == ["0.csv", "1.csv"]
    assert out["next"]["complete"]


def test_files_of_different_systems_have_none(tmp_path, capsys):
    paths = [tmp_path / f"{system}.csv" for system in ("linear", "lorenz")]
    for path in paths:
        bq.write(bq.simulate(path.stem, n=1000, seed=0), path)
    assert main(["info", *map(str, paths)]) == 0
    assert "they are not proposed to be used together" in capsys.readouterr().out


# --- time and experiments --------------------------------------------------------------------------------------------


def test_rate_and_duration_are_in_the_first_line():
    assert str(bq.info(duffing())).splitlines()[0] == "d: 1000 rows at 1000 Hz, 0.999 s; 4 channels"


def test_without_time(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,v\n" + "\n".join(f"{math.sin(k)},{math.cos(k)}" for k in range(50)))
    found = bq.info(path)
    assert "no time in it" in str(found).splitlines()[0]
    assert found.fs is None
    assert found.duration is None
    assert shlex.split(found.proposal.command)[-6:] == ["--fs", "RATE", "--disp", "x", "--vel", "v"]
    assert not found.proposal.complete
    assert any(note.startswith("RATE: ") for note in found.proposal.notes)
    assert bq.info(path, fs=10).duration == pytest.approx(4.9)


def test_a_column_that_rises_is_taken_for_time_and_a_counter_is_not(tmp_path):
    t, x, v, _ = motion()
    path = tmp_path / "a.csv"
    rows = (f"{k},{t[k]:.6f},{x[k]},{v[k]}" for k in range(len(t)))
    path.write_text("row,K1,Weg,speed\n" + "\n".join(rows))
    found = bq.info(path)
    assert found.experiments.time == "K1"
    assert found.experiments.counter == "row"
    assert found.fs == pytest.approx(FS)
    assert "--time K1 --disp Weg --vel speed" in found.proposal.command


def test_milliseconds_that_count_from_zero_are_time():
    k = np.arange(50.0)
    found = bq.info(bq.Record({"Zeit": k, "Weg": np.sin(k)}, units={"Zeit": "ms"}))
    assert found.experiments.time == "Zeit"
    assert found.fs == pytest.approx(1000)


def test_a_step_of_time_in_a_column(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,Ts\n0,0.25\n" + "\n".join(f"{math.sin(k)}," for k in range(50)))
    found = bq.info(path)
    assert found.fs == 4.0
    assert "--fs 4" in found.proposal.command or bq.read(path).fs == 4.0
    assert "Ts" not in found.channels


@pytest.mark.parametrize("numbered", [True, False])
def test_time_that_starts_over(numbered, tmp_path):
    t, x, v, _ = motion(1000)
    text = "t,run,x,v\n" if numbered else "t,x,v\n"
    for run in (1, 2, 3):
        number = f",{run}" if numbered else ""
        text += "".join(f"{t[k]}{number},{x[k]},{v[k]}\n" for k in range(len(t)))
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(RecordError):
        bq.read(path)
    found = bq.info(path)
    assert [record.n for record in found.experiments.records] == [1000, 1000, 1000]
    assert found.experiments.column == ("run" if numbered else None)
    assert found.proposal.complete is numbered
    assert found.duration == pytest.approx(3 * t[-1])
    if numbered:
        assert "--group run" in found.proposal.command
        assert len(bq.info(path, group="run").experiments.records) == 3
    else:
        assert any("first in row 1001" in sentence for sentence in found.findings)


def test_a_file_whose_time_is_nonsense_names_its_row(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,x\n0,1\n1,2\n,3\n3,4\n")
    with pytest.raises(RecordError, match="row 3"):
        bq.info(path)


def test_gaps_in_time():
    t, x, _, _ = motion()
    keep = np.r_[0:1000, 1003:2000, 2500:4000]
    found = bq.info(bq.Record({"x": x[keep]}, t[keep]))
    assert [(gap.row, gap.long) for gap in found.gaps] == [(1000, False), (1997, True)]
    assert found.gaps[1].seconds == pytest.approx(501 / FS)


# --- channels --------------------------------------------------------------------------------------------------------


def test_numbers_of_a_channel():
    t, x, _, _ = motion(noise=0.0)
    gappy = x + 5.0
    gappy[[3, 7, 8]] = np.nan
    found = bq.info(bq.Record({"x": gappy, "z": np.full(len(t), 2.0)}, t, {"x": "mm"}))
    one = found.channels["x"]
    assert (one.unit, one.missing) == ("mm", 3)
    assert one.mean == pytest.approx(np.nanmean(gappy))
    assert one.sd == pytest.approx(np.nanstd(gappy))
    assert (one.least, one.greatest) == (np.nanmin(gappy), np.nanmax(gappy))
    assert found.channels["z"].constant
    assert any("z is constant, 2" in sentence for sentence in found.findings)
    assert any("x: 3 samples are missing (0.075 %)" in sentence for sentence in found.findings)


def test_a_channel_without_samples_or_of_huge_numbers():
    found = bq.info(bq.Record({"x": np.full(60, np.nan), "y": np.linspace(-1e300, 1e300, 60)}, np.arange(60.0)))
    assert found.channels["x"].missing == 60
    assert math.isfinite(found.channels["y"].sd)
    json.dumps(found.to_dict(), allow_nan=False)


def test_bad_samples_are_found_where_they_were_put():
    t, x, v, a = motion(2000)
    x[1200] += 3.0
    a[300:340] = a[300]
    v = np.clip(v, -0.6 * v.max(), 0.6 * v.max())
    found = bq.info(bq.Record({"x": x, "v": v, "a": a}, t))
    assert found.bad["x"]["spikes"] == [1201]
    assert set(found.bad["a"]["stuck"]) >= set(range(302, 340))
    assert len(found.bad["v"]["clipped"]) == np.sum(np.abs(v) == v.max())
    assert not bq.info(bq.Record(dict(zip("xva", motion(2000)[1:], strict=True)), t)).bad


def test_in_a_long_record_only_suspect_stretches_are_looked_at():
    t, x, v, a = motion(60_000)
    v[43_210] += 5 * v.std()
    found = bq.info(bq.Record({"x": x, "v": v, "a": a}, t))
    assert found.bad == {"v": {"spikes": [43_211]}}
    assert 0 < found.looked_at < 5_000


def test_coarse_held_and_equal_channels():
    t, x, v, _ = motion()
    found = bq.info(bq.Record({"x": np.round(x), "v": np.repeat(v[::4], 4), "w": np.repeat(v[::4], 4)}, t))
    assert found.channels["x"].resolution == 1.0
    assert found.channels["v"].held == pytest.approx(4.0)
    assert found.copies == {"w": "v"}


def test_steps_of_a_programme_are_not_sampled_slower():
    t, x, _, _ = motion()
    levels = np.random.default_rng(2).uniform(0.0, 100.0, 100)
    held = {"slow": np.repeat(x[::5], 5), "even": np.repeat(levels, 40)}
    lengths = 20 * np.tile([1, 3, 1, 1, 4], 20)
    record = bq.Record({**held, "programme": np.repeat(levels, lengths)}, t)
    assert [text for text in bq.info(record).findings if "rows only" in text] == [
        "slow changes in every 5 rows only: it is sampled slower than the file",
        "even changes in every 40 rows only: steps of a programme, or it is sampled slower than the file",
    ]


@settings(max_examples=draws(30), deadline=None)
@given(st.floats(0.5, 40.0), st.integers(200, 3000))
def test_the_strongest_frequency_and_the_bandwidth(frequency, n):
    found = spectrum([np.sin(2 * np.pi * frequency * np.arange(n) / 100.0)], 0.01)
    resolution = 100.0 / n
    assert abs(found.peak - frequency) <= 1.5 * resolution
    assert abs(found.bandwidth - frequency) <= 4 * resolution
    assert sum(found.shares) == pytest.approx(1.0)
    assert found.octaves[-1] == 50.0
    assert len(bars(found)) == len(found.octaves)


# --- roles -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "unit", "order"),
    [
        ("ch1", "mm", 0),
        ("ch1", "in/s", 1),
        ("ch1", "g", 2),
        ("ch1", "rad/s^2", 2),
        ("ch1", "kN", INPUT),
        ("ch1", "V", None),
        ("acc", "", 2),
        ("Weg_links", "", 0),
        ("uEst", "", INPUT),
        ("a", "m", 0),
        ("voltage_2", "", INPUT),
        ("Lynx", "", None),
    ],
)
def test_units_go_before_names(name, unit, order):
    assert clue_of(name, unit).order == order


@settings(max_examples=draws(100), deadline=None)
@given(st.text(max_size=20), st.text(max_size=10))
def test_any_name_and_unit_is_read(name, unit):
    assert clue_of(name, unit).order in (None, INPUT, REFERENCE, STATE, 0, 1, 2)


def test_derivatives_and_their_units():
    t, x, v, a = motion()
    record = bq.Record({"c": a / 9.80665, "b": 1000 * x, "d": v}, t, {"b": "mm", "c": "g", "d": "m/s"})
    found = bq.info(record)
    assert found.guess.chains == (("b", "d", "c"),)
    gains = {link.above: (link.gain, link.expected) for link in found.links}
    assert gains["d"] == pytest.approx((1e-3, 1e-3), rel=0.02)
    assert gains["c"] == pytest.approx((1 / 9.80665, 1 / 9.80665), rel=0.02)


def test_a_reversed_channel_is_said_to_be_so():
    t, x, v, a = motion()
    found = bq.info(bq.Record({"x": x, "v": -v, "a": a}, t))
    assert found.guess.chains == (("x", "v", "a"),)
    assert any("v has the opposite sign" in sentence for sentence in found.findings)


def test_noise_is_nobody_s_derivative():
    rng = np.random.default_rng(0)
    channels = {f"ch{k}": rng.normal(size=1500) for k in range(5)}
    found = bq.info(bq.Record(channels, np.arange(1500) / FS))
    assert found.links == ()
    assert found.guess.chains == ()
    assert found.guess.undecided == tuple(channels)
    assert "displacement='DISPLACEMENT'" in found.proposal.python
    assert not found.proposal.complete


def test_accelerations_go_with_the_displacements_that_they_derive_from():
    t, x, _, a = motion(seed=1)
    _, y, _, b = motion(seed=2)
    base = motion(seed=3)[1]
    units = {"Rad": "mm", "Aufbau": "mm", "b_Rad": "m/s^2", "b_Aufbau": "m/s^2", "Stempel": "mm"}
    channels = {"Stempel": base, "Rad": x, "Aufbau": y, "b_Rad": a / 1e3, "b_Aufbau": b / 1e3}
    found = bq.info(bq.Record(channels, t, units))
    assert found.guess.chains == (("Rad", None, "b_Rad"), ("Aufbau", None, "b_Aufbau"))
    assert found.guess.inputs == ("Stempel",)
    with_force = bq.info(bq.Record({**channels, "F": t % 0.7}, t, {**units, "F": "N"}))
    assert with_force.guess.inputs == ("F",)  # the third displacement may be another mass then
    assert "a coordinate of its own: --chain Stempel::" in with_force.proposal.notes[-1]


def test_exchanged_columns_are_read_the_other_way_round(tmp_path):
    t, x, _, a = motion()
    path = tmp_path / "run.csv"
    bq.write(bq.Record({"x": a / 1e3, "a": x}, t, {"x": "mm", "a": "m/s^2"}), path)
    found = bq.info(path)
    assert any("x is 0.001 times the second derivative of a: are the columns ex" in text for text in found.findings)
    assert found.proposal.command.endswith("--units 'x=m/s^2,a=mm' --disp a --acc x")
    assert "units={'x': 'm/s^2', 'a': 'mm'}), displacement='a', acceleration='x'" in found.proposal.python


def test_a_reversed_sensor_is_reversed_by_the_command(tmp_path):
    t, x, v, a = motion()
    path = tmp_path / "run.csv"
    bq.write(bq.Record({"x": x, "v": v, "a": -a}, t, {"x": "m", "a": "m/s^2"}), path)
    found = bq.info(path, units={"a": "g"})
    assert any("reverse it (--scale a=-1)" in text for text in found.findings)
    assert "--units a=g --scale a=-1" in found.proposal.command
    assert "units={'a': '-1 g'}" in found.proposal.python


@pytest.mark.parametrize(
    ("channels", "units", "command"),
    [
        ({"Speed": 3.0}, {"Speed": "m/s"}, "--chain Speed"),
        ({"V_C": 1.0}, {}, "--chain V_C"),
        ({"ch1": 1.0}, {"ch1": "bar"}, "--chain ch1"),
        ({"V_C1": 1.0, "V_C2": 2.0}, {}, "--chain V_C1 --chain V_C2"),
        ({"meas_u": -1.0, "meas_i": 1.0, "meas_n": 2.0}, {}, "--chain meas_i --chain meas_n --input meas_u"),
        ({"n": 2.0, "Strom": 1.0}, {"n": "rpm", "Strom": "A"}, "--chain n --input Strom"),
        ({"Spannung": 2.0, "Strom": 1.0}, {"Spannung": "V", "Strom": "A"}, "--chain Strom --input Spannung"),
    ],
)
def test_states_of_first_order_by_unit_name_or_course(channels, units, command, tmp_path):
    rng = np.random.default_rng(0)
    t = np.arange(600) / 10
    made = {name: np.exp(-t * abs(rate) / 30) * 50 + rng.normal(size=600) for name, rate in channels.items()}
    path = tmp_path / "run.csv"
    bq.write(bq.Record(made, t, units), path)
    proposal = bq.info(path).proposal
    assert proposal.complete
    assert f"run.csv {command} --dictionary polynomial:" in proposal.command
    if len(channels) == 3:
        assert any("which are in V, A or rpm?" in note for note in proposal.notes)
        assert any("--chain meas_u --input meas_i --input meas_n" in note for note in proposal.notes)


def test_a_speed_that_swings_or_is_driven_is_a_velocity():
    t, _, v, _ = motion()
    assert bq.info(bq.Record({"c1": v}, t, {"c1": "m/s"})).guess.chains == ((None, "c1", None),)
    driven = bq.Record({"v": np.exp(-t), "F": v}, t, {"v": "m/s", "F": "N"})
    assert bq.info(driven).guess.chains == ((None, "v", None),)


def test_names_in_a_structure_say_what_they_say_without_it():
    t, x, _, a = motion()
    force = a + 0.4 * x
    guess = bq.info(bq.Record({"rig_x": x, "rig_a": a, "rig_F": force}, t)).guess
    assert guess.chains == (("rig_x", None, "rig_a"),)
    assert guess.inputs == ("rig_F",)


def test_what_is_no_acceleration_by_name_is_none_by_its_course():
    t, x, _, a = motion()
    for force in ("i_motor", "i_q", "Base_acc"):  # currents, and what moves a base
        guess = bq.info(bq.Record({"pos": x, force: 0.9 * a + 0.1 * x}, t)).guess
        assert (guess.chains, guess.inputs) == ((("pos", None, None),), (force,))
    guess = bq.info(bq.Record({"A_x": x, "A_F": 0.5 * a + 0.4 * x}, t)).guess
    assert (guess.chains, guess.inputs) == ((("A_x", None, None),), ("A_F",))
    recorder = bq.Record({"Voltage_0": x, "Voltage_1": a}, t)
    assert bq.info(recorder).guess.chains == (("Voltage_0", None, "Voltage_1"),)


def test_a_level_under_an_inflow_is_of_first_order():
    rng, t, h, levels = np.random.default_rng(0), 60.0 * np.arange(600.0), 2.0, []
    inflow = 1.0 + 0.3 * np.convolve(rng.standard_normal(680), np.ones(81) / 9.0, mode="valid")
    for q in inflow:
        h += 60.0 * (2e-3 * q - 1.2e-3 * np.sqrt(h))
        levels.append(h)
    record = bq.Record({"Fuellstand": np.array(levels), "Zulauf": inflow}, t, {"Fuellstand": "m", "Zulauf": "l/s"})
    guess = bq.info(record).guess
    assert (guess.chains, guess.inputs) == ((("Fuellstand",),), ("Zulauf",))


def test_records_in_years_say_years(tmp_path, capsys):
    k = np.arange(60.0)
    x = 3.0 * np.exp(-k / 30.0) + np.random.default_rng(0).normal(size=60) * 0.01
    path = tmp_path / "run.csv"
    path.write_text("Year,x (thousands)\n" + "".join(f"{1900 + t:.0f},{v:.5f}\n" for t, v in zip(k, x, strict=True)))
    found = str(bq.info(path))
    assert "60 rows at 1 per year, 59 years" in found
    assert " 1/year" in found
    saved = tmp_path / "eq.json"
    arguments = ["--time", "Year", "--chain", "x", "--dictionary", "polynomial:1", "--save", str(saved)]
    assert main(["discover", str(path), *arguments]) == 0
    out = capsys.readouterr().out
    assert "60 rows at 1 per year, 60 years, of run.csv" in out
    assert re.search(r"tau\[x\] .* year ", out)
    assert "/s" not in out
    assert bq.load(saved).data.clock == "year"
    assert bq.load(saved)[0].units["dx"] == "thousands/year"
    assert main(["predict", str(saved), str(path), "--time", "Year"]) == 0
    assert "at 1 per year, 60 years, of run.csv" in capsys.readouterr().out


def test_times_that_were_rounded_have_the_rate_that_they_were_rounded_from(tmp_path, capsys):
    k = np.delete(np.arange(600), range(200, 212))
    theta = 60.0 * np.exp(-k / 900) * np.cos(k / 9) + np.random.default_rng(0).normal(size=len(k)) * 0.1
    path = tmp_path / "run.txt"
    path.write_text("t (s)\ttheta (deg)\n" + "".join(f"{a / 30:.3f}\t{b:.2f}\n" for a, b in zip(k, theta, strict=True)))
    proposal = bq.info(path)
    assert "588 rows at uneven steps, mostly 0.03333 s (30 Hz), 19.967 s" in str(proposal)
    assert main(shlex.split(proposal.proposal.command)[1:]) == 0
    shown = capsys.readouterr()
    assert re.search(r"588 rows at (30|29\.99\d*|30\.00\d*) Hz, 19\.97 s", shown.out)
    assert "check units" not in shown.err


def test_a_displacement_in_radians_gets_sines():
    t, x, v, _ = motion()
    found = bq.info(bq.Record({"th": x, "w": v}, t, {"th": "rad", "w": "rad/s"}))
    assert "dictionary='oscillator + sin(th) + cos(th)'" in found.proposal.python


# --- text, JSON, notebooks, the command ------------------------------------------------------------------------------


def test_text_and_json_of_the_command(tmp_path, capsys):
    path = tmp_path / "run.csv"
    bq.write(duffing(), path)
    assert main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert out.rstrip("\n") == str(bq.info(path))
    assert main(["info", str(path), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown.pop("version") == bq.__version__
    assert shown == json.loads(json.dumps(bq.info(path).to_dict()))
    assert shown["time"]["fs"] == 1000.0
    assert {channel["role"] for channel in shown["channels"]} == {
        "displacement",
        "velocity",
        "acceleration",
        "force or input",
    }
    assert shown["channels"][0]["spectrum"]["bandwidth"] < 20.0


def test_long_names_do_not_break_the_table():
    t, x, v, _ = motion()
    found = bq.info(bq.Record({"x" * 300: x, "v": v}, t))
    assert max(map(len, str(found).split("\nwhy")[0].splitlines())) <= 100


def test_html_is_escaped():
    t, x, v, _ = motion()
    record = bq.Record({"x": x, "v": v}, t, {"x": "<script>alert(1)</script>"}, "<img src=x onerror=alert(1)>")
    for html in (bq.info(record)._repr_html_(), record._repr_html_()):
        assert "<script" not in html
        assert "<img" not in html
        assert "&lt;img" in html


def test_a_terminal_is_not_obeyed():
    t, x, _, _ = motion()
    assert "\x1b" not in str(bq.info(bq.Record({"x": x}, t, name="\x1b[2Jrun.csv")))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.csv"], "no such file"),
        (["bad.csv"], "line 3, column 'x'"),
        (["good.csv", "--time", "x9"], "no column"),
        (["good.csv", "--fs", "-1"], "sampling rate"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,one\n")
    (tmp_path / "good.csv").write_text("t,x\n0,1\n1,2\n")
    assert main(["info", *arguments]) == 2
    caught = capsys.readouterr()
    assert caught.out == ""
    assert len(caught.err.splitlines()) == 1
    assert message in caught.err


def test_what_is_no_record_is_refused():
    with pytest.raises(InputError, match="no record can be made of int"):
        bq.info(3)
    with pytest.raises(InputError, match="time says how a file is read"):
        bq.info(duffing(), time="x")


# --- measured records ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("schmidt_lipson/real_linear_a_1.txt", "--disp x --vel v --acc a"),
        ("schmidt_lipson/real_pend_a_1.txt", "--disp o --vel w --acc a"),
        ("schmidt_lipson/real_double_linear_h_1.txt", "--chain x1:v1: --chain x2:v2: --dictionary polynomial:2"),
        (
            "schmidt_lipson/real_double_pend_h_1.txt",
            "--time c2 --group c1 --chain c3:c5:c9 --chain c4:c6:c10 --dictionary polynomial:2",
        ),
        ("lynx_hare/hudson-bay-lynx-hare.csv", "--time Year --chain Lynx --chain Hare --dictionary polynomial:2"),
    ],
)
def test_measured_records(name, options):
    path = measured(name)
    assert bq.info(path).proposal.command == f"bayeq discover {path} {options}"


def test_the_measured_pendulum():
    path = measured("multiarm_single_pendulum/SinglePendulumDataForParameterEstimation.mat")
    assert bq.info(pendulum_record(path)[0]).guess.chains == (("th", "w", None),)


@pytest.mark.parametrize("names", ["t,x,v,a", "t,p,q,r"])
def test_experiments_of_one_row_each_are_described(names, tmp_path, capsys):
    path = tmp_path / "r.csv"
    path.write_text(f"{names}\n0,1,2,3\n1,2,4,1\n2,5,1,0\n")
    assert main(["info", str(path), "--group", "t"]) == 0
    assert "3 experiments" in capsys.readouterr().out


# --- columns of words ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("suffix", "place"),
    [
        *(("csv", place) for place in (0, 3, 5)),
        *((suffix, 3) for suffix in ("parquet", "xlsx")),
        *(pytest.param(suffix, place, marks=pytest.mark.slow) for suffix in ("parquet", "xlsx") for place in (0, 5)),
    ],
)
def test_columns_of_words_are_left_out(suffix, place, tmp_path, capsys):
    pd = pytest.importorskip("pandas")
    pytest.importorskip({"parquet": "pyarrow", "xlsx": "openpyxl", "csv": "numpy"}[suffix])
    record = bq.simulate("duffing", n=400, seed=1)
    frame = pd.DataFrame({"t": record.time, **record.channels})
    frame.insert(place, "remark", ["ok", "rough", "ok", "stopped"] * 100)
    frame.insert(1, "operator", ["A. B."] * 400)
    path = tmp_path / f"run.{suffix}"
    {"csv": frame.to_csv, "parquet": frame.to_parquet, "xlsx": frame.to_excel}[suffix](path, index=False)
    found = bq.info(path)
    assert sorted(found.channels) == ["a", "u", "v", "x"]
    assert {line for line in found.findings if "words" in line} == {
        "remark holds words, not numbers: left out", "operator holds words, not numbers: left out",
    }  # fmt: skip
    found_by = found_terms(found.proposal.command, capsys, "--smooth", "none")
    assert found_by == {"a": {"x", "v", "x**3", "u"}}


def test_words_that_are_constant_over_experiments_number_them(tmp_path, capsys):
    pd = pytest.importorskip("pandas")
    record = bq.simulate("duffing", n=400, seed=1)
    frame = pd.DataFrame({"Sample": "S1", "by": "A. B.", "t": record.time, **record.channels})
    frame.loc[150:, ["Sample", "t"]] = [["S2", value - record.time[150]] for value in record.time[150:]]
    path = tmp_path / "run.csv"
    frame.to_csv(path, index=False)
    found = bq.info(path)
    assert found.to_dict()["experiments"]["rows"] == [150, 250]
    assert {"2 experiments, 150 to 250 rows each, numbered by Sample", "by holds words, not numbers: left out"} <= {
        *found.findings
    }
    assert "run.csv --group Sample --disp x" in found.proposal.command
    assert bq.info(path, group="Sample").proposal.command == found.proposal.command
    assert found_terms(found.proposal.command, capsys, "--smooth", "none") == {"a": {"x", "v", "x**3", "u"}}


def test_a_cell_that_is_no_number_is_no_column_of_words(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,x,v\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(50)) + "50,oops,1\n")
    with pytest.raises(FileFormatError, match="line 52, column 'x': 'oops' is not a number"):
        bq.info(path)


@pytest.mark.parametrize("text", ["a,b\none,two\nthree,four\n", "remark\nok\nrough\n"])
def test_words_alone_are_refused(text, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError, match="is not a number"):
        bq.info(path)


def test_time_that_is_named_may_not_be_words(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("when,x,v\n" + "".join(f"morning,{k % 7},{k % 5}\n" for k in range(50)))
    with pytest.raises(FileFormatError, match="'morning' is not a number"):
        bq.info(path, time="when")


# --- options about reading, arrays of several lengths, several experiments -------------------------------------------


def test_options_about_reading_are_those_of_discover_and_stay_in_the_command(tmp_path, capsys):
    t, x, v, _ = motion(1000)
    path = tmp_path / "run.csv"
    lines = [f"{a},{b},{c}" for a, b, c in zip(t, x, v, strict=True)]
    path.write_text("made by hand\nt,p,q\n" + "\n".join(lines))
    options = ["--skip", "1", "--rows", "100:900", "--units", "weg=mm,q=mm/s", "--channel", "weg=p", "--channel", "q"]
    assert main(["info", str(path), *options, "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["rows"] == 800
    assert [(one["name"], one["unit"]) for one in shown["channels"]] == [("weg", "mm"), ("q", "mm/s")]
    command = shlex.split(shown["next"]["command"])[3:]
    assert command == [*options[4:6], *options[:4], "--disp", "weg=p", "--vel", "q"]
    assert ", skip=1).take(slice(100, 900)), displacement='weg'" in shown["next"]["python"]
    assert main(["discover", str(path), *command, "--dictionary", "weg, q", "--smooth", "none", "--json"]) == 0
    assert main(["info", str(path), "--skip", "1", "--rows", "5000:"]) == 2


def test_arrays_of_several_lengths_are_listed(tmp_path, capsys):
    t, x, v, _ = motion(1000)
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"t": t, "x": x, "v": v, "short": x[:700], "other": {"y": x[:500]}})
    with pytest.raises(FileFormatError, match="arrays of several lengths"):
        bq.read(path)
    found = bq.info(path)
    assert list(found.channels) == ["x", "v"]
    assert "short (700), other_y (500)" in found.findings[0]
    options = ["--dictionary", "x, v", "--smooth", "none", "--json"]
    assert main([*shlex.split(found.proposal.command)[1:], *options]) == 0
    assert list(bq.info(path, channels={"y": "other.y"}).channels) == ["y"]


def test_the_name_of_a_struct_names_its_channel(tmp_path):
    t, x, v, _ = motion(1000)
    Y = np.zeros(2, dtype=[("Name", object), ("Data", object), ("Unit", object)])
    Y[0], Y[1] = ("Angle", x, "rad"), ("Plant/Angular speed", v, "rad/s")
    several = {"Name": "run 3", "a": x, "b": v}
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"rec": {"X": {"Name": "time", "Data": t}, "Y": Y}, "s": several})
    record = bq.read(path)
    assert record.fs == pytest.approx(FS)
    assert record.names == ("Angle", "Plant_Angular_speed", "s_a", "s_b")
    assert bq.read(path, channels={"th": "rec.Y[0].Data"}).units["th"] == "rad"


def test_motions_from_rest_and_jumps_in_time_may_be_experiments():
    t = np.arange(2000) / 100
    x = np.tile(np.exp(-t) * np.cos(6 * t), 3)
    x += 1e-3 * np.random.default_rng(0).normal(size=len(x))
    time = np.arange(len(x)) / 100
    (sentence,) = [one for one in bq.info(bq.Record({"x": x}, time)).findings if "experiments" in one]
    assert "begins again from rest" in sentence
    assert "perhaps 3 experiments" in sentence
    found = bq.info(bq.Record({"x": x}, time + 50.0 * (np.arange(len(x)) // 2000)))
    assert any("time jumps before rows 2001, 4001: perhaps 3 experiments" in one for one in found.findings)
    assert not any("experiments" in one for one in bq.info(duffing()).findings)
    # a vibration that swells to and fro as it grows begins once
    growing = np.exp(0.25 * t) * (1.0 + 0.3 * np.sin(1.5 * t)) * np.sin(30.0 * t)
    assert not any("experiments" in one for one in bq.info(bq.Record({"x": growing}, t)).findings)


@pytest.mark.parametrize("name", ["day", "Woche", "Jahr", "année", "Days", "test week"])
def test_days_weeks_and_years_are_time(name):
    k = np.arange(80.0)
    found = bq.info(bq.Record({name.replace(" ", "_"): k, "x": np.sin(k)}))
    assert found.experiments.time == name.replace(" ", "_")


def test_a_channel_without_a_word_or_unit_does_not_push_a_motion_out():
    made = oscillator()
    t, x, force = made["t"], made["x"], made["F"]
    switches = {"Trigger": 5.0 * (t > 1.0), "Status": 1.0 * (t % 3 > 1.5)}
    for motion_of in ("Laser_1", "Weg_vorne", "c1"):
        for name, switch in switches.items():
            units = {"c1": "mm"} if motion_of == "c1" else {}
            guess = bq.info(bq.Record({motion_of: x, "Force": force, name: switch}, t, units)).guess
            assert (guess.chains, guess.inputs) == (((motion_of, None, None),), ("Force",))
            assert guess.undecided == (name,)


def test_short_arrays_are_named_and_settings_are_not(tmp_path):
    t, x, v, _ = motion(1000)
    path = tmp_path / "run.mat"
    for others in ({"T": x[:100]}, {"slow": {"time": t[::20], "T": x[::20]}}):
        scipy.io.savemat(path, {"t": t, "x": x, "v": v, "masses": x[:3], **others})
        with pytest.warns(DataWarning, match=r"of arrays of 1000 samples; there are others: (T|slow\.time) \("):
            found = bq.info(path)
        assert list(found.channels) == ["x", "v"]
    scipy.io.savemat(
        path, {"t": t, "x": x, "v": v, "w": x[:900], "masses": x[:3], **{f"k{i}": x[:50] for i in range(5)}}
    )
    found = bq.info(path)
    assert list(found.channels) == ["x", "v"]
    assert "there are others: w (900), k0 (50)" in found.findings[0]
    scipy.io.savemat(path, {"t": t, "x": x, "v": v, "masses": x[:3]})
    assert bq.read(path).names == ("x", "v")


def test_impossible_samples_are_missing_ones_as_in_discover():
    t, x, _, a = motion()
    x[100], a[200] = np.inf, 1e300
    found = bq.info(bq.Record({"x": x, "a": a}, t, {"x": "m", "a": "m/s^2"}))
    assert found.guess.chains == (("x", None, "a"),)
    assert found.channels["a"].greatest < 1e6
    assert "a: 1 sample is infinite or beyond 1e+50 (row 201): taken as missing" in " ".join(found.findings)


@pytest.mark.parametrize("size", [1e160, 1e-200])
def test_huge_and_tiny_numbers_are_described(size):
    made = oscillator()
    assert bq.info(bq.Record({"x": made["x"] * size, "F": made["F"]}, made["t"])).guess.inputs == ("F",)


@pytest.mark.parametrize(
    "name",
    [
        *(
            "Shaking table acc",
            "Shake table 1 acc",
            "Rütteltisch Beschl",
            "Schwingtischbeschleunigung",
            "acc_Schwingtisch",
        ),
        *("Accélération table vibrante", "Bodenbeschleunigung", "Fundamentbeschl", "Acc fondation"),
    ],
)
@pytest.mark.parametrize("unit", ["g", "m/s^2", ""])
def test_what_a_structure_stands_on_drives_it(name, unit):
    (cleaned,), _ = clean_names([name])
    assert clue_of(cleaned, unit).order == INPUT
    for other in ("Shaker acc", "Tischbeschleunigung", "Solenoid acc"):
        assert clue_of(clean_names([other])[0][0], unit).order == 2


@pytest.mark.parametrize("names", [("Motor_angle", "Link_angle"), ("Weg_Laser", "Weg_LVDT"), ("x1", "x2")])
def test_what_moves_as_another_coordinate_does_is_a_question(names):
    made = oscillator()
    beside = made["x"] + 0.02 * made["x"].std() * np.random.default_rng(0).normal(size=len(made["t"]))
    channels = {names[0]: made["x"], names[1]: beside, "F": made["F"]}
    found = bq.info(bq.Record(channels, made["t"], {**dict.fromkeys(names, "rad"), "F": "Nm"}))
    assert found.guess.inputs == ("F",)
    assert f"as a coordinate: --chain {names[0]}:: --chain {names[1]}::" in " ".join(found.proposal.notes)


@pytest.mark.parametrize("cubic", [0.0, 2e5])
@pytest.mark.parametrize(("chain", "turned"), [("xa", "x"), ("xa", "a"), ("xv", "x"), ("xv", "v"), ("va", "v")])
def test_a_force_says_which_of_two_channels_is_reversed(chain, turned, cubic, tmp_path):
    made = noisy(oscillator(cubic=cubic))
    path = tmp_path / "run.csv"
    channels = {name: -made[name] if name == turned else made[name] for name in (*chain, "F")}
    bq.write(bq.Record(channels, made["t"]), path)
    assert f" --scale {turned}=-1 " in bq.info(path).proposal.command


@pytest.mark.parametrize("header", ["t", "Zeit [s]"])
def test_times_that_are_all_the_same_are_refused_as_discover_does(header, tmp_path, capsys):
    path = tmp_path / "run.csv"
    path.write_text(f"{header},x\n" + "".join(f"1.5,{k / 10}\n" for k in range(50)))
    assert main(["info", str(path)]) == 2
    assert "all 50 times are 1.5: the clock is too coarse" in capsys.readouterr().err


def test_numbers_from_a_hundred_on_are_written_plainly():
    t, rng = np.arange(40_000) / 10_000, np.random.default_rng(0)
    tone = np.sin(2 * np.pi * 1000 * t)
    found = bq.info(bq.Record({"x": tone, "slow": np.repeat(rng.normal(size=400), 100)}, t))
    assert "1000 Hz" in str(found)
    assert "slow changes in every 100 rows only" in " ".join(found.findings)
    assert "e+0" not in str(found)


def test_time_that_runs_backwards_is_no_row_of_experiments(tmp_path):
    record = bq.simulate("duffing", n=400, seed=1)
    rows = np.column_stack([record.time, record["x"], record["u"]])[::-1]
    np.savetxt(tmp_path / "back.csv", rows, delimiter=",", header="t,x [m],u [N]", comments="")
    found = bq.info(tmp_path / "back.csv")
    assert len(found.experiments.records) == 1
    assert "time runs backwards: sort the rows by it" in str(found)
    with pytest.raises(InputError, match="sort the rows by time"):
        bq.discover(tmp_path / "back.csv", displacement="x", force="u")
