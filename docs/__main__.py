"""Build the documentation and open it in a browser: ``python -m docs``.

It needs the extra ``docs``: ``pip install -e ".[docs]"``. Warnings are errors.
"""

from __future__ import annotations

import argparse
import sys
import webbrowser
from importlib.util import find_spec
from pathlib import Path

DOCS = Path(__file__).resolve().parent
BUILT = DOCS / "_build" / "html"


def main() -> int:
    """Build, open, and return the exit code of the build."""
    parser = argparse.ArgumentParser(prog="python -m docs", description=__doc__)
    parser.add_argument("--no-browser", action="store_true", help="build only")
    parser.add_argument("--fresh", action="store_true", help="build every page and picture anew")
    options = parser.parse_args()
    if find_spec("sphinx") is None:
        print('the documentation needs its extra: pip install -e ".[docs]"', file=sys.stderr)
        return 2
    from sphinx.cmd.build import main as build

    arguments = ["-b", "html", "-W", "--keep-going", "-q", str(DOCS), str(BUILT)]
    failed = build(["-E", "-a", *arguments] if options.fresh else arguments)
    index = BUILT / "index.html"
    if failed:
        return int(failed)
    print(index)
    if not options.no_browser:
        webbrowser.open(index.as_uri())
    return 0


if __name__ == "__main__":
    sys.exit(main())
