"""Trajectories: poses of known rotations, observed poses, files that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.robotics.trajectory import is_trajectory, read_trajectory
from factorgraph_adj.models.lens import NoDistortion
from tests.hostile.examples import Example

TUM = """\
# a walk
1305031102.160407 1.344379 0.627206 1.661754 0.658249 0.611043 -0.294444 -0.326553
1305031102.194330 1.343641 0.626458 1.652408 0.657327 0.613265 -0.295150 -0.323593
1305031102.226738 1.338382 0.625665 1.641460 0.657713 0.615255 -0.294626 -0.319485
"""
KITTI = "1 0 0 5 0 0.6 -0.8 6 0 0.8 0.6 7\n1 0 0 5.5 0 1 0 6 0 0 1 8\n"
EUROC = """\
#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v
1403715524907143168,0.515356,1.996773,0.971104,0.161996,0.789985,-0.205376,0.554528,-0.002276
1403715524912143104,0.515342,1.996723,0.971077,0.161904,0.790015,-0.205283,0.554546,-0.003425
"""
EXAMPLE_FILES = {
    "tum": Example(
        "trajectory", {"a.txt": TUM}, "a.txt", unread=(r"\|#|\|a\||\|walk\|",), places_only=True
    ),
    "kitti": Example(
        "trajectory",
        {"a.txt": KITTI, "times.txt": "0.1\n0.25\n"},
        "a.txt",
        beside={"times": "times.txt"},
        places_only=True,
    ),
    "euroc": Example(
        "trajectory",
        {"a.csv": EUROC},
        "a.csv",
        {"sigma_m": 0.01},
        unread=(r"\|#timestamp", r"-0\.00\d+\|1403", r"\|,qz7x\|1403"),
    ),
}


def write(tmp_path: Path, text: str, name: str = "a.txt") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_poses_of_tum_have_the_rotation_of_their_quaternion(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, TUM))
    assert list(network.photos) == [line.split()[0] for line in TUM.splitlines()[1:]]
    values = np.array(TUM.splitlines()[2].split(), dtype=float)
    photo = network.photos["1305031102.194330"]
    assert photo.position == pytest.approx(values[1:4])
    expected = Rotation.from_quat(values[4:]).as_matrix()
    np.testing.assert_allclose(photo.rotation, expected, atol=1e-6)  # files have six digits
    body = read_trajectory(tmp_path / "a.txt", axes="body").photos["1305031102.194330"]
    np.testing.assert_allclose(body.rotation @ np.diag([1, -1, -1]), expected, atol=1e-6)


def test_poses_of_euroc_have_another_order_and_unit(tmp_path: Path) -> None:
    path = write(tmp_path, EUROC, "data.csv")
    network = fga.read(path, axes="body", sigma_m=0.02, sigma_rad=0.001)
    values = np.array(EUROC.splitlines()[2].split(","), dtype=float)
    photo = network.photos["1403715524.912143104"]
    expected = Rotation.from_quat(np.roll(values[4:8], -1)).as_matrix()
    np.testing.assert_allclose(photo.rotation @ np.diag([1, -1, -1]), expected, atol=1e-5)
    times = [o.time for o in network.observations.values()]
    assert times == [0.0, 0.0, 0.004999936, 0.004999936]


def test_nanoseconds_become_seconds_without_loss_of_a_digit(tmp_path: Path) -> None:
    """Two poses 60 ns apart, of which float64 makes the same second."""
    text = EUROC.replace("24912143104", "24907143228")
    network = fga.read(write(tmp_path, text, "data.csv"), axes="body", sigma_m=0.02)
    names = ["1403715524.907143168", "1403715524.907143228"]
    assert list(network.photos) == names and float(names[0]) == float(names[1])
    assert [o.time for o in network.observations.values()] == [0.0, 60e-9]
    fga.write(network, tmp_path / "path.tum")
    rows = (tmp_path / "path.tum").read_text().splitlines()
    assert [row.split()[0] for row in rows] == names
    again = fga.read(tmp_path / "path.tum", axes="body", sigma_m=0.02)
    assert [o.time for o in again.observations.values()] == [0.0, 60e-9]


@pytest.mark.parametrize("axes", ["camera", "body"])
@pytest.mark.parametrize("rows", ["TUM", "KITTI"])
def test_the_axes_that_were_read_are_written(tmp_path: Path, axes: str, rows: str) -> None:
    """Also those of an adjusted network, and of one that was a project in between."""
    names = {"TUM": TUM, "KITTI": KITTI}
    path = write(tmp_path, names[rows])
    given = [line.split() for line in names[rows].splitlines() if not line.startswith("#")]
    network = fga.read(path, axes=axes, sigma_m=0.02, sigma_rad=0.01)
    fga.write(network, tmp_path / "p" / "project.toml")
    for written in (network, fga.adjust(network), fga.read(tmp_path / "p" / "project.toml")):
        fga.write(written, tmp_path / "b.txt", format="trajectory", rows=rows)
        found = [line.split() for line in (tmp_path / "b.txt").read_text().splitlines()]
        values, expected = np.array(found, dtype=float), np.array(given, dtype=float)
        if rows == "TUM":
            values[:, 4:] *= np.sign(values[:, 7:] * expected[:, 7:])
        np.testing.assert_allclose(values, expected, rtol=0, atol=2e-6)


def test_axes_of_both_sorts_are_written_if_the_option_says_which(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, TUM), axes="body")
    network.add_camera("lens", NoDistortion(), {"c": 1.0})
    rotation = np.eye(3)
    network.add_photo("1305031103", "lens", position=(0, 0, 0), rotation=rotation)
    with pytest.raises(InputError, match="beside those of a body without the option axes"):
        fga.write(network, tmp_path / "b.tum")
    assert not (tmp_path / "b.tum").exists()
    fga.write(network, tmp_path / "b.tum", axes="camera")
    last = (tmp_path / "b.tum").read_text().splitlines()[-1].split()
    assert [float(x) for x in last[4:]] == [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("name", ["1403715524907143168", "1403715524907"])
def test_names_in_other_units_are_no_seconds(tmp_path: Path, name: str) -> None:
    network = fga.Network("path")
    network.add_camera("body", NoDistortion(), {"c": 1.0})
    network.add_photo(name, "body", position=(0, 0, 0), rotation=np.eye(3))
    with pytest.raises(InputError, match="name is no time in seconds"):
        fga.write(network, tmp_path / "b.tum")


def test_rows_of_kitti_are_rotations_and_places_with_times_of_another_file(tmp_path: Path) -> None:
    path, times = write(tmp_path, KITTI), write(tmp_path, "0.1\n0.25\n", "times.txt")
    assert list(fga.read(path).photos) == ["0", "1"]
    network = fga.read(path, times=times, sigma_m=0.1)
    photo = network.photos["0.1"]
    assert photo.position == (5.0, 6.0, 7.0)
    np.testing.assert_allclose(photo.rotation, [[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    assert [o.time for o in network.observations.values()] == pytest.approx([0.0, 0.15])


def test_the_network_says_that_poses_without_accuracies_are_start_values(tmp_path: Path) -> None:
    path = write(tmp_path, TUM, "a.tum")
    said = (
        "the poses are start values; sigma_m=0.05 (--set sigma_m=0.05) and "
        "sigma_rad=0.01 (--set sigma_rad=0.01) make observations of them"
    )
    assert fga.read(path).remarks == [said]
    with pytest.raises(InputError) as error:
        fga.adjust(fga.read(path))
    assert str(error.value) == f"nothing to adjust: the network has no observations: {said}"
    assert not fga.read(path, sigma_m=0.1).remarks


def test_observed_poses_are_adjusted(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, TUM), sigma_m=0.02, sigma_rad=0.01)
    solution = fga.adjust(network)
    assert solution.redundancy == 0
    assert solution.pose("1305031102.226738").sigmas[3:] == pytest.approx([0.02] * 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TUM.replace("0.613265", "0.9"), r"a\.txt:3: its quaternion has not the length 1"),
        (TUM.replace(" -0.319485", ""), r"a\.txt:4: has 7 numbers; valid in TUM: 8, time, x, y"),
        (TUM.replace("0.625665", "o.6"), r"a\.txt:4: y: 'o\.6' is not a number"),
        (TUM.replace("1102.226738", "1102.184330"), r"a\.txt:4: the time .* does not grow"),
        (KITTI.replace("0.6 -0.8", "0.6 0.8"), r"a\.txt:1: is no rotation, see the grammar of KIT"),
        ("# nothing\n", r"has no poses"),
        (
            TUM.replace("1305031102.", "1305031102"),
            r"a\.txt:2: time in seconds must be at most 1e\+11, not 1305031102160407",
        ),
        (EUROC.replace("524912143104,", "524.912143104,"), r"a\.txt:3: .* must be a whole number"),
        (
            EUROC.replace("timestamp,", "timestamp [s],"),
            r"a\.txt:1: has times in \[s\]; valid .* ns",
        ),
    ],
)
def test_files_that_are_wrong(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, text), format="trajectory")


def test_a_second_pose_of_a_time_has_a_name_of_its_own(tmp_path: Path) -> None:
    path = write(tmp_path, TUM.replace("1102.226738", "1102.194330"))
    network = fga.read(path)
    assert list(network.photos)[1:] == ["1305031102.194330", "1305031102.194330 (2)"]
    assert any("1 poses have the time of the one before" in r for r in network.remarks)


def test_times_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path, times = write(tmp_path, KITTI), write(tmp_path, "0.1\n", "times.txt")
    with pytest.raises(InputError, match=r"has 2 poses, but times\.txt has 1 times"):
        fga.read(path, times=times)


@pytest.mark.parametrize(
    ("text", "yes"),
    [
        (TUM, True),
        (KITTI, True),
        (EUROC, True),
        ("1 2 3 4 5 6 7 8\n2 2 3 4 5 6 7 8\n", False),  # no quaternions
        ("1 2 3 4 5 6 7 8 9 10 11 12\n", False),
        ("A 1 2 3\n", False),
    ],
)
def test_rotations_tell_a_trajectory_from_a_table(tmp_path: Path, text: str, yes: bool) -> None:
    assert is_trajectory(write(tmp_path, text, "a.xyz")) is yes


@pytest.mark.parametrize("options", [{"axes": "frd"}, {"sigma_m": 0.0}, {"sigma_rad": -1.0}])
def test_options_that_are_wrong(tmp_path: Path, options: dict) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        read_trajectory(write(tmp_path, TUM), **options)


def test_poses_of_one_name_are_joined_by_the_user_alone(tmp_path: Path) -> None:
    """The refusal says how, and the way leads to one adjustment of both."""
    first = fga.read(write(tmp_path, TUM, "a.tum"), sigma_m=0.02, sigma_rad=0.01)
    second = fga.read(write(tmp_path, TUM, "b.tum"), sigma_m=0.02, sigma_rad=0.01)
    with pytest.raises(InputError, match=r"first\.add\(\*second\.observations\.values\(\)\)"):
        fga.join([first, second])
    n = len(first.observations)
    first.add(*second.observations.values())
    assert fga.adjust(first).n_observations == 2 * 3 * n
