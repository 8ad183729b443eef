"""The network: points, cameras, photos and observations, added, checked and copied; its display.

A `Network` is a description without a solution; an adjustment leaves the network unchanged.
Each call that adds something checks the names, so that the error is raised where it was made.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ..control_characters import one_line
from ..crs.reference_system import ReferenceSystem, reference_system
from ..entities import (
    FREE_ORIENTATION,
    Camera,
    ImageTable,
    Origin,
    Parameter,
    Photo,
    Point,
)
from ..errors import Doubt, InputError, LeftOut, Problem, UnknownLeftOut, known
from ..frames import Frame, LocalFrame
from ..models.lens import Lens
from ..models.rolling_shutter import Towards
from ..models.unknown_registry import UNKNOWNS, VariableKind, parameter_kinds
from ..observations import AnyObservation, Correlated, ImagePoint, Observation
from ..result_display import Rows, Shown
from ..types import Array
from .composite_unknowns import RIGID, member_of_rig
from .construction import (
    checked_camera,
    checked_photo,
    checked_point,
    refuse_duplicate,
    required,
)
from .image_points import MeasuredImages
from .stated_unknowns import StatedUnknowns

DatumChoice: TypeAlias = Literal["given", "free"]
"""Datum from control points and from held and weighted unknowns (given), or a free network."""


class Network(MeasuredImages, StatedUnknowns, Shown):
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
        self,
        name: str = "",
        *,
        frame: Frame | None = None,
        datum: DatumChoice = "given",
        crs: ReferenceSystem | str | None = None,
    ) -> None:
        """Start an empty network.

        Args:
            name: its name.
            frame: frame of its coordinates; None: a flat local one.
            datum: where the datum comes from.
            crs: reference system of results, see `ReferenceSystem`. With a geocentric or
                topocentric frame it leads from the frame to grid coordinates; with a local frame
                the coordinates of the network are grid coordinates themselves, in axes that the
                adjustment takes as Cartesian ones, see `from_grid`.
        """
        if datum not in (valid := get_args(DatumChoice)):
            raise InputError(f"unknown datum {datum!r}; valid: {known(valid, meant=datum)}")
        self.name = name
        self.frame: Frame = LocalFrame() if frame is None else frame
        self.datum: DatumChoice = datum
        self.crs: ReferenceSystem | None = None if crs is None else reference_system(crs)
        """Reference system of results; None: none is known."""
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
        self.left_out: list[LeftOut] = []
        """What the reader of a file left out of the network."""
        self.remarks: list[str] = []
        """Sentences of the readers of files on how these were read: in another encoding."""
        self.without_observations = ""
        """Which tables the reader of a project did not find, if it found none of observations."""
        self.axes_of_files: dict[str, Array] = {}
        """Rotations frame_R_file (3, 3) of vectors that were read along other axes than those of
        the frame, by id: messages show them as they were read."""
        self.unknowns_left_out: list[UnknownLeftOut] = []
        """Unknowns that were left out as nothing determines them, see `determined_part`."""
        self.listed_points: dict[str, Point] = {}
        """Points that only a list has, and that no observation concerns: no unknowns."""
        self.point_number: dict[str, int] = {}
        self.photo_number: dict[str, int] = {}
        self._next_id = 1

    @property
    def name(self) -> str:
        """Name of the network, on one line; control characters are shown as escapes."""
        return self._name

    @name.setter
    def name(self, name: str) -> None:
        self._name = one_line(name)

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
        side_shot: bool = False,
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
            side_shot: whether one sight without a check gives the point; results list it apart.

        Raises:
            InputError: duplicate name, bad numbers, a held or weighted component without value.
        """
        refuse_duplicate(name, self.points, "point")
        self.points[name] = checked_point(
            name,
            coordinates,
            fixed=fixed,
            sigma=sigma,
            datum=datum,
            check=check,
            side_shot=side_shot,
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
            refuse_duplicate(name, self.points, "point")
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
        readout: float | None = None,
        readout_towards: Towards = "down",
    ) -> None:
        """Add a camera.

        Args:
            name: its name.
            lens: the lens model, see `factorgraph_adj.models.lens`.
            values: calibration parameters by name (absent: 0) or in the order of ``lens.names``;
                image units. A free principal distance c that is unknown may be absent if the
                format is given: 1.2 times the longer side is taken, and `orient` looks for a
                better one.
            free: names of parameters to estimate without a prior.
            sigma: standard deviations of weighted parameters by name; all others are held.
            unit: unit of its image coordinates, for reports.
            per_photo: whether every photo has a calibration of its own.
            format: width and height of the sensor, image units, for plots and their coverage.
            origin: place of the origin of image coordinates on the sensor, for the same.
            y_down_in_files: whether y and y0 point down in files and reports; here y is up.
            readout: readout time of a rolling shutter, seconds: time from the first to the last row
                (with ``right`` and ``left``, rows are columns); it needs the format. Photos then
                may have a motion, `set_unknown` of kind ``photo_motion``: velocity of the
                projection centre (x_t …, m/s, axes of the network) and angular velocity (rx_t …,
                rad/s, camera axes x right, y down, z forward), at the middle row. Photos without
                a motion are treated as exposed at one moment.
            readout_towards: side of the image to which the readout proceeds: down, up, right, left.
        """
        refuse_duplicate(name, self.cameras, "camera")
        options = (sigma, unit, per_photo, format, origin, y_down_in_files)
        self.cameras[name] = checked_camera(
            name, lens, values, free, *options, readout, readout_towards
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
        carrier: str | None = None,
        mount: str | None = None,
        play: tuple[float, float] = RIGID,
    ) -> None:
        """Add a photo, alone or as a member of a rig.

        Args:
            name: its name.
            camera: name of its camera.
            position: projection centre, metres; None: computed by resection.
            omega_phi_kappa: ω, φ, κ, radians, R = R1(ω) R2(φ) R3(κ) photogrammetric → object.
            rotation: world_R_camera (3, 3) instead of angles; x right, y down, z forward.
            fixed: whether the whole pose is held, or six flags (three equal ones for the
                rotations, then X, Y, Z). In parallel projection (`ParallelLens`) false holds the
                coordinate nearest to the viewing axis, which no image point determines, unless
                ``sigma_position`` is given; `remarks` says so.
            sigma_position: standard deviation of a weighted centre, metres.
            sigma_attitude: standard deviation of a weighted attitude, radians.
            carrier: name of the photo that carries it: the reference camera of its rig at the same
                moment, or any photo, with or without image points, that represents the carrier. The
                member gets a pose of its own, and two observations of value zero tie it to the
                carrier: a `RelativeRotation` and a `RelativePosition`.
            mount: its mount on the carrier, see `set_mount`; needed with a carrier.
            play: standard deviations of its rotation (radians) and position (metres) on the mount;
                by default it is rigid.
        """
        where = f"photo {name!r}"
        refuse_duplicate(name, self.photos, "photo")
        required(camera, self.cameras, "camera", where)
        if self.frame.left_handed:
            raise InputError(
                Problem("photos need a right-handed frame: choose axes en, nw, ws or se", where)
            )
        if (carrier is None) != (mount is None):
            raise InputError(Problem("carrier and mount are given together, or neither", where))
        ties: tuple[Observation, ...] = ()
        if carrier is not None and mount is not None:
            ties = member_of_rig(
                name,
                carrier,
                mount,
                play=play,
                photos=self.photos,
                mounts=self.mounts,
                observations=self.observations,
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
            lens=self.cameras[camera].lens,
            frame=self.frame,
        )
        self.photo_number[name] = len(self.photo_number)
        held = self.photos[name].fixed
        if fixed is False and any(held) and not all(held):
            axis = "xyz"[held.index(True) - 3]
            what = (
                f"camera {camera!r} has no projection centre: {axis} of its photos is held, which "
                "no image point tells"
            )
            if what not in self.remarks:
                self.remarks.append(what)
        self.add(*ties)

    # -- observations -------------------------------------------------------------------------

    def add(self, *observations: AnyObservation) -> list[str]:
        """Add observations; return their ids.

        Raises:
            InputError: names are unknown or duplicate. The message lists all of them, and no
                observation is added.
        """
        problems: list[Problem] = []
        flat: list[Observation] = []
        strange = [o for o in observations if not isinstance(o, (Observation, Correlated))]
        if strange:
            what = "observations are given one by one (of a list: add(*observations)), not as {!r}"
            raise InputError(Problem(what.format(o)) for o in strange)
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
            if not isinstance(item, Correlated):
                ids.append(self.insert(item))
            elif isinstance(item.observations[0], ImagePoint):
                ids += self.join_image_points(item)
            else:
                group = [self.insert(o) for o in item.observations]
                self.clusters.append((tuple(group), np.asarray(item.covariance, dtype=float)))
                ids += group
        return ids

    def copy(self) -> Network:
        """Return an independent network that shares the frozen entities of this network."""
        other = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, dict | list):
                setattr(other, name, value.copy())
        other.parameters = {kind: given.copy() for kind, given in self.parameters.items()}
        other.images = self.images.copy()
        return other

    def with_listed_points(self) -> Network:
        """Return a network with its ``listed_points`` among the others; itself, if it has none."""
        if not self.listed_points:
            return self
        other = self.copy()
        for name, point in self.listed_points.items():
            other.point_number[name] = len(other.points)
            other.points[name] = point
        other.listed_points = {}
        return other

    # -- helpers ------------------------------------------------------------------------------

    def check_names(self, o: Observation, seen: set[str]) -> None:
        """Check an observation's names, and its id, which ``seen`` gets; refuse bad ones."""
        record, where = o.record, o.label()
        for name in o.points():
            required(name, self.points, "point", where)
        for name in o.photos():
            required(name, self.photos, "photo", where)
        for kind, attribute in record.parameters:
            unknown, name = UNKNOWNS[kind], getattr(o, attribute)
            # Photos of image points may stand still; what is said of a motion needs one.
            of_a_photo = unknown.in_photo and attribute not in record.photos
            if of_a_photo:
                required(name, self.photos, "photo", where)
            elif unknown.absent != "refused":
                continue
            if name is None and unknown.default is None:
                raise InputError(Problem(f"{attribute} must name a {unknown.noun}", where))
            if name is not None:
                stated = self.parameters.get(kind, {})
                file = unknown.table.file if unknown.table else ""
                own = [f"{verb}_{file.removesuffix('s')}" for verb in ("set", "add")]
                how = next((f for f in own if hasattr(self, f)), "set_unknown")
                hint = f"; rows of {file}.csv state them, or {how} of Network" if file else ""
                required(name, stated, unknown.noun, where, hint)
                refers = record.in_frame != "nothing"
                if refers and stated[name].origin and stated[name].origin in o.points():
                    what = (
                        f"point {stated[name].origin!r} is the origin of {unknown.noun} {name!r}, "
                        "so that its coordinates there are minus the offset: state or weight that "
                        "offset, and take the observation out"
                    )
                    raise InputError(Problem(what, where))
        ident = o.id
        if ident is not None:
            if ident in self.observations or ident in seen:
                raise InputError(Problem(f"duplicate id {ident!r}", where))
            seen.add(ident)
        if record.fixes == "place" and isinstance(self.frame, LocalFrame):
            what = o.kind.replace("_", " ")
            raise InputError(Problem(f"{what} needs a geocentric or topocentric frame", where))

    def insert(self, o: Observation) -> str:
        """Add an observation whose names have been checked; return its id."""
        ident = o.id
        if isinstance(o, ImagePoint):
            self.images.take_over(ImageTable.of([o], self.photo_number, self.point_number))
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
