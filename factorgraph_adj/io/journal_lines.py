"""Lines of a journal: JSON objects in a chain of digests, written and checked.

A journal is a header ``{"journal": 4, …}`` and further lines, one entry each. Every line ends with
``"line"``, its number from 1, and ``"chain"``, the first `CHAIN_DIGITS` hexadecimal digits of
SHA-256 of the chain of the line before it (empty before the first) and of the line up to its own. A
line that is missing, occurs twice, was changed or comes from another journal breaks the chain.
Where the lines lie is the affair of a `JournalStore`: a file (`factorgraph_adj.io.journal`) or a
database (`factorgraph_adj.site.journal_table`).
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, Protocol

from ..errors import InputError, Problem

JOURNAL_VERSION = 4
"""Version of the format, the value of ``journal`` in the header; no other is read."""
CHAIN_DIGITS = 16
"""Hexadecimal digits of a link of the chain."""
_END = re.compile(rb'"line": ([0-9]{1,15}), "chain": "([0-9a-f]{%d})"\}$' % CHAIN_DIGITS)
"""How every line ends."""
_SHOWN = 60
"""Characters of a bad line that a message shows."""
_BEGIN = b'{"journal"'
"""How every header begins."""


class JournalStore(Protocol):
    """Where the lines of one journal lie."""

    @property
    def where(self) -> str:
        """Name of the place, for messages."""

    @property
    def folder(self) -> Path:
        """Folder in which files that the network names may lie, such as a geoid."""

    def begin(self, header: Mapping[str, object]) -> None:
        """Record the first line of a new journal."""

    def read(self) -> tuple[dict[str, Any], list[dict[str, Any]], str]:
        """Return the header, the entries, and what was torn at the end, to continue the journal."""

    def append(self, entry: Mapping[str, object]) -> None:
        """Record an entry; when this returns, it counts."""

    def close(self) -> None:
        """Give the journal back."""


class ChainLink(NamedTuple):
    """Place of a line in its journal."""

    number: int
    """Number of the line, from 1."""
    chain: str
    """What it and all lines before it come to."""

    def of(self, text: bytes) -> ChainLink:
        """Return the link of the next line, from the line before its end."""
        chain = hashlib.sha256(self.chain.encode() + text).hexdigest()[:CHAIN_DIGITS]
        return ChainLink(self.number + 1, chain)

    def end(self) -> bytes:
        """Return the end of the line."""
        return f'"line": {self.number}, "chain": "{self.chain}"}}'.encode()


INITIAL_LINK = ChainLink(0, "")
"""The link before the first line."""


def journal_line(
    entry: Mapping[str, object], where: str, before: ChainLink
) -> tuple[bytes, ChainLink]:
    """Return an entry as the line after another, and its link."""
    try:
        text = json.dumps(dict(entry), allow_nan=False, ensure_ascii=False).encode("utf-8")
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(Problem(f"cannot be recorded: {error}", where)) from None
    text = text[:-1] + (b", " if entry else b"")
    link = before.of(text)
    return text + link.end() + b"\n", link


def _links(raw: list[bytes], found: list[dict[str, Any]], where: str) -> ChainLink:
    """Return the link of the last line, and take the links out of what was found.

    Raises:
        InputError: lines that do not follow from the line before them, all of them.
    """
    before, problems = INITIAL_LINK, []
    for number, (line, entry) in enumerate(zip(raw, found, strict=True), start=1):
        end = _END.search(line)
        own = before.of(b"" if end is None else line[: end.start()])
        stated = ChainLink(number, "") if end is None else ChainLink(int(end[1]), end[2].decode())
        if end is None:
            what = "has no number and chain at its end: no journal was written so"
        elif stated.number != own.number:
            what = _number_problem(stated.number, before.number)
        elif stated != own:
            what = "was changed, or the line before it was, or comes from another journal"
        else:
            what = ""
        if what:
            problems.append(Problem(what, f"{where}:{number}"))
        before = stated
        entry.pop("line", None)
        entry.pop("chain", None)
    if problems:
        what = (
            "cannot be resumed: up to the line before the first of these it is whole; a copy that "
            "ends there resumes the state of that moment"
        )
        raise InputError([*problems, Problem(what, where)])
    return before


def _number_problem(stated: int, before: int) -> str:
    """Say what is wrong where the number of a line is not that after the line before."""
    if stated <= before:
        return (
            f"is line {stated} of the journal, which stands after line {before}: it is here twice"
        )
    lost = f"line {before + 1}" if stated == before + 2 else f"lines {before + 1} to {stated - 1}"
    return f"is line {stated} of the journal, after line {before}: {lost} of it is missing"


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def _parse(line: bytes) -> dict[str, Any] | None:
    """Return the object of a line; None where it is not one."""
    try:
        found = json.loads(line.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _shown(line: bytes) -> str:
    text = line[: 4 * _SHOWN].decode("utf-8", "replace")
    return repr(text[:_SHOWN]) + ("…" if len(text) > _SHOWN else "")


def whole_lines(data: bytes, where: str) -> tuple[list[dict[str, Any]], str, int, ChainLink]:
    """Return the objects of all whole lines, what is torn, the bytes to keep, and the last link.

    Raises:
        InputError: this is not a journal, or a line before the last one is bad, or out of turn.
    """
    if not data:
        raise InputError(Problem("is empty: nothing had been recorded", where))
    raw = data.split(b"\n")
    if raw[-1] == b"":
        raw.pop()
    found = [_parse(line) for line in raw]
    header = found[0]
    if header is None:
        own = raw[0].startswith(_BEGIN) or _BEGIN.startswith(raw[0])
        if len(raw) == 1 and own:
            what = f"holds only a torn line, {_shown(raw[0])}: nothing had been recorded"
            raise InputError(Problem(what, f"{where}:1"))
        what = "is not a journal: the first line is not its header {…}"
        raise InputError(Problem(what, where))
    if "journal" not in header:
        what = 'is not a journal: its first line lacks "journal"'
        raise InputError(Problem(what, where))
    if header["journal"] != JOURNAL_VERSION or isinstance(header["journal"], bool):
        what = (
            f"is a journal of version {header['journal']!r}; valid: {JOURNAL_VERSION}. The version "
            "of the program that wrote it can resume it, and save what is in the graph as a project"
        )
        raise InputError(Problem(what, where))
    torn, keep = "", len(data)
    if found[-1] is None:
        torn = f"{where}:{len(raw)}: the last line was torn and is left out: {_shown(raw[-1])}"
        keep = sum(len(line) + 1 for line in raw[:-1])
        found.pop()
    bad = [number for number, entry in enumerate(found, start=1) if entry is None]
    if bad:
        raise InputError(
            Problem(f"is not an object of JSON: {_shown(raw[n - 1])}", f"{where}:{n}") for n in bad
        )
    entries = [entry for entry in found if entry is not None]
    return entries, torn, keep, _links(raw[: len(entries)], entries, where)
