"""The line of sight in the horizon of its station; partials by both points and both verticals.

    d = (X_j + h_t u_j) − (X_i + h_i u_i)          q = (e·d, n·d, u·d)

Every terrestrial observation is a small function of q. Only this module defines q and its
partials by X_i, V_i, X_j, V_j. A change of (Φ, Λ) turns the basis:

    ∂q/∂Φ = (0, −q_u, q_n)      ∂q/∂Λ = (sinΦ q_n − cosΦ q_u, −sinΦ q_e, cosΦ q_e)
    ∂u/∂Φ = n                   ∂u/∂Λ = cosΦ e
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Basis, Frame
from ..types import Array


class Sights(NamedTuple):
    """n lines of sight."""

    q: Array
    """East, north and up component in the frame of the station, metres, (n, 3)."""
    by_station: Array
    """∂q/∂X_i, (n, 3, 3)."""
    by_station_vertical: Array
    """∂q/∂V_i, metres per radian, (n, 3, 2)."""
    by_target: Array
    """∂q/∂X_j, (n, 3, 3)."""
    by_target_vertical: Array
    """∂q/∂V_j, metres per radian, (n, 3, 2)."""

    def chain(self, gradient: Array) -> tuple[Array, Array, Array, Array]:
        """Return the partials by X_i, V_i, X_j, V_j, (n, 1, k), of f(q) with ∂f/∂q (n, 3)."""
        g = gradient[:, None, :]
        return (
            g @ self.by_station,
            g @ self.by_station_vertical,
            g @ self.by_target,
            g @ self.by_target_vertical,
        )


def up_by_angles(basis: Basis) -> Array:
    """Return ∂u/∂(Φ, Λ), (n, 3, 2)."""
    return np.stack([basis.enu[:, 1], basis.cos_latitude[:, None] * basis.enu[:, 0]], axis=-1)


def turned_by_angles(q: Array, basis: Basis) -> Array:
    """Return ∂q/∂(Φ, Λ), (n, 3, 2), of vectors d with coordinates q (n, 3) in the horizon."""
    s, c = basis.sin_latitude, basis.cos_latitude
    e, n, u = q[:, 0], q[:, 1], q[:, 2]
    out = np.zeros((len(q), 3, 2))
    out[:, 1, 0], out[:, 2, 0] = -u, n
    out[:, 0, 1], out[:, 1, 1], out[:, 2, 1] = s * n - c * u, -s * e, c * e
    return out


def sight(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    instrument_height: Array,
    target_height: Array,
    *,
    reverse: bool = False,
) -> Sights:
    """Return the lines of sight from stations (n, 3) to targets (n, 3).

    ``reverse`` expresses the same d in the frame of the target (for eq. 10).
    """
    at_i = frame.basis(station, station_vertical)
    at_j = frame.basis(target, target_vertical)
    hi, ht = instrument_height[:, None], target_height[:, None]
    # The difference of the marks comes first. A sum with geocentric coordinates would lose a
    # nanometre, and vᵀPv would no longer resolve steps of 1e-3 σ.
    d = (target - station) + (ht * at_j.enu[:, 2] - hi * at_i.enu[:, 2])
    basis = at_j if reverse else at_i
    rotation = basis.enu
    q = np.einsum("nij,nj->ni", rotation, d)

    # d and the basis depend on the angles; the angles depend on position and deflections.
    from_i = -hi[:, :, None] * (rotation @ up_by_angles(at_i))
    from_j = ht[:, :, None] * (rotation @ up_by_angles(at_j))
    turned = turned_by_angles(q, basis)
    if reverse:
        from_j = from_j + turned
    else:
        from_i = from_i + turned
    return Sights(
        q,
        -rotation + from_i @ at_i.angles_by_position,
        from_i @ at_i.angles_by_vertical,
        rotation + from_j @ at_j.angles_by_position,
        from_j @ at_j.angles_by_vertical,
    )
