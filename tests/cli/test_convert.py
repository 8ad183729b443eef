"""The command convert reads one format and writes another, with the options of both."""

from __future__ import annotations

from dataclasses import replace

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.cli.input import parsed_settings
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.lens import NormalisedLens
from tests.networks.projects import write
from tests.support.places import data_dir
from tests.support.same import assert_same_network


def test_a_network_of_gama_becomes_a_project(tmp_path, capsys):
    source = data_dir("gama_3d_networks") / "local_3d.gkf"
    out = tmp_path / "out" / "project.toml"
    assert main(["convert", str(source), str(out)]) == 0
    assert_same_network(fga.read(out), fga.read(source))
    said = capsys.readouterr().out
    assert said.startswith(f"{out}: ") and said.rstrip().endswith(f"observations of {source}")


def test_a_format_of_a_camera_says_that_it_has_nothing_else(tmp_path, capsys):
    network = fga.Network("a")
    network.add_point("P", (0, 0, 0))
    network.add_camera("1", NormalisedLens(), {"c": 900.0}, unit="px", format=(640, 480))
    network.cameras["1"] = replace(network.cameras["1"], origin="upper left", y_down_in_files=True)
    fga.write_project(network, tmp_path / "project.toml")
    assert main(["convert", str(tmp_path), str(tmp_path / "camera.yml")]) == 0
    said = capsys.readouterr().out
    assert said == f"{tmp_path / 'camera.yml'}: 1 camera of {tmp_path}, and nothing else of it\n"


def test_the_format_may_be_named(tmp_path, capsys):
    source = write(tmp_path)
    out = tmp_path / "copy" / "project.toml"
    assert main(["convert", str(source), str(out), "--from", "project", "--to", "project"]) == 0
    assert_same_network(fga.read(out), fga.read(source))


def test_an_unknown_format_to_write_is_refused_before_reading(tmp_path, capsys):
    assert main(["convert", str(tmp_path / "none.toml"), str(tmp_path / "a.xlsx")]) == 2
    assert "unknown kind of file to write; valid: .toml (project)" in capsys.readouterr().err


def test_an_option_that_the_reader_does_not_have_is_refused(tmp_path, capsys):
    source = write(tmp_path)
    arguments = ["convert", str(source), str(tmp_path / "b.toml"), "--set", "scale=2"]
    assert main(arguments) == 2
    assert "reading project has no option 'scale'; it has none" in capsys.readouterr().err
    assert not (tmp_path / "b.toml").exists()


def test_settings_are_values_of_toml_or_texts():
    given = parsed_settings(
        ["a=1", "b=true", "c=north east", 'd="x"', "e=[1, 2]", "f=1=2"], "--set"
    )
    assert given == {"a": 1, "b": True, "c": "north east", "d": "x", "e": [1, 2], "f": "1=2"}
    given = parsed_settings(
        ["a={b = 1, c = 2}", 'd={"b": 1}', 'e={"b: 1}', "f=null", "g={b: 1}"], "--set"
    )
    assert given == {
        "a": {"b": 1, "c": 2},
        "d": {"b": 1},
        "e": '{"b: 1}',
        "f": "null",
        "g": "{b: 1}",
    }
    with pytest.raises(InputError) as caught:
        parsed_settings(["a", "=1", "b=1", "b=2"], "--set")
    assert [str(p) for p in caught.value.problems] == [
        "--set: 'a' is not KEY=VALUE",
        "--set: '=1' is not KEY=VALUE",
        "--set: b is given twice",
    ]
