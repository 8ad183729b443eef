"""Simulation of the industry block of El-Hakim & Faig (1981) as described in the paper.

About 70 points of an industrial floor of 15 × 15 m; a Wild P31 (c = 100 mm, plates of
90 × 120 mm) on a crane at a height of about 10 m at the four corners, and again near three of
them; 150 taped distances and levelled heights, σ 0.5 mm each. The paper prints no coordinates.
Chosen here:

- a jittered grid of 10 × 7 points; two thirds lie on the floor (± 5 cm), one third on
  machines 0.5 to 2 m high, which hide 15 % of the sights; every point is visible in at least two
  of the first four photos;
- distances between 1 and 12 m; every point has at least one;
- levelling from one bench mark: the height difference to every other point;
- datum: the bench mark held in X, Y, Z and the opposite corner in Y; distances give the scale.
  Without terrestrial measurements, two opposite corners are held in X, Y, Z and a third in Z;
- a radial lens distortion that reaches the paper's 4 µm on the plates. A calibration
  certificate states the distortion with σ 4 µm, principal distance and principal point with
  σ 10 µm; these parameters are weighted unknowns;
- image coordinates with σ 6 µm. The stereocomparator alone measures with 2 to 3 µm; 6 µm include
  targets and plates, and give 95 % semi-major axes within 8 % of the four cases of table 2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factorgraph_adj.entities import Camera
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.lens import HarmonicLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import HeightDifference, SlopeDistance
from factorgraph_adj.simulation.generate.scene import in_view
from factorgraph_adj.simulation.measurement import (
    Seed,
    SimulatedNetwork,
    Truth,
    disturb,
    look_at,
    measure,
)
from factorgraph_adj.types import Array, Mask
from factorgraph_adj.units import MILLIMETRE

MICROMETRE = 1e-3
"""Micrometre in millimetres, the unit of image coordinates."""

GEOMETRY = 1981
"""Seed of points, hidden sights and taped lines: every simulation has the same block."""
SIDE = 15.0
"""Side of the square floor, metres."""
GRID = (10, 7)
"""Numbers of points along X and Y."""
PLATE = (120.0, 90.0)
"""Format of the plates, mm."""
SIGMA_TAPE = 0.5 * MILLIMETRE
SIGMA_LEVELLING = 0.5 * MILLIMETRE
TAPE = (1.0, 12.0)
"""Shortest and longest taped distance, metres."""
HIDDEN = 0.15
"""Fraction of the sights that machines hide."""

CAMERA = "P31"
LENS = HarmonicLens(reference_radius=60.0)
TRUE = {"c": 100.005, "x0": 0.007, "y0": -0.009, "a20": 2.4e-4, "a00": -2.484e-4}
"""True calibration, mm and dimensionless; a00 balances a20 over the plate."""
CERTIFICATE = {"c": 0.010, "x0": 0.010, "y0": 0.010} | dict.fromkeys(
    ("a20", "a22", "b22", "a31", "b31"), 7e-5
)
"""Standard deviations of the certificate, mm and dimensionless (7e-5 is 4 µm at 60 mm). Only these
parameters are estimated: a00 has the effect of c, a11 and b11 have a cusp at the centre, a33 and
b33 are held at 0."""

CORNERS = ("P01", "P10", "P70", "P61")
"""Points at the corners of the floor; the first is the bench mark."""
_DATUM_OF_LEVELLING = {CORNERS[0]: "xyz", CORNERS[2]: "y"}
_DATUM_OF_PHOTOS = {CORNERS[0]: "xyz", CORNERS[2]: "xyz", CORNERS[1]: "z"}

_CAMERAS = (
    # Projection centre and aim, metres from the centre of the floor.
    ((-9.4, -9.3, 10.1), (0.9, 1.0, 0.5)),
    ((9.2, -9.6, 9.8), (-1.0, 0.8, 0.5)),
    ((9.5, 9.3, 10.3), (-0.8, -1.0, 0.5)),
    ((-9.3, 9.5, 9.9), (1.0, -0.9, 0.5)),
    ((-7.8, -10.2, 9.3), (0.6, 0.9, 0.5)),
    ((10.2, -7.9, 10.6), (-1.0, 0.5, 0.5)),
    ((7.9, 10.1, 9.5), (-0.5, -1.1, 0.5)),
)
CONVERGENT = 4
"""Number of photos in the convergent block, the first four: one from each corner."""


def simulate_industry_block(
    seed: Seed,
    *,
    photos: int = len(_CAMERAS),
    terrestrial: bool = True,
    self_calibration: bool = True,
    distances: int = 150,
    sigma_image: float = 6.0 * MICROMETRE,
) -> SimulatedNetwork:
    """Simulate the measurements of the industry block.

    The cases of the paper's table 2 are (a) the defaults, (b) ``photos=4, terrestrial=False,
    self_calibration=False``, (c) as (b) with self-calibration, (d) as (c) with all photos. Equal
    seeds give equal image coordinates, distances and heights in all cases.

    Args:
        seed: seed of measuring errors and approximate values; the block is always the same.
        photos: number of photos, 4 to 7.
        terrestrial: whether distances and levelling are used.
        self_calibration: whether the calibration is estimated with the certificate as weighted
            values; otherwise c, x0, y0 are held and additional parameters are omitted.
        distances: number of taped distances; 35 or more, so that every point has one.
        sigma_image: standard deviation of image coordinates, mm.

    Returns:
        The network with approximate values (errors of 0.1 m for points, 0.3 m and 1° for
        photos), and the truth.
    """
    plan = industry_block_plan(
        photos=photos, terrestrial=terrestrial, distances=distances, sigma_image=sigma_image
    )
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=0.1, centres=0.3, attitudes=np.deg2rad(1.0)
    )
    if not self_calibration:
        network.cameras[CAMERA] = _without_additional_parameters(network.cameras[CAMERA])
    return SimulatedNetwork(network, Truth.of(plan))


def industry_block_plan(
    *,
    photos: int = len(_CAMERAS),
    terrestrial: bool = True,
    distances: int = 150,
    sigma_image: float = 6.0 * MICROMETRE,
) -> Network:
    """Return the industry block with true values; arguments as for `simulate_industry_block`."""
    if not CONVERGENT <= photos <= len(_CAMERAS):
        raise InputError(f"photos must be {CONVERGENT} to {len(_CAMERAS)}, not {photos}")
    points = _points()
    names = [f"P{i:02d}" for i in range(1, len(points) + 1)]
    plan = Network("industry block, simulated after El-Hakim & Faig 1981")
    held = _DATUM_OF_LEVELLING if terrestrial else _DATUM_OF_PHOTOS
    for name, xyz in zip(names, points, strict=True):
        plan.add_point(name, xyz, fixed=held.get(name, ""))
    plan.add_camera(CAMERA, LENS, TRUE, sigma=CERTIFICATE, format=PLATE)
    _add_photos(plan, names, points, photos, sigma_image)
    if terrestrial:
        plan.add(
            *(HeightDifference(CORNERS[0], p, 0.0, sigma=SIGMA_LEVELLING) for p in names[1:]),
            *(
                SlopeDistance(names[i], names[j], 0.0, sigma=SIGMA_TAPE)
                for i, j in _lines(points, distances)
            ),
        )
    return plan


def _without_additional_parameters(camera: Camera) -> Camera:
    """Return the camera held at its c, x0, y0 and without distortion."""
    n = len(camera.values)
    return replace(
        camera,
        values=camera.values[:3] + (0.0,) * (n - 3),
        fixed=(True,) * n,
        sigma=(np.inf,) * n,
    )


def _points() -> Array:
    """Return the points (70, 3), whole mm: a jittered grid on a floor with machines."""
    rng = np.random.default_rng([GEOMETRY, 0])
    columns, rows = GRID
    x, y = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    plan = SIDE * np.column_stack([x.ravel(), y.ravel()])
    plan += rng.uniform(-0.35, 0.35, plan.shape) * SIDE / np.array(GRID)
    n = len(plan)
    on_machine = rng.random(n) < 1 / 3
    height = np.where(on_machine, rng.uniform(0.5, 2.0, n), rng.uniform(-0.05, 0.05, n))
    return np.round(np.column_stack([plan, height]), 3)


def _add_photos(plan: Network, names: list[str], points: Array, photos: int, sigma: float) -> None:
    """Add the photos with the visible points on their plates."""
    centre = np.array([SIDE / 2, SIDE / 2, 0.0])
    seen = np.zeros((len(_CAMERAS), len(points)), dtype=bool)
    poses = []
    for i, (at, aim) in enumerate(_CAMERAS):
        position = centre + np.array(at)
        rotation = look_at(position, centre + np.array(aim))
        seen[i] = in_view(points, position, rotation, TRUE["c"], PLATE)
        poses.append((position, rotation))
    seen &= ~_hidden(seen)
    for i, (position, rotation) in enumerate(poses[:photos]):
        name = f"photo {i + 1}"
        plan.add_photo(name, CAMERA, position=position, rotation=rotation)
        chosen = [n for n, s in zip(names, seen[i], strict=True) if s]
        plan.add_image_points(name, chosen, np.zeros((len(chosen), 2)), sigma=sigma)


def _hidden(seen: Mask) -> Mask:
    """Draw the hidden sights (photos, points); each point keeps two of the first four photos."""
    rng = np.random.default_rng([GEOMETRY, 1])
    hidden = rng.random(seen.shape) < HIDDEN
    first = seen[:CONVERGENT]
    too_many = (first & ~hidden[:CONVERGENT]).sum(axis=0) < 2
    hidden[:CONVERGENT, too_many] = False
    return hidden


def _lines(points: Array, distances: int) -> list[tuple[int, int]]:
    """Draw the pairs of points with a taped distance; each point is in at least one pair."""
    rng = np.random.default_rng([GEOMETRY, 2])
    n = len(points)
    shortest, longest = TAPE
    length = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    possible = (length > shortest) & (length < longest)
    lines: dict[tuple[int, int], None] = {}
    alone = np.ones(n, dtype=bool)
    for i in rng.permutation(n).tolist():
        if alone[i]:
            others = possible[i] & alone if np.any(possible[i] & alone) else possible[i]
            j = int(rng.choice(np.flatnonzero(others)))
            lines[min(i, j), max(i, j)] = None
            alone[[i, j]] = False
    if len(lines) > distances:
        raise InputError(f"{distances} distances cannot reach {n} points; {len(lines)} can")
    rest = np.argwhere(np.triu(possible))
    for i, j in rng.permutation(rest).tolist():
        if len(lines) >= distances:
            break
        lines[i, j] = None
    return list(lines)
