"""gama-g3: networks against the printed results of Gama, every element, states, and mistakes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.units import ARCSEC, CC
from tests.hostile.examples import Example

HEAD = """<?xml version="1.0" ?>
<gnu-gama-data xmlns="http://www.gnu.org/software/gama/gnu-gama-data">
<text>two points are held</text>
<g3-model>
<constants>
<apriori-standard-deviation>10</apriori-standard-deviation>
<confidence-level>0.95</confidence-level>
<ellipsoid><id>wgs84</id></ellipsoid>
</constants>
"""
TAIL = "</g3-model>\n</gnu-gama-data>\n"
VECTORS = (
    ("B", "C", "-8882.8485 -10727.3349 9069.8455", "0.4 0.2 0.5"),
    ("A", "D", "-2590.2863 4708.4222 1156.5328", "0.4 0.2 0.4"),
    ("D", "E", "497.5786 5544.6487 -1483.8326", "0.6 0.4 0.7"),
    ("E", "C", "1680.9135 6095.1480 -2576.4300", "0.5 0.3 0.5"),
)
"""Vectors of Gama's demo-g3-01, metres and mm² (numbers of GNU Gama 2.33, tests/gama-g3)."""


def vector(start: str, end: str, xyz: str, variances: str) -> str:
    x, y, z = xyz.split()
    flt = " ".join(f"<flt>{v}</flt>" for v in variances.split())
    return (
        f"<obs>\n<vector><from>{start}</from> <to>{end}</to>\n"
        f"<dx>{x}</dx> <dy>{y}</dy> <dz>{z}</dz></vector>\n"
        f"<cov-mat><dim>3</dim> <band>0</band>\n{flt}\n</cov-mat>\n</obs>\n"
    )


def held(name: str, x: str, y: str, z: str) -> str:
    return f"<point><id>{name}</id>\n<x>{x}</x> <y> {y}</y> <z>{z}</z></point>\n"


GIVEN = {
    "A": ("3897173.613", "997293.454", "4933466.708"),
    "B": ("3905644.621", "1024368.968", "4921493.098"),
}
FREE = "<free><n/><e/><u/></free>\n"
FIXED = "<fixed><n/><e/><u/></fixed>\n"
NEW = "".join(f"<point><id>{n}</id></point>\n" for n in "CDE")
DEMO = (
    HEAD
    + FIXED
    + "".join(held(n, *xyz) for n, xyz in GIVEN.items())
    + FREE
    + NEW
    + "".join(vector(*v) for v in VECTORS)
    + TAIL
)
EXAMPLE_FILES = {
    "gama-g3": Example(
        "gama-g3",
        {"demo.xml": DEMO},
        "demo.xml",
        unread=(r"<text>", r"apriori-standard", r"confidence", r"\|attribute\|.*gnu-gama-data"),
    )
}
HUNDREDTH_MM = 1e-5


def read(folder: Path, text: str) -> fga.Network:
    (folder / "net.xml").write_text(text, encoding="utf-8")
    return fga.read(folder / "net.xml")


def test_a_network_of_vectors_is_gamas(tmp_path: Path) -> None:
    """Printed in demo-g3-01-adj.xml: Σ 3.14167e+05 with m0 = 10 mm, coordinates, (co)variances."""
    solution = fga.adjust(read(tmp_path, DEMO))
    assert (solution.n_observations, solution.n_unknowns, solution.redundancy) == (12, 9, 3)
    assert 100 * solution.vtpv == pytest.approx(3.14167e05, abs=0.5)
    assert 100 * solution.sigma0**2 == pytest.approx(1.04722e05, abs=0.5)
    expected = {
        "C": (3896761.78225, 1013641.64034, 4930562.95176),
        "D": (3894583.31695, 1002001.86896, 4934623.23419),
    }
    for name, xyz in expected.items():
        np.testing.assert_allclose(solution.point(name), xyz, rtol=0, atol=HUNDREDTH_MM)
    variances = 1e6 * solution.sigma0**2 * np.diag(solution.covariance("C"))
    np.testing.assert_allclose(variances, [3.3070215e02, 1.7136384e02, 3.9894228e02], rtol=1e-7)


POSITIONS = (
    "<obs>\n"
    + "".join(
        f"<xyz><id>{n}</id><x>{x}</x> <y>{y}</y>\n<z>{z}</z></xyz>\n"
        for n, (x, y, z) in GIVEN.items()
    )
    + "<cov-mat><dim>6</dim><band>2</band>\n"
    + "".join(f"<flt>{v}</flt>" for v in (0.31, 0.10, 0.04, 0.32, 0.11, 0, 0.33, 0, 0))
    + "".join(f"<flt>{v}</flt>" for v in (0.34, 0.12, 0.05, 0.35, 0.13, 0.36))
    + "</cov-mat></obs>\n"
)
DISTANCES = (
    "<obs><distance><from>B</from> <to>C</to> <val>16620.550</val>\n<stdev>15</stdev>"
    "<from-dh>0</from-dh></distance></obs>\n"
    "<obs><distance><from>B</from><to>C</to><val>16620.550</val></distance>\n"
    "<cov-mat><dim>1</dim><band>0</band><flt>225</flt></cov-mat></obs>\n"
)


@pytest.mark.parametrize(
    ("more", "squares", "variance"),
    [("", 1.86377e05, 6.21258e04), (DISTANCES, 1.86378e05, 3.72755e04)],
)
def test_observed_positions_and_distances_are_gamas(
    tmp_path: Path, more: str, squares: float, variance: float
) -> None:
    """Printed in demo-g3-02-adj.xml and demo-g3-03-adj.xml."""
    names = "".join(f"<point><id>{n}</id></point>\n" for n in "ABCDE")
    text = HEAD + FREE + names + "".join(vector(*v) for v in VECTORS) + POSITIONS + more + TAIL
    solution = fga.adjust(read(tmp_path, text))
    assert 100 * solution.vtpv == pytest.approx(squares, abs=0.5)
    assert 100 * solution.sigma0**2 == pytest.approx(variance, abs=0.05)


def test_constrained_points_are_the_datum(tmp_path: Path) -> None:
    text = DEMO.replace(FIXED, "<constr><n/><e/><u/></constr>\n")
    network = read(tmp_path, text)
    assert network.datum == "free"
    solution = fga.adjust(network)
    shifts = [solution.point(n) - np.array([float(v) for v in GIVEN[n]]) for n in "AB"]
    np.testing.assert_allclose(sum(shifts), 0.0, atol=1e-6)  # of the centre of both


EVERY = """
<point><id>P</id> <b>50-49-19.4040143</b> <l>14-41-47.2656613</l> <h>554.84924</h>
<geoid>45.5</geoid> <db>5.0</db> <dl>-3.0</dl> <fixed><n/><e/><u/></fixed></point>
<point><id>Q</id> <b>50-50-00.0</b> <l>14-42-00.0</l> <h>600</h> <geoid>45.6</geoid>
<height>554.4</height></point>
<point><id>R</id> <b>50-50-00.0</b> <l>14-40-00.0</l> <h>580</h></point>
"""
SIGHTS = """<obs>
<zenith><from>P</from><to>Q</to><val>98.25</val><stdev>10</stdev><from-dh>1.5</from-dh></zenith>
<zenith><from>P</from><to>R</to><val>88-30-15.5</val><variance>9</variance></zenith>
<azimuth><from>P</from><to>Q</to><val>12.5</val><stdev>20</stdev><to-dh>1.7</to-dh></azimuth>
<angle><from>P</from><left>R</left><right>Q</right><val>75-10-00</val><stdev>2</stdev>
<from-dh>1.1</from-dh><left-dh>1.2</left-dh><right-dh>1.3</right-dh></angle>
<height><id>Q</id><val>554.4</val><stdev>5</stdev></height>
<hdiff><from>P</from><to>Q</to><val>44.9</val><stdev>2</stdev></hdiff>
</obs>
"""


def test_every_element_is_read(tmp_path: Path) -> None:
    network = read(tmp_path, HEAD + FREE + EVERY + SIGHTS + TAIL)
    one, other, azimuth, angle, height, difference = network.observations.values()
    assert [o.kind for o in network.observations.values()] == [
        *("zenith_angle", "zenith_angle", "geodetic_azimuth", "horizontal_angle"),
        *("ellipsoid_height", "ellipsoid_height_difference"),
    ]
    assert one.value == pytest.approx(98.25 * math.pi / 200)
    assert (one.sigma, one.instrument_height) == (pytest.approx(10 * CC), 1.5)
    assert other.value == pytest.approx(math.radians(88 + 30 / 60 + 15.5 / 3600))
    assert other.sigma == pytest.approx(3 * ARCSEC)
    assert (azimuth.target_height, azimuth.sigma) == (1.7, pytest.approx(20 * CC))
    assert (angle.station, angle.target, angle.target2) == ("P", "R", "Q")
    heights = (angle.instrument_height, angle.target_height, angle.target2_height)
    assert heights == (1.1, 1.2, 1.3)
    assert (height.surface, height.sigma) == (45.6, pytest.approx(0.005))
    assert (difference.station_surface, difference.target_surface) == (45.5, 45.6)
    xi, eta = network.of_kind("vertical")["P"].values
    assert (xi, eta) == pytest.approx(
        (5 * ARCSEC, -3 * ARCSEC * math.cos(math.radians(50.8220567)))
    )
    # The listing of demo-g3-01 has the place of B in both ways.
    given = [float(v) for v in GIVEN["B"]]
    np.testing.assert_allclose(network.points["P"].coordinates, given, rtol=0, atol=HUNDREDTH_MM)
    assert all(network.points["P"].fixed) and not any(network.points["Q"].fixed)


def test_points_that_are_fixed_in_plan_are_held_there(tmp_path: Path) -> None:
    states = "<fixed><n/><e/></fixed><free><u/></free>\n"
    network = read(tmp_path, HEAD + states + held("A", *GIVEN["A"]) + TAIL)
    (control,) = network.observations.values()
    assert (control.axes, control.sigma) == ("ne", (1e-6, 1e-6))  # type: ignore[attr-defined]


def test_observations_of_unused_points_are_left_out(tmp_path: Path) -> None:
    text = DEMO.replace("<point><id>C</id>", "<point><id>C</id><unused><n/><e/><u/></unused>")
    network = read(tmp_path, text)
    assert "C" not in network.points and len(network.observations) == 2
    assert str(network.left_out[0]).startswith("observations: 2 left out")


def test_ellipsoids_by_axes(tmp_path: Path) -> None:
    stated = "<ellipsoid><a>6377397.155</a><b>6356078.963</b></ellipsoid>"
    network = read(tmp_path, DEMO.replace("<ellipsoid><id>wgs84</id></ellipsoid>", stated))
    assert network.frame == fga.GeocentricFrame("Bessel1841")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("wgs84", "moon", "<id> 'moon' is unknown; valid:"),
        ("<id>wgs84</id>", "<a>6378000</a><inv-f>300</inv-f>", "no ellipsoid has the axes"),
        ("<to>C</to>", "<to>X</to>", "<vector> names the unknown point 'X'; known: A, B, C"),
        ("<dim>3</dim>", "<dim>2</dim>", "<cov-mat> of dim 2 and band 0 needs 2 numbers, not 3"),
        ("<band>0</band>", "<band>3</band>", "band is 3; valid: 0 to 2"),
        ("<flt>0.4</flt>", "<flt>-0.4</flt>", "<cov-mat> needs variances > 0"),
        ("<dx>", "<dq>1</dq><dx>", "<dq> cannot be in <vector>; valid: from, to, dx"),
        ("4933466.708", "4933466.70x", "<z>: '4933466.70x' is not a number"),
        ("<id>D</id>", "<id>C</id>", "point 'C' stands in line"),
        ("<id>D</id>", "<id>D</id><constr><n/></constr>", "has components of different states"),
        ("<id>A</id>\n<x>3897173.613</x>", "<id>A</id>\n", "<x> of <point> is missing"),
        ("<point><id>C</id>", "<point><id>C</id><fixed><n/><e/><u/></fixed>",
         "point 'C' is fixed and has no coordinates"),
        ("<point><id>C</id>", "<point fix='xy'><id>C</id>", "<point> has no attribute 'fix'"),
        ("</cov-mat>\n</obs>", "</cov-mat>\n<cov-mat><dim>1</dim><band>0</band><flt>1</flt>"
         "</cov-mat></obs>", "has 3 observed values, but 4 rows of covariance"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in DEMO
    with pytest.raises(fga.InputError) as caught:
        read(tmp_path, DEMO.replace(old, new, 1))
    assert message in str(caught.value)
    assert "net.xml:" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<geoid>45.6</geoid>", "", "<height> needs <geoid> of point 'Q', in net.xml:"),
        ("14-42-00.0", "14.7", "<l> must be in degrees: '14.7' is not degrees-minutes-seconds"),
        ("75-10-00", "75-70-00", "has 60 or more minutes"),
        ("<stdev>5</stdev>", "<stdev>5</stdev><dist>1</dist>", "<dist> cannot be in <height>"),
    ],
)
def test_what_is_wrong_with_other_elements(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = HEAD + FREE + EVERY + SIGHTS + TAIL
    with pytest.raises(fga.InputError) as caught:
        read(tmp_path, text.replace(old, new))
    assert message in str(caught.value)
