"""Heights above the ellipsoid beside heights above a geoid are told before an adjustment."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.adjustment_report import Report

pytest.importorskip("pyproj", reason="the extra crs is not installed")

UNDULATION = 46.12
GRID = {
    "A": (690000.0, 5340000.0, 520.0),
    "B": (691500.0, 5340300.0, 541.0),
    "C": (690700.0, 5341400.0, 533.0),
}


def positioned(given: float, *, weighted: bool = False, east: float = 0.0) -> fga.Network:
    """Return control with GNSS positions, whose heights are typed with an error of ``given``.

    Args:
        given: error of the heights of control, metres: the undulation for ellipsoidal ones.
        weighted: whether control is weighted and not held.
        east: error of all eastings of control, metres.
    """
    system = fga.ReferenceSystem("EPSG:25832", geoid=UNDULATION)
    network = fga.Network("control")
    for name, xyz in GRID.items():
        typed = np.add(xyz, (east, 0.0, given))
        network.add_point(name, typed, **({"sigma": 0.01} if weighted else {"fixed": "xyz"}))
    out = fga.from_grid(network, system, frame="geocentric")
    phi, lam, h = system.to_geodetic(np.array(list(GRID.values())))
    rng = np.random.default_rng(3)
    for name, at in zip(GRID, system.ellipsoid.to_cartesian(phi, lam, h), strict=True):
        value = tuple((at + rng.normal(0, 0.01, 3)).tolist())
        out.add(fga.GnssPosition(name, value, sigma=(0.01,) * 3))
    return out


@pytest.mark.parametrize("weighted", [False, True])
def test_ellipsoidal_heights_of_control_are_told_with_the_undulation(weighted: bool) -> None:
    network = positioned(UNDULATION, weighted=weighted)
    (finding,) = fga.preliminary(network)
    assert str(finding).startswith(
        "3 GNSS positions are below the given heights of their points, and agree with them in "
        "plan (the undulation is 46.12 m there): 46.1"
    )
    assert len(finding.ids) == 3
    network.add_point("new")
    at = network.observations[finding.ids[0]].value
    network.add(fga.GnssPosition("new", at, sigma=(0.01,) * 3))
    said = [
        d
        for d in Report(fga.adjust(network)).shared_error_doubts
        if "3 GNSS positions are below" in d
    ]
    assert len(said) == 1


def test_another_offset_of_all_heights_is_told_without_the_undulation() -> None:
    (finding,) = fga.preliminary(positioned(-12.0))
    assert "are above the given heights" in str(finding) and "undulation" not in str(finding)


@pytest.mark.parametrize(("given", "east"), [(0.0, 0.0), (0.5, 0.0), (UNDULATION, 60.0)])
def test_right_heights_small_offsets_and_errors_in_plan_are_not_told(
    given: float, east: float
) -> None:
    assert not [f for f in fga.preliminary(positioned(given, east=east)) if "GNSS pos" in str(f)]
