"""What is wrong in tables of a photo flight is told with file, line and what would be valid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.project import load_project
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import PhotoAttitude, PhotoBase, PhotoPosition
from factorgraph_adj.validate.network_structure import check

TEXTS = {
    "project.toml": 'name = "flight"\n[sigma.photo_position]\nsigma_mm = 50\n'
    "[sigma.photo_attitude]\nsigma_mgon = 5\n[sigma.photo_angle]\nsigma_mgon = 5\n"
    '[sigma.photo_range]\nsigma_mm = 50\n[[camera]]\nname = "C"\nlens = "none"\n'
    "[camera.parameters]\nc = 100\n",
    "points.csv": "name,x,y,z,fixed\nA,0,0,0,xyz\n",
    "photos.csv": "name,camera,x,y,z,omega,phi,kappa,fixed\n"
    "1,C,0,0,1000,0,0,0,\n2,C,300,0,1000,0,0,0,yes\n",
    "mounts.csv": "name,free,rx_mgon\nimu,rx ry rz,0\n",
    "drifts.csv": "name,free,x_t_mm\nstrip,x x_t,0\n",
    "attitude_drifts.csv": "name,free\nstrip,rz\n",
    "shutters.csv": "name,error_s,sigma\nS,0.01,0.005\n",
    "observations.csv": "kind,photo,point,x,y,z,omega,phi,kappa,value,axes,about,angle,mount,drift,"
    "time,shutter,velocity_x,velocity_y,velocity_z\n"
    "photo_position,1,,0,0,1000,,,,,,,,,strip,1,S,60,0,0\n"
    "photo_attitude,1,,,,,0,0,0,,,body,,imu,strip,1,,,,\n"
    "photo_angle,2,,,,,,,,0.1,,,roll,imu,,,,,,\n"
    "photo_range,1,A,,,,,,,1000,,,,,,,,,,\n",
}
WRONG = {
    # name: table, what stands there, what is put there, the problem
    "an unknown mount": (
        *("observations.csv", "roll,imu", "roll,ium"),
        "observations.csv:4: photo_angle 2 roll: unknown mount 'ium'; known: imu",
    ),
    "an unknown drift": (
        *("observations.csv", "strip,1,S", "stripe,1,S"),
        "observations.csv:2: photo_position 1: unknown drift 'stripe'; known: strip",
    ),
    "an unknown drift of attitudes": (
        *("observations.csv", "imu,strip,1", "imu,stirp,1"),
        "observations.csv:3: photo_attitude 1: unknown drift of attitudes 'stirp'; known: strip",
    ),
    "an unknown shutter": (
        *("observations.csv", "1,S,60", "1,T,60"),
        "observations.csv:2: photo_position 1: unknown shutter 'T'; known: S",
    ),
    "a shutter without velocity": (
        *("observations.csv", "S,60,0,0", "S,0,0,0"),
        "observations.csv:2: photo_position 1: a shutter needs the velocity of the antenna, and "
        "it is zero",
    ),
    "a velocity with two components": (
        *("observations.csv", "S,60,0,0", "S,60,0,"),
        "observations.csv:2: photo_position 1: velocity_z is missing",
    ),
    "an unknown angle": (
        *("observations.csv", ",roll,", ",role,"),
        "observations.csv:4: photo_angle 2 role: angle must be one of omega, phi, kappa, roll, "
        "pitch, heading, not 'role'",
    ),
    "no angle": (
        *("observations.csv", ",roll,", ",,"),
        "observations.csv:4: photo_angle 2: angle is missing",
    ),
    "a wrong word for about": (
        *("observations.csv", ",body,", ",bodies,"),
        "observations.csv:3: photo_attitude 1: about must be body or angles, not 'bodies'",
    ),
    "a negative range": (
        *("observations.csv", "A,,,,,,,1000", "A,,,,,,,-1000"),
        "observations.csv:5: photo_range A 1: a distance cannot be negative: -1000.0",
    ),
    "an angle that is missing": (
        *("observations.csv", "0,0,0,,,body", "0,,0,,,body"),
        "observations.csv:3: photo_attitude 1: phi is missing",
    ),
    "a component of a drift that is none": (
        *("drifts.csv", "x x_t", "x t_x"),
        "drifts.csv:2: drift 'strip': free must be some of",
    ),
    "a unit of a rate that is none": (
        *("drifts.csv", "x_t_mm", "x_t_mgon"),
        "drifts.csv:1: unknown unit 'mgon' in 'x_t_mgon'; valid: m, dm, cm, mm",
    ),
    "a time error that is no number": (
        *("shutters.csv", "0.01", "10 ms"),
        "shutters.csv:2: shutter 'S': error_s: '10 ms' is not a number",
    ),
}


def written(folder: Path, texts: dict[str, str]) -> Path:
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "project.toml"


def test_the_flight_as_it_stands_is_read(tmp_path: Path) -> None:
    network = load_project(written(tmp_path, TEXTS)).network
    assert [o.kind for o in network.observations.values()] == [
        "photo_position",
        "photo_attitude",
        "photo_angle",
        "photo_range",
    ]
    assert network.shutters["S"].values == (0.01,)
    assert network.observations["1"].velocity == (60.0, 0.0, 0.0)
    assert network.observations["2"].about == "body"


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(name: str, tmp_path: Path) -> None:
    table, old, new, expected = WRONG[name]
    assert TEXTS[table].count(old) == 1
    texts = {**TEXTS, table: TEXTS[table].replace(old, new)}
    with pytest.raises(InputError) as caught:
        load_project(written(tmp_path, texts))
    assert expected in str(caught.value)


def test_observations_in_memory_are_checked() -> None:
    with pytest.raises(InputError, match="axes must be some of x, y, z, not 'en'"):
        PhotoPosition("1", (0.0, 0.0), axes="en", sigma=(1.0, 1.0))
    with pytest.raises(InputError, match="value must have 2 components"):
        PhotoPosition("1", (0.0, 0.0, 1.0), axes="xy", sigma=(1.0, 1.0))
    with pytest.raises(InputError, match="cannot join a photo to itself"):
        PhotoBase("1", "1", 30.0, sigma=0.1)
    with pytest.raises(InputError, match="give either sigma or covariance"):
        PhotoAttitude("1", (0.0, 0.0, 0.0))


def test_angles_that_are_not_defined_are_named() -> None:
    network = fga.Network("wall")
    network.add_camera("C", NoDistortion(), {"c": 100.0})
    angles = (0.0, np.pi / 2, 0.0)
    network.add_photo("1", "C", position=(0, 0, 0), omega_phi_kappa=angles)
    network.add(PhotoPosition("1", (0.0, 0.0, 0.0), sigma=(0.1,) * 3))
    wrong = PhotoAttitude("1", angles, sigma=(1e-3,) * 3, id="wrong")
    network.add(wrong)
    with pytest.raises(InputError, match=r'±90°.*about="body"'):
        fga.adjust(network)
    network.observations["wrong"] = PhotoAttitude("1", angles, sigma=(1e-3,) * 3, about="body")
    assert fga.adjust(network).converged


def test_drifts_that_take_up_every_position_are_named() -> None:
    network = fga.Network("strip")
    network.add_camera("C", NoDistortion(), {"c": 100.0})
    network.set_drift("strip 1", free=["x", "y", "z"])
    network.add_point("A", (0.0, 0.0, 0.0))
    for i in range(2):
        at, photo = (300.0 * i, 0.0, 1000.0), f"{i}"
        network.add_photo(photo, "C", position=at, rotation=np.diag([1.0, -1.0, -1.0]))
        network.add(PhotoPosition(photo, at, sigma=(0.1,) * 3, drift="strip 1"))
        network.add(PhotoAttitude(photo, (0.0, 0.0, 0.0), sigma=(1e-4,) * 3))
        network.add_image_points(photo, ["A"], [(-30.0 * i, 0.0)], sigma=0.01)
    told = [str(p) for p in check(network)]
    assert any(
        t.endswith("free shifts of drift 'strip 1' take up positions of photos") for t in told
    )
