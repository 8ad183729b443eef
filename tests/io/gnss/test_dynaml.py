"""DynaML: every type of measurement, reference frames, scales, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.crs.terrestrial_frames import frame_transformation
from factorgraph_adj.io.gnss.dynaml_writer import packed_angle
from factorgraph_adj.units import ARCSEC
from tests.hostile.readers import judge
from tests.networks.dynaml import (
    HEAD,
    MEASUREMENTS,
    STATIONS,
    TAIL,
    of_station,
    read,
    sight,
)
from tests.support.places import data_dir
from tests.support.same import assert_same_network


@pytest.fixture
def network(tmp_path: Path) -> fga.Network:
    return read(tmp_path, HEAD + STATIONS + MEASUREMENTS + TAIL)


def test_every_type_is_read(network: fga.Network) -> None:
    kinds = [o.kind for o in network.observations.values()]
    assert kinds == [
        *("control", "gnss_vector", "slope_distance", "zenith_angle", "vertical_angle"),
        *("geodetic_azimuth", "horizontal_angle", "direction", "direction", "ellipsoid_height"),
        *("control", "control", "astronomic_latitude", "astronomic_longitude"),
    ]
    by_kind = {o.kind: o for o in network.observations.values()}
    assert by_kind["zenith_angle"].value == pytest.approx(
        math.radians(91 + 15 / 60 + 30.123 / 3600)
    )  # type: ignore[attr-defined]
    assert by_kind["geodetic_azimuth"].value == pytest.approx(
        math.radians(123 + 30 / 60 + 30.5 / 3600)
    )  # type: ignore[attr-defined]
    assert by_kind["direction"].sigma == pytest.approx(1.5 * ARCSEC)  # type: ignore[attr-defined]
    assert by_kind["slope_distance"].instrument_height == 1.5  # type: ignore[attr-defined]
    assert by_kind["slope_distance"].source.startswith("combined.xml:")  # type: ignore[attr-defined]
    assert all(network.points["A"].fixed) and not any(network.points["B"].fixed)


def test_components_of_stations_are_observed_in_their_horizon(network: fga.Network) -> None:
    """CCF holds B in plan to 1 µm; P, Q, R are latitude, longitude and height of C."""
    controls = [o for o in network.observations.values() if isinstance(o, fga.ControlPoint)]
    assert [(o.point, o.axes) for o in controls] == [("B", "ne"), ("C", "n"), ("C", "e")]
    latitude, longitude = controls[1:]
    (height,) = (o for o in network.observations.values() if isinstance(o, fga.EllipsoidHeight))
    frame = network.frame
    assert isinstance(frame, fga.GeocentricFrame)
    assert (height.point, height.value, height.sigma, height.surface) == ("C", 120.25, 0.01, 0.0)
    m, n = frame.ellipsoid.radii(np.array(math.radians(-36.508333)))
    assert latitude.sigma == pytest.approx([0.5 * ARCSEC * (m + 120.0)], rel=1e-6)
    across = (n + 120.0) * math.cos(math.radians(36.508333))
    assert longitude.sigma == pytest.approx([0.5 * ARCSEC * across], rel=1e-6)


def test_scales_multiply_the_covariance_as_a_whole_and_in_north_east_up(tmp_path: Path) -> None:
    text = HEAD + STATIONS + MEASUREMENTS + TAIL
    plain = np.array([[4e-6, 1e-6, 0], [1e-6, 4e-6, 0], [0, 0, 9e-6]])
    (whole,) = (o for o in read(tmp_path, text).observations.values() if o.kind == "gnss_vector")
    np.testing.assert_allclose(whole.covariance, 2 * plain, rtol=1e-12)  # type: ignore[attr-defined]
    scales = "<Vscale>2</Vscale><Pscale>4</Pscale><Lscale>9</Lscale><Hscale>25</Hscale>"
    network = read(tmp_path, text.replace("<Vscale>2</Vscale>", scales))
    (local,) = (o for o in network.observations.values() if o.kind == "gnss_vector")
    at = np.array(network.points["A"].coordinates)[None]
    enu = network.frame.basis(at, np.zeros((1, 2))).enu[0]
    by = np.diag([3.0, 2.0, 5.0])  # roots of L (east), P (north), H (up)
    expected = by @ (enu @ (2 * plain) @ enu.T) @ by
    np.testing.assert_allclose(enu @ local.covariance @ enu.T, expected, rtol=1e-9)  # type: ignore[attr-defined]


def test_orthometric_heights_are_an_option(tmp_path: Path) -> None:
    text = (
        HEAD + STATIONS + sight("L", "A", "C", "20.5", 0.002) + of_station("H", "C", "120.5", 0.1)
    )
    with pytest.raises(fga.InputError, match="type L refers to the geoid, and the file has no"):
        read(tmp_path, text + TAIL)
    kinds = ["ellipsoid_height_difference", "ellipsoid_height"]
    for options, surface in (({"heights": "ellipsoidal"}, 0.0), ({"geoid": 4.5}, 4.5)):
        network = read(tmp_path, text + TAIL, **options)
        difference, height = list(network.observations.values())[1:]
        assert [difference.kind, height.kind] == kinds
        assert (difference.station_surface, height.surface) == (surface, surface)  # type: ignore[attr-defined]


def test_itrf2014_moves_with_the_plate_and_gda2020_does_not() -> None:
    """GDA2020 Technical Manual 1.8, section 3.3.1: Alice Springs (ALIC) at epoch 2018.0."""
    matrix, shift = frame_transformation("ITRF2014", "GDA2020", 2018.0)
    itrf = np.array([-4052052.6588, 4212835.9938, -2545104.6946])
    gda = np.array([-4052052.7373, 4212835.9835, -2545104.5867])
    np.testing.assert_allclose(matrix @ itrf + shift, gda, rtol=0, atol=1e-4)


def test_gda94_to_gda2020_is_that_of_the_manual() -> None:
    """GDA2020 Technical Manual 1.8, section 3.1.1: Alice Springs."""
    matrix, shift = frame_transformation("GDA94", "GDA2020", 2000.0)
    gda94 = np.array([-4052051.7643, 4212836.2017, -2545106.0245])
    gda2020 = np.array([-4052052.7379, 4212835.9897, -2545104.5898])
    np.testing.assert_allclose(matrix @ gda94 + shift, gda2020, rtol=0, atol=1e-4)


def test_there_and_back_between_frames() -> None:
    for by_gda94 in (False, True):
        a, s = frame_transformation("ITRF2008", "ITRF2020", 2016.5, by_gda94=by_gda94)
        b, t = frame_transformation("ITRF2020", "ITRF2008", 2016.5, by_gda94=by_gda94)
        np.testing.assert_allclose(a @ b, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(a @ t + s, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<Type>S</Type>", "<Type>M</Type>", "type M refers to the geoid, and the file has no"),
        ("<Type>S</Type>", "<Type>W</Type>", "unknown type 'W'; valid: A, B, C, D, E, G, H"),
        ("<Second>C</Second>", "<Second>X</Second>", "unknown point 'X'"),
        ("91.1530123", "91.6530123", "has 60 or more minutes or seconds; packed degrees"),
        ("CCF", "CXF", "<Constraints> must be three of C and F"),
        ("<Type>LLh</Type>", "<Type>UTM</Type>", "<Type> UTM has an orthometric height, which"),
        ("<Type>LLh</Type>", "<Type>ENU</Type>", "<Type> ENU has no origin in the file"),
        ("<Type>LLh</Type>", "<Type>LLZ</Type>", "<Type> 'LLZ' is not read; valid: LLH, LLh"),
        ("<SigmaZZ>9e-6", "<SigmaZZ>-9e-6", "must have positive variances"),
        ("<Value>1000.125</Value>", "", "<Value> of <DnaMeasurement> is missing; valid: a number"),
        ("<Description/>", "<Colour/>", "<Colour> cannot be in <DnaStation>"),
        ("<GPSBaseline>", "<ReferenceFrame>WGS84</ReferenceFrame><GPSBaseline>",
         "reference frame 'WGS84' is not known; known: ITRF2014"),
        ("<GPSBaseline>", "<ReferenceFrame>ITRF2014</ReferenceFrame><Epoch>2018</Epoch>"
         "<GPSBaseline>", "<Epoch> must be dd.mm.yyyy"),
        ("DnaXmlFormat", "gama-local", "the root element must be <DnaXmlFormat>"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = HEAD + STATIONS + MEASUREMENTS + TAIL
    assert old in text
    count = -1 if old == "DnaXmlFormat" else 1
    with pytest.raises(fga.InputError) as caught:
        read(tmp_path, text.replace(old, new, count))
    assert message in str(caught.value)
    assert "combined.xml:" in str(caught.value)


@pytest.mark.parametrize("degrees", [0.0, 1e-12, 59.999999999999, 145.5, -36.56347, 359.99999])
def test_packed_angles_carry_no_sixty(degrees: float) -> None:
    text = packed_angle(math.radians(degrees))
    whole, _, rest = text.lstrip("-").partition(".")
    minutes, seconds = int(rest[:2]), float(f"{rest[2:4]}.{rest[4:] or 0}")
    assert minutes < 60 and seconds < 60
    assert int(whole) + minutes / 60 + seconds / 3600 == pytest.approx(abs(degrees), abs=1e-12)


@pytest.mark.published
def test_the_network_of_dynadjust_there_and_back_to_the_bit(tmp_path: Path) -> None:
    path = data_dir("dynadjust_gnss") / "gnss-networkstn.xml"
    network = fga.read_dynaml(path, reference_frames="as is")
    fga.write_dynaml(network, tmp_path / "gnss-networkstn.xml")
    assert_same_network(fga.read(tmp_path / "gnss-networkstn.xml"), network)


def test_terrestrial_observations_there_and_back(tmp_path: Path) -> None:
    text = HEAD + STATIONS.replace("CCF", "FFF") + MEASUREMENTS + TAIL
    for kind in "PQR":
        text = text.replace(of_station(kind, "C", {"P": "-36.3030", "Q": "145.5745",
                                                   "R": "120.25"}[kind],
                                       0.01 if kind == "R" else 0.5), "")  # fmt: skip
    network = read(tmp_path, text)
    fga.write_dynaml(network, tmp_path / "again.xml")
    again = fga.read_dynaml(tmp_path / "again.xml")

    def of(n: fga.Network) -> dict[str, list]:
        found: dict[str, list] = {}
        for o in n.observations.values():
            found.setdefault(o.kind, []).append(o)
        return found

    a, b = of(network), of(again)
    assert sorted(a) == sorted(b)
    for kind in a:
        for x, y in zip(a[kind], b[kind], strict=True):
            assert x.names() == y.names()
            np.testing.assert_allclose(x.value, y.value, rtol=1e-15, atol=5e-15)
            if x.sigma is not None:
                np.testing.assert_allclose(x.sigma, y.sigma, rtol=1e-14)


def test_what_dynaml_cannot_express_is_refused_all_at_once(tmp_path: Path) -> None:
    network = fga.Network("x", frame=fga.GeocentricFrame(), datum="free")
    network.add_point("A", (4e6, 1e6, 4.8e6), fixed="x")
    network.add_point("B")
    network.set_refraction(value=0.13)
    network.add(fga.SlopeDistance("A", "B", 10.0, sigma=fga.StandardDeviation(0.001, ppm=1)))
    with pytest.raises(fga.InputError) as caught:
        fga.write_dynaml(network, tmp_path / "no.xml")
    for part in ("free datum", "kind refraction", "cannot hold x", "approximate", "one part only"):
        assert part in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_200_damaged_files(tmp_path: Path) -> None:
    files = {"combined.xml": (HEAD + STATIONS + MEASUREMENTS + TAIL).encode()}
    judge(fga.read_dynaml, files, "combined.xml", tmp_path, seed=22)


def test_measurements_without_stations_are_one_problem(tmp_path: Path) -> None:
    """Not one unknown point for each end of a vector."""
    path = tmp_path / "netmsr.xml"
    ends = "<First>A</First><Second>B</Second><Value>10</Value><StdDev>0.01</StdDev>"
    measurement = f"<DnaMeasurement><Type>S</Type><Ignore/>{ends}</DnaMeasurement>"
    path.write_text(
        '<?xml version="1.0"?>\n<DnaXmlFormat type="Measurement File" referenceframe="GDA2020">\n'
        f"{measurement}\n{measurement}\n</DnaXmlFormat>\n",
        encoding="utf-8",
    )
    with pytest.raises(fga.InputError, match="has no <DnaStation>: read the file of the") as caught:
        fga.read_dynaml(path)
    assert len(caught.value.problems) == 1


def test_components_of_stations_are_written_and_read_again(
    network: fga.Network, tmp_path: Path
) -> None:
    path = fga.write_dynaml(network, tmp_path / "w.xml", heights="ellipsoidal")
    assert path is None
    again = fga.read_dynaml(tmp_path / "w.xml", heights="ellipsoidal")

    def found(n: fga.Network) -> list[tuple[str, str, float, float]]:
        frame = n.frame
        assert isinstance(frame, fga.GeocentricFrame)
        out = []
        for o in n.observations.values():
            if isinstance(o, fga.ControlPoint) and o.local:
                where = frame.ellipsoid.to_geodetic(np.array(o.value))
                assert o.sigma is not None
                for axis, sigma in zip(o.axes, o.sigma, strict=True):
                    out.append((o.point, axis, float(where["neu".index(axis)]), sigma))
        return out

    one, other = found(network), found(again)
    assert len(one) == 4
    assert [x[:2] for x in one] == [x[:2] for x in other]
    for (_, _, value, sigma), (_, _, value2, sigma2) in zip(one, other, strict=True):
        assert value2 == pytest.approx(value, abs=1e-14, rel=1e-15)
        assert sigma2 == pytest.approx(sigma, rel=1e-8)


def test_correlated_components_are_refused(tmp_path: Path) -> None:
    network = fga.Network("x", frame=fga.GeocentricFrame())
    at = (4e6, 1e6, 4.8e6)
    network.add_point("A", at)
    covariance = np.array([[1e-4, 1e-5], [1e-5, 1e-4]])
    network.add(fga.ControlPoint("A", at, axes="ne", covariance=covariance))
    with pytest.raises(fga.InputError, match="no correlations of latitude"):
        fga.write_dynaml(network, tmp_path / "no.xml")


@pytest.mark.parametrize("year", [1988, 1989, 1990, 1991, 1992, 1993, 1994, 1996])
@pytest.mark.parametrize("epoch", [1994.0, 2010.0, 2020.5])
def test_older_frames_are_those_of_proj(year: int, epoch: float) -> None:
    """The file ITRF2014 of PROJ, from the tables of the IGN: 10 µm (ITRF1997 is mistyped there)."""
    proj = pytest.importorskip("pyproj")
    step = proj.Transformer.from_pipeline(f"+init=ITRF2014:ITRF{year % 100}")
    xyz = np.array([-4052052.7379, 4212835.9897, -2545104.5898])
    matrix, shift = frame_transformation("ITRF2014", f"ITRF{year}", epoch)
    expected = step.transform(*xyz, epoch)[:3]
    np.testing.assert_allclose(matrix @ xyz + shift, expected, rtol=0, atol=1e-5)
