"""Field books in XML: elements with their problems, numbers and names."""

from __future__ import annotations

import math
from pathlib import Path

from ..text import beginning
from ..xml_tree import Element, read_xml
from .notes import Notes


def first(element: Element, *tags: str) -> Element | None:
    """Return the element at the end of a path of tags."""
    at: Element | None = element
    for tag in tags:
        at = None if at is None else next(at.all(tag), None)
    return at


def text_of(element: Element, *tags: str) -> str:
    """Return the text at the end of a path of tags; '' where there is none."""
    found = first(element, *tags)
    return "" if found is None else found.text.strip()


def number_of(notes: Notes, element: Element, *tags: str, scale: float = 1.0) -> float | None:
    """Return the number at the end of a path of tags; None where it is absent or empty."""
    found = first(element, *tags)
    text = "" if found is None else found.text.strip()
    if found is None or not text:
        return None
    return notes.finite(found.line, text, f"<{found.tag}>", scale)


def attribute(notes: Notes, element: Element, name: str, scale: float = 1.0) -> float | None:
    """Return the number in an attribute; None where it is absent or empty."""
    text = element.attributes.get(name, "")
    return notes.finite(element.line, text, name, scale) if text else None


def root_of(path: Path, tag: str) -> Element | None:
    """Return the root of a file if it has a tag; otherwise None."""
    root = read_xml(path)
    return root if root.tag == tag else None


def begins_with(path: Path, tag: bytes) -> bool:
    """Return whether an element is named at the beginning of an XML file."""
    return b"<" + tag in beginning(path)


def known_or_nan(value: float | None) -> float:
    """Return a number, NaN for None."""
    return math.nan if value is None else value
