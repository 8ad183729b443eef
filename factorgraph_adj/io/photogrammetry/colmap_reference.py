"""Reference tables of COLMAP: control points, marks, prior positions; keypoint scales, similarity.

A model of structure from motion has no reference system. Tables give it one: control points with
their measured image coordinates, and positions of photos (GNSS). Start values follow from the rays
of the marks and from a similarity of the model to the reference system.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from ...entities import Point
from ...errors import InputError, LeftOut, Problem, known
from ...files import note_read, opened
from ...models.inverse_lens import directions
from ...models.similarity import Similarity, extent_ratio, fit_similarity
from ...network.network import Network
from ...start.image_rays import nearest_to_rays
from ...types import Array
from ...units import LENGTH
from ..csv_tables import CsvTable, FieldRow, read_table
from ..format_options import option_text
from ..numbers import Units
from ..unknowns_tables import UnknownsReader, check_columns
from .colmap_cameras import CAMERA_MODEL_BY_NAME
from .colmap_model import NO_POINT, ImageRecord, SparseModel

UnregisteredChoice = Literal["refuse", "leave out"]
"""What to do with rows of tables that name images which the model does not have."""
MARK_COLUMNS = ("photo", "point", "x", "y", "sigma")
PRIOR_COLUMNS = ("photo", "x", "y", "z")
_SIGMAS = tuple(f"sigma{axis}_{unit}" for axis in ("", "_x", "_y", "_z") for unit in LENGTH)
_ARM = tuple(f"arm_{axis}_{unit}" for axis in "xyz" for unit in LENGTH)

DATABASE_COMPANIONS = ("-wal", "-shm", "-journal")
"""Endings of names of the files that belong to a database of SQLite."""
MAX_BLOB_BYTES = 500_000_000
"""Largest size of the keypoints of one image in a database, bytes."""
COMPUTED_QUERY = """SELECT 1 FROM sqlite_master WHERE type = 'view' OR upper(sql) LIKE '%GENERATED%'
OR upper(sql) LIKE '% VIRTUAL %' OR upper(sql) LIKE '% AS (%' OR upper(sql) LIKE '% AS(%'"""
"""What a database of COLMAP does not have: rows that are computed, perhaps without end."""
MIN_INTERSECTION_STRENGTH = 1e-3
"""Smallest strength of an intersection, see `nearest_to_rays`."""
MIN_EXTENT_RATIO = 1e-3
"""Ratio of the second to the first extent of places below which they lie on a line."""
IDENTITY_SIMILARITY = Similarity(1.0, np.eye(3), np.zeros(3))
"""The similarity that moves nothing."""


@dataclass(frozen=True)
class ControlMark:
    """Measured image coordinates of a control point."""

    photo: str
    """Name of the image."""
    point: str
    """Name of the control point."""
    x: float
    """Pixels from the left edge of the image."""
    y: float
    """Pixels from the upper edge, down."""
    sigma: float | None
    """Standard deviation, pixels; None: that of the other measurements."""
    where: str
    """File and line."""


@dataclass(frozen=True)
class PositionPrior:
    """Observed position of a photo."""

    photo: str
    """Name of the image."""
    xyz: tuple[float, float, float]
    """Position of the antenna, metres."""
    sigma: tuple[float, float, float]
    """Standard deviations, metres."""
    arm: tuple[float, float, float]
    """Lever arm, metres, in photogrammetric axes of the camera."""
    where: str
    """File and line."""


def _rows(
    path: Path, columns: tuple[str, ...], required: tuple[str, ...], problems: list[Problem]
) -> Iterator[FieldRow]:
    """Iterate over the rows of a table with known columns."""
    table = read_table(path, problems)
    if table is None:
        return
    valid = check_columns(table, columns, required, problems)
    if not set(required) <= valid:
        return
    for line, fields in table.records():
        yield FieldRow({k: v for k, v in fields.items() if k in valid}, table.where(line), problems)


def read_control_points(
    path: Path, problems: list[Problem]
) -> tuple[dict[str, Point], dict[str, str]]:
    """Read control points: the columns of a project's ``points.csv``, metres.

    Args:
        path: the table.
        problems: gets what is wrong.

    Returns:
        The points and their places in the file, by name.
    """
    table: CsvTable | None = read_table(path, problems)
    if table is None:
        return {}, {}
    network = Network("control points")
    reader = UnknownsReader(network, Units(), 3, problems)
    reader.points(table)
    where = {name: reader.sources.get(("point", name), table.name) for name in network.points}
    return network.points, where


def read_marks(path: Path, problems: list[Problem]) -> list[ControlMark]:
    """Read measured image coordinates: columns photo, point, x, y and perhaps sigma, pixels.

    The origin is the upper left corner of the image, y points down.
    """
    out = []
    for row in _rows(path, MARK_COLUMNS, MARK_COLUMNS[:4], problems):
        photo, point = row.text("photo", required=True), row.text("point", required=True)
        x, y = row.number("x", required=True), row.number("y", required=True)
        sigma = row.number("sigma", positive=True)
        if not row.failed and photo and point and x is not None and y is not None:
            out.append(ControlMark(photo, point, x, y, sigma, row.where))
    return out


def read_priors(path: Path, problems: list[Problem]) -> list[PositionPrior]:
    """Read positions of photos: columns photo, x, y, z (metres) and σ with its unit.

    σ is ``sigma_m``, or ``sigma_x_m`` … ``sigma_z_m``, in any unit of length. ``arm_x_m`` … is the
    lever arm, see `PhotoPosition`.
    """
    out = []
    for row in _rows(path, (*PRIOR_COLUMNS, *_SIGMAS, *_ARM), PRIOR_COLUMNS, problems):
        photo = row.text("photo", required=True)
        xyz = [row.number(a, required=True) for a in "xyz"]
        every = row.quantity("sigma", LENGTH, positive=True)
        sigma = [row.quantity(f"sigma_{a}", LENGTH, positive=True) for a in "xyz"]
        sigma = [every if s is None else s for s in sigma]
        arm = [row.quantity(f"arm_{a}", LENGTH) or 0.0 for a in "xyz"]
        if any(s is None for s in sigma) and not row.failed:
            row.wrong(
                "has no standard deviation; valid: sigma_m, or sigma_x_m, sigma_y_m, sigma_z_m"
            )
        if row.failed or not photo:
            continue
        numbers = [[v if v is not None else np.nan for v in part] for part in (xyz, sigma, arm)]
        (x, y, z), (sx, sy, sz), (ax, ay, az) = numbers
        out.append(PositionPrior(photo, (x, y, z), (sx, sy, sz), (ax, ay, az), row.where))
    return out


def keypoint_scales(path: Path, wanted: Mapping[str, int]) -> dict[str, Array]:
    """Return the scales of the keypoints of images, pixels, from a database of COLMAP.

    A keypoint has its scale, or an affine shape whose scale is the mean length of its columns.

    Args:
        path: the database.
        wanted: number of measurements by name of the image.

    Raises:
        InputError: the file is no database of COLMAP, lacks an image, or has another number of
            keypoints than the model has measurements, or keypoints without a scale.
    """
    problems: list[Problem] = []
    out: dict[str, Array] = {}
    with opened(path):
        pass
    for ending in DATABASE_COMPANIONS:
        note_read(path.with_name(path.name + ending))
    try:
        with sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_BLOB_BYTES)
            if database.execute(COMPUTED_QUERY).fetchone():
                raise InputError(Problem("has views or computed columns, not tables", str(path)))
            found = database.execute(
                "SELECT name, rows, cols, data FROM images JOIN keypoints USING (image_id)"
            )
            for name, rows, cols, data in found:
                if name not in wanted:
                    continue
                what = _keypoints(name, rows, cols, data, wanted[name])
                if isinstance(what, str):
                    problems.append(Problem(what, path.name))
                else:
                    out[name] = what
    except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
        raise InputError(Problem(f"is no database of COLMAP: {error}", str(path))) from None
    absent = [n for n in wanted if n not in out]
    if absent and not problems:
        problems.append(Problem(f"has no keypoints of images {known(absent)}", path.name))
    if problems:
        raise InputError(problems)
    return out


def _keypoints(name: str, rows: object, cols: object, data: object, n: int) -> Array | str:
    """Return the scales of the keypoints of one image, or what is wrong with them."""
    if not (isinstance(rows, int) and isinstance(cols, int) and isinstance(data, bytes | None)):
        return f"the keypoints of image {name!r} are not a table of numbers"
    blob = data or b""
    if rows < 0 or cols not in (4, 6) or len(blob) != 4 * rows * cols:
        return f"the keypoints of image {name!r} have no scale: {cols} columns; valid: 4 or 6"
    if rows != n:
        return f"image {name!r} has {rows} keypoints, but {n} measurements in the model"
    table = np.frombuffer(blob, "<f4").reshape(rows, cols).astype(float)
    if cols == 4:
        scale = table[:, 2]
    else:
        scale = 0.5 * (np.hypot(table[:, 2], table[:, 4]) + np.hypot(table[:, 3], table[:, 5]))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        return f"a keypoint of image {name!r} has no positive scale"
    return np.asarray(scale)


@dataclass(frozen=True)
class ModelTables:
    """Tables beside a model."""

    control: Mapping[str, Point] = field(default_factory=dict)
    """Control and check points by name."""
    marks: Sequence[ControlMark] = ()
    """Their measured image coordinates."""
    priors: Sequence[PositionPrior] = ()
    """Observed positions of photos."""
    left_out: Sequence[LeftOut] = ()
    """Rows of images that the model does not have."""

    @classmethod
    def read(
        cls,
        control: str | Path | None,
        marks_: str | Path | None,
        priors_: str | Path | None,
        model: SparseModel,
        unregistered: UnregisteredChoice,
    ) -> ModelTables:
        """Read the tables that are given, and compare them with the model.

        Args:
            control: table of control points.
            marks_: table of their image coordinates.
            priors_: table of positions of photos.
            model: the model.
            unregistered: what to do with rows whose image is not in the model.

        Raises:
            InputError: rows that cannot be read, unknown images and points, control points that
                are measured nowhere, second marks and positions; all with file and line.
        """
        problems: list[Problem] = []
        points, where = (
            read_control_points(Path(control), problems) if control is not None else ({}, {})
        )
        measured = read_marks(Path(marks_), problems) if marks_ is not None else []
        positions = read_priors(Path(priors_), problems) if priors_ is not None else []
        seen = {i.name: bool((i.points != NO_POINT).any()) for i in model.images}
        measured_photos = {m.photo for m in measured}
        present = {n for n, has in seen.items() if has or n in measured_photos}
        if unregistered == "refuse":
            hint = f"; {option_text('unregistered', 'leave out')} leaves such rows out"
            rows = [(m.photo, m.where) for m in measured]
            rows += [(p.photo, p.where) for p in positions]
            problems += [
                Problem(f"unknown image {photo!r}; images: {_known_names(seen, photo)}{hint}", at)
                for photo, at in rows
                if photo not in present
            ]
        left_out = []
        for what, lost in (
            ("marks", [(m.photo, m.where) for m in measured if m.photo not in present]),
            ("positions", [(p.photo, p.where) for p in positions if p.photo not in present]),
        ):
            if lost:
                why = "their images are not in the model"
                names = tuple(dict.fromkeys(photo for photo, _ in lost))
                left_out.append(LeftOut(what, why, names, len(lost), where=lost[0][1]))
        measured = [m for m in measured if m.photo in present]
        positions = [p for p in positions if p.photo in present]
        taken = {str(p.number) for p in model.points}
        problems += [
            Problem(
                f"unknown control point {m.point!r}; known: {_known_names(points, m.point)}",
                m.where,
            )
            for m in measured
            if m.point not in points and m.point not in taken
        ]
        marked = {m.point for m in measured}
        problems += [
            Problem(
                f"control point {name!r} is measured in no image and is not the number of a 3-D "
                "point: give its image coordinates as marks",
                where[name],
            )
            for name in points
            if name not in marked and name not in taken
        ]
        for what, keys in (
            ("mark", [(m.photo, m.point, m.where) for m in measured]),
            ("position", [(p.photo, "", p.where) for p in positions]),
        ):
            first: dict[tuple[str, str], str] = {}
            for photo, point, at in keys:
                if (photo, point) in first:
                    name = " ".join(filter(None, (photo, point)))
                    problems.append(
                        Problem(f"second {what} of {name}; the first is {first[photo, point]}", at)
                    )
                first.setdefault((photo, point), at)
        if problems:
            raise InputError(problems)
        return cls(points, measured, positions, left_out)


def _known_names(names: Iterable[str], meant: str) -> str:
    return known(names, meant=meant) or "none"


def mark_rays(
    model: SparseModel, measured: Sequence[tuple[ImageRecord, ControlMark]]
) -> tuple[Array, Array]:
    """Return projection centres and directions of marks in the model, (n, 3) each; NaN: none."""
    cameras = {c.number: c for c in model.cameras}
    centres, found = [], []
    for image, mark in measured:
        camera = cameras[image.camera]
        known = CAMERA_MODEL_BY_NAME[camera.model]
        assert known.lens is not None
        values = known.to_lens(camera.parameters)
        k = np.array([[values.get(n, 0.0) for n in known.lens.names]])
        ray = directions(known.lens, np.array([[mark.x, -mark.y]]), k)[0]
        centres.append(image.pose.centre)
        found.append(image.pose.rotation.T @ ray)
    return np.array(centres).reshape(-1, 3), np.array(found).reshape(-1, 3)


def ray_intersection(centres: Array, directions_: Array) -> Array | None:
    """Return where rays meet, (3,); None: there are fewer than two, or they are parallel."""
    if len(centres) < 2:
        return None
    group = np.zeros(len(centres), dtype=np.intp)
    at, strength = nearest_to_rays(centres, directions_, group, 1)
    return at[0] if strength[0] > MIN_INTERSECTION_STRENGTH and np.isfinite(at).all() else None


def similarity_of_points(x: Array, to: Array) -> Similarity | None:
    """Return the similarity that maps places (n, 3) to others; None: they do not determine it."""
    if not min(extent_ratio(x), extent_ratio(to)) > MIN_EXTENT_RATIO:
        return None
    found = fit_similarity(x, to)
    return found if found.scale > 0 else None
