"""The ``.gkf`` file as XML elements: its vocabulary, its numbers and its problems."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError, Problem, known
from .xml_tree import Element, read_xml

_SIGHT = ("from", "to", "val", "stdev", "from_dh", "to_dh", "extern")
_STDEVS = (
    "distance-stdev",
    "direction-stdev",
    "angle-stdev",
    "zenith-angle-stdev",
    "azimuth-stdev",
)
_OBSERVED = ("direction", "distance", "angle", "s-distance", "z-angle", "azimuth", "dh")

VOCABULARY: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "gama-local": (("version",), ("network",)),
    "network": (
        ("axes-xy", "angles", "epoch"),
        ("description", "parameters", "points-observations"),
    ),
    "description": ((), ()),
    "parameters": (
        (
            *("sigma-apr", "conf-pr", "tol-abs", "sigma-act", "algorithm", "language"),
            *("encoding", "angular", "angles", "latitude", "ellipsoid", "cov-band"),
            "update-constrained-coordinates",
        ),
        (),
    ),
    "points-observations": (
        _STDEVS,
        ("point", "obs", "height-differences", "coordinates", "vectors"),
    ),
    "point": (("id", "x", "y", "z", "fix", "adj"), ()),
    "obs": (("from", "orientation", "from_dh"), (*_OBSERVED, "cov-mat")),
    "direction": (_SIGHT[1:], ()),
    "distance": (_SIGHT, ()),
    "s-distance": (_SIGHT, ()),
    "z-angle": (_SIGHT, ()),
    "azimuth": (_SIGHT, ()),
    "angle": (("from", "bs", "fs", "val", "stdev", "from_dh", "bs_dh", "fs_dh", "extern"), ()),
    "dh": (("from", "to", "val", "stdev", "dist", "extern"), ()),
    "height-differences": ((), ("dh", "cov-mat")),
    "coordinates": (("extern",), ("point", "cov-mat")),
    "vectors": ((), ("vec", "cov-mat")),
    "vec": (("from", "to", "dx", "dy", "dz", "from_dh", "to_dh", "extern"), ()),
    "cov-mat": (("dim", "band"), ()),
}
"""Attributes and children that each element may have, by its tag."""


class GamaSource:
    """A ``.gkf`` file: its elements and the problems found in it so far."""

    def __init__(self, path: Path) -> None:
        """Read the file; note every element and attribute that is unknown in the format.

        Raises:
            InputError: the file is missing, not XML, or not a ``<gama-local>``.
        """
        self.path = path
        self.root = read_xml(path)
        self.problems: list[Problem] = []
        if self.root.tag != "gama-local":
            self.add(self.root, f"is not a network of GNU Gama: <{self.root.tag}> should be "
                     "<gama-local>")  # fmt: skip
            self.raise_problems()
        for element in self.root.walk():
            attributes, children = VOCABULARY.get(element.tag, ((), ()))
            if element.tag not in VOCABULARY:
                continue  # an unknown tag is noted as a child of its parent
            for name in element.attributes:
                if name not in attributes:
                    self.add(element, f"<{element.tag}> has no attribute {name!r}; valid: "
                             + known(attributes, meant=name, most=40))  # fmt: skip
            for child in element.children:
                if child.tag not in children:
                    self.add(child, f"<{child.tag}> cannot stand in <{element.tag}>; valid: "
                             + known(children, meant=child.tag, most=40))  # fmt: skip

    def place(self, element: Element) -> str:
        """Return file and line."""
        return f"{self.path.name}:{element.line}"

    def add(self, element: Element, what: str) -> None:
        """Note a problem; the same problem is noted only once."""
        problem = Problem(what, self.place(element))
        if problem not in self.problems:
            self.problems.append(problem)

    def raise_problems(self) -> None:
        """Raise InputError with all problems in the order of lines, if there are any."""
        if self.problems:
            raise InputError(sorted(self.problems, key=_line))

    def name(self, element: Element, attribute: str) -> str:
        """Return the name of a point."""
        name = element.attributes.get(attribute, "")
        if not name:
            self.add(element, f"<{element.tag}> needs {attribute}, the name of a point")
        return name

    def number(
        self,
        element: Element,
        attribute: str,
        *,
        default: float | None = None,
        positive: bool = False,
    ) -> float:
        """Return a finite number; otherwise note a problem and return NaN."""
        text = element.attributes.get(attribute, "")
        if not text and default is not None:
            return default
        try:
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value) and (value > 0 or not positive):
            return value
        kind = "a number > 0" if positive else "a finite number"
        found = f"{attribute}={text!r} is not {kind}" if text else f"needs {attribute}, {kind}"
        self.add(element, f"<{element.tag}> {found}")
        return math.nan

    def positive(self, element: Element, attribute: str) -> float | None:
        """Return a number > 0; None where the attribute is absent."""
        if not element.attributes.get(attribute):
            return None
        return self.number(element, attribute, positive=True)

    def count(self, element: Element, attribute: str) -> int:
        """Return a whole number ≥ 0."""
        text = element.attributes.get(attribute, "")
        if re.fullmatch(r"\d{1,9}", text):
            return int(text)
        self.add(element, f"<{element.tag}> needs {attribute}, a whole number ≥ 0, not {text!r}")
        return 0

    def choice(self, element: Element, attribute: str, valid: Sequence[str], default: str) -> str:
        """Return one of several words."""
        text = element.attributes.get(attribute, default)
        if text in valid:
            return text
        self.add(
            element, f"{attribute}={text!r} is unknown; valid: {known(valid, meant=text, most=40)}"
        )
        return default


def _line(problem: Problem) -> int:
    """Return the line in ``file:line`` or ``file:line: observation``."""
    found = re.search(r":(\d+)(?::|$)", problem.where)
    return int(found.group(1)) if found else 0
