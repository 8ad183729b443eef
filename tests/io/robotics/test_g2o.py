"""Pose graphs: χ² and poses by g2o's own error, GTSAM's optimum, files that are wrong."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.robotics.g2o import is_pose_graph, read_g2o
from factorgraph_adj.rotation import TURN_ABOUT_X
from tests.hostile.examples import Example

UNIT = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 400 0 0 400 0 400"
FULL = "50 3 1 2 0 4 40 2 1 5 0 60 0 3 2 900 20 10 800 30 700"
SPACE = f"""\
# a body that goes around a mast
PARAMS_SE3OFFSET 3 0.1 -0.2 0.3 0 0 0.6 0.8
VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 2.1 0.1 0 0 0 0.28 0.96
VERTEX_SE3:QUAT 2 3.1 1.8 0.2 0.02 0 0.7 0.714
VERTEX_TRACKXYZ 7 2.2 3.1 1.4
FIX 0
EDGE_SE3:QUAT 0 1 2.0 0.05 0.02 0.01 0.02 0.28 0.9596 {FULL}
EDGE_SE3:QUAT 1 2 1.75 0.9 0.18 0.03 -0.01 0.46 0.8873 {FULL}
EDGE_SE3:QUAT 2 0 -1.85 3.05 -0.2 0.01 0.02 -0.69 0.724 {UNIT}
EDGE_SE3_TRACKXYZ 0 7 3 3.75 -1.1 1.12 90 5 2 80 1 70
EDGE_SE3_TRACKXYZ 1 7 3 3.0 -0.75 1.1 90 5 2 80 1 70
EDGE_SE3_PRIOR 2 4 3.1 1.75 0.2 0.02 0 0.69 0.724 {UNIT}
PARAMS_SE3OFFSET 4 0 0 0 0 0 0 1
"""
PLAN = """\
VERTEX_SE2 0 1.0 2.0 0.3
VERTEX_SE2 1 2.9 2.6 0.9
VERTEX_XY 5 2.1 4.4
EDGE_SE2 0 1 2.05 0.1 0.55 50 4 3 60 2 900
EDGE_SE2 1 2 1.95 -0.1 0.65 50 4 3 60 2 900
EDGE_SE2 2 0 -2.1 3.1 -1.27 50 4 3 60 2 900
EDGE_SE2_XY 0 5 1.8 1.95 30 2 40
EDGE_SE2_XY 2 5 0.3 2.05 30 2 40
EDGE_PRIOR_SE2 0 1.02 1.98 0.31 50 4 3 60 2 900
EDGE_PRIOR_SE2 2 4.1 4.05 1.55 50 4 3 60 2 900
"""
TORO = f"""\
VERTEX3 0 0 0 0 0 0 0
VERTEX3 1 1 0 0 0 0 0.5
EDGE3 0 1 1.1 0.02 0.01 0.01 0.02 0.52 {FULL}
EDGE3 1 2 1.0 0.05 0.02 0.02 0.01 0.49
EDGE3 0 2 1.9 0.6 0.05 0.03 0.05 1.02 {UNIT}
EQUIV 2 1
"""
ISAM = """\
ODOMETRY 0 1 1.1 0.02 0.3 0.01 0.001 0 0.02 0 0.0004
ODOMETRY 1 2 0.9 -0.02 0.3 0.01 0.001 0 0.02 0 0.0004
LANDMARK 0 0 2.0 1.0 0.1 0.01 0.2
LANDMARK 2 0 0.6 -0.1 0.1 0.01 0.2
"""
COMMENT = (r"\|#|\|a\||\|body\||\|that\||\|goes\||\|around\||\|mast\|",)
EXAMPLE_FILES = {
    "g2o in space": Example("g2o", {"a.g2o": SPACE}, "a.g2o", unread=COMMENT),
    "g2o in plan": Example("g2o", {"a.g2o": PLAN}, "a.g2o"),
    "toro": Example(
        "g2o", {"a.graph": TORO}, "a.graph", unread=(r"\|EQUIV",), left_out=(r"EQUIV",)
    ),
    "isam": Example("g2o", {"a.txt": ISAM}, "a.txt", {"matrices": "covariance"}),
}


def write(tmp_path: Path, text: str, name: str = "a.g2o") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def rows(text: str, word: str) -> list[np.ndarray]:
    """Return the numbers of the lines of a word."""
    return [
        np.array(line.split()[1:], dtype=float)
        for line in text.splitlines()
        if line.split()[:1] == [word]
    ]


def symmetric(numbers: np.ndarray, n: int) -> np.ndarray:
    m = np.zeros((n, n))
    m[np.triu_indices(n)] = numbers
    return m + np.triu(m, 1).T


def errors_in_plan(text: str, x: np.ndarray) -> np.ndarray:
    """Return g2o's errors of SE2 edges, whitened: poses 0, 1, 2 and landmark 5 in x."""
    pose = {-1: np.zeros(3)} | {i: x[3 * i : 3 * i + 3] for i in range(3)}

    def turn(angle: float) -> np.ndarray:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    out = []
    edges = rows(text, "EDGE_SE2")
    edges += [np.r_[-1, row] for row in rows(text, "EDGE_PRIOR_SE2")]
    for row in edges:
        a, b, z = pose[int(row[0])], pose[int(row[1])], row[2:5]
        d = turn(a[2]).T @ (b[:2] - a[:2])
        e = np.r_[turn(z[2]).T @ (d - z[:2]), b[2] - a[2] - z[2]]
        out.append(np.linalg.cholesky(symmetric(row[5:], 3)).T @ e)
    for row in rows(text, "EDGE_SE2_XY"):
        a = pose[int(row[0])]
        e = turn(a[2]).T @ (x[9:11] - a[:2]) - row[2:4]
        out.append(np.linalg.cholesky(symmetric(row[4:], 2)).T @ e)
    return np.concatenate(out)


def test_a_graph_in_plan_is_adjusted_as_the_error_of_g2o_says(tmp_path: Path) -> None:
    """The same least squares by another program, in the error of EdgeSE2::computeError."""
    start = np.array([1.0, 2.0, 0.3, 2.9, 2.6, 0.9, 4.1, 4.1, 1.6, 2.1, 4.4])
    best = least_squares(lambda x: errors_in_plan(PLAN, x), start, xtol=1e-15, gtol=1e-15)
    network = fga.read(write(tmp_path, PLAN))
    solution = fga.adjust(network)
    assert solution.redundancy == 19 - 11
    assert solution.vtpv == pytest.approx(2.0 * best.cost, rel=1e-9)
    assert solution.point("2")[:2] == pytest.approx(best.x[6:8], abs=1e-6)
    assert solution.point("L5")[:2] == pytest.approx(best.x[9:], abs=1e-6)
    azimuth = solution.unknown("heading", "2")["azimuth"]
    assert np.cos(np.pi / 2 - azimuth - best.x[8]) == pytest.approx(1.0, abs=1e-12)
    covariance = np.linalg.inv(best.jac.T @ best.jac)[6:8, 6:8]
    found = solution.variable_covariance(("point", "2"))[:2, :2]
    np.testing.assert_allclose(found, covariance, rtol=1e-5)


def errors_in_space(text: str, x: np.ndarray, half: bool) -> np.ndarray:
    """Return g2o's errors of SE3 edges, whitened: poses 1, 2 (place, rotation vector), landmark."""
    pose = {-1: (np.zeros(3), Rotation.identity()), 0: (np.zeros(3), Rotation.identity())}
    for i in (1, 2):
        part = x[6 * i - 6 : 6 * i]
        pose[i] = part[:3], Rotation.from_rotvec(part[3:])
    out = []
    edges = rows(text, "EDGE_SE3:QUAT")
    edges += [np.r_[-1, row[:1], row[2:]] for row in rows(text, "EDGE_SE3_PRIOR")]
    for row in edges:
        (ta, ra), (tb, rb) = pose[int(row[0])], pose[int(row[1])]
        z = Rotation.from_quat(row[5:9])
        e_t = z.inv().apply(ra.inv().apply(tb - ta) - row[2:5])
        delta = z.inv() * ra.inv() * rb
        q = delta.as_quat(canonical=True)[:3]
        e = np.r_[e_t, q if half else delta.as_rotvec()]
        out.append(np.linalg.cholesky(symmetric(row[9:], 6)).T @ e)
    offset = rows(text, "PARAMS_SE3OFFSET")[0]
    for row in rows(text, "EDGE_SE3_TRACKXYZ"):
        t, r = pose[int(row[0])]
        seen = r.inv().apply(x[12:15] - t) - offset[1:4]
        e = Rotation.from_quat(offset[4:]).inv().apply(seen) - row[3:6]
        out.append(np.linalg.cholesky(symmetric(row[6:], 3)).T @ e)
    return np.concatenate(out)


@pytest.mark.parametrize("half", [True, False])
def test_a_graph_in_space_is_adjusted_as_the_error_of_g2o_says(tmp_path: Path, half: bool) -> None:
    """EdgeSE3::computeError has half angles; rotation vectors are those of other programs.

    A quaternion's vector part is |v|/2 (1 − |v|²/24): with residuals of up to 0.1 rad vᵀPv is up
    to 10⁻³ of the part of rotations too large, and poses move by 10⁻³ of their residuals.
    """
    start = np.array([2.1, 0.1, 0, 0, 0, 0.57, 3.1, 1.8, 0.2, 0, 0, 1.55, 2.2, 3.1, 1.4])
    best = least_squares(lambda x: errors_in_space(SPACE, x, half), start, xtol=1e-15, gtol=1e-15)
    network = fga.read(write(tmp_path, SPACE), rotations="quaternion" if half else "vector")
    solution = fga.adjust(network)
    assert solution.redundancy == 4 * 6 + 2 * 3 - 15
    assert solution.vtpv == pytest.approx(2.0 * best.cost, rel=1e-3 if half else 1e-9)
    tolerance = 1e-4 if half else 1e-5
    assert solution.point("L7") == pytest.approx(best.x[12:], abs=tolerance)
    pose = solution.pose("2")
    assert pose.position == pytest.approx(best.x[6:9], abs=tolerance)
    turned = Rotation.from_matrix(pose.rotation @ TURN_ABOUT_X).as_rotvec()
    assert turned == pytest.approx(best.x[9:12], abs=tolerance)


def test_half_angles_have_a_quarter_of_the_weight_of_rotation_vectors(tmp_path: Path) -> None:
    by = [read_g2o(write(tmp_path, SPACE), rotations=r).clusters for r in ("quaternion", "vector")]
    assert len(by[0]) == len(by[1]) == 4  # three edges and a prior
    for (_, a), (_, b) in zip(by[0], by[1], strict=True):
        s = np.diag([1.0, 1, 1, 2, 2, 2])
        np.testing.assert_allclose(a, s @ b @ s, rtol=1e-12)


GTSAM_FILES = [
    ("Klaus3.g2o", True, 1e-5),
    ("known_landmark_localization_3.g2o", True, 1e-3),
    ("known_landmark_localization_20.g2o", True, 1e-3),
    ("w100_30.g2o", False, 1e-4),
]
"""Name, whether it is in space, and the share of vᵀPv by which the error of GTSAM differs: that of
a logarithm of SE(3) or SE(2), whose shift is turned by half the rotation's residual."""


@pytest.mark.parametrize(("name", "in_space", "share"), GTSAM_FILES)
def test_the_optimum_of_gtsam_is_found(name: str, in_space: bool, share: float) -> None:
    path = gtsam.findExampleDataFile(name)
    graph, start = gtsam.readG2o(path, in_space)
    if in_space:
        first = gtsam.PriorFactorPose3(0, start.atPose3(0), gtsam.noiseModel.Constrained.All(6))
    else:
        first = gtsam.PriorFactorPose2(0, start.atPose2(0), gtsam.noiseModel.Constrained.All(3))
    graph.add(first)
    best = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    network = fga.read(path, rotations="vector")
    solution = fga.adjust(network)
    assert solution.vtpv == pytest.approx(2.0 * graph.error(best), rel=share)
    for key in (k for k in start.keys() if k < 1000):  # noqa: SIM118 - no dict
        if in_space:
            theirs, ours = best.atPose3(key).translation(), solution.pose(str(key)).position
        else:
            pose = best.atPose2(key)
            theirs, ours = np.array([pose.x(), pose.y(), 0.0]), solution.point(str(key))
        assert ours == pytest.approx(theirs, abs=0.01)


def test_all_files_of_gtsam_are_read() -> None:
    """Counts of lines; the reduced sets of iSAM have square roots: 1.5811² = 1 / 0.4."""
    roots = {"matrices": "square root"}
    for name, options, counts in (
        ("toyExample.g2o", {}, (5, 0, 12)),
        ("example_with_vertices.g2o", {}, (8, 8, 0)),
        ("edge_se3_trackxyz_example.g2o", {}, (1, 1, 1)),
        ("edge_se3_trackxyz_missing_vertex.g2o", {}, (1, 1, 1)),
        ("edge_se3_trackxyz_nonidentity_offset.g2o", {}, (1, 1, 1)),
        ("w100.graph", {}, (0, 100, 600)),
        ("cityTrees_reduced_1k.g2o", roots, (0, 1000 + 66, 999 * 2 + 406)),
        ("victoriaPark_reduced_1k.g2o", roots, (0, 1000 + 48, 999 * 2 + 606)),
    ):
        network = fga.read(gtsam.findExampleDataFile(name), **options)
        found = (len(network.photos), len(network.points), len(network.observations))
        assert found == counts, name
    sight = network.observations[list(network.observations)[-1]]
    np.testing.assert_allclose(sight.covariance, 0.4 * np.eye(2), rtol=1e-6)


def test_vertices_that_are_missing_lie_along_the_edges(tmp_path: Path) -> None:
    network = fga.read(write(tmp_path, PLAN))
    assert network.points["2"].coordinates == pytest.approx((4.10, 4.05, 0.0), abs=0.2)
    assert "1 of them, first '2'" in network.remarks[0]


def test_toro_has_an_order_of_its_own_and_its_reader_takes_the_unit_for_no_matrix(
    tmp_path: Path,
) -> None:
    own = "EDGE2 0 1 1 0 0 4 1 9 16 2 3\n"  # xx xy yy θθ xθ yθ
    network = fga.read(write(tmp_path, own, "a.graph"))
    ((_, covariance),) = network.clusters
    turn = np.diag([1.0, 1.0, -1.0])
    information = np.array([[4, 1, 2], [1, 9, 3], [2, 3, 16.0]])
    np.testing.assert_allclose(np.linalg.inv(turn @ covariance @ turn), information, rtol=1e-12)
    network = fga.read(write(tmp_path, TORO, "b.graph"), sigmas=(0.5, 0.1))
    alone = [o for o in network.observations.values() if o.photo2 == "2" and o.photo == "1"]
    assert [np.ravel(o.sigma)[0].round(9) for o in alone] == [0.5, 0.1]
    assert str(network.left_out[0]).startswith("equivalences: 1 left out")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.28 0.9596", "0.28 0.8", r"a\.g2o:8: the quaternion has the length 0\.847.*; valid: 1"),
        ("EDGE_SE3:QUAT 1 2", "EDGE_SE3:QUAT 1 1", r"a\.g2o:9: joins pose 1 with itself"),
        ("1.75 0.9 0.18", "1.75 0.9", r"a\.g2o:9: EDGE_SE3:QUAT has 29 fields; valid: 30: pose"),
        ("90 5 2 80 1 70\nEDGE_SE3_P", "90 5 2 80 1 -70\nEDGE_SE3_P", "not positive definite"),
        ("0 7 3 3.75", "0 7 9 3.75", r"a\.g2o:11: there is no parameter 9: PARAMS_SE3OFFSET"),
        ("FIX 0", "FIX 12", r"a\.g2o:7: there is no vertex 12"),
        ("VERTEX_TRACKXYZ 7", "VERTEX_XY 7", r"a\.g2o:6: VERTEX_XY has 4 fields; valid: 3"),
        ("PRIOR 2 4", "PRIOR 2 3", r"a prior of a sensor with an offset is not read"),
        ("FIX 0", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1", r"a\.g2o:7: is in plan, but a\.g2o:3 is in"),
        ("VERTEX_SE3:QUAT 2", "VERTEX_SE3:QUAT 1", r"a\.g2o:5: pose 1 has a line already"),
        ("EDGE_SE3_PRIOR", "EDGE_GPS", r"a\.g2o:13: record 'EDGE_GPS' is unknown"),
    ],
)
def test_files_that_are_wrong(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert SPACE.count(old) == 1
    with pytest.raises(InputError, match=message):
        fga.read(write(tmp_path, SPACE.replace(old, new)))


def test_words_of_isam_need_what_their_matrices_are(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.g2o:1: ODOMETRY is a word of iSAM.*square root"):
        fga.read(write(tmp_path, ISAM))
    network = fga.read(write(tmp_path, ISAM), matrices="covariance")
    assert set(network.points) == {"0", "1", "2", "L0"}


def test_a_graph_without_a_link_is_refused(tmp_path: Path) -> None:
    text = "VERTEX_SE2 0 0 0 0\nEDGE_SE2 3 4 1 0 0 1 0 0 1 0 1\n"
    with pytest.raises(InputError, match="vertex '3' has no place, and no edge joins it"):
        fga.read(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "yes"),
    [
        (SPACE, True),
        (PLAN, True),
        (TORO, True),
        (ISAM, True),
        ("FIX 3\nVERTEX_SE2 0 0 0 0\n", True),
        ("VERTEX_SE2 of a drawing\n", False),
        ("LANDMARK 4 is a tower\n", False),
        ("1 2 3 4\n", False),
    ],
)
def test_the_first_line_tells_a_pose_graph(tmp_path: Path, text: str, yes: bool) -> None:
    assert is_pose_graph(write(tmp_path, text, "a.dat")) is yes


@pytest.mark.parametrize(
    "options",
    [{"rotations": "euler"}, {"matrices": "roots"}, {"sigmas": (1.0, 0.0)}, {"fixed": ("44",)}],
)
def test_options_that_are_wrong(tmp_path: Path, options: dict) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        read_g2o(write(tmp_path, SPACE), **options)


def test_the_choice_of_options_is_told(tmp_path: Path) -> None:
    """In the report where it matters, and for the command and for Python in messages."""
    half = fga.read(write(tmp_path, SPACE)).remarks
    assert half == [
        "rotations of the matrices are half angles, as g2o writes them; rotations=vector "
        "(--set rotations=vector) takes them for rotation vectors, as GTSAM does"
    ]
    vector = fga.read(write(tmp_path, SPACE), rotations="vector").remarks
    assert vector == ["rotations of the matrices are rotation vectors, as rotations=vector states"]
    assert not any("matrices" in r for r in fga.read(write(tmp_path, PLAN)).remarks)
    with pytest.raises(InputError) as error:
        fga.read(write(tmp_path, ISAM))
    for choice in ("matrices=covariance (--set matrices=covariance)", "--set 'matrices=square"):
        assert choice in str(error.value)
