"""DynAdjust's fixed columns: every type and version, geoid, constraints, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.hostile.examples import Example
from tests.support.same import assert_same_network

WIDTHS = {  # of names, stations' coordinates, values and covariances, scales, frame and epoch
    "1.00": (10, 14, (14, 11), (14, 11, 11, 11), 10),
    "3.00": (20, 14, (14, 14), (7, 7, 7, 7), 14),
    "3.01": (20, 20, (20, 20), (10, 10, 10, 10), 20),
}
HALF_TENTH_MM = 0.5e-4
"""Half of the last printed digit of a length, metres."""


def columns(version: str = "3.01", *, gap: str = " ") -> tuple[str, str]:
    """Return the two files of a small network with all types, by the widths of a version."""
    n, c, (value, vcv), scale, frame = WIDTHS[version]
    apart = "" if version == "1.00" else gap
    header = "{}" if version == "1.00" else f"!#=DNA {version} {{}}    12.12.2018" + 7 * " "
    header += "" if version == "1.00" else "GDA2020    01.01.2020         3"

    def station(name: str, held: str, kind: str, *xyz: str, zone: str = "") -> str:
        after = " " if version == "1.00" else apart
        coordinates = "".join(f"{x:>{c}}" for x in xyz)
        return f"{name:<{n}}{held}{after}{kind}{coordinates}{zone:>3} {name} hill"

    def names(kind: str, *ends: str, mark: str = " ") -> str:
        return kind + mark + "".join(f"{e:<{n}}" for e in (*ends, "", "", "")[:3])

    def length(kind: str, *ends: str, v: str, s: float, heights: tuple[float, ...] = ()) -> str:
        between = {"1.00": 14, "3.00": 14, "3.01": 14}[version]
        high = "".join(f"{h:7.3f}" for h in heights)
        return names(kind, *ends) + f"{v:>14}" + between * " " + f"{s:9.3f}" + high

    def angle(kind: str, *ends: str, v: str, s: float, heights: tuple[float, ...] = ()) -> str:
        d, m, sec = v.split()
        width = (4, 4, 6) if version == "1.00" else (3, 3, 8)
        high = "".join(f"{h:7.3f}" for h in heights)
        dms = f"{d:>{width[0]}}{m:>{width[1]}}{sec:>{width[2]}}"
        return names(kind, *ends) + 14 * " " + dms + f"{s:9.3f}" + high

    def cluster(kind: str, *ends: str, scales: str = "1 1 1 1") -> str:
        factors = "".join(f"{x:>{w}}" for x, w in zip(scales.split(), scale, strict=True))
        return names(kind, *ends) + factors + f"{'GDA2020':>{frame}}{'01.01.2020':>{frame}}"

    def matrix(*rows: str) -> list[str]:
        out = []
        for row in rows:
            first, *rest = row.split()
            text = f"{'' if first == '.' else first:>{value}}"
            out.append((2 + 3 * n) * " " + text + "".join(f"{x:>{vcv}}" for x in rest))
        return out

    stations = [
        header.format("STN"),
        "* a comment",
        station("A", "CCC", "LLh", "-36.3000", "145.5700", "100.0"),
        station("B", "FFF", "XYZ", "-4253391.24", "2873283.50", "-3772921.36"),
        station("C", "FFF", "UTM", "407412.1", "5958610.4", "115.0", zone="55"),
    ]
    own = ("1.5 4e-6", "2.5 1e-6 4e-6", "3.5 0 0 9e-6")
    measurements = [
        header.format("MSR"),
        "* a comment",
        length("S", "A", "C", v="1000.125", s=0.003, heights=(1.5, 1.6)),
        angle("V", "A", "C", v="89 15 30.12", s=2.0, heights=(1.5, 1.6)),
        angle("Z", "A", "C", v="-0 15 30.12", s=2.0, heights=(1.5, 1.6)),
        angle("B", "A", "C", v="123 30 30.5", s=1.0),
        angle("K", "A", "C", v="123 30 31.5", s=1.0),
        angle("A", "A", "B", "C", v="30 15 00.0", s=1.0),
        angle("D", "A", "B", "2", v="0 0 0.0", s=1.0),
        angle("D", "", "", "C", v="30 15 00.0", s=1.5),
        angle("D", "", "", "B", v="1 00 00.0", s=1.5).replace("D ", "D*", 1),
        *(length(k, "A", "C", v="999.875", s=0.01) for k in "CEM"),
        length("L", "A", "C", v="12.345", s=0.002),
        length("H", "C", v="115.5", s=0.01),
        length("R", "C", v="120.25", s=0.01),
        length("P", "C", v="-36.3030", s=0.5),
        length("Q", "C", v="145.5745", s=0.5),
        length("I", "C", v="-36.3031", s=0.5),
        length("J", "C", v="145.5746", s=0.5),
        cluster("G", "A", "B", scales="2 1 1 1"),
        *matrix(*own),
        cluster("X", "A", "B", "2"),
        *matrix(*own, ". 1e-6 0 0", ". 0 1e-6 0", ". 0 0 1e-6"),
        names("X", "A", "C"),
        *matrix(*own),
        cluster("Y", "B", "LLh", "1"),
        *matrix("-36.2959 1e-12", "145.5730 0 4e-12", "110 0 0 0.01"),
        length("S", "A", "B", v="1", s=0.01).replace("S ", "S*", 1),
    ]
    if version == "1.00":  # has no header
        stations, measurements = stations[1:], measurements[1:]
    return "\n".join(stations) + "\n", "\n".join(measurements) + "\n"


def written(folder: Path, stations: str, measurements: str) -> Path:
    (folder / "net.stn").write_text(stations, encoding="utf-8")
    (folder / "net.msr").write_text(measurements, encoding="utf-8")
    return folder / "net.stn"


STATIONS, MEASUREMENTS = columns()
GEOID = "point,n,xi,eta\nA,4.7,-7.1,-4.1\nB,4.8,-7.0,-4.2\nC,4.9,-6.9,-4.3\n"
EXAMPLE_FILES = {
    "dynadjust": Example(
        "dynadjust",
        {"net.stn": STATIONS, "net.msr": MEASUREMENTS},
        "net.stn",
        {"geoid": 4.5},
        unread=(
            r"\|\*|\* a comment",  # comments
            r"12\.12\.2018|\|value\|3\|!#=DNA",  # date and count of the header
            r"hill",  # descriptions
            r"net.stn\|[^|]*\|01.01.2020\|",  # epoch of the stations
            r"\|[SD]\*",  # what is switched off
            r"!#=DNA[^|]*MSR",  # frame and epoch of clusters are in their lines
            r"\|value\|01\.01\.2020\|",  # epoch in the frame of the stations
        ),
    )
}


def read(folder: Path, stations: str = STATIONS, measurements: str = MEASUREMENTS, **options):  # type: ignore[no-untyped-def]
    return fga.read_dynadjust(written(folder, stations, measurements), **{"geoid": 4.5, **options})


def test_every_type_is_read(tmp_path: Path) -> None:
    network = read(tmp_path)
    assert [o.kind for o in network.observations.values()] == [
        *("slope_distance", "zenith_angle", "vertical_angle", "geodetic_azimuth", "azimuth"),
        *("horizontal_angle", "direction", "direction"),
        *("ellipsoid_distance", "ellipsoid_distance", "ellipsoid_distance"),
        *("ellipsoid_height_difference", "ellipsoid_height", "ellipsoid_height"),
        *("control", "control", "astronomic_latitude", "astronomic_longitude"),
        *("gnss_vector", "gnss_vector", "gnss_vector", "gnss_position"),
    ]
    found = list(network.observations.values())
    slope, zenith, vertical, azimuth = found[:4]
    assert (slope.value, slope.instrument_height, slope.target_height) == (1000.125, 1.5, 1.6)
    degrees = math.radians(15 / 60 + 30.12 / 3600)
    assert zenith.value == pytest.approx(math.radians(89) + degrees, abs=1e-15)
    assert vertical.value == pytest.approx(-degrees, abs=1e-15)
    assert azimuth.sigma == pytest.approx(ARCSEC)
    chord, arc, at_sea = found[8:11]
    assert [(o.line, o.station_surface) for o in (chord, arc, at_sea)] == [
        ("chord", 0.0),
        ("arc", 0.0),
        ("arc", 4.5),
    ]
    assert [str(left).split(":")[1][:12] for left in network.left_out] == [" 2 left out,"]
    assert all(network.points["A"].fixed) and not any(network.points["B"].fixed)
    (covariance,) = (c for _, c in network.clusters if c.shape == (6, 6))
    assert covariance[0, 3] == covariance[4, 1] == 1e-6 and covariance[0, 1] == 1e-6
    assert found[18].covariance[0, 0] == 8e-6  # scale V


@pytest.mark.parametrize("version", ["1.00", "3.00"])
def test_older_versions_have_the_same_network(tmp_path: Path, version: str) -> None:
    network = read(tmp_path)
    (tmp_path / version).mkdir()
    older = read(tmp_path / version, *columns(version))
    assert_same_network(older, network)


def test_both_syntaxes_are_one_network(tmp_path: Path) -> None:
    """The same records as elements and as columns."""
    from tests.networks import dynaml as xml

    network = xml.read(tmp_path, xml.HEAD + xml.STATIONS + xml.MEASUREMENTS + xml.TAIL)
    at = {"A": ("CCC", "-36.3000", "145.5700", "100.0"),
          "B": ("CCF", "-36.2959", "145.5730", "110.0"),
          "C": ("FFF", "-36.3030", "145.5745", "120.0")}  # fmt: skip
    stations = "!#=DNA 3.01 STN    01.01.2020       GDA2020\n" + "".join(
        f"{n:<20}{held} LLh{a:>20}{b:>20}{h:>20}\n" for n, (held, a, b, h) in at.items()
    )
    pair = f"{'A':<20}{'C':<20}{'':<20}"
    high = "  1.500  1.600\n"
    own = f"{'':62}{'1.5':>20}{'4e-6':>20}\n{'':62}{'2.5':>20}{'1e-6':>20}{'4e-6':>20}\n"
    own += f"{'':62}{'3.5':>20}{'0':>20}{'0':>20}{'9e-6':>20}\n"
    dms = "{:14}{:>4}{:>2}{:>8}{:>9}"
    measurements = "!#=DNA 3.01 MSR    01.01.2020       GDA2020\n" + "".join(
        [
            f"G {'A':<20}{'B':<40}{2:>10}\n{own}",
            f"S {pair}{'1000.125':>14}{'':14}{'0.003':>9}{high}",
            f"V {pair}{dms.format('', 91, 15, 30.123, 2)}{high}",
            f"Z {pair}{dms.format('', '-1', 15, 30.123, 2)}{high}",
            f"B {pair}{dms.format('', 123, 30, 30.5, 1)}\n",
            f"A {'A':<20}{'B':<20}{'C':<20}{dms.format('', 30, 15, 0, 1)}\n",
            f"D {'A':<20}{'B':<20}{2:<20}{dms.format('', 0, 0, 0, 1)}\n",
            f"D {'':40}{'C':<20}{dms.format('', 30, 15, 0, 1.5)}\n",
            f"D*{'':40}{'B':<20}{dms.format('', 1, 0, 0, 1.5)}\n",
            f"R {'C':<60}{'120.25':>14}{'':14}{'0.01':>9}\n",
            f"P {'C':<60}{'-36.3030':>14}{'':14}{'0.5':>9}\n",
            f"Q {'C':<60}{'145.5745':>14}{'':14}{'0.5':>9}\n",
            f"I {'C':<60}{'-36.3031':>14}{'':14}{'0.5':>9}\n",
            f"J {'C':<60}{'145.5746':>14}{'':14}{'0.5':>9}\n",
        ]
    )
    same = read(tmp_path, stations, measurements, geoid=None)

    def heights(text: object) -> object:  # azimuths in columns have no heights
        return {**vars(text), "instrument_height": 0, "target_height": 0, "source": "", "id": ""}

    one, other = (list(n.observations.values()) for n in (network, same))
    assert len(one) == len(other) == 14
    for a, b in zip(one, other, strict=True):
        x, y = heights(a), heights(b)
        if getattr(a, "covariance", None) is not None:
            np.testing.assert_array_equal(x.pop("covariance"), y.pop("covariance"))  # type: ignore[attr-defined]
        assert x == y
    for name, point in network.points.items():
        assert same.points[name].coordinates == point.coordinates


def residuals(network: fga.Network) -> Array:
    """Return v of all scalar observations at the stations of the file, SI."""
    equations = compile_network(network)
    return equations.residuals(equations.unknowns.start(), whitened=False)


DSG_STATIONS = """!#=DNA 3.01 STN    08.08.2020       GDA2020    01.01.2020        13
409600170           FFF LLh      -34.1653411205      140.5338834181             49.4570
309100090           FFF LLh      -34.1736568897      141.2222094911             67.3200
365300060           FFF LLh      -34.1445174978      141.4600868068             64.3830
236300210           CCC LLh      -34.3007504493      142.1121017591             62.4850
212000820           FFF LLh      -35.3043378405      143.4625024111             88.0000
"""
DSG_MEASUREMENTS = """!#=DNA 3.01 MSR    08.08.2020       GDA2020    01.01.2020        43
B 309100090           236300210                                             107 21 43.7701    0.010
C 365300060           212000820                                  231035.5800                  0.456
E 309100090           236300210                                   78551.6573                  0.266
E 409600170           236300210                                  121577.7233                  0.331
"""
"""Stations of the network dsg and measurements that DynAdjust's simulator made of them (sampleData
of icsm-au/DynAdjust, Apache-2.0: dsg.stn, dsg-retained.msr)."""


def test_chords_arcs_and_azimuths_are_those_of_dynadjust(tmp_path: Path) -> None:
    """Published: up to 231 km to the printed 0.1 mm, azimuths to 0.0001"."""
    v = residuals(read(tmp_path, DSG_STATIONS, DSG_MEASUREMENTS, geoid=None))
    azimuth, chord, arc, far = v
    assert abs(azimuth) < 2e-4 * ARCSEC
    assert abs(chord) < HALF_TENTH_MM
    assert abs(arc) < HALF_TENTH_MM
    assert abs(far) < 2 * HALF_TENTH_MM  # the radius of DynAdjust is that of the mean latitude


def test_utm_is_the_map_grid(tmp_path: Path) -> None:
    """Published: station 33295 of the network urban, which is held (urban.phased.adj.expected)."""
    stations = (
        "!#=DNA 3.01 STN    12.12.2018         GDA94    01.01.1994       149\n"
        f"{'33295':<20}CCC UTM{'319941.0840':>20}{'5814343.2469':>20}{'100.0000':>20} 55\n"
    )
    network = read(tmp_path, stations, "!#=DNA 3.01 MSR\n", geoid=4.7874)
    xyz = np.array(network.points["33295"].coordinates)
    listing = [-4131246.8213, 2897591.0714, -3888040.0804]
    np.testing.assert_allclose(xyz, listing, rtol=0, atol=2 * HALF_TENTH_MM)  # and N of 4 digits


def test_a_northern_zone_is_north(tmp_path: Path) -> None:
    stations = (
        f"!#=DNA 3.01 STN\n{'P':<20}CCC UTM{'500000':>20}{'5000000':>20}{'0':>20}{'N32':>3}\n"
    )
    network = read(tmp_path, stations, "!#=DNA 3.01 MSR\n")
    assert network.points["P"].coordinates[2] > 4e6


def test_deflections_reduce_what_refers_to_plumb_lines(tmp_path: Path) -> None:
    """Classic corrections: Laplace of K, ξ cos α + η sin α of zeniths, none of B."""
    (tmp_path / "geoid.csv").write_text(GEOID)
    network = read(tmp_path, geoid=str(tmp_path / "geoid.csv"))
    plain = read(tmp_path, geoid=0.0)
    for name, point in plain.points.items():
        network.points[name] = point
    reduced = dict(
        zip(
            network.observations,
            zip(residuals_by(network), residuals_by(plain), strict=True),
            strict=True,
        )
    )
    change = {
        o.kind: a - b
        for (i, o), (a, b) in zip(network.observations.items(), reduced.values(), strict=True)
    }
    frame = network.frame
    assert isinstance(frame, fga.GeocentricFrame)
    a, c = (np.array(network.points[n].coordinates) for n in "AC")
    e, n, u = frame.basis(a[None], np.zeros((1, 2))).enu[0] @ (c - a)
    alpha, cot = math.atan2(e, n), u / math.hypot(e, n)
    xi, eta = -7.1 * ARCSEC, -4.1 * ARCSEC
    latitude = float(frame.ellipsoid.to_geodetic(a)[0])
    small = 2e-3 * ARCSEC
    laplace = eta * math.tan(latitude) + (xi * math.sin(alpha) - eta * math.cos(alpha)) * cot
    assert change["azimuth"] == pytest.approx(laplace, abs=small)
    along = xi * math.cos(alpha) + eta * math.sin(alpha)
    high = 0.02 * ARCSEC  # instruments stand along plumb lines: 1.6 m · 8" in 1 km
    assert change["zenith_angle"] == pytest.approx(-along, abs=high)
    assert change["vertical_angle"] == pytest.approx(along, abs=high)
    assert change["geodetic_azimuth"] == 0.0
    assert change["ellipsoid_height_difference"] == pytest.approx(4.7 - 4.9, abs=1e-9)


def residuals_by(network: fga.Network) -> list[float]:
    """Return v of the first component of each observation at the given stations."""
    equations = compile_network(network)
    v = equations.residuals(equations.unknowns.start(), whitened=False)
    first: dict[str, float] = {}
    for row in range(equations.n_rows):
        first.setdefault(equations.id(row), float(v[row]))
    return [first[i] for i in network.observations]


def test_positions_in_latitude_and_longitude_have_variances_in_square_radians(
    tmp_path: Path,
) -> None:
    network = read(tmp_path)
    (position,) = (o for o in network.observations.values() if o.kind == "gnss_position")
    frame = network.frame
    assert isinstance(frame, fga.GeocentricFrame)
    xyz = np.array(position.value)
    assert frame.ellipsoid.to_geodetic(xyz)[2] == pytest.approx(110.0, abs=1e-8)  # LLh
    enu = frame.basis(xyz[None], np.zeros((1, 2))).enu[0]
    latitude = float(frame.ellipsoid.to_geodetic(xyz)[0])
    m, n = (float(r) for r in frame.ellipsoid.radii(np.array(latitude)))
    sigma = np.sqrt(np.diag(enu @ position.covariance @ enu.T))
    across = 2e-6 * (n + 110.0) * math.cos(latitude)
    np.testing.assert_allclose(sigma, [across, 1e-6 * (m + 110.0), 0.1], rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "held", "axes"),
    [("LLh", "CFF", "n"), ("LLh", "FCC", "eu"), ("UTM", "CFF", "e"), ("UTM", "FCF", "n")],
)
def test_letters_of_constraints_follow_the_coordinates(
    tmp_path: Path, kind: str, held: str, axes: str
) -> None:
    at = {"LLh": ("-36.3000", "145.5700", "100"), "UTM": ("407412.1", "5958610.4", "115")}[kind]
    row = f"{'P':<20}{held} {kind}" + "".join(f"{x:>20}" for x in at) + " 55\n"
    network = read(tmp_path, "!#=DNA 3.01 STN\n" + row, "!#=DNA 3.01 MSR\n")
    (held_by,) = network.observations.values()
    assert (held_by.axes, held_by.sigma) == (axes, (1e-6,) * len(axes))  # type: ignore[attr-defined]


def test_geocentric_constraints_hold_geocentric_axes(tmp_path: Path) -> None:
    stations = STATIONS.replace("FFF XYZ", "FCF XYZ")
    assert read(tmp_path, stations).points["B"].held == "y"


DRIVER = """!#=DNA 3.00 MSR
* without values
A A                   B                   C
B A                   B
C A                   C
D A                   B                   1
D                                         C
E A                   B
G A                   B
H B
I B
J B
K A                   B
L A                   C
M A                   B
P B
Q B
R C
S A                   C
V A                   C
X A                   B                   1                      4.00   1.00   1.00   1.00
Y B                   XYZ                 1
Z A                   C
"""


def test_files_for_the_simulator_are_plans(tmp_path: Path) -> None:
    network = read(tmp_path, measurements=DRIVER, driver=True)
    assert len(network.observations) == 21
    a, c = (np.array(network.points[n].coordinates) for n in "AC")
    by_kind = {o.kind: o for o in network.observations.values()}
    wanted = 0.03 * math.sqrt(np.linalg.norm(c - a) / 1000.0)
    assert by_kind["slope_distance"].sigma == pytest.approx(wanted)
    assert by_kind["zenith_angle"].sigma == pytest.approx(0.01 * ARCSEC)
    assert by_kind["ellipsoid_height"].sigma == 0.024
    assert by_kind["gnss_vector"].covariance[0, 0] == pytest.approx(4 * 4.022e-5)
    plan = fga.plan(network)
    assert plan.solution.n_unknowns == 7
    with pytest.raises(fga.InputError, match="value is missing"):
        read(tmp_path, measurements=DRIVER)


def test_a_repeated_free_station_counts_once(tmp_path: Path) -> None:
    again = f"{'B':<20}FFF XYZ{'-4253391.25':>20}{'2873283.50':>20}{'-3772921.36':>20}\n"
    network = read(tmp_path, STATIONS + again)
    assert network.points["B"].coordinates[0] == -4253391.24
    assert str(network.left_out[0]).startswith("repeated stations: 1 left out")
    with pytest.raises(fga.InputError, match=r"net.stn:6: station 'B' stands in net.stn:4, and"):
        read(tmp_path, STATIONS + again.replace("FFF", "CCC"))


def test_measurements_of_another_name_are_an_option(tmp_path: Path) -> None:
    written(tmp_path, STATIONS, "!#=DNA 3.01 MSR\n")
    (tmp_path / "driver.msr").write_text(DRIVER)
    options = {"measurements": str(tmp_path / "driver.msr"), "driver": True, "geoid": 4.5}
    assert len(fga.read(tmp_path / "net.stn", **options).observations) == 21


@pytest.mark.parametrize("other", ["net.stn", "net.msr"])
def test_either_file_finds_the_other(tmp_path: Path, other: str) -> None:
    written(tmp_path, STATIONS, MEASUREMENTS)
    assert len(fga.read(tmp_path / other, geoid=4.5).observations) == 22


def test_measurements_alone_are_one_problem(tmp_path: Path) -> None:
    (tmp_path / "net.msr").write_text(MEASUREMENTS)
    with pytest.raises(fga.InputError, match="has no stations: read the file") as caught:
        fga.read(tmp_path / "net.msr")
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("1000.125", "1000.12567890", "'67890' stands outside of the columns of the record"),
        ("1.500  1.600", "1.500  x.600", "height of the target: 'x.600' is not a number"),
        (" 89 15   30.12", " 89 75   30.12", "has 60 or more minutes or seconds"),
        ("!#=DNA 3.01 MSR", "!#=DNA 9.01 MSR", "version '9.01' is unknown; valid: 1.00, 3.00"),
        ("H C", "W C", "unknown type 'W'; valid: A, B, C"),
        ("X A                   C", "X A                   Q", "unknown point 'Q'"),
        ("LLh", "LLx", "type of the coordinates 'LLx' is unknown; valid: XYZ, LLH, LLh"),
        ("2                            ", "5                            ",
         "must go on with direction 4"),
        ("GDA2020          01.01.2020\n", "WGS84            01.01.2020\n",
         "reference frame 'WGS84' is not known; known: ITRF2014"),
        (" 4e-6", "-4e-6", "must have positive variances"),
        ("H C ", "H?C ", "the second column must be blank or *, not '?'"),
        ("12.345", "12.345      7", "outside of the columns of the record"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in MEASUREMENTS
    with pytest.raises(fga.InputError) as caught:
        read(tmp_path, measurements=MEASUREMENTS.replace(old, new, 1))
    assert message in str(caught.value)
    assert "net.msr:" in str(caught.value)


def test_heights_beside_their_columns_are_taken_in_their_order(tmp_path: Path) -> None:
    """As in dsg.msr of DynAdjust, whose standard deviations have one column more."""
    shifted = MEASUREMENTS.replace("    0.003  1.500  1.600", "    0.003   1.500  1.600")
    assert shifted != MEASUREMENTS
    slope = next(iter(read(tmp_path, measurements=shifted).observations.values()))
    assert (slope.instrument_height, slope.target_height) == (1.5, 1.6)
    cut = MEASUREMENTS.replace("    0.003  1.500  1.600", "    0.003    1.500")
    with pytest.raises(fga.InputError, match="a number goes on beyond column 106"):
        read(tmp_path, measurements=cut)


def test_files_without_header_are_recognised_by_their_stations(tmp_path: Path) -> None:
    stations, measurements = columns("1.00")
    path = written(tmp_path, stations, measurements)
    assert len(fga.read(path, geoid=4.5).observations) == 22
    path.rename(tmp_path / "net.txt")
    assert len(fga.read(tmp_path / "net.txt", geoid=4.5).points) == 3


def test_every_type_is_written_as_dynaml_and_read_again(tmp_path: Path) -> None:
    network = read(tmp_path)
    fga.write_dynaml(network, tmp_path / "again.xml")
    again = fga.read_dynaml(tmp_path / "again.xml", geoid=4.5)

    def by_type(n: fga.Network) -> list[tuple]:  # type: ignore[type-arg]
        found = [
            (o.kind, o.names(), getattr(o, "line", ""), tuple(np.ravel(o.value).round(9)))  # type: ignore[attr-defined]
            for o in n.observations.values()
        ]
        return sorted(found)

    assert by_type(again) == by_type(network)
    for cls in (fga.EllipsoidDistance, fga.EllipsoidHeight, fga.EllipsoidHeightDifference):
        one, other = (
            sorted(
                repr(sorted((vars(o) | {"id": "", "source": ""}).items()))
                for o in n.observations.values()
                if isinstance(o, cls)
            )
            for n in (network, again)
        )
        assert one == other and one
