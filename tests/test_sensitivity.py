"""Settings for a while, and what the study sees of their use."""

from __future__ import annotations

import numpy as np
import pytest
from studies.overridden import overridden
from studies.sensitivity import Answer, Compared, Used, differences, moved

from bayeq.numerics.settings import SELECTION


def test_other_values_go_after_an_error_too():
    before = SELECTION.tolerance
    with pytest.raises(ZeroDivisionError), overridden(SELECTION, tolerance=0.0):
        1.0 / SELECTION.tolerance
    assert before == SELECTION.tolerance == type(SELECTION)().tolerance


def test_halves_and_doubles_are_values_of_the_kind():
    assert moved(5) == (2, 10)
    assert moved(1) == (1, 2)
    assert moved(0.1) == (0.05, 0.2)
    assert moved(0.9) == pytest.approx((0.45, 0.95))
    assert moved(1.5) == (1.25, 2.0)
    assert moved(1.5, "nats") == (0.75, 3.0)


def test_a_comparison_shows_whether_half_or_twice_would_decide_otherwise():
    one = Compared(("S", "least"), 4.0, (2.0, 8.0))
    assert one < 10.0
    assert not one < 1.0
    assert one.differs == [False, False]
    assert (np.array([1.0, 3.0, 10.0]) > one).tolist() == [False, False, True]
    assert one.differs == [True, False]
    assert max(one, 6.0) == 6.0
    assert one.differs == [True, True]


@pytest.mark.parametrize("use", [lambda one: 2.0 * one, lambda one: np.ones(3) + one, float, range, np.sqrt, np.array])
def test_any_other_use_is_seen(use):
    with pytest.raises(Used):
        use(Compared(("S", "least"), 4.0, (2.0, 8.0)))


def test_answers_are_compared_by_terms_verdict_warnings_and_numbers():
    usual = Answer({"a x": (0.1, 1.0, 0.8, 1.2)}, "found", [])
    assert differences(usual, usual) == {}
    other = Answer({"a x": (0.1, 1.05, 0.8, 1.3), "a v": (1.0, 1.0, 0.0, 2.0)}, "found", [])
    assert differences(usual, other) == {"terms": 1.0, "verdict": 0.0, "warnings": 0.0, "sd": pytest.approx(1.0)}
