"""Meshroom: a block of known truth by AliceVision's formulas, versions, files that are wrong."""

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

W, H = 4000, 3000
CENTRES = np.array([[-2.0, 0.1, 0.0], [0.0, -0.2, 0.3], [2.0, 0.2, -0.1]])
TURNS = np.array([[0.02, 0.25, 0.01], [-0.03, 0.02, 0.5], [0.01, -0.2, -0.4]])
POINTS = [(x, y, 8.0 + 0.5 * x * y) for x in (-2.0, -0.7, 0.6, 1.9) for y in (-1.6, 0.1, 1.5)]
FX, FY, X0, Y0 = 3000.0, 3030.0, 2020.0, 1480.0
BROWN = {"k1": -0.05, "k2": 0.02, "k3": -0.004, "t1": 1e-3, "t2": -2e-3}


def image(i: int, point: Any, fisheye: bool) -> list[float]:
    """Return the image coordinates of AliceVision's DistortionBrown or DistortionFisheye."""
    p = Rotation.from_rotvec(TURNS[i]).apply(np.array(point) - CENTRES[i])
    x, y = p[:2] / p[2]
    k1, k2, k3, t1, t2 = BROWN.values()
    r2 = x * x + y * y
    if fisheye:
        theta = np.arctan(np.sqrt(r2))
        powers = k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + t1 * theta**8
        s = theta * (1 + powers) / np.sqrt(r2)
        u, v = s * x, s * y
    else:
        s = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        u = x * s + t2 * (r2 + 2 * x * x) + 2 * t1 * x * y
        v = y * s + t1 * (r2 + 2 * y * y) + 2 * t2 * x * y
    return [float(FX * u + X0), float(FY * v + Y0)]


def texts(value: Any) -> Any:
    """Return a document whose numbers are texts, as AliceVision writes them."""
    if isinstance(value, dict):
        return {k: texts(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [texts(v) for v in value]
    return value if isinstance(value, str) else repr(value)


def document(version: tuple[int, int, int] = (1, 2, 11), fisheye: bool = False) -> dict[str, Any]:
    intrinsic = {
        **{"intrinsicId": 7, "width": W, "height": H, "sensorWidth": 36.0, "sensorHeight": 27.0},
        **{"type": "fisheye4" if fisheye else "brown", "principalPoint": [X0, Y0]},
        **{"distortionParams": list(BROWN.values())[: 4 if fisheye else 5], "locked": "0"},
    }
    if version >= (1, 2, 1):
        intrinsic["principalPoint"] = [X0 - W / 2, Y0 - H / 2]
    if version >= (1, 2, 8):
        kinds = {"distortionType": "fisheye" if fisheye else "brown", "undistortionType": "none"}
        intrinsic |= {"type": "pinhole", **kinds}
    if version < (1, 2, 2):
        intrinsic["pxFocalLength"] = [FX, FY]
    elif version < (1, 2, 5):
        intrinsic |= {"focalLength": FX / W * 36.0, "pixelRatio": FX / FY}
    elif version < (1, 2, 11):
        intrinsic |= {"focalLength": FX / W * 36.0, "pixelRatio": FY / FX}
    else:
        intrinsic |= {"focalLength": FY / W * 36.0, "pixelRatio": FY / FX}
    views, poses = [], []
    for i, (turn, centre) in enumerate(zip(TURNS, CENTRES, strict=True)):
        view = {"viewId": 100 + i, "poseId": 10 + i, "intrinsicId": 7, "path": f"/a/{i}.jpg"}
        views.append(view | {"width": W, "height": H, "metadata": {"Make": "x"}})
        by_columns = Rotation.from_rotvec(turn).as_matrix().T.ravel().tolist()
        transform = {"rotation": by_columns, "center": centre.tolist()}
        poses.append({"poseId": 10 + i, "pose": {"transform": transform, "locked": "0"}})
    views.append({"viewId": 200, "intrinsicId": 7, "path": "/a/lost.jpg"})
    structure = [
        {
            "landmarkId": j,
            "descType": "sift",
            "color": [1, 2, 3],
            "X": list(at),
            "observations": [
                {"observationId": 100 + i, "featureId": j, "x": image(i, at, fisheye), "scale": 1.5}
                for i in range(3)
            ],
        }
        for j, at in enumerate(POINTS)
    ]
    out = {"version": list(version), "views": views, "intrinsics": [intrinsic], "poses": poses}
    return texts(out | {"structure": structure})


def write(tmp_path: Path, content: object) -> Path:
    path = tmp_path / "cameras.sfm"
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
    return path


def small() -> str:
    content = document()
    content["structure"] = content["structure"][:2]
    return json.dumps(content, indent=1)


EXAMPLE_FILES = {
    "meshroom": Example(
        "meshroom",
        {"cameras.sfm": small()},
        "cameras.sfm",
        unread=(
            r'"(width|height|sensorHeight|featureId|scale|descType|Make|metadata|color)"',
            r'\|\d+\|"[123]"',
            r'"[123]",?$',
            r'"/a/',
        ),
        left_out=(r'"(poseId|viewId|observationId)"',),
        open_names=True,
    )
}


@pytest.mark.parametrize("version", [(1, 2, 0), (1, 2, 1), (1, 2, 4), (1, 2, 7), (1, 2, 11)])
@pytest.mark.parametrize("fisheye", [False, True])
def test_a_block_without_noise_has_no_residuals(
    tmp_path: Path, version: tuple[int, int, int], fisheye: bool
) -> None:
    """Rotations by columns, focal lengths and principal points of five versions."""
    network = fga.read(write(tmp_path, document(version, fisheye)))
    assert list(network.photos) == ["0.jpg", "1.jpg", "2.jpg"]
    assert str(network.left_out[0]).startswith("photos: 1 left out, as they have no pose: lost.jpg")
    v = compile_residuals(network)
    assert np.abs(v).max() < 1e-6
    held = fga.adjust(fga.read(tmp_path / "cameras.sfm", calibration="held"))
    assert held.redundancy == 2 * 36 - (3 * 12 + 6 * 3) + 7
    assert held.vtpv < 1e-9


def compile_residuals(network: fga.Network) -> np.ndarray:
    equations = compile_network(network)
    return np.asarray(equations.residuals(equations.unknowns.start()))


def test_what_is_locked_is_held(tmp_path: Path) -> None:
    content = document()
    content["intrinsics"][0]["locked"] = "true"
    content["poses"][0]["pose"]["locked"] = "1"
    network = fga.read(write(tmp_path, content))
    assert all(network.cameras["7"].fixed)
    assert [all(p.fixed) for p in network.photos.values()] == [True, False, False]


def changed(path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    content = document()
    at: Any = content
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return content


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("intrinsics", 0, "distortionType"), "radialk3pt", "intrinsic pinhole radialk3pt is not"),
        (("intrinsics", 0, "type"), "equidistant", "intrinsic equidistant is not read; valid"),
        (("intrinsics", 0, "undistortionType"), "3dea4", "undistortions of 3DEqualizer are not"),
        (("intrinsics", 0, "focalLength"), "x", r"cameras\.sfm:\d+: .*'x' is not a number"),
        (("poses", 1, "pose", "transform", "rotation", 0), "7", "is no rotation matrix"),
        (("views", 0, "intrinsicId"), "8", "view 100 has unknown intrinsics 8"),
        (("rigs",), [{"rigId": "1"}], "rigs are not read"),
        (("structure", 0, "X"), ["1", "2"], "needs 3 numbers, not 2"),
    ],
)
def test_files_that_are_wrong(
    tmp_path: Path, path: tuple[Any, ...], value: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, changed(path, value)))
