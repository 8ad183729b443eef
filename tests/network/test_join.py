"""Several networks of one object as one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Correlated
from tests.support.same import assert_same_network

PLACES = {"A": (0, 0, 100), "B": (120, 10, 103), "C": (60, 110, 99), "P": (45, 50, 101)}
SIGHTS = [(a, b) for a in "APB" for b in "ABCP" if a != b]


def surveyed(sights: list[tuple[str, str]], *, held: str = "ABC", seed: int = 5) -> Network:
    """Return a network of directions, zenith angles and distances; the first sees the noise."""
    network = fga.Network("book", datum="given" if held else "free")
    names = dict.fromkeys(n for sight in sights for n in sight)
    for name in names:
        network.add_point(name, PLACES[name], fixed="xyz" if name in held else "")
    for a, b in sights:
        rng = np.random.default_rng([seed, ord(a), ord(b)])
        d = np.subtract(PLACES[b], PLACES[a]).astype(float)
        s, across = float(np.linalg.norm(d)), float(np.hypot(*d[:2]))
        e = rng.normal(size=3) * (1e-5, 1e-5, 1e-3)
        reading = (np.arctan2(d[0], d[1]) + ord(a) + e[0]) % (2 * np.pi)
        network.add(fga.Direction(a, b, float(reading), sigma=1e-5))
        network.add(fga.ZenithAngle(a, b, float(np.arctan2(across, d[2]) + e[1]), sigma=1e-5))
        network.add(fga.SlopeDistance(a, b, s + float(e[2]), sigma=1e-3))
    return network


def levelled() -> Network:
    """Return a network of heights, with every point held in plan at 0 as field books have it."""
    network = fga.Network("level")
    for name in "APB":
        network.add_point(name, (0, 0, PLACES[name][2]), fixed="xyz" if name == "A" else "xy")
    network.add(fga.HeightDifference("A", "P", 1.0004, sigma=3e-4))
    network.add(fga.HeightDifference("P", "B", 1.9995, sigma=3e-4))
    return network


def test_parts_of_a_network_joined_are_the_network() -> None:
    """Each station in one book: points, observations and their ids are those of the whole."""
    whole = surveyed(SIGHTS)
    parts = [surveyed([s for s in SIGHTS if s[0] == a]) for a in "APB"]
    found = fga.join(parts, name="book")
    assert_same_network(found, whole)
    one, two = fga.adjust(found), fga.adjust(whole)
    assert one.vtpv == pytest.approx(two.vtpv, rel=1e-12)
    np.testing.assert_allclose(one.point("P"), two.point("P"), rtol=0, atol=1e-12)


def test_the_same_station_in_two_books_is_two_set_ups() -> None:
    """The circle was turned between: with one orientation nothing would fit."""
    from_p = [s for s in SIGHTS if s[0] == "P"]
    first, second = surveyed(from_p), surveyed(from_p, seed=6)
    for i, o in second.observations.items():
        if o.kind == "direction":
            second.observations[i] = replace(o, value=(o.value + 1.0) % (2 * np.pi))
    found = fga.join([first, second])
    assert list(found.orientations) == [("P", "1"), ("P", "2")]
    solution = fga.adjust(found)
    assert solution.redundancy == 2 * 9 - 3 - 2
    assert 0.5 < solution.sigma0 < 1.6
    turned = solution.orientation("P", "1").values[0] - solution.orientation("P", "2").values[0]
    assert (float(turned) % (2 * np.pi)) == pytest.approx(1.0, abs=3e-5)
    same = fga.join([first, second], sets="same")
    assert list(same.orientations) == [("P", "1")]
    assert fga.adjust(same).sigma0 > 1000


def test_errors_of_circles_belong_to_their_set_up() -> None:
    gon = np.pi / 200
    books = []
    for _ in range(2):
        book = surveyed([s for s in SIGHTS if s[0] == "P"])
        readings = [
            fga.FaceReading(station="P", target="A", face=f, direction=d * gon, zenith=z * gon)
            for f, d, z in ((1, 10.0, 99.0), (2, 210.002, 301.004))
        ]
        found = fga.reduce_faces(
            readings, sigma_direction=1e-5, sigma_zenith=1e-5, sigma_distance=1e-3, faces="both"
        )
        found.add_to(book)
        books.append(book)
    joined = fga.join(books)
    assert list(joined.of_kind("index_error")) == ["P/1", "P/2"]
    named = {o.index_error for o in joined.observations.values() if o.kind == "zenith_angle"}
    assert named == {None, "P/1", "P/2"}


def test_a_levelled_line_joins_without_its_plan() -> None:
    """The level book holds x = y = 0 of every point; the total station knows better."""
    book, level = surveyed(SIGHTS), levelled()
    for networks in ([book, level], [level, book]):
        found = fga.join(networks)
        assert found.points["P"].held == "" and found.points["A"].held == "xyz"
        np.testing.assert_array_equal(found.points["B"].coordinates, PLACES["B"])
        solution = fga.adjust(found)
        whole = surveyed(SIGHTS)
        for o in level.observations.values():
            whole.add(o)
        expected = fga.adjust(whole)
        np.testing.assert_allclose(solution.point("P"), expected.point("P"), atol=1e-9)
        assert solution.vtpv == pytest.approx(expected.vtpv, rel=1e-9)


def test_correlated_groups_and_doubts_follow_their_ids() -> None:
    first, second = surveyed(SIGHTS[:3]), surveyed(SIGHTS[:3])
    pair = tuple(fga.HeightDifference("A", b, 1.0, sigma=1e-3, id=f"h{b}") for b in "BP")
    for network in (first, second):
        network.add(Correlated(pair, 1e-6 * np.array([[1.0, 0.5], [0.5, 1.0]])))
    second.name = "second"
    found = fga.join([first, second])
    assert [ids for ids, _ in found.clusters] == [("hB", "hP"), ("second/hB", "second/hP")]


def other_frame() -> Network:
    network = fga.Network("gnss", frame=fga.GeocentricFrame())
    network.add_point("A", (4e6, 1e6, 4.8e6))
    return network


def moved() -> Network:
    network = surveyed(SIGHTS[:3])
    network.points["A"] = replace(network.points["A"], coordinates=(0.0, 0.01, 100.0))
    return network


def curved() -> Network:
    network = surveyed(SIGHTS[:3])
    network.frame = fga.LocalFrame(curvature=True)
    return network


def with_refraction() -> Network:
    network = surveyed(SIGHTS[:3])
    network.set_refraction(value=-0.87, fixed=True)
    return network


def in_another_system() -> Network:
    network = surveyed(SIGHTS[:3])
    network.crs = fga.ReferenceSystem("EPSG:25833", geoid=40.0)
    return network


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (other_frame, "network 'gnss': is in another frame than 'book'"),
        (
            curved,
            r"in another frame than 'book \(1\)' \(curvature=True and not curvature=False\): both "
            "must state the same",
        ),
        (moved, r"point 'A': y is 0 m, held in 'book \(1\)' and 0.01 m, held in 'book \(2\)'"),
        (with_refraction, r"network 'book \(1\)': its observations have no refraction group ''"),
        (in_another_system, "network 'book .2.': has another reference system"),
    ],
)
def test_what_does_not_agree_is_told(second: Callable[[], Network], message: str) -> None:
    first = surveyed(SIGHTS[:3])
    first.crs = fga.ReferenceSystem("EPSG:25832", geoid=40.0)
    with pytest.raises(fga.InputError, match=message):
        fga.join([first, second()])


def test_the_mean_radius_of_another_program_is_no_other_frame() -> None:
    """JAG3D computes with 6 371 007 m; a radius of curvature is another frame."""
    first, second = surveyed(SIGHTS[:3]), surveyed(SIGHTS[:3])
    second.frame = fga.LocalFrame(radius=6_371_007.0)
    assert fga.join([first, second]).frame == first.frame
    assert fga.join([second, first]).frame == second.frame
    second.frame = fga.LocalFrame(radius=6_384_000.0)
    with pytest.raises(fga.InputError, match=r"radius=6384000\.0 and not radius=6371000\.0"):
        fga.join([first, second])


def test_photos_join_with_their_image_points(photos: Network) -> None:
    """Photos of one network and sights of another: image points keep their photo and point."""
    book = surveyed(SIGHTS)
    found = fga.join([book, photos])
    assert {(p.photo, p.point, p.x, p.y) for p in found.image_points()} == {
        (p.photo, p.point, p.x, p.y) for p in photos.image_points()
    }
    with pytest.raises(fga.InputError, match=r"photo '1': is in 'photos .2.' and in a network"):
        fga.join([photos, photos])


@pytest.fixture
def photos() -> Network:
    network = fga.Network("photos")
    network.add_camera("c", fga.models.lens.NoDistortion(), {"c": 50.0})
    for name in "QP":
        network.add_point(name, PLACES.get(name, (30, 60, 100)))
    network.add_photo("1", "c", position=(40.0, 50.0, 180.0), omega_phi_kappa=(0.0, 0.0, 0.0))
    network.add_image_points("1", ["P", "Q"], [(3.1, 0.0), (-6.2, 6.2)], sigma=0.003)
    return network


@pytest.mark.parametrize("given", [[], ["book.gsi"], [None]])
def test_join_takes_networks(given: list[object]) -> None:
    with pytest.raises(fga.InputError, match="join takes a list of networks"):
        fga.join(given)  # type: ignore[arg-type]


def levelled_line() -> fga.Network:
    """Return a line as a field book has it: points that were levelled alone are held in plan."""
    network = fga.Network("levelled")
    for name in ("HP", "P"):
        network.add_point(name, (0.0, 0.0, np.nan), fixed="xy")
    network.add(fga.HeightDifference("HP", "P", 1.5, sigma=0.001))
    return network


@pytest.mark.parametrize("held", ["xy", "z", "xyz"])
def test_what_a_list_of_points_holds_of_all_of_them_is_control(held):
    """A list has no observations: it holds nothing because it has no use for it."""
    book = fga.Network("book", datum="free")
    for name in ("A", "B"):
        book.add_point(name)
    book.add(fga.SlopeDistance("A", "B", 100.0, sigma=0.002))
    control = fga.Network("control")
    place = {"A": (1.0, 2.0, 3.0), "B": (101.0, 2.0, 3.0)}
    for name, at in place.items():
        known = tuple(v if a in held else np.nan for a, v in zip("xyz", at, strict=True))
        control.add_point(name, known, fixed=held)
    joined = fga.join([book, control])
    for name, at in place.items():
        point = joined.points[name]
        assert point.held == held
        for axis, i in zip("xyz", range(3), strict=True):
            assert (axis in held) == (point.coordinates[i] == at[i])


def test_a_bench_mark_of_a_list_of_heights_stays_where_its_line_has_it():
    control = fga.Network("heights")
    control.add_point("HP", (np.nan, np.nan, 95.21), fixed="z")
    joined = fga.join([levelled_line(), control])
    assert joined.points["HP"].held == "xyz"
    assert joined.points["HP"].coordinates == (0.0, 0.0, 95.21)
    assert fga.adjust(joined).point("P")[2] == pytest.approx(96.71)


def test_a_point_that_another_network_observes_in_plan_is_free_there():
    book = fga.Network("book", datum="free")
    for name in ("S", "P", "Q"):
        book.add_point(name)
    book.add(
        fga.SlopeDistance("S", "P", 10.0, sigma=0.002),
        fga.SlopeDistance("S", "Q", 10.0, sigma=0.002),
    )
    joined = fga.join([levelled_line(), book])
    assert joined.points["P"].held == ""
    assert joined.points["HP"].held == "xy"
