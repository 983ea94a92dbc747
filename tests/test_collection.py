"""Tests compute, their collection does not: it would in every worker, whatever part of the tests is run."""

from __future__ import annotations

from tests.conftest import RAN_AT_COLLECTION


def test_no_kernel_ran_while_tests_were_collected(pytestconfig):
    assert pytestconfig.stash[RAN_AT_COLLECTION] == []
