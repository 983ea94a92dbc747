"""Where the measured records are, for tests that use them: $BAYEQ_DATA, or shared/data beside the checkout."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from bayeq import Record

__all__ = ["measured", "pendulum_record"]

ROOT = Path(os.environ.get("BAYEQ_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def measured(name: str) -> Path:
    """Path of a measured record; skips the test, saying so, where it is absent."""
    path = ROOT / name
    if not path.is_file():
        pytest.skip(f"measured record {name} is absent (looked in {ROOT}; set BAYEQ_DATA)")
    return path


def pendulum_record(path: Path) -> list[Record]:
    """Pieces of the encoder pendulum's .mat file (MATLAB cells Y_id, each 2 x n) as records th, w."""
    from scipy.io import loadmat

    content = loadmat(path)
    times, pieces = content["Time_id"].ravel(), content["Y_id"].ravel()
    return [
        Record.from_arrays(time=np.ravel(t), th=piece[0], w=piece[1], name=f"{path.name} [piece {k}]")
        for k, (t, piece) in enumerate(zip(times, pieces, strict=True))
    ]
