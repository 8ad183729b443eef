"""Parts of readers of photo blocks: pixel cameras, image points, left-out rows, matrices s R.

Programs that count pixels have the origin at a corner and y down. In a network image coordinates
are pixels with the origin at the upper left corner of the upper left pixel, x right and y up:
(column, −row). The centre of that pixel is (0.5, −0.5). The principal point follows: y0 is minus
the row.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...models.lens import Lens
from ...models.rolling_shutter import Towards
from ...network.network import Network
from ...types import Array
from ..numbers import MAX_NUMBER
from ..source import LeftOutReason, Problems

TIE_PREFIX = "tie "
"""Beginning of the names of tie points; their number in the file follows."""
MARKS_WITHOUT_PHOTO = LeftOutReason(
    "marks of known points", "their photos are not in the reconstruction", doubtful=True
)
RAYS_WITHOUT_PHOTO = LeftOutReason(
    "image points of tie points", "their photos are not in the network"
)
RAYS_WITHOUT_POINT = LeftOutReason("image points", "their tie points have no coordinates")
POINTS_WITH_FEW_RAYS = LeftOutReason("points", "fewer than two photos of the network see them")
POINTS_BEHIND_CAMERA = LeftOutReason("image points", "their points are behind the cameras")
PHOTOS_SWITCHED_OFF = LeftOutReason(
    "photos, points and readings", "they are switched off in the file"
)
PHOTOS_WITHOUT_POSE = LeftOutReason("photos", "they have no pose")


def add_pixel_camera(
    network: Network,
    name: str,
    lens: Lens,
    values: Mapping[str, float],
    *,
    size: tuple[float, float] | None,
    free: Iterable[str] = (),
    sigma: Mapping[str, float] | None = None,
    readout: tuple[float, Towards] | None = None,
) -> None:
    """Add a camera whose image coordinates are pixels from the upper left corner.

    Args:
        network: the network.
        name: name of the camera.
        lens: its lens model.
        values: calibration in pixels; x0 is the column, y0 minus the row of the principal point.
        size: width and height, pixels; None where unknown.
        free: names of the free parameters.
        sigma: standard deviations of the weighted parameters by name.
        readout: readout time of a rolling shutter, seconds, and the side to which it proceeds.
    """
    seconds: float | None
    towards: Towards
    seconds, towards = (None, "down") if readout is None else readout
    network.add_camera(
        name,
        lens,
        values,
        free=free,
        sigma=sigma,
        unit="px",
        format=size,
        origin="upper left",
        y_down_in_files=True,
        readout=seconds,
        readout_towards=towards,
    )


def filled_lines(text: str) -> Iterator[tuple[int, str]]:
    """Iterate over the lines of a text that are not blank: number from 1, and text."""
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip():
            yield number, line


@dataclass
class ImagePoints:
    """Image coordinates of many photos, gathered in rows and added to a network in columns."""

    problems: Problems
    """Where problems go."""
    rows: dict[str, list[tuple[str, float, float, float, float, str]]] = field(default_factory=dict)
    """Point, x, y, σ of x, σ of y and source of the image points of each photo."""

    def add(
        self, photo: str, point: str, xy: Sequence[float], sigma: Sequence[float], source: str
    ) -> None:
        """Add an image point; x right, y up, image units."""
        row = (point, float(xy[0]), float(xy[1]), float(sigma[0]), float(sigma[-1]), source)
        self.rows.setdefault(photo, []).append(row)

    def seen(self) -> dict[str, int]:
        """Return the number of rays of each point."""
        count: dict[str, int] = {}
        for rows in self.rows.values():
            for row in rows:
                count[row[0]] = count.get(row[0], 0) + 1
        return count

    def leave_out(self, network: Network, names: Iterable[str]) -> None:
        """Take points out of the network, with their image points."""
        lost = set(names)
        for name in network.points:
            if name in lost:
                self.problems.leave_out(POINTS_WITH_FEW_RAYS, name)
        for photo, rows in self.rows.items():
            self.rows[photo] = [r for r in rows if r[0] not in lost]
        for name in lost:
            del network.points[name]
        network.point_number = {name: i for i, name in enumerate(network.points)}

    def into(self, network: Network) -> None:
        """Add all image points to a network that has their photos and points.

        Image points of photos or points that the network does not have, and a point that is
        measured twice in a photo, are problems.
        """
        for photo, rows in self.rows.items():
            first: dict[str, str] = {}
            kept = []
            for row in rows:
                point, *_, source = row
                if photo not in network.photos:
                    self.problems.wrong(f"unknown photo {photo!r}", source)
                elif point not in network.points:
                    self.problems.wrong(f"unknown point {point!r}", source)
                elif point in first:
                    what = f"point {point!r} is measured twice in photo {photo!r}, first in "
                    self.problems.wrong(what + first[point], source)
                elif not (row[3] > 0 and row[4] > 0):
                    self.problems.wrong("standard deviations must be greater than zero", source)
                else:
                    kept.append(row)
                first.setdefault(point, source)
            if not kept:
                continue
            begin = network.images.size
            table = np.array([row[1:5] for row in kept])
            names = [row[0] for row in kept]
            network.add_image_points(photo, names, table[:, :2], sigma=table[:, 2:])
            sources = {begin + i: row[5] for i, row in enumerate(kept) if row[5]}
            network.images.sources.update(sources)


def all_in_range(values: Array) -> bool:
    """Return whether all values are finite and no larger than `MAX_NUMBER`."""
    return bool(np.all(np.abs(values) <= MAX_NUMBER))  # False for NaN


def whole_number(text: object) -> int | None:
    """Return a whole number that is not negative; None if the text is none."""
    plain = str(text).strip()
    short = plain.isascii() and plain.isdigit() and len(plain) <= 19
    return int(plain) if short else None


def rotation_and_scale(matrix: Array) -> tuple[Array, float] | None:
    """Split a matrix s R into the rotation and the scale; None if it is none to 1e-4.

    Args:
        matrix: (3, 3).
    """
    if not all_in_range(matrix):
        return None
    u, d, vt = np.linalg.svd(matrix)
    scale = float(d.mean())
    if not scale > 0 or np.ptp(d) > 1e-4 * scale or np.linalg.det(u @ vt) < 0:
        return None
    return u @ vt, scale


def wkt_unit_length(wkt: str) -> float:
    """Return the number of metres of the unit of a local coordinate system in WKT; 1 if none."""
    at = wkt.upper().rfind("UNIT[")
    try:
        value = float(wkt[at:].split(",")[1].rstrip("] \n\t"))
    except (IndexError, ValueError):
        return 1.0
    return value if at >= 0 and math.isfinite(value) and value > 0 else 1.0
