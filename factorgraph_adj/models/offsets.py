"""Offsets from planes, lines and sights; water levels; stretched wires with sag (FRAMES F13).

Each function takes the variables it touches as arrays (n, …), the observed values (n, 1) and
constants, and returns v = computed − observed, metres, with partials in the order of the variables.

The frame of a wire (LGC2 ECWI) has its y axis along the chord, from one fixing at y = 0 to the
other at y = L, and x across it. A point of the wire at the fraction τ = t/L of its length is

    w(t) = (0, t, 0) + 4 s (τ² − τ) g

with the sag s in the middle (s = W L²/8T, weight W per length, tension T) and the vertical g at the
origin of the frame, both in the axes of the wire. A sensor at the point P reads where the wire
passes, in its own axes x and z, of its zero P + K b:

    r = (m_x·d, m_z·d),   d = w(t) − q − a,   m_i = K B e_i,   a = K b,   t = m_y·(q + a) / m_y,y

K turns from the carrier of the sensor to the wire, B and b are the mount of the sensor on its
carrier; t is where the chord passes the plane of the sensor. The carrier is either the body in
whose frame the sensor sits, or it is set up level and across the wire: x horizontal, z vertical.
A roll of the sensor is the rotation of its mount about y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..rotation import skew
from ..types import Array
from .base import Linearised, NoDirectionError, require
from .directions import (
    Verticals,
    direction_in_frame,
    of_those_there,
    split_mount,
    vertical_in_frame,
)
from .line_of_sight import Sights, sight, turned_by_angles
from .positions import MOUNT_COMPONENTS, heights
from .sub_frame import COMPONENTS, InFrame, horizons, in_frame, split_frame

NO_OFFSET = "the point lies on the line: its offset has no direction"
NO_LINE = "the two points of the line coincide"
_SHORTEST = 1e-9
"""Smallest offset from a line, and smallest length of a line, metres."""
PARALLEL = "the wire is parallel to the plane of its sensor"
UPRIGHT = "the wire is vertical: no level sensor can be set up across it"
_STEEPEST = 1e-3
"""Smallest sine of the angle between the wire and the plane of a sensor, or the vertical."""
_Y = np.array([0.0, 1.0, 0.0])


def _of_q(
    there: InFrame, v: Array, gradient: Array, origin: Array | None, vertical: Array | None
) -> Linearised:
    """Return v (n,) with its partials, from those by q (n, 3)."""
    g = gradient[:, None, :]
    at_origin = of_those_there(((origin, g @ there.by_origin), (vertical, g @ there.by_vertical)))
    return Linearised(v[:, None], (g @ there.by_frame, g @ there.by_place, *at_origin))


def plane_offset(
    frame: Frame,
    stored: Array,
    point: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute q_x − observed: the distance from the plane x = 0 of a frame. LGC2 ECHO."""
    there = in_frame(frame, stored, point, origin, vertical)
    along = np.broadcast_to([1.0, 0.0, 0.0], (len(point), 3))
    return _of_q(there, there.q[:, 0] - observed[:, 0], along, origin, vertical)


def plumb_offset(
    frame: Frame,
    stored: Array,
    point: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute ρ − observed, ρ = hypot(q_x, q_y): the distance from the z axis of a frame.

    ∂ρ/∂q = (q_x, q_y, 0)/ρ. LGC2 ECVE.
    """
    there = in_frame(frame, stored, point, origin, vertical)
    rho = np.hypot(there.q[:, 0], there.q[:, 1])
    require(rho > _SHORTEST, NO_OFFSET, NoDirectionError)
    away = there.q * np.array([1.0, 1.0, 0.0]) / rho[:, None]
    return _of_q(there, rho - observed[:, 0], away, origin, vertical)


def line_offset(
    frame: Frame, point: Array, start: Array, end: Array, *, observed: Array
) -> Linearised:
    """Compute |P − F| − observed: the distance from the straight line through A and B.

    F = A + t (B − A), t = (P − A)·(B − A)/|B − A|². With e = (P − F)/|P − F| the partials are
    e by P, −(1 − t) e by A and −t e by B. LGC2 ECSP.
    """
    line, away = end - start, point - start
    square = np.sum(line * line, axis=1)
    require(square > _SHORTEST**2, NO_LINE)
    t = (np.sum(away * line, axis=1) / square)[:, None]
    normal = away - t * line
    offset = np.linalg.norm(normal, axis=1)
    require(offset > _SHORTEST, NO_OFFSET, NoDirectionError)
    e = normal / offset[:, None]
    partials = tuple(j[:, None, :] for j in (e, -(1.0 - t) * e, -t * e))
    return Linearised(offset[:, None] - observed, partials)


def _sighted(s: Sights, v: Array, gradient: Array, by_orientation: Array) -> Linearised:
    return Linearised(v[:, None], (*s.chain(gradient), by_orientation[:, None, None]))


def sight_plane_offset(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    orientation: Array,
    *,
    observed: Array,
    horizontal: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute −cos α q_e + sin α q_n − observed, α = orientation + horizontal reading.

    The offset from the vertical plane of a theodolite is positive to the left of its sight.
    LGC2 ECTH.
    """
    s = sight(
        frame, station, station_vertical, target, target_vertical, instrument_height, target_height
    )
    alpha = orientation[:, 0] + horizontal
    left = np.stack([-np.cos(alpha), np.sin(alpha), np.zeros_like(alpha)], 1)
    forward = np.sin(alpha) * s.q[:, 0] + np.cos(alpha) * s.q[:, 1]
    v = np.sum(left * s.q, axis=1) - observed[:, 0]
    return _sighted(s, v, left, forward)


def sight_offset(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    orientation: Array,
    *,
    observed: Array,
    horizontal: Array,
    zenith: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute |q − (l·q) l| − observed, l the unit vector of the theodolite's sight.

    l = (sin α sin ζ, cos α sin ζ, cos ζ), α = orientation + horizontal reading, ζ the zenith
    reading. With n = q − (l·q) l the partials are n/|n| by q and −(l·q) n·∂l/∂α / |n| by the
    orientation. LGC2 ECDIR.
    """
    s = sight(
        frame, station, station_vertical, target, target_vertical, instrument_height, target_height
    )
    alpha = orientation[:, 0] + horizontal
    line = np.stack(
        [np.sin(alpha) * np.sin(zenith), np.cos(alpha) * np.sin(zenith), np.cos(zenith)], 1
    )
    turned = np.stack(
        [np.cos(alpha) * np.sin(zenith), -np.sin(alpha) * np.sin(zenith), np.zeros_like(alpha)], 1
    )
    along = np.sum(line * s.q, axis=1)
    normal = s.q - along[:, None] * line
    offset = np.linalg.norm(normal, axis=1)
    require(offset > _SHORTEST, NO_OFFSET, NoDirectionError)
    away = normal / offset[:, None]
    return _sighted(s, offset - observed[:, 0], away, -along * np.sum(away * turned, axis=1))


def radial_offset(
    frame: Frame,
    point: Array,
    *,
    observed: Array,
    bearing: Array,
    reference_x: Array,
    reference_y: Array,
    reference_z: Array,
) -> Linearised:
    """Compute −cos β e·(X − X₀) + sin β n·(X − X₀) − observed, metres.

    e and n point east and north at the reference X₀: the offset of a point from the line through
    X₀ with the bearing β, positive to the left. LGC2 RADI.
    """
    reference = np.stack([reference_x, reference_y, reference_z], 1)
    enu = frame.basis(reference, np.zeros((len(reference), 2))).enu
    left = -np.cos(bearing)[:, None] * enu[:, 0] + np.sin(bearing)[:, None] * enu[:, 1]
    v = np.sum(left * (point - reference), axis=1)
    return Linearised(v[:, None] - observed, (left[:, None, :],))


def hydrostatic_reading(
    frame: Frame,
    point: Array,
    level: Array,
    mount: Array,
    *,
    observed: Array,
    undulation: Array,
    expansion: Array,
    side: Array,
) -> Linearised:
    """Compute side (w + N − h(P) − b_z)/(1 + α ΔT) − observed, metres.

    w is the height of the water, N the undulation of its surface at the sensor (geoid, tide), h(P)
    the height of the sensor's point, b_z the zero of the sensor above this point, α ΔT the relative
    expansion, side +1 for a sensor that reads upwards to the water and −1 for one that reads
    downwards. LGC2 ECWS.
    """
    height, up = heights(frame, point)
    factor = side / (1.0 + expansion)
    above = level[:, 0] + undulation - height - split_mount(mount)[1][:, 2]
    n = len(point)
    by_mount = np.zeros((n, 1, MOUNT_COMPONENTS))
    by_mount[:, 0, 5] = -factor
    return Linearised(
        (factor * above)[:, None] - observed,
        (-(factor[:, None] * up)[:, None, :], factor[:, None, None], by_mount),
    )


class _Carrier(NamedTuple):
    """Axes of the carriers of n sensors in the frames of their wires."""

    axes: Array
    """K, (n, 3, 3): its columns are the axes of the carrier."""
    by: tuple[Array, ...]
    """∂K/∂variable, (n, 3, 3, k), of each variable on which K depends."""


class _Reading(NamedTuple):
    """Readings of n sensors and their gradients."""

    value: Array
    """(m_x·d, m_y·d, m_z·d), (n, 3)."""
    by_q: Array
    """(n, 3, 3)."""
    by_axes: Array
    """∂r/∂K, (n, 3, 3, 3)."""
    by_up: Array
    """∂r/∂g, (n, 3, 3)."""
    by_sag: Array
    """(n, 3, 1)."""
    by_mount: Array
    """(n, 3, 6)."""


def _read(q: Array, axes: Array, up: Array, sag: Array, mount: Array, length: Array) -> _Reading:
    """Return readings of sensors at q (n, 3) with carriers K ``axes`` (n, 3, 3)."""
    turn, arm = split_mount(mount)
    sensor = axes @ turn  # columns m_i
    a = np.einsum("nij,nj->ni", axes, arm)
    at = q + a
    m_y = sensor[:, :, 1]
    slant = m_y[:, 1]
    require(np.abs(slant) > _STEEPEST, PARALLEL)
    t = np.sum(m_y * at, axis=1) / slant
    tau = t / length
    bend = 4.0 * (tau**2 - tau)
    d = t[:, None] * _Y + (sag * bend)[:, None] * up - at
    value = np.einsum("nij,ni->nj", sensor, d)
    # ∂w/∂t, and through it what moves t.
    along = _Y + (sag * 4.0 * (2.0 * tau - 1.0) / length)[:, None] * up
    by_t = np.einsum("nij,ni->nj", sensor, along)
    by_q = -sensor.transpose(0, 2, 1) + by_t[:, :, None] * (m_y / slant[:, None])[:, None, :]
    t_by_my = (at - t[:, None] * _Y) / slant[:, None]
    # ∂r_i/∂m_j = δ_ij d + δ_jy by_t ∂t/∂m_y
    by_m = np.zeros((len(q), 3, 3, 3))  # row i, component of m_j, j
    for i in range(3):
        by_m[:, i, :, i] = d
    by_m[:, :, :, 1] += by_t[:, :, None] * t_by_my[:, None, :]
    # m_j = Σ_k K_k B_kj and a = Σ_k K_k b_k
    by_axes = np.einsum("niaj,nkj->niak", by_m, turn) + by_q[..., None] * arm[:, None, None, :]
    by_mount = np.zeros((len(q), 3, MOUNT_COMPONENTS))
    turning = -skew(np.eye(3))  # ∂(B Exp(β) e_j)/∂β = −B [e_j]×
    by_mount[:, :, :3] = np.einsum("niaj,nab,jbc->nic", by_m, sensor, turning)
    by_mount[:, :, 3:] = by_q @ axes
    return _Reading(
        value,
        by_q,
        by_axes,
        (sag * bend)[:, None, None] * sensor.transpose(0, 2, 1),
        (bend[:, None] * np.einsum("nij,ni->nj", sensor, up))[:, :, None],
        by_mount,
    )


def _level_carrier(up: Array) -> _Carrier:
    """Return carriers that are set up level and across the wire; K depends on g alone."""
    across = np.cross(_Y, up)
    sine = np.linalg.norm(across, axis=1)
    require(sine > _STEEPEST, UPRIGHT)
    x = across / sine[:, None]
    y = np.cross(up, x)
    eye = np.eye(3)
    x_by_up = (eye - x[:, :, None] * x[:, None, :]) @ skew(_Y[None]) / sine[:, None, None]
    y_by_up = skew(up) @ x_by_up - skew(x)
    z_by_up = np.broadcast_to(eye, x_by_up.shape)
    return _Carrier(np.stack([x, y, up], 2), (np.stack([x_by_up, y_by_up, z_by_up], 2),))


def _wire_and_up(
    frame: Frame, wire: Array, point: Array, origin: Array | None, vertical: Array | None
) -> tuple[InFrame, Verticals]:
    """Return points in the frames of their wires, and the vertical at the origins there."""
    there = in_frame(frame, wire, point, origin, vertical)
    at = split_frame(wire).origin if origin is None else origin
    deflection = np.zeros((len(wire), 2)) if vertical is None else vertical
    return there, vertical_in_frame(frame, wire, at, deflection, origin, vertical)


def wire_reading(
    frame: Frame,
    wire: Array,
    point: Array,
    sag: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
    length: Array,
    axes: tuple[int, ...] = (0, 2),
) -> Linearised:
    """Compute the reading of a sensor that is set up level − observed, metres, (n, d).

    Args:
        frame: frame of the network.
        wire: frames of the wires, (n, 17).
        point: P, metres, (n, 3).
        sag: s, metres, (n, 1).
        mount: stored mounts of the sensors, (n, 12).
        origin: O of the wire where it is a point, (n, 3).
        vertical: deflections at O, (n, 2).
        observed: (n, d).
        length: L, metres, (n,).
        axes: read axes, 0: x, 2: z.
    """
    there, up = _wire_and_up(frame, wire, point, origin, vertical)
    carrier = _level_carrier(up.g)
    r = _read(there.q, carrier.axes, up.g, sag[:, 0], mount, length)
    by_up = r.by_up + np.einsum("niak,nakc->nic", r.by_axes, carrier.by[0])
    by_wire = r.by_q @ there.by_frame + by_up @ up.by_frame
    by_origin = r.by_q @ there.by_origin + by_up @ (up.by_origin + up.by_place)
    by_vertical = r.by_q @ there.by_vertical + by_up @ (up.by_vertical + up.by_deflection)
    every = [by_wire, r.by_q @ there.by_place, r.by_sag, r.by_mount]
    every += of_those_there(((origin, by_origin), (vertical, by_vertical)))
    rows = list(axes)
    return Linearised(r.value[:, rows] - observed, tuple(j[:, rows] for j in every))


def wire_reading_on_body(
    frame: Frame,
    wire: Array,
    body: Array,
    point: Array,
    sag: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    body_origin: Array | None,
    body_vertical: Array | None,
    *,
    observed: Array,
    length: Array,
    axes: tuple[int, ...] = (0, 2),
) -> Linearised:
    """Compute the reading of a sensor on a body − observed, metres, (n, d).

    K = R_wᵀ E_w E_bᵀ R_b with the frame of the body that carries the sensor, ``body`` (n, 17), and
    its origin and deflections where it is a point. The other arguments are those of `wire_reading`.
    """
    there, up = _wire_and_up(frame, wire, point, origin, vertical)
    carrier = _carried(frame, wire, body, point, (origin, vertical), (body_origin, body_vertical))
    r = _read(there.q, carrier.axes, up.g, sag[:, 0], mount, length)
    turned = [np.einsum("niak,nakc->nic", r.by_axes, j) for j in carrier.by]
    by_wire, by_body, by_origin, by_vertical, by_body_origin, by_body_vertical = turned
    every = [
        r.by_q @ there.by_frame + r.by_up @ up.by_frame + by_wire,
        by_body,
        r.by_q @ there.by_place,
        r.by_sag,
        r.by_mount,
    ]
    by_up = r.by_up @ (up.by_origin + up.by_place)
    by_origin = r.by_q @ there.by_origin + by_up + by_origin
    by_up = r.by_up @ (up.by_vertical + up.by_deflection)
    by_vertical = r.by_q @ there.by_vertical + by_up + by_vertical
    every += of_those_there(
        (
            (origin, by_origin),
            (vertical, by_vertical),
            (body_origin, by_body_origin),
            (body_vertical, by_body_vertical),
        )
    )
    rows = list(axes)
    return Linearised(r.value[:, rows] - observed, tuple(j[:, rows] for j in every))


def _carried(
    frame: Frame,
    wire: Array,
    body: Array,
    near: Array,
    at_wire: tuple[Array | None, Array | None],
    at_body: tuple[Array | None, Array | None],
) -> _Carrier:
    """Return carriers in the frames of their wires, with what their axes depend on.

    ∂K/∂variable is that by the frames of wire and body, and by origin and deflections of both.
    """
    n = len(wire)
    rotation, _, _, constant, level = split_frame(body)
    origin, vertical = at_body
    at = constant if origin is None else origin
    is_level = (level != 0)[:, None]
    deflection = np.zeros((n, 2)) if vertical is None else vertical
    basis = frame.basis(np.where(is_level, at, near), deflection)
    horizon = horizons(basis, level)
    to_object = horizon.transpose(0, 2, 1)
    by_wire, by_body = np.zeros((2, n, 3, 3, COMPONENTS))
    by_origin, by_body_origin = np.zeros((2, n, 3, 3, 3))
    by_vertical, by_body_vertical = np.zeros((2, n, 3, 3, 2))
    axes = np.zeros((n, 3, 3))
    for k in range(3):
        axis = np.einsum("nij,nj->ni", to_object, rotation[:, :, k])
        d = direction_in_frame(frame, wire, axis, near, *at_wire)
        axes[:, :, k] = d.g
        by_wire[:, :, k], by_origin[:, :, k] = d.by_frame, d.by_origin
        by_vertical[:, :, k] = d.by_vertical
        # As the horizon turns, E changes by S E, and Eᵀ by −Eᵀ S.
        by_angles = np.where(is_level, -1.0, 0.0)[:, :, None] * (
            d.by_vector @ to_object @ turned_by_angles(rotation[:, :, k], basis)
        )
        by_body_origin[:, :, k] = by_angles @ basis.angles_by_position
        by_body_vertical[:, :, k] = by_angles @ basis.angles_by_vertical
    turning = -skew(np.eye(3))  # ∂(K Exp(ω) e_k)/∂ω = −K [e_k]×
    by_body[..., :3] = np.einsum("nab,kbc->nakc", axes, turning)
    return _Carrier(
        axes, (by_wire, by_body, by_origin, by_vertical, by_body_origin, by_body_vertical)
    )
