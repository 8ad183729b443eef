"""A site that is killed while it takes postings: nothing acknowledged is lost, nothing doubled."""

from __future__ import annotations

import sys

import pytest

from tests.support.site_kills import assert_nothing_is_lost_or_doubled, campaign

pytestmark = [
    pytest.mark.usefixtures("store"),
    pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal"),
]


def test_a_site_that_is_killed_has_what_it_acknowledged(tmp_path):
    found = campaign(tmp_path, kills=2, seed=41)
    assert len(found.put) > 2
    assert_nothing_is_lost_or_doubled(tmp_path, found)


@pytest.mark.slow("kills at more moments, while the process starts among them")
def test_a_site_that_is_killed_often_has_what_it_acknowledged(tmp_path):
    found = campaign(tmp_path, kills=6, seed=42)
    assert_nothing_is_lost_or_doubled(tmp_path, found)
