"""Comp3D: files that name files, codes that no published project has, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.units import ARCSEC, GON
from tests.hostile.readers import judge

LONG = pytest.mark.slow("two hundred damaged projects; short tests read each kind of line")

POINTS = """* the net
1 S1 100.000 100.000 50.000 0.001 0.001 0.001 *comment
2 S2 150.000 100.000 50.000 0.010 0.010 0.000
3 S3 100.000 150.000 50.000 0.000 0.000 0.001
5 L1 120.000 120.000 50.000 0 0 0
1 F1 150.000 150.000 51.000 0 0 0
1 N1 160.000 150.000 51.000 -0.001 0.002 0.003
-1 OUT
@more.cor
"""
MORE = "0 T1 130.000 140.000 52.000\n"
OBSERVATIONS = """*code origin target value sigma_abs sigma_rel h_station h_target
7 S1 S2 100.0000 0.0010 0.001
5 S1 S3 0.0000 0.0010 0.000 1.500 1.600
6 S1 T1 96.0000 0.0010
3 S1 T1 50.0400 0.001 0.0001
1 S1 F1 70.7180 0.002
4 S1 L1 0.000 0.001 0.00001
8 S1 S2 100.0000 0.0010
9 S2 T2 0 0.003 0.001
4 S2 T2 1.600 0.001
14 S1 F1 50.000 0.002
15 S1 F1 50.000 0.002
-3 S1 F1 99.000 0.001
3 S1 F1 99.000 -0.001
3 S1 OUT 10.000 0.001
@inner.obs
12 S1 @polar.xyz
11 F1 @cartesian.xyz 1
22 @pairs.eq
"""
FILES = {
    "net.obs": OBSERVATIONS,
    "net.cor": POINTS,
    "more.cor": MORE,
    "inner.obs": "3 S3 T1 31.7000 0.002\n",
    "polar.xyz": "S2 300.0000 0.0000 50.0000 0.0010 0.0005 0.0010 0.0001 0.000\n"
    "T1 20.0 0.0 0.0 0.0010 -1 0.0001\n",
    "cartesian.xyz": "S1 -50.0 -50.0 -1.0 0.002 -1 0.004 0.0001\nT1 -20 -10 1 0.003 0.0001\n",
    "pairs.eq": "S1 S2 0.001\nS1 S3 0.002\n",
}


def write(folder: Path, **changed: str) -> Path:
    for name, text in (FILES | {k.replace("_", "."): v for k, v in changed.items()}).items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "net.obs"


def read(folder: Path, **changed: str) -> fga.Network:
    return fga.read_comp3d(write(folder, **changed), latitude=48.8)


def test_points_are_free_weighted_and_held_by_their_codes(tmp_path: Path) -> None:
    points = read(tmp_path).points
    assert set(points) == {"S1", "S2", "S3", "L1", "F1", "N1", "T1", "T2"}
    assert {n: p.held for n, p in points.items() if p.held} == {"L1": "xyz", "F1": "xyz"}
    on_ground = 1 + 50 / 6_377_000
    sigma = {n: p.sigma for n, p in points.items()}
    assert sigma["S1"] == pytest.approx((0.001 * on_ground, 0.001 * on_ground, 0.001))
    assert sigma["S2"] == pytest.approx((0.01, 0.01, math.inf), rel=1e-4)
    assert sigma["S3"] == pytest.approx((math.inf, math.inf, 0.001))
    assert sigma["N1"] == pytest.approx((math.inf, 0.002, 0.003), rel=1e-4)
    assert sigma["T1"] is None
    assert np.isnan(points["T2"].coordinates).all()


def test_observations_have_their_lines_as_ids_and_those_of_inner_files_their_name(
    tmp_path: Path,
) -> None:
    network = read(tmp_path)
    simple = {i: o.kind for i, o in network.observations.items() if o.kind[:5] != "frame"}
    assert simple == {
        **{"2": "direction", "3": "direction", "4": "zenith_angle", "5": "slope_distance"},
        **{"6": "slope_distance", "7": "height_difference", "8": "azimuth"},
        **{"9 x": "coordinate_difference", "9 y": "coordinate_difference"},
        **{"10": "height_difference", "11": "coordinate_difference"},
        **{"12": "coordinate_difference", "inner.obs:1": "slope_distance"},
        **{i: "equal_distance" for i, o in network.observations.items() if "equal" in o.kind},
    }
    assert network.observations["3"].source == "net.obs:3"  # type: ignore[attr-defined]
    assert network.observations["3"].instrument_height == 1.5  # type: ignore[attr-defined]


def test_relative_standard_deviations_of_angles_are_metres(tmp_path: Path) -> None:
    """Comp3D adds σ_rel/D in radians to σ_abs, which is in gon: 2 mgon + 1 mm/D."""
    observed = read(tmp_path).observations
    expected = StandardDeviation(0.001 * GON, centring_instrument=0.001, combine="linear")
    assert observed["2"].sigma == expected  # type: ignore[attr-defined]
    assert observed["3"].sigma == 0.001 * GON  # type: ignore[attr-defined]
    assert observed["5"].sigma == StandardDeviation(0.001, ppm=100.0, combine="linear")  # type: ignore[attr-defined]
    assert observed["7"].sigma == pytest.approx(  # type: ignore[attr-defined]
        0.001 + 0.00001 * math.hypot(20, 20), rel=1e-5
    )


def test_polar_subframes_count_from_x_to_y_and_from_the_plane(tmp_path: Path) -> None:
    network = read(tmp_path)
    polar = [o for o in network.observations.values() if getattr(o, "frame", "") == "polar"]
    direction, zenith, distance, second, _ = polar
    # 300 gon from x towards y is −y: 200 gon clockwise from y.
    assert direction.value == pytest.approx(200 * GON)  # type: ignore[attr-defined]
    assert zenith.value == pytest.approx(100 * GON)  # type: ignore[attr-defined]
    assert direction.sigma == pytest.approx(0.001 * GON + 0.0005 / 50)  # type: ignore[attr-defined]
    assert distance.sigma == pytest.approx(0.001 + 0.0001 * 50)  # type: ignore[attr-defined]
    assert second.kind == "frame_direction"  # its distance is switched off


def test_a_negative_sigma_switches_an_axis_of_a_subframe_off(tmp_path: Path) -> None:
    first, second = (
        o for o in read(tmp_path).observations.values() if o.kind == "frame_coordinate"
    )
    length = math.sqrt(50**2 + 50**2 + 1)
    assert (first.axes, first.value) == ("xz", (-50.0, -1.0))  # type: ignore[attr-defined]
    assert first.sigma == pytest.approx((0.002 + 1e-4 * length, 0.004 + 1e-4 * length))  # type: ignore[attr-defined]
    length = math.sqrt(20**2 + 10**2 + 1)
    assert second.sigma == pytest.approx((0.003 + 1e-4 * length,) * 3)  # type: ignore[attr-defined]


def test_a_polar_subframe_gives_the_place_from_which_it_was_made(tmp_path: Path) -> None:
    """α, β, distance of known points from a place and a turn, on a plane of 50 m."""
    place, turn = np.array([12.0, 7.0, 3.0]), 0.3
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])  # axes of the instrument in the net
    known = {"A": (0.0, 0.0, 0.0), "B": (50.0, 0.0, 5.0), "C": (0.0, 40.0, -4.0), "D": (30, 30, 9)}
    rows, points = [], []
    for name, at in known.items():
        x, y, z = rotation.T @ (np.array(at) - place)
        alpha, beta = math.atan2(y, x) / GON % 400, math.atan2(z, math.hypot(x, y)) / GON
        rows.append(f"{name} {alpha:.7f} {beta:.7f} {np.linalg.norm([x, y, z]):.6f} 0.001 0.001 0")
        points.append(f"1 {name} {' '.join(map(str, at))} 0 0 0")
    (tmp_path / "p.xyz").write_text("\n".join(rows), encoding="utf-8")
    (tmp_path / "p.cor").write_text("\n".join([*points, "0 I 11 8 3"]), encoding="utf-8")
    (tmp_path / "p.obs").write_text("12 I @p.xyz 1\n", encoding="utf-8")
    solution = fga.adjust(fga.read_comp3d(tmp_path / "p.obs", latitude=48.8))
    np.testing.assert_allclose(solution.point("I"), place, atol=2e-4)  # 50 m fall 0.2 mm
    assert solution.sigma0 < 0.2


def test_deflections_are_used_if_every_station_has_one(tmp_path: Path) -> None:
    every = "".join(
        f"1 {n} {x} {y} 50 0 0 0 {eta} 2\n" for n, x, y, eta in (("S1", 0, 0, 3), ("S2", 90, 5, 4))
    )
    files = {"net_cor": every, "net_obs": "5 S1 S2 0 0.001\n6 S1 S2 100 0.001\n"}
    network = read(tmp_path, **files)
    assert network.verticals["S1"].values == pytest.approx((2 * ARCSEC, 3 * ARCSEC))
    path = write(tmp_path, **files | {"net_cor": every.replace("0 0 0 3 2", "0 0 0")})
    with pytest.raises(fga.InputError, match="but station 'S1' has none; deflections='ignore'"):
        fga.read_comp3d(path, latitude=48.8)
    assert not fga.read_comp3d(path, latitude=48.8, deflections="ignore").verticals


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("net.obs", "14 S1", "2 S1", "net.obs:11: begins with an unknown code '2'"),
        (
            "net.obs",
            "3 S1 T1 50.0400",
            "3 S1 T1 5o.0400",
            "net.obs:5: the value: '5o.0400' is not a number",
        ),
        ("net.obs", "@inner.obs", "@gone.obs", "names the file 'gone.obs', which is not beside"),
        ("net.obs", "@inner.obs", "@../net.obs", "must name a file beside this one"),
        ("inner.obs", "3 S3", "@inner.obs\n3 S3", "files, or in itself"),
        ("net.cor", "1 F1", "1 S1", "point 'S1' stands in net.cor:2 already"),
        ("net.cor", "3 S3", "11 S3", "a point begins with a code (0, 1, 2"),
        ("more.cor", "0 T1", "1 T1", "needs standard deviations"),
        ("cartesian.xyz", "T1 -20 -10 1", "T1 0 0 0", "0 0 0 is the origin of the sub-frame"),
        ("cartesian.xyz", "0.003 0.0001", "0.003 0.003 0.003 0 1.5", "height of the target"),
        ("pairs.eq", "S1 S3 0.002", "", "one pair alone is equal to nothing"),
        ("net.obs", "11 F1 @cartesian.xyz 1", "19 S1 @cartesian.xyz", "longitude= of the centre"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_line(
    tmp_path: Path, file: str, old: str, new: str, message: str
) -> None:
    assert old in FILES[file]
    with pytest.raises(fga.InputError) as caught:
        read(tmp_path, **{file.replace(".", "_"): FILES[file].replace(old, new, 1)})
    assert message in str(caught.value)


def test_observations_without_a_project_need_a_latitude_and_one_file_of_points(
    tmp_path: Path,
) -> None:
    path = write(tmp_path)
    with pytest.raises(fga.InputError, match="needs latitude="):
        fga.read_comp3d(path)
    (tmp_path / "net.cor").rename(tmp_path / "other.cor")
    with pytest.raises(fga.InputError, match=r"has 2 files \.cor beside it"):
        fga.read_comp3d(path, latitude=48.8)
    assert fga.read_comp3d(path, latitude=48.8, points=tmp_path / "other.cor").points


PROJECT = """data=
{"config": {"root_COR_file": "net.cor", "root_OBS_file": "net.obs", "refraction": 0.13,
"coord_cov_file": "", "use_proj": true, "proj_def": "EPSG:2154", "use_ellips_height": true,
"local_center": [657723.0, 6860710.0, 0.0]}}
"""
GRID_POINTS = """1 S1 657723.000 6860710.000 150.000 0.001 0.002 0.003
1 S2 657923.000 6860760.000 161.000 0 0 0
3 S3 657823.000 6860910.000 155.000 0 0 0.004
0 T1 657773.000 6860800.000 140.000
-1 OUT
"""
GRID_OBSERVATIONS = """7 S1 S2 0.0000 0.0010
5 S1 T1 348.0000 0.0010
3 S2 T1 155.0000 0.001
4 S2 T1 -21.0000 0.001
3 S3 S1 224.0000 0.001
3 S3 S2 182.0000 0.001
8 S1 S2 84.0000 0.0010
9 T1 C 0 0.001
4 T1 C 1.500 0.001
"""


def in_grid(folder: Path, **changed: str) -> Path:
    (folder / "p.comp").write_text(changed.pop("project", PROJECT), encoding="utf-8")
    files = {"net_cor": GRID_POINTS, "net_obs": GRID_OBSERVATIONS} | changed
    write(folder, **files)
    return folder / "p.comp"


def test_points_of_a_grid_are_held_and_weighted_in_a_frame_on_the_ellipsoid(tmp_path: Path) -> None:
    """East, north, up at the centre; σ of the file are those of the axes at the centre."""
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    network = fga.read_comp3d(in_grid(tmp_path))
    assert isinstance(network.frame, fga.TopocentricFrame) and network.crs is not None
    assert network.points["S2"].held == "xyz"
    control = network.observations["S1 control"]
    np.testing.assert_allclose(control.value, (0.0, 0.0, 150.0), atol=1e-6)  # type: ignore[attr-defined]
    k = 1 + 150 / network.frame.radius
    expected = np.diag([(0.001 * k) ** 2, (0.002 * k) ** 2, 0.003**2])
    np.testing.assert_allclose(control.covariance, expected, rtol=1e-6, atol=1e-12)  # type: ignore[attr-defined]
    height = network.observations["S3 height"]
    assert (height.value, height.sigma) == pytest.approx((155.0, 0.004))  # type: ignore[attr-defined]
    grid = network.crs.from_frame(network.frame, np.array([network.points["T1"].coordinates]))
    np.testing.assert_allclose(grid[0], (657773.0, 6860800.0, 140.0), atol=1e-6)
    assert network.refractions[""].values[0] == 0.13
    assert network.observations["7"].value == 84 * GON  # type: ignore[attr-defined]


def test_a_point_that_is_centred_on_another_needs_no_coordinates(tmp_path: Path) -> None:
    """Code 9 without a second σ has the first one in both axes; 4 gives the height."""
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    network = fga.read_comp3d(in_grid(tmp_path))
    sigmas = {network.observations[f"8 {a}"].sigma for a in "xy"}  # type: ignore[attr-defined]
    assert len(sigmas) == 1
    grid = fga.grid_coordinates(fga.adjust(network))
    np.testing.assert_allclose(grid.point("C") - grid.point("T1"), (0, 0, 1.5), atol=1e-4)


def test_observations_of_a_grid_need_its_reference_system_alone(tmp_path: Path) -> None:
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    path = in_grid(tmp_path)
    by_project = fga.adjust(fga.read_comp3d(path))
    network = fga.read_comp3d(
        path.with_name("net.obs"),
        points=path.with_name("net.cor"),
        crs="EPSG:2154",
        refraction=0.13,
    )
    alone = fga.adjust(network)
    a, b = (fga.grid_coordinates(s).point("T1") for s in (by_project, alone))
    # σ of east and north of S1 belong to axes that turn by 1e-5 between both centres.
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-5)
    assert alone.sigma0 == pytest.approx(by_project.sigma0, rel=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "options", "message"),
    [
        ("EPSG:2154", "EPSG:99999", {}, "unknown reference system 'EPSG:99999'.*crs= states"),
        ("EPSG:2154", "EPSG:2263", {}, "counts in US survey foot"),
        ('"EPSG:2154"', '""', {}, "proj_def does not name its projection"),
        ("657723.0, 6860710.0", "6860710.0, 657723.0", {}, r"p\.comp.*its centre .* is "),
        ("", "", {"earth": "sphere"}, "computed on the ellipsoid"),
        ('height": true', 'height": false', {}, "heights are altitudes: give geoid="),
        ('"use_proj": true', '"use_proj": false', {"geoid": 45.0, "latitude": 48.8}, "no geoid"),
    ],
)
def test_grids_that_cannot_be_used_are_refused(
    tmp_path: Path, old: str, new: str, options: dict[str, object], message: str
) -> None:
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    text = PROJECT.replace(old, new).replace(
        '"refraction"', '"center_latitude": 48.8, "refraction"'
    )
    path = in_grid(tmp_path, project=text)
    with pytest.raises(fga.InputError, match=message):
        fga.read_comp3d(path, **options)  # type: ignore[arg-type]


def test_places_outside_of_the_grid_are_told_with_file_and_line(tmp_path: Path) -> None:
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    points = GRID_POINTS.replace("657823.000 6860910.000", "6860910.000 657823.000")
    with pytest.raises(fga.InputError, match=r"net\.cor:3: is far outside of the area"):
        fga.read_comp3d(in_grid(tmp_path, net_cor=points))


def test_altitudes_of_a_grid_take_a_geoid(tmp_path: Path) -> None:
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    path = in_grid(tmp_path, project=PROJECT.replace('height": true', 'height": false'))
    high = fga.read_comp3d(path, geoid=44.0)
    low = fga.read_comp3d(in_grid(tmp_path))
    assert high.observations["S3 height"].value == pytest.approx(155.0 + 44.0)  # type: ignore[attr-defined]
    lifted = high.points["S2"].coordinates[2] - low.points["S2"].coordinates[2]
    assert lifted == pytest.approx(44.0, abs=1e-6)


@pytest.mark.slow(
    "hundreds of damaged files are read or refused; short tests read and refuse single ones"
)
def test_200_damaged_projects_in_a_grid(tmp_path: Path) -> None:
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    named = {"p.comp": PROJECT, "net.cor": GRID_POINTS, "net.obs": GRID_OBSERVATIONS}
    files = {name: text.encode() for name, text in named.items()}
    judge(fga.read_comp3d, files, "p.comp", tmp_path, seed=22)


@LONG
def test_200_damaged_projects(tmp_path: Path) -> None:
    files = {name: text.encode() for name, text in FILES.items()}
    judge(
        lambda path: fga.read_comp3d(path, latitude=48.8, points=path.with_name("net.cor")),
        files,
        "net.obs",
        tmp_path,
        seed=24,
    )


def test_files_in_the_code_page_of_windows_are_stated(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "net.cor").write_bytes(POINTS.replace("the net", "Höhen").encode("cp1252"))
    network = fga.read(tmp_path / "net.obs", latitude=45.0)
    said = "1 line is not UTF-8: read as if in Windows-1252; first in net.cor:1"
    assert network.remarks == [said]
