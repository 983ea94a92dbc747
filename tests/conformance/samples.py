"""A small file of every format, written by the library that defines it or by hand, and what is in it."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bayeq import Record, write

FS = 50.0
N = 40
T = np.arange(N) / FS
X = np.sin(7.0 * T)
U = np.cos(3.0 * T)


class Sample(NamedTuple):
    """How a file is made, and what reading it gives beside channels x and u (or those of `names`)."""

    make: Callable[[Path], None]
    suffix: str
    units: Mapping[str, str]
    fs: float | None = FS
    names: tuple[str, ...] = ("x", "u")
    digits: float = 1e-12


def text(path: Path) -> None:
    rows = "\n".join(f"{t!r},{x!r},{u!r}" for t, x, u in zip(T.tolist(), X.tolist(), U.tolist(), strict=True))
    path.write_text(f"Run 7 of the shaker\nOperator: nobody\nTime,x,u\n(s),(mm),(N)\n{rows}\n")


def bayeq(path: Path) -> None:
    if path.suffix == ".parquet":
        pytest.importorskip("pyarrow")
    write(Record({"x": X, "u": U}, T, {"x": "mm", "u": "N"}), path)


def hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        group.attrs["sample_rate"] = FS
        for name, values, unit in (("x", X, "mm"), ("u", U, "N")):
            group.create_dataset(name, data=values).attrs["units"] = unit
        file.create_dataset("settings", data=[1.0, 2.0, 3.0])


def matlab_v73(path: Path) -> None:
    """As MATLAB's save -v7.3: a block of 512 bytes in front, classes as attributes, cells as references."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        kept = file.create_group("#refs#")
        cells = []
        for k in range(2):
            piece = kept.create_dataset(f"p{k}", data=np.column_stack([X + k, U]))  # 2 x n in MATLAB
            piece.attrs["MATLAB_class"] = np.bytes_("double")
            cells.append(piece.ref)
        y = file.create_dataset("Y", (2, 1), dtype=h5py.ref_dtype)
        y[:, 0] = cells
        y.attrs["MATLAB_class"] = np.bytes_("cell")
        rec = file.create_group("rec")
        rec.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in (("x", X), ("u", U), ("t", T)):
            rec.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        unit = rec.create_dataset("units", data=np.array([[ord(c)] for c in "mm"], dtype=np.uint16))
        unit.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def matlab(path: Path) -> None:
    from scipy.io import savemat

    cells = np.empty((1, 2), dtype=object)
    for k in range(2):
        cells[0, k] = np.vstack([X + k, U])
    rec = {"x": X[:, None], "u": U[:, None], "t": T[:, None], "units": "mm", "acc": {"data": X[:3]}}
    savemat(path, {"Y": cells[:, :0], "rec": rec, "gain": 3.0}, do_compression=True)


def uff(path: Path, binary: int = 0) -> None:
    pyuff = pytest.importorskip("pyuff")
    about = {
        "type": 58, "binary": binary, "func_type": 1, "rsp_dir": 3, "ref_dir": 3, "ref_node": 1, "x": T,
        "id1": "run", "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "abscissa_axis_lab": "Time",
        "abscissa_axis_units_lab": "s", "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0,
    }  # fmt: skip
    sets = [
        {**about, "rsp_node": node, "data": values, "ordinate_spec_data_type": kind, "ordinate_axis_units_lab": unit}
        for node, values, kind, unit in ((5, X, 8, "mm"), (2, U, 13, "N"))
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pyuff about itself
        pyuff.UFF(str(path)).write_sets(sets, mode="add")  # "overwrite" loses binary ones


def tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    about = {"wf_increment": 1 / FS, "wf_start_offset": 0.0}
    channels = [
        nptdms.ChannelObject("run", name, values, {**about, "unit_string": unit})
        for name, values, unit in (("x", X, "mm"), ("u", U, "N"))
    ]
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.RootObject({"operator": "nobody"}), *channels])


def lvm(path: Path) -> None:
    rows = "\n".join(f"{t:.6f}\t{x!r}\t{u!r}\t" for t, x, u in zip(T, X.tolist(), U.tolist(), strict=True))
    path.write_text(
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "Multi_Headings\tNo\nX_Columns\tOne\nTime_Pref\tRelative\nOperator\tnobody\n***End_of_Header***\t\n\t\n"
        f"Channels\t2\t\nSamples\t{N}\t{N}\t\nY_Unit_Label\tmm\tN\t\nX_Dimension\tTime\tTime\t\n"
        f"X0\t0.0\t0.0\t\nDelta_X\t{1 / FS}\t{1 / FS}\t\n***End_of_Header***\t\t\t\nX_Value\tx\tu\tComment\n{rows}\n"
    )


def xlsx(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["cover", "sheet"])
    sheet = book.create_sheet("data")
    sheet.append(["Time [s]", "x", "u"])
    sheet.append(["s", "mm", "N"])
    for row in zip(T.tolist(), X.tolist(), U.tolist(), strict=True):
        sheet.append(row)
    book.save(path)


def xls(path: Path) -> None:
    pytest.importorskip("xlrd")
    xlwt = pytest.importorskip("xlwt")
    book = xlwt.Workbook()
    sheet = book.add_sheet("data")
    for column, (head, values) in enumerate((("Time [s]", T), ("x [mm]", X), ("u [N]", U))):
        sheet.write(0, column, head)
        for row, value in enumerate(values.tolist(), 1):
            sheet.write(row, column, value)
    book.save(str(path))


def wav(path: Path) -> None:
    samples = np.column_stack([X, U]).astype("<f8").tobytes()
    form = struct.pack("<HHIIHH", 3, 2, int(FS), int(FS) * 16, 16, 64)
    body = b"WAVEfmt " + struct.pack("<I", 16) + form + b"LIST\x03\0\0\0abc\0data" + struct.pack("<I", len(samples))
    path.write_bytes(b"RIFF" + struct.pack("<I", len(body) + len(samples)) + body + samples)


def npy(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.rec.fromarrays([T, X, U], names=["t", "x", "u"]))


kept = {"x": "mm", "u": "N"}

#: At least one for every row of the table of formats.
SAMPLES: dict[str, Sample] = {
    "delimited text": Sample(text, ".csv", kept),
    "NumPy archive": Sample(bayeq, ".npz", kept),
    "Parquet": Sample(bayeq, ".parquet", kept),
    "compressed text": Sample(bayeq, ".gz", kept),
    "HDF5 and MATLAB v7.3": Sample(hdf5, ".h5", {"run_x": "mm", "run_u": "N"}, names=("run_x", "run_u")),
    "MATLAB v7.3": Sample(matlab_v73, ".mat", {"rec_x": "mm", "rec_u": "mm"}, names=("rec_x", "rec_u")),
    "MATLAB v4 and v5": Sample(matlab, ".mat", {"rec_x": "mm", "rec_u": "mm"}, names=("rec_x", "rec_u")),
    "universal file, dataset 58": Sample(
        uff, ".uff", {"disp_5_z": "mm", "force_2_z": "N"}, names=("disp_5_z", "force_2_z"), digits=1e-10
    ),
    "universal file, binary": Sample(
        lambda path: uff(path, 1), ".unv", {"disp_5_z": "mm", "force_2_z": "N"}, names=("disp_5_z", "force_2_z")
    ),
    "TDMS": Sample(tdms, ".tdms", kept),
    "LabVIEW measurement": Sample(lvm, ".lvm", kept),
    "Excel": Sample(xlsx, ".xlsx", kept),
    "Excel, .xls": Sample(xls, ".xls", kept),
    "WAV": Sample(wav, ".wav", {}, names=("c1", "c2")),
    "NumPy array": Sample(npy, ".npy", {}),
}
