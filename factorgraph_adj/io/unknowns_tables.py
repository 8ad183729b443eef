"""Reader of points.csv, photos.csv (with carriers) and tables of parameters; their columns."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Literal

import numpy as np

from ..entities import Key, Photo
from ..errors import InputError, Problem, known
from ..frames import LocalFrame, TopocentricFrame
from ..models.unknown_registry import UnknownKind
from ..network.composite_unknowns import RIGID, member_of_rig
from ..network.network import Network
from ..types import Array
from ..units import ANGLE, LENGTH
from .csv_tables import REMARK_COLUMNS, CsvTable, FieldRow
from .numbers import Units
from .observation_fields import unknown_field_message
from .parameter_tables import parameter_columns, parameter_table, read_parameter

Dimension = Literal[1, 2, 3]
"""Dimension of a network: 1 holds x and y, 2 holds z of every point; missing values are 0."""
HELD_BY_DIMENSION = {1: "xy", 2: "z", 3: ""}
GEOGRAPHIC_COLUMNS = ("latitude", "longitude", "height")
ROTATION_COLUMNS = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
ATTITUDE_COLUMNS = ("omega", "phi", "kappa")
POSE_PARTS = ("rx", "ry", "rz", "x", "y", "z")
"""Parts of a photo's orientation that can be held one by one."""
POSE_WORDS = {"yes": POSE_PARTS, "attitude": POSE_PARTS[:3], "position": POSE_PARTS[3:]}
_HORIZON = re.compile("sigma_(e|n|u|east|north|up)(_|$)")
CHECK_COLUMNS = ("check_x", "check_y", "check_z")


def _with_units(prefixes: Iterable[str], units: Iterable[str]) -> tuple[str, ...]:
    each = tuple(units)
    return tuple(f"{p}_{u}" for p in prefixes for u in each)


_SIGMA_XYZ = _with_units(("sigma", "sigma_x", "sigma_y", "sigma_z"), LENGTH)


POINT_COLUMNS = (
    *("name", "x", "y", "z", *GEOGRAPHIC_COLUMNS, "fixed", "datum", "side_shot"),
    *(*_SIGMA_XYZ, *CHECK_COLUMNS),
)
CARRIER_COLUMNS = ("carrier", "mount", *_with_units(("play",), (*LENGTH, *ANGLE)))
"""Columns of photos.csv that put a photo on a carrier; they become observations."""
PHOTO_COLUMNS = (
    *("name", "camera", "x", "y", "z", *ATTITUDE_COLUMNS, *ROTATION_COLUMNS, "fixed"),
    *(*_SIGMA_XYZ, *_with_units(("sigma_attitude",), ANGLE)),
)


def check_columns(
    table: CsvTable, valid: Iterable[str], required: Iterable[str], problems: list[Problem]
) -> set[str]:
    """Note columns that are unknown or missing; return the known columns of the table."""
    line = min((number for number, _ in table.rows), default=2) - 1
    where, known = table.where(max(line, 1)), {*valid, *REMARK_COLUMNS}
    for name in required:
        if name not in table.columns:
            has = ", ".join(table.columns)
            problems.append(Problem(f"missing column {name!r}; columns: {has}", where))
    for name in table.columns:
        what = _horizon_sigma_hint(name, known) or unknown_field_message(name, known)
        if what is not None:
            problems.append(Problem(what, where))
    return known & set(table.columns)


def _horizon_sigma_hint(name: str, known: Iterable[str]) -> str:
    """Return where σ in east, north, up is given, if a table of points has it instead."""
    found = _HORIZON.match(name)
    if found is None or name in known or CHECK_COLUMNS[0] not in known:
        return ""
    return (
        f"unknown column {name!r}: a table of points has σ along x, y, z of the frame; σ along "
        "east, north, up is that of a control point: a row of observations.csv of the kind "
        f"control with axes enu, all of x, y, z, and sigma_{found[1][0]}_mm"
    )


def _sigmas(row: FieldRow, axes: Iterable[str], units: Iterable[str]) -> tuple[float, ...] | None:
    """Return σ of each axis, infinite where none is given; None if no axis has a σ."""
    for_all = row.quantity("sigma", units, positive=True)
    each = [row.quantity(f"sigma_{a}", units, positive=True) for a in axes]
    if for_all is None and all(s is None for s in each):
        return None
    free = np.inf if for_all is None else for_all
    return tuple(free if s is None else s for s in each)


class UnknownsReader:
    """Reader of tables of unknowns into a network; it notes problems and continues.

    An unknown of a bad row gets a stand-in, so that other rows can refer to its name.
    """

    def __init__(
        self, network: Network, units: Units, dimension: Dimension, problems: list[Problem]
    ) -> None:
        """Read into ``network``."""
        self.network = network
        self.units = units
        self.dimension = dimension
        self.problems = problems
        self.complete = True
        """Whether all names and flags are in the network, so that its structure can be checked."""
        self.unreadable: set[str] = set()
        """Entities (point, photo) whose names are unknown because their table cannot be read."""
        self.cameras_named = True
        """Whether the names of all cameras could be read."""
        self._carried: list[tuple[FieldRow, str]] = []
        """Rows of photos that sit on a carrier, and their names."""
        self.sources: dict[tuple[str, str], str] = {}
        """File and line by entity (point, photo) and name."""

    def _rows(
        self, table: CsvTable, columns: tuple[str, ...], required: tuple[str, ...], key: str
    ) -> Iterable[tuple[FieldRow, str]]:
        """Iterate over rows that have the key; note bad columns once."""
        before = len(self.problems)
        valid = check_columns(table, columns, required, self.problems)
        self.complete &= len(self.problems) == before
        if not set(required) <= valid:
            return
        for line, fields in table.records():
            known = {k: v for k, v in fields.items() if k in valid}
            row = FieldRow(
                known, table.where(line), self.problems, f"{key} {fields.get(key, '')!r}"
            )
            yield row, row.text(key, default="") or ""

    def _named(
        self, table: CsvTable, columns: tuple[str, ...], what: str, *, nameless: bool = False
    ) -> Iterable[tuple[FieldRow, str]]:
        """Iterate over rows with a new name; one row may lack a name where ``nameless``."""
        seen: dict[str, int] = {}
        line_of = {table.where(line): line for line, _ in table.rows}
        for row, name in self._rows(table, columns, ("name",), "name"):
            row.of = f"{what} {name!r}"
            if not name and not nameless:
                row.of = ""
                row.wrong("name is missing")
                self.complete = False
            elif name in seen:
                self.complete = False
                row.wrong(f"duplicate name of a {what}; first in line {seen[name]}")
            else:
                seen[name] = line_of[row.where]
                self.sources[what, name] = row.where
                yield row, name

    def points(self, table: CsvTable) -> None:
        """Read points.csv."""
        if "name" not in table.columns:
            self.unreadable.add("point")
        for row, name in self._named(table, POINT_COLUMNS, "point"):
            self.point(row, name)

    def point(self, row: FieldRow, name: str) -> None:
        """Read one point; its name must be new."""
        held = HELD_BY_DIMENSION[self.dimension]
        xyz = self._coordinates(row)
        fixed = "".join(row.letters("fixed", "xyz"))
        for i, axis in enumerate("xyz"):
            if axis in held:
                xyz[i] = 0.0 if np.isnan(xyz[i]) else xyz[i]
        fixed += "".join(a for a in held if a not in fixed)
        sigma = _sigmas(row, "xyz", LENGTH)
        if sigma is not None:
            sigma = tuple(np.inf if a in fixed else s for a, s in zip("xyz", sigma, strict=True))
        check = [row.number(c, self.units.length) for c in CHECK_COLUMNS]
        datum, side_shot = row.flag("datum"), row.flag("side_shot")
        if not row.failed:
            try:
                self.network.add_point(
                    name,
                    xyz,
                    fixed=fixed,
                    sigma=sigma,
                    datum=datum,
                    side_shot=side_shot,
                    check=None if check == [None] * 3 else [_nan_for_none(c) for c in check],
                )
            except InputError as error:
                row.wrong_all(error)
        if name not in self.network.points:
            self.network.add_point(name, datum=datum, side_shot=side_shot)
            flags = ("x" in fixed, "y" in fixed, "z" in fixed)
            point = self.network.points[name]
            self.network.points[name] = replace(point, fixed=flags, sigma=sigma)  # type: ignore[arg-type]

    def _coordinates(self, row: FieldRow) -> list[float]:
        """Return x, y, z in metres, NaN where unknown; convert latitude, longitude, height."""
        if not any(g in row for g in GEOGRAPHIC_COLUMNS):
            return [_nan_for_none(row.number(a, self.units.length)) for a in "xyz"]
        frame = self.network.frame
        for a in "xyz":
            if a in row:
                row.wrong(f"give either latitude, longitude, height or x, y, z, not {a} too")
                return [np.nan] * 3
        if isinstance(frame, LocalFrame):
            row.wrong("latitude and longitude need a geocentric or topocentric frame")
            return [np.nan] * 3
        latitude = row.number("latitude", self.units.geographic, required=True)
        longitude = row.number("longitude", self.units.geographic, required=True)
        height = row.number("height", self.units.length, required=True)
        if latitude is None or longitude is None or height is None:
            return [np.nan] * 3
        if abs(latitude) > np.pi / 2:
            row.wrong(f"latitude is beyond a pole: {row.fields['latitude']}")
            return [np.nan] * 3
        at = np.array([latitude]), np.array([longitude]), np.array([height])
        if isinstance(frame, TopocentricFrame):
            xyz = frame.geocentric.ellipsoid.to_cartesian(*at)
            return [float(v) for v in frame.from_geocentric(xyz)[0]]
        return [float(v) for v in frame.ellipsoid.to_cartesian(*at)[0]]

    def photos(self, table: CsvTable) -> None:
        """Read photos.csv; a project with one camera may leave the column camera out."""
        if "name" not in table.columns:
            self.unreadable.add("photo")
        strangers: dict[str, list[FieldRow]] = {}
        for row, name in self._named(table, (*PHOTO_COLUMNS, *CARRIER_COLUMNS), "photo"):
            self.photo(row, name, strangers)
            if any(c in row for c in CARRIER_COLUMNS):
                self._carried.append((row, name))
        for camera, rows in strangers.items() if self.cameras_named else ():
            names = known(self.network.cameras, meant=camera)
            also = known([row.where for row in rows[1:]])
            what = f"unknown camera {camera!r}; known: {names}"
            rows[0].wrong(f"{what} (also in {also})" if len(rows) > 1 else what)

    def photo(
        self, row: FieldRow, name: str, strangers: dict[str, list[FieldRow]] | None = None
    ) -> None:
        """Read one photo; its name must be new; a network with one camera may omit the camera.

        Args:
            row: its fields.
            name: its name.
            strangers: rows by cameras that the network does not have, to which this one is added
                instead of a problem; None: it is a problem.
        """
        only = next(iter(self.network.cameras), None) if len(self.network.cameras) == 1 else None
        camera = row.text("camera", required=only is None, default=only)
        units = self.units
        position = self._all_or_none(row, ("x", "y", "z"), units.length)
        angles = self._all_or_none(row, ATTITUDE_COLUMNS, units.angle)
        rotation: Array | None = None
        entries = self._all_or_none(row, ROTATION_COLUMNS, "")
        if entries is not None:
            rotation = np.array(entries).reshape(3, 3)
            if angles is not None:
                row.wrong("give either omega, phi, kappa or r11 … r33, not both")
        fixed = self._fixed_parts(row)
        sigma = _sigmas(row, "xyz", LENGTH)
        attitude = row.quantity("sigma_attitude", ANGLE, positive=True)
        if strangers is not None and camera is not None and camera not in self.network.cameras:
            strangers.setdefault(camera, []).append(row)
        elif not row.failed and camera is not None:
            try:
                self.network.add_photo(
                    name,
                    camera,
                    position=position,
                    omega_phi_kappa=angles,
                    rotation=rotation,
                    fixed=fixed,
                    sigma_position=sigma,
                    sigma_attitude=attitude,
                )
            except InputError as error:
                row.wrong_all(error)
        if name not in self.network.photos:
            self.network.photos[name] = Photo(name, camera or "", fixed=tuple(fixed))
            self.complete &= camera in self.network.cameras

    def carriers(self) -> None:
        """Put photos on their carriers, once all photos and mounts are read."""
        network = self.network
        for row, name in self._carried:
            before = len(self.problems)
            carrier = row.text("carrier", required=True)
            mount = row.text("mount", required=True)
            turn = row.quantity("play", ANGLE, positive=True)
            shift = row.quantity("play", LENGTH, positive=True)
            if len(self.problems) > before or carrier is None or mount is None:
                continue
            play = (turn or RIGID[0], shift or RIGID[1])
            try:
                ties = member_of_rig(
                    name,
                    carrier,
                    mount,
                    play=play,
                    photos=network.photos,
                    mounts=network.mounts,
                    source=row.where,
                )
                network.add(*ties)
            except InputError as error:
                row.wrong_all(error)

    def _all_or_none(
        self, row: FieldRow, names: tuple[str, ...], unit: str
    ) -> tuple[float, ...] | None:
        if not any(n in row for n in names):
            return None
        found = [row.number(n, unit, required=True) for n in names]
        return None if None in found else tuple(v for v in found if v is not None)

    def _fixed_parts(self, row: FieldRow) -> list[bool]:
        if isinstance(row.fields.get("fixed"), bool):
            return [row.flag("fixed")] * len(POSE_PARTS)
        text = row.text("fixed", default="") or ""
        held: set[str] = set()
        for word in text.split():
            if word in POSE_WORDS:
                held |= set(POSE_WORDS[word])
            elif word in POSE_PARTS:
                held.add(word)
            elif word != "no":
                valid = ", ".join([*POSE_WORDS, "no", *POSE_PARTS])
                row.wrong(f"fixed must be some of {valid}, not {word!r}")
        return [part in held for part in POSE_PARTS]

    def parameters(self, table: CsvTable, kind: UnknownKind) -> None:
        """Read the table of a kind of parameters."""
        stated, given = parameter_table(kind), self.network.of_kind(kind.name)
        columns, required = parameter_columns(kind), stated.keys[:1]
        if stated.keys == ("name",):
            for row, name in self._named(
                table, columns, kind.noun, nameless=kind.default is not None
            ):
                read_parameter(row, kind, name, self.network, self.units)
                if name not in given:
                    self._parameter_stand_in(kind, name)
            return
        seen: set[Key] = set()
        for row, first in self._rows(table, columns, required, stated.keys[0]):
            others = [
                row.text(k, default=stated.key_default) or stated.key_default
                for k in stated.keys[1:]
            ]
            key: Key = (first, *others) if others else first
            row.of = f"{kind.name} of {first!r}" + "".join(
                f", {k} {v!r}" for k, v in zip(stated.keys[1:], others, strict=True)
            )
            if key in seen:
                row.wrong(f"duplicate {kind.name}")
                continue
            seen.add(key)
            read_parameter(row, kind, key, self.network, self.units)

    def _parameter_stand_in(self, kind: UnknownKind, name: str) -> None:
        """Put a stand-in for a bad row into the network, so that other rows can refer to it."""
        values = [0.0 if np.isnan(c.start) else c.start for c in kind.components[: kind.usual]]
        fixed = parameter_table(kind).held_unless_free
        self.network.set_unknown(kind.name, name, values, fixed=fixed)


def _nan_for_none(value: float | None) -> float:
    return float("nan") if value is None else value
