"""Mistakes in a hall with two trackers and a levelled scanner, and in a rig of cameras."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.rotation import exp_rotation

from .mistakes import CHECK, DOUBTFUL, SNOOP, mistake
from .projects import GON, Project, Row

TARGETS = {
    f"T{i:02d}": at
    for i, at in enumerate(
        np.random.default_rng(77).uniform((0.0, 0.0, 0.2), (34.0, 22.0, 8.0), (16, 3)), start=1
    )
}
"""True coordinates of targets, metres."""
HELD = ("T01", "T02", "T05")
INSTRUMENTS = {
    "LT1": ((6.2, 4.1, 1.5), (0.2, -0.11, 0.7), (5e-6, 15e-6, 0.5e-6)),
    "LT2": ((27.3, 17.2, 1.8), (-0.15, 0.3, -2.1), (5e-6, 15e-6, 0.5e-6)),
    "SC": ((16.5, 9.9, 1.7), (0.0, 0.0, 1.234), (30e-6, 1e-3, 10e-6)),
}
"""Place, rotation vector, and σ of angles, of distances and in proportion to these."""
KINDS = ("frame_direction", "frame_zenith", "frame_distance")


def tracked_hall(seed: int = 4) -> Project:
    """Return targets that two trackers and a levelled scanner sight; three are held."""
    rng = np.random.default_rng(seed)
    points: list[Row] = []
    for name, at in TARGETS.items():
        cells = {a: f"{v:.6f}" for a, v in zip("xyz", at, strict=True)} if name in HELD else {}
        points.append({"name": name, **cells, "fixed": "xyz" if name in HELD else ""})
    frames: list[Row] = []
    rows: list[Row] = []
    for frame, (station, turn, (angle, distance, ppm)) in INSTRUMENTS.items():
        level = not np.any(turn[:2])
        frames.append({"name": frame, "free": "rz offset" if level else "rotation offset"})
        frames[-1] |= {"level": "yes" if level else ""}
        frames[-1] |= {f"origin_{a}": f"{v:.0f}" for a, v in zip("xyz", station, strict=True)}
        for point, at in TARGETS.items():
            x, y, z = exp_rotation(np.array([turn]))[0].T @ (at - station)
            length = float(np.sqrt(x * x + y * y + z * z))
            values = (np.arctan2(x, y) / GON, np.arctan2(np.hypot(x, y), z) / GON, length)
            sigmas = (angle / GON, angle / GON, distance + ppm * length)
            for kind, value, sigma in zip(KINDS, values, sigmas, strict=True):
                read = value + sigma * rng.normal()
                far = kind == KINDS[2]
                spread = {"sigma_mm" if far else "sigma_mgon": f"{1e3 * sigma:.6f}"}
                text = f"{read:.6f}" if far else f"{read % 400:.6f}"
                rows.append({"kind": kind, "frame": frame, "point": point, "value": text, **spread})
    tables = {"points.csv": points, "frames.csv": frames, "observations.csv": rows}
    return Project('name = "tracked hall"\n[units]\nangle = "gon"\n', tables)


def exchange(p: Project, frame: str, a: str, b: str) -> None:
    """Exchange the names of two targets in a frame."""
    other = {a: b, b: a}
    for row in p.tables["observations.csv"]:
        if row["frame"] == frame:
            row["point"] = other.get(row["point"], row["point"])


def scale(p: Project, frame: str, kinds: tuple[str, ...], by: float) -> None:
    """Multiply the readings of some kinds in a frame."""
    for row in p.tables["observations.csv"]:
        if row["frame"] == frame and row["kind"] in kinds:
            row["value"] = f"{float(row['value']) * by:.6f}"


@mistake(
    "two targets of a tracker exchanged",
    SNOOP,
    DOUBTFUL,
    "6 observations rejected, the first: observations.csv:28: frame_distance LT1 T12 more probable "
    "than gross errors of single readings: two targets, exchanged: 'T09' and 'T12' in frame 'LT1'",
    tracked_hall,
)
def _(p: Project) -> None:
    exchange(p, "LT1", "T09", "T12")


@mistake(
    "two targets of a tracker exchanged that are far apart",
    SNOOP,
    DOUBTFUL,
    "two targets, exchanged: 'T07' and 'T08' in frame 'LT1'",
    tracked_hall,
)
def _(p: Project) -> None:
    exchange(p, "LT1", "T07", "T08")


@mistake(
    "a target of a tracker read for another",
    SNOOP,
    DOUBTFUL,
    "3 observations rejected, the first: observations.csv:22: frame_distance LT1 T07 more probable "
    "than gross errors of single readings: the name of the target 'T07' in frame 'LT1', which is "
    "'T08'",
    tracked_hall,
)
def _(p: Project) -> None:
    for kind in KINDS:
        (row,) = p.rows(kind, frame="LT1", point="T07")
        (other,) = p.rows(kind, frame="LT1", point="T08")
        row["value"] = other["value"]


CIRCLES_LINE = "better with its directions and zenith angles in degrees, not in gon"
TILTED_LINE = "frame 'LT1' is stated to be level, but its places fit those of"


@mistake("the circles of a scanner in degrees", CHECK, DOUBTFUL, CIRCLES_LINE, tracked_hall)
def _(p: Project) -> None:
    scale(p, "SC", KINDS[:2], 0.9)


@mistake("the same, with data snooping", SNOOP, DOUBTFUL, CIRCLES_LINE, tracked_hall)
def _(p: Project) -> None:
    scale(p, "SC", KINDS[:2], 0.9)


@mistake(
    "most readings of an instrument rejected", SNOOP, DOUBTFUL, "of frame 'SC' 4", tracked_hall
)
def _(p: Project) -> None:
    scale(p, "SC", KINDS[:2], 0.9)


@mistake(
    "the distances of a tracker in millimetres",
    SNOOP,
    DOUBTFUL,
    "times better with the factor 0.001, as millimetres",
    tracked_hall,
)
def _(p: Project) -> None:
    scale(p, "LT2", KINDS[2:], 1000.0)


def declare_level(p: Project) -> None:
    """State that a tilted tracker is level."""
    p.tables["frames.csv"][0] |= {"free": "rz offset", "level": "yes"}


@mistake("a tilted tracker stated to be level", CHECK, DOUBTFUL, TILTED_LINE, tracked_hall)
def _(p: Project) -> None:
    declare_level(p)


@mistake("a tilted tracker, with data snooping", SNOOP, DOUBTFUL, TILTED_LINE, tracked_hall)
def _(p: Project) -> None:
    declare_level(p)


# -- a rig ----------------------------------------------------------------------------------------

MEMBERS = ("ref", "M1", "M2", "M3")
MOMENTS = 4


def rig(seed: int = 1) -> Project:
    """Return photos of a rig of four cameras at four moments, with unknown mounts."""
    rng = np.random.default_rng(seed)
    heading = {m: exp_rotation(np.array([[0.0, 0.3 * k, 0.0]]))[0] for k, m in enumerate(MEMBERS)}
    arm = {m: 0.2 * k * np.array([1.0, 0.3 * k, -0.5]) for k, m in enumerate(MEMBERS)}
    around = np.linspace(-0.6, 1.5, 72)
    away = rng.uniform(8.0, 16.0, 72)
    up = rng.uniform(-5.0, 5.0, 72)
    places = np.stack([away * np.sin(around), up, away * np.cos(around)], axis=1)
    points: list[Row] = []
    for i, at in enumerate(places):
        held = i % 3 == 0
        cells = {a: f"{v:.5f}" for a, v in zip("xyz", at, strict=True)} if held else {}
        points.append({"name": f"Q{i:02d}", **cells, "fixed": "xyz" if held else ""})
    photos: list[Row] = []
    images: list[Row] = []
    rows: list[Row] = []
    for moment in range(MOMENTS):
        turn = exp_rotation(rng.normal(0.0, 0.1, (1, 3)))[0]
        centre = rng.normal(0.0, 1.0, 3)
        for member in MEMBERS:
            photo = f"m{moment}_{member}"
            photos.append({"name": photo, "camera": "cam"})
            rotation, place = turn @ heading[member], centre + turn @ arm[member]
            for i, at in enumerate(places):
                q = rotation.T @ (at - place)
                xy = 8.0 * q[:2] / q[2] * (1.0, -1.0) + 0.0015 * rng.normal(size=2)
                if q[2] > 1.0 and np.abs(xy).max() < 8.0:
                    cells = {a: f"{v:.5f}" for a, v in zip("xy", xy, strict=True)}
                    images.append({"photo": photo, "point": f"Q{i:02d}", **cells})
            if member != "ref":
                common = {"photo": f"m{moment}_ref", "photo2": photo, "mount": member}
                none = {"x": "0", "y": "0", "z": "0", "sigma_mm": "0.001"}
                turns = {"rx": "0", "ry": "0", "rz": "0", "sigma_mgon": "0.0006"}
                rows.append({"kind": "relative_rotation", **common, **turns})
                rows.append({"kind": "relative_position", **common, **none})
    mounts = [{"name": m, "free": "rx ry rz x y z"} for m in MEMBERS[1:]]
    toml = 'name = "rig"\n[units]\nangle = "gon"\n[[camera]]\nname = "cam"\nlens = "none"\n'
    toml += 'unit = "mm"\nsigma_um = 1.5\n[camera.parameters]\nc = 8.0\n'
    tables = {
        "points.csv": points,
        "photos.csv": photos,
        "images.csv": images,
        "observations.csv": rows,
        "mounts.csv": mounts,
    }
    return Project(toml, tables)


@mistake(
    "the images of two members of a rig exchanged",
    SNOOP,
    DOUBTFUL,
    "the images of two photos, exchanged: 'm2_M1' and 'm2_M2'",
    rig,
)
def _(p: Project) -> None:
    other = {"m2_M1": "m2_M2", "m2_M2": "m2_M1"}
    for row in p.tables["images.csv"]:
        row["photo"] = other.get(row["photo"], row["photo"])
