"""Headers of instruments, reconstructed from their documentation: channels, units and rate as an engineer reads them.

The files of `instruments` are small and made up; each follows the layout that is named here. No vendor wrote them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bayeq import read
from bayeq.errors import FileFormatError

FOLDER = Path(__file__).parent / "instruments"


class Header(NamedTuple):
    """What a file follows, and what is in it: first samples by channel, units, rate [Hz], first time [s]."""

    layout: str
    first: dict[str, float]
    units: dict[str, str]
    fs: float | None
    start: float = 0.0


HEADERS = {
    "ni_labview.lvm": Header(
        "layout after NI, Specification for the LabVIEW Measurement File (.lvm)",
        {"Acceleration": 0.125, "Force": -1.5}, {"Acceleration": "m/s^2", "Force": "N"}, 1000,
    ),
    "ni_diadem.csv": Header(
        "layout after NI DIAdem's ASCII export of TDM channels: properties, names, units, decimal commas",
        {"Displacement": 0.1, "Force": 1.5}, {"Displacement": "mm", "Force": "kN"}, 500,
    ),
    "catman.asc": Header(
        "layout after HBM catman AP, ASCII export with channel information: tabs, decimal commas, Latin-1",
        {"Weg": 1.25, "Kraft": -0.5}, {"Weg": "mm", "Kraft": "kN"}, 100,
    ),
    "dewesoft.txt": Header(
        "layout after Dewesoft X, export to text: data info, events, then one line of names with units",
        {"AI_1_acc": 0.981, "AI_2_force": 12}, {"AI_1_acc": "m/s2", "AI_2_force": "N"}, 5000,
    ),
    "polytec.txt": Header(
        "layout after Polytec PSV, ASCII export of a time signal: keys, names, units in brackets",
        {"Velocity": 1.25e-3}, {"Velocity": "m/s"}, 6400,
    ),
    "simcenter.unv": Header(
        "layout after the universal file format, dataset 58 (SDRL), as Simcenter Testlab and Polytec export it",
        {"acc_7_mx": 1}, {"acc_7_mx": "m/s^2"}, 800,
    ),
    "testlab.txt": Header(
        "layout after Siemens Simcenter Testlab, export to text: project keys, point identifiers, units",
        {"beam_1_Z": 0.1, "shaker_1_Z": 5}, {"beam_1_Z": "g", "shaker_1_Z": "N"}, 2000,
    ),
    "vibration_research.csv": Header(
        "layout after Vibration Research VibrationVIEW, recorder export to CSV: quoted lines",
        {"Ch1": 0.5, "Drive": 0.01}, {"Ch1": "G", "Drive": "V"}, 6250,
    ),
    "matlab_writetable.csv": Header(
        "layout after MATLAB's writetable: variable names, NaN", {"Displacement": 0.1, "Force_N": 5},
        {"Force_N": "N"}, 100,
    ),
    "matlab_csvwrite.csv": Header(
        "layout after MATLAB's csvwrite and writematrix: numbers alone", {"c1": 0, "c2": 0.1, "c3": 5}, {}, None,
    ),
    "excel_de.csv": Header(
        "layout after Excel's CSV UTF-8 in a German locale: byte-order mark, semicolons, decimal commas, ms",
        {"Weg": 1.25, "Kraft": 10}, {"Weg": "mm", "Kraft": "N"}, 400,
    ),
    "excel_fr.csv": Header(
        "layout after Excel's CSV in a French locale: Latin-1, semicolons, decimal commas",
        {"Déplacement": 1.25, "Force": 10}, {"Déplacement": "mm", "Force": "N"}, 50,
    ),
    "excel_stamps.csv": Header(
        "layout after Excel's CSV in a German locale, with dates over midnight",
        {"Weg": 1.25, "Kraft": 10}, {"Weg": "mm", "Kraft": "N"}, 4,
    ),
    "excel_unicode.txt": Header(
        "layout after Excel's Unicode text: UTF-16 with byte-order mark, tabs", {"Weg": 1.25}, {"Weg": "mm"}, 2,
    ),
    "bk_connect.txt": Header(
        "layout after Brüel & Kjær BK Connect, export to text: no column of time, the rate above",
        {"Accelerometer": 0.25, "Force": 1}, {"Accelerometer": "m/s²", "Force": "N"}, 4096,
    ),
    "picoscope.csv": Header(
        "layout after Pico Technology PicoScope, save as CSV: units in parentheses, a blank line",
        {"Channel_A": 1.25, "Channel_B": -12.5}, {"Channel_A": "V", "Channel_B": "mV"}, 4000, -5e-4,
    ),
    "tektronix_mso.csv": Header(
        "layout after Tektronix 5 Series MSO, waveform CSV: keys and values, then TIME and channels",
        {"CH1": 0.12, "CH2": 1.5}, {"CH1": "V", "CH2": "V"}, 312500, -6.4e-6,
    ),
    "rigol.csv": Header(
        "layout after Rigol DS1000Z, waveform CSV: a row counter, the increment beside the names",
        {"CH1": 1.2, "CH2": 0.02}, {"CH1": "V", "CH2": "V"}, 100000,
    ),
    "keysight.csv": Header(
        "layout after Keysight InfiniiVision, waveform CSV: x-axis and numbers of channels, units in words",
        {"_1": 1.25, "_2": -0.2}, {"_1": "V", "_2": "V"}, 100000, -5e-3,
    ),
    "lecroy.csv": Header(
        "layout after Teledyne LeCroy, waveform CSV with one segment", {"Ampl": 0.125}, {}, 1e6, -2e-6,
    ),
    "windaq.csv": Header(
        "layout after DATAQ WinDaq, export to spreadsheet: keys, names, units in words",
        {"Position": 0.1, "Load": 5}, {"Position": "in", "Load": "lbf"}, 240,
    ),
    "campbell_toa5.dat": Header(
        "layout after Campbell Scientific, TOA5: quoted stamps, rows of names, units and processing, NAN",
        {"Disp_Avg": 1.25, "Load": np.nan}, {"Disp_Avg": "mm", "Load": "N"}, 20,
    ),
    "mts_tem.txt": Header(
        "layout after MTS 793 MultiPurpose TestWare, specimen.dat: a line with pipes, header lines, names, units",
        {"Axial_Displacement": 1.25, "Axial_Force": -0.5}, {"Axial_Displacement": "mm", "Axial_Force": "kN"}, 102.4,
        0.0009765625,
    ),
    "instron_bluehill.csv": Header(
        "layout after Instron Bluehill, raw data CSV: results above, units in parentheses, quoted numbers",
        {"Extension": 1e-4, "Load": 1.25}, {"Extension": "mm", "Load": "N"}, 100,
    ),
    "optitrack.csv": Header(
        "layout after OptiTrack Motive 2 CSV: type, name, rotation or position, axes",
        {"Rotation_X": 0.01, "Position_Z": 0.13}, {}, 120,
    ),
    "kistler.txt": Header(
        "layout after Kistler BioWare, text export: rate, names, units",
        {"Fx": 0.5, "Fz": 701}, {"Fx": "N", "Fz": "N"}, 1000,
    ),
    "pipes.txt": Header(
        "no instrument: pipes and decimal commas", {"Angle": 10.5, "Torque": 1.25}, {"Angle": "deg", "Torque": "Nm"}, 10
    ),
}  # fmt: skip


def test_every_file_is_described() -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(HEADERS)
    assert sum("layout after" in header.layout for header in HEADERS.values()) >= 20


@pytest.mark.parametrize("name", sorted(HEADERS))
def test_header(name: str) -> None:
    if name.endswith(".unv"):
        pytest.importorskip("pyuff")
    header = HEADERS[name]
    record = read(FOLDER / name)
    for channel, value in header.first.items():
        assert record[channel][0] == pytest.approx(value, nan_ok=True)
    assert {k: v for k, v in record.units.items() if k in header.first} == header.units
    if header.fs is None:
        assert record.time is None
    else:
        assert record.time is not None
        assert record.fs == pytest.approx(header.fs, rel=2e-4)
        assert record.time[0] == pytest.approx(header.start)


def test_decimal_commas_in_quotes_between_commas(tmp_path: Path) -> None:
    file = tmp_path / "quoted.csv"
    file.write_text('"t","x [mm]"\n"0","1,284"\n"0,002","1,6046"\n"0,004","-1,7e1"\n')
    record = read(file)
    np.testing.assert_allclose(record.time, [0.0, 0.002, 0.004])
    np.testing.assert_allclose(record["x"], [1.284, 1.6046, -17.0])
    file.write_text('"t","x"\n"0","1,284"\n"1","2,500"\n')  # which may as well be thousands
    with pytest.raises(FileFormatError, match="'1,284' is not a number; write the decimal mark as a point"):
        read(file)
