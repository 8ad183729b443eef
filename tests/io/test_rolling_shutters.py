"""Every format of networks says that photos move during their readout, or refuses them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import Problem
from factorgraph_adj.io.json_records import camera_fields, camera_of, unknown_fields, unknown_of
from factorgraph_adj.io.photogrammetry.metashape_writer import write_metashape
from factorgraph_adj.io.writers import WRITERS, Writer
from factorgraph_adj.models.rolling_shutter import TOWARDS, Towards
from factorgraph_adj.network.network import Network
from tests.networks.rolling_drone import flown
from tests.support.same import assert_same_network

OF_PHOTOS = {"opf", "metashape", "colmap"}
"""Formats with photos, except projects."""
OF_CAMERAS = {"colmap", "opencv", "opf"}
"""Formats whose cameras say nothing of a readout time, as their writers document."""
SURVEYS = [w for w in WRITERS.entries if w.name not in {"project", *OF_PHOTOS, *OF_CAMERAS}]


def block(*, moving: bool) -> Network:
    """Return a block in the form that formats of photos have: pixels from the upper left."""
    network = flown(3, 1, 120)
    network.cameras["camera"] = replace(network.cameras["camera"], origin="upper left")
    for photo in network.photos:
        if not moving:
            del network.of_kind("photo_motion")[photo]
    return network


def test_projects_have_motions_and_readout_times(tmp_path: Path) -> None:
    network = block(moving=True)
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path / "project.toml")
    assert len(network.of_kind("photo_motion")) == 3
    assert again.of_kind("photo_motion") == network.of_kind("photo_motion")
    assert again.cameras == network.cameras
    assert_same_network(again, network)


def refused(name: str, network: Network, folder: Path) -> list[Problem]:
    """Return the problems with which the writer of a format refuses a network."""
    with pytest.raises(fga.InputError) as caught:
        WRITERS.of(folder / "out", name).write(network, folder / "out")
    assert not [*folder.iterdir()]
    return list(caught.value.problems)


@pytest.mark.parametrize("name", sorted(OF_PHOTOS))
def test_formats_of_photos_refuse_motions_that_they_do_not_have(name: str, tmp_path: Path) -> None:
    """OPF has velocities; these photos turn, too."""
    network = block(moving=True)
    said = [p for p in refused(name, network, tmp_path) if "the motion of a photo" in p.what]
    assert {p.where for p in said} == {f"photo {f!r}" for f in network.photos}
    assert all("network.of_kind('photo_motion')" in p.what for p in said)


@pytest.mark.parametrize("name", sorted(OF_PHOTOS - OF_CAMERAS))
def test_formats_of_shutters_refuse_readout_times(name: str, tmp_path: Path) -> None:
    said = refused(name, block(moving=False), tmp_path)
    of_camera = [p for p in said if "the readout time of a rolling shutter" in p.what]
    assert [p.where for p in of_camera] == ["camera 'camera'"]


@pytest.mark.parametrize("name", sorted(OF_CAMERAS))
def test_formats_of_cameras_alone_document_that_they_leave_readout_times_out(name: str) -> None:
    said = " ".join(str(WRITERS.of(Path("out"), name).write.__doc__).split())
    assert "readout time" in said


@pytest.mark.parametrize("writer", [pytest.param(w, id=w.name) for w in SURVEYS])
def test_formats_of_surveys_refuse_photos(writer: Writer, tmp_path: Path) -> None:
    assert refused(writer.name, block(moving=True), tmp_path)


def test_poses_of_cameras_alone_are_refused_where_photos_move(tmp_path: Path) -> None:
    with pytest.raises(fga.InputError, match="Metashape cannot express the motion of a photo"):
        write_metashape(block(moving=True), tmp_path / "cameras.xml", content="cameras")


@pytest.mark.parametrize("towards", TOWARDS)
def test_records_of_cameras_have_their_readout(towards: Towards) -> None:
    network = block(moving=False)
    camera = replace(network.cameras["camera"], readout=0.0123456789, readout_towards=towards)
    assert camera_of(camera_fields(camera)) == camera


def test_records_of_motions_stand_alone() -> None:
    """A record knows neither the photo nor its camera."""
    for key, motion in block(moving=True).of_kind("photo_motion").items():
        fields = unknown_fields("photo_motion", key, motion)
        assert fields["kind"] == "photo_motion"
        assert unknown_of(fields) == ("photo_motion", key, motion)


def test_a_project_tells_once_what_is_wrong_with_a_photo_that_moves(tmp_path: Path) -> None:
    network = block(moving=True)
    fga.write_project(network, tmp_path / "project.toml")
    photos = tmp_path / "photos.csv"
    rows = photos.read_text(encoding="utf-8").splitlines()
    wrong = [r.replace(",camera,", ",another,") if r.startswith("F1,") else r for r in rows]
    assert wrong != rows
    photos.write_text("\n".join(wrong) + "\n", encoding="utf-8")
    with pytest.raises(fga.InputError) as caught:
        fga.read_project(tmp_path / "project.toml")
    assert not [p for p in caught.value.problems if "readout" in p.what]
    photos.write_text("\n".join(rows) + "\n", encoding="utf-8")
    toml = (tmp_path / "project.toml").read_text(encoding="utf-8")
    lines = [line for line in toml.splitlines() if not line.startswith("readout")]
    (tmp_path / "project.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(fga.InputError) as caught:
        fga.read_project(tmp_path / "project.toml")
    said = [p for p in caught.value.problems if "has no readout time" in p.what]
    assert len(said) == len(network.photos)
    assert "photo_motions.csv" in said[0].where
