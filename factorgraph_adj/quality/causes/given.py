"""Given values that are held: tested as if each had been given with σ → ∞.

A held component of a point, a photo, a calibration or a parameter is one more column of A. The
error ∇ = given − true is estimated from the residuals, see `columns`; nothing is adjusted again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array, csr_array

from ...graph.equations import Equations
from ...graph.variables import DEFAULT, Unknowns
from ...models.variables import ENTITIES, UNKNOWNS, VariableKind
from ...solve.linear import LinearisedEquations
from ...solve.solution import Solution
from ...types import Array, Index, Mask
from .columns import Explained, explain_pieces, in_pieces
from .hypotheses import Size

MOST_RAYS = 2_000_000
"""Largest number of image points with which held values of calibrations are tested: each touches
all of them."""

MOST_OF_C = 0.5
"""Largest error of a principal distance, relative to it: the partials hold for no larger one."""


@dataclass(frozen=True)
class GivenValue:
    """A held unknown, tested as if its held components had been given with σ → ∞."""

    kind: VariableKind
    """Kind of the unknown."""
    name: str
    """Its name."""
    components: tuple[str, ...]
    """Names of its held components, (q,)."""
    sizes: tuple[Size, ...]
    """Their quantities, (q,)."""
    together: Explained
    """All of its held components together: T² and the errors given − true, in metres, radians or
    image units."""
    apart: tuple[Explained, ...]
    """Each of them alone, the others held."""
    possible: bool = True
    """Whether errors of this size are made: a principal distance that is another one altogether, or
    a factor between any two units, explains nothing."""

    @property
    def w(self) -> Array:
        """Test values of the single components, √T² with the sign of −∇̂, (q,)."""
        sign = np.array([-np.sign(e.error[0]) for e in self.apart])
        return np.asarray(sign * np.sqrt([e.t2 for e in self.apart]))


def given_values(solution: Solution) -> tuple[GivenValue, ...]:
    """Test every held unknown that observations touch.

    Args:
        solution: result of `adjust`.

    Returns:
        Points, photos, calibrations and parameters with held components, in the order of the
        network; no calibrations with more than `MOST_RAYS` image points, and nothing where the
        user added factors, whose partials by held components are not known.

    Raises:
        SingularError: the normal equations are singular at the solution.
    """
    if solution.n_extra:
        return ()
    held = held_components(solution.equations)
    unknowns = solution.equations.unknowns.freed(held)
    equations = replace(solution.equations, unknowns=unknowns)
    system = LinearisedEquations(equations, solution.state)
    # What no observation depends on, such as x and y in levelling, was not given.
    noticed = system.diagonal() > 0
    named = [
        (kind, number, which)
        for kind, flags in held.items()
        for number in np.flatnonzero(flags.any(axis=1)).tolist()
        if len(which := _noticed(unknowns, kind, number, np.flatnonzero(flags[number]), noticed))
    ]
    if not named:
        return ()
    columns, groups = _columns(unknowns, named)
    alone = [np.array([column]) for group in groups for column in group.tolist()]
    touched = [equations.touching(k, np.array([n for o, n, _ in named if o == k])) for k in held]
    rows = np.unique(np.concatenate(touched))

    def pieces(at: Index) -> Iterator[tuple[Index, csr_array]]:
        for some in in_pieces(rows):
            # f(x) computes with the given value, which is larger than the true one by ∇.
            yield some, csr_array(-csc_array(system.sparse(some))[:, columns[at]])

    found = explain_pieces(solution, pieces, [*groups, *alone])
    together, apart = found[: len(groups)], iter(found[len(groups) :])
    out = []
    for (kind, number, which), whole in zip(named, together, strict=True):
        names = unknowns.component_names(kind, number)
        out.append(
            GivenValue(
                kind,
                unknowns[kind].names[number],
                tuple(names[i] for i in which.tolist()),
                _sizes(kind, which),
                whole,
                tuple(next(apart) for _ in which),
                _possible(equations, kind, number, which, whole.error),
            )
        )
    return tuple(out)


def _noticed(
    unknowns: Unknowns, kind: VariableKind, number: int, held: Index, noticed: Mask
) -> Index:
    """Return the held components of a variable on which an observation depends."""
    return held[noticed[unknowns.columns(kind, number)[held]]]


def _possible(
    equations: Equations, kind: VariableKind, number: int, which: Index, error: Array
) -> bool:
    """Return whether errors (q,) of held components have a size in which they are made."""
    table, components = equations.unknowns[kind], UNKNOWNS[kind].components
    if components:
        largest = np.array([components[i].largest_error for i in which.tolist()])
        return not bool(np.any(np.abs(error) > largest))
    lengths = [equations.unknowns.component_names(kind, number)[i] == "c" for i in which.tolist()]
    given = np.abs(table.values[number][which])
    return not bool(np.any(np.asarray(lengths) & (np.abs(error) > MOST_OF_C * given)))


def _sizes(kind: VariableKind, which: Index) -> tuple[Size, ...]:
    components = UNKNOWNS[kind].components
    if not components:  # of a calibration
        image: Size = "image"
        return (image,) * len(which)
    return tuple(components[i].quantity for i in which.tolist())


def held_components(equations: Equations) -> dict[VariableKind, Mask]:
    """Return the held components that observations touch, (n, largest size), by kind."""
    unknowns = equations.unknowns
    out: dict[VariableKind, Mask] = {}
    for kind, table in unknowns.tables.items():
        touched = np.zeros(len(table.names), dtype=bool)
        for block in equations.blocks:
            for what, index in block.variables:
                if what == kind and not block.prior:
                    touched[index] = True
        if kind not in ENTITIES and DEFAULT in table.number and UNKNOWNS[kind].default is not None:
            # What is not named was not given.
            touched[table.number[DEFAULT]] = False
        if kind == "calibration" and equations.n_rays > MOST_RAYS:
            continue
        there = np.arange(table.free.shape[1]) < table.size[:, None]
        held = ~table.free & there & touched[:, None]
        if held.any():
            out[kind] = held
    return out


def _columns(
    unknowns: Unknowns, named: Sequence[tuple[VariableKind, int, Index]]
) -> tuple[Index, list[Index]]:
    """Return the columns of held components, (k,), and which of them each unknown has."""
    groups, parts, first = [], [], 0
    for kind, number, which in named:
        parts.append(unknowns.columns(kind, number)[which])
        groups.append(first + np.arange(len(which)))
        first += len(which)
    return np.concatenate(parts), groups
