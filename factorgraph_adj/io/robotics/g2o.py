"""Reader of pose graphs of g2o, TORO and iSAM: poses, relative poses, landmarks as a network.

A line is a word, numbers of vertices, and values; what a word has is a row of `RECORDS`. The upper
triangle of a symmetric matrix follows row by row; TORO's ``EDGE2`` has xx xy yy θθ xθ yθ.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ...errors import InputError
from ...network.network import Network
from ...rotation import exp_rotation, rotation_of_quaternion
from ...types import Array
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..numbers import MAX_NUMBER, parse_quantity
from ..source import LeftOutReason, TextSource, is_unread
from ..text_files import file_beginning
from .pose_graph import (
    LANDMARK,
    STANDING,
    WORLD,
    BodyPose,
    LandmarkSight,
    PoseEdge,
    PoseGraph,
    in_plan,
)

MatrixChoice = Literal["information", "covariance", "square root"]
"""What the matrices of a file are; a square root R of the information has RᵀR = Σ⁻¹."""
RotationChoice = Literal["quaternion", "vector"]
"""To what the rotations of the matrices belong: half angles of g2o, or rotation vectors."""
EQUIVALENCES = LeftOutReason("equivalences", "TORO states them for its own tree of poses")
TORO_ORDER = (0, 1, 3, 5, 2, 4)
"""Place in the upper triangle of each number of the matrix of TORO's EDGE2."""
MAX_QUATERNION_ERROR = 0.01
"""Largest difference of the length of a quaternion from one; files have four digits or more."""
ROTATION_REMARKS: dict[RotationChoice, str] = {
    "quaternion": "rotations of the matrices are half angles, as g2o writes them; "
    f"{option_text('rotations', 'vector')} takes them for rotation vectors, as GTSAM does",
    "vector": "rotations of the matrices are rotation vectors, as rotations=vector states",
}
"""What a report says of the choice, where a file has matrices that depend on it."""
DEFAULT_SIGMAS = (1.0, 1.0)
"""Standard deviations of edges without a matrix, metres and radians: g2o and TORO take the unit."""


@dataclass(frozen=True)
class PoseGraphRecord:
    """A line of a pose graph."""

    ids: tuple[str, ...]
    """What the numbers of vertices and parameters name: pose, landmark, parameter."""
    values: tuple[str, ...]
    """Names of the values."""
    use: str
    """What it is: pose, landmark, offset, edge, sight, prior."""
    matrix: int = 0
    """Number of rows of its matrix; 0: it has none."""
    planar: bool | None = None
    """Whether it is in plan; None: in both."""
    of_isam: bool = False
    """Whether the word is one of iSAM, whose files differ in what their matrices are."""
    optional: bool = False
    """Whether the matrix may be absent."""


_XY, _XYZ = ("x", "y"), ("x", "y", "z")
_PLANE, _QUATERNION = (*_XY, "angle"), (*_XYZ, "qx", "qy", "qz", "qw")
_EULER = (*_XYZ, "roll", "pitch", "yaw")
_PAIR, _SIGHT = ("pose", "pose"), ("pose", "landmark")

RECORDS: dict[str, PoseGraphRecord] = {
    "VERTEX_SE2": PoseGraphRecord(("pose",), _PLANE, "pose", planar=True),
    "VERTEX2": PoseGraphRecord(("pose",), _PLANE, "pose", planar=True),
    "VERTEX_XY": PoseGraphRecord(("landmark",), _XY, "landmark", planar=True),
    "VERTEX_SE3:QUAT": PoseGraphRecord(("pose",), _QUATERNION, "pose", planar=False),
    "VERTEX3": PoseGraphRecord(("pose",), _EULER, "pose", planar=False),
    "VERTEX_TRACKXYZ": PoseGraphRecord(("landmark",), _XYZ, "landmark", planar=False),
    "PARAMS_SE2OFFSET": PoseGraphRecord(("parameter",), _PLANE, "offset"),
    "PARAMS_SE3OFFSET": PoseGraphRecord(("parameter",), _QUATERNION, "offset"),
    "EDGE_SE2": PoseGraphRecord(_PAIR, _PLANE, "edge", 3, True),
    "EDGE2": PoseGraphRecord(_PAIR, _PLANE, "edge", 3, True, optional=True),
    "ODOMETRY": PoseGraphRecord(_PAIR, _PLANE, "edge", 3, True, of_isam=True),
    "EDGE_SE2_XY": PoseGraphRecord(_SIGHT, _XY, "sight", 2, True),
    "LANDMARK": PoseGraphRecord(_SIGHT, _XY, "sight", 2, True, of_isam=True),
    "LANDMARK2": PoseGraphRecord(_SIGHT, _XY, "sight", 2, True, of_isam=True),
    "EDGE_PRIOR_SE2": PoseGraphRecord(("pose",), _PLANE, "prior", 3, True),
    "EDGE_SE3:QUAT": PoseGraphRecord(_PAIR, _QUATERNION, "edge", 6, False),
    "EDGE3": PoseGraphRecord(_PAIR, _EULER, "edge", 6, False, optional=True),
    "EDGE_SE3_TRACKXYZ": PoseGraphRecord((*_SIGHT, "parameter"), _XYZ, "sight", 3, False),
    "EDGE_SE3_PRIOR": PoseGraphRecord(("pose", "parameter"), _QUATERNION, "prior", 6, False),
}
"""Records by their words."""
_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_BEGINNING = re.compile(
    rb"\s*(?:#[^\n]*\n\s*|FIX(?:[ \t]+\d+)+\s+)*(?:"
    + b"|".join(re.escape(w.encode()) for w in RECORDS)
    + rb"|BR|EQUIV|EDGE_\w+|VERTEX_[\w:]+)[ \t]+\d+(?:[ \t]+"
    + _NUMBER
    + rb"){2,}[ \t]*(?:\r?\n|$)"
)


def is_pose_graph(path: Path) -> bool:
    """Return whether a file begins with a line of a pose graph."""
    return _BEGINNING.match(file_beginning(path)) is not None


def read_g2o(
    path: str | Path,
    *,
    rotations: RotationChoice = "quaternion",
    matrices: MatrixChoice | None = None,
    sigmas: tuple[float, float] = DEFAULT_SIGMAS,
    fixed: tuple[str, ...] = (),
) -> Network:
    """Read a pose graph of g2o, TORO or iSAM as a network in space or in plan.

    Poses in space are photos without image points, and their axes are photogrammetric ones; those
    in plan are points with a heading, see `io.robotics.pose_graph`. Landmarks are points with the
    letter L before their number. Poses and landmarks without a VERTEX line are placed along the
    edges. Where the file holds nothing (FIX) and observes no pose (EDGE_SE3_PRIOR,
    EDGE_PRIOR_SE2), the pose with the smallest number is held, as g2o does.

    vᵀPv is the χ² of g2o: the matrix of an edge is carried over to the axes of the residuals here.
    The rotation of a g2o edge is a half angle, see `io.robotics.pose_graph`.

    Sources: g2o ``types/slam2d`` and ``types/slam3d`` (read, write and computeError of each type),
    TORO's and iSAM's file formats, and ``gtsam.readG2o``. Tried on the eight .g2o files and five
    further graphs of GTSAM's example data.

    Args:
        path: the file.
        rotations: what the rotations of the matrices of EDGE_SE3:QUAT are: vector parts of
            quaternions, as g2o writes them, or rotation vectors, as GTSAM and Ceres take them. TORO
            has rotation vectors.
        matrices: what the matrices of the file are; None: information matrices, and files with
            words of iSAM (ODOMETRY, LANDMARK, LANDMARK2) need it: they have covariances, or square
            roots of the information.
        sigmas: standard deviations of positions (metres) and rotations (radians) of edges of TORO
            without a matrix.
        fixed: names of poses and landmarks that are held beside those of FIX.

    Raises:
        InputError: the file has problems, each with file and line: an unknown record, a number too
            many or too few, a matrix that is not positive definite, graphs in plan and in space
            in one file, and what nothing places.
    """
    return read_pose_graph(
        path, rotations=rotations, matrices=matrices, sigmas=sigmas, fixed=fixed
    )[1]


def read_pose_graph(
    path: str | Path,
    *,
    rotations: RotationChoice = "quaternion",
    matrices: MatrixChoice | None = None,
    sigmas: tuple[float, float] = DEFAULT_SIGMAS,
    fixed: tuple[str, ...] = (),
) -> tuple[PoseGraph, Network]:
    """Return a pose graph and its network, see `read_g2o`."""
    stated = ("rotations", rotations, RotationChoice), ("matrices", matrices, MatrixChoice)
    for what, value, valid in stated:
        if value is not None and value not in get_args(valid):
            raise InputError(f"{what} must be one of {', '.join(get_args(valid))}, not {value!r}")
    if len(sigmas) != 2 or not all(s > 0 for s in sigmas):
        raise InputError(f"sigmas must be two numbers > 0, metres and radians, not {sigmas}")
    reading = _Reading(TextSource(path), rotations, matrices, sigmas)
    reading.lines()
    reading.hold(fixed)
    graph, problems = reading.graph, reading.source.problems
    problems.raise_all()
    if reading.of_quaternions:
        problems.remarks.append(ROTATION_REMARKS[rotations])
    placed = graph.place_missing()
    if placed:
        shown = f"{len(placed)} of them, first {placed[0]!r}"
        problems.remarks.append(f"poses and landmarks without a vertex lie along edges: {shown}")
    for name, where in graph.without_place():
        what = f"vertex {name!r} has no place, and no edge joins it with one that has"
        problems.wrong(what, where)
    problems.raise_all()
    network = graph.network(problems)
    problems.finish(network)
    return graph, network


class _Reading:
    """A file while it is read."""

    def __init__(
        self,
        source: TextSource,
        rotations: RotationChoice,
        matrices: MatrixChoice | None,
        sigmas: tuple[float, float],
    ) -> None:
        self.source = source
        self.rotations = rotations
        self.matrices = matrices
        self.sigmas = sigmas
        self.graph = PoseGraph(source.path.name)
        self.offsets: dict[str, BodyPose] = {}
        self.lines_of: dict[tuple[str, str], int] = {}
        self.dimension: tuple[bool, int] | None = None
        self.of_quaternions = False
        self.orders: tuple[list[int], bool] | None = None

    def lines(self) -> None:
        """Read all lines: vertices and parameters first, on which edges depend."""
        use: dict[str, Callable[..., None]] = {
            "pose": self._pose,
            "landmark": self._landmark,
            "offset": self._offset,
            "edge": self._edge,
            "sight": self._sight,
            "prior": self._prior,
        }
        held, rows = [], []
        for line, text in self.source.filled():
            word, *words = text.split("#", 1)[0].split() or [""]
            if word == "FIX":
                held += [(line, w) for w in words]
            elif word == "EQUIV":
                self.source.leave_out(line, EQUIVALENCES, " = ".join(words))
            elif word:
                record = self.source.field(line, word, "record").choice(
                    RECORDS | dict.fromkeys(("FIX", "EQUIV"))  # in the list of valid words
                )
                if record is not None:
                    rows.append((line, word, record, words))
        self._check_words(rows)
        later = ("edge", "sight", "prior")
        for line, word, record, words in sorted(rows, key=lambda r: r[2].use in later):
            self._dimension(line, record)
            found = self._numbers(line, word, record, words)
            if found is not None:
                use[record.use](line, record, *found)
        self.held = held

    def _check_words(self, rows: list[tuple[int, str, PoseGraphRecord, list[str]]]) -> None:
        """Refuse words of iSAM without saying what matrices are; find the order of EDGE2."""
        of_isam = next(((line, word) for line, word, r, _ in rows if r.of_isam), None)
        if of_isam is not None and self.matrices is None:
            self.source.wrong(
                of_isam[0],
                f"{of_isam[1]} is a word of iSAM, whose files have covariances, informations or "
                f"square roots of these: state {option_text('matrices', 'covariance')}, "
                f"information or {option_text('matrices', 'square root')}",
            )
            self.matrices = "information"
        self.toro = True
        edges = [(line, words[5:11]) for line, word, _, words in rows if word == "EDGE2"]
        if not edges or any(len(words) not in (0, 6) for _, words in edges):
            return
        fits = {order: all(self._fits(w, order) for _, w in edges) for order in (True, False)}
        if not fits[True] and fits[False]:
            self.toro = False
            self.source.problems.remarks.append(
                "matrices of EDGE2 have the order of g2o: in that of TORO (xx xy yy θθ xθ yθ) they "
                f"are not positive definite; first in {self.source.place(edges[0][0])}"
            )

    def _fits(self, words: list[str], toro: bool) -> bool:
        """Return whether the numbers of an EDGE2 may be a matrix in an order."""
        try:
            found = _symmetric(np.array([float(w) for w in words]), 3, toro) if words else np.eye(3)
            return bool(np.linalg.eigvalsh(found)[0] > 0)
        except (ValueError, np.linalg.LinAlgError):
            return False

    def _dimension(self, line: int, record: PoseGraphRecord) -> None:
        """Note that a file is in plan or in space, and not both."""
        if record.planar is None:
            return
        if self.dimension is None:
            self.dimension = record.planar, line
            self.graph.planar = record.planar
        elif self.dimension[0] != record.planar:
            here, there = ("plan", "space") if record.planar else ("space", "plan")
            place = self.source.place(self.dimension[1])
            self.source.wrong(line, f"is in {here}, but {place} is in {there}")

    def _numbers(
        self, line: int, word: str, record: PoseGraphRecord, words: list[str]
    ) -> tuple[list[str], Array, Array | None] | None:
        """Return names, values and covariance of a line; None after a problem."""
        n_matrix = record.matrix * (record.matrix + 1) // 2
        least = len(record.ids) + len(record.values)
        valid = [least + n_matrix] + ([least] if record.optional else [])
        if len(words) not in valid:
            matrix = f", the upper triangle of a matrix ({n_matrix})" if n_matrix else ""
            what = ", ".join((*record.ids, *record.values))
            need = " or ".join(map(str, valid))
            self.source.wrong(
                line, f"{word} has {len(words)} fields; valid: {need}: {what}{matrix}"
            )
            return None
        ids = [
            self.source.field(line, w, f"number of the {what}").integer()
            for what, w in zip(record.ids, words, strict=False)
        ]
        names = [
            f"{LANDMARK if what == 'landmark' else ''}{n}"
            for what, n in zip(record.ids, ids, strict=True)
        ]
        titles = (*record.values, *["element of the matrix"] * n_matrix)
        values = np.array(
            [
                self._number(line, w, what)
                for what, w in zip(titles, words[len(ids) :], strict=False)
            ]
        )
        if is_unread(*ids, *values.tolist()):
            return None
        n = len(record.values)
        covariance = None
        if record.matrix:
            covariance = self._covariance(line, word, record.matrix, values[n:])
            if covariance is None:
                return None
        return names, values[:n], covariance

    def _number(self, line: int, word: str, what: str) -> float:
        """Return a number; only what is wrong with it needs its place and its title."""
        with suppress(ValueError):
            found = parse_quantity(word)
            if abs(found) <= MAX_NUMBER:
                return found
        return self.source.field(line, word, what).number()

    def _covariance(self, line: int, word: str, size: int, numbers: Array) -> Array | None:
        """Return the covariance of the error of an edge; None after a problem."""
        if not len(numbers):
            shift, turn = self.sigmas
            n_turns = 1 if size == 3 else 3
            return np.diag([shift**2] * (size - n_turns) + [turn**2] * n_turns)
        matrix = _symmetric(numbers, size, word == "EDGE2" and self.toro)
        if self.matrices == "square root":
            matrix = np.triu(matrix).T @ np.triu(matrix)
        with np.errstate(all="ignore"):
            least, largest = np.linalg.eigvalsh(matrix)[[0, -1]]
        if not least > np.finfo(float).eps * size * largest:
            what = self.matrices or "information"
            self.source.wrong(line, f"the {what} matrix of {word} is not positive definite")
            return None
        found = matrix if self.matrices == "covariance" else np.linalg.inv(matrix)
        return np.asarray(0.5 * (found + found.T))

    def _pose_of(self, line: int, record: PoseGraphRecord, values: Array) -> BodyPose | None:
        """Return the pose of values; None after a problem."""
        if record.values == _PLANE:
            return in_plan(*values.tolist())
        if record.values == _EULER:
            axes = np.eye(3)
            roll, pitch, yaw = (exp_rotation(a * axes[i]) for i, a in enumerate(values[3:]))
            return BodyPose(yaw @ pitch @ roll, values[:3])
        length = float(np.linalg.norm(values[3:]))
        if not abs(length - 1.0) <= MAX_QUATERNION_ERROR:
            self.source.wrong(line, f"the quaternion has the length {length:.6g}; valid: 1")
            return None
        return BodyPose(rotation_of_quaternion(values[[6, 3, 4, 5]] / length), values[:3])

    # -- records --------------------------------------------------------------------------------

    def _is_first(self, line: int, what: str, name: str) -> bool:
        """Return whether a vertex has no line yet; a second one is a problem."""
        first = self.lines_of.setdefault((what, name), line)
        if first != line:
            self.source.wrong(line, f"{what} {name} has a line already: {self.source.place(first)}")
        return first == line

    def _pose(self, line: int, record: PoseGraphRecord, ids: list[str], v: Array, _: Any) -> None:
        pose = self._pose_of(line, record, v)
        if pose is not None and self._is_first(line, "pose", ids[0]):
            self.graph.poses[ids[0]] = pose

    def _landmark(
        self, line: int, record: PoseGraphRecord, ids: list[str], v: Array, _: Any
    ) -> None:
        if self._is_first(line, "landmark", ids[0]):
            self.graph.landmarks[ids[0]] = np.array([*v, 0.0][:3])

    def _offset(self, line: int, record: PoseGraphRecord, ids: list[str], v: Array, _: Any) -> None:
        pose = self._pose_of(line, record, v)
        if pose is not None and self._is_first(line, "parameter", ids[0]):
            self.offsets[ids[0]] = pose

    def _edge(self, line: int, record: PoseGraphRecord, ids: list[str], v: Array, c: Array) -> None:
        pose = self._pose_of(line, record, v)
        if ids[0] == ids[1]:
            self.source.wrong(line, f"joins pose {ids[0]} with itself")
        elif pose is not None:
            self._add_edge(line, record, ids[0], ids[1], pose, c)

    def _add_edge(
        self, line: int, record: PoseGraphRecord, a: str, b: str, pose: BodyPose, c: Array
    ) -> None:
        """Add an edge with its covariance in the axes of the residuals here."""
        n = 2 if record.planar else 3
        by_error = np.eye(len(c))
        by_error[:n, :n] = pose.rotation[:n, :n]
        if record.planar:
            by_error[2, 2] = -1.0
        elif record.values == _QUATERNION:
            self.of_quaternions = True
            by_error[3:, 3:] *= 2.0 if self.rotations == "quaternion" else 1.0
        there = by_error @ c @ by_error.T
        place = self.source.place(line)
        self.graph.edges.append(PoseEdge(a, b, pose, 0.5 * (there + there.T), place))

    def _sight(
        self, line: int, record: PoseGraphRecord, ids: list[str], v: Array, c: Array
    ) -> None:
        offset = self._parameter(line, ids[2]) if len(ids) > 2 else STANDING
        if offset is None:
            return
        n = len(c)
        r = offset.rotation[:n, :n]
        vector = offset.place + offset.rotation @ np.array([*v, 0.0][:3])
        there = r @ c @ r.T
        self.graph.sights.append(
            LandmarkSight(ids[0], ids[1], vector, 0.5 * (there + there.T), self.source.place(line))
        )

    def _prior(
        self, line: int, record: PoseGraphRecord, ids: list[str], v: Array, c: Array
    ) -> None:
        offset = self._parameter(line, ids[1]) if len(ids) > 1 else STANDING
        pose = self._pose_of(line, record, v)
        if offset is None or pose is None:
            return
        if not (np.allclose(offset.rotation, np.eye(3)) and not offset.place.any()):
            what = "a prior of a sensor with an offset is not read; valid: an offset of zero"
            self.source.wrong(line, what)
            return
        self.graph.poses.setdefault(WORLD, STANDING)
        self.graph.held[WORLD] = self.source.place(line)
        self._add_edge(line, record, WORLD, ids[0], pose, c)

    def _parameter(self, line: int, name: str) -> BodyPose | None:
        found = self.offsets.get(name)
        if found is None:
            self.source.wrong(line, f"there is no parameter {name}: PARAMS_SE3OFFSET states it")
        return found

    # -- datum ------------------------------------------------------------------------------------

    def hold(self, fixed: tuple[str, ...]) -> None:
        """Note what is held: by FIX, by the option, or the pose with the smallest number."""
        graph = self.graph
        used = {n for e in graph.edges for n in (e.first, e.second)}
        poses = {*graph.poses, *used, *(s.body for s in graph.sights)}
        landmarks = {*graph.landmarks, *(s.landmark for s in graph.sights)}
        for line, word in self.held:
            name = str(self.source.field(line, word, "number of a vertex").integer())
            if name != "None" and name not in poses and LANDMARK + name in landmarks:
                name = LANDMARK + name
            if name in poses or name in landmarks:
                graph.held[name] = self.source.place(line)
            elif name != "None":
                self.source.wrong(line, f"there is no vertex {name}")
        for name in fixed:
            if name not in poses and name not in landmarks:
                self.source.wrong(1, f"fixed names {name!r}, which the file does not have")
            graph.held[name] = ""
        if not graph.held and poses:
            graph.held[min(poses, key=int)] = ""


def _symmetric(numbers: Array, size: int, toro: bool) -> Array:
    """Return the symmetric matrix of the upper triangle of its rows."""
    matrix = np.zeros((size, size))
    pairs = list(combinations_with_replacement(range(size), 2))
    for k, number in enumerate(numbers.tolist()):
        i, j = pairs[TORO_ORDER[k] if toro else k]
        matrix[i, j] = matrix[j, i] = number
    return matrix


READER = Reader(
    "g2o",
    (".g2o", ".graph"),
    "pose graph of g2o, TORO or iSAM",
    NetworkReader(read_g2o),
    recognises=is_pose_graph,
)
