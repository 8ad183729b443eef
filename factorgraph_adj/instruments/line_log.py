"""Lines of a live source that are not posted yet, kept on the disk until they are.

A line is written before it is read by its grammar, and read again after a restart, with the time of
its first receipt: sets that were open, and postings that waited for the network, are as they were.
When all is posted, the lines that state station and height of the instrument alone are left.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..errors import InputError, Problem, system_reason
from .readings import ReceivedLine

ENCODING = "latin-1"
"""Bytes of a line as characters of JSON, and back."""


class LineLog:
    """A file of lines, each a JSON list: receipt, number, channel, text."""

    def __init__(self, path: Path) -> None:
        """Open a file, which may be there already."""
        self.path = path
        self.number = 0
        """Number of lines in it."""

    def lines(self) -> Iterator[ReceivedLine]:
        """Yield the lines of the file; one that a crash cut at its end is passed over.

        Raises:
            InputError: the file cannot be read, or is no such file.
        """
        if not self.path.exists():
            return
        try:
            texts = self.path.read_text(encoding="utf-8").split("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(Problem(system_reason(error), str(self.path))) from None
        for number, text in enumerate(texts[:-1], 1):  # the last one has no end
            try:
                received, of_source, channel, line = json.loads(text)
                found = ReceivedLine(
                    line.encode(ENCODING), float(received), int(of_source), channel=str(channel)
                )
            except (ValueError, TypeError, AttributeError):
                what = "is no line of a log: [receipt, number, channel, text]; remove the file"
                raise InputError(Problem(what, f"{self.path}:{number}")) from None
            self.number += 1
            yield found
        if texts[-1]:
            self._write(texts[:-1])

    def append(self, line: ReceivedLine) -> None:
        """Write a line; it is on the disk when the call ends. OSError: it is not."""
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(f"{self._text(line)}\n")
            stream.flush()
            os.fsync(stream.fileno())
        self.number += 1

    def keep(self, lines: Sequence[ReceivedLine]) -> None:
        """Leave these lines alone. OSError: the file is as it was."""
        if self.number != len(lines):
            self._write([self._text(line) for line in lines])
            self.number = len(lines)

    def _write(self, texts: Sequence[str]) -> None:
        new = self.path.with_name(f"{self.path.name}.new")
        with new.open("w", encoding="utf-8") as stream:
            stream.writelines(f"{text}\n" for text in texts)
            stream.flush()
            os.fsync(stream.fileno())
        new.replace(self.path)

    @staticmethod
    def _text(line: ReceivedLine) -> str:
        return json.dumps([line.received, line.number, line.channel, line.text.decode(ENCODING)])
