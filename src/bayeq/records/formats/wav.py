"""WAV files: PCM of 8 to 32 bits as shares of full scale, or floating point; the rate is kept."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns, Headers, Names, Select
from bayeq.records.formats.protocol import reading

PCM, FLOAT, EXTENSIBLE = 1, 3, 0xFFFE


def is_wav(path: Path, head: bytes) -> bool:
    return head[:4] == b"RIFF" and head[8:12] == b"WAVE"


def read_columns(path: Path, *, names: Names = None, chosen: Select | None = None) -> Columns:
    """Read the channels c1, c2 and so on; whole numbers are divided by full scale, so that they are within -1 and 1."""
    where = str(path)
    with reading(where, "WAV file"), path.open("rb") as file:
        kind, count, rate, bits, raw = _chunks(file, where)
    if not 1 <= count <= 1024 or rate <= 0:
        raise FileFormatError(f"{where}: {count} channels at {rate} Hz; the file is damaged")
    width = bits // 8 * count
    if not width or len(raw) < width:
        raise FileFormatError(f"{where}: no rows")
    samples = _samples(raw[: len(raw) - len(raw) % width], kind, bits, where).reshape(-1, count)
    headers = Headers.parse([""] * count, where).renamed(names)
    data = Columns.build(headers, lambda i: samples[:, i], chosen)
    return replace(data, step=1.0 / rate)


def _chunks(file: IO[bytes], where: str) -> tuple[int, int, int, int, bytes]:
    """Kind of samples, number of channels, rate [Hz], bits of a sample, and the samples."""
    file.seek(12)
    form: tuple[int, int, int, int] | None = None
    while len(mark := file.read(8)) == 8:
        name, size = struct.unpack("<4sI", mark)
        if name == b"fmt ":
            body = file.read(size)
            kind, count, rate, _, _, bits = struct.unpack_from("<HHIIHH", body)
            if kind == EXTENSIBLE:
                kind = struct.unpack_from("<H", body, 24)[0]
            form = (kind, count, rate, bits)
            file.seek(size % 2, 1)
        elif name == b"data":
            if form is None:
                raise FileFormatError(f"{where}: samples before their format; the file is damaged")
            raw = file.read()
            if size in (0, 0xFFFFFFFF):  # length unknown to the recorder
                return (*form, raw)
            if len(raw) < size:
                raise FileFormatError(
                    f"{where}: {len(raw)} bytes of samples where {size} are expected; the file is cut off"
                )
            return (*form, raw[:size])
        else:
            file.seek(size + size % 2, 1)
    raise FileFormatError(f"{where}: no samples; the file is cut off")


def _samples(raw: bytes, kind: int, bits: int, where: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    if kind == FLOAT and bits in (32, 64):
        return np.frombuffer(raw, f"<f{bits // 8}").astype(np.float64)
    if kind == PCM and bits == 8:
        return (np.frombuffer(raw, np.uint8).astype(np.float64) - 128.0) / 128.0
    if kind == PCM and bits == 24:
        padded = np.zeros((len(raw) // 3, 4), dtype=np.uint8)  # the lowest byte stays zero, to keep the sign
        padded[:, 1:] = np.frombuffer(raw, np.uint8).reshape(-1, 3)
        return padded.view("<i4").ravel() / 2.0**31
    if kind == PCM and bits in (16, 32):
        return np.frombuffer(raw, f"<i{bits // 8}") / 2.0 ** (bits - 1)
    raise FileFormatError(f"{where}: samples of kind {kind} with {bits} bits are not read; save PCM or floating point")
