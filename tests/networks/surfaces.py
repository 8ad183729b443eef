"""Points in frames of their own, above lakes, with barometers and gyrotheodolites; no datum."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.positions import heights
from factorgraph_adj.simulation.measurement import measure
from tests.networks.frames import network_of_frames

ADDED = ("lake", "barometer", "barometer of unknown scale", "gyro")
"""What a network of frames may have besides."""


def above_surfaces(
    seed: int, sorts: tuple[str, ...], added: tuple[str, ...], *, frame_name: str = "flat"
) -> fga.Network:
    """Return points that frames observe, and with them lakes, barometers and gyrotheodolites.

    Args:
        seed: of everything drawn.
        sorts: sorts of frames, see `tests.networks.frames`.
        added: some of `ADDED`.
        frame_name: name of a frame of the network, see `every_kind`.
    """
    plan = fga.adjust(network_of_frames(seed, sorts, frame_name=frame_name)).as_network()
    rng = np.random.default_rng(seed)
    names = list(plan.points)
    at = np.array([plan.points[n].coordinates for n in names])
    height = heights(plan.frame, at)[0]
    if "lake" in added:
        plan.set_level("lake", float(height.mean()))
        plan.set_level("gauge", float(height.min()) - 3.0)
        for name in names:
            plan.add(o.LevelHeight(name, "lake", sigma=0.002, slope=1e-3, along=rng.normal()))
            plan.add(o.LevelHeight(name, "gauge", sigma=0.002))
    for what in {"barometer", "barometer of unknown scale"} & {*added}:
        free = ("height", "scale") if what.endswith("scale") else ("height", "height_t")
        values = {"height": -12.0, "height_t": 0.3 * ("height_t" in free), "scale": 0.0}
        plan.set_profile(what, free=free, values=values)
        for name in names:
            plan.add(o.ProfileHeight(name, 0.0, profile=what, time=rng.normal(), sigma=0.003))
    if "gyro" in added:
        for number, gyro in enumerate(("gyro 1", "gyro 2")):
            plan.set_gyro(gyro, 0.3 - number)
            for i, a in enumerate(names):
                b = names[(i + 1 + number) % len(names)]
                plan.add(o.GyroAzimuth(a, b, 0.0, gyro=gyro, sigma=1e-4))
    return measure(plan, seed=seed)
