"""Image points with one joint covariance: adjustment, reliability, streams, files, copies."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io.json_records import observation_fields, observation_of
from factorgraph_adj.parts.part_files import RunFolder
from factorgraph_adj.parts.whole_network import cut_network
from factorgraph_adj.simulation.measurement import disturb, measure
from tests.networks.small_block import plan
from tests.support.arrivals import batch, difference
from tests.support.dense import (
    assert_adjustment_of_full_matrices,
    assert_reliability_of_full_matrices,
)
from tests.support.joint_images import jointly_measured
from tests.support.same import assert_same_network


@pytest.fixture(scope="module")
def network() -> fga.Network:
    """The small block; the image points of each of its first two photos err together."""
    network = jointly_measured(plan(), ["F1", "F2"])
    return disturb(measure(network, seed=2), seed=3, points=0.02, centres=0.02)


@pytest.fixture(scope="module")
def solution(network: fga.Network) -> fga.Solution:
    """The adjusted block."""
    return fga.adjust(network)


def test_the_weights_are_the_inverse_of_the_covariance(network: fga.Network) -> None:
    equations = compile_network(network)
    assert len(equations.clusters) == 2
    for cluster, group in zip(equations.clusters, network.images.joint, strict=True):
        w = cluster.whitener
        np.testing.assert_allclose(w.T @ w @ group.covariance, np.eye(len(w)), rtol=0, atol=1e-9)
        ids = [f"{o.photo}/{o.point}" for o in network.image_points(group.rows)]
        assert [equations.id(row) for row in cluster.rows[::2].tolist()] == ids


def test_the_adjustment_is_that_of_full_matrices(solution: fga.Solution) -> None:
    assert_adjustment_of_full_matrices(solution)


def test_reliability_is_that_of_full_matrices(solution: fga.Solution) -> None:
    assert_reliability_of_full_matrices(solution)


def test_a_joint_covariance_of_independent_points_changes_nothing() -> None:
    plain = disturb(measure(plan(), seed=2), seed=3, points=0.02, centres=0.02)
    joint = jointly_measured(plain, ["F1", "F3"], signal=0.0)
    a, b = fga.adjust(plain), fga.adjust(joint)
    assert a.variance_factor == pytest.approx(b.variance_factor, rel=1e-9)
    for name in plain.points:
        np.testing.assert_allclose(a.point(name), b.point(name), atol=1e-8)


def test_a_blunder_in_one_point_is_named(network: fga.Network) -> None:
    wrong = network.copy()
    xy = wrong.images.columns()[2].copy()
    row = int(network.images.joint[0].rows[5])
    xy[row, 0] += 0.08
    wrong.images = wrong.images.with_columns(xy=xy)
    (o,) = wrong.image_points(np.array([row]))
    found = fga.reliability(fga.adjust(wrong))
    worst = int(np.nanargmax(np.abs(found.w)))
    assert found.solution.equations.id(worst) == f"{o.photo}/{o.point}"
    assert [r.id for r in fga.snoop(wrong).rejected] == [f"{o.photo}/{o.point}"]


def test_files_and_records_keep_the_covariance(network: fga.Network, tmp_path: Path) -> None:
    for y_down in (False, True):
        given = network.copy()
        given.cameras["D3"] = replace(given.cameras["D3"], y_down_in_files=y_down)
        given.images.ids[int(given.images.joint[1].rows[0])] = "first"
        fga.write_project(given, tmp_path / f"{y_down}")
        assert_same_network(fga.read(tmp_path / f"{y_down}" / "project.toml"), given)
    for group in network.image_groups():
        again = observation_of(observation_fields(group, id=None))
        assert isinstance(again, fga.Correlated)
        assert again.observations == group.observations
        assert np.array_equal(again.covariance, group.covariance)


@pytest.mark.parametrize("y_down", [False, True])
def test_groups_behind_water_have_the_signs_of_files(y_down: bool, tmp_path: Path) -> None:
    network = plan()
    network.cameras["D3"] = replace(network.cameras["D3"], y_down_in_files=y_down)
    network.set_refractive_index("water", 1.34, sigma=1e-3)
    network.set_level("river", -3.0, fixed=True)
    both = [
        fga.ImageThroughLevel(
            "F1", name, (1.0, 2.0), sigma=(0.01, 0.01), level="river", medium="water", id=name
        )
        for name in ("P1", "P2")
    ]
    rho = 0.6 * np.eye(4) + 0.4
    network.add(fga.Correlated(tuple(both), 1e-4 * rho))
    fga.write_project(network, tmp_path)
    with (tmp_path / "covariances.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    (crossing,) = [
        r for r in rows if r["id"] == r["id2"] == "P1" and r["component"] != r["component2"]
    ]
    assert float(crossing["covariance_image2"]) == pytest.approx(-4e-5 if y_down else 4e-5)
    assert_same_network(fga.read(tmp_path / "project.toml"), network)


def test_faults_of_the_table_of_covariances_are_named(network: fga.Network, tmp_path: Path) -> None:
    fga.write_project(network, tmp_path)
    file = tmp_path / "covariances.csv"
    whole = file.read_text().splitlines(keepends=True)
    name = whole[1].split(",")[1]
    for line, says in (
        (whole[1].replace(name, "F1/nowhere", 1), "unknown id 'F1/nowhere'"),
        (whole[1].replace(",x,", ",z,", 1), "unknown component 'z'"),
        (whole[1].rsplit(",", 1)[0] + ",-1.0\n", "positive variances"),
        (whole[1].rsplit(",", 1)[0] + ",\n", "covariance_image2"),
    ):
        file.write_text("".join([whole[0], line, *whole[2:]]))
        with pytest.raises(fga.InputError, match=r"covariances\.csv") as caught:
            fga.read(tmp_path / "project.toml")
        assert says in str(caught.value)
    file.write_text("".join(whole).replace("covariance_image2", "covariance_si"))
    with pytest.raises(fga.InputError, match="image points are stated as covariance_image2"):
        fga.read(tmp_path / "project.toml")


def test_copies_keep_the_covariance_of_those_that_stay(network: fga.Network) -> None:
    group = network.images.joint[0]
    gone = next(network.image_points(group.rows[3:4]))
    fewer = fga.without(network, [f"{gone.photo}/{gone.point}"])
    left = np.delete(np.arange(len(group.covariance)), [6, 7])
    found = fewer.images.joint[0]
    assert np.array_equal(found.covariance, group.covariance[np.ix_(left, left)])
    labels = [o.label() for o in network.image_points(group.rows)]
    del labels[3]
    assert [o.label() for o in fewer.image_points(found.rows)] == labels
    kept = network.copy()
    kept.image_mask(network.images.columns()[0] != network.photo_number["F1"])
    assert len(kept.images.joint[0].rows) == len(network.images.joint[1].rows)
    assert len(measure(network, seed=7).images.joint) == 2


@pytest.mark.parametrize("engine", ["fronts", "isam2"])
def test_late_groups_end_at_the_batch_result(
    network: fga.Network, tmp_path: Path, engine: Literal["fronts", "isam2"]
) -> None:
    first = network.copy()
    (late,) = [g for g in network.image_groups() if g.observations[0].photo == "F2"]
    keep = np.ones(network.n_image_points, dtype=bool)
    keep[network.images.joint[1].rows] = False
    first.image_mask(keep)
    live = fga.IncrementalAdjustment(first, engine=engine, journal=tmp_path / "journal")
    live.add([late])
    live.settle()
    assert difference(live.solution(), batch(live)).largest < 1e-6
    assert len(live.network().images.joint) == 2
    with pytest.raises(fga.InputError, match="measured in this photo already"):
        live.add([replace(late.observations[0], id="again")])
    expected = batch(live)
    shutil.copy(tmp_path / "journal", tmp_path / "copy")
    again = fga.IncrementalAdjustment.resume(tmp_path / "copy", engine=engine)
    assert difference(again.solution(), expected).largest < 1e-6


def test_the_factor_graph_has_one_factor_for_each_group(solution: fga.Solution) -> None:
    built = fga.build_graph(solution.network, state=solution.state)
    sizes = [built.graph.at(i).keys() for i in range(built.graph.size())]
    # Twelve points, a pose and a calibration.
    assert sum(len(keys) == 14 for keys in sizes) == 2
    assert 2.0 * built.graph.error(built.values) == pytest.approx(solution.vtpv, rel=1e-9)


def test_parts_keep_groups_together(network: fga.Network, tmp_path: Path) -> None:
    regions = {name: "left" if name < "F3" else "right" for name in network.photos}
    parts = cut_network(network, regions.get, RunFolder(tmp_path))
    cut, whole = fga.adjust_parts(parts, folder=tmp_path, tolerance=1e-10), fga.adjust(network)
    assert cut.sigma0 == pytest.approx(whole.sigma0, rel=1e-9)
    assert cut.n_observations == whole.n_observations


def test_image_points_are_correlated_with_image_points_only(network: fga.Network) -> None:
    o = next(network.image_points())
    with pytest.raises(fga.InputError, match="with image points only"):
        fga.Correlated((o, fga.SlopeDistance("S1", "S2", 5.0, sigma=0.01)), np.eye(3))
    with pytest.raises(fga.InputError, match="two groups"):
        network.copy().images.join(network.images.joint[0])
