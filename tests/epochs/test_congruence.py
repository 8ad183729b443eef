"""Two epochs: published networks, laws of the tests, and simulation of their size and power."""

from __future__ import annotations

import re
from dataclasses import fields

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.epochs.congruence_tests import (
    UnitVariance,
    displacement_of_rows,
    robust_differences,
    weight_of_differences,
)
from factorgraph_adj.epochs.differences import differences_between
from factorgraph_adj.epochs.epoch_coordinates import SolutionCoordinates
from factorgraph_adj.errors import DatumError, InputError
from tests.loaders.gama import adjusted_epoch
from tests.networks.epochs import PLACES, detectable_shift, epoch, rates, solved, turned_vectors
from tests.support.places import data_dir

# -- published ------------------------------------------------------------------------------------


@pytest.mark.published
def test_shifts_of_gama(tmp_path):
    text = (data_dir("gama_deformation") / "data-1-2.txt").read_text(encoding="utf-8")
    rows = [t.split() for t in text.splitlines() if re.match(r"\w+ +\d+ +\d+ +\d+ ", t)]
    first, second = (adjusted_epoch(n, tmp_path) for n in (1, 2))
    names = [r[0] for r in rows]
    found = fga.congruence(first, second, reference=[], objects=names)
    printed = np.array([[float(x) for x in r[4:6]] for r in rows])
    assert found.differences.d.reshape(-1, 2) == pytest.approx(printed, abs=6e-6)
    n = 2 * len(names)
    upper = [float(x) for x in text.split(f"{n} {n - 1}")[1].split()]
    q = np.zeros((n, n))
    q[np.triu_indices(n)] = upper
    q = q + q.T - np.diag(np.diag(q))
    # Gama computes in axes with y to the other side and prints their covariances, but the shifts
    # in the axes of the file: products of x and y have the other sign.
    sign = np.where(np.add.outer(np.arange(n), np.arange(n)) % 2, -1.0, 1.0)
    assert 1e6 * found.differences.cofactor == pytest.approx(sign * q, abs=2e-4)


# -- laws -----------------------------------------------------------------------------------------


def test_the_test_is_independent_of_the_datum():
    first, second = solved(1), solved(2, {"B": (0.03, -0.02)})
    values = []
    for datum in (None, ["A", "B"], ["C", "D", "E", "P"]):
        a, b = (s if datum is None else fga.s_transform(s, datum) for s in (first, second))
        found = fga.congruence(a, b, objects=["P", "Q"])
        values.append((found.global_test.value, *found.displacement("P").vector, found.stable))
    for other in values[1:]:
        assert other[:4] == pytest.approx(values[0][:4], rel=1e-6, abs=2e-8)
        assert other[4] == values[0][4] == ("A", "C", "D", "E")


def test_displacements_equal_those_of_one_adjustment_of_both_epochs():
    shifts = {"P": (0.01, 0.02), "Q": (-0.02, 0.005)}
    one, two = epoch(3), epoch(4, shifts)
    both = fga.Network("both epochs", datum="free")
    for n, p in one.points.items():
        both.add_point(n, p.coordinates, fixed="z")
    for n in ("P", "Q"):
        both.add_point(f"{n}2", one.points[n].coordinates, fixed="z")
    both.add(*one.observations.values())
    later = {n: f"{n}2" if n in "PQ" else n for n in PLACES}
    for o in two.observations.values():
        changed = {"station": later[o.station], "target": later[o.target], "id": None}
        if isinstance(o, fga.Direction):
            changed["set"] = "later"
        both.add(type(o)(**{**_fields(o), **changed}))
    joint = fga.congruence(fga.adjust(both), pairs={"P": "P2", "Q": "Q2"}, variance="a-priori")
    apart = fga.congruence(
        fga.adjust(one),
        fga.adjust(two),
        reference=list("ABCDE"),
        objects=["P", "Q"],
        variance="a-priori",
    )
    for n in ("P", "Q"):
        a, b = apart.displacement(n), joint.displacement(n)
        assert a.vector == pytest.approx(b.vector, abs=2e-6)
        assert a.covariance == pytest.approx(b.covariance, rel=1e-4, abs=1e-11)
        assert a.test.value == pytest.approx(b.test.value, rel=1e-3)


def _fields(o):
    return {f.name: getattr(o, f.name) for f in fields(o)}


def differences_of(first, second):
    """Return the differences of all points of two adjustments."""
    places = SolutionCoordinates(first), SolutionCoordinates(second)
    return differences_between(*places, {n: n for n in PLACES})


def test_gauss_decomposition():
    """T of a set of points is Ω of all less Ω of the others."""
    found = differences_of(solved(5), solved(6, {"D": (0.01, 0.0)}))
    d, q, g = found.d, found.cofactor, found.motions
    w = weight_of_differences(q, g)
    for some in (["D"], ["A", "P"], ["B", "C", "E"]):
        rows = found.rows(some)
        rest = np.setdiff1d(np.arange(len(d)), rows)
        alone = weight_of_differences(q[np.ix_(rest, rest)], np.linalg.qr(g[rest])[0])
        expected = d @ w @ d - d[rest] @ alone @ d[rest]
        assert displacement_of_rows(w, d, rows)[2] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("method", ["backward", "combinations", "robust"])
def test_moved_reference_points_are_found(method):
    shifts = {"B": (0.02, 0.01), "D": (-0.015, 0.02), "P": (0.01, -0.01)}
    found = fga.congruence(solved(7), solved(8, shifts), objects=["P", "Q"], method=method)
    assert not found.global_test.accepted
    assert set(found.stable) == {"A", "C", "E"}
    assert set(found.moved) == {"B", "D", "P"}
    for name, shift in shifts.items():
        x = found.displacement(name)
        error = x.vector[:2] - shift
        assert error @ np.linalg.solve(x.covariance[:2, :2], error) < 14.0


def test_points_that_move_together_do_not_smear():
    """Three of seven points move alike: least squares leaves it to the others to have moved."""
    together = dict.fromkeys(("A", "B", "E"), (0.02, 0.015))
    first, second = solved(11), solved(12, together)
    found = fga.congruence(first, second)
    assert set(found.stable) == set(PLACES) - set(together)


def test_the_robust_transformation_has_the_smallest_sum_of_lengths():
    together = dict.fromkeys(("A", "E"), (0.02, 0.015))
    found = differences_of(solved(11), solved(12, together))
    moves, q = robust_differences(found, tuple(PLACES))

    def total(d):
        return np.linalg.norm(d.reshape(-1, 2), axis=1).sum()

    rng = np.random.default_rng(1)
    for size in (1e-2, 1e-3, 1e-4):
        for _ in range(100):
            t = size * rng.normal(size=found.motions.shape[1])
            assert total(moves + found.motions @ t) > total(moves) - 1e-6
    assert total(moves) < total(found.d)
    assert np.linalg.eigvalsh(q)[0] > -1e-12


def test_a_rigid_block_and_strain():
    turn, centre = 2e-4, np.mean([PLACES["P"], PLACES["Q"], PLACES["E"]], axis=0)
    shifts = {}
    for n in ("P", "Q", "E"):
        x, y = np.array(PLACES[n]) - centre
        shifts[n] = (0.01 - turn * y, turn * x)
    found = fga.congruence(
        solved(13), solved(14, shifts), reference=list("ABCD"), objects=["P", "Q", "E"]
    )
    rigid = fga.block_motion(found, ["P", "Q", "E"])
    assert rigid.names == ("tx", "ty", "rz")
    assert rigid.fit.accepted and not rigid.motion.accepted
    error = rigid.values - [0.01, 0.0, turn]
    assert (np.abs(error) < 3.3 * rigid.sigmas).all()
    affine = fga.block_motion(found, ["P", "Q", "E"], model="affine")
    assert affine.fit is None
    strains, directions = affine.principal_strains()
    assert (np.abs(strains) < 4 * max(affine.sigmas[3:])).all()
    assert directions @ directions.T == pytest.approx(np.eye(2), abs=1e-12)


def test_strain_of_a_stretched_body():
    e = np.array([[3e-4, 1e-4], [1e-4, -1e-4]])
    names = ["E", "P", "Q", "D"]
    centre = np.mean([PLACES[n] for n in names], axis=0)
    shifts = {n: tuple(e @ (np.array(PLACES[n]) - centre)) for n in names}
    found = fga.congruence(solved(15), solved(16, shifts), reference=["A", "B", "C"], objects=names)
    body = fga.block_motion(found, names, model="affine")
    expected = {"exx": 3e-4, "exy": 1e-4, "eyy": -1e-4, "rz": 0.0}
    for name, value in expected.items():
        assert abs(body[name] - value) < 3.3 * body.sigmas[body.names.index(name)]
    assert body.fit.p_value > 1e-3
    assert not fga.block_motion(found, names).fit.accepted
    assert body.principal_strains()[0] == pytest.approx(np.linalg.eigvalsh(e)[::-1], abs=5e-5)


def test_a_given_datum_needs_no_reference():
    found = fga.congruence(
        solved(21, datum="given"),
        solved(22, {"P": (0.0, 0.02)}, datum="given"),
        reference=[],
        objects=["B", "D", "E", "P", "Q"],
    )
    assert found.global_test is None
    assert found.moved == ("P",)


def test_all_points_may_leave_where_control_holds_both_epochs():
    """One rule whatever carries the datum; all points moved alike against the two held ones."""
    first = solved(21, datum="given")
    second = solved(22, dict.fromkeys("BDEPQ", (0.01, 0.02)), datum="given")
    named = fga.congruence(first, second, reference=[], objects=["B", "D", "E", "P", "Q"])
    for method in ("combinations", "backward", "robust"):
        found = fga.congruence(first, second, method=method)
        assert found.reference == ("B", "D", "E", "P", "Q")
        assert found.stable == ()
        assert found.fine == named.fine  # no doubt is added
        assert set(found.roles.held) == {"A", "C"}
        assert found.moved == named.moved == ("B", "D", "E", "P", "Q")
        for name in found.moved:
            own, other = found.displacement(name), named.displacement(name)
            assert own.test.value == pytest.approx(other.test.value, rel=1e-12)


# -- size and power -------------------------------------------------------------------------------


@pytest.mark.slow("counts decisions over repeated epochs; short tests compare with exact figures")
def test_size_and_power_of_a_few_epochs():
    size, _ = rates(range(1000, 1060), (0.0, 0.0), variance="a-priori")
    assert size <= 9 / 60  # 3 are expected, more than 9 with a probability of 1e-4
    _, power = rates(range(2000, 2060), detectable_shift(), variance="a-priori")
    assert 0.60 <= power <= 0.97


# -- wrong input ----------------------------------------------------------------------------------


def messages(caught):
    return [str(p) for p in caught.value.problems]


def test_wrong_names_are_all_told():
    first, second = solved(1), solved(2)
    with pytest.raises(InputError) as caught:
        fga.congruence(first, second, reference=["A", "X", "Y"], objects=["P"])
    assert [m.split(":")[0] for m in messages(caught)] == ["point 'X'", "point 'Y'"]
    with pytest.raises(InputError, match="named as reference and as object"):
        fga.congruence(first, second, reference=["A", "B"], objects=["B"])
    with pytest.raises(InputError, match="must be a list of names"):
        fga.congruence(first, second, reference="ABC")
    with pytest.raises(InputError, match="needs pairs"):
        fga.congruence(first)
    with pytest.raises(InputError, match="unknown method 'forward'"):
        fga.congruence(first, second, method="forward")
    with pytest.raises(InputError, match="alpha and power"):
        fga.congruence(first, second, alpha=0.9)


def test_held_points_cannot_be_seen_to_move():
    first, second = (solved(i, datum="given") for i in (1, 2))
    with pytest.raises(InputError, match="'A': is held in an epoch"):
        fga.congruence(first, second, reference=["A", "B"])


def test_two_reference_points_do_not_determine_a_rotation_of_one():
    with pytest.raises((DatumError, InputError)):
        fga.congruence(solved(1), solved(2), reference=["A"], objects=["P"])


def test_datums_may_be_turned_against_each_other():
    first = solved(1)
    network = epoch(2)
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    turned = network.copy()
    for n, p in network.points.items():
        turned.points[n] = type(p)(**{**_fields(p), "coordinates": tuple(turn @ p.coordinates)})
    second = fga.adjust(turned)
    expected, found = (fga.congruence(first, s) for s in (fga.adjust(network), second))
    assert found.global_test.value == pytest.approx(expected.global_test.value, rel=1e-5)
    for n in PLACES:
        assert found.displacement(n).vector == pytest.approx(
            expected.displacement(n).vector, abs=1e-7
        )


def test_a_known_scale_has_the_test_of_chi_squared():
    assert UnitVariance(1.0, np.inf).test(3.0, 1, 0.05).critical == pytest.approx(3.8415, abs=1e-4)
    assert UnitVariance(1.0, 30.0).test(3.0, 2, 0.05).critical == pytest.approx(3.3158, abs=1e-4)


# -- few reference points -------------------------------------------------------------------------


def distances(seed, places, shifts=None):
    """Return the free adjustment of a network of distances between all points."""
    rng = np.random.default_rng(seed)
    true = {n: np.array(x, dtype=float) for n, x in places.items()}
    for n, shift in (shifts or {}).items():
        true[n] = true[n] + shift
    network = fga.Network("distances", datum="free")
    for n, x in true.items():
        network.add_point(n, tuple(x), fixed="z" if not any(p[2] for p in places.values()) else "")
    names = list(true)
    for i, a in enumerate(names):
        for b in (*names[i + 1 :], *names[i + 1 :]):
            length = np.linalg.norm(true[b] - true[a]) + rng.normal(0, 0.001)
            network.add(fga.SlopeDistance(a, b, length, sigma=0.001))
    return fga.adjust(network)


IN_PLAN = {"A": (0, 0, 0), "B": (100, 0, 0), "C": (50, 80, 0), "D": (20, 40, 0)}


def test_a_stable_point_that_the_others_cannot_place_is_compared_in_what_they_tell():
    """Of A and B alone only the distance AB can have changed: A moves along it, or unseen."""
    first, second = distances(1, IN_PLAN), distances(2, IN_PLAN, {"C": (0.05, 0, 0)})
    found = fga.congruence(first, second, reference=["A", "B"], variance="a-priori")
    lengths = [np.linalg.norm(np.diff(s.state["point"][:2], axis=0)) for s in (first, second)]
    change = lengths[1] - lengths[0]
    for name, sign in (("A", -1.0), ("B", 1.0)):
        x = found.displacement(name)
        # B stays, and A takes the whole change of the distance.
        assert x.vector == pytest.approx([sign * change, 0.0, 0.0], abs=1e-7)
        assert x.test.freedom[0] == 1
        assert x.test.value == pytest.approx(found.global_test.value, rel=1e-6)
        assert np.isinf(x.sigmas[1])
        assert np.isinf(x.detectable)
        assert abs(x.hardest[1]) == pytest.approx(1.0, abs=1e-3)
        assert not x.moved
    assert found.displacement("C").vector[0] == pytest.approx(0.05, abs=0.003)
    assert found.moved == ("C",)


IN_SPACE = {
    "A": (0, 0, 0),
    "B": (100, 0, 0),
    "D": (20, 40, 10),
    "E": (60, -50, 25),
    "F": (9, 7, 50),
}


def test_reference_points_that_leave_a_rotation_open_are_refused():
    first, second = distances(1, IN_SPACE), distances(2, IN_SPACE)
    with pytest.raises(DatumError, match="A, B leave 1 of 6 motions of the other points open"):
        fga.congruence(first, second, reference=["A", "B"])


@pytest.mark.parametrize("far", [(2.0, 1.5), (10.0, -5.0)])
def test_displacements_do_not_depend_on_how_far_another_point_moved(far):
    """Ten metres in a network of 300 m would turn the second epoch by 17 mm at its ends."""
    first, near = solved(1), solved(2, {"P": (0.05, 0.0)})
    found = [fga.congruence(first, s, objects=["P", "Q"]) for s in (near, solved(2, {"P": far}))]
    noise = [
        c.displacement("P").vector[:2] - shift
        for c, shift in zip(found, ((0.05, 0.0), far), strict=True)
    ]
    assert noise[1] == pytest.approx(noise[0], abs=1e-4)  # directions to P are others
    vectors = [c.displacement("Q").vector for c in found]
    assert vectors[1] == pytest.approx(vectors[0], abs=1e-4)


def test_a_comparison_in_which_no_reference_point_is_stable_is_doubtful():
    """All azimuths of the second epoch are turned: every point moved against the held one."""
    found = fga.congruence(turned_vectors(0.0, 1), turned_vectors(2e-3, 2))
    assert not found.stable
    assert not found.fine
    assert fga.congruence(turned_vectors(0.0, 1), turned_vectors(0.0, 2)).fine
