"""Similarity transformations between two sets of coordinates, as frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import FrameCoordinate
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array

SEVEN = ("rx", "ry", "rz", "x", "y", "z", "ln_scale")

WOLF_DEWITT = np.array(
    [
        [1094.883, 820.085, 109.821, 10037.81, 5262.09, 772.04],
        [503.891, 1598.698, 117.685, 10956.68, 5128.17, 783.00],
        [2349.343, 207.658, 151.387, 8780.08, 4840.29, 782.62],
        [1395.320, 1348.853, 215.261, 10185.80, 4700.21, 851.32],
    ]
)
"""Arbitrary x, y, z and control X, Y, Z of four points, metres.

Wolf, DeWitt, Elements of Photogrammetry; Ghilani, Adjustment Computations. Also in
the MATLAB example ``example3DConformal`` and in ``CoordTrans.java`` of JAG3D.
"""
WOLF_DEWITT_SIGMA = np.array(
    [
        [0.007, 0.008, 0.005, 0.05, 0.06, 0.05],
        [0.011, 0.008, 0.009, 0.04, 0.06, 0.09],
        [0.006, 0.005, 0.007, 0.02, 0.04, 0.02],
        [0.005, 0.008, 0.009, 0.03, 0.05, 0.03],
    ]
)
"""Standard deviations of the same, metres (``example3DConformal``)."""

SEVEN_POINTS = np.array(
    [
        [4157222.543, 664789.307, 4774952.099, 4157870.237, 664818.678, 4775416.524],
        [4149043.336, 688836.443, 4778632.188, 4149691.049, 688865.785, 4779096.588],
        [4172803.511, 690340.078, 4758129.701, 4173451.354, 690369.375, 4758594.075],
        [4177148.376, 642997.635, 4760764.800, 4177796.064, 643026.700, 4761228.899],
        [4137012.190, 671808.029, 4791128.215, 4137659.549, 671837.337, 4791592.531],
        [4146292.729, 666952.887, 4783859.856, 4146940.228, 666982.151, 4784324.099],
        [4138759.902, 702670.738, 4785552.196, 4139407.506, 702700.227, 4786016.645],
    ]
)
"""Local and WGS 84 coordinates of seven points in Baden-Württemberg, geocentric metres.

Grafarend, Awange, Nonlinear analysis of the three-dimensional datum transformation (conformal group
C7(3)), Journal of Geodesy 77 (2003); also in ``CoordTrans.java`` of JAG3D.
"""


@dataclass(frozen=True)
class Similarity:
    """X = T + m R x."""

    scale: float
    """m."""
    rotation: Array
    """R, (3, 3)."""
    shift: Array
    """T, metres."""

    @property
    def omega_phi_kappa(self) -> Array:
        """ω, φ, κ of M = Rᵀ = R₃(κ) R₂(φ) R₁(ω), degrees, κ in [0, 360)."""
        m = self.rotation.T
        omega, kappa = np.arctan2(-m[2, 1], m[2, 2]), np.arctan2(-m[1, 0], m[0, 0])
        return np.degrees([omega, np.arcsin(m[2, 0]), kappa % (2 * np.pi)])


def similarity_of(solution: fga.Solution, frame: str) -> Similarity:
    """Return the similarity from a frame to the network."""
    values = solution.unknown("frame", frame).values
    origin = np.array(solution.network.frames[frame].constants[:3])
    rotation, scale = exp_rotation(values[None, :3])[0], float(np.exp(values[6]))
    return Similarity(scale, rotation, origin + scale * rotation @ values[3:6])


def inverted(similarity: Similarity) -> Similarity:
    """Return x = (X − T) R / m as a similarity."""
    scale, rotation = 1.0 / similarity.scale, similarity.rotation.T
    return Similarity(scale, rotation, -scale * rotation @ similarity.shift)


def both_observed(pairs: Array, sigma: Array) -> fga.Network:
    """Return free points that are observed in a free frame and in one that is the network's."""
    network = fga.Network("both sets observed")
    network.add_frame("x", free=SEVEN, origin=tuple(pairs[:, 3:].mean(axis=0)))
    network.add_frame("X", free=())
    for i, (pair, s) in enumerate(zip(pairs.tolist(), sigma.tolist(), strict=True), 1):
        network.add_point(str(i))
        network.add(
            FrameCoordinate("x", str(i), tuple(pair[:3]), sigma=tuple(s[:3])),
            FrameCoordinate("X", str(i), tuple(pair[3:]), sigma=tuple(s[3:])),
        )
    return network


def only_targets_observed(pairs: Array) -> fga.Network:
    """Return held points x with their X observed in a free frame: residuals are those of X."""
    network = fga.Network("targets observed")
    network.add_frame("X", free=SEVEN, origin=tuple(pairs[:, :3].mean(axis=0)))
    for i, pair in enumerate(pairs.tolist(), 1):
        network.add_point(str(i), pair[:3], fixed="xyz")
        network.add(FrameCoordinate("X", str(i), tuple(pair[3:]), sigma=(1.0,) * 3))
    return network
