"""What is measured and what is asked for: points, cameras, photos, observations.

A `Network` is a description: it holds no solution and is not changed by an adjustment.
Names are checked as they are added, so that an error stands where it was made.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from typing import Literal, TypeAlias

import numpy as np

from ..errors import InputError, Problem, known
from ..frames import Frame, LocalFrame
from ..models.lens import Lens
from ..observations import AnyObservation, Correlated, Direction, ImagePoint, Observation
from ..rotation import world_R_camera
from ..types import Array, Mask
from .entities import (
    FREE_ORIENTATION,
    REFRACTION_OF_THE_NETWORK,
    Camera,
    ImageTable,
    Parameter,
    Photo,
    Point,
    parameter,
    sigmas,
    triple,
)

DatumChoice: TypeAlias = Literal["given", "free"]
"""Datum from what is given (control, fixed, weighted), or a free network."""


class Network:
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
        if datum not in ("given", "free"):
            raise InputError(f"unknown datum {datum!r}; valid: given, free")
        self.name = name
        self.frame: Frame = LocalFrame() if frame is None else frame
        self.datum: DatumChoice = datum
        self.points: dict[str, Point] = {}
        self.cameras: dict[str, Camera] = {}
        self.photos: dict[str, Photo] = {}
        self.orientations: dict[tuple[str, str], Parameter] = {}
        self.refractions: dict[str, Parameter] = {}
        self.verticals: dict[str, Parameter] = {}
        self.distance_meters: dict[str, Parameter] = {}
        self.observations: dict[str, Observation] = {}
        self.clusters: list[tuple[tuple[str, ...], Array]] = []
        self.images = ImageTable()
        self._point_number: dict[str, int] = {}
        self._photo_number: dict[str, int] = {}
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
            datum: carries the datum of a free network. Where no point does, all do.
            check: coordinates for comparison only, metres.

        Raises:
            InputError: duplicate name, bad numbers, a held or weighted component without value.
        """
        where = f"point {name!r}"
        self._new(name, self.points, "point")
        if not set(fixed) <= set("xyz"):
            raise InputError(Problem(f"fixed must be some of x, y, z, not {fixed!r}", where))
        unknown = (np.nan, np.nan, np.nan)
        xyz = unknown if coordinates is None else triple(coordinates, "coordinates", where)
        held = ("x" in fixed, "y" in fixed, "z" in fixed)
        weights = None if sigma is None else sigmas(sigma, 3, where)
        for i, axis in enumerate("xyz"):
            if np.isnan(xyz[i]) and (held[i] or (weights is not None and weights[i] < np.inf)):
                raise InputError(Problem(f"{axis} is held or weighted but has no value", where))
        self.points[name] = Point(
            name,
            xyz,
            held,
            weights,  # type: ignore[arg-type]
            datum,
            None if check is None else triple(check, "check coordinates", where),
        )
        self._point_number[name] = len(self._point_number)

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
            self._point_number[name] = len(self._point_number)

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
    ) -> None:
        """Add a camera.

        Args:
            name: its name.
            lens: the lens model, see `factorgraph_adj.models.lens`.
            values: calibration, by name (absent: 0) or in the order of ``lens.names``;
                image units.
            free: parameters to estimate without a prior; the others are held, but for
            sigma: standard deviations of weighted ones, which are estimated too.
            unit: unit of its image coordinates, for reports.
            per_photo: every photo gets a calibration of its own.
        """
        where = f"camera {name!r}"
        self._new(name, self.cameras, "camera")
        names = lens.names
        weights = dict(sigma or {})
        unknown = [
            n
            for n in (*(values if isinstance(values, Mapping) else ()), *free, *weights)
            if n not in names
        ]
        if unknown:
            raise InputError(
                Problem(
                    f"unknown calibration parameter {', '.join(unknown)} of lens model "
                    f"{lens.kind!r}; known: {', '.join(names)}",
                    where,
                )
            )
        if isinstance(values, Mapping):
            numbers = [float(values.get(n, 0.0)) for n in names]
        else:
            numbers = [float(v) for v in values]
        if len(numbers) != len(names) or not np.all(np.isfinite(numbers)):
            raise InputError(
                Problem(f"values must be {len(names)} finite numbers ({', '.join(names)})", where)
            )
        if not numbers[0] > 0:
            raise InputError(
                Problem(f"the principal distance must be positive, not {numbers[0]}", where)
            )
        bad = [n for n, s in weights.items() if not s > 0]
        if bad:
            raise InputError(Problem(f"sigma of {', '.join(bad)} must be > 0", where))
        free = set(free)
        self.cameras[name] = Camera(
            name,
            lens,
            tuple(numbers),
            tuple(n not in free and n not in weights for n in names),
            tuple(float(weights.get(n, np.inf)) for n in names),
            unit,
            per_photo,
        )

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
            position: projection centre, metres; none: found by resection.
            omega_phi_kappa: ω, φ, κ, radians, R = R1(ω) R2(φ) R3(κ) photogrammetric → object.
            rotation: instead, world_R_camera (3, 3) with x right, y down, z forward.
            fixed: hold all of it, or six flags (the three rotations together, X, Y, Z).
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
        at = None if position is None else triple(position, "position", where)
        if at is not None and any(np.isnan(v) for v in at):
            raise InputError(Problem(f"position must be finite or none, not {at}", where))
        if rotation is None and omega_phi_kappa is not None:
            rotation = world_R_camera(*triple(omega_phi_kappa, "omega_phi_kappa", where))
        if rotation is not None:
            rotation = np.asarray(rotation, dtype=float)
            if (
                rotation.shape != (3, 3)
                or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
                or np.linalg.det(rotation) < 0
            ):
                raise InputError(Problem("rotation must be a 3 × 3 rotation matrix", where))
            if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-14:
                # Given with few digits: the nearest rotation. Others stay as they are, to the bit.
                u, _, vt = np.linalg.svd(rotation)
                rotation = u @ vt
        held = (bool(fixed),) * 6 if isinstance(fixed, bool) else tuple(map(bool, fixed))
        if len(held) != 6:
            raise InputError(Problem("fixed must be true, false or six flags", where))
        if any(held[:3]) != all(held[:3]):
            raise InputError(
                Problem("hold all three rotations of a photo or none: they do not commute", where)
            )
        weighted = sigma_position is not None or sigma_attitude is not None
        if (any(held) or weighted) and (at is None or rotation is None):
            raise InputError(Problem("a held or weighted photo needs its orientation", where))
        if sigma_attitude is not None and not sigma_attitude > 0:
            raise InputError(Problem("sigma_attitude must be > 0", where))
        self.photos[name] = Photo(
            name,
            camera,
            at,
            rotation,
            held,
            None if sigma_position is None else sigmas(sigma_position, 3, where),  # type: ignore[arg-type]
            sigma_attitude,
        )
        self._photo_number[name] = len(self._photo_number)

    # -- other unknowns -----------------------------------------------------------------------

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

        Without this call it is free and found from the directions.
        """
        self._known(station, self.points, "point", "orientation")
        self.orientations[station, set] = parameter((value,), fixed, sigma, f"set {station}/{set}")

    def set_refraction(
        self,
        group: str = REFRACTION_OF_THE_NETWORK,
        *,
        value: float = 0.13,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the coefficient of refraction κ of a group; free unless held or weighted.

        The group of observations that name none is the network's, held at 0 until this call.
        """
        self.refractions[group] = parameter((value,), fixed, sigma, f"refraction {group!r}")

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
            fixed: hold it. Stations without this call have ξ = η = 0, held.
        """
        self._known(station, self.points, "point", "vertical")
        self.verticals[station] = parameter((xi, eta), fixed, sigma, f"vertical of {station!r}")

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
            free: which are unknown without a prior; the others are held.
        """
        where = f"distance meter {name!r}"
        asked = set(free)
        if not asked <= {"scale", "zero"}:
            raise InputError(Problem(f"free must be some of scale, zero, not {asked}", where))
        given = [np.inf if s is None else s for s in (sigma_scale, sigma_zero)]
        sigma = sigmas(given, 2, where)
        self.distance_meters[name] = Parameter(
            (float(scale), float(zero)),
            tuple(
                n not in asked and s == np.inf
                for n, s in zip(("scale", "zero"), sigma, strict=True)
            ),
            sigma,
        )

    # -- observations -------------------------------------------------------------------------

    def add(self, *observations: AnyObservation) -> list[str]:
        """Add observations; return their ids.

        Raises:
            InputError: every unknown or duplicate name among them, all at once; nothing is added.
        """
        problems: list[Problem] = []
        flat: list[Observation] = []
        for item in observations:
            flat.extend(item.observations if isinstance(item, Correlated) else (item,))
        seen: set[str] = set()
        for o in flat:
            try:
                self._check_names(o, seen)
            except InputError as error:
                problems.extend(error.problems)
        if problems:
            raise InputError(problems)
        ids: list[str] = []
        for item in observations:
            if isinstance(item, Correlated):
                group = [self._insert(o) for o in item.observations]
                self.clusters.append((tuple(group), np.asarray(item.covariance, dtype=float)))
                ids.extend(group)
            else:
                ids.append(self._insert(item))
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
        measured = np.array(xy, dtype=float).reshape(-1, 2)
        weights = np.array(np.broadcast_to(np.asarray(sigma, dtype=float), measured.shape))
        if len(measured) != len(points):
            raise InputError(Problem(f"{len(points)} points but {len(measured)} rows", where))
        problems = [
            Problem(f"unknown point {p!r}; known: {known(self.points)}", f"image point {photo}/{p}")
            for p in points
            if p not in self._point_number
        ]
        for bad, what in (
            (~np.isfinite(measured).all(axis=1), "coordinates must be finite numbers"),
            (~(weights > 0).all(axis=1), "sigma must be greater than zero"),
            (~np.isfinite(weights).all(axis=1), "sigma must be a finite number"),
        ):
            problems += [
                Problem(what, f"image point {photo}/{points[i]}")
                for i in np.flatnonzero(bad).tolist()
            ]
        if problems:
            raise InputError(problems)
        number = np.fromiter(
            (self._point_number[p] for p in points), dtype=np.intp, count=len(points)
        )
        of_photo = np.full(len(points), self._photo_number[photo], dtype=np.intp)
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
        columns = self.images.columns()
        ids, sources = self.images.ids, self.images.sources
        new = np.cumsum(keep) - 1
        self.images = ImageTable()
        self.images.append(*(c[keep] for c in columns))  # type: ignore[arg-type]
        self.images.ids = {int(new[r]): v for r, v in ids.items() if keep[r]}
        self.images.sources = {int(new[r]): v for r, v in sources.items() if keep[r]}

    def copy(self) -> Network:
        """Return a network of its own with the same entities, which are frozen and shared."""
        other = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, dict | list):
                setattr(other, name, value.copy())
        other.images = self.images.copy()
        return other

    # -- helpers ------------------------------------------------------------------------------

    def _check_names(self, o: Observation, seen: set[str]) -> None:
        where = o.label()
        for attribute in ("station", "target", "target2", "point"):
            name = getattr(o, attribute, None)
            if name is not None:
                self._known(name, self.points, "point", where)
        if hasattr(o, "photo"):
            self._known(o.photo, self.photos, "photo", where)
        for attribute, names, what in (
            ("refraction", self.refractions, "refraction group"),
            ("instrument", self.distance_meters, "distance meter"),
        ):
            name = getattr(o, attribute, None)
            if name is not None:
                self._known(name, names, what, where)
        ident = getattr(o, "id", None)
        if ident is not None:
            if ident in self.observations or ident in seen:
                raise InputError(Problem(f"duplicate id {ident!r}", where))
            seen.add(ident)
        if o.kind.startswith("astronomic") and isinstance(self.frame, LocalFrame):
            raise InputError(
                Problem(
                    "astronomic latitude and longitude need a geocentric or topocentric frame",
                    where,
                )
            )

    def _insert(self, o: Observation) -> str:
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
        if isinstance(o, Direction):
            self.orientations.setdefault((o.station, o.set), FREE_ORIENTATION)
        self.observations[ident] = o
        return ident

    def _new(self, name: str, names: Mapping[str, object], what: str) -> None:
        if not isinstance(name, str) or not name:
            raise InputError(Problem(f"the name of a {what} must be non-empty text, not {name!r}"))
        if name in names:
            raise InputError(Problem(f"duplicate name of a {what}", f"{what} {name!r}"))

    def _known(self, name: str, names: Mapping[str, object], what: str, where: str) -> None:
        if name not in names:
            raise InputError(Problem(f"unknown {what} {name!r}; known: {known(names)}", where))

    def __repr__(self) -> str:
        """Say what the network has."""
        return (
            f"<Network {self.name!r}: {len(self.points)} points, {len(self.photos)} photos, "
            f"{self.n_image_points} image points, {len(self.observations)} other observations>"
        )
