"""Strongest correlation of each parameter with the pose of a photo, or with an object point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.variables import calibration_name
from ..models.positions import split_pose
from ..solve.solution import Solution
from ..types import Array, Index


@dataclass(frozen=True)
class StrongestCorrelation:
    """The strongest correlation of a parameter with a photo or a point."""

    name: str
    """Name of the photo or point."""
    component: str
    """Component of the photo or point. A photo has rotations rx, ry, rz about the axes of the
    camera and x, y, z of the projection centre along these axes (x right, y down, z forward); a
    point has x, y, z."""
    correlation: float
    """Correlation of the parameter with the component."""
    count: int
    """Number of photos, or points, with a correlation of at least the limit."""


@dataclass(frozen=True)
class CorrelationPartners:
    """The n photos or points with which parameters may be correlated."""

    names: tuple[str, ...]
    """Names of the photos or points."""
    components: tuple[str, ...]
    """Names of the k components of each."""
    columns: Index
    """Columns of the components, (n, k)."""
    sigma: Array
    """Standard deviations, infinite for held components, (n, k)."""
    axes: Array | None = None
    """Rotations from the frame to the axes of the last three components, (n, 3, 3); None: axes of
    the frame."""

    def ties(
        self, covariance: Array, sigma: Array, limit: float
    ) -> list[StrongestCorrelation | None]:
        """Return the strongest tie of each parameter.

        Args:
            covariance: covariances of all columns with the parameters, (n_columns, p).
            sigma: standard deviations of the parameters, (p,).
            limit: smallest correlation that is counted.
        """
        if not self.names:
            return [None] * len(sigma)
        cross = covariance[self.columns] / sigma
        if self.axes is not None:
            cross[:, 3:] = self.axes @ cross[:, 3:]
        rho = cross / self.sigma[:, :, None]
        size = np.abs(rho)
        count = np.sum(size.max(axis=1) >= limit, axis=0)
        out: list[StrongestCorrelation | None] = []
        for j in range(len(sigma)):
            n, i = divmod(int(np.argmax(size[:, :, j])), len(self.components))
            out.append(
                StrongestCorrelation(
                    self.names[n], self.components[i], float(rho[n, i, j]), int(count[j])
                )
            )
        return out


NO_CORRELATION_PARTNERS = CorrelationPartners((), (), np.zeros((0, 0), np.intp), np.zeros((0, 0)))


def photo_partners(solution: Solution) -> dict[str, CorrelationPartners]:
    """Return the photos with unknown components, by the name of their calibration."""
    network, table = solution.network, solution.equations.unknowns["pose"]
    groups: dict[str, list[str]] = {}
    for photo in network.photos:
        if table.offset[table.number[photo]] >= 0:
            groups.setdefault(calibration_name(network, photo), []).append(photo)
    out = {}
    for calibration, photos in groups.items():
        numbers = [table.number[f] for f in photos]
        covariance = np.array([solution.pose_covariance(f) for f in photos])
        world_R_camera, _ = split_pose(solution.state["pose"][numbers])
        axes = np.swapaxes(world_R_camera, 1, 2)
        covariance[:, 3:, 3:] = axes @ covariance[:, 3:, 3:] @ world_R_camera
        out[calibration] = CorrelationPartners(
            tuple(photos),
            ("rx", "ry", "rz", "x", "y", "z"),
            table.offset[numbers][:, None] + np.arange(6),
            _deviations(np.einsum("nii->ni", covariance)),
            axes,
        )
    return out


def point_partners(solution: Solution) -> CorrelationPartners:
    """Return the object points with unknown coordinates."""
    table = solution.equations.unknowns["point"]
    numbers = np.flatnonzero(table.offset >= 0)
    if not len(numbers):
        return NO_CORRELATION_PARTNERS
    return CorrelationPartners(
        tuple(table.names[n] for n in numbers.tolist()),
        ("x", "y", "z"),
        table.offset[numbers][:, None] + np.arange(3),
        _deviations(np.einsum("nii->ni", solution.point_covariances[numbers])),
    )


def _deviations(variances: Array) -> Array:
    """Return standard deviations; a variance of zero gives infinity."""
    held = variances <= 0
    return np.where(held, np.inf, np.sqrt(np.where(held, 1.0, variances)))
