"""Mistakes on the site with two held points, which readings between given points tell."""

from __future__ import annotations

from .mistakes import ADJUST, BAD_INPUT, CHECK, DOUBTFUL, add, mistake, times
from .projects import Project
from .site import book_as, site

FEET = 0.3048


def exchange_xy(p: Project, *names: str) -> None:
    """Exchange x and y of given points."""
    for name in names:
        row = p.point(name)
        row["x"], row["y"] = row["y"], row["x"]


@mistake(
    "x and y of a held point exchanged",
    CHECK,
    DOUBTFUL,
    "contradict their coordinates, and fit with x and y of point 'A' or 'B' exchanged",
    site,
)
def _(p: Project) -> None:
    exchange_xy(p, "B")


@mistake(
    "x and y of all held points exchanged",
    CHECK,
    DOUBTFUL,
    "the given coordinates -40.0000, -150.0000, -2.5000 m, which fits with x and y exchanged",
    site,
)
def _(p: Project) -> None:
    exchange_xy(p, "A", "B")


@mistake(
    "distances of one set-up in feet",
    CHECK,
    DOUBTFUL,
    "slope_distance A B contradicts the given coordinates: observed 509.385, computed 155.261 m, "
    "and fits as feet (factor 0.3048)",
    site,
)
def _(p: Project) -> None:
    for row in p.rows("slope_distance", station="A"):
        times(row, "value", 1 / FEET)


@mistake(
    "a distance between held points in millimetres",
    CHECK,
    DOUBTFUL,
    "and fits as millimetres (factor 0.001)",
    site,
)
def _(p: Project) -> None:
    times(p.rows("slope_distance", station="A", target="B")[0], "value", 1e3)


@mistake(
    "prism constant of 34.4 mm applied twice",
    CHECK,
    DOUBTFUL,
    "slope_distance A B contradicts the given coordinates: observed 155.29",
    site,
)
def _(p: Project) -> None:
    for row in p.rows("slope_distance"):
        add(row, "value", 0.0344)


@mistake(
    "scale of 400 ppm",
    CHECK,
    DOUBTFUL,
    "slope_distance A B contradicts the given coordinates: observed 155.19",
    site,
)
def _(p: Project) -> None:
    for row in p.rows("slope_distance"):
        times(row, "value", 1 - 4e-4)


@mistake(
    "a level reading of a line between bench marks 1 dm wrong",
    CHECK,
    DOUBTFUL,
    "5 height differences lead from the given point 'A' to 'B' and miss it",
    site,
)
def _(p: Project) -> None:
    add(p.rows("height_difference", station="P1")[0], "value", 0.1)


@mistake(
    "a levelled difference between bench marks with the wrong sign",
    CHECK,
    DOUBTFUL,
    "height_difference A B contradicts the given coordinates: observed -2.500, computed 2.500 m, "
    "and fits with the other sign",
    site,
)
def _(p: Project) -> None:
    row = dict(p.rows("height_difference")[0]) | {"target": "B", "value": "-2.5002"}
    p.tables["observations.csv"].append(row)


@mistake(
    "east and north of GNSS vectors exchanged",
    CHECK,
    DOUBTFUL,
    "2 GNSS vectors lead from the given point",
    site,
)
def _(p: Project) -> None:
    for row in p.rows("gnss_vector"):
        row["x"], row["y"] = row["y"], row["x"]


@mistake(
    "the zenith angle to a held point is a vertical angle",
    CHECK,
    DOUBTFUL,
    "zenith_angle A B contradicts the given coordinates: observed 1.00",
    site,
)
def _(p: Project) -> None:
    row = p.rows("zenith_angle", station="A", target="B")[0]
    row["value"] = f"{100.0 - float(row['value']):.4f}"


@mistake(
    "a held point moved by 36 mm",
    CHECK,
    DOUBTFUL,
    "slope_distance A B contradicts the given coordinates",
    site,
)
def _(p: Project) -> None:
    add(p.point("B"), "x", 0.03, 3)
    add(p.point("B"), "y", -0.02, 3)


@mistake(
    "the target is mistyped, and listed as a point",
    ADJUST,
    DOUBTFUL,
    "point 'PI' may be point 'P1', mistyped",
    site,
)
def _(p: Project) -> None:
    book_as(p, "S2", "P1", "PI")


@mistake(
    "one of three backsights read 0.1 gon wrong",
    CHECK,
    DOUBTFUL,
    "beside",
    site,
)
def _(p: Project) -> None:
    for name, at in (("S2", (1090.123, 2110.568, 149.391)), ("P1", (1040.123, 2080.568, 151.291))):
        cells = {axis: f"{v:.3f}" for axis, v in zip("xyz", at, strict=True)}
        p.point(name).update(cells | {"fixed": "xyz"})
    add(p.rows("direction", station="A", target="P1")[0], "value", 0.1)


@mistake(
    "vertical angles of a set-up booked as zenith angles",
    CHECK,
    BAD_INPUT,
    "a negative reading is an angle from the horizon, below it; is it a vertical_angle",
    site,
)
def _(p: Project) -> None:
    for row in p.rows("zenith_angle", station="S2"):
        row["value"] = f"{100.0 - float(row['value']):.4f}"


def lengths_in_metres(p: Project) -> None:
    """State the lengths of the levelled lines in metres."""
    for row in p.rows("height_difference"):
        row["length_km"] = "80"


for _command in (CHECK, ADJUST):
    mistake(
        f"lengths of levelled lines in metres, {_command[0]}",
        _command,
        DOUBTFUL,
        "80 km between points 67.4",
        site,
    )(lengths_in_metres)
