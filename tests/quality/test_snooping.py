"""Data snooping of simulated networks whose gross errors are known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import HeightDifference, ImagePoint
from factorgraph_adj.quality.rejections import Round, Snooping
from factorgraph_adj.quality.reliability import critical_tau, reliability
from factorgraph_adj.quality.snooping import snoop
from factorgraph_adj.quality.snooping_candidates import RowGroups, choose_outliers
from factorgraph_adj.quality.snooping_search import CannotSettle, SnoopingSearch
from factorgraph_adj.quality.snooping_state import MAX_NEGLECTED_RESIDUAL
from factorgraph_adj.simulation.simulated_blocks import (
    simulate_aerial_block,
    simulate_geocentric_block,
)
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.statistical_tests import descending
from tests.benchmarks.grids import simulate_grid
from tests.networks.mistaken import levelling
from tests.networks.trilateration import SIGMA, trilateration
from tests.support.same import contents
from tests.support.shifted import shift_image

LONG = pytest.mark.slow("hundreds of tests of larger networks; short tests search small ones")

# -- mixed networks -----------------------------------------------------------------------------


@cache
def quarry() -> tuple[Network, dict[str, float]]:
    """Return the geocentric block with gross errors of many kinds, SI and mm, by id."""
    network = simulate_geocentric_block(11).network
    kinds: dict[str, list[str]] = {}
    for ident, o in network.observations.items():
        kinds.setdefault(o.kind, []).append(ident)
    sizes = {
        kinds["slope_distance"][5]: 0.05,
        kinds["horizontal_distance"][40]: -0.03,
        kinds["direction"][30]: 2e-4,
        kinds["zenith_angle"][3]: 2e-4,
        kinds["vertical_angle"][50]: -3e-4,
        kinds["height_difference"][4]: 0.02,
        kinds["azimuth"][0]: 3e-4,
    }
    for ident, error in sizes.items():
        o = network.observations[ident]
        network.observations[ident] = replace(o, value=o.value + error)
    vector = network.clusters[0][0][1]  # one of a correlated pair
    o = network.observations[vector]
    network.observations[vector] = replace(o, value=(o.value[0], o.value[1] + 0.1, o.value[2]))
    position = kinds["photo_position"][4]
    o = network.observations[position]
    network.observations[position] = replace(o, value=(*o.value[:2], o.value[2] - 0.3))
    shift_image(network, "photo 02/T02", 0.05, -0.02)
    shift_image(network, "photo 06/T16", 0.0, 0.06)
    sizes |= {vector: 0.1, position: -0.3, "photo 02/T02": 0.05, "photo 06/T16": 0.06}
    return network, sizes


@pytest.fixture(scope="module")
def found() -> Snooping:
    return snoop(quarry()[0])


@LONG
def test_gross_errors_of_many_kinds_are_found_in_a_mixed_network(found: Snooping) -> None:
    """Eleven of nine kinds; a vector of a correlated pair and an image point go as a whole."""
    network, planted = quarry()
    rejected = {r.id: r for r in found.rejected}
    assert planted.keys() <= rejected.keys()
    # About 1 in 1000 of 3000 right ones goes with them.
    assert len(rejected) - len(planted) <= 6
    for ident, error in planted.items():
        r = rejected[ident]
        assert abs(r.final_error - error) < 4 * r.final_sigma
        assert abs(r.final_test) > found.critical
        assert r.final_test * error < 0  # computed − observed
        assert ident not in found.network.observations
    ((left, _),) = found.network.clusters
    assert left == (network.clusters[0][0][0],)
    assert found.network.n_image_points <= network.n_image_points - 2
    assert not found.unresolved
    assert not found.rejected_points


def test_the_clean_solution_is_the_adjustment_of_the_clean_network(found: Snooping) -> None:
    network, _ = quarry()
    s = adjust(without(network, [r.id for r in found.rejected]))
    assert found.solution.redundancy == s.redundancy
    assert found.solution.vtpv == pytest.approx(s.vtpv, rel=1e-4)  # σ by lengths of the start
    assert found.reliability.solution is found.solution
    assert np.nanmax(np.abs(found.reliability.w)) <= found.critical
    assert found.rounds[-1].set_aside == found.rounds[-1].readmitted == 0
    assert "no test value is above the critical value" in found.reason


def test_what_was_found_is_described(found: Snooping) -> None:
    by_id = {r.id: r for r in found.rejected}
    vector = by_id[quarry()[0].clusters[0][0][1]]
    assert (vector.kind, vector.component) == ("gnss_vector", "y")
    image = by_id["photo 06/T16"]
    assert (image.kind, image.component) == ("image", "y")
    assert image.label == "image photo 06 T16 y"
    assert image.estimated_error == pytest.approx(0.06, abs=0.02)
    assert 1 <= image.round <= len(found.rounds)


@pytest.mark.slow(
    "rounds of snooping agree with adjustments anew and with alpha; short tests take "
    "single gross errors"
)
def test_the_network_passed_in_is_never_changed():
    network, _ = quarry()
    before = contents(network)
    snoop(network, max_rounds=2)
    snoop(network, robust="huber", max_rounds=1)
    assert contents(network) == before


def test_weighted_unknowns_can_be_wrong_too():
    """A coordinate given 30 σ wrong, and the position of a photo: without their weight, free."""
    network = simulate_industry_block(5, photos=7).network
    free = adjust(network)
    for name, axis in (("P33", 0), ("P48", 2)):
        at = free.point(name)
        at[axis] += 0.03 * (axis == 0)
        point = network.points[name]
        network.points[name] = replace(point, coordinates=tuple(at), sigma=(0.001,) * 3)
    pose = free.pose("photo 5")
    network.photos["photo 5"] = replace(
        network.photos["photo 5"],
        position=tuple((pose.position + np.array([0.0, 0.2, 0.0])).tolist()),
        rotation=pose.rotation,
        sigma_position=(0.005,) * 3,
    )
    found = snoop(network)
    rejected = {r.id: r for r in found.rejected}
    assert {"point P33 x", "photo photo 5 position y"} <= rejected.keys()
    assert rejected["point P33 x"].kind == "control"
    assert rejected["point P33 x"].final_error == pytest.approx(0.03, abs=0.004)
    assert found.network.points["P33"].sigma == (np.inf, 0.001, 0.001)
    assert found.network.points["P48"].sigma == (0.001,) * 3
    assert not found.unresolved


# -- points and what cannot go ----------------------------------------------------------------


@cache
def images_alone() -> tuple[Network, dict[str, list[str]]]:
    """Return the industry block with four photos only, and the rays of each point."""
    network = simulate_industry_block(
        3, photos=4, terrestrial=False, self_calibration=False
    ).network
    rays: dict[str, list[str]] = {}
    for o in network.image_points():
        rays.setdefault(o.point, []).append(f"{o.photo}/{o.point}")
    return network, rays


def with_parallax(network: Network, ident: str, size: float) -> Network:
    """Return the network with a gross error across the epipolar line, mm.

    That is where the redundancy of two rays is: along the eigenvector of their Q_vv P.
    """
    from factorgraph_adj.quality.error_effects import residual_response

    s = adjust(network)
    rows = s.equations.find([ident])[0]
    _, vectors = np.linalg.eigh(residual_response(s, rows)[rows])
    wrong = network.copy()
    shift_image(wrong, ident, *(size * vectors[:, 1]))
    return wrong


def test_a_point_of_two_rays_with_a_parallax_goes_as_a_whole_and_is_said_to():
    network, rays = images_alone()
    name = next(p for p, r in rays.items() if len(r) == 2 and p not in ("P01", "P70", "P10"))
    found = snoop(with_parallax(network, rays[name][1], 0.2))
    (gone,) = found.rejected_points
    assert gone.name == name
    assert set(gone.rays) == set(rays[name])
    assert abs(gone.test) > 10
    assert (
        f"without '{rays[name][0]}'" in gone.reason or f"without '{rays[name][1]}'" in gone.reason
    )
    assert "the others do not determine it" in gone.reason
    assert name not in found.network.points
    assert not {r.id for r in found.rejected} & set(rays[name])
    assert found.solution.redundancy == adjust(without(network, [], points=[name])).redundancy


def test_a_wrong_ray_of_three_goes_alone_and_the_second_takes_the_point_along():
    network, rays = images_alone()
    name = next(p for p, r in rays.items() if len(r) == 3 and p not in ("P01", "P70", "P10"))
    wrong = network.copy()
    shift_image(wrong, rays[name][0], 0.2, 0.3)
    found = snoop(wrong)
    assert rays[name][0] in {r.id for r in found.rejected}
    assert not found.rejected_points
    assert name in found.network.points
    shift_image(wrong, rays[name][1], 0.4, -0.7)
    found = snoop(wrong)
    (gone,) = found.rejected_points
    (alone,) = (r.id for r in found.rejected if r.id in rays[name])
    assert {alone, *gone.rays} == set(rays[name])


def spoil(network: Network, share: float, seed: int) -> tuple[Network, frozenset[str]]:
    """Return the network with gross errors of 20 to 300 σ in some image points, and their ids."""
    rng = np.random.default_rng(seed)
    wrong = network.copy()
    _, _, xy, sigma = wrong.images.columns()
    on = rng.random(len(xy)) < share
    size = rng.uniform(20.0, 300.0, (int(on.sum()), 1)) * rng.choice([-1, 1], (int(on.sum()), 2))
    moved = xy.copy()
    moved[on] += sigma[on] * size * [1.0, 0.7]
    wrong.images.xy = [moved]
    names = [f"{o.photo}/{o.point}" for o in network.image_points()]
    return wrong, frozenset(n for n, bad in zip(names, on, strict=True) if bad)


def test_a_good_point_that_went_comes_back_when_its_rays_meet_again():
    """Huber's start takes a point of two rays for the errors of others."""
    network, rays = images_alone()
    wrong, bad = spoil(network, 0.03, seed=10)
    found = snoop(wrong, robust="huber")
    back = {name for name, own in rays.items() if set(own) <= set(found.readmitted)}
    assert back
    for name in back:
        assert not set(rays[name]) & bad
        assert name in found.network.points
    assert len({r.id for r in found.rejected} - bad) <= 1
    assert bad <= {r.id for r in found.rejected} | {
        i for p in found.rejected_points for i in p.rays
    }


def resected() -> Network:
    """Return a photo with a weighted attitude and two rays to held points: one redundancy."""
    network = Network()
    for name, at in (("A", (1.0, 0.5, 0.0)), ("B", (-1.2, 0.3, 0.5))):
        network.add_point(name, at, fixed="xyz")
    network.add_camera("cam", BrownLens(), {"c": 20.0})
    network.add_photo(
        "f",
        "cam",
        position=(0.0, 0.0, 8.0),
        omega_phi_kappa=(0.0, 0.0, 0.0),
        sigma_attitude=0.001,
    )
    network.add(
        ImagePoint("f", "A", 2.5, 1.25, sigma=0.005),
        ImagePoint("f", "B", -3.2, 0.8 + 0.3, sigma=0.005),
    )
    return network


def test_what_cannot_go_stays_and_is_unresolved():
    """Without any one of the three observations, the other two do not determine the photo."""
    found = snoop(resected())
    assert not found.rejected
    assert {u.id for u in found.unresolved} == {"f/A", "f/B", "photo f attitude"}
    assert "would be undetermined" in found.unresolved[0].reason
    assert all("may explain it" in u.reason for u in found.unresolved[1:])
    assert all(abs(u.test) > found.critical for u in found.unresolved)
    assert "cannot be rejected" in found.reason
    assert len(found.rounds) == 1


def test_others_do_not_go_for_the_error_of_one_that_cannot():
    """A held point that gives the datum has two rays: neither can go, whichever is wrong."""
    network, rays = images_alone()
    assert len(rays["P70"]) == 2
    wrong = with_parallax(network, rays["P70"][0], 0.5)
    found = snoop(wrong)
    assert rays["P70"][0] in {u.id for u in found.unresolved}
    assert sum("would be undetermined" in u.reason for u in found.unresolved) == 1
    assert len(found.unresolved) > 5
    assert len(found.rejected) + len(found.rejected_points) <= 2


def test_what_makes_the_adjustment_fail_stays_and_is_unresolved():
    """Weights of a calibration for each photo cannot be taken from one photo alone."""
    network = simulate_industry_block(5, photos=4).network
    camera = network.cameras["P31"]
    values = (camera.values[0] + 0.3, *camera.values[1:])
    network.cameras["P31"] = replace(camera, values=values, per_photo=True)
    found = snoop(network)
    stuck = [u for u in found.unresolved if u.kind == "weighted_calibration"]
    assert {u.id for u in stuck} >= {f"calibration P31@photo {i} c" for i in (1, 2, 3, 4)}
    assert "hold for all its photos" in stuck[0].reason
    assert not any(r.kind == "weighted_calibration" for r in found.rejected)


# -- the rule of a round ----------------------------------------------------------------------


def test_a_round_takes_the_worst_and_leaves_what_they_may_explain():
    network, _ = trilateration(2, share=0.25)
    s = adjust(network)
    rel = reliability(s)
    choice = choose_outliers(rel, rel.w, scale=1.0, critical=rel.critical_w, share=0.4)
    rows = [c.row for c in choice.chosen]
    w = np.abs(rel.w)
    assert len(rows) > 1
    assert rows[0] == int(np.argmax(w))
    assert np.all(np.diff(w[rows]) < 0)
    assert w[rows].min() >= 0.4 * w.max()
    rho = np.abs(rel.correlation(rows)) - np.eye(len(rows))
    assert rho.max() <= 0.5
    only = choose_outliers(rel, rel.w, scale=1.0, critical=rel.critical_w, share=1.0)
    assert [c.row for c in only.chosen] == rows[:1]


def test_test_values_without_those_that_go_are_those_of_the_next_adjustment():
    """The linear model of a round, against the adjustment without what it took."""
    from factorgraph_adj.quality.snooping_candidates import _OutlierSearch

    network, _ = trilateration(3, share=0.1)
    s = adjust(network)
    rel = reliability(s)
    every = np.arange(len(rel.w))
    search = _OutlierSearch(rel, RowGroups.of(s.equations), every, rel.w, 1.0)
    gone = np.argsort(-np.abs(rel.w))[:3].tolist()
    for unit in gone:
        search.consider(unit)
    left = np.delete(every, gone)
    expected = (search.w / np.sqrt(np.maximum(np.diag(search.left), 1e-12)))[left]
    ids = s.observations.ids
    later = reliability(adjust(without(network, [ids[i] for i in gone]), start=s))
    assert [ids[i] for i in left] == later.solution.observations.ids
    assert later.w == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_one_at_a_time_finds_what_several_at_a_time_find():
    network, bad = trilateration(5, share=0.08)
    several, single = snoop(network), snoop(network, share=1.0)
    assert {r.id for r in several.rejected} == {r.id for r in single.rejected} == bad
    assert len(several.rounds) < len(single.rounds)
    assert all(r.set_aside <= 1 for r in single.rounds)
    assert several.solution.vtpv == pytest.approx(single.solution.vtpv)


def test_good_ones_that_went_with_the_wrong_ones_come_back():
    """A fifth of the distances are wrong: thirteen good ones are taken for wrong, and put back."""
    network, bad = trilateration(0, share=0.2)
    found = snoop(network)
    assert {r.id for r in found.rejected} == bad
    assert len(found.readmitted) > 10
    assert sum(r.set_aside - r.readmitted for r in found.rounds) == len(bad)
    # What was put back and then rejected again is not put back a second time.
    assert len(set(found.readmitted)) == len(found.readmitted)


def test_popes_test_does_not_need_the_true_sigma():
    """All standard deviations five times too small: Baarda's test would reject most."""
    network, bad = trilateration(4, share=0.1, size=(100.0, 200.0), noise=5.0)
    found = snoop(network, test="pope")
    rejected = {r.id: r for r in found.rejected}
    assert rejected.keys() == bad
    assert found.solution.sigma0 == pytest.approx(5.0, rel=0.2)
    f = found.solution.redundancy
    assert found.critical == critical_tau(0.001, f)
    assert len(snoop(network).rejected) > 2 * len(bad)
    # Of one put back: τ is that of the adjustment with it.
    ident = found.rejected[0].id
    others = [i for i in rejected if i != ident]
    rel = reliability(adjust(without(network, others), start=found.solution))
    row = rel.solution.observations.row(ident)
    assert rejected[ident].final_test == pytest.approx(rel.tau[row], rel=1e-3)


def test_what_cannot_be_told_apart_is_said():
    """A levelling line of three legs between held heights: an error of one could be of any.

    All three have the same |w|; one of them goes, the others wait for what is left without it.
    """
    network = Network()
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("D", (9.0, 0.0, 0.0), fixed="xyz")
    for name in "BC":
        network.add_point(name, (3.0, 0.0, 0.0), fixed="xy")
    for a, b, h in (("A", "B", 1.0), ("B", "C", 1.0), ("C", "D", -1.9)):
        network.add(HeightDifference(a, b, h, sigma=0.01, id=a + b))
    result = snoop(network)
    (found,) = result.rejected
    assert (result.rounds[0].suspects, result.rounds[0].set_aside) == (3, 1)
    others = {"AB", "BC", "CD"} - {found.id}
    assert {name.split("id ")[1].rstrip(")") for name, _ in found.inseparable} == others
    assert all(abs(rho) == pytest.approx(1.0) for _, rho in found.inseparable)


@pytest.mark.parametrize("seed", [3, 4])
def test_rounding_does_not_choose_among_equal_test_values(seed: int) -> None:
    """Two readings of one loop stay in doubt in the second round of both networks, |w| equal.

    Changes of 10⁻¹⁰ of the test values stand for rounding on another machine.
    """
    rel = reliability(adjust(levelling(seed, scale=1.001)))
    first = choose_outliers(rel, rel.w, scale=1.0, critical=3.29, share=0.4).chosen
    aside = {rel.solution.equations.id(c.row) for c in first}
    network = without(levelling(seed, scale=1.001), aside)
    rel = reliability(adjust(network))
    size = np.abs(rel.w)
    tied = np.flatnonzero(size > (1.0 - 1e-9) * size.max())
    assert len(tied) > 1
    rng = np.random.default_rng(1)
    for _ in range(20):
        w = rel.w * (1.0 + 1e-10 * rng.normal(size=len(rel.w)))
        found = choose_outliers(rel, w, scale=1.0, critical=3.29, share=0.4).chosen
        assert found[0].row == tied[0]


def test_equal_test_values_keep_their_order() -> None:
    size = np.array([1.0, 7.0, 7.0 * (1.0 + 1e-9), 0.0, 7.1, 7.0 * (1.0 - 2e-9)])
    assert descending(size).tolist() == [4, 1, 2, 5, 0, 3]
    assert descending(size[:0]).tolist() == []


# -- clean networks ---------------------------------------------------------------------------


@pytest.mark.slow(
    "rounds of snooping agree with adjustments anew and with alpha; short tests take "
    "single gross errors"
)
def test_right_observations_are_rejected_as_often_as_alpha_says():
    """60 clean networks of 105 distances, α0 = 1 %: 63 false alarms, ± 4 √63.

    Rejections of one network are correlated; what the greatest explains does not follow.
    """
    n, alpha, trials = 105, 0.01, 60
    rejected = [len(snoop(trilateration(100 + t)[0], alpha=alpha).rejected) for t in range(trials)]
    expected = n * alpha * trials
    assert abs(sum(rejected) - expected) < 4 * np.sqrt(expected)


@LONG
def test_with_sidak_alpha_is_that_of_the_whole_network():
    """α = 30 % of all tests together: 18 of 60 clean networks lose something, ± 3 √(60·0.3·0.7)."""
    alpha, trials = 0.3, 60
    networks = [trilateration(100 + t)[0] for t in range(trials)]
    lose = sum(bool(snoop(network, alpha=alpha, sidak=True).rejected) for network in networks)
    assert abs(lose - alpha * trials) < 3 * np.sqrt(trials * alpha * (1 - alpha))
    found = snoop(networks[0], alpha=alpha, sidak=True)
    assert found.reliability.alpha == pytest.approx(1 - 0.7 ** (1 / 105))


def test_a_clean_network_takes_one_adjustment():
    network = simulate_industry_block(4).network
    found = snoop(network, alpha=1e-6)
    assert not found.rejected
    assert not found.readmitted
    assert len(found.rounds) == 1
    assert found.solution.vtpv == adjust(network).vtpv


def test_without_redundancy_nothing_is_found():
    network = Network()
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (3.0, 0.0, 0.0), fixed="xy")
    network.add(HeightDifference("A", "B", 100.0, sigma=0.01))
    for options in ({}, {"test": "pope"}, {"robust": "tukey"}):
        found = snoop(network, **options)
        assert not found.rejected
        assert not found.unresolved


# -- how it is asked --------------------------------------------------------------------------


def test_the_search_tells_of_each_round_and_stops_when_told():
    network, bad = trilateration(5, share=0.08)
    rounds: list[Round] = []
    found = snoop(network, share=1.0, max_rounds=3, progress=rounds.append)
    assert tuple(rounds) == found.rounds
    assert [r.number for r in rounds] == [1, 2, 3]
    assert len(found.rejected) == 3
    assert found.reason == "stopped after 3 rounds"
    assert rounds[0].largest > 30
    assert rounds[0].sigma0 == pytest.approx(adjust(network).sigma0)
    left = {u.id: u for u in found.unresolved}
    assert bad - {r.id for r in found.rejected} <= left.keys()
    assert "the search stopped" in next(iter(left.values())).reason


def test_it_can_start_from_a_solution():
    network, bad = trilateration(5, share=0.08)
    s = adjust(network)
    found = snoop(network, start=s, variance="a-posteriori")
    assert {r.id for r in found.rejected} == bad
    assert found.solution.variance == "a-posteriori"
    assert found.solution.sigma0 == pytest.approx(1.0, rel=0.25)
    assert np.median(found.solution.observations.sigmas) == SIGMA


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"test": "t"}, "unknown test 't'; valid: baarda, pope"),
        ({"robust": "l1"}, "unknown estimator 'l1'; valid: huber, danish, igg3, tukey"),
        ({"alpha": 0.0}, "alpha and power must lie between 0 and 1"),
        ({"alpha": 0.9}, "alpha below power: 0.9, 0.8"),
        ({"share": 0.0}, "share must lie between 0 and 1, not 0.0"),
        ({"max_rounds": 0}, "max_rounds must be 1 or more"),
    ],
)
def test_wrong_options_are_refused(options, what):
    with pytest.raises(InputError, match=what):
        snoop(trilateration(1)[0], **options)


def test_all_wrong_options_are_named_at_once():
    with pytest.raises(InputError) as error:
        snoop(trilateration(1)[0], test="t", share=2.0)
    assert len(error.value.problems) == 2


# -- rounds that withdraw observations ----------------------------------------------------------


def grid() -> Network:
    """Return a grid of total stations with gross errors in one observation of fifty."""
    network = simulate_grid(1, points=225).network
    rng = np.random.default_rng(2)
    ids = list(network.observations)
    for i in rng.choice(len(ids), len(ids) // 50, replace=False).tolist():
        o = network.observations[ids[i]]
        error = rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 50.0) * o.sigma
        network.observations[ids[i]] = replace(o, value=o.value + error)
    return network


def aerial() -> Network:
    """Return a block of photos with gross errors in one image point of a hundred."""
    network = simulate_aerial_block(3, image_points=2000, points_per_photo=100).network
    return spoil(network, 0.01, 4)[0]


SPOILT = {
    "grid": (grid, {}),
    "grid, one at a time": (grid, {"share": 1.0, "max_rounds": 12}),
    "grid, Pope": (grid, {"test": "pope"}),
    "photos": (aerial, {}),
    "photos, Pope": (aerial, {"test": "pope"}),
    "photos, stopped": (aerial, {"max_rounds": 2}),
    "clusters and vectors": (lambda: quarry()[0], {}),
    "photos, robust": (aerial, {"robust": "huber"}),
    "trilateration": (lambda: trilateration(5, share=0.08)[0], {}),
}


@pytest.mark.slow(
    "rounds of snooping agree with adjustments anew and with alpha; short tests take "
    "single gross errors"
)
@pytest.mark.parametrize("name", SPOILT)
def test_rounds_decide_as_adjustments_anew_do(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same observations go in the same rounds; what is reported is the adjustment anew."""
    make, options = SPOILT[name]
    network = make()
    calls = counted(monkeypatch)
    found = snoop(network, **options)
    adjusted = calls.copy()
    calls.clear()
    for way in ("_take_out", "_withdraw"):
        monkeypatch.setattr(SnoopingSearch, way, lambda *_: False)
    expected = snoop(network, **options)
    assert len(found.rejected) > 3
    if name != "clusters and vectors":
        # One at the end of each series of rounds, one for what is put back between them.
        assert len(adjusted) <= 1 + 2 * sum(r.readmitted > 0 for r in found.rounds)
        assert len(calls) == sum(r.set_aside + r.readmitted > 0 for r in expected.rounds)
    assert found.reason == expected.reason
    assert found.readmitted == expected.readmitted
    assert found.solution.weights is None
    assert found.solution.redundancy == expected.solution.redundancy
    assert found.solution.vtpv == pytest.approx(expected.solution.vtpv, rel=1e-9)
    assert [(p.name, p.rays, p.round) for p in found.rejected_points] == [
        (p.name, p.rays, p.round) for p in expected.rejected_points
    ]
    assert [(r.id, r.round, r.component) for r in found.rejected] == [
        (r.id, r.round, r.component) for r in expected.rejected
    ]
    # The two rays of a point without others have equal test values, in any order.
    assert {u.id for u in found.unresolved} == {u.id for u in expected.unresolved}
    for a, b in zip(found.rejected, expected.rejected, strict=True):
        assert a.test == pytest.approx(b.test, abs=MAX_NEGLECTED_RESIDUAL)
        assert a.estimated_error == pytest.approx(b.estimated_error, rel=MAX_NEGLECTED_RESIDUAL)
        assert a.final_test == pytest.approx(b.final_test, rel=1e-6, nan_ok=True)
    for one, other in zip(found.rounds, expected.rounds, strict=True):
        assert (one.suspects, one.set_aside, one.readmitted) == (
            other.suspects,
            other.set_aside,
            other.readmitted,
        )
        assert one.sigma0 == pytest.approx(other.sigma0, rel=1e-5)
        assert one.largest == pytest.approx(other.largest, abs=MAX_NEGLECTED_RESIDUAL)
    np.testing.assert_allclose(found.reliability.w, expected.reliability.w, atol=1e-4)


def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list to which every adjustment anew of a search adds the name of its network."""
    calls: list[str] = []

    def adjusted(network: Network, **options: object) -> Solution:
        calls.append(network.name)
        return adjust(network, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("factorgraph_adj.quality.snooping_search.adjust", adjusted)
    return calls


def test_a_search_that_cannot_settle_begins_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the network cannot be adjusted without what went, every round adjusts it anew."""
    network, bad = trilateration(5, share=0.08)
    expected = snoop(network)

    def refused(self: SnoopingSearch) -> None:
        if self.present.unsettled:
            raise CannotSettle

    monkeypatch.setattr(SnoopingSearch, "_settle", refused)
    found = snoop(network)
    assert {r.id for r in found.rejected} == bad
    assert len(found.rounds) == len(expected.rounds)
    assert found.solution.vtpv == pytest.approx(expected.solution.vtpv, rel=1e-9)
