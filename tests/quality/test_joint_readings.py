"""Edges of pose graphs, whose position and turn are one reading, in data snooping."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import Correlated
from factorgraph_adj.observations.body_vectors import HeadingDifference, PlanarVector
from factorgraph_adj.observations.relative_poses import RelativePosition, RelativeRotation
from factorgraph_adj.quality.group_tests import Test
from factorgraph_adj.quality.joint_readings import critical_joint_test
from factorgraph_adj.quality.reliability import critical_tau
from factorgraph_adj.quality.snooping_candidates import RowGroups
from factorgraph_adj.rotation import exp_rotation, log_rotation
from factorgraph_adj.types import Array

N = 24
POSES = [(math.cos(a) * 8.0, math.sin(a) * 8.0, -a) for a in np.linspace(0.0, 4.0 * math.pi, N)]
"""Two rounds on a circle: x, y, heading."""
COVARIANCE = np.array([[4e-4, 0.0, 1e-4], [0.0, 4e-4, -5e-5], [1e-4, -5e-5, 1e-4]])
"""Of ahead, left (m) and the turn (rad): 20 mm and 10 mrad, correlated."""
FALSE = (3, 17)
"""Stations of the false closure."""


def edge(i: int, j: int, error: Array) -> Correlated:
    """Return the true edge with errors of ahead, left and turn."""
    (x, y, a), (x2, y2, b) = POSES[i], POSES[j]
    east, north = x2 - x, y2 - y
    ahead = east * math.sin(a) + north * math.cos(a) + error[0]
    left = -east * math.cos(a) + north * math.sin(a) + error[1]
    turn = (b - a + error[2] + math.pi) % (2.0 * math.pi) - math.pi
    ends = f"P{i}", f"P{j}"
    return Correlated(
        (
            PlanarVector(*ends, (ahead, left), sigma=(1.0, 1.0), id=f"{i}-{j} vector"),
            HeadingDifference(*ends, turn, sigma=1.0, id=f"{i}-{j} turn"),
        ),
        COVARIANCE,
    )


def chain(
    closures: list[tuple[int, int]], *, seed: int | None = 0, error: Array | None = None
) -> fga.Network:
    """Return a chain of poses with closures, and the false one where it has an error."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(COVARIANCE) * float(seed is not None)
    network = fga.Network("chain")
    for i, (x, y, heading) in enumerate(POSES):
        network.add_point(f"P{i}", (x, y, 0.0), fixed="z" if i else "xyz")
        network.set_unknown("heading", f"P{i}", (heading,), fixed=i == 0)
    steps = [(i, i + 1) for i in range(N - 1)]
    network.add(*(edge(i, j, root @ rng.normal(size=3)) for i, j in [*steps, *closures]))
    if error is not None:
        network.add(edge(*FALSE, error))
    return network


MANY = [(i, i + 8) for i in range(0, N - 8, 2)] + [(N - 9, N - 1)]
"""Closures that control every step of the chain."""
FALSE_IDS = ("3-17 vector", "3-17 turn")


@pytest.mark.parametrize("test", ["baarda", "pope"])
@pytest.mark.parametrize("seed", range(3))
def test_a_false_closure_is_rejected_with_vector_and_turn_and_nothing_else(
    seed: int, test: Test
) -> None:
    error = np.random.default_rng(100 + seed).normal(0.0, (1.5, 1.5, 0.5))
    found = fga.snoop(chain(MANY, seed=seed, error=error), test=test)
    assert {r.id for r in found.rejected} == set(FALSE_IDS)
    assert not found.unresolved and not found.readmitted
    for r in found.rejected:
        (component,) = (i for i, name in enumerate(("ahead", "left", "")) if name == r.component)
        # A prediction of the chain: within four of its standard deviations.
        assert r.final_error == pytest.approx(error[component], abs=4.0 * r.final_sigma)


def test_a_wrong_turn_alone_takes_the_vector_of_its_edge_along() -> None:
    """One scan match made both: where one is false, nothing is known of the other."""
    found = fga.snoop(chain(MANY, error=np.array([0.0, 0.0, 0.4])))
    assert found.rejected_ids == FALSE_IDS


def test_an_error_of_one_reading_gives_it_the_largest_statistic() -> None:
    """The inequality of Cauchy and Schwarz; parts by themselves have no such law."""
    rng = np.random.default_rng(7)
    for _ in range(4):
        error = 1e-4 * rng.normal(size=3)  # linear
        solution = fga.adjust(chain(MANY, seed=None, error=error))
        groups = [g for g in fga.reliability(solution).groups if len(g.ids) == 2]
        assert max(groups, key=lambda g: g.test).ids == FALSE_IDS


def test_a_chain_with_one_loop_names_the_edges_that_no_test_separates() -> None:
    """Every edge of the loop has the same T²; the first one is rejected, the others are named."""
    found = fga.snoop(chain([], error=np.array([0.3, 0.2, 0.1])))
    assert len(found.rejected) == 2
    for r in found.rejected:
        partners = [label for label, _ in r.inseparable]
        assert len(partners) == FALSE[1] - FALSE[0]
        assert all(rho == pytest.approx(1.0, abs=1e-6) for _, rho in r.inseparable)


def test_an_edge_is_put_back_as_a_whole() -> None:
    """It fits without the false closure, and was rejected with it by a robust start."""
    network = chain(MANY, error=np.array([2.0, -1.0, 0.6]))
    found = fga.snoop(network, robust="huber")
    assert set(found.rejected_ids) == set(FALSE_IDS)
    back = {i.rpartition(" ")[0] for i in found.readmitted}
    assert set(found.readmitted) == {f"{e} {part}" for e in back for part in ("vector", "turn")}


def test_other_members_of_a_correlated_group_are_tested_by_themselves() -> None:
    """One vector of a session is wrong; the others of the session stay."""
    places = {"A": (0, 0, 0), "B": (900, 50, 3), "C": (300, 800, 9), "D": (700, 600, 1)}
    network = fga.Network("sessions")
    for name, xyz in places.items():
        network.add_point(name, xyz, fixed="xyz" if name == "A" else "")
    rng = np.random.default_rng(2)
    covariance = 1e-4 * (np.eye(9) + 0.5 * np.kron(np.ones((3, 3)) - np.eye(3), np.eye(3)))
    root = np.linalg.cholesky(covariance)
    for session, station in enumerate("ABC"):
        errors = root @ rng.normal(size=9)
        if station == "B":
            errors[3:6] += (0.0, 0.3, 0.1)
        members = []
        for k, target in enumerate(n for n in places if n != station):
            value = np.subtract(places[target], places[station]) + errors[3 * k : 3 * k + 3]
            ident = f"{session} {target}"
            members.append(
                fga.GnssVector(station, target, tuple(value), sigma=(1.0,) * 3, id=ident)
            )
        network.add(Correlated(tuple(members), covariance))
    found = fga.snoop(network)
    assert found.rejected_ids == ("1 C",)


def test_a_relative_pose_in_space_is_one_reading() -> None:
    rng = np.random.default_rng(5)
    covariance = np.diag([4e-4] * 3 + [1e-4] * 3) + 2e-5
    network = fga.Network("poses")
    network.add_camera("body", NoDistortion(), {"c": 1.0})
    places = rng.normal(0.0, 5.0, (8, 3))
    turns = [exp_rotation(t) for t in rng.normal(0.0, 0.4, (8, 3))]
    for i in range(8):
        network.add_photo(f"{i}", "body", position=places[i], rotation=turns[i], fixed=i == 0)
    pairs = [(i, j) for i in range(8) for j in (i + 1, i + 2) if j < 8]
    for i, j in pairs:
        e = np.linalg.cholesky(covariance) @ rng.normal(size=6)
        if (i, j) == (3, 5):
            e += rng.normal(0.0, 0.8, 6)
        position = turns[i].T @ (places[j] - places[i]) + e[:3]
        turn = log_rotation(turns[i].T @ turns[j] @ exp_rotation(e[3:]))
        network.add(
            Correlated(
                (
                    RelativePosition(
                        f"{i}", f"{j}", tuple(position), sigma=(1.0,) * 3, id=f"t{i}{j}"
                    ),
                    RelativeRotation(f"{i}", f"{j}", tuple(turn), sigma=(1.0,) * 3, id=f"r{i}{j}"),
                ),
                covariance,
            )
        )
    found = fga.snoop(network)
    assert set(found.rejected_ids) == {"t35", "r35"}
    units = RowGroups.of(fga.adjust(network).equations)
    assert units.size.tolist() == [6] * len(pairs)


def test_the_critical_value_of_one_component_is_that_of_its_own_test() -> None:
    """Baarda: χ² of one degree is w²; Pope: the Beta distribution is τ²."""
    alpha = 0.001
    w = critical_joint_test("baarda", alpha, 1, 10)
    assert w == pytest.approx(3.2905**2, abs=1e-3)
    tau = critical_joint_test("pope", alpha, 1, 10)
    assert tau == pytest.approx(critical_tau(alpha, 10) ** 2, rel=1e-9)
    assert critical_joint_test("pope", alpha, 3, 3) == math.inf
    # Much redundancy: σ̂0 is σ0.
    many = critical_joint_test("pope", alpha, 3, 10**6)
    assert many == pytest.approx(critical_joint_test("baarda", alpha, 3, 0), rel=1e-4)


def test_edges_without_correlation_are_separate_readings() -> None:
    network = chain(MANY)
    network.clusters = []
    for ident, o in list(network.observations.items()):
        sigma = (0.02, 0.02) if o.kind == "planar_vector" else 0.01
        network.observations[ident] = replace(o, sigma=sigma)
    equations = fga.adjust(network).equations
    assert equations.reading_of_row is equations.observation_of_row
