"""Frames of their own: results against dense matrices, and laws of free networks of frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import FrameCoordinate
from factorgraph_adj.rotation import exp_rotation
from tests.networks.every_kind import FRAMES
from tests.networks.frames import SORTS, network_of_frames
from tests.support.dense import Dense, DenseReliability
from tests.support.differences import assert_partials_are_right, observed_as_computed

AT_REST = 1e-5
"""Part of σ by which two adjustments of one network may end apart."""
DEFECTS = {
    ("model", "model"): 7,
    ("scan", "model"): 6,
    ("scan with a thermal scale", "model"): 6,
    ("levelled model", "model"): 5,
    ("levelled scan", "scan"): 4,
    ("nearly levelled scan", "scan"): 4,
    ("tripod", "tripod"): 6,
    ("tripod without forced centring", "scan"): 6,
    ("levelled tripod", "levelled tripod"): 4,
    ("levelled tripod", "model", "plan"): 4,
    ("plan", "scan"): 4,
    tuple(SORTS): 4,
}
"""Sorts of frames in a network, and its datum defect: what no frame among them knows."""
NAMED = {
    7: ("shift in x", "shift in y", "shift in z"),
    6: ("shift in x", "shift in y", "shift in z"),
    5: ("shift in x", "shift in y", "shift in z", "rotation about z", "scale"),
    4: ("shift in x", "shift in y", "shift in z", "rotation about z"),
}
"""Motions that the message of a defect names in a local frame."""


def all_points(solution: fga.Solution) -> np.ndarray:
    return np.array([solution.point(n) for n in solution.network.points])


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("frame_name", FRAMES)
@pytest.mark.parametrize("sorts", DEFECTS, ids="+".join)
def test_a_free_network_of_frames_misses_what_no_frame_knows(sorts, frame_name):
    """The same on the curved Earth as on a plane, whatever the sort of axes."""
    solution = fga.adjust(network_of_frames(5, sorts, frame_name=frame_name, coarse=0.05))
    assert solution.converged
    assert solution.datum_defect == DEFECTS[sorts]
    reliability = fga.reliability(solution)
    assert reliability.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-6)
    assert 0.5 < solution.sigma0 < 1.6
    if frame_name == "flat":
        (defect,) = solution.defects
        assert set(NAMED[DEFECTS[sorts]]) <= set(defect.names())
        assert len(defect.names()) == DEFECTS[sorts]


@pytest.mark.parametrize("frame_name", FRAMES)
def test_motions_of_the_defect_are_unnoticed_to_what_the_figure_of_the_earth_tells(frame_name):
    """A g of a motion of 1 m, relative to the same frame by frame without the others."""
    network = network_of_frames(6, ("levelled tripod", "tripod", "scan"), frame_name=frame_name)
    solution = fga.adjust(network)
    dense = Dense.at(solution.equations, solution.state)
    (defect,) = solution.defects
    g = defect.motions[dense.free]
    told = np.linalg.norm(dense.design @ g, axis=0)
    alone = np.linalg.norm(np.abs(dense.design) @ np.abs(g), axis=0)
    curved = 6.7e-3 * 40.0 / 6.37e6
    assert np.all(told < (1e-12 if frame_name in ("flat", "left-handed") else curved) * alone)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("frame_name", FRAMES)
def test_partials_of_frames_of_every_sort(frame_name):
    """At the solution, with every component of every frame unknown."""
    solution = fga.adjust(network_of_frames(7, tuple(SORTS), frame_name=frame_name))
    network = solution.as_network()
    for name, p in network.frames.items():
        network.frames[name] = replace(p, fixed=(False,) * 7, sigma=(np.inf,) * 7)
    for i, name in enumerate(network.points):
        network.set_vertical(name, xi=1e-5 * i, eta=-2e-5 * i)
    equations = compile_network(network)
    state = equations.unknowns.start()
    steps = np.full(equations.unknowns.n_columns, 0.01)
    for kind, number in equations.unknowns.active():
        columns = equations.unknowns.columns(kind, number)
        if kind == "frame":
            steps[columns] = [1e-3] * 3 + [1e-2] * 3 + [1e-3]
        elif kind == "vertical":
            steps[columns] = 1e-5  # near a pole η/cosφ is 600 times as large
        else:
            steps[columns] = 0.1
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)


@pytest.mark.parametrize("frame_name", ["flat", "left-handed", "curved", "topocentric"])
@pytest.mark.parametrize("seed", range(4))
def test_frames_of_every_sort_agree_with_dense_matrices(seed, frame_name):
    """Redundancy numbers, covariances, vᵀPv after one more step.

    Free on a plane, under inner constraints; on the curved Earth with three held points, as the
    dense matrices would use what little frames tell there of the place of a free network.
    """
    rng = np.random.default_rng(seed)
    sorts = tuple(rng.permutation(list(SORTS))[: rng.integers(3, len(SORTS))].tolist())
    network = network_of_frames(seed, (*sorts, "scan"), frame_name=frame_name)
    if frame_name in ("curved", "topocentric"):
        network.datum = "given"
        for name in ("P0", "P1", "P2"):
            network.points[name] = replace(network.points[name], fixed=(True,) * 3)
    solution = fga.adjust(network, tolerance=1e-8)
    dense = Dense.at(solution.equations, solution.state)
    assert solution.vtpv == pytest.approx(dense.vtpv_after_step(), rel=1e-9)
    reference = DenseReliability.of(solution)
    found = fga.reliability(solution).redundancy_numbers
    np.testing.assert_allclose(found, reference.redundancy_numbers, rtol=0, atol=1e-7)
    assert found.sum() == pytest.approx(solution.redundancy, abs=1e-6)
    columns = np.zeros(len(dense.free), dtype=bool)
    for number in range(len(network.points)):
        columns[solution.equations.unknowns.columns("point", number)] = True
    cofactor = dense.cofactor(columns)
    for kind, names in (("point", network.points), ("frame", network.frames)):
        for number, name in enumerate(names):
            own = solution.equations.unknowns.columns(kind, number)
            expected = np.sqrt(np.diag(cofactor)[own])
            found = sigmas(solution, kind, name)[: len(own)]
            np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-10)


def sigmas(solution: fga.Solution, kind: str, name: str) -> np.ndarray:
    if kind == "frame":
        # Steps of the tangent, as those of the dense matrices.
        return np.sqrt(np.diag(solution.variable_covariance(("frame", name))))
    return solution.standard_deviations(name)


@pytest.mark.parametrize("frame_name", ["flat", "geocentric"])
def test_results_do_not_depend_on_the_order_of_anything(frame_name):
    network = network_of_frames(8, tuple(SORTS), frame_name=frame_name)
    turned = fga.Network("turned", frame=network.frame, datum="free")
    for name in reversed(network.points):
        turned.points[name] = network.points[name]
    for name in reversed(network.frames):
        turned.frames[name] = network.frames[name]
    for o in reversed(network.observations.values()):
        turned.add(o)
    a, b = fga.adjust(network, tolerance=1e-7), fga.adjust(turned, tolerance=1e-7)
    assert (a.datum_defect, a.redundancy) == (b.datum_defect, b.redundancy)
    assert a.vtpv == pytest.approx(b.vtpv, rel=1e-8)
    for name in network.points:
        sigma = a.standard_deviations(name)
        assert np.all(np.abs(a.point(name) - b.point(name)) < AT_REST * sigma + 1e-8)


def test_two_places_leave_a_frame_turning_about_their_line():
    """Refused by name; a third place, or a level, helps."""
    network = fga.Network("two places")
    for name, at in (("A", (0, 0, 0)), ("B", (8, 3, 1))):
        network.add_point(name, at, fixed="xyz")
    values = {"rx": 0.1, "ry": 0.2, "rz": 0.3, "x": 1.0, "y": 1.0, "z": 1.0}
    network.add_frame("scan 7", values=values)
    coordinates = {"A": (1.0, 1.0, 1.0), "B": (8.0, 6.0, 0.5)}
    for name, at in coordinates.items():
        network.add(FrameCoordinate("scan 7", name, at, sigma=(0.01,) * 3))
    with pytest.raises(fga.DatumError, match="frame 'scan 7'") as error:
        fga.adjust(network)
    assert error.value.defect == 1
    without = network.copy()
    del without.frames["scan 7"]
    without.add_frame("scan 7")
    with pytest.raises(fga.ApproximationError, match=r"frame scan 7.*need three"):
        fga.adjust(without)
    without = network.copy()
    del without.frames["scan 7"]
    without.add_frame("scan 7", free=("rz", "x", "y", "z"), level=True)
    assert fga.adjust(without).redundancy == 2


def test_frames_without_control_are_refused_unless_the_network_is_free():
    network = network_of_frames(9, ("model", "model"))
    network.datum = "given"
    with pytest.raises(fga.DatumError, match=r"7 datum defects|7 defects"):
        fga.adjust(network)


@pytest.mark.parametrize("axis", range(3))
def test_a_frame_that_turns_about_one_of_its_axes(axis):
    """Its held rotations keep their values, and the turn is found from a few places."""
    names = ("rx", "ry", "rz")
    held = {n: 0.2 for n in names if n != names[axis]}
    tilt = exp_rotation(np.array([[held.get(n, 0.0) for n in names]]))[0]
    rotation = tilt @ exp_rotation(np.eye(3)[[axis]] * 0.7)[0]
    network = fga.Network("a turntable")
    network.add_frame("f", free=(names[axis], "x", "y", "z"), values=held)
    rng = np.random.default_rng(axis)
    for i, x in enumerate(rng.uniform(-5.0, 5.0, (5, 3))):
        network.add_point(f"P{i}", x, fixed="xyz")
        q = rotation.T @ x + 1e-3 * rng.normal(size=3)
        network.add(FrameCoordinate("f", f"P{i}", tuple(q.tolist()), sigma=(1e-3,) * 3))
    solution = fga.adjust(network)
    assert (solution.redundancy, solution.sigma0) == (11, pytest.approx(1.0, abs=0.7))
    found = exp_rotation(np.array([solution.unknown("frame", "f").values[:3]]))[0]
    np.testing.assert_allclose(found[:, axis], tilt[:, axis], rtol=0, atol=1e-12)


@pytest.mark.parametrize("free", [("rx", "rz"), ("ry", "rz")])
def test_a_tilt_cannot_be_held_alone(free):
    """Turns about two axes turn about the third, so that it would end elsewhere by each way."""
    network = fga.Network("two turns")
    with pytest.raises(fga.InputError, match=r"frame 'f'.*two of the rotations rx, ry, rz, or"):
        network.add_frame("f", free=(*free, "x", "y", "z"))


@pytest.mark.parametrize("seed", range(12))
def test_a_frame_far_from_its_origin_comes_to_rest(seed):
    """Map coordinates, and an origin 5400 km away, as nothing states another.

    The last digits of scale and rotation move its places by nanometres: vᵀPv cannot tell more.
    """
    rng = np.random.default_rng(seed)
    network = fga.Network("map coordinates")
    network.add_frame("scan", free=("rx", "ry", "rz", "x", "y", "z", "ln_scale"))
    turn = exp_rotation(np.array([[0.2, -0.1, 2.0]]))[0]
    corner = np.array([5e5, 5.4e6, 300.0])
    for name in "ABCDEFG":
        x = corner + rng.uniform(0, [50, 50, 10])
        held = name in "ABC"
        network.add_point(name, x if held else None, fixed="xyz" if held else "")
        q = turn.T @ (x - corner) + rng.normal(0, 1e-3, 3)
        network.add(FrameCoordinate("scan", name, tuple(q.tolist()), sigma=(1e-3,) * 3))
    solution = fga.adjust(network)
    assert solution.converged
    assert solution.iterations <= 3
