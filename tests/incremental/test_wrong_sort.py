"""What is of the wrong sort in a command is named, and nothing changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import SlopeDistance

DISTANCE = SlopeDistance("A", "B", 10.0, sigma=0.002)


@pytest.fixture
def inc() -> fga.IncrementalAdjustment:
    network = fga.Network("two points")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (10, 0, 0), fixed="yz")
    out = fga.IncrementalAdjustment(network)
    out.add([SlopeDistance("A", "B", 10.0, sigma=0.002, id=f"d{i}") for i in range(2)])
    return out


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda i: i.add([3, "x"]), "3: is no observation.*\n'x': is no observation"),
        (lambda i: i.add(None), "None: is no observation"),
        (lambda i: i.add(points=["N7"]), "'N7': is no fga.Point"),
        (lambda i: i.add(photos="1"), "'1': is no fga.Photo"),
        (lambda i: i.add(cameras=[DISTANCE]), "is no fga.Camera"),
        (lambda i: i.remove(None), "None: is no id: an id is a text"),
        (lambda i: i.remove(["d0", 1, 2]), "1: is no id: an id is a text\n2: is no id"),
        (lambda i: i.remove("D0"), "'D0': unknown observation; did you mean 'd0'"),
        (lambda i: i.replace("d", DISTANCE), "'d': unknown observation; did you mean 'd1'"),
        (lambda i: i.replace("d0", [DISTANCE]), "is no single observation"),
        (lambda i: i.replace(None, DISTANCE), "None: is no id"),
        (lambda i: i.reweight("d0", "2"), "between 1e-12 and 1e.12, not '2'"),
        (lambda i: i.observation("D1"), "unknown observation; did you mean 'd1'"),
        (
            lambda i: i.add(SlopeDistance("A", "B", 10.0, sigma=0.002, id="d0")),
            r"duplicate id 'd0': there is an observation with this id already",
        ),
        (
            lambda i: i.add(SlopeDistance("a", "B", 10.0, sigma=0.002)),
            "slope_distance a B: unknown point 'a'; known: A, B; did you mean 'A'",
        ),
        (lambda i: i.estimate("b"), "unknown point 'b'; known: A, B; did you mean 'B'"),
        (lambda i: i.pose("b"), "unknown photo 'b'; known: none"),
    ],
)
def test_wrong_sorts_are_named(
    inc: fga.IncrementalAdjustment, call: Callable[[Any], object], message: str
) -> None:
    before = repr(inc)
    with pytest.raises(fga.InputError, match=message):
        call(inc)
    assert repr(inc) == before


@pytest.mark.parametrize("what", ["net", None, 3])
def test_only_a_network_is_adjusted(what: Any) -> None:
    with pytest.raises(fga.InputError, match=r"is no fga\.Network"):
        fga.IncrementalAdjustment(what)


@pytest.mark.parametrize("options", [{"alpha": "a"}, {"accuracy": None}])
def test_options_that_are_no_numbers_are_named(options: dict[str, Any]) -> None:
    with pytest.raises(fga.InputError, match=f"{next(iter(options))} must be"):
        fga.IncrementalAdjustment(fga.Network("empty"), **options)


def test_points_are_as_a_network_takes_them(inc: fga.IncrementalAdjustment, tmp_path: Any) -> None:
    """Fields of a `Point` may be as those of `add_point`; the journal has them in full."""
    path = tmp_path / "day.jsonl"
    with_journal = fga.IncrementalAdjustment(inc.network(), journal=path)
    loose: Any = fga.Point("C", (1, 2, 3), fixed="xy")  # type: ignore[arg-type]
    with pytest.raises(fga.InputError, match="point 'C'"):
        with_journal.add(points=[fga.Point("C", (1, 2))])  # type: ignore[arg-type]
    with_journal.add(points=loose)
    there = with_journal.described.points["C"]
    assert there.fixed == (True, True, False)
    del with_journal
    assert fga.IncrementalAdjustment.resume(path).described.points["C"] == there


def test_a_photo_without_image_points_says_what_it_lacks() -> None:
    network = fga.Network("one photo")
    network.add_camera("cam", NoDistortion(), {"c": 50.0})
    network.add_photo("1", "cam")
    inc = fga.IncrementalAdjustment(network)
    with pytest.raises(fga.InputError, match="photo '1': is not determined: no observation has"):
        inc.pose("1")


def ambiguous(path: Any = None) -> fga.IncrementalAdjustment:
    """Return three distances to a point, which two positions fit."""
    network = fga.Network("two positions")
    for name, at in {"A": (0, 0, 0), "B": (10, 0, 0), "C": (0, 10, 0)}.items():
        network.add_point(name, at, fixed="xyz")
    network.add_point("P")
    inc = fga.IncrementalAdjustment(network, journal=path)
    d = {"A": 27.0**0.5, "B": 67.0**0.5, "C": 67.0**0.5}
    inc.add([SlopeDistance(n, "P", d[n], sigma=0.001, id=n) for n in d])
    return inc


@pytest.mark.parametrize("z", [4.0, -4.0])
def test_a_point_with_two_positions_takes_approximate_coordinates(z: float, tmp_path: Any) -> None:
    path = tmp_path / "day.jsonl"
    inc = ambiguous(path)
    assert inc.n_waiting == 3
    assert "give approximate coordinates" in inc.waiting[0].lacks
    arrival = inc.add(points=fga.Point("P", (1.0, 2.0, z)))
    assert [v.verdict for v in arrival.verdicts] == ["accepted"] * 3
    at = inc.estimate("P")
    assert at == pytest.approx((0.5 * (27 + 100 - 67) / 10,) * 2 + (z / 4 * 9**0.5,), abs=1e-6)
    del inc
    assert fga.IncrementalAdjustment.resume(path).estimate("P") == pytest.approx(at, abs=1e-9)


@pytest.mark.parametrize(
    "point",
    [
        fga.Point("P", (1.0, 2.0, 4.0), fixed=(True, True, True)),
        fga.Point("P", (1.0, 2.0, 4.0), sigma=(1.0, 1.0, 1.0)),
        fga.Point("P", (1.0, 2.0, float("nan"))),
        fga.Point("A", (1.0, 2.0, 4.0)),
    ],
)
def test_what_is_given_of_a_point_does_not_change(point: fga.Point) -> None:
    inc = ambiguous()
    with pytest.raises(fga.InputError, match="duplicate name of a point"):
        inc.add(points=point)
    assert inc.n_waiting == 3
