"""Cases that tests leave out: ``python -m tests.benchmarks.studies [OPTIONS OF PYTEST …]``.

More seeds, orders and networks of the sorts that tests have, and both engines where tests take them
in turn (hours). The exit code is that of pytest.
"""

from __future__ import annotations

import subprocess
import sys

from tests.support.places import ROOT


def main(options: list[str]) -> int:
    """Run the studies, of the tests that are named or of all."""
    command = [sys.executable, "-m", "pytest", "--studies", *options]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
