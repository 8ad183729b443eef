"""Pauses of the collector of cyclic garbage."""

from __future__ import annotations

import gc

import pytest

from factorgraph_adj.garbage_collection import without_collections


@pytest.mark.parametrize("enabled", [True, False])
def test_the_collector_is_as_it_was_after_nested_pauses_and_errors(enabled: bool) -> None:
    before = gc.isenabled()
    (gc.enable if enabled else gc.disable)()
    try:
        with without_collections:
            with pytest.raises(ValueError), without_collections:
                raise ValueError
            assert not gc.isenabled()
        assert gc.isenabled() == enabled
    finally:
        (gc.enable if before else gc.disable)()
