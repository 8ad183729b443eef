"""The README's scripts run and print what it says."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from tests.support.places import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
SCRIPTS = [m.group(1) for m in re.finditer(r"```python\n(.*?)```", README, re.DOTALL)]
OUTPUTS = dict(
    re.findall(r"```python\n(.*?)```\n+[^\n#`]{0,80}\n*```\n(.*?)```", README, re.DOTALL)
)


@pytest.mark.parametrize("number", range(len(SCRIPTS)))
def test_every_script_of_the_readme_runs_and_prints_what_is_shown(number: int) -> None:
    script = SCRIPTS[number]
    done = subprocess.run(
        [sys.executable, "-X", "utf8", "-W", "error", "-c", script],
        capture_output=True,
        encoding="utf-8",
        cwd=ROOT,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    if script in OUTPUTS:
        assert done.stdout.split() == OUTPUTS[script].split()


def test_at_least_two_scripts_are_shown_with_their_output() -> None:
    assert len(OUTPUTS) >= 2
