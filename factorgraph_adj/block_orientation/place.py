"""Parts in the frame of the network: by known coordinates, attitudes, lengths, or one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations
from ..types import Array, Mask
from .fitting import fit
from .growth import Growth
from .known import Known, Length
from .scale import scales_by_rays
from .similarity import (
    Similarity,
    from_components,
    from_points,
    in_one_line,
    mean_rotation,
    robust_similarity,
    with_rotation,
)
from .single_rays import similarity_from_rays

ROTATED_BY = 3
"""Number of known points, not in one line, that give the rotation of a part."""


@dataclass(frozen=True, eq=False)
class Placed:
    """The transformation of a part, and what it was found from."""

    to_frame: Similarity
    """From the axes of the part to those of the network."""
    words: str
    """What gave scale, rotation and shift."""
    complete: bool
    """Whether scale, rotation and shift were all found."""
    misfits: Array
    """Distance of each known place from its given one, metres, (points + photos,); NaN: unknown."""


def place(
    growth: Growth,
    equations: Equations,
    known: Known,
    lengths: Sequence[Length],
    joined: Mask,
) -> Placed:
    """Find the transformation of a part into the frame of the network.

    Args:
        growth: the part.
        equations: the network in arrays.
        known: coordinates and attitudes, NaN where unknown.
        lengths: known lengths.
        joined: known points that earlier parts found, (points,), for the words.

    Returns:
        The best transformation; what nothing gives is left as it is in the part.
    """
    x = np.concatenate([growth.point, growth.pose[:, 9:]])
    y = np.concatenate([known.point, known.pose[:, 9:]])
    there = np.isfinite(x).all(axis=1)
    full = there & np.isfinite(y).all(axis=1)
    some = there & np.isfinite(y).any(axis=1)
    words = _counted(full, len(growth.point), joined)
    found: Similarity | None = None
    complete = True
    if full.sum() >= ROTATED_BY and (robust := robust_similarity(x[full], y[full])) is not None:
        found = robust[0]
    if found is None and (rotation := _known_rotation(growth, known)) is not None:
        found = with_rotation(x[some], y[some], rotation)
        words = f"attitudes, and {words}"
        if found is None:
            by_rays: list[float] = []
            if full.any():
                at = int(np.flatnonzero(full)[0])
                by_rays = scales_by_rays(growth, known, rotation, (x[at], y[at]))
            found, said = _by_lengths(growth, lengths, rotation, x[full], y[full], by_rays)
            words, complete = f"{words}; {said}", bool(full.any()) and said != UNIT
    if found is None and (found := from_components(x[some], y[some])) is not None:
        words = f"{int(np.isfinite(y[some]).sum())} known coordinates of {int(some.sum())} places"
    if found is None and (by_single := similarity_from_rays(growth, known)) is not None:
        found, n_rays = by_single
        words = f"{n_rays} rays to known points"
    if found is None:
        complete = False
        found, words = _incomplete(growth, lengths, x[full], y[full], words)
    fitted = None if complete else fit(growth, equations, known, found)
    if fitted is not None and fitted.open < ONLY_SCALE:
        found, complete = fitted.to_frame, fitted.open == 0
        words = fitted.words if complete else f"{fitted.words}; {fitted.open} of 7 stay open"
    misfits = np.full(len(x), np.nan)
    misfits[full] = np.linalg.norm(found.of(x[full]) - y[full], axis=1)
    return Placed(found, words, complete, misfits)


ONLY_SCALE = 6
"""Number of open parameters of a part of which only the scale is known."""
UNIT = "the base of the start pair has the length 1"
NOTHING = "no known coordinates"


def _incomplete(
    growth: Growth, lengths: Sequence[Length], x: Array, y: Array, words: str
) -> tuple[Similarity, str]:
    """Return scale and shift from what there is, and words."""
    if len(x) >= 2 and (pair := from_points(x, y)) is not None and in_one_line(y):
        return pair, f"{words} in one line, which leave a rotation open"
    found, said = _by_lengths(growth, lengths, np.eye(3), x, y)
    return found, f"{words}; {said}"


def _by_lengths(
    growth: Growth,
    lengths: Sequence[Length],
    rotation: Array,
    x: Array,
    y: Array,
    by_rays: Sequence[float] = (),
) -> tuple[Similarity, str]:
    """Return a transformation with the scale of known lengths, or of rays, and words."""
    ratios = []
    for length in lengths:
        at = growth.point if length.between == "point" else growth.pose[:, 9:]
        size = float(np.linalg.norm(at[length.ends[0]] - at[length.ends[1]]))
        if np.isfinite(size) and size > 0:
            ratios.append(length.value / size)
    scale, said = 1.0, UNIT
    if ratios:
        scale = float(np.median(ratios))
        said = f"scale from {len(ratios)} known length{'s' * (len(ratios) > 1)}"
    elif by_rays:
        scale, said = float(np.median(by_rays)), f"scale from {len(by_rays)} rays that leave it"
    shift = np.zeros(3)
    if len(x):
        shift = (y - scale * x @ rotation.T).mean(axis=0)
    return Similarity(scale, rotation, shift), said


def _known_rotation(growth: Growth, known: Known) -> Array | None:
    """Return the rotation of a part from photos with known attitude; none: there are none."""
    rows = np.flatnonzero(growth.posed & np.isfinite(known.pose[:, :9]).all(axis=1))
    if not len(rows):
        return None
    ours = growth.pose[rows, :9].reshape(-1, 3, 3)
    theirs = known.pose[rows, :9].reshape(-1, 3, 3)
    return mean_rotation(theirs @ ours.transpose(0, 2, 1))


def _counted(full: Mask, n_points: int, joined: Mask) -> str:
    """Return how many known points and photos there are."""
    points = full[:n_points]
    own, shared = int((points & ~joined).sum()), int((points & joined).sum())
    parts = []
    if own:
        parts.append(f"{own} known point{'s' * (own > 1)}")
    if shared:
        parts.append(f"{shared} point{'s' * (shared > 1)} of the parts before")
    if n := int(full[n_points:].sum()):
        parts.append(f"{n} known projection centre{'s' * (n > 1)}")
    return " and ".join(parts) or NOTHING
