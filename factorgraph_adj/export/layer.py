"""Shapes of one kind with columns of data, and how large they are drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal, TypeAlias

import numpy as np

from ..errors import InputError
from ..quality.levels import CONFIDENCE
from ..types import Array

Geometry: TypeAlias = Literal["POINT", "LINESTRING", "POLYGON"]
"""What the shapes of a layer are."""


@dataclass(frozen=True, eq=False)
class Layer:
    """Shapes of one kind with columns of data."""

    name: str
    """Name of the layer: points, ellipses, observations …"""
    title: str
    """What the layer shows, with units and exaggeration."""
    geometry: Geometry
    """What the shapes are. Rings of polygons are closed and counter-clockwise."""
    shapes: Sequence[Array | None]
    """Map coordinates (m, 3) of each shape, None for what has no place."""
    columns: Mapping[str, Sequence[Any]]
    """Data of each shape: texts, numbers (NaN: unknown) and truth values by name."""
    looks: Sequence[str] = ()
    """How each shape looks where a format has one look for each; empty: all as the layer."""

    def look(self, number: int) -> str:
        """Return how a shape looks: the name of the layer, or of one of its own looks."""
        return self.looks[number] if self.looks else self.name

    def __len__(self) -> int:
        return len(self.shapes)

    def records(self) -> list[dict[str, Any]]:
        """Return the data of each shape by name, None where a number is not known."""
        cells = [plain_column(column) for column in self.columns.values()]
        return [
            dict(zip(self.columns, row, strict=True))
            for row in (zip(*cells, strict=True) if cells else ({} for _ in self.shapes))
        ]


@dataclass(frozen=True)
class Drawn:
    """What a map draws larger than it is."""

    confidence: float | None = CONFIDENCE
    """Probability of the error ellipses; None: standard ellipses."""
    exaggeration: float | None = None
    """Factor of the error ellipses; None: 1, 2 or 5 times a power of ten that makes them visible;
    1: true size."""
    vector_exaggeration: float | None = None
    """The same for differences at check points and control points."""

    def __post_init__(self) -> None:
        """Refuse factors that are not positive."""
        for name in ("exaggeration", "vector_exaggeration"):
            value = getattr(self, name)
            if value is not None and not (
                isinstance(value, int | float) and isfinite(value) and value > 0
            ):
                raise InputError(f"{name} must be a number greater than zero, not {value!r}")


def plain_column(values: Sequence[Any]) -> list[Any]:
    """Return values of Python as `plain` does; most columns have values of one type."""
    types = set(map(type, values))
    if types == {float}:
        return [v + 0.0 if isfinite(v) else None for v in values]
    if types <= {str, int, bool}:
        return list(values)
    return [plain(v) for v in values]


def plain(value: Any) -> Any:
    """Return a value of Python: None for a number that is not finite, −0 as 0."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return value + 0.0 if isfinite(value) else None
    return value
