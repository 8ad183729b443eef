"""Suffixes and names decide on the format, in Python and on the command line."""

from __future__ import annotations

import json
import sqlite3

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import SingularError
from factorgraph_adj.export.formats import EXPORT_FORMATS, export_target, format_list
from factorgraph_adj.export.map_coordinates import best_map_coordinates
from factorgraph_adj.export.map_layers import MapScaling, solution_map
from factorgraph_adj.io.writers import WRITERS
from factorgraph_adj.solve.solution import Solution
from tests.networks.mapped import geocentric, in_plane, in_utm
from tests.networks.small_block import small_block
from tests.support.same import assert_same_network


def project(folder, network):
    fga.write_project(network, folder / "project.toml")
    return str(folder)


def test_suffixes_and_names_belong_to_one_format_each():
    suffixes = [s for e in EXPORT_FORMATS for s in e.suffixes] + [
        s for w in WRITERS.entries for s in w.suffixes
    ]
    names = [e.name for e in EXPORT_FORMATS] + [w.name for w in WRITERS.entries]
    assert len(set(suffixes)) == len(suffixes) and len(set(names)) == len(names)
    assert all(s in format_list() for s in suffixes)


@pytest.mark.parametrize("export", EXPORT_FORMATS, ids=lambda e: e.name)
def test_a_solution_is_written_by_its_suffix(tmp_path, export):
    pytest.importorskip("pyproj")
    pytest.importorskip("ezdxf")
    by_suffix, by_name = tmp_path / f"a{export.suffixes[0].upper()}", tmp_path / "b.txt"
    fga.write(in_utm(), by_suffix)
    fga.write(in_utm(), by_name, format=export.name)
    assert by_suffix.read_bytes() == by_name.read_bytes() != b""


def test_a_solution_in_a_format_of_networks_has_adjusted_values(tmp_path):
    s = in_plane()
    fga.write(s, tmp_path / "project.toml")
    back = fga.read(tmp_path / "project.toml")
    assert back.points["P7"].coordinates == tuple(s.point("P7").tolist())
    held = fga.adjust(geocentric())
    fga.write(held, tmp_path / "held" / "project.toml")
    again = fga.adjust(fga.read(tmp_path / "held"))
    assert np.abs(again.state["point"] - held.state["point"]).max() < 1e-8
    assert again.sigma0 == pytest.approx(held.sigma0, rel=1e-9)
    fga.write(small_block(), tmp_path / "given" / "project.toml")
    assert_same_network(fga.read(tmp_path / "given"), small_block())


def test_a_network_has_no_results(tmp_path):
    with pytest.raises(fga.InputError, match="GeoPackage has results: adjust the network"):
        fga.write(small_block(), tmp_path / "a.gpkg")
    assert not list(tmp_path.iterdir())


def test_unknown_suffixes_names_and_options_are_refused(tmp_path):
    with pytest.raises(fga.InputError, match=r"unknown kind of file to write; valid: .*\.gpkg"):
        fga.write(in_plane(), tmp_path / "a.shp")
    with pytest.raises(fga.InputError, match=r"no format 'shape' can be written; valid: .*geojson"):
        fga.write(in_plane(), tmp_path / "a", format="shape")
    with pytest.raises(fga.InputError, match=r"GeoPackage has no option 'scale'; valid: .*exagg"):
        fga.write(in_plane(), tmp_path / "a.gpkg", scale=3)
    with pytest.raises(fga.InputError, match="confidence must lie between 0 and 1"):
        fga.write(in_plane(), tmp_path / "a.gpkg", confidence=95)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("value", ["10", -1.0, float("nan"), float("inf")])
def test_a_factor_is_a_positive_number(value):
    with pytest.raises(fga.InputError, match="exaggeration must be a number greater than zero"):
        MapScaling(exaggeration=value)


def test_a_solution_without_covariances_has_its_points(tmp_path, monkeypatch):
    """The normal equations are singular where the iteration stopped."""

    def singular(*_):
        raise SingularError("a pivot vanished")

    s = fga.adjust(small_block(), max_iterations=1)
    monkeypatch.setattr(Solution, "variable_covariance", singular)
    found = {
        x.name: x for x in solution_map(s, best_map_coordinates(s.network), MapScaling()).layers
    }
    assert "ellipses" not in found and len(found["points"]) == len(s.network.points)
    assert "sigma_x_mm" not in found["points"].columns
    assert "w" not in found["observations"].columns
    for file in ("a.gpkg", "a.ply", "a.json"):
        fga.write(s, tmp_path / file)


# -- the command ----------------------------------------------------------------------------------


def test_the_command_exports_several_formats_at_once(tmp_path, capsys):
    pytest.importorskip("ezdxf")
    source = project(tmp_path / "in", small_block())
    out = [str(tmp_path / f) for f in ("a.gpkg", "b.ply", "c.json", "d/project.toml")]
    named = f"dxf:{tmp_path / 'drawing'}"
    arguments = [a for f in (*out, named) for a in ("--export", f)]
    options = ["--with", "exaggeration=100", "--with", "binary=false"]
    assert main(["adjust", source, "--quiet", *arguments, *options]) == 0
    connection = sqlite3.connect(tmp_path / "a.gpkg")
    facts = dict(connection.execute("SELECT name, value FROM adjustment").fetchall())
    connection.close()
    assert facts["exaggeration_of_ellipses"] == "100.0"
    assert (tmp_path / "b.ply").read_bytes().startswith(b"ply\nformat ascii")
    found = json.loads((tmp_path / "c.json").read_text())
    assert found["run"]["file"] == source, "a result knows its run"
    at = fga.read(tmp_path / "d").points["P7"].coordinates
    assert found["points"]["P7"]["xyz"] == list(at)
    assert (tmp_path / "drawing").read_text().startswith("  0\nSECTION")


def test_snooping_is_in_what_is_exported(tmp_path, capsys):
    from tests.networks.small_block import blundered

    source = project(tmp_path / "in", blundered())
    file = tmp_path / "r.json"
    main(["adjust", source, "--quiet", "--snoop", "--export", str(file)])
    rejected = json.loads(file.read_text())["snooping"]["rejected"]
    assert "F1/P6" in {r["id"] for r in rejected}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--export", "a.shp"], "a.shp: unknown kind of file to write; valid: .json"),
        (["--export", "a.geojson"], "WGS 84 only; the network has no reference system"),
        (["--export", "."], "unknown kind of file to write"),
        (
            ["--export", "rpc:x.json"],
            "rpc:x.json: no format 'rpc' can be written; valid: results, ",
        ),
        (["--export", "C:\\a.shp"], "C:\\a.shp: unknown kind of file to write; valid: .json"),
        (["--with", "exaggeration=2"], "--with belongs to --export"),
        (
            ["--export", "a.ply", "--with", "exageration=2"],
            "no exported format has the option 'exageration'; valid: binary",
        ),
        (["--export", "a.gpkg", "--with", "exaggeration=0"], "must be a number greater than zero"),
    ],
)
def test_the_command_refuses_before_it_writes(tmp_path, monkeypatch, capsys, arguments, message):
    source = project(tmp_path / "in", small_block())
    monkeypatch.chdir(tmp_path)
    assert main(["adjust", source, "--quiet", "--out", "out", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["in"]


def test_a_colon_after_a_drive_or_a_folder_states_no_format(tmp_path, monkeypatch):
    source = project(tmp_path / "in", small_block())
    monkeypatch.chdir(tmp_path)
    files = ("C:a.json", "./rpc:a.json")
    arguments = [a for f in files for a in ("--export", f)]
    assert main(["adjust", source, "--quiet", *arguments]) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"in", "C:a.json", "rpc:a.json"}


def test_all_problems_of_exports_are_told_at_once(tmp_path, capsys):
    source = project(tmp_path, small_block())
    assert main(["adjust", source, "--export", "a.shp", "--export", "b.kml"]) == 2
    said = capsys.readouterr().err
    assert "2 problems:" in said and "a.shp" in said and "the format has longitude" in said


def test_a_network_in_parts_has_no_exports(tmp_path, capsys):
    source = project(tmp_path, small_block())
    assert main(["adjust", source, "--parts", "2", "--export", "a.gpkg"]) == 2
    assert "--export is for a network that is adjusted as a whole" in capsys.readouterr().err


def test_a_target_of_another_format_than_its_suffix(tmp_path):
    assert export_target("a.xml", "kml").name == "kml"
    assert export_target("A.GeoJSON").name == "geojson"
