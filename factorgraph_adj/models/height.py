"""Heights of places above the reference surface of the frame."""

from __future__ import annotations

import numpy as np

from ..frames import Frame, LocalFrame
from ..types import Array


def heights(frame: Frame, position: Array) -> tuple[Array, Array]:
    """Return heights h (n,) of places (n, 3), metres, and their gradients ∂h/∂X (n, 3).

    - geocentric and topocentric frames: the ellipsoidal height, whose gradient is the normal;
    - a flat local frame: Z;
    - a curved local frame: Z + d²/2R, with the distance d in plan from the place where Z is
      vertical.
    """
    found = frame.geodetic(position)
    if found is not None:
        return found[2], frame.basis(position, np.zeros((len(position), 2))).enu[:, 2]
    assert isinstance(frame, LocalFrame)
    height = position[:, 2].copy()
    gradient = np.zeros_like(position)
    gradient[:, 2] = 1.0
    if frame.curvature:
        away = position[:, :2] - np.asarray(frame.origin)[:2]
        height += np.sum(away**2, axis=1) / (2.0 * frame.radius)
        gradient[:, :2] = away / frame.radius
    return height, gradient
