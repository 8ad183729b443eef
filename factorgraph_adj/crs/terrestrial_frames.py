"""Transformations of GNSS frames at an epoch: ITRF of all years, GDA94, GDA2020.

From ITRF2014 to another frame at the epoch t, with t₀ of the parameters and τ = t − t₀:

    X' = X + T + Ṫ τ + (D + Ḋ τ) X + (r + ṙ τ) × X

in the convention of position vectors (IERS). Sources: IGN, Transformation parameters from ITRF2014
to past ITRFs (2016) and from ITRF2020 to past ITRFs (2022); ICSM, GDA2020 Technical Manual 1.8
(2023), tables 3.1 and 3.3, whose rotations have the opposite sign (coordinate frame convention);
J. Dawson, A. Woods, ITRF to GDA94 coordinate transformations, Journal of Applied Geodesy 4 (2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Array
from ..units import ARCSEC

_MM, _PPB, _MAS = 1e-3, 1e-9, 1e-3 * ARCSEC


@dataclass(frozen=True)
class FrameTransformation:
    """Transformation between two frames whose parameters change with time."""

    epoch: float
    """t₀, years."""
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """T, millimetres."""
    scale: float = 0.0
    """D, 10⁻⁹."""
    translation_rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Ṫ, millimetres per year."""
    scale_rate: float = 0.0
    """Ḋ, 10⁻⁹ per year."""
    rotation_rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """ṙ, milliseconds of arc per year."""
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """r, milliseconds of arc."""

    def at(self, epoch: float) -> tuple[Array, Array]:
        """Return the matrix (3, 3) and the translation (3,), metres, at an epoch, years."""
        after = epoch - self.epoch
        x, y, z = _MAS * (np.array(self.rotation) + after * np.array(self.rotation_rate))
        turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        matrix = (1.0 + _PPB * (self.scale + after * self.scale_rate)) * np.eye(3) + turn
        shift = np.array(self.translation) + after * np.array(self.translation_rate)
        return matrix, _MM * shift


FROM_ITRF2014: dict[str, FrameTransformation] = {
    "ITRF2014": FrameTransformation(2010.0),
    "ITRF2020": FrameTransformation(2015.0, (1.4, 0.9, -1.4), 0.42, (0.0, 0.1, -0.2)),
    "ITRF2008": FrameTransformation(2010.0, (1.6, 1.9, 2.4), -0.02, (0.0, 0.0, -0.1), 0.03),
    "ITRF2005": FrameTransformation(2010.0, (2.6, 1.0, -2.3), 0.92, (0.3, 0.0, -0.1), 0.03),
    "ITRF2000": FrameTransformation(2010.0, (0.7, 1.2, -26.1), 2.12, (0.1, 0.1, -1.9), 0.11),
    **{
        name: FrameTransformation(
            *(2010.0, shift, scale, (0.1, -0.5, -3.3), 0.12),
            rotation=rotation,
            rotation_rate=(0.0, 0.0, 0.02),
        )
        for name, shift, scale, rotation in (
            ("ITRF1997", (7.4, -0.5, -62.8), 3.80, (0.0, 0.0, 0.26)),
            ("ITRF1996", (7.4, -0.5, -62.8), 3.80, (0.0, 0.0, 0.26)),
            ("ITRF1994", (7.4, -0.5, -62.8), 3.80, (0.0, 0.0, 0.26)),
            ("ITRF1992", (15.4, 1.5, -70.8), 3.09, (0.0, 0.0, 0.26)),
            ("ITRF1991", (27.4, 15.5, -76.8), 4.49, (0.0, 0.0, 0.26)),
            ("ITRF1990", (25.4, 11.5, -92.8), 4.79, (0.0, 0.0, 0.26)),
            ("ITRF1989", (30.4, 35.5, -130.8), 8.19, (0.0, 0.0, 0.26)),
            ("ITRF1988", (25.4, -0.5, -154.8), 11.29, (0.1, 0.0, 0.26)),
        )
    },
    "ITRF1993": FrameTransformation(
        *(2010.0, (-50.4, 3.3, -60.2), 4.29, (-2.8, -0.1, -2.5), 0.12),
        rotation=(-2.81, -3.38, 0.40),
        rotation_rate=(-0.11, -0.19, 0.07),
    ),
    "GDA2020": FrameTransformation(2020.0, rotation_rate=(-1.50379, -1.18346, -1.20716)),
}
"""Transformations from ITRF2014 by the name of the other frame."""
GDA94_TO_GDA2020 = FrameTransformation(
    *(2020.0, (61.55, -10.87, -40.19), -9.994), rotation=(39.4924, 32.7221, 32.8979)
)
"""ICSM's seven parameters; they do not change with time."""
ITRF2008_TO_GDA94 = FrameTransformation(
    *(1994.0, (-84.68, -19.42, 32.01), 9.710, (1.42, 1.34, 0.90), 0.109),
    rotation=(0.4254, -2.2578, -2.4015),
    rotation_rate=(-1.5461, -1.1820, -1.1551),
)
"""Dawson and Woods, table 3."""
TERRESTRIAL_FRAMES = (*FROM_ITRF2014, "GDA94")
"""Names of the frames."""


def frame_transformation(
    source: str, target: str, epoch: float, *, by_gda94: bool = False
) -> tuple[Array, Array]:
    """Return matrix A (3, 3) and translation b (3,), metres, of X_target = A X_source + b.

    Args:
        source: frame of X.
        target: frame wanted.
        epoch: epoch of the measurement, years. In frames of a plate, such as GDA2020, a point that
            moves with the plate keeps its coordinates.
        by_gda94: whether ITRF2008 is connected by GDA94, with the parameters of Dawson and Woods,
            instead of ITRF2014: 4 nrad and 1 ppb of difference in 2015.

    Raises:
        KeyError: a frame is not in `TERRESTRIAL_FRAMES`.
    """
    a, s = _from_itrf2014(source, epoch, by_gda94)
    b, t = _from_itrf2014(target, epoch, by_gda94)
    matrix = b @ np.linalg.inv(a)
    return matrix, t - matrix @ s


def _from_itrf2014(name: str, epoch: float, by_gda94: bool) -> tuple[Array, Array]:
    if name == "GDA94":
        return _inverse_step(GDA94_TO_GDA2020, "GDA2020", epoch, by_gda94)
    if name == "ITRF2008" and by_gda94:
        return _inverse_step(ITRF2008_TO_GDA94, "GDA94", epoch, by_gda94)
    return FROM_ITRF2014[name].at(epoch)


def _inverse_step(
    step: FrameTransformation, to: str, epoch: float, by_gda94: bool
) -> tuple[Array, Array]:
    """Return the transformation from ITRF2014 to the source of a step whose target is ``to``."""
    a, s = _from_itrf2014(to, epoch, by_gda94)
    b, t = step.at(epoch)
    inverse = np.linalg.inv(b)
    return inverse @ a, inverse @ (s - t)
