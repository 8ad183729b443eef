"""transforms.json: image of a point by the conventions of nerfstudio, files that are wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from tests.hostile.examples import Example
from tests.networks.pixel_block import projected

CAMERA = {
    **{"fl_x": 900.0, "fl_y": 910.0, "cx": 330.0, "cy": 250.0, "w": 640, "h": 480},
    **{"k1": 0.05, "k2": -0.02, "p1": 0.003, "p2": -0.002},
}
TURNS = np.array([[0.1, -0.2, 0.3], [1.2, 0.1, -0.4]])
PLACES = np.array([[0.5, -0.3, 4.0], [0.2, -3.5, 1.5]])
POINT = np.array([0.3, 0.2, 0.4])


def document(**changes: Any) -> dict[str, Any]:
    frames = []
    for i, (turn, place) in enumerate(zip(TURNS, PLACES, strict=True)):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), place
        frames.append({"file_path": f"images/{i}.jpg", "transform_matrix": matrix.tolist()})
    return {"camera_model": "OPENCV", **CAMERA, "frames": frames, **changes}


def write(tmp_path: Path, content: object) -> Path:
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
    return path


def moving() -> dict[str, Any]:
    """Return a document of photos that move while their rows are read."""
    content = document(rolling_shutter_time=0.02)
    for frame in content["frames"]:
        frame["camera_linear_velocity"] = [2.0, -1.0, 0.5]
        frame["camera_angular_velocity"] = [0.3, -0.2, 0.6]
    return content


def between_poses() -> dict[str, Any]:
    """Return a document of photos that have poses at the start and the end alone."""
    content = document(rolling_shutter=[0.1, 0.0, 0.7])
    for frame in content["frames"]:
        start = frame.pop("transform_matrix")
        end = np.array(start) + np.outer([0.1, -0.2, 0.05, 0.0], [0, 0, 0, 1])
        frame |= {"transform_matrix_start": start, "transform_matrix_end": end.tolist()}
    return content


EXAMPLE_FILES = {
    "transforms between two poses": Example(
        "transforms",
        {"transforms.json": json.dumps(between_poses(), indent=1)},
        "transforms.json",
        open_names=True,
        places_only=True,
    ),
    "transforms of a rolling shutter": Example(
        "transforms",
        {"transforms.json": json.dumps(moving(), indent=1)},
        "transforms.json",
        open_names=True,
        places_only=True,
    ),
    "transforms": Example(
        "transforms",
        {"transforms.json": json.dumps(document(applied_scale=0.5), indent=1)},
        "transforms.json",
        open_names=True,
        places_only=True,
    ),
}


def image(i: int, point: np.ndarray, fisheye: bool = False) -> np.ndarray:
    """Return column and row by the formula of OpenCV, in axes with y down and z ahead."""
    q = Rotation.from_rotvec(TURNS[i]).inv().apply(point - PLACES[i])
    x, y = q[0] / -q[2], -q[1] / -q[2]
    c = CAMERA
    if fisheye:
        r = np.hypot(x, y)
        t = np.arctan(r)
        s = t * (1 + c["k1"] * t**2 + c["k2"] * t**4) / r
        u, v = s * x, s * y
    else:
        r2 = x * x + y * y
        s = 1 + c["k1"] * r2 + c["k2"] * r2**2
        u = s * x + 2 * c["p1"] * x * y + c["p2"] * (r2 + 2 * x * x)
        v = s * y + c["p1"] * (r2 + 2 * y * y) + 2 * c["p2"] * x * y
    return np.array([c["fl_x"] * u + c["cx"], c["fl_y"] * v + c["cy"]])


@pytest.mark.parametrize("fisheye", [False, True])
def test_a_point_has_the_image_of_opencv(tmp_path: Path, fisheye: bool) -> None:
    model = "OPENCV_FISHEYE" if fisheye else "OPENCV"
    network = fga.read(write(tmp_path, document(camera_model=model)))
    network.add_point("P", POINT.tolist())
    found = projected(network, ["P"])
    for i, photo in enumerate(network.photos):
        x, y = found[photo][0]
        assert (x, -y) == pytest.approx(image(i, POINT, fisheye), abs=1e-8)


def test_the_applied_motion_and_scale_are_undone(tmp_path: Path) -> None:
    """nerfstudio: the file's pose is that of COLMAP, moved by the transform, then scaled."""
    applied = np.array([[0, 1, 0, 0.5], [1, 0, 0, -1.0], [0, 0, -1, 2.0]], dtype=float)
    moved = document()
    for frame in moved["frames"]:
        matrix = np.array(frame["transform_matrix"])
        new = applied @ matrix
        new[:, 3] *= 0.25
        frame["transform_matrix"] = new.tolist()
    path = write(tmp_path, moved | {"applied_transform": applied.tolist(), "applied_scale": 0.25})
    network = fga.read(path)
    plain = tmp_path / "plain"
    plain.mkdir()
    expected = fga.read(write(plain, document()))
    for name, photo in expected.photos.items():
        assert network.photos[name].position == pytest.approx(photo.position)
        np.testing.assert_allclose(network.photos[name].rotation, photo.rotation, atol=1e-12)


def test_an_angle_gives_the_focal_length_and_a_frame_may_have_its_own_camera(
    tmp_path: Path,
) -> None:
    content = document()
    for key in (*CAMERA, "camera_model"):
        del content[key]
    content |= {"camera_angle_x": np.pi / 2}
    content["frames"][1] |= {"fl_x": 700.0, "w": 800, "h": 600}
    with pytest.raises(InputError, match=r"no size of the images, w and h: state size="):
        fga.read(write(tmp_path, content))
    network = fga.read(write(tmp_path, content), size=(640, 480))
    cameras = [network.cameras[p.camera] for p in network.photos.values()]
    assert [c.values[0] for c in cameras] == pytest.approx([320.0, 700.0])
    assert [c.values[1] for c in cameras] == pytest.approx([320.0, 400.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, r"transforms\.json:2: camera model 'EQUI.* not read"),
        ({"fl_x": -1.0}, r"transforms\.json:3: fl_x"),
        ({"applied_transform": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}, "no rotation and shi"),
        ({"frames": [{"file_path": "a"}]}, "has no 'transform_matrix'"),
        ({"frames": document()["frames"][:1] * 2}, "images/0.jpg"),
        (
            {"rolling_shutter": [0, 0, 1, 1]},
            r"transforms\.json:\d+: rolling_shutter .* motion blur",
        ),
        ({"rolling_shutter": [0, 1, 1, 0]}, r"valid: \[A, B, 0, 0\] or \[A, 0, C, 0\]"),
        ({"rolling_shutter_time": -0.1}, "rolling_shutter_time"),
        ({"rolling_shutter": [0, 1]}, "rolling_shutter needs 4 numbers, not 2"),
        (
            {"rolling_shutter": [0, 0, 1], "rolling_shutter_time": 0.1},
            "rolling_shutter beside rolling_shutter_time",
        ),
        (
            {"rolling_shutter_time": 0.1, "frames": between_poses()["frames"]},
            "transform_matrix_end of instant-ngp beside rolling_shutter_time",
        ),
    ],
)
def test_files_that_are_wrong(tmp_path: Path, changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, document(**changes)), format="transforms")


# -- rolling shutter ------------------------------------------------------------------------------

READOUT, VELOCITY, TURN = 0.02, np.array([2.0, -1.0, 0.5]), np.array([0.3, -0.2, 0.6])
"""Readout time, velocity and turn in the axes of the camera, y up: m/s and rad/s."""


def moved(i: int, t: float) -> tuple[Rotation, np.ndarray]:
    """Return the pose of photo i at the time t from its middle row."""
    pose = Rotation.from_rotvec(TURNS[i])
    return pose * Rotation.from_rotvec(TURN * t), PLACES[i] + pose.apply(VELOCITY) * t


def matrix_of(turned: Rotation, place: np.ndarray) -> list[list[float]]:
    """Return a pose as the file has it."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned.as_matrix(), place
    return matrix.tolist()


def rolling_image(i: int, point: np.ndarray, time_of: Any) -> np.ndarray:
    """Return column and row of a point whose pose is that of the time of its pixel."""
    at = np.array([320.0, 240.0])
    for _ in range(60):
        turned, place = moved(i, time_of(at / (640.0, 480.0)))
        still = Rotation.from_rotvec(TURNS[i]).apply(turned.inv().apply(point - place)) + PLACES[i]
        at = image(i, still)
    return at


def assert_images(network: fga.Network, time_of: Any) -> None:
    """Compare the images of a point at the poses and motions of a network."""
    network.add_point("P", POINT.tolist())
    expected = []
    for i, photo in enumerate(network.photos):
        column, row = rolling_image(i, POINT, time_of)
        network.add_image_points(photo, ["P"], [(column, -row)], sigma=1.0)
        expected.append((column, row))
    equations = compile_network(network)
    v = equations.residuals(equations.unknowns.start())
    np.testing.assert_allclose(v, 0.0, atol=1e-8)
    stills = [image(i, POINT) for i in range(2)]
    assert np.abs(np.subtract(expected, stills)).max() > 0.5


def test_velocities_are_those_of_the_camera_at_the_middle_row(tmp_path: Path) -> None:
    """Spectacular AI: a row y is read at T (y/h − 1/2); world and velocities may be scaled."""
    content = document(rolling_shutter_time=READOUT, applied_scale=2.0)
    for frame in content["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] *= 2.0
        frame |= {
            "transform_matrix": matrix.tolist(),
            "camera_linear_velocity": (2.0 * VELOCITY).tolist(),
            "camera_angular_velocity": TURN.tolist(),
        }
    network = fga.read(write(tmp_path, content))
    assert network.cameras["camera"].readout == READOUT
    assert_images(network, lambda uv: READOUT * (uv[1] - 0.5))


@pytest.mark.parametrize(
    ("times", "axis"),
    [([0.1, 0.0, 0.7, 0.0], 1), ([0.9, -0.6, 0.0, 0.0], 0), ([0.1, 0.0, 0.7], 1)],
)
@pytest.mark.parametrize("start", ["transform_matrix_start", "transform_matrix"])
def test_times_of_pixels_are_between_two_poses(
    tmp_path: Path, times: list[float], axis: int, start: str
) -> None:
    """instant-ngp: A + B u + C v is the part of the way from the first to the last pose.

    The first one is transform_matrix where it has no key of its own.
    """
    content = document(rolling_shutter=times)
    middle = times[0] + times[1 + axis] / 2
    for i, frame in enumerate(content["frames"]):
        del frame["transform_matrix"]
        for key, part in ((start, 0.0), ("transform_matrix_end", 1.0)):
            frame[key] = matrix_of(*moved(i, READOUT * (part - middle)))
    network = fga.read(write(tmp_path, content))
    assert network.cameras["camera"].readout_towards == ("right", "down")[axis]
    assert_images(network, lambda uv: READOUT * (times[0] + times[1 + axis] * uv[axis] - middle))


@pytest.mark.parametrize("times", [None, [0.25, 0.0, 0.0, 0.0], [0.25, 0.0, 0.0]])
def test_one_time_of_all_pixels_is_a_pose_between_two(
    tmp_path: Path, times: list[float] | None
) -> None:
    """instant-ngp: t = A, zero without rolling_shutter; the plain pose has no part in it."""
    content = document() if times is None else document(rolling_shutter=times)
    before = 0.0 if times is None else times[0]
    for i, frame in enumerate(content["frames"]):
        for word, part in (("start", 0.0), ("end", 1.0)):
            frame[f"transform_matrix_{word}"] = matrix_of(*moved(i, READOUT * (part - before)))
        frame["transform_matrix"] = matrix_of(*moved(i, 10.0))
    network = fga.read(write(tmp_path, content))
    assert not network.of_kind("photo_motion")
    (left,) = network.left_out
    assert (left.what, left.count) == ("transform_matrix beside transform_matrix_start", 2)
    for i, photo in enumerate(network.photos.values()):
        assert photo.position == pytest.approx(PLACES[i], abs=1e-12)
    network.add_point("P", POINT.tolist())
    for i, found in enumerate(projected(network, ["P"]).values()):
        assert (found[0][0], -found[0][1]) == pytest.approx(image(i, POINT), abs=1e-8)


def test_a_photo_with_a_start_alone_stands_still(tmp_path: Path) -> None:
    """instant-ngp: without an end the end is the start, whatever transform_matrix is."""
    content = document(rolling_shutter=[0.0, 0.0, 1.0, 0.0])
    for i, frame in enumerate(content["frames"]):
        frame["transform_matrix_start"] = frame["transform_matrix"]
        frame["transform_matrix"] = matrix_of(*moved(i, 1.0))
    network = fga.read(write(tmp_path, content))
    assert not network.of_kind("photo_motion")
    for i, photo in enumerate(network.photos.values()):
        assert photo.position == pytest.approx(PLACES[i], abs=1e-12)


def test_velocities_without_a_readout_time_are_left_out(tmp_path: Path) -> None:
    content = document()
    content["frames"][0]["camera_linear_velocity"] = VELOCITY.tolist()
    network = fga.read(write(tmp_path, content))
    assert [(e.what, e.count) for e in network.left_out] == [("velocities of photos", 1)]
    assert not network.of_kind("photo_motion")


def test_known_poses_become_a_model_of_colmap(tmp_path: Path) -> None:
    """Without points and image points; COLMAP's own reader has the same cameras and poses."""
    network = fga.read(write(tmp_path, document()))
    fga.write(network, tmp_path / "sparse", format="colmap")
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(str(tmp_path / "sparse"))
    images = {image.name: image for image in model.images.values()}
    assert set(images) == set(network.photos) and model.num_points3D() == 0
    for name, photo in network.photos.items():
        assert images[name].projection_center() == pytest.approx(photo.position, abs=1e-12)
    (camera,) = model.cameras.values()
    assert camera.model.name == "OPENCV"
    order = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")
    assert camera.params == pytest.approx([CAMERA[k] for k in order], rel=1e-12)
