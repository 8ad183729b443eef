"""Docstrings of the package as reStructuredText.

They are plain text with formulas: what is indented after an empty line is shown as it stands,
and the characters ``|``, ``*`` and a final ``_`` mean themselves.
"""

from __future__ import annotations

import re
from typing import Any

SECTION = re.compile(r"^(Args|Raises|Returns|Yields|Attributes|Example|Examples|Note|Notes):\s*$")
CODE = re.compile(r"(``.+?``|`[^`]+`)")
MARKS = re.compile(r"([|*])|(?<=\w)(_)(?!\w)")


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def escaped(text: str) -> str:
    """Return a line in which no character is markup, except backticks."""
    parts = CODE.split(text)
    return "".join(p if i % 2 else MARKS.sub(r"\\\1\2", p) for i, p in enumerate(parts))


def as_markup(lines: list[str]) -> list[str]:
    """Return a docstring as reStructuredText that napoleon reads."""
    out: list[str] = []
    in_section = literal = table = False
    for number, line in enumerate(lines):
        before = lines[number - 1] if number else ""
        if not line.strip():
            out.append("")
            table = False
            continue
        if not _indent(line):
            in_section = bool(SECTION.match(line))
            literal = False
        elif not in_section and not before.strip() and not literal:
            literal = not re.match(r"^\s*(- |\d+\. )", line)
            previous = next((t for t in reversed(out) if t.strip()), "")
            if literal and not previous.endswith("::"):
                out += ["::", ""]
        table = table or re.match(r"^=+( +=+)+$", line) is not None
        keep = literal or table or line.lstrip().startswith(">>>") or line.endswith("::")
        out.append(line if keep else escaped(line))
    return out


def _process(
    app: Any, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    lines[:] = as_markup(lines)


def setup(app: Any) -> dict[str, bool]:
    """Register before napoleon, which reads the sections."""
    app.connect("autodoc-process-docstring", _process, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
