"""Where a message says that a file is wrong: a line that the file has, or a place in its bytes."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from factorgraph_adj.errors import Problem

OF_A_WHOLE_FILE = {
    "absent": r"no such file|cannot be read|cannot be opened",
    "empty": r"is empty|has no header, or no rows|there are no points",
    "another encoding": r"UTF-16|is not readable XML",
    "of another format": r"is (no|none of|not a) ",
    "too many problems": r"^and \d+ (further|more) problems",
    "nested without end": r"^is nested too deeply",
}
"""Problems of a file as a whole, which have no line: kind, and how they are said."""
OF_A_LINK = r"\bsymbolic link\b"
"""A path that a symbolic link leads out: its file is named, with the table, not always a line."""
OF_A_NETWORK = r"network '"
"""Beginning of the place of a problem that no file has alone, such as a missing datum."""
IN_BYTES = r"@\d|\bbyte \d|\bbytes\b|\brecord \d|\brow \d|\bnumber \d|\bvertex \d|\bvertices\b|/\w+"
"""How a place in a file that is no text is said: byte, record, or the member of an archive."""


def misplaced(
    problem: Problem,
    files: Mapping[str, bytes],
    whole: Mapping[str, bytes],
    *,
    folder: str = "",
    options: Collection[str] = (),
) -> str:
    """Say what is wrong with the place of a problem; empty: nothing.

    Args:
        problem: the problem.
        files: contents of the files as they were read.
        whole: contents of the undamaged files: those that are text there have lines.
        folder: name of the folder, where the reader begins with it.
        options: options of the reader, which a problem may be about.
    """
    what, where = problem.what, problem.where
    if not what.strip():
        return "says nothing"
    if any(re.search(rf"\b{o}: ", f"{where}: {what}") for o in options):
        return ""
    if re.match(OF_A_NETWORK, where):
        return ""
    of_all = any(re.search(r, what) for r in OF_A_WHOLE_FILE.values())
    named = [n for n in whole if re.search(rf"(^|[/\s]){re.escape(n)}(?![\w.])", where)]
    if not named:
        return "" if of_all and folder and folder in where else "names no file"
    faults = [_in_file(n, where, what, of_all, files.get(n, b""), whole[n]) for n in named]
    return min(faults, key=len)


def _in_file(name: str, where: str, what: str, of_all: bool, now: bytes, before: bytes) -> str:
    rest = where[where.rfind(name) + len(name) :]
    if of_all and not rest:
        return ""
    if not is_text(before):
        return "" if re.search(IN_BYTES, f"{rest} {what}") else "names no place in the bytes"
    line = re.match(r":(\d+)\b", rest)
    if line is None:
        return "" if re.search(OF_A_LINK, what) else "names no line"
    last = len(re.split(rb"\r\n|\r|\n", now))
    return "" if 1 <= int(line[1]) <= last else f"names line {line[1]} of {last}"


def is_text(content: bytes) -> bool:
    """Return whether an undamaged file is text."""
    try:
        return "\0" not in content.decode()
    except UnicodeDecodeError:
        return False
