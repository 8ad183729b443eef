"""Weighted components of frames are observations of their given values."""

from __future__ import annotations

import pytest

from factorgraph_adj import adjust
from tests.networks.three_frames import MIDDLE, three_frames

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
