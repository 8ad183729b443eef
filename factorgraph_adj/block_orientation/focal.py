"""Principal distances that are tried where the calibration of a camera is only a guess."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..types import Array
from .dlt import dlt
from .robust_poses import shared_principal_distance
from .views import Views

FACTORS = (1.0, 0.7, 1.4, 0.5, 2.0, 0.35, 2.8, 4.0)
"""Principal distances that are tried, parts of the longer side of the image: angles of view from
110° to 14°."""
LEAST_KNOWN = 8
"""Smallest number of known points of a photo that tell a principal distance."""
MOST_PAIRS = 40
"""Largest number of pairs whose principal distance is asked for."""
LEAST_LIMIT = 2e-3
"""Smallest limit of the distance from epipolar lines, part of the longer side: what distortion that
is not known leaves."""
SHORTEST, LONGEST = 0.2, 8.0
"""Bounds of principal distances, parts of the longer side."""
NEAR = 0.05
"""Relative change of a principal distance that is worth telling."""


@dataclass(frozen=True, eq=False)
class Distances:
    """Calibrations with which a block may start."""

    views: Views
    """The image points."""
    stated: Mapping[str, Sequence[float]]
    """Principal distances by camera that are tried in the place of the given one."""
    known: Array
    """Known coordinates of points, (points, 3), NaN where unknown: they tell a principal distance
    by a direct linear transformation."""

    def first(self) -> tuple[Array, ...]:
        """Return the calibrations to begin with."""
        return self._with({n: float(values[0]) for n, values in self.stated.items()})

    @property
    def guessed(self) -> tuple[str, ...]:
        """Cameras whose principal distance may be another: stated, or free and not weighted."""
        return tuple(
            c.name
            for c in self.views.cameras
            if c.name in self.stated or not (c.fixed[0] or np.isfinite(c.sigma[0]))
        )

    def others(self) -> Iterator[tuple[Array, ...]]:
        """Iterate over further calibrations: those that were stated, or multiples of the format.

        Cameras change together: those with stated values take them in order, those whose principal
        distance is free and not weighted take a multiple of the longer side of their image.
        """
        most = max((len(v) for v in self.stated.values()), default=0)
        for i in range(1, most):
            yield self._with({n: float(v[min(i, len(v) - 1)]) for n, v in self.stated.items()})
        guessed = {n: self._longer_side(n) for n in self.guessed if n not in self.stated}
        if guessed and not most:
            for way in (self._by_control, self.by_pairs):
                if found := {n: c for n in guessed if (c := way(n)) is not None}:
                    yield self._with(found)
            for factor in FACTORS:
                yield self._with({n: factor * side for n, side in guessed.items()})

    def found(self, calibrations: tuple[Array, ...]) -> dict[str, float]:
        """Return the principal distances that differ from the given ones, by camera."""
        return {
            c.name: float(values[0])
            for c, values in zip(self.views.cameras, calibrations, strict=True)
            if abs(values[0] / c.values[0] - 1.0) > NEAR
        }

    def _with(self, distances: Mapping[str, float]) -> tuple[Array, ...]:
        out = []
        for camera in self.views.cameras:
            values = np.array(camera.values)
            values[0] = distances.get(camera.name, values[0])
            out.append(values)
        return tuple(out)

    def _by_control(self, name: str) -> float | None:
        """Return the median principal distance of photos with known points; none: too few."""
        v = self.views
        seen = self.known[v.point]
        there = np.isfinite(seen).all(axis=1) & (v.camera == self._number(name))
        found = []
        for photo in np.unique(v.photo[there]).tolist():
            rows = np.flatnonzero(there & (v.photo == photo))
            if len(rows) < LEAST_KNOWN:
                continue
            with suppress(InputError):
                found.append(dlt(seen[rows], v.xy[rows]).calibration["c"])
        side = self._longer_side(name)
        found = [c for c in found if SHORTEST < c / side < LONGEST]
        return float(np.median(found)) if found else None

    def by_pairs(self, name: str) -> float | None:
        """Return the median principal distance of pairs of photos of a camera; none: no pair."""
        v = self.views
        number = self._number(name)
        side, at = self._longer_side(name), np.array(v.cameras[number].values[1:3])
        table = v.table(v.camera == number)
        common = (table @ table.T).tocoo()
        upper = common.row < common.col
        order = np.argsort(-common.data[upper], kind="stable")[:MOST_PAIRS]
        limit = max(3.0 * float(np.median(v.sigma[v.camera == number])) / side, LEAST_LIMIT)
        found = []
        for a, b in zip(common.row[upper][order], common.col[upper][order], strict=True):
            rows = [np.flatnonzero(v.photo == photo) for photo in (a, b)]
            _, *own = np.intersect1d(v.point[rows[0]], v.point[rows[1]], return_indices=True)
            xy = [(v.xy[r[i]] - at) / side for r, i in zip(rows, own, strict=True)]
            c = shared_principal_distance(xy[0], xy[1], limit=limit)
            if c is not None and SHORTEST < c < LONGEST:
                found.append(c)
        return side * float(np.median(found)) if found else None

    def _number(self, name: str) -> int:
        return [c.name for c in self.views.cameras].index(name)

    def _longer_side(self, name: str) -> float:
        """Return the longer side of the format, or of what the image points cover."""
        number = self._number(name)
        camera = self.views.cameras[number]
        if camera.format is not None:
            return float(max(camera.format))
        own = self.views.xy[self.views.camera == number]
        covered = float(np.ptp(own, axis=0).max()) if len(own) else 0.0
        return covered if covered > 0.0 else float(camera.values[0])
