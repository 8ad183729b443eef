"""Frames, shapes, a rig, sights and water in one free network: what holds for all of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.hall import hall

AT_REST = 2e-5
"""Part of σ to which two adjustments agree: each is within 10⁻⁵ σ of the minimum."""


@cache
def adjusted(level: bool) -> fga.Solution:
    return fga.adjust(hall(level=level))


@pytest.mark.parametrize(("level", "defects"), [(True, 4), (False, 6)])
def test_scans_give_the_scale_and_water_the_horizon(level: bool, defects: int) -> None:
    solution = adjusted(level)
    assert solution.converged
    assert solution.datum_defect == defects
    assert solution.redundancy == solution.n_observations - solution.n_unknowns + defects
    found = fga.reliability(solution)
    assert found.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-6)
    accepted = solution.vtpv / solution.redundancy
    assert accepted == pytest.approx(1.0, abs=4 * np.sqrt(2 / solution.redundancy))


@pytest.mark.parametrize("level", [True, False])
def test_other_datum_points_change_nothing_that_can_be_measured(level: bool) -> None:
    first = adjusted(level)
    other = hall(level=level)
    for name in ("P1", "P4", "P8", "F0", "C3"):
        other.points[name] = replace(other.points[name], datum=False)
    second = fga.adjust(other)
    assert second.vtpv == pytest.approx(first.vtpv, rel=1e-9)
    r, s = (fga.reliability(x).redundancy_numbers for x in (first, second))
    np.testing.assert_allclose(r, s, rtol=0, atol=1e-7)
    for kind, name in (("size", "pipe"), ("size", "ball"), ("mount", "rod"), ("edm", "meter")):
        a, b = first.unknown(kind, name), second.unknown(kind, name)
        free = np.asarray(a.sigmas) > 0
        np.testing.assert_allclose(a.sigmas, b.sigmas, rtol=1e-6)
        moved = np.abs(np.asarray(a.values) - b.values)[free]
        assert np.all(moved < AT_REST * np.asarray(a.sigmas)[free])
    lengths = [np.linalg.norm(s.point("P2") - s.point("B1")) for s in (first, second)]
    assert lengths[0] == pytest.approx(lengths[1], abs=AT_REST * 1e-3)
    # The frames have followed the points: what is measured in them has the same residuals.
    v, w = (s.observations.residuals / s.observations.sigmas for s in (first, second))
    np.testing.assert_allclose(v, w, rtol=0, atol=1e-4)


@pytest.mark.parametrize("level", [True, False])
def test_the_order_of_everything_does_not_matter(level: bool) -> None:
    network, first = hall(level=level), adjusted(level)
    turned = fga.Network("turned", datum="free")
    turned.parameters = network.parameters
    turned.cameras = network.cameras
    for name in reversed(network.points):
        turned.add_point(name, network.points[name].coordinates)
    for name, photo in reversed(network.photos.items()):
        turned.add_photo(name, photo.camera, position=photo.position, rotation=photo.rotation)
    for o in reversed(network.observations.values()):
        turned.add(replace(o, id=None))
    for point in reversed(list(network.image_points())):
        turned.add(point)
    second = fga.adjust(turned)
    assert (second.datum_defect, second.redundancy) == (first.datum_defect, first.redundancy)
    assert second.vtpv == pytest.approx(first.vtpv, rel=1e-9)
    for name in network.points:
        sigma = first.standard_deviations(name)
        assert np.all(np.abs(first.point(name) - second.point(name)) < AT_REST * sigma + 1e-9)


def test_a_confused_target_is_named_among_all_kinds() -> None:
    network = hall(level=True)
    wrong = next(
        i
        for i, o in network.observations.items()
        if o.kind == "frame_coordinate" and o.names()[:2] == ("scan", "P5")
    )
    value = np.add(network.observations[wrong].value, (0.0, 0.03, 0.0))
    network.observations[wrong] = replace(network.observations[wrong], value=tuple(value.tolist()))
    assert [r.id for r in fga.snoop(network, alpha=1e-5).rejected] == [wrong]
