"""What is said of another minimum of the same observations."""

from __future__ import annotations

import factorgraph_adj as fga
from factorgraph_adj.observations import HorizontalDistance
from factorgraph_adj.solve.second_minimum import describe_other_minimum


def placed(y: float) -> fga.Solution:
    """Return two distances to a point, which may lie on either side of their stations."""
    network = fga.Network("mirror")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (8.0, 0.0, 0.0), fixed="xyz")
    network.add_point("P", (4.1, y, 0.0), fixed="z")
    network.add(HorizontalDistance("A", "P", 5.0, sigma=0.01, id="a"))
    network.add(HorizontalDistance("B", "P", 5.0, sigma=0.01, id="b"))
    return fga.adjust(network)


def test_the_point_that_lies_farthest_apart_is_named_with_its_place() -> None:
    told = describe_other_minimum(placed(2.9), placed(-2.9))
    assert told.startswith("another minimum has vᵀPv ")
    assert told.endswith("with point 'P' at 4.0000, -3.0000, 0.0000, 6 m away")


def test_without_a_common_point_only_the_sums_are_told() -> None:
    other = fga.Network("other")
    other.add_point("Q", (0.0, 0.0, 0.0), fixed="xyz")
    other.add_point("R", (3.0, 0.0, 0.0), fixed="yz")
    other.add(HorizontalDistance("Q", "R", 3.0, sigma=0.01, id="q"))
    told = describe_other_minimum(placed(2.9), fga.adjust(other))
    assert "with point" not in told
