"""Reader of ``.gkf``, the XML input of GNU Gama (gama-local): points, observations, covariances.

Format: A. Čepek, GNU Gama 2.33, manual, chapter "XML input data format for gama-local".
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ...frames import LocalFrame
from ...network.network import Network
from ...observations import (
    Azimuth,
    ControlPoint,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    SlopeDistance,
    ZenithAngle,
)
from ...units import ARCSEC, CC, GON, MILLIMETRE, parse_angle
from ..format_reader import NetworkReader, Reader, begins_with
from ..source import Field, Problems
from ..xml_files import Element
from ..xml_source import XmlSource
from .gama_elements import (
    DEFAULT_STDEV_ATTRIBUTES,
    GamaPoints,
    GamaWeights,
    PendingObservation,
    gama_source,
)

DEFAULT_SIGMA_APR = 10.0
MAX_FACE_DIFFERENCE_RAD = 0.05
"""Difference from π, radians, of two readings of one target that are two faces: far above any
collimation error, far below the angle between two targets of a set that a wrong name confuses."""
_DMS = re.compile(r"^[+-]?\d+-\d+-")
_SIGHTS: dict[str, type[Direction | Azimuth | ZenithAngle | SlopeDistance]] = {
    "direction": Direction,
    "azimuth": Azimuth,
    "z-angle": ZenithAngle,
    "distance": HorizontalDistance,
    "s-distance": SlopeDistance,
}


def read_gama(path: str | Path) -> Network:
    """Read a network of GNU Gama.

    The coordinates stay the file's x, y, z: the frame's axes are ``axes-xy``. Angles of
    ``angles="right-handed"`` (counter-clockwise), including azimuths, change their sign.
    Every observation states its file and line (``source``).

    Differences between Gama and this package:

    - Gama's weights are p = (sigma-apr / stdev)², ours 1 / stdev²: vᵀPv of Gama = sigma-apr² ·
      vᵀPv here, m0' = sigma-apr · sigma0. Coordinates and redundancy are the same. Gama scales
      its standard deviations by m0' where sigma-act is "aposteriori" (the default):
      ``adjust(network, variance="a-posteriori")``. sigma-apr (default 10) enters only
      into the standard deviation of height differences with ``dist``, sigma-apr · √km.
    - Every ``<obs>`` with directions is a set with an orientation unknown of its own.
      ``orientation``, an approximate value, is not needed.
    - Components that are neither ``fix`` nor ``adj`` do not exist in Gama; here they are held,
      at 0 where they have no value. Gama silently leaves out observations that need such
      components; here each of these observations is an error.
    - Uppercase ``adj`` (constrained) makes the network free and its point a datum point;
      without a datum defect it has no effect, as in Gama.
    - ``tol-abs`` is not applied: Gama leaves out observations that disagree with the approximate
      coordinates by more than this tolerance; here every observation takes part.
    - Angles in degrees (41-28-15.8) have standard deviations and covariances in arc seconds,
      those in gon in cc. ``angular`` concerns the output of Gama only.
    - A zenith angle of more than 200 gon is a reading in the second face. So is the direction to
      the same target, where the set has it half a circle from one in the first face; Gama takes
      such a set for gross errors.
    - A point may appear several times if repeated statements agree.

    Args:
        path: the file.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = gama_source(Path(path))
    reader = _Reader(source)
    network = reader.read()
    source.problems.finish(network)
    return network


@dataclass(frozen=True)
class _Setup:
    """Data that the observations of one ``<obs>`` share."""

    station: str
    height: float
    set: str
    defaults: Element


class _Reader:
    def __init__(self, source: XmlSource) -> None:
        self.source = source
        self.points = GamaPoints(source)
        self.weights = GamaWeights(source)
        self.sigma_apr = DEFAULT_SIGMA_APR
        self.sense = 1.0
        self.sets: dict[str, int] = {}
        self.reverse: set[int] = set()
        """Identities of the directions that were read in the second face."""

    def read(self) -> Network:
        """Return the network; problems are noted in ``source``."""
        networks = list(self.source.root.all("network"))
        if len(networks) != 1:
            self.source.wrong(
                self.source.root.line, f"must have one <network>, not {len(networks)}"
            )
            self.source.raise_all()
        (top,) = networks
        attribute = partial(self.source.attribute, top)
        axes = attribute("axes-xy").word(("ne", "sw", "es", "wn", "en", "nw", "se", "ws"), "ne")
        angles = attribute("angles").word(("left-handed", "right-handed"), "left-handed")
        attribute("epoch").number(default=0.0)
        self.sense = 1.0 if angles == "left-handed" else -1.0
        for parameters in top.all("parameters"):
            self._parameters(parameters)
        sections = list(top.all("points-observations"))
        for section in sections:
            self.points.read(section)
        for section in sections:
            self._section(section)
        lines = [t.strip() for d in top.all("description") for t in d.text.splitlines()]
        network = Network(
            next((t for t in lines if t), self.source.path.stem),
            frame=LocalFrame(axes=axes),  # type: ignore[arg-type]
            datum="free" if self.points.constrained else "given",
        )
        self.points.add_to(network)
        if not self.source.problems.count:
            network.add(*self.weights.observations)
        return network

    def _parameters(self, element: Element) -> None:
        attribute = partial(self.source.attribute, element)
        self.sigma_apr = attribute("sigma-apr").number(default=self.sigma_apr, above=0.0)
        for name in ("conf-pr", "tol-abs"):
            attribute(name).number(default=1.0, above=0.0)
        attribute("sigma-act").word(("apriori", "aposteriori"), "aposteriori")
        for name in ("angular", "angles"):
            attribute(name).word(("400", "360"), "400")

    # -- groups of observations -----------------------------------------------------------------

    def _section(self, section: Element) -> None:
        for group in section.children:
            if group.tag == "obs":
                self.weights.weigh(group, self._obs(group, section))
            elif group.tag == "height-differences":
                self.weights.weigh(group, [self._height_difference(e, "") for e in group.all("dh")])
            elif group.tag == "vectors":
                self.weights.weigh(group, [self._vector(e) for e in group.all("vec")])
            elif group.tag == "coordinates":
                self.weights.weigh(group, [self._coordinates(e) for e in group.all("point")])

    def _obs(self, group: Element, section: Element) -> list[PendingObservation | None]:
        station = group.attributes.get("from", "")
        number = ""
        if any(group.all("direction")):
            self.sets[station] = self.sets.get(station, 0) + 1
            number = str(self.sets[station])
        self.source.attribute(group, "orientation").number(default=0.0)
        self._find_reverse(group)
        height = self.source.attribute(group, "from_dh").number(default=0.0)
        setup = _Setup(station, height, number, section)
        out = []
        for element in group.children:
            if element.tag == "angle":
                out.append(self._angle(element, setup))
            elif element.tag == "dh":
                out.append(self._height_difference(element, station))
            elif element.tag in _SIGHTS:
                out.append(self._sight(element, setup))
        return out

    def _find_reverse(self, group: Element) -> None:
        """Note the directions of a set that were read in the second face.

        A set has one orientation: a target read twice, half a circle apart, with one zenith angle
        beyond 200 gon, was read in both faces. The n-th direction to a target belongs to the n-th
        zenith angle to it.
        """
        of_target: dict[tuple[str, str], list[tuple[Element, float]]] = {}
        for element in group.children:
            if element.tag in ("direction", "z-angle"):
                key = element.tag, element.attributes.get("to", "")
                # What is no angle is reported where it is read.
                reading = Problems().field(element.attributes.get("val"), "val", "")
                of_target.setdefault(key, []).append((element, angle_of(reading)[0]))
        for (tag, target), directions in of_target.items():
            zeniths = of_target.get(("z-angle", target), [])
            if tag != "direction" or len(zeniths) != len(directions):
                continue
            faces = [2 if z > math.pi else 1 for _, z in zeniths]
            for (element, value), face in zip(directions, faces, strict=True):
                apart = [
                    abs(abs(math.remainder(value - v, 2 * math.pi)) - math.pi)
                    for (_, v), f in zip(directions, faces, strict=True)
                    if f == 1
                ]
                if face == 2 and min(apart, default=math.inf) < MAX_FACE_DIFFERENCE_RAD:
                    self.reverse.add(id(element))

    # -- single observations ----------------------------------------------------------------------

    def _sight(self, element: Element, setup: _Setup) -> PendingObservation | None:
        before = self.source.problems.count
        cls = _SIGHTS[element.tag]
        station, target = self._ends(element, setup.station)
        if element.tag in ("distance", "s-distance"):
            value, unit = self.source.attribute(element, "val").number(above=0.0), MILLIMETRE
            sigma = self._stdev(element, self._default_of_distance(setup.defaults, value))
        else:
            value, unit = angle_of(self.source.attribute(element, "val"))
            value *= 1.0 if element.tag == "z-angle" else self.sense
            value += math.pi if id(element) in self.reverse else 0.0
            if element.tag == "z-angle" and value > math.pi:
                value = 2 * math.pi - value
            sigma = self._stdev(element, self._default_stdev(element, setup))
        hi = self.source.attribute(element, "from_dh").number(default=setup.height)
        ht = self.source.attribute(element, "to_dh").number(default=0.0)
        plan, height = element.tag not in ("z-angle",), element.tag in ("z-angle", "s-distance")
        for name in (station, target):
            self.points.require(element, name, plan=plan, height=height)
        if self.source.problems.count > before:
            return None
        of_set: dict[str, Any] = {"set": setup.set} if cls is Direction else {}
        return PendingObservation(
            element,
            (unit,),
            sigma,
            lambda q: cls(
                station,
                target,
                value,
                sigma=math.sqrt(q[0, 0]),
                instrument_height=hi,
                target_height=ht,
                source=self.source.place(element.line),
                **of_set,
            ),
        )

    def _angle(self, element: Element, setup: _Setup) -> PendingObservation | None:
        before = self.source.problems.count
        station, target = self._ends(element, setup.station, to="bs")
        target2 = self.source.attribute(element, "fs").name()
        value, unit = angle_of(self.source.attribute(element, "val"))
        sigma = self._stdev(element, self._default_stdev(element, setup))
        hi = self.source.attribute(element, "from_dh").number(default=setup.height)
        ht = self.source.attribute(element, "bs_dh").number(default=0.0)
        ht2 = self.source.attribute(element, "fs_dh").number(default=0.0)
        for name in (station, target, target2):
            self.points.require(element, name, plan=True)
        if self.source.problems.count > before:
            return None
        return PendingObservation(
            element,
            (unit,),
            sigma,
            lambda q: HorizontalAngle(
                station,
                target,
                target2,
                self.sense * value,
                sigma=math.sqrt(q[0, 0]),
                instrument_height=hi,
                target_height=ht,
                target2_height=ht2,
                source=self.source.place(element.line),
            ),
        )

    def _height_difference(self, element: Element, station: str) -> PendingObservation | None:
        before = self.source.problems.count
        station, target = self._ends(element, station)
        value = self.source.attribute(element, "val").number()
        length = self.source.attribute(element, "dist").number(above=0.0, default=math.nan)
        sigma = self._stdev(element, self.sigma_apr * length**0.5)
        for name in (station, target):
            self.points.require(element, name, height=True)
        if self.source.problems.count > before:
            return None
        return PendingObservation(
            element,
            (MILLIMETRE,),
            sigma,
            lambda q: HeightDifference(
                station,
                target,
                value,
                sigma=math.sqrt(q[0, 0]),
                length_km=None if math.isnan(length) else length,
                source=self.source.place(element.line),
            ),
        )

    def _vector(self, element: Element) -> PendingObservation | None:
        before = self.source.problems.count
        station, target = self._ends(element, "")
        x, y, z = (self.source.attribute(element, a).number() for a in ("dx", "dy", "dz"))
        hi = self.source.attribute(element, "from_dh").number(default=0.0)
        ht = self.source.attribute(element, "to_dh").number(default=0.0)
        for name in (station, target):
            self.points.require(element, name, plan=True, height=True)
        if self.source.problems.count > before:
            return None
        return PendingObservation(
            element,
            (MILLIMETRE, MILLIMETRE, MILLIMETRE),
            math.nan,
            lambda q: GnssVector(
                station,
                target,
                (x, y, z),
                covariance=q,
                instrument_height=hi,
                target_height=ht,
                source=self.source.place(element.line),
            ),
        )

    def _coordinates(self, element: Element) -> PendingObservation | None:
        before = self.source.problems.count
        name = self.source.attribute(element, "id").name()
        axes = "".join(a for a in "xyz" if a in element.attributes)
        values = tuple(self.source.attribute(element, a).number() for a in axes)
        if not axes:
            self.source.wrong(element.line, "an observed point needs x and y, or z, or all three")
        self.points.require(element, name, plan="x" in axes, height="z" in axes)
        if self.source.problems.count > before:
            return None
        return PendingObservation(
            element,
            (MILLIMETRE,) * len(axes),
            math.nan,
            lambda q: ControlPoint(
                name, values, axes=axes, covariance=q, source=self.source.place(element.line)
            ),
        )

    def _ends(self, element: Element, station: str, *, to: str = "to") -> tuple[str, str]:
        if "from" in element.attributes or not station:
            station = self.source.attribute(element, "from").name()
        return station, self.source.attribute(element, to).name()

    def _stdev(self, element: Element, default: float) -> float:
        return self.source.attribute(element, "stdev").number(above=0.0, default=default)

    def _default_stdev(self, element: Element, setup: _Setup) -> float:
        """Return the default of the section; NaN where it states none."""
        field = self.source.attribute(setup.defaults, DEFAULT_STDEV_ATTRIBUTES[element.tag])
        return field.number(above=0.0, default=math.nan)

    def _default_of_distance(self, section: Element, length: float) -> float:
        """Return a + b Dᶜ in mm, D in km; NaN where the section states no default."""
        field = self.source.attribute(section, "distance-stdev")
        if field.is_absent or not length > 0:
            return math.nan
        words = str(field.value).split()
        if not 1 <= len(words) <= 3:
            field.wrong(f"must be a, a b or a b c, not {field.value!r}")
            return math.nan
        a, b, c = (*field.numbers(len(words)), *(0.0, 1.0)[len(words) - 1 :])
        sigma = a + b * float((length / 1000.0) ** c)
        if sigma <= 0 or math.isinf(sigma):
            field.wrong(f"gives no standard deviation: {field.value!r}")
            return math.nan
        return sigma


def angle_of(field: Field) -> tuple[float, float]:
    """Return an angle in radians, and the unit of its standard deviation in radians."""
    text = str(field.value or "")
    if not _DMS.match(text):
        return field.number(scale=GON), CC
    try:
        return parse_angle(text, "dms"), ARCSEC
    except ValueError as error:
        field.wrong(f": {error}")
        return math.nan, ARCSEC


READER = Reader(
    "gama",
    (".gkf",),
    "GNU Gama",
    NetworkReader(read_gama),
    recognises=begins_with(rb"[^<]*(<[?!][^>]*>\s*)*<(gama-local|gama-xml)[\s>]"),
)
