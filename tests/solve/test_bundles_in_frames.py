"""A block of photos, and the same block as bundles of directions in frames (FRAMES F11, WP 2).

A camera is a theodolite whose y axis looks along the axis of the camera: x right, y forwards, z
upwards. An image point (x, y) at the principal distance c is the direction atan(x/c) and the zenith
angle π/2 − atan(y/√(c² + x²)). Their covariance follows from that of the image point with the
partials at the measured image point, so that both blocks have the same normal equations but for
what is quadratic in the errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.types import Array
from tests.networks.strip_of_photos import as_sights

FOCAL = 50.0
"""Principal distance, mm."""
SIGMA = 5e-3
"""Standard deviation of an image coordinate, mm."""


def block_of_photos(scale: float) -> fga.Network:
    """Return a simulated block of six photos and fourteen points, three of them held.

    Args:
        scale: factor on all random errors.
    """
    rng = np.random.default_rng(5)
    network = fga.Network("photos")
    for i in range(14):
        at = rng.uniform((-6, -5, -2), (6, 5, 2))
        network.add_point(f"P{i}", at, fixed="xyz" if i < 3 else "")
    network.add_camera("camera", BrownLens(), {"c": FOCAL})
    for i in range(6):
        angle = 2 * np.pi * i / 6
        centre = np.array([16 * np.cos(angle), 16 * np.sin(angle), 5.0 + i])
        rotation = look_at(centre, np.zeros(3))
        network.add_photo(f"F{i}", "camera", position=centre, rotation=rotation)
        network.add_image_points(f"F{i}", list(network.points), np.zeros((14, 2)), sigma=SIGMA)
    true, noisy = measure(network, seed=3, noise=False), measure(network, seed=3)
    out = true.copy()
    _, _, exact, _ = true.images.columns()
    photo, point, xy, sigma = noisy.images.columns()
    out.image_mask(np.zeros(len(photo), dtype=bool))
    out.images.append(photo, point, exact + scale * (xy - exact), sigma)
    return out


@dataclass(frozen=True)
class Pair:
    """Both adjustments."""

    photos: fga.Solution
    bundles: fga.Solution

    @classmethod
    def of(cls, scale: float) -> Pair:
        photos = block_of_photos(scale)
        return cls(
            fga.adjust(photos, tolerance=1e-8),
            fga.adjust(as_sights(photos, FOCAL, SIGMA), tolerance=1e-8),
        )

    def estimates(self) -> float:
        """Return the largest difference of a coordinate, in its standard deviation."""
        off = self.photos.state["point"][3:] - self.bundles.state["point"][3:]
        sigma = np.sqrt(np.einsum("pii->pi", self.photos.point_covariances[3:]))
        return float(np.abs(off / sigma).max())

    def covariances(self) -> float:
        """Return the largest difference of a covariance of coordinates, relative to σσ."""
        a, b = (s.point_covariances[3:] for s in (self.photos, self.bundles))
        sigma = np.sqrt(np.einsum("pii->pi", a))
        return float(np.abs((a - b) / (sigma[:, :, None] * sigma[:, None, :])).max())


def instruments(solution: fga.Solution) -> Array:
    """Return where the instruments stand, (n, 3)."""
    frames = solution.state["frame"]
    rotation, offset = frames[:, :9].reshape(-1, 3, 3), frames[:, 9:12]
    return np.asarray(frames[:, 13:16] + np.einsum("nij,nj->ni", rotation, offset))


@pytest.fixture(scope="module")
def usual() -> Pair:
    return Pair.of(1.0)


@pytest.fixture(scope="module")
def tenth() -> Pair:
    return Pair.of(0.1)


def test_bundles_in_frames_are_the_block_of_photos(usual: Pair) -> None:
    """An error of the image is 10⁻⁴ of the principal distance; so is what the weights change."""
    photos, bundles = usual.photos, usual.bundles
    assert (bundles.n_observations, bundles.n_unknowns) == (
        photos.n_observations,
        photos.n_unknowns,
    )
    assert bundles.sigma0 == pytest.approx(photos.sigma0, rel=3e-6)
    assert usual.estimates() < 3e-4
    assert usual.covariances() < 3e-5
    centres = photos.state["pose"][:, 9:]
    sigma = np.array([photos.unknown("pose", f).sigmas[3:] for f in photos.network.photos])
    assert np.abs((instruments(bundles) - centres) / sigma).max() < 3e-4
    r = [float(fga.reliability(s).redundancy_numbers.sum()) for s in (photos, bundles)]
    assert r[0] == pytest.approx(r[1], abs=1e-6)


def test_what_is_left_falls_with_the_errors_of_the_images(usual: Pair, tenth: Pair) -> None:
    """Ten times smaller errors leave a tenth in the covariances, a hundredth in the estimates."""
    assert tenth.covariances() < 0.2 * usual.covariances()
    assert tenth.estimates() < 0.02 * usual.estimates()  # of second order in units of σ
    assert tenth.bundles.vtpv == pytest.approx(tenth.photos.vtpv, rel=1e-6)


def test_bundles_without_their_covariance_are_another_block(usual: Pair) -> None:
    """Equal standard deviations of angles are not those of an image: 20 % at its corner."""
    network = as_sights(block_of_photos(1.0), FOCAL, SIGMA)
    network.clusters = []
    angle = SIGMA / FOCAL
    for ident, o in network.observations.items():
        network.observations[ident] = type(o)(o.frame, o.point, o.value, sigma=angle)
    plain = Pair(usual.photos, fga.adjust(network))
    assert plain.covariances() > 20 * usual.covariances()
