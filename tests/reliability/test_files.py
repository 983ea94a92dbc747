"""Files that change while they are read, and outputs that are also inputs."""

from __future__ import annotations

import json
import os

import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import FileFormatError
from bayeq.records.formats import text
from bayeq.records.stream import open_streams
from tests.reliability.commands import QUICK

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")


def changed(path, how):
    """The same number of rows and bytes for "replaced"."""
    content = path.read_bytes()
    if how == "longer":
        path.write_bytes(content + content.splitlines(keepends=True)[-1])
    elif how == "shorter":
        path.write_bytes(content[: len(content) // 2])
    else:
        path.write_bytes(content[:200].replace(b"0", b"1") + content[200:])
        os.utime(path, (2e9, 2e9))


HOW = pytest.mark.parametrize("how", ["longer", "shorter", "replaced"])


@HOW
def test_a_file_that_changes_while_it_is_read_whole_is_refused(how, folder, monkeypatch):
    path, read_columns = folder / "run.csv", text.read_columns

    def meanwhile(*arguments, **options):
        found = read_columns(*arguments, **options)
        changed(path, how)
        return found

    monkeypatch.setattr(text, "read_columns", meanwhile)
    with pytest.raises(FileFormatError, match=r"run.csv: has changed while it was read; start once more"):
        bq.read(path)


@HOW
@pytest.mark.parametrize("suffix", ["csv", "parquet", "npy"])
def test_a_file_that_changes_between_rows_is_refused(how, suffix, folder):
    pytest.importorskip("pyarrow")
    record, path = bq.read(folder / "run.csv"), folder / f"long.{suffix}"
    if suffix == "npy":
        import numpy as np

        np.save(path, np.column_stack([record.time, *record.channels.values()]))
    else:
        bq.write(record, path)
    (stream,) = open_streams([path])
    stream.read(0, 100)
    changed(path, how)
    with pytest.raises(FileFormatError, match=rf"long.{suffix}: has changed while it was read"):
        stream.read(100, 200)


def test_a_report_holds_no_hash_of_other_rows(folder, capsys, monkeypatch):
    path, page = folder / "run.csv", folder / "page.html"
    from bayeq import discovery

    discover = discovery.discover

    def meanwhile(*arguments, **options):
        changed(path, "longer")
        return discover(*arguments, **options)

    monkeypatch.setattr(discovery, "discover", meanwhile)
    assert main(["discover", str(path), *QUICK, "--report", str(page), "--save", str(folder / "eq.json")]) == 2
    out, err = capsys.readouterr()
    assert "\na = " in out
    assert "run.csv: has changed while it was read" in err
    assert not page.exists()
    assert json.loads((folder / "eq.json").read_text())


def test_an_output_is_no_input(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    terms, rows = folder / "terms.txt", folder / "rows"
    terms.write_text("x\nv\nu\n")
    rows.mkdir()
    for name in ("1.csv", "2.csv"):
        (rows / name).write_bytes((folder / "run.csv").read_bytes())
    (folder / "link.csv").symlink_to("run.csv")
    os.link("run.csv", "same.csv")
    assert main(["discover", "run.csv", *QUICK, "--save", "eq.json"]) == 0
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    given = ["discover", "run.csv", *QUICK]
    of_terms = ["discover", "run.csv", *QUICK[:8], "--dictionary"]
    for command in (
        [*given, "--forecast", "run.csv"],
        [*given, "--path", "link.csv"],
        [*given, "--sensitivity", "same.csv"],
        [*of_terms, "terms.txt", "--save", "terms.txt"],
        [*of_terms, "a: terms.txt", "--save", "./terms.txt"],
        ["discover", "rows", *QUICK, "--path", "rows/2.csv"],
        ["predict", "eq.json", "run.csv", "--forecast", "run.csv"],
        ["plan", "eq.json", "--output", "eq.json"],
        ["study", "table2", "--store", "run.csv"],
        ["study", "figures", "run.csv", "--systems", "linear"],
    ):
        capsys.readouterr()
        assert main(command) == 2
        said = capsys.readouterr().err
        assert (said.startswith("bayeq: error: "), said.count("\n")) == (True, 1)
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
