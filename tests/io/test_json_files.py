"""Lines of values in JSON files: right, and found by scanning each object and array once."""

from __future__ import annotations

import json

from factorgraph_adj.io.json_files import JsonFile, parse_json
from factorgraph_adj.io.source import Problems

TEXT = """

{
  "a": [1,
        2, [3,
      4]],
  "b\\u0041":
     {"c, {": "]", "d": []},
  "e": {}
}
"""


def test_lines_are_those_of_values():
    root = parse_json(TEXT, "x.json")
    a, b = root.need("a"), root.need("bA")
    nodes = [root, a, *a.list(), *list(a.list())[2].list(), b, b.need("c, {"), root.need("e")]
    assert [n.where for n in nodes] == [f"x.json:{k}" for k in (3, 4, 4, 5, 5, 5, 6, 8, 8, 9)]
    assert root.file.line(("e", "absent")) == 9


def test_numbers_without_a_problem_ask_for_no_line_and_others_scan_each_array_once(monkeypatch):
    """Time of a file with problems or places of all its values grows with its size alone."""
    scanned = []
    places = JsonFile._places
    monkeypatch.setattr(
        JsonFile, "_places", lambda self, at: scanned.append(at) or places(self, at)
    )
    photos = {f"photo {i}": {"position": [1.0, "two", 3.0 * i]} for i in range(20)}
    root, problems = parse_json(json.dumps(photos, indent=1), "x.json"), Problems()
    positions = [photo.need("position") for _, photo in root.items()]
    for position in positions:
        for k in (0, 2):
            list(position.list())[k].field(problems).number()
    assert not scanned and not problems.count
    for _ in range(2):
        for position in positions:
            list(position.list())[1].field(problems).number()
    assert problems.count == 20
    assert len(scanned) == len(set(scanned)) == 1 + 2 * 20
    assert [p.where for p in problems.ordered()] == [f"x.json:{5 + 7 * i}" for i in range(20)]
