"""``refine``: the corrections of the function, in a project and a table; what is refused."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.models.image_refraction import Atmosphere
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.triangulation.image_refinement import refine_images


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("block")
    plan = simulate_aerial_block(1, image_points=400, points_per_photo=50).network
    fga.write_project(measure(plan, seed=1), folder / "project.toml")
    return folder


def test_the_project_and_the_table_have_the_corrections(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "refined"
    air = ["--air", "985.0", "20", "150"]
    assert main(["refine", str(project), "--curvature", *air, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "985.0 hPa and 20.0 °C at 150 m above sea level" in said
    network = fga.read_project(project)
    expected = refine_images(
        network,
        curvature=True,
        atmosphere=Atmosphere(98_500.0, 293.15, 150.0),
        solution=fga.adjust(network),
    )
    written = fga.read_project(out).images.columns()[2]
    np.testing.assert_allclose(written, expected.network.images.columns()[2], rtol=0, atol=1e-9)
    with (out / "refinement.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for cause, values in {**expected.corrections, "sum": expected.sum}.items():
        found = [[float(r[f"{cause}_{a}"]) for a in "xy"] for r in rows]
        np.testing.assert_allclose(found, values, rtol=1e-6, atol=1e-9)
    assert [r["photo"] for r in rows] == list(expected.photo)


def test_what_cannot_be_corrected_is_refused(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["refine", str(project), "--refraction", "none"]) == 2
    assert "nothing to correct" in capsys.readouterr().err
    assert main(["refine", str(project), "--air", "98500", "20", "150"]) == 2
    assert "1 hPa is 100 Pa" in capsys.readouterr().err
