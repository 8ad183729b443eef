"""Lines of SNAP's files: comments, continuation, quoted words, dates, names with wildcards.

Format: LINZ, SNAP help, and ``datafile.c``, ``dateutil.c`` of the program (BSD-3).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import date, datetime, time
from pathlib import Path

from ..source import Field, TextSource

COMMENT, CONTINUATION = "!", "&"
_WORD = re.compile(r"(?:\"[^\"]*\"|'[^']*'|[^\s\"']|[\"'](?![^\"']*[\"']))+")
"""A word: letters, and parts in quotes."""
MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_MONTH = r"(?P<month>[A-Za-z]{3,9}|\d{1,2})"
_TIME = r"(?:[T:\s]+(?P<hour>\d{1,2})(?::(?P<minute>\d{1,2}))(?::(?P<second>\d{1,2}))?)?"
_DATES = (
    re.compile(
        r"(?P<year>\d{4})(?P<month>\d{2})(?P<day>\d{2})"
        r"(?:(?P<hour>\d{2})(?P<minute>\d{2})(?P<second>\d{2})?)?"
    ),
    re.compile(rf"(?P<year>\d{{4}})[-/\s]+{_MONTH}[-/\s]+(?P<day>\d{{1,2}}){_TIME}"),
    re.compile(rf"(?P<day>\d{{1,2}})[-/\s]*{_MONTH}[-/\s]*(?P<year>\d{{4}}){_TIME}"),
)
"""Forms of dates: 20080113, 2008-01-13T12:50:25, 13 Jan 2008 12:50."""
_DECIMAL_YEAR = re.compile(r"\d{4}(?:\.\d*)?")


def records(source: TextSource) -> Iterator[tuple[int, str]]:
    """Yield the lines that are not blank, without comments, continued ones joined."""
    begun, text = 0, ""
    for number, line in source.numbered():
        part = line.partition(COMMENT)[0].rstrip()
        begun = begun or number
        if part.endswith(CONTINUATION) and part[:-1][-1:].isspace():
            text += part[:-1] + " "
            continue
        text += part
        if text.strip():
            yield begun, text.strip()
        begun, text = 0, ""
    if text.strip():
        source.wrong(begun, "the file ends within a line that '&' continues")


def words_of(text: str) -> list[str]:
    """Return the words of a line; quotes hold together what has blanks.

    >>> words_of('data_file "my data.dat" csv')
    ['data_file', 'my data.dat', 'csv']
    """
    return [unquoted(w) for w in _WORD.findall(text)]


def unquoted(text: str) -> str:
    """Return a text without the quotes around it."""
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text


def parsed_date(text: str) -> datetime | None:
    """Return the date of a text; None if it is none.

    >>> parsed_date("16 Mar 1909 12:20:58")
    datetime.datetime(1909, 3, 16, 12, 20, 58)
    """
    for form in _DATES:
        found = form.fullmatch(text.strip())
        if found is None:
            continue
        part = found.groupdict()
        month = part["month"]
        if not month.isdigit():
            if month[:3].lower() not in MONTHS:
                return None
            month = str(MONTHS.index(month[:3].lower()) + 1)
        try:
            day = date(int(part["year"]), int(month), int(part["day"]))
            hour, minute, second = (int(part[p] or 0) for p in ("hour", "minute", "second"))
            at = time(hour, minute, second)
        except ValueError:
            return None
        return datetime.combine(day, at)
    return None


def decimal_year(at: datetime) -> float:
    """Return a date as a year with its part."""
    begin, end = datetime(at.year, 1, 1), datetime(at.year + 1, 1, 1)
    return at.year + (at - begin) / (end - begin)


def read_epoch(field: Field) -> float:
    """Return the epoch of a field, a decimal year or a date; NaN after a problem."""
    text = str(field.value or "")
    if _DECIMAL_YEAR.fullmatch(text):
        return float(text)
    found = parsed_date(text)
    if found is None:
        field.wrong(f"must be a date such as 2008-01-13, not {text[:40]!r}")
        return float("nan")
    return decimal_year(found)


def wildcard_pattern(text: str, *, path: bool = False) -> re.Pattern[str]:
    """Return the pattern of a name with ``*`` and ``?``.

    Args:
        text: the name.
        path: whether the wildcards stop at the separators of a path, and ``**`` does not.
    """
    inside = r"[^/\\]" if path else "."
    out = []
    for part in re.split(r"(\*\*|\*|\?)", text):
        wild = {"**": ".*" if path else f"{inside}*", "*": f"{inside}*", "?": inside}
        out.append(wild.get(part, re.escape(part)))
    return re.compile("".join(out), re.IGNORECASE | re.DOTALL)


def found_file(folder: Path, name: str, suffix: str = "") -> Path | None:
    """Return a file that a job names, as it stands or with its usual suffix; None: it is absent."""
    plain = Path(name.replace("\\", "/"))
    for candidate in (folder / plain, (folder / plain).with_name(plain.name + suffix)):
        if plain.name and candidate.is_file():
            return candidate
    return None
