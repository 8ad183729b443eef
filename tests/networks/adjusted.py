"""Every test network of the batch adjustment but those of Gama, by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.io.photogrammetry.bundler import read_bal
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.io.survey.mmvii import read_mmvii
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.rotation import world_R_camera
from tests.loaders import snap
from tests.networks import aicon, dbat
from tests.networks.comp3d import deflected, network_of_topo
from tests.networks.mmvii import example_3
from tests.networks.simulated import NETWORKS
from tests.support.places import data_dir


def topo_mini() -> fga.Network:
    folder = data_dir("mmvii_topo") / "TopoMini" / "inputs"
    return read_mmvii(folder / "meas.obs")


def camcal(model: int = 3) -> fga.Network:
    return dbat.read_camcal(data_dir("dbat_camcal"), model=model)


def camcal_free() -> fga.Network:
    """Its photos and points alone: seven defects."""
    network = dbat.read_camcal_export(data_dir("dbat_camcal"), "", control=False)
    network.datum = "free"
    return network


def held_photos(depth: float = 200.0) -> fga.Network:
    """Points intersected from three held photos, a metre apart; errors 1/1000 of the parallax."""
    network = fga.Network("held photos")
    network.add_camera("camera", BrownLens(), {"c": 30.0})
    centres = [np.array([float(i), 0.0, 0.0]) for i in range(3)]
    rotation = world_R_camera(np.pi, 0.0, 0.0)
    rng = np.random.default_rng(3)
    points = [depth * np.array([*rng.uniform(-0.3, 0.3, 2), 1.0]) for _ in range(4)]
    for number, at in enumerate(points):
        network.add_point(f"P{number}", at)
    for i, centre in enumerate(centres):
        network.add_photo(f"F{i}", "camera", position=centre, rotation=rotation, fixed=True)
        q = (np.array(points) - centre) @ rotation
        xy = 30.0 * q[:, :2] / q[:, 2:] * [1.0, -1.0] + 0.03 / depth * rng.normal(size=(4, 2))
        network.add_image_points(f"F{i}", list(network.points), xy, sigma=1e-3)
    return network


def read(file: str) -> fga.Network:
    return read_gama(data_dir("krumm_textbook") / file)


ADJUSTED: dict[str, Callable[[], fga.Network]] = {
    "Ghilani 21.1": lambda: read("Ghilani21_1.gkf"),
    "sxb": lambda: dbat.read_sxb(data_dir("dbat_sxb")),
    "sxb with camera positions": lambda: dbat.read_sxb(data_dir("dbat_sxb"), camera_positions=True),
    "camcal, model 3": camcal,
    "camcal, model 4": lambda: camcal(4),
    "camcal, model 1": lambda: camcal(1),
    "camcal, forward": lambda: camcal(-1),
    "camcal, weighted": lambda: dbat.read_camcal(data_dir("dbat_camcal"), control="weighted"),
    "camcal, five photos": lambda: dbat.read_camcal_export(data_dir("dbat_camcal"), "5"),
    "camcal, free": camcal_free,
    "AICON": lambda: aicon.read_aicon(data_dir("aicon_jaicov")),
    "Roma": lambda: dbat.read_roma(data_dir("dbat_roma")),
    "Ladybug, a cut": lambda: read_bal(data_dir("bal") / "problem-49-7776-pre-shrink-1800.txt"),
    "Comp3D": network_of_topo,
    "Comp3D, deflections": deflected,
    "MMVII, TopoMini": topo_mini,
    "MMVII, Ex3": lambda: example_3(fga.LocalFrame()),
    "SNAP, testrc": lambda: snap.read_zenith_angles(data_dir("snap_obs_equations") / "in"),
    "DynAdjust": lambda: fga.read_dynaml(data_dir("dynadjust_gnss") / "gnss-networkstn.xml"),
    "held photos": held_photos,
    **NETWORKS,
}
"""All but the networks of Gama, which test_gama prepares."""
