"""Set-ups without approximate coordinates, where targets have the names of others."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.start.approximate_values import approximate
from factorgraph_adj.start.polar_points import agreed_transformation, turned_in_plan
from tests.networks.exchanged_day import SIGMA_GNSS, day

TURN, SHIFT = 2.3, np.array([400.0, -150.0, 12.0])


def cloud(n: int) -> np.ndarray:
    return np.random.default_rng([n, 7]).uniform([-80, -80, -9], [80, 80, 9], (n, 3))


def moved(places: np.ndarray) -> np.ndarray:
    return np.append(turned_in_plan(places[:, :2], TURN), places[:, 2:], axis=1) + SHIFT


@pytest.mark.parametrize(("n", "wrong"), [(3, 1), (5, 2), (9, 4), (60, 28)])
def test_the_transformation_is_that_of_the_points_that_agree(n: int, wrong: int) -> None:
    """Points with the names of others are left out, also where they are nearly half."""
    own = cloud(n)
    known = moved(own)
    known[:wrong] = known[:wrong][::-1]
    known[:wrong] += [11.0, -7.0, 1.0]  # the middle one of an odd number is no other point
    found = agreed_transformation(own, known, within=0.3)
    assert found is not None
    np.testing.assert_allclose(np.mod(found.turn, 2 * np.pi), TURN, atol=1e-12)
    np.testing.assert_allclose(found.shift, SHIFT, atol=1e-9)
    np.testing.assert_array_equal(found.agree, np.arange(n) >= wrong)


def test_a_cloud_without_heights_is_joined_in_plan_alone() -> None:
    own = cloud(6)
    own[:, 2] = np.nan
    known = moved(own)
    known[2, :2] += 40.0
    found = agreed_transformation(own, known, within=0.3)
    assert found is not None and found.agree.sum() == 5 and np.isnan(found.shift[2])
    np.testing.assert_allclose(found.shift[:2], SHIFT[:2], atol=1e-9)


@pytest.mark.parametrize("n", [2, 3, 4, 10])
def test_points_of_which_no_more_than_half_agree_join_nothing(n: int) -> None:
    own = cloud(n)
    known = moved(own)
    for k, i in enumerate(range(0, n, 2)):
        known[i] += np.array([9.0, -17.0, 0.0]) * (k + 1)
    assert agreed_transformation(own, known, within=0.3) is None


@pytest.mark.parametrize("seed", [7, 35, 59, 87, 257, 339])
def test_exchanged_targets_move_no_other_point_of_a_start(seed: int) -> None:
    """All points but those exchanged begin where they are, within what positions tell."""
    case = day(seed)
    equations = compile_network(case.network)
    start = approximate(equations)["point"]
    names = equations.unknowns["point"].names
    wrong = set(itertools.chain.from_iterable(e.pair for e in case.exchanged))
    off = {n: np.abs(start[k] - case.true[n]).max() for k, n in enumerate(names)}
    assert len(wrong & off.keys()) == len(wrong)
    assert max(d for n, d in off.items() if n not in wrong) < 10 * max(SIGMA_GNSS)


def test_two_turns_with_as_many_points_are_no_agreement() -> None:
    """A station, two right targets, and two exchanged ones on opposite sides of the station."""
    own = np.array([[0, 0, 0], [60, 0, 0], [0, 70, 0], [-40, 30, 0], [40, -30, 0]], dtype=float)
    known = moved(own)
    known[[3, 4]] = known[[4, 3]]
    assert agreed_transformation(own, known, within=0.3) is None
    known[1] = moved(own)[1]
    more = np.append(own, [[20.0, 55.0, 0.0]], axis=0)
    found = agreed_transformation(more, np.append(known, moved(more)[-1:], axis=0), within=0.3)
    assert found is not None and found.agree.tolist() == [True, True, True, False, False, True]
