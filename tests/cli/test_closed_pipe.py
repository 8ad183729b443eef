"""A reader that closes the pipe early changes no exit code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.field_mistakes.mistakes import MISTAKES
from tests.field_mistakes.projects import yard
from tests.support.processes import HANGS

LINES = 3


def first_lines(*arguments: object) -> tuple[int, list[str]]:
    """Read a few lines of a command, then close its output; return its exit code too."""
    command = [sys.executable, "-m", "factorgraph_adj", *map(str, arguments)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(LINES)]
        process.stdout.close()
        return process.wait(HANGS), lines


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("a letter O in a number", 2),
        ("distances in feet", 1),
        ("height of the instrument 0.1 m too large", 1),
        ("", 0),
    ],
)
def test_the_exit_code_stays(name: str, code: int, tmp_path: Path) -> None:
    found = [m for m in MISTAKES if m.name == name]
    project = (found[0].make() if found else yard()).write(tmp_path / "yard")
    command = found[0].command[0] if found else "adjust"
    done, lines = first_lines(command, project)
    assert done == code
    assert any(lines)
