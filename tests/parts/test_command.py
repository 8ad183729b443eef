"""The command for several projects that are parts of one network."""

from __future__ import annotations

import csv
import shutil

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.parts.part_files import RunFolder
from factorgraph_adj.parts.whole_network import cut_network
from tests.networks.small_block import small_block

LONG = pytest.mark.slow(
    "projects as parts by the command, with their files; short tests read its arguments"
)


@LONG
def test_projects_are_parts_of_one_network(tmp_path, capsys):
    network = small_block()
    projects = []
    for part in cut_network(network, 2, RunFolder(tmp_path)):
        projects.append(str(tmp_path / f"p{part.name}"))
        fga.write_project(part.load(), tmp_path / f"p{part.name}" / "project.toml")
    out = tmp_path / "results"
    main(["adjust", *projects, "--full", "--out", str(out)])
    whole = fga.adjust(network)
    printed = capsys.readouterr().out
    assert f"redundancy n − u      {whole.redundancy};" in printed
    assert printed == (out / "report.txt").read_text(encoding="utf-8")
    with (out / "points.csv").open(encoding="utf-8") as stream:
        assert len(list(csv.reader(stream))) == 1 + len(network.points)
    with (out / "observations.csv").open(encoding="utf-8") as stream:
        assert len(list(csv.reader(stream))) == 1 + whole.equations.n_rows
    shutil.copytree(projects[1], tmp_path / "again")
    assert main(["adjust", *projects, str(tmp_path / "again"), "--quiet"]) == 2
    printed = capsys.readouterr().err
    assert "part 'again': other parts measure the same points in the same photos: im" in printed


@pytest.mark.parametrize(
    "option", ["--snoop", "--robust huber", "--test pope", "--sidak", "--alpha 0.01"]
)
def test_options_of_a_whole_network_are_refused(option, capsys):
    assert main(["adjust", "a", "b", *option.split()]) != 0
    assert (
        f"{option.split()[0]} is for a network that is adjusted as a whole"
        in capsys.readouterr().err
    )
