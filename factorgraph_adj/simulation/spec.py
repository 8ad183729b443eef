"""The spec of a simulation, its design and its measurement; all parameters in TOML files.

Example:
    >>> from factorgraph_adj.simulation.generate.photo_blocks import Aerial
    >>> from factorgraph_adj.simulation.generate.control import Control
    >>> spec = Spec(parts=(Aerial(strips=2, photos_per_strip=4),), control=Control())
    >>> len(design(spec).photos)
    8
    >>> spec.varied({"parts.0.strips": 3}).parts[0].strips
    3

Example:
    ::

        name = "a small block"
        [[parts]]
        kind = "aerial"
        strips = 2
        [control]
        horizontal = "perimeter"
        vertical = "full"
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, get_type_hints

import numpy as np

from ..entities import Point
from ..errors import InputError, Problem, known
from ..frames import Frame, LocalFrame, TopocentricFrame
from ..io.project_writer import toml_value
from ..io.text_files import parse_toml, read_text
from ..network.network import Network
from ..observations.base import of_quantities
from ..observations.registry import CONTROL_QUANTITIES
from .disturbances import Errors, add_gross_errors, drop, read, readings_of, true_plan
from .generate import (
    flight_observations,
    metrology,
    photo_blocks,
    rigs_and_models,
    terrestrial_additions,
    terrestrial_networks,
)
from .generate.control import Control
from .generate.scene import Part, Scene
from .measurement import Seed, SimulatedNetwork, Truth, disturb, measure
from .parameters import BAD, Parameters, changed, convert, number, path_of

BARE = re.compile(r"[A-Za-z0-9_-]+")
"""Pattern of keys that need no quotes."""
INDEX = re.compile(r"\[(\d+)\]")
"""Pattern of an index in a path in Python notation, such as ``[0]``."""
MODULES_OF_PARTS = (
    photo_blocks,
    photo_blocks,
    terrestrial_networks,
    metrology,
    terrestrial_additions,
    flight_observations,
    rigs_and_models,
)
"""Modules that define the kinds of parts; their import registers the kinds, and so does that of a
user's module with subclasses of `Part`."""


def to_toml(value: Any) -> str:
    """Return a dataclass of parameters as TOML.

    Defaults are written too, so that the text does not depend on later changes of defaults. TOML
    cannot express None; keys without a value are written as comments.
    """
    return "\n".join(_table(value, "")).strip() + "\n"


def _table(value: Any, path: str) -> Iterator[str]:
    """Yield the lines of a dataclass or a mapping; keys with tables of their own come last."""
    if isinstance(value, Mapping):
        items = list(value.items())
    else:
        items = [(f.name, getattr(value, f.name)) for f in fields(value)]
        if isinstance(value, Parameters) and value.kind:
            items.insert(0, ("kind", value.kind))
    tables = []
    for key, inner in items:
        if _is_table(inner) or (isinstance(inner, tuple) and any(map(_is_table, inner))):
            tables.append((key, inner))
        elif inner is None:
            yield f"# {_key(key)} = …  (not set)"
        else:
            yield f"{_key(key)} = {toml_value(inner)}"
    for key, inner in tables:
        name = f"{path}.{_key(key)}" if path else _key(key)
        if isinstance(inner, tuple):
            for one in inner:
                yield from ("", f"[[{name}]]", *_table(one, name))
        elif isinstance(inner, Mapping) and not inner:
            yield from ("", f"# [{name}]  (empty)")
        else:
            yield from ("", f"[{name}]", *_table(inner, name))


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) or dataclasses.is_dataclass(value)


def _key(name: str) -> str:
    return name if BARE.fullmatch(name) else toml_value(name)


@dataclass(frozen=True)
class Earth(Parameters):
    """The frame of the network, and the refraction that its adjustment assumes."""

    frame: Literal["local", "topocentric"] = "local"
    """Frame with X east, Y north, Z up: local (flat or curved), or topocentric on an ellipsoid."""
    curvature: bool = False
    """Whether the vertical of a local frame follows the curvature of the Earth."""
    latitude_deg: float = number(45.0, above=-90, below=90)
    """Latitude of the origin of a topocentric frame, degrees."""
    longitude_deg: float = number(0.0, least=-180, most=360)
    """Longitude of the origin of a topocentric frame, degrees."""
    height: float = number(0.0, least=-1000, most=10_000)
    """Height of the origin of a topocentric frame, metres."""
    refraction: float | None = number(None, least=-2, most=2)
    """Coefficient of refraction κ of the network; None: 0."""
    refraction_unknown: bool = False
    """Whether κ is estimated."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
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
    """Standard deviations of the normal errors of approximate values."""

    points: float = number(0.0, least=0)
    """Standard deviation of free coordinates, metres."""
    centres: float = number(0.0, least=0)
    """Standard deviation of projection centres, metres."""
    attitudes_deg: float = number(0.0, least=0, most=30)
    """Standard deviation of attitudes about each axis, degrees."""
    restart: bool = False
    """Whether free unknowns besides points, photos and cameras start without their values: mounts,
    drifts and profiles from zero, levels, frames and sizes from what an adjustment computes."""


@dataclass(frozen=True)
class Spec:
    """Parameters of a simulated network, checked on construction.

    Equal specs with equal seeds give equal networks. The spec's seed is the seed of the geometry,
    and the default seed of the errors in `simulate`.

    Raises:
        InputError: all problems, each with the path of its key.
    """

    parts: tuple[Part, ...]
    """The parts in the order in which they are added; a part may refer to earlier ones by number,
    from 0."""
    name: str = ""
    """Name of the network."""
    seed: int = number(0, least=0)
    """Seed of geometry and, by default, of errors."""
    datum: Literal["given", "free"] = "given"
    """Datum of the network."""
    earth: Earth = field(default_factory=Earth)
    """Frame and refraction."""
    control: Control | None = None
    """Control points; None: only the control points of the parts."""
    errors: Errors = field(default_factory=Errors)
    """Errors of the readings."""
    approximate: Approximate = field(default_factory=Approximate)
    """Errors of the approximate values."""

    def __post_init__(self) -> None:
        """Check every field, and convert tables to dataclasses."""
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
                An element that the spec lacks is given as a whole: ``{"control": Control()}``.

        Raises:
            InputError: all unknown keys and invalid values.
        """
        found: list[Problem] = []
        record = {f.name: getattr(self, f.name) for f in fields(self)}
        for path, level in levels.items():
            key, *rest = INDEX.sub(r".\1", path).split(".")
            if key not in record:
                found.append(
                    Problem(f"unknown key; valid: {known(record, meant=key, most=40)}", key)
                )
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

        Keys without a value are written as comments.
        """
        return to_toml(self)


def design(spec: Spec) -> Network:
    """Return the network of a spec with true values, for planning or measuring.

    Observations also have their true values; points that are not control points have their true
    coordinates as check coordinates.

    Raises:
        InputError: the parts do not fit together: points do not exist, or names are used twice.
            All problems are listed, except those of parts that need a failed part.
    """
    plan = _plan(spec)
    return measure(plan, seed=spec.seed, noise=False)


def simulate(spec: Spec, *, seed: Seed | None = None) -> SimulatedNetwork:
    """Simulate the measurements of a spec.

    Args:
        spec: the network and its errors.
        seed: seed of noise, gross errors, drop-outs and approximate values; None: the spec's.

    Returns:
        The network with approximate values, its truth, its gross errors and the lost observations.

    Raises:
        InputError: as `design`; or the seed is not a whole number ≥ 0.
    """
    seed = spec.seed if seed is None else _checked(seed)
    plan = _plan(spec)
    true = true_plan(plan, spec.errors)
    network = read(plan, true, spec.errors, seed=seed)
    gross = add_gross_errors(network, spec.errors, seed=seed)
    network, dropped = drop(network, spec.errors, gross, seed=seed)
    # A removed undetermined point may have had readings with gross errors.
    left = readings_of(network) if dropped else gross
    gross = {reading: size for reading, size in gross.items() if reading in left}
    by = spec.approximate
    network = disturb(
        network,
        seed=seed,
        points=by.points,
        centres=by.centres,
        attitudes=float(np.deg2rad(by.attitudes_deg)),
        restart=by.restart,
    )
    return SimulatedNetwork(network, Truth.of(true), gross, dropped)


def _checked(seed: object) -> Seed:
    """Return a seed; InputError if it is not a whole number ≥ 0."""
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool) and seed >= 0:
        return int(seed)
    raise InputError(Problem(f"must be a whole number ≥ 0, not {seed!r}", "seed"))


def _plan(spec: Spec) -> Network:
    """Return the plan of a spec: true values without readings."""
    plan = Network(spec.name, frame=spec.earth.made_frame(), datum=spec.datum)
    if spec.earth.refraction is not None:
        free = spec.earth.refraction_unknown
        plan.set_refraction(value=spec.earth.refraction, fixed=not free)
    scene = Scene(plan, spec.seed)
    found: list[Problem] = []
    for i, part in enumerate(spec.parts):
        scene.number, photos = i, len(plan.photos)
        try:
            part.add_to(scene)
            scene.note_photos(photos)
        except InputError as error:
            scene.failed.add(i)
            found += [
                p if f"{p.where}.".startswith(f"{scene.where}.") else Problem(str(p), scene.where)
                for p in error.problems
            ]
        # A failed part gets an empty list of points, which keeps the numbers of later parts.
        scene.points += [[]] * (i + 1 - len(scene.points))
    if not found:
        if spec.control is not None:
            found += spec.control.apply(scene, "control")
        found += spec.errors.unknown(plan, "errors")
    if found:
        raise InputError(found)
    known_axes: dict[str, set[str]] = {}
    for o in of_quantities(plan.observations.values(), *CONTROL_QUANTITIES):
        known_axes.setdefault(o.point, set()).update(o.axes)
    plan.points = {
        name: _with_check(p, known_axes.get(name, set())) for name, p in plan.points.items()
    }
    return plan


def _with_check(point: Point, observed: set[str]) -> Point:
    """Return a point with true check coordinates for components neither held nor observed."""
    rows = zip("xyz", point.coordinates, point.fixed, strict=True)
    check = tuple(np.nan if held or a in observed else v for a, v, held in rows)
    if all(np.isnan(check)):
        return point
    return replace(point, check=check)  # type: ignore[arg-type]


def read_spec(source: str | Path) -> Spec:
    """Read a spec.

    Args:
        source: a file, or the TOML text itself (text with a line break or an equals sign).

    Raises:
        InputError: all problems, each with the path of its key.
    """
    text, where = _text(source)
    document = parse_toml(text, where)
    names = [f.name for f in fields(Spec)]
    found = [
        Problem(f"unknown key; valid: {known(names, meant=key, most=40)}", key)
        for key in document
        if key not in names
    ]
    if "parts" not in document:
        found.append(Problem("is missing: a spec has at least one part", "parts"))
    try:
        # The rest is checked even with faulty parts, whose problems are already in the list.
        rest = {k: v for k, v in document.items() if k in names}
        spec = Spec(**{"parts": None, **rest})
    except InputError as error:
        absent = "parts" not in document
        found += [p for p in error.problems if not (absent and p.where == "parts")]
    if found:
        raise InputError(found)
    return spec


def _text(source: str | Path) -> tuple[str, str]:
    """Return the TOML text and its name for messages."""
    if isinstance(source, str) and ("\n" in source or "=" in source):
        return source, "spec"
    path = Path(source)
    return read_text(path, path.name), path.name
