"""Flags of OpenCV's calibration: which parameters it has held.

The values are those of ``cv::CALIB_…``. Up to OpenCV 4 ``cv::fisheye::CALIB_…`` had values of its
own; since OpenCV 5 the fisheye model has those of the other one, and flags of its own above 2²².
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

FIX_ASPECT_RATIO = 2
RATIONAL_MODEL = 1 << 14
FISHEYE_FIX_SKEW_4 = 8
FISHEYE_FIX_SKEW_5 = 1 << 25
FIRST_OF_OPENCV_5 = 1 << 22
"""Smallest flag that the fisheye calibration of OpenCV 5 has and that of OpenCV 4 has not."""

EVERYTHING = ("c", "b1", "x0", "y0", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
PINHOLE: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {
        FIX_ASPECT_RATIO: ("b1",),
        4: ("x0", "y0"),
        8: ("p1", "p2"),
        16: ("c", "b1"),
        32: ("k1",),
        64: ("k2",),
        128: ("k3",),
        256: EVERYTHING,
        1 << 11: ("k4",),
        1 << 12: ("k5",),
        1 << 13: ("k6",),
        1 << 21: ("p1", "p2"),
    }
)
"""What each flag holds, by its value: the principal point, tangential distortion, focal lengths."""
FISHEYE_4: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {
        16: ("k1",),
        32: ("k2",),
        64: ("k3",),
        128: ("k4",),
        256: EVERYTHING,
        512: ("x0", "y0"),
        2048: ("c", "b1"),
    }
)
"""The same of ``cv::fisheye::calibrate`` up to OpenCV 4."""


def held_by(flags: int, *, fisheye: bool) -> frozenset[str]:
    """Return the parameters that a calibration with these flags has not estimated.

    Args:
        flags: sum of the flags.
        fisheye: whether it is a calibration of the fisheye model.
    """
    table = FISHEYE_4 if fisheye and flags < FIRST_OF_OPENCV_5 else PINHOLE
    out = {name for bit, names in table.items() if flags & bit for name in names}
    if not fisheye and not flags & RATIONAL_MODEL:
        out |= {"k4", "k5", "k6"}
    return frozenset(out)


def skewed(flags: int) -> bool:
    """Return whether a calibration of the fisheye model with these flags estimates the skew."""
    fixed = FISHEYE_FIX_SKEW_4 if flags < FIRST_OF_OPENCV_5 else FISHEYE_FIX_SKEW_5
    return not flags & (fixed | 256)
