"""What the command writes, and where."""

from __future__ import annotations

import io
from pathlib import Path

FILES = {
    *("protocol.txt", "results.json", "points.csv", "photos.csv"),
    *("observations.csv", "unknowns.csv", "given_values.csv"),
}


def contents(folder: Path) -> dict[str, bytes]:
    return {f.name: f.read_bytes() for f in folder.iterdir()}


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True
