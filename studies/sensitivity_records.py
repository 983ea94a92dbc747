"""Twenty short records of the kinds of docs/evidence.md, and the questions that are asked of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.records import Record, read
from bayeq.systems import get_system, simulate
from studies import adverse_records, band, constants, forces, implicit, lags, nearly_true, states_only, static_laws
from studies import numbers_records as kinds

__all__ = ["RECORDS", "Question", "data_folder"]

# A record, or several, and the arguments of `discover` beside them.
Question = tuple[Record | list[Record], Mapping[str, Any]]

SPOILED = 300
OSCILLATOR: Mapping[str, Any] = {"chains": "x:v:a", "inputs": ["u"]}


def data_folder() -> Path:
    """Where the measured records are: $BAYEQ_DATA, or shared/data beside the checkout."""
    return Path(os.environ.get("BAYEQ_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def _paper(rows: int, seed: int, **asked: Any) -> Question:
    record, question, _ = kinds.draw_paper(seed, **asked)
    assert isinstance(record, Record)
    return record.slice(0, rows), question


def _rows(system: str, seed: int) -> Question:
    """Taken as measured, without the likelihood of the record."""
    return simulate(system, n=500, seed=seed, noise=0.01), {**OSCILLATOR, "smooth": "none"}


def _drawn(drawn: kinds.Drawn, rows: int | None = None) -> Question:
    record = drawn.records
    return record.slice(0, rows) if isinstance(record, Record) and rows else record, drawn.question


def _lorenz(seed: int) -> Question:
    record = simulate(get_system("lorenz"), n=500, seed=seed, noise=0.1)
    return record, {"chains": ["x", "y", "z"], "dictionary": "polynomial:2"}


def _vanderpol(seed: int) -> Question:
    record = states_only.draw_record("vanderpol", 10.0, 0.1, seed)
    return record, {"chains": list(record.channels), "dictionary": "polynomial:3"}


def _spoiled(seed: int) -> Question:
    """Spikes in x, the acceleration stuck for 30 rows, a gap of 3 samples and jittered time stamps."""
    rng, case = np.random.default_rng(seed), adverse_records.CASES["clean"]
    record = adverse_records.draw_record(case, SPOILED, seed)
    channels = {name: np.array(record[name]) for name in adverse_records.CHANNELS}
    for row in (61, 122, 256):
        channels["x"][row] += 3.0 * channels["x"].std()
    channels["a"][170:200] = channels["a"][170]
    time = (np.arange(SPOILED) + 0.02 * rng.standard_normal(SPOILED)) / adverse_records.RATE
    kept = np.r_[0:140, 143:SPOILED]
    return Record.from_arrays({name: values[kept] for name, values in channels.items()}, time=time[kept]), OSCILLATOR


def _adverse(case: str, seed: int) -> Question:
    return adverse_records.draw_record(adverse_records.CASES[case], 300, seed), OSCILLATOR


def _measured(name: str, ask: Callable[[Path], Question]) -> Callable[[int], Question | None]:
    def found(_: int) -> Question | None:
        path = data_folder() / name
        return ask(path) if path.is_file() else None

    return found


def _lagged(seed: int) -> Question:
    record, _, late, _ = lags.draw_record("input", "x:v:a", 0.02, seed)
    terms = lags.TERMS.format(v="v")
    return record.slice(0, 400), {**OSCILLATOR, "dictionary": terms, "lag_sd": {late: lags.LAG_SD}}


def _static(seed: int) -> Question:
    record, *_ = static_laws.draw_record("sign", 0.02, seed)
    return record.slice(0, 300), {"target": "F", "inputs": ["x", "v"], "dictionary": static_laws.BESIDE}


def _constants(seed: int) -> Question:
    record, *_ = constants.draw_record("tanh", 0.01, seed)
    return record.slice(0, 300), {**OSCILLATOR, "dictionary": "x, v, u, x**3, v*abs(v), tanh(v/{v0})"}


def _implicit(seed: int) -> Question:
    record, _ = implicit.cart_pole(0.005, seed)
    return record.slice(0, 250), implicit.SYSTEMS["cart-pole"][1]


# A record that was measured is None where it is absent.
RECORDS: Mapping[str, Callable[[int], Question | None]] = {
    "Duffing, x::, 1 %": partial(_paper, 400, system="duffing", chain="x::", noise=0.01, free=False, all_terms=True),
    "Coulomb, free, x:v:": partial(_paper, 400, system="coulomb", chain="x:v:", noise=0.01, free=True, all_terms=True),
    "linear, as rows": partial(_rows, "linear"),
    "ring-down, ::a": lambda seed: _drawn(kinds.draw_ringdown(seed, 0.02, 0.01, True)),
    "sign(x) and x**3, x::": lambda seed: _drawn(kinds.draw_sign_oscillator(seed, "sign(x)", "x**3", 0.01, 300)),
    "Lorenz, 10 %": _lorenz,
    "Van der Pol, 10 %": _vanderpol,
    "growth, 26 rows": lambda seed: _drawn(kinds.draw_growth(seed, 26)),
    "blows, x:v:a": lambda seed: (forces.draw_record("blows", (0.02, 0.02), seed)[0].slice(0, 300), OSCILLATOR),
    "unmeasured force of 10 %": partial(_adverse, "second force of 10 %"),
    "1/f noise": partial(_adverse, "1/f noise"),
    "spikes, stuck, gap": _spoiled,
    "hum, band": lambda seed: (band.draw_record("hum", seed).slice(0, 400), {**OSCILLATOR, "band": band.BAND}),
    "misfit of 3 %": lambda seed: (nearly_true.draw_record(seed, 0.03)[0].slice(0, 300), OSCILLATOR),
    "lag of u": _lagged,
    "static law": _static,
    "tanh(v/v0)": _constants,
    "cart-pole, implicit": _implicit,
    "measured: air track": _measured(
        "schmidt_lipson/real_linear_a_1.txt", lambda path: (read(path).slice(0, 300), {"chains": "x:v:a"})
    ),
    "measured: hare and lynx": _measured(
        "lynx_hare/hudson-bay-lynx-hare.csv",
        lambda path: (read(path, time="Year"), {"chains": ["Hare", "Lynx"], "dictionary": "polynomial:2"}),
    ),
}
