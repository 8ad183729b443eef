"""LGC2: inputs that stand as strings in the headers of its tests."""

from __future__ import annotations

import re
from pathlib import Path


def texts(path: Path) -> dict[str, str]:
    """Return the inputs in a C++ header by name."""
    source = path.read_text(encoding="latin-1")
    found = {}
    for match in re.finditer(r"char const \*const (\w+) =\s*(.*?)\s*;\s*\n", source, re.DOTALL):
        name, body = match.groups()
        raw = re.fullmatch(r'R"\((.*)\)"', body, re.DOTALL)
        body = re.sub(r"(?m)^\s*//.*$|/\*.*?\*/", "", body)
        parts = re.findall(r'"((?:[^"\\]|\\.)*)"', body)
        text = raw[1] if raw else "".join(parts).replace("\\n", "\n").replace("\\t", "\t")
        found[name] = text
    return found
