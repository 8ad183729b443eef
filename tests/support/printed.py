"""The words of a printed report."""

from __future__ import annotations

HALF_UNIT = 0.5 + 1e-9
"""Of the last printed digit."""


def section(text: str, heading: str) -> list[list[str]]:
    """Return the rows of a section as words, without its heading."""
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(heading))
    out = []
    for line in lines[first + 2 :]:
        if not line:
            break
        out.append(line.split())
    return out


def row(text: str, heading: str, name: str) -> list[str]:
    """Return the words of the row that starts with a name."""
    return next(words for words in section(text, heading) if words[0] == name)


def assert_printed(text: str, value: float) -> None:
    """A printed number agrees with a value to half its last digit."""
    last = 10.0 ** -len(text.partition(".")[2]) if "." in text else 1.0
    assert abs(float(text) - value) <= HALF_UNIT * last, (text, value)
