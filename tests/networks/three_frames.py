"""A room seen by a scanner, a photogrammetric model and a levelled station, each in its frame."""

from __future__ import annotations

import numpy as np

from factorgraph_adj import FrameCoordinate, Network
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array

MIDDLE = np.array((15.0, 10.0, 4.0))
STATION = np.array((10.0, 5.0, 1.5))
POINTS = 8
HELD = ("P0", "P1", "P2", "P3")
SIGMA = 0.002
"""Standard deviation of a coordinate, metres."""
FRAMES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "scan": ((0.1, 0.2, 2.0), (1.0, 2.0, 3.0), 1.0),
    "model": ((0.1, -0.2, 1.0), (0.0, 0.0, 0.0), 0.1),
    "station": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 1.0),
}
"""Rotation vectors, offsets and scales, metres per unit of the frame."""


def room(seed: int = 3) -> dict[str, Array]:
    """Return the true coordinates of the points."""
    rng = np.random.default_rng(seed)
    return {f"P{i}": rng.uniform((0, 0, 0), (30, 20, 8)) for i in range(POINTS)}


def true_coordinates(frame: str, x: Array) -> Array:
    """Return the coordinates of a place in a frame."""
    turn, offset, scale = FRAMES[frame]
    origin = STATION if frame == "station" else MIDDLE
    return np.asarray(exp_rotation(np.array([turn]))[0].T @ (x - origin) / scale - offset)


def three_frames(seed: int = 3, *, held: tuple[str, ...] = HELD) -> Network:
    """Return the network; the model has a scale, the station is levelled at its point T."""
    rng = np.random.default_rng(seed)
    network = Network("room")
    places = room(seed)
    for name, x in places.items():
        network.add_point(name, x if name in held else None, fixed="xyz" if name in held else "")
    network.add_point("T")
    network.add_frame("scan", origin=MIDDLE.tolist())
    every = ("rx", "ry", "rz", "x", "y", "z", "ln_scale")
    network.add_frame("model", free=every, origin=MIDDLE.tolist())
    network.add_frame("station", free=["rz"], origin="T", level=True)
    for frame, (_, _, scale) in FRAMES.items():
        sigma = SIGMA / scale
        for name, x in places.items():
            q = true_coordinates(frame, x) + sigma * rng.normal(size=3)
            network.add(FrameCoordinate(frame, name, tuple(q.tolist()), sigma=(sigma,) * 3))
    return network
