"""JSON text is that of `json.dumps`, and has no numbers that JSON does not have."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factorgraph_adj.report.layout import finite_json, json_text

SIMPLE = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
VALUES = st.recursive(
    SIMPLE,
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
    max_leaves=30,
)


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
@given(VALUES)
def test_text_is_that_of_the_standard_library(value: Any) -> None:
    assert json_text(value) == json.dumps(value, indent=1, ensure_ascii=False)


@pytest.mark.parametrize(
    "value", [[np.float64(0.1), 2], {"a": np.float64(1e300)}, [[], {}, [[1.5]], {"b": ()}]]
)
def test_numbers_of_numpy_and_empty_members_are_written_likewise(value: Any) -> None:
    assert json_text(value) == json.dumps(value, indent=1, ensure_ascii=False)


def test_what_is_not_finite_is_null_at_any_depth_and_minus_zero_is_zero() -> None:
    nan, inf = float("nan"), float("inf")
    given = {"a": [1.0, nan, -inf], "b": {"c": [nan, "x", [-0.0, (nan, 1)]]}, "d": np.float64(nan)}
    expected = '{"a":[1.0,null,null],"b":{"c":[null,"x",[0.0,[null,1]]]},"d":null}'
    assert json.dumps(finite_json(given), separators=(",", ":")) == expected
