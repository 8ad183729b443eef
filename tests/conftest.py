"""Where real measurements lie, and what tests do without them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

DATA = Path(
    os.environ.get("FACTORGRAPH_ADJ_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
)


def data_dir(name: str) -> Path:
    """Return the folder of a data set; skip the test, saying why, where it is absent."""
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"real measurements {name!r} are not at {DATA} (set FACTORGRAPH_ADJ_DATA)")
    return folder
