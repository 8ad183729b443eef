"""Elements of a ``.gkf`` file of GNU Gama: vocabulary, points, weights and covariances.

Points have coordinates, held components and datum components. Weights of observations are
``stdev``, defaults, or ``<cov-mat>``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...errors import InputError, known
from ...network.network import Network
from ...observations import AnyObservation, Correlated, Observation
from ...types import Array
from ..source import Field, LeftOutReason, is_unread
from ..xml_files import Element
from ..xml_source import XmlSource

_SIGHT_ATTRIBUTES = ("from", "to", "val", "stdev", "from_dh", "to_dh", "extern")
_STDEV_ATTRIBUTES = (
    "distance-stdev",
    "direction-stdev",
    "angle-stdev",
    "zenith-angle-stdev",
    "azimuth-stdev",
)
_OBSERVED_ELEMENTS = ("direction", "distance", "angle", "s-distance", "z-angle", "azimuth", "dh")

GKF_VOCABULARY: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
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
        _STDEV_ATTRIBUTES,
        ("point", "obs", "height-differences", "coordinates", "vectors"),
    ),
    "point": (("id", "x", "y", "z", "fix", "adj"), ()),
    "obs": (("from", "orientation", "from_dh"), (*_OBSERVED_ELEMENTS, "cov-mat")),
    "direction": (_SIGHT_ATTRIBUTES[1:], ()),
    "distance": (_SIGHT_ATTRIBUTES, ()),
    "s-distance": (_SIGHT_ATTRIBUTES, ()),
    "z-angle": (_SIGHT_ATTRIBUTES, ()),
    "azimuth": (_SIGHT_ATTRIBUTES, ()),
    "angle": (("from", "bs", "fs", "val", "stdev", "from_dh", "bs_dh", "fs_dh", "extern"), ()),
    "dh": (("from", "to", "val", "stdev", "dist", "extern"), ()),
    "height-differences": ((), ("dh", "cov-mat")),
    "coordinates": (("extern",), ("point", "cov-mat")),
    "vectors": ((), ("vec", "cov-mat")),
    "vec": (("from", "to", "dx", "dy", "dz", "from_dh", "to_dh", "extern"), ()),
    "cov-mat": (("dim", "band"), ()),
}
"""Attributes and children that each element may have, by its tag."""
ComponentStatus: TypeAlias = Literal["fixed", "free", "constrained"]
COMPONENT_WORDS = ("xy", "XY", "z", "Z", "xyz", "XYZ", "xyZ", "XYz")
"""Values of ``fix`` and ``adj``."""
POINTS_NEITHER_FIX_NOR_ADJ = LeftOutReason("points", "the file neither fixes nor adjusts them")
DEFAULT_STDEV_ATTRIBUTES = {
    "distance": "distance-stdev",
    "s-distance": "distance-stdev",
    "direction": "direction-stdev",
    "angle": "angle-stdev",
    "z-angle": "zenith-angle-stdev",
    "azimuth": "azimuth-stdev",
}
"""Attribute of ``<points-observations>`` with the default standard deviation, by element."""


def gama_source(path: Path) -> XmlSource:
    """Return a ``.gkf`` file whose unknown elements and attributes are problems.

    Raises:
        InputError: the file is missing, not XML, or not a ``<gama-local>``.
    """
    source = XmlSource(path, "gama-local")
    source.refuse_children(source.root, {tag: c for tag, (_, c) in GKF_VOCABULARY.items()})
    source.refuse_attributes(source.root, {tag: a for tag, (a, _) in GKF_VOCABULARY.items()})
    return source


@dataclass
class _GkfPoint:
    """A point as all ``<point>`` elements of its name describe it together."""

    element: Element
    values: dict[str, float] = field(default_factory=dict)
    status: dict[str, ComponentStatus] = field(default_factory=dict)
    observed: dict[str, float] = field(default_factory=dict)
    """Coordinates stated in ``<coordinates>`` only."""


class GamaPoints:
    """All points of the file."""

    def __init__(self, source: XmlSource) -> None:
        """Start without points."""
        self.source = source
        self._points: dict[str, _GkfPoint] = {}

    @property
    def constrained(self) -> bool:
        """Whether any component carries the datum of a free network."""
        return any("constrained" in p.status.values() for p in self._points.values())

    def read(self, section: Element) -> None:
        """Read the points of a ``<points-observations>``, including its ``<coordinates>``."""
        for element in section.all("point"):
            self._read(element, observed=False)
        for group in section.all("coordinates"):
            for element in group.all("point"):
                self._read(element, observed=True)

    def _read(self, element: Element, *, observed: bool) -> None:
        name = self.source.attribute(element, "id").name()
        if not name:
            return
        point = self._points.setdefault(name, _GkfPoint(element))
        if ("x" in element.attributes) != ("y" in element.attributes):
            self.source.wrong(element.line, f"point {name!r} needs both x and y, or neither")
        values = point.observed if observed else point.values
        for axis in "xyz":
            if axis in element.attributes:
                value = self.source.attribute(element, axis).number()
                if not observed and abs(values.get(axis, value) - value) > 0:
                    self.source.wrong(
                        element.line,
                        f"{axis} of point {name!r}: {value} here, {values[axis]} in line "
                        f"{point.element.line}",
                    )
                values[axis] = value
        status = self._status(element)
        other = [a for a in status if point.status.get(a, status[a]) != status[a]]
        if other:
            self.source.wrong(
                element.line,
                f"{', '.join(other)} of point {name!r}: {status[other[0]]} here, "
                f"{point.status[other[0]]} in line {point.element.line}",
            )
        point.status |= status

    def _status(self, element: Element) -> dict[str, ComponentStatus]:
        out: dict[str, ComponentStatus] = {}
        for attribute in ("adj", "fix"):  # read second, fix overrides adj
            for letter in self.source.attribute(element, attribute).word(COMPONENT_WORDS, ""):
                if attribute == "fix":
                    out[letter.lower()] = "fixed"
                else:
                    out[letter.lower()] = "constrained" if letter.isupper() else "free"
        return out

    def require(
        self, element: Element, name: str, *, plan: bool = False, height: bool = False
    ) -> None:
        """Note a problem unless a point has the components that an observation needs."""
        if not name:
            return
        point = self._points.get(name)
        if point is None:
            self.source.wrong(
                element.line,
                f"<{element.tag}> names the unknown point {name!r}; known: "
                f"{known(self._points, meant=name)}",
            )
            return
        missing = [
            what
            for what, asked, axis in (("x, y", plan, "x"), ("z", height, "z"))
            if asked and axis not in point.status
        ]
        if missing:
            self.source.wrong(
                element.line,
                f"<{element.tag}> needs {', '.join(missing)} of point {name!r}, which line "
                f"{point.element.line} neither fixes nor adjusts: give fix or adj there, or "
                "take the observation out",
            )

    def add_to(self, network: Network) -> None:
        """Add the points that take part in the adjustment to the network."""
        for name, point in self._points.items():
            if not point.status:
                self.source.leave_out(point.element.line, POINTS_NEITHER_FIX_NOR_ADJ, name)
                continue
            values = point.observed | point.values
            free = [a for a in "xyz" if point.status.get(a, "fixed") != "fixed"]
            constrained = [a for a in free if point.status[a] == "constrained"]
            empty = [a for a, s in point.status.items() if s == "fixed" and a not in values]
            if empty:
                self.source.wrong(
                    point.element.line, f"{', '.join(empty)} of point {name!r}: fixed at no value"
                )
            if constrained and constrained != free:
                self.source.wrong(
                    point.element.line,
                    f"{', '.join(free)} of point {name!r} are unknown, but only "
                    f"{', '.join(constrained)} carry the datum: a datum point carries it with "
                    "all its unknown components",
                )
            xyz = [values.get(a, math.nan if a in free else 0.0) for a in "xyz"]
            if self.source.problems.count:
                continue
            network.add_point(
                name,
                xyz,
                fixed="".join(a for a in "xyz" if a not in free),
                datum=bool(constrained),
            )


@dataclass(frozen=True)
class PendingObservation:
    """An observation that waits for its weight."""

    element: Element
    """XML element of the observation."""
    units: tuple[float, ...]
    """Unit of the standard deviation of each component, in metres or radians."""
    sigma: float
    """Standard deviation from ``stdev``, ``dist`` or a default, in the file's unit; NaN: none."""
    make: Callable[[Array], Observation]
    """Function that makes the observation from its covariance (k, k), metres² or radians²."""


class GamaWeights:
    """The observations with their weights."""

    def __init__(self, source: XmlSource) -> None:
        """Start without observations."""
        self.source = source
        self.observations: list[AnyObservation] = []

    def weigh(self, group: Element, pending: Sequence[PendingObservation | None]) -> None:
        """Give the observations of a group their weights and keep them; None is a faulty one."""
        matrices = list(group.all("cov-mat"))
        if len(matrices) > 1:
            self.source.wrong(matrices[1].line, "a second <cov-mat> of the same observations")
        whole = [p for p in pending if p is not None]
        if all(e.tag == "cov-mat" for e in group.children):
            self.source.wrong(group.line, f"<{group.tag}> has no observations")
        elif not matrices:
            for p in whole:
                self._independent(p)
        elif len(whole) == len(pending):
            self._correlated(matrices[0], whole)

    def _independent(self, p: PendingObservation) -> None:
        tag = p.element.tag
        if tag in ("vec", "point"):
            self.source.wrong(p.element.line, f"<{tag}> needs a <cov-mat> in its group")
        elif math.isnan(p.sigma):
            other = (
                "dist"
                if tag == "dh"
                else f"<points-observations {DEFAULT_STDEV_ATTRIBUTES[tag]}=…>"
            )
            self.source.wrong(
                p.element.line,
                f"<{tag}> has no standard deviation: give stdev, {other} or a <cov-mat>",
            )
        else:
            sigma = float(p.sigma * p.units[0])
            variance = sigma * sigma  # a product, because powers beyond the range raise
            if 0 < variance < np.inf:
                self._keep(p.make, np.array([[variance]]))
            else:
                what = f"<{tag}> has a standard deviation of {p.sigma:g}, which has no variance"
                self.source.wrong(p.element.line, f"{what}: the number is out of range")

    def _correlated(self, element: Element, pending: list[PendingObservation]) -> None:
        matrix = self._matrix(element, sum(len(p.units) for p in pending))
        if matrix is not None:
            self.share(matrix, pending)

    def share(self, matrix: Array, pending: Sequence[PendingObservation]) -> None:
        """Keep observations with their joint covariance, in uncorrelated groups.

        Args:
            matrix: covariance of all components, in the units of the file.
            pending: the observations in its order.
        """
        units = np.concatenate([p.units for p in pending])
        covariance = matrix * np.outer(units, units)
        ends = np.cumsum([len(p.units) for p in pending])
        rows = [np.arange(e - len(p.units), e) for p, e in zip(pending, ends, strict=True)]
        for members in _uncorrelated_groups(covariance, rows):
            together = np.concatenate([rows[i] for i in members])
            block = covariance[np.ix_(together, together)]
            if len(members) == 1:
                self._keep(pending[members[0]].make, block)
            else:
                own = [covariance[np.ix_(rows[i], rows[i])] for i in members]
                self._keep(_cluster_function([pending[i] for i in members], own), block)

    def _keep(self, make: Callable[[Array], AnyObservation], covariance: Array) -> None:
        try:
            self.observations.append(make(covariance))
        except InputError as error:
            self.source.problems.extend(error.problems)

    def _matrix(self, element: Element, size: int) -> Array | None:
        """Return the covariance (size, size) in the file's units; None if it is wrong."""
        dim = self.source.attribute(element, "dim").integer()
        band = self.source.attribute(element, "band").integer()
        if dim is None or band is None:
            return None
        wrong = ""
        if dim != size:
            wrong = f"dim is {dim}, but {size} values are observed"
        elif band >= dim:
            wrong = f"band is {band}; valid: 0 to {dim - 1}"
        if wrong:
            self.source.wrong(element.line, f"<cov-mat>: {wrong}")
            return None
        what = f"<cov-mat> of dim {dim} and band {band}"
        matrix = banded(self.source.field(element.line, element.text, what), dim, band)
        if matrix is not None and not np.all(np.diag(matrix) > 0):
            self.source.wrong(element.line, "<cov-mat> needs variances > 0")
            return None
        return matrix


def banded(field: Field, dim: int, band: int) -> Array | None:
    """Return the symmetric matrix (dim, dim) of a field; None after a problem.

    Args:
        field: upper triangle within the band, row by row.
        dim: number of rows.
        band: number of diagonals above the first.
    """
    numbers = field.numbers(dim * (band + 1) - band * (band + 1) // 2)
    if is_unread(numbers):
        return None
    matrix, first = np.zeros((dim, dim)), 0
    for i in range(dim):
        last = min(dim, i + band + 1)
        matrix[i, i:last] = matrix[i:last, i] = numbers[first : first + last - i]
        first += last - i
    return matrix


def _cluster_function(
    members: list[PendingObservation], own: list[Array]
) -> Callable[[Array], Correlated]:
    """Return a function that makes a cluster from its joint covariance.

    ``own`` are the covariance matrices of the members, the diagonal blocks.
    """
    return lambda joint: Correlated(
        tuple(p.make(q) for p, q in zip(members, own, strict=True)), joint
    )


def _uncorrelated_groups(covariance: Array, rows: list[Array]) -> list[list[int]]:
    """Split observations into mutually uncorrelated groups."""
    if len(rows) == 1:  # large networks have thousands of single vectors
        return [[0]]
    owner = np.concatenate([np.full(len(r), i) for i, r in enumerate(rows)])
    i, j = np.nonzero(covariance)
    joined = coo_array((np.ones(len(i)), (owner[i], owner[j])), shape=(len(rows), len(rows)))
    number, group = connected_components(joined, directed=False)
    return [np.flatnonzero(group == g).tolist() for g in range(number)]
