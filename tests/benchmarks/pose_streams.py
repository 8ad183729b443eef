"""Poses that arrive with their edges: the data sets of GTSAM's wheel.

Poses are photos of a camera without image points, edges `RelativePosition` and `RelativeRotation`.
Planar poses hold their height; their tilts, which this library holds only together with the
heading, are observed to be 0 by each edge. Landmarks in sight are photos with held rotations,
beacons at a distance are points in plan.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import gtsam
import numpy as np

from factorgraph_adj.entities import Photo
from factorgraph_adj.io.robotics.g2o import read_pose_graph
from factorgraph_adj.io.robotics.pose_graph import LANDMARK as LANDMARK_LETTER
from factorgraph_adj.io.robotics.pose_graph import PoseEdge
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Observation, PhotoRange, RelativePosition, RelativeRotation
from factorgraph_adj.types import Array

from .streams import Native, PlaceOf, Step, Stream

CAMERA = "camera"
AXES = np.diag([1.0, -1.0, -1.0])
"""Photogrammetric axes of a camera in its own."""
HELD = 1e-6
"""Standard deviation of the first pose, with which GTSAM alone holds it."""
SPHERE = (0.1, 0.1, 0.2), (0.1**0.5,) * 3
"""Standard deviations of the edges of sphere2500, radians and metres, as its file has them."""
WORLD = (0.02,) * 3, (0.05,) * 3
"""Those of the edges of w10000: its file has units."""
LANDMARK = 1_000_000
"""Number of the first landmark."""
ODOMETRY_OF_PLAZA = (0.01, 0.01, 0.01), (0.05, 0.05, 0.05)
"""Standard deviations of odometry between two ranges, radians and metres."""
RANGE = 1.0
"""Standard deviation of a range, metres: they are grossly wrong now and then."""

WEAK = 10.0
"""Standard deviation of beacons, metres: the first range does not place them."""


@dataclass(frozen=True)
class Edge:
    """A pose relative to another one."""

    i: int
    """The pose to which it refers."""
    j: int
    """The other one; a landmark from `LANDMARK` on."""
    rotation: Array
    """Rᵢᵀ Rⱼ, (3, 3)."""
    base: Array
    """Rᵢᵀ (Xⱼ − Xᵢ), (3,) metres."""
    turns: tuple[float, ...]
    """Standard deviations of turns about the axes of j, radians."""
    shifts: tuple[float, ...]
    """Standard deviations of the base, metres."""

    @property
    def lands(self) -> bool:
        """Whether it is of a landmark, which has no rotation."""
        return self.j >= LANDMARK

    @property
    def latest(self) -> int:
        """The pose with which it arrives."""
        return self.i if self.lands else max(self.i, self.j)

    def observations(self, number: int) -> list[Observation]:
        """Return it as observations with ids of a number."""
        turn = gtsam.Rot3.Logmap(gtsam.Rot3(AXES @ self.rotation @ AXES))
        names = _name(self.i), _name(self.j)
        base = AXES @ self.base
        shift = RelativePosition(*names, tuple(base), sigma=self.shifts, id=f"t{number}")
        if self.lands:
            return [shift]
        return [RelativeRotation(*names, tuple(turn), sigma=self.turns, id=f"r{number}"), shift]

    def in_space(self) -> gtsam.NonlinearFactor:
        """Return it as a native factor between poses in space."""
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([*self.turns, *self.shifts]))
        step = gtsam.Pose3(gtsam.Rot3(self.rotation), self.base)
        return gtsam.BetweenFactorPose3(self.i, self.j, step, noise)

    def in_plan(self) -> gtsam.NonlinearFactor:
        """Return it as a native factor in plan; a landmark by bearing and range."""
        if self.lands:
            x, y = self.base[:2]
            away = float(np.hypot(x, y))
            noise = gtsam.noiseModel.Diagonal.Sigmas(
                np.array([self.shifts[0] / away, self.shifts[0]])
            )
            bearing = gtsam.Rot2(float(np.arctan2(y, x)))
            return gtsam.BearingRangeFactor2D(self.i, self.j, bearing, away, noise)
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([*self.shifts[:2], self.turns[2]]))
        return gtsam.BetweenFactorPose2(self.i, self.j, self.step(), noise)

    def step(self) -> gtsam.Pose2:
        """Return it as a pose in plan."""
        heading = np.arctan2(self.rotation[1, 0], self.rotation[0, 0])
        return gtsam.Pose2(*self.base[:2], float(heading))


def sphere(poses: int = 2500) -> Stream:
    """Return the poses of sphere2500, each with its edges to those before it."""
    found = read_pose_graph(_file("sphere2500.txt"))[0].edges
    edges = [
        Edge(int(e.first), int(e.second), e.measured.rotation, e.measured.place, *SPHERE)
        for e in found
    ]
    prior = gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, HELD))
    return _stream("sphere2500", edges, poses, prior, planar=False)


def world(poses: int = 5000) -> Stream:
    """Return the first planar poses of w10000."""
    edges = [_planar_edge(e, *WORLD) for e in read_pose_graph(_file("w10000.graph"))[0].edges]
    return _stream("w10000", edges, poses, _prior_in_plan(gtsam.Pose2()), planar=True)


def victoria(poses: int = 10_000) -> Stream:
    """Return the poses of Victoria Park, each with odometry and the landmarks that it sees."""
    edges = []
    graph, _ = read_pose_graph(_file("victoria_park.txt"), matrices="covariance")
    for e in graph.edges:
        # The file has covariances of the error, in axes of the measured pose.
        back = np.eye(3)
        back[:2, :2] = e.measured.rotation[:2, :2]
        along, across, about = np.diag(back.T @ e.covariance @ back)
        turn, shift = about**0.5, (along**0.5, across**0.5, across**0.5)
        edges.append(_planar_edge(e, (turn,) * 3, shift))
    for s in graph.sights:
        j = int(s.landmark.removeprefix(LANDMARK_LETTER))
        sigma = (float(s.covariance[0, 0]) ** 0.5,) * 3
        edges.append(_planar(int(s.body), LANDMARK + j, s.vector[0], s.vector[1], 0.0, (), sigma))
    return _stream("victoria_park", edges, poses, _prior_in_plan(gtsam.Pose2()), planar=True)


def _stream(
    name: str, edges: Iterable[Edge], poses: int, prior: gtsam.NonlinearFactor, *, planar: bool
) -> Stream:
    """Return poses that arrive one by one; the first is held."""
    network = Network(name)
    network.add_camera(CAMERA, NoDistortion(), {"c": 1.0})
    network.add_photo(_name(0), CAMERA, position=(0.0,) * 3, rotation=np.eye(3), fixed=True)
    arriving: dict[int, list[tuple[int, Edge]]] = defaultdict(list)
    for number, edge in enumerate(edges):
        if edge.latest < poses:
            arriving[edge.latest].append((number, edge))
    steps, seen = [], {0}
    for pose in sorted(arriving):
        mine = arriving[pose]
        new = []  # with the edge from which its place follows
        for _, edge in sorted(mine, key=lambda e: (e[1].lands, abs(e[1].i - e[1].j))):
            for far, near in ((edge.j, edge.i), (edge.i, edge.j)):
                if far not in seen and near in seen:
                    new.append((far, near, edge))
                    seen.add(far)
        observations = tuple(o for number, e in mine for o in e.observations(number))
        factors = tuple(e.in_plan() if planar else e.in_space() for _, e in mine)
        start = partial(_placed_in_plan if planar else _placed_in_space, new)
        photos = partial(_photos, new, planar)
        native = Native(factors, start, pose)
        steps.append(Step(observations, ("pose", _name(pose)), photos=photos, native=native))
    return Stream(network, steps, native=(prior,))


def plaza(number: int = 2) -> Stream:
    """Return the drive of Plaza, with odometry between its ranges to four beacons."""
    from scipy.io import loadmat

    found = loadmat(str(_file(f"Plaza{number}_.mat")))
    truth = found["GT"]
    beacons = {int(row[0]): row[1:3] for row in found["TL"]}
    drive = np.loadtxt(_file(f"Plaza{number}_DR.txt"))
    ranges = np.loadtxt(_file(f"Plaza{number}_TD.txt"))
    x, y, heading = truth[0, 1:4]
    moved = np.diff(truth[:, 1:3], axis=0)
    along = np.cos(np.arctan2(moved[:, 1], moved[:, 0]) - truth[:-1, 3])
    if np.average(along, weights=np.hypot(*moved.T)) < 0.0:
        heading += np.pi  # it looks backwards
    first = gtsam.Pose2(float(x), float(y), float(heading))
    network = Network(f"Plaza{number}")
    network.add_camera(CAMERA, NoDistortion(), {"c": 1.0})
    turned = gtsam.Rot3.Rz(first.theta()).matrix()
    network.add_photo(_name(0), CAMERA, position=(x, y, 0.0), rotation=turned, fixed=True)
    for name, at in beacons.items():
        network.add_point(f"b{name}", (*at, 0.0), fixed="z", sigma=(WEAK, WEAK, np.inf))
    steps, at, pose, seen = [], 0, 0, set()
    for k, (time, _, beacon, distance) in enumerate(ranges):
        step = gtsam.Pose2()
        while at < len(drive) and drive[at, 0] <= time:
            half = gtsam.Pose2(0.0, 0.0, 0.5 * drive[at, 2])
            step = step.compose(half).compose(gtsam.Pose2(drive[at, 1], 0.0, 0.0)).compose(half)
            at += 1
        if int(beacon) not in beacons:
            continue
        i, pose = pose, pose + 1
        edge = _planar(i, pose, step.x(), step.y(), step.theta(), *ODOMETRY_OF_PLAZA)
        name, key = f"b{int(beacon)}", LANDMARK + int(beacon)
        observed = PhotoRange(name, _name(pose), distance, sigma=RANGE, id=f"d{k}")
        noise = gtsam.noiseModel.Isotropic.Sigma(1, RANGE)
        factors = [edge.in_plan(), gtsam.RangeFactor2D(pose, key, distance, noise)]
        placed = {}
        if key not in seen:
            seen.add(key)
            placed[key] = np.asarray(beacons[int(beacon)])
            weak = gtsam.noiseModel.Isotropic.Sigma(2, WEAK)
            factors.append(gtsam.PriorFactorPoint2(key, placed[key], weak))
        new = [(pose, i, edge)]
        start = partial(_placed_in_plan, new, beacons=placed)
        native = Native(tuple(factors), start, pose)
        both = (*edge.observations(k), observed)
        photos = partial(_photos, new, True)
        steps.append(Step(both, ("pose", _name(pose)), photos=photos, native=native))
    return Stream(network, steps, native=(_prior_in_plan(first),))


def _name(number: int) -> str:
    return f"x{number}" if number < LANDMARK else f"l{number - LANDMARK}"


def _planar(
    i: int,
    j: int,
    x: float,
    y: float,
    heading: float,
    turns: tuple[float, ...],
    shifts: tuple[float, ...],
) -> Edge:
    rotation = gtsam.Rot3.Rz(heading).matrix()
    return Edge(i, j, rotation, np.array([x, y, 0.0]), turns, shifts)


def _planar_edge(e: PoseEdge, turns: tuple[float, ...], shifts: tuple[float, ...]) -> Edge:
    """Return an edge of a pose graph in plan."""
    x, y, _ = e.measured.place
    return _planar(int(e.first), int(e.second), x, y, e.measured.angle, turns, shifts)


def _prior_in_plan(pose: gtsam.Pose2) -> gtsam.NonlinearFactor:
    return gtsam.PriorFactorPose2(0, pose, gtsam.noiseModel.Isotropic.Sigma(3, HELD))


def _photos(new: list[tuple[int, int, Edge]], planar: bool, place_of: PlaceOf) -> tuple[Photo, ...]:
    """Return new photos where an edge has them; in space they have no start values."""
    out: list[Photo] = []
    mine: dict[int, tuple[Array, Array]] = {}
    for far, near, edge in new:
        if not planar:
            out.append(Photo(_name(far), CAMERA))
            continue
        rotation, at = mine[near] if near in mine else place_of(_name(near))
        if near == edge.i:
            turned, there = rotation @ edge.rotation, at + rotation @ edge.base
        else:
            turned = rotation @ edge.rotation.T
            there = at - turned @ edge.base
        held = (far >= LANDMARK,) * 3 + (False, False, True)
        turned = np.eye(3) if far >= LANDMARK else turned
        mine[far] = turned, there
        position = float(there[0]), float(there[1]), 0.0
        out.append(Photo(_name(far), CAMERA, position, turned, held))
    return tuple(out)


def _placed_in_space(new: list[tuple[int, int, Edge]], isam: gtsam.ISAM2) -> gtsam.Values:
    values = gtsam.Values()
    for far, near, edge in new:
        step = gtsam.Pose3(gtsam.Rot3(edge.rotation), edge.base)
        at = isam.calculateEstimatePose3(near)
        values.insert(far, at.compose(step if near == edge.i else step.inverse()))
    return values


def _placed_in_plan(
    new: list[tuple[int, int, Edge]],
    isam: gtsam.ISAM2,
    beacons: dict[int, Array] | None = None,
) -> gtsam.Values:
    values, mine = gtsam.Values(), {}
    for far, near, edge in new:
        at = mine[near] if near in mine else isam.calculateEstimatePose2(near)
        if far >= LANDMARK:
            values.insert(far, at.transformFrom(edge.base[:2]))
            continue
        step = edge.step() if near == edge.i else edge.step().inverse()
        mine[far] = at.compose(step)
        values.insert(far, mine[far])
    for key, place in (beacons or {}).items():
        values.insert(key, place)
    return values


def _file(name: str) -> Path:
    return Path(gtsam.findExampleDataFile(name))
