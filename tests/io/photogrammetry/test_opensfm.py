"""OpenSfM and ODM: formulas of their documentation, and a block of known truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.rotation import log_rotation
from factorgraph_adj.start.approximate_values import approximate
from factorgraph_adj.statistical_tests import global_test
from tests.networks.pixel_block import projected
from tests.support.attitude import rodrigues

LATITUDE, LONGITUDE, HEIGHT = 52.5, 13.4, 40.0
W, H = 4000, 3000
BROWN = {
    "projection_type": "brown",
    "width": W,
    "height": H,
    **{"focal_x": 0.85, "focal_y": 0.86, "c_x": 0.01, "c_y": -0.02},
    **{"k1": -0.05, "k2": 0.02, "k3": -0.004, "p1": 1e-3, "p2": -2e-3},
}
CENTRES = np.array([(0.0, 0.0, 60.0), (12.0, 1.0, 61.0), (2.0, 14.0, 59.0), (13.0, 12.0, 62.0)])
TURNS = np.array([(3.1, 0.1, 0.05), (3.0, 0.3, -0.1), (0.1, 3.1, 0.2), (2.9, -0.4, 0.1)])
POINTS = np.array([(x, y, 0.05 * x * y - 1) for x in (-9.0, 5.0, 20.0) for y in (-8.0, 6.0, 18.0)])


def normalised(shot: int, points: np.ndarray, camera: dict = BROWN) -> np.ndarray:
    """Return normalised image coordinates by the formula of OpenSfM's geometry.rst."""
    rotation = rodrigues(TURNS[shot])
    q = (points - CENTRES[shot]) @ rotation.T
    x, y = q[:, 0] / q[:, 2], q[:, 1] / q[:, 2]
    r2 = x * x + y * y
    d = 1 + camera["k1"] * r2 + camera["k2"] * r2**2 + camera["k3"] * r2**3
    p1, p2 = camera["p1"], camera["p2"]
    u = camera["focal_x"] * (x * d + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + camera["c_x"]
    v = camera["focal_y"] * (y * d + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)) + camera["c_y"]
    return np.stack([u, v], 1)


def geographic(points: np.ndarray) -> np.ndarray:
    """Return longitude, latitude (degrees) and height of topocentric points."""
    frame = fga.TopocentricFrame(np.deg2rad(LATITUDE), np.deg2rad(LONGITUDE), HEIGHT, "WGS84")
    latitude, longitude, height = frame.geodetic(points)
    return np.stack([np.rad2deg(longitude), np.rad2deg(latitude), height], 1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A reconstruction whose first four points are surveyed too, and a fifth is a check point."""
    rng = np.random.default_rng(11)
    shots = {
        f"{i}.jpg": {
            "rotation": TURNS[i].tolist(),
            "translation": (-rodrigues(TURNS[i]) @ CENTRES[i]).tolist(),
            "camera": "cam",
            "gps_position": (CENTRES[i] + 1.0).tolist(),
            "gps_dop": 5.0,
        }
        for i in range(4)
    }
    points = {str(i): {"coordinates": p.tolist(), "color": [1, 2, 3]} for i, p in enumerate(POINTS)}
    document = [{"cameras": {"cam": BROWN}, "shots": shots, "points": points}]
    (tmp_path / "reconstruction.json").write_text(json.dumps(document, indent=1))
    origin = {"latitude": LATITUDE, "longitude": LONGITUDE, "altitude": HEIGHT}
    (tmp_path / "reference_lla.json").write_text(json.dumps(origin))
    rows = ["OPENSFM_TRACKS_VERSION_v2"]
    ground = ["WGS84"]
    for i in range(4):
        seen = normalised(i, POINTS) + rng.normal(0, 0.5 / W, (len(POINTS), 2))
        for j, (x, y) in enumerate(seen.tolist()):
            rows.append(f"{i}.jpg\t{j}\t{j}\t{x!r}\t{y!r}\t0.001\t1\t2\t3\t-1\t-1")
        rows.append(f"{i}.jpg\t999\t77\t0.1\t0.1\t0.001\t1\t2\t3\t-1\t-1")  # no point
        for j, (lon, lat, h) in enumerate(geographic(POINTS[:5] + 0.5).tolist()):
            u, v = normalised(i, POINTS[j : j + 1] + 0.5)[0].tolist()
            column, row = u * W + (W - 1) / 2, v * W + (H - 1) / 2
            name = f"CHK-{j}" if j == 4 else f"G{j}"
            ground.append(f"{lon!r} {lat!r} {h!r} {column!r} {row!r} {i}.jpg {name}")
    (tmp_path / "tracks.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "gcp_list.txt").write_text("\n".join(ground) + "\n")
    return tmp_path


def test_image_points_are_those_of_the_formulas_of_opensfm(folder: Path) -> None:
    """Ground control has no noise: pixel conventions and p1, p2 agree to 1e-6 px."""
    network = fga.read(folder / "reconstruction.json")
    equations = compile_network(network)
    v = equations.residuals(approximate(equations))
    block = next(b for b in equations.blocks if b.kind == "image")
    of_ground = [k for k, i in enumerate(block.ids) if "tie" not in i]
    assert len(of_ground) == 20
    assert np.abs(v[block.rows].reshape(-1, 2)[of_ground]).max() < 1e-6
    assert np.abs(v[block.rows]).max() < 3.0


def test_a_fisheye_is_read(folder: Path) -> None:
    """u = f θ (1 + k1 θ² + k2 θ⁴) x/ρ, of OpenSfM's geometry.rst."""
    text = (folder / "reconstruction.json").read_text()
    document = json.loads(text)
    camera = {"projection_type": "fisheye", "width": W, "height": H, "focal": 0.5}
    document[0]["cameras"]["cam"] = camera | {"k1": -0.1, "k2": 0.03}
    (folder / "reconstruction.json").write_text(json.dumps(document))
    (folder / "gcp_list.txt").unlink()
    network = fga.read(folder / "reconstruction.json")
    q = (POINTS - CENTRES[0]) @ rodrigues(TURNS[0]).T
    rho = np.hypot(q[:, 0], q[:, 1])
    theta = np.arctan2(rho, q[:, 2])
    scale = W * 0.5 * theta * (1 - 0.1 * theta**2 + 0.03 * theta**4) / rho
    expected = np.stack([W / 2 + scale * q[:, 0], -H / 2 - scale * q[:, 1]], 1)
    ours = projected(network, list(network.points))["0.jpg"]
    assert ours == pytest.approx(expected, abs=1e-6)


def test_a_reconstruction_with_ground_control_is_adjusted(folder: Path) -> None:
    network = fga.read(folder / "reconstruction.json")
    assert len([n for n in network.points if n.startswith("tie ")]) == 9
    assert network.n_image_points == 4 * 9 + 4 * 5
    check = network.points["CHK-4"]
    assert check.check == pytest.approx(POINTS[4] + 0.5, abs=1e-6)
    control = [o for o in network.observations.values() if o.kind == "control"]
    assert len(control) == 4 and control[0].source == "gcp_list.txt:2"
    solution = fga.adjust(network)
    assert solution.converged
    assert solution.point("CHK-4") == pytest.approx(POINTS[4] + 0.5, abs=0.05)


def test_positions_of_a_list_are_observed(folder: Path) -> None:
    rows = [
        f"{i}.jpg " + " ".join(map(repr, at)) for i, at in enumerate(geographic(CENTRES).tolist())
    ]
    (folder / "geo.txt").write_text("\n".join(["EPSG:4326", *rows]) + "\n")
    (folder / "gcp_list.txt").unlink()
    path = folder / "reconstruction.json"
    network = fga.read(path, positions=folder / "geo.txt", sigma_positions=(0.02, 0.04))
    observed = list(network.observations.values())
    assert np.array([o.value for o in observed]) == pytest.approx(CENTRES, abs=1e-6)
    assert {o.sigma for o in observed} == {(0.02, 0.02, 0.04)}
    with pytest.raises(InputError, match="exclude each other"):
        fga.read(path, positions=folder / "geo.txt", gps="observe")


def test_parameters_that_opensfm_estimates_are_unknown(folder: Path) -> None:
    camera = fga.read(folder / "reconstruction.json").cameras["cam"]
    free = {n for n, held in zip(camera.lens.names, camera.fixed, strict=True) if not held}
    assert free == {"c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1"}
    held = fga.read(folder / "reconstruction.json", calibration="held").cameras["cam"]
    assert all(held.fixed)


def test_positions_are_observed_where_it_is_asked_for(folder: Path) -> None:
    network = fga.read(folder / "reconstruction.json", gps="observe")
    observed = [o for o in network.observations.values() if o.kind == "photo_position"]
    assert len(observed) == 4
    assert isinstance(observed[0], fga.PhotoPosition)
    assert observed[0].sigma == (5.0, 5.0, 10.0)


def test_rigs_place_shots_by_instance_and_rig_camera(folder: Path) -> None:
    """A shot's pose is that of its rig camera after that of the instance."""
    document = json.loads((folder / "reconstruction.json").read_text())
    first = document[0]["shots"]["0.jpg"]
    rotation, translation = first.pop("rotation"), np.array(first.pop("translation"))
    inner, shift = np.array((0.1, -0.2, 0.3)), np.array((0.5, 0.1, -0.2))
    outer = rodrigues(inner).T @ rodrigues(np.array(rotation))
    document[0]["rig_cameras"] = {
        "side": {"rotation": inner.tolist(), "translation": shift.tolist()}
    }
    document[0]["rig_instances"] = {
        "0": {
            "rotation": np.ravel(log_rotation(outer[None])).tolist(),
            "translation": (rodrigues(inner).T @ (translation - shift)).tolist(),
            "rig_camera_ids": {"0.jpg": "side"},
        }
    }
    (folder / "reconstruction.json").write_text(json.dumps(document))
    photo = fga.read(folder / "reconstruction.json").photos["0.jpg"]
    assert photo.position == pytest.approx(CENTRES[0], abs=1e-9)
    assert np.asarray(photo.rotation) == pytest.approx(rodrigues(TURNS[0]).T, abs=1e-12)


def test_ground_control_of_json_is_normalised(folder: Path) -> None:
    (folder / "gcp_list.txt").unlink()
    lon, lat, h = geographic(POINTS[:1] + 0.5)[0].tolist()
    marks = [
        {"shot_id": f"{i}.jpg", "projection": normalised(i, POINTS[:1] + 0.5)[0].tolist()}
        for i in range(4)
    ]
    position = {"latitude": lat, "longitude": lon, "altitude": h}
    points = [{"id": "0", "position": position, "observations": marks}]
    points.append({"id": "free", "observations": marks[:2]})
    path = folder / "ground_control_points.json"
    path.write_text(json.dumps({"points": points}, indent=1))
    network = fga.read(folder / "reconstruction.json")
    assert network.points["0"].coordinates == pytest.approx(POINTS[0] + 0.5, abs=1e-6)
    equations = compile_network(network)
    v = equations.residuals(approximate(equations))
    block = next(b for b in equations.blocks if b.kind == "image")
    row = list(block.ids).index("2.jpg/0")
    assert np.abs(v[block.rows].reshape(-1, 2)[row]).max() < 1e-6
    del position["altitude"]
    path.write_text(json.dumps({"points": points}, indent=1))
    control = next(iter(fga.read(folder / "reconstruction.json").observations.values()))
    assert isinstance(control, fga.ControlPoint) and control.axes == "en"


def test_the_largest_reconstruction_is_read_or_the_one_asked_for(folder: Path) -> None:
    document = json.loads((folder / "reconstruction.json").read_text())
    small = {"cameras": {"cam": BROWN}, "shots": {}, "points": {}}
    (folder / "reconstruction.json").write_text(json.dumps([small, *document]))
    assert len(fga.read(folder / "reconstruction.json").photos) == 4
    assert not fga.read(folder / "reconstruction.json", reconstruction=0).photos
    with pytest.raises(InputError, match="has no reconstruction 2; valid: 0 to 1"):
        fga.read(folder / "reconstruction.json", reconstruction=2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"brown"', '"dual"', r"reconstruction\.json:5: projection 'dual' cannot be read"),
        ('"focal_x": 0.85', '"focal_x": -1', r"focal_x must be greater than zero, not -1"),
        ('"k1": -0.05', '"k9": 1', r"unknown parameter 'k9' of brown"),
        ('"camera": "cam"', '"camera": "came"', r"unknown camera 'came'"),
        ('"k3": -0.004', '"k3": NaN', r"NaN is not a finite number"),
        ('"translation"', '"translations"', r"has no 'translation'; did you mean 'translations'"),
    ],
)
def test_wrong_reconstructions_are_refused(folder: Path, old: str, new: str, message: str) -> None:
    path = folder / "reconstruction.json"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        fga.read(path)


def test_lists_in_etrs89_lie_in_the_frame_of_wgs84(folder: Path) -> None:
    """ETRS89 is WGS84 to PROJ; its ellipsoid differs by 0.1 mm, and was refused."""
    pytest.importorskip("pyproj")
    from factorgraph_adj.crs.reference_system import ReferenceSystem

    network = fga.read(folder / "reconstruction.json")
    grid = ReferenceSystem("EPSG:32633", heights="ellipsoidal").from_frame(network.frame, CENTRES)
    rows = [f"{i}.jpg {x!r} {y!r} {z!r}" for i, (x, y, z) in enumerate(grid.tolist())]
    (folder / "geo.txt").write_text("\n".join(["EPSG:25833", *rows]) + "\n")
    options = {"positions": folder / "geo.txt", "sigma_positions": (0.02, 0.03)}
    again = fga.read(folder / "reconstruction.json", **options)
    found = [o.value for o in again.observations.values() if o.kind == "photo_position"]
    assert np.array(found) == pytest.approx(CENTRES, abs=1e-3)
    (said,) = again.remarks
    assert said.startswith("geo.txt: places were carried from ETRS89 / UTM zone 33N to WGS 84")
    path = folder / "gcp_list.txt"
    at = ReferenceSystem("EPSG:32633", heights="ellipsoidal").from_frame(
        network.frame, np.array([network.points["G0"].coordinates])
    )
    path.write_text("EPSG:25833\n" + " ".join(map(repr, at[0].tolist())) + " 1 2 0.jpg G0\n")
    moved = fga.read(folder / "reconstruction.json")
    assert [r.split(":")[0] for r in moved.remarks] == ["gcp_list.txt"]
    control = moved.points["G0"].coordinates
    assert control == pytest.approx(network.points["G0"].coordinates, abs=1e-3)


@pytest.mark.parametrize("system", ["WGS84 UTM 33N", "EPSG:32633", "+proj=utm +zone=33"])
def test_ground_control_in_a_grid_is_the_same(folder: Path, system: str) -> None:
    pytest.importorskip("pyproj")
    from factorgraph_adj.crs.reference_system import ReferenceSystem

    network = fga.read(folder / "reconstruction.json")
    names = ("G0", "G1", "G2", "G3")
    at = np.array([network.points[n].coordinates for n in names])
    grid = ReferenceSystem("EPSG:32633", heights="ellipsoidal").from_frame(network.frame, at)
    path = folder / "gcp_list.txt"
    rows = [r.split() for r in path.read_text().splitlines()[1:]]
    rows = [[*map(repr, grid[names.index(r[6])].tolist()), *r[3:]] for r in rows if r[6] in names]
    path.write_text("\n".join([system, *(" ".join(r) for r in rows)]))
    again = fga.read(folder / "reconstruction.json")
    for name in names:
        expected = network.points[name].coordinates
        assert again.points[name].coordinates == pytest.approx(expected, abs=1e-6)


def test_a_reconstruction_without_its_tracks_is_refused(folder: Path) -> None:
    (folder / "tracks.csv").rename(folder / "other.csv")
    message = r"reconstruction\.json: the image coordinates of its 9 tie points are in tracks\.csv"
    with pytest.raises(InputError, match=message) as refused:
        fga.read(folder / "reconstruction.json")
    assert "tracks=PATH (--set tracks=PATH)" in str(refused.value)
    network = fga.read(folder / "reconstruction.json", tracks=folder / "other.csv")
    assert network.images.size == 4 * (9 + 5)


def test_positions_have_the_checks_of_ground_control(folder: Path) -> None:
    """Another zone and the other order lie far away; an order that stays near is found by shape."""
    rows = [[f"{i}.jpg", *place] for i, place in enumerate(geographic(CENTRES).tolist())]
    path = folder / "geo.txt"
    options = {"positions": path, "sigma_positions": (0.02, 0.03)}

    def written(order: tuple[int, int], shift: float = 0.0) -> None:
        lines = [f"{r[0]} {r[order[0]] + shift!r} {r[order[1]]!r} {r[3]!r}" for r in rows]
        path.write_text("\n".join(["EPSG:4326", *lines]) + "\n")

    written((1, 2))
    assert len(fga.read(folder / "reconstruction.json", **options).observations) == 4 + 4
    written((2, 1))
    with pytest.raises(InputError, match=r"geo\.txt:2: lies \d{4} km .* longitude or easting"):
        fga.read(folder / "reconstruction.json", **options)
    written((1, 2), 6.0)
    with pytest.raises(InputError, match=r"geo\.txt:5: lies \d{3} km from latitude, longitude"):
        fga.read(folder / "reconstruction.json", **options)


def test_keys_tell_the_order_of_ground_control_in_json(folder: Path) -> None:
    """The first line of a list says nothing about ground_control_points.json."""
    (folder / "gcp_list.txt").unlink()
    position = {"latitude": LONGITUDE, "longitude": LATITUDE, "altitude": HEIGHT}
    points = [{"id": "A", "position": position, "observations": []}]
    (folder / "ground_control_points.json").write_text(json.dumps({"points": points}))
    with pytest.raises(InputError, match="degrees of WGS84 under their own keys") as refused:
        fga.read(folder / "reconstruction.json")
    assert "comes first" not in str(refused.value)


def test_an_unknown_system_of_ground_control_is_refused(folder: Path) -> None:
    path = folder / "gcp_list.txt"
    path.write_text(path.read_text().replace("WGS84", "UTM32", 1))
    with pytest.raises(InputError, match=r"gcp_list\.txt:1: unknown reference system 'UTM32'"):
        fga.read(folder / "reconstruction.json")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("13.4 52.5 40 10 20", r"gcp_list\.txt:3: a row has X Y Z column row image"),
        ("13.4 52.5 x 10 20 0.jpg", r"gcp_list\.txt:3: row: 'x' is not a number"),
        ("13.4 95 40 10 20 0.jpg N", r"gcp_list\.txt:3: latitude 95°"),
        ("13.4 52.5 40 10 20 0.jpg G0", r"point 'G0' has another place"),
        ("52.5 13.4 40 10 20 0.jpg N", r"gcp_list\.txt:3: lies \d{4} km .* longitude or easting"),
        ("13.4 54.5 40 10 20 0.jpg CHK-1 x", r"gcp_list\.txt:3: lies 223 km from latitude, lo"),
    ],
)
def test_wrong_ground_control_is_refused(folder: Path, line: str, message: str) -> None:
    path = folder / "gcp_list.txt"
    rows = path.read_text().splitlines()
    rows[2] = line
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match=message):
        fga.read(folder / "reconstruction.json")


# -- rolling shutter ------------------------------------------------------------------------------

READOUT_MS, SPEED = 33.0, np.array([8.0, -3.0, 1.0])


def roll(folder: Path) -> None:
    """Write image points of photos that move, as ODM's rs_correct takes them to be.

    The centre is that of the photo + speed × readout × (row − H/2)/H.
    """
    rng = np.random.default_rng(3)
    grid = np.linspace(-14.0, 28.0, 7)
    points = np.array([(x, y, rng.uniform(0.0, 15.0)) for x in grid for y in grid])
    document = json.loads((folder / "reconstruction.json").read_text())
    document[0]["points"] = {
        str(i): {"coordinates": p.tolist(), "color": [1, 2, 3]} for i, p in enumerate(points)
    }
    (folder / "reconstruction.json").write_text(json.dumps(document))
    (folder / "gcp_list.txt").unlink()
    rows = ["OPENSFM_TRACKS_VERSION_v2"]
    for i in range(4):
        xy = normalised(i, points)
        for _ in range(20):
            shift = SPEED * READOUT_MS / 1000.0 * (xy[:, 1:] * W) / H
            xy = np.concatenate([normalised(i, p[None]) for p in points - shift])
        for j, (x, y) in enumerate((xy + rng.normal(0, 0.1 / W, xy.shape)).tolist()):
            rows.append(f"{i}.jpg\t{j}\t{j}\t{x!r}\t{y!r}\t0.001\t1\t2\t3\t-1\t-1")
        (folder / "exif").mkdir(exist_ok=True)
        exif = {"make": "x", "speed": SPEED.tolist(), "rolling_shutter": READOUT_MS}
        (folder / "exif" / f"{i}.jpg.exif").write_text(json.dumps(exif))
    (folder / "tracks.csv").write_text("\n".join(rows) + "\n")


def test_motions_of_the_kind_that_odm_corrects_are_found(folder: Path) -> None:
    """With the readout time of the exif files; without motions the photos do not fit."""
    roll(folder)
    options = {"sigma_px": 0.1, "calibration": "held"}
    network = fga.read(folder / "reconstruction.json", rolling_shutter="estimate", **options)
    assert network.cameras["cam"].readout == pytest.approx(READOUT_MS / 1000.0, rel=1e-15)
    solution = fga.adjust(network)
    assert solution.converged and global_test(solution).accepted
    errors = []
    for photo in network.photos:
        found = solution.unknown("photo_motion", photo)
        errors.append((np.array(found.values) - (*SPEED, 0, 0, 0))[:3] / np.array(found.sigmas)[:3])
        assert max(found.sigmas[:2]) < 2.0
    assert np.abs(errors).max() < 4.0
    still = fga.adjust(fga.read(folder / "reconstruction.json", **options))
    assert still.sigma0 > global_test(still).upper


def test_image_points_that_odm_has_corrected_get_no_motion(folder: Path) -> None:
    (folder / "rs_done.txt").write_text("Done!\n")
    assert any(
        "corrected by ODM for a rolling" in r
        for r in fga.read(folder / "reconstruction.json").remarks
    )
    with pytest.raises(InputError, match=r"rs_done\.txt: image points of tracks.csv are corrected"):
        fga.read(folder / "reconstruction.json", rolling_shutter="estimate", readout=0.033)


def test_photos_of_different_readout_times_need_one_that_is_stated(folder: Path) -> None:
    roll(folder)
    path = folder / "exif" / "2.jpg.exif"
    path.write_text(json.dumps({"rolling_shutter": 25}))
    with pytest.raises(InputError, match=r"different readout times: 33 ms .*, 25 ms .*readout="):
        fga.read(folder / "reconstruction.json", rolling_shutter="estimate")
    assert fga.read(
        folder / "reconstruction.json", rolling_shutter="estimate", readout=0.025
    ).of_kind("photo_motion")
