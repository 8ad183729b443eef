"""Blocks of the Damped Bundle Adjustment Toolbox (DBAT), and variants that its scripts lack."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from factorgraph_adj.io.photogrammetry.dbat import read_dbat
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, PhotoPosition

CAMCAL, ROMA = "Olympus Camedia C4040Z", "Canon EOS 5D Mark II"
"""Names of the cameras."""


def read_sxb(folder: Path, *, camera_positions: bool = False) -> Network:
    """Return the aerial block, no approximate values for photos and tie points.

    Args:
        folder: where it lies.
        camera_positions: the variant ``sxb_eo``: every control point is used, every image
            point has σ = 1 px, the projection centres of photos 1 to 4 are observed
            (σ = 0.05 m), and the principal distance is PhotoModeler's, 0.2 µm shorter.
    """
    network = read_dbat(folder / "sxb.xml")
    if not camera_positions:
        return network
    (camera,) = network.cameras.values()
    export = folder / "prague2016/pmexports/wsmart-with-orient-pmexport.txt"
    c = float(export.read_text().splitlines()[3].split()[0])
    network.cameras[camera.name] = replace(camera, values=(c, *camera.values[1:]))
    for name, point in network.points.items():
        if point.check is not None:
            network.points[name] = replace(point, coordinates=point.check, check=None)
            network.add(ControlPoint(name, point.check, sigma=(0.02, 0.02, 0.04)))
    network.images.columns()[3][:] = 0.006
    photo_of = {Path(path).name: ident for ident, path in table(folder / "images/images.txt")}
    for label, x, y, z, sigma in table(folder / "prague2016/ref/fake-camera-positions.txt"):
        at = (float(x), float(y), float(z))
        network.add(PhotoPosition(photo_of[label], at, sigma=(float(sigma),) * 3))
    return network


def read_camcal(
    folder: Path, *, model: int = 3, control: Literal["fixed", "weighted"] = "fixed"
) -> Network:
    """Return the calibration of a camera, no approximate values but the nominal focal length."""
    network = read_dbat(folder / "camcaldemo.xml", model=model)
    if control == "weighted":
        for name, point in network.points.items():
            if any(point.fixed):
                network.points[name] = replace(point, fixed=(False,) * 3)
                network.add(ControlPoint(name, point.coordinates, sigma=(0.001,) * 3))
    return network


def read_roma(
    folder: Path,
    *,
    calibrated: Sequence[str] = ("c", "x0", "y0", "k1", "k2"),
    values: Mapping[str, float] | None = None,
) -> Network:
    """Return the block of 60 photos with DBAT's datum: photo 1 and Y of photo 19 held.

    Args:
        folder: where it lies.
        calibrated: which calibration parameters are unknown.
        values: calibration that differs from the camera's file.
    """
    network = read_dbat(folder / "romabundledemo.xml")
    camera = network.cameras[ROMA]
    given = dict(zip(camera.lens.names, camera.values, strict=True)) | dict(values or {})
    network.cameras[ROMA] = replace(
        camera,
        values=tuple(given.values()),
        fixed=tuple(n not in calibrated for n in camera.lens.names),
    )
    return network


def read_camcal_export(folder: Path, case: str, *, control: bool = True) -> Network:
    """Return a PhotoModeler export of the calibration, with the values it exports as start.

    Args:
        folder: where it lies.
        case: what follows ``camcal-pmexport`` in its name: "", "5", "-missing-obs", "-1ray".
        control: whether points 1001 to 1004 are held.
    """
    given = read_camcal(folder)
    network = Network(f"camera calibration {case}".strip())
    camera = given.cameras[CAMCAL]
    network.cameras[CAMCAL] = camera
    assert camera.format is not None
    pixel = camera.format[1] / 1704
    text = (folder / f"dbat/pmexports/camcal-pmexport{case}.txt").read_text()
    blocks = [[line.split() for line in b.splitlines()] for b in text.split("\n\n") if b.strip()]
    blocks = [[fields for fields in block if fields] for block in blocks]
    for block in blocks:
        # photo, X, Y, Z, κ, φ, ω follow a line that ends with the name of the picture
        for before, fields in itertools.pairwise(block):
            if before[-1].endswith(".JPG"):
                x, y, z, kappa, phi, omega = map(float, fields[1:7])
                network.add_photo(
                    str(int(fields[0]) + 1),
                    CAMCAL,
                    position=(x, y, z),
                    omega_phi_kappa=np.deg2rad([omega, phi, kappa]).tolist(),
                )
    # four tables at the end: points, measurements, and two on who sees what
    points, measured = blocks[-4:-2]
    for name, x, y, z, *_ in points:
        held = control and name in ("1001", "1002", "1003", "1004")
        network.add_point(name, (float(x), float(y), float(z)), fixed="xyz" if held else "")
    rows = [r for r in measured if r[1] in network.points]
    for photo in network.photos:
        mine = [r for r in rows if str(int(r[0]) + 1) == photo]
        xy = np.array([[float(r[2]), -float(r[3])] for r in mine]) * pixel
        sigma = np.array([[float(r[4])] * 2 for r in mine]) * pixel
        network.add_image_points(photo, [r[1] for r in mine], xy, sigma=sigma)
    return network


def table(path: Path) -> list[list[str]]:
    """Return the rows of a table with commas and comments (#)."""
    lines = path.read_text().splitlines()
    return [
        [field.strip() for field in line.split(",")]
        for line in lines
        if line.strip() and not line.startswith("#")
    ]
