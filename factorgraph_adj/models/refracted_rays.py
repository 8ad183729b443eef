"""Image coordinates of points seen through a water surface, a tilted plane or a flat port.

A ray from the projection centre to a point at p passes parallel layers with the common normal ν,
the heights h_i of the layers along ν, and refractive indices n_i; that of the first layer, with
the camera, is 1: indices are relative to it. With p⊥ = p − ν (νᵀp), ρ = |p⊥|², μ_i = 1/n_i and
the last height νᵀp − Σ h_i, Snell's law along the ray is one equation for κ:

    Σ h_i μ_i κ / √(1 + (1 − μ_i²) ρ κ²) = 1,            q = ν + κ p⊥.

q leads to the place where the ray leaves the first layer, and the image of the point is that of q,
whatever the lens model. κ √ρ is the tangent of the angle of incidence. There is no singularity at
vertical incidence, where κ = 1/Σ h_i μ_i. Counted in the layer with the smallest index, the left
side is concave and increasing in κ, so that Newton's method from this value never passes the
solution, however grazing the ray is. Partials follow from implicit differentiation.

| interface | ν, h and p |
| --- | --- |
| level surface h(X) = w | ν normal at the refraction point, away from the camera, p = X − X₀ |
| plane, axis d of a frame through Z | ν = ±d, h = νᵀ(Z − X₀), p = X − X₀ |
| flat port | ν = (s_x, −s_y, 1)/N and h in axes of the camera, p = Rᵀ (X − X₀) |

The level surface is curved as heights of the frame are. Its plane at the refraction point Q is
found with Q; Q moves the normal by 1/R, which the partials have to the first order.

A point on the camera's side of the last surface is seen straight, q = p: as a point that is above
the water. At the surface both are the same, and only the partials change.

(FRAMES F19.2. Agrawal et al. 2012, A theory of multi-layer flat refractive geometry, CVPR, has the
layers; Glaeser & Schröcker 2000, Reflections on refractions, the refraction point; Murase et al.
2008, the depth ratio; Mulsow 2010, A flexible multi-media bundle approach, ISPRS Archives
XXXVIII-5, the bundle.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..types import Array, Mask
from .base import Linearised, require
from .frame_axes import axis_of
from .lens import Lens
from .line_of_sight import up_by_angles
from .positions import heights, split_pose
from .rolling_shutter import Readout, Turns

SNELL_ITERATIONS = 60
"""Largest number of steps of Newton's method along a ray; ordinary rays need five."""
SURFACE_ITERATIONS = 20
"""Largest number of planes of a curved surface; each has the square root of the error before."""
SURFACE_TOLERANCE = 1e-11
"""Change of the refraction point, relative to the ray, at which the search for it ends."""
NO_RAY = "the place where the ray to the point passes the surface was not found"
ON_SURFACE = "the projection centre lies in the surface through which the point is seen"
INDEX = "refractive indices and layers must be greater than zero, or the layer zero"


@dataclass(frozen=True)
class RefractedRays:
    """Rays q to the first interface, ν + κ p⊥, and their partials."""

    q: Array
    """q, whose component along ν is 1 if the ray is refracted, (n, 3)."""
    by_p: Array
    """∂q/∂p, (n, 3, 3)."""
    by_normal: Array
    """∂q/∂ν for changes across ν, (n, 3, 3)."""
    by_layers: Array
    """∂q/∂h of all layers but the last, (n, 3, m − 1)."""
    by_indices: Array
    """∂q/∂n of all layers but the first, (n, 3, m − 1)."""
    straight: Mask
    """Whether the point is not in the last layer, and q is p, (n,)."""


def refracted_rays(p: Array, normal: Array, layers: Array, indices: Array) -> RefractedRays:
    """Return rays from the origin to points p through parallel layers.

    Args:
        p: places of the points, (n, 3).
        normal: unit vectors ν across the layers, away from the origin, (n, 3).
        layers: heights of all layers but the last along ν, the first with the origin, (n, m − 1).
        indices: refractive indices of all layers but the first, relative to it, (n, m − 1).

    Raises:
        DegenerateError: layers or indices that are negative, or an origin in the first surface.
    """
    along = np.einsum("ni,ni->n", normal, p)
    across = p - along[:, None] * normal
    rho = np.einsum("ni,ni->n", across, across)
    h = np.concatenate([layers, along[:, None] - layers.sum(axis=1, keepdims=True)], axis=1)
    require((layers.min(axis=1) >= 0.0) & (indices.min(axis=1) > 0.0), INDEX)
    require(layers[:, 0] > 0.0, ON_SURFACE)
    straight = h[:, -1] < 0.0
    h[straight] = 1.0  # any layers: the ray does not pass them
    mu = np.concatenate([np.ones_like(along[:, None]), 1.0 / indices], axis=1)
    kappa = _solved(h, mu, rho)
    squared = rho * kappa**2
    w = 1.0 + (1.0 - mu**2) * squared[:, None]
    root = np.sqrt(w)
    cubed = w * root
    by_kappa = np.sum(h * mu / cubed, axis=1)
    k = kappa[:, None]
    by_h = -mu * k / root / by_kappa[:, None]
    by_mu = -h * k * (1.0 + squared)[:, None] / cubed / by_kappa[:, None]
    by_rho = 0.5 * kappa**3 * np.sum(h * mu * (1.0 - mu**2) / cubed, axis=1) / by_kappa
    last = by_h[:, -1:]
    # ρ = |p|² − (νᵀp)², and for ν that stays a unit vector νᵀp changes by p⊥ᵀ dν.
    kappa_by_p = 2.0 * by_rho[:, None] * across + last * normal
    kappa_by_normal = (-2.0 * by_rho * along)[:, None] * across + last * across
    eye, a = np.eye(3), across[:, :, None]
    by_p = a * kappa_by_p[:, None] + k[:, :, None] * (eye - normal[:, :, None] * normal[:, None])
    by_normal = (
        (1.0 - kappa * along)[:, None, None] * eye
        - k[:, :, None] * normal[:, :, None] * across[:, None]
        + a * kappa_by_normal[:, None]
    )
    q = normal + k * across
    by_layers = a * (by_h[:, :-1] - last)[:, None]
    by_indices = a * (-(mu[:, 1:] ** 2) * by_mu[:, 1:])[:, None]
    q[straight], by_p[straight] = p[straight], eye
    for by in (by_normal, by_layers, by_indices):
        by[straight] = 0.0
    return RefractedRays(q, by_p, by_normal, by_layers, by_indices, straight)


def _solved(h: Array, mu: Array, rho: Array) -> Array:
    """Return κ (n,) of layers with heights h and ratios μ (n, m) at squared distances ρ (n,)."""
    # Counted in the layer of the smallest index, whose μ is the largest, no root is imaginary.
    thinnest = mu.max(axis=1, keepdims=True)
    ratio = mu / thinnest
    c = 1.0 - ratio**2
    weight = h * ratio
    kappa = 1.0 / weight.sum(axis=1)
    step = kappa
    for _ in range(SNELL_ITERATIONS):
        w = 1.0 + c * (rho * kappa**2)[:, None]
        root = np.sqrt(w)
        found = np.sum(weight / root, axis=1) * kappa - 1.0
        step = -found / np.sum(weight / (w * root), axis=1)
        kappa = kappa + step
        if np.all(np.abs(step) <= 4e-16 * kappa):
            break
    require(np.abs(step) <= 1e-9 * kappa, NO_RAY)
    first = ratio[:, 0]
    return np.asarray(first * kappa / np.sqrt(1.0 + c[:, 0] * rho * kappa**2))


class _Imaged(NamedTuple):
    """Image coordinates of rays q in the axes of the camera."""

    v: Array
    """Computed − observed, (n, 2)."""
    by_q: Array
    """g = ∂v/∂q, (n, 2, 3)."""
    by_k: Array
    """∂v/∂K of the calibration, (n, 2, k)."""
    by_turn: Array
    """∂v/∂ω = g × q of a turn about the axes of the camera where q is fixed in the object,
    (n, 2, 3)."""

    @classmethod
    def of(cls, q: Array, observed: Array, calibration: Array, lens: Lens) -> _Imaged:
        """Return the image coordinates of rays (n, 3)."""
        x, y = observed[:, 0], observed[:, 1]
        found = lens.seen((q[:, 0], q[:, 1], q[:, 2]), x, y, calibration)
        by_q = np.empty((len(q), 2, 3))
        by_k = np.empty((len(q), 2, len(found.by_k)))
        for out, pairs in ((by_q, found.by_p), (by_k, found.by_k)):
            for j, pair in enumerate(pairs):
                out[:, 0, j], out[:, 1, j] = pair
        return cls(np.stack(found.v, axis=1), by_q, by_k, np.cross(by_q, q[:, None]))


@dataclass(frozen=True)
class _Exposure:
    """Poses at the time at which each ray was exposed."""

    rotation: Array
    """world_R_camera, (n, 3, 3)."""
    centre: Array
    """Projection centres, (n, 3)."""
    turns: Turns | None
    """Turns since the middle of the readout; None: all rows are exposed at the same time."""
    components: int
    """Number of components of the motions of the photos, with or without a readout."""

    @classmethod
    def of(
        cls, pose: Array, motion: Array | None, readout: Readout | None, observed: Array
    ) -> _Exposure:
        """Return the moved poses of measured coordinates (n, 2)."""
        rotation, centre = split_pose(pose)
        if motion is None or readout is None:
            return cls(rotation, centre, None, 0 if motion is None else motion.shape[1])
        turns, shift = Turns.of(motion, readout.times(observed[:, 0], observed[:, 1]))
        return cls(rotation @ turns.matrix, centre + shift, turns, motion.shape[1])

    def partials(self, by_turn: Array, by_centre: Array) -> tuple[Array, list[Array]]:
        """Return the partials by the pose, (n, 2, 6), and a list of those by the motion, if any."""
        by_pose = np.concatenate([by_turn, by_centre], axis=2)
        if self.turns is not None:
            by_pose, by_motion = self.turns.of_moved_pose(by_pose)
            return by_pose, [by_motion]
        still = [np.zeros((len(by_pose), 2, self.components))] if self.components else []
        return by_pose, still


def image_through_level(
    frame: Frame,
    pose: Array,
    calibration: Array,
    point: Array,
    motion: Array | None,
    level: Array,
    index: Array,
    *,
    observed: Array,
    geoid: Array,
    lens: Lens,
    readout: Readout | None = None,
) -> Linearised:
    """Compute v of image coordinates of points beyond a level surface, (n, 2), image units.

    Args:
        frame: frame of the network, whose heights the surface has.
        pose: stored poses, (n, 12).
        calibration: parameters of the lens, (n, k).
        point: object points, (n, 3), metres.
        motion: motions of the photos during the readout, (n, 6 d); none: they stand still.
        level: heights w of the surface, metres, (n, 1).
        index: refractive indices beyond the surface, relative to that of the camera, (n, 1).
        observed: measured coordinates, (n, 2).
        geoid: geoid undulation at the point less that at the place of w, metres, (n,).
        lens: the lens model.
        readout: times of the rows; None: all are exposed at the same time.

    Raises:
        DegenerateError: the projection centre lies in the surface, or the point has no image.
    """
    at = _Exposure.of(pose, motion, readout, observed)
    height = level[:, 0] + geoid
    above, _ = heights(frame, at.centre)
    side = np.where(above >= height, -1.0, 1.0)
    p = point - at.centre
    size = np.linalg.norm(p, axis=1)
    place = point
    for _ in range(SURFACE_ITERATIONS):
        found, up = heights(frame, place)
        steep = np.linalg.norm(up, axis=1)
        normal = (side / steep)[:, None] * up
        foot = place + ((height - found) / steep**2)[:, None] * up
        thick = np.einsum("ni,ni->n", normal, foot - at.centre)
        rays = refracted_rays(p, normal, thick[:, None], index)
        before, place = place, at.centre + thick[:, None] * rays.q
        place[rays.straight] = point[rays.straight]
        if np.all(np.linalg.norm(place - before, axis=1) <= SURFACE_TOLERANCE * size):
            break
    n = len(p)
    eye = np.tile(np.eye(3), (n, 1, 1))
    # By X₀, X, w and the index: first with a normal that stays, then with that of the moved place.
    p_by = np.concatenate([-eye, eye, np.zeros((n, 3, 2))], axis=2)
    raised = np.stack([side / steep, np.zeros(n)], axis=1)
    thick_by = np.concatenate([-normal, np.zeros((n, 3)), raised], axis=1)[:, None]
    by = rays.by_p @ p_by + rays.by_layers @ thick_by
    by[:, :, 7:] += rays.by_indices
    place_by = np.concatenate([eye, np.zeros((n, 3, 5))], axis=2)
    place_by += rays.q[:, :, None] * thick_by + thick[:, None, None] * by
    basis = frame.basis(place, np.zeros((n, 2)))
    normal_by = side[:, None, None] * up_by_angles(basis) @ basis.angles_by_position @ place_by
    lever = (thick[:, None] * (rays.q - normal))[:, None]
    by += rays.by_normal @ normal_by + rays.by_layers @ (lever @ normal_by)
    return _seen(at, rays, by, (by[:, :, 6:7], by[:, :, 7:]), observed, calibration, lens)


def image_through_plane(
    frame: Frame,
    pose: Array,
    calibration: Array,
    point: Array,
    motion: Array | None,
    stored: Array,
    origin: Array | None,
    vertical: Array | None,
    index: Array,
    *,
    observed: Array,
    lens: Lens,
    readout: Readout | None = None,
) -> Linearised:
    """Compute v of image coordinates of points beyond a plane, (n, 2), image units.

    Args:
        frame: frame of the network.
        pose: stored poses, (n, 12).
        calibration: parameters of the lens, (n, k).
        point: object points, (n, 3), metres.
        motion: motions of the photos during the readout, (n, 6 d); none: they stand still.
        stored: frames whose z axes are the normals of the planes, (n, 17).
        origin: O of the frames where it is a point, (n, 3).
        vertical: deflections there, (n, 2).
        index: refractive indices beyond the plane, relative to that of the camera, (n, 1).
        observed: measured coordinates, (n, 2).
        lens: the lens model.
        readout: times of the rows; None: all are exposed at the same time.

    Raises:
        DegenerateError: as `image_through_level`.
    """
    at = _Exposure.of(pose, motion, readout, observed)
    plane = axis_of(frame, stored, origin, vertical)
    away = plane.zero - at.centre
    along = np.einsum("ni,ni->n", plane.d, away)
    side = np.where(along < 0.0, -1.0, 1.0)
    normal, thick = side[:, None] * plane.d, side * along
    rays = refracted_rays(point - at.centre, normal, thick[:, None], index)
    by_thick = rays.by_layers
    by_centre = -rays.by_p - by_thick @ normal[:, None]
    by_plane = tuple(
        side[:, None, None] * (rays.by_normal @ d + by_thick @ (away[:, None] @ d))
        + by_thick @ (normal[:, None] @ z)
        for d, z in zip(plane.d_by, plane.zero_by, strict=True)
    )
    given = (True, origin is not None, vertical is not None)
    there = tuple(by for by, is_there in zip(by_plane, given, strict=True) if is_there)
    by = np.concatenate([by_centre, rays.by_p], axis=2)
    return _seen(at, rays, by, (*there, rays.by_indices), observed, calibration, lens)


def _seen(
    at: _Exposure,
    rays: RefractedRays,
    by: Array,
    further: tuple[Array, ...],
    observed: Array,
    calibration: Array,
    lens: Lens,
) -> Linearised:
    """Return v of rays in axes of the network.

    Args:
        at: poses.
        rays: the rays.
        by: ∂q/∂(X₀, X), (n, 3, 6) or more.
        further: ∂q by the unknowns of the surface and by the index, (n, 3, k) each.
        observed: measured coordinates, (n, 2).
        calibration: parameters of the lens, (n, k).
        lens: the lens model.
    """
    image = _Imaged.of(np.einsum("nji,nj->ni", at.rotation, rays.q), observed, calibration, lens)
    g = image.by_q @ at.rotation.transpose(0, 2, 1)
    by_pose, by_motion = at.partials(image.by_turn, g @ by[:, :, :3])
    parts = (g @ f for f in further)
    return Linearised(image.v, (by_pose, image.by_k, g @ by[:, :, 3:6], *by_motion, *parts))


def port_normals(port: Array) -> tuple[Array, Array]:
    """Return the normals of ports (n, 5), (n, 3) in axes of the camera, and partials by slopes.

    The axes are x right, y down, z ahead; the partials are (n, 3, 2).
    """
    towards = np.stack([port[:, 0], -port[:, 1], np.ones(len(port))], axis=1)
    size = np.linalg.norm(towards, axis=1)
    normal = towards / size[:, None]
    across = (np.eye(3) - normal[:, :, None] * normal[:, None]) / size[:, None, None]
    return normal, across[:, :, :2] * [1.0, -1.0]


def image_through_port(
    frame: Frame,
    pose: Array,
    calibration: Array,
    point: Array,
    motion: Array | None,
    port: Array,
    index: Array,
    *,
    observed: Array,
    lens: Lens,
    readout: Readout | None = None,
) -> Linearised:
    """Compute v of image coordinates of points beyond a flat port, (n, 2), image units.

    Args:
        frame: not used.
        pose: stored poses, (n, 12).
        calibration: parameters of the lens, (n, k).
        point: object points, (n, 3), metres.
        motion: motions of the photos during the readout, (n, 6 d); none: they stand still.
        port: slopes of the normal (x right, y up), distance of the inner face from the projection
            centre and thickness of the glass along the normal, metres, index of the glass, (n, 5).
        index: refractive indices beyond the port, relative to that of the camera, (n, 1).
        observed: measured coordinates, (n, 2).
        lens: the lens model.
        readout: times of the rows; None: all are exposed at the same time.

    Raises:
        DegenerateError: the projection centre lies in the port, or the point has no image.
    """
    at = _Exposure.of(pose, motion, readout, observed)
    p = np.einsum("nji,nj->ni", at.rotation, point - at.centre)
    normal, by_slopes = port_normals(port)
    rays = refracted_rays(p, normal, port[:, 2:4], np.concatenate([port[:, 4:], index], axis=1))
    image = _Imaged.of(rays.q, observed, calibration, lens)
    by_p = image.by_q @ rays.by_p
    by_point = by_p @ at.rotation.transpose(0, 2, 1)
    by_pose, by_motion = at.partials(np.cross(by_p, p[:, None]), -by_point)
    by_port = np.concatenate(
        [rays.by_normal @ by_slopes, rays.by_layers, rays.by_indices[:, :, :1]], axis=2
    )
    parts = (image.by_q @ by_port, image.by_q @ rays.by_indices[:, :, 1:])
    return Linearised(image.v, (by_pose, image.by_k, by_point, *by_motion, *parts))


def rays_behind_port(ray: Array, port: Array, index: Array) -> tuple[Array, Array]:
    """Return places at the outer face of ports, and unit vectors of rays beyond, (n, 3) each.

    Args:
        ray: unit vectors of rays in the camera, (n, 3), in its axes.
        port: ports, (n, 5).
        index: refractive indices beyond, (n, 1).
    """
    normal, _ = port_normals(port)
    place = np.zeros_like(ray)
    layers = (port[:, 2], port[:, 3], None)
    for n, thick in zip((np.ones(len(port)), port[:, 4], index[:, 0]), layers, strict=True):
        # What lies across the normal of a unit vector shrinks by the index of the layer.
        along = np.einsum("ni,ni->n", ray, normal)[:, None]
        across = (ray - along * normal) / n[:, None]
        left = np.maximum(1.0 - np.einsum("ni,ni->n", across, across), 0.0)[:, None]
        inside = across + np.sqrt(left) * normal
        if thick is None:
            return place, inside
        place = place + thick[:, None] * inside / np.maximum(np.sqrt(left), 1e-12)
    raise AssertionError  # pragma: no cover
