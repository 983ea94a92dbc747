"""Headers as in the field: the proposed command is right, or says which question to answer; it is never wrong."""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

import bayeq as bq
from tests.headers import FRESH, TUNED

ALL = {headers.name: headers for headers in (*TUNED, *FRESH)}


@cache
def verdict_on(name):
    """What is thought of a proposal, by the name of its headers."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        path.write_text(ALL[name].text(), encoding="utf-8")
        return ALL[name].judge(bq.info(path))


# The fresh ones, which were harder, or all.
HEADERS = pytest.mark.statistical(short=len(FRESH), full=len(ALL))


@HEADERS
def test_no_proposal_is_wrong(number):
    verdicts = {name: verdict_on(name) for name in list(ALL)[-number:]}
    assert {name: verdict for name, verdict in verdicts.items() if verdict.startswith("wrong")} == {}


@HEADERS
def test_of_forty_at_least_38_are_right_or_ask(number):
    assert len(ALL) == 40
    counts = Counter(verdict_on(name).split(":")[0] for name in list(ALL)[-number:])
    assert counts["right"] + counts["asks"] >= 38 / 40 * number
    assert counts["right"] >= 36 / 40 * number


@pytest.mark.parametrize(
    "headers",
    [*(pytest.param(one, marks=pytest.mark.slow) for one in (*TUNED, *FRESH[5:])), *FRESH[:5]],
    ids=lambda headers: headers.name,
)
def test_without_names_nothing_is_wrong(headers, tmp_path):
    path = tmp_path / "a.csv"
    bare = headers.without_names()
    path.write_text(bare.text())
    assert not bare.judge(bq.info(path)).startswith("wrong")
