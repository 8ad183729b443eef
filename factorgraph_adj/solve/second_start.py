"""The adjustment from the given values where the start that replaced them led to no minimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..errors import DatumError, InputError
from .solution import Solution
from .start import Start

REPEATED = "{why}: it was repeated from the given poses and coordinates."
"""Sentence of a solution that began at the given values after all."""
NEITHER = "From the given poses and coordinates it did not converge either."
"""Sentence of a solution that began at the other start, where neither converged."""


def better_of_both(attempt: Callable[[Start], Solution], start: Start) -> Solution:
    """Return the adjustment from a start, or from the given values that the start has replaced.

    A start is chosen by robust costs, without an adjustment. If it does not converge, the given
    values are tried; what converges is returned, otherwise what has the smaller vᵀPv. The sentences
    on how the adjustment began say so.

    Args:
        attempt: adjusts from a start.
        start: the start; one that replaces no given values is tried alone.

    Raises:
        InputError, DatumError: the error of the first attempt, if the second one fails too.
    """
    if start.instead_of is None:
        return attempt(start)
    first: Solution | None = None
    failure: InputError | DatumError | None = None
    try:
        first = attempt(start)
        if first.converged:
            return first
        why = "The adjustment from there did not converge"
    except (InputError, DatumError) as error:
        failure, why = error, "The adjustment from there ended in an error"
    words = (*start.words, REPEATED.format(why=why))
    given = Start(start.unknowns, start.instead_of, start.origin, words)
    try:
        second = attempt(given)
    except (InputError, DatumError):
        second = None
    if second is not None and (first is None or second.converged or second.vtpv < first.vtpv):
        return second
    if failure is not None:
        raise failure
    assert first is not None
    return replace(first, begun=(*first.begun, NEITHER))


def describe_other_minimum(ours: Solution, theirs: Solution) -> str:
    """Return a sentence on the minimum ``theirs``, seen from ``ours``.

    It has both vᵀPv, and the point whose places in the two are farthest apart.
    """
    told = f"another minimum has vᵀPv {theirs.vtpv:.6g} instead of {ours.vtpv:.6g}"
    unknowns, there = ours.equations.unknowns["point"], theirs.equations.unknowns["point"]
    names = [n for n in unknowns.names if n in there.number]
    if names:
        apart = [float(np.linalg.norm(ours.point(n) - theirs.point(n))) for n in names]
        name = names[int(np.argmax(apart))]
        at = ", ".join(f"{x:.4f}" for x in theirs.point(name))
        told += f", with point {name!r} at {at}, {max(apart):.3g} m away"
    return told
