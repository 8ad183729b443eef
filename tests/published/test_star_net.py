"""STAR*NET-PRO: a network of GPS vectors in a grid, and what its listing prints.

Readings and printed results of 28 April to 5 May 2025 in Fredericton, grid of New Brunswick,
STAR*NET-PRO 13.0.2 (jeelojacko/webnet, tests/fixtures/industry_case_gnss_output.txt).

The listing was made with the factor 1.2 for V28 and V29, where the data file beside it has 1: it
prints σ of north and east 0.0007, 0.0005 and 0.0009, 0.0008 m, 1.2 times those of the variances.
Its column of scales, 0.99985, contradicts its own coordinates and vectors and is not compared.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.statistical_tests import global_test
from factorgraph_adj.units import ARCSEC

pytest.importorskip("pyproj", reason="the extra crs is not installed")
pytestmark = pytest.mark.published

GRID = "EPSG:2953"
"""NAD83(CSRS) / New Brunswick Stereographic."""
OPTIONS = {"adjustment": "3D", "linear": "Meters", "order": "NE"}
CONTROL = "C FRDN 7437047.544 2487601.211 117.930 ! ! !"
VECTORS = """
FRDN-GPS4 785.7010 1233.8307 745.8148 1 1
5.464972900900E-07 2.366875605700E-06 2.852765874200E-06
-9.531319165000E-07 1.005577019000E-06 -2.380853402400E-06
GPS4-GPS2 281.7671 412.3120 195.6258 1.2 1
9.175308264300E-07 4.194758730600E-06 4.713094767800E-06
-1.695791297600E-06 1.829959387600E-06 -4.104981599100E-06
GPS2-GPS3 -348.0912 248.9096 325.5144 1.2 1
2.137200453900E-06 1.120961769600E-05 1.223061281100E-05
-4.332318894700E-06 4.428170086600E-06 -1.114578299200E-05
FRDN-GPS3 719.3787 1895.0485 1266.9577 1 1
2.210563252400E-06 1.046367833600E-05 1.288943894900E-05
-4.140416876900E-06 4.430791705100E-06 -1.072369377700E-05
GPS3-GPS5 573.9513 -336.4067 -480.1599 2 1
2.385281959500E-06 9.192975085200E-06 1.244120994700E-05
-3.927204034000E-06 4.305355560100E-06 -9.612583198800E-06
GPS5-GPS4 -507.6288 -324.8080 -40.9816 1 1
1.322445427800E-06 4.926017481900E-06 6.447530267900E-06
-2.151862645400E-06 2.415020162500E-06 -5.151202458400E-06
FRDN-GPS5 1293.3336 1558.6359 786.7972 1 1
5.716740815800E-06 2.240024514300E-05 2.554278398700E-05
-9.527539987200E-06 9.696396773500E-06 -2.208622572700E-05
GPS5-GPS1 -597.1829 -127.1773 144.2224 1 1
1.426423295900E-06 6.479063813500E-06 7.238465968800E-06
-2.459451479800E-06 2.415396920700E-06 -6.456846222100E-06
GPS1-GPS6 57.5596 280.5083 184.5462 2.6 2
1.800686277400E-06 8.921731932800E-06 9.445886462300E-06
-3.552047246600E-06 3.524005478500E-06 -8.663806511300E-06
FRDN-GPS1 696.1460 1431.4659 931.0100 1 1
5.451095717000E-07 2.358926622000E-06 2.611509671600E-06
-9.868880397300E-07 9.666193818700E-07 -2.273621476000E-06
GPS1-GPS6 57.5594 280.5039 184.5496 1 1.5
6.284718892900E-06 2.124716047500E-05 2.751300053200E-05
-9.965136996500E-06 8.876492756800E-06 -2.076305827400E-05
GPS6-GPS2 313.7690 -65.8393 -174.1093 1 1
2.036881596700E-06 6.156230483600E-06 3.764264420200E-06
-2.035269517400E-06 1.128655000600E-07 -1.440115625000E-06
FRDN-GPS6 753.6948 1711.9838 1115.5418 1.8 1
1.136785795100E-05 5.675945794800E-05 9.208645497000E-05
-2.278895772200E-05 2.701043195000E-05 -6.803093856400E-05
GPS6-GPS2 313.7734 -65.8365 -174.1109 3 1
1.429163717100E-06 4.461853222900E-06 4.373726369500E-06
-1.397134042200E-06 5.077712899000E-07 -2.706625537000E-06
GPS2-GPS5 225.8606 -87.5151 -154.6210 3.0 3.5
2.879562771300E-06 7.024473234200E-06 1.130099099100E-05
-3.169588126200E-06 2.558644382600E-06 -6.146647592700E-06
""".strip().splitlines()
"""Three lines of each vector: names, ΔX, ΔY, ΔZ and the two factors; variances; covariances."""
PRINTED = {
    "GPS1": ((7438438.7334, 2488810.2370, 64.8732), (0.000428, 0.000305, 0.002005)),
    "GPS2": ((7438481.0552, 2489236.2880, 37.7009), (0.000654, 0.000494, 0.002858)),
    "GPS3": ((7438971.1706, 2489016.3029, 16.8087), (0.000715, 0.000536, 0.003152)),
    "GPS4": ((7438154.0601, 2488813.5863, 82.6306), (0.000413, 0.000322, 0.001982)),
    "GPS5": ((7438251.1418, 2489408.5227, 44.6921), (0.000530, 0.000437, 0.002523)),
    "GPS6": ((7438735.4148, 2488974.8105, 34.3045), (0.001117, 0.000704, 0.003138)),
}
"""Adjusted N, E and elevation, and their standard deviations, metres."""
POSITIONS = {
    "FRDN": ("45-56-00.588500", "66-39-35.564343", -(6 * 60 + 55.54)),
    "GPS5": ("45-56-39.683134", "66-38-11.763501", -(5 * 60 + 55.07)),
}
"""Latitude, longitude west, convergence (seconds)."""
HALF_DIGIT, HALF_MICROMETRE = 0.5e-4, 0.5e-6
HALF_HUNDREDTH = 0.005


def data_file(folder: Path, control: str = CONTROL) -> Path:
    lines = [control, ".GPS WEIGHT COVARIANCE"]
    for first, variances, covariances in zip(*[iter(VECTORS)] * 3, strict=True):
        names, *rest = first.split()
        lines += [
            f".GPS FACTOR {rest[3]} VERT {rest[4]}",
            "G0 'postprocessed",
            f"G1 {names} {' '.join(rest[:3])}",
            f"G2 {variances}",
            f"G3 {covariances}",
        ]
    path = folder / "sessions.gps"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def adjusted(tmp_path_factory: pytest.TempPathFactory) -> fga.Solution:
    path = data_file(tmp_path_factory.mktemp("gps"))
    return fga.adjust(fga.read(path, options=OPTIONS, crs=GRID, geoid=0.0))


def test_the_statistical_summary_is_that_of_the_listing(adjusted: fga.Solution) -> None:
    """45 observations, 18 unknowns; sum of squares 40.545, error factor 1.225, within 1.265.

    Factors of V28 and V29 from 1.17 to 1.23 give the printed σ, and sums from 40.61 to 40.53.
    """
    assert (adjusted.n_observations, adjusted.n_unknowns, adjusted.redundancy) == (45, 18, 27)
    assert adjusted.vtpv == pytest.approx(40.545, abs=0.04)
    assert adjusted.sigma0 == pytest.approx(1.225, abs=1e-3)
    test = global_test(adjusted, alpha=0.05)
    assert test.accepted
    assert (test.lower, test.upper) == pytest.approx((0.735, 1.265), abs=0.5e-3)


def test_adjusted_coordinates_in_the_grid_are_those_of_the_listing(adjusted: fga.Solution) -> None:
    grid = fga.grid_coordinates(adjusted)
    for name, ((north, east, up), _) in PRINTED.items():
        np.testing.assert_allclose(grid.point(name), (east, north, up), rtol=0, atol=2 * HALF_DIGIT)


def test_standard_deviations_are_those_of_the_listing(adjusted: fga.Solution) -> None:
    """STAR*NET does not scale them where the χ² test passes; printed to a micrometre."""
    grid = fga.grid_coordinates(adjusted)
    names = list(adjusted.network.points)
    for name, (_, (north, east, up)) in PRINTED.items():
        found = grid.places.sigma[names.index(name)]
        np.testing.assert_allclose(found, (east, north, up), rtol=0, atol=3 * HALF_MICROMETRE)


def test_positions_and_convergence_are_those_of_the_listing(adjusted: fga.Solution) -> None:
    grid = fga.grid_coordinates(adjusted)
    names = list(adjusted.network.points)
    for name, (latitude, longitude, convergence) in POSITIONS.items():
        row = names.index(name)
        at = grid.system.geodetic(adjusted.network.frame, adjusted.point(name)[None])
        found = [float(np.degrees(v[0])) for v in at[:2]]
        expected = [_degrees(latitude), -_degrees(longitude)]
        np.testing.assert_allclose(found, expected, rtol=0, atol=HALF_DIGIT / 30.9 / 3600 * 2)
        expected_angle = convergence * ARCSEC
        assert grid.places.convergence[row] == pytest.approx(expected_angle, abs=0.006 * ARCSEC)


def test_the_combined_factor_is_grid_distance_by_level_distance(adjusted: fga.Solution) -> None:
    """FRDN to GPS1: 1843.1364 m in the grid, ΔN 1393.7243 and ΔE 1206.3100 m at FRDN.

    The level distance at the mean height is that of the horizon at FRDN within h d/2R.
    """
    grid = fga.grid_coordinates(adjusted)
    names = list(adjusted.network.points)
    ends = [names.index(n) for n in ("FRDN", "GPS1")]
    level = np.hypot(1393.7243, 1206.3100)
    expected = 1843.1364 / level
    # A level distance at GPS1 is shorter by its 53 m below; half of it on the average.
    error = 2 * HALF_DIGIT / level + 0.5 * 53.3 / 6.37e6
    assert grid.places.combined[ends].mean() == pytest.approx(expected, abs=error)


def test_a_control_point_by_latitude_and_longitude_gives_the_same(
    adjusted: fga.Solution, tmp_path: Path
) -> None:
    control = "PH FRDN 45-56-00.588500 66-39-35.564343 117.930 ! ! !"
    path = data_file(tmp_path, control)
    options = {"adjustment": "3D", "linear": "Meters", "longitude": "west positive"}
    other = fga.adjust(fga.read(path, options=options, crs=GRID, geoid=0.0))
    for name in PRINTED:
        a, b = (fga.grid_coordinates(s).point(name) for s in (adjusted, other))
        np.testing.assert_allclose(a, b, rtol=0, atol=HALF_DIGIT)


def test_the_standard_error_of_a_steep_zenith_angle_is_that_of_a_listing(tmp_path: Path) -> None:
    """POT to 108: 35.882 m at 81-42-38, 5.48″ (tests/fixtures/industry_case_traverse_input.txt).

    Zenith angle 3.28473″, centring 1.5 mm at both ends, heights 0.5 mm. The heights alone give
    5.23″.
    """
    options = {
        **{"adjustment": "3D", "linear": "Meters", "angular": "DMS", "order": "EN"},
        **{"distances": "slope", "distance": 0.003, "distance_ppm": 2.0, "refraction": 0.07},
        **{"zenith": 3.28473, "centring_instrument": 0.0015, "centring_target": 0.0015},
        "centring_vertical": 0.0005,
    }
    path = tmp_path / "sight.dat"
    path.write_text("C POT 0 0 0 ! ! !\nC 108 0 35.507 5.174\nDV POT-108 35.8820 81-42-38.35\n")
    network = fga.read(path, options=options)
    network.points["108"] = replace(network.points["108"], fixed=(True, False, False))
    zenith = fga.adjust(network).observations.sigmas[1]
    assert zenith / ARCSEC == pytest.approx(5.48, abs=HALF_HUNDREDTH)


def _degrees(text: str) -> float:
    d, m, s = map(float, text.split("-"))
    return d + m / 60 + s / 3600
