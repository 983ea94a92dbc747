"""Valid inputs of every parser, small; what fuzzing has found is kept in ``corpus``."""

from __future__ import annotations

import io
import struct
import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from bayeq.records import Record, write

INSTRUMENTS = Path(__file__).resolve().parents[1] / "instruments"
ROWS = {"t": np.arange(4) / 8, "x": np.array([0.0, 1.0, -2.5, 1e-9]), "v": np.array([1.0, 2.0, 3.0, 4.0])}


def expressions() -> list[bytes]:
    """Terms."""
    texts = "x*abs(v)**1.5; sign(v)*x**-2; where(x<0, x**3, -v); sin(2*pi*x)/(1 + v**2); atan2(x, u) - e**x; max(x, v)"
    texts += "; tanh(v/{v0}); abs(x)**{n: 1..3} - {a:-1e-3 .. .5}*t"
    return [text.strip().encode() for text in texts.split(";")]


def dictionaries() -> list[bytes]:
    """Dictionaries, with unknown constants inside terms and either-or."""
    texts = [
        "x, v, u, tanh(v/{v0}) | sign(v)",
        "fourier:2 + sin({w}*t + {p}) - sin(x)",
        "a: max(x - {gap: 0.1..1}, 0), x/({K}+abs(x))",
        "abs(v)**{n: 1..3}*sign(v), where(t > {t0}, 1, 0), v/sqrt(v**2+{s}**2)",
    ]
    return [text.encode() for text in texts]


def known() -> list[bytes]:
    """What is known beforehand: constraints, ties, conserved sums, laws of hidden states."""
    texts = [
        "a: x1-x2 == 2*(b: x2-x1)",
        "0 <= a: x1**3 <= 5",
        "x1*abs(x1) == 0.5*x1**3 - 2*u",
        "u ~ 0.1 +- 0.001",
        "2*S + I - R",
        "df = {k: 1..5}*u - f/{tau}",
    ]
    return [text.encode() for text in texts]


def tables() -> list[bytes]:
    """Tables as instruments export them."""
    found = [path.read_bytes() for path in sorted(INSTRUMENTS.iterdir()) if path.suffix not in (".lvm", ".unv")]
    return [b"t,x [m],v\n0,1,2\n0.5,2,3\n1.0,4,1\n", *(data for data in found if len(data) < 3000)]


def _array(values: np.ndarray) -> bytes:
    made = io.BytesIO()
    np.lib.format.write_array(made, values, allow_pickle=False)
    return made.getvalue()


def arrays() -> list[bytes]:
    """NumPy's arrays."""
    fields = np.zeros(3, dtype=[("t", "<f8"), ("x", "<i4")])
    return [
        _array(one) for one in (np.arange(6.0), np.arange(8).reshape(4, 2), fields, np.array("text"), np.eye(2, 5).T)
    ]


@cache
def _written(suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        write(Record(ROWS, units={"x": "m"}), path)
        return path.read_bytes()


def archives() -> list[bytes]:
    """Archives, and arrays that are put into one."""
    return [_written(".npz"), *arrays()]


@cache
def _equations() -> bytes:
    import bayeq

    record = bayeq.simulate("duffing", n=80, seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = bayeq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, u", smooth="none", method="bma")
    with tempfile.TemporaryDirectory() as folder:
        found.save(Path(folder) / "a.json")
        return (Path(folder) / "a.json").read_bytes()


def saved() -> list[bytes]:
    """Equations as they are saved."""
    return [_equations(), b'{"format": "bayeq.equations"}']


def commands() -> list[bytes]:
    """Arguments, one in a line."""
    lines = (
        "discover r.csv --disp x --vel v --acc a --force u --dictionary x,v,x**3 --method vb --seed 1",
        "discover r.csv --chain x:v:a --input u --noise u=0.1 --units x=mm,a=g --rows 2:9 --json",
        "discover r.csv --chain x:: --fs 8 --band 0.5:3 --tolerance 0.01 --smooth band --remove-offset x=0.2",
        "info r.csv --time t --json",
        "simulate duffing -o out.csv --n 10 --fs 100 --noise 0.1",
        "study table2 --realisations 1 --systems duffing",
        "predict eq.json r.csv",
        "plan eq.json",
    )
    return [line.replace(" ", "\n").encode() for line in lines]


def lvm() -> list[bytes]:
    """LabVIEW's measurement files."""
    return [(INSTRUMENTS / "ni_labview.lvm").read_bytes()]


def uff() -> list[bytes]:
    """Universal files."""
    return [(INSTRUMENTS / "simcenter.unv").read_bytes()]


def wav() -> list[bytes]:
    """Sound."""
    form, data = struct.pack("<HHIIHH", 1, 2, 100, 400, 4, 16), struct.pack("<8h", *range(8))
    body = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", len(data)) + data
    return [b"RIFF" + struct.pack("<I", len(body)) + body]


@cache
def workbook() -> bytes:
    """A workbook of Excel."""
    import openpyxl

    book, made = openpyxl.Workbook(), io.BytesIO()
    book.active.append(["t", "x [m]"])
    for k in range(3):
        book.active.append([k / 8, 2.5 * k])
    book.save(made)
    return made.getvalue()


def sheets() -> list[bytes]:
    """A workbook, and the XML of its sheet."""
    import zipfile

    with zipfile.ZipFile(io.BytesIO(workbook())) as archive:
        return [archive.read("xl/worksheets/sheet1.xml"), workbook()]


def _saved_by(save: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        save(path)
        return path.read_bytes()


def matlab() -> list[bytes]:
    """MATLAB's files, as they are and compressed."""
    from scipy.io import savemat

    nested = {**ROWS, "run": {"y": np.arange(3.0), "name": "a"}, "cells": np.array([np.arange(2.0), 3.0], dtype=object)}
    return [_saved_by(lambda path, c=c: savemat(path, nested, do_compression=c), ".mat") for c in (False, True)]


@cache
def hdf5() -> list[bytes]:
    """HDF5."""
    import h5py

    def save(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, values in ROWS.items():
                file[f"run/{name}"] = values
            file["run/x"].attrs["unit"] = "m"

    return [_saved_by(save, ".h5")]


def parquet() -> list[bytes]:
    """Parquet."""
    return [_written(".parquet")]
