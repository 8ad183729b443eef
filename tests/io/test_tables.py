"""CSV tables bring back every text, and hold no formulas and no control characters."""

from __future__ import annotations

import csv
import io
import re
from itertools import product

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.control_characters import escaped
from factorgraph_adj.experiment.repetitions import Repetition
from factorgraph_adj.experiment.runs import Results
from factorgraph_adj.io.csv_tables import read_table, unguarded_cell, write_columns
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import Direction, SlopeDistance
from factorgraph_adj.report.epochs_report import EpochsReport, displacements_table
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.report.tables import as_csv

FORMULA = re.compile(r"[=@+\-\t\r＝＠＋－]")
NAMES = (
    *("=1+1", "@SUM(A1)", "+P", "-P", "-5", "+1e3", "-.5", "'=x", "''=x", "'-5", "'a", "''", "−1"),
    *("=a,b", '="x"', "#1", "'#1", "＝1", "-12-30", "- 5", "=", "-", "'", "+inf", "a=b", "-inf"),
)


def written(tmp_path, names):
    (tmp_path / "t.csv").write_text(write_columns({"name": names, "n": ["-1"] * len(names)}))
    problems = []
    table = read_table(tmp_path / "t.csv", problems)
    assert not problems
    return table


def is_formula(cell):
    """Return whether a spreadsheet would compute a cell: not if it is a number."""
    try:
        float(cell)
    except ValueError:
        return FORMULA.match(cell) is not None
    return False


def test_every_name_comes_back_and_none_is_a_formula(tmp_path):
    rng = np.random.default_rng(1)
    drawn = ("".join(rng.choice(list("'=+-@,;\"#x1. "), 4)).strip() for _ in range(2000))
    every = ("".join(t) for n in (1, 2, 3) for t in product("'=-1a", repeat=n))
    names = list(dict.fromkeys(n for n in (*NAMES, *every, *drawn) if n))
    table = written(tmp_path, names)
    assert [cells[0] for _, cells in table.rows] == names
    text = (tmp_path / "t.csv").read_text()
    assert not [c for row in csv.reader(io.StringIO(text)) for c in row if is_formula(c)]


def test_numbers_are_written_as_they_are():
    assert write_columns({"v": ["-5", "+1e-3", "-.5", "-inf", "nan"]}) == (
        "v\n-5\n+1e-3\n-.5\n-inf\nnan\n"
    )
    assert (
        unguarded_cell("-5") == "-5"
        and unguarded_cell("'5") == "'5"
        and unguarded_cell("'=5") == "=5"
    )


def triangle(names):
    net = fga.Network("three points")
    a, b, p = names
    net.add_point(a, (0, 0, 0), fixed="xyz")
    net.add_point(b, (100, 0, 0), fixed="xyz")
    net.add_point(p, (40, 30, 0), fixed="z")
    for n, (station, length) in enumerate([(a, 50.0), (b, np.hypot(60, 30)), (a, 50.003)]):
        net.add(SlopeDistance(station, p, length, sigma=0.002, id=f"{'=-@'[n]}{n}x"))
    return net


@pytest.mark.parametrize("names", [NAMES[i : i + 3] for i in range(0, 24, 6)], ids=str)
def test_projects_with_such_names_come_back_and_results_have_no_formulas(tmp_path, names):
    net = triangle(names)
    fga.write_project(net, tmp_path / "p" / "project.toml")
    again = fga.read_project(tmp_path / "p")
    assert list(again.points) == list(names)
    assert list(again.observations) == list(net.observations)
    write_solution(fga.adjust(again), tmp_path / "out")
    tables = list(tmp_path.rglob("*.csv"))
    assert len(tables) > 4
    for path in tables:
        with path.open(newline="") as stream:
            assert not [c for row in csv.reader(stream) for c in row if is_formula(c)], path


def test_tables_of_epochs_and_experiments_have_no_formulas():
    epochs = [fga.adjust(triangle(("=A", "@B", "=P+1"))) for _ in range(2)]
    moved = as_csv(displacements_table(EpochsReport(fga.congruence(*epochs))))
    row = Repetition({"=f": "+a"}, 0, 1, {"@v": -1.0}, "=1", "-cmd\x07\nnext")
    said = Results("study", ("=f",), (row,)).table()
    assert "'=P+1" in moved and "'+a" in said and "\x07" not in said
    for text in (moved, said):
        assert not [c for r in csv.reader(io.StringIO(text)) for c in r if is_formula(c)]


STEERING = (
    "\x1b[2J",
    "\x07",
    "\x9b2J",
    "\u202e",
    "\u2028",
    "a\nb",
    "\t",
    "\x7f",
    "\u2066",
    "\ud800",
)


@pytest.mark.parametrize("steering", STEERING, ids=ascii)
def test_control_characters_are_refused_wherever_a_name_enters_a_network(steering):
    name = f"P{steering}Q"
    net = fga.Network(f"title {steering}")
    assert net.name.isprintable()
    net.add_camera("camera", BrownLens(), {"c": 100.0})
    for p in "AB":
        net.add_point(p, (0, 0, 0))
    refused = (
        lambda: net.add_point(name, (0, 0, 0)),
        lambda: net.add_points([name], np.zeros((1, 3))),
        lambda: net.add_camera(name, BrownLens(), {"c": 100.0}),
        lambda: net.add_photo(name, "camera"),
        lambda: net.add_frame(name),
        lambda: net.set_refraction(name),
        lambda: net.set_mount(name),
        lambda: net.set_size(name, 1.0),
        lambda: net.set_orientation("A", set=name, value=0.0),
        lambda: SlopeDistance("A", "B", 1.0, sigma=1.0, id=name),
        lambda: SlopeDistance(name, "B", 1.0, sigma=1.0),
        lambda: SlopeDistance("A", "B", 1.0, sigma=1.0, instrument=name),
        lambda: Direction("A", "B", 1.0, sigma=1.0, set=name),
    )
    for call in refused:
        with pytest.raises(fga.InputError, match="cannot have control characters") as error:
            call()
        assert escaped(str(error.value)).translate({9: None, 10: None}).isprintable()
