"""The mistakes: what is done wrong, the command, the exit code, and the line that must appear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .projects import (
    LATITUDE,
    LONGITUDE,
    Project,
    Row,
    book_of_both,
    facade,
    field_book,
    hall,
    yard,
    yard_on_earth,
)

FINE, DOUBTFUL, BAD_INPUT = 0, 1, 2
CHECK, ADJUST, SNOOP = ("check",), ("adjust", "--full"), ("adjust", "--full", "--snoop")


@dataclass(frozen=True)
class Mistake:
    """A mistake in a project."""

    name: str
    """What was done."""
    make: Callable[[], Project]
    """Returns the project with it."""
    command: tuple[str, ...]
    """The command that is to find it, without the project."""
    code: int
    """Its exit code."""
    line: str
    """What must appear in its output, line ends taken as blanks."""


MISTAKES: list[Mistake] = []


def mistake(
    name: str,
    command: tuple[str, ...],
    code: int,
    line: str,
    project: Callable[[], Project] = yard,
) -> Callable[[Callable[[Project], None]], Callable[[Project], None]]:
    """Register a function that spoils a project."""

    def noted(spoil: Callable[[Project], None]) -> Callable[[Project], None]:
        def make() -> Project:
            out = project()
            spoil(out)
            return out

        MISTAKES.append(Mistake(name, make, command, code, line))
        return spoil

    return noted


def add(row: Row, column: str, by: float, digits: int = 4) -> None:
    """Add a number to a cell."""
    row[column] = f"{float(row[column] or 0.0) + by:.{digits}f}"


def times(row: Row, column: str, by: float, digits: int = 4) -> None:
    """Multiply a cell by a number."""
    row[column] = f"{float(row[column]) * by:.{digits}f}"


def make_geocentric(p: Project) -> None:
    """Turn the GNSS vectors of the yard from east, north, up into geocentric axes."""
    lat, lon = np.deg2rad((LATITUDE, LONGITUDE))
    e = np.array([-np.sin(lon), np.cos(lon), 0.0])
    n = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    u = np.cross(e, n)
    for row in p.rows("gnss_vector"):
        x, y, z = (float(row[a]) for a in "xyz")
        for axis, value in zip("xyz", x * e + y * n + z * u, strict=True):
            row[axis] = f"{value:.4f}"


POLES = {"B": 1.3, "E": 1.75}
"""Heights of targets that differ, metres."""


def exchange_axes(p: Project, photo: str) -> None:
    """Exchange x and y of a photo."""
    for row in p.tables["images.csv"]:
        if row["photo"] == photo:
            row["x"], row["y"] = row["y"], row["x"]


# -- in the field ---------------------------------------------------------------------------------


@mistake(
    "height of the instrument 0.1 m too large",
    ADJUST,
    DOUBTFUL,
    "most probable cause: the height of the instrument at 'S2' (1.712 m): 10",
)
def _(p: Project) -> None:
    for row in p.tables["observations.csv"]:
        if row["station"] == "S2" and "instrument_height" in row:
            add(row, "instrument_height", 0.1, 3)


@mistake(
    "height of a target wrong at one station",
    ADJUST,
    DOUBTFUL,
    "the height of the target at 'E' (1.500 m) seen from 'S1'".replace("1.500", "1.5"),
)
def _(p: Project) -> None:
    for row in p.tables["observations.csv"]:
        if (row["station"], row["target"]) == ("S1", "E") and "target_height" in row:
            add(row, "target_height", 0.2, 3)


@mistake(
    "one height of the instrument differs within a set-up",
    CHECK,
    DOUBTFUL,
    "readings at station 'S1' have another height of the instrument than the usual 1.583 m",
)
def _(p: Project) -> None:
    p.rows("zenith_angle", station="S1")[2]["instrument_height"] = "1.853"


@mistake(
    "the height of the instrument is missing in some rows",
    CHECK,
    DOUBTFUL,
    "have no height of the instrument, the others 1.547 m",
)
def _(p: Project) -> None:
    for row in p.rows("slope_distance", station="S3")[:3]:
        row["instrument_height"] = ""


def exchange_targets(p: Project, station: str, a: str, b: str) -> None:
    """Exchange two targets of a station."""
    other = {a: b, b: a}
    for row in p.tables["observations.csv"]:
        if row["station"] == station and "instrument_height" in row:
            row["target"] = other.get(row["target"], row["target"])


@mistake(
    "two targets exchanged",
    SNOOP,
    DOUBTFUL,
    "1. two targets, exchanged: 'A' and 'E' seen from 'S1'",
)
def _(p: Project) -> None:
    exchange_targets(p, "S1", "A", "E")


@mistake(
    "two targets exchanged, adjusted without data snooping",
    ADJUST,
    DOUBTFUL,
    "readings fit without a mistake: two targets, exchanged: 'A' and 'D' seen from 'S1'",
)
def _(p: Project) -> None:
    exchange_targets(p, "S1", "A", "D")


@mistake(
    "two targets exchanged, with which the adjustment has no minimum",
    ADJUST,
    DOUBTFUL,
    "readings fit without a mistake: two targets, exchanged: 'A' and 'E' seen from 'S1'",
)
def _(p: Project) -> None:
    exchange_targets(p, "S1", "A", "E")


@mistake(
    "two targets exchanged, whose heights were looked up by name",
    SNOOP,
    DOUBTFUL,
    "1. two targets, exchanged: 'B' and 'E' seen from 'S1', with the height that goes with",
    lambda: yard(heights=POLES),
)
def _(p: Project) -> None:
    other = {"B": "E", "E": "B"}
    for row in p.tables["observations.csv"]:
        if row["station"] == "S1" and row["target"] in other and "target_height" in row:
            row["target"] = other[row["target"]]
            row["target_height"] = f"{POLES[row['target']]:.3f}"


@mistake(
    "a point confused with another of the list",
    SNOOP,
    DOUBTFUL,
    "1. the name of the target 'B' seen from 'S3', which is 'E'",
)
def _(p: Project) -> None:
    for row in p.tables["observations.csv"]:
        if (row["station"], row["target"]) == ("S3", "E"):
            row["target"] = "B"


@mistake(
    "index error of the vertical circle",
    ADJUST,
    DOUBTFUL,
    "most probable cause: the index error of the vertical circle at station 'S3': 19.8 ±",
)
def _(p: Project) -> None:
    for row in p.rows("zenith_angle", station="S3"):
        add(row, "value", 0.02)


@mistake(
    "a zenith angle read in the second face",
    CHECK,
    BAD_INPUT,
    "a reading in the second face is 400 gon minus the zenith angle; give both faces to",
)
def _(p: Project) -> None:
    row = p.rows("zenith_angle", station="S2")[1]
    row["value"] = f"{400.0 - float(row['value']):.4f}"


@mistake(
    "prism constant of 30 mm forgotten at a station",
    ADJUST,
    DOUBTFUL,
    "most probable cause: the zero constant (prism constant) of distances at station 'S2': 3",
)
def _(p: Project) -> None:
    for row in p.rows("slope_distance", station="S2"):
        add(row, "value", 0.03)


@mistake(
    "wrong scale of distances: atmospheric correction of another instrument",
    ADJUST,
    DOUBTFUL,
    "most probable cause: the scale of distances everywhere: 1000 ±",
)
def _(p: Project) -> None:
    for row in p.rows("slope_distance"):
        times(row, "value", 1.001)


MISTAKES.append(
    Mistake(
        "instrument 50 mm beside the mark",
        lambda: yard(beside={"S3": (0.03, 0.04)}),
        ADJUST,
        DOUBTFUL,
        "most probable cause: the centring of the instrument at 'S3' (height 1.547 m): east",
    )
)


@mistake(
    "tripod turned during a set of directions",
    ADJUST,
    DOUBTFUL,
    "most probable cause: the orientation, turned on the way, of set 'S2/1' from target",
)
def _(p: Project) -> None:
    for row in p.rows("direction", station="S2")[4:]:
        row["value"] = f"{(float(row['value']) + 0.03) % 400:.4f}"


@mistake(
    "GNSS vector with start and end exchanged",
    SNOOP,
    DOUBTFUL,
    "1. start and end, exchanged, of vector 'A' – 'E'",
)
def _(p: Project) -> None:
    row = p.rows("gnss_vector", station="A", target="E")[0]
    for axis in "xyz":
        times(row, axis, -1.0)


@mistake(
    "height of the base antenna 0.1 m too large",
    ADJUST,
    DOUBTFUL,
    "most probable cause: the height of the antenna at 'A' (0.1 m): 10",
)
def _(p: Project) -> None:
    for row in p.rows("gnss_vector", station="A"):
        row["instrument_height"] = "0.1"


@mistake(
    "held control point shifted by 60 mm",
    SNOOP,
    DOUBTFUL,
    "1. the given x, y, z of point 'B'",
)
def _(p: Project) -> None:
    add(p.point("B"), "z", 0.06, 3)


@mistake(
    "levelled height difference with the other sign",
    CHECK,
    DOUBTFUL,
    "contradicts the given heights of its points, and fits with the other sign",
)
def _(p: Project) -> None:
    times(p.rows("height_difference")[2], "value", -1.0)


@mistake(
    "levelled loop does not close",
    CHECK,
    DOUBTFUL,
    "the loop of 7 height differences does not close",
)
def _(p: Project) -> None:
    add(p.rows("height_difference")[4], "value", 0.05)


@mistake(
    "loop of GNSS vectors does not close",
    CHECK,
    DOUBTFUL,
    "GNSS vectors does not close in y",
)
def _(p: Project) -> None:
    add(p.rows("gnss_vector", station="C", target="E")[0], "y", 0.1)


@mistake(
    "reciprocal zenith angles do not agree",
    CHECK,
    DOUBTFUL,
    "forth and back, do not cancel",
)
def _(p: Project) -> None:
    add(p.rows("zenith_angle", station="S1", target="S2")[0], "value", 0.1)


@mistake(
    "the same distance measured twice, one metre apart",
    CHECK,
    DOUBTFUL,
    "slope_distance S1 A differ: -1000 mm",
)
def _(p: Project) -> None:
    row = dict(p.rows("slope_distance", station="S1", target="A")[0])
    add(row, "value", 1.0)
    p.tables["observations.csv"].append(row)


@mistake(
    "a row copied",
    CHECK,
    DOUBTFUL,
    "two of them make the result look more precise than it is",
)
def _(p: Project) -> None:
    p.tables["observations.csv"].append(dict(p.rows("direction", station="S2")[3]))


def sight(p: Project, station: str, target: str, face: str) -> Row:
    """Return a row of the field book."""
    wanted = (station, target, face)
    book = p.tables["readings.csv"]
    return next(r for r in book if (r["station"], r["target"], r["face"]) == wanted)


TWO_FACES = "1 doubt about the two faces of targets, the first: station 'S2', set '1', target 'E'"


@mistake(
    "a zenith angle wrong by 10 mgon in one face",
    ADJUST,
    DOUBTFUL,
    f"{TWO_FACES}: its two faces give index",
    field_book,
)
def _(p: Project) -> None:
    add(sight(p, "S2", "E", "2"), "zenith", 0.01)


@mistake(
    "a direction wrong by 10 mgon in one face",
    CHECK,
    DOUBTFUL,
    "station 'S2', set '1', target 'E': its two faces give collimation 1.9 mgon, the others -3.1 "
    "mgon, tolerance 2.5 mgon; look at the readings of both faces",
    field_book,
)
def _(p: Project) -> None:
    add(sight(p, "S2", "E", "1"), "direction", -0.01)


@mistake(
    "the same with both faces as observations",
    ADJUST,
    DOUBTFUL,
    f"{TWO_FACES}: its two faces give collimation",
    book_of_both,
)
def _(p: Project) -> None:
    add(sight(p, "S2", "E", "1"), "direction", -0.01)


@mistake(
    "a wrong reading of both faces, which data snooping rejects",
    SNOOP,
    FINE,
    "1 observation rejected",
    book_of_both,
)
def _(p: Project) -> None:
    add(sight(p, "S2", "E", "1"), "direction", -0.01)


@mistake(
    "both faces announced, one face read",
    CHECK,
    DOUBTFUL,
    "index error 'S1/1': no target was read in both faces: only the geometry of the network "
    "determines",
    book_of_both,
)
def _(p: Project) -> None:
    book = p.tables["readings.csv"]
    p.tables["readings.csv"] = [r for r in book if (r["station"], r["face"]) != ("S1", "2")]


# -- units, signs, frames -------------------------------------------------------------------------


@mistake(
    "distances in feet",
    CHECK,
    DOUBTFUL,
    "slope distances fit the given coordinates",
)
def _(p: Project) -> None:
    for row in p.rows("slope_distance"):
        times(row, "value", 1.0 / 0.3048)


@mistake(
    "zenith angles in degrees, the project in gon",
    CHECK,
    DOUBTFUL,
    "times better as degrees, not gon; state their unit",
)
def _(p: Project) -> None:
    for row in p.rows("zenith_angle"):
        times(row, "value", 0.9)


@mistake(
    "height differences in millimetres",
    CHECK,
    DOUBTFUL,
    "times better as millimetres; state their unit",
)
def _(p: Project) -> None:
    for row in p.rows("height_difference"):
        times(row, "value", 1000.0, 1)


@mistake(
    "GNSS vectors geocentric in a local frame",
    CHECK,
    DOUBTFUL,
    "they are geocentric, or in another frame",
)
def _(p: Project) -> None:
    make_geocentric(p)


@mistake(
    "GNSS vectors geocentric in a topocentric frame, between points without coordinates",
    CHECK,
    DOUBTFUL,
    "times better as geocentric X, Y, Z, in a topocentric frame",
    lambda: yard_on_earth(geographic=False),
)
def _(p: Project) -> None:
    make_geocentric(p)
    for row in p.tables["points.csv"]:
        if not row["fixed"]:
            row["x"] = row["y"] = row["z"] = ""


@mistake(
    "latitude and longitude of two points exchanged",
    CHECK,
    DOUBTFUL,
    "2 points, far away as given, would be among the others with latitude and longitude "
    "exchanged: B, E",
    yard_on_earth,
)
def _(p: Project) -> None:
    for name in "BE":
        row = p.point(name)
        row["latitude"], row["longitude"] = row["longitude"], row["latitude"]


@mistake(
    "latitude and longitude of the origin exchanged",
    CHECK,
    DOUBTFUL,
    "far from the origin of the frame, and would not with latitude and longitude of the origin",
    yard_on_earth,
)
def _(p: Project) -> None:
    p.toml = p.toml.replace(f"latitude = {LATITUDE}", "latitude = swap")
    p.toml = p.toml.replace(f"longitude = {LONGITUDE}", f"longitude = {LATITUDE}")
    p.toml = p.toml.replace("latitude = swap", f"latitude = {LONGITUDE}")


@mistake(
    "control with X and Y exchanged",
    CHECK,
    DOUBTFUL,
    "X and Y of the control, or the axes of the frame, are exchanged",
)
def _(p: Project) -> None:
    for row in p.tables["points.csv"]:
        row["x"], row["y"] = row["y"], row["x"]
        row["fixed"] = "xyz"
    p.tables["observations.csv"] = p.rows("direction")


@mistake(
    "coordinates far from the origin of a curved frame",
    CHECK,
    DOUBTFUL,
    "points lie far from the origin of the curved frame",
)
def _(p: Project) -> None:
    p.toml += '[frame]\nkind = "local"\ncurvature = true\n'
    for row in p.tables["points.csv"]:
        add(row, "x", 512_000.0, 3)


@mistake(
    "image y axis the other way",
    CHECK,
    DOUBTFUL,
    "times better with the image y axis the other way: 1, 2, 3; state y_axis",
    facade,
)
def _(p: Project) -> None:
    for row in p.tables["images.csv"]:
        times(row, "y", -1.0)


def in_pixels(y0: float, *, y_axis: str = "") -> Project:
    """Return the wall in pixels of 0.01 mm, whose rows count down from the upper left corner.

    Args:
        y0: row of the principal point in the project; the true one is 1500.
        y_axis: line of the camera that says where y points.
    """
    out = facade()
    for row in out.tables["images.csv"]:
        row["x"] = f"{2000.0 + 100.0 * float(row['x']):.2f}"
        row["y"] = f"{1500.0 - 100.0 * float(row['y']):.2f}"
    out.toml = out.toml.replace(
        'unit = "mm"\nsigma_um = 3', f'unit = "px"\nsigma_px = 0.3\n{y_axis}'
    )
    out.toml = out.toml.replace("c = 50.0", f"c = 5000\nx0 = 2000\ny0 = {y0}")
    return out


MISTAKES += [
    Mistake(
        f"pixels counted down, the project has y up and y0 = {y0}",
        lambda y0=y0: in_pixels(y0),  # type: ignore[misc]
        CHECK,
        code,
        "times better with the image y axis the other way: 1, 2, 3; state y_axis, and y0 in",
    )
    # Where y0 lies outside the image as well, the rays of all marks miss their points.
    for y0, code in ((1500, DOUBTFUL), (-1500, BAD_INPUT))
]
MISTAKES.append(
    Mistake(
        "pixels counted down, y0 with the sign of y up",
        lambda: in_pixels(-1500, y_axis='y_axis = "down"'),
        CHECK,
        BAD_INPUT,
        "times better with the other sign of y0: 1, 2, 3; give y0 in the direction of y",
    )
)


@mistake(
    "x and y of image points exchanged",
    CHECK,
    BAD_INPUT,
    "times better with x and y of the image exchanged",
    facade,
)
def _(p: Project) -> None:
    for row in p.tables["images.csv"]:
        row["x"], row["y"] = row["y"], row["x"]


@mistake(
    "rotation matrices transposed",
    CHECK,
    DOUBTFUL,
    "times better with transposed rotation matrices",
    facade,
)
def _(p: Project) -> None:
    for row in p.tables["photos.csv"]:
        for a, b in (("12", "21"), ("13", "31"), ("23", "32")):
            row[f"r{a}"], row[f"r{b}"] = row[f"r{b}"], row[f"r{a}"]


@mistake(
    "a rotation matrix with a wrong element",
    CHECK,
    BAD_INPUT,
    "more than the 9 decimals of its elements explain",
    facade,
)
def _(p: Project) -> None:
    add(p.tables["photos.csv"][1], "r11", 0.01, 9)


@mistake(
    "a point measured twice in a photo",
    CHECK,
    BAD_INPUT,
    "the point is measured more than once in this photo; first in line 2",
    facade,
)
def _(p: Project) -> None:
    p.tables["images.csv"].append(dict(p.tables["images.csv"][0]))


# -- frames of their own ---------------------------------------------------------------------------


@mistake(
    "a scan with left-handed axes",
    CHECK,
    DOUBTFUL,
    "times better with a mirror: its axes are left-handed; exchange x and y, or change the sign",
    hall,
)
def _(p: Project) -> None:
    for row in p.rows("frame_coordinate", frame="scan2"):
        times(row, "y", -1.0)


@mistake(
    "a target with the name of another in one scan",
    CHECK,
    DOUBTFUL,
    "point 'H5' in frame 'scan3' does not fit beside frame 'scan1', frame 'scan2', by the places",
    hall,
)
def _(p: Project) -> None:
    row = p.rows("frame_coordinate", frame="scan3", point="H5")[0]
    p.tables["observations.csv"].remove(row)
    p.rows("frame_coordinate", frame="scan3", point="H4")[0]["point"] = "H5"


@mistake(
    "a scanner knocked on the way to one target",
    CHECK,
    DOUBTFUL,
    "point 'H7' in frame 'scan1' does not fit",
    hall,
)
def _(p: Project) -> None:
    add(p.rows("frame_coordinate", frame="scan1", point="H7")[0], "z", 0.05)


MISTAKES.append(
    Mistake(
        "the origin of a scan left at zero, in national coordinates",
        lambda: without_origin(hall(shift=(452_000.0, 5_410_000.0, 300.0)), "scan2"),
        CHECK,
        DOUBTFUL,
        "the origin of frame 'scan2' is far from its places, which extend over",
    )
)


def without_origin(p: Project, frame: str) -> Project:
    """Return the project with a frame whose origin is left out."""
    row = next(r for r in p.tables["frames.csv"] if r["name"] == frame)
    for axis in "xyz":
        del row[f"origin_{axis}"]
    return p


@mistake(
    "a scan that has two targets in common with the others",
    CHECK,
    BAD_INPUT,
    "frame 'scan3': only 2 of its 3 places are common with the rest of the network (H0, H1), and "
    "its 6 unknowns need 3 that do not lie in one line",
    hall,
)
def _(p: Project) -> None:
    for row in p.rows("frame_coordinate", frame="scan3")[2:]:
        p.tables["observations.csv"].remove(row)
    p.tables["points.csv"].append({"name": "alone"})
    cells = {"x": "3.1", "y": "-2.2", "z": "1.5"}
    row = {"kind": "frame_coordinate", "frame": "scan3", "point": "alone", **cells}
    p.tables["observations.csv"].append(row)


@mistake(
    "a scan without any target",
    CHECK,
    BAD_INPUT,
    "frame 'scan4': it is unknown, but no observation depends on it: hold it, or take it out",
    hall,
)
def _(p: Project) -> None:
    p.tables["frames.csv"].append({"name": "scan4", "free": "rotation offset"})


@mistake(
    "a scan under another name in the observations",
    CHECK,
    BAD_INPUT,
    "unknown frame 'scan_2'; known: scan1, scan2, scan3; did you mean 'scan2'?",
    hall,
)
def _(p: Project) -> None:
    p.rows("frame_coordinate", frame="scan2")[0]["frame"] = "scan_2"


# -- at the desk ----------------------------------------------------------------------------------


@mistake(
    "a point name with another case",
    CHECK,
    BAD_INPUT,
    "unknown point 's2'; known: A, B, C, D, E, S1, S2, S3; did you mean 'S2'?",
)
def _(p: Project) -> None:
    p.rows("direction", station="S1", target="S2")[0]["target"] = "s2"


@mistake(
    "a table under another name",
    ADJUST,
    BAD_INPUT,
    "problems: observation.csv: is not read: the table is named observations.csv",
)
def _(p: Project) -> None:
    p.tables["observation.csv"] = p.tables.pop("observations.csv")


@mistake(
    "a field book under another name",
    ADJUST,
    FINE,
    "warning: reading.csv: is not read: the table is named readings.csv",
)
def _(p: Project) -> None:
    p.tables["reading.csv"] = [{"station": "S1", "target": "A", "direction": "0"}]


@mistake(
    "the same, before the adjustment",
    CHECK,
    DOUBTFUL,
    "1 doubt about files, readings or given values; nothing was changed: Reading.CSV: is not read",
)
def _(p: Project) -> None:
    p.tables["Reading.CSV"] = [{"station": "S1", "target": "A", "direction": "0"}]


@mistake(
    "a decimal comma",
    CHECK,
    BAD_INPUT,
    "1 problem: observations.csv:4: 10 cells, but the header has 9 columns; is one of the "
    "commas a decimal comma?",
)
def _(p: Project) -> None:
    row = p.rows("slope_distance", station="S1")[0]
    row["value"] = row["value"].replace(".", ",")


@mistake(
    "a column misspelt",
    CHECK,
    BAD_INPUT,
    "unknown column 'targt_height'; did you mean 'target_height'?",
)
def _(p: Project) -> None:
    p.tables["observations.csv"] = [
        {("targt_height" if k == "target_height" else k): v for k, v in row.items()}
        for row in p.tables["observations.csv"]
    ]


@mistake(
    "an unknown kind of observation",
    CHECK,
    BAD_INPUT,
    "observations.csv:4: slope_distnce S1 A: unknown kind 'slope_distnce'",
)
def _(p: Project) -> None:
    p.rows("slope_distance")[0]["kind"] = "slope_distnce"


@mistake(
    "a letter O in a number",
    CHECK,
    BAD_INPUT,
    "observations.csv:4:",
)
def _(p: Project) -> None:
    p.rows("slope_distance")[0]["value"] = "4O.1274"


@mistake(
    "no value",
    CHECK,
    BAD_INPUT,
    "observations.csv:2:",
)
def _(p: Project) -> None:
    p.rows("direction")[0]["value"] = ""


@mistake(
    "an infinite distance",
    CHECK,
    BAD_INPUT,
    "observations.csv:4:",
)
def _(p: Project) -> None:
    p.rows("slope_distance")[0]["value"] = "inf"


@mistake(
    "a negative distance",
    CHECK,
    BAD_INPUT,
    "a distance cannot be negative",
)
def _(p: Project) -> None:
    times(p.rows("slope_distance")[0], "value", -1.0)


@mistake(
    "a sight from a point to itself",
    CHECK,
    BAD_INPUT,
    "an observation cannot join a point to itself",
)
def _(p: Project) -> None:
    p.rows("direction", station="S1")[0]["target"] = "S1"


@mistake(
    "a standard deviation of zero",
    CHECK,
    BAD_INPUT,
    "observations.csv:2:",
)
def _(p: Project) -> None:
    p.rows("direction")[0]["sigma_mgon"] = "0"


@mistake(
    "no standard deviation for a kind",
    CHECK,
    BAD_INPUT,
    "sigma",
)
def _(p: Project) -> None:
    p.toml = p.toml.replace("[sigma.direction]\nsigma_mgon = 1\n", "")


@mistake(
    "an id used twice",
    CHECK,
    BAD_INPUT,
    "duplicate id 'r1'",
)
def _(p: Project) -> None:
    for row in p.rows("direction")[:2]:
        row["id"] = "r1"


@mistake(
    "an unknown unit",
    CHECK,
    BAD_INPUT,
    "project.toml",
)
def _(p: Project) -> None:
    p.toml = p.toml.replace('angle = "gon"', 'angle = "gons"')


@mistake(
    "an unknown key of the project",
    CHECK,
    BAD_INPUT,
    "unknown key 'datums'",
)
def _(p: Project) -> None:
    p.toml = 'datums = "free"\n' + p.toml


@mistake(
    "an unknown letter for a held component",
    CHECK,
    BAD_INPUT,
    "points.csv:2:",
)
def _(p: Project) -> None:
    p.point("A")["fixed"] = "xyq"


@mistake(
    "a point without enough readings",
    CHECK,
    BAD_INPUT,
    "point 'F'",
)
def _(p: Project) -> None:
    p.tables["points.csv"].append({"name": "F"})
    row = dict(p.rows("direction", station="S1")[0]) | {"target": "F", "value": "12.5"}
    p.tables["observations.csv"].append(row)


@mistake(
    "nothing is held",
    CHECK,
    BAD_INPUT,
    "datum",
)
def _(p: Project) -> None:
    for row in p.tables["points.csv"]:
        row["fixed"] = ""


@mistake(
    "a table outside the folder of the project",
    CHECK,
    BAD_INPUT,
    "lies outside the folder of the project, or is named as if it did: move it there",
)
def _(p: Project) -> None:
    p.toml += '[files]\npoints = "../../../../etc/passwd"\n'


@mistake(
    "a direction from one station to the next 0.05 gon wrong",
    CHECK,
    DOUBTFUL,
    "the angles of the traverse",
)
def _(p: Project) -> None:
    add(p.rows("direction", station="S1", target="S2")[0], "value", 0.05)


@mistake(
    "a point intersected in line with its two stations",
    CHECK,
    DOUBTFUL,
    "what is observed of point 'W' determines it",
)
def _(p: Project) -> None:
    a, b = p.point("S1"), p.point("S2")
    middle = {axis: f"{(float(a[axis]) + float(b[axis])) / 2:.3f}" for axis in "xyz"}
    p.tables["points.csv"].append({"name": "W", **middle, "fixed": "z"})
    for station, target in (("S1", "S2"), ("S2", "S1")):
        row = p.rows("direction", station=station, target=target)[0]
        p.tables["observations.csv"].append(dict(row) | {"target": "W", "target_height": "0"})


@mistake(
    "x and y of one photo exchanged",
    SNOOP,
    DOUBTFUL,
    "x and y, exchanged, of photo '3'",
    facade,
)
def _(p: Project) -> None:
    exchange_axes(p, "3")


@mistake(
    "x and y of one photo exchanged, before the adjustment",
    CHECK,
    DOUBTFUL,
    "times better with x and y of the image exchanged: 2",
    facade,
)
def _(p: Project) -> None:
    exchange_axes(p, "2")


# -- units ----------------------------------------------------------------------------------------


def without_places(p: Project) -> None:
    """Take out the coordinates of points that are not held."""
    for row in p.tables["points.csv"]:
        if not row["fixed"]:
            row["x"] = row["y"] = row["z"] = ""


def in_degrees(p: Project) -> None:
    """State degrees, where gon was read."""
    p.toml = p.toml.replace('angle = "gon"', 'angle = "deg"')


def state_length(p: Project, unit: str, factor: float, *, digits: int = 4) -> None:
    """State another unit of lengths, and give the coordinates of points another size."""
    p.toml = p.toml.replace("[units]\n", f'[units]\nlength = "{unit}"\n')
    for row in p.tables["points.csv"]:
        for axis in "xyz":
            if row[axis]:
                times(row, axis, factor, digits)


@mistake(
    "directions in gon, the project in degrees",
    CHECK,
    DOUBTFUL,
    "observations.csv:2: direction S1 A: 375.2990 degrees is more than the full circle of 360 "
    "degrees, which no instrument reads; it is valid in gon (0 to 400)",
)
def _(p: Project) -> None:
    in_degrees(p)


@mistake(
    "a direction with a wrong first digit, in gon",
    CHECK,
    DOUBTFUL,
    "is more than the full circle of 400 gon, which no instrument reads; it is valid in mgon",
)
def _(p: Project) -> None:
    add(p.rows("direction", station="S2")[1], "value", 500.0)


@mistake(
    "zenith angles in gon, the project in degrees, sights forth and back",
    CHECK,
    DOUBTFUL,
    "the values of 21 zenith angles are in gon, not in degrees: 3 sums of both faces, or of sights "
    "forth and back, fit in gon",
)
def _(p: Project) -> None:
    in_degrees(p)
    without_places(p)


@mistake(
    "zenith angles in degrees, the project in gon, from one station alone",
    CHECK,
    DOUBTFUL,
    "the values of 7 zenith angles are in degrees, not in gon: they lie near 90, which is level",
)
def _(p: Project) -> None:
    without_places(p)
    own = [r for r in p.tables["observations.csv"] if r["kind"] != "zenith_angle"]
    rows = p.rows("zenith_angle", station="S2")
    for row in rows:
        times(row, "value", 0.9)
    p.tables["observations.csv"] = [*own, *rows]


@mistake(
    "a field book in gon, the project in degrees",
    CHECK,
    DOUBTFUL,
    "gon: both add up to a circle of gon, not of degrees; state their unit",
    field_book,
)
def _(p: Project) -> None:
    in_degrees(p)
    for row in p.tables["readings.csv"]:  # directions that degrees allow
        row["direction"] = f"{float(row['direction']) % 360:.4f}"


@mistake(
    "both faces in gon, the project in degrees",
    CHECK,
    DOUBTFUL,
    "the values of 42 zenith angles are in gon, not in degrees: 24 sums of both faces",
    book_of_both,
)
def _(p: Project) -> None:
    in_degrees(p)
    without_places(p)
    for row in p.tables["readings.csv"]:
        row["direction"] = f"{float(row['direction']) % 360:.4f}"


@mistake(
    "coordinates in millimetres, as stated, and distances in metres",
    CHECK,
    DOUBTFUL,
    "times better as metres; state their unit, or that of the coordinates (mm is stated): the "
    "factor is 1000",
)
def _(p: Project) -> None:
    state_length(p, "mm", 1000.0)


@mistake(
    "the same, with coordinates of the held points alone",
    CHECK,
    DOUBTFUL,
    "6 traverses between held points are as long as these are apart with the factor 1000, as "
    "metres",
)
def _(p: Project) -> None:
    state_length(p, "mm", 1000.0)
    without_places(p)


@mistake(
    "coordinates in feet, the project in metres",
    CHECK,
    DOUBTFUL,
    "times better as they stand, with the coordinates in feet; state their unit, or that of the "
    "coordinates (m is stated): the factor is 3.281",
)
def _(p: Project) -> None:
    state_length(p, "m", 1.0 / 0.3048, digits=6)


@mistake(
    "scans in millimetres, the project in metres",
    CHECK,
    DOUBTFUL,
    "with the factor 0.001, as millimetres; state the unit of its places",
    hall,
)
def _(p: Project) -> None:
    for row in p.rows("frame_coordinate"):
        for axis in "xyz":
            times(row, axis, 1000.0, 1)


# -- exchanges in scans, surfaces, axes -----------------------------------------------------------


def exchange_in_scan(p: Project) -> None:
    """Exchange two targets of a scan."""
    for row in p.rows("frame_coordinate", frame="scan2"):
        row["point"] = {"H0": "H4", "H4": "H0"}.get(row["point"], row["point"])


@mistake(
    "two targets exchanged in one scan",
    CHECK,
    DOUBTFUL,
    "1 doubt about files, readings or given values; nothing was changed: point 'H0' and point 'H4' "
    "are exchanged in frame 'scan2'",
    hall,
)
def _(p: Project) -> None:
    exchange_in_scan(p)


@mistake(
    "two targets exchanged in one scan, with data snooping",
    SNOOP,
    DOUBTFUL,
    "1. two targets, exchanged: 'H0' and 'H4' in frame 'scan2'",
    hall,
)
def _(p: Project) -> None:
    exchange_in_scan(p)


def polar(p: Project) -> None:
    """Turn the coordinates of scans into directions, zenith angles and distances."""
    out = []
    for row in p.tables["observations.csv"]:
        q = np.array([float(row[a]) for a in "xyz"])
        length = float(np.linalg.norm(q))
        common = {"frame": row["frame"], "point": row["point"]}
        for kind, value in (
            ("frame_direction", np.arctan2(q[0], q[1]) * 200 / np.pi % 400),
            ("frame_zenith", np.arccos(q[2] / length) * 200 / np.pi),
            ("frame_distance", length),
        ):
            out.append({"kind": kind, **common, "value": f"{value:.5f}"})
    p.tables["observations.csv"] = out
    p.toml += "[sigma.frame_direction]\nsigma_mgon = 15\n[sigma.frame_zenith]\nsigma_mgon = 15\n"
    p.toml += "[sigma.frame_distance]\nsigma_mm = 2\n"


def polar_hall() -> Project:
    """Return the hall with polar points."""
    out = hall()
    polar(out)
    return out


@mistake(
    "two polar points of a scan exchanged",
    CHECK,
    DOUBTFUL,
    "1 doubt about files, readings or given values; nothing was changed: point 'H0' and point 'H4' "
    "are exchanged in frame 'scan2'",
    hall,
)
def _(p: Project) -> None:
    exchange_in_scan(p)
    polar(p)


@mistake(
    "two polar points of a scan exchanged, with data snooping",
    SNOOP,
    DOUBTFUL,
    "1. two targets, exchanged: 'H0' and 'H4' in frame 'scan2'",
    hall,
)
def _(p: Project) -> None:
    exchange_in_scan(p)
    polar(p)


def lake(p: Project, value: str, fixed: str) -> None:
    """Add the shore of a lake at 103.2 m, with a stated height."""
    p.toml += "[sigma.level_height]\nsigma_mm = 20\n"
    p.tables["levels.csv"] = [{"name": "lake", "value_m": value, "fixed": fixed}]
    for name, above in (("A", -3.2), ("B", -2.0), ("C", 0.3), ("S3", -0.6)):
        row = {"kind": "level_height", "point": name, "level": "lake", "value": f"{above}"}
        p.tables["observations.csv"].append(row)


@mistake(
    "the height of a lake with two digits exchanged, held",
    CHECK,
    DOUBTFUL,
    "level surface 'lake': its held height of 130.2 m contradicts the given heights of the 3 "
    "points on it, by which it is 103.2 m",
)
def _(p: Project) -> None:
    lake(p, "130.2", "yes")


@mistake(
    "the height of a lake with two digits exchanged, approximate",
    CHECK,
    DOUBTFUL,
    "level surface 'lake': its approximate height of 130.2 m contradicts",
)
def _(p: Project) -> None:
    lake(p, "130.2", "")


def yard_with_lake() -> Project:
    """Return the yard with a lake whose height is right."""
    out = yard()
    lake(out, "103.2", "yes")
    return out


def full_circle() -> Project:
    """Return the yard with a direction of exactly a full circle, which is zero."""
    out = yard()
    rows = out.rows("direction", station="S1")
    zero = float(rows[0]["value"])
    for row in rows:
        row["value"] = f"{(float(row['value']) - zero) % 400:.4f}"
    rows[0]["value"] = "400.0"
    return out


@mistake(
    "frames that are not level in a network of north, east",
    ADJUST,
    DOUBTFUL,
    "the axes of the network are left-handed, and frames are not level: scan1, scan2, scan3; no "
    "rotation leads from one to the other",
    hall,
)
def _(p: Project) -> None:
    p.toml += '[frame]\nkind = "local"\naxes = "ne"\n'
    for row in p.tables["points.csv"]:
        if row["fixed"]:
            row["x"], row["y"] = row["y"], row["x"]
