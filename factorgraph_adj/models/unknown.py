"""Record of a kind of unknowns: components, table, stored form, tangent; all: `unknown_registry`.

A stored value is a vector of its components. Where ``rotates`` is true the first three components
are a rotation R, stored as nine matrix elements in rows; the tangent of R is R ← R Exp(ω), and the
given values of R are the rotation vector Log R. Steps of all other components are added.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from ..rotation import exp_rotation, log_rotation, right_jacobian_inverse
from ..types import Array, Index, Mask
from .base import within
from .datum_motions import Motions

Quantity: TypeAlias = Literal["length", "angle", "ppm", "number"]
"""Quantity of a component: metres, radians, a ratio shown in millionths, or a plain number."""
Held: TypeAlias = Callable[[Array, Array, Mask, Array], Array]
"""(stored values (n, s), G (n, k, 7), held components (n, k), places that stay (n, 3)) → G."""
MoveBy: TypeAlias = Callable[[Motions, Array, Index], Array]
"""(motions, stored values (n, s), numbers (n,) of the points of the unknowns) → G (n, k, 7)."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")
ROTATION = 9
"""Number of stored values of a rotation, the elements of its matrix."""
ENTITIES = ("point", "pose", "calibration")
"""Kinds of the unknowns that belong to the points, photos and cameras of a network."""


@dataclass(frozen=True)
class Component:
    """One component of an unknown."""

    name: str
    """Name, as in results: ``scale``."""
    quantity: Quantity = "number"
    """Quantity of the component."""
    start: float = 0.0
    """Start value if none is given, SI; NaN if the start value is computed."""
    sign: str = ""
    """Symbol in reports; if empty, the name."""
    column: str = ""
    """Column in the table of the project; if empty, the name."""
    plain: bool = False
    """Whether the column has a name without unit and values in the unit of the project."""
    whole: bool = False
    """Whether values are shown in the unit of observed values, not in that of standard deviations:
    a coordinate, or a rotation of any size. Angles of the whole circle always are."""
    circular: bool = False
    """Whether it is an angle of the whole circle, which results give in [0, 2π)."""
    largest_error: float = math.inf
    """Largest error, SI, that a given value may have; a larger one explains nothing."""
    power: int = 0
    """Power of the time t by which observations multiply it: its unit is one per unit of t to this
    power, which reports say."""
    time: str = "t"
    """Unit of t, where it is always the same: s."""
    planned: float = float("nan")
    """Value that a plan takes where none is given: no partial depends on it, or it is the natural
    one, as no offset from an origin that was stated; NaN: a plan refuses the unknown."""


@dataclass(frozen=True)
class UnknownTable:
    """The table of a project that states the unknowns of a kind."""

    file: str
    """Name of the table: ``distance_meters`` for the file distance_meters.csv."""
    keys: tuple[str, ...] = ("name",)
    """Columns that name an unknown. An observation refers to the last column."""
    key_default: str = ""
    """Value of an empty last key in a table with several keys."""
    held_unless_free: bool = False
    """True: a column ``free`` lists the free components. False: ``fixed`` lists the held ones."""


@dataclass(frozen=True)
class UnknownKind:
    """Record of a kind of unknowns."""

    name: str
    """Name of the kind: lower-case letters, digits and underscores."""
    noun: str
    """Noun before the name of an unknown in messages: ``distance meter``."""
    letter: str
    """Character of the keys in a GTSAM graph; each kind has its own."""
    components: tuple[Component, ...] = ()
    """Components of the tangent; empty for calibrations, whose lens models name the components."""
    short: str = ""
    """Short noun for the tables of the report; if empty, ``noun``."""
    rotates: bool = False
    """Whether the first three components are a rotation."""
    variable_size: bool = False
    """Whether an unknown may have only the first few of the listed components."""
    motions: MoveBy | None = None
    """Change of the components in a motion of the whole object; None: no change."""
    held_motions: Held | None = None
    """Motions where components are held; None: those of the other components stay the same."""
    connects: bool = False
    """Whether observations of one unknown of this kind belong to one connected part."""
    single_turns: bool = False
    """Whether single components of the rotation, about the axes of the unknown itself, may be held:
    those about x and y keep the direction of its z axis."""
    constants: tuple[str, ...] = ()
    """Names of numbers that belong to an unknown and never change; they are stored behind its
    components."""
    words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Words that stand for several components where free ones are listed: ``rotation``."""
    late: int = 0
    """Place in the elimination: 0 with the points, 1 after them, 2 last; many observations
    touch an unknown that is eliminated late."""
    table: UnknownTable | None = None
    """Table in a project; None for points, photos and cameras, whose tables have special forms."""
    default: tuple[float, ...] | None = None
    """Values of the held constant for observations that name no unknown of this kind; None if
    every observation must name an unknown."""
    absent: Literal["refused", "default", "found"] = "refused"
    """Treatment of a name that the network does not state: the name is refused, means the default,
    or creates a free unknown whose start value is computed."""
    shifts: bool = False
    """Whether the first three components are a shift of observed coordinates along x, y, z."""
    at_point: bool = False
    """Whether the unknown belongs to a point, whose name is the first key."""
    in_photo: bool = False
    """Whether the unknown belongs to a photo, whose name is its key."""
    across: bool = False
    """Whether the two components point north and east: they turn with the object about the
    vertical."""
    at_stations: bool = False
    """Whether the unknown belongs to the stations of its observations together: in a motion of the
    whole it changes by the mean of what it would change by at each of them."""
    additional: bool = False
    """Whether the components are additional parameters, which are tested for significance."""
    reference: Literal["zero", "given"] = "zero"
    """Value with which a test of significance compares a free component."""
    instrument: bool = False
    """Whether the unknown belongs to an instrument, for groups of variance components."""
    remedy: str = ""
    """What helps where unknowns of the kind are not determined; empty: nothing in particular."""
    on_earth: bool = False
    """Whether it is the height of a surface, or a constant of azimuths, that many places share:
    on the curved Earth observations of it tell a free network by little where it is."""
    titles: Mapping[str, str] = field(default_factory=dict)
    """Its title in reports by language, such as ``de``, where no catalogue of texts has it."""

    @property
    def title(self) -> str:
        """Noun in the tables of the report."""
        return self.short or self.noun

    @property
    def size(self) -> int:
        """Largest number of components."""
        return len(self.components)

    @property
    def usual(self) -> int:
        """Number of components where no values are given: those of the default, or all."""
        return self.size if self.default is None else len(self.default)

    @property
    def stored(self) -> int:
        """Length of the stored value of an unknown with all components."""
        return self.moving + len(self.constants)

    @property
    def moving(self) -> int:
        """Length of the stored value without constants."""
        return self.size + (ROTATION - 3 if self.rotates else 0)

    def names(self, size: int | None = None) -> tuple[str, ...]:
        """Return the names of the first ``size`` components; None: of all components."""
        return tuple(c.name for c in self.components[:size])

    def store(self, values: Array) -> Array:
        """Return the stored form (n, s) of given values (n, k)."""
        if not self.rotates:
            return values
        rotation = exp_rotation(values[:, :3]).reshape(-1, ROTATION)
        return np.concatenate([rotation, values[:, 3:]], axis=1)

    def given(self, stored: Array) -> Array:
        """Return the values (n, k) of a stored form (n, s)."""
        if not self.rotates:
            return stored
        rotation = log_rotation(stored[:, :ROTATION].reshape(-1, 3, 3))
        return np.concatenate([rotation, stored[:, ROTATION : self.moving]], axis=1)

    def shown(self, stored: Array) -> Array:
        """Return the values (n, k) of a stored form (n, s) for results: circular ones in [0, 2π).

        >>> UNKNOWNS["orientation"].shown(np.array([[-0.5]])).round(4).tolist()
        [[5.7832]]
        """
        values = self.given(stored)
        turning = np.array([c.circular for c in self.components], dtype=bool)
        if not turning.any():
            return values
        return np.where(turning, within(values), values)

    def retract(self, stored: Array, step: Array) -> Array:
        """Return stored values (n, s) moved by steps of the tangent (n, k)."""
        if not self.rotates:
            return stored + step
        turned = stored[:, :ROTATION].reshape(-1, 3, 3) @ exp_rotation(step[:, :3])
        others, constants = stored[:, ROTATION : self.moving], stored[:, self.moving :]
        return np.concatenate(
            [turned.reshape(-1, ROTATION), others + step[:, 3:], constants], axis=1
        )

    def local(self, stored: Array, other: Array) -> Array:
        """Return the steps (n, k) that move stored values (n, s) to ``other`` (n, s)."""
        if not self.rotates:
            return np.asarray(other - stored)
        a, b = (x[:, :ROTATION].reshape(-1, 3, 3) for x in (stored, other))
        turn = log_rotation(np.swapaxes(a, 1, 2) @ b)
        rest = slice(ROTATION, self.moving)
        return np.concatenate([turn, other[:, rest] - stored[:, rest]], axis=1)

    def by_step(self, stored: Array) -> Array:
        """Return the partials of given values by steps of the tangent, (n, k, k), at (n, s).

        The rotation vector w = Log R moves by J_r⁻¹(w) ω where R ← R Exp(ω); all other components
        move by their steps.
        """
        given = self.given(stored)
        out = np.tile(np.eye(given.shape[1]), (len(given), 1, 1))
        if self.rotates:
            out[:, :3, :3] = right_jacobian_inverse(given[:, :3])
        return out

    def in_stored_form(self, components: Mask) -> Mask:
        """Return flags of components (n, k) as flags of stored numbers (n, s).

        A rotation is flagged as a whole if any of its three components is.
        """
        if not self.rotates:
            return components.copy()
        turned = np.repeat(components[:, :3].any(axis=1, keepdims=True), ROTATION, axis=1)
        never = np.zeros((len(components), len(self.constants)), dtype=bool)
        return np.concatenate([turned, components[:, 3:], never], axis=1)

    def problems(self) -> list[str]:
        """Return all errors in the record itself."""
        found = []
        if not _NAME.fullmatch(self.name):
            found.append(f"its name must be lower-case letters, digits and _, not {self.name!r}")
        if not self.noun:
            found.append("its noun is missing: messages name its unknowns by it")
        if len(self.letter) != 1 or not self.letter.isascii() or not self.letter.isalpha():
            found.append(f"its letter must be one letter from a to z, not {self.letter!r}")
        names = [c.name for c in self.components]
        if len(set(names)) < len(names) or "" in names:
            found.append(f"its components must have different names, not {', '.join(names)}")
        if self.rotates and len(names) < 3:
            found.append("it rotates, so that it needs three components of rotation first")
        if self.rotates and any(c.quantity != "angle" for c in self.components[:3]):
            found.append("it rotates: its first three components must be angles")
        if self.rotates and self.variable_size:
            found.append("it rotates, so that it cannot have fewer components than are listed")
        if self.connects and self.motions is None:
            found.append("it connects, so that motions must say how it follows the object")
        if self.table is None and self.name not in ENTITIES:
            found.append("its table is missing: a project could not state it")
        if self.absent == "default" and self.default is None:
            found.append("absent names mean a default, but there is none")
        most = self.default is not None and len(self.default)
        if most is not False and not (
            most == self.size or (self.variable_size and most < self.size)
        ):
            found.append(f"its default must be {self.size} values, not {self.default}")
        return found
