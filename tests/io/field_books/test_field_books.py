"""One survey in every format gives one network; damaged files are refused with their lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.format_reader import NetworkReader
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle
from factorgraph_adj.units import GON
from tests.hostile.damage import BOMB
from tests.hostile.formats import FORMATS
from tests.io.field_books.field_files import (
    COLLIMATION,
    INDEX,
    KNOWN,
    STATION,
    gsi,
    landxml,
    sights,
)

TENTH_MM = 1e-4
BOOKS = {name: form for name, form in FORMATS.items() if form.is_field_book}
"""The survey in every format."""


@pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
def test_the_station_comes_out_of_every_field_book(tmp_path, book):
    network = book.reads(book.write(tmp_path))
    kinds = [type(o) for o in network.observations.values()]
    assert [kinds.count(k) for k in (Direction, ZenithAngle, SlopeDistance)] == [3, 3, 3]
    solution = fga.adjust(network)
    assert solution.redundancy == 5
    assert np.max(np.abs(solution.point("S") - STATION)) < TENTH_MM
    assert not network.doubts
    first = next(iter(network.observations.values()))
    assert (first.instrument_height, first.target_height) == (1.5, 1.6)
    assert first.source.startswith(f"{book.begin}:")


@pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
def test_both_faces_give_the_errors_of_the_circles(tmp_path, book):
    network = book.reads(book.write(tmp_path), faces="both")
    solution = fga.adjust(network)
    for kind, true in (("index_error", INDEX), ("collimation_error", COLLIMATION)):
        found = solution.unknown(kind, "S/1").values[0]
        assert abs(found - true) < 1e-5 * GON  # half the last digit of GSI


def test_gsi_8_and_gsi_16_are_the_same_book(tmp_path):
    for size in (8, 16):
        (tmp_path / f"{size}.gsi").write_text(gsi(size), encoding="utf-8")
    a, b = (fga.read_gsi(tmp_path / f"{n}.gsi") for n in (8, 16))
    assert [o.value for o in a.observations.values()] == [o.value for o in b.observations.values()]


@pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
def test_without_held_points_the_network_is_free(tmp_path, book):
    network = book.reads(book.write(tmp_path), fixed=())
    assert network.datum == "free"
    solution = fga.adjust(network)
    a, b = solution.point("A"), solution.point("B")
    assert abs(np.linalg.norm(b - a) - np.linalg.norm(np.subtract(KNOWN["B"], KNOWN["A"]))) < 1e-3


@pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
def test_a_point_that_is_held_must_be_there(tmp_path, book):
    with pytest.raises(InputError, match="there is no point 'X'"):
        book.reads(book.write(tmp_path), fixed="A,X")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"sigma_direction_mgon": 0}, "sigma_direction_mgon: must be a number > 0"),
        ({"ppm": -1}, "ppm: must be a number ≥ 0"),
        ({"faces": "one"}, "faces must be 'means' or 'both', not 'one'"),
        ({"refraction": math.nan}, "refraction: must be a number such as 0.13"),
        ({"faces": "both", "centring_mm": 1.0}, "centring"),
    ],
)
def test_options_that_are_no_accuracies_are_refused(tmp_path, wrong, said):
    with pytest.raises(InputError, match=said):
        fga.read(BOOKS["gsi"].write(tmp_path), **wrong)


def test_curvature_and_refraction_lower_a_height_by_d_squared_over_2r(tmp_path):
    """One sight of 1 km, horizontal: h = (1 − k) D²/2R higher than the plane says."""
    text = landxml().split("<Survey>")[0] + (
        '<Survey><InstrumentSetup id="s" stationName="A" instrumentHeight="0"/>'
        '<ObservationGroup id="o" setupID="s"><RawObservation horizAngle="0" zenithAngle="100" '
        'slopeDistance="1000"><TargetPoint name="P"/></RawObservation></ObservationGroup>'
        "</Survey></LandXML>"
    )
    path = tmp_path / "far.xml"
    path.write_text(text, encoding="utf-8")
    heights = []
    for k in (None, 0.13):
        network = fga.read(path, fixed="A,B,C", refraction=k)
        network.set_orientation("A", set="1", value=0.0, fixed=True)
        heights.append(fga.adjust(network).point("P")[2])
    radius = network.frame.radius
    assert abs(heights[1] - heights[0] - 0.87 * 1000.0**2 / (2 * radius)) < TENTH_MM


def test_a_target_that_is_read_again_begins_another_set(tmp_path):
    rows = landxml().replace("</ObservationGroup>", "")
    again = rows[rows.index("<RawObservation") : rows.index("</Survey>")]
    path = tmp_path / "twice.xml"
    path.write_text(
        landxml().replace("</ObservationGroup>", again + "</ObservationGroup>"), encoding="utf-8"
    )
    network = fga.read_landxml(path)
    sets = [o.set for o in network.observations.values() if isinstance(o, Direction)]
    assert sets == ["1"] * 3 + ["1.2"] * 3


def test_convert_writes_a_field_book_as_a_project_and_for_star_net(tmp_path, capsys):
    path = BOOKS["gsi"].write(tmp_path)
    for out in ("project/project.toml", "book.dat"):
        arguments = ["convert", str(path), str(tmp_path / out), "--set", "fixed=A,B,C"]
        assert main(arguments) == 0
        assert "4 points" in capsys.readouterr().out
    a = fga.adjust(fga.read_gsi(path, fixed="A,B,C"))
    b = fga.adjust(fga.read(tmp_path / "project"))
    c = fga.adjust(
        fga.read(tmp_path / "book.dat", options={"adjustment": "3D", "linear": "Meters"})
    )
    assert np.array_equal(a.point("S"), b.point("S"))
    assert np.max(np.abs(a.point("S") - c.point("S"))) < 1e-6


# -- damaged files --------------------------------------------------------------------------------


@pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
@pytest.mark.parametrize("content", [b"", b"\x00\xff\xfe" * 99, b"\n\n", "Größe".encode("latin-1")])
def test_binary_empty_and_other_text_is_refused(tmp_path, book, content):
    path = book.write(tmp_path)
    path.write_bytes(content)
    with pytest.raises(InputError):
        book.reads(path)


@pytest.mark.parametrize("name", ["jobxml", "hexml"])
def test_entities_that_grow_and_deep_elements_are_refused(tmp_path, name):
    path = BOOKS[name].write(tmp_path)
    text = path.read_bytes()
    tag = b"<FieldBook>" if name == "jobxml" else b"<Survey>"
    path.write_bytes(text.replace(tag, tag + b"<a>" * 50_000 + b"</a>" * 50_000))
    with pytest.raises(InputError, match=rf"{path.name}:\d+: is nested too deeply"):
        fga.read(path)
    path.write_bytes(BOMB)
    with pytest.raises(InputError):
        fga.read(path)


@pytest.mark.parametrize("name", ["gsi", "sdr33", "columns"])
def test_a_very_long_line_is_refused(tmp_path, name):
    path = BOOKS[name].write(tmp_path)
    path.write_bytes(path.read_bytes() + b"1," * 1_000_000)
    with pytest.raises(InputError, match="book"):
        BOOKS[name].reads(path)


def test_the_readings_of_the_tests_are_those_of_an_instrument_with_errors():
    one, two = sights()[0], sights()[3]
    assert (one.target, two.target) == ("A", "A")
    assert abs(0.5 * (one.zenith + two.zenith - 2 * math.pi) - INDEX) < 1e-12


# -- accuracies -----------------------------------------------------------------------------------


@pytest.mark.parametrize("book", BOOKS.values(), ids=BOOKS)
def test_accuracies_in_one_object_or_each_by_its_name_give_one_network(tmp_path, book):
    path = book.write(tmp_path)
    stated = {"sigma_direction_mgon": 0.3, "sigma_distance_mm": 1.0, "faces": "both"}
    load = READERS.named(book.reader).load
    assert isinstance(load, NetworkReader)
    beside = {option: path.parent / file for option, file in book.beside.items()}
    one = load.read(path, fixed="A", accuracies=fga.Accuracies(**stated), **beside)
    other = fga.read(path, format=book.reader, fixed="A", **stated, **beside)
    mixed = book.reads(path, fixed="A", accuracies=fga.Accuracies(faces="both"), **stated)
    assert one.observations == other.observations == mixed.observations
    sigma = next(o.sigma for o in one.observations.values() if isinstance(o, Direction))
    assert sigma == pytest.approx(0.3e-3 * GON)  # a single face, without centring


def test_centring_follows_the_faces_where_a_field_is_stated_alone(tmp_path):
    path = BOOKS["gsi"].write(tmp_path)
    network = fga.read(path, faces="both")
    assert all(o.sigma == pytest.approx(1e-3 * GON) for o in network.observations.values()
               if isinstance(o, Direction))  # fmt: skip


def test_an_object_that_is_no_accuracies_is_refused(tmp_path):
    path = BOOKS["gsi"].write(tmp_path)
    with pytest.raises(InputError, match="option accuracies must be Accuracies, not 3"):
        fga.read(path, accuracies=3)


def test_a_row_of_readings_without_a_reading_is_refused(tmp_path):
    path = BOOKS["columns"].write(tmp_path)
    path.write_text(path.read_text(encoding="utf-8") + "B;;;;1,6;x\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"book\.csv:8: a reading needs one of direction, zenith"):
        BOOKS["columns"].reads(path)
