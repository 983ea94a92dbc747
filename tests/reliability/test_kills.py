"""Killed at random moments: nothing lost, doubled or half written. `make reliability` is the long form."""

from __future__ import annotations

import os

import pytest
from studies.kills import disturbed

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs process groups")


@pytest.mark.slow  # a kill of a batch and of a study: test_batch, test_study; sums that are kept: test_streaming
@pytest.mark.parametrize("name", ["discover --checkpoint", "batch"])
def test_a_command_that_is_killed_ends_as_if_undisturbed(name):
    found = disturbed(name, seed=int.from_bytes(os.urandom(4)), kills=2)
    assert (found["partial"], found["same"]) == (0, True)
