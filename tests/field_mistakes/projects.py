"""The projects without a mistake: a yard with two set-ups, a levelled loop, GNSS vectors, photos.

Readings are computed from true coordinates with small errors from a seed, and written as tables,
so that a mistake is a change of a few cells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from factorgraph_adj.frames import TopocentricFrame
from tests.hostile.examples import Example

Row = dict[str, str]
"""One row of a table: cells by column."""
GON = np.pi / 200.0
STATIONS = {"S1": (1.583, 0.0), "S2": (1.612, 0.0), "S3": (1.547, 0.0)}
"""Heights of the instruments, metres."""
TARGET_HEIGHT = 1.300
POINTS = {
    "A": (0.0, 0.0, 100.0),
    "B": (82.0, 4.0, 101.2),
    "C": (77.0, 71.0, 103.5),
    "D": (-6.0, 66.0, 102.1),
    "E": (35.0, 95.0, 104.4),
    "S1": (20.0, 22.0, 100.7),
    "S2": (61.0, 28.0, 101.4),
    "S3": (38.0, 57.0, 102.6),
}
"""True coordinates, metres."""
HELD = ("A", "B", "C", "D")
LEVELLED = ("A", "S1", "S2", "B", "C", "S3", "D", "A")
"""A levelled loop."""
VECTORS = (("A", "S1"), ("A", "S2"), ("A", "S3"), ("A", "E"), ("C", "E"), ("C", "S3"), ("B", "S2"))
SIGMAS = """
[sigma.direction]
sigma_mgon = 1
[sigma.zenith_angle]
sigma_mgon = 1
[sigma.slope_distance]
sigma_mm = 2
[sigma.height_difference]
sigma_mm = 1
[sigma.gnss_vector]
sigma_x_mm = 4
sigma_y_mm = 4
sigma_z_mm = 8
"""


@dataclass
class Project:
    """The tables of a project."""

    toml: str
    """project.toml."""
    tables: dict[str, list[Row]] = field(default_factory=dict)
    """Rows of each table, by the name of its file."""

    def write(self, folder: Path) -> Path:
        """Write the files."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "project.toml").write_text(self.toml, encoding="utf-8")
        for name, rows in self.tables.items():
            columns = list(dict.fromkeys(c for row in rows for c in row))
            lines = [",".join(columns)]
            lines += [",".join(row.get(c, "") for c in columns) for row in rows]
            (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
        return folder

    def rows(self, kind: str, **wanted: str) -> list[Row]:
        """Return the observations of a kind with some cells."""
        return [
            row
            for row in self.tables["observations.csv"]
            if row["kind"] == kind and all(row.get(k) == v for k, v in wanted.items())
        ]

    def point(self, name: str) -> Row:
        """Return the row of a point."""
        return next(row for row in self.tables["points.csv"] if row["name"] == name)


def yard(
    seed: int = 5,
    *,
    beside: dict[str, tuple[float, float]] | None = None,
    heights: dict[str, float] | None = None,
    noise: float = 1.0,
) -> Project:
    """Return the yard: total station at S1, S2, S3, levelling, GNSS vectors.

    Args:
        seed: of the errors of the readings.
        beside: by how much instruments stand east and north of their marks, metres.
        noise: size of the errors of the total station, in their standard deviations.
        heights: heights of targets by name, metres; the others have `TARGET_HEIGHT`.
    """
    rng = np.random.default_rng(seed)
    points: list[Row] = []
    for name, at in POINTS.items():
        x, y, z = np.array(at) + (0.0 if name in HELD else 0.02) * rng.normal(size=3)
        fixed = "xyz" if name in HELD else ""
        points.append(
            {"name": name, "x": f"{x:.3f}", "y": f"{y:.3f}", "z": f"{z:.3f}", "fixed": fixed}
        )
    rows: list[Row] = []
    for station, (height, _) in STATIONS.items():
        orientation = rng.uniform(0.0, 2 * np.pi)
        for target in POINTS:
            if target == station:
                continue
            d = np.array(POINTS[target]) - np.array(POINTS[station])
            d[:2] -= (beside or {}).get(station, (0.0, 0.0))
            above = (heights or {}).get(target, TARGET_HEIGHT)
            d[2] += above - height
            length = float(np.linalg.norm(d))
            errors = noise * rng.normal(size=3)
            direction = (np.arctan2(d[0], d[1]) - orientation) / GON + 1e-3 * errors[0]
            zenith = np.arccos(d[2] / length) / GON + 1e-3 * errors[1]
            common = {
                "station": station,
                "target": target,
                "instrument_height": f"{height:.3f}",
                "target_height": f"{above:.3f}",
            }
            for kind, value in (
                ("direction", f"{direction % 400:.4f}"),
                ("zenith_angle", f"{zenith:.4f}"),
                ("slope_distance", f"{length + 2e-3 * errors[2]:.4f}"),
            ):
                rows.append({"kind": kind, **common, "value": value})
    for a, b in pairwise(LEVELLED):
        rise = POINTS[b][2] - POINTS[a][2] + 1e-3 * float(rng.normal())
        rows.append(
            {"kind": "height_difference", "station": a, "target": b, "value": f"{rise:.4f}"}
        )
    for a, b in VECTORS:
        d = np.array(POINTS[b]) - np.array(POINTS[a]) + rng.normal(0.0, [0.004, 0.004, 0.008])
        x, y, z = (f"{v:.4f}" for v in d)
        rows.append({"kind": "gnss_vector", "station": a, "target": b, "x": x, "y": y, "z": z})
    toml = 'name = "yard"\n[units]\nangle = "gon"\n' + SIGMAS
    return Project(toml, {"points.csv": points, "observations.csv": rows})


INDEX, COLLIMATION = 0.0021, -0.0034
"""Errors of the instrument of the field book, gon."""


def field_book(seed: int = 8, *, faces: str = "means") -> Project:
    """Return the yard with the readings of the total station in two faces.

    Args:
        seed: of the differences between the faces.
        faces: what the project makes of them: means, or both.
    """
    rng = np.random.default_rng(seed)
    out = yard(noise=0.0)
    read: dict[tuple[str, str], Row] = {}
    rest: list[Row] = []
    for row in out.tables["observations.csv"]:
        if "instrument_height" in row:
            sight = read.setdefault((row["station"], row["target"]), dict(row))
            sight[row["kind"]] = row["value"]
        else:
            rest.append(row)
    book: list[Row] = []
    for row in read.values():
        d, z = float(row["direction"]), float(row["zenith_angle"])
        c = COLLIMATION / np.sin(z * GON)
        names = ("station", "target", "instrument_height", "target_height")
        for face, circle, zenith in (
            (1, d - c, z + INDEX),
            (2, d + c + 200.0, 400.0 - z + INDEX),
        ):
            circle, zenith = np.array([circle, zenith]) + 1e-3 * rng.normal(size=2)
            book.append(
                {
                    **{n: row[n] for n in names},
                    "face": str(face),
                    "direction": f"{circle % 400:.4f}",
                    "zenith": f"{zenith:.4f}",
                    "distance": f"{float(row['slope_distance']) + 2e-3 * rng.normal():.4f}",
                }
            )
    out.toml += f'[readings]\nfaces = "{faces}"\n'
    out.tables |= {"observations.csv": rest, "readings.csv": book}
    return out


def book_of_both() -> Project:
    """Return the field book with both faces as observations."""
    return field_book(faces="both")


LATITUDE, LONGITUDE, HEIGHT = 48.0, 11.0, 500.0
"""Where the yard lies on the Earth: degrees, metres."""


def yard_on_earth(*, geographic: bool = True) -> Project:
    """Return the yard in a topocentric frame.

    Args:
        geographic: whether its points are given by latitude, longitude and height.
    """
    out = yard()
    out.toml += f'[frame]\nkind = "topocentric"\nlatitude = {LATITUDE}\n'
    out.toml += f"longitude = {LONGITUDE}\nheight = {HEIGHT}\n"
    frame = TopocentricFrame(np.deg2rad(LATITUDE), np.deg2rad(LONGITUDE), HEIGHT)
    for row in out.tables["points.csv"] if geographic else ():
        found = frame.geodetic(np.array([[float(row.pop(axis)) for axis in "xyz"]]))
        assert found is not None
        latitude, longitude, height = (float(x[0]) for x in found)
        row["latitude"] = f"{np.rad2deg(latitude):.9f}"
        row["longitude"] = f"{np.rad2deg(longitude):.9f}"
        row["height"] = f"{height:.4f}"
    return out


FACADE = [(x, 0.3 * np.sin(3.0 * x + z), z) for x in (0.0, 3.0, 6.0, 9.0) for z in (0.0, 2.5, 5.0)]
"""True coordinates of targets on a wall, metres."""
CENTRES = ((-1.0, -12.0, 2.0), (4.5, -13.0, 3.0), (10.0, -12.0, 2.5))
FOCAL = 50.0
"""Principal distance, millimetres."""


def facade(seed: int = 6) -> Project:
    """Return a wall in three photos, whose orientations are roughly given."""
    rng = np.random.default_rng(seed)
    points: list[Row] = []
    for i, at in enumerate(FACADE):
        held = i in (0, 2, 9, 11)
        x, y, z = np.array(at) + (0.0 if held else 0.01) * rng.normal(size=3)
        cells = {"x": f"{x:.4f}", "y": f"{y:.4f}", "z": f"{z:.4f}"}
        points.append({"name": f"P{i}", **cells, "fixed": "xyz" if held else ""})
    photos: list[Row] = []
    images: list[Row] = []
    for number, centre in enumerate(CENTRES, start=1):
        ahead = np.array((4.5, 0.0, 2.5)) - centre
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        rotation = np.column_stack([right, np.cross(ahead, right), ahead])
        row = {"name": str(number), "camera": "cam"}
        row |= {a: f"{v:.3f}" for a, v in zip("xyz", centre, strict=True)}
        row |= {f"r{i + 1}{j + 1}": f"{rotation[i, j]:.9f}" for i in range(3) for j in range(3)}
        photos.append(row)
        for i, at in enumerate(FACADE):
            q = rotation.T @ (np.array(at) - centre)
            x, y = FOCAL * q[:2] / q[2] * (1.0, -1.0) + 0.003 * rng.normal(size=2)
            cells = {"x": f"{x:.4f}", "y": f"{y:.4f}"}
            images.append({"photo": str(number), "point": f"P{i}", **cells})
    toml = (
        'name = "facade"\n[[camera]]\nname = "cam"\nlens = "none"\nunit = "mm"\nsigma_um = 3\n'
        f"[camera.parameters]\nc = {FOCAL}\n"
    )
    tables = {"points.csv": points, "photos.csv": photos, "images.csv": images}
    return Project(toml, tables)


HALL = [
    (float(x), float(y), z)
    for i, (x, y) in enumerate(((0, 0), (12, 0), (24, 0), (24, 15), (12, 15), (0, 15)))
    for z in (1.0 + 0.3 * i, 6.5 - 0.4 * i)
]
"""True coordinates of targets on the walls of a hall, metres."""
SCANS: dict[str, tuple[tuple[float, float, float], float]] = {
    "scan1": ((6.0, 7.0, 1.6), 0.4),
    "scan2": ((18.0, 8.0, 1.7), 2.1),
    "scan3": ((11.0, 5.0, 4.0), 4.4),
}
"""Where the scanner stands, and how it is turned, radians."""


def hall(seed: int = 9, *, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Project:
    """Return a hall that a scanner saw from three stations in frames of their own.

    Args:
        seed: of the errors of the coordinates.
        shift: added to the coordinates of the network, metres.
    """
    rng = np.random.default_rng(seed)
    points: list[Row] = []
    for i, at in enumerate(HALL):
        held = i in (0, 3, 6, 9)
        cells = {a: f"{v + d:.4f}" for a, v, d in zip("xyz", at, shift, strict=True)}
        points.append({"name": f"H{i}", **(cells if held else {}), "fixed": "xyz" if held else ""})
    frames: list[Row] = []
    rows: list[Row] = []
    for name, (station, turn) in SCANS.items():
        middle = zip("xyz", np.array((12.0, 7.0, 4.0)) + shift, strict=True)
        frames.append({"name": name, "free": "rotation offset"})
        frames[-1] |= {f"origin_{a}": f"{v:.0f}" for a, v in middle}
        c, s = np.cos(turn), np.sin(turn)
        to_scan = np.array([[c, s, 0.0], [-s, c, 0.02], [0.02 * s, -0.02 * c, 1.0]])
        to_scan = np.linalg.qr(to_scan.T)[0].T
        to_scan *= np.sign(np.diag(to_scan @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])))[:, None]
        for i, at in enumerate(HALL):
            q = to_scan @ (np.array(at) - station) + 0.002 * rng.normal(size=3)
            cells = {a: f"{v:.4f}" for a, v in zip("xyz", q, strict=True)}
            rows.append({"kind": "frame_coordinate", "frame": name, "point": f"H{i}", **cells})
    toml = 'name = "hall"\n[sigma.frame_coordinate]\nsigma_mm = 2\n'
    tables = {"points.csv": points, "frames.csv": frames, "observations.csv": rows}
    return Project(toml, tables)


def _files(folder: Path, make: Callable[[], Any]) -> dict[str, bytes]:
    at = make().write(folder / "project")
    return {f.name: f.read_bytes() for f in sorted(at.iterdir()) if f.is_file()}


EXAMPLE_FILES = {
    name: Example("project", partial(_files, make=make), unread=(r"\|\|",))
    for name, make in (("project", yard), ("project with photos", facade))
}
