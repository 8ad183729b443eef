"""Candidates from two designs: what the larger one has and the smaller one lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import InputError, Problem, known
from ..network.network import Network
from ..observations import AnyObservation, Correlated, Observation
from .candidates import Candidate


def difference(name: str, design: Network, larger: Network, *, cost: float = 1.0) -> Candidate:
    """Return as a candidate what a larger design adds to a design.

    Both may come from specs, the larger one with further parts behind those of the other: GNSS on
    the photos, a statoscope, a cross strip, a lake. The candidate has the observations, points,
    photos, cameras and other unknowns that the design lacks. Values are those of the larger
    design for what is new, and those of the design for the rest.

    Args:
        name: name of the candidate.
        design: the design.
        larger: the design with the additions. Observations are the same if their ids are.
        cost: cost of the additions.

    Raises:
        InputError: what the design has and the larger one lacks, or holds when the other does
            not: a candidate only adds.
    """
    problems = _lost(design, larger)
    if problems:
        raise InputError(problems)
    grouped = {i for ids, _ in larger.clusters for i in ids}
    groups: list[AnyObservation] = []
    for ids, covariance in larger.clusters:
        new = [i for i in ids if i not in design.observations]
        if new and len(new) < len(ids):
            there = known([i for i in ids if i not in new])
            what = f"is correlated with observations of the design ({there}); add it alone"
            raise InputError(Problem(what, f"observation {new[0]!r}"))
        if new:
            members = tuple(_unnumbered(larger.observations[i]) for i in ids)
            groups.append(Correlated(members, covariance))
    single = [
        _unnumbered(o)
        for i, o in larger.observations.items()
        if i not in design.observations and i not in grouped
    ]
    photo, point, *_ = design.images.columns()
    photos, points = list(design.photos), list(design.points)
    imaged = {(photos[f], points[p]) for f, p in zip(photo.tolist(), point.tolist(), strict=True)}
    images = [o for o in larger.image_points() if (o.photo, o.point) not in imaged]
    unknowns = {
        kind: {key: p for key, p in given.items() if key not in design.of_kind(kind)}
        for kind, given in larger.parameters.items()
    }
    return Candidate(
        name,
        (*groups, *single, *images),
        cost=cost,
        points=tuple(p for n, p in larger.points.items() if n not in design.points),
        photos=tuple(f for n, f in larger.photos.items() if n not in design.photos),
        cameras=tuple(c for n, c in larger.cameras.items() if n not in design.cameras),
        unknowns={kind: given for kind, given in unknowns.items() if given},
    )


def _unnumbered(o: Observation) -> Observation:
    """Return an observation without an id that is a number, which other candidates have too."""
    ident = getattr(o, "id", None)
    return replace(o, id=None) if ident is not None and ident.isdecimal() else o  # type: ignore[call-arg]


def _lost(design: Network, larger: Network) -> list[Problem]:
    """Return what a design has and another one lacks or holds otherwise."""
    lacks = "is in the design alone; the larger one must have it too"
    problems = []
    for what, mine, other in (
        ("point", design.points, larger.points),
        ("photo", design.photos, larger.photos),
        ("camera", design.cameras, larger.cameras),
        ("observation", design.observations, larger.observations),
    ):
        problems += [Problem(lacks, f"{what} {n!r}") for n in mine if n not in other]
    for n, p in design.points.items():
        other_point = larger.points.get(n)
        if other_point is not None and not np.array_equal(p.fixed, other_point.fixed):
            what = "is held in one of the designs alone; a candidate adds observations of it"
            problems.append(Problem(what, f"point {n!r}"))
    return problems
