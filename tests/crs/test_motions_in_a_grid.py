"""Motions of photos whose coordinates are those of a grid."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.network.network import Network

pytest.importorskip("pyproj", reason="the extra crs is not installed")

SYSTEM = fga.ReferenceSystem("EPSG:25832", geoid=46.88)
VELOCITY, TURN = (9.0, -5.0, 2.0), (0.2, -0.1, 0.3)
PLACE = np.array([690_000.0, 5_330_000.0, 900.0])
"""Convergence 1.9°, scale 1.00004."""


def strip(**stated: Any) -> Network:
    """Return three photos in a grid, of which the second has a motion."""
    network = Network("in the grid")
    network.add_camera("c", BrownForwardLens(), {"c": 30.0}, format=(36, 24), readout=0.03)
    for i in range(3):
        at = PLACE + np.array([40.0, 5.0, 1.0]) * i
        network.add_photo(f"F{i}", "c", position=at, omega_phi_kappa=(0.02 * i, 0.1, 0.3))
    network.set_unknown("photo_motion", "F1", (*VELOCITY, *TURN), **stated)
    return network


@pytest.mark.parametrize("frame", ["geocentric", "topocentric"])
def test_a_photo_is_at_the_same_place_after_a_second(frame: Any) -> None:
    later = strip()
    later.add_photo("later", "c", position=PLACE + np.array([40.0, 5.0, 1.0]) + VELOCITY)
    network = fga.from_grid(later, SYSTEM, frame=frame)
    motion = np.array(network.of_kind("photo_motion")["F1"].values)
    position = np.array(network.photos["F1"].position)
    np.testing.assert_allclose(position + motion[:3], network.photos["later"].position, atol=1e-5)
    np.testing.assert_array_equal(motion[3:], TURN)
    turned = np.linalg.norm(position + VELOCITY - network.photos["later"].position)
    assert turned > 0.2  # what a velocity along the axes of the grid would be wrong by


def test_ways_between_neighbours_are_along_the_new_axes() -> None:
    grid = strip()
    sigma = (0.1, 0.2, 0.4)
    grid.add(fga.PhotoShift("F1", "F0", "F2", (0.5, -0.2, 0.1), interval=8.0, sigma=sigma))
    grid.add(fga.PhotoTurn("F1", "F0", "F2", (0.01, 0.02, 0.03), interval=8.0, sigma=sigma))
    network = fga.from_grid(grid, SYSTEM, frame="geocentric")
    shift, turn = network.observations.values()
    found = []
    for each in (grid, network):
        equations = compile_network(each)
        start = equations.unknowns.start()
        of_kind = {b.kind: b for b in equations.blocks}
        found.append(
            [
                of_kind[k].whiten(of_kind[k].evaluate(each.frame, start).residual)[0]
                for k in ("photo_shift", "photo_turn")
            ]
        )
    (one, first), (two, second) = found
    assert np.linalg.norm(two) == pytest.approx(np.linalg.norm(one), rel=1e-5)
    np.testing.assert_allclose(second, first, atol=1e-4)
    assert np.abs(np.array(shift.value) - (0.5, -0.2, 0.1)).max() > 0.1  # type: ignore[attr-defined]
    assert turn.value == (0.01, 0.02, 0.03)  # type: ignore[attr-defined]


def test_weights_of_velocities_are_the_same_in_all_axes_or_refused() -> None:
    turns = {"rx_t": 0.1, "ry_t": 0.2}
    even = strip(sigma={"x_t": 1.0, "y_t": 1.0, "z_t": 1.0} | turns)
    sigma = fga.from_grid(even, SYSTEM, frame="geocentric").of_kind("photo_motion")["F1"].sigma
    np.testing.assert_allclose(sigma, (1.0, 1.0, 1.0, 0.1, 0.2, np.inf), rtol=1e-3)
    for stated in ({"sigma": {"x_t": 1.0}}, {"fixed": ("z_t",)}):
        with pytest.raises(fga.InputError, match=r"'F1'.*held or weighted along axes of the grid"):
            fga.from_grid(strip(**stated), SYSTEM, frame="geocentric")


def test_a_motion_without_a_place_has_no_axes() -> None:
    nowhere = Network("nowhere")
    nowhere.cameras = dict(strip().cameras)
    nowhere.add_photo("F1", "c")
    nowhere.add_point("A", PLACE)
    nowhere.set_unknown("photo_motion", "F1", (*VELOCITY, *TURN))
    with pytest.raises(fga.InputError, match="'F1'"):
        fga.from_grid(nowhere, SYSTEM, frame="geocentric")
    nowhere.set_unknown("photo_motion", "F1")
    kept = fga.from_grid(nowhere, SYSTEM, frame="geocentric").of_kind("photo_motion")["F1"]
    assert kept.values == (0.0,) * 6
