"""Arguments of another type are refused by a sentence that names the point, camera or record."""

import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens


def built() -> fga.Network:
    network = fga.Network("n")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B")
    return network


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda n: n.add_point("C", (0, 0, 0), fixed=True), "point 'C': fixed must be some of"),
        (lambda n: n.add_point("C", (0, 0, 0), sigma="x"), "point 'C': standard deviations must"),
        (lambda n: n.add_camera("c", BrownLens, {}), "camera 'c': lens must be a lens model"),
        (lambda n: n.add_camera("c", BrownLens(), {"c": "x"}), "camera 'c': values must be"),
        (lambda n: n.add_camera("c", BrownLens(), 5), "camera 'c': values must be"),
        (
            lambda n: n.add([fga.SlopeDistance("A", "B", 1.0, sigma=0.1)]),
            r"of a list: add\(\*observations\)",
        ),
        (lambda n: n.add("A"), "not as 'A'"),
        (lambda n: n.set_refraction(0.13), "refraction group: it is named by name, not by 0.13"),
        (lambda n: n.set_orientation(1, value=0.0), r"named by station and set, not by \(1, '1'\)"),
    ],
)
def test_refused(call, says):
    network = built()
    with pytest.raises(fga.InputError, match=says):
        call(network)
    assert list(network.points) == ["A", "B"]
    assert not network.cameras
    assert not network.observations


def test_all_wrong_records_at_once():
    with pytest.raises(fga.InputError) as error:
        built().add(fga.SlopeDistance("A", "B", 1.0, sigma=0.1), 3, "x")
    assert len(error.value.problems) == 2
