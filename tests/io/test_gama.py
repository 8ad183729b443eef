"""The reader of GNU Gama: what each element means, and what is said about a wrong file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Azimuth,
    ControlPoint,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.units import ARCSEC, CC, GON

MM = 1e-3
POINTS = """\
<point id="A" x="0" y="0" z="10" fix="xyz"/>
<point id="B" x="100" y="0" z="11" fix="xyz"/>
<point id="C" adj="xyz"/>
"""


def write(
    folder: Path,
    body: str,
    *,
    network: str = "",
    parameters: str = "",
    defaults: str = "",
    points: str = POINTS,
) -> Path:
    """Write a file; the points begin in line 5, the body follows them."""
    path = folder / "net.gkf"
    path.write_text(
        '<?xml version="1.0"?>\n<gama-local xmlns="http://www.gnu.org/software/gama/gama-local">\n'
        f"<network {network}><parameters {parameters}/><description>\nTest </description>"
        f"<points-observations {defaults}>\n{points}{body}\n"
        "</points-observations></network></gama-local>\n",
        encoding="utf-8",
    )
    return path


def observations(network: Network) -> list[Observation]:
    return list(network.observations.values())


def problems(path: Path) -> list[str]:
    with pytest.raises(InputError) as caught:
        read_gama(path)
    return [str(p) for p in caught.value.problems]


# -- what elements mean ---------------------------------------------------------------------------


def test_every_observation_of_a_station_is_read_with_its_heights_and_line(tmp_path: Path) -> None:
    body = """\
<obs from="A" from_dh="1.5" orientation="12.5">
<direction to="B" val="10" stdev="20" to_dh="1.2"/>
<distance to="C" val="50.1" stdev="5"/>
<s-distance to="C" val="50.2" stdev="6" from_dh="1.6"/>
<z-angle to="C" val="99" stdev="30"/>
<azimuth to="C" val="25" stdev="7" extern="x"/>
<angle bs="B" fs="C" val="100.5" stdev="8" bs_dh="0.1" fs_dh="0.2"/>
<angle from="B" bs="A" fs="C" val="50" stdev="8"/>
<dh to="C" val="1.25" dist="0.25"/>
</obs>"""
    read = read_gama(write(tmp_path, body, parameters='sigma-apr="4"'))
    hi = {"instrument_height": 1.5}
    line = "net.gkf:{}".format
    assert observations(read) == [
        Direction("A", "B", 10 * GON, sigma=20 * CC, target_height=1.2, source=line(9), **hi),
        HorizontalDistance("A", "C", 50.1, sigma=5 * MM, source=line(10), **hi),
        SlopeDistance("A", "C", 50.2, sigma=6 * MM, instrument_height=1.6, source=line(11)),
        ZenithAngle("A", "C", 99 * GON, sigma=30 * CC, source=line(12), **hi),
        Azimuth("A", "C", 25 * GON, sigma=7 * CC, source=line(13), **hi),
        HorizontalAngle(
            *("A", "B", "C", 100.5 * GON),
            sigma=8 * CC,
            target_height=0.1,
            target2_height=0.2,
            source=line(14),
            **hi,
        ),
        HorizontalAngle("B", "A", "C", 50 * GON, sigma=8 * CC, source=line(15), **hi),
        HeightDifference("A", "C", 1.25, sigma=4 * MM * 0.5, length_km=0.25, source=line(16)),
    ]


def test_every_set_of_directions_has_an_orientation_unknown_of_its_own(tmp_path: Path) -> None:
    one = '<obs from="A"><direction to="B" val="1" stdev="1"/></obs>'
    distances = '<obs from="A"><distance to="B" val="1" stdev="1"/></obs>'
    other = '<obs from="B"><direction to="A" val="1" stdev="1"/></obs>'
    read = read_gama(write(tmp_path, one + distances + other + one))
    assert list(read.orientations) == [("A", "1"), ("B", "1"), ("A", "2")]


@pytest.mark.parametrize(
    ("defaults", "element", "sigma"),
    [
        ('distance-stdev="5"', '<distance to="B" val="2000"/>', 5 * MM),
        ('distance-stdev="5 3"', '<s-distance to="B" val="2000"/>', 11 * MM),
        ('distance-stdev="5 3 0.5"', '<distance to="B" val="4000"/>', 11 * MM),
        ('distance-stdev="5"', '<distance to="B" val="2000" stdev="7"/>', 7 * MM),
        ('direction-stdev="5"', '<direction to="B" val="1"/>', 5 * CC),
        ('angle-stdev="5"', '<angle bs="B" fs="C" val="1"/>', 5 * CC),
        ('zenith-angle-stdev="5"', '<z-angle to="B" val="1"/>', 5 * CC),
        ('azimuth-stdev="5"', '<azimuth to="B" val="1"/>', 5 * CC),
        ('azimuth-stdev="5"', '<azimuth to="B" val="1-2-3.5"/>', 5 * ARCSEC),
    ],
)
def test_default_standard_deviations_are_those_of_the_section(
    tmp_path: Path, defaults: str, element: str, sigma: float
) -> None:
    read = read_gama(write(tmp_path, f'<obs from="A">{element}</obs>', defaults=defaults))
    (observation,) = observations(read)
    assert observation.sigma == pytest.approx(sigma, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "degrees"),
    [("41-28-15.8", 41 + 28 / 60 + 15.8 / 3600), ("-0-30-00", -0.5), ("10-59-60.00", 11.0)],
)
def test_sexagesimal_angles_have_standard_deviations_in_arc_seconds(
    tmp_path: Path, text: str, degrees: float
) -> None:
    read = read_gama(
        write(tmp_path, f'<obs from="A"><azimuth to="C" val="{text}" stdev="2"/></obs>')
    )
    (azimuth,) = observations(read)
    assert azimuth.value == pytest.approx(math.radians(degrees), rel=1e-14)
    assert azimuth.sigma == pytest.approx(2 * ARCSEC, rel=1e-14)


def test_a_zenith_angle_of_the_second_face_is_turned_to_the_first(tmp_path: Path) -> None:
    read = read_gama(write(tmp_path, '<obs from="A"><z-angle to="C" val="310" stdev="2"/></obs>'))
    assert observations(read)[0].value == pytest.approx(90 * GON)


@pytest.mark.parametrize("axes", ["ne", "sw", "es", "wn", "en", "nw", "se", "ws"])
@pytest.mark.parametrize("angles", ["left-handed", "right-handed"])
def test_axes_and_sense_of_angles_do_not_change_the_object(
    tmp_path: Path, axes: str, angles: str
) -> None:
    """A triangle stands where compass and sense of the circle say, in any axes of the file."""
    letters = {"e": (1.0, 0.0), "n": (0.0, 1.0), "w": (-1.0, 0.0), "s": (0.0, -1.0)}
    to_file = np.array([letters[a] for a in axes])
    east_north = {"A": (0.0, 0.0), "B": (0.0, 100.0), "C": (80.0, 60.0)}
    sense = 1 if angles == "left-handed" else -1
    points = "".join(
        '<point id="{}" x="{}" y="{}" {}/>'.format(
            name, *(to_file @ at), 'adj="xy"' if name == "C" else 'fix="xy"'
        )
        for name, at in east_north.items()
    )
    azimuth_ac = math.atan2(80, 60) / GON
    angle_b = -(200 - math.atan2(80, -40) / GON)  # at B from A to C, clockwise
    body = f"""<obs from="A"><azimuth to="C" val="{sense * azimuth_ac}" stdev="1"/>
        <direction to="B" val="0" stdev="1"/>
        <direction to="C" val="{sense * azimuth_ac}" stdev="1"/>
        <angle from="B" bs="A" fs="C" val="{sense * angle_b}" stdev="1"/></obs>"""
    network = f'axes-xy="{axes}" angles="{angles}"'
    read = read_gama(write(tmp_path, body, network=network, points=points))
    assert read.frame == LocalFrame(axes=axes)
    assert adjust(read).vtpv < 1e-12
    np.testing.assert_allclose(adjust(read).point("C")[:2], to_file @ (80, 60), atol=1e-9)


def test_without_axes_and_angles_x_is_north_and_angles_are_clockwise(tmp_path: Path) -> None:
    body = '<obs from="A"><azimuth to="C" val="25" stdev="1"/></obs>'
    read = read_gama(write(tmp_path, body))
    assert read.frame == LocalFrame(axes="ne")
    assert observations(read)[0].value == pytest.approx(25 * GON)
    assert read.name == "Test"


def test_components_that_are_not_adjusted_are_held(tmp_path: Path) -> None:
    points = """<point id="plane" x="1" y="2" adj="xy"/><point id="height" adj="z"/>
<point id="both" x="1" y="2" z="3" adj="xyz" fix="z"/><point id="unused" x="7" y="8"/>"""
    body = (
        '<height-differences><dh from="both" to="height" val="1" stdev="1"/></height-differences>'
    )
    read = read_gama(write(tmp_path, body, points=points)).points
    assert list(read) == ["plane", "height", "both"]
    assert read["plane"].fixed == (False, False, True)
    assert read["plane"].coordinates == (1, 2, 0)
    assert read["height"].fixed == (True, True, False)
    assert read["height"].coordinates[:2] == (0, 0)
    assert math.isnan(read["height"].coordinates[2])
    assert read["both"].fixed == (False, False, True)


def test_capital_letters_in_adj_make_a_free_network_with_datum_points(tmp_path: Path) -> None:
    body = '<obs from="A"><distance to="B" val="1" stdev="1"/></obs>'
    points = '<point id="A" x="0" y="0" adj="XY"/>\n<point id="B" x="1" y="0" adj="{}"/>'
    free = read_gama(write(tmp_path, body, points=points.format("xy")))
    assert free.datum == "free"
    assert [p.datum for p in free.points.values()] == [True, False]
    given = read_gama(write(tmp_path, body, points=points.replace("XY", "xy").format("xy")))
    assert given.datum == "given"
    assert not any(p.datum for p in given.points.values())


def test_what_several_elements_state_about_a_point_is_joined(tmp_path: Path) -> None:
    body = """<point id="P" x="1" y="2"/><point id="P" z="3" adj="xy"/><point id="P" fix="z"/>
<obs from="A"><distance to="P" val="1" stdev="1"/></obs>"""
    point = read_gama(write(tmp_path, body)).points["P"]
    assert point.coordinates == (1, 2, 3)
    assert point.fixed == (False, False, True)


def test_a_covariance_matrix_gives_weights_in_the_units_of_its_observations(
    tmp_path: Path,
) -> None:
    """Rows of angles in degrees are arc seconds, of lengths millimetres."""
    body = """<obs from="A"><direction to="B" val="1" /><distance to="B" val="1"/>
<azimuth to="B" val="1-0-0"/><direction to="C" val="2"/>
<cov-mat dim="4" band="2">4 0 1
9 0 0
16 0
25</cov-mat></obs>"""
    read = read_gama(write(tmp_path, body))
    assert [o.sigma for o in observations(read)] == pytest.approx(
        [2 * CC, 4 * ARCSEC, 3 * MM, 5 * CC]
    )
    ((ids, covariance),) = read.clusters
    assert [type(read.observations[i]) for i in ids] == [Direction, Azimuth]
    expected = np.array([[4 * CC**2, CC * ARCSEC], [CC * ARCSEC, 16 * ARCSEC**2]])
    np.testing.assert_allclose(covariance, expected, rtol=1e-12)


def test_vectors_and_observed_coordinates_are_read_with_their_covariance(tmp_path: Path) -> None:
    body = """<vectors><vec from="A" to="C" dx="1" dy="2" dz="3" from_dh="1.1" to_dh="1.2"/>
<cov-mat dim="3" band="1">4 1 4 1 4</cov-mat></vectors>
<coordinates><point id="C" x="1.5" y="2.5"/><point id="D" z="3" adj="z"/>
<cov-mat dim="3" band="1">1 0 4 3 9</cov-mat></coordinates>"""
    read = read_gama(write(tmp_path, body))
    vector, x, d = observations(read)
    assert isinstance(vector, GnssVector)
    assert vector.value == (1, 2, 3)
    assert (vector.instrument_height, vector.target_height) == (1.1, 1.2)
    np.testing.assert_allclose(
        vector.covariance, np.array([[4, 1, 0], [1, 4, 1], [0, 1, 4]]) * 1e-6, rtol=1e-12
    )
    assert isinstance(x, ControlPoint)
    assert isinstance(d, ControlPoint)
    assert (x.point, x.axes, x.value, d.point, d.axes) == ("C", "xy", (1.5, 2.5), "D", "z")
    ((ids, covariance),) = read.clusters
    assert len(ids) == 2
    np.testing.assert_allclose(
        covariance, np.array([[1, 0, 0], [0, 4, 3], [0, 3, 9]]) * 1e-6, rtol=1e-12
    )
    assert read.points["C"].coordinates[:2] == (1.5, 2.5)  # a start where none else is given


# -- wrong files ----------------------------------------------------------------------------------

GOOD = '<obs from="A"><distance to="B" val="1" stdev="1"/></obs>'
BAD = [
    ('<obs from="A"><distance to="X" val="1" stdev="1"/></obs>', ["8", "'X'", "A, B, C"]),
    ('<obs from="A"><distance to="A" val="1" stdev="1"/></obs>', ["8", "itself"]),
    ('<obs from="A"><distance to="B" val="abc" stdev="1"/></obs>', ["8", "val", "'abc'"]),
    ('<obs from="A"><distance to="B" val="nan" stdev="1"/></obs>', ["8", "val", "'nan'"]),
    (
        '<obs from="A"><distance to="B" val="-1" stdev="1"/></obs>',
        ["8", "val", "greater"],
    ),
    ('<obs from="A"><distance to="B" stdev="1"/></obs>', ["8", "val"]),
    (
        '<obs from="A"><distance to="B" val="1" stdev="0"/></obs>',
        ["8", "stdev", "greater"],
    ),
    ('<obs from="A"><distance to="B" val="1"/></obs>', ["8", "stdev", "distance-stdev"]),
    ('<obs from="A"><azimuth to="B" val="1-70-1" stdev="1"/></obs>', ["8", "1-70-1", "minutes"]),
    ('<obs from="A"><direction from="A" to="B" val="1" stdev="1"/></obs>', ["8", "'from'", "to"]),
    ('<obs><distance to="B" val="1" stdev="1"/></obs>', ["8", "from of <distance>", "a name"]),
    ('<obs><angle from="A" bs="B" val="1" stdev="1"/></obs>', ["8", "fs of <angle>", "a name"]),
    ('<obs from="A"></obs>', ["8", "no observations"]),
    ('<obs from="A"><bearing/></obs>', ["8", "bearing", "direction", "azimuth"]),
    ('<point id="A" x="5" y="0"/>' + GOOD, ["8", "x of point 'A'", "5.0", "line 5"]),
    ('<point id="A" adj="xy"/>' + GOOD, ["8", "x, y of point 'A': free", "fixed", "line 5"]),
    ('<point id="D" x="5" adj="xy"/>' + GOOD, ["8", "'D'", "both x and y"]),
    ('<point id="D" x="1" y="2m" fix="xy"/>' + GOOD, ["8", "y of <point>", "'2m'"]),
    ('<point id="D" fix="xy"/>' + GOOD, ["8", "'D'", "fixed at no value"]),
    ('<point id="D" adj="yx"/>' + GOOD, ["8", "'yx'", "xyz, XYZ"]),
    ('<point id="D" adj="XYz"/>' + GOOD, ["8", "'D'", "x, y carry the datum"]),
    ('<point x="1" y="1"/>' + GOOD, ["8", "id of <point>", "a name"]),
    (
        '<point id="D" x="1" y="1"/><obs from="A"><distance to="D" val="1" stdev="1"/></obs>',
        ["8", "x, y of point 'D'", "fix or adj"],
    ),
    (
        '<point id="D" x="1" y="1" adj="xy"/>\n'
        '<obs><z-angle from="A" to="D" val="1" stdev="1"/></obs>',
        ["9", "z of point 'D'", "line 8", "fix or adj"],
    ),
    ('<vectors><vec from="A" to="B" dx="1" dy="1" dz="1"/></vectors>', ["8", "needs a <cov-mat>"]),
    (
        '<obs from="A"><distance to="B" val="1"/><cov-mat dim="2" band="0">1 1</cov-mat></obs>',
        ["8", "dim is 2", "1 values"],
    ),
    (
        '<obs from="A"><distance to="B" val="1"/><cov-mat dim="1" band="1">1 1</cov-mat></obs>',
        ["8", "band is 1", "0 to 0"],
    ),
    (
        '<obs from="A"><distance to="B" val="1"/><cov-mat dim="1" band="0">1 1</cov-mat></obs>',
        ["8", "dim 1 and band 0", "1 numbers, not 2"],
    ),
    (
        '<obs from="A"><distance to="B" val="1"/><cov-mat dim="1" band="0">x</cov-mat></obs>',
        ["8", "cov-mat", "'x'"],
    ),
    (
        '<obs from="A"><distance to="B" val="1"/><cov-mat dim="1" band="0">-1</cov-mat></obs>',
        ["8", "variances > 0"],
    ),
    (
        '<obs from="A"><distance to="B" val="1"/><distance to="C" val="1"/>'
        '<cov-mat dim="2" band="1">1 2 1</cov-mat></obs>',
        ["8", "not positive definite"],
    ),
]


@pytest.mark.parametrize(("body", "words"), BAD)
def test_a_wrong_element_is_named_with_its_line(
    tmp_path: Path, body: str, words: list[str]
) -> None:
    line, *said = words
    (problem,) = problems(write(tmp_path, body))
    assert problem.startswith(f"net.gkf:{line}: ")
    assert all(word in problem for word in said), problem


@pytest.mark.parametrize(
    ("where", "text", "words"),
    [
        ("network", 'axes-xy="nn"', ["3", "'nn'", "ne, sw, es"]),
        ("network", 'angles="left"', ["3", "'left'", "left-handed, right-handed"]),
        ("network", 'unit="m"', ["3", "'unit'", "axes-xy"]),
        ("parameters", 'sigma-apr="0"', ["3", "sigma-apr", "greater"]),
        ("parameters", 'sigma-act="both"', ["3", "'both'", "apriori"]),
        ("parameters", 'angular="100"', ["3", "'100'", "400, 360"]),
        ("defaults", 'distance-stdev="1 2 3 4"', ["4", "distance-stdev", "a b c"]),
        (
            "defaults",
            'distance-stdev="1" direction-stdev="-1"',
            ["4", "direction-stdev", "greater"],
        ),
    ],
)
def test_a_wrong_setting_is_named_with_its_line(
    tmp_path: Path, where: str, text: str, words: list[str]
) -> None:
    body = '<obs from="A"><distance to="B" val="1"/><direction to="B" val="1" stdev="1"/></obs>'
    settings = {where: text}
    if where != "defaults":
        settings["defaults"] = 'distance-stdev="1"'
    line, *said = words
    (problem,) = problems(write(tmp_path, body, **settings))
    assert problem.startswith(f"net.gkf:{line}: ")
    assert all(word in problem for word in said), problem


def test_all_problems_of_a_file_are_reported_at_once_in_the_order_of_lines(tmp_path: Path) -> None:
    body = """<obs from="A"><distance to="X" val="1" stdev="1"/>
<distance to="B" val="one" stdev="-1"/></obs>
<point id="D" adj="up"/>"""
    said = problems(write(tmp_path, body, parameters='sigma-apr="big"'))
    assert [p.split(": ")[0] for p in said] == [f"net.gkf:{i}" for i in (3, 8, 9, 9, 10)]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("<gama-local><network>\n</gama-local>", ["net.gkf:2", "well-formed"]),
        ("", ["net.gkf:1", "well-formed"]),
        ("<project/>", ["net.gkf:1", "<project>", "<gama-local>"]),
        ("<gama-local/>", ["net.gkf:1", "one <network>"]),
        ('<?xml version="1.0" encoding="klingon"?><gama-local/>', ["net.gkf", "encoding"]),
    ],
)
def test_what_is_no_network_is_refused(tmp_path: Path, content: str, words: list[str]) -> None:
    path = tmp_path / "net.gkf"
    path.write_text(content, encoding="utf-8")
    (problem,) = problems(path)
    assert all(word in problem for word in words), problem


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    (problem,) = problems(tmp_path / "none.gkf")
    assert "none.gkf" in problem
    assert "cannot be read" in problem


def test_a_target_in_both_faces_of_a_set_has_its_direction_folded(tmp_path):
    """Half a circle apart, with a zenith angle beyond 200 gon; others keep what the file has."""
    rows = [("A", 10.0, 99.0), ("B", 120.0, 98.0), ("A", 210.002, 301.001), ("C", 320.0, 302.0)]
    sights = "".join(
        f'<direction to="{n}" val="{t}" stdev="10"/><z-angle to="{n}" val="{z}" stdev="10"/>\n'
        for n, t, z in rows
    )
    points = "".join(
        f'<point id="{n}" x="{x}" y="{y}" z="5" fix="xyz"/>\n'
        for n, x, y in (("A", 10, 0), ("B", 0, 90), ("C", 70, 70))
    )
    path = tmp_path / "faces.gkf"
    path.write_text(
        '<?xml version="1.0"?><gama-local xmlns="http://www.gnu.org/software/gama/gama-local">'
        '<network axes-xy="en"><points-observations>'
        f'{points}<point id="S" x="1" y="2" z="5" adj="xyz"/><obs from="S">{sights}</obs>'
        "</points-observations></network></gama-local>"
    )
    network = read_gama(path)
    read = [o for o in network.observations.values() if o.kind == "direction"]
    assert [round(o.value * 200 / np.pi % 400, 6) for o in read] == [10, 120, 10.002, 320]
    zeniths = [o for o in network.observations.values() if o.kind == "zenith_angle"]
    assert [round(o.value * 200 / np.pi, 6) for o in zeniths] == [99, 98, 98.999, 98]
