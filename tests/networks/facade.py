"""A facade in four photos, with control at its corners and two distances: truth and noise."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import disturb, look_at, measure

FOCAL, SIGMA_MM = 20.0, 0.003
"""Principal distance and σ of image coordinates, mm."""
SIGMA_CONTROL = 0.002
"""σ of control, metres."""
CONTROL = {
    "K1": (0.0, 0.0, 0.5),
    "K2": (12.0, 0.3, 0.8),
    "K3": (12.2, 0.1, 8.1),
    "K4": (0.2, -0.2, 7.9),
}
BESIDE = (0.15, 0.0, 0.0)
"""Place of point N9 relative to N1, metres."""
CENTRES = ((-2.0, -13.5, 2.5), (3.5, -15.0, 7.0), (8.5, -14.5, 1.5), (14.5, -13.0, 6.5))


def facade(seed: int, *, held: bool = True) -> Network:
    """Return the block, measured, with rough poses.

    Args:
        seed: seed of noise and start values.
        held: whether all of the camera is held; otherwise c and k1 are free.
    """
    rng = np.random.default_rng([seed, 45])
    network = Network("facade")
    for name, at in CONTROL.items():
        network.add_point(name, at, sigma=SIGMA_CONTROL)
    for i in range(8):
        at = (1.5 + 3.0 * (i % 4), rng.uniform(-0.8, 0.8), 2.5 + 3.5 * (i // 4))
        network.add_point(f"N{i + 1}", at)
    network.add_point("N9", tuple((network.points["N1"].coordinates + np.array(BESIDE)).tolist()))
    free = () if held else ("c", "k1")
    network.add_camera("camera", BrownLens(), {"c": FOCAL}, free=free)
    for i, centre in enumerate(CENTRES):
        rotation = look_at(np.array(centre), np.array([6.0, 0.0, 4.0]))
        turned = rotation @ exp_rotation(np.array([0.0, 0.0, 1.5 * (i % 2)]))
        network.add_photo(f"F{i + 1}", "camera", position=centre, rotation=turned)
    for a, b in (("N1", "N8"), ("N4", "N5")):
        network.add(SlopeDistance(a, b, 1.0, sigma=0.001))
    for photo in network.photos:
        network.add_image_points(photo, list(network.points), np.zeros((13, 2)), sigma=SIGMA_MM)
    measured = measure(network, seed=seed)
    return disturb(measured, seed=seed, points=0.1, centres=0.2, attitudes=0.03)
