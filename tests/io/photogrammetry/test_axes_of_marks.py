"""Marks along other axes, and control in one place, are told by every reader and by `check`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import TopocentricFrame
from factorgraph_adj.graph.equations import compile_rows
from factorgraph_adj.models.lens import NormalisedLens
from factorgraph_adj.validate.contradicting_groups import points_behind_cameras
from factorgraph_adj.validate.network_structure import check
from tests.networks import photo_files

WIDTH, HEIGHT, FOCAL = 2000, 1500, 1500.0
CENTRES = [(-3.0, 0.0, 30.0), (0.0, 0.5, 31.0), (3.0, 1.0, 30.0)]
CONTROL = [(-2.0, -3.0, 0.5), (-1.0, 4.0, 1.5), (2.5, -2.0, 0.0), (3.0, 3.5, 2.0), (0.5, 0.5, 1.0)]
DOWN = np.diag([1.0, -1.0, -1.0])
"""Camera axes x right, y down, z ahead, of a photo that looks down."""
Axes = Callable[[float, float], tuple[float, float]]
AXES: dict[str, tuple[Axes, str]] = {
    "right": (lambda x, y: (x, y), ""),
    "upwards": (lambda x, y: (x, HEIGHT - y), "with y counted upwards from the lower edge"),
    "from the right": (lambda x, y: (WIDTH - x, y), "with x counted from the right edge"),
    "exchanged": (lambda x, y: (y, x), "with x and y exchanged"),
}


def pixels(c: tuple[float, ...], p: tuple[float, ...]) -> tuple[float, float]:
    """Return column and row of a point in a photo that looks down."""
    depth = c[2] - p[2]
    return (
        WIDTH / 2 + FOCAL * (p[0] - c[0]) / depth,
        HEIGHT / 2 - FOCAL * (p[1] - c[1]) / depth,
    )


def openmvg(axes: Axes, *, one_place: bool) -> tuple[dict[str, bytes], str]:
    poses = [(DOWN.tolist(), list(c)) for c in CENTRES]
    ties = [[1.0, -1.0, 0.5], [-1.0, 1.0, 0.0], [2.0, 2.0, 1.0]]
    points = [*map(list, CONTROL), *ties]
    seen = {
        i: {
            j: list(axes(*pixels(c, tuple(p))) if j < len(CONTROL) else pixels(c, tuple(p)))
            for j, p in enumerate(points)
        }
        for i, c in enumerate(CENTRES)
    }
    files = photo_files.openmvg(
        ("pinhole", {}), poses=poses, seen=seen, points=points, control=len(CONTROL)
    )
    if one_place:
        whole = json.loads(files["sfm_data.json"])
        for given in whole["control_points"]:
            given["value"]["X"] = list(CONTROL[0])
        files = {"sfm_data.json": json.dumps(whole).encode()}
    return files, "sfm_data.json"


def opensfm(axes: Axes, *, one_place: bool) -> tuple[dict[str, bytes], str]:
    earth = TopocentricFrame(np.radians(52.5), np.radians(13.4), 40.0, "WGS84")
    camera = {"projection_type": "perspective", "width": WIDTH, "height": HEIGHT,
              "focal": FOCAL / WIDTH, "k1": 0.0, "k2": 0.0}  # fmt: skip
    shots = {
        f"{i}.jpg": {
            "rotation": [np.pi, 0.0, 0.0],
            "translation": [-c[0], c[1], c[2]],
            "camera": "cam",
        }
        for i, c in enumerate(CENTRES)
    }
    document = [{"cameras": {"cam": camera}, "shots": shots, "points": {}}]
    ground = ["WGS84"]
    for j, p in enumerate(CONTROL):
        given = CONTROL[0] if one_place else p
        latitude, longitude, height = (float(v[0]) for v in earth.geodetic(np.array([given])))
        for i, c in enumerate(CENTRES):
            x, y = axes(*pixels(c, p))
            place = f"{np.degrees(longitude):.12f} {np.degrees(latitude):.12f} {height:.6f}"
            ground.append(f"{place} {x:.4f} {y:.4f} {i}.jpg G{j}")
    return {
        "reconstruction.json": json.dumps(document).encode(),
        "reference_lla.json": b'{"latitude": 52.5, "longitude": 13.4, "altitude": 40.0}',
        "tracks.csv": b"OPENSFM_TRACKS_VERSION_v2\n",
        "gcp_list.txt": ("\n".join(ground) + "\n").encode(),
    }, "reconstruction.json"


def block(axes: Axes, *, one_place: bool) -> fga.Network:
    """Return the same photos as a network, image coordinates in pixels with y down."""
    network = fga.Network("block")
    network.add_camera(
        "cam",
        NormalisedLens(),
        {"c": FOCAL, "x0": WIDTH / 2, "y0": -HEIGHT / 2},
        unit="px",
        format=(WIDTH, HEIGHT),
        origin="upper left",
        y_down_in_files=True,
    )
    for j, p in enumerate(CONTROL):
        at = CONTROL[0] if one_place else p
        network.add_point(f"G{j}", at)
        network.add(fga.ControlPoint(f"G{j}", at, sigma=(0.01, 0.01, 0.02)))
    for i, c in enumerate(CENTRES):
        network.add_photo(f"{i}.jpg", "cam", position=c, rotation=DOWN)
        marks = [axes(*pixels(c, p)) for p in CONTROL]
        names = [f"G{j}" for j in range(len(CONTROL))]
        network.add_image_points(f"{i}.jpg", names, [(x, -y) for x, y in marks], sigma=1.0)
    return network


READERS = {"OpenMVG": (openmvg, fga.read_openmvg), "OpenSfM": (opensfm, fga.read_opensfm)}


def put(files: dict[str, bytes], folder: Path) -> None:
    for name, content in files.items():
        (folder / name).write_bytes(content)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("axes", AXES)
def test_marks_along_other_axes_are_refused(reader: str, axes: str, tmp_path: Path) -> None:
    written, read = READERS[reader]
    files, name = written(AXES[axes][0], one_place=False)
    put(files, tmp_path)
    if not AXES[axes][1]:
        assert len(read(tmp_path / name).points) >= len(CONTROL)
        return
    with pytest.raises(InputError) as error:
        read(tmp_path / name)
    assert AXES[axes][1] in str(error.value)


@pytest.mark.parametrize("reader", READERS)
def test_control_in_one_place_is_refused(reader: str, tmp_path: Path) -> None:
    written, read = READERS[reader]
    files, name = written(AXES["right"][0], one_place=True)
    put(files, tmp_path)
    with pytest.raises(InputError, match="the same coordinates"):
        read(tmp_path / name)


@pytest.mark.parametrize("writer", ["metashape", "opf"])
def test_written_blocks_with_other_axes_are_refused_where_they_are_read(
    writer: str, tmp_path: Path
) -> None:
    write, read, file = {
        "metashape": (fga.write_metashape, fga.read_metashape, tmp_path / "cameras.xml"),
        "opf": (fga.write_opf, fga.read_opf, tmp_path / "block.opf"),
    }[writer]
    write(block(AXES["right"][0], one_place=False), file)
    assert len(read(file).photos) == len(CENTRES)
    write(block(AXES["upwards"][0], one_place=False), file)
    with pytest.raises(InputError, match=AXES["upwards"][1]):
        read(file)


@pytest.mark.parametrize("axes", AXES)
def test_check_tells_it_of_a_network(axes: str) -> None:
    said = " ".join(p.what for p in check(block(AXES[axes][0], one_place=False)))
    assert AXES[axes][1] in said
    assert AXES[axes][1] or not said


def test_check_tells_of_control_in_one_place() -> None:
    said = " ".join(p.what for p in check(block(AXES["right"][0], one_place=True)))
    assert "the same coordinates" in said


def test_check_tells_of_points_behind_cameras(tmp_path: Path, capsys) -> None:
    network = block(AXES["right"][0], one_place=False)
    assert not list(points_behind_cameras(compile_rows(network)))
    high = (*CONTROL[2][:2], 70.0)
    network.points["G2"] = replace(network.points["G2"], coordinates=high)
    (told,) = points_behind_cameras(compile_rows(network))
    assert "the points of 3 image points lie behind the camera" in str(told)
    assert "G2" in str(told)
    fga.write_project(network, tmp_path / "project.toml")
    assert main(["check", str(tmp_path)]) != 0
    printed = "".join(capsys.readouterr())
    assert "behind the camera" in printed and "G2" in printed


def test_photos_turned_upside_down_have_all_points_behind() -> None:
    """Then nothing is told of single points: poses in axes of their own are moved as a whole."""
    network = block(AXES["right"][0], one_place=False)
    for name, photo in network.photos.items():
        network.photos[name] = replace(photo, rotation=np.eye(3))
    assert not list(points_behind_cameras(compile_rows(network)))
