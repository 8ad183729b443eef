"""What an adjustment takes on any machine, against the record of earlier versions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.benchmarks.record import (
    COLUMNS,
    TABLE,
    WORKS,
    Figures,
    Row,
    append,
    figures,
    newest,
    read,
    worse,
)
from tests.support.places import data_dir

QUICK = ("roma", "aerial 10000", "grid 100")
"""Works that take less than a few seconds."""
FIGURES = Figures(iterations=5, calls=6, largest_front=60, fronts=3, bytes_of_partials=1000)
ROW = Row("0.6.0", "2026-01-01", "block", 5, 6, 60, 3, 1000, 0.52, 0.75, 0.3, 0.31, 318.0)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("name", QUICK)
def test_no_figure_is_worse_than_its_newest_record(name: str) -> None:
    work = WORKS[name]
    if work.data is not None:
        data_dir(work.data.name)
    assert not worse(figures(work.make()), newest(read())[name])


def test_every_work_has_a_record() -> None:
    assert set(newest(read())) == set(WORKS)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("iterations", 4),
        ("calls", 4),
        ("largest_front", 59),
        ("fronts", 2),
        ("fronts", 4),
        ("bytes_of_partials", 999),
        ("bytes_of_partials", 1001),
    ],
)
def test_a_figure_that_misses_its_record_is_named(tmp_path: Path, column: str, value: int) -> None:
    """A doctored record, which the figures miss in one place."""
    table = tmp_path / "record.csv"
    append([ROW, replace(ROW, **{column: value})], table)
    (found,) = worse(FIGURES, newest(read(table))["block"])
    assert f"block: {column} is {getattr(FIGURES, column)}" in found


def test_figures_as_good_as_the_record_or_better_pass() -> None:
    assert not worse(FIGURES, ROW)
    assert not worse(replace(FIGURES, iterations=4, calls=3, largest_front=50), ROW)
    assert not worse(replace(FIGURES, calls=7), ROW), "one more linearisation is allowed"
    assert worse(replace(FIGURES, calls=8), ROW)


def test_a_doctored_table_fails_the_figures_of_a_real_adjustment(tmp_path: Path) -> None:
    table = tmp_path / "record.csv"
    row = newest(read())["grid 100"]
    doctored = replace(row, iterations=row.iterations - 1, bytes_of_partials=1)
    append([row, doctored], table)
    found = worse(figures(WORKS["grid 100"].make()), newest(read(table))["grid 100"])
    assert [text.split()[2] for text in found] == ["iterations", "bytes_of_partials"]


def test_the_newest_row_of_a_work_is_the_last_one(tmp_path: Path) -> None:
    table = tmp_path / "record.csv"
    append([ROW], table)
    append([replace(ROW, iterations=4), replace(ROW, work="other", ratio_to_pycolmap=None)], table)
    rows = read(table)
    assert [row.iterations for row in rows] == [5, 4, 5]
    assert newest(rows) == {"block": replace(ROW, iterations=4), "other": rows[2]}
    assert rows[2].ratio_to_pycolmap is None


def test_a_table_with_other_columns_is_refused(tmp_path: Path) -> None:
    table = tmp_path / "record.csv"
    table.write_text("version,work\n0.6.0,block\n", encoding="utf-8")
    with pytest.raises(ValueError, match="expected"):
        read(table)
    assert TABLE.read_text(encoding="utf-8").splitlines()[0] == ",".join(COLUMNS)
