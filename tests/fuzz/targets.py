"""What is fuzzed: one function of bytes per parser. Anything but bayeq's own typed errors is a finding."""

from __future__ import annotations

import contextlib
import io
import os
import struct
import tempfile
import zipfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from bayeq.equation.load import load
from bayeq.errors import BayeqError
from bayeq.expressions import Evaluator, parse
from bayeq.records import Record, read, write
from tests.fuzz import seeds

__all__ = ["TARGETS", "Target"]

COLUMNS = {"x": np.array([-1.5, 0.0, 2.0]), "v": np.array([0.5, 1e9, -3.0]), "u": np.array([1.0, 2.0, 1e-9])}


class Target(NamedTuple):
    """A parser.

    Attributes
    ----------
    run : callable
        Of the bytes to parse.
    seeds : callable
        Valid inputs, from which others are made.
    words : tuple of bytes
        Pieces that mean something to the parser.
    own : bool
        Whether bayeq parses; else a library does.
    """

    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    words: tuple[bytes, ...]
    own: bool = True


@cache
def folder() -> Path:
    """Where files are put, in memory if there is such a place."""
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    made = tempfile.TemporaryDirectory(prefix="bayeq-fuzz-", dir=place)
    _OPEN.append(made)
    return Path(made.name)


_OPEN: list[tempfile.TemporaryDirectory[str]] = []


def _expression(data: bytes) -> None:
    text = data.decode("utf-8", "surrogateescape")
    try:
        expression = parse(text)
    except BayeqError:
        return
    assert parse(expression.text) == expression, "the canonical text is another expression"
    with contextlib.suppress(BayeqError):
        Evaluator(COLUMNS)(expression)


def _file(name: str, data: bytes) -> None:
    path = folder() / name
    path.write_bytes(data)
    try:
        found = read(path)
    except BayeqError as error:
        assert "\n" not in str(error), "a message of several lines"
        return
    for record in found if isinstance(found, list) else [found]:
        assert record.n > 0


def _text(data: bytes) -> None:
    _file("a.csv", data)


def _npz(data: bytes) -> None:
    """An archive as it is, or one array in a sound archive: otherwise check sums hide the arrays."""
    if data[:2] == b"PK":
        _file("a.npz", data)
        return
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("x.npy", data)
    _file("a.npz", made.getvalue())


def _npy(data: bytes) -> None:
    _file("a.npy", data)


def _saved(data: bytes) -> None:
    path = folder() / "a.json"
    path.write_bytes(data)
    with contextlib.suppress(BayeqError):
        str(load(path))


@cache
def _working_folder() -> Path:
    place = folder() / "work"
    place.mkdir()
    rows = Record({name: np.sin(np.arange(12) * k) for k, name in enumerate("xvau", 1)}, np.arange(12) / 8)
    write(rows, place / "r.csv")  # too few rows for an answer: options are read, nothing is written
    os.chdir(place)
    return place


def _command(data: bytes) -> None:
    """Lines are arguments. Commands that read are run on a short record, of others the arguments are read."""
    from bayeq.cli.app import app

    _working_folder()
    given = [line.replace("\0", "") for line in data.decode("utf-8", "replace").split("\n")]
    quiet = io.StringIO()
    with (
        contextlib.suppress(BayeqError, click.ClickException, click.exceptions.Exit),
        contextlib.redirect_stdout(quiet),
        contextlib.redirect_stderr(quiet),
        app.make_context("bayeq", given) as context,
    ):
        if given and given[0] in ("discover", "info") and "r.csv" in given:
            app.invoke(context)
            return
        words = [*context._protected_args, *context.args]
        if not words:
            return
        name, command, rest = app.resolve_command(context, words)
        assert command is not None
        command.make_context(name, rest, parent=context)


def _sheet(data: bytes) -> None:
    """The XML of a sheet in a sound workbook."""
    if data[:2] == b"PK":
        _file("a.xlsx", data)
        return
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(seeds.workbook())) as old, zipfile.ZipFile(made, "w") as new:
        for member in old.namelist():
            new.writestr(member, data if member == "xl/worksheets/sheet1.xml" else old.read(member))
    _file("a.xlsx", made.getvalue())


NUMBERS = (b"0", b"-1", b"1e309", b"1e-320", b"nan", b"inf", b"9" * 30, b"0x1", b"1_0", b"1,5", b"\xff\xfe", b"\0")
BINARY = (struct.pack("<I", 2**32 - 1), struct.pack("<I", 2**31), struct.pack("<Q", 2**63), bytes(8), b"\xff" * 8)
SIGNS = (b"(", b")", b"**", b"*", b"/", b"-", b"sign(", b"where(", b"atan2(", b",", b"<", b"==", b"t", b"pi", b".", b"e9")
HEADER = (b"'descr': '<f8'", b"'descr': '|O'", b"'shape': (3,)", b"(", b"[", b"{", b"'", b'"', b"\n", b"True", b"<U9", b"10**9")
JSON = (b"[", b"{", b"}", b"]", b"null", b"true", b'""', b"1e999", b"-0", b"NaN", b"\\ud800", b'"names"', b":", b",")
TABLE = (b",", b";", b"\t", b'"', b"\n", b"\r", b"# ", b"[m]", b"t", b"12:30:00", b"2020-01-01", b"%", b"1,5", b"=1+1")
OPTIONS = (
    b"discover", b"info", b"simulate", b"predict", b"plan", b"show", b"study", b"r.csv", b"--disp", b"--chain", b"x:v:a",
    b"--input", b"--dictionary", b"polynomial:3", b"--time", b"--rows", b"1:9", b"--band", b"--noise", b"u=1%", b"--units",
    b"--json", b"--method", b"--smooth", b"--fs", b"--remove-offset", b"--seed", b"--group", b"\n", b"=", b"--", b"-",
)  # fmt: skip

#: Every parser.
TARGETS: dict[str, Target] = {
    "expressions": Target(_expression, seeds.expressions, SIGNS + NUMBERS),
    "text": Target(_text, seeds.tables, TABLE + NUMBERS),
    "npz": Target(_npz, seeds.archives, HEADER + BINARY),
    "npy": Target(_npy, seeds.arrays, HEADER + BINARY),
    "json": Target(_saved, seeds.saved, JSON + NUMBERS),
    "command": Target(_command, seeds.commands, OPTIONS + NUMBERS + SIGNS),
    "lvm": Target(partial(_file, "a.lvm"), seeds.lvm, TABLE + NUMBERS),
    "wav": Target(partial(_file, "a.wav"), seeds.wav, BINARY + (b"data", b"fmt ", b"LIST")),
    "excel": Target(_sheet, seeds.sheets, (b"<v>", b"</v>", b"<f>", b'r="A1"', b't="s"', b"<!ENTITY", *NUMBERS), False),
    "matlab": Target(partial(_file, "a.mat"), seeds.matlab, BINARY, False),
    "hdf5": Target(partial(_file, "a.h5"), seeds.hdf5, BINARY, False),
    "parquet": Target(partial(_file, "a.parquet"), seeds.parquet, BINARY, False),
    "uff": Target(partial(_file, "a.unv"), seeds.uff, (b"    -1\n", b"    58\n", *NUMBERS), False),
}
