"""A journal with a damaged line is refused with file and line, not with an error of Python."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError

JOURNAL = Path(__file__).with_name("version_1.jsonl")


def damaged(folder: Path, line: int, key: str, value: Any) -> Path:
    """Return a journal of which one entry of a line has another value; None: it is absent."""
    out = Path(shutil.copy(JOURNAL, folder))
    lines = [json.loads(text) for text in out.read_text().splitlines()]
    if value is None:
        del lines[line - 1][key]
    else:
        lines[line - 1][key] = value
    out.write_text("".join(json.dumps(each) + "\n" for each in lines))
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
    "no options": (1, "options", None, "the options must be accuracy, alpha, datum, policy"),
    "another option": (1, "options", {"3ccuracy": 0.01}, "the options must be accuracy, alpha"),
    "no files": (1, "files", None, "the line has no files of a network"),
    "an unknown point": (
        3,
        "observations",
        [{**OBSERVATION, "target": "P{"}],
        "unknown point 'P{'; known: ",
    ),
    "text for a list": (3, "accepted", 3, "the line is damaged: TypeError"),
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
