"""Counts of the checklist of the papers: a line with a marker becomes their table."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parents[1] / "results" / "checklist.md"
"""The page with the rows."""
COUNTS = "<!-- counts of the checklist -->"
STATES = {
    "✔": "there",
    "◐": "in part",
    "✖": "not there",
    "–": "without counterpart",
}
"""Meaning of the marks."""


@dataclass(frozen=True)
class Row:
    """A row of the checklist."""

    name: str
    """Letter of its part, and number."""
    paper: str
    """Words of the paper."""
    state: str
    """A key of `STATES`."""
    here: str
    """What it is here."""
    shown: str
    """Tests and commands that show it."""


def rows_by_part() -> dict[str, list[Row]]:
    """Return the rows of the checklist by the title of their part."""
    found: dict[str, list[Row]] = {}
    for title, body in re.findall(
        r"^## (.*?)$(.*?)(?=^## |\Z)", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S
    ):
        lines = re.findall(r"^\| [A-Z]\d+ \|.*$", body, flags=re.M)
        cells = [[c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
        found[title] = [Row(*row) for row in cells]
    return found


def counts_of_checklist() -> str:
    """Return a table with the number of rows of each state, by part."""
    parts = rows_by_part()
    parts["all"] = [row for rows in parts.values() for row in rows]
    heading = " | ".join(f"{mark} {meaning}" for mark, meaning in STATES.items())
    out = [f"| part | rows | {heading} |", "| --- |" + " --- |" * (1 + len(STATES))]
    for title, rows in parts.items():
        count = Counter(row.state for row in rows)
        cells = " | ".join(f"{count[mark]}" for mark in STATES)
        out.append(f"| {title} | {len(rows)} | {cells} |")
    return "\n".join(out) + "\n"


def with_counts(text: str) -> str:
    """Return a page with the table in the place of its marker."""
    return text.replace(f"{COUNTS}\n", counts_of_checklist()) if COUNTS in text else text


def _read(app: Any, name: str, source: list[str]) -> None:
    source[0] = with_counts(source[0])


def setup(app: Any) -> dict[str, bool]:
    """Fill pages as they are read."""
    app.connect("source-read", _read)
    app.connect("env-get-outdated", lambda *_: ["results/papers"])
    return {"parallel_read_safe": True, "parallel_write_safe": True}
