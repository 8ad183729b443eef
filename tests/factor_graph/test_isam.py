"""A network in iSAM2: the figures of the batch, stable keys, and nothing changed by an error."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.graph.user_factors import KeyOf, MakesFactor
from factorgraph_adj.observations import Correlated, SlopeDistance
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from tests.networks.building_site import site
from tests.networks.deformed_models import deformed_block
from tests.networks.odometry import odometry
from tests.networks.simulated import simulate_industry_block
from tests.networks.small_block import small_block
from tests.networks.three_frames import three_frames
from tests.support.arrivals import ids_of, items, split

PROMISE, AT_REST = 0.01, 1e-6


def site_network(seed: int = 3) -> fga.Network:
    described, readings, _ = site(seed)
    described.add(*readings)
    return described


def apart(isam: fga.Isam, solution: fga.Solution) -> tuple[float, float]:
    """Return the largest difference of coordinates and of covariances of points, relative to σ."""
    moved = scatter = 0.0
    state = isam.state
    table = solution.equations.unknowns["point"]
    for name, number in table.number.items():
        sigma = solution.standard_deviations(name)
        on = sigma > 0.0
        if table.offset[number] < 0 or not on.any():
            continue
        gap = state["point"][isam.keys.unknowns["point"].number[name]] - solution.point(name)
        moved = max(moved, float((np.abs(gap)[on] / sigma[on]).max()))
        both = isam.covariance("point", name) - solution.covariance(name)
        scaled = np.abs(both)[np.ix_(on, on)] / np.outer(sigma[on], sigma[on])
        scatter = max(scatter, float(scaled.max()))
    return moved, scatter


@pytest.mark.parametrize("make", [site_network, small_block])
def test_after_settling_it_is_the_batch(make) -> None:
    network = make()
    solution = fga.adjust(network, tolerance=1e-9)
    isam = fga.Isam(network)
    isam.settle()
    moved, scatter = apart(isam, solution)
    assert moved < AT_REST
    assert scatter < AT_REST


def test_an_observation_of_coordinates_enters_with_all_of_its_axes() -> None:
    """Control observed in x, y and z has a row in a block of its own for each axis."""
    network = simulate_aerial_block(1, image_points=200, points_per_photo=50).network
    solution = fga.adjust(network, tolerance=1e-9)
    isam = fga.Isam(network)
    isam.settle()
    assert 2 * isam.graph.error(isam.values) == pytest.approx(solution.vtpv, rel=1e-9)
    assert max(apart(isam, solution)) < AT_REST
    control = solution.equations.blocks[1]
    assert control.kind == "control" and len(set(control.ids)) == 4
    before = len(isam)
    isam.remove(control.ids[0])
    assert len(isam) == before - 1
    isam.settle()
    rest = fga.adjust(without(network, [control.ids[0]]), tolerance=1e-9)
    assert max(apart(isam, rest)) < AT_REST


def test_a_free_network_has_its_inner_constraints() -> None:
    network = without(site_network(), [])
    network.datum = "free"
    solution = fga.adjust(network, tolerance=1e-9)
    isam = fga.Isam(network)
    isam.settle()
    assert isam.graph.error(isam.values) == pytest.approx(0.5 * solution.vtpv, rel=1e-6)


def test_tests_are_those_of_the_batch() -> None:
    network = site_network()
    isam = fga.Isam(network)
    isam.settle()
    rel = fga.reliability(fga.adjust(network, tolerance=1e-9))
    some = list(network.observations)[::7]
    found = isam.test(some)
    for i, name in enumerate(some):
        row = int(rel.solution.equations.find([name])[0][0])
        own = int(found.rows[i][0])
        if len(found.rows[i]) > 1:
            continue
        assert found.redundancy_numbers[own] == pytest.approx(rel.redundancy_numbers[row], abs=1e-6)
        if rel.controlled[row]:
            assert found.w[own] == pytest.approx(rel.w[row], abs=1e-4)
            assert found.t2[i] == pytest.approx(rel.w[row] ** 2, abs=1e-3)


def test_observations_arrive_with_new_points_and_keys_stay() -> None:
    network = site_network()
    solution = fga.adjust(network, tolerance=1e-9)
    late = "T9"
    own = [i for i, o in network.observations.items() if late in o.names()]
    begun = without(network, own, points=[late])
    isam = fga.Isam(begun)
    before = {
        n: isam.keys.key("point", n)
        for n in begun.points
        if n[0] == "T" and not any(begun.points[n].fixed)
    }
    isam.new_factors()
    point = replace(network.points[late], coordinates=None)
    arriving = [replace(network.observations[i], id=i) for i in own]
    names = isam.add(arriving, points=[point])
    assert set(names) >= set(own)
    assert {n: isam.keys.key("point", n) for n in before} == before
    graph, values = isam.new_factors()
    assert graph.size() == len(names)
    assert isam.keys.key("point", late) in list(values.keys())
    assert isam.new_factors()[0].size() == 0
    moved, _ = apart(isam, solution)
    assert moved < PROMISE
    isam.settle()
    assert apart(isam, solution)[0] < AT_REST


def test_a_photo_arrives_with_its_rays() -> None:
    network = small_block()
    solution = fga.adjust(network, tolerance=1e-9)
    late = list(network.photos)[-1]
    isam = fga.Isam(without(network, [], photos=[late]))
    rays = [o for o in items(network) if getattr(o, "photo", None) == late]
    photo: Photo = network.photos[late]
    isam.add(rays, photos=[photo])
    isam.settle()
    assert apart(isam, solution)[0] < AT_REST


def test_an_outlier_is_found_by_the_update_and_taken_out_again() -> None:
    network = site_network()
    isam = fga.Isam(network)
    isam.settle()
    before = isam.covariance("point", "T8")
    ident, o = next((i, o) for i, o in network.observations.items() if o.kind == "slope_distance")
    wrong = replace(o, value=o.value + 0.05, id="wrong")
    names = isam.add(wrong)
    assert isam.test(names).suspects == ("wrong",)
    verdict = fga.IncrementalAdjustment(network).add(wrong).verdicts[0]
    (w,) = isam.test(names).w
    assert w == pytest.approx(float(verdict.w[0]), rel=1e-3)
    isam.remove("wrong")
    isam.settle()
    np.testing.assert_allclose(isam.covariance("point", "T8"), before, rtol=1e-6)
    assert ident in isam.names


def test_native_factors_go_straight_in() -> None:
    network = simulate_industry_block(seed=2).network
    isam = fga.Isam(network)
    distance = np.linalg.norm(
        np.subtract(*(isam.state["point"][isam.keys.unknowns["point"].number[n]] for n in PAIR))
    )
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.001)

    def tape(key: KeyOf) -> gtsam.NonlinearFactor:
        return gtsam.RangeFactor3(*(key("point", n) for n in PAIR), float(distance) + 0.02, noise)

    assert isam.add(factors={"tape": tape}) == ("tape",)
    assert isam.test("tape").suspects == ("tape",)
    batch = fga.reliability(fga.adjust(network, extra_factors={"tape": tape})).factor("tape")
    assert isam.test("tape").w[0] == pytest.approx(float(batch.w[0]), rel=0.01)


PAIR = ("P35", "P36")


def test_a_factor_whose_jacobian_has_the_wrong_sign_is_refused() -> None:
    network = site_network()
    isam = fga.Isam(network)
    first, second = [n for n, p in network.points.items() if not any(p.fixed)][:2]

    def tape(sign: float) -> MakesFactor:
        def make(key: KeyOf) -> gtsam.NonlinearFactor:
            keys = [key("point", first), key("point", second)]

            def error(_: object, values: gtsam.Values, jacobians: list | None) -> np.ndarray:
                a, b = (values.atPoint3(k) for k in keys)
                length = np.linalg.norm(b - a)
                if jacobians is not None:
                    jacobians[0] = sign * (a - b)[None] / length
                    jacobians[1] = (b - a)[None] / length
                return np.array([length - 10.0])

            return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, 1.0), keys, error)

        return make

    n = len(isam)
    with pytest.raises(InputError, match="the sign of its Jacobian is wrong"):
        isam.add(factors={"tape": tape(-1.0)})
    assert len(isam) == n
    assert isam.add(factors={"tape": tape(1.0)}) == ("tape",)


def test_what_it_has_goes_into_an_isam2_of_your_own() -> None:
    isam = fga.Isam(site_network())
    graph, values = isam.new_factors()
    own = gtsam.ISAM2()
    own.update(graph, values)
    key = isam.keys.key("point", "T8")
    there = own.calculateEstimate().atVector(key)
    assert np.linalg.norm(there - isam.values.atVector(key)) < 1e-3


def test_an_error_changes_nothing() -> None:
    isam = fga.Isam(site_network())
    names, here = isam.names, isam.values
    with pytest.raises(fga.InputError, match="nowhere"):
        isam.add(SlopeDistance("S0", "nowhere", 1.0, sigma=0.001))
    loose = [SlopeDistance("S0", "new", 12.0, sigma=0.001, id="d")]
    with pytest.raises(fga.AdjustmentError, match="not determined"):
        isam.add(loose, points=[Point("new", (1.0, 2.0, 3.0))])
    with pytest.raises(fga.InputError, match="is no factor here"):
        isam.remove("nothing")
    with pytest.raises(fga.AdjustmentError, match="not determined"):
        isam.remove([i for i in names if "T8" in i or i in ids_touching(isam, "T8")][1:])
    assert isam.names == names
    assert isam.values.equals(here, 0.0)
    assert "T8" in isam.network.points


def ids_touching(isam: fga.Isam, point: str) -> list[str]:
    return [
        i for o in items(isam.network) for i in ids_of(o) if point in getattr(o, "names", list)()
    ]


LATE = {
    "a scanner": (three_frames, "frame", "scan"),
    "a model of unknown scale": (three_frames, "frame", "model"),
    "a levelled station": (three_frames, "frame", "station"),
    "a deformation of models": (
        lambda: measure(deformed_block(), seed=2),
        "model_deformation",
        "left",
    ),
}


@pytest.mark.parametrize(("make", "kind", "name"), LATE.values(), ids=[*LATE])
def test_an_unknown_of_any_kind_arrives_with_its_observations(make, kind, name) -> None:
    network = make()
    first, later = split(network, kind, name)
    seen = {p for o in first.observations.values() for p in o.points()}
    seen |= {f.origin for f in first.frames.values() if f.origin in first.points}
    new = [first.points.pop(p) for p in list(first.points) if p not in seen]
    for point in new:
        del first.point_number[point.name]
    isam = fga.Isam(first)
    before = {p: isam.keys.key("point", p) for p in seen if not any(first.points[p].fixed)}
    isam.add(later, points=new, unknowns={kind: {name: network.of_kind(kind)[name]}})
    assert {p: isam.keys.key("point", p) for p in before} == before
    assert isam.keys.key(kind, name) in list(isam.values.keys())
    isam.settle()
    solution = fga.adjust(network, tolerance=1e-9)
    moved, scatter = apart(isam, solution)
    assert moved < AT_REST
    assert scatter < AT_REST
    q = solution.variable_covariance((kind, name))
    found = isam.covariance(kind, name)
    np.testing.assert_allclose(found, q, rtol=1e-5, atol=1e-6 * np.abs(q).max())


def test_unknowns_that_cannot_be_stated_are_refused_together() -> None:
    isam = fga.Isam(three_frames())
    scratch = fga.Network()
    scratch.add_frame("scan")
    scratch.add_frame("next")
    given = {"frame": {**scratch.frames, "odd": 1}, "fame": {"x": 1}}
    with pytest.raises(fga.InputError) as error:
        isam.add(points=[Point("P0", (0.0, 0.0, 0.0))], unknowns=given)
    for words in ("'P0'", "frame 'scan': is stated already", "'odd'", "did you mean 'frame'?"):
        assert words in str(error.value)
    with pytest.raises(fga.InputError, match="as the parameters of a scratch network"):
        isam.add(unknowns=scratch.frames)
    with pytest.raises(fga.ApproximationError, match="next"):
        isam.add(unknowns={"frame": {"next": scratch.frames["next"]}})
    assert "next" not in isam.network.frames


def test_what_observations_depend_on_already_is_not_stated_after_them() -> None:
    isam = fga.Isam(site_network())
    scratch = fga.Network()
    scratch.set_refraction(value=0.13, fixed=True)
    with pytest.raises(fga.InputError, match="depends on it: state it before"):
        isam.add(unknowns=scratch.parameters)


def test_what_was_removed_does_not_come_back_and_its_name_is_free() -> None:
    network = site_network()
    isam = fga.Isam(network)
    wrong = SlopeDistance("S0", "T8", 1.0, sigma=0.001, id="wrong")
    isam.add(wrong)
    isam.remove("wrong")
    o = next(o for o in network.observations.values() if o.kind == "slope_distance")
    assert isam.add(replace(o, id="again")) == ("again",)
    assert "wrong" not in isam.network.observations
    isam.add(replace(o, id="wrong"))
    whole = network.copy()
    whole.add(replace(o, id="again"), replace(o, id="wrong"))
    isam.settle()
    assert apart(isam, fga.adjust(whole, tolerance=1e-9))[0] < AT_REST


def test_a_point_without_factors_leaves_and_returns_with_new_readings() -> None:
    network = site_network()
    own = [i for i, o in network.observations.items() if "T9" in o.names()]
    isam = fga.Isam(network)
    key, size = isam.keys.key("point", "T9"), isam.values.size()
    last = isam.state["point"][isam.keys.unknowns["point"].number["T9"]]
    isam.remove(own)
    isam.settle()
    assert not isam.values.exists(key)
    np.testing.assert_array_equal(
        isam.state["point"][isam.keys.unknowns["point"].number["T9"]], last
    )
    with pytest.raises(fga.InputError, match="no factor depends on it"):
        isam.covariance("point", "T9")
    isam.add([replace(network.observations[i], id=i) for i in own])
    assert isam.values.size() == size and isam.keys.key("point", "T9") == key
    isam.settle()
    moved, scatter = apart(isam, fga.adjust(network, tolerance=1e-9))
    assert max(moved, scatter) < AT_REST


def test_a_partly_held_point_leaves_with_what_keeps_its_held_components() -> None:
    network = fga.Network("a plan")
    for name, x in {"A": (0, 0, 0), "B": (100, 0, 0), "C": (0, 80, 0)}.items():
        network.add_point(name, x, fixed="xyz")
    for name in "PQ":
        network.add_point(name, (60.0, 50.0, 0.0), fixed="z")
        network.add(
            *(SlopeDistance(s, name, 78.1, sigma=0.1, id=f"{s}{name}") for s in "AB"),
            SlopeDistance("C", name, 67.1, sigma=0.1, id=f"C{name}"),
        )
    isam = fga.Isam(network)
    kept = "held components of point Q"
    assert kept in isam.names
    isam.remove([f"{s}Q" for s in "ABC"])
    assert kept not in isam.names
    assert isam.values.size() == 1


def test_a_name_that_a_factor_has_is_refused() -> None:
    isam = fga.Isam(site_network())

    def prior(key: KeyOf) -> gtsam.NonlinearFactor:
        noise = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
        return gtsam.PriorFactorVector(key("point", "T8"), isam.state["point"][14], noise)

    isam.add(factors={"prior": prior})
    n = isam.graph.nrFactors()
    o = SlopeDistance("S0", "T8", 50.0, sigma=1.0, id="prior")
    for given in ({"factors": {"prior": prior}}, {"observations": o}):
        with pytest.raises(fga.InputError, match="'prior': is the name of another factor"):
            isam.add(**given)
    with pytest.raises(fga.InputError, match="'both': is the name of another factor"):
        isam.add(replace(o, id="both"), factors={"both": prior})
    assert isam.graph.nrFactors() == n


def test_each_solver_reads_from_its_own_moment() -> None:
    network = site_network()
    isam = fga.Isam(network)
    assert isam.n_arrivals == 1
    everything = isam.new_factors()[0].size()
    distance = next(o for o in network.observations.values() if o.kind == "slope_distance")
    isam.add(replace(distance, id="first"))
    isam.add([replace(distance, id="second"), replace(distance, id="third")])
    isam.remove("second")
    assert isam.new_factors(since=2)[0].size() == 1
    assert isam.new_factors(since=1)[0].size() == 2
    graph, values = isam.new_factors(since=0)
    assert graph.size() == everything + 2
    assert values.size() == isam.values.size()
    assert isam.new_factors()[0].size() == 0
    with pytest.raises(fga.InputError, match="between 0 and 3, not 4"):
        isam.new_factors(since=4)


def test_weights_follow_the_lengths_of_sights_after_an_arrival_too() -> None:
    centred = fga.StandardDeviation(1e-4, centring_target=0.002)
    network = fga.Network("short sights")
    true = {"A": (0.0, 0.0, 0.0), "B": (30.0, 0.0, 0.0), "C": (10.0, 25.0, 0.0)}
    p = np.array((12.0, 9.0, 0.0))
    for name, x in true.items():
        network.add_point(name, x, fixed="xyz")
    network.add_point("P", (18.0, 3.0, 0.0), fixed="z")
    for name, error in zip(true, (3e-4, -2e-4, 4e-4), strict=True):
        azimuth = float(np.arctan2(*(p - true[name])[:2])) + error
        network.add(fga.observations.Azimuth(name, "P", azimuth, sigma=centred, id=f"at {name}"))
    later = [SlopeDistance("A", "P", 15.0, sigma=10.0, id=f"paced {i}") for i in range(6)]
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(0.0)
    params.relinearizeSkip = 1
    isam = fga.Isam(network, params=params)
    for o in later:
        isam.add(o)
    isam.settle()
    network.add(*later)
    moved, scatter = apart(isam, fga.adjust(network, tolerance=1e-9))
    assert max(moved, scatter) < AT_REST


def test_what_is_not_determined_is_named_as_the_network_calls_it() -> None:
    """GTSAM has a symbol for it, such as p1."""
    network = fga.Network("one distance")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("bolt 7", (3.0, 0.0, 0.0))
    network.add(SlopeDistance("A", "bolt 7", 3.0, sigma=1e-3))
    with pytest.raises(fga.AdjustmentError, match="not determined, point 'bolt 7' or") as raised:
        fga.Isam(network)
    assert "p1" not in str(raised.value)


@pytest.mark.parametrize("beside", [0.0, 1e-20, -1e-20, 1e-3])
def test_a_covariance_that_is_diagonal_up_to_rounding_is_a_noise_model(beside: float) -> None:
    """GTSAM takes such a square root for a diagonal one, whose elements must not be negative."""
    network = fga.Network("vectors")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (1.0, 0.1, 0.0))
    covariance = np.diag([0.01, 0.02, 0.03]) + beside * (np.ones((3, 3)) - np.eye(3))
    network.add(fga.GnssVector("A", "B", (1.0, 0.0, 0.2), covariance=covariance))
    found = fga.Isam(network).covariance("point", "B")
    assert found == pytest.approx(covariance, rel=1e-9, abs=1e-15)


def test_it_begins_with_one_held_pose() -> None:
    """Poses arrive with their odometry; the end is that of the batch."""
    whole = measure(odometry(6, joint=True), seed=3)
    begin = fga.Network("first pose")
    begin.cameras |= whole.cameras
    held = next(name for name, photo in whole.photos.items() if all(photo.fixed))
    begin.photos[held] = whole.photos[held]
    isam = fga.Isam(begin)
    assert len(isam) == 0
    for item in items(whole):
        members = item.observations if isinstance(item, Correlated) else (item,)
        names = dict.fromkeys(n for o in members for n in o.photos())
        photos = [whole.photos[n] for n in names if n not in isam.network.photos]
        points = [whole.points[p] for o in members for p in o.points()]
        new = [p for p in points if p.name not in isam.network.points]
        isam.add(item, photos=photos, points=new)
    isam.settle()
    batch = fga.adjust(whole)
    for name in whole.photos:
        if name != held:
            expected = batch.pose_covariance(name)
            np.testing.assert_allclose(
                isam.covariance("pose", name), expected, atol=1e-4 * np.abs(expected).max()
            )
