"""Covariances that refer to datum points although the datum itself is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.variables import Unknowns
from ..models.variables import VariableKind
from ..types import Array
from .datum import FreeDatum


@dataclass(frozen=True, eq=False)
class ReferenceDatum:
    """Datum points to which covariances refer although the datum itself is given."""

    points: tuple[str, ...]
    """Names of the datum points."""
    motions: tuple[str, ...]
    """Names of the motions that are removed; mixtures are named by their main part."""
    datum: FreeDatum
    """G and the datum coordinates among all components, including held ones."""
    unknowns: Unknowns
    """Layout of all components, including held ones."""
    cross: Array
    """F = Q B_D (components, d), see `FreeDatum.basis`; zero for held components."""
    square: Array
    """E = B_DᵀF (d, d)."""

    def transformed(
        self, block: Array, a: tuple[VariableKind, str], b: tuple[VariableKind, str]
    ) -> Array:
        """S-transform the cofactors (k, l) between two variables, by kind and name."""
        return self.datum.transformed(block, self._parts(*a), self._parts(*b), self.square)

    def transformed_points(self, blocks: Array) -> Array:
        """S-transform the cofactors (n, 3, 3) of all points."""
        offset = self.unknowns["point"].offset
        out = blocks.copy()
        on = np.flatnonzero(offset >= 0)
        columns = offset[on, None] + np.arange(3)
        both = self.datum.basis[columns], self.cross[columns]
        out[on] = self.datum.transformed(blocks[on], both, both, self.square)
        return out

    def _parts(self, kind: VariableKind, name: str) -> tuple[Array, Array]:
        """Return B and F of a variable, (k, d) each."""
        table = self.unknowns[kind]
        number = table.number[name]
        columns = self.unknowns.columns(kind, number)
        if not len(columns):
            nothing = np.zeros((int(table.size[number]), len(self.square)))
            return nothing, nothing
        return self.datum.basis[columns], self.cross[columns]
