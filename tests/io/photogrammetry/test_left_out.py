"""Every mark, row and point that a reader leaves out is counted and named, in every format."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from tests.networks import photo_files


@dataclass(frozen=True)
class Damage:
    """A file of a format with a row that cannot be used, and what the network says of it."""

    files: Callable[[Path], dict[str, bytes]]
    """The files, undamaged."""
    read: str
    """Name of the file that is read; empty: the folder."""
    file: str
    """Name of the file that is damaged."""
    old: str
    new: str
    said: str
    """Sentence of the network."""
    doubtful: bool = False
    """Whether the row was to be used."""
    options: dict[str, object] = field(default_factory=dict)
    """Options of the reader."""


def no_folder(files: Callable[[], dict[str, bytes]]) -> Callable[[Path], dict[str, bytes]]:
    """Return files that need no folder to be made in."""
    return lambda folder: files()


def openmvg_with_a_mark(folder: Path) -> dict[str, bytes]:
    """Return a file of OpenMVG with a mark in the view that has no pose."""
    files = photo_files.openmvg(control=4)
    whole = json.loads(files["sfm_data.json"])
    seen = whole["control_points"][0]["value"]["observations"]
    seen.append({"key": 3, "value": {"id_feat": 0, "x": [10.0, 20.0]}})
    return {"sfm_data.json": json.dumps(whole, indent=1).encode()}


BAL = b"""2 3 5
0 0 10 10
1 0 20 10
0 1 10 20
1 1 20 20
0 2 10 20
0 0 0 0 0 -10 500 0 0
0 0 0 1 0 -10 500 0 0
0 0 0
1 0 0
1 1 90
"""

DAMAGES = {
    "OpenSfM, a mark": Damage(
        no_folder(photo_files.opensfm), "reconstruction.json", "gcp_list.txt",
        "201 1.jpg G2", "201 1.JPG G2",
        "marks of known points: 1 of 4 left out, as their photos are not in the "
        "reconstruction: 1.JPG; did you mean '1.jpg'?; first in gcp_list.txt:5",
        doubtful=True,
    ),
    "OpenSfM, a track": Damage(
        no_folder(photo_files.opensfm), "reconstruction.json", "tracks.csv",
        "0.jpg\t5\t5\t", "9.jpg\t5\t5\t",
        "image points of tie points: 1 left out, as their photos are not in the network: "
        "9.jpg; first in tracks.csv:7",
    ),
    "OpenSfM, a point": Damage(
        no_folder(photo_files.opensfm), "reconstruction.json", "tracks.csv",
        "0.jpg\t5\t5\t", "0.jpg\t77\t5\t",
        "image points: 1 left out, as their tie points have no coordinates: tie 77; "
        "first in tracks.csv:7",
    ),
    "Bundler": Damage(
        lambda folder: {"bundle.out": photo_files.BUNDLER.encode()}, "bundle.out", "bundle.out",
        "# Bundle", "# Bundle",
        "photos: 1 left out, as they have no pose: 2; first in bundle.out:13",
    ),
    "DBAT": Damage(
        no_folder(photo_files.dbat), "script.xml", "script.xml",
        '<filter id="4">keep</filter>', '<filter id="1">keep</filter>',
        "as a <filter> of the file leaves them out",
    ),
    "AICON, a point": Damage(
        no_folder(photo_files.aicon), "block.obc", "block.obc",
        "9 1 2 3 0.1 0.1 0.1 2 0 1 0", "9 1 2 3 0.1 0.1 0.1 2 0 1 0",
        "left out, as they are switched off in the file: point 9",
    ),
    "Metashape": Damage(
        photo_files.metashape, "cameras.xml", "cameras.xml",
        'sensor_id="0" label="IMG 0.jpg" enabled="true"',
        'sensor_id="0" label="IMG 0.jpg" enabled="false"',
        "photos, points and readings: 1 left out, as they are switched off in the file: IMG 0.jpg",
    ),
    "COLMAP, a measurement": Damage(
        no_folder(photo_files.colmap), "", "images.txt", "# two", "# two",
        "measurements: 1 left out, as they belong to no 3-D point",
    ),
    "COLMAP, an image": Damage(
        no_folder(photo_files.colmap), "", "images.txt", "2 0 1 0 0 0 0 10 1 c.jpg",
        "11 1 0 0 0 0 0 0 1 d.jpg\n10 10 -1\n2 0 1 0 0 0 0 10 1 c.jpg",
        "images: 1 left out, as they see no 3-D point: d.jpg",
    ),
    "OpenMVG, a photo": Damage(
        lambda folder: photo_files.openmvg(control=4), "sfm_data.json", "sfm_data.json",
        '"sfm_data_version"', '"sfm_data_version"',
        "photos: 1 left out, as they have no pose: 3.jpg; first in sfm_data.json:",
    ),
    "OpenMVG, a mark": Damage(
        openmvg_with_a_mark, "sfm_data.json", "sfm_data.json",
        '"sfm_data_version"', '"sfm_data_version"',
        "marks of known points: 1 of 13 left out, as their photos are not in the reconstruction: "
        "view 3",
        doubtful=True,
    ),
    "OPF, a camera": Damage(
        photo_files.opf, "block.opf", "calibrated-cameras.json",
        '"id": 4,\n   "sensor_id"', '"id": 44,\n   "sensor_id"',
        "photos: 1 left out, as they have no pose: ",
    ),
    "OPF, a pose": Damage(
        photo_files.opf, "block.opf", "calibrated-cameras.json",
        '"id": 4,\n   "sensor_id"', '"id": 44,\n   "sensor_id"',
        "poses: 1 left out, as no capture has their camera: camera 44; "
        "first in calibrated-cameras.json:",
    ),
    "OPF, marks": Damage(
        photo_files.opf, "block.opf", "calibrated-cameras.json",
        '"id": 4,\n   "sensor_id"', '"id": 44,\n   "sensor_id"',
        "left out, as their photos are not in the reconstruction: camera 4",
        doubtful=True,
    ),
    "BAL": Damage(
        lambda folder: {"problem.txt": BAL}, "problem.txt", "problem.txt", "2 3 5", "2 3 5",
        "observations: 1 left out, as their points are behind the cameras: 2",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", DAMAGES)
def test_what_is_left_out_is_counted_and_named(what: str, tmp_path: Path) -> None:
    damage = DAMAGES[what]
    for name, content in damage.files(tmp_path).items():
        (tmp_path / name).write_bytes(content)
    path = tmp_path / damage.file
    text = path.read_text()
    assert damage.old in text
    path.write_text(text.replace(damage.old, damage.new, 1))
    network = fga.read(tmp_path / damage.read, **damage.options)  # type: ignore[arg-type]
    said = [str(left) for left in network.left_out]
    found = [left for left, s in zip(network.left_out, said, strict=True) if damage.said in s]
    assert found, said
    assert found[0].doubtful == damage.doubtful
    assert network.copy().left_out == network.left_out


def opensfm_with(tmp_path: Path, old: str, new: str) -> Path:
    """Write a reconstruction whose ground control is changed; return its path."""
    for name, content in photo_files.opensfm().items():
        (tmp_path / name).write_bytes(content)
    listed = tmp_path / "gcp_list.txt"
    listed.write_text(listed.read_text().replace(old, new))
    return tmp_path / "reconstruction.json"


def test_marks_that_are_all_left_out_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"marks .*4 of 4 .* did you mean '0\.jpg'"):
        fga.read(opensfm_with(tmp_path, ".jpg", ".JPG"))


def test_check_says_what_was_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", str(opensfm_with(tmp_path, "201 1.jpg G2", "201 1.JPG G2"))])
    said = capsys.readouterr().out
    assert "marks of known points: 1 of 4 left out" in " ".join(said.split())


@pytest.mark.parametrize(
    ("files", "read", "file", "old", "new", "options", "said"),
    [
        (
            photo_files.micmac, "", "measures.xml", ".tif", ".TIF",
            {"format": "micmac", "control": "control.xml", "measures": "measures.xml"},
            [f"image '{i}.TIF' has no orientation" for i in range(3)],
        ),
        (
            photo_files.mmvii, "", "measures.xml", "0.tif", "7.tif",
            {"format": "micmac", "control": "control.xml", "measures": "measures.xml"},
            ["image '7.tif' has no orientation"],
        ),
    ],
    ids=["MicMac", "MMVII"],
)  # fmt: skip
def test_measures_of_images_without_orientation_are_refused_all_at_once(
    files: Callable[[], dict[str, bytes]],
    read: str,
    file: str,
    old: str,
    new: str,
    options: dict[str, str],
    said: list[str],
    tmp_path: Path,
) -> None:
    for name, content in files().items():
        (tmp_path / name).write_bytes(content)
    path = tmp_path / file
    path.write_text(path.read_text().replace(old, new))
    options |= {k: str(tmp_path / v) for k, v in options.items() if v.endswith(".xml")}
    with pytest.raises(InputError) as caught:
        fga.read(tmp_path / read, **options)
    told = [p.what for p in caught.value.problems]
    for s in said:
        assert any(s in what for what in told), told
