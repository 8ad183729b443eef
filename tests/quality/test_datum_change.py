"""The S-transformation: coordinates and covariances on another datum, and what stays the same."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.keys import KeyMap
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, HeightDifference
from factorgraph_adj.quality.datum_change import s_transform
from factorgraph_adj.quality.point_precision import distance_precision
from factorgraph_adj.quality.reliability import reliability
from factorgraph_adj.solve.datum_defects import minimal_datum
from factorgraph_adj.types import Array, Mask
from tests.networks.aicon import MM, point_reference, read_aicon
from tests.networks.free import (
    FREE,
    MILLIMETRE,
    adjusted,
    freed,
    gnss,
    levelled,
    plane,
    rest,
    with_datum,
)
from tests.networks.small_block import small_block
from tests.networks.total_station import total_station
from tests.support.dense import Dense
from tests.support.places import data_dir

LONG = pytest.mark.slow(
    "every kind of network between its data; short tests change the datum of one"
)

NANOMETRE = 1e-9
FEW_ULP = 1e-15
"""Relative: geocentric coordinates come in steps of 1 nm."""
ROUNDING = 1e-9
"""Covariances from two ways of computing them, relative to the standard deviations."""
CANCELLED = 1e-14
"""What rounding leaves of a variance, relative to the largest one of the network, where datum
points have none."""


# -- networks -------------------------------------------------------------------------------------


# -- comparisons ----------------------------------------------------------------------------------


def dense_covariance(solution: fga.Solution) -> Array:
    """Return the covariance between all points, (3 n, 3 n), by the public functions."""
    names = list(solution.network.points)
    return np.block([[solution.covariance(a, b) for b in names] for a in names])


def assert_same_covariance(
    found: Array, expected: Array, rel: float = ROUNDING, largest: float = 0.0
) -> None:
    """Compare relative to the standard deviations; ``largest`` variance around, if not here."""
    sigma = np.sqrt(np.maximum(np.diag(expected), 0.0))
    rounding = CANCELLED * max(largest, float(np.diag(expected).max()))
    wrong = np.abs(found - expected) > rel * np.outer(sigma, sigma) + rounding
    assert not wrong.any(), np.argwhere(wrong)


def assert_same(found: fga.Solution, expected: fga.Solution) -> None:
    """Compare coordinates, attitudes, other unknowns and covariances."""
    for kind, values in expected.state.items():
        np.testing.assert_allclose(found.state[kind], values, rtol=FEW_ULP, atol=NANOMETRE)
    assert_same_covariance(dense_covariance(found), dense_covariance(expected))
    largest = float(expected.point_covariances.max())
    for kind, number in expected.equations.unknowns.active():
        variable = kind, expected.equations.unknowns[kind].names[number]
        assert_same_covariance(
            found.variable_covariance(variable),
            expected.variable_covariance(variable),
            largest=largest if kind == "point" else 0.0,
        )


def spread(solution: fga.Solution, names: Iterable[str]) -> float:
    """Return the sum of variances of points; over datum points S is a projection."""
    return float(sum(np.trace(solution.covariance(n)) for n in names))


def datum_mask(solution: fga.Solution, names: tuple[str, ...]) -> Mask:
    table = solution.equations.unknowns["point"]
    out = np.zeros(solution.equations.unknowns.n_columns, dtype=bool)
    for name in names:
        first = table.offset[table.number[name]]
        out[first : first + 3] = True
    return out & solution.equations.unknowns.free


# -- free networks --------------------------------------------------------------------------------


@LONG
@pytest.mark.parametrize("name", FREE)
def test_it_leads_to_the_adjustment_with_the_other_datum_points(name):
    there = adjusted(name, 1)
    found = s_transform(adjusted(name, 0), FREE[name][3])
    assert found.converged
    assert found.datum_defect == FREE[name][1]
    assert_same(found, there)
    assert found.vtpv == pytest.approx(there.vtpv, rel=1e-9)


@pytest.mark.parametrize("name", FREE)
def test_back_again_leads_to_the_first_solution(name):
    first = adjusted(name, 0)
    assert_same(s_transform(s_transform(first, FREE[name][3]), FREE[name][2]), first)


@pytest.mark.parametrize("name", FREE)
def test_covariances_are_those_of_a_dense_s_q_s_transposed(name):
    """Inner constraints by the null space of the design matrix, from a singular value
    decomposition that knows nothing of similarity transformations."""
    found = s_transform(adjusted(name, 0), FREE[name][3])
    dense = Dense.at(found.equations, found.state).cofactor(datum_mask(found, FREE[name][3]))
    table = found.equations.unknowns["point"]
    columns = (table.offset[:, None] + np.arange(3)).ravel()
    assert_same_covariance(dense_covariance(found), dense[np.ix_(columns, columns)], rel=1e-7)
    every = np.stack([found.covariance(n) for n in table.names])
    np.testing.assert_allclose(found.point_covariances, every, rtol=1e-9, atol=1e-9 * every.max())


@pytest.mark.parametrize("name", FREE)
def test_what_does_not_depend_on_the_datum_stays(name):
    """Residuals; distances and their precision, unless scale is part of the datum."""
    first = adjusted(name, 0)
    found = s_transform(first, FREE[name][3])
    np.testing.assert_allclose(
        found.observations.normalised, first.observations.normalised, rtol=0, atol=1e-5
    )
    names = [n for d in first.defects for n in d.names()]
    for a, b in combinations(first.network.points, 2):
        before, after = distance_precision(first, a, b), distance_precision(found, a, b)
        if name == "levelling":
            height = found.covariance(a) + found.covariance(b) - 2 * found.covariance(a, b)
            was = first.covariance(a) + first.covariance(b) - 2 * first.covariance(a, b)
            assert height[2, 2] == pytest.approx(was[2, 2], rel=1e-9)
        elif "scale" not in names:
            assert after.distance == pytest.approx(before.distance, abs=NANOMETRE)
            assert after.sigma == pytest.approx(before.sigma, rel=1e-7)


@LONG
def test_over_all_points_the_trace_is_smallest():
    """The inner constraints over all points give the smallest sum of variances of them all."""
    first = adjusted("total station", 0)
    least = np.trace(dense_covariance(s_transform(first)))
    for names in combinations(first.network.points, 3):
        assert np.trace(dense_covariance(s_transform(first, names))) > least


def test_the_network_says_which_points_carry_the_datum():
    found = s_transform(adjusted("plane", 0), ("C", "D", "E"))
    assert [n for n, p in found.network.points.items() if p.datum] == ["C", "D", "E"]
    assert [n for n, p in adjusted("plane", 0).network.points.items() if p.datum] == ["A", "B"]


def test_reliability_does_not_depend_on_the_datum_points():
    first = adjusted("total station", 0)
    before, after = reliability(first), reliability(s_transform(first, FREE["total station"][3]))
    np.testing.assert_allclose(after.redundancy_numbers, before.redundancy_numbers, atol=1e-9)
    np.testing.assert_allclose(after.w, before.w, atol=1e-4)


def range_factor(network: Network) -> gtsam.NonlinearFactor:
    """Return a distance between two points as a factor of the user."""
    keys = KeyMap(compile_network(network).unknowns)
    noise = gtsam.noiseModel.Isotropic.Sigma(1, MILLIMETRE)
    return gtsam.RangeFactor3(keys.key("point", "A"), keys.key("point", "C"), 158.2, noise)


def test_factors_of_the_user_move_along():
    first, there = (
        fga.adjust(
            with_datum(plane(), names), extra_factors=[range_factor(plane())], tolerance=1e-8
        )
        for names in FREE["plane"][2:]
    )
    assert first.vtpv != pytest.approx(adjusted("plane", 0).vtpv, rel=1e-3)
    assert_same(s_transform(first, FREE["plane"][3]), there)


def test_a_solution_that_is_not_at_rest_says_so():
    network = with_datum(total_station(1, coarse=1.0), ("P0", "P1", "P2"))
    stopped = fga.adjust(network, max_iterations=1)
    assert not stopped.converged
    found = s_transform(stopped, ("P3", "P5", "P6"))
    assert not found.converged
    assert found.reason == stopped.reason


@pytest.mark.slow(
    "a published block over two other datums; small networks show the same in a moment"
)
def test_published_standard_deviations_come_back_after_a_detour():
    """AICON's close-range block, free over its 150 points: over five of them and back."""
    folder = data_dir("aicon_jaicov")
    network = read_aicon(folder)
    first = fga.adjust(network, variance="a-posteriori")
    five = ["6", "8", "506", "507", "1080"]
    away = s_transform(first, five)
    assert spread(away, five) < spread(first, five)
    back = s_transform(away)
    names, published = point_reference(folder)
    found = np.array([back.standard_deviations(n) for n in names])
    np.testing.assert_allclose(found, published[:, 3:], rtol=0, atol=0.5e-6 * MM)
    np.testing.assert_allclose(back.state["point"], first.state["point"], rtol=0, atol=NANOMETRE)


# -- given datum ----------------------------------------------------------------------------------


def held_minimally(name: str) -> tuple[Network, Network]:
    """Return the network with as many coordinates held as it has defects, and the free one.

    Both start at the same adjusted coordinates, so that both have the same solution.
    """
    # Standard deviations with ppm belong to where an adjustment starts: so twice.
    free = adjusted(name, 0)
    for _ in range(2):
        free = fga.adjust(restarted(free.network, free), tolerance=rest(name))
    assert free.datum is not None
    columns = minimal_datum(free.datum.motions, datum_mask(free, FREE[name][2]))
    given = restarted(free.network, free)
    unknowns = free.equations.unknowns
    for column in columns.tolist():
        _, point, axis = unknowns.describe(column)
        p = given.points[point]
        fixed = list(p.fixed)
        fixed["xyz".index(axis)] = True
        given.points[point] = replace(p, fixed=tuple(fixed))
    given.datum = "given"
    return given, with_datum(restarted(free.network, free), FREE[name][3])


def restarted(network: Network, solution: fga.Solution) -> Network:
    """Return the network with the coordinates of a solution."""
    out = network.copy()
    for name, p in out.points.items():
        out.points[name] = replace(p, coordinates=tuple(solution.point(name).tolist()))
    return out


@LONG
@pytest.mark.parametrize("name", FREE)
def test_a_minimal_datum_is_exchanged_for_inner_constraints(name):
    """The covariances of a free network, held coordinates included, from one with a given datum."""
    given, free = (fga.adjust(n, tolerance=rest(name)) for n in held_minimally(name))
    assert given.datum is None
    assert given.redundancy == free.redundancy
    found = s_transform(given, FREE[name][3])
    assert found.reference is not None
    assert len(found.reference.motions) == FREE[name][1]
    assert_same(found, free)
    photos = list(free.network.photos)
    for photo in photos[:1]:
        pair = ("pose", photo), ("point", "P5")
        expected = free.variable_covariance(*pair)
        scale = np.outer(
            np.sqrt(np.diag(free.pose_covariance(photo))), free.standard_deviations("P5")
        )
        assert np.abs((found.variable_covariance(*pair) - expected) / scale).max() < ROUNDING
    np.testing.assert_allclose(
        found.point_covariances,
        free.point_covariances,
        rtol=0,
        atol=1e-9 * free.point_covariances.max(),
    )


def all_components(solution: fga.Solution, q: Array) -> Array:
    """Return cofactors of the points with rows for held ones too, (3 n, 3 n)."""
    table = solution.equations.unknowns["point"]
    n = len(table.names)
    out = np.zeros((3 * n, 3 * n))
    on = np.flatnonzero(table.offset >= 0)
    mine = (3 * on[:, None] + np.arange(3)).ravel()
    theirs = (table.offset[on, None] + np.arange(3)).ravel()
    out[np.ix_(mine, mine)] = q[np.ix_(theirs, theirs)]
    return out


def test_more_control_than_a_datum_needs_keeps_what_it_says_of_the_shape():
    """Against a dense S Q Sᵀ: Q with the control, G the null space without it."""
    solution = fga.adjust(small_block())
    names = ("P1", "P7", "P9", "P12")
    found = s_transform(solution, names)
    dense = Dense.at(solution.equations, solution.state)
    q = dense.cofactor(np.zeros(solution.equations.unknowns.n_columns, dtype=bool))
    loose = compile_network(freed(small_block())).weighted_at(solution.state)
    free = Dense.at(loose, solution.state)
    scale = np.linalg.norm(free.design, axis=0)
    _, s, vt = np.linalg.svd(free.design / scale)
    rank = int(np.sum(s > 1e-9 * s[0]))
    g = np.zeros((loose.unknowns.n_columns, len(scale) - rank))
    g[free.free] = (vt[rank:] / scale).T
    assert g.shape[1] == 4
    table = loose.unknowns["point"]
    g = g[(table.offset[:, None] + np.arange(3)).ravel()]
    datum = np.repeat(np.isin(table.names, names), 3)
    transformation = np.eye(len(g))
    transformation[:, datum] -= g @ np.linalg.solve(g[datum].T @ g[datum], g[datum].T)
    expected = transformation @ all_components(solution, q) @ transformation.T
    assert_same_covariance(dense_covariance(found), expected, rel=1e-7)
    # The held station is a point like others there.
    assert solution.covariance("S1").max() == 0.0
    assert found.standard_deviations("S1").min() > 0.0


def test_coordinates_and_residuals_of_a_given_datum_stay():
    solution = fga.adjust(small_block())
    found = s_transform(solution, ("P1", "P7", "P9"))
    assert found.state is solution.state
    assert found.redundancy == solution.redundancy
    np.testing.assert_array_equal(reliability(found).w, reliability(solution).w)
    for a, b in (("P1", "P9"), ("S1", "P3"), ("P2", "S2")):
        before, after = distance_precision(solution, a, b), distance_precision(found, a, b)
        assert after.sigma == pytest.approx(before.sigma, rel=1e-8)
    before = distance_precision(solution, ("pose", "F1"), "P3")
    after = distance_precision(found, ("pose", "F1"), "P3")
    assert after.sigma == pytest.approx(before.sigma, rel=1e-8)


def test_a_transformed_solution_can_be_transformed_again():
    solution = fga.adjust(small_block())
    there = s_transform(solution, ("P2", "P5", "P8"))
    again = s_transform(s_transform(solution, ("P1", "P7", "P9")), ("P2", "P5", "P8"))
    assert_same_covariance(dense_covariance(again), dense_covariance(there))


def weighted(network: Network, names: str, sigma: float) -> Network:
    """Return the network with weighted coordinates."""
    out = network.copy()
    out.datum = "given"
    for name in names:
        p = out.points[name]
        out.points[name] = replace(p, sigma=(sigma,) * 3)
    return out


def test_motions_that_observations_notice_stay_unless_they_are_named():
    """An azimuth holds the rotation, distances the scale."""
    solution = fga.adjust(weighted(plane(azimuth=True), "AB", 0.01))
    shifts = s_transform(solution, ("C", "D", "E"))
    assert shifts.reference is not None
    assert set(shifts.reference.motions) == {"shift in x", "shift in y"}
    turned = s_transform(
        solution,
        ("C", "D", "E"),
        motions=["shift in x", "shift in y", "rotation about z"],
    )
    free = s_transform(fga.adjust(weighted(plane(), "AB", 0.01)), ("C", "D", "E"))
    assert free.reference is not None
    assert len(free.reference.motions) == 3
    assert spread(turned, "CDE") < spread(shifts, "CDE")
    scaled = s_transform(
        solution,
        ("C", "D", "E"),
        motions=["shift in x", "shift in y", "rotation about z", "scale"],
    )
    assert spread(scaled, "CDE") < spread(turned, "CDE")


def test_named_motions_are_the_same_as_those_found():
    solution = fga.adjust(small_block())
    found = s_transform(solution, ("P1", "P7", "P9"))
    assert found.reference is not None
    named = s_transform(
        solution,
        ("P1", "P7", "P9"),
        motions=["shift in x", "shift in y", "shift in z", "rotation about z"],
    )
    assert set(found.reference.motions) == set(named.reference.motions)  # type: ignore[union-attr]
    assert_same_covariance(dense_covariance(named), dense_covariance(found))


def test_levelling_has_one_motion():
    network = levelled()
    network.points["A"] = replace(network.points["A"], fixed=(True, True, True))
    found = s_transform(fga.adjust(network), ("B",))
    assert found.reference is not None
    assert found.reference.motions == ("shift in z",)
    # Every point has a height difference of 1 mm to each of the four others: 5 r of 10.
    # Zero but for rounding of the variances that it is the difference of.
    assert found.covariance("B")[2, 2] == pytest.approx(0.0, abs=1e-15 * MILLIMETRE**2)
    assert found.standard_deviations("A")[2] == pytest.approx(MILLIMETRE * (2 / 5) ** 0.5)
    assert found.covariance("A")[0, 0] == 0.0


def test_control_that_nothing_else_observes_is_left_out():
    network = weighted(plane(), "AB", 0.01)
    network.add_point("far", (500.0, 500.0, 0.0), fixed="z", sigma=0.01)
    found = s_transform(fga.adjust(network), ("C", "D", "E"))
    without = s_transform(fga.adjust(weighted(plane(), "AB", 0.01)), ("C", "D", "E"))
    assert_same_covariance(found.covariance("B"), without.covariance("B"))
    assert found.standard_deviations("far")[0] == pytest.approx(0.01)


def test_control_points_as_observations_give_the_datum_too():
    network = gnss()
    for name in "AB":
        at = network.points[name].coordinates
        network.add(ControlPoint(name, at, sigma=(0.02,) * 3))
    found = s_transform(fga.adjust(network), ("C", "D"))
    assert found.reference is not None
    assert len(found.reference.motions) == 3
    free = fga.adjust(with_datum(gnss(), ("C", "D")))
    # Two control points say something of the shape: never less than without them.
    for name in "ABCDE":
        more = np.linalg.eigvalsh(free.covariance(name) - found.covariance(name))
        assert more.min() > -1e-12


def test_an_a_posteriori_solution_stays_one():
    network = with_datum(plane(), ("A", "B"))
    known = s_transform(fga.adjust(network), ("C", "D"))
    scaled = s_transform(fga.adjust(network, variance="a-posteriori"), ("C", "D"))
    np.testing.assert_allclose(
        scaled.covariance("E"), scaled.sigma0**2 * known.covariance("E"), rtol=1e-9
    )


# -- what is wrong --------------------------------------------------------------------------------


def test_all_unknown_points_are_named_at_once():
    with pytest.raises(fga.InputError, match=r"'X'(.|\n)*'Y'") as error:
        s_transform(adjusted("plane", 0), ["X", "A", "Y"])
    assert len(error.value.problems) == 2
    with pytest.raises(fga.InputError, match="list of names"):
        s_transform(adjusted("plane", 0), "A")


def test_points_that_cannot_carry_the_datum_are_refused():
    with pytest.raises(fga.DatumError, match="cannot carry a datum with 3 defects"):
        s_transform(adjusted("plane", 0), ["C"])
    with pytest.raises(fga.DatumError, match="cannot carry a datum with 4 defects"):
        s_transform(fga.adjust(small_block()), ["P1"])


def test_motions_are_not_for_free_networks_and_must_be_known():
    with pytest.raises(fga.InputError, match=r"datum defect \(shift in x, shift in y"):
        s_transform(adjusted("plane", 0), ["C", "D"], motions=["scale"])
    solution = fga.adjust(small_block())
    for wrong in (["shift"], [], "scale"):
        with pytest.raises(fga.InputError, match="motions must be some of shift in x"):
            s_transform(solution, ["P1", "P7"], motions=wrong)  # type: ignore[arg-type]


def test_a_held_point_carries_no_free_datum():
    network = with_datum(levelled(), ("B", "C"))
    network.points["E"] = replace(network.points["E"], fixed=(True, True, True))
    for ident, o in list(network.observations.items()):
        if "E" in o.names():
            del network.observations[ident]
    with pytest.raises(fga.InputError, match="point 'E': is held"):
        s_transform(fga.adjust(network), ["A", "E"])


def test_parts_that_only_control_connects_are_refused_unless_motions_are_named():
    network = Network("two lines of levels")
    for name, z in zip("ABCD", (1.0, 2.0, 5.0, 6.0), strict=True):
        network.add_point(name, (0.0, 0.0, z), fixed="xyz" if name in "AC" else "xy")
    network.add(
        HeightDifference("A", "B", 1.0, sigma=MILLIMETRE),
        HeightDifference("C", "D", 1.0, sigma=MILLIMETRE),
    )
    solution = fga.adjust(network)
    with pytest.raises(fga.DatumError, match="not connected; name motions="):
        s_transform(solution, ["B"])
    found = s_transform(solution, ["B"], motions=["shift in z"])
    assert found.standard_deviations("A")[2] == pytest.approx(MILLIMETRE)
    # D is known relative to C, C held, hence relative to A: both errors add up.
    assert found.standard_deviations("D")[2] == pytest.approx(2**0.5 * MILLIMETRE)


def test_nothing_to_take_out_is_said():
    """A factor of the user may be an observation: what it notices stays."""
    network = gnss()
    keys = KeyMap(compile_network(network).unknowns)
    at = np.array(network.points["A"].coordinates)
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.01)
    prior = gtsam.PriorFactorPoint3(keys.key("point", "A"), at, noise)
    solution = fga.adjust(network, extra_factors=[prior])
    with pytest.raises(fga.InputError, match="nothing to take out"):
        s_transform(solution, ["B", "C"])
    named = s_transform(solution, ["B", "C"], motions=["shift in x", "shift in y", "shift in z"])
    free = fga.adjust(with_datum(gnss(), ("B", "C")))
    assert_same_covariance(dense_covariance(named), dense_covariance(free))
