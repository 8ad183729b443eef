"""Coordinates of a free model of photos are not those of a reference system."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.network.grid.model_coordinates import has_model_coordinates
from tests.networks.photo_block import block
from tests.networks.pixel_block import pixel_block

pytest.importorskip("pyproj", reason="the extra crs is not installed")

SYSTEM = fga.ReferenceSystem("EPSG:25832", heights="ellipsoidal")
EVERY_EXPORT = ("block.kml", "block.geojson", "block.gpkg", "block.dxf")
"""Files whose coordinates are of the reference system, or of WGS 84."""


def model() -> fga.Network:
    """Return a free block: image points, and a check point, which determines nothing."""
    network = block(3)
    network.points = {n: replace(p, fixed=(False,) * 3) for n, p in network.points.items()}
    network.points["P0"] = replace(network.points["P0"], check=network.points["P0"].coordinates)
    network.datum = "free"
    return network


def placed(how: str) -> fga.Network:
    """Return the block with one thing that says where it is."""
    network = model()
    point, photo = network.points["P1"], network.photos["F1"]
    if how == "held":
        network.points["P1"] = replace(point, fixed=(True, True, False))
    elif how == "weighted":
        network.points["P1"] = replace(point, sigma=(0.01, 0.01, 0.01))
    elif how == "control":
        network.add(fga.ControlPoint("P1", point.coordinates, sigma=(0.01, 0.01, 0.01)))
    elif how == "position":
        network.add(fga.PhotoPosition("F1", photo.position, sigma=(0.05, 0.05, 0.05)))
    elif how == "held photo":
        network.photos["F1"] = replace(photo, fixed=(False,) * 3 + (True,) * 3)
    elif how == "weighted photo":
        network.photos["F1"] = replace(photo, sigma_position=(0.1, 0.1, 0.1))
    return network


def test_a_free_model_is_refused_with_what_is_missing() -> None:
    """With a scale bar, which gives a size and no place, too."""
    barred = model()
    barred.add(fga.SlopeDistance("P0", "P1", 8.0, sigma=0.001))
    for network in (model(), barred):
        with pytest.raises(fga.InputError, match="free model") as refused:
            fga.from_grid(network, SYSTEM)
        said = str(refused.value)
        assert "8 photos" in said and SYSTEM.name in said
        assert all(w in said for w in ("gcp=", "positions=", "ControlPoint", "PhotoPosition"))


@pytest.mark.parametrize(
    "how", ["held", "weighted", "control", "position", "held photo", "weighted photo"]
)
def test_what_says_where_a_block_is_makes_it_no_model(how: str) -> None:
    assert has_model_coordinates(model())
    assert not has_model_coordinates(placed(how))


def test_free_networks_of_instruments_have_coordinates_of_a_map() -> None:
    network = model()
    network.add(fga.HeightDifference("P0", "P1", 0.1, sigma=0.001))
    assert not has_model_coordinates(network)
    assert not has_model_coordinates(fga.Network("without photos", datum="free"))


def test_a_block_on_the_earth_has_a_place() -> None:
    """A frame on the Earth is a place, as OpenSfM has it from its positions."""
    network = model()
    network.frame = fga.TopocentricFrame(0.8, 0.2, 500.0)
    assert not has_model_coordinates(network)


@pytest.fixture(scope="module")
def solution() -> fga.Solution:
    network = model()
    network.crs = SYSTEM
    return fga.adjust(network)


@pytest.mark.parametrize("name", EVERY_EXPORT)
def test_every_export_to_the_earth_refuses_a_model(
    name: str, solution: fga.Solution, tmp_path: Path
) -> None:
    with pytest.raises(fga.InputError, match="free model"):
        fga.write(solution, tmp_path / name)
    assert not (tmp_path / name).exists()


def test_results_in_a_grid_and_in_wgs84_refuse_a_model(solution: fga.Solution) -> None:
    for results in (fga.grid_coordinates, fga.wgs84_coordinates, fga.grid_photos):
        with pytest.raises(fga.InputError, match="free model"):
            results(solution)


def test_the_command_refuses_a_model_in_a_grid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A project of a free block; without --crs it is adjusted."""
    network = pixel_block(observed=False)
    for ident in [i for i, o in network.observations.items() if o.kind == "control"]:
        del network.observations[ident]
    network.datum = "free"
    fga.write_project(network, tmp_path / "block")
    words = ["adjust", str(tmp_path / "block"), "--quiet"]
    assert main([*words, "--crs", "EPSG:25832", "--heights", "ellipsoidal"]) == 2
    assert "4 photos are a free model" in capsys.readouterr().err
    assert main(words) in (0, 1)
