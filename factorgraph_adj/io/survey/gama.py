"""Reader of networks of GNU Gama: ``.gkf``, the XML input of gama-local.

Format: A. Čepek, GNU Gama 2.33, manual, chapter "XML input data format for gama-local".
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
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
from ...units import ARCSEC, CC, GON, LENGTH, parse_angle
from ..xml_files import Element
from .gama_elements import (
    DEFAULT_STDEV_ATTRIBUTES,
    GamaPoints,
    GamaSource,
    GamaWeights,
    PendingObservation,
)

MM = LENGTH["mm"]
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
    source = GamaSource(Path(path))
    reader = _Reader(source)
    network = reader.read()
    source.raise_problems()
    return network


@dataclass(frozen=True)
class _Setup:
    """Data that the observations of one ``<obs>`` share."""

    station: str
    height: float
    set: str
    defaults: Element


class _Reader:
    def __init__(self, source: GamaSource) -> None:
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
            self.source.add(self.source.root, f"must have one <network>, not {len(networks)}")
            self.source.raise_problems()
        (top,) = networks
        axes = self.source.choice(
            top, "axes-xy", ("ne", "sw", "es", "wn", "en", "nw", "se", "ws"), "ne"
        )
        angles = self.source.choice(top, "angles", ("left-handed", "right-handed"), "left-handed")
        self.source.number(top, "epoch", default=0.0)
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
        if not self.source.problems:
            network.add(*self.weights.observations)
        return network

    def _parameters(self, element: Element) -> None:
        number, choice = self.source.number, self.source.choice
        self.sigma_apr = number(element, "sigma-apr", default=self.sigma_apr, positive=True)
        for name in ("conf-pr", "tol-abs"):
            number(element, name, default=1.0, positive=True)
        choice(element, "sigma-act", ("apriori", "aposteriori"), "aposteriori")
        for name in ("angular", "angles"):
            choice(element, name, ("400", "360"), "400")

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
        self.source.number(group, "orientation", default=0.0)
        self._find_reverse(group)
        height = self.source.number(group, "from_dh", default=0.0)
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
        before = len(self.source.problems)
        for element in group.children:
            if element.tag in ("direction", "z-angle"):
                key = element.tag, element.attributes.get("to", "")
                angle = self._angular(element)[0]
                of_target.setdefault(key, []).append((element, angle))
        # What is no angle is noted where it is read.
        del self.source.problems[before:]
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
        before = len(self.source.problems)
        cls = _SIGHTS[element.tag]
        station, target = self._ends(element, setup.station)
        if element.tag in ("distance", "s-distance"):
            value, unit = self.source.number(element, "val", positive=True), MM
            sigma = self._stdev(element, self._default_of_distance(setup.defaults, value))
        else:
            value, unit = self._angular(element)
            value *= 1.0 if element.tag == "z-angle" else self.sense
            value += math.pi if id(element) in self.reverse else 0.0
            if element.tag == "z-angle" and value > math.pi:
                value = 2 * math.pi - value
            default = self.source.positive(setup.defaults, DEFAULT_STDEV_ATTRIBUTES[element.tag])
            sigma = self._stdev(element, default)
        hi = self.source.number(element, "from_dh", default=setup.height)
        ht = self.source.number(element, "to_dh", default=0.0)
        plan, height = element.tag not in ("z-angle",), element.tag in ("z-angle", "s-distance")
        for name in (station, target):
            self.points.require(element, name, plan=plan, height=height)
        if len(self.source.problems) > before:
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
                source=self.source.place(element),
                **of_set,
            ),
        )

    def _angle(self, element: Element, setup: _Setup) -> PendingObservation | None:
        before = len(self.source.problems)
        station, target = self._ends(element, setup.station, to="bs")
        target2 = self.source.name(element, "fs")
        value, unit = self._angular(element)
        default = self.source.positive(setup.defaults, DEFAULT_STDEV_ATTRIBUTES["angle"])
        sigma = self._stdev(element, default)
        hi = self.source.number(element, "from_dh", default=setup.height)
        ht = self.source.number(element, "bs_dh", default=0.0)
        ht2 = self.source.number(element, "fs_dh", default=0.0)
        for name in (station, target, target2):
            self.points.require(element, name, plan=True)
        if len(self.source.problems) > before:
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
                source=self.source.place(element),
            ),
        )

    def _height_difference(self, element: Element, station: str) -> PendingObservation | None:
        before = len(self.source.problems)
        station, target = self._ends(element, station)
        value = self.source.number(element, "val")
        length = self.source.positive(element, "dist")
        sigma = self._stdev(element, None if length is None else self.sigma_apr * length**0.5)
        for name in (station, target):
            self.points.require(element, name, height=True)
        if len(self.source.problems) > before:
            return None
        return PendingObservation(
            element,
            (MM,),
            sigma,
            lambda q: HeightDifference(
                station,
                target,
                value,
                sigma=math.sqrt(q[0, 0]),
                length_km=length,
                source=self.source.place(element),
            ),
        )

    def _vector(self, element: Element) -> PendingObservation | None:
        before = len(self.source.problems)
        station, target = self._ends(element, "")
        x, y, z = (self.source.number(element, a) for a in ("dx", "dy", "dz"))
        hi = self.source.number(element, "from_dh", default=0.0)
        ht = self.source.number(element, "to_dh", default=0.0)
        for name in (station, target):
            self.points.require(element, name, plan=True, height=True)
        if len(self.source.problems) > before:
            return None
        return PendingObservation(
            element,
            (MM, MM, MM),
            None,
            lambda q: GnssVector(
                station,
                target,
                (x, y, z),
                covariance=q,
                instrument_height=hi,
                target_height=ht,
                source=self.source.place(element),
            ),
        )

    def _coordinates(self, element: Element) -> PendingObservation | None:
        before = len(self.source.problems)
        name = self.source.name(element, "id")
        axes = "".join(a for a in "xyz" if a in element.attributes)
        values = tuple(self.source.number(element, a) for a in axes)
        if not axes:
            self.source.add(element, "an observed point needs x and y, or z, or all three")
        self.points.require(element, name, plan="x" in axes, height="z" in axes)
        if len(self.source.problems) > before:
            return None
        return PendingObservation(
            element,
            (MM,) * len(axes),
            None,
            lambda q: ControlPoint(
                name, values, axes=axes, covariance=q, source=self.source.place(element)
            ),
        )

    def _ends(self, element: Element, station: str, *, to: str = "to") -> tuple[str, str]:
        if "from" in element.attributes or not station:
            station = self.source.name(element, "from")
        return station, self.source.name(element, to)

    def _angular(self, element: Element) -> tuple[float, float]:
        """Return ``val`` in radians, and the unit of its standard deviation in radians."""
        text = element.attributes.get("val", "")
        if not _DMS.match(text):
            return self.source.number(element, "val") * GON, CC
        try:
            return parse_angle(text, "dms"), ARCSEC
        except ValueError as error:
            self.source.add(element, f"val: {error}")
            return math.nan, ARCSEC

    def _stdev(self, element: Element, default: float | None) -> float | None:
        given = self.source.positive(element, "stdev")
        return default if given is None else given

    def _default_of_distance(self, section: Element, length: float) -> float | None:
        """Return a + b Dᶜ in mm, D in km; None where the section states no default."""
        text = section.attributes.get("distance-stdev", "")
        if not text or not length > 0:
            return None
        try:
            a, b, c = (*(float(w) for w in text.split()), *(0.0, 1.0)[len(text.split()) - 1 :])
        except ValueError:
            a = b = c = math.nan
        sigma = a + b * float((length / 1000.0) ** c)
        if not 0 < sigma < math.inf:
            self.source.add(section, f"distance-stdev must be a, a b or a b c, not {text!r}")
            return None
        return sigma
