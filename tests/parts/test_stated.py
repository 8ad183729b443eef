"""Parts that state the same thing twice or in different ways: wrong numbers must not pass."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownForwardLens, Lens, NormalisedLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, HeightDifference, SlopeDistance, ZenithAngle
from factorgraph_adj.parts.part_files import RunFolder
from factorgraph_adj.parts.whole_network import cut_network
from factorgraph_adj.rotation import exp_rotation
from tests.networks.small_block import small_block

pytestmark = pytest.mark.slow(
    "what parts state differently in files of whole runs; short tests run two parts by the command"
)


def part_of(name: str, network: Network) -> fga.Part:
    return fga.Part(name, partial(Network.copy, network))


def adjusted(*networks: Network) -> fga.PartsSolution:
    return fga.adjust_parts([part_of(str(i), network) for i, network in enumerate(networks)])


def refused(*networks: Network) -> str:
    with pytest.raises(fga.InputError) as error:
        adjusted(*networks)
    return str(error.value)


def line(dh: float, sigma: tuple[float, float, float] | None = None) -> Network:
    """Return a measured line from a fixed point A to B."""
    network = Network("line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (10.0, 0.0, 1.0), fixed="" if sigma else "xy", sigma=sigma)
    network.add(
        HeightDifference("A", "B", dh, sigma=0.01), SlopeDistance("A", "B", 9 + dh, sigma=0.01)
    )
    return network


# -- twice ----------------------------------------------------------------------------------------


def test_the_same_observation_in_two_parts_is_reported():
    # Ids run from 1 in every project, so that they do not tell one observation from another.
    one, other = line(1.01), line(1.02)
    found = adjusted(one, other)
    assert (found.n_observations, found.repeated) == (4, ())
    other.add(HeightDifference("A", "B", 1.01, sigma=0.01, id="another"))
    assert [part for part, _ in adjusted(one, other).repeated] == ["0", "1"]
    assert len(adjusted(one, one).repeated) == 4
    # A difference of heights of instrument makes another observation.
    a, b = line(1.01), line(1.02)
    for network, height in ((a, 1.5), (b, 1.6)):
        network.add(
            SlopeDistance("A", "B", 10.1, sigma=0.01, instrument_height=height, target_height=1.5)
        )
    assert adjusted(a, b).repeated == ()


def test_the_same_control_in_two_parts_is_reported():
    networks = [line(1.01), line(1.02)]
    for network in networks:
        network.add(ControlPoint("B", (1.005,), axes="z", sigma=(0.01,)))
    assert [label[:9] for _, label in adjusted(*networks).repeated] == ["control B"] * 2
    again = line(1.03)
    again.add(ControlPoint("B", (1.005,), axes="y", sigma=(0.01,)))
    assert adjusted(networks[0], again).repeated == ()


def test_a_photo_that_measures_a_point_in_two_parts_is_refused():
    one = small_block()
    other = one.copy()
    keep = np.zeros(one.n_image_points, dtype=bool)
    keep[0] = True
    other.image_mask(keep)
    other.images.xy[0][:] = 0.5  # other coordinates: a photo measures a point once all the same
    photo, point = other.images.columns()[:2]
    names = list(other.photos)[photo[0]], list(other.points)[point[0]]
    assert f"image {names[0]} {names[1]}" in refused(one, other)


# -- cameras --------------------------------------------------------------------------------------


def photos(lens: Lens, k3: float = 0.0, unit: str = "mm") -> Network:
    """Return a block of photos with another lens."""
    network = small_block()
    ((name, old),) = network.cameras.items()
    del network.cameras[name]
    network.add_camera(name, lens, {"c": old.values[0], "k3": k3}, free=("c",), unit=unit)
    return network


@pytest.mark.parametrize(
    ("one", "other", "what"),
    [
        (
            photos(BrownForwardLens()),
            photos(NormalisedLens()),
            "it has BrownForwardLens.* and Norm",
        ),
        (
            photos(BrownForwardLens()),
            photos(BrownForwardLens(), unit="px"),
            "in mm in one and .*px",
        ),
        (photos(BrownForwardLens(), 1e-12), photos(BrownForwardLens(), 2e-12), "different values"),
    ],
)
def test_cameras_of_one_name_that_differ_are_refused(one, other, what):
    with pytest.raises(fga.InputError, match=rf"calibration of camera '\w+': .*{what}"):
        adjusted(one, other)


def test_a_photo_with_another_calibration_is_refused():
    one = small_block()
    (name,) = one.cameras
    other = one.copy()
    other.cameras[name] = replace(other.cameras[name], per_photo=True)
    text = refused(one, other)
    for photo in one.photos:
        assert f"photo {photo!r}: it has calibration {name!r} in one" in text
        assert f"calibration '{name}@{photo}' in the other" in text


def test_an_attitude_that_is_held_in_part_is_the_same_in_all_parts():
    one, other = small_block(), small_block()
    (photo, *_) = one.photos
    for network, turn in ((one, 0.0), (other, 1e-3)):
        f = network.photos[photo]
        rotation = f.rotation @ exp_rotation(np.array([[turn, 0.0, 0.0]]))[0]
        network.photos[photo] = replace(f, rotation=rotation, fixed=(True, *[False] * 5))
    assert f"photo {photo!r}: it is held at different values" in refused(one, other)


# -- weights --------------------------------------------------------------------------------------


def test_weighted_values_are_compared_where_they_are_weighted():
    sigma = (0.01, 0.01, np.inf)
    one, other = line(1.01, sigma), line(1.02, sigma)
    x = other.points["B"]
    for height in (1.3, np.nan):
        other.points["B"] = replace(x, coordinates=(10.0, 0.0, height))
        assert adjusted(one, other).n_observations == 6
    other.points["B"] = replace(x, coordinates=(10.001, 0.0, 1.0))
    assert "point 'B': its weighted values" in refused(one, other)


# -- defaults -------------------------------------------------------------------------------------


def test_a_part_without_zenith_angles_says_nothing_of_their_refraction():
    one, other = line(1.01), line(1.02)
    one.add(*[ZenithAngle("A", "B", 1.47 + d, sigma=0.001) for d in (0.0, 0.001)])
    one.set_refraction(value=0.2, fixed=True)
    assert adjusted(one, other).unknown("refraction", "").values[0] == 0.2
    assert adjusted(other, one).unknown("refraction", "").values[0] == 0.2
    other.add(ZenithAngle("A", "B", 1.471, sigma=0.001))
    assert "refraction group '': it is held at different values" in refused(one, other)


def test_a_region_with_weighted_unknowns_but_without_observations_is_no_part(tmp_path):
    network = line(1.01, (0.01, 0.01, 0.01))
    found = cut_network(network, {"A": "west", "B": "east"}, RunFolder(tmp_path))
    assert [part.name for part in found] == ["west"]
    assert fga.adjust_parts(found).n_observations == fga.adjust(network).equations.n_rows


def test_observations_between_held_points_go_to_a_part_with_unknowns(tmp_path):
    network = line(1.01)
    for name in "CD":
        network.add_point(name, (0.0, 9.0, 0.0), fixed="xyz")
    network.add(HeightDifference("C", "D", 0.01, sigma=0.01))
    regions = {"A": "west", "B": "west", "C": "east", "D": "east"}
    found = fga.adjust_parts(cut_network(network, regions, RunFolder(tmp_path)))
    assert (found.n_observations, len(found.jobs)) == (3, 1)
