"""National Instruments' TDMS files, by npTDMS (the extra ``files``)."""

from __future__ import annotations

import logging
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError, needing
from bayeq.records.formats.nested import Channel
from bayeq.records.formats.protocol import check_array, reading


def channels(path: Path) -> list[Channel]:
    """List the channels of a file: path ``group.channel``, named after the channel if its name is unique."""
    with needing("npTDMS", "files", "reading TDMS files"):
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    where, size = str(path), path.stat().st_size
    found: list[Channel] = []
    log_manager.set_level(logging.CRITICAL)  # faults are reported by an error of one line
    with reading(where, "TDMS file"), path.open("rb") as raw, TdmsFile.open(raw) as file:
        if file.file_status.incomplete_final_segment:
            raise FileFormatError(f"{where}: the last segment is incomplete; the file is cut off")
        every = [(group.name, channel) for group in file.groups() for channel in group.channels()]
        count = Counter(channel.name for _, channel in every)
        for group, channel in every:
            if channel.dtype is None or np.dtype(channel.dtype).kind not in "biufM" or not len(channel):
                continue  # text and empty channels
            place = f"{group}.{channel.name}"
            check_array(where, place, (len(channel),), np.dtype(channel.dtype).itemsize, size)
            label = channel.name if count[channel.name] == 1 else f"{group} {channel.name}"
            values, about = channel[:], channel.properties
            unit = str(about.get("unit_string") or "").strip() or None
            step, start = (_number(about.get(key)) for key in ("wf_increment", "wf_start_offset"))
            if step is None or step <= 0:
                step = start = None
            found.append(Channel(place, len(values), values.__getitem__, label, unit, step, start or 0.0))
    return found


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and np.isfinite(value) else None
