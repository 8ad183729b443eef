"""Scale and datum of a block of images from whatever there is: each leads to the same minimum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.observation_selection import filtered
from factorgraph_adj.observations import (
    Azimuth,
    ControlPoint,
    Direction,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalDistance,
    Observation,
    PhotoBase,
    PhotoPosition,
    SlopeDistance,
    ZenithAngle,
)
from tests.networks.image_blocks import ImageBlock, aerial, ring

SAME = 1e-9
"""Relative difference of vᵀPv of two adjustments that end at one minimum."""
ANGLE = 1e-4
"""Standard deviation of observed angles, radians."""


class Seen:
    """Six points of a block that many photos see, and observations of them with errors."""

    def __init__(self, block: ImageBlock) -> None:
        self.block = block
        count = dict.fromkeys(block.network.points, 0)
        for i in block.network.image_points():
            count[i.point] += 1
        often = [n for n in count if count[n] >= 4]
        self.names = [often[i] for i in np.linspace(0, len(often) - 1, 6).astype(int)]
        self.x = np.array([block.points[int(n[1:])] for n in self.names])
        self.sigma = float(np.ptp(block.points, axis=0).max()) / 20_000
        self.rng = np.random.default_rng(0)

    def near(self, true) -> np.ndarray:
        return np.asarray(true) + self.rng.normal(0, self.sigma, np.shape(true))

    def distance(self, i: int, j: int) -> Observation:
        value = float(self.near(np.linalg.norm(self.x[i] - self.x[j])))
        return SlopeDistance(self.names[i], self.names[j], value, sigma=self.sigma)

    def horizontal(self, i: int, j: int) -> Observation:
        value = float(self.near(np.hypot(*(self.x[i] - self.x[j])[:2])))
        return HorizontalDistance(self.names[i], self.names[j], value, sigma=self.sigma)

    def height(self, i: int, j: int) -> Observation:
        value = float(self.near(self.x[j, 2] - self.x[i, 2]))
        return HeightDifference(self.names[i], self.names[j], value, sigma=self.sigma)

    def control(self, i: int, axes: str = "xyz") -> Observation:
        at = tuple(self.near(self.x[i])[["xyz".index(a) for a in axes]].tolist())
        return ControlPoint(self.names[i], at, axes=axes, sigma=(self.sigma,) * len(axes))

    def gnss(self, i: int) -> Observation:
        at = tuple(self.near(self.x[i]).tolist())
        return GnssPosition(self.names[i], at, sigma=(self.sigma,) * 3)

    def vector(self, i: int, j: int) -> Observation:
        d = tuple(self.near(self.x[j] - self.x[i]).tolist())
        return GnssVector(self.names[i], self.names[j], d, sigma=(self.sigma,) * 3)

    def centre(self, f: int) -> Observation:
        at = tuple(self.near(self.block.centres[f]).tolist())
        return PhotoPosition(f"F{f}", at, sigma=(self.sigma,) * 3)

    def base(self, f: int, g: int) -> Observation:
        value = float(self.near(np.linalg.norm(self.block.centres[f] - self.block.centres[g])))
        return PhotoBase(f"F{f}", f"F{g}", value, sigma=self.sigma)

    def azimuth(self, i: int, j: int) -> Observation:
        d = self.x[j] - self.x[i]
        value = self.angle(np.arctan2(d[0], d[1]))
        return Azimuth(self.names[i], self.names[j], value, sigma=ANGLE)

    def angle(self, true: float) -> float:
        return float((true + self.rng.normal(0, ANGLE)) % (2 * np.pi))

    def set_up(self, i: int, targets: Sequence[int], *, distances: bool) -> list[Observation]:
        out: list[Observation] = []
        for j in targets:
            d = self.x[j] - self.x[i]
            ends = self.names[i], self.names[j]
            out.append(Direction(*ends, self.angle(np.arctan2(d[0], d[1]) - 0.7), sigma=ANGLE))
            zenith = float(np.arccos(d[2] / np.linalg.norm(d)) + self.rng.normal(0, ANGLE))
            out.append(ZenithAngle(*ends, zenith, sigma=ANGLE))
            if distances:
                out.append(self.distance(i, j))
        return out

    def levelled(self) -> list[Observation]:
        return [self.height(i, i + 1) for i in range(5)]


Case = tuple[str, Callable[[Seen], list[Observation]], int, str]
CASES: dict[str, Case] = {
    "slope distances": ("free", lambda s: [s.distance(0, 3), s.distance(1, 4)], 6, "2 known len"),
    "horizontal distances": (
        "free",
        lambda s: [s.horizontal(0, 3), s.horizontal(1, 4)],
        5,
        "horizontal distance",
    ),
    "GNSS positions of points": ("given", lambda s: [s.gnss(i) for i in (0, 2, 4)], 0, "3 known p"),
    "GNSS positions of cameras": (
        "given",
        lambda s: [s.centre(f) for f in (0, 2, 3, 5)],
        0,
        "4 known projection centres",
    ),
    "GNSS vectors": (
        "free",
        lambda s: [s.vector(0, 1), s.vector(2, 3), s.vector(4, 5)],
        3,
        "3 gnss vector observations; 3 of 7 stay open",
    ),
    "two full control points and a height": (
        "given",
        lambda s: [s.control(0), s.control(4), s.control(2, "z")],
        0,
        "7 known coordinates of 3 places",
    ),
    "control in plan and in height": (
        "given",
        lambda s: [*(s.control(i, "xy") for i in (0, 2, 4)), *(s.control(i, "z") for i in (1, 5))],
        0,
        "",
    ),
    "height differences": ("free", Seen.levelled, 4, "height difference"),
    "height differences and a distance": (
        "free",
        lambda s: [*s.levelled(), s.distance(0, 5)],
        4,
        "",
    ),
    "one control point, an azimuth and height differences": (
        "given",
        lambda s: [s.control(0), s.azimuth(0, 4), *s.levelled()],
        0,
        "azimuth",
    ),
    "a base between cameras": ("free", lambda s: [s.base(0, 3)], 6, "1 known length"),
    "a total station": ("free", lambda s: s.set_up(0, (1, 2, 3, 4), distances=True), 4, ""),
    "angles of a total station": (
        "free",
        lambda s: s.set_up(0, (1, 2, 3, 4), distances=False),
        5,
        "",
    ),
    "two control points and a total station": (
        "given",
        lambda s: [s.control(0), s.control(3), *s.set_up(1, (2, 4, 5), distances=False)],
        0,
        "zenith angle",
    ),
    "nothing": ("free", lambda s: [], 7, "the base of the start pair has the length 1"),
}
"""Datum, observations, datum defect of the adjustment, and what is said of the datum."""


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("case", CASES)
def test_what_there_is_gives_scale_and_datum(case):
    _same_minimum(ring(3, photos=7, control=0), case)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("case", ["GNSS vectors", "two control points and a total station"])
def test_so_it_does_in_an_aerial_block(case):
    _same_minimum(aerial(3, strips=2, photos=5, n_points=300, control=0), case)


def _same_minimum(block: ImageBlock, case: str) -> None:
    datum, made, defect, said = CASES[case]
    observations = made(Seen(block))
    for network in (block.network, block.truth):
        network.datum = datum
        network.add(*observations)
    solution = fga.adjust(block.network)
    assert solution.converged
    assert solution.datum_defect == defect
    assert solution.vtpv == pytest.approx(fga.adjust(block.truth).vtpv, rel=SAME)
    if said:
        assert said in " ".join(solution.begun)


def test_levelled_observations_turn_a_block_upright():
    """The plumb line of the network is its z axis; the start pair has any axes.

    A set-up with zenith angles among the photos is enough for it.
    """
    block = ring(3, photos=7, control=0)
    seen = Seen(block)
    block.network.add(*seen.set_up(0, (1, 2, 3, 4), distances=True))
    found = fga.orient(block.network).start
    assert found is not None
    x = found.state["point"][[list(block.network.points).index(n) for n in seen.names]]
    np.testing.assert_allclose(x[:, 2] - x[0, 2], seen.x[:, 2] - seen.x[0, 2], atol=0.02)


def test_a_held_photo_and_a_distance_give_the_datum():
    block = ring(3, photos=7, control=0)
    for network in (block.network, block.truth):
        network.photos["F0"] = replace(
            network.photos["F0"],
            position=tuple(block.centres[0]),
            rotation=block.rotations[0],
            fixed=(True,) * 6,
        )
        network.datum = "given"
    bar = Seen(block).distance(0, 3)
    for network in (block.network, block.truth):
        network.add(bar)
    solution = fga.adjust(block.network)
    assert solution.vtpv == pytest.approx(fga.adjust(block.truth).vtpv, rel=SAME)


def test_rays_to_known_points_give_the_scale_beside_a_photo_that_stands():
    """F1 sees two known points that F0 does not: one ray each, which tells the base."""
    block = ring(3, photos=2, control=0)
    network = block.network
    network.datum = "given"
    network.photos["F0"] = replace(
        network.photos["F0"],
        position=tuple(block.centres[0]),
        rotation=block.rotations[0],
        fixed=(True,) * 6,
    )
    photo, point, _, _ = network.images.columns()
    network.image_mask(~((photo == 0) & (point < 2)))
    for name in ("P0", "P1"):
        at = tuple(block.points[int(name[1:])])
        network.points[name] = replace(network.points[name], coordinates=at, fixed=(True,) * 3)
    found = fga.orient(network)
    assert "scale from 2 rays that leave it" in found.parts[0].datum
    centre = fga.adjust(network).pose("F1").position
    assert np.linalg.norm(centre - block.centres[1]) < 0.02


def test_two_rays_and_a_known_projection_centre_orient_a_photo():
    """Too few rays for a resection; a photo with one ray turns about it, and is told so."""
    block = ring(3, photos=7, control=3)
    photo, point, _, _ = block.network.images.columns()
    few = (photo == 5) & (point > 1) | (photo == 6) & (point > 0)
    for network in (block.network, block.truth):
        network.image_mask(~few)
        for f in (5, 6):
            at = tuple(block.centres[f])
            network.add(PhotoPosition(f"F{f}", at, sigma=(0.01,) * 3))
    found = fga.orient(block.network)
    assert found.by_given == ("F5",)
    assert list(found.unoriented) == ["F6"]
    assert "1 of its 1 image points" in found.unoriented["F6"]
    assert "one leaves the rotation about its ray open" in found.unoriented["F6"]
    for network in (block.network, block.truth):
        last = next(i for i, o in network.observations.items() if "F6" in o.photos())
        del network.observations[last]
        photos = network.images.columns()[0]
        network.image_mask(photos != 6)
    clean = [filtered(n, lambda kind, name: name != "F6") for n in (block.network, block.truth)]
    vtpv = [fga.adjust(n).vtpv for n in clean]
    assert vtpv[0] == pytest.approx(vtpv[1], rel=SAME)
