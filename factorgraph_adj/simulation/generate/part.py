"""Base of the parts of a simulated network, and the scene to which the parts are added."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...errors import InputError, Problem, known
from ...network.network import Network
from ...types import Array
from ..parameters import Parameters, path_of

MILLIMETRE = 1e-3
"""Millimetre in metres."""
MICROMETRE = 1e-3
"""Micrometre in millimetres, the unit of image coordinates."""
GEOMETRY = 2000
"""Tag of the streams of geometry. numpy pads seeds with zeros, [s, p, 0] is [s, p]: without a
unique tag, the first stream of part p would be the noise of the p-th kind."""


@dataclass(frozen=True)
class Part(Parameters):
    """Base of the parts: blocks of photos, terrestrial networks, additions to them.

    A part adds points, photos and observations to the plan, with true values. Its geometry is
    drawn from a stream of its own, so that other parts of a spec do not change it.
    """

    def add_to(self, scene: Scene) -> None:
        """Add the part to the scene."""
        raise NotImplementedError


@dataclass
class Scene:
    """A plan to which parts are added one after the other."""

    plan: Network
    """The network with true values."""
    seed: int
    """Seed of the geometry."""
    points: list[list[str]] = field(default_factory=list)
    """Names of the points that each part has added up to now."""
    strips: dict[int, list[list[str]]] = field(default_factory=dict)
    """Photos of the strips that each part has flown, by its number, in the order of flight."""
    number: int = 0
    """Number of the current part."""
    failed: set[int] = field(default_factory=set)
    """Numbers of the parts that could not be added."""

    @property
    def where(self) -> str:
        """Path of the current part."""
        return path_of("parts", self.number)

    def rng(self, stream: int) -> np.random.Generator:
        """Return a stream of random numbers of the part."""
        return np.random.default_rng([self.seed, GEOMETRY, self.number, stream])

    def fail(self, key: str, what: str) -> None:
        """Raise InputError about a key of the part."""
        raise InputError(Problem(what, path_of(self.where, key)))

    def add_points(
        self, prefix: str, names: Sequence[str], coordinates: Array, *, fixed: str = ""
    ) -> list[str]:
        """Add points; return their names with the prefix.

        Raises:
            InputError: an earlier part has used a name.
        """
        full = [prefix + n for n in names]
        self.refuse_used(full, self.plan.points, "points")
        for name, xyz in zip(full, np.asarray(coordinates).tolist(), strict=True):
            self.plan.add_point(name, xyz, fixed=fixed)
        return full

    def photo_names(self, prefix: str, names: Sequence[str]) -> list[str]:
        """Return names of photos with the prefix; InputError if a name is used already."""
        full = [prefix + n for n in names]
        self.refuse_used(full, self.plan.photos, "photos")
        return full

    def refuse_used(self, names: list[str], used: Container[str], what: str) -> None:
        """Refuse names that an earlier part has used."""
        twice = [n for n in names if n in used]
        if twice:
            self.fail(
                "prefix",
                f"{what} {known(twice, most=4)} exist already in an earlier part; give this one "
                "another prefix",
            )

    def points_of(self, parts: Sequence[int]) -> list[str]:
        """Return the names of the points of earlier parts; ``parts`` empty means all of them.

        Raises:
            InputError: a part does not exist or has no points. The error lists no problem for a
                failed part, whose problems are known already.
        """
        chosen = self._earlier(parts)
        names = dict.fromkeys(n for p in chosen for n in self.points[p])
        if not names:
            self.fail("parts", "the earlier parts have no points")
        return list(names)

    def coordinates(self, names: Sequence[str]) -> Array:
        """Return true coordinates (n, 3) of points, metres."""
        return np.array([self.plan.points[n].coordinates for n in names]).reshape(-1, 3)

    def strips_of(self, parts: Sequence[int]) -> list[list[str]]:
        """Return the photos of the strips of earlier parts; ``parts`` empty means all of them.

        Photos of a part that is not flown in strips count as one strip; cameras that others carry
        are in none.

        Raises:
            InputError: as `points_of`.
        """
        chosen = self._earlier(parts)
        found = [strip for p in chosen for strip in self.strips.get(p, []) if strip]
        if not found:
            self.fail("parts", "the earlier parts have no photos")
        return found

    def note_photos(self, before: int) -> None:
        """Note the photos behind the first ``before`` as one strip, unless the part has strips."""
        new = list(self.plan.photos)[before:]
        self.strips.setdefault(self.number, [new])

    def _earlier(self, parts: Sequence[int]) -> list[int]:
        """Return numbers of earlier parts, all if none are asked for; refuse others."""
        wrong = [p for p in parts if not 0 <= p < self.number]
        if wrong:
            valid = f"0 to {self.number - 1}" if self.number else "none, it is the first"
            numbers = ", ".join(map(str, wrong))
            self.fail("parts", f"there is no earlier part {numbers}; valid: {valid}")
        chosen = parts or range(self.number)
        if self.failed & set(chosen):
            # The problems of the failed part are already listed.
            raise InputError([])
        return list(chosen)
