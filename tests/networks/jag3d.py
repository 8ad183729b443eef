"""A small site in the tables of JAG3D, and what JAG3D computed of it.

The site is simulated. The results were computed with JAG3D (GitHub: applied-geodesy/jag3d, commit
119e251 of 2026-04-30) from a database with the same rows: its SQLAdjustmentManager read the rows,
its NetworkAdjustment adjusted them. HSQLDB 2.7.4 wrote the databases.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import factorgraph_adj as fga
from tests.hostile.examples import Example
from tests.networks.surveyed import surveyed

GON = math.pi / 200.0

COLUMNS: dict[str, dict[str, str]] = {
    "ObservationGroup": {
        "id": "INTEGER",
        "name": "VARCHAR(256)",
        "type": "SMALLINT",
        "enable": "BOOLEAN",
        "reference_epoch": "BOOLEAN",
        "order": "INTEGER",
    },
    "ObservationGroupUncertainty": {"group_id": "INTEGER", "type": "SMALLINT", "value": "DOUBLE"},
    "ObservationApriori": {
        "id": "INTEGER",
        "group_id": "INTEGER",
        "start_point_name": "VARCHAR(256)",
        "end_point_name": "VARCHAR(256)",
        "instrument_height": "DOUBLE",
        "reflector_height": "DOUBLE",
        "value_0": "DOUBLE",
        "sigma_0": "DOUBLE",
        "distance_0": "DOUBLE",
        "enable": "BOOLEAN",
    },
    "GNSSObservationApriori": {
        "id": "INTEGER",
        "group_id": "INTEGER",
        "start_point_name": "VARCHAR(256)",
        "end_point_name": "VARCHAR(256)",
        "y0": "DOUBLE",
        "x0": "DOUBLE",
        "z0": "DOUBLE",
        "sigma_y0": "DOUBLE",
        "sigma_x0": "DOUBLE",
        "sigma_z0": "DOUBLE",
        "enable": "BOOLEAN",
    },
    "AdditionalParameterApriori": {
        "id": "INTEGER",
        "group_id": "INTEGER",
        "type": "SMALLINT",
        "value_0": "DOUBLE",
        "enable": "BOOLEAN",
    },
    "PointGroup": {
        "id": "INTEGER",
        "name": "VARCHAR(256)",
        "type": "SMALLINT",
        "dimension": "TINYINT",
        "enable": "BOOLEAN",
        "order": "INTEGER",
    },
    "PointGroupUncertainty": {"group_id": "INTEGER", "type": "SMALLINT", "value": "DOUBLE"},
    "PointApriori": {
        "id": "INTEGER",
        "group_id": "INTEGER",
        "name": "VARCHAR(256)",
        "code": "VARCHAR(256)",
        "y0": "DOUBLE",
        "x0": "DOUBLE",
        "z0": "DOUBLE",
        "sigma_y0": "DOUBLE",
        "sigma_x0": "DOUBLE",
        "sigma_z0": "DOUBLE",
        "enable": "BOOLEAN",
    },
    "ReductionDefinition": {
        "id": "INTEGER",
        "projection_type": "SMALLINT",
        "reference_height": "DOUBLE",
        "reference_latitude": "DOUBLE",
        "major_axis": "DOUBLE",
        "minor_axis": "DOUBLE",
    },
    "ReductionTask": {"reduction_id": "INTEGER", "type": "SMALLINT"},
    "VerticalDeflectionGroup": {
        "id": "INTEGER",
        "name": "VARCHAR(256)",
        "type": "SMALLINT",
        "enable": "BOOLEAN",
        "order": "INTEGER",
    },
    "VerticalDeflectionGroupUncertainty": {
        "group_id": "INTEGER",
        "type": "SMALLINT",
        "value": "DOUBLE",
    },
    "VerticalDeflectionApriori": {
        "id": "INTEGER",
        "group_id": "INTEGER",
        "name": "VARCHAR(256)",
        "y0": "DOUBLE",
        "x0": "DOUBLE",
        "sigma_y0": "DOUBLE",
        "sigma_x0": "DOUBLE",
        "enable": "BOOLEAN",
    },
    "CongruenceAnalysisGroup": {
        "id": "INTEGER",
        "name": "VARCHAR(256)",
        "dimension": "TINYINT",
        "enable": "BOOLEAN",
        "order": "INTEGER",
    },
    "CongruenceAnalysisPointPairApriori": {
        "id": "INTEGER",
        "group_id": "INTEGER",
        "start_point_name": "VARCHAR(256)",
        "end_point_name": "VARCHAR(256)",
        "enable": "BOOLEAN",
    },
    "ProjectMetadata": {"id": "INTEGER", "name": "VARCHAR(256)", "date": "TIMESTAMP"},
}
"""Columns of the tables of JAG3D that are needed, and one that is not."""
SCHEMA = '"OpenAdjustment"'
Rows = dict[str, list[list[Any]]]

DIRECTIONS = {
    0: "P A 205.43606, P B 88.486, P C 365.94979, P Q 32.59632, P N1 318.00379",
    1: "Q A 126.48959, Q B 34.52083, Q C 228.87694, Q P 143.46966",
    2: "A B 144.56591, A P 99.85931, A Q 110.04, A N1 72.70004",
}
SLOPE = """P A 1.52 1.5 70.7442, P B 1.52 1.7 80.6147, P C 1.52 1.3 61.0436, P Q 1.52 1.6 43.5599,
A B 1.61 1.4 120.4342, A C 1.61 1.4 125.5281, A Q 1.61 1.4 111.5285"""
HORIZONTAL = "A N1 85.4404, B N1 114.0149, P N1 36.0571"
ZENITH = """P A 1.52 1.5 102.26769, P B 1.52 1.7 99.46269, P C 1.52 1.3 94.48739,
P Q 1.52 1.6 87.38258, Q A 1.48 1.4 106.33263, Q B 1.48 1.45 108.11503, Q P 1.48 1.6 112.33097"""
LEVELLING = "R M 1.20018 30, M P 1.79994 40, A M 0.70012 37, P Q 8.50014 0"
POINTS = {
    "A": (1000.0, 2000.0, 50.0),
    "B": (1120.0, 2010.0, 53.0),
    "C": (1059.9954, 2110.0027, 57.9996),
    "P": (1049.978, 2049.989, 52.511),
    "Q": (1090.007, 2065.009, 60.986),
    "N1": (1030.026, 2080.03, 0.037),
    "M": (1020.02, 2030.038, 50.742),
    "R": (1005.0, 2005.0, 49.5),
}


def _lines(text: str) -> list[list[str]]:
    return [line.split() for line in text.replace("\n", " ").split(",")]


def site() -> Rows:
    """Return the rows of a site with points and observations of every kind."""
    rows: Rows = {name: [] for name in COLUMNS}
    groups = (
        ("Reference", 1, 3, "AB"),
        ("Stochastic", 2, 3, "C"),
        ("New 3D", 4, 3, "PQ"),
        ("New 2D", 4, 2, ["N1"]),
        ("New 1D", 4, 1, "M"),
        ("Reference 1D", 1, 1, "R"),
    )
    for i, (name, kind, dimension, names) in enumerate(groups):
        rows["PointGroup"].append([i, name, kind, dimension, True, i])
        for point in names:
            sigma = (0.003, 0.003, 0.002) if kind == 2 else (0.0, 0.0, 0.0)
            number = len(rows["PointApriori"])
            rows["PointApriori"].append([number, i, point, "", *POINTS[point], *sigma, True])
    kinds = (
        ("Directions P", 2), ("Directions Q", 2), ("Directions A", 2), ("Slope", 4),
        ("Horizontal", 3), ("Zenith", 5), ("Levelling", 1), ("GNSS3D", 8), ("GNSS2D", 7),
        ("GNSS1D", 6), ("switched off", 3),
    )  # fmt: skip
    for i, (name, kind) in enumerate(kinds):
        rows["ObservationGroup"].append([i, name, kind, name != "switched off", True, i])
    parts = {
        0: (0.0003 * GON, 0.0, 0.0005),
        1: (0.0003 * GON, 0.0005 * GON, 0.0005),
        3: (0.001, 0.0, 1e-6),
        5: (0.0003 * GON, 0.0, 0.0008),
        6: (0.0001, 0.001, 0.0),
    }
    for group, three in parts.items():
        for kind, value in zip((10, 11, 12), three, strict=True):
            rows["ObservationGroupUncertainty"].append([group, kind, value])

    def add(group: int, a: str, b: str, value: float, ih: str = "0", th: str = "0",
            sigma: float = 0.0, distance: str = "0", enable: bool = True) -> None:  # fmt: skip
        number = len(rows["ObservationApriori"])
        numbers = (float(ih), float(th), value, sigma, float(distance))
        rows["ObservationApriori"].append([number, group, a, b, *numbers, enable])

    for group, text in DIRECTIONS.items():
        for a, b, v in _lines(text):
            add(group, a, b, float(v) * GON)
    for a, b, ih, th, v in _lines(SLOPE):
        add(3, a, b, float(v), ih, th)
    for a, b, v in _lines(HORIZONTAL):
        add(4, a, b, float(v), sigma=0.002)
    for a, b, ih, th, v in _lines(ZENITH):
        add(5, a, b, float(v) * GON, ih, th)
    for a, b, v, d in _lines(LEVELLING):
        add(6, a, b, float(v), distance=d)
    add(10, "A", "B", 7.0)
    add(4, "C", "N1", 7.0, enable=False)
    for number, (group, a, b, y, x, z, s) in enumerate(
        (
            (7, "A", "P", 50.006, 50.007, 2.505, (0.01, 0.01, 0.015)),
            (7, "B", "Q", -29.996, 55.007, 7.986, (0.01, 0.01, 0.015)),
            (8, "C", "N1", -30.003, -29.996, 0.0, (0.0, 0.0, 0.0)),
            (9, "M", "Q", 0.0, 0.0, 10.292, (0.0, 0.0, 0.0)),
        )
    ):
        rows["GNSSObservationApriori"].append([number, group, a, b, y, x, z, *s, True])
    for number, entry in enumerate(
        (
            [0, 1, 0.0, True], [1, 1, 0.0, True], [2, 1, 0.0, True], [3, 2, 1.00001, False],
            [3, 3, 0.0, True], [4, 2, 1.0, False], [4, 3, 0.0, False], [5, 4, 0.1, True],
            [6, 2, 1.0, False], [7, 2, 1.0, False], [7, 8, 0.0, False], [7, 9, 0.0, False],
            [7, 10, 0.0, False],
        )
    ):  # fmt: skip
        rows["AdditionalParameterApriori"].append([number, *entry])
    rows["ReductionDefinition"].append([1, 0, 0.0, 0.0, 6371007.0, 6371007.0])
    rows["ProjectMetadata"].append([1, "site", None])
    return rows


def column(rows: Rows, table: str, name: str, value: Any, where: Mapping[str, Any]) -> None:
    """Change a column of the rows of a table in which other columns have given values."""
    names = list(COLUMNS[table])
    for row in rows[table]:
        if all(row[names.index(n)] == v for n, v in where.items()):
            row[names.index(name)] = value


def reduced_site() -> Rows:
    """Return the rows of a free network with reductions for height and curvature of the Earth."""
    rows = site()
    for group in (0, 1):
        column(rows, "PointGroup", "type", 3, {"id": group})
    for group in (3, 4, 5):
        column(rows, "PointGroup", "enable", False, {"id": group})
    for group in (6, 7, 9):
        column(rows, "ObservationGroup", "enable", False, {"id": group})
    column(rows, "AdditionalParameterApriori", "value_0", 0.13, {"type": 4})
    column(rows, "AdditionalParameterApriori", "enable", False, {"type": 4})
    rows["ReductionDefinition"] = [[1, 0, 500.0, 0.9, 6378137.0, 6356752.3]]
    rows["ReductionTask"] = [[1, 4], [1, 2]]
    for a, b, value in (("A", "B", 120.423), ("C", "Q", 54.096)):
        number = len(rows["ObservationApriori"])
        row = [number, 4, a, b, 0.0, 0.0, value, 0.002, 0.0, True]
        rows["ObservationApriori"].append(row)
    return rows


def deflected_site() -> Rows:
    """Return the rows of a network with known points, and verticals that deviate from z."""
    rows = reduced_site()
    for group in (0, 1):
        column(rows, "PointGroup", "type", 1, {"id": group})
    rows["VerticalDeflectionGroup"] = [[0, "held", 1, True, 0], [1, "weighted", 2, True, 1]]
    rows["VerticalDeflectionApriori"] = [
        [0, 0, "P", 0.02 * GON, -0.03 * GON, 0.0, 0.0, True],
        [1, 1, "Q", 0.01 * GON, 0.005 * GON, 0.005 * GON, 0.004 * GON, True],
    ]
    return rows


def turned_site() -> Rows:
    """Return the site with GNSS vectors of unknown scale and rotation: 2, −3, 5·10⁻⁴, 200 ppm."""
    rows = site()
    for number in range(len(rows["AdditionalParameterApriori"])):
        column(rows, "AdditionalParameterApriori", "enable", True, {"id": number, "group_id": 7})
    rows["GNSSObservationApriori"] = [r for r in rows["GNSSObservationApriori"] if r[1] != 7]
    for a, b, y, x, z in (
        ("A", "P", 49.986, 50.0341, 2.4722), ("B", "Q", -30.0296, 54.9997, 7.9902),
        ("A", "B", 120.0201, 10.0638, 2.9728), ("B", "C", -60.0651, 99.9898, 4.9858),
        ("C", "P", -9.968, -60.0187, -5.4794), ("Q", "C", -30.0304, 44.9936, -3.0053),
        ("P", "Q", 40.0053, 15.0245, 8.4884), ("C", "A", -59.9616, -110.054, -7.9519),
    ):  # fmt: skip
        number = 10 + len(rows["GNSSObservationApriori"])
        row = [number, 7, a, b, y, x, z, 0.002, 0.002, 0.002, True]
        rows["GNSSObservationApriori"].append(row)
    return rows


def two_epochs() -> Rows:
    """Return the rows of a free network of two epochs: P moved by 5 mm, Q by 0.3 mm in y."""
    rng = np.random.default_rng(5)
    places = {
        "A": (1000, 2000, 50),
        "B": (1120, 2010, 53),
        "C": (1060, 2110, 58),
        "D": (1010, 2090, 52),
        "P1": (1050, 2050, 52.5),
        "Q1": (1090, 2065, 61),
        "P2": (1050.004, 2049.997, 52.502),
        "Q2": (1090.0003, 2065, 61),
    }
    rows: Rows = {name: [] for name in COLUMNS}
    rows["PointGroup"] = [[0, "Datum", 3, 3, True, 0], [1, "New", 4, 3, True, 0]]
    for number, (name, xyz) in enumerate(places.items()):
        group = 0 if name in "ABCD" else 1
        place = tuple(map(float, xyz))
        rows["PointApriori"].append([number, group, name, "", *place, 0.0, 0.0, 0.0, True])
    for group, (epoch, kind) in enumerate((e, k) for e in "12" for k in (4, 5)):
        rows["ObservationGroup"].append([group, f"{kind} of {epoch}", kind, True, epoch == "1", 0])
        sigma = 0.001 if kind == 4 else 0.0005 * GON
        for part, value in ((10, sigma), (11, 0.0), (12, 0.0)):
            rows["ObservationGroupUncertainty"].append([group, part, value])
        names = ["A", "B", "C", "D", "P" + epoch, "Q" + epoch]
        for a, b in ((a, b) for a in names for b in names if a != b):
            d = np.subtract(places[b], places[a])
            s = float(np.linalg.norm(d))
            noise = float(rng.normal())
            value = round(s + noise * 0.001, 4)
            if kind == 5:
                value = round(math.acos(d[2] / s) / GON + noise * 0.0005, 5) * GON
            number = len(rows["ObservationApriori"])
            row = [number, group, a, b, 0.0, 0.0, value, 0.0, 0.0, True]
            rows["ObservationApriori"].append(row)
    rows["CongruenceAnalysisGroup"] = [[0, "moved", 3, True, 0], [1, "switched off", 3, False, 1]]
    rows["CongruenceAnalysisPointPairApriori"] = [
        [0, 0, "P1", "P2", True], [1, 0, "Q1", "Q2", True],
        [2, 0, "A", "B", False], [3, 1, "A", "C", True],
    ]  # fmt: skip
    return rows


# -- flat files ----------------------------------------------------------------------------------

FLAT = {
    "Festpunkte 3D.txt": "# name y x z\n\nA 1000 2000 50\nB;1120,0;2010;53\n",
    "stochastic_points_3d.txt": "C 1059.9954 2110.0027 57.9996 0.003 0.002\n",
    "new_points_3d.txt": "P 1049.978 2049.989 52.511\nQ\t1090.007\t2065.009\t60.986\n",
    "neupunkte_2d.txt": "N1 1030.026 2080.03\n",
    "neupunkte-1D.txt": "M 1020.02 2030.038 50.742\n",
    "reference_points_1d.txt": "R 1005 2005 49.5\n",
    "Richtungen.txt": "P A 205.43606\nP B 88.486\nP C 365.94979\nP N1 318.00379 0.0004\n"
    "A B 144.56591\nA P 99.85931\nP Q 12.1\nP A 184.9397\n",
    "Schrägstrecken.txt": "P A 1.52 1.5 70.7319 0.001\nP B 1.52 1.7 80.6024\n"
    "P C 61.06 0.001\nP Q 43.55\n",
    "horizontal_distances.txt": "A N1 85.4404 0.002\nP N1 36.0571\nB N1 114.0149 5.0\n",
    "zenith.txt": "P A 1.52 1.5 102.26769\nP Q 1.52 1.6 87.38258 0.0004\nQ P 290\n",
    "nivellement.txt": "R M 1.20018 30\nM P 1.79994 0.0002\nA M 0.70012 37\nP Q 8.50014\n",
    "gnss3d.txt": "A P 50.006 50.007 2.505 0.01 0.015\nB Q -29.996 55.007 7.986\n",
    "gnss_2d.txt": "C N1 -30.003 -29.996 0.01\n",
    "gnss-1d.txt": "M Q 10.292\nM P 0 0 1.8 0.02\n",
}  # fmt: skip
"""Flat files of every kind, by name."""


# -- databases ------------------------------------------------------------------------------------


def _sql(value: Any) -> str:
    if value is None:
        return "NULL"
    if isinstance(value, bool):
        return str(value).upper()
    if isinstance(value, str):
        text = "".join(c if ord(c) < 128 else f"\\u{ord(c):04x}" for c in value.replace("'", "''"))
        return f"'{text}'"
    if isinstance(value, float):
        text = repr(value).upper()
        return text if "E" in text else f"{text}E0"
    return repr(value)


def _create(name: str, kind: str) -> str:
    columns = ",".join(f'"{c}" {t} NOT NULL' for c, t in COLUMNS[name].items())
    key = "" if "id" in COLUMNS[name] else ',PRIMARY KEY("group_id","type")'
    return f'CREATE {kind} TABLE {SCHEMA}."{name}"({columns}{key})'


def script(rows: Rows) -> str:
    """Return the script of a database whose tables are in memory, as SCRIPT writes it."""
    lines = ["SET DATABASE UNIQUE NAME HSQLDBA20D87EE12", "SET FILES SCALE 32"]
    lines += [f"CREATE SCHEMA {SCHEMA} AUTHORIZATION SA"]
    lines += [_create(name, "MEMORY") for name in rows]
    lines += [f'CREATE INDEX "IndexOf" ON {SCHEMA}."PointApriori"("name")', f"SET SCHEMA {SCHEMA}"]
    for name, table in rows.items():
        lines += [f'INSERT INTO "{name}" VALUES({",".join(map(_sql, row))})' for row in table]
    return "\n".join([*lines, ""])


def _bytes(kind: str, value: Any) -> bytes:
    if value is None:
        return b"\0"
    form = {"INTEGER": ">i", "SMALLINT": ">h", "TINYINT": ">h", "DOUBLE": ">d", "BOOLEAN": ">b"}
    if kind.startswith("VARCHAR"):
        text = value.encode()
        return b"\1" + struct.pack(">i", len(text)) + text
    return b"\1" + struct.pack(form[kind], value)


def database(rows: Rows, *, indexes: int = 2) -> tuple[str, bytes]:
    """Return script and cached tables of a database, in the layout of HSQLDB's files.

    Rows of a table are a tree in which each is the parent of those on both sides of it.
    """
    scale = 32
    data = bytearray(scale)
    lines = [f"SET FILES SCALE {scale}", f"CREATE SCHEMA {SCHEMA} AUTHORIZATION SA"]
    lines += [_create(name, "CACHED") for name in rows]
    for name, table in rows.items():
        places: list[int] = []
        contents = []
        at = len(data) // scale
        for row in table:
            values = b"".join(
                _bytes(t, v) for t, v in zip(COLUMNS[name].values(), row, strict=True)
            )
            size = -(-(4 + 16 * indexes + len(values)) // scale) * scale
            contents.append((size, values))
            places.append(at)
            at += size // scale
        children = {}

        def root(
            low: int, high: int, children: dict[int, tuple[int, int]] = children,
            places: Sequence[int] = places,
        ) -> int:  # fmt: skip
            if low >= high:
                return 0
            middle = (low + high) // 2
            children[middle] = (root(low, middle), root(middle + 1, high))
            return places[middle]

        top = root(0, len(table))
        for i, (size, values) in enumerate(contents):
            node = struct.pack(">4i", 0, *children[i], 0)
            content = struct.pack(">i", size) + node * indexes + values
            data += content.ljust(size, b"\0")
        if table:
            numbers = [top] * indexes + [0] * (indexes if indexes > 1 else 1) + [len(table)]
            lines.append(f"SET TABLE {SCHEMA}.\"{name}\" INDEX '{' '.join(map(str, numbers))}'")
    data[12:20] = struct.pack(">q", len(data))
    return "\n".join([*lines, ""]), bytes(data)


def files(rows: Rows) -> dict[str, bytes]:
    """Return the files of a database with cached tables."""
    text, data = database(rows)
    return {"site.script": text.encode(), "site.data": data}


# -- results of JAG3D -----------------------------------------------------------------------------

SITE_POINTS = {
    "C": ((1060.0003848, 2110.0002608, 58.0001185), (0.7381, 0.7460, 0.6777)),
    "P": ((1050.0002801, 2050.0004318, 52.5000421), (0.4511, 0.3251, 0.2141)),
    "Q": ((1090.0001044, 2065.0001656, 61.0000852), (0.5456, 0.4059, 0.2743)),
    "N1": ((1030.0011730, 2080.0004030, 0.0), (0.5623, 0.7799, 0.0)),
    "M": ((1020.02, 2030.038, 50.7001374), (0.0, 0.0, 0.1209)),
}
"""Adjusted y, x, z, metres, and their σ (with σ̂0), mm. JAG3D writes 0 for z of N1."""
SITE_PARAMETERS = {
    "orientation P": (0.7000104562, 5.4614e-6),
    "orientation Q": (2.1000039679, 6.0901e-6),
    "orientation A": (5.4999976599, 4.1954e-6),
    "zero": (0.0118271372, 0.00042201),
    "refraction": (0.5202231058, 0.71782),
}
"""Additional parameters and their σ (with σ̂0): radians, metres."""
SITE_OMEGA, SITE_REDUNDANCY = 20.062203, 29
"""vᵀPv and redundancy."""
SITE_OBSERVATIONS = (
    ("direction", "P", "A", 8.499390, 0.32494, 61.6119, 0.4471, -3.2397),
    ("direction", "P", "N1", 14.643561, 0.09207, -199.4223, 0.0157, 0.5575),
    ("direction", "Q", "A", 6.560653, 0.37789, -44.1003, 1.8461, 5.4797),
    ("direction", "Q", "P", 12.665574, 0.59841, -67.6550, 0.0694, 2.5812),
    ("direction", "A", "B", 6.280763, 0.35502, -43.5574, 3.2419, 6.7381),
    ("slope_distance", "P", "B", 1003.246056, 0.56289, 5525.5082, 6.4900, -1917.5276),
    ("slope_distance", "A", "C", 1007.849552, 0.59963, -5378.1283, 1.0524, 800.6270),
    ("horizontal_distance", "B", "N1", 2000.0, 0.86045, -8909.2707, 1.1207, 1963.9796),
    ("zenith_angle", "P", "C", 13.921201, 0.15137, -147.8526, 0.1798, 2.2970),
    ("zenith_angle", "Q", "P", 18.959223, 0.91604, -81.8539, 0.1668, 7.4119),
    ("height_difference", "R", "M", 200.0, 0.47190, 1203.0404, 0.0960, -42.5639),
    ("height_difference", "P", "Q", 229.682815, 0.17396, 2275.4990, 1.0232, -96.9007),
)
"""Kind, station, target; σ, µm or µrad; r; ∇(λ) with JAG3D's sign; T prio = w²; v, µm or µrad.

σ is that at the approximate coordinates. α = 0.1 %, power 80 %."""
REDUCED_POINTS = {
    "A": ((999.9994195, 1999.9991142, 49.9998269), (0.9253, 0.7487, 0.8511)),
    "B": ((1119.9989551, 2010.0019199, 52.9999246), (1.0273, 0.8462, 0.8435)),
    "C": ((1059.9970254, 2110.0016659, 57.9998485), (0.4961, 1.3538, 1.0071)),
    "P": ((1049.9984238, 2050.0006323, 52.4992607), (0.6438, 0.6482, 0.6743)),
    "Q": ((1089.9983105, 2065.0011024, 60.9989057), (0.8363, 0.8125, 0.8218)),
}
REDUCED_OMEGA, REDUCED_REDUNDANCY = 27.937578, 12
DEFLECTED_POINTS = {
    "P": ((1049.9992528, 2050.0011074, 52.4983698), (5.4669, 5.6569, 7.3071)),
    "Q": ((1089.9978028, 2064.9993893, 61.0137354), (6.1349, 6.6788, 12.4662)),
}
DEFLECTED_OMEGA, DEFLECTED_REDUNDANCY = 3744.0546, 17
DEFLECTION_Q = (2.479070521768269e-4, 6.283142766056085 - 2.0 * math.pi)
"""Adjusted rotations r_y, r_x at Q, radians."""
EPOCHS_OMEGA, EPOCHS_REDUNDANCY = 76.75472104, 100
EPOCHS_PAIRS = {
    "P1": ((4.8369109, -2.8983972, 1.9342741), (0.57200765, 0.57582172, 0.19768337),
           48.22571886, 62.83094799),
    "Q1": ((0.5171402, -0.5546939, -0.3216263), (0.54273557, 0.62998036, 0.20690555),
           1.20963450, 1.57597407),
}  # fmt: skip
"""Δy, Δx, Δz and their σ (with σ̂0), mm; T prio; T post, of pairs of points."""
TURNED_OMEGA, TURNED_REDUNDANCY = 42.917603, 43
TURNED_FRAME = {
    "rx": (2.2913198635565708e-4, 1.2091e-5),
    "ry": (6.2828714579945615 - 2.0 * math.pi, 1.30708e-5),
    "rz": (5.052760143631758e-4, 9.0715e-6),
    "m": (1.0002045548111367, 9.0160e-6),
}
"""Rotations and scale of the GNSS vectors, and their σ (with σ̂0)."""


def _written(folder: Path) -> dict[str, bytes]:
    """Return the flat files that the writer makes of a survey."""
    fga.write_jag3d(surveyed(), folder / "flat")
    return {f.name: f.read_bytes() for f in sorted((folder / "flat").iterdir())}


UNREAD = (
    r"\|#",
    r"\|(SET|CREATE|ALTER) ",  # statements without rows; words of columns
    r"ProjectMetadata|ReductionDefinition",  # what no task reduces
)
EXAMPLE_FILES = {
    "jag3d flat files": Example("jag3d", _written, unread=UNREAD),
    "jag3d": Example(
        "jag3d", lambda _: {"site.script": script(site())}, "site.script", unread=UNREAD
    ),
    "jag3d database": Example("jag3d", lambda _: files(site()), "site.script", unread=UNREAD),
    "jag3d flat": Example("jag3d", FLAT, unread=UNREAD),
}
