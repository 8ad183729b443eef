"""Scripts of other projects that the report holds, and how data are packed into it.

The scripts come from the installed packages: plotly.js (MIT) from ``plotly``, DataTables with
jQuery (MIT) from ``itables``.
"""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

from ...errors import InputError

NEEDED = ("jinja2", "plotly", "itables")
"""Packages of the extra."""
MISSING = "the report needs {names}: pip install 'factorgraph_adj[report]'"
"""Message where some of them are not installed."""
LEVEL = 6
"""Level of compression of data; libraries, which stay the same, have the best one."""


@dataclass(frozen=True)
class Libraries:
    """Packed scripts and styles."""

    plotly: str
    """plotly.js."""
    tables: str
    """DataTables with its extensions, a module of JavaScript."""
    style: str
    """Style sheet of DataTables."""


def refuse_missing() -> None:
    """Raise the packages that are not installed.

    Raises:
        InputError: some are not; the message says how to install them.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise InputError(MISSING.format(names=", ".join(missing)))


@cache
def libraries() -> Libraries:
    """Return the scripts of the installed packages, packed once in a process."""
    from plotly.offline import get_plotlyjs

    folder = files("itables") / "html"
    return Libraries(
        _packed(get_plotlyjs().encode(), 9),
        _packed((folder / "dt_bundle.js").read_bytes(), 9),
        _packed((folder / "dt_bundle.css").read_bytes(), 9),
    )


def packed(data: Any) -> str:
    """Return data as JSON, packed by gzip and written in base64, which needs no escaping."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return _packed(text.encode(), LEVEL)


def _packed(data: bytes, level: int) -> str:
    # No time stamp: the same report gives the same file.
    return b64encode(gzip.compress(data, level, mtime=0)).decode("ascii")
