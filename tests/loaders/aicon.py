"""Close-range blocks of AICON 3D Studio: .phc, .eor, .obc, .ior, .scale (millimetres).

The camera's ``Ck`` is the negative principal distance. Image coordinates have x right, y up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from factorgraph_adj import units
from factorgraph_adj.models.lens import BalancedLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.types import Array

MM = units.LENGTH["mm"]
CAMERA = "camera"
FREE = ("c", "x0", "y0", "A1", "A2", "B1", "B2")
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

    Image coordinates and their a-priori standard deviations are those of the report, see
    ``image_obs_reference.csv``.

    Args:
        folder: where the files lie.
        name: what they are called.
        start: the published solution; the same with "photos astray" by 20 mm and 5 mrad and a
            nominal calibration; or "perturbed", points by 5 mm too. From a fixed seed.
        with_rejected: put back the image points that AICON rejected, see `rejected_image_points`.
    """
    network = Network("AICON close-range block", datum="free")
    rng = np.random.default_rng(1)

    def astray(values: list[float], sigma: float) -> list[float]:
        return (values + rng.normal(0, sigma, len(values))).tolist()

    for fields in _rows(folder / f"{name}.obc"):
        if fields[8] == "1":  # active
            xyz = [MM * float(v) for v in fields[1:4]]
            if start == "perturbed":
                xyz = astray(xyz, 5 * MM)
            network.add_point(fields[0], xyz, datum=True)
    values, radius = _interior(folder / f"{name}.ior")
    if start != "published":
        values |= {"c": round(values["c"], 0), "A1": 0.0, "A2": 0.0, "B1": 0.0, "B2": 0.0}
    network.add_camera(CAMERA, BalancedLens(zero_radius=radius), values, free=FREE, unit="mm")
    for fields in _rows(folder / f"{name}.eor"):
        numbers = [float(v) for v in fields[2:8]]
        centre, angles = [MM * v for v in numbers[:3]], numbers[3:]
        if start != "published":
            centre, angles = astray(centre, 20 * MM), astray(angles, 5e-3)
        network.add_photo(fields[0], CAMERA, position=centre, omega_phi_kappa=angles)
    photos, points, table = image_reference(folder)
    for photo in network.photos:
        rows = np.flatnonzero(photos == photo)
        network.add_image_points(
            photo, points[rows].tolist(), table[rows, :2], sigma=table[rows, 2:4]
        )
    if with_rejected:
        for photo, point, x, y in rejected_image_points(folder, name=name):
            network.add_image_points(photo, [point], np.array([[x, y]]), sigma=SIGMA)
    for fields in _rows(folder / f"{name}.scale"):
        _, _, a, b, length, sigma, _ = fields
        network.add(SlopeDistance(a, b, MM * float(length), sigma=MM * float(sigma), id="bar"))
    return network


def rejected_image_points(
    folder: Path, *, name: str = "example"
) -> list[tuple[str, str, float, float]]:
    """Return photo, point, x and y (mm) of the real measurements that AICON rejected.

    Only those of points that take part in the adjustment.
    """
    active = {f[0] for f in _rows(folder / f"{name}.obc") if f[8] == "1"}
    return [
        (f[0], f[1], float(f[2]), float(f[3]))
        for f in _rows(folder / f"{name}.phc")
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
    rows = [f for f in _rows(folder / f"{name}.obc") if f[8] == "1"]
    return [f[0] for f in rows], MM * np.array([[float(v) for v in f[1:7]] for f in rows])


def published_poses(folder: Path, *, name: str = "example") -> dict[str, Array]:
    """Return X0, Y0, Z0 (metres), ω, φ, κ (rad) of the photos as in the .eor file."""
    scale = np.array([MM, MM, MM, 1.0, 1.0, 1.0])
    return {
        f[0]: scale * np.array([float(v) for v in f[2:8]]) for f in _rows(folder / f"{name}.eor")
    }


def _interior(path: Path) -> tuple[dict[str, float], float]:
    """Return the calibration (mm) and the radius of zero distortion."""
    n = [[float(v) for v in fields] for fields in _rows(path)]
    _, _, ck, x0, y0, a1, a2, radius = n[0]
    values = {"c": -ck, "x0": x0, "y0": y0, "A1": a1, "A2": a2, "A3": n[1][0]}
    values |= {"B1": n[2][0], "B2": n[2][1], "C1": n[3][0], "C2": n[3][1]}
    return values, radius


def _rows(path: Path) -> list[list[str]]:
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
