"""Undo records of changes of a Bayes tree."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..models.variables import VariableKind
from ..types import Array, Index
from .row_groups import Grown


@dataclass(eq=False)
class Mark:
    """A tree before something is done to it, and what was replaced in it since then."""

    version: int
    """Its version."""
    counts: dict[VariableKind, int]
    """Number of variables of each kind."""
    of_units: tuple[Array, ...]
    """Whether each unit is in, and its gap."""
    of_keys: tuple[Array, ...]
    """Which keys have rows."""
    of_columns: tuple[Array, ...]
    """δ, δ at the last look, diagonal of N and bound of each column."""
    loosened: float
    """Largest factor by which standard deviations had grown since rows were measured."""
    units: list[Index] = field(default_factory=list)
    """Units whose rows were evaluated anew."""
    replaced: list[tuple[Grown, Index, Array]] = field(default_factory=list)
    """Values by row that were replaced: where, numbers of the rows, and values before."""
    theta: list[tuple[VariableKind, Index, Array]] = field(default_factory=list)
    """Kind and numbers of variables, with their points of linearisation before."""
