"""Cases that tests leave out: ``python -m tests.benchmarks.studies [OPTIONS OF PYTEST …]``.

More seeds, orders and networks of the sorts that tests have, and both engines where tests take them
in turn (hours). The exit code is that of pytest.
"""

from __future__ import annotations

import sys

import pytest

from tests.support.places import ROOT


def main(options: list[str]) -> int:
    """Run the studies, of the tests that are named or of all."""
    named = any(not o.startswith("-") for o in options)
    return int(pytest.main(["--studies", *options, *([] if named else [str(ROOT / "tests")])]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
