"""On which variables observations depend, where deflections of the vertical are stated."""

from __future__ import annotations

import pytest

from factorgraph_adj.graph.dependence import variables_of
from tests.networks.every_kind import GEOMETRIES, sight_equations


@pytest.mark.parametrize("frame", ["flat", "topocentric"])
def test_every_kind_of_sight_says_on_what_it_depends(frame: str) -> None:
    """Those that carry a frame and a mount too: their verticals are worked out for one sight."""
    network = sight_equations(frame, GEOMETRIES["ordinary"])[0].network
    assert network.verticals
    verticals: dict[str, set[str]] = {}
    for o in network.observations.values():
        found = list(variables_of(network, o))
        named = {name for what, name in found if what == "vertical"}
        verticals.setdefault(o.kind, set()).update(named)
    for kind in ("frame_inclination", "frame_roll", "unit_vector", "zenith_angle", "azimuth"):
        assert verticals[kind], kind
    assert not verticals["slope_distance"] - {"i", "j"}
    assert not verticals["right_angle"]
