"""Members of results files, compared with those that their schema describes."""

from __future__ import annotations

from typing import Any, Literal

import pytest

import factorgraph_adj as fga

SCHEMA_FILES = {"adjustment": "results.schema.json", "epochs": "epochs.schema.json"}
"""Files of the schemas in `report/`."""


def contradictions(found: Any, of: Literal["adjustment", "epochs"] = "adjustment") -> list[str]:
    """Return where results differ from their schema; of an unknown member, where to add it."""
    jsonschema = pytest.importorskip("jsonschema")
    out = []
    for error in jsonschema.Draft202012Validator(fga.results_schema(of)).iter_errors(found):
        if error.validator == "additionalProperties":
            for name in sorted(set(error.instance) - set(error.schema.get("properties", ()))):
                out.append(
                    f"add the member {name} to report/{SCHEMA_FILES[of]}, which does not describe "
                    f"it at {error.json_path}"
                )
        else:
            out.append(f"{error.json_path}: {error.message}")
    return out


def assert_described(found: Any, of: Literal["adjustment", "epochs"] = "adjustment") -> None:
    """Results are as their schema says."""
    different = contradictions(found, of)
    assert not different, "\n".join(different)


def assert_only_added(
    found: Any, name: str, of: Literal["adjustment", "epochs"] = "adjustment"
) -> None:
    """Results have a member that their schema does not describe yet, and nothing else is wrong."""
    different = contradictions(found, of)
    assert different
    told = f"add the member {name} to report/{SCHEMA_FILES[of]}, which does not describe it at "
    assert all(line.startswith(told) for line in different), "\n".join(different)
