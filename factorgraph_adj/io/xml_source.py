"""XML files whose data are texts of elements: names and numbers, and the problems found in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import known
from .collected import Collected
from .xml_tree import Element, read_xml


class XmlSource(Collected):
    """An XML file: its elements and the problems found in it so far."""

    def __init__(self, path: str | Path, root: str) -> None:
        """Read the file.

        Args:
            path: the file.
            root: name of its root element.

        Raises:
            InputError: the file cannot be read, is not XML, or has another root.
        """
        super().__init__(Path(path))
        self.root = read_xml(self.path)
        self.last = self.root.end
        if self.root.tag != root:
            self.add(self.root.line, f"the root element must be <{root}>, not <{self.root.tag}>")
            self.raise_all()

    def refuse_children(self, element: Element, valid: Mapping[str, Sequence[str]]) -> None:
        """Note the descendants that may not stand where they stand.

        Args:
            element: the element.
            valid: names of the children by name of the parent; others may have any.
        """
        for e in element.walk():
            if e.children and e.text.strip():
                self.add(e.line, f"<{e.tag}> has the text {e.text.strip()[:40]!r} beside elements")
            for child in e.children:
                if e.tag in valid and child.tag not in valid[e.tag]:
                    can = known(valid[e.tag], meant=child.tag, most=40)
                    self.add(child.line, f"<{child.tag}> cannot stand in <{e.tag}>; valid: {can}")

    def child(self, element: Element, tag: str) -> Element | None:
        """Return the one child of a name; note a problem where there are none or several."""
        found = list(element.all(tag))
        if len(found) == 1:
            return found[0]
        self.add(element.line, f"<{element.tag}> needs one <{tag}>, not {len(found)}")
        return None

    def text(self, element: Element, tag: str, default: str | None = None) -> str:
        """Return the text of a child; note a problem where it is missing or empty."""
        found = next(element.all(tag), None)
        text = "" if found is None else found.text.strip()
        if text:
            return text
        if default is None:
            self.add((found or element).line, f"<{element.tag}> needs <{tag}>")
            return ""
        return default

    def value(
        self,
        element: Element,
        tag: str,
        *,
        default: float | None = None,
        positive: bool = False,
    ) -> float:
        """Return the number of a child; note a problem and return NaN where it is none."""
        found = next(element.all(tag), None)
        text = "" if found is None else found.text.strip()
        if not text and default is not None:
            return default
        if not text:
            self.add((found or element).line, f"<{element.tag}> needs <{tag}>, a number")
            return math.nan
        line = (found or element).line
        return self.number(line, f"<{tag}>", text, positive=positive)
