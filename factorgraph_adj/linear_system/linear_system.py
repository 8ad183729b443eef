"""A network as linear equations at its minimum: what every engine answers.

`isam2_system.ISAM2System` has them in iSAM2, `front_system.FrontSystem` in fronts. What happens to
observations above knows neither; `engines` has what changes a system: rows enter and leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement
from typing import Literal, Protocol, TypeAlias

import numpy as np

from ..graph.dependence import Variable
from ..graph.variables import State, Unknowns
from ..ledger.candidates import Known
from ..models.variables import VariableKind
from ..solve.adjustment_run import ShapeMisfit
from ..solve.solution import Solution
from ..types import Array, Index

EngineName: TypeAlias = Literal["isam2", "fronts"]
"""What has a linear system."""


class LinearSystem(Known, Protocol):
    """A network at its minimum, to first order. A system is a value: changes return another one."""

    @property
    def engine(self) -> EngineName:
        """What has it."""
        ...

    @property
    def doubt(self) -> str:
        """Why this is not the minimum; empty if it is."""
        ...

    @property
    def is_free(self) -> bool:
        """Whether it is a free network."""
        ...

    @property
    def n_rows(self) -> int:
        """Number of scalar rows, weighted unknowns among them."""
        ...

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        ...

    @property
    def n_rays(self) -> int:
        """Number of image points of the whole network as it was adjusted last."""
        ...

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear forms."""
        ...

    @property
    def looked(self) -> Mapping[str, ShapeMisfit]:
        """Shapes that were fitted again in vain, see `solve.shape_minimum`."""
        ...

    @property
    def adjusted_solution(self) -> Solution | None:
        """The batch solution of everything; none: something has changed since there was one."""
        ...

    @property
    def datum_solution(self) -> Solution | None:
        """The solution whose minimal datum holds a free network; none: the datum is given."""
        ...

    def names(self, kind: VariableKind) -> set[str]:
        """Return the names of the known variables of a kind."""
        ...

    def places(self) -> list[tuple[Unknowns, State, State]]:
        """Return unknowns, state and start values; those of a later entry were adjusted later."""
        ...

    def carried(self, unknowns: Unknowns, state: State) -> State:
        """Return a state with the values of what `places` does not have."""
        ...

    def cofactors(self, a: Variable, b: Variable) -> Array:
        """Return the joint cofactors of the components of two variables, (i, j).

        All blocks of one system have the same datum.
        """
        ...

    def function_cofactors(
        self, touched: Mapping[Variable, Index], a: Array, groups: Sequence[Index]
    ) -> list[Array]:
        """Return the cofactors A Q Aᵀ of groups of functions of unknowns.

        Args:
            touched: components of the variables that the functions touch.
            a: the functions by these, in their order, (k, m).
            groups: rows of each group.
        """
        ...

    def renumbered(self, new: Index) -> LinearSystem:
        """Return the system after the rows of the ledger have got new numbers (n,)."""
        ...

    def prepared(self) -> LinearSystem:
        """Compute now what the first new observation would wait for."""
        ...


def block_by_block(
    system: LinearSystem, touched: Mapping[Variable, Index], a: Array, groups: Sequence[Index]
) -> list[Array]:
    """Return A Q Aᵀ of groups of functions from the cofactors of pairs of variables.

    Arguments as of `LinearSystem.function_cofactors`.
    """
    ends = np.cumsum([len(own) for own in touched.values()], dtype=np.intp)
    at = {v: np.arange(end - len(touched[v]), end) for v, end in zip(touched, ends, strict=True)}
    out = []
    for rows in groups:
        found = np.zeros((len(rows),) * 2)
        mine = [v for v in touched if a[np.ix_(rows, at[v])].any()]
        for v, w in combinations_with_replacement(mine, 2):
            q = system.cofactors(v, w)[np.ix_(touched[v], touched[w])]
            block = a[np.ix_(rows, at[v])] @ q @ a[np.ix_(rows, at[w])].T
            found += block if v == w else block + block.T
        out.append(found)
    return out
