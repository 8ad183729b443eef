"""An epoch that is compared with itself, or copied in part, is told in the first lines."""

from __future__ import annotations

import pytest

from factorgraph_adj.cli.command_line import main
from tests.field_mistakes.site import site


def first_lines(capsys) -> str:
    return " ".join(" ".join(capsys.readouterr().out.splitlines()[:5]).split())


@pytest.mark.parametrize("copied", [False, True])
def test_an_epoch_compared_with_itself_is_told(copied, tmp_path, capsys) -> None:
    first = site().write(tmp_path / "first")
    second = site().write(tmp_path / "second") if copied else first
    main(["compare", str(first), str(second)])
    assert "both epochs have the same 39 readings" in first_lines(capsys)


@pytest.mark.parametrize(("n", "told"), [(0, False), (5, False), (30, True)])
def test_readings_copied_in_part_are_told(n: int, told: bool, tmp_path, capsys) -> None:
    first, second = site(5), site(9)
    rows = second.tables["observations.csv"]
    rows[:n] = first.tables["observations.csv"][:n]
    main(["compare", str(first.write(tmp_path / "a")), str(second.write(tmp_path / "b"))])
    assert (f"{n} of 39 readings are the same in both epochs" in first_lines(capsys)) == told
