"""Hostile and damaged files: one line with file and place, nothing executed, memory bounded."""

from __future__ import annotations

import gzip
import io
import struct
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from bayeq.errors import FileFormatError, InputError
from bayeq.records import read
from bayeq.records.formats import protocol

MEMORY = 300 * 2**20


@pytest.fixture
def bounded():
    """Fails a test that allocates more than `MEMORY` bytes."""
    tracemalloc.start()
    yield
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < MEMORY, peak


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def npy_header(text: str) -> bytes:
    body = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(body)) + body


def test_an_archive_that_claims_far_more_than_it_is(tmp_path, bounded):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as member:
        member.write(npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (50_000_000,), }".replace("_", "")))
        for _ in range(400):
            member.write(bytes(10**6))
    assert path.stat().st_size < 2**20
    assert "claims 381 MiB in a file of" in refused(path)


def test_an_archive_of_2_mb_that_claims_2_4_gb(tmp_path, bounded):
    path = tmp_path / "claim.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "x.npy", npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (3,), }") + bytes(2 * 10**6)
        )
    raw = bytearray(path.read_bytes())
    central = raw.rindex(b"PK\x01\x02")
    raw[central + 24 : central + 28] = struct.pack("<I", 2_400_000_000)
    path.write_bytes(raw)
    assert "claims 2.24 GiB in a file of 1.91 MiB" in refused(path)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (10**12,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': ((((((3,), }",
        "__import__('os').abort()",
        "{'descr': '''",
        "",
        "(" * 110,
    ],
)
def test_headers_of_numpy(tmp_path, bounded, header):
    for name in ("a.npy", "a.npz"):
        path = tmp_path / name
        content = npy_header(header) + bytes(24)
        if name == "a.npy":
            path.write_bytes(content)
        else:
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("x.npy", content)
        refused(path)


def test_compressed_text_that_unpacks_to_far_more(tmp_path, bounded):
    path = tmp_path / "bomb.csv.gz"
    with gzip.open(path, "wb") as file:
        for _ in range(120):
            file.write(b"0,0\n" * 250_000)
    assert "more than 100 times the file's size is not read" in refused(path)


def test_a_matlab_file_that_unpacks_to_far_more(tmp_path, bounded):
    size = 120 * 10**6
    array = struct.pack("<IIIIIIIIIIII", 14, size + 48, 6, 8, 6, 0, 5, 8, 1, size // 8, 1, 0) + struct.pack(
        "<II", 9, size
    )
    body = zlib.compress(array + bytes(size), 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path = tmp_path / "bomb.mat"
    path.write_bytes(head + struct.pack("<II", 15, len(body)) + body)
    assert "claims" in refused(path)
    path.write_bytes(head + struct.pack("<II", 14, 4_000_000_000) + bytes(100))
    assert "the variable at byte 136 is cut off" in refused(path)


@pytest.mark.parametrize("packed", [False, True])
def test_types_of_a_matlab_file_are_checked_before_they_are_used(tmp_path, packed):
    """SciPy looks types up in a table without asking whether they are in it: 128 ended the process."""
    from scipy.io import savemat

    content = {"x": np.arange(9.0), "s": {"y": np.arange(3.0), "c": np.array([1.0, "text"], dtype=object)}}
    savemat(tmp_path / "whole.mat", {**content, "z": np.arange(4) * 1j, "e": np.zeros((0, 3))})
    raw = (tmp_path / "whole.mat").read_bytes()
    assert "x" in read(tmp_path / "whole.mat", channels={"x": "x"}).names
    path, seen = tmp_path / "a.mat", set()
    for place in range(128, len(raw), 4):
        for kind in (0, 8, 10, 128, 0xFFFF):
            bad = raw[:place] + struct.pack("<I", kind) + raw[place + 4 :]
            if packed:
                variables, at = b"", 128
                while at + 8 <= len(bad):
                    length = struct.unpack("<I", bad[at + 4 : at + 8])[0]
                    body = zlib.compress(bad[at : at + 8 + length])
                    variables, at = variables + struct.pack("<II", 15, len(body)) + body, at + 8 + length
                bad = bad[:128] + variables
            path.write_bytes(bad)
            try:
                read(path, channels={"x": "x"})
            except InputError as refused:
                seen.add(str(refused).partition("ValueError: ")[2][:20])
    assert any("the type" in text for text in seen)


def test_a_matlab_file_of_version_4_and_objects(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "old.mat", {"x": np.arange(9.0), "dt": 0.5, "words": "run 7"}, format="4")
    record = read(tmp_path / "old.mat")
    assert (record.names, record.fs) == (("x",), 2.0)
    assert record["x"].tolist() == list(range(9))
    whole = (tmp_path / "old.mat").read_bytes()
    for damaged, said in (
        (whole[:50], "is cut off; the file is damaged"),
        (whole[:4] + struct.pack("<i", 2**30) + whole[8:], "is cut off; the file is damaged"),
        (whole[:4] + struct.pack("<i", -1) + whole[8:], "a matrix of type"),
    ):
        (tmp_path / "bad.mat").write_bytes(damaged)
        assert said in refused(tmp_path / "bad.mat")
    savemat(tmp_path / "words.mat", {"label": "run 7"})
    assert "holds no array of numbers" in refused(tmp_path / "words.mat")


def test_links_out_of_an_hdf5_file_are_refused(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = np.arange(9.0)
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file["x"] = h5py.ExternalLink("other.h5", "/x")
    assert "'/x' is a link to another file" in refused(tmp_path / "external.h5")
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout((9,), dtype=float)
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "x", (9,))
        file.create_virtual_dataset("x", layout)
    assert "'/x' is put together from other files" in refused(tmp_path / "virtual.h5")
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        file.create_dataset("x", (2,), float, external=[("/etc/hostname", 0, 16)])
    assert "'/x' is put together from other files" in refused(tmp_path / "raw.h5")
    with h5py.File(tmp_path / "soft.h5", "w") as file:
        file["x"], file["u"] = np.arange(9.0), h5py.SoftLink("/nowhere")
    assert read(tmp_path / "soft.h5").names == ("x",)


def test_an_hdf5_file_whose_strings_have_no_end(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(9.0)
        file["x"].attrs["unit"] = "m"
    whole = path.read_bytes()
    assert read(path).units == {"x": "m"}
    heap = whole.index(b"GCOL")
    # as of a run that was cut off: HDF5 2.0 reads this for ever
    for reserved in (b"\0\0\0", b"\0\0\x10"):
        start = whole[: heap + 5] + reserved + whole[heap + 8 : heap + 16]
        path.write_bytes(start + bytes(4080) + whole[heap + 4096 :])
        assert refused(path).endswith(f"damaged: the strings at byte {heap} have no end; write the file again")
    path.write_bytes(whole[: heap + 20])
    assert "HDF5" in refused(path)


def test_an_hdf5_file_that_claims_what_was_never_written_or_goes_round(tmp_path, bounded):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "empty.h5", "w") as file:
        file.create_dataset("x", (10**12,), float, chunks=(10**6,))
    assert "takes 7.45e+03 GiB; at most 4 GiB are read" in refused(tmp_path / "empty.h5")
    with h5py.File(tmp_path / "round.h5", "w") as file:
        file.create_group("a")["b"] = file["/"]
    assert "nested too deeply, or refers to itself" in refused(tmp_path / "round.h5")
    with h5py.File(tmp_path / "cells.h5", "w") as file:
        cells = file.create_dataset("c", (3,), h5py.ref_dtype)
        cells[:] = [cells.ref] * 3
    assert "nested too deeply, or refers to itself" in refused(tmp_path / "cells.h5")


def test_deep_metadata_of_parquet(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    table = pa.table({"x": [1.0, 2.0]}).replace_schema_metadata({"bayeq.units": "[" * 100_000})
    pq.write_table(table, tmp_path / "deep.parquet")
    assert "not a readable Parquet file" in refused(tmp_path / "deep.parquet")
    units = np.array("[" * 100_000)
    np.savez(tmp_path / "deep.npz", x=np.arange(3.0), __units__=units)
    assert "not a readable .npz archive" in refused(tmp_path / "deep.npz")


def test_a_table_of_a_million_columns(tmp_path, bounded):
    path = tmp_path / "wide.csv"
    path.write_text("1," * 999_999 + "1\n2" + ",2" * 999_999 + "\n")
    assert "line 1: 1000000 columns; at most 16384 are read" in refused(path)
    path.write_text("1," * 5_000_000)
    assert "line 1: longer than 2097152 characters" in refused(path)


def test_excel(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["t", "x"])
    for k in range(5):
        book.active.append([0.1 * k, f"=A{k + 2}*2"])
    book.save(tmp_path / "formulas.xlsx")
    assert np.isnan(read(tmp_path / "formulas.xlsx")["x"]).all()  # never evaluated, and nobody saved their values
    book = openpyxl.Workbook()
    book.active.append([1.0, 2.0])
    book.active.cell(1_048_576, 16_384).value = 1.0
    book.save(tmp_path / "corner.xlsx")
    assert "16384 values where 2 are expected" in refused(tmp_path / "corner.xlsx")
    book = openpyxl.Workbook()
    book.active.append(["only", "words"])
    book.save(tmp_path / "words.xlsx")
    assert "no sheet holds numbers" in refused(tmp_path / "words.xlsx")


def test_wav(tmp_path):
    def put(form: bytes, size: int, samples: bytes) -> Path:
        body = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", size) + samples
        path = tmp_path / "a.wav"
        path.write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
        return path

    pcm = struct.pack("<HHIIHH", 1, 1, 100, 300, 3, 24)
    assert read(put(pcm, 6, b"\x00\x00\x40\x00\x00\xc0"))["c1"].tolist() == [0.5, -0.5]
    pcm = struct.pack("<HHIIHH", 1, 1, 100, 200, 2, 16)
    assert read(put(pcm, 4, struct.pack("<hh", 16384, -32768)))["c1"].tolist() == [0.5, -1.0]
    assert read(put(struct.pack("<HHIIHH", 1, 1, 100, 100, 1, 8), 2, b"\xc0\x00"))["c1"].tolist() == [0.5, -1.0]
    assert "4 bytes of samples where 4000000000 are expected" in refused(put(pcm, 4_000_000_000, bytes(4)))
    assert "samples of kind 85" in refused(put(struct.pack("<HHIIHH", 85, 1, 100, 200, 2, 16), 4, bytes(4)))
    assert "0 channels at 100 Hz" in refused(put(struct.pack("<HHIIHH", 1, 0, 100, 200, 2, 16), 4, bytes(4)))


def test_uff_without_time_histories_and_cut_off(tmp_path):
    pytest.importorskip("pyuff")
    whole = (Path(__file__).parent / "instruments" / "simcenter.unv").read_text()
    path = tmp_path / "a.unv"
    path.write_text(whole.replace("    1         0    0         0", "    4         0    0         0"))
    assert "no time history" in refused(path)
    path.write_text(whole.replace("         2         8         1", "         2         9         1"))
    assert "8 samples where 9 are stated" in refused(path)
    path.write_text(whole + whole[:-7])
    assert "2 functions begin and 1 end; the file is cut off" in refused(path)


def test_lvm_of_several_segments_and_cut_off(tmp_path):
    whole = (Path(__file__).parent / "instruments" / "ni_labview.lvm").read_text()
    segment = whole[whole.index("Channels\t2") :]
    path = tmp_path / "a.lvm"
    path.write_text(whole + "\n" + segment)
    assert "name the channels to read; there are: [0].Acceleration, [0].Force, [1]" in refused(path)
    two = read(path, channels={"a": "[*].Acceleration"})
    assert [record.fs for record in two] == pytest.approx([1000, 1000])
    path.write_text(whole.replace("\t0,500000\t-0,750000\n", ""))
    assert "3 rows where the header states 4; the file is cut off" in refused(path)
    one = whole.replace("Multi_Headings\tYes", "Multi_Headings\tNo")
    path.write_text(one + "\t0,625000\t-0,500000\n")  # rows of a second segment under the one header
    assert read(path)["Acceleration"].tolist() == [0.125, 0.25, 0.375, 0.5, 0.625]
    path.write_text(whole.replace("0,500000", "five"))
    assert "line 27, column 'Acceleration': 'five' is not a number" in refused(path)


def test_claims():
    protocol.check_claim("f", "it", 64 * 2**20, 1)
    with pytest.raises(FileFormatError, match="claims 64 MiB in a file of 1 bytes"):
        protocol.check_claim("f", "it", 64 * 2**20 + 1, 1)
    with pytest.raises(FileFormatError, match="takes 4 GiB; at most 4 GiB"):
        protocol.check_claim("f", "it", 4 * 2**30 + 1, 2**40)


def test_no_file_is_executed(tmp_path):
    class Harm:
        def __reduce__(self):
            return (open, (str(tmp_path / "harm"), "w"))

    raw = io.BytesIO()
    np.save(raw, np.array([Harm()], dtype=object), allow_pickle=True)
    (tmp_path / "a.npy").write_bytes(raw.getvalue())
    assert "pickled objects, which are refused" in refused(tmp_path / "a.npy")
    assert not (tmp_path / "harm").exists()
