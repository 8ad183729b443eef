"""Networks without some of their observations, and what is lost with them."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.observation_selection import weighted_unknowns, without
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    ControlPoint,
    Correlated,
    Direction,
    GnssVector,
    ImagePoint,
    SlopeDistance,
    VerticalAngle,
)
from factorgraph_adj.simulation.simulated_blocks import simulate_geocentric_block
from tests.networks.small_block import small_block
from tests.networks.three_frames import room, three_frames
from tests.support.same import contents


def scene() -> Network:
    """Return a network with one of everything that may be lost."""
    network = Network("scene")
    for i, name in enumerate("ABCD"):
        network.add_point(name, (10.0 * i, 3.0 * i * i, 0.1 * i))
    network.add_camera("cam", BrownLens(), {"c": 20.0})
    network.add_photo("f/1", "cam", position=(0.0, 0.0, 30.0), omega_phi_kappa=(0.0, 0.0, 0.0))
    network.add_photo("f", "cam", position=(5.0, 0.0, 30.0), omega_phi_kappa=(0.0, 0.0, 0.0))
    network.set_distance_meter("own", scale=0.0, free=("scale",))
    network.set_distance_meter("held", scale=1e-6)
    network.set_refraction("ray", value=0.13)
    network.set_vertical("B", xi=0.0, eta=0.0)
    network.set_vertical("C", xi=0.0, eta=0.0, sigma=1e-5)
    network.add(
        SlopeDistance("A", "D", 30.0, sigma=0.01, instrument="own", id="own distance"),
        SlopeDistance("A", "D", 30.0, sigma=0.01, instrument="held", id="held distance"),
        VerticalAngle("A", "D", 0.0, sigma=0.01, refraction="ray", id="angle"),
        SlopeDistance("A", "B", 10.0, sigma=0.01, id="at B"),
        SlopeDistance("A", "C", 20.0, sigma=0.01, id="at C"),
        Direction("A", "B", 0.0, sigma=0.01, id="one"),
        Direction("A", "C", 0.1, sigma=0.01, set="2", id="two"),
        Direction("A", "D", 0.2, sigma=0.01, set="2", id="three"),
        ImagePoint("f/1", "A", 1.0, 2.0, sigma=0.1),
        ImagePoint("f", "A", 3.0, 4.0, sigma=0.1, id="own name"),
        ImagePoint("f", "B", 5.0, 6.0, sigma=0.1, source="rays.csv line 3"),
        ImagePoint("f/1", "D", 7.0, 8.0, sigma=0.1, id="another name"),
    )
    return network


def test_a_copy_shares_nothing_that_can_change():
    network = scene()
    before = contents(network)
    copy = network.copy()
    assert contents(copy) == before
    copy.add_point("new", (0.0, 0.0, 0.0))
    copy.add(SlopeDistance("A", "new", 1.0, sigma=0.1), ImagePoint("f", "new", 0, 0, sigma=1.0))
    copy.set_refraction(value=0.2)
    copy.clusters.append(((), np.zeros((0, 0))))
    del copy.points["B"]
    assert contents(network) == before
    assert copy.observations["one"] is network.observations["one"]


def test_taking_out_observations_leaves_the_network_as_it_was():
    network = scene()
    before = contents(network)
    less = without(network, ["at B", "f/1/A", "own name"])
    assert contents(network) == before
    assert "at B" not in less.observations
    assert less.n_image_points == 2
    assert len(less.observations) == len(network.observations) - 1


def test_image_points_go_by_photo_and_point_or_by_their_own_id():
    """Names with a slash are read in every way that makes sense; ids and sources stay in place."""
    network = scene()
    for ident in ("f/1/A", "own name", "f/A", "f/B", "another name", "f/1/D"):
        assert without(network, [ident]).n_image_points == 3
    less = without(network, ["f/1/A", "own name"])
    left = list(less.image_points())
    assert [(o.photo, o.point, o.x) for o in left] == [("f", "B", 5.0), ("f/1", "D", 7.0)]
    assert [(o.id, o.source) for o in left] == [(None, "rays.csv line 3"), ("another name", None)]


def test_unknown_ids_are_named_all_at_once():
    with pytest.raises(InputError) as error:
        without(scene(), ["at B", "no", "f/1/Z", "point A x"], points=["nowhere"])
    where = [p.where for p in error.value.problems]
    assert where == [
        "point 'nowhere'",
        "observation 'no'",
        "observation 'f/1/Z'",
        "observation 'point A x'",
    ]
    assert "own distance" in str(error.value)
    assert "photo/point" in str(error.value)


def test_an_id_that_means_two_observations_is_refused():
    network = scene()
    network.add(SlopeDistance("B", "C", 10.0, sigma=0.1, id="f/1/A"))
    with pytest.raises(InputError, match="both an image point and another observation"):
        without(network, ["f/1/A"])


def test_free_unknowns_go_with_their_last_observation_and_others_stay():
    network = scene()
    assert set(without(network, ["two"]).orientations) == {("A", "1"), ("A", "2")}
    assert set(without(network, ["two", "three"]).orientations) == {("A", "1")}
    less = without(network, ["own distance", "held distance", "angle", "at B", "at C"])
    assert set(less.distance_meters) == {"held"}
    assert less.refractions == {}
    # The direction to B leans on its vertical still; that of C is weighted, not free.
    assert set(less.verticals) == {"B", "C"}
    assert set(without(network, ["at B", "one"]).verticals) == {"C"}


def test_a_correlated_group_keeps_the_covariance_of_those_that_stay():
    network = scene()
    rng = np.random.default_rng(5)
    root = rng.normal(size=(8, 8))
    covariance = root @ root.T + np.eye(8)
    own = {"covariance": np.eye(3)}
    group = (
        GnssVector("A", "B", (1.0, 2.0, 3.0), **own, id="v1"),
        ControlPoint("D", (0.0, 0.0), axes="xz", sigma=(1.0, 1.0), id="c"),
        GnssVector("A", "C", (1.0, 2.0, 3.0), **own, id="v2"),
    )
    network.add(Correlated(group, covariance))
    ((ids, left),) = without(network, ["c"]).clusters
    assert ids == ("v1", "v2")
    rows = [0, 1, 2, 5, 6, 7]
    np.testing.assert_array_equal(left, covariance[np.ix_(rows, rows)])
    ((ids, left),) = without(network, ["v2", "v1"]).clusters
    assert ids == ("c",)
    np.testing.assert_array_equal(left, covariance[3:5, 3:5])
    assert without(network, ["v1", "v2", "c"]).clusters == []
    assert network.clusters[0][1].shape == (8, 8)


def test_points_go_with_everything_that_touches_them():
    network = scene()
    less = without(network, ["f/1/D"], points=["A"])
    assert set(less.points) == {"B", "C", "D"}
    assert [(o.photo, o.point) for o in less.image_points()] == [("f", "B")]
    assert less.observations == {}
    assert less.orientations == {}
    # Numbers of points have moved up: what is added goes to the right ones.
    less.add(ImagePoint("f", "D", 9.0, 9.0, sigma=0.1))
    assert [o.point for o in less.image_points()] == ["B", "D"]


def test_a_weighted_unknown_becomes_free():
    network = small_block()
    network.add_photo(
        "G",
        "D3",
        position=(0.0, 0.0, 9.0),
        omega_phi_kappa=(0.0, 0.0, 0.0),
        sigma_position=0.1,
        sigma_attitude=0.01,
    )
    network.set_orientation("S1", value=0.7, sigma=0.1)
    ids = weighted_unknowns(network)
    assert ids == {
        "point S2 y": ("point", "S2", 1),
        "point S2 z": ("point", "S2", 2),
        "orientation S1/1 orientation": ("orientation", "S1/1", 0),
        "photo G attitude": ("pose", "G", -1),
        "photo G position x": ("pose", "G", 0),
        "photo G position y": ("pose", "G", 1),
        "photo G position z": ("pose", "G", 2),
        "calibration D3 k2": ("calibration", "D3", BrownLens().names.index("k2")),
    }
    compiled = {i for b in compile_network(network).blocks for i in b.ids}
    assert ids.keys() <= compiled
    for ident in ids:
        less = compile_network(without(network, [ident]))
        assert ident not in {i for b in less.blocks for i in b.ids}
        assert less.unknowns.n_unknowns == compile_network(network).unknowns.n_unknowns
    without_y = without(network, ["point S2 y"])
    assert without_y.points["S2"].sigma == (np.inf, np.inf, 0.001)
    assert network.points["S2"].sigma == (np.inf, 0.001, 0.001)
    assert weighted_unknowns(without(network, list(ids))) == {}


def test_the_weight_of_a_calibration_for_each_photo_cannot_go_for_one():
    network = Network()
    network.add_camera("cam", BrownLens(), {"c": 20.0}, sigma={"c": 0.1}, per_photo=True)
    network.add_photo("f", "cam")
    with pytest.raises(InputError, match="hold for all its photos"):
        without(network, ["calibration cam@f c"])


def test_adjusting_without_is_adjusting_what_never_had_them():
    """The order of what is left, its weights and its unknowns are those of the network itself."""
    network = simulate_geocentric_block(3).network
    ids = [i for k, i in enumerate(network.observations) if k % 97 == 0]
    less = without(network, [*ids, "photo 01/T01", network.clusters[0][0][0]])
    other = deepcopy(network)
    for i in [*ids, network.clusters[0][0][0]]:
        del other.observations[i]
    ((pair, covariance),) = network.clusters
    other.clusters = [((pair[1],), covariance[3:, 3:])]
    names = [f"{o.photo}/{o.point}" for o in network.image_points()]
    other.image_mask(np.array([n != "photo 01/T01" for n in names]))
    a, b = adjust(less), adjust(other)
    assert a.vtpv == b.vtpv
    np.testing.assert_array_equal(a.observations.residuals, b.observations.residuals)


def test_without_the_point_at_the_origin_of_a_frame_what_was_measured_in_the_frame_goes_too():
    network = three_frames()
    left = without(network, [], points="T")
    assert list(left.frames) == ["scan", "model"]
    assert {o.frame for o in left.observations.values()} == {"scan", "model"}
    assert adjust(left).redundancy == adjust(network).redundancy - 3 * len(room()) + 1 + 3
