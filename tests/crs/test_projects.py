"""Projects in grid coordinates: the section [crs], and what is written and saved."""

from __future__ import annotations

import csv
import io
import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import AdjustmentError, InputError
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.io.project import load_project
from factorgraph_adj.report.result_files import write_solution
from tests.hostile.damage import damaged
from tests.networks.geoids import write_gtx
from tests.support.printed import row

LONG = pytest.mark.slow(
    "whole projects in grid coordinates with their reports; short tests convert the same points"
)

pytest.importorskip("pyproj", reason="the extra crs is not installed")

POINTS = """name,x,y,z,fixed,sigma_x_mm,sigma_y_mm,sigma_z_mm,check_x,check_y,check_z
A,686000,5319000,520.5,xyz,,,,,,
B,687000,5319200,540.25,,10,10,20,,,
C,686400,5320100,533,,,,,686400.02,5320100.01,532.98
"""
OBSERVATIONS = """kind,station,target,value,sigma_mm,sigma_mgon
slope_distance,A,B,1019.8,2,
slope_distance,A,C,1170.5,2,
slope_distance,B,C,1081.6,2,
zenith_angle,A,B,98.77,,1
zenith_angle,A,C,99.32,,1
zenith_angle,B,C,100.43,,1
direction,A,B,0,,1
direction,A,C,311.2,,1
height_difference,A,B,19.75,1,
"""
CRS = 'system = "EPSG:25832"\ngeoid = "geoid.gtx"\n'


def project(folder: Path, crs: str = CRS, head: str = "", points: str = POINTS) -> Path:
    """Write a project in grid coordinates."""
    write_gtx(folder / "geoid.gtx")
    (folder / "points.csv").write_text(points, encoding="utf-8")
    (folder / "observations.csv").write_text(OBSERVATIONS, encoding="utf-8")
    file = folder / "project.toml"
    file.write_text(f'name = "site"\n{head}\n[crs]\n{crs}', encoding="utf-8")
    return file


def test_a_project_in_the_grid_is_that_of_python(tmp_path: Path) -> None:
    network = fga.read_project(project(tmp_path))
    assert isinstance(network.frame, fga.TopocentricFrame)
    by_hand = fga.Network("site")
    by_hand.add_point("A", (686000, 5319000, 520.5), fixed="xyz")
    by_hand.add_point("B", (687000, 5319200, 540.25), sigma=(0.01, 0.01, 0.02))
    by_hand.add_point("C", (686400, 5320100, 533), check=(686400.02, 5320100.01, 532.98))
    system = fga.ReferenceSystem("EPSG:25832", geoid=str(tmp_path / "geoid.gtx"))
    made = fga.from_grid(by_hand, system)
    for name, point in made.points.items():
        assert network.points[name] == point
    control = network.observations["B control"]
    assert isinstance(control, fga.ControlPoint)
    assert control.axes == "enu"
    assert control.source == "points.csv:3"
    shift = network.observations["9"]
    assert isinstance(shift, fga.HeightDifference)
    assert shift.value != 19.75  # by the difference of the undulations, here mm
    assert abs(shift.value - 19.75) < 0.05


def test_a_project_in_the_grid_adjusts_and_reports_its_grid_coordinates(tmp_path: Path) -> None:
    solution = fga.adjust(fga.read_project(project(tmp_path)))
    text = fga.text_report(solution)
    assert "system         ETRS89 / UTM zone 32N; heights: geoid" in text
    assert "Grid coordinates" in text
    write_solution(solution, tmp_path / "out")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "points.csv").read_text())))
    found = fga.grid_coordinates(solution)
    for i, line in enumerate(rows):
        got = [float(line[a]) for a in ("easting", "northing", "grid_height")]
        np.testing.assert_allclose(got, found.coordinates[i], rtol=0, atol=1e-7)
        assert float(line["combined_factor"]) == pytest.approx(found.places.combined[i], abs=1e-9)
        assert float(line["sigma_easting_mm"]) == pytest.approx(
            1e3 * found.places.sigma[i, 0], rel=1e-3, abs=1e-6
        )
    np.testing.assert_allclose(found.point("A"), [686000, 5319000, 520.5], rtol=0, atol=1e-7)
    record = json.loads((tmp_path / "out" / "results.json").read_text())
    assert record["reference_system"]["definition"] == "EPSG:25832"
    np.testing.assert_allclose(record["points"]["C"]["grid"], found.point("C"), atol=1e-9)


def test_what_is_written_reads_back_to_the_bit_and_keeps_the_system(tmp_path: Path) -> None:
    network = fga.read_project(project(tmp_path))
    fga.write_project(network, tmp_path / "again" / "project.toml")
    with pytest.raises(fga.InputError, match=r"project\.toml:\d+: .*allow_outside=True"):
        fga.read_project(tmp_path / "again")
    again = fga.read_project(tmp_path / "again", allow_outside=True)
    assert again.frame == network.frame
    assert again.points == network.points
    assert again.crs == network.crs
    text = (tmp_path / "again" / "project.toml").read_text()
    assert 'coordinates = "frame"' in text
    # Beside its geoid a project names it without the folder.
    fga.write_project(network, tmp_path / "beside.toml")
    assert 'geoid = "geoid.gtx"' in (tmp_path / "beside.toml").read_text()
    solution = fga.adjust(network)
    solution.save(tmp_path / "solution.npz")
    loaded = fga.load_solution(tmp_path / "solution.npz")
    np.testing.assert_array_equal(
        fga.grid_coordinates(loaded).coordinates, fga.grid_coordinates(solution).coordinates
    )
    fewer = fga.without(network, ["1"])
    assert fewer.crs == network.crs


def test_every_option_of_the_section_reaches_the_network(tmp_path: Path) -> None:
    crs = (
        'system = "EPSG:31468"\ngeoid = 46.9\ndatum = "EPSG:4258"\n'
        'parameters = [598.1, 73.7, 418.2, 0.202, 0.045, -2.455, 6.7]\naxes = "ne"\n'
        'deflections = "weighted"\nsigma_deflections_arcsec = 2\n'
        'geoid_offset = "weighted"\nsigma_geoid_mm = 30\nazimuths = "grid"\nvectors = "grid"\n'
        'horizontal_distances = "grid"\n'
    )
    points = "name,x,y,z,fixed\nA,5319000,4461000,520,xyz\nB,5319200,4462000,540,\n"
    points += "C,5320100,4461400,533,\n"
    network = fga.read_project(project(tmp_path, crs, '[frame]\nkind = "geocentric"', points))
    assert isinstance(network.frame, fga.GeocentricFrame)
    assert network.crs is not None
    assert network.crs.parameters == fga.SevenParameters(
        598.1, 73.7, 418.2, 0.202, 0.045, -2.455, 6.7
    )
    grid = network.crs.from_frame(network.frame, np.array([network.points["B"].coordinates]), ["B"])
    np.testing.assert_allclose(grid[0], [4462000, 5319200, 540], rtol=0, atol=1e-5)
    assert network.of_kind("level")["geoid"].sigma == (0.03,)
    assert network.of_kind("vertical")["A"].sigma[0] == pytest.approx(np.radians(2 / 3600))
    fga.write_project(network, tmp_path / "again" / "project.toml")
    assert fga.read_project(tmp_path / "again").crs == network.crs


@pytest.mark.parametrize(
    ("crs", "head", "message"),
    [
        ('system = "EPSG:25832"\n', "", r"\[crs\].*does not tell what heights are"),
        ('system = "EPSG:25832+7837"\n', "", r"needs the grid de_bkg_gcg2016\.tif"),
        ('system = "EPSG:1"\n', "", "unknown reference system 'EPSG:1'"),
        ("geoid = 46.0\n", "", "system is missing"),
        (CRS + 'colour = "red"\n', "", "unknown key 'colour'; known: system, geoid"),
        (CRS + 'axes = "se"\n', "", "unknown axes 'se'; valid: en, ne"),
        (CRS + "parameters = [1, 2]\n", "", "parameters must be"),
        (CRS + "sigma_geoid_mm = 3\n", "", "are given together, or neither"),
        (CRS + 'deflections = "weighted"\n', "", "are given together, or neither"),
        (CRS, '[frame]\nkind = "local"', "need a topocentric or geocentric"),
        (CRS, "dimension = 2", "need all three dimensions"),
        ('system = "EPSG:25832"\ngeoid = "no.gtx"\n', "", "no such file of a geoid"),
        ('system = "EPSG:25832"\ngeoid = "../points.csv"\n', "", "outside the folder"),
        ('system = "EPSG:25832"\ngeoid = true\n', "", "geoid must be text"),
    ],
)
def test_what_is_wrong_in_the_section_is_told_with_its_place(
    tmp_path: Path, crs: str, head: str, message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        fga.read_project(project(tmp_path, crs, head))
    assert all(p.where.startswith("project.toml") for p in error.value.problems)


def test_a_point_outside_is_told_with_its_line(tmp_path: Path) -> None:
    points = POINTS.replace("C,686400,5320100", "C,686400,5520100")
    with pytest.raises(InputError, match=r"points\.csv:4: point 'C'.*outside of the geoid grid"):
        load_project(project(tmp_path, points=points))


@pytest.mark.slow("200 damages; short tests name single ones")
def test_200_damaged_projects_give_messages_with_places_or_a_network(tmp_path: Path) -> None:
    """Tables, the section and the geoid are damaged; never a traceback, never a warning."""
    crs = CRS + 'deflections = "held"\nazimuths = "grid"\ngeoid_offset = "free"\n'
    (tmp_path / "whole").mkdir()
    project(tmp_path / "whole", crs)
    files = {p.name: p.read_bytes() for p in (tmp_path / "whole").iterdir()}
    rng = np.random.default_rng(11)
    read = 0
    for turn in range(200):
        done = damaged(rng, files, tmp_path / f"{turn}")
        try:
            fga.read_project(tmp_path / f"{turn}")
            read += 1
        except AdjustmentError as error:
            assert isinstance(error, InputError), done
            assert all(p.what and p.where for p in error.problems), (done, error)
        shutil.rmtree(tmp_path / f"{turn}")
    assert 20 < read < 180


def test_solutions_and_systems_are_pickled_without_what_proj_made_of_them(tmp_path: Path) -> None:
    solution = fga.adjust(fga.read_project(project(tmp_path)))
    found = fga.grid_coordinates(solution).coordinates
    again = pickle.loads(pickle.dumps(solution))
    np.testing.assert_array_equal(fga.grid_coordinates(again).coordinates, found)
    assert "chain" not in vars(pickle.loads(pickle.dumps(solution.network.crs)))


@LONG
def test_a_report_says_why_it_has_no_grid_coordinates(tmp_path: Path) -> None:
    solution = fga.adjust(fga.read_project(project(tmp_path)))
    (tmp_path / "geoid.gtx").unlink()
    lost = replace(solution, network=solution.network.copy())
    lost.network.crs = fga.ReferenceSystem("EPSG:25832", geoid=str(tmp_path / "geoid.gtx"))
    text = fga.text_report(lost)
    assert "none: " in text
    assert "no such file of a geoid" in " ".join(text.split())
    write_solution(lost, tmp_path / "out")
    header = (tmp_path / "out" / "points.csv").read_text().splitlines()[0]
    assert "easting" not in header
    assert "latitude" in header


def test_a_network_without_a_system_has_no_grid() -> None:
    network = fga.Network("local")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (1.0, 0.0, 0.0), fixed="yz")
    network.add(fga.SlopeDistance("A", "B", 1.0, sigma=0.001))
    solution = fga.adjust(network)
    for function in (fga.grid_coordinates, fga.grid_photos, fga.wgs84_coordinates):
        with pytest.raises(InputError, match="has no reference system: state one"):
            function(solution)
    assert "Grid coordinates" not in fga.text_report(solution)


@LONG
def test_units_of_reports_hold_for_grid_coordinates(tmp_path: Path) -> None:
    solution = fga.adjust(fga.read_project(project(tmp_path)))
    units = Units(length="mm", angle="dms", sigma_length="um")
    text = fga.text_report(solution, options=fga.ReportOptions(units=units))
    line = row(text, "Grid coordinates", "C")
    easting = fga.grid_coordinates(solution).point("C")[0]
    assert float(line[1]) == pytest.approx(1e3 * easting, abs=0.01)
    assert line[7].startswith("1-5")  # γ, degrees-minutes-seconds
    write_solution(solution, tmp_path / "out", options=fga.ReportOptions(units=units))
    header = (tmp_path / "out" / "points.csv").read_text().splitlines()[0].split(",")
    assert {"easting", "sigma_easting_um", "convergence_deg"} <= set(header)
