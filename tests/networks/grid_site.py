"""A site of 3 km in a grid and in geocentric coordinates: control, total stations, photos."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import GeocentricFrame, TopocentricFrame
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import TURN_ABOUT_X, world_R_photogrammetric
from factorgraph_adj.types import Array
from tests.networks.grids import TransverseMercator

UNDULATION = 46.88
CONTROL = ("A", "B", "C", "D")
NAMES = (*CONTROL, "P", "Q", "R")
SIGMA = (0.02, 0.01, 0.03)
"""σ of E, N, H of the weighted control."""


class Site:
    """Points and photos of a site of 3 km in a grid, with true geometry on the Earth."""

    def __init__(self, grid: TransverseMercator) -> None:
        """Place the site."""
        self.grid = grid
        self.ellipsoid = ellipsoid(grid.ellipsoid)
        self.frame = GeocentricFrame(grid.ellipsoid)
        self.rng = np.random.default_rng(4)
        middle = TopocentricFrame(*(float(np.radians(v)) for v in grid.place), 0.0, grid.ellipsoid)
        plan = [(-1500, -1400), (1500, -1500), (1400, 1500), (-1500, 1450)]
        plan += [(-200, 300), (600, -500), (500, 800)]
        at = np.array([(*p, 400.0 + 60.0 * i) for i, p in enumerate(plan)])
        self.points = dict(zip(NAMES, middle.to_geocentric(at), strict=True))
        centres = np.array(
            [(x, y, 2500.0) for x in (-900, 0, 900) for y in (-700, 700)], dtype=float
        )
        self.centres = middle.to_geocentric(centres)
        # ω, φ, κ count from the grid and the vertical at the photo.
        self.angles = self.rng.normal([0.0, 0.0, 0.4], 0.03, (6, 3))

    def to_grid(self, xyz: Array) -> Array:
        """Return E, N, H of geocentric coordinates."""
        phi, lam, h = self.ellipsoid.to_geodetic(xyz)
        return np.column_stack([self.grid.to_grid(phi, lam), h - UNDULATION])

    def enu(self, xyz: Array) -> Array:
        """Return rows east, north, up."""
        return self.frame.basis(xyz[None], np.zeros((1, 2))).enu[0]

    def partials(self, xyz: Array) -> Array:
        """Return ∂(E, N, H)/∂(e, n, u), by differences of the series over 50 m."""
        rows = self.enu(xyz)
        steps = [(self.to_grid(xyz + s * 50.0 * rows) / 100.0) for s in (1.0, -1.0)]
        return (steps[0] - steps[1]).T

    def rotation(self, i: int) -> Array:
        """Return the true rotation of photo i in the geocentric frame."""
        xyz = self.centres[i]
        k = self.partials(xyz)
        gamma = np.arctan2(k[1, 0], k[0, 0])
        c, s = np.cos(gamma), np.sin(gamma)
        enu_R_grid = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        turn = world_R_photogrammetric(*self.angles[i]) @ TURN_ABOUT_X
        return np.asarray(self.enu(xyz).T @ enu_R_grid @ turn)

    def observations(self) -> Iterator[fga.Observation]:
        """Yield sights between all points, with errors, from the true geometry."""
        rng = np.random.default_rng(8)
        for station in ("A", "P", "Q", "R"):
            e, n, u = self.enu(self.points[station])
            for target in NAMES:
                if target == station:
                    continue
                d = self.points[target] - self.points[station]
                s = float(np.linalg.norm(d))
                azimuth = float(np.arctan2(d @ e, d @ n)) + rng.normal(0, 5e-6)
                reading = float(np.mod(azimuth + 0.7, 2 * np.pi))
                zenith = float(np.arccos(d @ u / s)) + rng.normal(0, 1e-5)
                yield fga.SlopeDistance(station, target, s + rng.normal(0, 0.003), sigma=0.003)
                yield fga.Direction(station, target, reading, sigma=5e-6)
                yield fga.ZenithAngle(station, target, zenith, sigma=1e-5)

    def rays(self) -> Iterator[tuple[str, list[str], Array]]:
        """Yield image coordinates with errors."""
        rng = np.random.default_rng(9)
        for i, centre in enumerate(self.centres):
            at = np.array([self.rotation(i).T @ (x - centre) for x in self.points.values()])
            xy = 100.0 * at[:, :2] / at[:, 2:] * [1.0, -1.0]
            yield f"{i}", list(NAMES), xy + rng.normal(0, 0.004, xy.shape)

    def complete(self, network: fga.Network) -> fga.Network:
        """Add what does not depend on axes."""
        network.add(*self.observations())
        for photo, names, xy in self.rays():
            network.add_image_points(photo, names, xy, sigma=0.004)
        return network


def in_grid(site: Site) -> fga.Network:
    """Return the network with E, N, H of control, photos and their positions."""
    network = fga.Network("in the grid")
    network.add_camera("c", NoDistortion(), {"c": 100.0}, unit="mm")
    at = site.to_grid(np.array(list(site.points.values())))
    noise = np.random.default_rng(3).normal(0.0, 1.0, at.shape) * SIGMA
    for i, (name, enh) in enumerate(zip(NAMES, at, strict=True)):
        if name == "A":
            network.add_point(name, enh, fixed="xyz")
        elif name in CONTROL:
            network.add_point(name, enh + noise[i], sigma=SIGMA)
        else:
            network.add_point(name, enh + 0.3)
    for i, enh in enumerate(site.to_grid(site.centres)):
        network.add_photo(f"{i}", "c", position=enh + 0.2, omega_phi_kappa=site.angles[i])
        network.add(fga.PhotoPosition(f"{i}", tuple(enh + 0.01 * i), sigma=(0.05, 0.04, 0.1)))
    return site.complete(network)


def geocentric(site: Site) -> fga.Network:
    """Return the same network in geocentric coordinates, with covariances by hand."""
    network = fga.Network("geocentric", frame=site.frame)
    network.add_camera("c", NoDistortion(), {"c": 100.0}, unit="mm")
    at = np.array(list(site.points.values()))
    noise = np.random.default_rng(3).normal(0.0, 1.0, at.shape) * SIGMA
    control = []
    for i, (name, xyz) in enumerate(zip(NAMES, at, strict=True)):
        if name == "A":
            network.add_point(name, xyz, fixed="xyz")
        elif name in CONTROL:
            k = np.linalg.inv(site.partials(xyz))
            observed = xyz + site.enu(xyz).T @ k @ noise[i]
            network.add_point(name, observed)
            sigma = k @ np.diag(np.square(SIGMA)) @ k.T
            control.append(
                fga.ControlPoint(
                    name, tuple(observed), axes="enu", covariance=(sigma + sigma.T) / 2
                )
            )
        else:
            network.add_point(name, xyz)
    for i, xyz in enumerate(site.centres):
        network.add_photo(f"{i}", "c", position=xyz, rotation=site.rotation(i))
        k = site.enu(xyz).T @ np.linalg.inv(site.partials(xyz))
        sigma = k @ np.diag(np.square([0.05, 0.04, 0.1])) @ k.T
        network.add(
            fga.PhotoPosition(
                f"{i}", tuple(xyz + k @ np.full(3, 0.01 * i)), covariance=(sigma + sigma.T) / 2
            )
        )
    site.complete(network)
    network.add(*control)
    return network
