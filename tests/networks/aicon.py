"""The close-range block of AICON 3D Studio with what its report says, and other starts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from factorgraph_adj import units
from factorgraph_adj.io.photogrammetry import aicon
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import omega_phi_kappa, world_R_camera
from factorgraph_adj.types import Array

MM = units.LENGTH["mm"]
CAMERA = "1"
FREE = aicon.AICON_PARAMETERS
"""What the report lists as calibrated; A3, C1, C2 are held."""

SIGMA = 0.0005
"""A-priori standard deviation of image coordinates, mm."""

Start = Literal["published", "photos astray", "perturbed"]


def read_aicon(
    folder: Path,
    *,
    name: str = "example",
    start: Start = "published",
    with_rejected: bool = False,
) -> Network:
    """Return the block as a free network over its active points, in metres.

    Args:
        folder: where the files lie.
        name: what they are called.
        start: the published solution; the same with "photos astray" by 20 mm and 5 mrad and a
            nominal calibration; or "perturbed", points by 5 mm too. From a fixed seed.
        with_rejected: put back the image points that AICON rejected, see `rejected_image_points`.
    """
    network = aicon.read_aicon(folder / f"{name}.obc", sigma_mm=SIGMA)
    photos, points, numbers = image_reference(folder)
    f, p, _, sigma = network.images.columns()
    row = {
        f"{list(network.photos)[a]}/{list(network.points)[b]}": i
        for i, (a, b) in enumerate(zip(f.tolist(), p.tolist(), strict=True))
    }
    for photo, point, values in zip(photos, points, numbers, strict=True):
        sigma[row[f"{photo}/{point}"]] = values[2:4]  # four have 5 µm in the report
    rng = np.random.default_rng(1)
    if start == "perturbed":
        for ident, point in network.points.items():
            moved = tuple((point.coordinates + rng.normal(0, 5 * MM, 3)).tolist())
            network.points[ident] = replace(point, coordinates=moved)
    if start != "published":
        camera = network.cameras[CAMERA]
        given = dict(zip(camera.lens.names, camera.values, strict=True))
        given |= {"c": round(given["c"], 0), "A1": 0.0, "A2": 0.0, "B1": 0.0, "B2": 0.0}
        network.cameras[CAMERA] = replace(camera, values=tuple(given.values()))
        for ident, photo in network.photos.items():
            assert photo.position is not None and photo.rotation is not None
            centre = tuple((photo.position + rng.normal(0, 20 * MM, 3)).tolist())
            angles = omega_phi_kappa(photo.rotation) + rng.normal(0, 5e-3, 3)
            network.photos[ident] = replace(
                photo, position=centre, rotation=world_R_camera(*angles.tolist())
            )
    if with_rejected:
        for photo, point, x, y in rejected_image_points(folder, name=name):
            network.add_image_points(photo, [point], np.array([[x, y]]), sigma=SIGMA)
    return network


def rejected_image_points(
    folder: Path, *, name: str = "example"
) -> list[tuple[str, str, float, float]]:
    """Return photo, point, x and y (mm) of the real measurements that AICON rejected.

    Only those of points that take part in the adjustment.
    """
    active = {f[0] for f in rows(folder / f"{name}.obc") if f[8] == "1"}
    return [
        (f[0], f[1], float(f[2]), float(f[3]))
        for f in rows(folder / f"{name}.phc")
        if f[9] == "0" and f[1] in active
    ]


def image_reference(folder: Path) -> tuple[Array, Array, Array]:
    """Return photo, point and the numbers of each image point in ``image_obs_reference.csv``.

    Columns of the numbers: x, y, a-priori σ of both, then what the report prints for them
    (residuals, redundancy numbers, test values), then the same from a second computation.
    """
    text = np.loadtxt(
        folder / "image_obs_reference.csv", delimiter=",", skiprows=1, dtype=str, ndmin=2
    )
    return text[:, 0], text[:, 1], text[:, 2:].astype(float)


def point_reference(folder: Path) -> tuple[list[str], Array]:
    """Return names and X, Y, Z, sX, sY, sZ (metres) of the adjusted points."""
    text = np.loadtxt(
        folder / "points_reference.csv", delimiter=",", dtype=str, skiprows=1, ndmin=2
    )
    return text[:, 0].tolist(), MM * text[:, 1:].astype(float)


def published_points(folder: Path, *, name: str = "example") -> tuple[list[str], Array]:
    """Return the same as AICON prints them in the .obc file, to 0.0001 mm."""
    active = [f for f in rows(folder / f"{name}.obc") if f[8] == "1"]
    return [f[0] for f in active], MM * np.array([[float(v) for v in f[1:7]] for f in active])


def published_poses(folder: Path, *, name: str = "example") -> dict[str, Array]:
    """Return X0, Y0, Z0 (metres), ω, φ, κ (rad) of the photos as in the .eor file."""
    scale = np.array([MM, MM, MM, 1.0, 1.0, 1.0])
    return {
        f[0]: scale * np.array([float(v) for v in f[2:8]]) for f in rows(folder / f"{name}.eor")
    }


def rows(path: Path) -> list[list[str]]:
    """Return the fields of the rows of a file, without quotation marks."""
    return [line.replace('"', "").split() for line in path.read_text().splitlines() if line.strip()]


def published_pose_sigmas(folder: Path, *, name: str = "example") -> dict[str, Array]:
    """Return σ of X0, Y0, Z0 (metres) and of AICON's rx, ry, rz as the report prints them.

    A photo takes three lines there: "number camera X Y Z sX sY sZ rays",
    "air rad ω φ κ sω sφ sκ rms rms" and "srx sry srz max max".
    """
    report = (folder / f"{name}_report_plain.txt").read_text(errors="replace").splitlines()
    out = {}
    for before, line, after in zip(report, report[1:], report[2:], strict=False):
        if line.strip().startswith("air rad"):
            first, third = before.split(), after.split()
            out[first[0]] = np.array(
                [MM * float(v) for v in first[5:8]] + [float(v) for v in third[:3]]
            )
    return out
