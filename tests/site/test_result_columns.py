"""Results of epochs in parts: each record is in one of them, and together they are the result."""

from __future__ import annotations

import json

import pytest

from factorgraph_adj.site.result_columns import joined, parted

WHOLE = {
    "time": 5.0,
    "sigma0": 1.0,
    "estimate": {"names": ["A", "B"]},
    "points": [{"name": "B", "x": 1.0}, {"name": "A", "x": 2.0}],
    "findings": {
        "problem": "",
        "against": 1,
        "displacements": [{"name": "A", "dx_mm": 1.0}, {"name": "B", "dx_mm": 2.0}],
        "tests": [
            {"point": "A", "rule": "r", "exceeds": True},
            {"point": "", "rule": "of the reference", "exceeds": False},
            {"point": "A", "rule": "s", "exceeds": False},
        ],
        "motions": {"A": {"T": 1.0}},
    },
}
NOT_COMPARED = {"time": 5.0, "problem": "no point", "points": [], "findings": {"problem": "why"}}


@pytest.mark.parametrize(
    "result", [WHOLE, NOT_COMPARED, {"time": 1.0, "points": [], "estimate": None}, {"time": 1.0}]
)
def test_the_parts_of_a_result_are_together_the_result(result):
    before = json.dumps(result)
    summary, points, rest = json.loads(json.dumps(parted(result)))
    assert joined(summary, points, rest) == result
    assert json.dumps(result) == before, "nothing of it changes"
    assert not summary.keys() - {"findings"} & rest.keys()
    assert not (summary["findings"].keys() & rest.get("findings", {}).keys())


def test_no_record_of_a_point_is_kept_twice():
    summary, points, rest = parted(WHOLE)
    assert rest["points"] == rest["findings"]["tests"] == rest["findings"]["displacements"] == []
    assert rest["findings"]["motions"] == {} and points.keys() == {"A", "B", ""}
    assert len(points["A"]["tests"]) == 2 and "estimate" not in summary
