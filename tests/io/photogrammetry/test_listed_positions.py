"""Positions of photos for every reader of free models: same places, same checks, same messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.photogrammetry.coordinate_lists import (
    ORDER_OF_COLUMNS,
    ORDER_OF_LINES,
    ListedSystem,
    ListSystem,
    list_system,
)

PLACE = fga.TopocentricFrame(np.deg2rad(47.6), np.deg2rad(8.9), 400.0, "WGS84")
GRID = [(x, y, 60.0 + 3.0 * ((x + y) % 3)) for x in (0.0, 30.0, 61.0) for y in (0.0, 42.0)]
CENTRES = np.array(GRID)
"""Projection centres of a flight, metres in the frame at `PLACE`."""
POINTS = np.array([(x, y, 0.2 * x - 0.1 * y) for x in (-5.0, 20, 50, 70) for y in (-9.0, 20, 50)])
DOWN = Rotation.from_euler("x", 180, degrees=True)
TURNS = [Rotation.from_rotvec([0.02 * i, -0.03 * i, 0.4 * i]) * DOWN for i in range(len(GRID))]
"""Rotations from the frame at `PLACE` to the axes of the cameras, x right, y down, z ahead."""
MODEL = Rotation.from_rotvec([0.7, -0.4, 1.1])
SCALE, SHIFT, F = 0.05, np.array([3.0, -2.0, 8.0]), 2000.0


def in_model(places: np.ndarray) -> np.ndarray:
    return SCALE * MODEL.apply(places) + SHIFT


def pixels(i: int) -> np.ndarray:
    """Return image coordinates of all points from the principal point, y down."""
    q = TURNS[i].apply(POINTS - CENTRES[i])
    return F * q[:, :2] / q[:, 2:]


def nvm(folder: Path) -> Path:
    lines = ["NVM_V3", "", str(len(GRID))]
    for i, centre in enumerate(in_model(CENTRES)):
        x, y, z, w = (TURNS[i] * MODEL.inv()).as_quat()
        numbers = " ".join(f"{v:.12f}" for v in (w, x, y, z, *centre))
        lines.append(f"{i}.jpg {F} {numbers} 0 0")
    lines += ["", str(len(POINTS))]
    for j, at in enumerate(in_model(POINTS)):
        rays = " ".join(f"{i} 1 {u:.6f} {v:.6f}" for i in range(6) for u, v in [pixels(i)[j]])
        lines.append(f"{' '.join(f'{v:.9f}' for v in at)} 1 2 3 6 {rays}")
    path = folder / "model.nvm"
    path.write_text("\n".join([*lines, "0", ""]))
    return path


def bundler(folder: Path) -> Path:
    """Bundler looks along −z with y up."""
    flip = np.diag([1.0, -1.0, -1.0])
    lines = ["# Bundle file v0.3", f"{len(GRID)} {len(POINTS)}"]
    for i, centre in enumerate(in_model(CENTRES)):
        r = flip @ (TURNS[i] * MODEL.inv()).as_matrix()
        rows = [[F, 0, 0], *r.tolist(), (-r @ centre).tolist()]
        lines += [" ".join(f"{v:.12f}" for v in row) for row in rows]
    for j, at in enumerate(in_model(POINTS)):
        rays = " ".join(f"{i} 1 {u:.6f} {-v:.6f}" for i in range(6) for u, v in [pixels(i)[j]])
        lines += [" ".join(f"{v:.9f}" for v in at), "1 2 3", f"6 {rays}"]
    path = folder / "bundle.out"
    path.write_text("\n".join(lines) + "\n")
    (folder / "list.txt").write_text("".join(f"{i}.jpg\n" for i in range(6)))
    return path


def meshroom(folder: Path) -> Path:
    views = [{"viewId": i, "poseId": i, "intrinsicId": 1, "path": f"{i}.jpg"} for i in range(6)]
    camera = {"intrinsicId": 1, "width": 4000, "height": 3000, "sensorWidth": 4000.0}
    camera |= {"sensorHeight": 3000.0, "type": "pinhole", "focalLength": F, "pixelRatio": 1.0}
    camera |= {"principalPoint": [0, 0], "distortionType": "none", "distortionParams": []}
    camera |= {"undistortionType": "none", "locked": True}
    poses = []
    for i, centre in enumerate(in_model(CENTRES)):
        r = (TURNS[i] * MODEL.inv()).as_matrix().T.ravel().tolist()
        poses.append({"poseId": i, "pose": {"transform": {"rotation": r, "center": list(centre)}}})
    seen = [
        {
            "landmarkId": j,
            "X": list(at),
            "observations": [
                {"observationId": i, "x": (pixels(i)[j] + [2000.0, 1500.0]).tolist()}
                for i in range(6)
            ],
        }
        for j, at in enumerate(in_model(POINTS))
    ]

    def texts(value):
        if isinstance(value, dict):
            return {k: texts(v) for k, v in value.items()}
        if isinstance(value, list):
            return [texts(v) for v in value]
        return value if isinstance(value, bool) else str(value)

    content = {"version": [1, 2, 11], "views": views, "intrinsics": [camera], "poses": poses}
    path = folder / "model.sfm"
    path.write_text(json.dumps(texts({**content, "structure": seen}), indent=1))
    return path


MAKERS = {"nvm": nvm, "bundler": bundler, "meshroom": meshroom}


def listed(order: str = "lon lat") -> np.ndarray:
    """Return longitude and latitude of the projection centres, or latitude first, and height."""
    latitude, longitude, height = PLACE.geodetic(CENTRES)
    first, second = np.rad2deg(longitude), np.rad2deg(latitude)
    if order == "lat lon":
        first, second = second, first
    return np.stack([first, second, height], 1)


def geo(folder: Path, order: str = "lon lat", system: str = "EPSG:4326") -> Path:
    rows = [
        f"{i}.jpg {a!r} {b!r} {h!r} 0 0 0 0.02 0.03"
        for i, (a, b, h) in enumerate(listed(order).tolist())
    ]
    path = folder / "geo.txt"
    path.write_text("\n".join([system, *rows]) + "\n")
    return path


def read(kind: str, folder: Path, **options: object) -> fga.Network:
    more = {"images": folder / "list.txt"} if kind == "bundler" else {}
    return fga.read(MAKERS[kind](folder), **more, **options)


@pytest.mark.parametrize("kind", MAKERS)
def test_positions_place_every_model(kind: str, tmp_path: Path) -> None:
    """Without noise points and poses come to their true places within a hundredth of a mm."""
    assert read(kind, tmp_path).datum == "free"
    network = read(kind, tmp_path, positions=geo(tmp_path))
    assert network.datum == "given" and isinstance(network.frame, fga.TopocentricFrame)
    observed = [o for o in network.observations.values() if o.kind == "photo_position"]
    assert [o.sigma for o in observed] == [(0.02, 0.02, 0.03)] * 6
    assert {left.what for left in network.left_out} == {"yaw, pitch and roll of photos"}
    solution = fga.adjust(network)
    assert solution.converged and solution.datum_defect == 0
    latitude, longitude, height = network.frame.geodetic(
        np.array([solution.pose(f"{i}.jpg").position for i in range(6)])
    )
    found = np.stack([np.rad2deg(longitude), np.rad2deg(latitude), height], 1)
    assert found == pytest.approx(listed(), abs=1e-7)
    heights = network.frame.geodetic(np.array([solution.point(n) for n in network.points]))[2]
    assert heights == pytest.approx(PLACE.geodetic(POINTS)[2], abs=1e-3)


@pytest.mark.parametrize("kind", MAKERS)
def test_latitude_first_is_refused_in_every_model(kind: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^geo\.txt: its 6 places fit .* x and y exchanged"):
        read(kind, tmp_path, positions=geo(tmp_path, "lat lon"))


@pytest.mark.parametrize("kind", MAKERS)
def test_options_of_positions_need_positions(kind: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sigma_positions and positions_system belong to posit"):
        read(kind, tmp_path, sigma_positions=(0.1, 0.2))


def test_a_table_tells_its_order_by_its_columns(tmp_path: Path) -> None:
    """Advice on the first line of a list would be wrong there."""
    rows = [f"{i}.jpg,{a!r},{b!r},{h!r}" for i, (a, b, h) in enumerate(listed("lat lon").tolist())]
    path = tmp_path / "flight.csv"
    path.write_text("\n".join(["label,longitude,latitude,altitude", *rows]) + "\n")
    with pytest.raises(InputError, match="columns named longitude and latitude") as refused:
        read("nvm", tmp_path, positions=path, sigma_positions=(0.1, 0.2))
    assert "comes first" not in str(refused.value)


def test_positions_on_a_line_do_not_place_a_model(tmp_path: Path) -> None:
    path = geo(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:3]) + "\n")
    with pytest.raises(
        InputError, match=r"geo\.txt: control points and positions of photos give 2"
    ):
        read("nvm", tmp_path, positions=path)


def test_exchanged_grid_coordinates_fit_after_an_exchange() -> None:
    """Poland's EPSG:2180 has numbers of the same size in both coordinates."""
    pytest.importorskip("pyproj")
    grid = list_system("EPSG:2180").grid
    assert grid is not None
    at = CENTRES + np.array([500e3, 300e3, 0.0])
    frame = grid.frame_at(at)
    of = ListedSystem(ListSystem(grid), ORDER_OF_LINES, "geo.txt")
    right = grid.to_frame(frame, at)
    assert of.problem_of_order(frame, in_model(CENTRES), right) == ""
    there = of.system.exchanged(frame, right)
    said = of.problem_of_order(frame, in_model(CENTRES), there)
    assert "its 6 places fit" in said and said.endswith(ORDER_OF_LINES)


def test_an_exchange_that_leaves_the_earth_explains_nothing() -> None:
    """A longitude of 100° is no latitude: the misfit has another reason."""
    east = fga.TopocentricFrame(0.5, np.deg2rad(100.0), 0.0, "WGS84")
    assert np.isnan(ListSystem().exchanged(east, CENTRES)).any()
    of = ListedSystem(ListSystem(), ORDER_OF_LINES, "geo.txt")
    bent = CENTRES + np.array([[0.0, 0, 0]] * 5 + [[90.0, 10, 0]])
    assert of.problem_of_order(east, in_model(CENTRES), bent) == ""


@pytest.mark.parametrize("sigma", [0.02, 1.0, 5.0])
def test_errors_of_positions_are_no_exchange(sigma: float) -> None:
    """Errors of 8 % of the extent of a flight are no reason: they are as large in both orders."""
    of = ListedSystem(ListSystem(), ORDER_OF_COLUMNS, "flight.csv")
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noisy = CENTRES + rng.normal(0.0, sigma, CENTRES.shape)
        assert of.problem_of_order(PLACE, in_model(CENTRES), noisy) == ""


def test_a_position_far_from_the_frame_of_its_block_is_refused() -> None:
    """The same limit as for ground control, with the advice of the file."""
    of = ListedSystem(ListSystem(), ORDER_OF_COLUMNS, "flight.csv")
    x, y, _ = of.place(PLACE, (8.9 + 1.0, 47.6, 400.0))
    assert np.hypot(x, y) == pytest.approx(75.2e3, abs=100.0)
    with pytest.raises(InputError, match=r"lies 150 km from .* 47\.6°, 8\.9° .* columns named"):
        of.place(PLACE, (8.9 + 2.0, 47.6, 400.0))


def mrk(folder: Path, status: dict[int, int] | None = None) -> Path:
    """Write the positions as DJI does: number, time, offsets, place, σ, status."""
    rows = [
        f"{i + 1}\t400373.48{i}\t[2264]\t{i - 40},N\t{i},E\t86,V\t{lat:.8f},Lat\t{lon:.8f},Lon\t"
        f"{h:.3f},Ellh\t0.011, 0.012, 0.030\t{(status or {}).get(i, 50)},Q"
        for i, (lon, lat, h) in enumerate(listed().tolist())
    ]
    path = folder / "flight_Timestamp.MRK"
    path.write_text("\n".join(rows) + "\n")
    return path


def numbered(folder: Path, names: str = "DJI_20240501_{:04}_V.JPG") -> Path:
    """Return a model whose photos have the names of DJI."""
    path = nvm(folder)
    text = path.read_text()
    for i in range(6):
        text = text.replace(f"{i}.jpg ", names.format(i + 1) + " ")
    path.write_text(text)
    return path


@pytest.mark.parametrize("names", ["DJI_20240501_{:04}_V.JPG", "flight/100_0005_{:04}.JPG"])
def test_positions_of_mrk_belong_to_the_numbers_of_files(tmp_path: Path, names: str) -> None:
    """σ are north, east, elevation in the file, and x, y, z (east first) in the network."""
    network = fga.read(numbered(tmp_path, names), positions=mrk(tmp_path))
    observed = list(network.observations.values())
    assert [o.photo for o in observed] == [names.format(i + 1) for i in range(6)]
    assert {o.sigma for o in observed} == {(0.012, 0.011, 0.03)}
    latitude, longitude, height = network.frame.geodetic(np.array([o.value for o in observed]))
    found = np.stack([np.rad2deg(longitude), np.rad2deg(latitude), height], 1)
    assert found[:, :2] == pytest.approx(listed()[:, :2], abs=6e-9)
    assert found[:, 2] == pytest.approx(listed()[:, 2], abs=6e-4)


def test_positions_that_are_not_fixed_need_their_accuracy(tmp_path: Path) -> None:
    """σ of a single-point solution of real files are 3 cm, and its errors metres."""
    model, path = numbered(tmp_path), mrk(tmp_path, {2: 16, 4: 0})
    with pytest.raises(InputError, match=r"MRK:3: has no accuracy \(RTK status 16 is not 50, fix"):
        fga.read(model, positions=path)
    network = fga.read(model, positions=path, sigma_positions=(2.0, 4.0))
    sigma = {o.photo[-10:-6]: o.sigma for o in network.observations.values()}
    assert sigma["0003"] == (2.0, 2.0, 4.0) and sigma["0001"] == (0.012, 0.011, 0.03)
    assert "0005" not in sigma
    assert any("RTK status is 0" in left.why for left in network.left_out)


def test_two_images_of_one_number_have_no_position(tmp_path: Path) -> None:
    """Two cameras, or two folders: their positions would be guessed."""
    model = numbered(tmp_path)
    model.write_text(model.read_text().replace("0002_V", "0001_T"))
    network = fga.read(model, positions=mrk(tmp_path))
    assert len(network.observations) == 4
    assert any(left.doubtful and left.count == 2 for left in network.left_out)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (",Lat", ",La", r"MRK:1: a row has number, time, \[week\]"),
        ("0.011", "x", r"MRK:1: σ north: 'x' is not a number"),
        ("0.011", "0", r"MRK:1: σ north"),
    ],
)
def test_rows_of_mrk_that_are_wrong(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = mrk(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        fga.read(numbered(tmp_path), positions=path)


def test_a_table_without_a_header_asks_for_one(tmp_path: Path) -> None:
    path, rows = tmp_path / "pix4d.csv", listed().tolist()
    path.write_text("".join(f"{i}.jpg,{b!r},{a!r},{h!r}\n" for i, (a, b, h) in enumerate(rows)))
    with pytest.raises(InputError, match="needs one, such as image,latitude,longitude,altitude"):
        read("nvm", tmp_path, positions=path)
