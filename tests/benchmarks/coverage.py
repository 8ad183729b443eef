"""Which lines the short tests run: ``python -m tests.benchmarks.coverage [TESTS …]``.

Runs ``pytest -n auto -m "not slow"`` under coverage.py, in all its processes, and prints the share
of the lines of functions that ran, in the package and in each module below a limit; exit code 1:
there are such modules, or tests failed. What stands outside of functions runs when a module is
imported, which proves nothing: it does not count.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.places import ROOT

LEAST_PERCENT = 40.0
"""Share of the lines of functions of a module that the short tests are to run."""
LEAST_SHOWN = 10
"""How many modules are shown at least."""
SETTINGS = """
[run]
source = {root}/factorgraph_adj
parallel = true
data_file = {folder}/data
patch = _exit, subprocess
[report]
exclude_also = if TYPE_CHECKING:
"""


def ran(tests: list[str], folder: Path) -> tuple[int, dict[str, tuple[int, int]]]:
    """Run tests; return their exit code, and the lines of functions: of each module, and run."""
    settings = folder / "settings"
    settings.write_text(SETTINGS.format(root=ROOT, folder=folder), encoding="utf-8")
    command = [sys.executable, "-m", "coverage"]
    those = tests or ["-n", "auto", "-m", "not slow"]
    tested = [*command, "run", f"--rcfile={settings}", "-m", "pytest", "-p", "no:cacheprovider"]
    code = subprocess.run([*tested, *those], cwd=ROOT, check=False).returncode
    for step in (["combine", "--quiet"], ["json", "--quiet", "-o", str(folder / "found.json")]):
        subprocess.run([*command, *step, f"--rcfile={settings}"], cwd=ROOT, check=True)
    found = json.loads((folder / "found.json").read_text(encoding="utf-8"))
    lines = {}
    for module, of in found["files"].items():
        inner = [f["summary"] for name, f in of["functions"].items() if name]
        count = sum(s["num_statements"] for s in inner)
        lines[module] = count, sum(s["covered_lines"] for s in inner)
    return code, lines


def main(tests: list[str]) -> int:
    """Print the figures."""
    with TemporaryDirectory() as folder:
        code, found = ran(tests, Path(folder))
    lines, covered = (sum(column) for column in zip(*found.values(), strict=True))
    shares = sorted((100.0 * c / n, name) for name, (n, c) in found.items() if n)
    low = [each for each in shares if each[0] < LEAST_PERCENT]
    print(f"{100.0 * covered / lines:.1f} % of {lines} lines of functions in {len(shares)} modules")
    print(f"{len(low)} modules below {LEAST_PERCENT:g} %; the least covered:")
    for share, name in shares[: max(len(low), LEAST_SHOWN)]:
        print(f"{share:5.1f} %  {name}")
    return 1 if low else code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
