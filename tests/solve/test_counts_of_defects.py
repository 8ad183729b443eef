"""Numbers of defects in messages: exact, or "at least" where only a bound was found."""

from __future__ import annotations

import re

import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o


def hanging(n: int) -> fga.Network:
    """Return n points that one distance each leaves with two undetermined coordinates."""
    network = fga.Network("hanging")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    for i in range(n):
        network.add_point(f"P{i}", (10.0 + i, 3.0 * i, 0.1 * i))
        network.add(o.SlopeDistance("A", f"P{i}", 10.0 + 3 * i, sigma=0.001))
    return network


@pytest.mark.parametrize("n", [1, 5, 19])
def test_a_number_that_is_known_is_told(n):
    with pytest.raises(fga.DatumError, match=rf"not determined: {2 * n} defect"):
        fga.adjust(hanging(n))


@pytest.mark.parametrize("n", [21, 30])
def test_a_bound_is_told_as_a_bound(n):
    with pytest.raises(fga.DatumError) as told:
        fga.adjust(hanging(n))
    bound = re.search(r"not determined: at least (\d+) defects", str(told.value))
    assert bound is not None and 40 <= int(bound[1]) <= 2 * n
