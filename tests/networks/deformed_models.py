"""Models with the same deformation, as plan with true values."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.deformation import DEFORMATIONS, DISPLACEMENTS
from factorgraph_adj.triangulation.independent_models import FRAME_COMPONENTS

BASE = 90.0
"""Base of the models at image scale, millimetres: the length of their deformation."""
SCALE = 10.0
"""Metres in a millimetre of the models."""
SIGMA = (0.006, 0.006, 0.010)
"""Standard deviations of model coordinates, millimetres."""
SIGMA_DEFORMATION = 0.03
"""Standard deviation of the parameters of the deformation, millimetres."""
TRUE = {"affinity": 0.040, "shear_xy": -0.025, "x_yy": 0.015, "z_xy": -0.030, "y_xyy": 0.02}
"""True parameters of the film, millimetres."""
CENTRES = {"x": 0.020, "y": -0.015, "z": 0.030}
"""True errors of all left projection centres, millimetres."""
MODELS, ROWS = 4, 5


def deformed_block(
    *, weighted: tuple[str, ...] = DISPLACEMENTS[3:], sigma: float = SIGMA_DEFORMATION
) -> fga.Network:
    """Return the plan: a strip of models that share points and projection centres.

    Args:
        weighted: components of the deformation that are weighted with 0; others are held at 0.
        sigma: their standard deviation, millimetres.
    """
    network = fga.Network("deformed models")
    rng = np.random.default_rng(8)
    step = BASE * SCALE
    for i in range(MODELS + 1):
        for j in range(ROWS):
            x = (i * step, (j - 2) * 450.0, float(rng.uniform(0.0, 150.0)))
            held = i in (0, 2, MODELS) and j in (0, 2, 4)
            network.add_point(f"{i}-{j}", x, fixed="xyz" if held else "")
            if j < ROWS - 1:
                half = (i * step, (j - 1.5) * 450.0, float(rng.uniform(0.0, 150.0)))
                network.add_point(f"{i}+{j}", half)
        at = (i * step, float(rng.normal(0, 10)), 1530.0 + float(rng.normal(0, 10)))
        network.add_point(f"C{i}", at)
    film = {n: TRUE.get(n, 0.0) for n in DEFORMATIONS}
    network.set_model_deformation("film", values=film, sigma=dict.fromkeys(weighted, sigma))
    network.set_model_deformation("left", values=CENTRES, sigma=dict.fromkeys("xyz", 0.05))
    for k in range(MODELS):
        turn = rng.normal(0.0, 0.05, 3).tolist()
        x0 = np.array([k * step, 0.0, 75.0])
        values = dict(zip(FRAME_COMPONENTS, (*turn, 0.0, 0.0, 0.0, np.log(SCALE)), strict=True))
        network.add_frame(f"M{k}", free=FRAME_COMPONENTS, values=values, origin=x0.tolist())
        for name in network.points:
            i = int(name[1:] if name[0] == "C" else name[0])
            if i not in (k, k + 1):
                continue
            group = "film" if name[0] != "C" else "left" if i == k else None
            at = (0.0, 0.0, 0.0)
            network.add(
                fga.FrameCoordinate(f"M{k}", name, at, sigma=SIGMA, deformation=group, base=BASE)
            )
    return network
