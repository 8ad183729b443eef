"""Points, error ellipses and photos as columns and shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..frames import Frame
from ..quality.ellipses import ErrorEllipse, error_ellipses
from ..report.context import Report
from ..report.coordinates import by_photo
from ..report.html.places import states
from ..solve.solution import Solution
from ..types import Array

MM = 1e-3
"""Millimetre, metres."""
VERTICES = 72
"""Vertices of a ring; the axes of the ellipse end at four of them."""


def point_columns(report: Report) -> dict[str, Sequence[Any]]:
    """Return name, status, coordinates, σ, σ along east, north, up, and check differences."""
    solution, given = report.solution, report.network.points
    xyz = solution.state["point"]
    columns: dict[str, Sequence[Any]] = {"name": list(given), "status": states(report)}
    columns |= {a: xyz[:, i].tolist() for i, a in enumerate("xyz")}
    if not report.singular:
        covariances = solution.point_covariances
        enu = report.network.frame.basis(xyz, np.zeros((len(xyz), 2))).enu
        along = np.einsum("nai,nij,naj->na", enu, covariances, enu)
        for names, variances in (
            ("xyz", np.einsum("nii->ni", covariances)),
            (("east", "north", "up"), along),
        ):
            sigma = np.sqrt(np.maximum(variances, 0.0)) / MM
            columns |= {f"sigma_{a}_mm": sigma[:, i].tolist() for i, a in enumerate(names)}
    check = [p.check for p in given.values()]
    if any(c is not None for c in check):
        nothing = (np.nan,) * 3
        known = np.array([nothing if c is None else c for c in check], dtype=float)
        off = (xyz - known.reshape(-1, 3)) / MM
        columns |= {f"check_d{a}_mm": off[:, i].tolist() for i, a in enumerate("xyz")}
    return columns


def photo_columns(report: Report) -> dict[str, Sequence[Any]]:
    """Return name, camera, projection centre, angles, σ, and the image points of each photo."""
    photos = report.network.photos
    names = list(photos)
    counts, norms = by_photo(report)
    number = report.solution.equations.unknowns["pose"].number
    stored = report.solution.state["pose"][[number[n] for n in names]]
    columns: dict[str, Sequence[Any]] = {
        "name": names,
        "camera": [f.camera for f in photos.values()],
    }
    columns |= {a: stored[:, 9 + i].tolist() for i, a in enumerate("xyz")}
    if not report.singular:
        poses = [report.poses[n] for n in names]
        angles = np.degrees([p.angles for p in poses])
        off = np.array([p.sigma_position for p in poses]) / MM
        turned = np.degrees([p.sigma_angles for p in poses])
        about = ("omega", "phi", "kappa")
        columns |= {f"{a}_deg": angles[:, i].tolist() for i, a in enumerate(about)}
        columns |= {f"sigma_{a}_mm": off[:, i].tolist() for i, a in enumerate("xyz")}
        columns |= {f"sigma_{a}_deg": turned[:, i].tolist() for i, a in enumerate(about)}
    columns["image_points"] = [counts[n] for n in names]
    columns["normalised_rms"] = [norms[n] for n in names]
    return columns


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Error ellipses of the points that have one."""

    names: list[str]
    """Names of the points."""
    centres: Array
    """Adjusted places, (n, 3) metres in the frame."""
    semi_axes: Array
    """Semi-major and semi-minor axes, (n, 2) metres."""
    azimuths: Array
    """Azimuths of the major axes, clockwise from north, (n,) radians."""
    axes: Array
    """Unit vectors along the major axis, and 90° counter-clockwise from it, (n, 2, 3) in the
    frame."""

    def columns(self) -> dict[str, Sequence[Any]]:
        """Return name, semi-axes and azimuth of each ellipse."""
        return {
            "name": self.names,
            "semi_major_mm": (self.semi_axes[:, 0] / MM).tolist(),
            "semi_minor_mm": (self.semi_axes[:, 1] / MM).tolist(),
            "azimuth_deg": np.degrees(self.azimuths).tolist(),
        }

    def rings(self, factor: float) -> list[Array]:
        """Return closed rings, counter-clockwise from the end of the major axis, in the frame."""
        t = np.linspace(0.0, 2.0 * np.pi, VERTICES + 1)
        t[-1] = 0.0
        turn = np.stack([np.cos(t), np.sin(t)], axis=1)
        scaled = factor * self.semi_axes[:, :, None] * self.axes
        return list(self.centres[:, None] + np.einsum("mk,nki->nmi", turn, scaled))


def ellipse_shapes(solution: Solution, confidence: float | None) -> Ellipses:
    """Return the error ellipses of all points whose plan position is not held."""
    return shapes_of(error_ellipses(solution, confidence=confidence), solution.network.frame)


def shapes_of(ellipses: Sequence[ErrorEllipse], frame: Frame) -> Ellipses:
    """Return those of some ellipses in a frame that have a size."""
    found = [e for e in ellipses if e.semi_axes[0] > 0]
    centres = np.array([e.centre for e in found]).reshape(-1, 3)
    azimuths = np.array([e.azimuth for e in found])
    enu = frame.basis(centres, np.zeros((len(centres), 2))).enu
    sine, cosine = np.sin(azimuths)[:, None], np.cos(azimuths)[:, None]
    east, north = enu[:, 0], enu[:, 1]
    axes = np.stack([sine * east + cosine * north, sine * north - cosine * east], axis=1)
    sizes = np.array([e.semi_axes for e in found]).reshape(-1, 2)
    return Ellipses([str(e.a) for e in found], centres, sizes, azimuths, axes)
