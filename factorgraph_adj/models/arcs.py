"""Arcs: places of a spacecraft or an aircraft as functions of time, with partials.

An arc has the state r₀, v₀ at the time t = 0 in the axes of the network, the gravitational
parameter μ = GM of the body that attracts (m³/s²), the rate Ω at which this body and the axes of
the network turn about their z axis (rad/s), and coefficients a₂, a₃ … of what is not modelled:

    X(t) = S(Ωt) r(t; r₀, v₀, μ) + a₂ t² + a₃ t³ + …

r(t) is the orbit of two bodies, about the origin of a geocentric or local frame, or about the
centre of the ellipsoid of a topocentric one, in axes that do not turn and that are those of the
network at t = 0; v₀ is the velocity in these, not the one over the ground. S turns its coordinates
to the axes of the network. With μ = Ω = 0, r = r₀ + v₀ t, and X is a polynomial.

With the universal variable s, dt = r ds, β = 2μ/r₀ − v₀², η = r₀·v₀ and Gₖ = sᵏ Σ (−βs²)ⁱ/(k + 2i)!

    t = r₀ G₁ + η G₂ + μ G₃             r = r₀ G₀ + η G₁ + μ G₂
    r(t) = f r₀ + g v₀,                 f = 1 − μ G₂/r₀,  g = t − μ G₃

for ellipses, parabolas and hyperbolas alike. The partials of r(t) are, with w = (v₀ − v(t))/μ =
(G₁/(r r₀)) r₀ + (G₂/r) v₀ and D = μ (3 G₅ − s G₄) − t G₂,

| partial | |
| --- | --- |
| r₀ | f I + μ r w wᵀ + (μ G₂/r₀³) r r₀ᵀ + (μ D/r₀³) v r₀ᵀ |
| v₀ | g I + G₂ ((r − r₀) v₀ᵀ + μ w r₀ᵀ) + D v v₀ᵀ |
| μ | (t v − (∂r/∂v₀) v₀)/2μ, as r stays where t → λt, v₀ → v₀/λ, μ → μ/λ² |

(Goodyear 1965, Completely general closed-form solution for coordinates and partial derivatives of
the two-body problem, Astronomical Journal 70, 189–192; Battin 1999, An introduction to the
mathematics and methods of astrodynamics, 9.7; FRAMES F18.)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np

from ..frames import Frame, TopocentricFrame
from ..rotation import TURN_ABOUT_X, skew
from ..types import Array
from .base import Linearised, require
from .positions import split_pose

STATE, GM, SPIN, TERMS = 6, 6, 7, 8
"""Number of components of r₀, v₀; places of μ, Ω and of the first coefficient."""
HIGHEST_POWER = 5
"""Highest power of t of which an arc has coefficients."""
SERIES_WITHIN = 1.0
"""Largest |βs²| for which c₄ and c₅ follow from their series; closed forms serve beyond."""
SERIES_TERMS = 11
"""Terms of these series: the next one is below 10⁻²² of the first."""
MAX_STEPS = 60
"""Largest number of steps of Laguerre's method; it needs four or five, near a collision more."""


@dataclass(frozen=True)
class TwoBodies:
    """Places r(t) on orbits of two bodies, with partials."""

    place: Array
    """r, (n, 3) metres."""
    velocity: Array
    """v, (n, 3) metres per second."""
    by_place: Array
    """∂r/∂r₀, (n, 3, 3)."""
    by_velocity: Array
    """∂r/∂v₀, (n, 3, 3)."""
    by_gm: Array
    """∂r/∂μ, (n, 3); zero where μ is zero, as no orbit begins there."""


def two_bodies(place: Array, velocity: Array, gm: Array, time: Array) -> TwoBodies:
    """Return the places of orbits at times.

    Args:
        place: r₀, (n, 3) metres.
        velocity: v₀, (n, 3) metres per second.
        gm: μ, (n,) m³/s²; zero: a straight line.
        time: t, (n,) seconds.

    Raises:
        DegenerateError: μ is negative, or the orbit begins or passes at the centre.
    """
    require(gm >= 0.0, "the gravitational parameter gm of an arc is negative")
    n, eye = len(time), np.eye(3)
    out = TwoBodies(
        place + time[:, None] * velocity,
        velocity.copy(),
        np.tile(eye, (n, 1, 1)),
        time[:, None, None] * eye,
        np.zeros((n, 3)),
    )
    on = np.flatnonzero(gm > 0.0)
    if not len(on):
        return out
    r0, v0, mu, t = place[on], velocity[on], gm[on], time[on]
    first = np.linalg.norm(r0, axis=1)
    valid = np.ones(n, dtype=bool)
    valid[on] = first > 0.0
    require(valid, "an arc with gm begins at the centre of the body: state its x, y, z")
    eta, square = np.sum(r0 * v0, axis=1), np.sum(v0 * v0, axis=1)
    beta = 2.0 * mu / first - square
    s = _universal_variable(first, eta, mu, beta, t)
    with np.errstate(all="ignore"):
        g0, g1, g2, g3, g4, g5 = _universal_functions(s, beta)
        r = first * g0 + eta * g1 + mu * g2
        missed = first * g1 + eta * g2 + mu * g3 - t
        scale = np.abs(t) + np.abs(s) * first
        valid[on] = (r > 0.0) & (np.abs(missed) <= 1e-12 * scale)
    require(valid, "an arc passes the centre of the body, where its orbit ends")
    f, g = 1.0 - mu * g2 / first, t - mu * g3
    w = (g1 / (r * first))[:, None] * r0 + (g2 / r)[:, None] * v0
    at = f[:, None] * r0 + g[:, None] * v0
    v = v0 - mu[:, None] * w
    rest = 3.0 * g5 - s * g4
    d = mu * rest - t * g2
    cube = first**3

    def times(factor: Array, a: Array, b: Array) -> Array:
        return np.asarray(factor[:, None, None] * a[:, :, None] * b[:, None, :])

    out.place[on], out.velocity[on] = at, v
    out.by_place[on] = (
        f[:, None, None] * eye
        + times(mu * r, w, w)
        + times(mu * g2 / cube, at, r0)
        + times(mu * d / cube, v, r0)
    )
    out.by_velocity[on] = (
        g[:, None, None] * eye + times(g2, at - r0, v0) + times(g2 * mu, w, r0) + times(d, v, v0)
    )
    # (t v − (∂r/∂v₀) v₀)/2μ with the factor μ of each difference taken out: no digit is lost.
    moved = (t[:, None] * w) - (g2 / first)[:, None] * r0 - g3[:, None] * v0
    twice = g3[:, None] * v0 - (t + g2 * eta)[:, None] * w
    twice -= square[:, None] * (g2[:, None] * moved + rest[:, None] * v)
    out.by_gm[on] = twice / 2.0
    return out


def _universal_functions(s: Array, beta: Array) -> tuple[Array, ...]:
    """Return G₀ … G₅ (n,) of s and β (n,)."""
    z = beta * s * s
    near = np.abs(z) <= SERIES_WITHIN
    small, large = np.where(near, z, 0.0), np.where(near, SERIES_WITHIN, z)
    root = np.sqrt(np.abs(large))
    cosine = np.where(large > 0, np.cos(root), np.cosh(root))
    sine = np.where(large > 0, np.sin(root), np.sinh(root)) / root
    c2, c3 = (1.0 - cosine) / large, (1.0 - sine) / large
    far = (0.5 - c2) / large, (1.0 / 6.0 - c3) / large
    c4, c5 = (np.where(near, _series(k, small), c) for k, c in zip((4, 5), far, strict=True))
    c2, c3 = 0.5 - z * c4, 1.0 / 6.0 - z * c5
    c0, c1 = 1.0 - z * c2, 1.0 - z * c3
    return c0, c1 * s, c2 * s**2, c3 * s**3, c4 * s**4, c5 * s**5


def _series(k: int, z: Array) -> Array:
    """Return cₖ(z) = Σ (−z)ⁱ/(k + 2i)!, (n,)."""
    total = np.zeros_like(z)
    for i in reversed(range(SERIES_TERMS)):
        total = 1.0 / factorial(k + 2 * i) - z * total
    return total


def _universal_variable(r0: Array, eta: Array, mu: Array, beta: Array, t: Array) -> Array:
    """Return s (n,) at which the time is t, by Laguerre's method, which converges from afar."""
    s = t / r0
    with np.errstate(all="ignore"):
        for _ in range(MAX_STEPS):
            g0, g1, g2, g3, _, _ = _universal_functions(s, beta)
            f = r0 * g1 + eta * g2 + mu * g3 - t
            df = r0 * g0 + eta * g1 + mu * g2
            ddf = eta * g0 + (mu - beta * r0) * g1
            root = np.sqrt(np.abs(16.0 * df * df - 20.0 * f * ddf))
            step = -5.0 * f / (df + np.copysign(root, df))
            s = s + step
            if np.all(np.abs(step) <= 1e-15 * np.abs(s)) or not np.isfinite(step).all():
                break
    return s


def arc_places(frame: Frame, arc: Array, time: Array) -> tuple[Array, Array]:
    """Return the places X(t) of arcs, (n, 3) metres, and their partials (n, 3, k).

    Args:
        frame: frame of the network.
        arc: x, y, z, x_t, y_t, z_t, then gm, spin, x_tt, y_tt … as far as arcs have them, (n, k).
        time: t, (n,) seconds.
    """
    n, size = arc.shape
    full = np.zeros((n, TERMS + 3 * (HIGHEST_POWER - 1)))
    full[:, :size] = arc
    rows, origin = np.eye(3), np.zeros(3)
    if isinstance(frame, TopocentricFrame):
        rows, origin = frame.axes_in_geocentric, frame.to_geocentric(np.zeros((1, 3)))[0]
    found = two_bodies(full[:, :3] @ rows + origin, full[:, 3:6] @ rows, full[:, GM], time)
    turn = full[:, SPIN] * time
    c, s = np.cos(turn), np.sin(turn)
    to_body = np.zeros((n, 3, 3))
    to_body[:, 0, 0], to_body[:, 0, 1], to_body[:, 1, 0], to_body[:, 1, 1] = c, s, -s, c
    to_body[:, 2, 2] = 1.0
    to_network = rows @ to_body
    turned = np.einsum("nij,nj->ni", to_body, found.place)
    by = np.zeros((n, 3, full.shape[1]))
    by[:, :, :3] = to_network @ found.by_place @ rows.T
    by[:, :, 3:6] = to_network @ found.by_velocity @ rows.T
    by[:, :, GM] = np.einsum("nij,nj->ni", to_network, found.by_gm)
    across = np.stack([turned[:, 1], -turned[:, 0], np.zeros(n)], axis=1)
    by[:, :, SPIN] = time[:, None] * (across @ rows.T)
    place = (turned - origin) @ rows.T
    for power in range(2, HIGHEST_POWER + 1):
        first = TERMS + 3 * (power - 2)
        term = time**power
        place = place + term[:, None] * full[:, first : first + 3]
        by[:, :, first : first + 3] = term[:, None, None] * np.eye(3)
    return place, by[:, :, :size]


def photo_on_arc(
    frame: Frame, pose: Array, arc: Array, *, observed: Array, time: Array
) -> Linearised:
    """Compute D Rᵀ (X₀ − X(t)) − observed, metres in axes of the camera, (n, 3).

    These axes turn with the object, as the orbit does: residuals tell nothing of its direction.

    Args:
        frame: frame of the network.
        pose: stored poses, (n, 12).
        arc: arcs, (n, k), see `arc_places`.
        observed: places of the projection centre against the arc, photogrammetric axes, (n, 3).
        time: t, (n,) seconds.
    """
    place, by_arc = arc_places(frame, arc, time)
    rotation, centre = split_pose(pose)
    back = TURN_ABOUT_X @ np.swapaxes(rotation, 1, 2)
    off = np.einsum("nij,nj->ni", back, centre - place)
    by_turn = TURN_ABOUT_X @ skew(off @ TURN_ABOUT_X)
    return Linearised(off - observed, (np.concatenate([by_turn, back], axis=2), -back @ by_arc))
