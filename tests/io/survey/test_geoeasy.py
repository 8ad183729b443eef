"""GeoEasy: lists of Tcl, coordinates and parameters beside a field book, plane networks."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.survey.geoeasy import READER, tcl_list
from factorgraph_adj.units import ANGLE
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, sights

COORDINATES = "".join(
    f"{{5 {n}}} {{37 {y}}} {{38 {x}}} {{39 {z}}}\n" for n, (x, y, z) in KNOWN.items()
)


def geoeasy() -> str:
    """Return the survey of all field books; GeoEasy keeps the mean of the faces as one reading."""
    rows = [f"{{3 {HEIGHT}}} {{2 S}}"]
    rows += [
        f"{{5 {s.target}}} {{6 {TARGET}}} {{7 {s.direction!r}}} {{8 {s.zenith!r}}} "
        f"{{9 {s.distance!r}}}"
        for s in sights()
    ]
    return "\n".join(rows) + "\n"


EXAMPLE_FILES = {
    "geoeasy": Example(
        "geoeasy",
        {"book.geo": geoeasy(), "book.coo": COORDINATES, "book.par": "{114 3} {115 2} {116 2}\n"},
        "book.geo",
        HELD,
        is_field_book=True,
    )
}


def book(tmp_path, text: str, coo: str = "", par: str = "", **options: object) -> fga.Network:
    """Return the network of a field book."""
    for suffix, content in ((".geo", text), (".coo", coo), (".par", par)):
        if content:
            (tmp_path / f"b{suffix}").write_text(content, encoding="cp1250")
    return fga.read(tmp_path / "b.geo", **options)


def test_lists_of_tcl_have_braces_quotes_and_backslashes():
    assert tcl_list('{5 {Kis Janos}} {4 "a b"} x\\ y') == ["5 {Kis Janos}", '4 "a b"', "x y"]
    assert tcl_list('4 "a b"') == ["4", "a b"]
    assert tcl_list("") == []
    for wrong in ("{5 1", "{5 1}x", "} 1", '"a'):
        assert tcl_list(wrong) is None


def test_directions_to_references_and_points_share_one_circle(tmp_path):
    """Codes 7 and 21; angles are radians or degrees with hyphens; a slope distance goes first."""
    network = book(
        tmp_path,
        "{2 {st 1}} {3 1.45}\n{5 12} {21 5.164598941}\n{5 5002} {7 90-30-00} {11 954.73} {6 1.30}\n"
        "{5 x} {4 tree} {7 1.5} {8 1.6} {9 20.5} {11 20.4}\n",
    )
    of = {(o.target, o.kind): o for o in network.observations.values()}
    assert {o.station for o in of.values()} == {"st 1"}
    assert of["12", "direction"].value == 5.164598941
    assert of["5002", "direction"].value == pytest.approx(math.radians(90.5))
    assert of["5002", "direction"].set == of["12", "direction"].set == "1"
    assert of["5002", "horizontal_distance"].value == 954.73
    assert of["5002", "horizontal_distance"].target_height == 1.3
    assert of["x", "slope_distance"].value == 20.5
    assert ("x", "horizontal_distance") not in of


def test_coordinates_lie_beside_the_book_and_preliminary_ones_count_last(tmp_path):
    coo = "{38 2.5} {37 1} {5 A} {39 3} {237 0.01}\n{5 B} {138 10} {137 20}\n"
    network = book(tmp_path, "{2 A}\n{5 B} {7 0.5} {8 1.5} {9 30}\n", coo, fixed="A")
    assert tuple(network.points["A"].coordinates) == (2.5, 1.0, 3.0)
    assert np.array_equal(network.points["B"].coordinates, (10, 20, math.nan), equal_nan=True)
    alone = fga.read(tmp_path / "b.coo")
    assert (set(alone.points), len(alone.observations)) == ({"A", "B"}, 0)
    (tmp_path / "b.geo").write_text("", encoding="ascii")
    with pytest.raises(InputError, match=r"b\.geo:1: is empty: .* are read from its \.coo"):
        fga.read(tmp_path / "b.geo")


def test_parameters_state_standard_deviations_unless_options_do(tmp_path):
    text, par = (
        "{2 A}\n{5 B} {7 0.5} {8 1.5} {9 30}\n{2 A}\n{5 C} {11 500} {120 1.25}\n",
        "{114 3} {115 5} {116 7} {118 0.7}\n",
    )
    network = book(tmp_path, text, par=par, centring_mm=0)
    of = {o.kind: o for o in network.observations.values()}
    assert of["direction"].sigma == pytest.approx(3 * ANGLE["arcsec"])
    assert (of["slope_distance"].sigma.constant, of["slope_distance"].sigma.ppm) == (0.005, 7.0)
    assert of["height_difference"].sigma == pytest.approx(0.00035)  # 0.7 mm for each km
    assert of["height_difference"].length_km == 0.5
    stated = book(tmp_path, text, centring_mm=0, sigma_direction_mgon=2, sigma_levelling_mm=3)
    of = {o.kind: o for o in stated.observations.values()}
    assert of["direction"].sigma == pytest.approx(2 * ANGLE["mgon"])
    assert of["height_difference"].sigma.per_sqrt_km == pytest.approx(0.003)


def test_the_levelling_network_of_the_tutorial(tmp_path):
    """Heights that GeoEasy printed from differences rounded to 1 mm, σ of 0.7 mm for each km.

    Source: "Step by step" of GeoEasy (doc/step_by_step.rst), levelling network adjustment: H
    100.44987, I 100.37601, J 100.44003, N 100.27110, K 100.26900 where B is 99.99998.
    """
    lines = [
        ("B", "H", 232, 0.450), ("H", "I", 240, -0.074), ("I", "J", 416, 0.064),
        ("I", "N", 186, -0.105), ("K", "B", 90, -0.269), ("K", "N", 215, 0.002),
        ("J", "K", 806, -0.171), ("N", "H", 408, 0.178), ("N", "J", 634, 0.169),
    ]  # fmt: skip
    text = "".join(f"{{2 {a}}}\n{{5 {b}}} {{11 {s}}} {{120 {d}}}\n" for a, b, s, d in lines)
    network = book(tmp_path, text, "{5 B} {39 99.99998}\n", "{118 0.7}\n", fixed="B")
    solution = fga.adjust(network)
    printed = {"H": 100.44987, "I": 100.37601, "J": 100.44003, "N": 100.27110, "K": 100.26900}
    for name, height in printed.items():
        assert solution.point(name)[2] == pytest.approx(height, abs=1e-5)


def test_a_plane_network_reduces_slope_distances_and_leaves_heights_out(tmp_path):
    text = (
        "{2 A} {3 1.5}\n{5 B} {7 0.5} {8 1.4} {9 30}\n{5 C} {7 0.7} {8 1.5}\n{5 D} {8 1.5}\n"
        "{2 A}\n{5 B} {11 100} {120 1.5}\n"
    )
    network = book(tmp_path, text, dimension=2)
    kinds = [(o.kind, o.target) for o in network.observations.values()]
    assert sorted(kinds) == [("direction", "B"), ("direction", "C"), ("horizontal_distance", "B")]
    of = {o.kind: o for o in network.observations.values()}
    assert of["horizontal_distance"].value == pytest.approx(30 * math.sin(1.4))
    assert [r.names for r in network.left_out] == [("C", "D", "B")]
    with pytest.raises(InputError, match="dimension must be 2"):
        book(tmp_path, text, dimension=1)


def test_readings_that_are_not_used_and_derived_ones_are_left_out(tmp_path):
    text = "{2 A}\n{5 B} {7 0.5} {-8 1.4} {9 30}\n{5 C} {7 0.7} {8 1.5} {9 20} {10 1.4}\n"
    network = book(tmp_path, text)
    assert {(r.what, r.names) for r in network.left_out} == {
        ("points and observations", ("B",)),
        ("reduced observations", ("C",)),
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{2 A} {5 B}\n", "b.geo:1: needs a station (code 2) or a target (code 5), and not both"),
        ("{2 A}\n{5 B} {7 x}\n", "b.geo:2: direction (7): 'x' is not a number"),
        ("{2 A}\n{5 B} {99 1}\n", "b.geo:2: word '99' is unknown"),
        ("{2 A}\n{5 B} {7 1} {7 2}\n", "b.geo:2: code '7' stands twice"),
        ("{2 A}\n{5 B} {7 1} {21 2}\n", "b.geo:2: has a direction (7) and a direction to a ref"),
        ("{2 A}\n{5 B} {10 1} {7 1}\n", "b.geo:2: a height difference (10) without a zenith angle"),
        ("{2 A}\n{5 B} {20 1} {7 1}\n", "b.geo:2: a constant of the slope distance (20)"),
        ("{2 A}\n{5 B} {120 1} {7 1}\n", "b.geo:2: a levelled height difference (120) with dir"),
        ("{2 A}\n{5 B} {7 1 2}\n", "b.geo:2: must be pairs of a code and a value in braces"),
        ("{5 B} {7 1}\n", "b.geo:1: 1 sight from here has no station"),
        ("{5 B} {120 1}\n", "b.geo:1: a levelled height difference before any station"),
    ],
)
def test_wrong_lines_are_refused_with_their_line(tmp_path, text, said):
    with pytest.raises(InputError) as refused:
        book(tmp_path, text)
    assert said in str(refused.value)


def test_wrong_coordinates_name_their_file(tmp_path):
    with pytest.raises(InputError) as refused:
        book(tmp_path, "{2 A}\n{5 B} {7 1}\n", "{5 A} {37 x} {38 1}\n{37 1}\n")
    assert "b.coo:1: northing (37): 'x' is not a number" in str(refused.value)
    assert "b.coo:2: needs the name of a point, code 5" in str(refused.value)


def test_the_book_is_recognised_whatever_the_suffix(tmp_path):
    path = tmp_path / "book.txt"
    assert READER.recognises is not None
    for text, is_one in (
        (geoeasy(), True),
        (COORDINATES, True),
        ("{7 1} {8 2}\n", False),
        ('{"a": 1}\n', False),
        ("", False),
    ):
        path.write_text(text, encoding="ascii")
        assert READER.recognises(path) is is_one
