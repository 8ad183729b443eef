"""XML files as sources: fields of elements and attributes; names that are unknown are refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import InputError, Problem, known
from .source import Field, Problems, Source
from .xml_files import Element, element_at, read_xml


class XmlSource(Source):
    """An XML file: its elements, fields of which are texts of children and attributes."""

    def __init__(self, path: str | Path, root: str = "", problems: Problems | None = None) -> None:
        """Read the file.

        Args:
            path: the file.
            root: name that its root element must have; '': any.
            problems: collection of the reader; default: one of this file.

        Raises:
            InputError: the file cannot be read, is not XML, or has another root.
        """
        super().__init__(path, problems)
        self.root = read_xml(self.path)
        self.last = self.root.end
        if root and self.root.tag != root:
            what = f"the root element must be <{root}>, not <{self.root.tag}>"
            raise InputError(Problem(what, self.place(self.root.line)))

    def refuse_children(self, element: Element, valid: Mapping[str, Sequence[str]]) -> None:
        """Add a problem for each descendant that its parent cannot have.

        Args:
            element: the element.
            valid: names of the children by name of the parent; others may have any.
        """
        for e in element.walk():
            if e.children and e.text.strip():
                self.wrong(
                    e.line, f"<{e.tag}> has the text {e.text.strip()[:40]!r} beside elements"
                )
            for child in e.children:
                if e.tag in valid and child.tag not in valid[e.tag]:
                    can = known(valid[e.tag], meant=child.tag, most=40)
                    self.wrong(child.line, f"<{child.tag}> cannot be in <{e.tag}>; valid: {can}")

    def refuse_attributes(self, element: Element, valid: Mapping[str, Sequence[str]]) -> None:
        """Add a problem for each attribute of a descendant that it cannot have.

        Args:
            element: the element.
            valid: names of the attributes by name of the element; others may have any.
        """
        for e in element.walk():
            for name in e.names if e.tag in valid else ():
                if name not in valid[e.tag]:
                    can = known(valid[e.tag], meant=name, most=40)
                    self.wrong(e.line, f"<{e.tag}> has no attribute {name!r}; valid: {can}")

    def child(self, element: Element, tag: str) -> Element | None:
        """Return the one child of a name; None after a problem where there are none or several."""
        found = list(element.all(tag))
        if len(found) == 1:
            return found[0]
        self.wrong(element.line, f"<{element.tag}> needs one <{tag}>, not {len(found)}")
        return None

    def inside(self, element: Element, *tags: str) -> Field:
        """Return the field with the text at the end of a path of tags; absent where there is none.

        Without tags it is the text of the element itself.
        """
        found = element_at(element, *tags)
        name = f"<{tags[-1] if tags else element.tag}>"
        if found is None:
            name += f" of <{element.tag}>"
        return self.field((found or element).line, found and found.text, name)

    def attribute(self, element: Element, name: str) -> Field:
        """Return the field of an attribute."""
        what = f"{name} of <{element.tag}>"
        return self.field(element.line, element.attributes.get(name), what)
