"""Brown's model about a centre of distortion of its own, measured → ideal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .lens import Lens, brown_terms


@dataclass(frozen=True)
class CentredBrownLens(Lens):
    """Brown, measured → ideal, about a centre of distortion beside the principal point.

    With a = (x̄, ȳ) from the principal point and q = a − (xd, yd): corrected = a + brown(q) +
    (b1 q_x + b2 q_y, 0). Units: k_i in 1/unit^2i, p in 1/unit; xd and yd, the centre of distortion
    from the principal point, in image units. This is the model of MicMac (RadialStd, Fraser), whose
    y points down: its p2 and b2 are −p2 and −b2 here. Only distortion tells the centre: xd and yd
    are undetermined where the radial terms are zero.
    """

    kind: ClassVar[str] = "brown_centred"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1", "b2", "xd", "yd")

    def _correction(
        self, x: Array, y: Array, k: Array, partials: bool
    ) -> tuple[Array, Array, tuple[Array, ...], list[tuple[Array, Array]]]:
        b1, b2, xd, yd = (k[:, j] for j in range(8, 12))
        qx, qy = x - xd, y - yd
        dx, dy, d, columns = brown_terms(qx, qy, tuple(k[:, j] for j in range(3, 8)), 0.0, partials)
        dx = dx + b1 * qx + b2 * qy
        if not partials:
            return dx, dy, (), []
        dxx, dxy, dyx, dyy = d[0] + b1, d[1] + b2, d[2], d[3]
        zero = np.zeros_like(qx)
        columns = [*columns, (qx, zero), (qy, zero), (-dxx, -dyx), (-dxy, -dyy)]
        return dx, dy, (dxx, dxy, dyx, dyy), columns
