"""Kalibr: images of points by its formulas, rigs, targets, files that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from tests.hostile.examples import Example

R0, T0 = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix(), np.array([0.1, 0.02, -0.05])
R1, T1 = Rotation.from_rotvec([0.02, 0.01, -0.03]).as_matrix(), np.array([-0.12, 0.001, 0.004])


def motion(rotation: np.ndarray, shift: np.ndarray) -> str:
    rows = [*np.hstack([rotation, shift[:, None]]).tolist(), [0.0, 0.0, 0.0, 1.0]]
    return "\n".join(f"  - [{', '.join(f'{v:.15f}' for v in row)}]" for row in rows)


INERTIAL = f"""\
%YAML:1.0

cam0:
  T_cam_imu:
{motion(R0, T0)}
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.0001]
  distortion_model: radtan
  intrinsics: [458.0, 457.0, 367.0, 248.0] # fu, fv, cu, cv
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  line_delay: 3.5e-05
cam1:
  T_imu_cam:
{motion((R1 @ R0).T, -(R1 @ R0).T @ (R1 @ T0 + T1))}
  camera_model: pinhole
  distortion_coeffs: [0.03, -0.02, 0.01, -0.003]
  distortion_model: equidistant
  intrinsics: [300.0, 301.0, 370.0, 240.0]
  resolution: [752, 480]
"""
CHAIN = f"""\
cam0:
  camera_model: omni
  intrinsics: [0.8, 700.0, 701.0, 320.0, 240.0]
  distortion_model: none
  distortion_coeffs: []
  resolution: [640, 480]
cam1:
  T_cn_cnm1:
{motion(R1, T1)}
  camera_model: eucm
  intrinsics: [0.6, 1.1, 300.0, 301.0, 320.0, 240.0]
  resolution: [640, 480]
"""
GRID = "target_type: 'aprilgrid'\ntagCols: 3\ntagRows: 2\ntagSize: 0.08\ntagSpacing: 0.25\n"
UNREAD = (
    r"\|#|\|fu,|\|fv,|\|cu,|\|cv\||%YAML|cam_overlaps|rostopic|\[1\]|image_raw",
    r"qz7x\|intrinsics",
)
EXAMPLE_FILES = {
    "kalibr": Example("kalibr", {"chain.yaml": INERTIAL}, "chain.yaml", unread=UNREAD),
    "kalibr target": Example("kalibr", {"april.yaml": GRID}, "april.yaml", places_only=True),
}


def write(tmp_path: Path, text: str, name: str = "chain.yaml") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def images(network: fga.Network, point: np.ndarray) -> dict[str, np.ndarray]:
    """Return column and row of a point in the cameras, from the corner, y down."""
    network.add_point("P", point.tolist())
    cameras = [p for p in network.photos if p != "imu"]
    for photo in cameras:
        network.add_image_points(photo, ["P"], np.zeros((1, 2)), sigma=1.0)
    equations = compile_network(network)
    v = equations.residuals(equations.unknowns.start())
    out = {}
    for block in (b for b in equations.blocks if b.kind == "image"):
        for ident, xy in zip(block.ids, v[block.rows].reshape(-1, 2), strict=True):
            out[ident.split("/")[0]] = xy * [1.0, -1.0]
    return out


def test_cameras_on_an_inertial_unit_see_points_as_kalibr_says(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, INERTIAL))
    point = np.array([0.4, -0.3, 2.5])
    found = images(network, point)
    p = R0 @ point + T0
    x, y = p[:2] / p[2]
    r2, (k1, k2, p1, p2) = x * x + y * y, (-0.28, 0.07, 0.0002, 0.0001)
    s = 1 + k1 * r2 + k2 * r2**2
    u = s * x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = s * y + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    assert found["cam0"] == pytest.approx([458 * u + 367.5, 457 * v + 248.5], abs=1e-8)
    p = R1 @ p + T1
    x, y = p[:2] / p[2]
    r = np.hypot(x, y)
    t = np.arctan(r)
    s = t * (1 + 0.03 * t**2 - 0.02 * t**4 + 0.01 * t**6 - 0.003 * t**8) / r
    assert found["cam1"] == pytest.approx([300 * s * x + 370.5, 301 * s * y + 240.5], abs=1e-8)


def test_cameras_of_a_chain_stand_on_the_first(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, CHAIN))
    assert list(network.photos) == ["cam0", "cam1"]
    point = np.array([0.5, -0.4, 1.5])
    found = images(network, point)
    d = np.linalg.norm(point)
    omni = point[:2] / (point[2] + 0.8 * d)
    assert found["cam0"] == pytest.approx(omni * [700, 701] + [320.5, 240.5], abs=1e-8)
    p = R1 @ point + T1
    d = np.sqrt(1.1 * (p[:2] @ p[:2]) + p[2] ** 2)
    eucm = p[:2] / (0.6 * d + 0.4 * p[2])
    assert found["cam1"] == pytest.approx(eucm * [300, 301] + [320.5, 240.5], abs=1e-8)


def test_the_rig_is_tied_by_its_mounts(tmp_path: Path) -> None:
    solution = fga.adjust(fga.read(write(tmp_path, CHAIN)))
    assert solution.pose("cam1").position == pytest.approx(-R1.T @ T1, abs=1e-9)
    free = fga.read(write(tmp_path, CHAIN), calibration="free")
    assert not all(free.cameras["cam1"].fixed)


def test_points_of_targets(tmp_path: Path) -> None:
    grid = fga.read(write(tmp_path, GRID))
    assert len(grid.points) == 4 * 3 * 2
    assert grid.points["1"].coordinates == pytest.approx((0.08, 0.0, 0.0))
    assert grid.points["2"].coordinates == pytest.approx((0.10, 0.0, 0.0))  # a gap of 0.25 × 0.08
    assert grid.points["12"].coordinates == pytest.approx((0.0, 0.10, 0.0))
    board = (
        "target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\n"
        "rowSpacingMeters: 0.06\ncolSpacingMeters: 0.05\n"
    )
    points = fga.read(write(tmp_path, board)).points
    assert len(points) == 42
    assert points["7"].coordinates == pytest.approx((0.05, 0.06, 0.0))
    circles = (
        "target_type: circlegrid\ntargetCols: 3\ntargetRows: 4\n"
        "spacingMeters: 0.02\nasymmetricGrid: True\n"
    )
    points = fga.read(write(tmp_path, circles)).points
    assert points["4"].coordinates == pytest.approx((0.06, 0.02, 0.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "model: radtan",
            "model: brown",
            r"chain\.yaml:12: .*'brown' of pinhole is unknown; valid",
        ),
        (
            "model: pinhole\n  distortion_coeffs: [-",
            "model: ds\n  distortion_coeffs: [-",
            "'ds' is",
        ),
        ("[458.0, 457.0,", "[458.0,", r"chain\.yaml:13: cam0 intrinsics needs 4 numbers, not 3"),
        ("[752, 480]\n  rost", "[752, x]\n  rost", r"chain\.yaml:14: cam0 resolution: 'x' is not"),
        ("T_imu_cam", "T_imu_cma", r"cam1 T_imu_cma is unknown; valid: camera_model, intrinsics"),
        ("cam1:", "camera1:", r"chain\.yaml:\d+: camera1 is unknown; valid: cam0, cam1"),
        ("  distortion_model: equidistant\n", "", r"cam1 has distortion_coeffs|distortion"),
    ],
)
def test_files_that_are_wrong(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert INERTIAL.count(old) == 1
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, INERTIAL.replace(old, new)))


def test_a_camera_without_a_place_and_a_target_without_a_size_are_refused(tmp_path: Path) -> None:
    text = CHAIN[: CHAIN.index("  T_cn")] + CHAIN[CHAIN.index("  camera_model: eucm") :]
    with pytest.raises(InputError, match="cam1 has no place in the rig"):
        fga.read(write(tmp_path, text))
    with pytest.raises(InputError, match="the target has no tagSize"):
        fga.read(write(tmp_path, GRID.replace("tagSize: 0.08\n", "")))


@pytest.mark.parametrize(
    ("delay", "readout"), [("3.5e-05", (480 * 3.5e-5, "down")), ("-2e-5", (480 * 2e-5, "up"))]
)
def test_a_delay_of_lines_is_a_readout_time(
    tmp_path: Path, delay: str, readout: tuple[float, str]
) -> None:
    """Kalibr: a row is read line_delay × row after the first one, in seconds."""
    network = fga.read(write(tmp_path, INERTIAL.replace("3.5e-05", delay)))
    camera = network.cameras["cam0"]
    assert (camera.readout, camera.readout_towards) == (pytest.approx(readout[0]), readout[1])
    assert network.cameras["cam1"].readout is None
    times = camera.times()
    assert times is not None
    rows = times.times(np.zeros(2), np.array([0.0, -480.0]))
    assert rows[1] - rows[0] == pytest.approx(float(delay) * 480)


def test_rows_without_a_delay_are_exposed_at_once(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, INERTIAL.replace("3.5e-05", "0.0")))
    assert network.cameras["cam0"].readout is None
    with pytest.raises(InputError, match="line_delay"):
        fga.read(write(tmp_path, INERTIAL.replace("3.5e-05", "fast")))
