"""Reader of inputs of LGC2, the adjustment program of CERN.

Format: CERN, LGC2 user guide; what its documents leave open was found from its tests:

- Angles are gon, their σ cc; σ of lengths are mm, parts per million mm/km, added to them.
- A frame states translation, three rotations and a scale: X_parent = T + Rx(−ω) Ry(−φ) Rz(−κ) x,
  with the usual right-handed matrices: its rotations count clockwise. Free components follow.
- A ``*SCALE`` states σ, ppm, a correction (metres) that is added to the reading, its σ, and the σ
  of centring; it gives the offsets. ``*ECTH`` is positive to the left of the sight.
- A wire has a bearing, a slope, two offsets and a sag; what a sensor reads is in the x and z of its
  own frame, where the chord passes its plane y, with the sag added along the vertical.
- Printed σ are multiplied with the estimated σ of unit weight where its test fails at 95 %, as in
  ECTH, and are a priori where it passes, as in ECVE and ECSP.
"""

from __future__ import annotations

from pathlib import Path

from ...network.network import Network
from ..collected import LinesOfFile
from .lgc2_frames import Lgc2Builder
from .lgc2_input import Lgc2Input
from .lgc2_observations import Lgc2Observations

TINY = 1e-8
"""Standard deviation of conditions, metres."""


def read_lgc2(path: str | Path, *, condition: float = TINY) -> Network:
    """Read an input of LGC2.

    The frame is the cartesian system of the input: plane (``*OLOC``), over a sphere (``*SPHE``) or
    over the ellipsoid with the geoid of 1985 (``*LEP``); the grid of the geoid of 2000 (``*RS2K``)
    is not here, and is refused. Points of ``*CALA`` are held, those of ``*POIN`` free; ``*VXY``,
    ``*VXZ``, ``*VZ`` hold the components that are not named. A frame with free components is one of
    the network, whose origin is a point ``NAME/origin``; what is held of its translation, and held
    points in it, are conditions. Read are ``*ANGL``, ``*ZEND``, ``*DIST``, ``*DSPT``,
    ``*ECTH``, ``*ECSP``, ``*ECVE``, ``*ECWI``, ``*ECWS``, ``*INCLY``, ``*ROLLY``, ``*UVEC``,
    ``*UVD``, ``*OBSXYZ`` and ``*PDOR`` with their instruments; ``*TITR``, ``*PREC``, ``*PUNC``,
    ``*FAUT``, ``*INSTR``, ``*V0`` and ``*END`` do not change a network.

    Args:
        path: the file.
        condition: standard deviation of conditions, metres. From coarse approximate values an
            adjustment may need softer conditions first, whose solution starts the next one.

    Raises:
        InputError: every problem of the file, each with its line: words that are not understood,
            unknown instruments, free frames in free frames, frames with a scale.
    """
    file = LinesOfFile(path, latin=True)
    found = Lgc2Input(file)
    if not found.points:
        file.add(0, "has no points (*CALA, *POIN, *VXY, *VXZ, *VZ)")
    file.raise_all()
    builder = Lgc2Builder(found, condition)
    builder.frames_and_points()
    file.raise_all()
    Lgc2Observations(builder).add_all()
    file.raise_all()
    return builder.network
