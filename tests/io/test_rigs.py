"""Rigs and relative poses in projects and records."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from factorgraph_adj import (
    Correlated,
    InputError,
    Network,
    RelativePosition,
    RelativeRotation,
    read_project,
    write_project,
)
from factorgraph_adj.io.json_records import observation_fields, observation_of
from factorgraph_adj.network.composite_unknowns import RIGID
from factorgraph_adj.simulation.measurement import measure
from tests.networks.odometry import odometry
from tests.networks.rigs import rig

PROJECT = """
name = "rig"
[[camera]]
name = "camera"
parameters = { c = 12.0 }
[files]
points = "points.csv"
photos = "photos.csv"
mounts = "mounts.csv"
"""
PHOTOS = """name,camera,carrier,mount,play_mm,play_mgon
E0 left,camera,E0,left,,
E0,camera,,,,
E0 right,camera,E0,right,0.5,20
"""
MOUNTS = """name,rx_deg,x_mm,free
left,90,-200,rx ry rz
right,,200,rx ry rz x y z
"""


def project(folder: Path, photos: str = PHOTOS, mounts: str = MOUNTS) -> Path:
    """Write a project of a rig."""
    for name, text in (
        ("project.toml", PROJECT),
        ("points.csv", "name,x,y,z\nA,1,2,3\n"),
        ("photos.csv", photos),
        ("mounts.csv", mounts),
    ):
        (folder / name).write_text(text)
    return folder


def test_a_table_of_photos_puts_members_on_their_carriers(tmp_path: Path) -> None:
    network = read_project(project(tmp_path))
    ties = list(network.observations.values())
    assert [type(o) for o in ties] == [RelativeRotation, RelativePosition] * 2
    assert [o.photos() for o in ties] == [("E0", "E0 left")] * 2 + [("E0", "E0 right")] * 2
    sigmas = [o.sigma[0] for o in ties]  # type: ignore[attr-defined]
    assert sigmas[:2] == list(RIGID)
    assert sigmas[2:] == pytest.approx([0.02 * np.pi / 200, 5e-4])
    assert all(o.value == (0.0, 0.0, 0.0) for o in ties)  # type: ignore[attr-defined]
    assert ties[0].source == "photos.csv:2"  # type: ignore[attr-defined]
    by_hand = Network("by hand")
    from factorgraph_adj.models.lens import NoDistortion

    by_hand.add_camera("camera", NoDistortion(), {"c": 12.0})
    by_hand.add_photo("E0", "camera")
    by_hand.set_mount("left")
    by_hand.add_photo("E0 left", "camera", carrier="E0", mount="left")
    assert list(by_hand.observations) == list(network.observations)[:2]


def test_bad_carriers_are_named_with_their_lines(tmp_path: Path) -> None:
    photos = (
        "name,camera,carrier,mount,play_mm\n"
        "E0,camera,,,\nA,camera,E1,left,\nB,camera,E0,lefd,\nC,camera,E0,,\nD,camera,E0,left,-1\n"
        "F,camera,F,left,\nG,camera,,left,\n"
    )
    with pytest.raises(InputError) as found:
        read_project(project(tmp_path, photos))
    for message in (
        "photos.csv:3: photo 'A': unknown carrier 'E1'; photos: E0",
        "photos.csv:4: photo 'B': unknown mount 'lefd'; known: left, right",
        "photos.csv:5: photo 'C': mount is missing",
        "photos.csv:6: photo 'D': play_mm must be greater than zero",
        "photos.csv:7: photo 'F': a photo cannot be its own carrier",
        "photos.csv:8: photo 'G': carrier is missing",
    ):
        assert message in str(found.value)


@pytest.mark.parametrize(
    "make", [lambda: rig(3), lambda: odometry(5), lambda: odometry(5, scale=0.1)]
)
def test_projects_give_back_rigs_and_odometry_to_the_bit(make, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    network = measure(make(), seed=1)
    write_project(network, tmp_path / "project.toml")
    back = read_project(tmp_path)
    assert list(back.observations) == list(network.observations)
    for ident, o in network.observations.items():
        other = back.observations[ident]
        assert (other.value, other.sigma) == (o.value, o.sigma)  # type: ignore[attr-defined]
        assert other.parameters() == o.parameters()
    assert back.mounts == network.mounts
    assert [ids for ids, _ in back.clusters] == [ids for ids, _ in network.clusters]
    for (_, a), (_, b) in zip(back.clusters, network.clusters, strict=True):
        assert np.array_equal(a, b)


def test_records_give_back_relative_poses_to_the_bit() -> None:
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, 2.0]])
    for o in (
        RelativeRotation("A", "B", (0.1, -0.2, 3.0), covariance=1e-8 * covariance, id="turn"),
        RelativeRotation("A", "B", (0.0, 0.0, 0.0), sigma=(1e-4, 2e-4, 3e-4), mount="left"),
        RelativePosition("A", "B", (0.1, -0.2, 3.0), covariance=covariance, instrument="odometer"),
    ):
        back = observation_of(json.loads(json.dumps(observation_fields(o, id="1"))))
        assert isinstance(back, type(o))
        assert (back.value, back.sigma, back.photos()) == (o.value, o.sigma, o.photos())
        assert back.parameters() == o.parameters()
        if o.covariance is not None:
            assert np.array_equal(back.covariance, o.covariance)


def test_bad_relative_poses_are_named(tmp_path: Path) -> None:
    folder = project(tmp_path)
    (folder / "project.toml").write_text(PROJECT + 'observations = "observations.csv"\n')
    (folder / "observations.csv").write_text(
        "kind,photo,photo2,x,y,z,rx,ry,rz,mount,sigma_mm,sigma_mgon\n"
        "relative_position,E0,E0,1,2,3,,,,,1,\n"
        "relative_position,E0,E9,1,2,3,,,,,1,\n"
        "relative_rotation,E0,E0 left,,,,1,2,,,,1\n"
        "relative_rotation,E0,E0 left,,,,1,2,3,top,,1\n"
        "relative_rotation,E0,E0 left,,,,190,2,150,,,-1\n"
    )
    with pytest.raises(InputError) as found:
        read_project(folder)
    for message in (
        "observations.csv:2: relative_position E0 E0: photo and photo2 are the same",
        "observations.csv:3: relative_position E0 E9: unknown photo 'E9'",
        "observations.csv:4: relative_rotation E0 E0 left: rz is missing",
        "observations.csv:5: relative_rotation E0 E0 left: unknown mount 'top'; known: left, right",
        "observations.csv:6: relative_rotation E0 E0 left: sigma_mgon must be greater than zero",
    ):
        assert message in str(found.value)


def test_a_group_of_rotation_and_position_needs_six_rows() -> None:
    turn = RelativeRotation("A", "B", (0.0, 0.0, 0.0), sigma=(1e-4,) * 3)
    step = RelativePosition("A", "B", (1.0, 0.0, 0.0), sigma=(1e-2,) * 3)
    with pytest.raises(InputError, match="covariance must be 6 × 6"):
        Correlated((turn, step), np.eye(3))
