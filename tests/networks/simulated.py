"""Simulated networks of every sort, held and free, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import (
    ControlPoint,
    Correlated,
    GnssPosition,
    GnssVector,
    HeightDifference,
    SlopeDistance,
)
from factorgraph_adj.simulation.simulated_blocks import (
    simulate_aerial_block,
    simulate_geocentric_block,
)
from tests.networks.small_block import small_block
from tests.networks.total_station import total_station


def levelling(datum: str = "given") -> fga.Network:
    """A levelled net; free, or with one held bench mark."""
    network = fga.Network("levelling", datum=datum)  # type: ignore[arg-type]
    heights = {"A": 100.0, "B": 103.2, "C": 99.1, "D": 101.7, "E": 98.0}
    for name, z in heights.items():
        held = "xyz" if datum == "given" and name == "A" else "xy"
        network.add_point(name, (0.0, 0.0, z + 0.01), fixed=held)
    lines = ["AB", "BC", "CD", "DA", "AC", "DE"]
    errors = [0.4, -0.3, 0.1, 0.5, -0.6, 0.2]
    for (a, b), error in zip(lines, errors, strict=True):
        network.add(
            HeightDifference(a, b, heights[b] - heights[a] + 1e-3 * error, sigma=1e-3, id=a + b)
        )
    return network


def gnss() -> fga.Network:
    """Vectors with covariances, a cluster of two, a position, control with a covariance."""
    rng = np.random.default_rng(5)
    network = fga.Network("gnss")
    at = {n: 100.0 * rng.normal(size=3) for n in "ABCDE"}
    for name, x in at.items():
        network.add_point(name, x + 0.05 * rng.normal(size=3))

    def covariance(n: int) -> np.ndarray:
        root = 1e-3 * rng.normal(size=(n, n))
        return root @ root.T + 1e-6 * np.eye(n)

    def vector(a: str, b: str) -> tuple[float, float, float]:
        x, y, z = (at[b] - at[a] + 1e-3 * rng.normal(size=3)).tolist()
        return x, y, z

    for a, b in ("AB", "BC", "CD", "DA", "AC"):
        network.add(GnssVector(a, b, vector(a, b), covariance=covariance(3)))
    pair = (GnssVector("B", "D", vector("B", "D"), id="v1", sigma=(1.0, 1.0, 1.0)),)
    pair += (GnssVector("B", "E", vector("B", "E"), id="v2", sigma=(1.0, 1.0, 1.0)),)
    network.add(Correlated(pair, covariance(6)))
    network.add(SlopeDistance("A", "E", float(np.linalg.norm(at["E"] - at["A"])), sigma=1e-3))
    known = tuple((at["A"] + 1e-3 * rng.normal(size=3)).tolist())
    network.add(ControlPoint("A", known, covariance=covariance(3)))
    plan = tuple(at["C"][:2].tolist())
    network.add(ControlPoint("C", plan, axes="xy", sigma=(0.002, 0.003)))
    network.add(GnssPosition("D", tuple(at["D"].tolist()), covariance=covariance(3)))
    return network


def free_block(seed: int = 4) -> fga.Network:
    """The small block without anything that holds it."""
    network = small_block(seed)
    network.points = {
        n: replace(p, fixed=(False,) * 3, sigma=None) for n, p in network.points.items()
    }
    network.datum = "free"
    return network


def free_images() -> fga.Network:
    """Photos and points alone: seven defects."""
    network = simulate_aerial_block(3, image_points=240, points_per_photo=40).network
    network.observations = {}
    network.datum = "free"
    return network


def own_cameras() -> fga.Network:
    """Every photo with a calibration of its own, with priors."""
    network = small_block(6)
    camera = network.cameras["D3"]
    network.cameras = {}
    network.add_camera(
        "D3",
        BrownLens(),
        camera.values,
        sigma={"c": 0.05, "x0": 0.05, "y0": 0.05, "k1": 1e-5},
        per_photo=True,
    )
    return network


def weighted_photos() -> fga.Network:
    network = small_block(7)
    network.photos = {
        n: replace(p, sigma_position=(0.01,) * 3, sigma_attitude=1e-3)
        for n, p in network.photos.items()
    }
    return network


def held_photo() -> fga.Network:
    network = small_block(8)
    solution = fga.adjust(network)
    pose = solution.pose("F1")
    network.photos["F1"] = replace(
        network.photos["F1"],
        position=tuple(pose.position.tolist()),
        rotation=pose.rotation,
        fixed=(True,) * 6,
    )
    return network


NETWORKS: dict[str, Callable[[], fga.Network]] = {
    "levelling, held": levelling,
    "levelling, free": lambda: levelling("free"),
    "total station, free": lambda: total_station(1, coarse=0.1),
    "total station, free, verticals": lambda: total_station(2, coarse=0.1, verticals=True),
    "gnss": gnss,
    "combined block": small_block,
    "combined block, free": free_block,
    "images, free": free_images,
    "own cameras": own_cameras,
    "weighted photos": weighted_photos,
    "held photo": held_photo,
    "aerial block": lambda: simulate_aerial_block(2, image_points=240, points_per_photo=40).network,
    "industry block": lambda: simulate_industry_block(3).network,
    "geocentric block": lambda: simulate_geocentric_block(3).network,
}
