"""Photos on the arc of an orbit or of a strip; formulas: `models.arcs`."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

from ..models import arcs, datum_motions
from ..models.unknown_registry import Component, UnknownKind, UnknownTable
from .base import VectorObservation
from .registry import ObservationKind


@dataclass(frozen=True)
class PhotoOnArc(VectorObservation):
    """Place of the projection centre of a photo against its arc, Rᵀ (X₀ − X(t)); metres.

    The arc is a trajectory, a function of time: the orbit of two bodies, a polynomial, or both, see
    `Network.add_arc`. The axes are photogrammetric ones of the camera: x right, y up, z backwards.
    Sigma says by how much the craft may differ from it.
    """

    kind: ClassVar[str] = "photo_on_arc"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    photo: str
    """The photo."""
    arc: str
    """The arc."""
    value: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Vector from the place on the arc to the projection centre, metres: 0, or the arm from the
    reference point of the craft, which the arc is of, to the camera. Lever arms of `PhotoPosition`
    have the opposite direction, from the camera to the antenna."""
    _: KW_ONLY
    time: float = field(metadata={"quantity": "number"})
    """Time t of the exposure, seconds since the epoch of the arc, best one in its middle."""
    sigma: tuple[float, float, float] | None = None
    """Standard deviations along the axes of the camera, metres; None if ``covariance`` is given."""


_TERMS = tuple(
    Component(f"{a}_{'t' * power}", "length", power=power, time="s", whole=True)
    for power in range(2, arcs.HIGHEST_POWER + 1)
    for a in "xyz"
)
UNKNOWNS_IN_MODULE = (
    UnknownKind(
        "arc",
        "arc",
        "O",
        (
            *(Component(a, "length", whole=True) for a in "xyz"),
            *(Component(f"{a}_t", "length", power=1, time="s", whole=True) for a in "xyz"),
            Component("gm", sign="GM (m³/s²)"),
            Component("spin", sign="spin (rad/s)"),
            *_TERMS,
        ),
        variable_size=True,
        motions=datum_motions.of_arcs,
        connects=True,
        late=2,
        table=UnknownTable("arcs", held_unless_free=True),
        remedy=(
            "an arc needs photos at different times: two for a straight line or an orbit, one more "
            "for each further power of t; gm is free only where it is not zero; short arcs tell "
            "little of the datum of the network, which needs control"
        ),
        titles={"de": "Bahnbogen"},
    ),
)
"""Arc: place and velocity at the epoch, GM and rate of turn of the body, terms of higher powers."""
KINDS_IN_MODULE = (
    ObservationKind(
        PhotoOnArc,
        (("pose", "photo"), ("arc", "arc")),
        arcs.photo_on_arc,
        ("time",),
        titles={"de": "Foto auf Bahnbogen"},
    ),
)
"""The record."""
