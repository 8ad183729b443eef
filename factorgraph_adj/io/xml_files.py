"""XML as a tree of elements with line numbers, read within bounds of memory; search by path."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from ..errors import InputError, Problem
from ..files import (
    MAX_DEPTH,
    MAX_ELEMENTS,
    MAX_TAG_BYTES,
    MIN_BYTES_OF_ATTRIBUTE,
    MIN_BYTES_OF_ELEMENT,
    PIECE_BYTES,
    SPARE_ELEMENTS,
    read_pieces,
)
from .text_files import file_beginning

MAX_SHARED_VALUES = 100_000
"""Number of different short values, and of different lists of names, that elements share: names of
points and standard deviations come again and again."""
MAX_SHARED_CHARACTERS = 16
"""Largest number of letters of a value that is shared."""


@dataclass(slots=True, eq=False)
class Element:
    """An element of an XML file; a large file has millions, so that it takes little memory."""

    tag: str
    """Name, without namespace."""
    line: int
    """Line of the start tag, counted from 1."""
    names: tuple[str, ...] = ()
    """Names of the attributes, without namespace."""
    values: tuple[str, ...] = ()
    """Their values, stripped of blanks at both ends."""
    children: Sequence[Element] = ()
    """Elements inside, in order."""
    text: str = ""
    """Text directly inside the element, without the text of its children."""
    end: int = 0
    """Line of the end tag."""

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes by name."""
        return dict(zip(self.names, self.values, strict=True))

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
    """Read an XML file piece by piece; return its root.

    Raises:
        InputError: the file cannot be read; or see `parse_xml`.
    """
    return _parsed(read_pieces(path), path.name)


def parse_xml(content: bytes, name: str) -> Element:
    """Return the root of an XML text.

    Args:
        content: the text.
        name: name of its file in messages.

    Raises:
        InputError: the text is not well-formed, declares entities, or has more elements or longer
            tags than any survey (with the line).
    """
    pieces = (content[i : i + PIECE_BYTES] for i in range(0, len(content), PIECE_BYTES))
    return _parsed(pieces, name)


def _parsed(pieces: Iterable[bytes], name: str) -> Element:
    """Return the root of an XML text in pieces, within the bounds of `_refuse_bounds`."""
    root: list[Element] = []
    stack: list[Element] = []
    children: list[list[Element]] = [root]
    names: dict[tuple[str, ...], tuple[str, ...]] = {}
    values: dict[str, str] = {}
    texts: list[list[str]] = []  # joined once: entities can make millions of pieces
    size = elements = attributes = 0
    parser = expat.ParserCreate(namespace_separator=" ")

    def start(tag: str, stated: dict[str, str]) -> None:
        nonlocal elements, attributes
        if len(stack) >= MAX_DEPTH:
            what = f"is nested too deeply: an element has {MAX_DEPTH} others around it at most"
            raise InputError(Problem(what, f"{name}:{parser.CurrentLineNumber}"))
        elements += 1
        attributes += len(stated)
        element = Element(_name(tag), parser.CurrentLineNumber)
        if stated:
            element.names = _shared_names(names, tuple(stated))
            element.values = tuple(_shared_value(values, v.strip()) for v in stated.values())
        children[-1].append(element)
        children.append([])
        stack.append(element)
        texts.append([])

    def end(_: str) -> None:
        element = stack.pop()
        element.text, element.end = "".join(texts.pop()), parser.CurrentLineNumber
        element.children = children.pop() or ()
        if element.end == element.line:
            element.end = element.line  # one number

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
        for piece in pieces:
            parser.Parse(piece, False)
            size += len(piece)
            where = f"{name}:{parser.CurrentLineNumber}"
            _refuse_bounds(size, elements, attributes, size - parser.CurrentByteIndex, where)
        parser.Parse(b"", True)
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


def _shared_value(known: dict[str, str], value: str) -> str:
    """Return a value; one object for all elements that have the same short one."""
    if len(value) > MAX_SHARED_CHARACTERS:
        return value
    return (
        known.setdefault(value, value)
        if len(known) < MAX_SHARED_VALUES
        else known.get(value, value)
    )


def _shared_names(
    known: dict[tuple[str, ...], tuple[str, ...]], stated: tuple[str, ...]
) -> tuple[str, ...]:
    """Return names without namespaces; one object for all elements that have the same."""
    found = known.get(stated)
    if found is None:
        found = tuple(map(_name, stated))
        if len(known) < MAX_SHARED_VALUES:
            known[stated] = found
    return found


def _name(stated: str) -> str:
    """Return a name without namespace; one object for all elements that have it."""
    return sys.intern(stated.rsplit(" ", 1)[-1])


def _refuse_bounds(size: int, elements: int, attributes: int, unfinished: int, where: str) -> None:
    """Refuse a text whose tree needs much more memory than the text itself, while it is read.

    Args:
        size: size of the text so far, bytes.
        elements: number of its elements.
        attributes: number of their attributes.
        unfinished: size of what begins a tag without its end, bytes.
        where: file and line.
    """
    for n, what, each in (
        (elements, "elements", MIN_BYTES_OF_ELEMENT),
        (attributes, "attributes", MIN_BYTES_OF_ATTRIBUTE),
    ):
        most = min(MAX_ELEMENTS, SPARE_ELEMENTS + size // each)
        if n > most:
            text = f"has {n} {what} in its first {size} bytes; valid: at most {most}"
            raise InputError(Problem(text, where))
    if unfinished > MAX_TAG_BYTES:
        raise InputError(Problem(f"has a tag of more than {MAX_TAG_BYTES} bytes", where))


def element_at(element: Element, *tags: str) -> Element | None:
    """Return the element at the end of a path of tags."""
    at: Element | None = element
    for tag in tags:
        at = None if at is None else next(at.all(tag), None)
    return at


def text_at(element: Element, *tags: str) -> str:
    """Return the text at the end of a path of tags; '' where there is none."""
    found = element_at(element, *tags)
    return "" if found is None else found.text.strip()


def begins_with_element(path: Path, tag: bytes) -> bool:
    """Return whether an element is named at the beginning of an XML file."""
    return b"<" + tag in file_beginning(path)
