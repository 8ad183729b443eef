"""XML as a tree whose elements store their line numbers for error messages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from ..errors import InputError, Problem
from ..files import (
    MAX_DEPTH,
    MAX_ELEMENTS,
    MAX_TAG_BYTES,
    MIN_BYTES_OF_ELEMENT,
    SPARE_ELEMENTS,
    read_bytes,
)

_LONG_TAG = re.compile(rb"<[A-Za-z_:][^<>]{%d}" % MAX_TAG_BYTES)
_NOTHING: dict[str, str] = {}
"""Attributes of the elements that have none, which are most of the elements of a large file."""


@dataclass(slots=True)
class Element:
    """An element of an XML file."""

    tag: str
    """Name, without namespace."""
    attributes: dict[str, str]
    """Attributes, values stripped of blanks at both ends."""
    line: int
    """Line of the start tag, counted from 1."""
    children: list[Element] = field(default_factory=list)
    """Elements inside, in order."""
    text: str = ""
    """Text directly inside the element, without the text of its children."""
    end: int = 0
    """Line of the end tag."""

    def all(self, tag: str) -> Iterator[Element]:
        """Iterate over the children with a name."""
        return (c for c in self.children if c.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child with a name; None if there is none."""
        return next(self.all(tag), None)

    def walk(self) -> Iterator[Element]:
        """Iterate over this element and all its descendants, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()


def read_xml(path: Path) -> Element:
    """Read an XML file; return its root.

    Raises:
        InputError: the file cannot be read, or is not well-formed (with the line).
    """
    return parse_xml(read_bytes(path), path.name)


def parse_xml(content: bytes, name: str) -> Element:
    """Return the root of an XML text.

    Args:
        content: the text.
        name: name of its file in messages.

    Raises:
        InputError: the text is not well-formed, declares entities, or has more elements or longer
            tags than any survey (with the line).
    """
    _refuse_bounds(content, name)
    root: list[Element] = []
    stack: list[Element] = []
    texts: list[list[str]] = []  # joined once: entities can make millions of pieces
    parser = expat.ParserCreate(namespace_separator=" ")

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) >= MAX_DEPTH:
            what = f"is nested too deeply: an element has {MAX_DEPTH} others around it at most"
            raise InputError(Problem(what, f"{name}:{parser.CurrentLineNumber}"))
        element = Element(
            tag.rsplit(" ", 1)[-1],
            {k.rsplit(" ", 1)[-1]: v.strip() for k, v in attributes.items()} or _NOTHING,
            parser.CurrentLineNumber,
        )
        (stack[-1].children if stack else root).append(element)
        stack.append(element)
        texts.append([])

    def end(_: str) -> None:
        element = stack.pop()
        element.text, element.end = "".join(texts.pop()), parser.CurrentLineNumber

    def characters(text: str) -> None:
        texts[-1].append(text)

    def entity(entity: str, *_: object) -> None:
        what = f"declares the entity {entity!r}, which is not read: write its text where it stands"
        raise InputError(Problem(what[:200], f"{name}:{parser.CurrentLineNumber}"))

    parser.EntityDeclHandler = entity
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = characters
    parser.buffer_text = True
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise InputError(
            Problem(
                f"is not well-formed XML: {expat.ErrorString(error.code)}",
                f"{name}:{error.lineno}",
            )
        ) from None
    except (ValueError, LookupError) as error:  # the encoding is unknown or multi-byte
        raise InputError(Problem(f"is not readable XML: {error}", f"{name}:1")) from None
    return root[0]


def _refuse_bounds(content: bytes, name: str) -> None:
    """Refuse a text whose tree would need much more memory than the text itself."""
    n = content.count(b"<") - content.count(b"</") + content.count(b'="') + content.count(b"='")
    most = min(MAX_ELEMENTS, SPARE_ELEMENTS + len(content) // MIN_BYTES_OF_ELEMENT)
    if n > most:
        what = f"has {n} elements and attributes in {len(content)} bytes; valid: at most {most}"
        raise InputError(Problem(what, name))
    if found := _LONG_TAG.search(content):
        line = content.count(b"\n", 0, found.start()) + 1
        what = f"has a tag of more than {MAX_TAG_BYTES} bytes"
        raise InputError(Problem(what, f"{name}:{line}"))
