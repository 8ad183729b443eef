"""Records of points on shapes."""

from __future__ import annotations

from collections.abc import Sequence

from ..models.shapes import SHAPES
from . import on_shapes
from .on_shapes import _OnShape
from .registry import ObservationKind


def on_shape(cls: type[_OnShape]) -> ObservationKind:
    """Return the record of points on a shape."""
    shape = SHAPES[cls.shape_name]
    variables = (
        ("frame", "shape"),
        ("point", "point"),
        ("point", "shape.origin"),
        ("vertical", "shape.origin"),
        *((s.kind, s.attribute) for s in shape.sizes),
    )
    return ObservationKind(
        cls, variables, shape, shape=shape.name, turns=shape.turns, outline=shape.outline
    )


RECORDS: Sequence[ObservationKind] = tuple(
    on_shape(cls)
    for cls in (
        on_shapes.OnPlane,
        on_shapes.OnLine,
        on_shapes.OnCircle,
        on_shapes.OnCylinder,
        on_shapes.OnSphere,
        on_shapes.OnCone,
        on_shapes.OnTorus,
        on_shapes.OnParaboloid,
    )
)
"""The records."""
