"""Levels, profiles and constants of gyros in free networks, and against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from tests.networks.every_kind import FRAMES
from tests.networks.surfaces import above_surfaces
from tests.support.dense import Dense

DEFECTS = {
    (("model",), ("lake",)): 4,
    (("model",), ("barometer of unknown scale",)): 5,
    (("model",), ("barometer",)): 4,
    (("scan",), ("lake",)): 4,
    (("scan",), ("barometer",)): 4,
    (("scan",), ("gyro",)): 4,
    (("model", "scan"), ("lake", "barometer", "gyro")): 4,
    (("model", "model"), ("lake", "barometer of unknown scale", "gyro")): 4,
}
"""Frames and what observes heights and azimuths, with the datum defect: all that is left of the
seven motions are three shifts, a rotation about the vertical, and the scale where neither a frame
nor a barometer knows it."""
NEAR_A_POLE = "geocentric, near a pole"


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("frame_name", FRAMES)
@pytest.mark.parametrize(("sorts", "added"), DEFECTS, ids=str)
def test_surfaces_and_gyros_move_with_a_free_network(sorts, added, frame_name):
    """On a plane and on the curved Earth; what moves with the network is no datum."""
    solution = fga.adjust(above_surfaces(5, sorts, added, frame_name=frame_name))
    assert solution.converged
    assert solution.datum_defect == DEFECTS[sorts, added]
    redundancy = fga.reliability(solution).redundancy_numbers
    # Near a pole the turn is noticed by 7e-4 of what its unknowns alone are: its square is missing.
    missing = 1e-5 if frame_name == NEAR_A_POLE else 1e-6
    assert redundancy.sum() == pytest.approx(solution.redundancy, abs=missing)
    assert 1e-4 < stats.chi2(solution.redundancy).cdf(solution.vtpv) < 1.0 - 1e-4


@pytest.mark.parametrize("frame_name", FRAMES)
def test_the_motions_are_unnoticed_to_what_the_figure_of_the_earth_tells(frame_name):
    """A g of a motion of 1 m, relative to the same unknown by unknown without the others."""
    added = ("lake", "barometer of unknown scale", "gyro")
    solution = fga.adjust(above_surfaces(6, ("model",), added, frame_name=frame_name))
    dense = Dense.at(solution.equations, solution.state)
    (defect,) = solution.defects
    g = defect.motions[dense.free]
    told = np.linalg.norm(dense.design @ g, axis=0)
    alone = np.linalg.norm(np.abs(dense.design) @ np.abs(g), axis=0)
    # The convergence of meridians: by the distance from the axis of the Earth, near a pole.
    curved = 10.0 * 40.0 / (1.1e4 if frame_name == NEAR_A_POLE else 6.37e6)
    assert np.all(told < (1e-12 if frame_name in ("flat", "left-handed") else curved) * alone)
