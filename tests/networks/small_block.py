"""A small combined block with known truth: total station, level, camera, control.

Twelve points on a box, four convergent photos, directions, zenith angles and slope distances
from two stations, a levelled loop, and check points; noise from a seed.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Direction,
    HeightDifference,
    ImagePoint,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import disturb, look_at, measure
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.types import Array
from factorgraph_adj.units import CC
from tests.support.shifted import shift_first_distance, shift_image

STATIONS = {"S1": (-8.0, -9.0, 0.3), "S2": (9.0, -8.0, 0.1)}
CENTRES = ((-7.0, -8.0, 6.0), (7.0, -8.0, 6.5), (7.5, 8.0, 6.0), (-7.0, 8.5, 6.2))
FOCAL, SIGMA_MM = 28.0, 0.004
SIGHTED = ("P1", "P2", "P4", "P7", "P8", "P11", "P12")
LEVELLED = ("P1", "P3", "P5", "P6", "P4", "P2", "P1")
CHECKED = ("P3", "P8", "P10")


def box() -> dict[str, tuple[float, float, float]]:
    """Return the points on the box, metres."""
    corners = [(x, y, z) for z in (0.0, 2.5) for x in (-3.0, 0.4, 3.0) for y in (-2.5, 2.5)]
    shifts = 0.1 * np.sin(np.arange(1, 13))
    return {
        f"P{i}": (x + d, y + d, z + d)
        for i, ((x, y, z), d) in enumerate(zip(corners, shifts.tolist(), strict=True), start=1)
    }


def plan() -> Network:
    """Return the block with its true values."""
    network = Network("small block")
    network.add_point("S1", STATIONS["S1"], fixed="xyz")
    network.add_point("S2", STATIONS["S2"], fixed="x", sigma=(np.inf, 0.001, 0.001))
    for name, at in box().items():
        network.add_point(name, at, check=at if name in CHECKED else None)
    network.add_camera(
        "D3",
        BrownLens(),
        {"c": FOCAL, "k1": 1e-4},
        free=("c", "x0", "y0", "k1"),
        sigma={"k2": 1e-6},
    )
    for i, centre in enumerate(CENTRES):
        rotation = look_at(np.array(centre), np.array([0.0, 0.0, 1.0]))
        turned = rotation @ exp_rotation(np.array([0.0, 0.0, 1.5 * i]))
        network.add_photo(f"F{i + 1}", "D3", position=centre, rotation=turned)
    for station in STATIONS:
        network.set_orientation(station, value=0.7)
        for target in SIGHTED:
            heights = {"instrument_height": 1.6, "target_height": 0.1}
            centred = StandardDeviation(5 * CC, centring_target=0.0003)
            distance = StandardDeviation(0.0006, ppm=1.0)
            network.add(
                Direction(station, target, 0.0, sigma=centred, **heights),
                ZenithAngle(station, target, 1.5, sigma=5 * CC, **heights),
                SlopeDistance(station, target, 1.0, sigma=distance, **heights),
            )
    for a, b in pairwise(LEVELLED):
        network.add(HeightDifference(a, b, 0.0, sigma=0.0002))
    for photo in network.photos:
        for point in box():
            network.add(ImagePoint(photo, point, 0.0, 0.0, sigma=SIGMA_MM))
    return network


def small_block(seed: int = 1) -> Network:
    """Return the block, measured and with rough approximate values."""
    measured = measure(plan(), seed=seed)
    return disturb(measured, seed=seed, points=0.02, centres=0.1, attitudes=0.02)


def images_only() -> Network:
    """Return the photos of the small block without its terrestrial observations."""
    block = small_block()
    out = Network("images", frame=block.frame)
    for p in block.points.values():
        if p.name.startswith("P"):
            out.add_point(p.name, p.coordinates)
    out.cameras.update(block.cameras)
    for photo in block.photos.values():
        out.add_photo(photo.name, photo.camera, position=photo.position, rotation=photo.rotation)
    out.add(*block.image_points())
    return out


@cache
def blundered() -> Network:
    """Return the small block with a wrong distance and a wrong image coordinate."""
    network = small_block()
    shift_first_distance(network, 0.02)
    shift_image(network, "F1/P6", 0.08)
    return network


def columns_of(solution: Solution, *names: str) -> list[Array]:
    """Return the columns of some points."""
    table = solution.equations.unknowns["point"]
    return [solution.equations.unknowns.columns("point", table.number[n]) for n in names]


def rows_of(solution: Solution, *names: str) -> Array:
    """Return the rows that touch some points."""
    number = solution.equations.unknowns["point"].number
    touching = solution.equations.touching("point", np.array([number[n] for n in names]))
    return np.unique(touching)
