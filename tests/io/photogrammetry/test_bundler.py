"""Bundler: a real file by the formula of the format, and files that are wrong."""

from __future__ import annotations

import bz2
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.photogrammetry.bundler import is_bal
from tests.networks.photo_files import BUNDLER
from tests.networks.pixel_block import projected
from tests.support.places import data_dir


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "bundle.out"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_real_file_is_read_by_the_formula_of_the_format() -> None:
    """The file's own numbers: every view of point 0, P = R X + t, p = −P/P_z, f (1 + …) p."""
    path = data_dir("bal") / "gtsam" / "Balbianello.out"
    lines = path.read_text().splitlines()
    network = fga.read(path)
    assert (len(network.photos), len(network.points), network.n_image_points) == (5, 544, 1417)
    at = np.array(lines[27].split(), dtype=float)
    views = np.array(lines[29].split()[1:], dtype=float).reshape(-1, 4)
    ours = projected(network, ["tie 0"])
    for camera, _, x, y in views.tolist():
        block = [np.array(r.split(), dtype=float) for r in lines[2 + 5 * int(camera) :][:5]]
        (f, k1, k2), rotation, t = block[0], np.array(block[1:4]), block[4]
        p = rotation @ at + t
        p = -p[:2] / p[2]
        expected = f * (1 + k1 * (p @ p) + k2 * (p @ p) ** 2) * p
        assert ours[str(int(camera))][0] == pytest.approx(expected, abs=1e-5)  # R has 11 digits
        assert expected == pytest.approx((x, y), abs=2.0)


def test_a_real_file_is_adjusted() -> None:
    """It is a result of bundle adjustment: its own minimum, to half a pixel."""
    solution = fga.adjust(fga.read(data_dir("bal") / "gtsam" / "Balbianello.out"))
    assert solution.converged
    assert solution.datum_defect == 7
    assert solution.redundancy == 2 * 1417 - (3 * 544 + 9 * 5) + 7
    assert 0.3 < solution.sigma0 < 0.7


def test_cameras_that_were_not_registered_are_left_out(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, BUNDLER))
    assert list(network.photos) == ["0", "1"] and network.n_image_points == 4
    assert {o.source for o in network.image_points()} == {"bundle.out:20", "bundle.out:23"}
    names = tmp_path / "list.txt"
    names.write_text("photos/a.jpg 0 530.5\nphotos/b.jpg\nphotos/c.jpg\n", encoding="utf-8")
    assert list(fga.read(tmp_path / "bundle.out", images=names).photos) == ["a.jpg", "b.jpg"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("v0.3", "v1", r"bundle\.out:1: is no file of Bundler"),
        ("3 2", "3", r"bundle\.out:2: the second line must be two whole"),
        ("3 2", "3 4", r"3 cameras and 4 points take 29 lines, not 23"),
        ("500 -0.1 0.01", "-500 -0.1 0.01", r"bundle\.out:3: f must not be negative"),
        ("1 0 0\n0 1 0", "1 0 0\n0 2 0", r"bundle\.out:3: R is no rotation matrix"),
        ("500 0 0", "500 0 inf", r"bundle\.out:8: .*'inf' is not a finite number"),
        ("2 0 7", "2 9 7", r"bundle\.out:20: there is no camera 9; valid: 0 to 2"),
        ("2 0 7", "2 1 7", r"bundle\.out:20: point 'tie 0' is measured twice in photo '1'"),
        ("2 0 7", "5 0 7", r"bundle\.out:20: the views of a point are"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, BUNDLER.replace(old, new, 1)), format="bundler")


def test_a_problem_of_bal_is_recognised_by_its_first_numbers(tmp_path: Path) -> None:
    """Tables of eight columns and lists of other programs have the same suffix."""
    for text, yes in (
        ("1 1 1\n0 0 -3.3e+01 2.6\n", True),
        ("2 3 4\n0     0     -385.989990234375 387.1199951171875\n", True),
        ("# Camera list with one line of data per camera:\n", False),
        ("1311868164.3 0 0 0 0 0 0 1\n", False),
        ("WGS84 UTM 16N\n1 2 3 4 5 a.jpg\n", False),
        ("1 2 3\n4 5 6\n", False),
    ):
        path = tmp_path / "a.txt"
        path.write_text(text, encoding="utf-8")
        assert is_bal(path) is yes, text
        with bz2.open(tmp_path / "a.txt.bz2", "wt") as packed:
            packed.write(text)
        assert is_bal(tmp_path / "a.txt.bz2") is yes
    (tmp_path / "b.txt.gz").write_bytes(b"1 1 1\n0 0 1.0 2.0\n")  # not packed
    assert not is_bal(tmp_path / "b.txt.gz")
