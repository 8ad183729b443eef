"""Cases of tests that only ``python -m tests.benchmarks.studies`` runs, and engines in turn.

A test keeps a case of each sort, and those in which something once was wrong; more of the same
sort are a study.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest

STUDY, LONG, TOGETHER = "study", "slow", "one_engine"
"""Names of markers: long tests take the engines in turn, or all those of a module take one."""
ENGINES = ("isam2", "fronts")


def cases(values: Iterable[Any], tested: Iterable[Any]) -> list[Any]:
    """Return parameters, marked ones too, of which all but those that are tested are a study."""
    every, some = list(values), list(tested)
    assert some and all(v in map(_plain, every) for v in some), "they are among all cases"
    return [v if _plain(v) in some else _in_study(v) for v in every]


def _plain(value: Any) -> Any:
    """Return a parameter without marks."""
    if not isinstance(value, type(pytest.param())):
        return value
    return value.values[0] if len(value.values) == 1 else value.values


def _in_study(value: Any) -> Any:
    mark = getattr(pytest.mark, STUDY)
    if isinstance(value, type(pytest.param())):
        return pytest.param(*value.values, id=value.id, marks=(*value.marks, mark))
    return pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=mark)


def without_studies(items: Sequence[pytest.Item]) -> tuple[list[pytest.Item], list[pytest.Item]]:
    """Return the tests without studies, and the studies.

    Of the long tests of a module that run on both engines, every case runs on one engine, the next
    on the other one; all of them on both are a study. Short tests run on both.
    """
    kept: list[pytest.Item] = []
    left: list[pytest.Item] = []
    numbers: dict[Path, dict[str, int]] = {}
    for item in items:
        study = item.get_closest_marker(STUDY) is not None
        engine, case = _engine_and_case(item)
        if not study and engine in ENGINES and item.get_closest_marker(LONG):
            seen = numbers.setdefault(item.path, {})
            turn = 0 if item.get_closest_marker(TOGETHER) else seen.setdefault(case, len(seen))
            study = engine != ENGINES[turn % len(ENGINES)]
        (left if study else kept).append(item)
    return kept, left


def _engine_and_case(item: pytest.Item) -> tuple[str, str]:
    """Return the engine of a test, if it has one, and its name with the other parameters."""
    parameters = dict(item.callspec.params) if hasattr(item, "callspec") else {}
    engine = str(parameters.pop("engine", ""))
    return engine, f"{getattr(item, 'originalname', '')} {parameters}"
