"""A scale of given coordinates along one axis: of a board, and of given heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import HeightDifference, ImagePoint
from factorgraph_adj.quality.causes.shared_error_tests import axis_scales
from factorgraph_adj.simulation.measurement import look_at, measure

NAME = "the scale of the given coordinates"


def board(seed: int, ratio: float) -> fga.Network:
    """Return photos of a board whose coordinates along y are given too large by a ratio."""
    rng = np.random.default_rng([seed, 61])
    network = fga.Network("board")
    places = {
        (i, j): np.array([0.03 * (i - 3), 0.03 * (j - 2), 0.0]) for i in range(7) for j in range(5)
    }
    for (i, j), at in places.items():
        network.add_point(f"{i}-{j}", tuple(at.tolist()), fixed="xyz")
    values = {"c": 24.0, "x0": 0.05, "y0": -0.04, "k1": 1e-4}
    network.add_camera("C", BrownLens(), values, free=("c", "x0", "y0", "k1"))
    for photo in range(6):
        turn = rng.uniform(0.0, 2 * np.pi)
        at = np.array([0.15 * np.cos(turn), 0.15 * np.sin(turn), rng.uniform(0.25, 0.35)])
        upright = look_at(at, rng.normal(0.0, 0.01, 3))
        c, s = np.cos(photo), np.sin(photo)
        rotation = upright @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        network.add_photo(f"F{photo}", "C", position=tuple(at.tolist()), rotation=rotation)
        for i, j in places:
            network.add(ImagePoint(f"F{photo}", f"{i}-{j}", 0.0, 0.0, sigma=0.002))
    out = measure(network, seed=seed)
    for name, point in out.points.items():
        x, y, z = point.coordinates
        out.points[name] = replace(point, coordinates=(x, (1.0 + ratio) * y, z))
    return out


@pytest.mark.parametrize("ratio", [0.01, -0.0909])
def test_a_board_with_another_spacing_along_one_axis_is_named(ratio: float) -> None:
    """The scale of the other axis is the same to all images, with the cameras nearer or farther.

    The partials are those of the wrong board: its size is right to 3.5 times the ratio.
    """
    solution = fga.adjust(board(1, ratio))
    found = fga.causes(fga.reliability(solution))
    first, second = found.found[:2]
    assert {first.cause, second.cause} == {NAME}
    along = {c.where.split(",")[0]: c for c in (first, second)}
    assert abs(along["along y"].error[0] - ratio) < 3.5 * ratio**2
    assert found.most_probable is None
    assert set(found.undecided) == {f"{c.cause} {c.where}" for c in (first, second)}


def test_given_heights_in_another_unit_are_named() -> None:
    """Heights of five bench marks in yards, whose differences were levelled in metres.

    All that was levelled may have a wrong scale as well: nothing tells which.
    """
    rng = np.random.default_rng(8)
    network = fga.Network("levelling")
    heights = rng.uniform(0.0, 12.0, 8)
    for i, h in enumerate(heights.tolist()):
        network.add_point(f"B{i}", (0.0, 0.0, h / 0.9144), fixed="xyz" if i < 5 else "xy")
    for i in range(8):
        for j in range(i):
            rise = float(heights[i] - heights[j] + 0.001 * rng.normal())
            network.add(HeightDifference(f"B{j}", f"B{i}", rise, sigma=0.001))
    solution = fga.adjust(network)
    (scale,) = [a for a in axis_scales(solution) if a.found.dof]
    assert (scale.axis, scale.points) == ("z", 5)
    assert abs(scale.found.error[0] - (1.0 - 0.9144)) < 5.0 * scale.found.sigma[0]
    found = fga.causes(fga.reliability(solution))
    assert set(found.undecided) == {
        f"{NAME} along z, of 5 held points",
        "the scale of levelled height differences (staff or line of sight) everywhere",
    }


def test_a_good_board_has_no_scale_of_its_own() -> None:
    for seed in range(6):
        found = fga.causes(fga.reliability(fga.adjust(board(seed, 0.0))))
        assert not found.more_probable
