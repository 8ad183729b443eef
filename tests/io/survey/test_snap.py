"""Jobs of LINZ SNAP: its own networks and listings, surveys of known stations, wrong files.

Networks of the regression tests of github.com/linz/snap (BSD-3-Clause) are in
``../shared/data/snap_obs_equations``; all others have numbers of their own.
"""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.io.survey.snap import HELD_SIGMA_M, is_snap_job, read_snap
from factorgraph_adj.io.survey.snap_lines import parsed_date
from factorgraph_adj.io.survey.snap_recoding import Recoding, Recodings
from factorgraph_adj.io.survey.snap_selections import is_code_before
from factorgraph_adj.io.survey.snap_systems import SNAP_SYSTEMS
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.hostile.examples import Example
from tests.loaders.snap_listing import (
    errors_of,
    is_held,
    read_errors,
    read_summary,
    same_errors,
    summary,
)
from tests.support.places import data_dir

HALF_DIGIT = 0.6e-5
"""Half of the last digit of sums in listings, and the share of one radius for refraction."""
TENTH_MM = 1e-4

SITE = """Four stations
NZGD1949
options ellipsoidal_heights deflections geoid_heights c=Order c=Mark
1 41 00 00.00 S 173 00 00.00 E 120.00 -4.0 3.0 12.5 1 PIN  North
2 41 00 30.00 S 173 00 45.00 E 180.00 -4.1 3.1 12.6 1 PIN  East
3 41 00 45.00 S 173 00 05.00 E  90.00 -4.2 3.2 12.7 2 TUBE South
4 41 00 20.00 S 172 59 40.00 E 150.00 -4.3 3.3 12.8 2 TUBE West
"""
READINGS = """Readings of 2008
#date 3 Feb 2008
#classification tool
#data SD tool error ZD error
1 1.5 2 1.6 1400.100 T2 0.005 87 33 30.1 4.0
1 1.5 3 1.2 1393.230 T2 0.005 -
* 2 1.4 4 1.3 1550.0 T1 0.005 91 06 10.0 4.0
#ha_error 3 sec 2 mm
#data HA no_heights
1
2 0 00 00.0
3 45 20 11.5
4 * 90 10 10.0 error 9
3
1 0 00 00.0
4 322 11 12.0
#deg_angles
#bearing_orientation_error plan
#data AZ error no_heights
1 2 131.3 0.01
#data LT error LN error no_heights
4 -41.00556 0.001 172.99444 0.001
#dms_angles
#lv_error 8 mm
#data LV no_heights
3 4 60.05
#oh_error 20 mm
#data OH no_heights
4 137.2
#reference_frame WGS
#gps_enu_error 4 4 9 mm 1 1 2 ppm
#data GB grouped no_heights
1
2 -900.0 -900.1 -910.2
3 -940.0 -20.1 -1020.2
#gps_error_type full
#data GX error grouped no_heights
4 -4784900.0 586500.0 -4158000.0
#end_set
4e-4 1e-5 5e-4
-2e-5 3e-5 6e-4
"""
JOB = """title Survey of a site
coordinate_file site.crd
data_file readings.dat error_factor 1.1
mode 3d adjustment
fix 1 2
float horizontal 3
horizontal_float_error 0.5
refraction_coefficient DEFAULT 0.07
bearing_orientation_error plan 12
distance_scale_error use tool
distance_scale_error T2 3.0
reference_frame WGS translation 0.1 0.2 0.3 scale 0.5 rotation 0.01 0.02 0.03
reweight_observations 1.5 data_type=ZD/LV
list residuals
"""
EXAMPLE_FILES = {
    "snap": Example(
        "snap",
        {"site.snp": JOB, "site.crd": SITE, "readings.dat": READINGS},
        "site.snp",
        unread=(
            r"site\.snp\|.*\|(title|list) ",
            r"site\.crd\|.*\|Four stations",
            r"site\.crd\|word\|.*\|\d 41 ",  # names of stations
            r"site\.crd\|value\|(North|East|South|West|\d|PIN|TUBE)\|",
            r"readings\.dat\|.*\|(Readings|#date|\* 2 1\.4)",
        ),
    )
}


def job(folder: Path, commands: str, stations: str = SITE, readings: str = READINGS) -> Path:
    """Write a job; return its command file."""
    (folder / "site.crd").write_text(stations)
    (folder / "readings.dat").write_text(readings)
    path = folder / "site.snp"
    path.write_text(f"coordinate_file site.crd\ndata_file readings.dat\n{commands}")
    return path


# -- networks and listings of SNAP ----------------------------------------------------------------


@pytest.mark.published
@pytest.mark.parametrize("name", ["test1", "test1a", "test1b", "testafx", "testrc", "testgx3"])
def test_figures_are_those_of_the_listing(name: str) -> None:
    """All sixteen types (test1b, data_check in test1), floats, automatic fixes, parameters."""
    folder = data_dir("snap_obs_equations")
    theirs = read_summary(folder / "expected" / name / f"{name}.lst")
    ours = summary(fga.read(folder / "in" / f"{name}.snp"))
    assert theirs is not None
    assert (ours.observations, ours.redundancy) == (theirs.observations, theirs.redundancy)
    # One radius for the refraction that testrc looks for: a share of 2·10⁻⁶.
    assert ours.squares == pytest.approx(theirs.squares, abs=HALF_DIGIT, rel=2e-6)
    assert ours.unit_weight == pytest.approx(theirs.unit_weight, abs=HALF_DIGIT)


@pytest.mark.published
@pytest.mark.parametrize("name", ["test1", "test1a"])
def test_readings_that_take_part_and_their_errors_are_those_of_the_listing(name: str) -> None:
    """Every scalar reading with its line and error: stated, of instruments, by default."""
    folder = data_dir("snap_obs_equations")
    listed = read_errors(folder / "expected" / name / f"{name}.lst")
    assert listed is not None and sum(len(found) for found in listed.values()) > 70
    found = errors_of(fga.read(folder / "in" / f"{name}.snp"))
    assert same_errors(listed, found)
    (first, *_), wrong = found[min(found)], dict(found)
    wrong[min(found)] = [replace(first, error=1.1 * first.error)]
    assert not same_errors(listed, wrong)


@pytest.mark.published
def test_unknown_rotations_of_vectors_are_iterated() -> None:
    """testgx3a: SNAP stops after one iteration, since no station moves, with rotations of 65″.

    Its listing has "ITERATION NUMBER 1" alone and Σ 3.99113: half the square of 65″ (5·10⁻⁸) is
    0.02 m in 500 km, which one iteration does not find.
    """
    folder = data_dir("snap_obs_equations")
    listing = folder / "expected" / "testgx3a" / "testgx3a.lst"
    theirs = read_summary(listing)
    ours = summary(fga.read(folder / "in" / "testgx3a.snp"))
    assert theirs is not None
    assert (ours.observations, ours.redundancy) == (theirs.observations, theirs.redundancy)
    assert "ITERATION NUMBER 2" not in listing.read_text()
    assert ours.squares < 1e-3 < theirs.squares


@pytest.mark.published
def test_adjusted_stations_and_their_errors_are_those_of_the_listing() -> None:
    folder = data_dir("snap_obs_equations")
    solution = fga.adjust(read_snap(folder / "in" / "test1b.snp"))
    with (folder / "expected" / "test1b" / "test1b-stn.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["mode"] != "*"]
    assert [row["code"] for row in rows] == ["1", "2", "3", "5"]
    frame = solution.network.frame
    for row in rows:
        at = solution.point(row["code"])
        place = np.radians([[float(row["latitude"])], [float(row["longitude"])]])
        theirs = frame.ellipsoid.to_cartesian(*place, np.array([float(row["ellheight"])]))[0]
        # Degrees have nine decimals and heights four: 0.1 mm.
        assert at == pytest.approx(theirs, abs=TENTH_MM)
        enu = frame.basis(at[None], np.zeros((1, 2))).enu[0]
        covariance = enu @ solution.covariance(row["code"]) @ enu.T
        semi_major = math.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        assert semi_major == pytest.approx(float(row["errell_max"]), abs=0.6e-4)
        assert math.sqrt(covariance[2, 2]) == pytest.approx(float(row["errhgt"]), abs=0.6e-4)


@pytest.mark.published
def test_parameters_are_those_of_the_listing() -> None:
    """testrc prints k(TEST) = 0.48471 ± 0.07513, PLAN1 −18.383″, PLAN_C 123.217″."""
    solution = fga.adjust(read_snap(data_dir("snap_obs_equations") / "in" / "testrc.snp"))
    k = solution.unknown("refraction", "TEST")
    assert k.values[0] / 2 == pytest.approx(0.48471, abs=1e-5)
    assert k.sigmas[0] / 2 == pytest.approx(0.07513, abs=1e-5)
    for name, seconds in (("PLAN1", -18.383), ("PLAN_C", 123.217)):
        constant = solution.unknown("gyro", name).values[0]
        assert -constant / ARCSEC == pytest.approx(seconds, abs=0.6e-3)


# -- a survey of known stations -------------------------------------------------------------------

GRS80 = ellipsoid("GRS80")
TRUE = {
    "A": (-36.85, 174.76, 60.0),
    "B": (-36.8561, 174.7722, 141.0),
    "C": (-36.8443, 174.7743, 22.0),
    "D": (-36.8502, 174.7805, 95.0),
}
GEOID = {"A": 34.2, "B": 34.1, "C": 34.3, "D": 34.15}
XI, ETA = -6.0, 4.5
"""Deflections of all stations, seconds of arc."""


def xyz(place: tuple[float, float, float]) -> Array:
    phi, lam = np.radians(place[:2])
    at = np.array([phi]), np.array([lam]), np.array([place[2]])
    return np.asarray(GRS80.to_cartesian(*at)[0])


def axes(phi: float, lam: float) -> Array:
    sp, cp, sl, cl = math.sin(phi), math.cos(phi), math.sin(lam), math.cos(lam)
    return np.array([[-sl, cl, 0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


def sight(a: str, b: str, hi: float = 0.0, ht: float = 0.0, *, tilted: bool = False) -> Array:
    """Return east, north, up of a sight, in the horizon of the ellipsoid or of the plumb line."""
    phi, lam = np.radians(TRUE[a][:2])
    up_a, up_b = axes(phi, lam)[2], axes(*np.radians(TRUE[b][:2]))[2]
    d = xyz(TRUE[b]) + ht * up_b - xyz(TRUE[a]) - hi * up_a
    if tilted:
        phi, lam = phi + XI * ARCSEC, lam + ETA * ARCSEC / math.cos(phi)
    return axes(phi, lam) @ d


def azimuth(a: str, b: str, *, tilted: bool = False) -> float:
    e, n, _ = sight(a, b, tilted=tilted)
    return math.degrees(math.atan2(e, n)) % 360.0


def zenith(a: str, b: str, k: float) -> float:
    q = sight(a, b, tilted=True)
    angle = math.acos(q[2] / np.linalg.norm(q))
    normals = [axes(*np.radians(TRUE[n][:2]))[2] for n in (a, b)]
    return math.degrees(angle - k * math.asin(np.linalg.norm(np.cross(*normals))))


def dms(degrees: float) -> str:
    minutes, seconds = divmod(degrees * 3600.0, 60.0)
    whole, minutes = divmod(int(minutes), 60)
    return f"{whole} {minutes} {seconds:.7f}"


def true_readings() -> str:
    """Return exact readings of every type in all forms of lines, by formulas of this file."""
    geod = pytest.importorskip("pyproj").Geod(ellps="GRS80")
    lines = ["Exact readings", "#date 1 Mar 2001", "#ds_error 3 mm 2 ppm", "#data SD"]
    length = np.linalg.norm(sight("A", "B", 1.5, 1.6))
    lines += [f"A 1.5 B 1.6 {length:.6f}", "#data HD no_heights"]
    for b in "CD":
        mean = 0.5 * (TRUE["A"][2] + TRUE[b][2])
        ends = [xyz((*TRUE[n][:2], mean)) for n in ("A", b)]
        lines.append(f"A {b} {np.linalg.norm(ends[1] - ends[0]):.6f}")
    lines.append("#data ED no_heights")
    pairs = [("B", "C"), ("C", "D"), ("B", "D")]
    for a, b in pairs:
        arc = geod.inv(TRUE[a][1], TRUE[a][0], TRUE[b][1], TRUE[b][0])[2]
        lines.append(f"{a} {b} {arc:.6f}")
    lines.append("#data DR no_heights")
    lines += ["D", *(f"{b} {1.00002 * np.linalg.norm(sight('D', b)):.6f}" for b in "ABC")]
    lines += ["#ha_error 2 sec", "#data HA no_heights"]
    for a in "ABC":
        lines.append(a)
        lines += [f"{b} {dms((azimuth(a, b, tilted=True) + 17.0) % 360.0)}" for b in TRUE if b != a]
    lines += ["#zd_error 3 sec", "#data ZD no_heights", f"A B {dms(zenith('A', 'B', 0.075))}"]
    lines += ["#refraction_coefficient wet", "#hp_angles"]
    for a, b in (("B", "D"), ("D", "B"), ("C", "A"), ("D", "C")):
        degrees, minutes, seconds = dms(zenith(a, b, 0.2)).split()
        packed = f"{int(minutes):02d}{float(seconds):010.7f}".replace(".", "")
        lines.append(f"{a} {b} {degrees}.{packed}")
    lines += ["#deg_angles", "#az_error 2 sec", "#data AZ no_heights"]
    lines.append(f"A D {azimuth('A', 'D'):.10f}")
    lines += ["#bearing_orientation_error turned"]
    lines += [f"{a} {b} {azimuth(a, b) + 0.01:.10f}" for a, b in pairs]
    lines += ["#lv_error 2 mm", "#data LV no_heights"]
    height = {n: TRUE[n][2] - GEOID[n] for n in TRUE}
    lines += [f"{a} {b} {height[b] - height[a]:.6f}" for a, b in pairs]
    lines += ["#oh_error 5 mm", "#data OH", f"D 1.2 {height['D'] + 1.2:.6f}"]
    lines += ["#eh_error 5 mm", "#data EH", f"C 1.1 {TRUE['C'][2] + 1.1:.6f}"]
    lines += ["#lt_error 0.001 sec", "#ln_error 0.001 sec", "#data LT LN no_heights"]
    lines += [f"B {TRUE['B'][0]:.12f} {TRUE['B'][1]:.12f}"]
    lines += ["#gps_enu_error 5 5 9 mm", "#data GB no_heights"]
    lines += [f"A C {' '.join(f'{v:.6f}' for v in xyz(TRUE['C']) - xyz(TRUE['A']))}"]
    return "\n".join(lines) + "\n"


def station_lines(shift: float) -> str:
    """Return the coordinate file, coordinates away from the truth by some metres."""
    lines = ["Known stations", "NZGD2000(20180701)", "options orthometric_heights geoid degrees"]
    for i, (name, (phi, lam, h)) in enumerate(TRUE.items()):
        away = 0.0 if name == "A" else shift * (1.0 - 0.6 * i)
        at = phi + away / 111e3, lam - away / 90e3, h - GEOID[name] + 0.3 * away
        lines.append(f"{name} {at[0]:.12f} {at[1]:.12f} {at[2]:.6f} {XI} {ETA} {GEOID[name]}")
    return "\n".join(lines) + "\n"


def test_exact_readings_of_every_type_give_the_stations_and_parameters(tmp_path: Path) -> None:
    """Coordinates 3 m away; formulas of the readings are those of this file."""
    parameters = (
        "deformation none\nfix A\nrefraction_coefficient calculate WET\n"
        "bearing_orientation_error TURNED 0 ?\n"
    )
    path = job(tmp_path, parameters, station_lines(3.0), true_readings())
    solution = fga.adjust(fga.read(path))
    for name, place in TRUE.items():
        assert solution.point(name) == pytest.approx(xyz(place), abs=TENTH_MM), name
    assert solution.unknown("refraction", "WET").values[0] / 2 == pytest.approx(0.2, abs=1e-3)
    error = -math.degrees(solution.unknown("gyro", "TURNED").values[0])
    assert error == pytest.approx(0.01, abs=1e-6)
    (meter,) = solution.network.of_kind("edm")
    assert solution.unknown("edm", meter).values[0] == pytest.approx(2e-5, abs=1e-7)
    assert solution.vtpv < 0.02


def test_bearings_count_from_grid_north_with_the_curvature_of_their_line(tmp_path: Path) -> None:
    """The bearing between coordinates of NZTM by PROJ, from which the azimuth is 1.1° away."""
    pyproj = pytest.importorskip("pyproj")
    grid = pyproj.Transformer.from_crs("EPSG:4167", "EPSG:2193", always_xy=True)
    (e1, n1), (e2, n2) = (grid.transform(TRUE[n][1], TRUE[n][0]) for n in "AD")
    bearing = math.degrees(math.atan2(e2 - e1, n2 - n1))
    assert abs(bearing - azimuth("A", "D")) > 1.0
    text = (
        f"Bearing\n#deg_angles\n#projection NZTM\n#data PB error no_heights\nA D {bearing} 0.001\n"
    )
    network = fga.read(job(tmp_path, "deformation none\nfix all\n", station_lines(0.0), text))
    (observation,) = network.observations.values()
    assert math.degrees(observation.value) == pytest.approx(azimuth("A", "D"), abs=1e-8)


def test_coordinates_of_a_projection_and_geocentric_ones_are_those_of_latitude_and_longitude(
    tmp_path: Path,
) -> None:
    pyproj = pytest.importorskip("pyproj")
    grid = pyproj.Transformer.from_crs("EPSG:4167", "EPSG:2105", always_xy=True)
    in_grid, cartesian = [], []
    for name, (phi, lam, h) in TRUE.items():
        e, n = grid.transform(lam, phi)
        in_grid.append(f"{name} {e:.5f} {n:.5f} {h}")
        cartesian.append(f"{name} {' '.join(f'{v:.5f}' for v in xyz((phi, lam, h)))}")
    readings = "Heights\n#eh_error 1 mm\n#data EH no_heights\nA 60.0\n"
    for code, lines in (("EDENTM2000", in_grid), ("NZGD2000_XYZ", cartesian)):
        text = "\n".join(["Stations", code, "no_geoid ellipsoidal_heights", *lines])
        network = fga.read(job(tmp_path, "deformation none\nfix all\n", text, readings))
        for name, place in TRUE.items():
            assert network.points[name].coordinates == pytest.approx(xyz(place), abs=TENTH_MM)
        assert (network.crs is not None) == (code == "EDENTM2000")


def test_the_table_of_systems_has_ellipsoids_and_projections_of_proj() -> None:
    """Names of EPSG: circuits of both datums, with the ellipsoid of the table."""
    pyproj = pytest.importorskip("pyproj")
    projections = [s for s in SNAP_SYSTEMS.values() if s.epsg is not None]
    assert len(projections) > 90
    for system in projections:
        crs = pyproj.CRS.from_epsg(system.epsg)
        assert crs.name.startswith({"NZGD2000": "NZGD2000", "NZGD1949": "NZGD49"}[system.datum])
        assert crs.ellipsoid.semi_major_metre == pytest.approx(system.ellipsoid.a)
    known = {"WELLTM2000": "Wellington 2000", "BLUFTM1949": "Bluff Circuit", "NZTM": "Mercator"}
    for code, name in known.items():
        assert name in pyproj.CRS.from_epsg(SNAP_SYSTEMS[code].epsg).name


# -- commands -------------------------------------------------------------------------------------


def observed(network: fga.Network, kind: str) -> list[fga.Observation]:
    return [o for o in network.observations.values() if o.kind == kind]


def test_errors_are_those_of_items_and_commands_times_their_factors(tmp_path: Path) -> None:
    network = fga.read(job(tmp_path, JOB.partition("mode")[2].partition("\n")[2]))
    assert [o.sigma for o in observed(network, "slope_distance")] == [0.005, 0.005]
    (zenith_angle,) = observed(network, "zenith_angle")
    assert zenith_angle.sigma == pytest.approx(1.5 * 4.0 * ARCSEC)
    (levelled,) = observed(network, "ellipsoid_height_difference")
    assert levelled.sigma == pytest.approx(1.5 * 0.008)
    (bearing,) = observed(network, "geodetic_azimuth")
    assert bearing.sigma == pytest.approx(math.radians(0.01))
    assert math.degrees(bearing.value) == pytest.approx(131.3 - 12.0 / 3600.0)
    # Directions: 3″ and 2 mm over the level distance, 1 394 m to station 3 and 590 m from 3 to 4.
    directions = observed(network, "direction")
    assert len(directions) == 4
    ends = [np.array(network.points[n].coordinates) for n in "13"]
    level = math.sqrt(np.sum((ends[1] - ends[0]) ** 2) - 30.0**2)
    assert directions[1].sigma == pytest.approx(math.hypot(3.0 * ARCSEC, 0.002 / level))


def test_vectors_of_a_group_have_the_stated_errors_between_any_two_stations(tmp_path: Path) -> None:
    """σ² of the vector 2 → 3 follows from the joint covariance: that of its own length."""
    network = fga.read(job(tmp_path, "fix all\n"))
    ((members, covariance),) = network.clusters
    between = np.hstack([-np.eye(3), np.eye(3)])
    found = np.sqrt(np.linalg.eigvalsh(between @ covariance @ between.T))
    first, second = (np.array(network.observations[m].value) for m in members)
    length = np.linalg.norm(second - first)
    stated = [math.hypot(0.004, 1e-6 * length), math.hypot(0.009, 2e-6 * length)]
    assert found == pytest.approx([stated[0], stated[0], stated[1]], rel=1e-9)


def test_a_reference_frame_is_applied_to_its_observations(tmp_path: Path) -> None:
    """observed = (1 + s) R (X + t), R with the signs of the National Geodetic Survey."""
    true = np.array([-4800000.0, 600000.0, -4160000.0])
    rx, ry, rz = (v * ARCSEC for v in (0.3, -0.2, 0.1))
    turn = np.array([[1.0, rz, -ry], [-rz, 1.0, rx], [ry, -rx, 1.0]])
    seen = (1.0 + 2e-6) * turn @ (true + np.array([1.0, 2.0, 3.0]))
    position = "Position\n#reference_frame X\n#gx_enu_error 5 5 9 mm\n#data GX no_heights\n4 "
    text = position + " ".join(f"{v:.6f}" for v in seen) + "\n"
    stated = "translation 1 2 3 scale 2 rotation 0.3 -0.2 0.1"
    network = fga.read(job(tmp_path, f"fix all\nreference_frame X {stated}\n", readings=text))
    (observation,) = network.observations.values()
    # The matrix of small angles is one of rotation to their squares: 1 µrad² · 6 Mm.
    assert observation.value == pytest.approx(true, abs=TENTH_MM)
    iers = "IERS_TSR 1000 2000 3000 2000 -300 200 -100"
    network = fga.read(job(tmp_path, f"fix all\nreference_frame X {iers}\n", readings=text))
    (observation,) = network.observations.values()
    assert observation.value == pytest.approx(true, abs=TENTH_MM)


RATES = (
    "translation 1.2 -0.3 15.8 scale 2.5 rotation 0 0 0 epoch 2008 "
    "translation_rate -0.12 0.03 -1.58 scale_rate -0.25 rotation_rate 3 -0.5 6.5"
)
RATE_STATIONS = """Stations of testrf1
NZGD1949
no_geoid ellipsoidal_heights
1 41 00 46.8000000 S 173 19 15.6000000 E 150.0
2 34 00 25.2000000 S 173 19 40.8000000 E 250.0
3 41 00 28.8000000 S 163 19 58.8000000 E  70.0
"""
RATE_READINGS = """Ten years after the epoch of the frame
#date 1 Jan 2018
#reference_frame GPS_rate
#gx_enu_error 40 60 120 mm
#data GX no_heights
1 -4787188.5515 561498.5759 -4163647.4692
2 -5257306.6538 616140.5375 -3547246.5749
3 -4617434.7161 1383348.3782 -4163299.6013
"""


@pytest.mark.published
def test_rates_of_a_frame_move_its_matrix_at_the_date(tmp_path: Path) -> None:
    """Lines of testrf1 (github.com/linz/snap, BSD-3), whose residuals e, n, u SNAP prints.

    After ten years the frame is the rotation 30″ −5″ 65″ alone. The same readings in a frame that
    is stated so have in SNAP's listing the residuals that they have here in both. In the frame with
    rates SNAP moves T₀x instead of x: T₀x + (T₁₀ − T₀) T₀x, and prints 2 to 3 mm.
    """
    path = job(
        tmp_path, f"fix all\nreference_frame GPS_rate {RATES}\n", RATE_STATIONS, RATE_READINGS
    )
    network = fga.read(path)
    printed = 1e-4 * np.array([[0, 2, -2], [1, -3, 1], [-4, -1, 1]])
    printed_with_rates = 1e-4 * np.array([[22, 1, -2], [29, -5, 1], [18, 2, 1]])
    scale = 1.0 + 2.5e-6
    angles = -np.diag([30.0, -5.0, 65.0]) * ARCSEC
    turn = np.linalg.multi_dot(list(exp_rotation(angles)))
    readings = [line.split()[1:] for line in RATE_READINGS.splitlines()[-3:]]
    for i, observation in enumerate(network.observations.values()):
        at = np.array(network.points[observation.point].coordinates)
        axes = network.frame.basis(at[None], np.zeros((1, 2))).enu[0]
        residual = axes @ (np.array(observation.value) - at)
        np.testing.assert_allclose(residual, printed[i], atol=TENTH_MM)
        moved = scale * at
        in_snap = moved + (turn - scale * np.eye(3)) @ moved
        found = axes @ (np.array(readings[i], dtype=float) - in_snap)
        np.testing.assert_allclose(found, printed_with_rates[i], atol=TENTH_MM)


@pytest.mark.parametrize("sort", ["geocentric", "topocentric"])
def test_unknown_parameters_of_a_reference_frame_come_back(tmp_path: Path, sort: str) -> None:
    """Positions and a vector of held stations, moved by T (X + t) of the formulas above."""
    rotation = np.array([0.4, -0.3, 0.2]) * ARCSEC
    rx, ry, rz = rotation
    turn = exp_rotation(-rotation[None])[0]
    assert turn == pytest.approx(np.array([[1, rz, -ry], [-rz, 1, rx], [ry, -rx, 1]]), abs=1e-10)
    network = fga.read(job(tmp_path, "fix all\n"))
    at = {n: np.array(p.coordinates) for n, p in network.points.items()}
    shift, scale = np.array([1.0, -2.0, 0.5]), 1.0 + 3e-6
    lines = ["Frame", "#reference_frame X", "#gx_enu_error 1 1 1 mm", "#data GX"]
    for name, xyz_of in at.items():
        normal = network.frame.basis(xyz_of[None], np.zeros((1, 2))).enu[0, 2]
        seen = scale * turn @ (xyz_of + 1.5 * normal + shift)
        lines.append(f"{name} 1.5 {' '.join(f'{v:.7f}' for v in seen)}")
    vector = scale * turn @ (at["4"] - at["2"])
    lines += ["#gps_enu_error 1 1 1 mm", "#data GB no_heights"]
    lines += [f"2 4 {' '.join(f'{v:.7f}' for v in vector)}"]
    stated = f"reference_frame X {sort} calculate translation scale rotation"
    path = job(tmp_path, f"fix all\n{stated}\n", readings="\n".join(lines) + "\n")
    solution = fga.adjust(fga.read(path))
    assert solution.redundancy == 15 - 7
    assert solution.vtpv < 1e-4
    values = solution.unknown("frame", "X").values
    # Stations within 1.7 km, to 0.1 µm: angles to 1e-9, and their sign is that of R, not of Rᵀ.
    assert np.array(values[:3]) == pytest.approx(rotation, abs=1e-9)
    assert values[6] == pytest.approx(-3e-6, abs=1e-9)


def test_a_set_of_positions_may_have_an_unknown_translation(tmp_path: Path) -> None:
    """The mean shift leaves the residuals; that of a set without the option does not."""
    network = fga.read(job(tmp_path, "fix all\n"))
    lines = ["Sets", "#gx_enu_error 1000 1000 1000 mm"]
    for shift in (0.0, 5.0):
        lines.append("#data GX grouped no_heights")
        for name in "123":
            place = np.array(network.points[name].coordinates) + shift
            lines.append(f"{name} {' '.join(f'{v:.6f}' for v in place)}")
    option = "set_observation_option calculate_gx_translation"
    text = "\n".join(lines) + "\n"
    both = fga.adjust(fga.read(job(tmp_path, f"fix all\n{option}\n", readings=text)))
    assert (both.redundancy, both.vtpv) == (12, pytest.approx(0.0, abs=1e-6))
    moved = both.unknown("frame", "translation 2").values[3:6]
    assert np.array(moved) == pytest.approx([-5.0] * 3, abs=1e-5)
    # Without the option: nine components of 5 m with σ 1 m.
    assert summary(fga.read(job(tmp_path, "fix all\n", readings=text))).squares == pytest.approx(
        9 * 25.0, abs=1e-3
    )


@pytest.mark.parametrize(
    ("commands", "held", "floated"),
    [
        ("fix 1", {"1": "eu"}, {}),
        ("fix 1-3", {"1": "eu", "2": "eu", "3": "eu"}, {}),
        ("fix all except order=2", {"1": "eu", "2": "eu"}, {}),
        ("fix all\nfree vertical mark=T*", {"1": "eu", "2": "eu", "3": "e", "4": "e"}, {}),
        ("fix horizontal all and mark=pin", {"1": "e", "2": "e"}, {}),
        ("mode 1d adjustment\nfix 4", {"1": "e", "2": "e", "3": "e", "4": "eu"}, {}),
        ("mode horizontal adjustment\nfix 4", {"1": "u", "2": "u", "3": "u", "4": "eu"}, {}),
        ("fix 1\nvertical_float_error 0.2\nfloat vertical 3", {"1": "eu"}, {"3": 0.2}),
        ("fix ?\nfree inside NZGD1949 part", {"1": "eu", "3": "eu"}, {}),
        ("fix all\nfree outside NZGD1949 round", {"2": "eu", "4": "eu"}, {}),
        ("fix @held", {"2": "eu", "4": "eu"}, {}),
    ],
)
def test_stations_are_fixed_free_or_floated(
    tmp_path: Path, commands: str, held: dict[str, str], floated: dict[str, float]
) -> None:
    """A station that is fixed in plan or height alone is observed there with 1 µm."""
    (tmp_path / "part.wkt").write_text("POLYGON((172.9 -41.011,173.5 -41.011,173.5 -41.0055,"
                                       "172.9 -41.0055,172.9 -41.011))\n")  # fmt: skip
    turned = (tmp_path / "part.wkt").read_text().replace("17", "53")
    (tmp_path / "round.wkt").write_text(turned)
    (tmp_path / "held.stl").write_text("! held\n2\n4\n")
    plan = "#ln_error 1 sec\n#lt_error 1 sec\n#data LT LN EH error no_heights\n"
    lines = "".join(f"{n} 41 00 20 S 173 00 00 E 130 0.1\n" for n in "1234")
    network = fga.read(job(tmp_path, f"{commands}\n", readings=f"Places\n{plan}{lines}"))
    found: dict[str, str] = {n: "eu" for n, p in network.points.items() if all(p.fixed)}
    for o in network.observations.values():
        if is_held(o):
            found[o.point] = found.get(o.point, "") + o.axes.replace("en", "e")
    assert found == held
    weighted = {
        o.point: o.sigma[0]
        for o in network.observations.values()
        if o.kind == "control" and o.sigma[0] != HELD_SIGMA_M
    }
    assert weighted == floated


@pytest.mark.parametrize(
    ("commands", "kinds"),
    [
        ("", {"slope_distance": 2, "direction": 4, "gnss_vector": 2}),
        ("reject 3", {"slope_distance": 1, "direction": 1, "gnss_vector": 1}),
        ("ignore_observations data_type=SD/GB", {"direction": 4}),
        ("reject_observations tool=T2", {"slope_distance": 0, "gnss_vector": 2}),
        ("reject_observations using_stations 2", {"slope_distance": 1, "gnss_vector": 1}),
        ("reject_observations between_stations 1 2", {"slope_distance": 1, "direction": 3}),
        ("ignore_observations before 2009-01-01", {"slope_distance": 0, "direction": 0}),
        ("ignore_observations after 2009-01-01", {"slope_distance": 2, "direction": 4}),
        ("classification data_type ignore HA", {"slope_distance": 2, "direction": 0}),
        ("reject_observations data_file=*.dat data_type=HA", {"direction": 0, "gnss_vector": 2}),
        ("recode 2 to 2B\nreject_observations using_stations 2B", {"slope_distance": 1}),
        ("classification tool reject T1/T2", {"slope_distance": 2}),
        ("classification tool reject T2 error_factor 2", {"slope_distance": 0}),
        ("recode 2 to *", {"slope_distance": 1, "gnss_vector": 1}),
        ("recode 2 to *2 after 2008-01-01", {"slope_distance": 1, "gnss_vector": 1}),
        ("recode 2 to *2 before 2008-01-01", {"slope_distance": 2, "gnss_vector": 2}),
    ],
)
def test_observations_are_left_out_by_criteria(
    tmp_path: Path, commands: str, kinds: dict[str, int]
) -> None:
    network = fga.read(job(tmp_path, f"fix all\n{commands}\n"))
    assert {k: len(observed(network, k)) for k in kinds} == kinds
    assert network.left_out


def test_heights_of_antennas_are_added_by_criteria(tmp_path: Path) -> None:
    command = "fix all\ngps_antenna_height 0.25 m data_type=GB using_stations 2\n"
    network = fga.read(job(tmp_path, command))
    heights = {
        o.target: (o.instrument_height, o.target_height) for o in observed(network, "gnss_vector")
    }
    # The antenna of station 2 alone is higher: ``obsmod.c`` of SNAP takes the ends one by one.
    assert heights == {"2": (0.0, 0.25), "3": (0.0, 0.0)}
    both = "fix all\ngps_antenna_height 0.25 m data_type=GB\n"
    vectors = observed(fga.read(job(tmp_path, both)), "gnss_vector")
    assert {(o.instrument_height, o.target_height) for o in vectors} == {(0.25, 0.25)}


FURTHER_STATIONS = """Stations of testom30 and testom35
NZGD1949
options ellipsoidal_heights no_deflections no_geoid
1 41 00 43.456933 S 173 19 16.231453 E   -47.3042
2 41 00 21.856404 S 173 19 41.431894 E    52.7059
3 41 00 25.456562 S 173 19 59.432056 E  -127.2952
"""
FURTHER_POSITIONS = """Positions
#gx_enu_error 40 60 120 mm 20 30 50 mmr
#data GX grouped no_heights
1 -4787185.5859 560571.4708 -4163474.5066
2 -4787763.2856 560046.1603 -4163037.2916
3 -4787604.8448 559604.1132 -4163002.9955
"""
FURTHER_VECTORS = """Vectors
#data GB no_heights grouped
#gb_enu_error 4 6 12 mm
1
2 -577.6996 -525.3105 437.215
3 -419.2589 -967.3576 471.511
"""
PLAIN, MOVED = (0.0982, 0.0414, 0.0908), (4.2424, 3.0207, 3.9870)
TOGETHER = (4.2424, 3.0207, 3.9871)


@pytest.mark.published
@pytest.mark.parametrize(
    ("commands", "readings", "printed"),
    [
        (
            "offset_error 3 5 m data_type=GX using_stations 2",
            FURTHER_POSITIONS,
            (PLAIN, MOVED, PLAIN),
        ),
        (
            "centroid_error 3 5 m data_type=GX using_stations 2",
            FURTHER_POSITIONS,
            (TOGETHER, TOGETHER, TOGETHER),
        ),
        (
            "offset_error 3 5 m using_stations 2\n"
            "reweight_observations offset_error 300 500 mm using_stations 3",
            FURTHER_VECTORS,
            ((4.2413, 3.0204, 3.9860), (0.4242, 0.3021, 0.3987)),
        ),
        (
            "offset_error 3 5 m using_stations 1\n"
            "reweight_observations offset_error 0.3 0.5 m using_stations 2",
            FURTHER_VECTORS,
            ((4.2623, 3.0355, 4.0061), (4.2411, 3.0205, 3.9862)),
        ),
    ],
)
def test_further_errors_of_vectors_are_those_of_the_listing(
    tmp_path: Path, commands: str, readings: str, printed: tuple[tuple[float, ...], ...]
) -> None:
    """testom30, 31, 35 (github.com/linz/snap, BSD-3): printed errors of X, Y, Z, to 0.1 mm.

    The error of the station from which a group of vectors starts is one of all its vectors.
    """
    path = job(tmp_path, f"fix all\nreweight_observations {commands}\n", FURTHER_STATIONS, readings)
    network = fga.read(path)
    found = [np.sqrt(np.diag(o.covariance)) for o in network.observations.values()]
    np.testing.assert_allclose(found, printed, atol=1.1 * TENTH_MM)
    ((_, joint),) = network.clusters
    if "using_stations 1" in commands or "centroid" in commands:
        up = network.frame.basis(
            np.array(network.points["1"].coordinates)[None], np.zeros((1, 2))
        ).enu[0, 2]
        assert up @ joint[:3, 3:6] @ up == pytest.approx(25.0, rel=1e-3)


def test_a_solution_in_sinex_is_a_set_of_positions(tmp_path: Path) -> None:
    """Coordinates and covariance are those of the solution that was written, codes with points."""
    network = fga.Network("solution", frame=GeocentricFrame("International1924"))
    given = fga.read(job(tmp_path, "fix all\n")).points
    for name in "12":
        network.add_point(f"STA{name}", given[name].coordinates)
        position = tuple(given[name].coordinates)
        network.add(fga.GnssPosition(f"STA{name}", position, sigma=(0.01, 0.02, 0.03)))
    step = np.subtract(given["2"].coordinates, given["1"].coordinates)
    network.add(fga.GnssVector("STA1", "STA2", tuple(step.tolist()), sigma=(0.001, 0.002, 0.003)))
    solution = fga.adjust(network)
    fga.write_sinex(solution, tmp_path / "solution.snx")
    codes = SITE.replace("\n1 41", "\nSTA1_A 41").replace("\n2 41", "\nSTA2 41")
    command = "data_file solution.snx sinex ref_frame=X error_factor 2\nfix all\nrecode {}\n"
    for option, first in (("", "STA1 to STA1_A"), (" code=POINT", "STA2_A to STA2")):
        text = command.format(first).replace("sinex", f"sinex{option}")
        read = fga.read(job(tmp_path, text, codes, "Nothing\n"))
        ((members, covariance),) = read.clusters
        assert [read.observations[m].point for m in members] == ["STA1_A", "STA2"]
        cross = solution.covariance("STA1", "STA2")
        assert covariance[:3, 3:] == pytest.approx(4.0 * cross, rel=1e-9)
        assert read.observations[members[0]].value == pytest.approx(given["1"].coordinates)
    with pytest.raises(fga.InputError, match="station 'STA2_A' is not in the coordinate file"):
        fga.read(job(tmp_path, text.replace("recode STA2_A", "recode STA9"), codes, "Nothing\n"))
    dated = command.format("STA1 to * before 1990-01-01").replace("sinex", "sinex date=1980-01-01")
    (only,) = observed(fga.read(job(tmp_path, dated, codes, "Nothing\n")), "gnss_position")
    assert only.point == "STA2"


def test_a_recoded_station_is_a_new_one_at_the_same_place(tmp_path: Path) -> None:
    network = fga.read(job(tmp_path, "fix all\nrecode suffix _B after 2008-01-01 for 3\n"))
    assert network.points["3_B"].coordinates == network.points["3"].coordinates
    assert {o.target for o in observed(network, "slope_distance")} == {"2", "3_B"}


@pytest.mark.parametrize(
    ("date", "code"),
    [
        ("1999", "1_0"),
        ("2000", "1_1"),
        ("2003", "1_2"),
        ("2006", "1"),
        ("2011", "1_3"),
        ("2013", "1_4"),
    ],
)
def test_the_recoding_next_to_a_date_counts(date: str, code: str) -> None:
    """Of ``before`` the first in time, of ``after`` the last, whatever their order in the job."""
    recodings = Recodings()
    years = {"1_4": (2012, None), "1_1": (None, 2001), "1_0": (None, 2000), "1_3": (2010, None),
             "1_2": (2002, 2004)}  # fmt: skip
    for new, ends in years.items():
        after, before = (None if y is None else datetime(y, 1, 1) for y in ends)
        recodings.add(Recoding("1", new, after, before))
    assert recodings.new_code("1", datetime(int(date), 6, 1)) == (code, False)
    assert recodings.new_code("1", None) == ("1", False)


def test_recoded_stations_are_at_one_place_within_the_errors_of_the_steps(tmp_path: Path) -> None:
    """1_A until 2000 and 1_B until 2001, of which no reading has 1_B: √(0.3² + 0.4²) in plan.

    Observed 50 m apart in latitude with 1 m each, the stations of the old and the new date keep
    50 m less the share of the condition: 50 · 2/(2 + 0.25) m.
    """
    recode = (
        "recode 1 to 1_A hv_error 0.3 0.6 m before 2000-01-01\n"
        "recode 1 to 1_B hv_error 0.4 0.8 m before 2001-01-01\nfix 2\n"
    )
    north = 50.0 / 30.84  # seconds of arc
    lines = ["Places", "#lt_error 0.03243 sec", "#ln_error 0.03243 sec", "#eh_error 1000 mm"]
    for year, shift in ((1999, 0.0), (2005, north)):
        lines += [f"#date 1 Jan {year}", "#data LT LN EH no_heights"]
        lines += [f"1 41 00 {shift:07.4f} S 173 00 00 E 120.0"]
    network = fga.read(job(tmp_path, recode, readings="\n".join(lines) + "\n"))
    (condition,) = observed(network, "coordinate_difference")
    assert {condition.station, condition.target} == {"1", "1_A"}
    assert condition.sigma == pytest.approx((0.5, 0.5, 1.0))
    solution = fga.adjust(network)
    assert solution.redundancy == 3
    d = solution.point("1") - solution.point("1_A")
    assert np.linalg.norm(d) == pytest.approx(50.0 * 0.25 / 2.25, rel=2e-3)


def test_stations_that_readings_do_not_locate_are_left_out(tmp_path: Path) -> None:
    """A distance alone does not locate station 3 in plan, and nothing concerns 4."""
    text = "Distance\n#ds_error 5 mm\n#data SD no_heights\n1 3 1393.2\n"
    network = fga.read(job(tmp_path, "fix 1 2\n", readings=text))
    assert set(network.points) == {"1", "2"}
    assert not network.observations
    named = {name for left in network.left_out for name in left.names}
    assert {"3", "4"} <= named


def test_files_are_included_from_their_own_folders(tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "part.inc").write_text('data_file "two words.dat"\nfix all\n')
    (tmp_path / "more" / "two words.dat").write_text(READINGS)
    path = job(tmp_path, "include more/part.inc\n")
    assert len(observed(fga.read(path), "slope_distance")) == 4


def test_modes_of_a_job_are_those_of_the_network(tmp_path: Path) -> None:
    checked = fga.read(job(tmp_path, "mode 3d data_check\n"))
    assert all(all(p.fixed) for p in checked.points.values())
    assert fga.read(job(tmp_path, "mode 3d free_net_adjustment\n")).datum == "free"


def test_a_file_is_a_job_by_its_commands(tmp_path: Path) -> None:
    path = job(tmp_path, "mode 3d adjustment\n").rename(tmp_path / "commands.txt")
    assert is_snap_job(path)
    assert not is_snap_job(tmp_path / "site.crd")
    assert not is_snap_job(tmp_path / "readings.dat")
    assert fga.read(path, format="snap").points


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("13 Jan 2008", "2008-01-13 00:00:00"),
        ("13-01-2008", "2008-01-13 00:00:00"),
        ("2008-01-13T12:50:25", "2008-01-13 12:50:25"),
        ("20080113", "2008-01-13 00:00:00"),
        ("31 Feb 2008", "None"),
        ("Jan 2008", "None"),
    ],
)
def test_dates_have_the_forms_of_the_manual(text: str, expected: str) -> None:
    assert str(parsed_date(text)) == expected


@pytest.mark.parametrize(
    ("first", "last", "inside", "outside"),
    [
        ("5", "15", "5 10 10A 15", "4 4B 15A 16 100 A"),
        ("C_10", "C_100", "C_11 c_99 C_10A", "C_9 C_101 D_11 11"),
        ("PIND", "TUBBY", "PINE QQ T2", "PIN TUBE U 7"),
    ],
)
def test_ranges_of_codes_go_by_their_numbers(
    first: str, last: str, inside: str, outside: str
) -> None:
    found = [
        c
        for c in (inside + " " + outside).split()
        if is_code_before(first, c) and is_code_before(c, last)
    ]
    assert found == inside.split()


# -- wrong files ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("commands", "problem"),
    [
        ("fxi 1", "site.snp:3: command 'fxi' is unknown"),
        ("fix 7", "site.snp:3: unknown station '7'; known: 1, 2, 3, 4"),
        ("fix", "site.snp:3: fix needs stations, or all"),
        ("mode 4d", "site.snp:3: mode '4d' is unknown"),
        ("deformation type=linz model=x", "the deformation model type=linz model=x applies"),
        ("geoid nzgeoid09", "the geoid nzgeoid09 is a grid of SNAP that is not read"),
        ("include none.inc", "site.snp:3: the included file 'none.inc' is not there"),
        ("data_file readings.dat csv", "the format definition obs.dtf is not there"),
        ("data_file readings.dat xml", "data_file as 'xml' is not read"),
        ("data_file readings.dat sinex", "is not SINEX: the first line must begin with %=SNX"),
        ("data_file readings.dat sinex code=X", "site.snp:3: code 'X' is unknown"),
        ("refraction_coefficient X", "site.snp:3: 'X' is not read; valid: use CLASS"),
        ("reference_frame X size 3", "word of reference_frame 'size' is unknown"),
        ("reference_frame WGS rotation 0 ? 0 0", "a rotation of which some components are known"),
        ("reference_frame WGS calculate scale_rate", "rates of change beside unknown parameters"),
        ("set_observation_option other", "option 'other' is unknown"),
        ("reweight_observations 2", "needs criteria of observations"),
        (
            "reweight_observations offset_error 2 data_type=GX",
            "needs one or two values and m or mm",
        ),
        ("reject_observations data_type=QQ", "data_type must be some of SD, HD"),
        ("reject_observations data_file=other.dat", "no data_file before this line"),
        ("recode 1 to 2 hv_error 0.1 before 2008-01-01", "hv_error needs one or two values and m"),
        ("recode 1 to 2 hv_error 0.1 m", "hv_error needs a date: before or after"),
        (
            "recode 1 to X after 2008-01-01\nrecode 1 to X after 2009-01-01",
            "site.snp:4: recode of 1 to X holds from two dates",
        ),
        ("recode 1 to 2 before yesterday", "are no dates"),
        ("horizontal_float_error 0", "must be greater than zero"),
    ],
)
def test_a_wrong_command_is_refused_with_its_line(
    tmp_path: Path, commands: str, problem: str
) -> None:
    with pytest.raises(fga.InputError) as caught:
        fga.read(job(tmp_path, f"{commands}\n"))
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("173 00 45.00 E", "173 60 45.00 E"), "site.crd:5: minutes of longitude must be less"),
        (("NZGD1949", "NZGD1848"), "site.crd:2: coordinate system 'NZGD1848' is unknown"),
        (("NZGD1949", "WELL"), "coordinates of WELL have in SNAP a unit of 0.999998261 m"),
        (("NZGD1949", "NZGD1949/NZVD2016"), "needs a title"),
        (("deflections ", "deviations "), "site.crd:3: option 'deviations' is unknown"),
        (("3 41 00 45", "2 41 00 45"), "site.crd:6: station '2' is there already, in line 5"),
    ],
)
def test_a_wrong_coordinate_file_is_refused_with_its_line(
    tmp_path: Path, change: tuple[str, str], problem: str
) -> None:
    if "NZVD2016" in change[1]:
        change, problem = ("geoid_heights ", "no_geoid "), "station"
        text = SITE.replace("NZGD1949", "NZGD1949/NZVD2016").replace("geoid_heights", "no_geoid")
        problem = "geoid heights of NZVD2016 are in a grid of SNAP that is not read"
    else:
        text = SITE.replace(*change)
    with pytest.raises(fga.InputError) as caught:
        fga.read(job(tmp_path, "fix all\n", text))
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("#lv_error 8 mm\n", ""), "the error of LV is not stated; valid: #lv_error before"),
        (("#lv_error 8 mm", "#lv_error 8 cm"), "#lv_error must be # mm"),
        (("3 4 60.05", "3 4 60.05 1"), "the line has 1 words too many, from '1'"),
        (("3 4 60.05", "3 4 60,05"), "value of LV: '60,05' is not a number"),
        (("3 4 60.05", "3 9 60.05"), "station '9' is not in the coordinate file"),
        (("3 4 60.05", "3 4"), "value of LV is missing"),
        (("45 20 11.5", "45 61 11.5"), "minutes of HA must be less than 60"),
        (("#data LV", "#data LW"), "item of #data 'LW' is unknown"),
        (("#data LV", "#data LV GB"), "cannot have LV, GB in one line"),
        (("#dms_angles", "#gon_angles"), "command # 'gon_angles' is unknown"),
        (("3 Feb 2008", "33 Feb 2008"), "date '33 Feb 2008' is none"),
        (("#classification tool\n", ""), "item of #data 'tool' is unknown"),
    ],
)
def test_a_wrong_data_file_is_refused_with_its_line(
    tmp_path: Path, change: tuple[str, str], problem: str
) -> None:
    assert change[0] in READINGS
    with pytest.raises(fga.InputError) as caught:
        fga.read(job(tmp_path, "fix all\n", readings=READINGS.replace(*change)))
    assert problem in str(caught.value)
    assert str(caught.value).startswith("readings.dat:")


def test_a_matrix_that_is_not_complete_is_refused(tmp_path: Path) -> None:
    text = (
        "Vectors\n#gps_error_type full\n#data GB error grouped no_heights\n1\n2 1 2 3\n3 4 5 6\n"
        "#end_set\n1 0 1\n0 0 1\n"
    )
    with pytest.raises(fga.InputError, match=r"has 6 elements of 21"):
        fga.read(job(tmp_path, "fix all\n", readings=text))


def test_the_deformation_model_of_a_datum_is_refused_unless_an_option_says_none(
    tmp_path: Path,
) -> None:
    readings = "Heights\n#eh_error 1 mm\n#data EH no_heights\nA 60.0\n"
    path = job(tmp_path, "fix all\n", station_lines(0.0), readings)
    with pytest.raises(fga.InputError, match="the deformation model of NZGD2000 applies"):
        fga.read(path)
    assert fga.read(path, deformation="none").points
