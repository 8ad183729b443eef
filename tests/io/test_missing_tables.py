"""A project whose tables or whose TOML file are missing: the message names files and folder."""

from __future__ import annotations

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main

POINTS = "name,x,y,z,fixed\nA,0,0,0,xyz\nB,10,0,0,\n"
OBSERVATIONS = "kind,station,target,value,sigma_mm\nslope_distance,A,B,10,10\n"


def refused(network: fga.Network) -> str:
    """Return the message that refuses to adjust a network."""
    with pytest.raises(fga.InputError) as error:
        fga.adjust(network)
    return str(error.value)


def test_no_table_of_observations(tmp_path, capsys):
    (tmp_path / "project.toml").write_text('name = "site"\n')
    (tmp_path / "points.csv").write_text(POINTS)
    says = (
        f"the network has no observations: the folder {tmp_path} has none of observations.csv, "
        "images.csv, readings.csv"
    )
    assert says in refused(fga.read(tmp_path))
    assert says in refused(fga.read(tmp_path).copy())
    assert main(["adjust", str(tmp_path)]) == 2
    assert says in "".join(capsys.readouterr())
    (tmp_path / "observations.csv").write_text(OBSERVATIONS.splitlines()[0] + "\n")
    assert refused(fga.read(tmp_path)).endswith("the network has no observations")


def test_files_without_observations(tmp_path):
    (tmp_path / "project.toml").write_text('[files]\npoints = "points.csv"\n')
    (tmp_path / "points.csv").write_text(POINTS)
    (tmp_path / "observations.csv").write_text(OBSERVATIONS)
    assert "project.toml names none of observations, images, readings" in refused(
        fga.read(tmp_path)
    )


@pytest.mark.parametrize("command", ["check", "adjust"])
def test_tables_without_project(command, tmp_path, capsys):
    (tmp_path / "points.csv").write_text(POINTS)
    (tmp_path / "observations.csv").write_text(OBSERVATIONS)
    says = f"{tmp_path}: project.toml is missing beside points.csv, observations.csv; "
    assert main([command, str(tmp_path)]) == 2
    assert f"{says}write it, or name the right folder" in "".join(capsys.readouterr())
    (tmp_path / "second.toml").write_text('name = "second"\n')
    with pytest.raises(fga.InputError) as error:
        fga.read(tmp_path)
    assert str(error.value) == f"{says}valid: {tmp_path / 'second.toml'}"


def test_folder_without_tables(tmp_path):
    with pytest.raises(fga.InputError, match="is a folder that no reader knows"):
        fga.read(tmp_path)


def test_tables_that_files_does_not_name(tmp_path, capsys):
    """Tables that [files] names under another path, or under the name of another table, are."""
    (tmp_path / "points.csv").write_text(POINTS.replace("0,0,0,\n", "0,0,0,yz\n"))
    (tmp_path / "readings.csv").write_text(OBSERVATIONS)
    (tmp_path / "doubts.txt").write_text("about the site\n")
    for name in ("covariances", "verticals", "refractive_indices"):
        (tmp_path / f"{name}.csv").write_text("name\n")
    named = '[files]\npoints = "./points.csv"\nobservations = "readings.csv"\n'
    (tmp_path / "project.toml").write_text(named)
    assert main(["check", str(tmp_path)]) != 2
    said = "".join(capsys.readouterr())
    for name in ("covariances", "verticals", "refractive_indices"):
        assert f"{name}.csv is not read: [files] does not name it" in said
    assert said.count("is not read") == 4  # with doubts.txt, nearly a table
