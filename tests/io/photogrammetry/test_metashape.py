"""Metashape: a real project against the report of DBAT, and the traps of its versions."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.photogrammetry.metashape import read_metashape
from factorgraph_adj.io.photogrammetry.metashape_reference import chunk_reference
from factorgraph_adj.io.photogrammetry.metashape_writer import write_metashape
from factorgraph_adj.models.lens import Lens
from factorgraph_adj.models.normalised_lens import RationalLens
from factorgraph_adj.models.ray_lens import FisheyeLens
from factorgraph_adj.solve.solution import Solution
from tests.support.dbat_report import Report, read_report
from tests.support.places import data_dir

SENSOR = """<sensors><sensor id="0" label="cam" type="frame"><resolution width="1000" height="800"/>
<calibration type="frame" class="adjusted">{calibration}</calibration></sensor></sensors>"""
UNIT = "1 0 0 {x} 0 1 0 0 0 0 1 0 0 0 0 1"


def chunk(
    calibration: str = "<f>900</f>", inside: str = "", version: str = "1.4.0", reference: str = ""
) -> str:
    """Return a document of one chunk with two cameras."""
    cameras = "".join(
        f'<camera id="{i}" sensor_id="0" label="{i}.jpg"><transform>{UNIT.format(x=i)}</transform>'
        f"{reference if i == 0 else ''}</camera>"
        for i in range(2)
    )
    return (
        f'<?xml version="1.0"?>\n<document version="{version}">\n<chunk label="site">\n'
        f"{SENSOR.format(calibration=calibration)}\n<cameras>{cameras}</cameras>\n{inside}\n"
        "</chunk>\n</document>\n"
    )


def read(tmp_path: Path, text: str, **options: object) -> fga.Network:
    path = tmp_path / "cameras.xml"
    path.write_text(text, encoding="utf-8")
    return fga.read(path, **options)


def camera_of(network: fga.Network) -> dict[str, float]:
    camera = next(iter(network.cameras.values()))
    return dict(zip(camera.lens.names, camera.values, strict=True))


# -- a real project -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def project() -> Path:
    return data_dir("metashape_sxb") / "sxb.psz"


@pytest.fixture(scope="module")
def report(project: Path) -> Report:
    return read_report(project.parent / "sxb-dbatreport.txt")


@pytest.fixture(scope="module")
def solution(project: Path) -> Solution:
    return fga.adjust(fga.read(project), variance="a-posteriori")


@pytest.mark.published
def test_a_project_of_photoscan_has_the_published_figures(solution: Solution) -> None:
    assert solution.converged
    figures = (solution.n_observations, solution.n_unknowns, solution.redundancy)
    assert figures == (8180, 3576, 4604)
    assert solution.sigma0 == pytest.approx(0.710294, abs=0.5e-6)
    assert np.sqrt(solution.vtpv) == pytest.approx(48.1954, abs=0.5e-4)


@pytest.mark.published
def test_its_photos_have_the_published_orientation(solution: Solution, report: Report) -> None:
    """DBAT stops at steps of 1e-6; its photos lie within 1e-3 σ of the minimum, as elsewhere."""
    assert len(report.photos) == 5
    for photo, name in zip(report.photos.values(), solution.network.photos, strict=True):
        pose = solution.pose(name)
        angles = np.rad2deg(pose.omega_phi_kappa)
        ours = dict(zip(("Omega", "Phi", "Kappa"), angles.tolist(), strict=True))
        ours |= dict(zip(("Xc", "Yc", "Zc"), pose.position.tolist(), strict=True))
        sigmas = dict(zip(("Xc", "Yc", "Zc"), pose.sigmas[3:].tolist(), strict=True))
        for label, (value, deviation) in photo.items():
            assert deviation is not None
            assert abs(ours[label] - value.value) <= value.half + 1e-3 * deviation.value
            if label in sigmas:
                assert abs(sigmas[label] - deviation.value) <= deviation.half


@pytest.mark.published
def test_its_control_points_have_the_published_coordinates(
    solution: Solution, report: Report
) -> None:
    """The report names the markers in their order; its control file has the same coordinates."""
    names = [n for n in solution.network.points if not n.startswith("tie ")]
    assert len(names) == len(report.points) == 16
    for name, (values, deviations) in zip(names, report.points.values(), strict=True):
        sigmas = solution.standard_deviations(name)
        for ours, sigma, value, deviation in zip(
            solution.point(name), sigmas, values, deviations, strict=True
        ):
            assert abs(ours - value.value) <= value.half + 1e-3 * sigma
            assert abs(sigma - deviation.value) <= deviation.half + 1e-5 * sigma


def test_the_same_chunk_as_psx_gives_the_same_network(project: Path, tmp_path: Path) -> None:
    """The archives of a .psx hold what the one archive of a .psz holds."""
    with zipfile.ZipFile(project) as opened:
        files = {n: opened.read(n) for n in opened.namelist()}
    text = files["doc.xml"].decode()
    begin, end = text.index("<frame id"), text.index("</frame>") + len("</frame>")
    frame = text[begin:end]
    a, b = frame.index("<point_cloud>"), frame.index("</point_cloud>") + len("</point_cloud>")
    ties = frame[a:b]
    chunk_text = text[text.index("<chunk id") : text.index("</chunk>") + len("</chunk>")]
    chunk_text = chunk_text.replace(frame, '<frame id="0" path="0/frame.zip"/>')
    folder = tmp_path / "sxb.files" / "0" / "0" / "point_cloud"
    folder.mkdir(parents=True)
    frame = frame.replace(ties, '<point_cloud path="point_cloud/point_cloud.zip"/>')
    plys = {n: c for n, c in files.items() if n.endswith(".ply")}
    top = '<document version="1.2.0"><chunks><chunk id="0" path="0/chunk.zip"/></chunks></document>'
    for path, members in {
        folder / "point_cloud.zip": {"doc.xml": ties.encode(), **plys},
        folder.parent / "frame.zip": {"doc.xml": frame.encode()},
        folder.parent.parent / "chunk.zip": {"doc.xml": chunk_text.encode()},
        tmp_path / "sxb.files" / "project.zip": {"doc.xml": top.encode()},
    }.items():
        with zipfile.ZipFile(path, "w") as written:
            for name, content in members.items():
                written.writestr(name, content)
    link = '<document version="1.2.0" path="{projectname}.files/project.zip"/>'
    (tmp_path / "sxb.psx").write_text(link, encoding="utf-8")
    psx, psz = fga.read(tmp_path / "sxb.psx"), fga.read(project)
    assert list(psx.points.values()) == list(psz.points.values())
    for a, b in zip(psx.images.columns(), psz.images.columns(), strict=True):
        assert np.array_equal(a, b)
    (tmp_path / "sxb.files" / "0" / "0" / "frame.zip").unlink()
    with pytest.raises(InputError, match=r"chunk\.zip/doc\.xml:\d+: the file 0/frame\.zip is miss"):
        fga.read(tmp_path / "sxb.psx")


# -- traps: lens ----------------------------------------------------------------------------------


def project_point(network: fga.Network, xyz: tuple[float, float, float]) -> tuple[float, float]:
    """Return column and row of a point in photo 0.jpg, by the residual of an image point at 0."""
    one = network.copy()
    one.add_point("Q", xyz)
    one.add_image_points("0.jpg", ["Q"], np.zeros((1, 2)), sigma=1.0)
    from factorgraph_adj.graph.equations import compile_network

    equations = compile_network(one)
    x, y = equations.residuals(equations.unknowns.start())
    return float(x), float(-y)


def test_the_current_lens_has_its_principal_point_at_the_centre(tmp_path: Path) -> None:
    """Metashape's manual: u = w/2 + cx + x' f + x' b1 + y' b2, with p1 (r² + 2x²) + 2 p2 x y."""
    k = {"f": 900.0, "cx": 7.0, "cy": -4.0, "b1": 3.0, "b2": -2.0, "k1": 0.1, "k2": -0.05}
    k |= {"k3": 0.02, "k4": -0.01, "p1": 1e-3, "p2": -2e-3}
    network = read(tmp_path, chunk("".join(f"<{n}>{v}</{n}>" for n, v in k.items())))
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    s = 1 + k["k1"] * r2 + k["k2"] * r2**2 + k["k3"] * r2**3 + k["k4"] * r2**4
    xd = x * s + k["p1"] * (r2 + 2 * x * x) + 2 * k["p2"] * x * y
    yd = y * s + k["p2"] * (r2 + 2 * y * y) + 2 * k["p1"] * x * y
    u = 500 + k["cx"] + xd * k["f"] + xd * k["b1"] + yd * k["b2"]
    v = 400 + k["cy"] + yd * k["f"]
    assert project_point(network, (5 * x, 5 * y, 5.0)) == pytest.approx((u, v), abs=1e-9)
    camera = network.cameras["cam"]
    assert camera.lens.kind == "normalised_affine"
    assert not any(camera.fixed)


def test_the_old_lens_has_an_absolute_principal_point_and_p1_p2_exchanged(tmp_path: Path) -> None:
    """Forum of Agisoft, topic 6437: x += p2 (r² + 2x²) + 2 p1 x y, u = cx + x fx + y skew."""
    k = {"fx": 903.0, "fy": 900.0, "cx": 507.0, "cy": 396.0, "skew": -2.0, "k1": 0.1}
    k |= {"p1": 1e-3, "p2": -2e-3}
    text = chunk("".join(f"<{n}>{v}</{n}>" for n, v in k.items()), version="1.2.0")
    network = read(tmp_path, text)
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    xd = x * (1 + k["k1"] * r2) + k["p2"] * (r2 + 2 * x * x) + 2 * k["p1"] * x * y
    yd = y * (1 + k["k1"] * r2) + k["p1"] * (r2 + 2 * y * y) + 2 * k["p2"] * x * y
    u, v = k["cx"] + xd * k["fx"] + yd * k["skew"], k["cy"] + yd * k["fy"]
    assert project_point(network, (5 * x, 5 * y, 5.0)) == pytest.approx((u, v), abs=1e-9)


def test_a_fisheye_distorts_the_angle(tmp_path: Path) -> None:
    """Metashape's manual: x = x0 θ/r0, y = y0 θ/r0 with θ = atan r0, then as the frame camera."""
    k = {"f": 600.0, "cx": 7.0, "cy": -4.0, "b1": 3.0, "b2": -2.0, "k1": 0.1, "p1": 1e-3}
    text = chunk("".join(f"<{n}>{v}</{n}>" for n, v in k.items()))
    network = read(tmp_path, text.replace('type="frame"', 'type="fisheye"'))
    x, y = 0.9, -0.6
    theta, r = np.arctan(np.hypot(x, y)), np.hypot(x, y)
    x, y = x * theta / r, y * theta / r
    r2 = x * x + y * y
    xd = x * (1 + k["k1"] * r2) + k["p1"] * (r2 + 2 * x * x)
    yd = y * (1 + k["k1"] * r2) + 2 * k["p1"] * x * y
    u = 500 + k["cx"] + xd * (k["f"] + k["b1"]) + yd * k["b2"]
    v = 400 + k["cy"] + yd * k["f"]
    assert project_point(network, (5 * 0.9, 5 * -0.6, 5.0)) == pytest.approx((u, v), abs=1e-9)


def test_what_is_free_is_what_metashape_optimised(tmp_path: Path) -> None:
    full = "<f>900</f><cx>1</cx><k1>0.1</k1><p1>0</p1>"
    held = chunk(full).replace("<calibration", '<property name="fixed" value="true"/><calibration')
    assert all(read(tmp_path, held).cameras["cam"].fixed)
    covariance = "</calibration><covariance><params>f k1</params></covariance></sensor>"
    listed = read(tmp_path, chunk(full).replace("</calibration></sensor>", covariance))
    assert free_of(listed) == {"c", "k1"}
    flags = '<meta><property name="optimize/fit_flags" value="f cx cy p1"/></meta>'
    assert free_of(read(tmp_path, chunk(full, flags))) == {"c", "x0", "y0", "p1"}
    old = '<meta><property name="optimize/fit_cxcy" value="1"/></meta>'
    assert free_of(read(tmp_path, chunk(full, old))) == {"x0", "y0"}
    assert free_of(read(tmp_path, chunk(full), calibration="held")) == set()
    assert free_of(read(tmp_path, chunk(full), calibration=["f", "b1"])) == {"c", "b1"}


def free_of(network: fga.Network) -> set[str]:
    camera = network.cameras["cam"]
    return {n for n, held in zip(camera.lens.names, camera.fixed, strict=True) if not held}


@pytest.mark.parametrize(
    ("calibration", "message"),
    [
        ("<f>900</f><p3>0.1</p3>", r"cameras\.xml:5: <p3> is 0\.1; this lens model has no p3"),
        ("<k1>0.1</k1>", r"cameras\.xml:5: the calibration has no <f>"),
        ("<f>-3</f>", r"<f> must be greater than zero, not -3"),
        ("<f>900</f><k5>1</k5>", r"unknown parameter <k5> of a calibration; valid: f, cx"),
        ("<f>900</f><k1>nan</k1>", r"<k1>: 'nan' is not a finite number"),
    ],
)
def test_a_lens_that_is_none_is_refused(tmp_path: Path, calibration: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, chunk(calibration))


def test_other_sensors_are_refused(tmp_path: Path) -> None:
    fisheye = chunk().replace('label="cam" type="frame"', 'label="cam" type="equisolid_fisheye"')
    with pytest.raises(InputError, match=r"a sensor of type 'equisolid_fisheye' cannot be read"):
        read(tmp_path, fisheye)
    rig = chunk().replace('label="cam"', 'label="cam" master_id="3"')
    with pytest.raises(InputError, match=r"belongs to a rig of several sensors"):
        read(tmp_path, rig)


# -- traps: reference -----------------------------------------------------------------------------

WGS84 = (
    'GEOGCS["WGS 84",DATUM["World Geodetic System 1984",'
    'SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.01745329251994328]]'
)
MARKERS = """<markers><marker id="0" label="P1"><reference x="{0}" y="{1}" z="100" sxy="0.02"
 sz="0.04" enabled="true"/></marker><marker id="1" label="P2"><reference x="{2}" y="{3}" z="130"
 enabled="false"/></marker></markers><reference>{4}</reference>"""


def test_geographic_references_are_longitude_latitude_and_metres(tmp_path: Path) -> None:
    """1e-4° of latitude at 45° are 11.1 m (M = 6 367 382 m); σ stay metres, east, north and up."""
    inside = MARKERS.format(7.0, 45.0, 7.0, 45.0001, WGS84)
    network = read(tmp_path, chunk(inside=inside))
    assert isinstance(network.frame, fga.TopocentricFrame)
    a, b = network.points["P1"], network.points["P2"]
    north = np.array(b.check) - a.coordinates
    assert north == pytest.approx((0.0, np.deg2rad(1e-4) * (6367381.8 + 115), 30.0), abs=1e-3)
    control = next(iter(network.observations.values()))
    assert isinstance(control, fga.ControlPoint)
    covariance = np.asarray(control.covariance)
    assert np.sqrt(np.diag(covariance)) == pytest.approx((0.02, 0.02, 0.04), abs=1e-6)


def test_poses_of_a_geographic_chunk_come_from_geocentric_coordinates(tmp_path: Path) -> None:
    e = fga.GeocentricFrame("WGS84").ellipsoid
    at = e.to_cartesian(np.deg2rad([45.0]), np.deg2rad([7.0]), np.array([160.0]))[0]
    words = " ".join(f"{v:.9f}" for v in at)
    transform = f"<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>{words}"
    transform += "</translation><scale>10</scale></transform>"
    inside = MARKERS.format(7.0, 45.0, 7.0, 45.0, WGS84) + transform
    network = read(tmp_path, chunk(inside=inside))
    first, second = (np.array(network.photos[n].position) for n in ("0.jpg", "1.jpg"))
    assert first == pytest.approx((0.0, 0.0, 45.0), abs=1e-6)  # the middle of the markers is 115 m
    assert np.linalg.norm(second - first) == pytest.approx(10.0, abs=1e-8)
    rotation = np.asarray(network.photos["0.jpg"].rotation)
    east = [-np.sin(np.deg2rad(7.0)), np.cos(np.deg2rad(7.0)), 0.0]
    assert rotation[0] == pytest.approx(east, abs=1e-9)


UTM = (
    'PROJCS["WGS 84 / UTM zone 32N",GEOGCS["WGS 84",DATUM["World Geodetic System 1984",'
    'SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.01745329251994328],AUTHORITY["EPSG","4326"]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
    'PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1],'
    'AUTHORITY["EPSG","32632"]]'
)


def test_a_projected_reference_becomes_a_topocentric_frame(tmp_path: Path) -> None:
    """2 km apart at 3° from the meridian: the grid is 1.00053 times longer, and turned by 2.2°."""
    pytest.importorskip("pyproj")
    inside = MARKERS.format(740000, 5050000, 740000, 5052000, UTM).replace('z="130"', 'z="100"')
    network = read(tmp_path, chunk(inside=inside.replace('sxy="0.02"', 'sx="0.02" sy="0.3"')))
    assert isinstance(network.frame, fga.TopocentricFrame)
    a, b = np.array(network.points["P1"].coordinates), np.array(network.points["P2"].check)
    # scale of the projection on the ellipsoid, 0.9996 (1 + E²/2R²), and 1 + h/R
    scale = 0.9996 * (1 + (240000 / 0.9996) ** 2 / (2 * 6378e3**2)) / (1 + 100 / 6368e3)
    assert np.linalg.norm(b - a) == pytest.approx(2000 / scale, abs=2e-2)
    convergence = np.arctan2(*(b - a)[:2])
    assert convergence == pytest.approx(np.deg2rad(3.05) * np.sin(np.deg2rad(45.5)), abs=1e-3)
    control = network.observations["1"]
    assert isinstance(control, fga.ControlPoint)
    north = np.array((b - a)[:2]) / np.linalg.norm((b - a)[:2])
    along = north @ np.asarray(control.covariance)[:2, :2] @ north
    assert np.sqrt(along) == pytest.approx(0.3, abs=1e-4)


def test_a_projected_reference_may_be_taken_as_local(tmp_path: Path) -> None:
    text = chunk(inside=MARKERS.format(500000, 5e6, 500010, 5e6, UTM))
    network = read(tmp_path, text, crs="local")
    assert network.points["P1"].coordinates == (500000.0, 5e6, 100.0)
    assert network.photos["0.jpg"].position is None
    wrong = text.replace('PROJECTION["Transverse_Mercator"]', 'PROJECTION["None_Such"]')
    with pytest.raises(InputError, match=r"cameras\.xml:\d+: .*cannot be used"):
        read(tmp_path, wrong)


def test_disabled_markers_are_check_points_and_positions_of_cameras_are_observed(
    tmp_path: Path,
) -> None:
    inside = MARKERS.format(1, 2, 3, 4, "LOCAL_CS[&quot;Local&quot;,UNIT[&quot;mm&quot;,0.001]]")
    reference = '<reference x="5" y="6" z="7" sxyz="3" enabled="true"/>'
    transform = "<transform><scale>2</scale></transform>"
    network = read(tmp_path, chunk(inside=inside + transform, reference=reference))
    assert network.points["P2"].check == pytest.approx((0.003, 0.004, 0.13))
    assert network.points["P1"].coordinates == pytest.approx((0.001, 0.002, 0.1))
    kinds = {o.kind: o for o in network.observations.values()}
    assert set(kinds) == {"control", "photo_position"}
    position = kinds["photo_position"]
    assert isinstance(position, fga.PhotoPosition)
    assert position.value == pytest.approx((0.005, 0.006, 0.007))
    assert np.sqrt(np.diag(np.asarray(position.covariance))) == pytest.approx((0.003,) * 3)
    assert position.source == "cameras.xml:6"
    assert network.photos["1.jpg"].position == pytest.approx((0.002, 0.0, 0.0))


def test_accuracies_are_those_of_the_chunk_or_those_that_are_asked_for(tmp_path: Path) -> None:
    marker = '<markers><marker id="0" label="P"><reference x="1" y="2" z="3"/></marker></markers>'
    settings = '<settings><property name="accuracy_markers" value="0.25"/></settings>'
    network = read(tmp_path, chunk(inside=marker + settings))
    control = network.observations["1"]
    assert isinstance(control, fga.ControlPoint) and control.sigma == (0.25,) * 3
    asked = read(tmp_path, chunk(inside=marker + settings), accuracy={"markers": 0.5})
    control = asked.observations["1"]
    assert isinstance(control, fga.ControlPoint) and control.sigma == (0.5,) * 3
    with pytest.raises(InputError, match=r"accuracy 'marker' = 0\.5; valid: numbers > 0 for tiep"):
        read(tmp_path, chunk(inside=marker), accuracy={"marker": 0.5})
    with pytest.raises(InputError, match=r"accuracy must be a table, such as .* not '0\.5'"):
        read(tmp_path, chunk(inside=marker), accuracy="0.5")


def test_the_chunk_is_the_one_that_is_asked_for(tmp_path: Path) -> None:
    two = chunk().replace("</chunk>", '</chunk><chunk label="other"></chunk>')
    with pytest.raises(
        InputError,
        match=r"has several chunks; choose one with chunk=NAME \(--set chunk=NAME\); valid: 'si",
    ):
        read(tmp_path, two)
    assert read(tmp_path, two, chunk="site").name == "site"
    with pytest.raises(InputError, match=r"has no single chunk 'third'; .*'other'"):
        read(tmp_path, two, chunk="third")


# -- writing --------------------------------------------------------------------------------------


def with_markers(project: Path) -> fga.Network:
    """Return the real project with its markers alone, and one accuracy."""
    network = read_metashape(project, tie_points=False, calibration=["f", "cx"])
    network.add(fga.SlopeDistance("216", "305", 31.0, sigma=0.01))
    return network


def test_what_is_written_is_read_again(project: Path, tmp_path: Path) -> None:
    network = with_markers(project)
    write_metashape(network, tmp_path / "out.xml")
    again = read_metashape(tmp_path / "out.xml")
    assert list(again.points) == list(network.points)
    assert again.cameras == network.cameras
    for name, photo in network.photos.items():
        assert again.photos[name].position == pytest.approx(photo.position, abs=1e-9)
        assert np.asarray(again.photos[name].rotation) == pytest.approx(photo.rotation, abs=1e-14)
    assert {o.kind for o in again.observations.values()} == {"control", "slope_distance"}
    a, b = fga.adjust(network), fga.adjust(again)
    assert (a.n_observations, a.n_unknowns) == (b.n_observations, b.n_unknowns)
    assert b.vtpv == pytest.approx(a.vtpv, rel=1e-9)


def test_cameras_alone_are_written_of_any_network(solution: Solution, tmp_path: Path) -> None:
    """Tie points and levelled heights stay behind; the adjusted poses are read to all digits."""
    network = solution.as_network()
    network.add(fga.HeightDifference("216", "305", 0.1, sigma=0.01))
    with pytest.raises(InputError, match=r"Metashape cannot express a height difference; content"):
        write_metashape(network, tmp_path / "out.xml")
    assert not (tmp_path / "out.xml").exists()
    write_metashape(network, tmp_path / "out.xml", content="cameras")
    again = fga.read(tmp_path / "out.xml")
    for name in network.photos:
        assert np.array_equal(again.photos[name].position, network.photos[name].position)


def test_what_cannot_be_expressed_is_told_at_once(tmp_path: Path) -> None:
    network = fga.Network("film")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    from factorgraph_adj.models.lens import BrownLens

    network.add_camera("film", BrownLens(), {"c": 150.0})
    network.add_photo("1", "film", position=(0, 0, 9), omega_phi_kappa=(0, 0, 0), fixed=True)
    with pytest.raises(InputError) as caught:
        write_metashape(network, tmp_path / "out.xml")
    told = [str(p) for p in caught.value.problems]
    assert len(told) == 3
    for words in ("held coordinates", "a held pose", "pixels of a known format"):
        assert any(words in t for t in told)


def test_archives_that_are_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.psz"
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"is no ZIP archive|cannot be unpacked"):
        fga.read(path)
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as written:
        written.writestr("other.xml", "")
    path.write_bytes(bomb.getvalue())
    with pytest.raises(InputError, match=r"p\.psz/doc\.xml: the archive has no such file"):
        fga.read(path)
    (tmp_path / "q.psx").write_text('<document path="../../etc/x.zip"/>', encoding="utf-8")
    with pytest.raises(InputError, match="lies outside the folder of the project"):
        fga.read(tmp_path / "q.psx")


def test_the_origin_of_points_on_both_sides_of_the_antimeridian_is_among_them():
    wkt = (
        'GEOGCS["WGS 84",DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,'
        '298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]]'
    )
    given = np.array([[179.999, -17.0, 100.0], [-179.998, -17.001, 120.0]])
    frame = chunk_reference(wkt, given, "project").frame
    assert np.degrees(frame.longitude) == pytest.approx(-179.9995, abs=1e-9)
    at = chunk_reference(wkt, given, "project").points(given)
    assert np.abs(at).max() < 500.0
    given[:, 0] = [178.0, 179.0]
    assert np.degrees(chunk_reference(wkt, given, "project").frame.longitude) == pytest.approx(
        178.5
    )


@pytest.mark.parametrize(
    ("lens", "more"),
    [
        (
            RationalLens(),
            {"k1": -0.02, "k2": 0.01, "p1": 1e-4, "p2": -2e-4, "b1": 0.002, "b2": 1e-4},
        ),
        (
            FisheyeLens(),
            {"k1": 0.02, "k2": -0.01, "k4": 1e-3, "p1": 1e-4, "p2": -2e-4, "b1": 0.002, "b2": 1e-4},
        ),
    ],
    ids=lambda x: getattr(x, "kind", ""),
)
def test_lenses_of_colmap_are_written_where_metashape_has_the_same(
    tmp_path: Path, lens: Lens, more: dict[str, float]
) -> None:
    """What is read again projects points as what was written."""
    network = fga.Network("lens")
    values = {"c": 900.0, "x0": 510.0, "y0": -380.0, **more}
    network.add_camera(
        "1",
        lens,
        values,
        unit="px",
        format=(1024, 768),
        origin="upper left",
        y_down_in_files=True,
    )
    network.add_photo("a", "1", position=(0, 0, 5), omega_phi_kappa=(0, 0, 0))
    fga.write_metashape(network, tmp_path / "out.xml", content="cameras")
    back = next(iter(fga.read(tmp_path / "out.xml").cameras.values()))
    rng = np.random.default_rng(1)
    local, zero = np.column_stack([rng.uniform(-0.5, 0.5, (40, 2)), np.ones(40)]), np.zeros(40)
    written, read_again = (
        camera.lens.seen(tuple(local.T), zero, zero, np.array([camera.values]), jacobians=False)[0]
        for camera in (network.cameras["1"], back)
    )
    np.testing.assert_allclose(read_again, written, atol=1e-9)
    lost = "s1" if lens.kind == "fisheye" else "k5"
    camera = network.cameras["1"]
    stated = dict(zip(lens.names, camera.values, strict=True)) | {lost: 0.1}
    network.cameras["1"] = replace(camera, values=tuple(stated.values()))
    free = tuple(n != lost for n in lens.names)
    for wrong in (network.cameras["1"], replace(camera, fixed=free)):
        network.cameras["1"] = wrong
        with pytest.raises(InputError, match=r"cannot express the lens model .* = 0, held"):
            fga.write_metashape(network, tmp_path / "none.xml", content="cameras")
