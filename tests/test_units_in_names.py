"""Units that headers end in without brackets: ``disp_mm``, ``Kraft/kN``; and names that only look like it."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.records.names import unit_in_name

WITH = {
    "disp_mm": "mm", "vel_mm_s": "mm/s", "Accel_mps2": "m/s^2", "acc_m_s_2": "m/s^2", "acc m/s^2": "m/s^2",
    "theta_deg": "deg", "omega_rad_per_s": "rad/s", "acc_g": "g", "force_N": "N", "LoadCell_kN": "kN", "Weg/mm": "mm",
    "v/m/s": "m/s", "Strom/A": "A", "T/K": "K", "Level/cm": "cm",
}  # fmt: skip
WITHOUT = [
    "motor_A",
    "F/A",
    "u_in",
    "m/s",
    "x_m",
    "N/A",
    "I/O",
    "dv/dt",
    "and/or",
    "handlebar",
    "leg",
    "C/N0",
    "time_ms",
]


@pytest.mark.parametrize(("header", "unit"), WITH.items())
def test_units_that_names_end_in(header, unit):
    assert unit_in_name(header) == unit


@pytest.mark.parametrize("header", WITHOUT)
def test_names_that_end_in_no_unit(header):
    assert unit_in_name(header) is None


def test_a_file_states_units_in_its_names(tmp_path):
    """Names stay as they are; what brackets say, or the caller, comes first; no gain is asked about."""
    run = bq.simulate("duffing", n=600, seed=4)
    columns = [1e3 * run.time, 1e3 * run["x"], run["a"] / 9.80665, run["u"]]
    path = tmp_path / "run.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header="time_ms,disp_mm,acc_g,force_N (kN)", comments="")
    read = bq.read(path)
    assert read.names == ("disp_mm", "acc_g", "force_N")
    assert read.units.items() >= {"disp_mm": "mm", "acc_g": "g", "force_N": "kN"}.items()
    assert bq.read(path, units={"disp_mm": "cm"}).units["disp_mm"] == "cm"
    np.testing.assert_allclose(read.time, run.time, rtol=1e-9)
    noticed = bq.info(path).findings
    assert not any("check its" in message for message in noticed), noticed
