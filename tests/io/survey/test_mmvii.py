"""Survey measurements of MMVII: published results, fixed stations, refusals, damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import CoordinateDifference, Direction, SlopeDistance
from factorgraph_adj.units import GON
from tests.hostile.readers import judge
from tests.networks.survey_files import MMVII
from tests.support.places import data_dir

POINTS, OBSERVATIONS = MMVII["coords.txt"], MMVII["meas.obs"]


def write(folder: Path, observations: str = OBSERVATIONS, points: str = POINTS) -> Path:
    (folder / "coords.txt").write_text(points, encoding="utf-8")
    path = folder / "meas.obs"
    path.write_text(observations, encoding="utf-8")
    return path


def test_topo_mini_is_read_with_its_published_result():
    """MMVII-UseCaseDataSet, TopoMini: "final 1.7"; an independent program gives 1.764."""
    folder = data_dir("mmvii_topo") / "TopoMini" / "inputs"
    network = fga.read(folder / "meas.obs", format="mmvii")
    solution = fga.adjust(network)
    assert (solution.n_observations, solution.n_unknowns, solution.redundancy) == (18, 14, 4)
    assert solution.sigma0 == pytest.approx(1.764, abs=5e-4)
    assert network.observations["3"].source == "meas.obs:1"


def test_stations_begin_sets_and_fixed_ones_have_known_orientations(tmp_path):
    network = fga.read(write(tmp_path))  # #NEW and #FIX tell the format
    directions = [o for o in network.observations.values() if isinstance(o, Direction)]
    assert [(o.station, o.set) for o in directions] == [
        ("A", "1"), ("A", "1"), ("A", "2"), ("A", "2"), ("B", "1"),
    ]  # fmt: skip
    assert directions[1].value == 34.4042 * GON
    held = network.parameters["orientation"][("B", "1")]
    assert (held.values, held.fixed) == ((0.0,), (True,))
    kinds = [o for o in network.observations.values() if isinstance(o, CoordinateDifference)]
    assert [o.axes for o in kinds] == ["x", "y", "z"]
    lengths = [o for o in network.observations.values() if isinstance(o, SlopeDistance)]
    assert len(lengths) == 1  # σ < 0 switches the other off
    solution = fga.adjust(network)
    assert solution.sigma0 < 1.5
    assert np.allclose(solution.point("C"), (130, 150, 11), atol=0.005)
    again = fga.adjust(fga.read_mmvii(write(tmp_path), approximate=False))
    assert np.allclose(again.point("C"), solution.point("C"), atol=1e-6)


def test_a_tangent_frame_has_curvature_and_refraction(tmp_path):
    network = fga.read_mmvii(write(tmp_path), latitude=48.8, longitude=2.3, sigma_mm=0.5)
    assert isinstance(network.frame, fga.TopocentricFrame)
    assert network.refractions[""].values == (0.12,)
    with pytest.raises(InputError, match="from -90 to 90"):
        fga.read_mmvii(write(tmp_path), latitude=95)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("9 A B 1 0.1", "unknown code '9'"),
        ("3 A B 1", "code, station, target, value, σ"),
        ("3 A X 1 0.1", "unknown point 'X'"),
        ("#TILT", "valid: #FIX, #VERT, #BASC, #NEW"),
        ("#BASC", "stations without a vertical"),
        ("14 A B 1 0.1", "needs #FIX before it"),
        ("3 A B 1,5 0.1", "value: '1,5' is not a number; write a decimal point"),
    ],
)
def test_what_is_not_understood_is_refused_with_its_line(tmp_path, line, said):
    with pytest.raises(InputError) as caught:
        fga.read_mmvii(write(tmp_path, f"* comment\n{line}\n"))
    assert str(caught.value).startswith("meas.obs:2")
    assert said in str(caught.value)


def test_points_are_found_beside_the_observations_or_named(tmp_path):
    path = write(tmp_path)
    (tmp_path / "coords.txt").rename(tmp_path / "meas.cor")
    assert "C" in fga.read_mmvii(path).points
    (tmp_path / "meas.cor").rename(tmp_path / "other.txt")
    with pytest.raises(InputError, match="points="):
        fga.read_mmvii(path)
    assert "C" in fga.read_mmvii(path, points=tmp_path / "other.txt").points
    with pytest.raises(InputError, match=r"coords\.txt:1: a point has"):
        fga.read_mmvii(write(tmp_path, points="A 1 2 3\n"))


def test_damaged_files_are_refused_or_read(tmp_path):
    files = {"meas.obs": OBSERVATIONS.encode(), "coords.txt": POINTS.encode()}
    judge(fga.read_mmvii, files, "meas.obs", tmp_path, seed=6)
