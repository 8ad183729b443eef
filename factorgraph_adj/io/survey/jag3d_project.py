"""Project of JAG3D as read: its database as groups, and point pairs of its two epochs.

Source: JAG3D 2026, jag3d/sql/SQLDatabase.java (tables) and
adjustment/network/sql/SQLAdjustmentManager.java (which rows take part in an adjustment).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeAlias

from ...errors import InputError, Problem
from ...network.network import Network
from ..source import ROWS_SWITCHED_OFF, LeftOutReason, Problems
from ..text_files import file_beginning, last_line_number, read_text
from .hsqldb import DatabaseRow as TableRow
from .hsqldb import DatabaseTable, read_tables
from .jag3d_model import (
    JAG3D_EARTH_RADIUS_M,
    JAG3D_KIND_BY_NUMBER,
    PARAMETER_BY_NUMBER,
    POINT_STATUS_BY_NUMBER,
    Deflection,
    GroupParameter,
    ObservationGroup,
    ObservationRow,
    ObservationType,
    PointRow,
    Reduction,
    gaussian_radius,
)
from .jag3d_network import as_network, groups_with_set_names

EpochChoice: TypeAlias = Literal["both", "reference", "control"]
READ_TABLES = (
    "ObservationGroup",
    "ObservationGroupUncertainty",
    "ObservationApriori",
    "GNSSObservationApriori",
    "AdditionalParameterApriori",
    "PointGroup",
    "PointGroupUncertainty",
    "PointApriori",
    "ReductionDefinition",
    "ReductionTask",
    "VerticalDeflectionGroup",
    "VerticalDeflectionGroupUncertainty",
    "VerticalDeflectionApriori",
)
"""Tables that are read."""
OBSERVATION_TABLES = ("ObservationApriori", "GNSSObservationApriori")
"""Tables of observations."""
COUNTED_TABLES = ("PointApriori", *OBSERVATION_TABLES, "VerticalDeflectionApriori")
"""Tables of which every row that is not used is counted and named."""
OBSERVATIONS_OF_OTHER_EPOCH = LeftOutReason(
    "observations", "they belong to the other epoch: epoch=… chooses"
)
REQUIRED_TABLES = ("ObservationGroup", "ObservationApriori", "PointGroup", "PointApriori")
"""Tables without which a database is no project of JAG3D."""
PROJECTIONS = {1: "Gauß-Krüger", 2: "UTM", 3: "a local ellipsoidal system"}
"""Projections by number (ProjectionType.java) with which observations depend on coordinates."""
HEIGHT_REDUCTION, CURVATURE_REDUCTION = 2, 4
"""Numbers of reductions (ReductionTaskType.java)."""
SIGMA_PART_NUMBERS = (10, 11, 12)
"""Numbers of the parts a, b, c of σ of a group (ObservationGroupUncertaintyType.java)."""
SIGMA_AXIS_NUMBERS = {"y": 21, "x": 20, "z": 22}
"""Numbers of σ of the coordinates of a group of points (PointGroupUncertaintyType.java)."""
DEFLECTION_SIGMA_NUMBERS = {"y": 32, "x": 31}
"""Numbers of σ of deflections (VerticalDeflectionGroupUncertaintyType.java)."""
DEFAULT_DEFLECTION_SIGMA_RAD = 0.001 * math.pi / 200.0
"""σ of a stochastic deflection that states none, radians (DefaultUncertainty.java)."""


def is_jag3d_project(path: Path) -> bool:
    """Return whether a file is the script of a project of JAG3D."""
    return path.suffix == ".script" and b'"OpenAdjustment"' in file_beginning(path)


def read_jag3d_project(path: Path, *, epoch: EpochChoice) -> Network:
    """Return the network of a project; what is switched off in it is left out.

    Args:
        path: its script.
        epoch: epoch of the groups of observations.

    Raises:
        InputError: all problems.
    """
    tables = read_tables(path, READ_TABLES)
    missing = [name for name in REQUIRED_TABLES if name not in tables]
    if missing:
        what = f"is no project of JAG3D 2018 or later: it has no table {', '.join(missing)}"
        raise InputError(Problem(what, path.name))
    return _Tables(path, tables).network(epoch)


def point_pairs(path: str | Path) -> dict[str, str]:
    """Return the point pairs of the congruence analysis of a project, for `congruence`.

    Groups and pairs that are switched off are left out.

    Args:
        path: its script.

    Returns:
        Names in the control epoch by names in the reference epoch.

    Raises:
        InputError: the project is damaged, or a point is in two pairs.
    """
    script = Path(path).with_suffix(".script")
    groups, pairs = "CongruenceAnalysisGroup", "CongruenceAnalysisPointPairApriori"
    tables = _Tables(script, read_tables(script, (groups, pairs)))
    on = {tables.get(r, "id") for r in tables.rows(groups)}
    out: dict[str, str] = {}
    for row in tables.rows(pairs):
        if tables.get(row, "group_id") not in on:
            continue
        first = str(tables.get(row, "start_point_name", ""))
        second = str(tables.get(row, "end_point_name", ""))
        if out.setdefault(first, second) != second:
            what = f"point {first!r} is compared with {out[first]!r} and {second!r}"
            tables.problems.wrong(what, row.source)
    tables.problems.raise_all()
    return out


class _Tables:
    def __init__(self, path: Path, tables: Mapping[str, DatabaseTable]) -> None:
        self.path = path
        self.tables = tables
        self.problems = Problems()

    def rows(self, name: str) -> Iterable[TableRow]:
        """Return the rows of a table that are switched on, in the order of their ids."""
        table = self.tables.get(name)
        if table is None:
            return []
        on = [r for r in table.rows if r.values.get("enable") is not False]
        return sorted(on, key=lambda r: r.values.get("id") or 0)

    def get(self, row: TableRow, column: str, default: Any = None) -> Any:
        """Return a value of a row; note a problem where it is missing or not finite."""
        value = row.values.get(column, default)
        if value is None or (isinstance(value, float) and not abs(value) < 1e9):
            self.problems.wrong(f"{column} is {value}", row.source)
            return 0 if default is None else default
        return value

    def numbers(self, table: str) -> dict[tuple[int, int], float]:
        """Return the values of a table of uncertainties by group and type."""
        return {
            (self.get(r, "group_id"), self.get(r, "type")): self.get(r, "value")
            for r in self.rows(table)
        }

    def network(self, epoch: EpochChoice) -> Network:
        reduction = self._reduction()
        points = self._points()
        groups = self._groups(epoch)
        known = {p.name for p in points}
        off = {self.get(r, "name") for r in self._all("PointApriori")} - known
        # JAG3D takes observations of points that are switched off for switched off.
        groups = [
            ObservationGroup(
                g.name,
                g.kind,
                tuple(r for r in g.rows if r.start not in off and r.end not in off),
                g.uncertainty,
                g.extras,
                g.source,
            )
            for g in groups
        ]
        deflections = self._deflections()
        network = as_network(
            self.path.stem,
            points,
            groups_with_set_names([g for g in groups if g.rows]),
            deflections=deflections,
            reduction=reduction,
            problems=self.problems,
            where=f"{self.path.name}:{last_line_number(read_text(self.path))}",
        )
        used = {p.source for p in points} | {r.source for g in groups for r in g.rows}
        used |= {d.source for d in deflections if d.name in known}
        self._leave_out(used, epoch)
        self.problems.finish(network)
        return network

    def _leave_out(self, used: set[str], epoch: EpochChoice) -> None:
        """Leave out the points, observations and deflections whose rows are not used."""
        other = {
            group.values.get("id")
            for group in self.rows("ObservationGroup")
            if epoch != "both" and group.values.get("reference_epoch") != (epoch == "reference")
        }
        for table in COUNTED_TABLES:
            for row in self._all(table):
                if row.source in used:
                    continue
                of_other = table in OBSERVATION_TABLES and row.values.get("group_id") in other
                names = (row.values.get(c) for c in ("name", "start_point_name", "end_point_name"))
                why = OBSERVATIONS_OF_OTHER_EPOCH if of_other else ROWS_SWITCHED_OFF
                name = " ".join(str(n) for n in names if n)
                self.problems.leave_out(why, name, row.source)

    def _all(self, name: str) -> list[TableRow]:
        table = self.tables.get(name)
        return [] if table is None else table.rows

    def _reduction(self) -> Reduction:
        tasks = {self.get(r, "type") for r in self.rows("ReductionTask")}
        for row in self.rows("ReductionDefinition"):
            kind = self.get(row, "projection_type")
            major = self.get(row, "major_axis", JAG3D_EARTH_RADIUS_M)
            minor = self.get(row, "minor_axis", JAG3D_EARTH_RADIUS_M)
            latitude = self.get(row, "reference_latitude", 0.0)
            height = self.get(row, "reference_height", 0.0)
            if kind == 3 or (kind in PROJECTIONS and tasks):
                what = (
                    f"the project reduces observations to {PROJECTIONS[kind]}: give them as they "
                    "were measured (write flat files without reductions), and state the reference "
                    "system with fga.from_grid"
                )
                self.problems.wrong(what, row.source)
            if not (0 < minor <= major):
                self.problems.wrong(f"axes {major}, {minor} of an ellipsoid", row.source)
                continue
            return Reduction(
                gaussian_radius(major, minor, latitude),
                CURVATURE_REDUCTION in tasks,
                height if HEIGHT_REDUCTION in tasks else None,
            )
        return Reduction()

    def _points(self) -> list[PointRow]:
        uncertainty = self.numbers("PointGroupUncertainty")
        groups = {self.get(r, "id"): r for r in self.rows("PointGroup")}
        out = []
        for row in self.rows("PointApriori"):
            number = self.get(row, "group_id")
            if number not in groups:
                continue
            status = POINT_STATUS_BY_NUMBER.get(self.get(groups[number], "type"))
            dimension = self.get(groups[number], "dimension")
            if status is None or dimension not in (1, 2, 3):
                what = f"type or dimension {dimension} is not one of JAG3D"
                self.problems.wrong(what, groups[number].source)
                continue
            sigma = [
                own
                if (own := self.get(row, f"sigma_{axis}0", 0.0)) > 0
                else uncertainty.get((number, SIGMA_AXIS_NUMBERS[axis]), math.nan)
                for axis in "yxz"
            ]
            out.append(
                PointRow(
                    str(self.get(row, "name", "")),
                    status,
                    dimension,
                    tuple(float(self.get(row, f"{axis}0", 0.0)) for axis in "yxz"),  # type: ignore[arg-type]
                    tuple(sigma),  # type: ignore[arg-type]
                    row.source,
                )
            )
        return out

    def _groups(self, epoch: EpochChoice) -> list[ObservationGroup]:
        uncertainty = self.numbers("ObservationGroupUncertainty")
        rows: dict[int, list[ObservationRow]] = {}
        found: dict[int, tuple[ObservationType, TableRow]] = {}
        for group in self.rows("ObservationGroup"):
            kind = JAG3D_KIND_BY_NUMBER.get(self.get(group, "type"))
            if kind is None:
                what = f"observations of type {group.values.get('type')} are not known"
                self.problems.wrong(what, group.source)
            elif epoch == "both" or self.get(group, "reference_epoch", True) == (
                epoch == "reference"
            ):
                found[self.get(group, "id")] = kind, group
        for table in OBSERVATION_TABLES:
            for row in self.rows(table):
                number = self.get(row, "group_id")
                if number in found:
                    rows.setdefault(number, []).append(self._row(row, found[number][0]))
        extras: dict[int, dict[str, GroupParameter]] = {}
        for row in self._all("AdditionalParameterApriori"):
            name = PARAMETER_BY_NUMBER.get(self.get(row, "type"))
            if name is None:
                what = f"additional parameter of type {row.values.get('type')} is not known"
                self.problems.wrong(what, row.source)
                continue
            extra = GroupParameter(
                float(self.get(row, "value_0", 0.0)), row.values.get("enable") is True
            )
            extras.setdefault(self.get(row, "group_id"), {})[name] = extra
        out = []
        for number, (kind, group) in found.items():
            stated = [uncertainty.get((number, part), -1.0) for part in SIGMA_PART_NUMBERS]
            parts = [
                s if s > 0 or (s == 0 and i > 0) else d
                for i, (s, d) in enumerate(zip(stated, kind.default, strict=True))
            ]
            out.append(
                ObservationGroup(
                    str(self.get(group, "name", "")) or f"{kind.name} {number}",
                    kind,
                    tuple(rows.get(number, ())),
                    tuple(parts),  # type: ignore[arg-type]
                    extras.get(number, {}),
                    group.source,
                )
            )
        return out

    def _row(self, row: TableRow, kind: ObservationType) -> ObservationRow:
        start = str(self.get(row, "start_point_name", ""))
        end = str(self.get(row, "end_point_name", ""))
        if kind.axes:
            value = tuple(float(self.get(row, f"{a}0", 0.0)) for a in kind.axes)
            sigma = tuple(self.get(row, f"sigma_{a}0", 0.0) for a in kind.axes)
            return ObservationRow(start, end, value, sigma, row.source)
        return ObservationRow(
            start,
            end,
            (float(self.get(row, "value_0")),),
            (self.get(row, "sigma_0", 0.0),),
            row.source,
            ih=self.get(row, "instrument_height", 0.0),
            th=self.get(row, "reflector_height", 0.0),
            distance=self.get(row, "distance_0", 0.0),
        )

    def _deflections(self) -> list[Deflection]:
        uncertainty = self.numbers("VerticalDeflectionGroupUncertainty")
        groups = {self.get(r, "id"): r for r in self.rows("VerticalDeflectionGroup")}
        out = []
        for row in self.rows("VerticalDeflectionApriori"):
            number = self.get(row, "group_id")
            if number not in groups:
                continue
            kind = self.get(groups[number], "type")
            y, x = (float(self.get(row, f"{a}0", 0.0)) for a in "yx")
            sy, sx = (
                own
                if (own := self.get(row, f"sigma_{a}0", 0.0)) > 0
                else uncertainty.get(
                    (number, DEFLECTION_SIGMA_NUMBERS[a]), DEFAULT_DEFLECTION_SIGMA_RAD
                )
                for a in "yx"
            )
            sigma = (sy, sx) if kind == 2 else None
            out.append(
                Deflection(str(self.get(row, "name", "")), (y, x), sigma, kind == 3, row.source)
            )
        return out
