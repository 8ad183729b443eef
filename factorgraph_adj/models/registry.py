"""The tables of kinds: which variables an observation touches, and its model; lens models.

A new kind of observation is a dataclass in `factorgraph_adj.observations`, a model function,
and one line here; a new lens model is a class and one line here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from . import position, terrestrial
from .base import Linearised
from .lens import (
    AffineLens,
    BalancedLens,
    BrownForwardLens,
    BrownLens,
    HarmonicLens,
    Lens,
    NormalisedLens,
)
from .orthogonal_lens import EbnerLens, GruenLens

VariableKind: TypeAlias = Literal[
    "point", "pose", "calibration", "orientation", "refraction", "vertical", "edm"
]
Unit: TypeAlias = Literal["m", "rad", "image", "mixed"]


@dataclass(frozen=True)
class Kind:
    """How observations of one kind are computed."""

    name: str
    """Name of the kind."""
    variables: tuple[tuple[VariableKind, str], ...]
    """Kind of each variable it touches, and the attribute of the observation that names it."""
    model: Callable[..., Linearised]
    """(frame, *variables, observed=…, constants…) → residuals and partials."""
    constants: tuple[str, ...] = ()
    """Attributes of the observation that the model takes as arrays."""
    unit: Unit = "m"
    """Unit of its value."""
    linear: bool = False
    """Whether its partials are the same wherever its ends are."""

    @property
    def curved(self) -> bool:
        """Whether it is a sight whose partials change with the place of its ends."""
        return not self.linear and sum(kind == "point" for kind, _ in self.variables) > 1


_SIGHT: tuple[tuple[VariableKind, str], ...] = (
    ("point", "station"),
    ("vertical", "station"),
    ("point", "target"),
    ("vertical", "target"),
)
_HEIGHTS = ("instrument_height", "target_height")
_EDM: tuple[VariableKind, str] = ("edm", "instrument")
_KAPPA: tuple[VariableKind, str] = ("refraction", "refraction")
_STATION = _SIGHT[:2]

KINDS: dict[str, Kind] = {
    k.name: k
    for k in (
        Kind("slope_distance", (*_SIGHT, _EDM), terrestrial.slope_distance, _HEIGHTS),
        Kind("horizontal_distance", (*_SIGHT, _EDM), terrestrial.horizontal_distance, _HEIGHTS),
        Kind("vertical_angle", (*_SIGHT, _KAPPA), terrestrial.vertical_angle, _HEIGHTS, "rad"),
        Kind("zenith_angle", (*_SIGHT, _KAPPA), terrestrial.zenith_angle, _HEIGHTS, "rad"),
        Kind(
            "direction",
            (*_SIGHT, ("orientation", "set")),
            terrestrial.direction,
            _HEIGHTS,
            "rad",
        ),
        Kind("azimuth", _SIGHT, terrestrial.azimuth, _HEIGHTS, "rad"),
        Kind(
            "horizontal_angle",
            (*_SIGHT, ("point", "target2"), ("vertical", "target2")),
            terrestrial.horizontal_angle,
            (*_HEIGHTS, "target2_height"),
            "rad",
        ),
        Kind("height_difference", _SIGHT, terrestrial.height_difference, _HEIGHTS, linear=True),
        Kind("astronomic_latitude", _STATION, terrestrial.astronomic_latitude, (), "rad"),
        Kind("astronomic_longitude", _STATION, terrestrial.astronomic_longitude, (), "rad"),
        Kind("gnss_vector", _SIGHT, position.gnss_vector, _HEIGHTS, linear=True),
        Kind("photo_position", (("pose", "photo"),), position.photo_position, ("lever_arm",)),
    )
}
"""Kinds with a model of their own, by name. Control points and weighted variables become rows
of `position.coordinate`, `position.photo_attitude` and `position.component`; image
coordinates have a table of their own."""

LENSES: dict[str, type[Lens]] = {
    cls.kind: cls
    for cls in (
        Lens,
        HarmonicLens,
        BrownLens,
        BrownForwardLens,
        NormalisedLens,
        BalancedLens,
        AffineLens,
        EbnerLens,
        GruenLens,
    )
}
"""Lens models by name."""
