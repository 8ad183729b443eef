"""Factors that the user adds to an adjustment, and their rows at a state."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, TypeAlias

import gtsam

from ..errors import InputError
from ..graph.equations import Equations
from ..graph.extra import linearise_extra, name_of
from ..graph.keys import KeyMap
from ..graph.made import MakesFactor, made
from ..graph.partials import refuse_wrong_partials
from ..graph.variables import State, Unknowns
from ..network.network import Network
from .linear import ExtraRows


@dataclass(frozen=True, eq=False)
class Extra:
    """A user's factors, linearised at one state.

    GTSAM cannot pickle factors of every type, for instance factors written in Python. A pickled
    `Extra` keeps only the rows at its state. A solution with these rows has all its estimates,
    covariances and reliability figures. The rows cannot be linearised at another state: after
    pickling, `s_transform` cannot move a free network with such factors to other datum points.
    Copies share the factors.
    """

    factors: tuple[gtsam.NonlinearFactor, ...] | None = ()
    """The factors; none after pickling."""
    rows: tuple[ExtraRows, ...] = ()
    """Rows of the factors."""
    names: tuple[str, ...] = ()
    """Names of the factors; empty: their numbers from 1, and their types."""
    keyed: Unknowns | None = None
    """The unknowns that their keys belong to; none: those of the network that is adjusted first."""
    apart: int = 0
    """Number of further rows that count in the redundancy, and that no unknown changes."""

    @classmethod
    def of(cls, given: ExtraFactors, network: Network) -> Extra:
        """Return factors that a user gives: in order, or by name; rows that are there as they are.

        Args:
            given: factors, or functions by name that make them.
            network: network whose unknowns the keys belong to.

        Raises:
            InputError: names that are no texts, or what is no factor.
        """
        if isinstance(given, Extra):
            return given
        if isinstance(given, gtsam.NonlinearFactor):
            raise InputError("give factors in a list, [factor], or by name, {'name': factor}")
        if not isinstance(given, Mapping):
            return cls(tuple(_checked(given)))
        if wrong := [name for name in given if not isinstance(name, str)]:
            raise InputError(f"names of factors must be texts, not {wrong[0]!r}")
        found: dict[str, object] = dict(given)
        makers = {name: f for name, f in given.items() if callable(f)}
        if makers:
            keys = KeyMap(Unknowns(network))
            found |= {name: made(name, make, keys) for name, make in makers.items()}
        return cls(tuple(_checked(found.values())), names=tuple(given))

    def named(self) -> dict[str, gtsam.NonlinearFactor]:
        """Return the factors by their names.

        Raises:
            InputError: the factors were lost in pickling.
        """
        factors = self.given()
        names = self.names or [name_of(n, f) for n, f in enumerate(factors, start=1)]
        return dict(zip(names, factors, strict=True))

    def without(self, names: Collection[str]) -> Extra:
        """Return the factors without some of them, by their names; rows are not taken along."""
        left = {name: f for name, f in self.named().items() if name not in names}
        return Extra(tuple(left.values()), (), tuple(left), self.keyed)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.apart + sum(len(e.residual) for e in self.rows)

    def at(self, equations: Equations, state: State) -> Extra:
        """Return the same factors, linearised at another state.

        Raises:
            InputError: the factors were lost in pickling; or as `linearise_extra`.
        """
        factors = self.given()
        if not factors:
            return self
        keyed = equations.unknowns if self.keyed is None else self.keyed
        found = linearise_extra(self.named(), equations, state, keyed)
        rows = tuple(ExtraRows(columns, a, r, name) for name, columns, a, r in found)
        return Extra(factors, rows, self.names, keyed)

    def refuse_wrong_partials(self, equations: Equations, state: State) -> None:
        """Compare the partials of the factors with differences, see `refuse_wrong_partials`.

        Raises:
            InputError: the partial of each factor that is most wrong; or as `at`.
        """
        if self.given():
            keys = None if self.keyed is None else KeyMap(self.keyed)
            refuse_wrong_partials(self.named(), equations, state, keys)

    def given(self) -> tuple[gtsam.NonlinearFactor, ...]:
        """Return the factors.

        Raises:
            InputError: the factors were lost in pickling.
        """
        if self.factors is None:
            raise InputError(
                "the factors that were added to this adjustment were left behind when its solution "
                "was pickled: their rows are those of the solution, and cannot be had at another "
                "state; adjust again with extra_factors="
            )
        return self.factors

    def __deepcopy__(self, memo: dict[int, Any]) -> Extra:
        """Return a copy with copied rows and the same factors."""
        return Extra(self.factors, deepcopy(self.rows, memo), self.names, self.keyed, self.apart)

    def __copy__(self) -> Extra:
        """Return the object itself, as it is immutable."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Return the rows for pickling, without the factors."""
        kept = {"rows": self.rows, "names": self.names, "keyed": None, "apart": self.apart}
        return {"factors": None if self.factors else (), **kept}


def _checked(given: Iterable[object]) -> list[gtsam.NonlinearFactor]:
    """Return factors as they are.

    Raises:
        InputError: one is none.
    """
    out: list[gtsam.NonlinearFactor] = []
    for f in given:
        if not isinstance(f, gtsam.NonlinearFactor):
            kind = type(f).__name__
            raise InputError(f"factors must be a `gtsam.NonlinearFactor` each, not {kind}")
        out.append(f)
    return out


ExtraFactors: TypeAlias = (
    Sequence[gtsam.NonlinearFactor] | Mapping[str, gtsam.NonlinearFactor | MakesFactor] | Extra
)
"""Factors of a user: in order, or by name, or functions by name that make them; or with the
unknowns that their keys belong to."""
NOTHING_MORE = Extra()
"""No rows beside the observations."""
