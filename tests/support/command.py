"""What the command writes, and where."""

from __future__ import annotations

import io
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from factorgraph_adj.cli.command_line import main

FILES = {
    *("report.txt", "results.json", "points.csv", "photos.csv"),
    *("observations.csv", "unknowns.csv", "given_values.csv"),
}


def contents(folder: Path) -> dict[str, bytes]:
    return {f.name: f.read_bytes() for f in folder.iterdir()}


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def here(capsys: pytest.CaptureFixture[str]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the command in this process, which is sooner than in one of its own."""

    def run_here(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = list(map(str, arguments))
        code: Any
        try:
            code = main(command)
        except SystemExit as stop:  # argparse
            code = stop.code
        return subprocess.CompletedProcess(command, code, *capsys.readouterr())

    return run_here
