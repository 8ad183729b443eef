"""Drone blocks of a rolling shutter: motions found, their covariances, and what leaves them out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.quality.precision_maps import precision_map
from factorgraph_adj.solve.datum_defects import find_defects
from factorgraph_adj.solve.inner_constraints import moved_by_similarity
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.statistical_tests import global_test
from factorgraph_adj.triangulation.independent_models import relative_model
from factorgraph_adj.triangulation.plan_blocks import radial_observations
from factorgraph_adj.types import Array
from tests.networks.rolling_drone import (
    INTERVAL,
    MOTION_SIGMA,
    SIGMA_PX,
    errors_of_motions,
    flown,
    measured,
    true_motions,
)
from tests.support.dense import Dense

NORMAL_95 = 1.959964
REPETITIONS = 40


@pytest.mark.parametrize("per_photo", [False, True])
def test_covariances_and_redundancy_numbers_are_those_of_dense_algebra(per_photo: bool) -> None:
    """``per_photo``: the calibration is of the photo too, behind its motion."""
    solution = fga.adjust(measured(flown(per_photo=per_photo), 1))
    assert solution.converged and solution.datum_defect == 0
    equations = solution.equations
    unknowns = equations.unknowns
    dense = Dense.at(equations, solution.state)
    q = dense.cofactor(unknowns.free)
    for kind, name in (("photo_motion", "F2"), ("pose", "F5"), ("point", "P1")):
        columns = unknowns.columns(kind, unknowns[kind].number[name])
        own = q[np.ix_(columns, columns)]
        found = solution.variable_covariance((kind, name))
        np.testing.assert_allclose(found, own, atol=1e-8 * np.abs(own).max())
    cross = solution.variable_covariance(("photo_motion", "F2"), ("pose", "F2"))
    columns = [unknowns.columns(k, unknowns[k].number["F2"]) for k in ("photo_motion", "pose")]
    wanted = q[np.ix_(*columns)]
    np.testing.assert_allclose(cross, wanted, atol=1e-8 * np.abs(wanted).max())
    assert solution.vtpv == pytest.approx(dense.vtpv_after_step(), rel=1e-9)
    found_numbers = fga.reliability(solution).redundancy_numbers
    np.testing.assert_allclose(found_numbers, dense.redundancy_numbers(), atol=1e-9)


def repeated(plan: Network) -> Iterator[Array]:
    """Iterate over the errors of the motions in repetitions of a block."""
    for seed in range(REPETITIONS):
        yield errors_of_motions(plan, fga.adjust(measured(plan, seed)))


def test_intervals_of_95_percent_cover_the_true_motions() -> None:
    """Of 40 × 12 × 6 intervals; `tests.benchmarks.rolling_shutter` repeats it more often."""
    found = np.array(list(repeated(flown(4, 3, 200))))
    assert found.shape == (REPETITIONS, 12, 6)
    assert np.mean(np.abs(found) < NORMAL_95) == pytest.approx(0.95, abs=0.01)
    assert np.mean(found**2) == pytest.approx(1.0, abs=0.1)


def test_photos_that_are_said_to_stand_still_do_not_fit() -> None:
    """Poses and calibration absorb most of 15 cm, more than 6 px, at the first and last rows."""
    network = measured(flown(), 1)
    network.parameters.pop("photo_motion")
    still = fga.adjust(network)
    moving = fga.adjust(measured(flown(), 1))
    assert global_test(moving).accepted
    assert still.sigma0 > global_test(still).upper


def test_given_motions_leave_the_result_of_a_global_shutter() -> None:
    """A motion of zero, held, is no motion."""
    network = measured(flown(), 1)
    for photo in network.photos:
        network.set_unknown("photo_motion", photo, (0.0,) * 6, fixed=True)
    held = fga.adjust(network)
    network.parameters.pop("photo_motion")
    absent = fga.adjust(network)
    assert held.vtpv == pytest.approx(absent.vtpv, rel=1e-9)
    for name in network.points:
        np.testing.assert_allclose(held.point(name), absent.point(name), atol=1e-7)


def test_weighted_motions_are_more_precise_than_free_ones() -> None:
    plan = flown()
    network = measured(plan, 1)
    free = fga.adjust(network)
    for photo, motion in true_motions(plan).items():
        network.set_unknown("photo_motion", photo, motion, sigma=MOTION_SIGMA)
    weighted = fga.adjust(network)
    for photo in network.photos:
        sigmas = np.array(weighted.unknown("photo_motion", photo).sigmas)
        assert (sigmas < np.array(free.unknown("photo_motion", photo).sigmas)).all()
        assert (sigmas < MOTION_SIGMA).all()


def test_motions_follow_from_the_neighbours() -> None:
    """Where a photo has few image points, the way between its neighbours tells its motion."""
    plan = flown(5, 1, 120)
    network = measured(plan, 1)
    times = {photo: INTERVAL * i for i, photo in enumerate(network.photos)}
    network.add_strip_motions(times, sigma_velocity=1.5, sigma_rate=0.2)
    solution = fga.adjust(network)
    for photo, true in true_motions(plan).items():
        found = solution.unknown("photo_motion", photo)
        assert (np.array(found.sigmas) <= [1.5] * 3 + [0.2] * 3).all()
        np.testing.assert_allclose(found.values[:3], true[:3], atol=4.0)


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_image_points_that_arrive_give_the_batch_result(engine: Literal["isam2", "fronts"]) -> None:
    network = measured(flown(3, 2, 160), 1)
    whole = fga.adjust(network)
    photo, point, xy, _ = network.images.columns()
    last = photo == len(network.photos) - 1
    names, points = list(network.photos), list(network.points)
    late = [
        ImagePoint(names[f], points[p], x, y, sigma=SIGMA_PX)
        for f, p, (x, y) in zip(photo[last], point[last], xy[last].tolist(), strict=True)
    ]
    begun = network.copy()
    begun.image_mask(~last)
    graph = fga.IncrementalAdjustment(begun, engine=engine)
    graph.add(late)
    graph.settle()
    assert not graph.n_waiting
    for photo in network.photos:
        np.testing.assert_allclose(
            graph.solution().unknown("photo_motion", photo).values,
            whole.unknown("photo_motion", photo).values,
            atol=1e-6,
        )


def test_what_has_one_pose_for_all_rows_refuses_photos_that_move() -> None:
    network = measured(flown(), 1)
    reason = r"photo 'F0'.*takes the rows of a photo as exposed at the same time"
    with pytest.raises(fga.InputError, match=reason):
        relative_model(network, ("F0", "F1"))
    with pytest.raises(fga.InputError, match=reason):
        radial_observations(network)
    solution = fga.adjust(network)
    with pytest.raises(fga.InputError, match=reason):
        precision_map(solution, np.array([[40.0, 20.0, 10.0]]))
    found = precision_map(solution)
    np.testing.assert_allclose(found.covariances, solution.point_covariances)
    network.parameters.pop("photo_motion")
    assert relative_model(network, ("F0", "F1")).photos == ("F0", "F1")


def without_positions(network: Network) -> Network:
    """Return a block of which only image points remain, with inner constraints."""
    ids = [i for i, o in network.observations.items() if o.kind in ("control", "photo_position")]
    out = fga.without(network, ids)
    out.datum = "free"
    return out


@pytest.mark.parametrize("amounts", [(0.3, 0.0), (1.0, 0.0), (0.0, 0.5), (-0.8, -0.4)])
def test_velocities_turn_and_grow_with_a_free_network(amounts: tuple[float, float]) -> None:
    """``amounts``: a turn, radians, and the change of ln scale. No residual changes."""
    solution = fga.adjust(without_positions(measured(flown(), 2)))
    equations = solution.equations
    system = LinearisedEquations(equations, solution.state)
    (defect,) = find_defects(system, solution.state, system.diagonal(), free=True)
    turn, ln_scale = amounts
    _, size = defect.about
    motion = np.zeros(7)
    motion[3:6] = size * turn * np.array([0.6, 0.0, 0.8])
    motion[6] = size * ln_scale
    along = np.linalg.solve(defect.mixture, motion)
    there = moved_by_similarity(equations, solution.state, defect, along)
    v, moved = (equations.residuals(state) for state in (solution.state, there))
    np.testing.assert_allclose(moved, v, rtol=0.0, atol=1e-7)
    speeds = [np.linalg.norm(s["photo_motion"][:, :3], axis=1) for s in (solution.state, there)]
    np.testing.assert_allclose(speeds[1], np.exp(ln_scale) * speeds[0], rtol=1e-12)


def test_weights_about_zero_are_no_length_of_a_free_network() -> None:
    network = without_positions(measured(flown(), 2))
    for photo in network.photos:
        network.set_unknown("photo_motion", photo, (0.0,) * 6, sigma=MOTION_SIGMA)
    with pytest.raises(fga.DatumError, match="nothing in the free network has a length") as caught:
        fga.adjust(network)
    assert "weighted photo motion" in str(caught.value)
