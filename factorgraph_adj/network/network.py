"""The network: points, cameras, photos, other unknowns and observations.

A `Network` is a description without a solution; an adjustment leaves the network unchanged.
Each call that adds something checks the names, so that the error is raised where it was made.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ..errors import Doubt, InputError, Problem, known
from ..frames import Frame, LocalFrame
from ..models.lens import Lens
from ..models.variables import UNKNOWNS, VariableKind, parameter_kinds, unknown_kind
from ..observations import AnyObservation, Correlated, ImagePoint, Observation
from ..shown import Rows, Shown
from ..types import Array, Mask
from .checked import checked_camera, checked_image_points, checked_photo, checked_point
from .entities import (
    FREE_ORIENTATION,
    REFRACTION_OF_THE_NETWORK,
    Camera,
    ImageTable,
    Key,
    Origin,
    Parameter,
    Photo,
    Point,
    parameter,
    parameter_name,
)
from .of_kind import OfKind

DatumChoice: TypeAlias = Literal["given", "free"]
"""Datum from control points and from held and weighted unknowns (given), or a free network."""


class Network(Shown):
    """Points, cameras, photos and observations in one frame.

    Example:
        >>> net = Network("two distances", frame=LocalFrame())
        >>> net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
        >>> net.add_point("B", (10.0, 0.0, 0.0), fixed="yz")
        >>> from factorgraph_adj.observations import SlopeDistance
        >>> net.add(SlopeDistance("A", "B", 10.02, sigma=0.01))
        ['1']
    """

    def __init__(
        self, name: str = "", *, frame: Frame | None = None, datum: DatumChoice = "given"
    ) -> None:
        """Start an empty network."""
        if datum not in (valid := get_args(DatumChoice)):
            raise InputError(f"unknown datum {datum!r}; valid: {known(valid, meant=datum)}")
        self.name = name
        self.frame: Frame = LocalFrame() if frame is None else frame
        self.datum: DatumChoice = datum
        self.points: dict[str, Point] = {}
        self.cameras: dict[str, Camera] = {}
        self.photos: dict[str, Photo] = {}
        self.parameters: dict[VariableKind, dict[Any, Parameter]] = {
            kind.name: {} for kind in parameter_kinds()
        }
        """Unknowns besides points, photos and cameras, by kind and name."""
        self.observations: dict[str, Observation] = {}
        self.clusters: list[tuple[tuple[str, ...], Array]] = []
        self.images = ImageTable()
        self.doubts: list[Doubt] = []
        """Readings that did not agree when they were reduced to observations."""
        self.point_number: dict[str, int] = {}
        self.photo_number: dict[str, int] = {}
        self._next_id = 1

    # -- points -----------------------------------------------------------------------------

    def add_point(
        self,
        name: str,
        coordinates: Sequence[float] | None = None,
        *,
        fixed: str = "",
        sigma: float | Sequence[float] | None = None,
        datum: bool = False,
        check: Sequence[float] | None = None,
    ) -> None:
        """Add an object point.

        Args:
            name: its name.
            coordinates: given or approximate X, Y, Z, metres; NaN or None where unknown.
            fixed: components to hold: any of ``x``, ``y``, ``z``. A plane network holds z,
                a levelling network x and y.
            sigma: standard deviations, metres, of weighted coordinates (infinite: free). They
                enter as observations of the given coordinates.
            datum: whether the point carries the datum of a free network. If no point does, all
                points carry the datum.
            check: coordinates for comparison only, metres.

        Raises:
            InputError: duplicate name, bad numbers, a held or weighted component without value.
        """
        self._new(name, self.points, "point")
        self.points[name] = checked_point(
            name, coordinates, fixed=fixed, sigma=sigma, datum=datum, check=check
        )
        self.point_number[name] = len(self.point_number)

    def add_points(self, names: Sequence[str], coordinates: Array) -> None:
        """Add many free points with approximate coordinates (n, 3), metres; NaN: unknown."""
        xyz = np.asarray(coordinates, dtype=float)
        if xyz.shape != (len(names), 3):
            raise InputError(f"coordinates must be ({len(names)}, 3), not {xyz.shape}")
        if np.any(np.isinf(xyz)):
            row = int(np.flatnonzero(np.isinf(xyz).any(axis=1))[0])
            raise InputError(Problem("coordinates must be finite", f"point {names[row]!r}"))
        for name, at in zip(names, xyz.tolist(), strict=True):
            self._new(name, self.points, "point")
            self.points[name] = Point(name, tuple(at))
            self.point_number[name] = len(self.point_number)

    # -- cameras and photos -------------------------------------------------------------------

    def add_camera(
        self,
        name: str,
        lens: Lens,
        values: Mapping[str, float] | Sequence[float],
        *,
        free: Iterable[str] = (),
        sigma: Mapping[str, float] | None = None,
        unit: str = "mm",
        per_photo: bool = False,
        format: Sequence[float] | None = None,
        origin: Origin = "centre",
        y_down_in_files: bool = False,
    ) -> None:
        """Add a camera.

        Args:
            name: its name.
            lens: the lens model, see `factorgraph_adj.models.lens`.
            values: calibration parameters by name (absent: 0) or in the order of ``lens.names``;
                image units.
            free: names of parameters to estimate without a prior.
            sigma: standard deviations of weighted parameters by name; all others are held.
            unit: unit of its image coordinates, for reports.
            per_photo: whether every photo has a calibration of its own.
            format: width and height of the sensor, image units, for plots and their coverage.
            origin: place of the origin of image coordinates on the sensor, for the same.
            y_down_in_files: whether y and y0 point down in files and reports; here y is up.
        """
        self._new(name, self.cameras, "camera")
        options = (sigma, unit, per_photo, format, origin, y_down_in_files)
        self.cameras[name] = checked_camera(name, lens, values, free, *options)

    def add_photo(
        self,
        name: str,
        camera: str,
        *,
        position: Sequence[float] | None = None,
        omega_phi_kappa: Sequence[float] | None = None,
        rotation: Array | None = None,
        fixed: bool | Sequence[bool] = False,
        sigma_position: float | Sequence[float] | None = None,
        sigma_attitude: float | None = None,
    ) -> None:
        """Add a photo.

        Args:
            name: its name.
            camera: name of its camera.
            position: projection centre, metres; None: computed by resection.
            omega_phi_kappa: ω, φ, κ, radians, R = R1(ω) R2(φ) R3(κ) photogrammetric → object.
            rotation: world_R_camera (3, 3) instead of angles; x right, y down, z forward.
            fixed: whether the whole pose is held, or six flags (three equal ones for the
                rotations, then X, Y, Z).
            sigma_position: standard deviation of a weighted centre, metres.
            sigma_attitude: standard deviation of a weighted attitude, radians.
        """
        where = f"photo {name!r}"
        self._new(name, self.photos, "photo")
        self._known(camera, self.cameras, "camera", where)
        if self.frame.left_handed:
            raise InputError(
                Problem("photos need a right-handed frame: choose axes en, nw, ws or se", where)
            )
        self.photos[name] = checked_photo(
            name,
            camera,
            position=position,
            omega_phi_kappa=omega_phi_kappa,
            rotation=rotation,
            fixed=fixed,
            sigma_position=sigma_position,
            sigma_attitude=sigma_attitude,
        )
        self.photo_number[name] = len(self.photo_number)

    # -- other unknowns -----------------------------------------------------------------------

    def set_unknown(
        self,
        kind: VariableKind,
        key: Key,
        values: Sequence[float] | None = None,
        *,
        fixed: bool | Iterable[str] = False,
        sigma: float | Sequence[float] | Mapping[str, float] | None = None,
    ) -> None:
        """State an unknown of any kind; its components are free unless held or weighted.

        Args:
            kind: name of the kind, see `factorgraph_adj.models.variables.UNKNOWNS`.
            key: name of the unknown, or several names such as station and set.
            values: values of the components, SI; None: the start values of the kind.
            fixed: whether all components are held, or the names of the held components.
            sigma: standard deviations of weighted components, SI: one for all, one for each, or
                some by name.

        Raises:
            InputError: an unknown kind or point, a value that is not finite, a wrong number of
                values, or a component that is both held and weighted.
        """
        record = unknown_kind(kind)
        if record.table is None:
            raise InputError(f"a {record.noun} is no parameter: use add_{record.noun}")
        keys = (key,) if isinstance(key, str) else tuple(key)
        if len(keys) != len(record.table.keys):
            what = " and ".join(record.table.keys)
            raise InputError(Problem(f"it is named by {what}, not by {key!r}", record.noun))
        where = f"{record.noun} {parameter_name(key)!r}"
        if record.at_point:
            self._known(keys[0], self.points, "point", where)
        start = [c.start for c in record.components] if values is None else values
        self.of_kind(kind)[key] = parameter(record, start, fixed, sigma, where)

    def of_kind(self, kind: VariableKind) -> dict[Any, Parameter]:
        """Return the stated unknowns of a kind by key."""
        return self.parameters.setdefault(kind, {})

    def set_orientation(
        self,
        station: str,
        *,
        set: str = "1",
        value: float,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the orientation unknown of a set of directions, radians.

        Without this call the unknown is free; its start value is computed from the directions.
        """
        self.set_unknown("orientation", (station, set), (value,), fixed=fixed, sigma=sigma)

    def set_refraction(
        self,
        group: str = REFRACTION_OF_THE_NETWORK,
        *,
        value: float = 0.13,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the coefficient of refraction κ of a group; free unless held or weighted.

        The group of the network is that of observations without one; not stated, its κ is 0, held.
        """
        self.set_unknown("refraction", group, (value,), fixed=fixed, sigma=sigma)

    def set_vertical(
        self,
        station: str,
        *,
        xi: float = 0.0,
        eta: float = 0.0,
        sigma: float | Sequence[float] | None = None,
        fixed: bool = False,
    ) -> None:
        """State the deflection of the vertical of a station; free unless held or weighted.

        Args:
            station: the point.
            xi: ξ = Φ − φ, radians, north positive.
            eta: η = (Λ − λ) cosφ, radians, east positive.
            sigma: standard deviations, radians.
            fixed: whether ξ and η are held. A station without this call has ξ = η = 0, held.
        """
        self.set_unknown("vertical", station, (xi, eta), fixed=fixed, sigma=sigma)

    def set_distance_meter(
        self,
        name: str,
        *,
        scale: float = 0.0,
        zero: float = 0.0,
        sigma_scale: float | None = None,
        sigma_zero: float | None = None,
        free: Iterable[Literal["scale", "zero"]] = (),
    ) -> None:
        """State a distance meter: observed = (1 + scale) S + zero.

        Args:
            name: its name, as in ``instrument`` of the distances.
            scale: m, dimensionless (1e-6 is one ppm).
            zero: additive constant, metres.
            sigma_scale: standard deviation of a weighted scale.
            sigma_zero: standard deviation of a weighted constant, metres.
            free: components to estimate without a prior. Components that are neither free nor
                weighted are held.
        """
        asked = set(free)
        if not asked <= {"scale", "zero"}:
            where = f"distance meter {name!r}"
            raise InputError(Problem(f"free must be some of scale, zero, not {asked}", where))
        given = {"scale": sigma_scale, "zero": sigma_zero}
        sigma = {n: np.inf if s is None else s for n, s in given.items()}
        held = [n for n, s in sigma.items() if s == np.inf and n not in asked]
        self.set_unknown("edm", name, (scale, zero), fixed=held, sigma=sigma)

    orientations = OfKind("orientation")
    """Orientation unknowns by station and set."""
    refractions = OfKind("refraction")
    """Coefficients of refraction by group."""
    verticals = OfKind("vertical")
    """Deflections of the vertical by station."""
    distance_meters = OfKind("edm")
    """Scales and zero constants by distance meter."""

    # -- observations -------------------------------------------------------------------------

    def add(self, *observations: AnyObservation) -> list[str]:
        """Add observations; return their ids.

        Raises:
            InputError: names are unknown or duplicate. The message lists all of them, and no
                observation is added.
        """
        problems: list[Problem] = []
        flat: list[Observation] = []
        for item in observations:
            flat.extend(item.observations if isinstance(item, Correlated) else (item,))
        seen: set[str] = set()
        for o in flat:
            try:
                self.check_names(o, seen)
            except InputError as error:
                problems.extend(error.problems)
        if problems:
            raise InputError(problems)
        ids: list[str] = []
        for item in observations:
            if isinstance(item, Correlated):
                group = [self.insert(o) for o in item.observations]
                self.clusters.append((tuple(group), np.asarray(item.covariance, dtype=float)))
                ids.extend(group)
            else:
                ids.append(self.insert(item))
        return ids

    def add_image_points(
        self,
        photo: str,
        points: Sequence[str],
        xy: Array,
        *,
        sigma: float | Sequence[float] | Array,
    ) -> None:
        """Add image coordinates of many points in one photo.

        Args:
            photo: name of the photo.
            points: n names.
            xy: measured coordinates, (n, 2), image units, x right, y up.
            sigma: one standard deviation, two for x and y, or (n, 2).
        """
        where = f"photo {photo!r}"
        self._known(photo, self.photos, "photo", where)
        measured, weights = checked_image_points(
            photo, points, xy, sigma=sigma, known_points=self.point_number
        )
        number = np.array([self.point_number[p] for p in points], dtype=np.intp)
        of_photo = np.full(len(points), self.photo_number[photo], dtype=np.intp)
        self.images.append(of_photo, number, measured, weights)

    @property
    def n_image_points(self) -> int:
        """Number of image points."""
        return self.images.size

    def image_points(self) -> Iterator[ImagePoint]:
        """Iterate over the image points as observations."""
        photos, points = list(self.photos), list(self.points)
        for row, (f, p, xy, s) in enumerate(zip(*self.images.columns(), strict=True)):
            yield ImagePoint(
                photos[f],
                points[p],
                float(xy[0]),
                float(xy[1]),
                sigma=(float(s[0]), float(s[1])),
                id=self.images.ids.get(row),
                source=self.images.sources.get(row),
            )

    def image_mask(self, keep: Mask) -> None:
        """Keep only the image points with ``keep`` (n,) true."""
        self.images = self.images.kept(keep)

    def copy(self) -> Network:
        """Return an independent network that shares the frozen entities of this network."""
        other = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, dict | list):
                setattr(other, name, value.copy())
        other.parameters = {kind: given.copy() for kind, given in self.parameters.items()}
        other.images = self.images.copy()
        return other

    # -- helpers ------------------------------------------------------------------------------

    def check_names(self, o: Observation, seen: set[str]) -> None:
        """Check an observation's names, and its id, which ``seen`` gets; refuse bad ones."""
        record, where = o.record, o.label()
        for name in o.points():
            self._known(name, self.points, "point", where)
        for name in o.photos():
            self._known(name, self.photos, "photo", where)
        for kind, attribute in record.parameters:
            unknown, name = UNKNOWNS[kind], getattr(o, attribute)
            if unknown.absent != "refused":
                continue
            if name is None and unknown.default is None:
                raise InputError(Problem(f"{attribute} must name a {unknown.noun}", where))
            if name is not None:
                self._known(name, self.parameters.get(kind, {}), unknown.noun, where)
        ident = getattr(o, "id", None)
        if ident is not None:
            if ident in self.observations or ident in seen:
                raise InputError(Problem(f"duplicate id {ident!r}", where))
            seen.add(ident)
        if record.fixes == "place" and isinstance(self.frame, LocalFrame):
            what = o.kind.replace("_", " ")
            raise InputError(Problem(f"{what} needs a geocentric or topocentric frame", where))

    def insert(self, o: Observation) -> str:
        """Add an observation whose names have been checked; return its id."""
        ident: str | None = getattr(o, "id", None)
        if isinstance(o, ImagePoint):
            row = self.images.size
            self.add_image_points(o.photo, [o.point], np.array([[o.x, o.y]]), sigma=o.sigma)
            if ident is not None:
                self.images.ids[row] = ident
            if o.source is not None:
                self.images.sources[row] = o.source
            return ident or f"{o.photo}/{o.point}"
        if ident is None:
            while str(self._next_id) in self.observations:
                self._next_id += 1
            ident = str(self._next_id)
        self.state_found(o)
        self.observations[ident] = o
        return ident

    def state_found(self, o: Observation) -> None:
        """State the unknowns of an observation that nobody has to state, such as orientations."""
        for kind, key in o.parameters():
            if UNKNOWNS[kind].absent == "found":
                self.of_kind(kind).setdefault(key, FREE_ORIENTATION)

    def _new(self, name: str, names: Mapping[str, object], what: str) -> None:
        if not isinstance(name, str) or not name:
            raise InputError(Problem(f"the name of a {what} must be non-empty text, not {name!r}"))
        if name in names:
            raise InputError(Problem(f"duplicate name of a {what}", f"{what} {name!r}"))

    def _known(self, name: str, names: Mapping[Any, object], what: str, where: str) -> None:
        if name not in names:
            there = known(names, meant=name)
            raise InputError(Problem(f"unknown {what} {name!r}; known: {there}", where))

    def headline(self) -> str:
        """Say what the network has."""
        return (
            f"Network {self.name!r}: {len(self.points)} points, {len(self.photos)} photos, "
            f"{self.n_image_points} image points, {len(self.observations)} other observations"
        )

    def first_rows(self) -> Rows:
        """Return the points."""
        rows = ((p.name, *p.coordinates, p.held) for p in self.points.values())
        return Rows(("point", "x", "y", "z", "fixed"), rows, len(self.points))
