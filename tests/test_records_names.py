"""Headers to channel names."""

from __future__ import annotations

import keyword

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayeq.records.columns import Headers
from bayeq.records.names import RESERVED, clean_name, clean_names


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("x [m]", "x", "m"),
        ("x (m)", "x", "m"),
        ("x[m/(s*s)]", "x", "m/(s*s)"),
        ("acc-1", "acc_1", None),
        ("Time [s]", "Time", "s"),
        ('"wheel speed"', "wheel_speed", None),
        ("lambda", "lambda_", None),
        ("sin", "sin_", None),
        ("2nd", "_2nd", None),
        ("", "c3", None),
        ("%", "c3", None),
        ("[V]", "c3", "V"),
        ("x []", "x", None),
        ("x(t)", "x", None),
        ("dx/dt [m/s]", "dx_dt", "m/s"),
        ("θ [rad]", "θ", "rad"),
        ("x (a[b])", "x_a_b", None),  # a unit has no square brackets
        ("x [m\u200b/s]", "x", "m/s"),  # nor what cannot be seen
        ("x [\n m\u00a0s ]", "x", "m s"),
        ("nan", "nan_", None),
        ("\ufefft", "t", None),
    ],
)
def test_clean_name(header: str, name: str, unit: str | None) -> None:
    assert clean_name(header, 3) == (name, unit)


@given(st.text(max_size=12))
def test_names_are_identifiers_and_cleaning_twice_is_cleaning_once(header: str) -> None:
    name, _ = clean_name(header)
    assert name.isidentifier()
    assert not keyword.iskeyword(name)
    assert name not in RESERVED
    assert clean_name(name) == (name, None)


@given(st.lists(st.sampled_from(["x", "x_2", "x [m]", "", "c1", "c2", "y"]), max_size=8))
def test_names_are_unique(headers: list[str]) -> None:
    names, units = clean_names(headers)
    assert len(set(names)) == len(names) == len(units) == len(headers)


def test_repeated_header() -> None:
    assert clean_names(["w1", "w2", "w1", "w2"])[0] == ["w1", "w2", "w1_2", "w2_2"]


@pytest.mark.parametrize(
    ("names", "time"),
    [(["x", "Time [s]"], 1), (["T", "x"], 0), (["x", "T"], None), (["T", "t"], 1), (["a", "Timestamp"], 1)],
)
def test_which_column_is_time(names: list[str], time: int | None) -> None:
    assert Headers.parse(names).time == time
