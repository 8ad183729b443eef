"""OpenCV: calibrations there and back, and a calibration with its views."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.models.normalised_lens import RationalLens
from factorgraph_adj.models.ray_lens import FisheyeLens
from tests.networks.pixel_block import pixel_block, projected

CALIBRATION = """%YAML:1.0
---
calibration_time: "Tue Nov 24 10:00:00 2026"
image_width: 640
image_height: 480
flags: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3e+02, 0., 3.2e+02, 0., 5.31e+02, 2.41e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.6e-01, -4.5e-02, 1.0e-03, -3.0e-04, 2.5e-01 ]
avg_reprojection_error: 2.0e-01
"""
FX, FY, CX, CY = 530.0, 531.0, 320.0, 241.0
K1, K2, P1, P2, K3 = -2.6e-01, -4.5e-02, 1.0e-03, -3.0e-04, 2.5e-01


def write(tmp_path: Path, text: str, name: str = "camera.yml") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def opencv(q: np.ndarray) -> np.ndarray:
    """Return OpenCV's image coordinates of points in the camera: the formula of its manual."""
    x, y = q[:, 0] / q[:, 2], q[:, 1] / q[:, 2]
    r2 = x * x + y * y
    d = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    u = x * d + 2 * P1 * x * y + P2 * (r2 + 2 * x * x)
    v = y * d + P1 * (r2 + 2 * y * y) + 2 * P2 * x * y
    return np.stack([FX * u + CX, FY * v + CY], 1)


def test_a_calibration_projects_as_opencv_does(tmp_path: Path) -> None:
    """OpenCV's pixel (0, 0) is the centre of the first pixel: half a pixel from the corner."""
    network = fga.read(write(tmp_path, CALIBRATION))
    camera = network.cameras["camera"]
    assert camera.format == (640, 480) and all(camera.fixed)
    network.add_photo("f", "camera", position=(0, 0, 0), rotation=np.eye(3))
    q = np.array([(0.2, -0.1, 1.0), (-0.5, 0.4, 1.5), (0.0, 0.0, 2.0)])
    for i, at in enumerate(q.tolist()):
        network.add_point(str(i), at)
    expected = (opencv(q) + 0.5) * (1, -1)
    assert projected(network, ["0", "1", "2"])["f"] == pytest.approx(expected, abs=1e-10)


def test_xml_and_yaml_are_the_same(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    network = fga.read(write(tmp_path, CALIBRATION))
    fga.write_opencv(network, tmp_path / "out.xml")
    fga.write_opencv(network, tmp_path / "out.yml")
    for name in ("out.xml", "out.yml"):
        assert fga.read(tmp_path / name).cameras == network.cameras


@pytest.mark.parametrize(
    ("lens", "values", "model"),
    [
        (RationalLens(), {"k4": 0.01, "k5": -0.02, "k6": 0.003, "b1": 1e-3}, "pinhole"),
        (FisheyeLens(), {"k4": 0.01, "b1": 1e-3, "b2": 2e-4}, "fisheye"),
    ],
)
def test_other_lenses_are_written_and_read(
    tmp_path: Path, lens: object, values: dict[str, float], model: str
) -> None:
    network = fga.Network("lens")
    values = {"c": 500.0, "x0": 320.5, "y0": -240.25, "k1": -0.1, "k2": 0.05, "k3": 0.01} | values
    network.add_camera(
        "camera",
        lens,
        values,
        unit="px",
        format=(640, 480),
        origin="upper left",  # type: ignore[arg-type]
        y_down_in_files=True,
    )
    fga.write_opencv(network, tmp_path / "lens.xml")
    again = fga.read(tmp_path / "lens.xml", model=model).cameras["camera"]
    assert type(again.lens) is type(lens)
    assert again.values == pytest.approx(network.cameras["camera"].values, abs=1e-12)


def views(tmp_path: Path, noise: float) -> tuple[Path, list[np.ndarray]]:
    """Write a calibration with six views of a board, as OpenCV's program does."""
    rng = np.random.default_rng(4)
    board = np.array([(0.03 * i, 0.03 * j, 0.0) for j in range(6) for i in range(8)])
    vectors = rng.normal(0, 0.35, (6, 3))
    shifts = np.array([-0.1, -0.08, 0.45]) + rng.normal(0, 0.03, (6, 3))
    from factorgraph_adj.rotation import exp_rotation

    corners = []
    for r, t in zip(exp_rotation(vectors), shifts, strict=True):
        seen = opencv(board @ r.T + t)
        corners.append(seen + rng.normal(0, noise, seen.shape))

    def matrix(name: str, rows: int, cols: int, kind: str, data: np.ndarray) -> str:
        numbers = ", ".join(repr(float(v)) for v in data.ravel())
        head = f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: {kind}\n"
        return f"{head}   data: [ {numbers} ]\n"

    text = CALIBRATION + matrix("extrinsic_parameters", 6, 6, "d", np.hstack([vectors, shifts]))
    text += matrix("image_points", 6, 48, "2f", np.array(corners))
    text += matrix("grid_points", 48, 1, "3f", board)
    return write(tmp_path, text), corners


def test_a_calibration_with_views_is_adjusted_with_covariances(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    path, _ = views(tmp_path, 0.1)
    network = fga.read(path, sigma_px=0.1)
    assert (len(network.photos), network.n_image_points) == (6, 288)
    solution = fga.adjust(network)
    assert solution.converged
    assert solution.redundancy == 2 * 288 - 6 * 6 - 9
    assert 0.9 < solution.sigma0 < 1.1
    found = solution.calibration("camera")
    for name, true in (("c", FY), ("x0", CX + 0.5), ("y0", -CY - 0.5), ("b1", FX - FY)):
        assert abs(found[name] - true) < 4 * found.sigma(name)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("   cols: 3", "   cols: 4", r"camera\.yml:\d+: camera_matrix needs 12 numbers, not 9"),
        ("5.3e+02", "-5.3e+02", r"camera_matrix must be \[fx s cx; 0 fy cy; 0 0 1\]"),
        ("5.3e+02", "nan", r"camera\.yml:7: camera_matrix: 'nan' is not a finite number"),
        ("rows: 5", "rows: 1e9", r"camera.yml:12: distortion_coefficients has rows '1e9'"),
        ("camera_matrix", "camera_matrices", r"camera\.yml:17: has no camera_matrix"),
        ("image_width: 640", "image_width: [", r"camera\.yml:\d+: is not YAML"),
        ("image_height", "image_width", r"camera\.yml:5: image_width is defined twice"),
        ("rows: 5", "rows: 3", r"distortion_coefficients needs 3 numbers, not 5"),
    ],
)
def test_wrong_calibrations_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    pytest.importorskip("yaml")
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, CALIBRATION.replace(old, new, 1)))


def test_thin_prisms_and_tilts_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    text = CALIBRATION.replace("rows: 5", "rows: 12").replace(
        "2.5e-01 ]", "2.5e-01, 0., 0., 0., 1e-3, 0., 0., 0. ]"
    )
    with pytest.raises(InputError, match=r"s1 \(thin prism, tilt\) are not zero"):
        fga.read(write(tmp_path, text))


def test_a_missing_extra_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(InputError, match=r"pip install 'factorgraph_adj\[opencv\]'"):
        fga.read(write(tmp_path, CALIBRATION))


def test_what_opencv_has_no_lens_for_is_refused(tmp_path: Path) -> None:
    network = pixel_block(affine=True)
    with pytest.raises(InputError, match="OpenCV has no lens model 'normalised_affine'"):
        fga.write_opencv(network, tmp_path / "no.yml")
    film = fga.Network("film")
    film.add_camera("film", BrownLens(), {"c": 150.0})
    with pytest.raises(InputError, match="OpenCV needs pixels"):
        fga.write_opencv(film, tmp_path / "no.yml")
    film.add_camera("second", BrownLens(), {"c": 150.0})
    with pytest.raises(InputError, match="has 2 cameras; choose one: film, second"):
        fga.write_opencv(film, tmp_path / "no.yml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("flags", "held"),
    [
        (0, ""),
        (2, "b1"),
        (4, "x0 y0"),
        (8, "p1 p2"),
        (8 + 128, "p1 p2 k3"),
        (32 + 64, "k1 k2"),
        (16, "c b1"),
        (1 << 21, "p1 p2"),
        (256, "c x0 y0 b1 k1 k2 k3 p1 p2"),
    ],
)
def test_what_the_flags_held_is_held(tmp_path: Path, flags: int, held: str) -> None:
    """The flags of cv::calibrateCamera; all others stay unknown."""
    pytest.importorskip("yaml")
    path, _ = views(tmp_path, 0.1)
    path.write_text(path.read_text().replace("flags: 0", f"flags: {flags}"))
    camera = fga.read(path).cameras["camera"]
    free = {n for n, fixed in zip(camera.lens.names, camera.fixed, strict=True) if not fixed}
    assert free == {*["c", "x0", "y0", "b1", "k1", "k2", "k3", "p1", "p2"]} - set(held.split())


def test_a_given_ratio_of_focal_lengths_stays(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    path, _ = views(tmp_path, 0.1)
    path.write_text(path.read_text().replace("flags: 0", "flags: 2"))
    network = fga.read(path, sigma_px=0.1)
    solution = fga.adjust(network)
    assert network.cameras["camera"].lens.kind == "rational"
    fga.write_opencv(solution.as_network(), tmp_path / "out.yml")
    text = (tmp_path / "out.yml").read_text()
    numbers = [float(v) for v in text.split("data: [ ")[1].split("]")[0].split(",")]
    assert numbers[0] / numbers[4] == pytest.approx(FX / FY, rel=1e-14)
    assert abs(numbers[4] - FY) > 1e-3


@pytest.mark.parametrize(
    ("flags", "held"),
    [
        (2 + 8, ""),  # RECOMPUTE_EXTRINSIC, FIX_SKEW of OpenCV 4
        (2 + 8 + 16 + 512, "k1 x0 y0"),
        ((1 << 23) + (1 << 25), ""),  # the same two of OpenCV 5
        ((1 << 23) + (1 << 25) + 16 + 32, "c b1 k1"),
    ],
)
def test_a_fisheye_file_says_that_it_is_one(tmp_path: Path, flags: int, held: str) -> None:
    pytest.importorskip("yaml")
    path, _ = views(tmp_path, 0.1)
    text = path.read_text().replace("flags: 0", f"flags: {flags}\nfisheye_model: 1")
    text = text.replace("rows: 5", "rows: 4").replace(", 2.5e-01 ]", " ]")
    path.write_text(text)
    camera = fga.read(path).cameras["camera"]
    assert camera.lens.kind == "fisheye"
    free = {n for n, fixed in zip(camera.lens.names, camera.fixed, strict=True) if not fixed}
    assert free == {*["c", "x0", "y0", "b1", "k1", "k2", "k3", "k4"]} - set(held.split())
    with pytest.raises(InputError, match=r"has 5 distortion coefficients|rows|valid: 4"):
        path.write_text(text.replace("rows: 4", "rows: 5").replace("-3.0e-04 ]", "-3.0e-04, 0 ]"))
        fga.read(path)


def test_the_unknown_parameters_can_be_chosen(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    path, _ = views(tmp_path, 0.1)
    for choice, free in (("held", 0), (["c", "k1"], 2)):
        assert fga.adjust(fga.read(path, calibration=choice)).n_unknowns == 36 + free
    for wrong in ({"calibration": "k1"}, {"model": "wide"}, {"sigma_px": "a"}):
        with pytest.raises(InputError, match=str(*wrong)):
            fga.read(path, **wrong)
    with pytest.raises(InputError, match="k9"):
        fga.read(path, calibration=["k9"])
