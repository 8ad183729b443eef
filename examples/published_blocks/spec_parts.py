"""Blocks of published papers as parts of a spec."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from factorgraph_adj.errors import Problem
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import HeightDifference, SlopeDistance
from factorgraph_adj.simulation.generate.photo_blocks import Aerial
from factorgraph_adj.simulation.generate.scene import (
    MICROMETRE,
    Camera,
    Part,
    Scene,
    perimeter,
    round_lines,
)
from factorgraph_adj.simulation.parameters import number
from factorgraph_adj.units import MILLIMETRE

from .el_hakim_1986 import (
    SIGMA_AERIAL_TERRESTRIAL,
    SIGMA_TERRESTRIAL,
    aerial_1986_plan,
    close_range_1986_plan,
)
from .industry_1981 import industry_block_plan


def _isp_camera() -> Camera:
    return Camera(name="ISP", c_mm=152.0, sigma_um=5.0)


@dataclass(frozen=True)
class IspBlock(Part):
    """The part of the ISP test block of El-Hakim & Faig (1981), table 1.

    Printed: 25 photos with 9 points each, simulated; full and reduced control; three layouts of
    distances, directions, azimuths, vertical angles, levelling, astronomic latitude and
    longitude. All other data are not printed. Chosen here:

    - five strips of five photos, 60 % forward and 20 % side overlap, wide angle, c = 152 mm,
      230 × 230 mm, scale 1:10 000; image coordinates with σ 5 µm; heights within ± 50 m;
    - von Gruber's 3 × 3 points in each photo; the end photos of a strip have their third column
      within the overlap; the second photo also sees this column and then has 12 points;
    - control and terrestrial observations are separate: the spec states full or reduced control,
      and the terrestrial observations are other parts (docs/results/papers.md).
    """

    kind = "isp_1981"
    prefix: str = ""
    """Prefix of the names of points and photos."""
    scale: float = number(10_000.0, above=0)
    """Denominator of the photo scale."""
    relief: float = number(50.0, least=0)
    """Largest height of a point above and below zero, metres."""
    camera: Camera = field(default_factory=_isp_camera)
    """The camera."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        return self._block().problems(where)

    def add_to(self, scene: Scene) -> None:
        """Add camera, points and photos."""
        self._block().add_to(scene)

    def _block(self) -> Aerial:
        return Aerial(
            prefix=self.prefix,
            strips=5,
            photos_per_strip=5,
            scale=self.scale,
            relief=self.relief,
            camera=self.camera,
            points="von_gruber",
        )


@dataclass(frozen=True)
class IndustryBlock(Part):
    """Industry block of El-Hakim & Faig (1981), see `examples.published_blocks.industry_1981`.

    The block defines its own datum; a spec with this part alone needs no control.
    """

    kind = "industry_1981"
    photos: int = number(7, least=4, most=7)
    """Number of photos."""
    terrestrial: bool = True
    """Whether distances and levelling are used."""
    distances: int = number(150, least=35)
    """Number of taped distances."""
    sigma_um: float = number(6.0, above=0)
    """Standard deviation of image coordinates, µm."""

    def add_to(self, scene: Scene) -> None:
        """Put the block into the scene."""
        block = industry_block_plan(
            photos=self.photos,
            terrestrial=self.terrestrial,
            distances=self.distances,
            sigma_image=self.sigma_um * MICROMETRE,
        )
        taped = sum(o.kind == SlopeDistance.kind for o in block.observations.values())
        if self.terrestrial and taped < self.distances:
            scene.fail("distances", f"is {self.distances}, but there are only {taped} lines")
        _put(scene, block)


@dataclass(frozen=True)
class Aerial1986(Part):
    """The block of 52 photos of El-Hakim (1986), with its control.

    Distances and height differences run along the edge of the block, evenly spread.
    """

    kind = "aerial_1986"
    distances: int = number(0, least=0)
    """Number of distances."""
    height_differences: int = number(0, least=0)
    """Number of height differences."""
    sigma_terrestrial_mm: float = number(SIGMA_AERIAL_TERRESTRIAL / MILLIMETRE, above=0)
    """Standard deviation of both, mm."""
    own_control: bool = True
    """Whether the block's control is held: 20 points in X, Y, Z and 14 in Z; else the spec's is."""

    def add_to(self, scene: Scene) -> None:
        """Put the block into the scene."""
        names = _put(scene, aerial_1986_plan(control=self.own_control))
        _along_the_edge(
            scene, names, self.distances, self.height_differences, self.sigma_terrestrial_mm
        )


@dataclass(frozen=True)
class CloseRange1986(Part):
    """The block of four convergent photos of El-Hakim (1986), with its control.

    Distances and height differences run along the edge of the floor, evenly spread.
    """

    kind = "close_range_1986"
    distances: int = number(0, least=0)
    """Number of distances."""
    height_differences: int = number(0, least=0)
    """Number of height differences."""
    sigma_terrestrial_mm: float = number(SIGMA_TERRESTRIAL / MILLIMETRE, above=0)
    """Standard deviation of both, mm."""

    def add_to(self, scene: Scene) -> None:
        """Put the block into the scene."""
        names = _put(scene, close_range_1986_plan())
        _along_the_edge(
            scene, names, self.distances, self.height_differences, self.sigma_terrestrial_mm
        )


def _put(scene: Scene, block: Network) -> list[str]:
    """Add a whole plan to the plan of the scene; return the names of its points."""
    plan = scene.plan
    for what, mine, there in (
        ("point", block.points, plan.points),
        ("photo", block.photos, plan.photos),
        ("camera", block.cameras, plan.cameras),
    ):
        twice = [name for name in mine if name in there]
        if twice:
            scene.fail(
                "kind", f"{what} {twice[0]!r} exists already in an earlier part; put this one first"
            )
    for p in block.points.values():
        plan.add_point(p.name, p.coordinates)
        plan.points[p.name] = p
    plan.cameras |= block.cameras
    for f in block.photos.values():
        plan.add_photo(f.name, f.camera, position=f.position, rotation=f.rotation)
        plan.photos[f.name] = f
    photo, point, _, sigma = block.images.columns()
    photos, points = list(block.photos), list(block.points)
    for i in dict.fromkeys(photo.tolist()):
        rows = np.flatnonzero(photo == i)
        seen = [points[j] for j in point[rows].tolist()]
        plan.add_image_points(photos[i], seen, np.zeros((len(rows), 2)), sigma=sigma[rows])
    plan.add(*block.observations.values())
    scene.points.append(points)
    return points


def _along_the_edge(
    scene: Scene, names: list[str], distances: int, heights: int, sigma_mm: float
) -> None:
    """Add distances and height differences along the perimeter of points."""
    ring = [names[i] for i in perimeter(scene.coordinates(names)[:, :2])]
    sigma = sigma_mm * MILLIMETRE
    for kind, count, key in (
        (SlopeDistance, distances, "distances"),
        (HeightDifference, heights, "height_differences"),
    ):
        lines = round_lines(len(ring), count)
        if len(lines) < count:
            scene.fail(key, f"is {count}, but there are only {len(lines)} lines")
        scene.plan.add(*(kind(ring[i], ring[j], 0.0, sigma=sigma) for i, j in lines))
