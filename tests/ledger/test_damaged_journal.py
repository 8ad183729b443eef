"""A journal with a damaged line is refused with file and line, not with an error of Python."""

from __future__ import annotations

import gc
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import SlopeDistance
from tests.networks.small_block import small_block
from tests.support import journals
from tests.support.arrivals import bare, chunks

LONG = pytest.mark.slow(
    "every way in which a file is changed beneath a journal; short tests damage single lines"
)


def day(folder: Path) -> Path:
    """Return a journal of five photos, three tapes, and a removal."""
    out, network = folder / "day.jsonl", small_block()
    inc = fga.IncrementalAdjustment(bare(network), journal=out)
    photos = [c for c in chunks(network, None, by_photo=True) if len(c) > 1]
    inc.add([c for c in chunks(network, None, by_photo=True) if len(c) == 1 for c in c])
    for rays in photos:
        inc.add(rays)
    for n in range(3):
        inc.add(SlopeDistance("P1", "P6", 5.0, sigma=5.0, id=f"tape {n}"))
    inc.remove("tape 1")
    del inc
    gc.collect()
    return out


@cache
def recorded() -> bytes:
    """Return the journal of one such day."""
    with TemporaryDirectory() as folder:
        return day(Path(folder)).read_bytes()


def damaged(folder: Path, line: int, key: str, value: Any) -> Path:
    """Return a journal of which one entry of a line has another value; None: it is absent."""
    out = folder / "day.jsonl"
    out.write_bytes(recorded())
    lines = journals.read(out)
    if value is None:
        del lines[line - 1][key]
    else:
        lines[line - 1][key] = value
    journals.write(out, lines)
    return out


OBSERVATION = {
    "kind": "slope_distance",
    "station": "P1",
    "value": 5.0,
    "unit": "m",
    "sigma_m": 5.0,
    "id": "t",
}
CASES = {
    "no options": (
        1,
        "options",
        None,
        "the options must be accuracy, alpha, datum, engine, keep, keep_seconds, policy",
    ),
    "another option": (1, "options", {"3ccuracy": 0.01}, "the options must be accuracy, alpha"),
    "no files": (1, "files", None, "the line has no files of a network"),
    "an unknown point": (
        3,
        "observations",
        [{**OBSERVATION, "target": "P{"}],
        "unknown point 'P{'; known: ",
    ),
    "text for a list": (3, "accepted", 3, "the line is damaged: TypeError"),
    "a field of no version": (3, "colour", 3, "unknown field 'colour'; valid: "),
    "images without points": (3, "images", [{"photo": "F1"}], "the line is damaged: KeyError"),
}


@pytest.mark.parametrize(("line", "key", "value", "told"), CASES.values(), ids=CASES)
def test_a_damaged_line_is_refused_with_file_and_line(tmp_path, line, key, value, told):
    journal = damaged(tmp_path, line, key, value)
    before = journal.read_bytes()
    with pytest.raises(InputError) as caught:
        fga.IncrementalAdjustment.resume(journal)
    for problem in caught.value.problems:
        assert str(problem).startswith(f"{journal}:{line}")
    assert told in str(caught.value)
    assert journal.read_bytes() == before


def line_by_line(journal: Path) -> list[bytes]:
    return journal.read_bytes().splitlines(keepends=True)


LINKS = {
    "a line is missing": (lambda x: [*x[:4], *x[5:]], 5, "line 5 of it is missing"),
    "two lines are missing": (lambda x: [*x[:4], *x[6:]], 5, "lines 5 to 6 of it is missing"),
    "the last but one is missing": (lambda x: [*x[:-2], x[-1]], -1, "of it is missing"),
    "a line stands twice": (lambda x: [*x[:5], *x[4:]], 6, "it is here twice"),
    "two lines are exchanged": (
        lambda x: [*x[:4], x[5], x[4], *x[6:]],
        5,
        "line 5 of it is missing",
    ),
    "a line without links": (
        lambda x: [*x[:4], b'{"do": "dance"}\n', *x[4:]],
        5,
        "no number and chain",
    ),
    "a changed number": (
        lambda x: [*x[:6], x[6].replace(b"5.0", b"6.0"), *x[7:]],
        7,
        "was changed",
    ),
    "another network at the start": (
        lambda x: [x[0].replace(b'"alpha": 0.001', b'"alpha": 0.010'), *x[1:]],
        1,
        "was changed",
    ),
}


@LONG
@pytest.mark.parametrize(("change", "line", "told"), LINKS.values(), ids=LINKS)
def test_lines_that_do_not_follow_from_one_another_are_refused(tmp_path, change, line, told):
    journal = day(tmp_path)
    lines = line_by_line(journal)
    changed = change(lines)
    assert changed != lines
    journal.write_bytes(b"".join(changed))
    with pytest.raises(InputError) as caught:
        fga.IncrementalAdjustment.resume(journal)
    first = caught.value.problems[0]
    assert first.where == f"{journal}:{line if line > 0 else len(changed)}"
    assert told in first.what
    assert journal.read_bytes() == b"".join(changed)
    # What stands before is whole, as the message says.
    journal.write_bytes(b"".join(changed[: max(int(first.where.rpartition(":")[2]) - 1, 0)]))
    if line != 1:
        assert fga.IncrementalAdjustment.resume(journal).resumed == ""


@LONG
def test_lines_of_two_journals_do_not_mix(tmp_path):
    (tmp_path / "a").mkdir()
    first = day(tmp_path / "a")
    second = day(tmp_path)
    lines = journals.read(second)
    lines[2]["causes"] = {}
    journals.write(second, lines)
    mixed = [*line_by_line(second)[:5], *line_by_line(first)[5:]]
    second.write_bytes(b"".join(mixed))
    with pytest.raises(InputError, match="comes from another journal"):
        fga.IncrementalAdjustment.resume(second)


def replaced(path: Path) -> None:
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)


def overwritten(path: Path) -> None:
    path.write_bytes(b"x" * path.stat().st_size)


def shortened(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def longer(path: Path) -> None:
    with path.open("ab") as stream:
        stream.write(b"{}\n")


BENEATH = {
    "deleted": (Path.unlink, "was deleted or renamed"),
    "renamed": (lambda p: p.rename(p.with_name("other")), "was deleted or renamed"),
    "replaced": (replaced, "was replaced by another file"),
    "emptied": (lambda p: p.write_bytes(b""), r"was truncated from \d+ to 0 bytes"),
    "shortened": (shortened, "was truncated from"),
    "overwritten": (overwritten, "was changed by somebody else"),
    "longer": (longer, "was changed by somebody else"),
}


@LONG
@pytest.mark.parametrize(("happens", "told"), BENEATH.values(), ids=BENEATH)
def test_what_happens_to_the_file_beneath_is_an_error_before_the_next_answer(
    tmp_path, happens, told
):
    journal = day(tmp_path)
    inc = fga.IncrementalAdjustment.resume(journal)
    n, at = len(inc), inc.estimate("P1")
    happens(journal)
    for command in (
        lambda: inc.add(SlopeDistance("P1", "P6", 5.0, sigma=5.0, id="late")),
        lambda: inc.remove("tape 0"),
        lambda: inc.reweight("tape 0", 2.0),
    ):
        with pytest.raises(InputError, match=told):
            command()
        assert len(inc) == n
        assert (inc.estimate("P1") == at).all()
    assert len(inc.network().observations) + inc.network().n_image_points == n
