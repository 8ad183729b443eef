"""Sights before any station: coordinates beside the readings, or the user, give the station."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.accuracies import DEFAULT_ACCURACIES
from factorgraph_adj.io.field_books.field_book import FieldBook
from factorgraph_adj.io.source import Source

TARGETS = {"1": (30.0, 5.0, 2.0), "2": (-12.0, 40.0, 1.0), "3": (8.0, -25.0, 0.5)}
MM = 1e-3


def sights(
    book: FieldBook, axis: tuple[float, float, float], orientation: float, line: int, **given
) -> None:
    """Read all targets from a tilting axis, with coordinates beside that are rounded to mm."""
    for i, (name, xyz) in enumerate({**TARGETS, **given}.items()):
        e, n, u = np.subtract(xyz, axis) + np.array([0.0, 0.0, 1.3])
        place = tuple(float(v) for v in np.round(xyz, 3))
        book.sight(
            line + i,
            name,
            direction=(math.atan2(e, n) - orientation) % (2 * math.pi),
            zenith=math.atan2(math.hypot(e, n), u),
            distance=math.hypot(e, n, u),
            target_height=1.3,
            coordinates=place,
        )


def new_book(**options) -> FieldBook:
    return FieldBook(Source("a.raw"), DEFAULT_ACCURACIES, may_lack_station=True, **options)


def test_coordinates_beside_readings_give_the_station_and_the_height_of_the_axis():
    book = new_book()
    sights(book, (3.0, 4.0, 10.0), 1.1, 1)
    network = book.network()
    assert np.allclose(network.points["station"].coordinates, (3.0, 4.0, 10.0), atol=MM)
    (said,) = network.remarks
    assert said.startswith(
        "no record states the station of 3 sights from a.raw:1: coordinates beside 3 of them give "
        "'station' at 3.000 4.000 m, and differ by 0.000"
    )
    assert said.endswith("tilting axis; station=NAME (--set station=NAME) names it")


@pytest.mark.parametrize("how", ["height of the point", "height of the instrument"])
def test_a_point_of_the_file_is_the_station_and_the_height_of_the_instrument_follows(how):
    book = new_book()
    if how == "height of the instrument":
        book.point(1, "P", 3.0, 4.0)
        book.set_height(2, 1.55)
    sights(book, (3.0, 4.0, 10.0), 1.1, 2)
    if how == "height of the point":
        book.point(9, "P", 3.0, 4.0, 8.45)
    network = book.network()
    assert set(network.points) == {"P", "1", "2", "3"}
    assert np.allclose(network.points["P"].coordinates, (3.0, 4.0, 8.45), atol=MM)
    for o in network.observations.values():
        assert o.station == "P" and o.instrument_height == pytest.approx(1.55, abs=MM)
    solution = fga.adjust(network)
    for name, xyz in TARGETS.items():
        between = np.subtract(solution.point(name), solution.point("P"))
        assert np.linalg.norm(between) == pytest.approx(math.dist(xyz, (3.0, 4.0, 8.45)), abs=MM)


def test_set_ups_end_where_readings_and_coordinates_disagree():
    book = new_book()
    sights(book, (3.0, 4.0, 10.0), 1.1, 1)
    sights(book, (50.0, -4.0, 11.0), 0.2, 4)
    book.begin(8, "K", 1.5)
    book.sight(9, "1", direction=0.5, zenith=1.5, distance=20.0)
    network = book.network()
    assert np.allclose(network.points["station"].coordinates, (3.0, 4.0, 10.0), atol=MM)
    assert np.allclose(network.points["station_2"].coordinates, (50.0, -4.0, 11.0), atol=MM)
    directions = [o.station for o in network.observations.values() if o.kind == "direction"]
    assert directions == ["station"] * 3 + ["station_2"] * 3 + ["K"]


def test_sights_that_no_coordinates_place_are_left_out_and_counted():
    book = new_book()
    sights(book, (3.0, 4.0, 10.0), 1.1, 1)
    book.sight(4, "9", direction=1.0, zenith=1.5, distance=90.0, coordinates=(0.0, 0.0, 0.0))
    book.begin(5, "K", 1.5)
    book.sight(6, "1", direction=0.5, zenith=1.5, distance=20.0)
    network = book.network()
    assert "9" not in network.points
    (left,) = network.left_out
    assert str(left) == ("sights: 1 left out, as no station is known for them: 9; first in a.raw:4")


def without_coordinates(*, later: float = 20.0, **options) -> FieldBook:
    book = new_book(**options)
    for line, distance in ((1, 20.0), (2, later)):
        book.sight(line, "1", direction=0.5, zenith=1.5, distance=distance)
    return book


def test_sights_of_a_file_without_any_station_are_one_set_up_if_nothing_contradicts():
    network = without_coordinates().network()
    assert set(network.points) == {"1", "station"}
    assert network.remarks == [
        "no record states the station of 2 sights from a.raw:1: they are one set-up, whose station "
        "is called 'station'; station=NAME (--set station=NAME) names it"
    ]
    with pytest.raises(InputError) as caught:
        without_coordinates(later=25.0).network()
    assert str(caught.value) == (
        "a.raw:1: 2 sights from here have no station, and more than one: line 2 has other readings "
        "of '1'; give station=NAME (--set station=NAME) if all are from one point"
    )
    book = without_coordinates()
    book.begin(3, "K")
    with pytest.raises(InputError, match="2 sights from here have no station; give station=NAME"):
        book.network()


def test_the_user_names_the_station():
    for later in (20.0, 25.0):
        network = without_coordinates(later=later, station="S").network()
        assert set(network.points) == {"1", "S"} and not network.remarks
    book = new_book(station="S")
    sights(book, (3.0, 4.0, 10.0), 1.1, 1)
    network = book.network()
    assert np.allclose(network.points["S"].coordinates, (3.0, 4.0, 10.0), atol=MM)
    assert "names it" not in network.remarks[0]


def test_both_faces_give_one_station():
    book = new_book()
    sights(book, (3.0, 4.0, 10.0), 1.1, 1)
    s = book.unnamed.sights[0]
    two = {**s.readings, "direction": s.readings["direction"] + math.pi}
    two["zenith"] = 2 * math.pi - s.readings["zenith"]
    book.unnamed.add(9, s.target, s.coordinates, **two)
    network = book.network()
    assert "beside 4 of them" in network.remarks[0]
    assert [o.kind for o in network.observations.values()].count("direction") == 3
