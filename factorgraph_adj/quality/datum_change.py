"""The S-transformation: a solution as it looks from other datum points.

Coordinates and their covariances belong to a datum; what observations tell of the shape does not.
Baarda's S-transformation (S-transformations and criterion matrices, 1973) leads from one datum to
another without adjusting again: with G, the motions that the observations leave undetermined,
and G_D, its rows of the new datum points,

    Q' = S Q Sᵀ,  S = I − G (G_DᵀG_D)⁻¹ G_Dᵀ

In a free network G is its datum defect, and the coordinates move along, by a finite similarity
transformation, to where inner constraints over the new datum points want them. Where coordinates
are given (held, weighted, control points, GNSS positions), Q holds what they say of G too; S takes
just that out. Its G is what is undetermined without them. Held coordinates, errorless in their own
datum, are points like others in the new one, and get covariances. With more given coordinates
than a datum needs, what they say of the shape stays in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from ..errors import DatumError, InputError, Problem, known
from ..graph.equations import Equations, compile_network
from ..graph.variables import Unknowns
from ..solve.datum import FreeDatum, find_defects, generators
from ..solve.free_network import carry, datum_columns
from ..solve.linear import ExtraRows, LinearSystem
from ..solve.normal import NormalEquations
from ..solve.rank import describe_defects
from ..solve.reference_datum import ReferenceDatum
from ..solve.solution import Solution
from ..solve.step import Step
from ..solve.tree import SingularError
from ..types import Array, Index

Motion: TypeAlias = Literal[
    "shift in x",
    "shift in y",
    "shift in z",
    "rotation about x",
    "rotation about y",
    "rotation about z",
    "scale",
]
"""The seven motions of a similarity transformation, in the order of `solve.datum.MOTIONS`."""

IGNORED = 1e-60
"""Factor on weights that leaves nothing of an observation."""
UNOBSERVED = 1e-30
"""Diagonal of N (1/m², 1/rad²) below which only ignored observations touch a column."""
AT_REST = 1e-5
"""Step relative to σ below which a solution is at rest, as in `adjust`."""


def s_transform(
    solution: Solution,
    points: Sequence[str] | None = None,
    *,
    motions: Sequence[Motion] | None = None,
) -> Solution:
    """Return the same solution with another datum: inner constraints over other points.

    Nothing is adjusted again: residuals, vᵀPv, redundancy and the precision of everything that
    does not depend on the datum (distances, where scale is determined; angles) stay.

    - A free network is carried onto the constraints G_Dᵀ (x − x₀)_D = 0 over ``points``, x₀ =
      ``solution.start``: coordinates, attitudes, orientation unknowns and covariances become those
      of an adjustment with ``points`` as its datum points; back again leads to the first ones.
    - Where the datum is given, coordinates stay, and covariances become those relative to
      ``points`` (``solution.reference``). Reliability and the effects of errors stay with the
      given datum.

    Args:
        solution: what `adjust` found, or an S-transformed one.
        points: names of the new datum points; none: all points.
        motions: only where the datum is given: the motions to take out. By default all that no
            observation besides coordinates (held, weighted, control points, GNSS and photo
            positions) notices; of any others, what the observations say is lost. Rotations and
            scale are about the centre of the points: to take them out without the shifts seldom
            makes sense.

    Raises:
        InputError: unknown points or motions, all at once; motions for a free network; nothing
            to take out.
        DatumError: the points cannot carry the datum; without coordinates the network would not
            be connected.
    """
    names = _names(solution, points)
    _check_motions(motions)
    if solution.datum is None:
        return replace(solution, reference=_reference(solution, names, motions))
    if motions is not None:
        raise InputError(
            "motions= is for networks whose datum is given; in a free network they are its datum "
            f"defect ({', '.join(n for d in solution.defects for n in d.names())})"
        )
    return _carried(solution, names)


def _names(solution: Solution, points: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the datum points."""
    table = solution.equations.unknowns["point"]
    if points is None:
        return table.names
    if isinstance(points, str):
        raise InputError(f"points must be a list of names, not the one name {points!r}")
    wrong = [n for n in dict.fromkeys(points) if n not in table.number]
    if wrong:
        raise InputError(
            [
                Problem(f"unknown point {n!r}; known: {known(table.names)}", "datum points")
                for n in wrong
            ]
        )
    if solution.datum is not None:
        held = [n for n in points if table.offset[table.number[n]] < 0]
        if held:
            raise InputError(
                [Problem("is held and cannot carry a free datum", f"point {n!r}") for n in held]
            )
    return tuple(dict.fromkeys(points))


def _check_motions(motions: Sequence[str] | None) -> None:
    if motions is None:
        return
    wrong = [m for m in motions if m not in get_args(Motion)]
    if wrong or isinstance(motions, str) or not motions:
        raise InputError(f"motions must be some of {', '.join(get_args(Motion))}, not {motions!r}")


# -- free networks --------------------------------------------------------------------------------


def _carried(solution: Solution, names: tuple[str, ...]) -> Solution:
    """Carry a free network onto inner constraints over other points."""
    assert solution.datum is not None
    equations = solution.equations
    columns = datum_columns(equations, solution.datum.motions, names)

    def step(normal: NormalEquations) -> Step | None:
        try:
            factor = normal.factorise(solution.constraint)
        except SingularError:
            return None
        return Step.of(factor, normal.gradient)

    carried = carry(
        equations,
        solution.state,
        solution.start,
        FreeDatum(solution.datum.motions, columns),
        solution.defects,
        normal_at=solution.normal_at,
        step=step,
        tolerance=AT_REST,
        at_rest=solution.converged,
    )
    there = solution.at(carried.state)
    if carried.normal is not None:
        there = replace(there, linearised=carried.normal)
    lost = solution.converged and not carried.at_rest
    network = solution.network.copy()
    chosen = set(names)
    for name, point in network.points.items():
        if point.datum != (name in chosen):
            network.points[name] = replace(point, datum=name in chosen)
    return replace(
        there,
        network=network,
        converged=carried.at_rest,
        reason="not at rest on the inner constraints" if lost else solution.reason,
        vtpv=there.normal().system.vtpv,
        datum=carried.datum,
        defects=carried.defects,
        linearised=there.normal(),
    )


# -- given datum ----------------------------------------------------------------------------------


def _reference(
    solution: Solution, names: tuple[str, ...], motions: Sequence[Motion] | None
) -> ReferenceDatum:
    """Lay G out over all components, and multiply the cofactors with it."""
    freed = _freed(solution)
    unknowns = freed.unknowns
    place = _places(solution.equations.unknowns, unknowns)
    if motions is None:
        g, called = _undetermined(solution, freed, place)
    else:
        chosen = [get_args(Motion).index(m) for m in dict.fromkeys(motions)]
        g, called = generators(freed, solution.state)[:, chosen], tuple(dict.fromkeys(motions))
    datum = FreeDatum(g, datum_columns(freed, g, names))
    masked = datum.masked
    cross = np.zeros_like(g)
    cross[place] = solution.cofactor_times(masked[place])
    return ReferenceDatum(names, called, datum, unknowns, cross, masked.T @ cross)


def _freed(solution: Solution) -> Equations:
    """Return the network with every point and photo free, and coordinates without weight.

    An axis that is held in all points is none of the network: levelling has no x and y.
    """
    network = solution.network.copy()
    every = list(network.points.values())
    x, y, z = (all(p.fixed[i] for p in every) for i in range(3))
    plane = (x, y, z)
    for p in every:
        if p.fixed != plane:
            network.points[p.name] = replace(p, fixed=plane)
    for name, photo in network.photos.items():
        if any(photo.fixed):
            network.photos[name] = replace(photo, fixed=(False,) * 6)
    equations = compile_network(network).weighted_at(solution.state)
    weights = np.ones(equations.n_rows)
    for block in equations.blocks:
        if block.fixes in ("coordinates", "attitude"):
            weights[block.rows] = IGNORED
    return equations.reweighted(weights)


def _places(mine: Unknowns, freed: Unknowns) -> Index:
    """Return where each column is among all components, (n_columns,)."""
    out = np.zeros(mine.n_columns, dtype=np.intp)
    for kind, table in mine.tables.items():
        for j in range(table.free.shape[1]):
            on = (table.offset >= 0) & (j < table.size)
            out[table.offset[on] + j] = freed[kind].offset[on] + j
    return out


def _undetermined(
    solution: Solution, freed: Equations, place: Index
) -> tuple[Array, tuple[str, ...]]:
    """Return G of what no observation besides coordinates notices, and the motions' names."""
    extra = [ExtraRows(place[e.columns], e.a, e.residual) for e in solution.normal().system.extra]
    system = LinearSystem(freed, solution.state, extra)
    diagonal = system.diagonal()
    diagonal[diagonal < UNOBSERVED] = 0.0
    defects = find_defects(system, solution.state, diagonal, free=True)
    if not defects:
        raise InputError(
            "the observations determine position, attitude and scale without given coordinates: "
            "there is nothing to take out; name motions= to take out nevertheless"
        )
    if len(defects) > 1:
        lines = describe_defects(freed.unknowns, defects)
        raise DatumError(
            "\n  ".join(
                ["without given coordinates the network is not connected; name motions=", *lines]
            ),
            defect=sum(d.size for d in defects),
        )
    return defects[0].motions, tuple(defects[0].names())
