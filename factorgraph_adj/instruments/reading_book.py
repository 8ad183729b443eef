"""Field book that hands on the readings of one line, so that formats of files are grammars too.

A reader of field books calls the methods of a `FieldBook`; those of a `ReadingBook` make the
`Reading`s of the line instead. One definition of a format then serves files and streams.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io.field_books.accuracies import DEFAULT_ACCURACIES
from ..io.field_books.field_book import FieldBook
from ..io.source import Source
from .readings import InstrumentHeight, Occupation, Reading, ReceivedLine, Sight


class ReadingBook(FieldBook):
    """The readings of one line."""

    def __init__(self, line: ReceivedLine, **of_line: Any) -> None:
        """Start for a line.

        Args:
            line: the line.
            of_line: time and identity of its readings.
        """
        super().__init__(Source(Path("line")), DEFAULT_ACCURACIES, may_lack_station=True)
        self.line, self.of_line = line, of_line
        self.found: list[Reading] = []

    def begin(self, line: int, station: str, height: float | None = None) -> None:
        """Note that a set-up begins."""
        reading = Occupation(station=station, instrument_height=_known(height), **self.of_line)
        self.found.append(reading)

    def set_height(self, line: int, height: float) -> None:
        """Note the height of the instrument."""
        self.found.append(InstrumentHeight(height=height, **self.of_line))

    def sight(self, line: int, target: str, **readings: Any) -> None:
        """Note a sight; a distance of 0 was not measured, and coordinates are results."""
        readings.pop("coordinates", None), readings.pop("stated", None)
        for name in ("distance", "horizontal"):
            readings[name] = readings.get(name) or None
        values: dict[str, Any] = {n: _known(v) if n != "face" else v for n, v in readings.items()}
        measured = ("direction", "zenith", "distance", "horizontal")
        if any(values.get(n) is not None for n in measured):
            self.found.append(Sight(target=target, **values, **self.of_line))

    def made(self) -> list[Reading]:
        """Return the readings.

        Raises:
            InputError: the problems that were noted.
        """
        if self.source.problems.count:
            raise InputError(self.source.problems.ordered())
        return self.found


def _known(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value
