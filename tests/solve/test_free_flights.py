"""Free networks of photo flights: what no observation notices moves mounts and drifts too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import NavigationAttitude, PhotoAttitude
from factorgraph_adj.solve.datum_defects import generators
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from tests.networks.small_flight import OFFSETS, SHIFT, TURNS, Plan, observed, plan_of


def unnoticed(network: fga.Network) -> np.ndarray:
    """Return |A g| / |√diag(N) g| of the seven motions."""
    equations = compile_network(network)
    state = equations.unknowns.start()
    system = LinearisedEquations(equations, state)
    g = generators(equations, state)
    scale = np.sqrt(system.diagonal())[:, None]
    noticed = np.linalg.norm(system.times(g), axis=0)
    return np.asarray(noticed / np.linalg.norm(scale * g, axis=0))


@pytest.mark.parametrize("axes", ["en", "nw"])
@pytest.mark.parametrize("kind", [PhotoAttitude, NavigationAttitude])
def test_turned_attitudes_notice_no_turn(kind, axes: str) -> None:
    """A block with its platform turned by any amount."""
    plan = Plan(LocalFrame(axes=axes), positions=False, attitudes=kind, control=0, turning=TURNS)
    network = plan_of(plan)
    for name, p in network.attitude_drifts.items():
        values = (0.4, -0.3, 1.2, *p.values[3:])
        network.attitude_drifts[name] = replace(p, values=values)
    # All strips have the same turn, as the object has one.
    assert unnoticed(network).max() < 1e-12


def test_shifted_positions_notice_no_shift_and_ranges_of_an_arm_no_scale() -> None:
    network = plan_of(Plan(control=0, attitudes=None, drift=SHIFT))
    ratio = unnoticed(network)
    assert ratio[:3].max() < 1e-12
    assert ratio[3:].min() > 1e-3
    plan = Plan(control=0, positions=False, attitudes=None, mount=OFFSETS, extra=("photo_range",))
    network = plan_of(plan)
    network.set_mount("imu", free=OFFSETS, values={"x": 0.3, "y": -2.0, "z": 1.0})
    ratio = unnoticed(network)
    assert ratio[:6].max() < 1e-12
    assert ratio[6] > 1e-3


def test_a_free_block_with_a_free_platform_is_that_with_a_minimum_of_control() -> None:
    """Seven coordinates held on three points, or inner constraints over all points."""
    plan = Plan(positions=False, control=0, turning=TURNS, relief=150.0)
    network = observed(plan_of(plan), 1)
    free = network.copy()
    free.datum = "free"
    solution = fga.adjust(free)
    assert solution.redundancy == solution.n_observations - solution.n_unknowns + 7
    held = network.copy()
    names = list(network.points)
    for name, fixed in ((names[0], "xyz"), (names[-1], "xyz"), (names[3], "z")):
        flags = tuple(a in fixed for a in "xyz")
        held.points[name] = replace(held.points[name], fixed=flags)
    minimum = fga.adjust(held)
    assert minimum.vtpv == pytest.approx(solution.vtpv, rel=1e-6)
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-6)


@pytest.mark.parametrize(("datum", "defects"), [("free", 3), ("given", 10)])
def test_an_unknown_without_observations_is_no_defect_of_the_datum(datum, defects: int) -> None:
    """Three shifts that nothing observes; the seven defects of a free block are none."""
    network = observed(plan_of(Plan(control=0, positions=False, attitudes=None)), 1)
    for kind in ("mount", "drift", "attitude_drift"):
        network.of_kind(kind).clear()
    network.set_drift("flown never", free=SHIFT)
    with pytest.raises(fga.DatumError) as error:
        fga.adjust(network, datum=datum)
    told = str(error.value)
    assert error.value.defect == defects
    assert "drift 'flown never' is not determined" in told
    assert "free shift of drift" not in told
    for of_datum in ("datum defect 7", "ask for a free network"):
        assert (of_datum in told) == (datum == "given")
