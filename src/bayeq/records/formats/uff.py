"""Universal files with time histories (dataset 58, text or binary), by pyuff (the extra ``files``)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError, needing
from bayeq.records.formats.nested import Channel
from bayeq.records.formats.protocol import reading
from bayeq.records.validate import SECONDS

# A delimiter, which fills columns 1 to 6, and the number of a dataset.
_BEGIN = re.compile(rb"(?:\A|\n)    -1[ \t]*\r?\n *(\d{1,5})[ b\r\n]")
TIME_RESPONSE, TIME, EVEN = 1, 17, 1
_KINDS = {8: "disp", 9: "reaction", 11: "vel", 12: "acc", 13: "force", 15: "pressure", 3: "strain", 2: "stress"}
_AXES = {0: "", 1: "x", 2: "y", 3: "z", 4: "rx", 5: "ry", 6: "rz"}


def is_uff(path: Path, head: bytes) -> bool:
    return _BEGIN.match(head) is not None


def channels(path: Path) -> list[Channel]:
    """List the time histories of a file: path ``[0]``, ``[1]`` ..., named by kind, node and axis, as ``acc_5_z``."""
    with needing("pyuff", "files", "reading universal files"):
        import pyuff
    where = str(path)
    with reading(where, "universal file"):
        file = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in file.get_set_types()]
        begun = sum(number == b"58" for number in _BEGIN.findall(path.read_bytes()))
        if kinds.count(58) < begun:
            raise FileFormatError(f"{where}: {begun} functions begin and {kinds.count(58)} end; the file is cut off")
        functions = [file.read_sets(k) for k, kind in enumerate(kinds) if kind == 58]
    histories = ((place, one) for place, one in enumerate(functions) if _is_history(one))
    found = [channel for place, one in histories for channel in _channels(one, place, where)]
    if not found:
        raise FileFormatError(
            f"{where}: no time history (dataset 58 of function type 1) among {len(functions)} functions; spectra and"
            " frequency responses are no records"
        )
    return found


def _is_history(function: Mapping[str, Any]) -> bool:
    kind = function.get("func_type")
    over_time = kind == TIME_RESPONSE or (kind == 0 and function.get("abscissa_spec_data_type") == TIME)
    return over_time and not np.iscomplexobj(np.asarray(function.get("data")))


def _channels(function: Mapping[str, Any], place: int, where: str) -> list[Channel]:
    """A time history, and its times where they are uneven."""
    values, expected = np.asarray(function["data"], dtype=float), int(function["num_pts"])
    if len(values) != expected:
        raise FileFormatError(
            f"{where}: function {place} has {len(values)} samples where {expected} are stated; the file is damaged"
        )
    kind = _KINDS.get(function["ordinate_spec_data_type"], "y")
    axis, node = function["rsp_dir"], function["rsp_node"]
    words = (kind, str(node) if node else "", ("m" if axis < 0 else "") + _AXES.get(abs(axis), ""))
    label, unit = "_".join(word for word in words if word), _label(function.get("ordinate_axis_units_lab"))
    factor = SECONDS.get(_label(function.get("abscissa_axis_units_lab")) or "s", 1.0)
    if function["abscissa_spacing"] == EVEN:
        step, start = function["abscissa_inc"] * factor, function["abscissa_min"] * factor
        if not step > 0:
            raise FileFormatError(f"{where}: function {place} has a time step of {step:g} s; the file is damaged")
        return [Channel(f"[{place}]", len(values), values.__getitem__, label, unit, step, start)]
    times = np.asarray(function["x"], dtype=float) * factor
    return [
        Channel(f"[{place}].t", len(times), times.__getitem__, "t" if not place else f"t_{place}", "s"),
        Channel(f"[{place}]", len(values), values.__getitem__, label, unit),
    ]


def _label(text: Any) -> str | None:
    text = str(text or "").strip()
    return None if text.upper() in ("", "NONE") else text
