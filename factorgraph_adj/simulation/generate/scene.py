"""Scene of a simulated network: base of its parts, cameras, photos; patterns of points, lines."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...errors import InputError, Problem, known
from ...models.lens import Lens
from ...models.lens_registry import LENSES
from ...network.network import Network
from ...types import Array, Index, Mask
from ..parameters import Parameters, number, path_of

MICROMETRE = 1e-3
"""Micrometre in millimetres, the unit of image coordinates."""
GEOMETRY = 2000
"""Tag of the streams of geometry. numpy pads seeds with zeros, [s, p, 0] is [s, p]: without a
unique tag, the first stream of part p would be the noise of the p-th kind."""
JITTER = 0.3
"""Largest shift of a point from its place in a jittered grid, as a fraction of the grid's width."""


@dataclass(frozen=True)
class Part(Parameters):
    """Base of the parts: blocks of photos, terrestrial networks, additions to them.

    A part adds points, photos and observations to the plan, with true values. Its geometry is
    drawn from a stream of its own, so that other parts of a spec do not change it.
    """

    def add_to(self, scene: Scene) -> None:
        """Add the part to the scene."""
        raise NotImplementedError


@dataclass
class Scene:
    """A plan to which parts are added one after the other."""

    plan: Network
    """The network with true values."""
    seed: int
    """Seed of the geometry."""
    points: list[list[str]] = field(default_factory=list)
    """Names of the points that each part has added up to now."""
    strips: dict[int, list[list[str]]] = field(default_factory=dict)
    """Photos of the strips that each part has flown, by its number, in the order of flight."""
    number: int = 0
    """Number of the current part."""
    failed: set[int] = field(default_factory=set)
    """Numbers of the parts that could not be added."""

    @property
    def where(self) -> str:
        """Path of the current part."""
        return path_of("parts", self.number)

    def rng(self, stream: int) -> np.random.Generator:
        """Return a stream of random numbers of the part."""
        return np.random.default_rng([self.seed, GEOMETRY, self.number, stream])

    def fail(self, key: str, what: str) -> None:
        """Raise InputError about a key of the part."""
        raise InputError(Problem(what, path_of(self.where, key)))

    def add_points(
        self, prefix: str, names: Sequence[str], coordinates: Array, *, fixed: str = ""
    ) -> list[str]:
        """Add points; return their names with the prefix.

        Raises:
            InputError: an earlier part has used a name.
        """
        full = [prefix + n for n in names]
        self.refuse_used(full, self.plan.points, "points")
        for name, xyz in zip(full, np.asarray(coordinates).tolist(), strict=True):
            self.plan.add_point(name, xyz, fixed=fixed)
        return full

    def photo_names(self, prefix: str, names: Sequence[str]) -> list[str]:
        """Return names of photos with the prefix; InputError if a name is used already."""
        full = [prefix + n for n in names]
        self.refuse_used(full, self.plan.photos, "photos")
        return full

    def refuse_used(self, names: list[str], used: Container[str], what: str) -> None:
        """Refuse names that an earlier part has used."""
        twice = [n for n in names if n in used]
        if twice:
            self.fail(
                "prefix",
                f"{what} {known(twice, most=4)} exist already in an earlier part; give this one "
                "another prefix",
            )

    def points_of(self, parts: Sequence[int]) -> list[str]:
        """Return the names of the points of earlier parts; ``parts`` empty means all of them.

        Raises:
            InputError: a part does not exist or has no points. The error lists no problem for a
                failed part, whose problems are known already.
        """
        chosen = self._earlier(parts)
        names = dict.fromkeys(n for p in chosen for n in self.points[p])
        if not names:
            self.fail("parts", "the earlier parts have no points")
        return list(names)

    def coordinates(self, names: Sequence[str]) -> Array:
        """Return true coordinates (n, 3) of points, metres."""
        return np.array([self.plan.points[n].coordinates for n in names]).reshape(-1, 3)

    def strips_of(self, parts: Sequence[int]) -> list[list[str]]:
        """Return the photos of the strips of earlier parts; ``parts`` empty means all of them.

        Photos of a part that is not flown in strips count as one strip; cameras that others carry
        are in none.

        Raises:
            InputError: as `points_of`.
        """
        chosen = self._earlier(parts)
        found = [strip for p in chosen for strip in self.strips.get(p, []) if strip]
        if not found:
            self.fail("parts", "the earlier parts have no photos")
        return found

    def note_photos(self, before: int) -> None:
        """Note the photos behind the first ``before`` as one strip, unless the part has strips."""
        new = list(self.plan.photos)[before:]
        self.strips.setdefault(self.number, [new])

    def _earlier(self, parts: Sequence[int]) -> list[int]:
        """Return numbers of earlier parts, all if none are asked for; refuse others."""
        wrong = [p for p in parts if not 0 <= p < self.number]
        if wrong:
            valid = f"0 to {self.number - 1}" if self.number else "none, it is the first"
            numbers = ", ".join(map(str, wrong))
            self.fail("parts", f"there is no earlier part {numbers}; valid: {valid}")
        chosen = parts or range(self.number)
        if self.failed & set(chosen):
            # The problems of the failed part are already listed.
            raise InputError([])
        return list(chosen)


def jittered_grid(low: Array, high: Array, spacing: float, rng: np.random.Generator) -> Array:
    """Return plan coordinates (n, 2) of a jittered grid that fills a rectangle, column by column.

    Args:
        low: smallest X and Y, metres.
        high: largest X and Y, metres.
        spacing: approximate width of the grid; the exact width is fitted to the rectangle.
        rng: generator of the shifts, up to `JITTER` of the width.
    """
    size = np.asarray(high) - low
    columns, rows = np.maximum(1, np.round(size / spacing)).astype(int)
    x, y = ((np.arange(n) + 0.5) / n for n in (columns, rows))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
    grid += rng.uniform(-JITTER, JITTER, grid.shape) / [columns, rows]
    return np.asarray(low + grid * size)


def corners(xy: Array) -> list[int]:
    """Return the numbers of the points (n, 2) nearest to the corners of their rectangle."""
    middle, half = (xy.max(0) + xy.min(0)) / 2, np.ptp(xy, axis=0) / 2
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return list(
        dict.fromkeys(int(np.argmin(np.sum((xy - middle - half * s) ** 2, axis=1))) for s in signs)
    )


def perimeter(xy: Array) -> list[int]:
    """Return the numbers of the points (n, 2) on the edge, in order around it.

    The rectangle of the points is divided into columns and rows as wide as the spacing of the
    points; the first and the last point of each column and row are on the edge. For a regular
    grid this is its edge. The order is by azimuth from the middle of the rectangle, anticlockwise
    from its lower left corner.
    """
    n = len(xy)
    size = np.maximum(np.ptp(xy, axis=0), 1e-9)
    width = np.maximum(np.sqrt(size.prod() / n), size.max() / n)
    cuts = np.clip(np.round(size / width).astype(int), 1, n)
    cell = np.minimum(((xy - xy.min(axis=0)) / size * cuts).astype(int), cuts - 1)
    chosen: set[int] = set()
    for across, along in ((0, 1), (1, 0)):
        for c in range(cuts[across]):
            inside = np.flatnonzero(cell[:, across] == c)
            if inside.size:
                t = xy[inside, along]
                chosen |= {int(inside[np.argmin(t)]), int(inside[np.argmax(t)])}
    # Scaling by the half sides avoids crowded azimuths at the ends of a long block.
    d = (xy - (xy.max(axis=0) + xy.min(axis=0)) / 2) / size
    turn = (np.arctan2(d[:, 1], d[:, 0]) + 0.75 * np.pi) % (2 * np.pi)
    return sorted(chosen, key=lambda i: (float(turn[i]), i))


def spread(xy: Array, count: int, first: list[int]) -> list[int]:
    """Return the numbers of ``count`` points (n, 2) that are far from one another.

    The first points are given; each further point is the one farthest from all chosen points.
    """
    chosen = first[:count]
    if not chosen:
        return []
    nearest = np.min(np.linalg.norm(xy[:, None] - xy[chosen], axis=2), axis=1)
    while len(chosen) < min(count, len(xy)):
        far = int(np.argmax(nearest))
        chosen.append(far)
        nearest = np.minimum(nearest, np.linalg.norm(xy - xy[far], axis=1))
    return sorted(chosen)


def round_lines(n: int, count: int) -> list[tuple[int, int]]:
    """Return ``count`` lines along a ring of n places, evenly spread.

    The first n lines join neighbours; further lines join every second place, then every third. No
    pair is joined twice: at most n (n − 1) / 2 lines are possible.
    """
    lines: dict[tuple[int, int], None] = {}
    for step in range(1, n // 2 + 1):
        # For a step of half the ring, the second half repeats the lines of the first, reversed.
        ring = [(i, (i + step) % n) for i in range(n // 2 if 2 * step == n else n)]
        missing = count - len(lines)
        chosen = (
            ring
            if missing >= len(ring)
            else [ring[k * len(ring) // missing] for k in range(missing)]
        )
        lines |= dict.fromkeys(chosen)
        if len(lines) >= count:
            break
    return list(lines)


def nearest_lines(xyz: Array, count: int) -> list[tuple[int, int]]:
    """Return ``count`` short lines between points (n, 3).

    First, each point is joined to its nearest one, up to ``count`` lines; then the shortest of
    all other lines follow.
    """
    length = np.linalg.norm(xyz[:, None] - xyz[None, :], axis=2)
    np.fill_diagonal(length, np.inf)
    near: Index = np.argmin(length, axis=1)
    own = {(min(i, int(j)), max(i, int(j))): None for i, j in enumerate(near)}
    lines = dict(sorted(own.items(), key=lambda item: float(length[item[0]])))
    i, j = np.triu_indices(len(xyz), 1)
    order = np.argsort(length[i, j], kind="stable")
    for a, b in zip(i[order].tolist(), j[order].tolist(), strict=True):
        if len(lines) >= count:
            break
        lines[a, b] = None
    return list(lines)[:count]


LensName = Literal[
    "none",
    "harmonic",
    "brown",
    "brown_forward",
    "normalised",
    "balanced",
    "affine",
    "ebner",
    "gruen",
]


@dataclass(frozen=True)
class Camera(Parameters):
    """A camera: true calibration, free parameters, and σ of image coordinates."""

    name: str = "camera"
    """Name of the camera; parts with equal cameras share one camera."""
    c_mm: float = number(153.0, above=0)
    """Principal distance, mm."""
    format_mm: tuple[float, float] = number((230.0, 230.0), above=0)
    """Width and height of the photos, mm."""
    x0_mm: float = 0.0
    """x of the principal point, mm."""
    y0_mm: float = 0.0
    """y of the principal point, mm."""
    lens: LensName = "none"
    """Lens model of the adjustment."""
    lens_options: Mapping[str, float] = field(default_factory=dict)
    """Options of the lens model, such as ``reference_radius``, mm."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """True additional parameters; absent parameters are 0."""
    free: tuple[str, ...] = ()
    """Calibration parameters to estimate."""
    sigma: Mapping[str, float] = field(default_factory=dict, metadata={"above": 0.0})
    """Standard deviations of weighted calibration parameters."""
    sigma_um: float = number(5.0, above=0)
    """Standard deviation of image coordinates, µm."""

    def made_lens(self) -> Lens:
        """Return the lens model with its options."""
        return LENSES[self.lens](**self.lens_options)

    def problems(self, where: str) -> list[Problem]:
        """Return the problems: options and parameters that are unknown in the lens model."""
        try:
            names = self.made_lens().names
        except TypeError:
            valid = known(LENSES[self.lens].__dataclass_fields__)
            what = f"lens {self.lens!r} does not take these; valid: {valid}"
            return [Problem(what, path_of(where, "lens_options"))]
        except InputError as error:
            return [Problem(str(error), path_of(where, "lens_options"))]
        asked = {"parameters": self.parameters, "free": self.free, "sigma": self.sigma}
        return [
            Problem(
                f"unknown calibration parameter {n!r} of lens {self.lens!r}; valid: "
                f"{known(names, meant=n, most=40)}",
                path_of(where, key),
            )
            for key, given in asked.items()
            for n in given
            if n not in names
        ]

    def add_to(self, scene: Scene) -> None:
        """Add the camera to the plan if the plan lacks it."""
        values = {"c": self.c_mm, "x0": self.x0_mm, "y0": self.y0_mm, **self.parameters}
        alone = Network()
        alone.add_camera(self.name, self.made_lens(), values, free=self.free, sigma=self.sigma)
        there = scene.plan.cameras.setdefault(self.name, alone.cameras[self.name])
        if there != alone.cameras[self.name]:
            scene.fail(
                "camera.name",
                f"an earlier part has another camera {self.name!r}; give this one another name",
            )

    def sees(self, points: Array, at: Array, rotation: Array) -> Mask:
        """Return the mask (n,) of the points (n, 3) on a photo."""
        return in_view(points, at, rotation, self.c_mm, self.format_mm)


def in_view(
    points: Array, at: Array, rotation: Array, c: float, plate: tuple[float, float]
) -> Mask:
    """Return the mask (n,) of the points (n, 3) in front of a camera and on its plate.

    Args:
        points: coordinates, metres.
        at: projection centre, metres.
        rotation: world_R_camera.
        c: principal distance, mm.
        plate: width and height, mm.
    """
    p = (points - at) @ rotation
    on = np.all(np.abs(p[:, :2] / p[:, 2:]) < np.array(plate) / 2 / c, axis=1)
    return np.asarray(on & (p[:, 2] > 0))


def add_photo(
    scene: Scene,
    name: str,
    camera: Camera,
    at: Array,
    rotation: Array,
    points: Sequence[str],
) -> None:
    """Add a photo and its image points to the plan."""
    plan = scene.plan
    plan.add_photo(name, camera.name, position=at.tolist(), rotation=rotation)
    xy = np.zeros((len(points), 2))
    plan.add_image_points(name, list(points), xy, sigma=camera.sigma_um * MICROMETRE)
