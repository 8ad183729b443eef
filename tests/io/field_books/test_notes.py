"""Notes of field books: one rule for all of them, left out and counted with their text."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.source import NOTES
from tests.hostile.formats import FORMATS

TEXT = "wind from the east"


def behind(begin: str, added: str) -> Callable[[str], str]:
    """Return a function that adds a line behind the first one with a beginning."""

    def change(text: str) -> str:
        lines = text.splitlines(keepends=True)
        at = next(i for i, line in enumerate(lines) if line.lstrip().startswith(begin))
        return "".join([*lines[: at + 1], added + "\n", *lines[at + 1 :]])

    return change


def at_first(before: str, after: str) -> Callable[[str], str]:
    """Return a function that replaces the first occurrence of a text."""
    return lambda text: text.replace(before, after, 1)


NOTED: dict[str, Callable[[str], str]] = {
    "sdr33": behind("10NM", f"13NM{TEXT}"),
    "nikon_raw": behind("CO,QUARRY", f"CO,{TEXT}"),
    "rw5": behind("MO,", f"--{TEXT}"),
    "jobxml": at_first(
        "<FieldBook>",
        f"<FieldBook><NoteRecord ID='n'><Notes><Note>{TEXT}</Note></Notes></NoteRecord>",
    ),
    "topcon gts7": behind("UNITS", f"NOTE  {TEXT}"),
    "sokkia-scr": lambda text: f"N,{TEXT}\n{text}",
}
"""How a note is added to the example of a format."""


def notes(network: fga.Network) -> list[str]:
    """Return the texts of notes that are left out."""
    return [n for left in network.left_out if left.what == NOTES.what for n in left.names]


@pytest.mark.parametrize("name", NOTED)
def test_a_note_is_left_out_and_counted_with_its_text(tmp_path, name):
    book = FORMATS[name]
    path = book.write(tmp_path)
    before = book.reads(path)
    path.write_text(NOTED[name](path.read_text(encoding="utf-8")), encoding="utf-8")
    network = book.reads(path)
    counts = [
        sum(left.count for left in n.left_out if left.what == NOTES.what) for n in (before, network)
    ]
    assert counts[1] == counts[0] + 1
    assert TEXT in notes(network)
    assert [o.value for o in network.observations.values()] == [
        o.value for o in before.observations.values()
    ]


def test_words_of_remarks_of_gsi_count_unless_they_are_empty(tmp_path):
    path = FORMATS["gsi"].write(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("*11"))
    lines[at] = f"{lines[at].rstrip()} 71....+{0:016d} 72....+{'WIND':0>16} "
    path.write_text("\n".join(lines), encoding="utf-8")
    assert notes(FORMATS["gsi"].reads(path)) == ["WIND"]


def test_the_note_of_a_station_of_geozseni_is_left_out(tmp_path):
    path = tmp_path / "book.gjk"
    path.write_text(f"GJK,2\nAP,S,,1.5,,,,,,{TEXT}\nAM,A,,1.6,,,0,,,90,,,10\n", encoding="utf-8")
    assert notes(fga.read(path)) == [TEXT]
