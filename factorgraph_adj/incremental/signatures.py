"""What a datum has to do with a kind of observation.

Two observations of one kind, with as many components of their variables held, and with the same
distance meter and refraction, notice the same motions of a free network.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np

from ..types import Index
from .rows import Rows, Store

Signature: TypeAlias = tuple[object, ...]


def signatures(store: Store, pieces: Iterable[tuple[Rows, Index]]) -> set[Signature]:
    """Return the signatures of rows."""
    out: set[Signature] = set()
    for rows, at in pieces:
        if len(at):
            out |= _of(store, rows, at)
    return out


def _of(store: Store, rows: Rows, at: Index) -> set[Signature]:
    held, groups = [], []
    for kind, index in zip(rows.kinds, rows.index, strict=True):
        numbers = index.view[at]
        held.append((store.register[kind].place.view[numbers] < 0).sum(axis=1))
        groups.append(numbers if kind in ("edm", "refraction") else np.zeros_like(numbers))
    codes = np.unique(np.stack([*held, *groups], axis=1), axis=0)
    return {(rows.template.kind, *code) for code in codes.tolist()}
