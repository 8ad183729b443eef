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


def data_dir(name: str) -> Path:
    """Return the folder of a data set; skip the test, saying why, where it is absent."""
    folder = DATA / name
    if not folder.is_dir():
        import pytest  # benchmarks import this module in environments without pytest

        pytest.skip(f"real measurements {name!r} are not at {DATA} (set FACTORGRAPH_ADJ_DATA)")
    return folder
