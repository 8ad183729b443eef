"""The spec of a simulation: everything that a simulated network is made from.

Example:
    >>> from factorgraph_adj.simulation.generate.aerial import Aerial
    >>> from factorgraph_adj.simulation.generate.control import Control
    >>> spec = Spec(parts=(Aerial(strips=2, photos_per_strip=4),), control=Control())
    >>> len(design(spec).photos)
    8
    >>> spec.varied({"parts.0.strips": 3}).parts[0].strips
    3
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_type_hints

import numpy as np

from ..errors import InputError, Problem
from ..frames import Frame, LocalFrame, TopocentricFrame
from ..network.entities import Point
from ..network.network import Network
from ..observations import ControlPoint
from .disturbances import Errors, add_gross_errors, drop, read, readings_of, true_plan
from .generate import additions, aerial, close_range, published, terrestrial
from .generate.control import Control
from .generate.part import Part, Scene
from .parameters import BAD, Parameters, changed, convert, number, path_of
from .simulate import Seed, SimulatedNetwork, Truth, disturb, measure
from .write_parameters import to_toml

INDEX = re.compile(r"\[(\d+)\]")
"""A number of a path, as Python writes it."""
MODULES_OF_PARTS = (aerial, close_range, terrestrial, additions, published)
"""Where the kinds of parts are defined: importing them makes them known."""


@dataclass(frozen=True)
class Earth(Parameters):
    """The frame of the network, and the refraction that its adjustment assumes."""

    frame: Literal["local", "topocentric"] = "local"
    """X east, Y north, Z up: local and flat or curved, or over an ellipsoid."""
    curvature: bool = False
    """Let the vertical of a local frame tilt with the curvature of the Earth."""
    latitude_deg: float = number(45.0, above=-90, below=90)
    """Latitude of the origin of a topocentric frame, degrees."""
    longitude_deg: float = number(0.0, least=-180, most=360)
    """Longitude of the origin, degrees."""
    height: float = number(0.0, least=-1000, most=10_000)
    """Height of the origin, metres."""
    refraction: float | None = number(None, least=-2, most=2)
    """Coefficient of refraction κ of the network; none: 0."""
    refraction_unknown: bool = False
    """Whether κ is estimated."""

    def problems(self, where: str) -> list[Problem]:
        """Return what the fields together cannot be."""
        found = []
        if self.curvature and self.frame != "local":
            what = "goes with a local frame; a topocentric one is curved"
            found.append(Problem(what, path_of(where, "curvature")))
        if self.refraction_unknown and self.refraction is None:
            what = "needs a value of refraction to start from"
            found.append(Problem(what, path_of(where, "refraction_unknown")))
        return found

    def made_frame(self) -> Frame:
        """Return the frame."""
        if self.frame == "local":
            return LocalFrame(curvature=self.curvature)
        latitude, longitude = np.deg2rad([self.latitude_deg, self.longitude_deg]).tolist()
        return TopocentricFrame(latitude, longitude, self.height)


@dataclass(frozen=True)
class Approximate(Parameters):
    """How far approximate values are off; standard deviations of normal errors."""

    points: float = number(0.0, least=0)
    """Of free coordinates, metres."""
    centres: float = number(0.0, least=0)
    """Of projection centres, metres."""
    attitudes_deg: float = number(0.0, least=0, most=30)
    """Of attitudes about each axis, degrees."""


@dataclass(frozen=True)
class Spec:
    """What a simulated network is made from; checked when it is made.

    Equal specs with equal seeds make equal networks. The spec's seed is that of the geometry,
    and that of the errors where `simulate` gets none.

    Raises:
        InputError: everything that is wrong, each with the path of its key.
    """

    parts: tuple[Part, ...]
    """The parts, in the order in which they are put in; later ones may name earlier ones by
    number, from 0."""
    name: str = ""
    """Name of the network."""
    seed: int = number(0, least=0)
    """Seed of geometry and, by default, of errors."""
    datum: Literal["given", "free"] = "given"
    """Datum of the network."""
    earth: Earth = field(default_factory=Earth)
    """Frame and refraction."""
    control: Control | None = None
    """Control points; none: those that parts bring along."""
    errors: Errors = field(default_factory=Errors)
    """Errors of the readings."""
    approximate: Approximate = field(default_factory=Approximate)
    """Errors of the approximate values."""

    def __post_init__(self) -> None:
        """Check every field, and make of tables what they stand for."""
        found: list[Problem] = []
        hints = get_type_hints(Spec)
        for f in fields(self):
            value = convert(hints[f.name], getattr(self, f.name), f.name, found, f)
            if value is not BAD:
                object.__setattr__(self, f.name, value)
        if isinstance(self.parts, tuple) and not self.parts:
            found.append(Problem("a spec has at least one part", "parts"))
        if found:
            raise InputError(found)

    def varied(self, levels: Mapping[str, Any]) -> Spec:
        """Return a spec with other values at some paths.

        Args:
            levels: values by path, such as ``{"parts.0.strips": 4, "errors.gross.0.size": 0.1}``;
                all are changed before the spec is checked. ``parts[0].strips`` is the same path.
                What the spec does not have is given as a whole: ``{"control": Control()}``.

        Raises:
            InputError: unknown keys, and what is wrong with the values, all at once.
        """
        found: list[Problem] = []
        record = {f.name: getattr(self, f.name) for f in fields(self)}
        for path, level in levels.items():
            key, *rest = INDEX.sub(r".\1", path).split(".")
            if key not in record:
                found.append(Problem(f"unknown key; valid: {', '.join(record)}", key))
                continue
            record[key] = changed(record[key], rest, level, key, found)
        try:
            made = Spec(**record)
        except InputError as error:
            raise InputError([*found, *error.problems]) from None
        if found:
            raise InputError(found)
        return made

    def to_toml(self) -> str:
        """Return the spec as TOML, which `read_spec` reads as an equal spec.

        Keys that are not set are there as comments.
        """
        return to_toml(self)


def design(spec: Spec) -> Network:
    """Return the network of a spec with true values, to be planned with or measured.

    Observations have their true values too; points that are not control points have their true
    coordinates as check coordinates.

    Raises:
        InputError: what only shows when the parts are put together: points that do not exist,
            names used twice, all at once as far as one part does not need another.
    """
    plan = _plan(spec)
    return measure(plan, seed=spec.seed, noise=False)


def simulate(spec: Spec, *, seed: Seed | None = None) -> SimulatedNetwork:
    """Simulate the measurements of a spec.

    Args:
        spec: what is measured and what goes wrong.
        seed: seed of noise, gross errors, drop-outs and approximate values; none: the spec's.

    Returns:
        The network with approximate values, its truth, the gross errors in it and what was lost.

    Raises:
        InputError: as `design`; a seed that is no whole number ≥ 0.
    """
    seed = spec.seed if seed is None else _checked(seed)
    plan = _plan(spec)
    true = true_plan(plan, spec.errors)
    network = read(plan, true, spec.errors, seed=seed)
    gross = add_gross_errors(network, spec.errors, seed=seed)
    network, dropped = drop(network, spec.errors, gross, seed=seed)
    # A point that nothing determines any more may take a gross error with it.
    left = readings_of(network) if dropped else gross
    gross = {reading: size for reading, size in gross.items() if reading in left}
    by = spec.approximate
    network = disturb(
        network,
        seed=seed,
        points=by.points,
        centres=by.centres,
        attitudes=float(np.deg2rad(by.attitudes_deg)),
    )
    return SimulatedNetwork(network, Truth.of(true), gross, dropped)


def _checked(seed: object) -> Seed:
    """Return a seed; InputError where it is none."""
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool) and seed >= 0:
        return int(seed)
    raise InputError(Problem(f"must be a whole number ≥ 0, not {seed!r}", "seed"))


def _plan(spec: Spec) -> Network:
    """Return the plan of a spec: true values, nothing read yet."""
    plan = Network(spec.name, frame=spec.earth.made_frame(), datum=spec.datum)
    if spec.earth.refraction is not None:
        free = spec.earth.refraction_unknown
        plan.set_refraction(value=spec.earth.refraction, fixed=not free)
    scene = Scene(plan, spec.seed)
    found: list[Problem] = []
    for i, part in enumerate(spec.parts):
        scene.number = i
        try:
            part.add_to(scene)
        except InputError as error:
            scene.failed.add(i)
            found += [
                p if f"{p.where}.".startswith(f"{scene.where}.") else Problem(str(p), scene.where)
                for p in error.problems
            ]
        # A part that failed has no points, or later ones would be counted wrongly.
        scene.points += [[]] * (i + 1 - len(scene.points))
    if not found:
        if spec.control is not None:
            found += spec.control.apply(scene, "control")
        found += spec.errors.unknown(plan, "errors")
    if found:
        raise InputError(found)
    known_axes: dict[str, set[str]] = {}
    for o in plan.observations.values():
        if isinstance(o, ControlPoint):
            known_axes.setdefault(o.point, set()).update(o.axes)
    plan.points = {
        name: _with_check(p, known_axes.get(name, set())) for name, p in plan.points.items()
    }
    return plan


def _with_check(point: Point, observed: set[str]) -> Point:
    """Return a point with its true coordinates to check what is neither held nor observed."""
    rows = zip("xyz", point.coordinates, point.fixed, strict=True)
    check = tuple(np.nan if held or a in observed else v for a, v, held in rows)
    if all(np.isnan(check)):
        return point
    return replace(point, check=check)  # type: ignore[arg-type]
