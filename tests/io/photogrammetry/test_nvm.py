"""VisualSFM: models of known truth by both meanings of the format, files that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from tests.hostile.examples import Example

CENTRES = np.array([[-2.0, 0.1, 0.0], [0.0, -0.2, 0.3], [2.0, 0.2, -0.1]])
ANGLES = np.array([[0.02, 0.15, 0.01], [-0.03, 0.02, 0.05], [0.01, -0.2, -0.02]])
F, R = (900.0, 920.0, 910.0), (0.11, 0.12, 0.13)
GRID = [(x, y, 9.0 + 0.4 * x * y) for x in (-2.0, -0.7, 0.6, 1.9) for y in (-1.6, 0.1, 1.5)]


def model(*, colmap: bool = False) -> str:
    """Return a model without noise, of which every photo sees every point."""
    lines = [str(len(CENTRES))]
    for i, (c, w, f, r) in enumerate(zip(CENTRES, ANGLES, F, R, strict=True)):
        x, y, z, q = Rotation.from_rotvec(w).as_quat()
        turn = " ".join(f"{v:.12f}" for v in (q, x, y, z))
        place = " ".join(f"{v:.9f}" for v in c)
        lines.append(f'photo"{i}.jpg {f} {turn} {place} {r} 0')
    lines += ["", str(len(GRID))]
    for at in GRID:
        rays = []
        for i, (c, w, f, r) in enumerate(zip(CENTRES, ANGLES, F, R, strict=True)):
            p = Rotation.from_rotvec(w).apply(np.array(at) - c)
            p = p[:2] / p[2]
            if colmap:
                m = f * p * (1.0 - r * (p @ p)) + [1400.0, 1000.0]
            else:
                s = 1.0  # of m = s p, with s (1 + r s² |p|²) = 1
                for _ in range(60):
                    s = 1.0 / (1.0 + r * s * s * (p @ p))
                m = f * s * p
            rays.append(f"{i} 7 {m[0]:.9f} {m[1]:.9f}")
        place = " ".join(f"{v:.9f}" for v in at)
        lines.append(f"{place} 1 2 3 {len(rays)} {' '.join(rays)}")
    return "\n".join(lines) + "\n"


MODEL = f"NVM_V3\n\n{model()}\n0\n"
CONVERTED = f"NVM_V3\n\n{model(colmap=True)}"
SHORT = """\
NVM_V3 FixedK 900 0 900 0 0.1

2
a.jpg 900 1 0 0 0 0 0 0 0 0
b.jpg 900 1 0 0 0 2 0 0 0 0
2
0 0 9 1 2 3 2 0 5 1.5 -2.5 1 6 -200.5 -3
1 1 8 1 2 3 2 0 8 111 -112 1 9 -113 114
0
#the PLY files
0
"""
EXAMPLE_FILES = {
    "nvm": Example(
        "nvm",
        {"a.nvm": SHORT},
        "a.nvm",
        unread=(
            r"\|#the|\|PLY\||\|files\|",
            r"\|0\|0$",
            r"\|[123]\|[01] [01] [89] ",
            r"#the PLY",
            r"qz7x( 1 2 3)?\|0$",
        ),
    )
}


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.nvm"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("colmap", [False, True])
def test_a_model_without_noise_has_no_residuals(tmp_path: Path, colmap: bool) -> None:
    """Coordinates of nine decimals: residuals of 10⁻⁶ px; c and k1 are those of the file."""
    path = write(tmp_path, CONVERTED if colmap else MODEL)
    options = {"program": "colmap", "principal_point": (1400, 1000)} if colmap else {}
    network = fga.read(path, **options)
    solution = fga.adjust(network)
    assert solution.redundancy == 2 * 36 - (3 * 12 + 8 * 3) + 7
    assert solution.vtpv < 1e-9
    for i, (f, r) in enumerate(zip(F, R, strict=True)):
        found = solution.calibration(f"photo {i}.jpg")
        k1 = found.values[found.names.index("k1")]
        assert found.values[0] == pytest.approx(f, abs=1e-2)
        assert (-k1 if colmap else k1 * f**2) == pytest.approx(r, abs=1e-5)
    assert solution.pose("photo 1.jpg").position == pytest.approx(CENTRES[1], abs=1e-4)


def test_a_file_without_negative_coordinates_asks_for_its_program(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"seem to count from the upper left corner, as COLMAP"):
        fga.read(write(tmp_path, CONVERTED))


def test_a_camera_that_is_fixed_is_held(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, SHORT))
    (camera,) = network.cameras.values()
    assert not any(camera.free if hasattr(camera, "free") else ())
    values = dict(zip(camera.lens.names, camera.values, strict=True))
    assert (values["c"], values["k1"]) == pytest.approx((900.0, 0.1 / 900.0**2))


def test_one_of_several_models_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, f"NVM_V3\n{model()}{model()}0\n1 0\n")
    network = fga.read(path, model=2)
    assert network.remarks == ["model 2 of 2 models was read"]
    with pytest.raises(InputError, match=r"has 2 models; valid for model: 1 to 2, not 3"):
        fga.read(path, model=3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("NVM_V3 F", "NVM_V4 F", r"a\.nvm:1: must begin with NVM_V3"),
        ("FixedK 900", "FixedK", r"a\.nvm:1: cx|a\.nvm:1: focal|a\.nvm:1: fx = 0"),
        ("a.jpg 900 1 0", "a.jpg 900 1 0.5", r"a\.nvm:4: its quaternion has not the length 1"),
        ("b.jpg 900", "b.jpg -900", r"a\.nvm:5: f must be greater than zero, not -900"),
        ("3 2 0 5", "3 3 0 5", r"a\.nvm:7: says 3 image points of 4 fields, and has 8 fields"),
        ("1 9 -113", "2 9 -113", r"a\.nvm:8: number of a photo must be a whole number from 0 to 1"),
        ("1 9 -113", "0 9 -113", r"a\.nvm:8: photo 'a\.jpg' measures the point 2 times; repeated"),
        ("\n2\n0 0 9", "\n9\n0 0 9", r"a\.nvm:.*ends in point 5 of 9|a point has 7 fields"),
    ],
)
def test_files_that_are_wrong(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert SHORT.count(old) == 1
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, SHORT.replace(old, new)), format="nvm")


def test_repeated_image_points_are_left_out_on_demand(tmp_path: Path) -> None:
    path = write(tmp_path, MODEL.replace(" 3 0 7 ", " 4 0 9 1.0 2.0 0 7 ", 1))
    network = fga.read(path, repeated="leave out")
    assert network.n_image_points == 36 - 1
    assert "2 left out" in str(network.left_out[0])


@pytest.mark.parametrize(
    "options",
    [
        {"program": "bundler"},
        {"principal_point": (1.0, 2.0)},
        {"program": "colmap"},
        {"sigma_px": 0.0},
        {"repeated": "keep"},
    ],
)
def test_options_that_are_wrong(tmp_path: Path, options: dict) -> None:
    with pytest.raises(InputError, match=r"must be|given together"):
        fga.read(write(tmp_path, MODEL), **options)
