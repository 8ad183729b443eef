"""A table of a project is no project: the folder to give is told."""

from __future__ import annotations

import pytest

from factorgraph_adj.cli.command_line import main
from tests.field_mistakes.site import site


@pytest.mark.parametrize("table", ["observations.csv", "points.csv"])
@pytest.mark.parametrize("command", ["check", "adjust"])
def test_the_folder_of_a_table_is_told(command, table, tmp_path, capsys) -> None:
    folder = site().write(tmp_path / "site")
    assert main([command, str(folder / table)]) == 2
    assert f"is a table of the project in its folder: give the folder, {folder}" in (
        "".join(capsys.readouterr())
    )


def test_a_table_alone_needs_a_mapping(tmp_path, capsys) -> None:
    table = tmp_path / "readings.csv"
    table.write_text("a,b\n1,2\n")
    assert main(["check", str(table)]) == 2
    assert "mapping" in "".join(capsys.readouterr())
