"""Docstrings of the package as reStructuredText.

They are plain text with formulas: what is indented after an empty line, and a paragraph with
indented lines in it, is shown as it stands, and the characters ``|``, ``*`` and a final ``_`` mean
themselves.
"""

from __future__ import annotations

import re
from itertools import groupby
from typing import Any

from pygments.lexers.special import TextLexer

SECTION = re.compile(r"^(Args|Raises|Returns|Yields|Attributes|Example|Examples|Note|Notes):\s*$")
ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")
"""How the name of a type in another type is shown."""
MADE = re.compile(r"^Create new instance of ")
"""What Python writes under a named tuple."""
CODE = re.compile(r"(``.+?``|`[^`]+`|\*\*\w[^*]*\*\*)")
"""Code, and what is bold."""
TABLE = re.compile(r"^=+( +=+)+$")
ITEM = re.compile(r"^\s*(- |\d+\. )")
MARKS = re.compile(r"([|*])|(?<=\w)(_)(?!\w)")


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def escaped(text: str) -> str:
    """Return a line in which no character is markup, except backticks."""
    parts = CODE.split(text)
    return "".join(p if i % 2 else MARKS.sub(r"\\\1\2", p) for i, p in enumerate(parts))


def _listings(lines: list[str]) -> list[str]:
    """Indent paragraphs with indented lines in them, such as formulas over several lines."""
    out: list[str] = []
    for empty, group in groupby(lines, key=lambda line: not line.strip()):
        paragraph = list(group)
        first = paragraph[0]
        plain = empty or _indent(first) or any(p.match(first) for p in (SECTION, ITEM, TABLE))
        if not plain and any(map(_indent, paragraph)):
            paragraph = ["    " + line for line in paragraph]
        out += paragraph
    return out


def as_markup(lines: list[str]) -> list[str]:
    """Return a docstring as reStructuredText that napoleon reads."""
    lines = _listings(lines)
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
            literal = not ITEM.match(line)
            previous = next((t for t in reversed(out) if t.strip()), "")
            if literal and not previous.endswith("::"):
                out += ["::", ""]
        table = table or TABLE.match(line) is not None
        keep = literal or table or line.lstrip().startswith(">>>") or line.endswith("::")
        out.append(line if keep else escaped(line))
    return out


def _process(
    app: Any, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    lines[:] = as_markup([line for line in lines if not MADE.match(line)])
    if what in ("attribute", "property", "data"):
        # Napoleon would take "R: radius" for the type R; an escaped newline shows nothing.
        lines.insert(0, "\\")


def _shorten(
    app: Any, what: str, name: str, obj: object, options: object, signature: str | None, back: str
) -> tuple[str | None, str]:
    """Name types by their aliases, and leave out what makes a default."""

    def short(text: str | None) -> str | None:
        return text and ALIAS.sub(r"\1", text).replace("<factory>", "...")

    return short(signature), short(back) or back


def setup(app: Any) -> dict[str, bool]:
    """Register before napoleon, which reads the sections; tables are shown as plain text."""
    app.add_lexer("csv", TextLexer)
    app.connect("autodoc-process-docstring", _process, priority=100)
    app.connect("autodoc-process-signature", _shorten)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
