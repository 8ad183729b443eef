"""All searches for what observations that do not fit may be instead, in one list."""

from __future__ import annotations

from collections.abc import Sequence

from ...graph.equations import Equations
from ...solve.solution import Solution
from .evidence import VarianceFactor
from .exchanged_photos import exchanged_photos
from .image_names import exchanged_image_points
from .matches import Match, matches
from .mirrored_block import mirrored_block
from .photos import photos


def every_match(
    equations: Equations,
    clean: Solution,
    aside: Sequence[str],
    above: Sequence[str],
    alpha: float,
    *,
    again: bool,
    estimated: bool,
) -> tuple[Match, ...]:
    """Look for what observations that do not fit may be instead.

    Args:
        equations: the network with them.
        clean: the solution without those set aside.
        aside: ids of the observations set aside.
        above: ids of those above the critical value that have stayed.
        alpha: probability with which a reading that is right does not fit.
        again: whether the network may be adjusted again with other images.
        estimated: whether σ0 is that of the clean solution; otherwise it is 1.
    """
    weight = VarianceFactor.left_by(clean, estimated=estimated)
    found = (
        *matches(equations, clean, aside, alpha, weight),
        *photos(equations, clean, aside, alpha, weight),
        *exchanged_image_points(equations, clean, aside, alpha, weight),
    )
    if again:
        bad = [*aside, *above]
        block = tuple(mirrored_block(equations, clean, bad, alpha, weight))
        pairs = () if block else tuple(exchanged_photos(equations, clean, bad, alpha, weight))
        found = (*block, *pairs, *found)
    return tuple(m.judged_by(weight.variance) for m in found)
