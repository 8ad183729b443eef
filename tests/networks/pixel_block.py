"""A small block in pixels with control, a check point, positions and a scale bar."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import NormalisedLens
from factorgraph_adj.models.normalised_lens import AffineNormalisedLens
from factorgraph_adj.rotation import world_R_camera

SIGMA = 0.5
CALIBRATION = {"c": 1500.0, "x0": 1003.5, "y0": -748.25, "k1": -0.08, "k2": 0.03, "k3": 0.01}
CALIBRATION |= {"p1": 6e-4, "p2": -9e-4}


def pixel_block(
    *,
    affine: bool = False,
    observed: bool = True,
    free: tuple[str, ...] = ("c", "k1"),
    seed: int = 5,
) -> fga.Network:
    """Return the block, with measured image points of known truth and noise.

    Args:
        affine: whether the lens has an affinity and k4.
        observed: whether projection centres and a scale bar are observed.
        free: unknown parameters of the camera.
        seed: of the noise.
    """
    rng = np.random.default_rng(seed)
    network = fga.Network("pixel block")
    lens = AffineNormalisedLens() if affine else NormalisedLens()
    values = CALIBRATION | ({"k4": -0.004, "b1": 1.5, "b2": -0.75} if affine else {})
    network.add_camera(
        "DSC 1",
        lens,
        values,
        free=free,
        unit="px",
        format=(2000, 1500),
        origin="upper left",
        y_down_in_files=True,
    )
    centres = [(0.0, 0.0, 30.0), (8.0, 1.0, 31.0), (1.0, 9.0, 29.0), (9.0, 8.0, 32.0)]
    turns = [(0.05, -0.1, 0.1), (-0.1, 0.2, 1.7), (0.2, 0.1, -1.5), (-0.15, -0.2, 3.0)]
    for i, (at, angles) in enumerate(zip(centres, turns, strict=True)):
        network.add_photo(f"IMG {i}.jpg", "DSC 1", position=at, rotation=world_R_camera(*angles))
    grid = [(x, y) for x in (-4.0, 1.0, 6.0, 12.0) for y in (-3.0, 4.0, 11.0)]
    places = {f"P{i}": (x, y, float(rng.uniform(-1, 1))) for i, (x, y) in enumerate(grid)}
    for name, at in places.items():
        if name == "P4":
            network.add_point(name, at, check=at)
        else:
            network.add_point(name, at)
    for name in ("P0", "P2", "P9", "P11", "P6"):
        value = tuple((places[name] + rng.normal(0, 0.01, 3)).tolist())
        network.add(fga.ControlPoint(name, value, sigma=(0.01, 0.01, 0.02)))
    if observed:
        for i, at in enumerate(centres):
            value = tuple((at + rng.normal(0, 0.05, 3)).tolist())
            network.add(fga.PhotoPosition(f"IMG {i}.jpg", value, sigma=(0.05, 0.05, 0.1)))
        length = float(np.linalg.norm(np.subtract(places["P1"], places["P7"])))
        network.add(fga.SlopeDistance("P1", "P7", length + 0.001, sigma=0.002, id="bar"))
    for photo, xy in projected(network, list(places)).items():
        noisy = np.round(xy + rng.normal(0, SIGMA, xy.shape), 4)
        network.add_image_points(photo, list(places), noisy, sigma=SIGMA)
    return network


def projected(network: fga.Network, points: list[str]) -> dict[str, np.ndarray]:
    """Return image coordinates (n, 2), x right, y up, of points by photo, at the given values."""
    seen = network.copy()
    seen.images = type(network.images)()
    for photo in network.photos:
        seen.add_image_points(photo, points, np.zeros((len(points), 2)), sigma=1.0)
    equations = compile_network(seen)
    block = next(b for b in equations.blocks if b.kind == "image")
    v = equations.residuals(equations.unknowns.start())[block.rows].reshape(-1, 2)
    by_id = dict(zip(block.ids, v, strict=True))
    return {f: np.array([by_id[f"{f}/{p}"] for p in points]) for f in network.photos}


def assert_same_results(a: fga.Network, b: fga.Network, *, relative: float = 1e-9) -> None:
    """Compare counts, vᵀPv and adjusted points of two networks."""
    one, two = fga.adjust(a), fga.adjust(b)
    assert one.converged and two.converged
    for name in ("n_observations", "n_unknowns", "redundancy"):
        assert getattr(one, name) == getattr(two, name), name
    assert abs(one.vtpv - two.vtpv) <= relative * one.vtpv
    for name in a.points:
        assert np.abs(one.point(name) - two.point(name)).max() < 1e-7
