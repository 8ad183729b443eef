"""A close-range block of photos for each lens, with all of its parameters."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.graph.variables import calibration_scales
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import disturb, look_at, measure
from tests.networks.every_kind import LENSES_USED

PHOTOS, SIDE, CONTROL = 8, 3, 6
BOX = np.array([6.0, 6.0, 4.0])
"""Size of the object, metres."""
KNOWN = 0.002
"""Standard deviation of each additional parameter: what moves a corner by this part of the half
diagonal of the format."""
FREE = {"tangents": ("c", "x0", "y0"), "rays": ("c",), "places": ("c",)}
"""What is free; the principal point of a lens that sees all around is an attitude, and that of
parallel projection a shift of all photos."""
FORMAT = (24.0, 18.0)
SIGMA = 0.003
"""Standard deviation of image coordinates, mm."""


def lens_block(lens: str, seed: int = 1) -> Network:
    """Return a block of a lens of `LENSES_USED` with measuring errors and approximate values.

    c, x0 and y0 are free, all others weighted.

    Args:
        lens: its name.
        seed: seed of geometry and errors.
    """
    rng = np.random.default_rng([seed, 11])
    used = LENSES_USED[lens]
    network = Network(lens)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, SIDE)] * 3), -1).reshape(-1, 3)
    places = (grid + rng.uniform(-0.08, 0.08, grid.shape)) * BOX
    for i, at in enumerate(rng.permutation(places).tolist()):
        network.add_point(f"P{i}", tuple(at), fixed="xyz" if i < CONTROL else "")
    free = [n for n in used.lens.names if n in FREE[used.lens.takes]]
    network.add_camera("C", used.lens, used.values, free=free, format=FORMAT)
    camera = network.cameras["C"]
    radius = 0.5 * float(np.hypot(*FORMAT))
    scale = dict(zip(used.lens.names, calibration_scales(camera), strict=True))
    more = {
        n: min(KNOWN * scale[n], 0.1 * abs(used.values.get(n, 0.0)) or np.inf)
        for n in used.lens.names
        if n not in free
    }
    del network.cameras["C"]
    network.add_camera("C", used.lens, used.values, free=free, sigma=more, format=FORMAT)
    c = used.values["c"]
    for i in range(PHOTOS):
        turn = 2.0 * np.pi * i / PHOTOS
        away = 1.1 * c / radius * float(np.linalg.norm(BOX))
        at = np.array([away * np.cos(turn), away * np.sin(turn), 3.0 * (-1.0) ** i])
        roll = exp_rotation(np.array([0.0, 0.0, 0.5 * np.pi * (i % 3)]))
        network.add_photo(f"F{i}", "C", position=at, rotation=look_at(at, np.zeros(3)) @ roll)
        for name in network.points:
            network.add(ImagePoint(f"F{i}", name, 0.0, 0.0, sigma=SIGMA))
    return disturb(
        measure(network, seed=seed), seed=seed, points=0.03, centres=0.05, attitudes=0.005
    )
