"""Photos on carriers of a rig, shapes with their sizes, attributes of a network by kind."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, Protocol

from ..entities import Parameter
from ..errors import InputError, Problem, known, unknown_name
from ..models.shapes import SHAPES
from ..models.unknown_registry import VariableKind
from ..observations.relative_poses import RelativePosition, RelativeRotation

RIGID = (1e-8, 1e-6)
"""Play of a rigid mount, radians and metres: beside a projection centre with σ = 1 mm it changes
nothing by more than (play/σ)² = 10⁻⁶ of σ. Ten times less costs digits that large blocks need."""


class Holder(Protocol):
    """What has stated unknowns by kind and key."""

    parameters: dict[VariableKind, dict[Any, Parameter]]
    """The unknowns."""

    def of_kind(self, kind: VariableKind) -> dict[Any, Parameter]:
        """Return the stated unknowns of a kind by key."""


class OfKind:
    """Attribute of a network: its stated unknowns of one kind by key."""

    def __init__(self, kind: VariableKind) -> None:
        self.kind = kind

    def __get__(self, network: Holder, owner: object = None) -> dict[Any, Parameter]:
        return network.of_kind(self.kind)

    def __set__(self, network: Holder, given: Mapping[Any, Parameter]) -> None:
        # Copies of the network may share the table of kinds: the setter replaces the table.
        network.parameters = {**network.parameters, self.kind: dict(given)}


def member_of_rig(
    photo: str,
    carrier: str,
    mount: str,
    *,
    play: tuple[float, float] = RIGID,
    photos: Mapping[str, object],
    mounts: Mapping[str, object],
    observations: Container[str] = (),
    source: str | None = None,
) -> tuple[RelativeRotation, RelativePosition]:
    """Return the relative pose, of value zero, that puts a photo on its carrier.

    Args:
        photo: the member.
        carrier: the photo that carries it, or is its reference.
        mount: the mount of the member.
        play: standard deviations of its rotation, radians, and position, metres.
        photos: photos that may be carriers, by name.
        mounts: mounts, by name.
        observations: ids that are taken.
        source: file and line that put the photo there.

    Raises:
        InputError: everything that is wrong.
    """
    where, problems = f"photo {photo!r}", []
    if carrier == photo:
        problems.append(Problem("a photo cannot be its own carrier", where))
    elif carrier not in photos:
        there = known(photos, meant=carrier)
        problems.append(Problem(f"unknown carrier {carrier!r}; photos: {there}", where))
    if mount not in mounts:
        if not mounts:
            there += "; rows of mounts.csv state them, or set_mount"
        problems.append(Problem(unknown_name("mount", mount, mounts), where))
    if len(play) != 2 or not all(0 < s < float("inf") for s in play):
        what = f"play must be two standard deviations > 0, radians and metres, not {play}"
        problems.append(Problem(what, where))
    ids = [f"{photo} on {carrier} {part}" for part in ("rotation", "position")]
    problems += [Problem(f"duplicate id {i!r}", where) for i in ids if i in observations]
    if problems:
        raise InputError(problems)
    zero = (0.0, 0.0, 0.0)
    turn, shift = play
    rotation, position = ids
    return (
        RelativeRotation(
            carrier, photo, zero, sigma=(turn,) * 3, mount=mount, id=rotation, source=source
        ),
        RelativePosition(
            carrier, photo, zero, sigma=(shift,) * 3, mount=mount, id=position, source=source
        ),
    )


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
