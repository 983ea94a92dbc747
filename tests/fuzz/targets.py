"""What is fuzzed: one function of bytes per parser. Anything but bayeq's own typed errors is a finding."""

from __future__ import annotations

import contextlib
import io
import math
import os
import struct
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from bayeq.dictionary import Variables, build_dictionaries
from bayeq.dictionary.ranges import families, grids, located
from bayeq.equation.load import load
from bayeq.equation.written import constant_units
from bayeq.errors import BayeqError
from bayeq.expressions import Evaluator, parse
from bayeq.records import Record, read, write
from bayeq.regression.constraints import parse_conserved, parse_constraints, parse_ties
from bayeq.states import Roles, with_laws
from bayeq.states.roles import parse_chains
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
    assert parse(expression.text) == expression.named(), "the canonical text is another expression"
    with contextlib.suppress(BayeqError):
        Evaluator(COLUMNS)(expression)


def _dictionary(data: bytes) -> None:
    text = data.decode("utf-8", "surrogateescape")
    with contextlib.suppress(BayeqError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        terms, allowed = build_dictionaries(text, ("a",), Variables(("x", "v"), ("u",)))
        assert allowed.shape == (1, len(terms))
        assert len({term.text for term in terms}) == len(terms), "two terms with one text"
        constants = located(terms, [{**COLUMNS, "t": np.arange(3.0)}])
        assert all(-math.inf < one.low < one.high < math.inf for one in constants.values()), "a range without ends"
        constant_units(terms, {"x": "m", "v": "m/s"})
        for family in families(terms):
            own = [terms[j].with_unknowns(constants) for j in family]
            next(grids(own, constants, [{**COLUMNS, "t": np.arange(3.0)}]))


def _known(data: bytes) -> None:
    """Constraints, ties between equations, conserved sums and laws of hidden states."""
    text = data.decode("utf-8", "surrogateescape")
    terms = [parse(one) for one in ("x1-x2", "x2-x1", "x1", "u", "x1**3", "x1*abs(x1)")]
    with contextlib.suppress(BayeqError):
        for one in parse_constraints([text], terms, ("a", "b")):
            assert np.isfinite(one.equalities.slopes).all()
            assert (one.limits[:, 0] < one.limits[:, 1]).all()
            assert all(sd > 0.0 and math.isfinite(mean) for _, mean, sd in one.stated)
    with contextlib.suppress(BayeqError):
        for _, parts, value in parse_ties([text], terms, ("a", "b")):
            assert all(math.isfinite(factor) for _, _, factor in parts)
            assert math.isfinite(value)
    with contextlib.suppress(BayeqError):
        assert len(parse_conserved(text, parse_chains(["S", "I", "R"]))) > 1
    with contextlib.suppress(BayeqError):
        with_laws(text, Roles.parse(["x1::"], inputs=["u"]))


def _file(name: str, data: bytes) -> None:
    path = folder() / name
    path.write_bytes(data)
    try:
        found = read(path)
    except BayeqError as error:
        if "\n" in str(error):
            raise ValueError("a message of several lines") from error
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
    _working_folder()
    given = [line.replace("\0", "") for line in data.decode("utf-8", "replace").split("\n")]
    quiet = io.StringIO()
    try:
        _invoked(given, quiet)
    except OSError as error:
        if error.filename is None:  # with a name it is one line, `bayeq.cli.app.main`
            raise


def _invoked(given: list[str], quiet: io.StringIO) -> None:
    from bayeq.cli.app import app

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


def _words(text: str) -> tuple[bytes, ...]:
    return tuple(word.encode() for word in text.split())


NUMBERS = (*_words("0 -1 1e309 1e-320 nan inf 0x1 1_0 1,5"), b"9" * 30, b"\xff\xfe", b"\0")
BINARY = (struct.pack("<I", 2**32 - 1), struct.pack("<I", 2**31), struct.pack("<Q", 2**63), bytes(8), b"\xff" * 8)
SIGNS = _words("( ) ** * / - sign( where( atan2( , < == t pi . e9 {a} {b:1..2} { } .. | : tanh( sin( [-1] [")
HEADER = (*_words("'descr':'<f8' 'descr':'|O' 'shape':(3,) ( [ { ' True <U9 10**9"), b'"', b"\n")
JSON = _words('[ { } ] null true "" 1e999 -0 NaN \\ud800 "names" : ,')
TABLE = (*_words('; " # [m] t 12:30:00 2020-01-01 % 1,5 =1+1'), b",", b"\t", b"\n", b"\r")
OPTIONS = (
    *_words(
        "discover info simulate predict plan show study r.csv --disp --chain x:v:a --input --dictionary --time --rows"
    ),
    *_words(
        "polynomial:3 1:9 --band --noise u=1% --units --json --method --smooth --fs --remove-offset --seed --group"
    ),
    *_words("= -- -"),
    b"\n",
)

#: Every parser.
TARGETS: dict[str, Target] = {
    "expressions": Target(_expression, seeds.expressions, SIGNS + NUMBERS),
    "dictionaries": Target(_dictionary, seeds.dictionaries, (*SIGNS, *NUMBERS, *_words("oscillator fourier:2 + ; a:"))),
    "known": Target(_known, seeds.known, (*SIGNS, *NUMBERS, *_words("== <= >= ~ +- a: b: df d 2*( S + I"))),
    "text": Target(_text, seeds.tables, TABLE + NUMBERS),
    "npz": Target(_npz, seeds.archives, HEADER + BINARY),
    "npy": Target(_npy, seeds.arrays, HEADER + BINARY),
    "json": Target(_saved, seeds.saved, JSON + NUMBERS),
    "command": Target(_command, seeds.commands, OPTIONS + NUMBERS + SIGNS),
    "lvm": Target(partial(_file, "a.lvm"), seeds.lvm, TABLE + NUMBERS),
    "wav": Target(partial(_file, "a.wav"), seeds.wav, (*BINARY, b"data", b"fmt ", b"LIST")),
    "excel": Target(_sheet, seeds.sheets, (b"<v>", b"</v>", b"<f>", b'r="A1"', b't="s"', b"<!ENTITY", *NUMBERS), False),
    "matlab": Target(partial(_file, "a.mat"), seeds.matlab, BINARY, False),
    "hdf5": Target(partial(_file, "a.h5"), seeds.hdf5, BINARY, False),
    "parquet": Target(partial(_file, "a.parquet"), seeds.parquet, BINARY, False),
    "uff": Target(partial(_file, "a.unv"), seeds.uff, (b"    -1\n", b"    58\n", *NUMBERS), False),
}
