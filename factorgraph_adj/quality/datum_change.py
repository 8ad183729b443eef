"""S-transformation to other datum points: of a free network, or of covariances in a given datum.

Coordinates and their covariances refer to a datum; the shape of the network is independent of it.
Baarda's S-transformation (S-transformations and criterion matrices, 1973) leads from one datum to
another without a new adjustment: with G, the motions that the observations leave undetermined,
and G_D, its rows of the new datum points,

    Q' = S Q Sᵀ,  S = I − G (G_DᵀG_D)⁻¹ G_Dᵀ

In a free network G is its datum defect, and the coordinates move along, by a finite similarity
transformation, until the inner constraints over the new datum points hold. If coordinates are given
(held, weighted, control points, GNSS positions), they determine the motions G as well; S removes
this contribution from Q. G then holds the motions that are undetermined without the given
coordinates. Held coordinates are errorless in their own datum; in the new datum they have
covariances like all other points. If more coordinates are given than a datum needs, their
information on the shape remains in Q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import DatumError, InputError, Problem, SingularError, taking, unknown_name
from ..graph.equations import Equations, compile_network
from ..graph.variables import Unknowns
from ..solve.datum_defects import MOTION_NAMES, FreeDatum, Motion, find_defects, generators
from ..solve.defect_description import describe_defects
from ..solve.gauss_newton_steps import Step
from ..solve.inner_constraints import (
    ReferenceDatum,
    datum_columns,
    held_gradient,
    network_on_constraints,
)
from ..solve.linearised_equations import LinearisedEquations
from ..solve.normal_equations import NormalEquations
from ..solve.solution import Solution, normal_equations_at, solution_at
from ..types import Array, Index

IGNORED_WEIGHT = 1e-60
"""Factor on the weights of an observation that takes it out of the adjustment."""
MIN_OBSERVED_DIAGONAL = 1e-30
"""Diagonal element of N (1/m², 1/rad²) below which only ignored observations touch a column."""
DATUM_STEP_TOLERANCE = 1e-5
"""Step relative to σ below which a solution has converged; the same value as in `adjust`."""


@taking(Solution)
@with_one_thread
def s_transform(
    solution: Solution,
    points: Sequence[str] | None = None,
    *,
    motions: Sequence[Motion] | None = None,
) -> Solution:
    """Return the same solution with another datum: inner constraints over other points.

    Residuals, vᵀPv, redundancy and the precision of all datum-invariant quantities (angles;
    distances if the observations determine the scale) stay the same.

    - A free network is moved onto the constraints G_Dᵀ (x − x₀)_D = 0 over ``points``, x₀ =
      ``solution.start``: coordinates, attitudes, orientation unknowns and covariances become those
      of an adjustment with ``points`` as its datum points. A second transformation to the first
      datum points restores the first solution.
    - With a given datum, coordinates stay, and covariances become those relative to ``points``
      (``solution.reference``). Reliability and the effects of errors still refer to the given
      datum.

    Args:
        solution: result of `adjust`, or an S-transformed solution.
        points: names of the new datum points; None: all points.
        motions: the motions to remove, only for a given datum. By default all motions that no
            observation besides coordinates (held, weighted, control points, GNSS and photo
            positions) determines. Any other motion loses the information of the observations on
            it. Rotations and scale refer to the centre of the points: to remove them without the
            shifts seldom makes sense.

    Raises:
        InputError: unknown points or motions, all at once; motions for a free network; nothing
            to remove.
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
    return _free_network_in_datum(solution, names)


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
            [Problem(unknown_name("point", n, table.names), "datum points") for n in wrong]
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
    wrong = [m for m in motions if m not in MOTION_NAMES]
    if wrong or isinstance(motions, str) or not motions:
        raise InputError(f"motions must be some of {', '.join(MOTION_NAMES)}, not {motions!r}")


# -- free networks --------------------------------------------------------------------------------


def _free_network_in_datum(solution: Solution, names: tuple[str, ...]) -> Solution:
    """Move a free network onto inner constraints over other points."""
    assert solution.datum is not None
    equations = solution.equations
    columns = datum_columns(equations, solution.datum.motions, names)

    def step(normal: NormalEquations) -> Step | None:
        try:
            factor = normal.factorise(solution.run.constraint)
        except SingularError:
            return None
        return Step.of(factor, held_gradient(normal, solution.defects, solution.run.constraint))

    carried = network_on_constraints(
        equations,
        solution.state,
        solution.start,
        FreeDatum(solution.datum.motions, columns),
        solution.defects,
        normal_at=partial(normal_equations_at, solution),
        step=step,
        tolerance=DATUM_STEP_TOLERANCE,
        at_rest=solution.converged,
    )
    there = solution_at(solution, carried.state)
    if carried.normal is not None:
        there = replace(there, run=replace(there.run, linearised=carried.normal))
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
        reason="not converged on the inner constraints" if lost else solution.reason,
        within=max(solution.within, carried.left) if carried.at_rest else np.inf,
        vtpv=there.normal().system.vtpv,
        datum=carried.datum,
        defects=carried.defects,
        run=replace(there.run, linearised=there.normal()),
    )


# -- given datum ----------------------------------------------------------------------------------


def _reference(
    solution: Solution, names: tuple[str, ...], motions: Sequence[Motion] | None
) -> ReferenceDatum:
    """Expand G to all components, and multiply the cofactors by it."""
    freed = _network_without_coordinates(solution)
    unknowns = freed.unknowns
    place = _places(solution.equations.unknowns, unknowns)
    if motions is None:
        g, called = _undetermined(solution, freed, place)
    else:
        chosen = [MOTION_NAMES.index(m) for m in dict.fromkeys(motions)]
        g, called = generators(freed, solution.state)[:, chosen], tuple(dict.fromkeys(motions))
    datum = FreeDatum(g, datum_columns(freed, g, names))
    masked = datum.masked
    cross = np.zeros_like(g)
    cross[place] = solution.cofactor_times(masked[place])
    return ReferenceDatum(names, called, datum, unknowns, cross, masked.T @ cross)


def _network_without_coordinates(solution: Solution) -> Equations:
    """Return the network with every point and photo free, and coordinates without weight.

    An axis that is held in all points stays held: a levelling network has no x and y.
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
            weights[block.rows] = IGNORED_WEIGHT
    return equations.reweighted(weights)


def _places(mine: Unknowns, freed: Unknowns) -> Index:
    """Return the position of each column among all components, (n_columns,)."""
    out = np.zeros(mine.n_columns, dtype=np.intp)
    for kind, table in mine.tables.items():
        for j in range(table.free.shape[1]):
            on = (table.offset >= 0) & (j < table.size)
            out[table.offset[on] + j] = freed[kind].offset[on] + j
    return out


def _undetermined(
    solution: Solution, freed: Equations, place: Index
) -> tuple[Array, tuple[str, ...]]:
    """Return G of the motions that only coordinates determine, and the names of these motions."""
    extra = [replace(e, columns=place[e.columns]) for e in solution.normal().system.extra]
    system = LinearisedEquations(freed, solution.state, extra)
    diagonal = system.diagonal()
    diagonal[diagonal < MIN_OBSERVED_DIAGONAL] = 0.0
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
