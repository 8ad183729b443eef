"""Units of linear rows: as one system, and correlated ones of one pattern at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..graph.clusters import alike, first_equal
from ..types import Array, Index


class Stacked(NamedTuple):
    """Units as one system of rows, correlated ones whitened."""

    a: Array
    """Partials, (n, m)."""
    v: Array
    """Residuals at θ, (n,)."""
    columns: Index
    """Columns of the variables that they touch, ascending, (m,)."""
    rows: list[Index]
    """Rows of each unit."""


class WideForm(NamedTuple):
    """Partials of rows of one sort by all columns of a variable."""

    keys: Index
    """Key of the variable, −1 where it is a constant, (n,)."""
    a: Array
    """Partials, (n, d, largest size)."""
    size: Index
    """Number of columns of the variable, (n,)."""


def wide_form(a: Array, columns: Index, key: Index, first: Index, size: Index) -> WideForm:
    """Return partials by all columns of a variable.

    Args:
        a: partials by some of them, (n, d, s).
        columns: these, −1: held, (n, s).
        key: key of each column.
        first: first column of each key.
        size: number of columns of each key.
    """
    free = columns >= 0
    keys = np.where(free.any(axis=1), columns.max(axis=1, initial=-1), -1)
    keys[keys >= 0] = key[keys[keys >= 0]]
    sizes = np.where(keys >= 0, size[keys], 0) if len(first) else 0 * keys
    i, j = np.nonzero(free)
    wide = np.zeros((len(a), a.shape[1], int(sizes.max(initial=0))))
    wide[i, :, columns[i, j] - first[keys[i]]] = a[i, :, j]
    return WideForm(keys, wide, sizes)


class CorrelatedUnits(NamedTuple):
    """Units of one pattern, whitened."""

    units: Index
    """Their numbers, (n,)."""
    a: Array
    """Partials, (n, k, w)."""
    v: Array
    """Residuals at θ, (n, k)."""
    variables: list[tuple[Index, slice]]
    """Keys (n,) of each variable, and its columns of the partials."""

    def columns(self, first: Index) -> Iterator[tuple[slice, Index]]:
        """Yield the columns of the partials of each variable, and those of the unknowns (n, s).

        Args:
            first: first column of each key.
        """
        for keys, on in self.variables:
            yield on, first[keys][:, None] + np.arange(on.stop - on.start)


def correlated_units(
    units: Index, whitener: Array, v: Sequence[Array], forms: Sequence[Sequence[WideForm]]
) -> Iterator[CorrelatedUnits]:
    """Iterate over units in patterns of equal variables.

    Args:
        units: their numbers, (n,).
        whitener: W of each, (n, k, k).
        v: residuals of each member, (n, d).
        forms: partials of each member.
    """
    begin = np.cumsum([0, *(part.shape[1] for part in v)]).tolist()
    slots = [(begin[i], begin[i + 1], form) for i, own in enumerate(forms) for form in own]
    joined = np.concatenate(v, axis=1)
    keys = np.stack([form.keys for _, _, form in slots], axis=1)
    sizes = np.stack([form.size for _, _, form in slots], axis=1)
    firsts = np.where(keys >= 0, first_equal(keys), -1)
    for on in alike(np.concatenate([firsts, sizes], axis=1)):
        first, size = firsts[on[0]].tolist(), sizes[on[0]].tolist()
        columns: dict[int, slice] = {}
        width = 0
        for i in (i for i, f in enumerate(first) if f == i):
            columns[i] = slice(width, width + size[i])
            width += size[i]
        a = np.zeros((len(on), begin[-1], width))
        for (start, stop, form), f, n in zip(slots, first, size, strict=True):
            if f >= 0:
                a[:, start:stop, columns[f]] += form.a[on][:, :, :n]
        w = whitener[on]
        variables = [(keys[on, i], own) for i, own in columns.items()]
        yield CorrelatedUnits(units[on], w @ a, (w @ joined[on][:, :, None])[:, :, 0], variables)
