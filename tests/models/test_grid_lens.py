"""Correction grids: bilinear by hand, in project files, in a block, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import factorgraph_adj as fga
from factorgraph_adj.models.grid_lens import GridLens, y_is_time
from factorgraph_adj.models.lens import BrownLens, HarmonicLens, Lens
from factorgraph_adj.models.ray_lens import FisheyeLens
from factorgraph_adj.models.scanner_lens import LineLens
from tests.networks.every_kind import LENSES_USED


def example() -> GridLens:
    used = LENSES_USED["grid"].lens
    assert isinstance(used, GridLens)
    return used


def test_corrections_are_bilinear_and_constant_outside() -> None:
    """The same by scipy's interpolator, at the nearest place of the grid where outside."""
    grid = example()
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-20.0, 20.0, (2, 200))
    inside = np.clip(x, grid.x[0], grid.x[-1]), np.clip(y, grid.y[0], grid.y[-1])
    for found, table in zip(grid.corrections(x, y), (grid.dx, grid.dy), strict=True):
        other = RegularGridInterpolator((grid.y, grid.x), np.array(table))
        np.testing.assert_allclose(found, other(np.column_stack(inside[::-1])), atol=1e-15)


def test_corrected_coordinates_go_through_the_lens_behind_the_grid() -> None:
    used, rng = LENSES_USED["grid"], np.random.default_rng(2)
    grid = example()
    k = np.array([[used.values.get(n, 0.0) for n in grid.names]])
    tx, ty, x, y = rng.uniform(-0.4, 0.4, (4, 50)) * [[1.0], [1.0], [28.0], [28.0]]
    dx, dy = grid.corrections(x, y)
    v, by_t, by_k = grid.residual(tx, ty, np.column_stack([x, y]), k)
    other = grid.base.residual(tx, ty, np.column_stack([x + dx, y + dy]), k)
    for a, b in zip((v, by_t, by_k), other, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.abs(v - grid.base.residual(tx, ty, np.column_stack([x, y]), k)[0]).max() > 0.005


def test_a_grid_without_nodes_corrects_nothing() -> None:
    zero = GridLens(BrownLens())
    for found in zero.corrections(np.arange(3.0), np.arange(3.0)):
        np.testing.assert_array_equal(found, 0.0)


@pytest.mark.parametrize(
    "base", [Lens(), BrownLens(affine="after"), HarmonicLens(reference_radius=60.0)]
)
def test_projects_keep_the_grid_and_the_lens_behind_it(base: Lens, tmp_path: Path) -> None:
    grid = GridLens(
        base, (-5.0, 0.1, 7.25), (-3.0, 3.0), ((1e-3, 2e-3, -1e-17),) * 2, ((0.0, 1 / 3, 2.0),) * 2
    )
    network = fga.Network("camera")
    network.add_camera("c", grid, {"c": 100.0}, unit="mm")
    fga.write_project(network, tmp_path / "project.toml")
    assert fga.read_project(tmp_path).cameras["c"].lens == grid


def test_what_is_wrong_is_said(tmp_path: Path) -> None:
    with pytest.raises(fga.InputError, match="must be a model of tangents, not 'fisheye'"):
        GridLens(FisheyeLens())
    with pytest.raises(fga.InputError, match="x must be two or more increasing nodes"):
        GridLens(Lens(), (1.0, 1.0), (0.0, 1.0), ((0.0, 0.0),) * 2, ((0.0, 0.0),) * 2)
    with pytest.raises(fga.InputError, match=r"dy must have 2 rows \(nodes of y\) of 3"):
        GridLens(Lens(), (0.0, 1.0, 2.0), (0.0, 1.0), ((0.0, 0.0, 0.0),) * 2, ((0.0, 0.0),) * 2)
    network = fga.Network("camera")
    network.add_camera("c", GridLens(), {"c": 100.0}, unit="mm")
    path = tmp_path / "project.toml"
    fga.write_project(network, path)
    text = path.read_text(encoding="utf-8")
    for old, new, said in (
        ("dx = []", 'dx = [[1.0, "a"]]', "dx must be a list of rows, each a list of numbers"),
        ("x = []", "x = 3", "x must be a list of numbers"),
        ('base = "none"', 'base = "brwn"', "unknown base model 'brwn'|brwn"),
        ('base = "none"', 'base = "grid"', "must be a model of tangents"),
    ):
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(fga.InputError, match=said):
            fga.read_project(path)


def test_a_grid_cannot_correct_a_time() -> None:
    nodes, zero, one = (0.0, 1.0), ((0.0, 0.0),) * 2, ((0.0, 0.1),) * 2
    along = GridLens(LineLens(), nodes, nodes, one, zero)
    assert y_is_time(along) and not y_is_time(GridLens())
    for dy, modes in ((one, ()), (zero, ((1.0,) * 4,))):
        with pytest.raises(fga.InputError, match="is the time of a line of the image"):
            GridLens(LineLens(), nodes, nodes, one, dy, modes)
