"""Where the repository, its examples and real measurements lie; what tests do without the last."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""Root of the repository: the folder of README.md and pyproject.toml."""
EXAMPLES = ROOT / "examples"
"""Folder of the example scripts and projects."""
DATA = Path(os.environ.get("FACTORGRAPH_ADJ_DATA", ROOT.parent / "shared" / "data"))
"""Folder of real measurements, one folder in it for each data set."""
ABSENT = "real measurements"
"""Beginning of the reason for which a test is skipped that has no data."""


def where_data_come_from(number: int) -> str:
    """Return how many tests were skipped without real measurements, and how to get these."""
    return (
        f"{number} tests were skipped, because the {ABSENT} of other projects are not part of this "
        "repository. The module of each test names the project and its commit: copy its files into "
        f"{DATA}/NAME, or set FACTORGRAPH_ADJ_DATA; see docs/results/measurements.md"
    )


def data_dir(name: str) -> Path:
    """Return the folder of a data set; skip the test, saying why, where it is absent."""
    folder = DATA / name
    if not folder.is_dir():
        import pytest  # benchmarks import this module in environments without pytest

        pytest.skip(f"{ABSENT} {name!r} are not at {DATA} (set FACTORGRAPH_ADJ_DATA)")
    return folder
