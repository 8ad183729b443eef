"""Pose graphs and trajectories that are written: in plan and in space, and what is refused."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import HeadingDifference, PlanarVector, SlopeDistance

PLAN = """\
VERTEX_SE2 0 1.0 2.0 0.3
VERTEX_SE2 1 2.9 2.6 0.9
VERTEX_SE2 2 4.1 4.0 1.5
VERTEX_XY 5 2.1 4.4
EDGE_SE2 0 1 2.05 0.1 0.55 50 4 3 60 2 900
EDGE_SE2 1 2 1.95 -0.1 0.65 50 4 3 60 2 900
EDGE_SE2_XY 0 5 1.8 1.95 30 2 40
EDGE_SE2_XY 2 5 0.3 2.05 30 2 40
EDGE_PRIOR_SE2 0 1.02 1.98 0.31 50 0 0 60 0 900
"""
SPACE = """\
PARAMS_SE3OFFSET 3 0.1 -0.2 0.3 0 0 0.6 0.8
PARAMS_SE3OFFSET 4 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 2.1 0.1 0 0 0 0.28 0.96
VERTEX_TRACKXYZ 7 2.2 3.1 1.4
FIX 0
EDGE_SE3:QUAT 0 1 2 0.05 0.02 0.01 0.02 0.28 0.9596 5 1 0 0 0 0 6 0 0 1 0 7 0 0 0 90 2 0 80 1 70
EDGE_SE3_TRACKXYZ 0 7 3 3.75 -1.1 1.12 90 5 2 80 1 70
EDGE_SE3_PRIOR 1 4 2.1 0.1 0 0 0 0.28 0.96 5 0 0 0 0 0 6 0 0 0 0 7 0 0 0 90 0 0 80 0 70
"""


def read(folder: Path, text: str) -> fga.Network:
    """Return a pose graph of a text."""
    (folder / "given.g2o").write_text(text)
    return fga.read(folder / "given.g2o")


@pytest.mark.parametrize("text", [PLAN, SPACE], ids=["plan", "space"])
@pytest.mark.parametrize("rotations", ["quaternion", "vector"])
def test_what_is_written_has_the_same_values_and_covariances(
    tmp_path: Path, text: str, rotations: str
) -> None:
    given = read(tmp_path, text)
    fga.write(given, tmp_path / "b.g2o", rotations=rotations)
    found = fga.read(tmp_path / "b.g2o", rotations=rotations)
    assert list(found.points) == list(given.points) and list(found.photos) == list(given.photos)
    for one, two in zip(given.points.values(), found.points.values(), strict=True):
        assert two.coordinates == pytest.approx(one.coordinates, abs=1e-15)
        assert two.fixed == one.fixed
    for one, two in zip(given.photos.values(), found.photos.values(), strict=True):
        assert np.allclose(two.rotation, one.rotation, rtol=0, atol=1e-15)
        assert (two.position, two.fixed) == (one.position, one.fixed)
    for name, heading in given.of_kind("heading").items():
        assert found.of_kind("heading")[name].values == pytest.approx(heading.values, abs=1e-15)
    for a, b in zip(given.observations.values(), found.observations.values(), strict=True):
        assert type(a) is type(b)
        assert np.allclose(a.value, b.value, rtol=0, atol=1e-14)
    for (ids, a), (others, b) in zip(given.clusters, found.clusters, strict=True):
        assert ids == others
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-16)
    assert fga.adjust(found).vtpv == pytest.approx(fga.adjust(given).vtpv, rel=1e-9)


def test_gtsam_reads_the_optimum_that_is_written(tmp_path: Path) -> None:
    solution = fga.adjust(fga.read(gtsam.findExampleDataFile("Klaus3.g2o"), rotations="vector"))
    fga.write(solution, tmp_path / "best.g2o", rotations="vector")
    graph, values = gtsam.readG2o(str(tmp_path / "best.g2o"), True)
    assert 2.0 * graph.error(values) == pytest.approx(solution.vtpv, rel=1e-4)


@pytest.mark.parametrize("text", [PLAN + "FIX 1\nFIX 5\n", SPACE], ids=["plan", "space"])
def test_gtsam_reads_all_edges_between_poses(tmp_path: Path, text: str) -> None:
    """In plan it reads none behind a FIX; in space it reads the edges to landmarks as well."""
    fga.write(read(tmp_path, text), tmp_path / "b.g2o")
    words = [line.split()[0] for line in (tmp_path / "b.g2o").read_text().splitlines()]
    in_space = text is SPACE
    read_by_gtsam = ("EDGE_SE3:QUAT", "EDGE_SE3_TRACKXYZ") if in_space else ("EDGE_SE2",)
    assert words.count("FIX") == (1 if in_space else 2)
    graph, values = gtsam.readG2o(str(tmp_path / "b.g2o"), in_space)
    assert graph.size() == sum(words.count(word) for word in read_by_gtsam) == 2
    assert values.size() == sum(word.startswith("VERTEX") for word in words)


def test_what_g2o_has_not_is_refused_all_at_once(tmp_path: Path) -> None:
    network = read(tmp_path, PLAN)
    network.add_point("tower", (0.0, 0.0, 5.0))
    network.add(SlopeDistance("0", "tower", 5.0, sigma=0.01))
    network.add(PlanarVector("0", "2", (1.0, 2.0), sigma=(0.1, 0.1)))
    network.add(HeadingDifference("0", "2", 0.1, sigma=0.1))
    with pytest.raises(InputError) as error:
        fga.write(network, tmp_path / "b.g2o")
    for what in (
        "g2o cannot express other names than the letter L and a whole number",
        "g2o cannot express a slope distance",
        "g2o cannot express a planar vector alone: an edge is a correlated group",
        "g2o cannot express a height other than one held at 0 of a landmark in plan",
    ):
        assert what in str(error.value)
    assert not (tmp_path / "b.g2o").exists()


def test_a_trajectory_of_a_graph_in_plan_and_of_kitti(tmp_path: Path) -> None:
    network = read(tmp_path, PLAN)
    fga.write(network, tmp_path / "path.tum")
    first = (tmp_path / "path.tum").read_text().splitlines()[0].split()
    assert first[0] == "0"
    sine, cosine = np.sin(0.15), np.cos(0.15)
    assert np.array(first[1:], float) == pytest.approx([1.0, 2.0, 0, 0, 0, sine, cosine], abs=1e-15)
    space = read(tmp_path, SPACE)
    fga.write(space, tmp_path / "b.txt", format="trajectory", rows="KITTI")
    rows = np.loadtxt(tmp_path / "b.txt").reshape(-1, 3, 4)
    assert len(rows) == 2
    turned = Rotation.from_quat([0, 0, 0.28, 0.96]).as_matrix()  # that of the graph, as it is
    assert np.allclose(rows[1, :, :3], turned)


def test_names_that_are_no_times_are_refused(tmp_path: Path) -> None:
    network = fga.Network("strip")
    camera = fga.read(Path(gtsam.findExampleDataFile("Klaus3.g2o"))).cameras["body"]
    network.cameras["body"] = camera
    network.add_photo("IMG_1", "body", position=(0, 0, 1.0), rotation=np.eye(3))
    with pytest.raises(InputError, match="pose 'IMG_1': TUM cannot express a pose whose name"):
        fga.write(network, tmp_path / "path.tum")
