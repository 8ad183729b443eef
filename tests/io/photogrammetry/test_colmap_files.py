"""Traps of COLMAP's files, what is refused with file and line, and damaged files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.photogrammetry.colmap import read_colmap, read_sparse_model
from factorgraph_adj.io.photogrammetry.colmap_binary_files import binary_files
from factorgraph_adj.io.photogrammetry.colmap_model import Pose
from factorgraph_adj.io.photogrammetry.colmap_text_files import text_files
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import exp_rotation

CAMERAS = """# a comment
1 SIMPLE_PINHOLE 100 80 100 50 40
"""
IMAGES = """# two lines each
# the second one may be empty
7 1 0 0 0 0 0 0 1 first image.jpg
50 40 3 60.5 40 4 10 10 -1
9 1 0 0 0 -1 0 0 1 b.jpg

2 0 1 0 0 0 0 10 1 c.jpg
50 40 3 40 40.5 4
"""
POINTS = """3 0 0 5 255 0 0 0.1 7 0 2 0
4 0.5 0 5 0 0 0 0.2 7 1 2 1
"""


def folder(path: Path, cameras: str = CAMERAS, images: str = IMAGES, points: str = POINTS) -> Path:
    for name, text in (("cameras", cameras), ("images", images), ("points3D", points)):
        (path / f"{name}.txt").write_text(text)
    return path


def refused(path: Path) -> str:
    with pytest.raises(InputError) as error:
        read_colmap(path)
    return str(error.value)


# -- traps ----------------------------------------------------------------------------------------


def test_image_without_measurements_has_an_empty_second_line(tmp_path: Path) -> None:
    model = read_sparse_model(folder(tmp_path))
    assert [(i.number, len(i.points)) for i in model.images] == [(7, 3), (9, 0), (2, 2)]
    network = read_colmap(tmp_path)
    assert list(network.photos) == ["first image.jpg", "c.jpg"]
    assert network.name.endswith("without 1 images that see no 3-D point")


def test_one_file_of_a_model_stands_for_its_folder(tmp_path: Path) -> None:
    folder(tmp_path)
    network = fga.read(tmp_path / "images.txt")
    assert list(network.photos) == list(read_colmap(tmp_path).photos)
    for name in ("cameras", "points3D"):
        (tmp_path / f"{name}.txt").unlink()
    lines = "# Image list with two lines of data per image:\n# IMAGE_ID, QW\n" + IMAGES
    (tmp_path / "images.txt").write_text(lines)
    with pytest.raises(InputError, match=r"a part of a COLMAP model.*give the folder with"):
        fga.read(tmp_path / "images.txt")
    assert "give the folder that has cameras, images, points3D" in refused(tmp_path / "images.txt")


def test_last_image_without_measurements_may_lack_its_second_line(tmp_path: Path) -> None:
    images = IMAGES.rstrip("\n") + "\n11 1 0 0 0 0 0 0 1 d.jpg"
    assert len(read_sparse_model(folder(tmp_path, images=images)).images) == 4


def test_names_of_images_may_contain_blanks_and_numbers(tmp_path: Path) -> None:
    images = IMAGES.replace("b.jpg", "run 2/IMG 7 1.jpg")
    names = [i.name for i in read_sparse_model(folder(tmp_path, images=images)).images]
    assert names == ["first image.jpg", "run 2/IMG 7 1.jpg", "c.jpg"]
    model = read_sparse_model(tmp_path)
    for files in (text_files(model), binary_files(model)):
        out = tmp_path / f"{len(str(files))}"
        out.mkdir()
        for name, content in files.items():
            data = content if isinstance(content, bytes) else content.encode()
            (out / name).write_bytes(data)
        assert [i.name for i in read_sparse_model(out).images] == names


def test_poses_are_camera_from_world(tmp_path: Path) -> None:
    """q = (0, 1, 0, 0) turns by π about x; t = (0, 0, 10): the centre is −Rᵀ t = (0, 0, 10)."""
    photo = read_colmap(folder(tmp_path)).photos["c.jpg"]
    np.testing.assert_allclose(photo.position, (0.0, 0.0, 10.0), atol=1e-15)
    np.testing.assert_allclose(photo.rotation, np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_pixels_count_from_the_corner_and_y_points_down(tmp_path: Path) -> None:
    """Point 3 lies on the axis, at the principal point (50, 40): residuals are zero."""
    network = read_colmap(folder(tmp_path))
    camera = network.cameras["1"]
    assert (camera.origin, camera.format, camera.y_down_in_files) == ("upper left", (100, 80), True)
    assert dict(zip(camera.lens.names, camera.values, strict=True))["y0"] == -40.0
    for row, (_, point, xy, _) in enumerate(zip(*network.images.columns(), strict=True)):
        if list(network.points)[point] == "3":
            assert xy.tolist() == [50.0, -40.0], row


def test_identifiers_are_no_row_numbers(tmp_path: Path) -> None:
    network = read_colmap(folder(tmp_path))
    assert list(network.points) == ["3", "4"]
    assert [list(network.photos)[f] for f in network.images.columns()[0]] == [
        *["first image.jpg"] * 2,
        *["c.jpg"] * 2,
    ]


def test_binary_files_are_taken_where_there_are_both(tmp_path: Path) -> None:
    for name, data in binary_files(read_sparse_model(folder(tmp_path))).items():
        (tmp_path / name).write_bytes(data)
    (tmp_path / "images.txt").write_text("nonsense")
    assert len(read_sparse_model(tmp_path).images) == 3


def test_quaternions_of_every_rotation_come_back() -> None:
    rng = np.random.default_rng(1)
    turns = [exp_rotation(w[None])[0] for w in rng.normal(0.0, 2.0, (50, 3))]
    turns += [np.diag(d) for d in ((1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0))]
    for turn in turns:
        pose = Pose.of(turn, np.array([1.0, -2.0, 3.0]))
        np.testing.assert_allclose(pose.rotation, turn.T, atol=4e-16)
        np.testing.assert_allclose(pose.centre, [1.0, -2.0, 3.0], atol=3e-15)


# -- what is refused ------------------------------------------------------------------------------

WRONG = {
    "a model without counterpart": (
        (CAMERAS, "SIMPLE_PINHOLE", "METASHAPE"),
        "cameras.txt:2: unknown camera model 'METASHAPE'; valid: SIMPLE_PINHOLE, PINHOLE",
    ),
    "a model that the library lacks": (
        (CAMERAS, "SIMPLE_PINHOLE", "RAD_TAN_THIN_PRISM_FISHEYE"),
        "cameras.txt:2: no lens model here is the camera model 'RAD_TAN_THIN_PRISM_FISHEYE'",
    ),
    "too few parameters": (
        (CAMERAS, "100 50 40", "100 50"),
        "cameras.txt:2: SIMPLE_PINHOLE has the parameters f, cx, cy, not 2 numbers",
    ),
    "a focal length of zero": (
        (CAMERAS, "100 50 40", "0 50 40"),
        "cameras.txt:2: f must be greater than zero, not 0",
    ),
    "a camera that is not there": (
        (IMAGES, "0 0 0 0 0 0 1 first", "0 0 0 0 0 0 5 first"),
        "images.txt:3: unknown CAMERA_ID 5; cameras: 1",
    ),
    "a name twice": (
        (IMAGES, "b.jpg", "c.jpg"),
        "images.txt:7: image name 'c.jpg' stands at images.txt:5 already",
    ),
    "no name": ((IMAGES, " first image.jpg", ""), "images.txt:3: NAME is missing"),
    "a word in a measurement": (
        (IMAGES, "60.5", "60,5"),
        "images.txt:4: '60,5' is not a number of X Y POINT3D_ID",
    ),
    "a cut measurement": (
        (IMAGES, "10 10 -1", "10 10"),
        "images.txt:4: the second line of an image has X Y POINT3D_ID of each measurement, not 8",
    ),
    "a point that is not there": (
        (IMAGES, "50 40 3 60.5", "50 40 5 60.5"),
        "images.txt:3: measurements of points that points3D lacks: 5",
    ),
    "no quaternion": (
        (IMAGES, "7 1 0 0 0", "7 0 0 0 0"),
        "images.txt:3: the quaternion has the length zero",
    ),
    "a track elsewhere": (
        (POINTS, "0.1 7 0", "0.1 7 1"),
        "points3D.txt:1: the track of point 3 names measurement 1 of image 7, which is not a",
    ),
    "a short track": (
        (POINTS, " 7 1 2 1", " 7 1"),
        "points3D.txt:2: the track of point 4 has 1 measurements, the images have 2 of it",
    ),
    "an infinite coordinate": (
        (POINTS, "0.5 0 5", "inf 0 5"),
        "points3D.txt:2: coordinates must be finite",
    ),
    "a point twice": (
        (POINTS, "4 0.5", "3 0.5"),
        "points3D.txt:2: POINT3D_ID 3 stands at points3D.txt:1 already",
    ),
    "a colour": ((POINTS, "255", "256"), "points3D.txt:1: R must be 0 to 255, not 256"),
    "a number of another script": (
        (POINTS, "0.5", "٣"),
        "points3D.txt:2: X: '٣' is not a number",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_told_with_file_and_line(case: str, tmp_path: Path) -> None:
    (text, old, new), expected = WRONG[case]
    assert text.count(old) == 1, old
    given = {"cameras": CAMERAS, "images": IMAGES, "points": POINTS}
    given = {k: v.replace(old, new) if v == text else v for k, v in given.items()}
    assert expected in refused(folder(tmp_path, **given))


def test_all_problems_are_told_at_once(tmp_path: Path) -> None:
    told = refused(
        folder(
            tmp_path,
            CAMERAS.replace("100 50 40", "-1 50 40"),
            IMAGES.replace("b.jpg", "c.jpg"),
            POINTS.replace("0.5 0 5", "nan 0 5"),
        )
    )
    assert all(f"{name}.txt:" in told for name in ("cameras", "images", "points3D"))


def test_point_measured_twice_in_an_image_is_refused_or_left_out(tmp_path: Path) -> None:
    images = IMAGES.replace("10 10 -1", "10 10 3")
    path = folder(tmp_path, images=images, points=POINTS.replace("7 0 2 0", "7 0 7 2 2 0"))
    assert "images.txt:3: image 'first image.jpg' measures a point several times" in refused(path)
    network = read_colmap(path, repeated="leave out")
    assert network.n_image_points == 3
    assert network.name.endswith("without 2 measurements of points measured twice in an image")


def test_folder_without_a_model_names_those_inside(tmp_path: Path) -> None:
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    folder(tmp_path / "sparse" / "0")
    assert f"there are models in {tmp_path / 'sparse' / '0'}" in refused(tmp_path)


def test_count_that_the_file_cannot_hold_is_refused_at_once(tmp_path: Path) -> None:
    for name, data in binary_files(read_sparse_model(folder(tmp_path))).items():
        (tmp_path / name).write_bytes(data)
    data = (tmp_path / "points3D.bin").read_bytes()
    (tmp_path / "points3D.bin").write_bytes(struct.pack("<Q", 2**60) + data[8:])
    assert "points3D.bin, byte 0: 1152921504606846976 rows do not fit" in refused(tmp_path)


TABLES = {
    "an unknown image": (
        "photo,point,x,y\nx.jpg,G,1,2\n",
        "marks.csv:2: unknown image 'x.jpg'; images: first image.jpg, b.jpg, c.jpg",
    ),
    "an unknown point": (
        "photo,point,x,y\nc.jpg,H,1,2\n",
        "marks.csv:2: unknown control point 'H'; known: G",
    ),
    "a second mark": (
        "photo,point,x,y\nc.jpg,G,1,2\nc.jpg,G,1,3\n",
        "marks.csv:3: second mark of c.jpg G; the first is marks.csv:2",
    ),
    "a column": ("photo,point,x,y,z\nc.jpg,G,1,2,3\n", "marks.csv:1: unknown column 'z'"),
    "no number": ("photo,point,x,y\nc.jpg,G,1,two\n", "marks.csv:2: y:"),
    "no mark": (
        "photo,point,x,y\nc.jpg,3,1,2\n",
        "control.csv:2: control point 'G' is measured in no image",
    ),
    "too few places": (
        "photo,point,x,y\nc.jpg,G,1,2\n",
        "control points and positions of photos give 0 places, which do not carry the model over",
    ),
}


@pytest.mark.parametrize("case", TABLES)
def test_wrong_tables_are_told_with_file_and_line(case: str, tmp_path: Path) -> None:
    marks, expected = TABLES[case]
    (tmp_path / "marks.csv").write_text(marks)
    (tmp_path / "control.csv").write_text("name,x,y,z,fixed\nG,1,2,3,xyz\n")
    with pytest.raises(InputError) as error:
        read_colmap(
            folder(tmp_path), control=tmp_path / "control.csv", marks=tmp_path / "marks.csv"
        )
    assert expected in str(error.value)


def test_priors_of_unregistered_images_are_refused_or_left_out(tmp_path: Path) -> None:
    path = folder(tmp_path)
    (tmp_path / "control.csv").write_text("name,x,y,z\n3,0,0,5\n4,0.5,0,5\n")
    (tmp_path / "p.csv").write_text("photo,x,y,z,sigma_m\nz.jpg,0,0,0,1\nc.jpg,0,0,10,0.1\n")
    given = {"priors": tmp_path / "p.csv", "control": tmp_path / "control.csv"}
    with pytest.raises(InputError, match=r"unknown image 'z\.jpg'"):
        read_colmap(path, **given)
    network = read_colmap(path, unregistered="leave out", **given)
    assert [o.photo for o in network.observations.values()] == ["c.jpg"]
    (tmp_path / "p.csv").write_text("photo,x,y,z\nc.jpg,0,0,10\n")
    with pytest.raises(InputError, match=r"p.csv:2: has no standard deviation; valid: sigma_m, or"):
        read_colmap(path, **given)


def test_database_that_is_none_is_refused(tmp_path: Path) -> None:
    path = folder(tmp_path)
    (tmp_path / "database.db").write_bytes(b"not a database" * 100)
    for name, told in (("database.db", "is no database of COLMAP"), ("none.db", "no such file")):
        with pytest.raises(InputError, match=told):
            read_colmap(path, sigma_by_scale=tmp_path / name)


@pytest.mark.parametrize("options", [{"sigma": 0.0}, {"sigma": "one"}, {"calibration": "some"}])
def test_wrong_options_are_refused(options: dict[str, object], tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read_colmap(folder(tmp_path), **options)  # type: ignore[arg-type]


# -- rigs -----------------------------------------------------------------------------------------

RIGS = "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0.5 0 0\n"
FRAMES = "1 1 1 0 0 0 0 0 0 2 CAMERA 1 7 CAMERA 2 9\n2 1 0 1 0 0 0 0 10 1 CAMERA 1 2\n"


def rig_folder(path: Path, rigs: str = RIGS, frames: str = FRAMES) -> Path:
    folder(
        path,
        CAMERAS + "2 SIMPLE_PINHOLE 100 80 100 50 40\n",
        "7 1 0 0 0 0 0 0 1 a.jpg\n50 40 3\n9 1 0 0 0 0.5 0 0 2 b.jpg\n60 40 3\n"
        "2 0 1 0 0 0 0 10 1 c.jpg\n50 40 3\n",
        "3 0 0 5 255 0 0 0.1 7 0 9 0 2 0\n",
    )
    (path / "rigs.txt").write_text(rigs)
    (path / "frames.txt").write_text(frames)
    return path


def mounted(network: Network) -> dict[str, tuple[str, str | None]]:
    return {
        o.photos()[1]: (o.photos()[0], o.mount)
        for o in network.observations.values()
        if o.kind == "relative_rotation"
    }


def test_cameras_of_a_rig_sit_on_the_image_of_its_reference(tmp_path: Path) -> None:
    network = read_colmap(rig_folder(tmp_path))
    assert mounted(network) == {"b.jpg": ("a.jpg", "rig 1 camera 2")}
    # sensor_from_rig has t = (0.5, 0, 0): the camera is 0.5 to the left.
    np.testing.assert_allclose(
        network.mounts["rig 1 camera 2"].values, [0, 0, 0, -0.5, 0, 0], atol=1e-16
    )


def test_frame_without_its_reference_has_a_carrier_without_image_points(tmp_path: Path) -> None:
    rigs = RIGS.replace("1 2 CAMERA 1", "1 3 IMU 1 CAMERA 1 1 1 0 0 0 0 0 0")
    network = read_colmap(rig_folder(tmp_path, rigs))
    assert mounted(network) == {
        "a.jpg": ("frame 1", "rig 1 camera 1"),
        "b.jpg": ("frame 1", "rig 1 camera 2"),
    }
    assert [all(m.fixed) for m in network.mounts.values()] == [True, False]


def test_unknown_mount_is_computed_from_the_poses(tmp_path: Path) -> None:
    network = read_colmap(rig_folder(tmp_path, RIGS.replace("2 1 1 0 0 0 0.5 0 0", "2 0")))
    np.testing.assert_allclose(
        network.mounts["rig 1 camera 2"].values, [0, 0, 0, -0.5, 0, 0], atol=1e-16
    )


@pytest.mark.parametrize(
    "rigs, frames, expected",
    [
        (RIGS.replace("CAMERA 2", "CAMERA 5"), FRAMES, "rigs.txt:1: unknown CAMERA_ID 5"),
        (RIGS.replace("CAMERA 2", "LIDAR 2"), FRAMES, "rigs.txt:1: unknown type of sensor 'LIDAR'"),
        (RIGS, FRAMES.replace("1 1 1 0", "1 4 1 0"), "frames.txt:1: unknown RIG_ID 4"),
        (RIGS, FRAMES.replace("2 9", "2 7"), "frames.txt:1: image 7 is of camera 1, not 2"),
        (RIGS, FRAMES.replace("1 2\n", "1 7\n"), "frames.txt:2: image 7 belongs to the frame at"),
        (RIGS, FRAMES.replace("0 2 CAMERA", "0 3 CAMERA"), "frames.txt:1: the type of a sensor is"),
    ],
)
def test_wrong_rigs_are_refused(rigs: str, frames: str, expected: str, tmp_path: Path) -> None:
    assert expected in refused(rig_folder(tmp_path, rigs, frames))


def test_rig_of_two_equal_cameras_is_written_as_single_images(tmp_path: Path) -> None:
    """COLMAP has one mount for each camera."""
    network = read_colmap(rig_folder(tmp_path))
    network.photos["b.jpg"] = type(network.photos["b.jpg"])(
        **{**vars(network.photos["b.jpg"]), "camera": "1"}
    )
    fga.write_colmap(network, tmp_path / "out")
    model = read_sparse_model(tmp_path / "out")
    assert [len(r.others) for r in model.rigs] == [0]
    assert [f.data for f in model.frames] == [((("CAMERA", 1), i),) for i in (1, 2, 3)]
