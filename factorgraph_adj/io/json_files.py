"""JSON as nodes that read their values: a problem of a value names its file and line.

Python's fast reader reads the text and keeps no places. Where a line is asked for, the objects and
arrays along the path to the value are scanned again, each of them once.
"""

from __future__ import annotations

import json
import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from json.decoder import scanstring  # type: ignore[attr-defined]
from typing import Any, TypeAlias

from ..errors import InputError, Problem, similar
from .source import Field, Problems
from .text_files import decoded

JsonPath: TypeAlias = tuple[str | int, ...]
"""Keys and indices from the root to a value."""

_BLANK = " \t\n\r"
_NO_NUMBER = re.compile(r"[:\[,]\s*-?(NaN|Infinity|\d{4300})")
"""What Python's reader takes for a number, and JSON does not have; or too many digits."""
_DECODER = json.JSONDecoder()
_ABSENT = object()


@dataclass(frozen=True)
class JsonNode:
    """A value of a JSON file."""

    value: Any
    """The value."""
    file: JsonFile
    """The file."""
    path: JsonPath = ()
    """Its place in the file."""

    @property
    def where(self) -> str:
        """Name of the file and line."""
        return f"{self.file.name}:{self.file.line(self.path)}"

    @property
    def title(self) -> str:
        """Path in words, for messages."""
        return "/".join(map(str, self.path)) or "the document"

    def fail(self, what: str) -> InputError:
        """Return an error about the value."""
        return InputError(Problem(what, self.where))

    def get(self, key: str) -> JsonNode | None:
        """Return a member of an object; None if it is absent.

        Raises:
            InputError: the value is no object.
        """
        members = self.members()
        found = members.get(key, _ABSENT)
        return None if found is _ABSENT else JsonNode(found, self.file, (*self.path, key))

    def need(self, key: str) -> JsonNode:
        """Return a member of an object.

        Raises:
            InputError: the value is no object, or has no such member.
        """
        found = self.get(key)
        if found is None:
            others = [str(k) for k in self.members()]
            raise self.fail(f"{self.title} has no {key!r}{similar(key, others)}")
        return found

    def members(self) -> Mapping[str, Any]:
        """Return the members of an object.

        Raises:
            InputError: the value is none.
        """
        if not isinstance(self.value, dict):
            raise self.fail(f"{self.title} must be an object, not {_shown(self.value)}")
        return self.value

    def items(self) -> Iterator[tuple[str, JsonNode]]:
        """Iterate over the members of an object: key and value."""
        for key, value in self.members().items():
            yield key, JsonNode(value, self.file, (*self.path, key))

    def list(self) -> Iterator[JsonNode]:
        """Iterate over the elements of an array.

        Raises:
            InputError: the value is none.
        """
        if not isinstance(self.value, list):
            raise self.fail(f"{self.title} must be an array, not {_shown(self.value)}")
        return (JsonNode(v, self.file, (*self.path, i)) for i, v in enumerate(self.value))

    def text(self) -> str:
        """Return a text.

        Raises:
            InputError: the value is none.
        """
        if not isinstance(self.value, str):
            raise self.fail(f"{self.title} must be a text, not {_shown(self.value)}")
        return self.value

    def number(self, unit: str = "", **limits: float) -> float:
        """Return a number in SI.

        Args:
            unit: see `Field.number`.
            limits: ``scale``, ``least``, ``above`` and ``largest`` of the same.

        Raises:
            InputError: the value is none, or is beyond the limits.
        """
        if isinstance(self.value, bool | str | list | dict | None):
            raise self.fail(f"{self.title} must be a number, not {_shown(self.value)}")
        problems = Problems()
        found = self.field(problems).number(unit, **limits)
        if problems.count:
            raise InputError(problems.problems)
        return found

    def field(self, problems: Problems) -> Field:
        """Return the value as a field, whose problems are added instead of raised."""
        return problems.field(self.value, self.title, lambda: self.where)

    def numbers(self, size: int) -> tuple[float, ...]:
        """Return ``size`` numbers of an array.

        Raises:
            InputError: the value is none.
        """
        found = list(self.list())
        if len(found) != size:
            raise self.fail(f"{self.title} needs {size} numbers, not {len(found)}")
        return tuple(n.number() for n in found)

    def integer(self) -> int:
        """Return a whole number of at most 64 bits.

        Raises:
            InputError: the value is none.
        """
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int) or not abs(value) < 2**64:
            raise self.fail(f"{self.title} must be a whole number, not {_shown(value)}")
        return value

    def truth(self) -> bool:
        """Return true or false.

        Raises:
            InputError: the value is neither.
        """
        if not isinstance(self.value, bool):
            raise self.fail(f"{self.title} must be true or false, not {_shown(self.value)}")
        return self.value


@dataclass(frozen=True)
class JsonFile:
    """The text of a JSON file."""

    name: str
    """Name in messages."""
    content: str
    """The text."""

    _members: dict[JsonPath, dict[str | int, int]] = field(default_factory=dict, repr=False)

    def line(self, path: JsonPath) -> int:
        """Return the line of the value at a path, counted from 1."""
        return bisect_left(self._ends_of_lines, self._place(path)) + 1

    @cached_property
    def _ends_of_lines(self) -> list[int]:
        return [found.start() for found in re.finditer("\n", self.content)]

    def _place(self, path: JsonPath) -> int:
        """Return the place of the value at a path; of what should have it, if it is absent."""
        if not path:
            return self._blank(0)
        whole = path[:-1]
        at = self._place(whole)
        if whole not in self._members:
            self._members[whole] = dict(self._places(at))
        return self._members[whole].get(path[-1], at)

    def _blank(self, at: int) -> int:
        """Return the place of the next character that is not blank."""
        while at < len(self.content) and self.content[at] in _BLANK:
            at += 1
        return at

    def _places(self, at: int) -> Iterator[tuple[str | int, int]]:
        """Yield the keys, or indices, and places of what an object or array at a place has."""
        text = self.content
        named, count, at = text[at] == "{", 0, self._blank(at + 1)
        while text[at] not in "]}":  # the text is JSON: every object and array ends
            name: str | int = count
            if named:
                name, at = scanstring(text, at + 1, True)
                at = self._blank(self._blank(at) + 1)  # behind the colon
            yield name, at
            _, at = _DECODER.raw_decode(text, at)
            count, at = count + 1, self._blank(at)
            if text[at] == ",":
                at = self._blank(at + 1)


def _shown(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 40 else text[:37] + "…"


def parse_json(content: bytes | str, name: str) -> JsonNode:
    """Return the root of a JSON text.

    Args:
        content: the text; bytes are UTF-8, or UTF-16 with its mark.
        name: name of its file in messages.

    Raises:
        InputError: the text is not JSON (with the line), has a number that is not finite, or a
            name twice in one object.
    """
    text = content if isinstance(content, str) else decoded(content, name)[0]
    twice: list[str] = []

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        out = dict(pairs)
        if len(out) < len(pairs):
            seen: set[str] = set()
            for key, _ in pairs:
                if key in seen:
                    twice.append(key)
                seen.add(key)
        return out

    def refuse(word: str) -> float:
        raise ValueError(f"{word} is not a finite number")

    try:
        value = json.loads(text, object_pairs_hook=unique, parse_constant=refuse)
    except json.JSONDecodeError as error:
        raise InputError(Problem(f"is not JSON: {error.msg}", f"{name}:{error.lineno}")) from None
    except RecursionError:
        raise InputError(Problem("is nested too deeply", name)) from None
    except ValueError as error:
        found = _NO_NUMBER.search(text)
        line = text.count("\n", 0, found.start(1) if found else 0) + 1
        raise InputError(Problem(f"is not JSON: {str(error)[:80]}", f"{name}:{line}")) from None
    if twice:
        line = text.count("\n", 0, text.find(json.dumps(twice[0], ensure_ascii=False))) + 1
        what = f"the name {twice[0]!r} stands twice in one object"
        raise InputError(Problem(what, f"{name}:{line}"))
    return JsonNode(value, JsonFile(name, text))
