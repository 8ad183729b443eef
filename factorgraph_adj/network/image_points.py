"""The image points of a network: added, joined in groups, iterated over, taken out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import cast

import numpy as np

from ..entities import ImageTable, JointImagePoints, Photo, Point
from ..observations import Correlated, ImagePoint
from ..types import Array, Index, Mask
from .construction import checked_image_points, required


class MeasuredImages:
    """Image points of a network; a base of `Network`."""

    images: ImageTable
    photos: dict[str, Photo]
    points: dict[str, Point]
    photo_number: dict[str, int]
    point_number: dict[str, int]

    def add_image_points(
        self,
        photo: str,
        points: Sequence[str],
        xy: Array,
        *,
        sigma: float | Sequence[float] | Array,
        correlation: float | Array = 0.0,
    ) -> None:
        """Add image coordinates of many points in one photo.

        Args:
            photo: name of the photo.
            points: n names.
            xy: measured coordinates, (n, 2), image units, x right, y up.
            sigma: one standard deviation, two for x and y, or (n, 2).
            correlation: correlation of x and y, one or (n,), between −1 and 1.
        """
        where = f"photo {photo!r}"
        required(photo, self.photos, "photo", where)
        measured, weights, rho = checked_image_points(
            photo, points, xy, sigma=sigma, correlation=correlation, known_points=self.point_number
        )
        number = np.array([self.point_number[p] for p in points], dtype=np.intp)
        of_photo = np.full(len(points), self.photo_number[photo], dtype=np.intp)
        self.images.append(of_photo, number, measured, weights, rho)

    def join_image_points(self, group: Correlated) -> list[str]:
        """Add correlated image points whose names have been checked; return their ids."""
        images = cast("tuple[ImagePoint, ...]", group.observations)
        rows = self.images.size + np.arange(len(images))
        self.images.take_over(ImageTable.of(images, self.photo_number, self.point_number))
        self.images.join(JointImagePoints(rows, np.asarray(group.covariance, dtype=float)))
        return [o.id or f"{o.photo}/{o.point}" for o in images]

    @property
    def n_image_points(self) -> int:
        """Number of image points."""
        return self.images.size

    def image_groups(self) -> Iterator[Correlated]:
        """Iterate over the image points with joint covariances, group by group."""
        for rows, covariance in self.images.joint:
            yield Correlated(tuple(self.image_points(rows)), covariance)

    def image_points(self, rows: Index | None = None) -> Iterator[ImagePoint]:
        """Iterate over the image points as observations; ``rows``: some of them, none: all."""
        photos, points = list(self.photos), list(self.points)
        rho = self.images.correlation
        chosen = np.arange(self.images.size) if rows is None else rows
        columns = (column[chosen] for column in self.images.columns())
        for row, f, p, xy, s in zip(chosen.tolist(), *columns, strict=True):
            yield ImagePoint(
                photos[f],
                points[p],
                float(xy[0]),
                float(xy[1]),
                sigma=(float(s[0]), float(s[1])),
                correlation=float(rho[row]),
                id=self.images.ids.get(row),
                source=self.images.sources.get(row),
            )

    def image_mask(self, keep: Mask) -> None:
        """Keep only the image points with ``keep`` (n,) true."""
        self.images = self.images.kept(keep)
