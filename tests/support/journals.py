"""Journals whose content was changed, with links that hold: what else is wrong shows then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from factorgraph_adj.io.journal import Journal


def read(path: Path) -> list[dict[str, Any]]:
    """Return the header and the entries of a journal."""
    journal, header, entries, torn = Journal.open(path, durable=False)
    journal.close()
    assert not torn
    return [header, *entries]


def write(path: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    """Write a journal anew."""
    path.unlink(missing_ok=True)
    header, *entries = lines
    with Journal.create(path, {k: v for k, v in header.items() if k != "journal"}) as journal:
        for entry in entries:
            journal.append(entry)
