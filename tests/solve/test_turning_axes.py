"""Two known points, or points on a line, leave a block free to turn about their line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.solve.datum_defects import find_defects
from factorgraph_adj.solve.defect_description import names_on_axis
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from tests.networks.photo_block import block, plan

AXIS = "line of point 'P1', point 'P3'"


def two_points(network: fga.Network, how: str = "held") -> fga.Network:
    """Return a block of which two points are known, held or observed."""
    for name, p in network.points.items():
        known = name in ("P1", "P3")
        network.points[name] = replace(p, fixed=(known and how == "held",) * 3)
        if known and how == "observed":
            network.add(fga.ControlPoint(name, p.coordinates, sigma=(0.01, 0.01, 0.01)))
    return network


@pytest.mark.parametrize("how", ["held", "observed"])
def test_the_axis_is_named_before_iterations(how: str) -> None:
    iterations: list[int] = []
    with pytest.raises(fga.DatumError, match=AXIS) as refused:
        fga.adjust(two_points(block(2), how), progress=lambda i, vtpv, bound: iterations.append(i))
    said = str(refused.value)
    assert "datum defect 1: missing rotation about" in said and "away from this line" in said
    assert iterations == []
    assert refused.value.defect == 1


def test_a_gross_start_is_no_reason_to_iterate() -> None:
    """All but the known points start turned and shifted, so that v/σ is a thousand and more."""
    network = two_points(plan(2), "observed")
    turn = exp_rotation(np.array([0.3, 0.2, -0.4]))
    for name, p in network.points.items():
        if name not in ("P1", "P3"):
            at = tuple((turn @ np.array(p.coordinates)).tolist())
            network.points[name] = replace(p, coordinates=at)
    iterations: list[int] = []
    with pytest.raises(fga.DatumError, match=AXIS):
        fga.adjust(network, progress=lambda i, vtpv, bound: iterations.append(i))
    assert iterations == []


def test_the_position_of_a_photo_holds_the_rotation() -> None:
    network = two_points(block(2))
    photo = plan(2).photos["F1"]
    network.add(fga.PhotoPosition("F1", photo.position, sigma=(0.02, 0.02, 0.02)))
    assert fga.adjust(network).converged


def test_points_on_the_axis_rest_and_others_do_not() -> None:
    """A rotation about a line through three points of many, with a shift of the centre."""
    network = two_points(plan(2))
    middle = (np.array(network.points["P1"].coordinates) + network.points["P3"].coordinates) / 2
    network.points["P2"] = replace(network.points["P2"], coordinates=tuple(middle.tolist()))
    equations = compile_network(network)
    state = equations.unknowns.start()
    system = LinearisedEquations(equations, state, ())
    (defect,) = find_defects(system, state, system.diagonal(), free=False)
    assert names_on_axis(equations.unknowns, defect, state) == [
        "point 'P1'",
        "point 'P2'",
        "point 'P3'",
    ]
    shifted = replace(defect, mixture=defect.mixture + np.eye(7)[:, [6]])
    assert names_on_axis(equations.unknowns, shifted, state) == []


def test_other_defects_have_no_axis() -> None:
    """One known point leaves three rotations and the scale."""
    network = two_points(block(2))
    network.points["P3"] = replace(network.points["P3"], fixed=(False,) * 3)
    with pytest.raises(fga.DatumError) as refused:
        fga.adjust(network)
    assert "datum defect 4" in str(refused.value) and "line of" not in str(refused.value)


def test_points_that_start_on_a_line_are_no_defect() -> None:
    """A singular start far from the minimum is of the place: its adjustment is not refused."""
    network = plan(2)
    for name, p in network.points.items():
        if not any(p.fixed):
            x = p.coordinates[0]
            network.points[name] = replace(p, coordinates=(x, 0.1 * x, 0.1 * x))
    assert fga.adjust(network) is not None
