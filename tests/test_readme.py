"""The README: short, and its commands run on a system that has nothing but Python."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from factorgraph_adj.cli.command_line import main
from tests.support.places import ROOT

SYSTEM = Path("/usr/bin")
"""Where Debian and Ubuntu have the Python that refuses to install into itself."""
PYTHON = SYSTEM / "python3"
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^```sh\n(.*?)```$", README, re.MULTILINE | re.DOTALL)
LEFT = ("__pycache__", "*.egg-info", ".venv*", ".git", ".*_cache", ".hypothesis", "_build", "build")
"""What a checkout does not hold."""


def test_the_readme_is_short_and_its_two_commands_are_a_line_each() -> None:
    assert len(README.splitlines()) <= 110
    assert len(COMMANDS) == 2
    for command in COMMANDS:
        assert command.count("\n") == 1
        assert "\\" not in command


def test_each_command_makes_and_uses_an_environment() -> None:
    for command in COMMANDS:
        make, *use = command.strip().split(" && ")
        assert make == "python3 -m venv .venv"
        assert use
        assert all(step.startswith(".venv/bin/") for step in use)


def test_the_readme_tells_what_debian_needs_besides_and_how_to_run_all_tests() -> None:
    assert "apt install python3-venv" in README
    assert "Python ≥ 3.11" in README
    short, marks, _ = COMMANDS[1].strip().split(" && ")[-1].partition(' -m "not slow"')
    assert marks
    assert f"`{short}` runs all tests" in README


def test_the_command_of_the_readme_adjusts_its_example(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    program, *arguments = shlex.split(COMMANDS[0].strip().rpartition("/bin/")[2])
    assert program == "factorgraph-adj"
    assert main(arguments) == 0
    assert "converged" in capsys.readouterr().out


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a line in a folder as a user does who has only the system's programs."""
    ours = ("PYTHON", "VIRTUAL_ENV", "PYENV", "CONDA")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    return subprocess.run(
        ["/bin/sh", "-c", command],
        cwd=folder,
        env=kept | {"PATH": str(SYSTEM)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow(
    "the first command of the README runs in a clean copy with the system's Python alone, which "
    "installs nothing into itself: the short tests have an environment already"
)
def test_the_first_command_runs_in_a_clean_copy_with_the_system_alone(tmp_path: Path) -> None:
    if not PYTHON.exists():
        pytest.skip(f"{PYTHON} is absent")
    if run("python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))'", tmp_path).returncode:
        pytest.skip(f"{PYTHON} is older than 3.11")
    if run("python3 -c 'import ensurepip'", tmp_path).returncode:
        pytest.skip(f"{PYTHON} has no ensurepip (Debian: apt install python3-venv)")
    asked = run("python3 -m venv ask && ask/bin/pip download --no-deps -d . setuptools", tmp_path)
    if asked.returncode:
        pytest.skip(f"packages cannot be installed here: {asked.stderr.strip()[-200:]}")
    copy = tmp_path / "factorgraph_adj"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT))
    done = run(COMMANDS[0], copy)
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout
