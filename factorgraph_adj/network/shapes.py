"""Shapes of a network: a frame with the components that a shape has, and its sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..errors import InputError, Problem, known
from ..models.shapes import SHAPES


class StatedShapes:
    """Part of a network: its shapes, which are frames and sizes."""

    add_frame: Any
    """States a frame, see `StatedUnknowns.add_frame`."""
    of_kind: Any
    """Returns the stated unknowns of a kind by key."""
    set_unknown: Any
    """States an unknown of any kind."""

    def add_shape(
        self,
        name: str,
        shape: str,
        *,
        origin: str | Sequence[float] | None = None,
        free: Iterable[str] | None = None,
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
        level: bool = False,
    ) -> None:
        """State a shape: its frame, and those of its sizes that are not stated yet.

        Observations such as `OnPlane` say which points lie on it. Its place and its sizes are
        computed from points that are known, unless they are given.

        Args:
            name: its name, that of its frame. A radius, the angle of a cone and the focal length
                of a paraboloid have the same name; the radius of the ring of a torus has the name
                ``NAME ring``.
            shape: plane, line, circle, cylinder, sphere, cone, torus or paraboloid.
            origin: constant coordinates near its points, metres, or the name of a point; every
                shape needs one.
            free: free components of its frame, see `add_frame`; none: all that the shape has. With
                ``level`` and ``free=("x", "y")`` lines, cylinders and cones are upright; with
                ``level`` and ``free=("z",)`` planes are horizontal.
            values: values of components, as for `add_frame`.
            sigma: standard deviations of weighted components, as for `add_frame`.
            level: whether its frame counts from the horizon at its origin.

        Raises:
            InputError: an unknown shape, no origin; errors of `add_frame`.
        """
        found = SHAPES.get(shape)
        if found is None:
            what = f"unknown shape {shape!r}; valid: {known(SHAPES, meant=shape)}"
            raise InputError(Problem(what, f"shape {name!r}"))
        if origin is None:
            what = (
                "it needs an origin: constant coordinates near its points, such as "
                "origin=(100.0, 200.0, 10.0), or the name of a point"
            )
            raise InputError(Problem(what, f"shape {name!r}"))
        wanted = [n for n in found.free if n not in (sigma or {})] if free is None else free
        self.add_frame(name, free=wanted, values=values, sigma=sigma, origin=origin, level=level)
        for size in found.sizes:
            key = f"{name}{size.suffix}"
            if size.suffix is not None and key not in self.of_kind(size.kind):
                self.set_unknown(size.kind, key)
