"""Examples of every format that can be read: those of all modules of tests that state any."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

from tests.hostile.examples import Example
from tests.support.places import ROOT

OPTIONS = ("fixed",)
"""Options of readers that problems may be about."""


def _stated() -> Iterator[tuple[str, Example]]:
    """Yield the examples that modules state as ``EXAMPLE_FILES``."""
    for path in sorted((ROOT / "tests").rglob("*.py")):
        if "\nEXAMPLE_FILES" in path.read_text(encoding="utf-8"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            yield from import_module(name).EXAMPLE_FILES.items()


FORMATS: dict[str, Example] = dict(_stated())
"""Examples by name, one at least for each row of the table of formats."""
