"""Weighted components of frames are observations of their given values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factorgraph_adj import FrameCoordinate, Network, adjust
from factorgraph_adj.rotation import exp_rotation
from tests.networks.frames import network_of_frames
from tests.networks.three_frames import MIDDLE, room, three_frames

GIVEN = {"x": 1.001, "y": 1.999, "z": 3.002, "ln_scale": 2e-4}


@pytest.mark.parametrize("component", GIVEN)
def test_the_residual_of_a_weighted_component_is_estimate_minus_given(component) -> None:
    network = three_frames()
    del network.frames["scan"]
    free = [n for n in ("rx", "ry", "rz", *GIVEN) if n != component]
    network.add_frame(
        "scan", free=free, values=GIVEN, sigma={component: 1e-3}, origin=MIDDLE.tolist()
    )
    s = adjust(network)
    row = list(s.observations.ids).index(f"frame scan {component}")
    v = s.unknown("frame", "scan")[component] - GIVEN[component]
    assert s.observations.residuals[row] == pytest.approx(v, abs=1e-12)
    assert abs(v) > 1e-8


@pytest.mark.parametrize("direction", [0.0, 1.1, -2.5])
def test_tilts_of_a_compensator_are_about_the_axes_of_the_instrument(direction) -> None:
    """R = R₃(κ) Exp(rx, ry, 0): whatever the direction κ, the readings rx and ry fit."""
    reading = (4e-3, -2e-3, 0.0)
    turn, tilt = exp_rotation(np.array([(0.0, 0.0, direction), reading]))
    network = Network("a tilted scanner")
    network.add_frame(
        "scan",
        free=["rz", "x", "y", "z"],
        values={"rx": reading[0], "ry": reading[1]},
        sigma={"rx": 1e-5, "ry": 2e-5},
        origin=MIDDLE.tolist(),
        level=True,
    )
    for name, x in room().items():
        network.add_point(name, x, fixed="xyz")
        q = (turn @ tilt).T @ (x - MIDDLE)
        network.add(FrameCoordinate("scan", name, tuple(q.tolist()), sigma=(0.002,) * 3))
    assert adjust(network).vtpv < 1e-10


def test_tilts_tell_a_free_network_nothing_of_its_direction() -> None:
    network = network_of_frames(0, ("nearly levelled scan", "levelled scan", "scan"))
    name = "nearly levelled scan"
    stated = network.frames[name]
    network.frames[name] = replace(stated, values=(2e-4, -1e-4, *stated.values[2:]))
    s = adjust(network)
    assert s.converged
    assert s.datum_defect == 4
