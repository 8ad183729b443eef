"""The two blocks of El-Hakim (1986) that show the effect of terrestrial observations.

The paper prints no coordinates, but table 1 gives indirect information: e2, the part of an error
that changes the point, depends only on the rays of the point.

**Aerial block**: 52 vertical photos, 60 % forward and 20 % side overlap, nearly flat terrain,
dense points. Chosen here:

- four strips of 13 photos along X, every second one flown backwards; each begins at another
  fraction of the base, otherwise the points between two strips would have 4 or 6 rays and
  seldom 5. Centres vary by 3 % of the base, attitudes by 1°;
- a wide-angle camera, c = 153 mm, plates of 230 × 230 mm, without distortion; scale 1:4400 like
  the paper's other aerial block, hence H = 673 m, base 405 m; σ of image coordinates 5 µm;
- a jittered grid of points a sixth of a photo's side apart, about 34 in each photo: with this
  number, r of points with 5 and 6 rays is that of table 1. Heights within ± 10 m;
- held control: 7 × 5 points of the block without the central one, the 20 on the edge with X, Y, Z,
  the others with Z; these are the paper's 20 horizontal and 34 vertical control points.

**Close-range block**: four convergent photos "from the four corners" with a Wild P31. Chosen:

- 7 × 6 points on a floor of 15 × 15 m, two thirds at ± 5 cm, one third 0.5 to 2 m high;
- photos 10 m up at (± 5, ± 9) m from the middle, the x axis of the plates along X. Four rays
  from (± a, ± b, h) meet with e2_x = ¼ (1 + a²/(b² + h²) (b²/(a² + h²) + h²/(a² + b²))), which
  is 0.36 for a square; 0.31, as printed, needs a short base along x. r_x = 0 for two rays means
  that these come from the two photos of one base, whose epipolar lines run along x;
- each pair therefore covers the edge beneath the other pair, which that pair cannot see. A tenth
  of the sights is hidden, but only of points in all four photos, which keep three rays;
- c = 100 mm, plates of 120 × 90 mm, no distortion; σ of image coordinates 6 µm, with which
  `industry_block` shows the precision that the paper of 1981 prints;
- control in the four corners and terrestrial observations, σ 0.5 mm as in the paper.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from factorgraph_adj.models.lens import Lens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, HeightDifference, SlopeDistance
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.generate.scene import in_view
from factorgraph_adj.simulation.measurement import Seed, SimulatedNetwork, Truth, disturb, measure
from factorgraph_adj.types import Array, Mask
from factorgraph_adj.units import MILLIMETRE

MICROMETRE = 1e-3
"""Micrometre in millimetres, the unit of image coordinates."""
GEOMETRY = 1986
"""Seed of the geometry: every simulation has the same blocks."""
JITTER = 0.3
"""Largest shift of a point from its place in the grid, as a fraction of the grid's width."""
Line = tuple[str, str]
"""Names of two points."""

CAMERA = "camera"

# -- aerial block ------------------------------------------------------------------------------

STRIPS, IN_STRIP = 4, 13
"""Number of strips, and of photos in a strip; together 52 photos."""
AERIAL_C, AERIAL_PLATE = 153.0, (230.0, 230.0)
"""Principal distance, and format of the plates, mm."""
AERIAL_SCALE = 4400.0
SIDE = AERIAL_SCALE * AERIAL_PLATE[0] * MILLIMETRE
"""Side of a photo on the ground, metres."""
BASE, ACROSS = 0.4 * SIDE, 0.8 * SIDE
"""Distances between photos of a strip, and between strips, metres."""
FIRST = (0.0, 0.3, 0.6, 0.2)
"""Start of each strip along X, in bases."""
SPACING = SIDE / 6
"""Width of the grid of points, metres."""
RELIEF = 10.0
"""Largest height of a point above and below zero, metres."""
SIGMA_AERIAL = 5.0 * MICROMETRE
SIGMA_AERIAL_TERRESTRIAL = 5.0 * MILLIMETRE
"""σ of distances and height differences, metres: a quarter of an image coordinate's 22 mm on the
ground."""
CONTROL = (7, 5)
"""Numbers of control points along X and Y."""

# -- close-range block -------------------------------------------------------------------------

FLOOR = 15.0
"""Side of the floor, metres."""
GRID = (7, 6)
"""Numbers of points along X and Y."""
P31_C, P31_PLATE = 100.0, (120.0, 90.0)
"""Principal distance, and format of the plates, mm."""
CORNERS = ((-5.0, -9.0), (5.0, -9.0), (5.0, 9.0), (-5.0, 9.0))
"""Plan positions of the photos 1 to 4, metres from the middle of the floor."""
CRANE = 10.0
"""Height of the photos, metres."""
AIM = 0.1
"""Distance of the aims beyond the middle, as a fraction of the photos' distance from the middle."""
HIDDEN = 0.1
"""Fraction of the sights that is hidden."""
SIGMA_P31 = 6.0 * MICROMETRE
SIGMA_CONTROL = 0.5 * MILLIMETRE
SIGMA_TERRESTRIAL = 0.5 * MILLIMETRE


def simulate_aerial_1986(
    seed: Seed,
    *,
    distances: Iterable[Line] = (),
    height_differences: Iterable[Line] = (),
    sigma_terrestrial: float = SIGMA_AERIAL_TERRESTRIAL,
) -> SimulatedNetwork:
    """Simulate the measurements of the block of 52 photos.

    Points are named by column and row of the grid, ``"0412"`` is column 4, row 12; columns run
    along the strips. Photos are named ``"1/1"`` (strip, place in the strip) to ``"4/13"``.

    Args:
        seed: seed of measuring errors and approximate values; the block is always the same.
        distances: pairs of points with a measured slope distance.
        height_differences: pairs of points with a levelled height difference.
        sigma_terrestrial: standard deviation of both, metres.

    Returns:
        The network with approximate values (1 m for points, 2 m and 0.5° for photos), and the
        truth.
    """
    plan = aerial_1986_plan()
    _add_terrestrial(plan, distances, height_differences, sigma_terrestrial)
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=1.0, centres=2.0, attitudes=np.deg2rad(0.5)
    )
    return SimulatedNetwork(network, Truth.of(plan))


def aerial_1986_plan(*, control: bool = True) -> Network:
    """Return the block of 52 photos with true values, without terrestrial observations.

    Args:
        control: whether the 20 horizontal and 34 vertical control points are held.
    """
    rng = np.random.default_rng([GEOMETRY, 0])
    names, points = _terrain(rng)
    poses = _strips(rng)
    seen = [in_view(points, *pose, AERIAL_C, AERIAL_PLATE) for pose in poses.values()]
    used = np.sum(seen, axis=0) >= 2
    held = _control(points, used) if control else {}
    plan = Network("aerial block of 52 photos, simulated after El-Hakim 1986")
    for i in np.flatnonzero(used).tolist():
        plan.add_point(names[i], points[i], fixed=held.get(i, ""))
    plan.add_camera(CAMERA, Lens(), {"c": AERIAL_C})
    for (photo, (at, rotation)), inside in zip(poses.items(), seen, strict=True):
        plan.add_photo(photo, CAMERA, position=at.tolist(), rotation=rotation)
        _observe(plan, photo, names, inside & used, SIGMA_AERIAL)
    return plan


def edge_lines(network: Network) -> list[Line]:
    """Return 50 lines that join every second point of the aerial block's whole edge.

    The edge consists of the first and the last point of every column and every row of the grid.
    Lines are 200 to 600 m long, and up to 920 m around the ends of the strips.
    """
    columns: dict[str, list[str]] = {}
    rows: dict[str, list[str]] = {}
    for name in sorted(network.points):
        columns.setdefault(name[:2], []).append(name)
        rows.setdefault(name[2:], []).append(name)
    up, right = (list(dict(sorted(line.items())).values()) for line in (rows, columns))
    around = [column[0] for column in right] + [row[-1] for row in up]
    around += [column[-1] for column in right[::-1]] + [row[0] for row in up[::-1]]
    chosen = list(dict.fromkeys(around))[1::2]
    return list(zip(chosen, chosen[1:] + chosen[:1], strict=True))


def simulate_close_range_1986(
    seed: Seed,
    *,
    distances: Iterable[Line] = (),
    height_differences: Iterable[Line] = (),
    sigma_terrestrial: float = SIGMA_TERRESTRIAL,
) -> SimulatedNetwork:
    """Simulate the measurements of the block of four convergent photos.

    Points are named by column and row, ``"11"`` to ``"76"``; the points at the four corners are
    control points. Photos are named ``"1"`` to ``"4"``; bases along X join 1 and 2, 3 and 4.

    Args:
        seed: seed of measuring errors and approximate values; the block is always the same.
        distances: pairs of points with a measured slope distance.
        height_differences: pairs of points with a levelled height difference.
        sigma_terrestrial: standard deviation of both, metres.

    Returns:
        The network with approximate values (0.1 m for points, 0.3 m and 1° for photos), and the
        truth.
    """
    plan = close_range_1986_plan()
    _add_terrestrial(plan, distances, height_differences, sigma_terrestrial)
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=0.1, centres=0.3, attitudes=np.deg2rad(1.0)
    )
    return SimulatedNetwork(network, Truth.of(plan))


def close_range_1986_plan() -> Network:
    """Return the block of four photos with true values, without terrestrial observations."""
    rng = np.random.default_rng([GEOMETRY, 1])
    names, points = _floor(rng)
    plan = Network("close-range block of 4 photos, simulated after El-Hakim 1986")
    for name, xyz in zip(names, points, strict=True):
        plan.add_point(name, xyz)
    rows = GRID[1]
    for i in (0, rows - 1, len(names) - rows, len(names) - 1):
        plan.add(ControlPoint(names[i], tuple(points[i].tolist()), sigma=(SIGMA_CONTROL,) * 3))
    plan.add_camera(CAMERA, Lens(), {"c": P31_C})
    poses = [_looking_in(np.array([*corner, CRANE])) for corner in CORNERS]
    seen = np.array([in_view(points, *pose, P31_C, P31_PLATE) for pose in poses])
    hidden = rng.random(seen.shape) < HIDDEN
    hidden &= hidden.cumsum(axis=0) == 1
    seen &= ~(hidden & seen.all(axis=0))
    for i, ((at, rotation), inside) in enumerate(zip(poses, seen, strict=True), start=1):
        plan.add_photo(f"{i}", CAMERA, position=at.tolist(), rotation=rotation)
        _observe(plan, f"{i}", names, inside, SIGMA_P31)
    return plan


def _terrain(rng: np.random.Generator) -> tuple[list[str], Array]:
    """Return names and coordinates (n, 3), whole mm, of a jittered grid under the block."""
    end = np.array([BASE * (IN_STRIP - 1 + max(FIRST)), ACROSS * (STRIPS - 1)]) + SIDE / 2
    x, y = (np.arange(-SIDE / 2 + SPACING / 2, e, SPACING) for e in end)
    names = [f"{i:02d}{j:02d}" for i in range(1, len(x) + 1) for j in range(1, len(y) + 1)]
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
    grid += rng.uniform(-JITTER, JITTER, grid.shape) * SPACING
    return names, np.round(np.column_stack([grid, rng.uniform(-RELIEF, RELIEF, len(grid))]), 3)


def _strips(rng: np.random.Generator) -> dict[str, tuple[Array, Array]]:
    """Return position and world_R_camera of each photo of the aerial block."""
    height = AERIAL_C * MILLIMETRE * AERIAL_SCALE
    poses = {}
    for strip, first in enumerate(FIRST):
        for place in range(IN_STRIP):
            at = np.array([(place + first) * BASE, strip * ACROSS, height])
            at += rng.normal(0.0, 0.03 * BASE, 3)
            omega, phi, kappa = rng.normal(0.0, np.deg2rad(1.0), 3)
            rotation = world_R_camera(omega, phi, kappa + np.pi * (strip % 2))
            poses[f"{strip + 1}/{place + 1}"] = at, rotation
    return poses


def _control(points: Array, used: Mask) -> dict[int, str]:
    """Return the held coordinates of each control point, by its number."""
    low, high = points[used, :2].min(axis=0), points[used, :2].max(axis=0)
    columns, rows = CONTROL
    held = {}
    for i in range(columns):
        for j in range(rows):
            if (2 * i, 2 * j) == (columns - 1, rows - 1):
                continue
            place = low + (high - low) * [i / (columns - 1), j / (rows - 1)]
            far = np.where(used, np.sum((points[:, :2] - place) ** 2, axis=1), np.inf)
            edge = i in (0, columns - 1) or j in (0, rows - 1)
            held[int(np.argmin(far))] = "xyz" if edge else "z"
    return held


def _floor(rng: np.random.Generator) -> tuple[list[str], Array]:
    """Return names and coordinates (n, 3), whole mm, of the points of the close-range block."""
    columns, rows = GRID
    names = [f"{i}{j}" for i in range(1, columns + 1) for j in range(1, rows + 1)]
    x, y = (((np.arange(n) + 0.5) / n - 0.5) * FLOOR for n in GRID)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
    grid += rng.uniform(-JITTER, JITTER, grid.shape) * FLOOR / np.array(GRID)
    high = rng.random(len(grid)) < 1 / 3
    z = np.where(high, rng.uniform(0.5, 2.0, len(grid)), rng.uniform(-0.05, 0.05, len(grid)))
    return names, np.round(np.column_stack([grid, z]), 3)


def _looking_in(at: Array) -> tuple[Array, Array]:
    """Return position and world_R_camera of a close-range photo; its x axis is nearly along X."""
    z = at * [-AIM, -AIM, 0.0] - at
    z /= np.linalg.norm(z)
    x = np.array([1.0, 0.0, 0.0]) - z * z[0]
    x /= np.linalg.norm(x)
    return at, np.stack([x, np.cross(z, x), z], axis=1)


def _observe(plan: Network, photo: str, names: list[str], seen: Mask, sigma: float) -> None:
    chosen = [name for name, s in zip(names, seen, strict=True) if s]
    plan.add_image_points(photo, chosen, np.zeros((len(chosen), 2)), sigma=sigma)


def _add_terrestrial(
    plan: Network, distances: Iterable[Line], heights: Iterable[Line], sigma: float
) -> None:
    plan.add(
        *(SlopeDistance(a, b, 0.0, sigma=sigma) for a, b in distances),
        *(HeightDifference(a, b, 0.0, sigma=sigma) for a, b in heights),
    )
