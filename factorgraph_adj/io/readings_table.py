"""Reader of readings.csv, the table of readings in two faces, reduced to observations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import cast

from ..errors import InputError, Problem, known
from ..network.face_readings import FaceReading
from ..network.face_reduction import FacesChoice, reduce_faces
from ..network.network import Network
from ..stochastic_model import StandardDeviation
from .csv_tables import CsvTable, FieldRow
from .observation_fields import RecordContext, sigma_fields
from .observation_records import scalar_sigma
from .unknowns_tables import check_columns

READING_NAME_COLUMNS = ("station", "target", "set", "instrument", "distance_meter", "refraction")
"""Columns of names."""
READING_KINDS = {"direction": "direction", "zenith": "zenith_angle", "distance": "slope_distance"}
"""Columns of readings, and the kind of observation that each becomes."""
LENGTH_COLUMNS = ("distance", "instrument_height", "target_height")
"""Columns in the project's unit of length."""
READING_TABLE_COLUMNS = (*READING_NAME_COLUMNS, "face", *READING_KINDS, *LENGTH_COLUMNS[1:])
FACE_BY_TEXT = {"1": 1, "I": 1, "2": 2, "II": 2}
"""Faces as they may be written."""


def read_readings(
    network: Network,
    table: CsvTable,
    context: RecordContext,
    faces: str,
    problems: list[Problem],
) -> bool:
    """Reduce the readings of a table and add the observations to a network.

    Args:
        network: the network, with its points and other unknowns.
        table: the table.
        context: units of the project, and σ of a reading in one face by kind: those of
            directions, zenith angles and slope distances.
        faces: ``means`` or ``both``, see `factorgraph_adj.reduce_faces`.
        problems: list to which problems are added.

    Returns:
        Whether all readings are in the network.
    """
    before = len(problems)
    valid = check_columns(table, READING_TABLE_COLUMNS, ("station", "target"), problems)
    if not {"station", "target"} <= valid:
        return False
    readings = []
    for line, cells in table.records():
        own = {k: v for k, v in cells.items() if k in valid}
        found = _reading(FieldRow(own, table.where(line), problems), context)
        if found is not None:
            readings.append(found)
    problems += _unknown_stations_and_targets(network, readings)
    sigmas = _reading_sigmas(table, readings, context, problems)
    try:
        reduced = reduce_faces(readings, **sigmas, faces=cast(FacesChoice, faces))
        if len(problems) == before:
            reduced.add_to(network)
    except InputError as error:
        problems += error.problems
    return len(problems) == before


def _reading(row: FieldRow, context: RecordContext) -> FaceReading | None:
    names = {n: row.text(n, required=n in ("station", "target")) for n in READING_NAME_COLUMNS}
    row.of = " – ".join(n for n in (names["station"], names["target"]) if n)
    text = (row.text("face") or "").upper()
    if text and text not in FACE_BY_TEXT:
        row.wrong(f"face must be 1 or 2 (I or II), or empty where zenith tells it, not {text!r}")
    numbers = {
        name: row.number(
            name, context.units.length if name in LENGTH_COLUMNS else context.units.angle
        )
        for name in (*READING_KINDS, *LENGTH_COLUMNS[1:])
    }
    if numbers["distance"] is not None and numbers["distance"] < 0:
        row.wrong(f"a distance cannot be negative: {numbers['distance']}")
    if names["station"] is not None and names["station"] == names["target"]:
        row.wrong("an observation cannot join a point to itself")
    if row.failed:
        return None
    return FaceReading(
        station=names["station"] or "",
        target=names["target"] or "",
        face=FACE_BY_TEXT.get(text),
        direction=numbers["direction"],
        zenith=numbers["zenith"],
        distance=numbers["distance"],
        set=names["set"] or "1",
        instrument_height=numbers["instrument_height"] or 0.0,
        target_height=numbers["target_height"] or 0.0,
        instrument=names["instrument"],
        distance_meter=names["distance_meter"],
        refraction=names["refraction"],
        source=row.where,
    )


def _unknown_stations_and_targets(
    network: Network, readings: Iterable[FaceReading]
) -> list[Problem]:
    """Return names that the network does not have, each once with its rows."""
    given: dict[str, tuple[str, Mapping[str, object]]] = {
        "station": ("point", network.points),
        "target": ("point", network.points),
        "distance_meter": ("distance meter", network.distance_meters),
        "refraction": ("refraction group", network.refractions),
    }
    rows: dict[tuple[str, str], list[str]] = {}
    for r in readings:
        for attribute, (noun, names) in given.items():
            name = getattr(r, attribute)
            if name is not None and name not in names:
                rows.setdefault((noun, name), []).append(r.source or "")
    lists = dict(given.values())
    out = []
    for (noun, name), where in rows.items():
        also = f" (also in {known(where[1:])})" if len(where) > 1 else ""
        out.append(Problem(f"unknown {noun} {name!r}; known: {known(lists[noun])}{also}", where[0]))
    return out


def _reading_sigmas(
    table: CsvTable,
    readings: Iterable[FaceReading],
    context: RecordContext,
    problems: list[Problem],
) -> dict[str, float | StandardDeviation]:
    """Return σ of a reading in one face, by argument of `reduce_faces`."""
    out: dict[str, float | StandardDeviation] = {}
    given = list(readings)
    for name, kind in READING_KINDS.items():
        # What nothing was read of needs no σ.
        out[f"sigma_{name}"] = 1.0
        if all(getattr(r, name) is None for r in given):
            continue
        stated = context.sigma.get(kind, {})
        if not any(f in stated for f in sigma_fields(kind)):
            what = f"no standard deviation of a reading in one face: state [sigma.{kind}]"
            problems.append(Problem(what, f"{table.name}: {name}"))
            continue
        row = FieldRow(stated, table.name, problems, name)
        found = scalar_sigma(row, kind, stated, f"[sigma.{kind}]")
        out[f"sigma_{name}"] = 1.0 if found is None else found
    return out
