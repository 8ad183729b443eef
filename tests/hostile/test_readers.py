"""Every reader: 200 damaged sets of files, and words that must not be passed over.

`python -m tests.hostile.readers N SEED` damages as many as one likes.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import Problem
from factorgraph_adj.io.readers import READERS
from tests.hostile.examples import Example
from tests.hostile.formats import FORMATS, OPTIONS
from tests.hostile.places import misplaced
from tests.hostile.readers import hear, judge

LONG = pytest.mark.slow(
    "every format with 35 kinds of damage; "
    "short tests damage the files of each reader in its own way"
)

DAMAGED = 200
CHANGED = 60
"""Changes of each file of a format; the command makes all of them."""


def made(form: Example, folder: Path) -> dict[str, bytes]:
    (folder / "made").mkdir()
    return form.files(folder / "made")


def test_every_reader_has_files_that_are_damaged() -> None:
    without = {r.name for r in READERS.entries} - {f.reader for f in FORMATS.values()}
    assert not without, f"state EXAMPLE_FILES in the tests of these readers: {without}"


@pytest.mark.parametrize("name", FORMATS)
def test_undamaged_files_are_read_and_told_by_name_and_content(name: str, tmp_path: Path) -> None:
    form = FORMATS[name]
    network = form.reads(form.write(tmp_path))
    assert network.points or network.photos
    assert bool(network.observations or network.n_image_points) != form.places_only
    if form.begin:
        assert READERS.of(tmp_path / form.begin).name == form.reader


@LONG
@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_refused_with_file_and_line_or_read(name: str, tmp_path: Path) -> None:
    form = FORMATS[name]
    files = made(form, tmp_path)
    judge(form.reads, files, form.begin, tmp_path, seed=21, count=DAMAGED, options=OPTIONS)


@LONG
@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_passed_over_in_silence(name: str, tmp_path: Path) -> None:
    form = FORMATS[name]
    files = made(form, tmp_path)
    (tmp_path / "changed").mkdir()
    passed = hear(
        *(form.reads, files, form.begin, tmp_path / "changed"),
        example=form,
        seed=22,
        count=CHANGED,
        options=OPTIONS,
    )
    what = "either the reader refuses it, or `unread` of its example and formats.md declare it"
    assert not passed, f"passed over in silence, {what}: {passed}"


@pytest.mark.parametrize(
    ("where", "what", "fault"),
    [
        ("a.txt:2", "is wrong", ""),
        ("a.txt:3", "is wrong", "names line 3 of 2"),
        ("a.txt:0", "is wrong", "names line 0 of 2"),
        ("a.txt", "is wrong", "names no line"),
        ("a.txt", "is empty: the first line must name the columns", ""),
        ("b.txt:1", "is wrong", "names no file"),
        ("a.txt: [points]", "leads out of the folder by a symbolic link", ""),
        ("[points]", "leads out of the folder by a symbolic link", "names no file"),
        ("a.txt:1", " ", "says nothing"),
        ("a.bin", "is wrong", "names no place in the bytes"),
        ("a.bin", "is cut at byte 7", ""),
        ("a.txt: a.bin, byte 7", "is wrong", ""),
        ("fixed", "there is no point 'A'", ""),
        ("network 'n'", "no datum", ""),
    ],
)
def test_the_judge_tells_a_place_from_none(where: str, what: str, fault: str) -> None:
    files = {"a.txt": b"one\ntwo", "a.bin": b"\0\1\2"}
    assert misplaced(Problem(what, where), files, files, options=("fixed",)) == fault


def careless(path: Path) -> fga.Network:
    """Read points, one a line, and pass over what is none."""
    network = fga.Network("careless")
    for row in path.read_text(encoding="utf-8", errors="replace").split("\n"):
        name, *xyz = [*row.split(), "", "", ""][:4]
        try:
            network.add_point(name, [float(v) for v in xyz])
        except (ValueError, fga.InputError):
            continue
    return network


def test_a_reader_that_passes_over_lines_is_found(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_bytes(b"A 1 2 3\nB 4 5 6\nC 7 8 9\n")
    files = {"p.txt": b"A 1 2 3\nB 4 5 6\nC 7 8 9\n"}
    found = hear(careless, files, "p.txt", tmp_path, example=Example("", files), seed=1, count=100)
    assert any("value|5" in f and "parts are lost" in f for f in found)
    assert any("word|" in f and "skipped" in f for f in found)
