"""Small files that would fill the memory, or be waited for: every reader refuses them at once."""

from __future__ import annotations

import bz2
import gzip
import os
import sqlite3
import sys
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.files import FREE_GROWTH_BYTES
from factorgraph_adj.io.photogrammetry.colmap_reference import keypoint_scales
from factorgraph_adj.io.photogrammetry.metashape_files import ZipArchive
from factorgraph_adj.io.xml_files import parse_xml
from tests.hostile.formats import FORMATS
from tests.hostile.judge import run

MEGABYTES = 300.0
"""Largest memory of a command that refuses, beside that of the process at its start."""
HEAD, TAIL = b'<?xml version="1.0"?>\n<gama-local version="2.0">', b"</gama-local>\n"
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")


Write = Callable[[Path], Path]


def _written(name: str, *pieces: bytes | tuple[bytes, int] | Iterator[bytes]) -> Write:
    """Return what writes a file piece by piece: its own memory must not hide that of a reader."""

    def write(folder: Path) -> Path:
        with _packed(folder / name) as stream:
            for piece in pieces:
                if isinstance(piece, tuple):
                    unit, times = piece
                    for _ in range(100):
                        stream.write(unit * (times // 100))
                elif isinstance(piece, bytes):
                    stream.write(piece)
                else:
                    stream.writelines(piece)
        return folder / name

    return write


@contextmanager
def _packed(path: Path) -> Iterator[Any]:
    if path.suffix == ".psz":
        archive = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED)
        with archive, archive.open("doc.xml", "w") as stream:
            yield stream
    else:
        opens = {".gz": gzip.open, ".bz2": bz2.open}.get(path.suffix, open)
        with opens(path, "wb") as stream:
            yield stream


def _project(text: str) -> Write:
    def write(folder: Path) -> Path:
        (folder / "project.toml").write_text(text)
        (folder / "points.csv").write_text("name,x,y,z\nA,0,0,0\n")
        return folder

    return write


def _pipe(name: str) -> Write:
    def write(folder: Path) -> Path:
        _project("")(folder)
        (folder / name).unlink(missing_ok=True)
        os.mkfifo(folder / name)
        return folder if name.endswith((".csv", ".toml")) else folder / name

    return write


def _device(name: str) -> Write:
    def write(folder: Path) -> Path:
        _project("")(folder)
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to("/dev/zero")
        return folder if name.endswith((".csv", ".toml")) else folder / name

    return write


def _holes(folder: Path) -> Path:
    with (folder / "n.gkf").open("wb") as stream:
        stream.truncate(3_000_000_000)
    return folder / "n.gkf"


BOMBS: dict[str, Write] = {
    "an archive of blanks": _written("p.psz", b"<document>", (b" ", 10**8), b"</document>"),
    "an archive of elements": _written("p.psz", b"<document>", (b"<a/>", 25_000_000)),
    "a small archive of elements": _written("p.psz", b"<document>", (b"<a />\n", 600_000)),
    "packed numbers, gz": _written("p.txt.gz", (b"1 ", 10**8)),
    "packed numbers, bz2": _written("p.txt.bz2", (b" ", 10**8)),
    "entities": _written(
        "n.gkf",
        b"<!DOCTYPE a [",
        (b'<!ENTITY e%d "%s">' % (i, b"x" * 20) for i in range(20_000)),
        b"]><a>&e1;</a>",
    ),
    "elements": _written("n.gkf", HEAD, (b"<a/>", 2_000_000), TAIL),
    "elements in a large file": _written("n.gkf", HEAD, (b"<Point/>", 15_000_000), TAIL),
    "a comment without end": _written("n.gkf", HEAD, b"<!--", (b"x", 5_000_000)),
    "attributes of one element": _written(
        "n.gkf", HEAD, b"<a ", (b'a%d="1" ' % i for i in range(1_000_000)), b"/>", TAIL
    ),
    "attributes": _written("n.gkf", HEAD, (b'<a b="" c="" d="" e="" f=""/>', 200_000), TAIL),
    "depth": _written("n.gkf", HEAD, (b"<a>", 300_000), TAIL),
    "a file of holes": _holes,
    "a TOML key of many parts": _project("a" + ".a" * 200_000 + " = 1\n"),
    "a TOML header of many parts": _project("[a" + '."a"' * 200_000 + "]\n"),
    "a TOML key in a table": _project("x = {a" + " . a" * 200_000 + " = 1}\n"),
    "a TOML number of many digits": _project("datum = " + "9" * 100_000 + "\n"),
    "TOML in TOML": _project("a = " + "[" * 200_000 + "\n"),
    "YAML": _written("c.yml", b"%YAML:1.0\na: [", (b"1, ", 2_000_000), b"1]\n"),
    "YAML in YAML": _written("c.yml", b"%YAML:1.0\na: ", (b"[", 50_000)),
    "YAML with a list as name": _written("c.yml", b"%YAML:1.0\n---\n? [1, 2]\n: 3\n"),
    "YAML with a table as name": _written("c.yml", b"%YAML:1.0\n---\n{a: 1}: 3\n"),
    "JSON in JSON": _written("reconstruction.json", (b"[", 500_000)),
    "a JSON number of many digits": _written("reconstruction.json", b"[" + b"9" * 100_000 + b"]"),
    "a pipe as a table": _pipe("points.csv"),
    "a pipe as a project": _pipe("project.toml"),
    "a pipe as a file": _pipe("n.gkf"),
    "a pipe as packed numbers": _pipe("p.txt.gz"),
    "a pipe as an archive": _pipe("p.psz"),
    "a device as a table": _device("points.csv"),
    "a device as a file": _device("n.gkf"),
    "a folder as a file": lambda folder: (folder / "n.gkf").mkdir() or folder / "n.gkf",
}

LARGE = {
    *("a small archive of elements", "packed numbers, bz2", "packed numbers, gz"),
    *("elements in a large file", "attributes"),
}
LONG = pytest.mark.slow(
    "files that take seconds to be packed or read; short tests refuse smaller ones"
)


@pytest.mark.parametrize("bomb", [pytest.param(b, marks=LONG if b in LARGE else ()) for b in BOMBS])
def test_what_would_fill_the_memory_is_refused_at_once(bomb: str, tmp_path: Path) -> None:
    path = BOMBS[bomb](tmp_path)
    told = run(["check", str(path)], None)
    assert told.code == 2 and not told.fault, told
    assert told.megabytes < MEGABYTES, told
    named = [p.name for p in (path, *(path.iterdir() if path.is_dir() else ()))]
    assert any(n in told.output for n in named), told.output


@pytest.mark.parametrize("name", FORMATS)
def test_a_pipe_in_place_of_any_file_is_no_file(name: str, tmp_path: Path) -> None:
    form = FORMATS[name]
    (tmp_path / "made").mkdir()
    files = form.files(tmp_path / "made")
    for file in files:
        here = tmp_path / "site"
        here.mkdir()
        for other, content in files.items():
            if other != file:
                (here / other).write_bytes(content)
        os.mkfifo(here / file)
        with suppress(fga.InputError):  # what a reader can do without, it may pass over
            form.reads(here / form.begin)
        for made in here.iterdir():
            made.unlink()
        here.rmdir()


def test_a_file_of_arrays_with_more_than_it_can_hold_is_refused(tmp_path: Path) -> None:
    archive = zipfile.ZipFile(tmp_path / "s.npz", "w", zipfile.ZIP_DEFLATED)
    with archive, archive.open("header.npy", "w") as stream:
        np.lib.format.write_array(stream, np.zeros(20_000_000, dtype=np.uint8))
    with pytest.raises(fga.InputError, match=r"s\.npz: unpacks to \d+ bytes"):
        fga.load_solution(tmp_path / "s.npz")
    np.savez(tmp_path / "o.npz", header=np.array([{"a": 1}], dtype=object))
    with pytest.raises(fga.InputError, match="is no file of"):
        fga.load_solution(tmp_path / "o.npz")


def test_files_of_one_archive_are_measured_together(tmp_path: Path) -> None:
    names = [f"{i}.ply" for i in range(8)]
    with zipfile.ZipFile(tmp_path / "p.psz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.writestr(name, b" " * (FREE_GROWTH_BYTES // 2))
    packed = ZipArchive(tmp_path / "p.psz")
    for name in (*names[:2], names[0]):  # the same file again takes no more
        assert len(packed.read(name)) == FREE_GROWTH_BYTES // 2
    with pytest.raises(fga.InputError, match=r"p\.psz: unpacks to \d+ bytes"):
        packed.read(names[2])


def test_a_database_whose_rows_are_computed_without_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "d.db"
    with sqlite3.connect(path) as database:
        database.execute(
            "CREATE VIEW images AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) "
            "SELECT x AS image_id, 'a' AS name FROM c"
        )
        database.execute("CREATE TABLE keypoints (image_id, rows, cols, data)")
    with pytest.raises(fga.InputError, match="views or computed columns"):
        keypoint_scales(path, {"a": 1})


def test_large_surveys_are_within_the_bounds(tmp_path: Path) -> None:
    rows = b"".join(
        b'<point id="%d" x="%d.123" y="%d.456" z="1.5" adj="xyz"/>\n' % (i, i, 2 * i)
        for i in range(50_000)
    )
    network = b"<network><points-observations>%s</points-observations></network>" % rows
    (tmp_path / "n.gkf").write_bytes(HEAD + network + TAIL)
    assert len(fga.read(tmp_path / "n.gkf").points) == 50_000


def test_the_tree_of_a_survey_takes_memory_in_proportion_to_its_text() -> None:
    """Elements with three attributes each: 6 bytes for one of the text, where dicts took 13."""
    rows = "".join(
        f'<obs from="A{i % 100}"><distance to="B{i % 97}" val="{100 + i * 1e-4:.4f}" stdev="2.0"/>'
        f'<direction to="B{i % 97}" val="{i % 400}.1234" stdev="10"/></obs>\n'
        for i in range(5_000)
    )
    text = f"<survey>{rows}</survey>".encode()
    tracemalloc.start()
    try:
        root = parse_xml(text, "survey.xml")
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(root.children) == 5_000
    assert root.children[7].children[0].attributes["to"] == "B7"
    assert held < 7.5 * len(text)
    assert peak < 8.5 * len(text)
