"""Reference frames of SNAP with unknown parameters, as frames of a network of their own.

SNAP: observed = T (X + t), T = (1 + s) R; a frame of a network: q = e^{−ℓ} Rᵀ (X − O) − c. With the
translation unknown O is in the middle of the stations and c is free; with a known one O = −t and
c = 0, which scale and rotation about the centre of the Earth need.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...network.network import Network
from ...rotation import log_rotation
from ...types import Array
from .snap_parameters import PPM, ReferenceFrame, frame_matrix, frame_shift

TRANSLATION, SCALE, ROTATION, RATES = slice(0, 3), 3, slice(4, 7), slice(7, 14)
ROUNDED_TO_M = 1000.0
"""Metres to which the constant origin of a frame is rounded."""


@dataclass(frozen=True)
class GnssFrame:
    """A frame of the network in which GNSS observations are."""

    name: str
    """Its name."""
    subtracted: Array
    """What is taken from observed positions, so that they count from its origin, (3,) metres."""
    matrix: Array
    """T of the stated values, (3, 3)."""


def why_not(frame: ReferenceFrame) -> str:
    """Return what of a frame with unknown parameters has no counterpart; empty if nothing."""
    found = frame.calculated
    if any(found[RATES]) or any(frame.parameters[RATES]):
        return "rates of change beside unknown parameters"
    for word, part in (("translation", TRANSLATION), ("rotation", ROTATION)):
        if any(found[part]) and not all(found[part]):
            return f"a {word} of which some components are known and others are not"
    return ""


def add_reference_frame(
    network: Network, frame: ReferenceFrame, horizon: Array | None, middle: Array | None
) -> GnssFrame:
    """Add the frame of a reference frame to a network.

    Args:
        network: the network.
        frame: the reference frame, of which `why_not` says nothing.
        horizon: east, north, up as rows (3, 3) of a topocentric frame; None: geocentric.
        middle: middle of the stations, (3,) metres; None where it has vectors alone, in which a
            translation has no part.
    """
    parameters = frame.at(0.0)
    matrix = frame_matrix(parameters, horizon)
    shift = frame_shift(parameters, horizon)
    scale = 1.0 + PPM * float(parameters[SCALE])
    turn = log_rotation((matrix / scale).T[None])[0]
    values = dict(zip(("rx", "ry", "rz"), turn.tolist(), strict=True))
    values["ln_scale"] = -math.log(scale)
    free = [
        word
        for word, known in (
            ("offset", not any(frame.calculated[TRANSLATION])),
            ("rotation", not any(frame.calculated[ROTATION])),
            ("scale", not frame.calculated[SCALE]),
        )
        if not known
    ]
    if middle is None and "offset" in free:
        free.remove("offset")
    if middle is None or "offset" not in free:
        network.add_frame(frame.code, free=free, values=values, origin=tuple((-shift).tolist()))
        return GnssFrame(frame.code, np.zeros(3), matrix)
    origin = np.round(middle / ROUNDED_TO_M) * ROUNDED_TO_M
    offset = origin - matrix @ (origin + shift)
    values |= dict(zip("xyz", offset.tolist(), strict=True))
    network.add_frame(frame.code, free=free, values=values, origin=tuple(origin.tolist()))
    return GnssFrame(frame.code, origin, matrix)


def add_translation(network: Network, name: str, middle: Array) -> GnssFrame:
    """Add the frame of a set of positions with an unknown translation."""
    origin = np.round(middle / ROUNDED_TO_M) * ROUNDED_TO_M
    values = dict.fromkeys(("x", "y", "z", "rx", "ry", "rz", "ln_scale"), 0.0)
    network.add_frame(name, free=["offset"], values=values, origin=tuple(origin.tolist()))
    return GnssFrame(name, origin, np.eye(3))
