"""Writer of pose graphs of g2o: poses, edges, landmarks; see `io.robotics.pose_graph`.

The records are those of the reader: in space ``VERTEX_SE3:QUAT``, ``EDGE_SE3:QUAT``,
``VERTEX_TRACKXYZ``, ``EDGE_SE3_TRACKXYZ`` and ``EDGE_SE3_PRIOR``, in plan ``VERTEX_SE2``,
``EDGE_SE2``, ``VERTEX_XY``, ``EDGE_SE2_XY`` and ``EDGE_PRIOR_SE2``, and ``FIX`` at the end.
Matrices are informations of the error of g2o, T⁻¹ Σ T⁻ᵀ of the covariance Σ of the residuals.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import get_args

import numpy as np

from ...errors import InputError, taking
from ...network.network import Network
from ...observations import Observation, RelativePosition, RelativeRotation
from ...observations.body_vectors import BodyVector, HeadingDifference, PlanarVector
from ...rotation import TURN_ABOUT_X, exp_rotation
from ...solve.solution import Solution
from ...types import Array
from ..file_transaction import write_files
from ..format_limits import Refusals
from .g2o import RotationChoice
from .pose_graph import BODY, LANDMARK, WORLD, in_plan

OFFSET = 0
"""Number of the parameter of sensors, which stand at the body."""
_NUMBER = re.compile(r"0|[1-9]\d*")
_IN_SPACE, _IN_PLAN = (RelativePosition, RelativeRotation), (PlanarVector, HeadingDifference)


@taking(Network | Solution)
def write_g2o(
    network: Network | Solution, path: str | Path, *, rotations: RotationChoice = "quaternion"
) -> None:
    """Write a pose graph in plan or in space for g2o, GTSAM, Ceres.

    Numbers have 17 digits: what `read_g2o` reads is the same network.

    Args:
        network: the network with its given poses, or a solution. Poses in space are photos, those
            in plan points with a heading; their names are whole numbers, those of landmarks have
            the letter L before the number. An edge is a correlated group of a position and a
            rotation.
        path: the file.
        rotations: to what the rotations of the matrices of EDGE_SE3:QUAT belong, see `read_g2o`.

    Raises:
        InputError: everything that the format cannot express: other names, observations and
            unknowns, poses without values, weighted or partly held ones, a free datum. No file has
            changed.
    """
    if rotations not in get_args(RotationChoice):
        valid = ", ".join(get_args(RotationChoice))
        raise InputError(f"rotations must be one of {valid}, not {rotations!r}")
    if isinstance(network, Solution):
        network = network.as_network()
    written = _Writing(network, rotations)
    lines = written.lines()
    written.refused.raise_all()
    target = Path(path)
    write_files(target.parent, {target.name: "\n".join(lines) + "\n"})


def numbers(values: Iterable[float]) -> str:
    """Return numbers with 17 digits, blanks between."""
    return " ".join(repr(float(v)) for v in values)


def quaternion(rotation: Array) -> list[float]:
    """Return qx, qy, qz, qw ≥ 0 of a rotation."""
    from scipy.spatial.transform import Rotation

    found: list[float] = Rotation.from_matrix(rotation).as_quat().tolist()
    return [-x for x in found] if found[3] < 0 else found


class _Writing:
    """A network while it is written."""

    def __init__(self, network: Network, rotations: RotationChoice) -> None:
        self.network = network
        self.rotations = rotations
        self.refused = Refusals("g2o")
        self.headings = network.of_kind("heading")
        self.planar = not network.photos
        self.poses = list(self.headings if self.planar else network.photos)
        self.begun: list[str] = []
        self.held: list[str] = []
        self.observes_pose = False

    def lines(self) -> list[str]:
        """Return the lines; what cannot be written is refused."""
        self._refuse_others()
        vertices = [line for name in self.poses for line in self._pose(name)]
        marks = [n for n in self.network.points if not self.planar or n not in self.headings]
        vertices += [line for name in marks for line in self._landmark(name)]
        edges = self._edges()
        if not self.held and not self.observes_pose:
            what = "a free datum: hold a pose, as its readers hold the first one"
            self.refused.refuse(what, self.network.name)
        # GTSAM reads no edge of a graph in plan after a FIX.
        return [*self.begun, *vertices, *edges, *(f"FIX {n}" for n in self.held)]

    def _refuse_others(self) -> None:
        network, refused = self.network, self.refused
        if network.frame != Network("").frame:
            refused.refuse("a frame on the curved Earth", network.name)
        if network.n_image_points:
            refused.refuse("image points", network.name)
        for camera in network.cameras.values():
            if camera.name != BODY or camera.lens.kind != "none":
                refused.refuse("a calibration", f"camera {camera.name!r}")
        for kind, given in network.parameters.items():
            if given and not (self.planar and kind == "heading"):
                refused.refuse(f"unknowns of the kind {kind}", network.name)
        if not self.poses:
            refused.refuse("a network without poses: photos, or points with a heading")

    def _number(self, name: str, where: str, before: str = "") -> str:
        found = name.removeprefix(before)
        if not name.startswith(before) or _NUMBER.fullmatch(found) is None:
            least = f"the letter {before} and a whole number" if before else "a whole number"
            self.refused.refuse(f"other names than {least}", where)
        return found

    def _hold(self, number: str, flags: Iterable[bool], where: str) -> None:
        held = tuple(flags)
        if all(held):
            self.held.append(number)
        elif any(held):
            self.refused.refuse("a partly held pose or landmark", where)

    # -- vertices ---------------------------------------------------------------------------------

    def _pose(self, name: str) -> Iterable[str]:
        if self.planar:
            yield from self._planar_pose(name)
            return
        photo, where = self.network.photos[name], f"photo {name!r}"
        if photo.sigma_position is not None or photo.sigma_attitude is not None:
            self.refused.refuse("a weighted pose", where)
        if photo.rotation is None or photo.position is None:
            self.refused.refuse("a pose without values: write the solution", where)
            return
        place, rotation = np.array(photo.position), photo.rotation @ TURN_ABOUT_X
        if name == WORLD:
            standing = not place.any() and np.allclose(rotation, np.eye(3), atol=1e-15)
            self._world(standing and all(photo.fixed), where)
            return
        number = self._number(name, where)
        self._hold(number, photo.fixed, where)
        yield f"VERTEX_SE3:QUAT {number} {numbers([*place, *quaternion(rotation)])}"

    def _world(self, holds: bool, where: str) -> None:
        """Refuse a world that is not where it is; it has no line."""
        if not holds:
            self.refused.refuse("a world that is not held at its origin", where)

    def _planar_pose(self, name: str) -> Iterable[str]:
        where = f"point {name!r}"
        point, heading = self.network.points.get(name), self.headings[name]
        if point is None or not np.isfinite([*point.coordinates, *heading.values]).all():
            self.refused.refuse("a pose without values: write the solution", where)
            return
        if point.sigma is not None or np.isfinite(heading.sigma).any():
            self.refused.refuse("a weighted pose", where)
        x, y, z = point.coordinates
        if z != 0.0 or not point.fixed[2]:
            self.refused.refuse("a height other than one held at 0 of a pose in plan", where)
        angle = 0.5 * np.pi - heading.values[0]
        flags = (*point.fixed[:2], heading.fixed[0])
        if name == WORLD:
            standing = x == 0.0 and y == 0.0 and abs(angle) < 1e-15
            self._world(standing and all(flags), where)
            return
        number = self._number(name, where)
        self._hold(number, flags, where)
        yield f"VERTEX_SE2 {number} {numbers([x, y, angle])}"

    def _landmark(self, name: str) -> Iterable[str]:
        where = f"point {name!r}"
        point = self.network.points[name]
        number = self._number(name, where, LANDMARK)
        if not np.isfinite(point.coordinates).all():
            self.refused.refuse("a landmark without coordinates: write the solution", where)
            return
        if point.sigma is not None:
            self.refused.refuse("a weighted landmark", where)
        n = 2 if self.planar else 3
        if self.planar and (point.coordinates[2] != 0.0 or not point.fixed[2]):
            self.refused.refuse("a height other than one held at 0 of a landmark in plan", where)
        if all(point.fixed) and number in self.poses:
            self.refused.refuse(f"a held landmark with the number of pose {number}", where)
        self._hold(number, point.fixed[:n], where)
        word = "VERTEX_XY" if self.planar else "VERTEX_TRACKXYZ"
        yield f"{word} {number} {numbers(point.coordinates[:n])}"

    # -- edges ------------------------------------------------------------------------------------

    def _edges(self) -> list[str]:
        network, out = self.network, list[str]()
        group_of = {i: group for group in network.clusters for i in group[0]}
        done: set[str] = set()
        for ident, o in network.observations.items():
            if ident in done:
                continue
            ids, covariance = group_of.get(ident, ((ident,), np.zeros((0, 0))))
            done |= set(ids)
            members = [network.observations[i] for i in ids]
            if len(members) == 1:
                out += self._sight(o)
            else:
                out += self._edge(members, covariance)
        return out

    def _edge(self, members: list[Observation], covariance: Array) -> Iterable[str]:
        kinds = _IN_PLAN if self.planar else _IN_SPACE
        names = ("station", "target") if self.planar else ("photo", "photo2")
        ordered = [o for kind in kinds for o in members if isinstance(o, kind)]
        ends = {tuple(getattr(o, n) for n in names) for o in ordered}
        if len(members) != 2 or len(ordered) != 2 or len(ends) != 1:
            kinds_here = ", ".join(o.kind.replace("_", " ") for o in members)
            self.refused.refuse(f"a correlated group of {kinds_here}", members[0].label())
            return
        ((first, second),) = ends
        if any(getattr(o, n, None) is not None for o in ordered for n in ("mount", "instrument")):
            self.refused.refuse("mounts and distance meters", members[0].label())
            return
        at, turned = ordered
        n = len(at.component_names())
        order = np.arange(len(covariance))
        if members[0] is turned:
            order = np.roll(order, n)
        own = covariance[np.ix_(order, order)]
        value, turn = np.array(at.value), np.atleast_1d(turned.value)
        by_error = np.eye(len(own))
        if self.planar:
            rotation = in_plan(0.0, 0.0, -float(turn[0])).rotation
            by_error[2, 2] = -1.0
            text = numbers([*value, -turn[0]])
        else:
            rotation = exp_rotation(turn)
            by_error[3:, 3:] *= 2.0 if self.rotations == "quaternion" else 1.0
            text = numbers([*value, *quaternion(rotation)])
        by_error[:n, :n] = rotation[:n, :n]
        error = np.linalg.inv(by_error)
        information = np.linalg.inv(error @ own @ error.T)
        information = information[np.triu_indices(len(own))]
        words = {
            (True, False): f"EDGE_SE2 {first} {second}",
            (False, False): f"EDGE_SE3:QUAT {first} {second}",
            (True, True): f"EDGE_PRIOR_SE2 {second}",
            (False, True): f"EDGE_SE3_PRIOR {second} {OFFSET}",
        }
        if first == WORLD:
            self.observes_pose = True
            self._with_offset()
        yield f"{words[self.planar, first == WORLD]} {text} {numbers(information)}"

    def _sight(self, o: Observation) -> Iterable[str]:
        if self.planar and isinstance(o, PlanarVector) and o.target not in self.headings:
            body, mark, word = o.station, o.target, "EDGE_SE2_XY"
        elif not self.planar and isinstance(o, BodyVector):
            body, mark, word = o.photo, o.point, "EDGE_SE3_TRACKXYZ"
        else:
            hint = ""
            if isinstance(o, (*_IN_SPACE, *_IN_PLAN)):
                hint = " alone: an edge is a correlated group of a position and a rotation"
            self.refused.refuse(f"a {o.kind.replace('_', ' ')}{hint}", o.label())
            return
        covariance = o.covariance
        if covariance is None:
            covariance = np.diag(np.square(np.asarray(o.sigma, dtype=float)))
        information = np.linalg.inv(covariance)[np.triu_indices(len(covariance))]
        ends = f"{body} {mark.removeprefix(LANDMARK)}"
        if not self.planar:
            self._with_offset()
            ends += f" {OFFSET}"
        yield f"{word} {ends} {numbers(o.value)} {numbers(information)}"

    def _with_offset(self) -> None:
        """State the parameter of sensors at the body, once, in space."""
        if not self.planar and not self.begun:
            self.begun = [f"PARAMS_SE3OFFSET {OFFSET} 0 0 0 0 0 0 1"]
