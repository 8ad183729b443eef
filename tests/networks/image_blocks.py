"""Blocks of photos with known truth, whose networks have image points and control only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.image import image
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.types import Array

CAMERA = "camera"
HALF = 0.5 * np.array([36.0, 24.0])
"""Half of the format, mm."""
SIGMA = 0.003
"""Standard deviation of image coordinates, mm."""
LENS = BrownLens()


@dataclass(frozen=True)
class ImageBlock:
    """A network without poses, and the truth."""

    network: fga.Network
    """Image points and control; photos have no pose."""
    truth: fga.Network
    """The same with true poses and points as start values."""
    mismatched: frozenset[str]
    """Ids of image points that belong to other points."""
    rotations: Array
    """True world_R_camera, (f, 3, 3)."""
    centres: Array
    """True projection centres, (f, 3)."""
    points: Array
    """True points, (p, 3)."""


def look_at(centre: Array, target: Array, kappa: float = 0.0) -> Array:
    """Return the rotation of a camera that looks at a target, turned about its axis."""
    forward = target - centre
    forward = forward / np.linalg.norm(forward)
    aside = np.cross(forward, [0.0, 0.0, 1.0])
    aside = aside / np.linalg.norm(aside)
    r = np.stack([aside, np.cross(forward, aside), forward], 1)
    c, s = np.cos(kappa), np.sin(kappa)
    return r @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def aerial(
    seed: int, *, strips: int = 3, photos: int = 6, n_points: int = 600, **options
) -> ImageBlock:
    """Return strips of photos over hills, 70 % forward and 40 % side overlap."""
    rng = np.random.default_rng(seed)
    height, c = 900.0, 30.0
    base, side = 0.3 * 24.0 / c * height, 0.6 * 36.0 / c * height
    centres, rotations = [], []
    for s in range(strips):
        for i in range(photos):
            at = np.array([s * side, i * base, height]) + rng.normal(0, 15.0, 3)
            turn = world_R_camera(*rng.normal(0, 0.03, 2), np.pi * (s % 2) + rng.normal(0, 0.05))
            centres.append(at)
            rotations.append(turn)
    x = rng.uniform([-500, -350, 0], [strips * side + 200, photos * base + 150, 0], (n_points, 3))
    x[:, 2] = 40 * np.sin(x[:, 0] / 170) + 30 * np.cos(x[:, 1] / 140) + rng.uniform(0, 12, n_points)
    return _block("aerial", np.array(rotations), np.array(centres), x, c, rng, **options)


def ring(seed: int, *, photos: int = 16, **options) -> ImageBlock:
    """Return convergent photos around an object of 2 m, at two heights."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (160, 3)) * [1.0, 0.8, 0.7]
    angle = np.linspace(0, 2 * np.pi, photos, endpoint=False) + rng.normal(0, 0.05, photos)
    centres = np.stack(
        [4 * np.cos(angle), 4 * np.sin(angle), np.tile([0.8, 2.2], photos)[:photos]], 1
    )
    centres += rng.normal(0, 0.1, centres.shape)
    rotations = np.array(
        [look_at(p, rng.normal(0, 0.1, 3), rng.choice([0.0, np.pi / 2])) for p in centres]
    )
    return _block("ring", rotations, centres, x, 28.0, rng, **options)


def two_parts(seed: int, **options) -> ImageBlock:
    """Return two rings 30 m apart that share no point."""
    rng = np.random.default_rng(seed)
    one, other = ring(seed, photos=10), ring(seed + 1000, photos=8)
    away = np.array([30.0, 5.0, 1.0])
    return _block(
        "two parts",
        np.concatenate([one.rotations, other.rotations]),
        np.concatenate([one.centres, other.centres + away]),
        np.concatenate([one.points, other.points + away]),
        28.0,
        rng,
        reach=10.0,
        **options,
    )


def _block(
    name: str,
    rotations: Array,
    centres: Array,
    points: Array,
    c: float,
    rng: np.random.Generator,
    *,
    mismatches: float = 0.0,
    distortion: float = 0.0,
    guess: float | None = None,
    control: int = 8,
    reach: float = np.inf,
) -> ImageBlock:
    """Return the network of image points, and the same with the truth.

    Args:
        name: name of the network.
        rotations: world_R_camera, (f, 3, 3).
        centres: projection centres, (f, 3).
        points: points, (p, 3).
        c: principal distance, mm.
        rng: source of the noise.
        mismatches: share of the image points that are those of another point.
        distortion: k1, 1/mm²; with any the camera is free.
        guess: stated principal distance; none: the true one, held if there is no distortion.
        control: number of control points, σ = 1/20 000 of the size of the block.
        reach: largest distance at which a point is seen.
    """
    size = float(np.ptp(points, axis=0).max())
    network = fga.Network(name, datum="given" if control else "free")
    free = ("c", "x0", "y0", "k1") if guess is not None or distortion else ()
    start = {"c": c if guess is None else guess}
    network.add_camera(CAMERA, LENS, start, free=free, format=tuple(2 * HALF))
    calibration = np.zeros((1, len(LENS.names)))
    calibration[0, [0, 3]] = c, distortion
    seen: list[tuple[int, Array, Array]] = []
    for f, (r, at) in enumerate(zip(rotations, centres, strict=True)):
        pose = np.tile(np.concatenate([r.ravel(), at]), (len(points), 1))
        xy = np.zeros((len(points), 2))
        for _ in range(12):  # the lens corrects measured coordinates
            xy = (
                xy
                + image(
                    network.frame,
                    pose,
                    calibration,
                    points,
                    observed=xy,
                    lens=LENS,
                    jacobians=False,
                ).residual
            )
        depth = (points - at) @ r[:, 2]
        near = np.linalg.norm(points - at, axis=1) < reach
        inside = (depth > 0) & near & (np.abs(xy) < HALF).all(axis=1)
        rows = np.flatnonzero(inside)
        seen.append((f, rows, xy[rows] + rng.normal(0, SIGMA, (len(rows), 2))))
    count = np.bincount(np.concatenate([rows for _, rows, _ in seen]), minlength=len(points))
    used = np.flatnonzero(count >= 2)
    names = {int(p): f"P{p}" for p in used}
    for p in used.tolist():
        network.add_point(names[p])
    often = used[count[used] >= 3]
    spread = rng.choice(often, control, replace=False) if control else []
    sigma = size / 20_000
    for p in sorted(np.asarray(spread, dtype=int).tolist()):
        at = points[p] + rng.normal(0, sigma, 3)
        network.add(fga.ControlPoint(names[p], tuple(at), sigma=(sigma,) * 3))
    for f in range(len(centres)):
        network.add_photo(f"F{f}", CAMERA)
    wrong = set()
    for f, rows, xy in seen:
        keep = np.isin(rows, used)
        rows, xy = rows[keep], xy[keep]
        bad = np.flatnonzero(rng.random(len(rows)) < mismatches)
        xy[bad] = rng.uniform(-HALF, HALF, (len(bad), 2))
        wrong |= {f"F{f}/{names[int(p)]}" for p in rows[bad]}
        network.add_image_points(f"F{f}", [names[int(p)] for p in rows], xy, sigma=SIGMA)
    truth = network.copy()
    for p in used.tolist():
        truth.points[names[p]] = replace(
            truth.points[names[p]], coordinates=tuple(points[p].tolist())
        )
    for f, (r, at) in enumerate(zip(rotations, centres, strict=True)):
        photo = truth.photos[f"F{f}"]
        truth.photos[f"F{f}"] = replace(photo, position=tuple(at.tolist()), rotation=r)
    if free:
        camera = truth.cameras[CAMERA]
        truth.cameras[CAMERA] = replace(camera, values=tuple(calibration[0].tolist()))
    return ImageBlock(network, truth, frozenset(wrong), rotations, centres, points)


KINDS = {
    "aerial": lambda seed: aerial(seed),
    "ring": lambda seed: ring(seed),
    "two parts": lambda seed: two_parts(seed),
    "mismatches": lambda seed: (aerial if seed % 2 else ring)(seed, mismatches=0.05),
    "unknown calibration": lambda seed: ring(
        seed, distortion=4e-5, guess=(20.0, 40.0, 50.0, 14.0)[seed % 4]
    ),
}
"""Blocks of each kind by seed."""


def images_alone(network: fga.Network, *, datum: str | None = None) -> fga.Network:
    """Return a network without poses, and without coordinates of points that are not held."""
    out = network.copy()
    for name, p in network.points.items():
        if not p.held:
            out.points[name] = replace(p, coordinates=(np.nan,) * 3)
    for name, f in network.photos.items():
        out.photos[name] = replace(f, position=None, rotation=None, fixed=(False,) * 6)
    if datum is not None:
        out.datum = datum
    return out
