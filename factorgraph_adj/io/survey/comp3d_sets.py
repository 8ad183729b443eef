"""Sets of observations of Comp3D in files of their own: sub-frames, axes, baselines, equalities."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ...frames import EARTH_SCALE_M, TopocentricFrame
from ...network.network import Network
from ...observations import (
    Correlated,
    EqualDistance,
    EqualHeightDifference,
    FrameCoordinate,
    FrameDirection,
    FrameDistance,
    FrameZenith,
    GnssVector,
    Observation,
    OnCircle,
)
from ...units import GON
from .comp3d_files import Comp3dFiles, Comp3dLine

EQUALITY_KINDS: dict[str, type[Observation]] = {"21": EqualHeightDifference, "22": EqualDistance}
"""Kinds by code."""


def _rows(files: Comp3dFiles, line: Comp3dLine, at: int) -> Iterator[Comp3dLine]:
    """Iterate over the lines of the file that a line names."""
    if at >= len(line.words):
        line.wrong("must name a file as @file")
        return
    path = files.beside(line, line.words[at])
    if path is not None:
        yield from files.lines(path)


def _add_set_observation(network: Network, row: Comp3dLine, *observations: object) -> None:
    if all(o is not None for o in observations):
        row.attempt(network.add, *observations)


# -- sub-frames (codes 11, 12) -------------------------------------------------------------------


def add_subframe(files: Comp3dFiles, network: Network, line: Comp3dLine) -> None:
    """Add a sub-frame: code, point at its origin, @file, 1 where its third axis is vertical.

    Cartesian ones (11) have rows name X Y Z σ [σ_rel], or with three σ [σ_rel [height]]; polar ones
    (12) name α β distance σ_angles [σ_rel] σ_distance σ_rel [height], α from x towards y and β from
    the xy plane, gon. σ_rel of lengths is multiplied with the distance; that of angles, metres, is
    divided by it.
    """
    if len(line.words) not in (3, 4) or line.words[3:] not in ([], ["1"], ["0"]):
        line.wrong("a sub-frame has a code, an origin, @file, and 1 if it is levelled")
        return
    code, origin, file = line.words[:3]
    level = line.words[3:] == ["1"]
    name = file.removeprefix("@").rsplit(".", 1)[0]
    if name in network.frames:
        name = f"{name} at {origin}"
    line.attempt(
        network.add_frame,
        name,
        free=("rz",) if level else ("rx", "ry", "rz"),
        origin=origin,
        level=level,
    )
    if name not in network.frames:
        return
    for row in _rows(files, line, 2):
        (_cartesian if code == "11" else _polar)(network, name, row)


def _cartesian(network: Network, frame: str, row: Comp3dLine) -> None:
    if not 5 <= len(row.words) <= 9:
        row.wrong("a row has a name, X, Y, Z and one to five numbers of σ and height")
        return
    before = row.file.problems.count
    xyz = [row.number_at(i, "XYZ"[i - 1]) for i in (1, 2, 3)]
    rest = [row.number_at(i, "σ") for i in range(4, len(row.words))]
    if row.file.problems.count > before:
        return
    length = math.sqrt(sum(v * v for v in xyz))
    sigma = rest[:3] if len(rest) >= 3 else rest[:1] * 3
    relative = rest[3] if len(rest) > 3 else rest[1] if len(rest) == 2 else 0.0
    if len(rest) == 5 and rest[4] != 0.0:
        row.wrong("a height of the target in a sub-frame is not read: give another point")
    if length == 0.0:
        row.wrong("0 0 0 is the origin of the sub-frame")
    axes = "".join(a for a, s in zip("xyz", sigma, strict=True) if s > 0)
    if 0.0 in sigma:
        row.wrong("σ must be > 0, or negative for a coordinate that takes no part")
    if row.file.problems.count > before:
        return
    if len(axes) < 3:
        row.switched_off()
    if not axes:
        return
    made = row.attempt(
        FrameCoordinate,
        frame,
        row.words[0],
        tuple(xyz["xyz".index(a)] for a in axes),
        axes=axes,
        sigma=tuple(sigma["xyz".index(a)] + relative * length for a in axes),
        source=row.source,
    )
    _add_set_observation(network, row, made)


def _polar(network: Network, frame: str, row: Comp3dLine) -> None:
    if not 7 <= len(row.words) <= 9:
        row.wrong("a row has a name, α, β, distance, and three to five numbers of σ and height")
        return
    before = row.file.problems.count
    alpha, beta, distance = (row.number_at(i, "a coordinate") for i in (1, 2, 3))
    rest = [row.number_at(i, "σ") for i in range(4, len(row.words))]
    if row.file.problems.count > before:
        return
    of_angle, angle_rel = rest[0], rest[1] if len(rest) > 3 else 0.0
    of_distance, distance_rel = rest[2:4] if len(rest) > 3 else rest[1:3]
    if len(rest) == 5 and rest[4] != 0.0:
        row.wrong("a height of the target in a sub-frame is not read: give another point")
    if angle_rel > 0 and not distance > 0:
        row.wrong("σ_rel of the angles needs the distance")
    if row.file.problems.count > before:
        return
    made = []
    if min(of_angle, of_distance) <= 0:
        row.switched_off()
    more = {"source": row.source}
    if of_angle > 0:
        sigma = of_angle * GON + (angle_rel / distance if angle_rel else 0.0)
        direction = (math.pi / 2 - alpha * GON) % (2 * math.pi)
        made.append(
            row.attempt(FrameDirection, frame, row.words[0], direction, sigma=sigma, **more)
        )
        zenith = math.pi / 2 - beta * GON
        made.append(row.attempt(FrameZenith, frame, row.words[0], zenith, sigma=sigma, **more))
    if of_distance > 0:
        sigma = of_distance + distance_rel * distance
        made.append(row.attempt(FrameDistance, frame, row.words[0], distance, sigma=sigma, **more))
    _add_set_observation(network, row, *made)


# -- axes of rotation (code 18) ------------------------------------------------------------------


def add_axis(files: Comp3dFiles, network: Network, line: Comp3dLine) -> None:
    """Add an axis of rotation: code, name of a point on it, @file with its targets.

    Rows: target, position, point, σ of the radius, σ along the axis. Each target has a radius and a
    place along the axis. A row ``L point`` says only where on the axis its own point is.
    """
    if len(line.words) != 3:
        line.wrong("an axis of rotation has a code, a point, @file")
        return
    name = line.words[1]
    if name in network.frames:
        what = "is there already: axes that intersect in a point are not read"
        line.wrong(f"axis {name[:40]!r} {what}")
        return
    targets: dict[str, list[tuple[Comp3dLine, float, float]]] = {}
    for row in _rows(files, line, 2):
        if row.words[0] == "L" and len(row.words) == 2:
            continue
        if len(row.words) != 5:
            row.wrong("a row has target, position, point, σ of the radius, σ along the axis")
            continue
        before = row.file.problems.count
        radial, axial = (row.number_at(i, "σ") for i in (3, 4))
        if row.words[2] not in network.points:
            row.wrong(f"unknown point {row.words[2][:40]!r}")
        if row.file.problems.count > before:
            continue
        if min(radial, axial) <= 0:
            row.switched_off()
        else:
            targets.setdefault(row.words[0], []).append((row, radial, axial))
    rows = [r for of in targets.values() for r in of]
    if not rows:
        line.wrong(f"axis {name[:40]!r} has no targets")
        return
    places = np.array([network.points[r.words[2]].coordinates for r, _, _ in rows])
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        line.wrong(f"axis {name[:40]!r} needs coordinates of its targets")
        return
    line.attempt(
        network.add_shape,
        name,
        "circle",
        origin=places.mean(axis=0).tolist(),
        free=("rx", "ry", "x", "y"),
        values={"z": 0.0},
    )
    for number, (target, of) in enumerate(targets.items()):
        height = f"{name} height {target}"
        radius = None if number == 0 else f"{name} radius {target}"
        line.attempt(network.set_size, height)
        if radius is not None:
            line.attempt(network.set_size, radius)
        for row, radial, axial in of:
            made = row.attempt(
                OnCircle,
                name,
                row.words[2],
                sigma=(axial, radial),
                height=height,
                radius=radius,
                source=row.source,
            )
            _add_set_observation(network, row, made)


# -- GNSS baselines (code 19) --------------------------------------------------------------------


def add_baselines(files: Comp3dFiles, network: Network, line: Comp3dLine) -> None:
    """Add baselines: code, their start, @file, [factor K of standard deviations, [height]].

    Rows: target ΔX ΔY ΔZ, the upper half of their covariance, geocentric, [height of the target].
    """
    frame = network.frame
    if not 3 <= len(line.words) <= 5:
        line.wrong("baselines have a code, a start, @file, a factor and a height or none")
        return
    if not isinstance(frame, TopocentricFrame):
        line.wrong("baselines need a place on the ellipsoid: earth='ellipsoid'")
        return
    factor = line.number_at(3, "K", above=0.0) if len(line.words) > 3 else 1.0
    height = line.number_at(4, "the height") if len(line.words) > 4 else 0.0
    zero = frame.from_geocentric(np.zeros((1, 3)))
    # Steps of the size of the Earth, whose differences keep all digits.
    turn = (frame.from_geocentric(EARTH_SCALE_M * np.eye(3)) - zero).T / EARTH_SCALE_M
    for row in _rows(files, line, 2):
        if len(row.words) not in (10, 11):
            row.wrong("a row has target, ΔX ΔY ΔZ, σXX σXY σXZ σYY σYZ σZZ, and a height or none")
            continue
        before = row.file.problems.count
        numbers = [row.number_at(i, "a number") for i in range(1, len(row.words))]
        if row.file.problems.count > before:
            continue
        xx, xy, xz, yy, yz, zz = numbers[3:9]
        if min(xx, yy, zz) < 0:
            row.switched_off()
            continue
        covariance = (
            factor**2 * turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        )
        made = row.attempt(
            GnssVector,
            line.words[1],
            row.words[0],
            tuple((turn @ numbers[:3]).tolist()),
            covariance=(covariance + covariance.T) / 2,
            instrument_height=height,
            target_height=numbers[9] if len(numbers) > 9 else 0.0,
            source=row.source,
        )
        _add_set_observation(network, row, made)


# -- equal distances and heights (codes 21, 22) --------------------------------------------------


def add_equalities(files: Comp3dFiles, network: Network, line: Comp3dLine) -> None:
    """Add pairs of points with one unknown distance or height difference: code, @file.

    Rows: two points and the σ of their value. n pairs are n − 1 differences of neighbours, which
    are correlated by what they share: the unknown value is eliminated.
    """
    if len(line.words) > 3:
        line.wrong("equal distances or height differences have a code, @file, a number or none")
    elif len(line.words) == 3:
        line.number_at(2, "the number behind @file, which has no part in the observation")
    pairs = []
    for row in _rows(files, line, 1):
        if len(row.words) != 3:
            row.wrong("a row has two points and σ")
            continue
        sigma = row.number_at(2, "σ")
        if sigma > 0:
            pairs.append((row, sigma))
        elif sigma == 0:
            row.wrong("σ must be > 0, or negative for a pair that takes no part")
        elif sigma < 0:
            row.switched_off()
    if len(pairs) < 2:
        if pairs:
            line.wrong("one pair alone is equal to nothing")
        return
    members = [
        first.attempt(
            EQUALITY_KINDS[line.words[0]],
            *first.words[:2],
            *second.words[:2],
            sigma=1.0,
            source=first.source,
        )
        for (first, _), (second, _) in pairwise(pairs)
    ]
    if any(m is None for m in members):
        return
    variances = np.array([s**2 for _, s in pairs])
    differences = np.eye(len(pairs))[:-1] - np.eye(len(pairs), k=1)[:-1]
    covariance = differences @ np.diag(variances) @ differences.T
    if len(members) == 1:
        row, sigma = pairs[0][0], float(np.sqrt(covariance[0, 0]))
        names = (*pairs[0][0].words[:2], *pairs[1][0].words[:2])
        made = row.attempt(EQUALITY_KINDS[line.words[0]], *names, sigma=sigma, source=row.source)
        _add_set_observation(network, row, made)
        return
    _add_set_observation(network, line, line.attempt(Correlated, tuple(members), covariance))
