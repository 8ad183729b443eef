"""``python -m factorgraph_adj`` is the command ``factorgraph-adj``."""

import sys

from .cli.command_line import main

if __name__ == "__main__":
    sys.exit(main())
