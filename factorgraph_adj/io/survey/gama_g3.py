"""Reader of the XML input of gama-g3, GNU Gama's adjustment on the ellipsoid.

Grammar: GNU Gama 2.33, xml/gnu-gama-data.xsd, and its parser, lib/gnu_gama/xml/dataparser_g3.cpp;
the models are in lib/gnu_gama/g3. There is no manual.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import (
    GnssPosition,
    GnssVector,
    HorizontalAngle,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ...observations.ellipsoidal_observations import (
    EllipsoidHeight,
    EllipsoidHeightDifference,
    GeodeticAzimuth,
)
from ...types import Array
from ...units import MILLIMETRE
from ..format_reader import NetworkReader, Reader, begins_with
from ..source import LeftOutReason, Problems
from ..xml_files import Element
from ..xml_source import XmlSource
from .gama import angle_of
from .gama_elements import GamaWeights, PendingObservation, banded
from .gama_g3_points import STATES, G3Points

_HEIGHTS = ("from-dh", "to-dh")
_WEIGHT = ("stdev", "variance")
_SIGHT = ("from", "to", "val", *_WEIGHT, *_HEIGHTS)
G3_CHILDREN: dict[str, tuple[str, ...]] = {
    "gnu-gama-data": ("text", "g3-model"),
    "g3-model": ("constants", *STATES, "point", "obs"),
    "constants": (
        *("apriori-standard-deviation", "confidence-level", "tol-abs", "ellipsoid"),
        *("reference-variance-apriori", "reference-variance-apriory"),
        *("reference-variance-aposteriori", "angular-units-degrees", "angular-units-gons"),
    ),
    "ellipsoid": ("id", "a", "b", "inv-f"),
    **dict.fromkeys(STATES, ("n", "e", "u")),
    "point": ("id", "x", "y", "z", "b", "l", "h", "height", "geoid", "db", "dl", *STATES),
    "obs": (
        *("vector", "xyz", "distance", "zenith", "azimuth", "height", "hdiff", "angle"),
        "cov-mat",
    ),
    "vector": ("from", "to", "dx", "dy", "dz", *_HEIGHTS),
    "xyz": ("id", "x", "y", "z"),
    "distance": _SIGHT,
    "zenith": _SIGHT,
    "azimuth": _SIGHT,
    "hdiff": ("from", "to", "val", *_WEIGHT),
    "angle": ("from", "left", "right", "val", *_WEIGHT, "from-dh", "left-dh", "right-dh"),
    "cov-mat": ("dim", "band", "flt"),
}
"""Children of the elements; ``height`` has one more meaning in a point."""
G3_CHILDREN |= {
    leaf: ()
    for tags in tuple(G3_CHILDREN.values())
    for leaf in tags
    if leaf not in G3_CHILDREN and leaf != "height"
}
OF_UNUSED_POINTS = LeftOutReason("observations", "the file says that their points are unused")


def read_gama_g3(path: str | Path) -> Network:
    """Read a network of gama-g3 (``<gnu-gama-data>`` with ``<g3-model>``).

    The frame is geocentric. Coordinates of points are x, y, z or b, l, h (degrees, minutes and
    seconds such as 50-49-19.404); the states ``fixed``, ``free``, ``constr`` and ``unused`` of n,
    e, u apply to the points that follow, or to the point in which they stand. ``constr`` points are
    the datum of a free network; a point that is fixed in some components and free in others is held
    by observed components with a standard deviation of 1 µm.

    | element | observation |
    | --- | --- |
    | vector, xyz | `GnssVector`, `GnssPosition` |
    | distance, zenith | `SlopeDistance`, `ZenithAngle` |
    | azimuth | `GeodeticAzimuth`: Gama ignores deflections |
    | angle | `HorizontalAngle` from left clockwise to right |
    | height, hdiff | `EllipsoidHeight`, `EllipsoidHeightDifference` above the geoid of the points |

    Covariances and standard deviations are in mm² and mm, of angles in gon in cc, of those in
    degrees (D-M-S) in seconds. ``from-dh``, ``to-dh`` are heights of instrument and target, ``db``,
    ``dl`` of a point the differences of astronomic and geodetic latitude and longitude in seconds.

    Differences between Gama and this package: weights of Gama are (m0/σ)², so that its sum of
    squares is the square of ``apriori-standard-deviation`` times vᵀPv here; ``tol-abs``, beyond
    which Gama leaves out observations, is not applied; Gama makes one step from its approximate
    coordinates, here an adjustment iterates. ``text``, the confidence level, the units of the
    output, its variance factor and approximate heights of points (``height``) are not used.
    Ellipsoids are those that the package knows, by name or by axes.

    Tried on the demos, the GNSS networks of Ghilani and the S-JTSK/05 networks of Gama.

    Args:
        path: the file.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = XmlSource(path, "gnu-gama-data")
    network = _Reader(source).read()
    source.problems.finish(network)
    return network


@dataclass
class _Group:
    """Observations of one ``<obs>`` and the blocks of their covariance."""

    pending: list[PendingObservation] = field(default_factory=list)
    blocks: list[Array] = field(default_factory=list)


class _Reader:
    def __init__(self, source: XmlSource) -> None:
        self.source = source
        self.problems: Problems = source.problems
        self.points = G3Points(source)
        self.weights = GamaWeights(source)

    def read(self) -> Network:
        """Return the network; problems are noted in the source."""
        self.source.refuse_children(self.source.root, G3_CHILDREN)
        self.source.refuse_attributes(self.source.root, dict.fromkeys((*G3_CHILDREN, "height"), ()))
        top = self.source.child(self.source.root, "g3-model")
        if top is None:
            self.source.raise_all()
            raise AssertionError  # pragma: no cover
        for constants in top.all("constants"):
            self.points.read_constants(constants)
        for element in top.children:
            if element.tag in (*STATES, "point"):
                self.points.read(element)
        for element in top.all("obs"):
            self._group(element)
        return self._network()

    def _network(self) -> Network:
        network = Network(
            self.source.path.stem,
            frame=GeocentricFrame(self.points.ellipsoid.name),
            datum="free" if self.points.constrained else "given",
        )
        self.points.add_to(network)
        if not self.problems.count:
            for one in self.weights.observations:
                self.problems.attempt(self.source.path.name, network.add, one)
        self.points.state_deflections(network)
        return network

    # -- observations -----------------------------------------------------------------------------

    def _group(self, element: Element) -> None:
        before, group = self.problems.count, _Group()
        for child in element.children:
            if child.tag == "cov-mat":
                matrix = self._matrix(child)
                if matrix is not None:
                    group.blocks.append(matrix)
                continue
            one = self._observation(child)
            if one is not None:
                group.pending.append(one)
            group.blocks += self._own(child)
        if self.problems.count > before:
            return
        size = sum(len(p.units) for p in group.pending)
        rows = sum(len(b) for b in group.blocks)
        if not size:
            self.source.wrong(element.line, "<obs> has no observations")
        elif size != rows:
            what = f"has {size} observed values, but {rows} rows of covariance (stdev, cov-mat)"
            self.source.wrong(element.line, f"<obs> {what}")
        else:
            self._share(element, np.asarray(block_diag(*group.blocks)), group.pending)

    def _share(self, element: Element, matrix: Array, pending: list[PendingObservation]) -> None:
        """Give observations their covariance, without those of unused points."""
        kept: list[PendingObservation] = []
        rows: list[int] = []
        first = 0
        for p in pending:
            size = len(p.units)
            names = [e.text.strip() for e in p.element.children if e.tag in ENDS]
            if any(map(self.points.is_unused, names)):
                label = f"{p.element.tag} {' '.join(names)}"
                self.source.leave_out(p.element.line, OF_UNUSED_POINTS, label)
            else:
                kept.append(p)
                rows += range(first, first + size)
            first += size
        if not kept:
            return
        with self.problems.collect(self.source.place(element.line)):
            self.weights.share(matrix[np.ix_(rows, rows)], kept)

    def _own(self, element: Element) -> Iterator[Array]:
        """Yield the variance that an observation states itself."""
        for child in element.children:
            if child.tag == "stdev":
                sigma = self.source.inside(child).sigma()
                yield np.array([[sigma * sigma]])
            elif child.tag == "variance":
                yield np.array([[self.source.inside(child).number(above=0.0)]])

    def _matrix(self, element: Element) -> Array | None:
        dim = self.source.inside(element, "dim").integer(least=1)
        band = self.source.inside(element, "band").integer()
        if dim is None or band is None:
            return None
        if band >= dim:
            self.source.wrong(element.line, f"<cov-mat>: band is {band}; valid: 0 to {dim - 1}")
            return None
        words = [w for e in element.all("flt") for w in e.text.split()]
        what = f"<cov-mat> of dim {dim} and band {band}"
        matrix = banded(self.source.field(element.line, words, what), dim, band)
        if matrix is not None and not np.all(np.diag(matrix) > 0):
            self.source.wrong(element.line, "<cov-mat> needs variances > 0")
            return None
        return matrix

    def _observation(self, element: Element) -> PendingObservation | None:
        """Return an observation that waits for its weight; None after a problem."""
        before = self.problems.count
        tag = element.tag
        make: Callable[..., Observation]
        more: dict[str, Any] = {"source": self.source.place(element.line)}
        unit = MILLIMETRE

        def number(name: str) -> float:
            return self.source.inside(element, name).number()

        def height(name: str) -> float:
            return self.source.inside(element, name).number(default=0.0)

        if tag in ("vector", "xyz"):
            names = self.points.names(element, *(("id",) if tag == "xyz" else ("from", "to")))
            axes = ("x", "y", "z") if tag == "xyz" else ("dx", "dy", "dz")
            value = tuple(number(a) for a in axes)
            make = GnssPosition if tag == "xyz" else GnssVector
            if tag == "vector":
                more |= {"instrument_height": height("from-dh"), "target_height": height("to-dh")}
            if self.problems.count > before:
                return None
            return _triple(element, make, names, value, more)
        if tag == "height":
            self.source.refuse_children(element, {"height": ("id", "val", *_WEIGHT)})
            names, make = self.points.names(element, "id"), EllipsoidHeight
            single = number("val")
            more["surface"] = self.points.geoid(element, names[0])
        elif tag == "hdiff":
            names, make = self.points.names(element, "from", "to"), EllipsoidHeightDifference
            single = number("val")
            more["station_surface"] = self.points.geoid(element, names[0])
            more["target_surface"] = self.points.geoid(element, names[1])
        elif tag == "angle":
            names, make = self.points.names(element, "from", "left", "right"), HorizontalAngle
            single, unit = angle_of(self.source.inside(element, "val"))
            ends = (("instrument", "from"), ("target", "left"), ("target2", "right"))
            more |= {f"{a}_height": height(f"{b}-dh") for a, b in ends}
        elif tag in SIGHTS:
            names, make = self.points.names(element, "from", "to"), SIGHTS[tag]
            more |= {"instrument_height": height("from-dh"), "target_height": height("to-dh")}
            if tag == "distance":
                single = number("val")
            else:
                single, unit = angle_of(self.source.inside(element, "val"))
        else:
            return None  # noted as an element that cannot be in <obs>
        if self.problems.count > before:
            return None
        return _scalar(element, make, names, single, unit, more)


def _scalar(
    element: Element,
    make: Callable[..., Observation],
    names: list[str],
    value: float,
    unit: float,
    more: dict[str, Any],
) -> PendingObservation:
    """Return an observation of one value that waits for its variance."""
    return PendingObservation(
        element, (unit,), math.nan, lambda q: make(*names, value, sigma=math.sqrt(q[0, 0]), **more)
    )


def _triple(
    element: Element,
    make: Callable[..., Observation],
    names: list[str],
    value: tuple[float, ...],
    more: dict[str, Any],
) -> PendingObservation:
    """Return a vector or a position that waits for its covariance."""
    return PendingObservation(
        element,
        (MILLIMETRE,) * 3,
        math.nan,
        lambda q: make(*names, value, covariance=q, **more),
    )


SIGHTS: dict[str, Callable[..., Observation]] = {
    "distance": SlopeDistance,
    "zenith": ZenithAngle,
    "azimuth": GeodeticAzimuth,
}
"""Elements of sights."""
ENDS = ("id", "from", "to", "left", "right")
"""Elements with names of points."""


READER = Reader(
    "gama-g3",
    (".xml",),
    "GNU Gama g3",
    NetworkReader(read_gama_g3),
    recognises=begins_with(
        rb"[^<]*(<[?!][^>]*>\s*)*<gnu-gama-data[\s>](?!(.|\n)*<g3-adjustment-results)"
    ),
)
