"""Every function that writes files writes all of them or none."""

from __future__ import annotations

import errno
import os
import re
import tomllib
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.result_files import write_tables
from tests.networks.epochs import epoch
from tests.support.same import assert_same_network

PACKAGE = Path(fga.__file__).parent
OWN_WAYS = {
    "cli/command_line.py": "nothing, to nothing, when nobody reads the output any more",
    "cli/instrument_simulation.py": "the true places of a simulation, a line for each set",
    "io/transaction_folders.py": "files beside their places",
    "io/journal.py": "a journal, of which every line is whole or taken back",
    "io/json_records.py": "a temporary folder that is read again",
    "instruments/line_log.py": "lines that wait, of which a new file takes the place when whole",
    "site/site_archive.py": "an archive under a name that was free, removed where it is not whole",
    "site/database.py": "an empty file, whose lock keeps other processes out",
    "parts/part_files.py": "states of a run, each moved into place by itself",
}
"""Modules that write without `write_files`, and what."""
WRITING = re.compile(
    r"open\([^)\n]*[\"'](?:[wax]b?|r\+b?)[\"']|O_WRONLY|O_RDWR|O_CREAT|\.write_(?:text|bytes)\("
    r"|np\.save\w*\((?!buffer)|savefig\((?!stream|buffer)|os\.(?:replace|rename)\("
    r"|shutil\.(?:copy|move)"
)
"""What writes a file."""


def test_no_module_writes_files_in_a_way_of_its_own():
    writing = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if any(
            WRITING.search(line) and "``" not in line  # code in a docstring
            for line in path.read_text(encoding="utf-8").splitlines()
        )
    }
    assert writing == set(OWN_WAYS)


@pytest.fixture(scope="module")
def solutions():
    return [fga.adjust(epoch(n, datum="given")) for n in (1, 2)]


WRITERS = {
    "tables": lambda s, folder: write_tables(Report(s), folder),
    "project": lambda s, folder: fga.write_project(s.network, folder / "project.toml"),
    "project by its suffix": lambda s, folder: fga.write(s, folder / "project.toml"),
    "results": lambda s, folder: fga.write(s, folder / "results.json"),
    "points": lambda s, folder: fga.write(s, folder / "points.ply"),
    "solution": lambda s, folder: s.save(folder / "solution.npz"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_function_that_cannot_write_its_last_file_leaves_all_old_ones(name, solutions, tmp_path):
    """Moving the last file into place fails, when all others are in place."""
    first, second = solutions
    write, folder = WRITERS[name], tmp_path / "out"
    write(first, folder)
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    place, moved = os.replace, []

    def counted(source, target):
        moved.append(target)
        if len(moved) == fails:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        place(source, target)

    fails = 0
    with patch("os.replace", counted):
        write(first, folder)
        fails = len(moved)
        assert fails == len(before)
        moved.clear()
        with pytest.raises(InputError, match="no space left on device"):
            write(second, folder)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    write(second, folder)
    after = {p.name: p.read_bytes() for p in folder.iterdir()}
    assert after != before


def test_the_standard_deviation_of_most_rows_of_a_kind_is_stated_once(tmp_path):
    """Rows of a joint covariance have none of their own, and must not get the common one."""
    network = fga.Network("a", datum="free")
    for i in range(6):
        network.add_point(f"P{i}", (10.0 * i, float(i % 2), 0.0))
    for i in range(4):
        network.add(
            fga.SlopeDistance("P0", f"P{i + 1}", 10.0 * (i + 1), sigma=0.001 * (1 + i // 3))
        )
        network.add(fga.HeightDifference("P0", f"P{i + 1}", 0.1 * i, sigma=0.002 + 0.001 * i))
    joint = [
        fga.HorizontalDistance("P0", "P5", 50.0, sigma=0.004, id="a"),
        fga.HorizontalDistance("P1", "P5", 40.0, sigma=0.004, id="b"),
    ]
    network.add(fga.Correlated(joint, np.array([[16e-6, 4e-6], [4e-6, 16e-6]])))
    fga.write_project(network, tmp_path)
    document = tomllib.loads((tmp_path / "project.toml").read_text(encoding="utf-8"))
    assert document["sigma"] == {"slope_distance": {"sigma_mm": 1.0}}
    assert_same_network(fga.read(tmp_path), network)
