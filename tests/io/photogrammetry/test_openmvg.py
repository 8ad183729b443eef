"""OpenMVG: formulas of its source, a block of known truth, what cereal writes once, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from tests.networks.photo_files import openmvg
from tests.support.attitude import rodrigues

F, PP = 1500.0, np.array([1000.0, 750.0])
LENSES = {
    "pinhole": {},
    "pinhole_radial_k1": {"disto_k1": [-0.06]},
    "pinhole_radial_k3": {"disto_k3": [-0.06, 0.02, -0.004]},
    "pinhole_brown_t2": {"disto_t2": [-0.06, 0.02, -0.004, 1e-3, -2e-3]},
    "fisheye": {"fisheye": [0.03, -0.01, 0.004, -0.001]},
}
CENTRES = np.array([(0.0, 0, 30), (8, 1, 31), (1, 9, 29), (9, 8, 32)])
TURNS = np.array([(3.1, 0.1, 0.05), (3.0, 0.3, -0.1), (0.1, 3.1, 0.2), (2.9, -0.4, 0.1)])
POINTS = np.array([(x, y, 0.05 * x * y - 1) for x in (-4.0, 5, 12) for y in (-3.0, 4, 11)])


def image(kind: str, rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return pixels (n, 2) by add_disto and cam2ima of src/openMVG/cameras/Camera_Pinhole*.hpp."""
    q = (POINTS - centre) @ rotation.T
    p = q[:, :2] / q[:, 2:]
    r2 = np.sum(p * p, axis=1)
    coefficients = next(iter(LENSES[kind].values()), [])
    if kind == "fisheye":
        r = np.sqrt(r2)
        t = np.arctan(r)
        k1, k2, k3, k4 = coefficients
        d = p * ((t + k1 * t**3 + k2 * t**5 + k3 * t**7 + k4 * t**9) / r)[:, None]
    else:
        k = [*coefficients[:3], 0.0, 0.0, 0.0][:3]
        d = p * (1 + k[0] * r2 + k[1] * r2**2 + k[2] * r2**3)[:, None]
        if kind == "pinhole_brown_t2":
            t1, t2 = coefficients[3:]
            x, y = p.T
            d[:, 0] += t2 * (r2 + 2 * x * x) + 2 * t1 * x * y
            d[:, 1] += t1 * (r2 + 2 * y * y) + 2 * t2 * x * y
    return F * d + PP


def block(kind: str, noise: float = 0.0, **more) -> dict[str, bytes]:
    rng = np.random.default_rng(4)
    poses = [(rodrigues(t), c) for t, c in zip(TURNS, CENTRES, strict=True)]
    seen = {
        i: {j: (xy + noise * rng.normal(size=2)).tolist()
            for j, xy in enumerate(image(kind, r, c))}
        for i, (r, c) in enumerate(poses)
    }  # fmt: skip
    given = [(r.tolist(), c.tolist()) for r, c in poses]
    return openmvg((kind, LENSES[kind]), poses=given, seen=seen, points=POINTS.tolist(), **more)


def write(folder: Path, files: dict[str, bytes]) -> Path:
    path = folder / "sfm_data.json"
    path.write_bytes(files["sfm_data.json"])
    return path


@pytest.mark.parametrize("kind", LENSES)
def test_images_of_every_lens_follow_the_formula_of_the_source(tmp_path, kind):
    """Residuals at the values of the file vanish: poses, lens and axes are those of OpenMVG."""
    path = write(tmp_path, block(kind, control=4))
    network = fga.read(path, calibration="held")
    assert list(network.photos) == ["0.jpg", "1.jpg", "2.jpg", "3.jpg"]
    assert network.n_image_points == 4 * 9
    solution = fga.adjust(network)
    assert solution.vtpv < 1e-12
    for i, centre in enumerate(CENTRES):
        assert np.allclose(solution.pose(f"{i}.jpg").position, centre, atol=1e-7)


def test_a_block_with_noise_has_its_truth_within_its_accuracy(tmp_path):
    path = write(tmp_path, block("pinhole_radial_k1", noise=0.5, control=5))
    network = fga.read_openmvg(path, sigma_px=0.5, sigma_control_px=0.5, positions="observe",
                               sigma_control=(0.005, 0.005, 0.005))  # fmt: skip
    kinds = [o.kind for o in network.observations.values()]
    assert sorted(kinds) == ["control"] * 5 + ["photo_position"] * 2
    position = next(o for o in network.observations.values() if o.kind == "photo_position")
    assert position.sigma == (0.05, 0.05, 0.1)  # 1 / center_weight
    solution = fga.adjust(network)
    assert 0.7 < solution.sigma0 < 1.3
    errors = [
        np.abs(solution.point(f"tie {j}") - POINTS[j]) / solution.standard_deviations(f"tie {j}")
        for j in range(5, 9)
    ]
    assert np.max(errors) < 4.0
    assert abs(solution.calibration("0").values[0] - F) < 4 * solution.calibration("0").sigmas[0]


def test_control_points_are_observed_compared_or_left_out(tmp_path):
    path = write(tmp_path, block("pinhole", control=4))
    observed = fga.read_openmvg(path)
    assert observed.datum == "given"
    assert observed.points["control 0"].check is None
    compared = fga.read_openmvg(path, control="check")
    assert compared.datum == "free"
    assert compared.points["control 0"].check == tuple(POINTS[0])
    left = fga.read_openmvg(path, control="leave out")
    assert "control 0" not in left.points
    assert left.n_image_points == 4 * 5


def test_a_reconstruction_in_another_frame_is_moved_to_the_control_points(tmp_path):
    document = json.loads(block("pinhole", control=4)["sfm_data.json"])
    same = fga.adjust(
        fga.read_openmvg(write(tmp_path, {"sfm_data.json": json.dumps(document).encode()}))
    )
    for entry in document["control_points"]:
        entry["value"]["X"] = [400.0 - 3.0 * v for v in entry["value"]["X"][:2]] + [
            3.0 * entry["value"]["X"][2]
        ]
    path = write(tmp_path, {"sfm_data.json": json.dumps(document).encode()})
    moved = fga.adjust(fga.read_openmvg(path, sigma_control=(0.03, 0.03, 0.3)))
    assert moved.converged and "similarity" in moved.begun[1]
    assert same.converged
    assert fga.read_openmvg(path, control="leave out").datum == "free"


def test_points_seen_once_and_views_without_a_pose_are_left_out(tmp_path):
    document = json.loads(block("pinhole")["sfm_data.json"])
    seen = document["structure"][0]["value"]["observations"]
    document["structure"][0]["value"]["observations"] = [*seen[:1], {**seen[1], "key": 4}]
    path = write(tmp_path, {"sfm_data.json": json.dumps(document).encode()})
    network = fga.read_openmvg(path)
    assert "tie 1" not in network.points
    assert "4.jpg" not in network.photos


def change(document: dict, what: str) -> None:
    lens = document["intrinsics"][0]["value"]
    views = [v["value"]["ptr_wrapper"]["data"] for v in document["views"]]
    poses = document["extrinsics"]
    if what == "version":
        document["sfm_data_version"] = "0.9"
    elif what == "type":
        lens["polymorphic_name"] = "spherical"
    elif what == "unnamed":
        lens["polymorphic_id"] = 7
    elif what == "empty pointer":
        lens["ptr_wrapper"] = {"id": 99}
    elif what == "shared":
        views[1]["id_pose"] = 0
    elif what == "names":
        views[1]["filename"] = "0.jpg"
    elif what == "rotation":
        poses[0]["value"]["rotation"][0] = [1, 1, 1]
    elif what == "twice":
        poses[1]["key"] = 0
    elif what == "camera":
        views[0]["id_intrinsic"] = 5
    elif what == "coefficients":
        lens["ptr_wrapper"]["data"]["disto_k3"] = [0.1]
    elif what == "measured":
        point = document["structure"][0]["value"]
        point["observations"].append(point["observations"][0])
    elif what == "weight":
        views[0]["center_weight"] = [0, 1, 1]


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("version", "valid: 0.1, 0.2, 0.3"),
        ("type", "type 'spherical' cannot be read"),
        ("unnamed", "has no name before it is used"),
        ("empty pointer", "no content before it is used"),
        ("shared", "shares pose 0 with '0.jpg'"),
        ("names", "0.jpg"),
        ("rotation", "is no rotation matrix"),
        ("twice", "pose 0 stands twice"),
        ("camera", "unknown intrinsics 5"),
        ("coefficients", "3"),
        ("measured", "is measured twice"),
        ("weight", "three numbers > 0"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path, what, said):
    document = json.loads(block("pinhole_radial_k3")["sfm_data.json"])
    change(document, what)
    path = write(tmp_path, {"sfm_data.json": json.dumps(document, indent=1).encode()})
    with pytest.raises(InputError) as caught:
        fga.read(path, positions="observe")
    assert said in str(caught.value)
    assert "sfm_data.json:" in str(caught.value)


def test_a_shared_pointer_has_its_content_at_its_first_use(tmp_path):
    """Two intrinsics that are one object: cereal writes the second one without data."""
    document = json.loads(block("pinhole_radial_k3")["sfm_data.json"])
    document["intrinsics"].append(
        {"key": 1, "value": {"polymorphic_id": 2, "ptr_wrapper": {"id": 20}}}
    )
    path = write(tmp_path, {"sfm_data.json": json.dumps(document).encode()})
    cameras = fga.read_openmvg(path).cameras
    assert cameras["0"].values == cameras["1"].values
