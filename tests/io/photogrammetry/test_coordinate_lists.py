"""Lists of ground control and of positions beside a model: a block of known truth, wrong lists."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.photogrammetry.coordinate_lists import (
    ListSystem,
    list_system,
    read_positions,
)
from factorgraph_adj.io.source import Problems

PLACE = fga.TopocentricFrame(np.deg2rad(52.5), np.deg2rad(13.4), 40.0, "WGS84")
CENTRES = np.array([(0.0, 0, 60), (12.0, 1, 61), (2.0, 14, 59), (13.0, 12, 62)])
TURNS = np.array([(3.1, 0.1, 0.05), (3.0, 0.3, -0.1), (0.1, 3.1, 0.2), (2.9, -0.4, 0.1)])
POINTS = np.array([(x, y, 0.05 * x * y - 1) for x in (-9.0, 5, 20) for y in (-8.0, 6, 18)])
TURN, SCALE, SHIFT = Rotation.from_rotvec([0.4, -0.2, 0.9]), 0.13, np.array([2.0, -1.0, 5.0])
F, X0, Y0 = 3400.0, 2000.0, 1500.0


def pixels(i: int, points: np.ndarray) -> np.ndarray:
    """Return columns and rows from the upper left corner."""
    q = Rotation.from_rotvec(TURNS[i]).apply(points - CENTRES[i])
    return F * q[:, :2] / q[:, 2:] + [X0, Y0]


def geographic(points: np.ndarray) -> np.ndarray:
    latitude, longitude, height = PLACE.geodetic(points)
    return np.stack([np.rad2deg(longitude), np.rad2deg(latitude), height], 1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A model of COLMAP in coordinates of its own, with a list of ground control and geo.txt."""
    rng = np.random.default_rng(5)
    images, tracks = [], {j: [] for j in range(len(POINTS))}
    ground, geo = ["EPSG:4326", "# comment"], ["EPSG:4326"]
    for i in range(4):
        seen = pixels(i, POINTS) + rng.normal(0, 0.3, (len(POINTS), 2))
        rotation = Rotation.from_rotvec(TURNS[i]) * TURN.inv()
        x, y, z, w = rotation.as_quat()
        t = -rotation.apply(SCALE * TURN.apply(CENTRES[i]) + SHIFT)
        pose = " ".join(repr(float(v)) for v in (w, x, y, z, *t))
        images.append(f"{i + 1} {pose} 1 flight/{i}.jpg")
        images.append(" ".join(f"{u!r} {v!r} {j}" for j, (u, v) in enumerate(seen.tolist())))
        for j in tracks:
            tracks[j] += [i + 1, j]
        lon, lat, h = geographic(CENTRES[i : i + 1] + rng.normal(0, 0.02, (1, 3)))[0].tolist()
        geo.append(f"{i}.jpg {lon!r} {lat!r} {h!r} 10 0 0 0.02 0.03")
        for k, at in enumerate(geographic(POINTS[:5] + 0.5).tolist()):
            u, v = (pixels(i, POINTS[k : k + 1] + 0.5)[0] - 0.5).tolist()
            place = " ".join(map(repr, at))
            ground.append(f"{place} {u!r} {v!r} {i}.jpg {'CHK-4' if k == 4 else f'G{k}'}")
    ground.append("13.4 52.5 40 10 20 other.jpg G0")
    model = tmp_path / "sparse"
    model.mkdir()
    (model / "cameras.txt").write_text(f"1 SIMPLE_PINHOLE 4000 3000 {F} {X0} {Y0}\n")
    (model / "images.txt").write_text("\n".join(images) + "\n")
    places = SCALE * TURN.apply(POINTS) + SHIFT
    rows = [" ".join(map(str, [j, *places[j].tolist(), 1, 2, 3, 0.1, *tracks[j]])) for j in tracks]
    (model / "points3D.txt").write_text("\n".join(rows) + "\n")
    (tmp_path / "gcp_list.txt").write_text("\n".join(ground[:-1]) + "\n")
    (tmp_path / "geo.txt").write_text("\n".join(geo) + "\nother.jpg 13.4 52.5 100\n")
    return tmp_path


def at_true_place(network: fga.Network, points: np.ndarray) -> np.ndarray:
    """Return places of the truth in the frame of the network."""
    frame = network.frame
    assert isinstance(frame, fga.TopocentricFrame)
    return np.array([ListSystem().place(frame, tuple(g)) for g in geographic(points).tolist()])


def test_ground_control_places_a_model_of_colmap(folder: Path) -> None:
    """Noise of 0.3 px at 60 m and f = 3400 is 5 mm on the ground."""
    network = fga.read(folder / "sparse", gcp=folder / "gcp_list.txt")
    assert len([o for o in network.observations.values() if o.kind == "control"]) == 4
    solution = fga.adjust(network)
    assert solution.datum_defect == 0
    expected = at_true_place(network, POINTS + 0.5)
    assert solution.point("CHK-4") == pytest.approx(expected[4], abs=0.03)
    others = at_true_place(network, POINTS)
    off = [solution.point(str(j)) - others[j] for j in range(9)]
    assert np.abs(off).max() < 0.1
    assert solution.network.points["CHK-4"].check == pytest.approx(expected[4], abs=1e-6)


def test_positions_place_a_model_of_colmap(folder: Path) -> None:
    network = fga.read(folder / "sparse", positions=folder / "geo.txt")
    observed = [o for o in network.observations.values() if o.kind == "photo_position"]
    assert [o.sigma for o in observed] == [(0.02, 0.02, 0.03)] * 4
    lost = {r.what: r.count for r in network.left_out}
    assert lost["positions"] == 1
    assert lost["yaw, pitch and roll of photos"] == 4
    solution = fga.adjust(network)
    off = [solution.pose(f"flight/{i}.jpg").position for i in range(4)]
    assert off == pytest.approx(at_true_place(network, CENTRES), abs=0.1)


def test_tables_of_other_programs_have_the_same_positions(folder: Path, tmp_path: Path) -> None:
    """Metashape, Pix4D with its header, and exiftool with degrees in words."""
    rows = geographic(CENTRES).tolist()
    metashape = '# CoordinateSystem: GEOGCS["WGS 84",DATUM["World Geodetic System 1984"]]\n'
    metashape += "#Label,X/Longitude,Y/Latitude,Z/Altitude,Yaw,Pitch,Roll,Accuracy_(m)\n"
    pix4d = "imagename;latitude;longitude;altitude;accuracy horizontal;accuracy vertical\n"
    exif = "SourceFile,GPSLatitude,GPSLongitude,GPSAltitude,RtkStdLon,RtkStdLat,RtkStdHgt\n"
    for i, (lon, lat, h) in enumerate(rows):
        metashape += f"{i}.jpg,{lon!r},{lat!r},{h!r},10,0,0,0.02\n"
        pix4d += f"{i}.jpg;{lat!r};{lon!r};{h!r};0.02;0.02\n"
        words = []
        for value, letter in ((lat, "N"), (lon, "E")):
            minutes = 60.0 * (value - int(value))
            seconds = 60.0 * (minutes - int(minutes))
            words.append(f'"{int(value)} deg {int(minutes)}\' {seconds:.6f}"" {letter}"')
        exif += f"./photos/{i}.jpg,{words[0]},{words[1]},{h:.4f} m Above Sea Level,"
        exif += "0.02,0.02,0.02\n"
    metashape += "#Label,X_est\n"
    for text in (metashape, pix4d, exif):
        path = tmp_path / "positions.csv"
        path.write_text(text)
        network = fga.read(folder / "sparse", positions=path)
        observed = list(network.observations.values())
        assert [o.sigma for o in observed] == [(0.02, 0.02, 0.02)] * 4
        found = np.array([o.value for o in observed])
        assert found == pytest.approx(at_true_place(network, CENTRES), abs=1e-3)


def test_systems_of_lists() -> None:
    for text in ("WGS84", "epsg:4326", "+proj=longlat +ellps=WGS84 +datum=WGS84 +no_defs"):
        assert list_system(text).grid is None
    assert list_system("WGS84 UTM 16N").grid is not None
    assert list_system("EPSG:25833").grid is not None
    with pytest.raises(InputError, match="unknown reference system 'UTM 33'"):
        list_system("UTM 33")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("EPSG:4326\na.jpg 1\n", r"p\.txt:2: a row has image x y \[z\]"),
        ("EPSG:4326\na.jpg 1 x 3\n", r"p\.txt:2: y: 'x' is not a number"),
        ("a.jpg 1 2 3\n", r"p\.txt:1: unknown reference system 'a\.jpg 1 2 3'"),
        ("label,x,y,z\na,1,2,3\n", r"p\.txt:1: the table states no reference system; valid: posi"),
        ("label,x,z\na,1,2\n", r"p\.txt:1: the header has no column for y; valid: y: y/north"),
        ("label,lat,lon\na,95 deg,2\n", r"p\.txt:2: latitude: '95 deg' is not a number"),
        ("", r"p\.txt.*is empty: the first line names the reference system"),
    ],
)
def test_lists_that_are_wrong(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.txt"
    path.write_text(text)
    problems = Problems()
    with pytest.raises(InputError, match=message):
        read_positions(path, problems)
        problems.raise_all()


def test_positions_without_accuracies_need_them(folder: Path) -> None:
    path = folder / "geo.txt"
    path.write_text(path.read_text().replace(" 10 0 0 0.02 0.03", ""))
    with pytest.raises(InputError, match=r"geo\.txt:2: has no accuracy; valid: sigma_positions="):
        fga.read(folder / "sparse", positions=path)
    network = fga.read(folder / "sparse", positions=path, sigma_positions=(1.5, 3.0))
    assert {o.sigma for o in network.observations.values()} == {(1.5, 1.5, 3.0)}


def test_lists_and_tables_exclude_each_other(folder: Path) -> None:
    with pytest.raises(InputError, match=r"lists \(gcp, positions\) and tables"):
        fga.read(folder / "sparse", gcp=folder / "gcp_list.txt", control=folder / "c.csv")


def test_a_place_that_two_lines_of_ground_control_give_a_photo_is_refused(folder: Path) -> None:
    path = folder / "gcp_list.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[2]]) + "\n")
    with pytest.raises(InputError, match=r"control point 'G0' is measured twice in image 'flight"):
        fga.read(folder / "sparse", gcp=path)


def test_lost_positions_are_a_doubt_and_all_of_them_a_problem(folder: Path) -> None:
    """Names with other suffixes: images of the model are then without a position."""
    text = (folder / "geo.txt").read_text()
    (folder / "part.txt").write_text(text.replace("3.jpg", "3.png"))
    network = fga.read(folder / "sparse", positions=folder / "part.txt")
    (lost,) = (left for left in network.left_out if left.doubtful)
    assert str(lost).startswith("positions of photos: 2 of 5 left out, as their images are not in")
    assert "did you mean 'flight/3.jpg'?" in str(lost)
    assert any("positions of photos: 2 of 5" in str(f) for f in fga.preliminary(network))
    (folder / "none.txt").write_text(text.replace(".jpg", ".png"))
    with pytest.raises(InputError, match="positions of photos: 5 of 5 left out") as caught:
        fga.read(folder / "sparse", positions=folder / "none.txt")
    assert "none.txt:2" in str(caught.value)


@pytest.mark.parametrize("which", ["gcp", "positions"])
def test_lists_with_latitude_first_are_refused_by_their_shape(folder: Path, which: str) -> None:
    """A model of COLMAP has no frame that a place could be far from."""
    path = folder / {"gcp": "gcp_list.txt", "positions": "geo.txt"}[which]
    at = {"gcp": 0, "positions": 1}[which]
    lines = []
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) > 3:
            words[at], words[at + 1] = words[at + 1], words[at]
        lines.append(" ".join(words))
    path.write_text("\n".join(lines) + "\n")
    message = rf"^{path.name}: its \d places fit those of the block to .* longitude or easting"
    with pytest.raises(InputError, match=message):
        fga.read(folder / "sparse", **{which: path})


def with_positions(folder: Path, change: dict[int, tuple[float, float, bool]]) -> Path:
    """Return geo.txt with shifts of longitude and latitude, degrees, and exchanges of both."""
    lines = (folder / "geo.txt").read_text().splitlines()[:5]
    for row, (longitude, latitude, exchanged) in change.items():
        words = lines[row].split()
        x, y = float(words[1]) + longitude, float(words[2]) + latitude
        words[1:3] = [repr(y), repr(x)] if exchanged else [repr(x), repr(y)]
        lines[row] = " ".join(words)
    path = folder / "changed.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("row", [1, 3, 4])
def test_one_exchanged_line_alone_is_named(folder: Path, row: int) -> None:
    path = with_positions(folder, {row: (0, 0, True)})
    with pytest.raises(InputError, match=rf"^changed.txt:{row + 1}: lies \d+ km from") as caught:
        fga.read(folder / "sparse", positions=path)
    assert len(caught.value.problems) == 1


def test_one_exchanged_line_of_a_grid_alone_is_named() -> None:
    places = np.array([(492482.0 + i, 5271848.0 + 3 * i * i, 400.0) for i in range(5)])
    good = list_system("EPSG:25832")
    frame = good.frame(places[1:])
    places[0, :2] = places[0, 1::-1]
    assert good.frame(places) == frame


def test_a_frame_of_good_places_is_in_the_middle_of_all() -> None:
    places = np.array([(13.0, 52.0, 10.0), (13.1, 52.0, 30.0), (13.9, 52.8, 50.0)])
    frame = ListSystem().frame(places)
    assert np.rad2deg([frame.longitude, frame.latitude]) == pytest.approx([13.45, 52.4])


@pytest.mark.parametrize("row", [1, 4])
def test_one_position_far_from_the_others_is_named(folder: Path, row: int) -> None:
    """All places are on a line then, but that is not what is wrong."""
    path = with_positions(folder, {row: (0, 0.5, False)})
    message = rf"^changed.txt:{row + 1}: position of image 'flight/{row - 1}.jpg' lies 55.6 km from"
    with pytest.raises(InputError, match=message) as caught:
        fga.read(folder / "sparse", positions=path)
    assert len(caught.value.problems) == 1


def test_positions_far_from_control_are_told(folder: Path) -> None:
    path = with_positions(folder, dict.fromkeys(range(1, 5), (0.0, 0.5, False)))
    message = r"^changed.txt: positions of photos lie 55.6 km from the control points, \d+ times"
    with pytest.raises(InputError, match=message):
        fga.read(folder / "sparse", positions=path, gcp=folder / "gcp_list.txt")
    assert fga.read(folder / "sparse", positions=path).observations


@pytest.mark.parametrize("exchanged", [True, False])
def test_three_control_points_show_an_exchange(folder: Path, exchanged: bool) -> None:
    """Degrees of longitude are shorter than those of latitude, so that the triangle differs."""
    rows = (folder / "gcp_list.txt").read_text().splitlines()
    rows = [r for r in rows if not r.endswith("G1") and not r.endswith("CHK-4")]
    words = [r.split() for r in rows]
    if exchanged:
        words = [[w[1], w[0], *w[2:]] if len(w) > 3 else w for w in words]
    path = folder / "three.txt"
    path.write_text("\n".join(" ".join(w) for w in words) + "\n")
    if exchanged:
        with pytest.raises(InputError, match=r"^three.txt: its 3 places fit those of the block"):
            fga.read(folder / "sparse", gcp=path)
    else:
        assert fga.adjust(fga.read(folder / "sparse", gcp=path)).converged


def test_control_on_a_line_is_told(folder: Path) -> None:
    rows = (folder / "gcp_list.txt").read_text().splitlines()
    path = folder / "line.txt"
    path.write_text("\n".join(r for r in rows if r[-2:] not in ("G3", "-4")) + "\n")
    with pytest.raises(InputError, match="give 3 places, which do not carry the model over"):
        fga.read(folder / "sparse", gcp=path)
