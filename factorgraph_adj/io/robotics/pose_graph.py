"""Pose graphs as read from a file, and as networks in space or in plan.

A pose is the rotation R and the place X of a body in the world. With the measured relative pose
(R_z, t_z) of body j in axes of body i, g2o has the error e of the transformation Z⁻¹ Xᵢ⁻¹ Xⱼ:

    e_t = R_zᵀ (Rᵢᵀ (Xⱼ − Xᵢ) − t_z)              along the axes of the measured j
    e_q = vector part of the quaternion of R_zᵀ Rᵢᵀ Rⱼ

The observations of a network, `RelativePosition` and `RelativeRotation`, have the residuals
v_t = R_z e_t and v_r = Log(R_zᵀ Rᵢᵀ Rⱼ) = 2 e_q (1 + |e_q|²/6 + …), with the covariance

    T Σ_e Tᵀ,   T = diag(R_z, 2 I)

Programs that take the same numbers for rotation vectors (GTSAM, Ceres) have T = diag(R_z, I).

In plan e = (R_zᵀ (d − t_z), θⱼ − θᵢ − θ_z), and `PlanarVector` and `HeadingDifference`, which is
clockwise, have T = diag(R_z, −1).

Bodies in space are photos without image points, whose photogrammetric axes are those of the body,
so that ω, φ, κ are the angles of R. Bodies in plan are points with a heading, the azimuth of their
x axis: 90° less the angle of the file.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from ...models.base import within
from ...models.lens import NoDistortion
from ...network.network import Network
from ...observations import Correlated, Observation, RelativePosition, RelativeRotation
from ...observations.body_vectors import BodyVector, HeadingDifference, PlanarVector
from ...rotation import TURN_ABOUT_X, log_rotation
from ...types import Array
from ..source import Problems

BODY = "body"
"""Name of the camera of bodies, which takes no images."""
WORLD = "world"
"""Name of the held pose to which observed poses refer."""
LANDMARK = "L"
"""Letter before the number of a landmark: files number poses and landmarks apart."""


@dataclass(frozen=True)
class BodyPose:
    """Rotation and place of a body."""

    rotation: Array
    """World ← body, (3, 3)."""
    place: Array
    """Place, (3,) metres."""

    def before(self, other: BodyPose) -> BodyPose:
        """Return this pose followed by another one that is given in its axes."""
        return BodyPose(self.rotation @ other.rotation, self.place + self.rotation @ other.place)

    def inverse(self) -> BodyPose:
        """Return the pose of the world in axes of the body."""
        return BodyPose(self.rotation.T, -self.rotation.T @ self.place)

    @property
    def angle(self) -> float:
        """Angle of the x axis in plan, counter-clockwise from the x axis of the world, radians."""
        return float(np.arctan2(self.rotation[1, 0], self.rotation[0, 0]))


def in_plan(x: float, y: float, angle: float) -> BodyPose:
    """Return a pose in plan, whose x axis has an angle from that of the world, radians."""
    c, s = math.cos(angle), math.sin(angle)
    return BodyPose(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, 0.0]))


STANDING = BodyPose(np.eye(3), np.zeros(3))
"""The pose of the world itself."""


@dataclass(frozen=True)
class PoseEdge:
    """Measured pose of a body j in axes of a body i."""

    first: str
    """The body i; `WORLD` for an observed pose."""
    second: str
    """The body j."""
    measured: BodyPose
    """Its pose in axes of i."""
    covariance: Array
    """Covariance of the residuals: position and rotation (6, 6), or in plan (3, 3)."""
    where: str
    """File and line."""


@dataclass(frozen=True)
class LandmarkSight:
    """Measured place of a landmark in axes of a body."""

    body: str
    """The body."""
    landmark: str
    """The landmark."""
    vector: Array
    """Its place, (3,) metres."""
    covariance: Array
    """Covariance, (3, 3), or in plan (2, 2)."""
    where: str
    """File and line."""


@dataclass
class PoseGraph:
    """A pose graph: approximate values and measurements."""

    name: str
    """Its name."""
    planar: bool = False
    """Whether it is in plan."""
    poses: dict[str, BodyPose] = field(default_factory=dict)
    """Approximate poses by name."""
    landmarks: dict[str, Array] = field(default_factory=dict)
    """Approximate places of landmarks, (3,), by name."""
    edges: list[PoseEdge] = field(default_factory=list)
    """Relative poses."""
    sights: list[LandmarkSight] = field(default_factory=list)
    """Sights of landmarks."""
    held: dict[str, str] = field(default_factory=dict)
    """Held poses and landmarks, with their places in the file."""

    def place_missing(self) -> list[str]:
        """Fill poses and landmarks without approximate values along the edges; return their names.

        A graph without any pose begins at the first body of its first edge. What no edge joins
        stays without values.
        """
        if not self.poses and self.edges:
            self.poses[self.edges[0].first] = STANDING
        begun = set(self.poses) | set(self.landmarks)
        joined: dict[str, list[tuple[str, BodyPose]]] = defaultdict(list)
        for e in self.edges:
            joined[e.first].append((e.second, e.measured))
            joined[e.second].append((e.first, e.measured.inverse()))
        waiting = deque(self.poses)
        while waiting:
            name = waiting.popleft()
            for other, step in joined[name]:
                if other not in self.poses:
                    self.poses[other] = self.poses[name].before(step)
                    waiting.append(other)
        for s in self.sights:
            if s.landmark not in self.landmarks and s.body in self.poses:
                pose = self.poses[s.body]
                self.landmarks[s.landmark] = pose.place + pose.rotation @ s.vector
        return [n for n in (*self.poses, *self.landmarks) if n not in begun]

    def without_place(self) -> Iterable[tuple[str, str]]:
        """Yield names that measurements use and that have no place, with the file and line."""
        for e in self.edges:
            yield from ((n, e.where) for n in (e.first, e.second) if n not in self.poses)
        for s in self.sights:
            if s.body not in self.poses:
                yield s.body, s.where

    def network(self, problems: Problems) -> Network:
        """Return the graph as a network; what an observation refuses is noted with its place."""
        network = Network(self.name)
        add = self._planar_observations if self.planar else self._observations
        if self.planar:
            self._points(network)
        else:
            self._photos(network)
        for e in self.edges:
            with problems.collect(e.where):
                network.add(Correlated(add(e), e.covariance))
        for s in self.sights:
            with problems.collect(s.where):
                network.add(self._sight(s))
        return network

    # -- in space ---------------------------------------------------------------------------------

    def _photos(self, network: Network) -> None:
        network.add_camera(BODY, NoDistortion(), {"c": 1.0})
        for name, pose in self.poses.items():
            network.add_photo(
                name,
                BODY,
                position=pose.place.tolist(),
                rotation=pose.rotation @ TURN_ABOUT_X,
                fixed=name in self.held,
            )
        for name, at in self.landmarks.items():
            network.add_point(name, at.tolist(), fixed="xyz" if name in self.held else "")

    @staticmethod
    def _observations(e: PoseEdge) -> tuple[Observation, ...]:
        turn = log_rotation(e.measured.rotation[None])[0]
        names, at, sigma = (e.first, e.second), e.where, np.sqrt(np.diag(e.covariance)).tolist()
        base = tuple(e.measured.place.tolist())
        return (
            RelativePosition(*names, base, sigma=tuple(sigma[:3]), source=at),
            RelativeRotation(*names, tuple(turn.tolist()), sigma=tuple(sigma[3:]), source=at),
        )

    # -- in plan ----------------------------------------------------------------------------------

    def _points(self, network: Network) -> None:
        for name, pose in self.poses.items():
            held = name in self.held
            network.add_point(name, pose.place.tolist(), fixed="xyz" if held else "z")
            azimuth = float(within(np.array(0.5 * np.pi - pose.angle)))
            network.set_unknown("heading", name, (azimuth,), fixed=held)
        for name, at in self.landmarks.items():
            network.add_point(name, at.tolist(), fixed="xyz" if name in self.held else "z")

    @staticmethod
    def _planar_observations(e: PoseEdge) -> tuple[Observation, ...]:
        x, y = e.measured.place[:2].tolist()
        names, at, sigma = (e.first, e.second), e.where, np.sqrt(np.diag(e.covariance)).tolist()
        return (
            PlanarVector(*names, (x, y), sigma=tuple(sigma[:2]), source=at),
            HeadingDifference(*names, -e.measured.angle, sigma=sigma[2], source=at),
        )

    def _sight(self, s: LandmarkSight) -> Observation:
        if self.planar:
            x, y = s.vector[:2].tolist()
            return PlanarVector(s.body, s.landmark, (x, y), covariance=s.covariance, source=s.where)
        at = tuple(s.vector.tolist())
        return BodyVector(s.body, s.landmark, at, covariance=s.covariance, source=s.where)
