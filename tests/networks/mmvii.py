"""Surveys of MMVII."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.frames import LocalFrame, TopocentricFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance, ZenithAngle

MILLIMETRE = 1e-3


def example_3(frame: LocalFrame | TopocentricFrame, *, refraction: float = 0.12) -> Network:
    """Return the survey; its new point Tr1 has no coordinates."""
    network = Network("Ex3", frame=frame)
    network.add_point("Ori1", (100, 110, 100), sigma=MILLIMETRE)
    network.add_point("St1", (100, 100, 100), sigma=MILLIMETRE)
    network.add_point("Tr1")
    network.set_refraction(value=refraction, fixed=True)
    orientation = 2.2
    network.add(
        Direction("St1", "Ori1", -orientation, sigma=1e-4),
        Direction("St1", "Tr1", np.pi / 4 - orientation, sigma=1e-4),
        ZenithAngle("St1", "Tr1", np.pi / 2, sigma=1e-4),
        SlopeDistance("St1", "Tr1", 10.0, sigma=MILLIMETRE),
        SlopeDistance("St1", "Tr1", 10.002, sigma=MILLIMETRE),
        HeightDifference("St1", "Tr1", 0.0002, sigma=1e-4),
    )
    return network
