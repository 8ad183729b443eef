"""Results as columns: the same figures as one by one, and data frames."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.columns import Columns
from tests.networks.arriving import CASES


@pytest.fixture(scope="module", params=["combined block", "own cameras", "gnss", "levelling, free"])
def solution(request):
    return fga.adjust(CASES[request.param].make())


def test_points_are_those_of_the_solution(solution):
    table = solution.point_table()
    assert list(table["name"]) == list(solution.network.points)
    for i, name in enumerate(table["name"]):
        xyz = [table[a][i] for a in "xyz"]
        assert xyz == pytest.approx(solution.point(name), abs=0.0)
        sigma = [table[f"sigma_{a}"][i] for a in "xyz"]
        assert sigma == pytest.approx(solution.standard_deviations(name), rel=1e-6, abs=1e-12)
        held = tuple(bool(table[f"held_{a}"][i]) for a in "xyz")
        assert held == solution.network.points[name].fixed


def test_photos_are_those_of_the_solution(solution):
    table = solution.photo_table()
    assert len(table) == len(solution.network.photos)
    for i, name in enumerate(table["name"]):
        pose = solution.pose(name)
        assert [table[a][i] for a in "xyz"] == pytest.approx(pose.position)
        sigmas = [table[f"sigma_{a}"][i] for a in ("rx", "ry", "rz", "x", "y", "z")]
        assert sigmas == pytest.approx(pose.sigmas)


def test_other_unknowns_are_those_of_the_solution(solution):
    table = solution.unknown_table()
    for i in range(len(table)):
        found = solution.unknown(table["kind"][i], table["name"][i])
        at = list(found.names).index(table["component"][i])
        assert table["value"][i] == pytest.approx(found.values[at])
        assert table["sigma"][i] == pytest.approx(found.sigmas[at])


def test_figures_of_observations_are_those_of_the_reliability(solution):
    rel = fga.reliability(solution)
    table = rel.table()
    assert len(table) == len(solution.observations)
    assert np.array_equal(table["w"], rel.w, equal_nan=True)
    row = len(table) // 2
    record = solution.observations[row]
    assert (table["id"][row], table["component"][row]) == (record.id, record.component)
    assert table["residual"][row] == record.residual


def test_a_data_frame_has_the_same_columns(solution):
    pytest.importorskip("pandas")
    for table in (
        solution.point_table(),
        solution.unknown_table(),
        fga.reliability(solution).table(),
    ):
        frame = table.to_pandas()
        assert list(frame.columns) == list(table) and len(frame) == len(table)


def test_a_table_shows_itself():
    table = Columns("points", {"name": np.array(["A"]), "x": np.array([1.0])})
    assert repr(table) == "<1 points: name, x>"
    assert "<td>A</td>" in table._repr_html_()
    with pytest.raises(fga.InputError, match="unknown column 'y'; known: name, x"):
        table["y"]


def test_a_frame_of_polars_has_the_same_columns(solution):
    polars = pytest.importorskip("polars")
    for table in (
        solution.point_table(),
        solution.unknown_table(),
        fga.reliability(solution).table(),
    ):
        frame = table.to_polars()
        assert frame.columns == list(table) and len(frame) == len(table)
        for name in table:
            kept = frame[name].to_numpy()
            if table[name].dtype == object:
                assert frame[name].dtype == polars.String
                assert kept.tolist() == table[name].tolist()
            else:
                assert np.array_equal(kept, table[name], equal_nan=table[name].dtype == float)


def test_an_empty_table_of_polars_keeps_its_types():
    polars = pytest.importorskip("polars")
    empty = Columns("points", {"name": np.array([], dtype=object), "x": np.array([], dtype=float)})
    frame = empty.to_polars()
    assert frame.schema == {"name": polars.String, "x": polars.Float64}


def test_without_polars_the_extra_is_named(solution, monkeypatch):
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(fga.InputError, match=r"pip install 'factorgraph_adj\[polars\]'"):
        solution.point_table().to_polars()
