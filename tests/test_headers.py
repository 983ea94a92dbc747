"""Headers as in the field: the proposed command is right, or says which question to answer; it is never wrong."""

from __future__ import annotations

from collections import Counter

import pytest

import bayeq as bq
from tests.headers import FRESH, TUNED

ALL = (*TUNED, *FRESH)


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory):
    """What is thought of each proposal, by the name of its headers."""
    folder = tmp_path_factory.mktemp("headers")
    out = {}
    for k, headers in enumerate(ALL):
        path = folder / f"{k}.csv"
        path.write_text(headers.text(), encoding="utf-8")
        out[headers.name] = headers.judge(bq.info(path))
    return out


def test_no_proposal_is_wrong(verdicts):
    assert {name: verdict for name, verdict in verdicts.items() if verdict.startswith("wrong")} == {}


def test_of_forty_at_least_38_are_right_or_ask(verdicts):
    assert len(verdicts) == len(ALL) == 40
    counts = Counter(verdict.split(":")[0] for verdict in verdicts.values())
    assert counts["right"] + counts["asks"] >= 38
    assert counts["right"] >= 36


@pytest.mark.parametrize(
    "headers",
    [*(pytest.param(one, marks=pytest.mark.slow) for one in TUNED), *FRESH],
    ids=lambda headers: headers.name,
)
def test_without_names_nothing_is_wrong(headers, tmp_path):
    path = tmp_path / "a.csv"
    bare = headers.without_names()
    path.write_text(bare.text())
    assert not bare.judge(bq.info(path)).startswith("wrong")
