"""A block for Ayeni's methods: three strips over hills, with film and lens that deform images.

Ayeni (1980) does not prescribe it. The camera is one of 1980: principal distance 153 mm, format
23 cm, photo scale 1 : 10 000, overlap 60 per cent along and 30 per cent across. Its images have
the systematic errors of an Ebner model with the image base of 92 mm, up to 8 µm each, which only
some of the methods can remove.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.orthogonal_lens import EbnerLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Azimuth, Observation, ProfileHeight, SlopeDistance
from factorgraph_adj.rotation import exp_rotation, world_R_camera
from factorgraph_adj.simulation.measurement import Seed, disturb, measure
from factorgraph_adj.types import Array, Index

FOCAL, FORMAT = 153.0, 230.0
"""Principal distance and side of a photo, mm."""
HEIGHT = 1530.0
"""Flying height, metres."""
RELIEF = 60.0
"""Amplitude of the terrain, metres."""
STRIPS, PHOTOS = 3, 7
"""Numbers of strips, and of photos in a strip."""
BASE, SPACING = 920.0, 1610.0
"""Distances of photos along a strip and of strips, metres."""
GRID = (460.0, 402.5)
"""Distances of points along and across the strips, metres."""
COMPARATOR, PLOTTER = 0.005, 0.010
"""Standard deviations of image coordinates in a comparator, and in a stereoplotter, mm."""
IMAGE_BASE = 92.0
"""Image base of the Ebner model, mm."""
SYSTEMATIC = 0.008
"""Largest systematic error of each term, mm."""
SIGMA_DISTANCE, SIGMA_AZIMUTH = 0.02, 5e-5
"""Standard deviations of distances, metres, and of azimuths, radians."""
SIGMA_STATOSCOPE, SIGMA_TILT = 0.5, 2e-4
"""Standard deviations of statoscope readings, metres, and of tilts of photos, radians."""
CAMERA = "camera"


@dataclass(frozen=True, eq=False)
class MethodBlock:
    """A block with the data that the methods use."""

    network: Network
    """Photos measured in a comparator, control held, check points with known coordinates."""
    plotter: Network
    """The same photos as a stereoplotter measures them."""
    terrestrial: tuple[Observation, ...] = ()
    """Distances and azimuths between control points."""
    statoscope: tuple[ProfileHeight, ...] = ()
    """Heights of photos from a statoscope, a profile for each strip."""
    tilts: Mapping[str, Array] = field(default_factory=dict)
    """Attitudes (3, 3), world_R_camera, by photo, of which the tilts were measured."""
    image_base: float = IMAGE_BASE
    """Image base of the Ebner model, image units."""


def simulated_block(seed: Seed = 1980) -> MethodBlock:
    """Return the simulated block; errors of measurement follow from the seed."""
    rng = np.random.default_rng([1980, 1])
    x = np.arange(-GRID[0], BASE * (PHOTOS - 1) + 1.5 * GRID[0], GRID[0])
    # No row of points lies below the photos of a strip: radial directions do not meet there.
    y = np.arange(-2.5 * GRID[1], SPACING * (STRIPS - 1) + 3.0 * GRID[1], GRID[1])
    grid = np.array([(a, b) for a in x for b in y]) + rng.uniform(-60, 60, (len(x) * len(y), 2))
    heights = RELIEF * np.sin(grid[:, 0] / 700.0) * np.cos(grid[:, 1] / 550.0)
    ground = np.column_stack([grid, heights])
    plan, seen = _photos(ground, rng)
    control = _control(ground, seen)
    for i in np.flatnonzero(seen).tolist():
        at = tuple(ground[i].tolist())
        name = f"P{i}"
        held = i in control
        p = plan.points[name]
        plan.points[name] = replace(p, fixed=(held,) * 3, check=None if held else at)
    lines = _lines(ground, control)
    told = plan.copy()
    for a, b in lines:
        told.add(SlopeDistance(f"P{a}", f"P{b}", 1.0, sigma=SIGMA_DISTANCE))
        told.add(Azimuth(f"P{a}", f"P{b}", 0.0, sigma=SIGMA_AZIMUTH))
    terrestrial = tuple(measure(told, seed=seed).observations.values())
    read = [read_images(plan, sigma, seed + k) for k, sigma in enumerate((COMPARATOR, PLOTTER))]
    return MethodBlock(read[0], read[1], terrestrial, *_flown(plan, seed))


def _flown(plan: Network, seed: Seed) -> tuple[tuple[ProfileHeight, ...], dict[str, Array]]:
    """Return measurements of a statoscope and a horizon camera: heights by strip, attitudes."""
    rng = np.random.default_rng([seed, 14])
    surface = rng.normal(0.0, [20.0, 2.0], (STRIPS, 2))
    heights, tilts = [], {}
    for name, photo in plan.photos.items():
        strip, k = (int(n) for n in name.split("."))
        t = float(k - (PHOTOS + 1) / 2)
        assert photo.position is not None
        assert photo.rotation is not None
        a, b = surface[strip - 1]
        value = photo.position[2] - a - b * t + rng.normal(0.0, SIGMA_STATOSCOPE)
        heights.append(
            ProfileHeight(
                None, float(value), photo=name, sigma=SIGMA_STATOSCOPE, profile=f"{strip}", time=t
            )
        )
        turn = np.array([[*rng.normal(0.0, SIGMA_TILT, 2), 0.0]])
        tilts[name] = photo.rotation @ exp_rotation(turn)[0]
    return tuple(heights), tilts


def _photos(ground: Array, rng: np.random.Generator) -> tuple[Network, Array]:
    """Return a plan with photos and true image points, and how many photos see each point."""
    plan = Network("simulated block")
    lens = EbnerLens(image_base=IMAGE_BASE)
    names = lens.names[3:]
    errors = rng.uniform(-SYSTEMATIC, SYSTEMATIC, len(names))
    values = {"c": FOCAL} | dict(zip(names, errors.tolist(), strict=True))
    plan.add_camera(CAMERA, lens, values)
    rays: list[tuple[str, Index]] = []
    count = np.zeros(len(ground), dtype=int)
    for s in range(STRIPS):
        for k in range(PHOTOS):
            at = np.array([k * BASE, s * SPACING, HEIGHT]) + rng.normal(0, 15, 3)
            rotation = world_R_camera(*np.deg2rad(rng.normal(0, 1.5, 3)))
            p = (ground - at) @ rotation
            xy = FOCAL * p[:, :2] / p[:, 2:]
            inside = np.flatnonzero(np.abs(xy).max(axis=1) < 0.48 * FORMAT)
            name = f"{s + 1}.{k + 1}"
            plan.add_photo(name, CAMERA, position=at.tolist(), rotation=rotation)
            rays.append((name, inside))
            count[inside] += 1
    kept = count >= 2
    for i in np.flatnonzero(kept).tolist():
        plan.add_point(f"P{i}", ground[i].tolist())
    for name, on_photo in rays:
        chosen = [f"P{i}" for i in on_photo.tolist() if kept[i]]
        plan.add_image_points(name, chosen, np.zeros((len(chosen), 2)), sigma=COMPARATOR)
    return plan, np.where(kept, count, 0)


def _control(ground: Array, seen: Array) -> list[int]:
    """Return the points nearest to a lattice of four by four, edges included, row by row."""
    on = np.flatnonzero(seen)
    low, high = ground[on, :2].min(axis=0), ground[on, :2].max(axis=0)
    found = []
    for y in np.linspace(low[1], high[1], STRIPS + 1):
        for x in np.linspace(low[0], high[0], 4):
            off = np.sum((ground[on, :2] - (x, y)) ** 2, axis=1)
            found.append(int(on[np.argmin(off)]))
    return found


def _lines(ground: Array, control: list[int]) -> list[tuple[int, int]]:
    """Return lines between neighbours in the lattice of control points."""
    along = [(control[i], control[i + 1]) for i in range(len(control) - 1) if i % 4 != 3]
    return along + [(control[i], control[i + 4]) for i in range(len(control) - 4)]


def read_images(plan: Network, sigma: float, seed: Seed, focal: float = FOCAL) -> Network:
    """Return the block as measured with a σ, mm: rough start values, an ideal camera."""
    told = plan.copy()
    told.images.sigma = [np.full_like(s, sigma) for s in told.images.sigma]
    read = measure(told, seed=seed)
    read = disturb(read, seed=seed, points=3.0, centres=5.0, attitudes=float(np.deg2rad(0.2)))
    del read.cameras[CAMERA]
    read.add_camera(CAMERA, NoDistortion(), {"c": focal})
    return read
