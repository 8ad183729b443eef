"""Readings against given coordinates: units, signs, frames and exchanged axes.

Where both ends of readings have given coordinates, rough ones too, computed values tell of gross
mistakes of whole groups. A mistake is told where another reading of a whole group fits the
coordinates `BETTER` times better, in the median of the misfits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...frames import LocalFrame
from ...graph.equations import Equations
from ...models.terrestrial import direction_in_face_one
from ...network.network import Network
from ...types import Array, Index
from .finding import Finding
from .geographic import exchanged_latitudes
from .given_rows import BETTER, LEAST, computed_values, given_rows, median
from .given_units import wrong_units
from .gnss_frames import vector_frames
from .gnss_heights import mixed_heights
from .photo_axes import photo_axes

FAR = 100_000.0
"""Distance from the origin of a curved local frame, metres, beyond which it is told: the error of
the sphere that stands for the Earth is more than 1e-4 of the curvature there."""
LEAST_TURN = 1e-5
"""Misfit of directions, radians, below which no other order of axes is looked for: rounding, and
the errors of good directions."""


def against_given(
    equations: Equations, *, length: str = "m", angle: str = "gon"
) -> Iterator[Finding]:
    """Iterate over mistakes that given coordinates tell of.

    Where places are on another part of the Earth, nothing else is compared with them.

    Args:
        equations: the network.
        length: unit of lengths in its files.
        angle: unit of angles in its files.
    """
    elsewhere = tuple(exchanged_latitudes(equations))
    yield from elsewhere
    if elsewhere:
        return
    yield from wrong_units(equations, length, angle)
    yield from _signs(equations)
    yield from vector_frames(equations)
    yield from mixed_heights(equations.network)
    yield from _axes(equations)
    yield from _origin(equations.network)
    yield from photo_axes(equations)


def _signs(equations: Equations) -> Iterator[Finding]:
    """Height differences that fit with the other sign."""
    for block, rows in given_rows(equations, "height_difference"):
        observed, computed = computed_values(equations, block, rows)
        usual = max(median(observed - computed), 1e-3)
        off, turned = np.abs(observed - computed)[:, 0], np.abs(observed + computed)[:, 0]
        wrong = np.flatnonzero((off > BETTER * usual) & (turned * BETTER < off))
        for i in wrong.tolist():
            yield Finding(
                f"{block.labels(int(rows[i]))} contradicts the given heights of its points, and "
                "fits with the other sign",
                "look at its sign, and at the order of its points",
                float(off[i]),
                float(BETTER * usual),
                "m",
            )


def _axes(equations: Equations) -> Iterator[Finding]:
    """Control with X and Y exchanged: readings turn the other way round.

    A direction is α − o with the orientation o of its set; with X and Y exchanged α becomes
    π/2 − α, so that the sum of azimuth and reading is the same for a set, not the difference.
    """
    held = np.all(~equations.unknowns["point"].free[:, :2], axis=1)
    for block, given in given_rows(equations, "direction"):
        by = {what: index for what, index in block.variables if what == "orientation"}
        ends = [index for what, index in block.variables if what == "point"]
        rows = given[held[ends[0][given]] & held[ends[1][given]]]
        if len(rows) < LEAST:
            continue
        points = np.nan_to_num(equations.unknowns["point"].values)  # heights may be unknown
        start = points[ends[0][rows]]
        enu = equations.network.frame.basis(start, np.zeros((len(rows), 2))).enu
        d = np.einsum("nij,nj->ni", enu, points[ends[1][rows]] - start)
        azimuth = np.arctan2(d[:, 0], d[:, 1])
        reading = direction_in_face_one(block.observed[rows, 0], block.constants["face"][rows])
        group = by["orientation"][rows]
        now, other = (_spread(azimuth - sign * reading, group) for sign in (1.0, -1.0))
        if max(other, LEAST_TURN) * BETTER < now:
            yield Finding(
                f"{len(rows)} directions between held points run the other way round",
                "X and Y of the control, or the axes of the frame, are exchanged",
                float(np.rad2deg(now)),
                float(np.rad2deg(BETTER * other)),
                "degrees",
            )


def _spread(angle: Array, group: Index) -> float:
    """Return the median deviation of angles from the mean of their group; one alone has none."""
    out = []
    for g in np.unique(group).tolist():
        own = angle[group == g]
        if len(own) > 1:
            mean = np.angle(np.mean(np.exp(1j * own)))
            out.append(np.abs(np.angle(np.exp(1j * (own - mean)))))
    return float(np.median(np.concatenate(out))) if out else 0.0


def _origin(network: Network) -> Iterator[Finding]:
    """Coordinates far from the origin of a curved local frame."""
    frame = network.frame
    if not isinstance(frame, LocalFrame) or not frame.curvature:
        return
    names = list(network.points)
    xyz = np.array([p.coordinates for p in network.points.values()]).reshape(-1, 3)
    far = np.linalg.norm((xyz - np.array(frame.origin))[:, :2], axis=1)
    far = np.nan_to_num(far)
    if len(far) and far.max() > FAR:
        yield Finding(
            f"{int((far > FAR).sum())} points lie far from the origin of the curved frame, the "
            f"farthest {names[int(far.argmax())]!r}",
            "give the frame an origin in the middle of the network",
            float(far.max()) / 1e3,
            FAR / 1e3,
            "km",
        )
