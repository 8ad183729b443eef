"""Reader of images.csv, observations.csv, covariances.csv, and doubts.csv on reduced readings."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from math import isfinite
from pathlib import Path

import numpy as np

from ..control_characters import problems_of_names
from ..errors import Doubt, InputError, Problem, known
from ..network.network import Network
from ..observations import KINDS, Observation
from . import observation_records
from .covariance_tables import CovarianceTable, image_correlation
from .csv_tables import CsvTable, FieldRow
from .observation_fields import (
    RecordContext,
    known_fields,
    placeholder_sigma,
    sigma_fields,
    signs_in_files,
)
from .unknowns_tables import check_columns

IMAGE_COLUMNS = ("photo", "point", "x", "y", "id", *sigma_fields("image"), "correlation")
TABLES_OF_OBSERVATIONS = ("observations", "images", "readings")
"""Tables of a project that have observations, or readings of which they are means."""
DOUBT_COLUMNS = ("doubt", "where", "what", "id")


@dataclass
class ObservationsReader:
    """Reader of tables of observations into a network; it notes problems and continues."""

    network: Network
    """The network, with its points, photos and other unknowns."""
    context: RecordContext
    """Defaults of the project for records."""
    problems: list[Problem]
    """Problems found so far."""
    unreadable: set[str] = field(default_factory=set)
    """Entities (point, photo) whose names are unknown because their table cannot be read."""
    readings: bool = True
    """Whether observed values are required; otherwise a missing value is zero."""
    complete: bool = True
    """Whether every row, or a stand-in with its names, is in the network."""

    def with_covariances(self, table: CsvTable | None, covariances: CsvTable | None) -> None:
        """Read observations.csv, if there is one, and the covariances of it and of images.csv."""
        matrices = None
        if covariances is not None:
            matrices = CovarianceTable(covariances, self.problems, self.context.axes_of)
        if matrices is not None:
            images = {
                self.network.images.ids.get(row) or f"{o.photo}/{o.point}": row
                for row, o in enumerate(self.network.image_points())
            }
            points = self.network.image_points()
            axes = [self.context.axes_of(o.photo) for o in points]
            for group in matrices.image_groups(images, signs_in_files(axes)):
                self.network.images.join(group)
        if table is not None:
            self.observations(table, matrices)
        elif matrices is not None:
            matrices.join([])

    def observations(self, table: CsvTable, matrices: CovarianceTable | None) -> None:
        """Read observations.csv, and the covariances between its rows."""
        before = len(self.problems)
        valid = check_columns(table, known_fields(), ("kind",), self.problems)
        self.complete &= len(self.problems) == before
        if "kind" not in valid:
            return
        found: list[Observation] = []
        context = self.context
        if any(c.startswith(("sigma", "covariance")) and c not in valid for c in table.columns):
            # The header has the message; the stand-ins avoid one more for every row.
            stand_ins = {kind: placeholder_sigma(kind) for kind in KINDS}
            context = replace(context, sigma={**stand_ins, **context.sigma})
        rows = list(table.records())
        taken = {fields["id"] for _, fields in rows if "id" in fields}
        free = (str(i) for i in count(1) if str(i) not in taken)
        for line, fields in rows:
            record: dict[str, object] = {k: v for k, v in fields.items() if k in valid}
            ident, where = fields.get("id"), table.where(line)
            if ident is None and taken and fields.get("kind") != "image":
                record["id"] = next(free)  # a number that no other row claims
            if matrices is not None and ident is not None:
                matrices.complete_sigma(ident, record)
            if not self.readings:
                record = observation_records.record_with_reading(record)
            try:
                found.append(
                    observation_records.observation_from_record(
                        record, context=context, source=where
                    )
                )
            except InputError as error:
                self.problems.extend(error.problems)
                self._stand_in(record, where, found)
        refused: list[Problem] = []
        for item in found if matrices is None else matrices.join(found):
            if self.unreadable:
                break
            try:
                self.network.add(item)
            except InputError as error:
                refused.extend(error.problems)
                self.complete = False
        self.problems.extend(_problems_once(refused))

    def _stand_in(self, record: dict[str, object], where: str, found: list[Observation]) -> None:
        try:
            other = observation_records.placeholder_observation(record, source=where)
        except InputError:
            other = None
        if other is None:
            self.complete = False
        else:
            found.append(other)

    def doubts(self, table: CsvTable) -> None:
        """Read doubts.csv: doubts about readings that observations were made from."""
        valid = check_columns(table, DOUBT_COLUMNS, DOUBT_COLUMNS[:1], self.problems)
        if DOUBT_COLUMNS[0] not in valid:
            return
        found: dict[str, Doubt] = {}
        for line, fields in table.records():
            row = FieldRow(fields, table.where(line), self.problems)
            number = row.text("doubt", required=True) or ""
            what, where = (row.text(n, default="") or "" for n in ("what", "where"))
            doubt = found.setdefault(number, Doubt(what, where))
            ident = row.text("id")
            if ident is None:
                continue
            if ident not in self.network.observations and self.complete:
                names = known(self.network.observations, meant=ident)
                row.wrong(f"unknown observation {ident!r}; known: {names}")
            found[number] = replace(doubt, ids=(*doubt.ids, ident))
        self.network.doubts += found.values()

    def images(self, table: CsvTable) -> None:
        """Read images.csv by columns, as it has many rows; each standard deviation is read once."""
        valid = check_columns(table, IMAGE_COLUMNS, ("photo", "point", "x", "y"), self.problems)
        if not {"photo", "point", "x", "y"} <= valid:
            self.complete = False
            return
        unknown_sigma = any(c.startswith("sigma") and c not in valid for c in table.columns)
        column = {name: i for i, name in enumerate(table.columns)}
        photo_number = {n: i for i, n in enumerate(self.network.photos)}
        point_number = {n: i for i, n in enumerate(self.network.points)}
        stated = [n for n in table.columns if n.startswith("sigma") and n in valid]
        at_sigma = [column[n] for n in stated]
        at_photo, at_point, at_x, at_y = (column[n] for n in ("photo", "point", "x", "y"))
        at_id, at_rho = column.get("id"), column.get("correlation")
        sigma_of: dict[tuple[str, ...], tuple[float, float] | None] = {}
        unknown: dict[tuple[str, str], list[int]] = {}
        seen: dict[tuple[int, int], int] = {}
        photos: list[int] = []
        points: list[int] = []
        xy: list[tuple[float, float]] = []
        sigmas: list[tuple[float, float]] = []
        correlations: list[float] = []
        first, ids, sources = self.network.n_image_points, {}, {}
        for line, cells in table.rows:
            photo, point = photo_number.get(cells[at_photo]), point_number.get(cells[at_point])
            if photo is None:
                unknown.setdefault(("photo", cells[at_photo]), []).append(line)
            if point is None:
                unknown.setdefault(("point", cells[at_point]), []).append(line)
            try:
                x, y = float(cells[at_x]), float(cells[at_y])
            except ValueError:
                x = y = np.nan
            if not isfinite(x + y) or "_" in cells[at_x] + cells[at_y]:
                x, y = self._bad_image(table, line, cells)
            axes = self.context.axes_of(cells[at_photo])
            key = (axes.unit, cells[at_photo], *(cells[i] for i in at_sigma))
            if key not in sigma_of:
                fields = {n: cells[i] for n, i in zip(stated, at_sigma, strict=True)}
                what = f"image point {cells[at_photo]}/{cells[at_point]}"
                row = FieldRow(fields, table.where(line), self.problems, what)
                default = self.context.sigma.get("image", {})
                judged = cells[at_photo] in self.context.images and not unknown_sigma
                sigma_of[key] = (
                    observation_records.image_sigma(row, axes, default) if judged else None
                )
            if photo is None or point is None:
                continue
            if (photo, point) in seen:
                self.problems.append(
                    Problem(
                        "the point is measured more than once in this photo; first in line "
                        f"{seen[photo, point]}",
                        f"{table.where(line)}: image point {cells[at_photo]}/{cells[at_point]}",
                    )
                )
                continue
            seen[photo, point] = line
            if at_id is not None and cells[at_id]:
                ids[first + len(photos)] = cells[at_id]
                found = problems_of_names([cells[at_id]], "image point")
                self.problems += [p.at(table.where(line)) for p in found]
            sources[first + len(photos)] = table.where(line)
            photos.append(photo)
            points.append(point)
            xy.append((x, -y if axes.y_down else y))
            sigmas.append(sigma_of[key] or (1.0, 1.0))
            correlations.append(0.0)
            if at_rho is not None and cells[at_rho]:
                row = self._image_row(table, line, cells)
                correlations[-1] = image_correlation(row, axes)
        self._unknown_names(table, unknown)
        self.network.images.append(
            np.array(photos, dtype=np.intp),
            np.array(points, dtype=np.intp),
            np.array(xy, dtype=float).reshape(-1, 2),
            np.array(sigmas, dtype=float).reshape(-1, 2),
            np.array(correlations, dtype=float),
        )
        self.network.images.ids.update(ids)
        self.network.images.sources.update(sources)

    def _bad_image(self, table: CsvTable, line: int, cells: list[str]) -> tuple[float, float]:
        row = self._image_row(table, line, cells)
        row.number("x", required=True)
        row.number("y", required=True)
        return 0.0, 0.0

    def _image_row(self, table: CsvTable, line: int, cells: list[str]) -> FieldRow:
        fields = dict(zip(table.columns, cells, strict=True))
        what = f"image point {fields['photo']}/{fields['point']}"
        return FieldRow(fields, table.where(line), self.problems, what)

    def _unknown_names(self, table: CsvTable, unknown: dict[tuple[str, str], list[int]]) -> None:
        """Note unknown names, each once with its lines."""
        names: dict[str, Iterable[str]] = {
            "photo": self.network.photos,
            "point": self.network.points,
        }
        for (kind, name), lines in unknown.items():
            self.complete = False
            if name and kind in self.unreadable:
                continue
            if not name:
                what = f"{kind} is missing"
            else:
                what = f"unknown {kind} {name!r}; known: {known(names[kind], meant=name)}"
            if len(lines) > 1:
                what += f" (also in lines {known(map(str, lines[1:]))})"
            self.problems.append(Problem(what, table.where(lines[0])))


def _problems_once(problems: Sequence[Problem]) -> list[Problem]:
    """Return problems of which those with the same text, such as an unknown name, are one.

    A name that no row states is unknown in every observation that has it.
    """
    same: dict[str, list[Problem]] = {}
    for p in problems:
        same.setdefault(p.what, []).append(p)
    out = []
    for what, own in same.items():
        more = len(own) - 1
        also = f" (and in {more} more observation{'s' * (more > 1)})" if more else ""
        out.append(replace(own[0], what=what + also))
    return out


def without_observations(path: Path, found: Collection[str], stated: bool) -> str:
    """Return which tables of observations a project does not have; empty if it has one of them.

    Args:
        path: the TOML file of the project.
        found: names of its tables.
        stated: whether the TOML file names its tables under [files].
    """
    if not set(TABLES_OF_OBSERVATIONS).isdisjoint(found):
        return ""
    if stated:
        return f"[files] of {path} names none of {', '.join(TABLES_OF_OBSERVATIONS)}"
    files = ", ".join(f"{name}.csv" for name in TABLES_OF_OBSERVATIONS)
    return f"the folder {path.parent} has none of {files}"
