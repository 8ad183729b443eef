"""MMVII: small surveys with published σ0.

MMVII's σ0 sums the residuals of survey measurements only and divides by all redundancies; those
of weighted coordinates are left out. Both sums are compared here.
"""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.frames import LocalFrame, TopocentricFrame
from factorgraph_adj.io.survey.mmvii import read_mmvii
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.solve.solution import Solution
from tests.networks.mmvii import MILLIMETRE, example_3
from tests.support.places import data_dir

pytestmark = pytest.mark.published


def sigma0_of_mmvii(solution: Solution) -> float:
    survey = [r.residual / r.sigma for r in solution.observations if r.kind != "control"]
    return float(np.sqrt(np.sum(np.square(survey)) / solution.redundancy))


def test_topo_mini():
    """Documented: "final 1.7"; an independent program gives 1.764 in a flat frame."""
    folder = data_dir("mmvii_topo") / "TopoMini" / "inputs"
    network = read_mmvii(folder / "meas.obs")
    solution = adjust(network)
    assert solution.converged
    assert (solution.n_observations, solution.n_unknowns, solution.redundancy) == (18, 14, 4)
    assert sigma0_of_mmvii(solution) == pytest.approx(1.764, abs=5e-4)
    assert solution.sigma0 == pytest.approx(1.764, abs=5e-4)
    largest = {r.id: r.residual / r.sigma for r in solution.observations}
    lines = [("PtA", "PtC", -1.80), ("PtD", "PtB", -1.98), ("PtD", "PtC", 2.24)]
    for station, target, published in lines:
        ident = next(
            i
            for i, o in network.observations.items()
            if isinstance(o, SlopeDistance) and (o.station, o.target) == (station, target)
        )
        assert largest[ident] == pytest.approx(published, abs=5e-3)


def test_topo_mini_needs_no_coordinates_of_the_unknown_points():
    folder = data_dir("mmvii_topo") / "TopoMini" / "inputs"
    network = read_mmvii(folder / "meas.obs", approximate=False)
    assert sigma0_of_mmvii(adjust(network)) == pytest.approx(1.764, abs=5e-4)


def test_example_1_a_point_by_four_distances():
    """MMVII, Topo.cpp, Ex1: three points at one height leave two positions; D starts above."""
    network = Network("Ex1", frame=LocalFrame())
    for name, at in {"A": (10, 10, 10), "B": (20, 10, 10), "C": (15, 20, 10)}.items():
        network.add_point(name, at, sigma=MILLIMETRE)
    network.add_point("D", (14.0, 14.0, 14.0))
    for target, value in (("A", 10.0), ("B", 10.0), ("C", 10.0), ("C", 10.01)):
        network.add(SlopeDistance("D", target, value, sigma=0.01))
    solution = adjust(network)
    assert sigma0_of_mmvii(solution) == pytest.approx(0.70711, abs=5e-6)
    np.testing.assert_allclose(solution.point("D"), (15.0, 13.744999, 17.808648), atol=5e-7)


def test_example_3_a_polar_point_with_the_curvature_of_the_earth():
    """MMVII, Topo.cpp, Ex3: tangent frame at longitude 45°, latitude 0; refraction 0.12.

    A height difference of 0.2 mm against a level sight of 10 m, which curvature and refraction
    change by 7 nm: that is 7 units of the last published digit.
    """
    frame = TopocentricFrame(0.0, np.pi / 4, 0.0, "WGS84")
    solution = adjust(example_3(frame))
    assert solution.redundancy == 2
    assert sigma0_of_mmvii(solution) == pytest.approx(1.00918, abs=5e-6)
    flat = adjust(example_3(LocalFrame(), refraction=0.0))
    assert abs(sigma0_of_mmvii(flat) - 1.00918) > 5e-4
