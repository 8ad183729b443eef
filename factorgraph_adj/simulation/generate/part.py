"""What every part of a simulated network is, and the scene that the parts are put in."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...errors import InputError, Problem, known
from ...network.network import Network
from ...types import Array
from ..parameters import Parameters, path_of

MILLIMETRE = 1e-3
"""In metres."""
MICROMETRE = 1e-3
"""In millimetres, the unit of image coordinates."""
GEOMETRY = 2000
"""Tag of the streams of geometry. numpy pads seeds with zeros, [s, p, 0] is [s, p]: without a tag
that is no other stream's, the first stream of part p is the noise of the p-th kind."""


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
    """A plan while its parts are put in."""

    plan: Network
    """The network with true values."""
    seed: int
    """Seed of the geometry."""
    points: list[list[str]] = field(default_factory=list)
    """Names of the points that each part so far has added."""
    number: int = 0
    """Number of the part that is put in now."""
    failed: set[int] = field(default_factory=set)
    """Parts that could not be put in."""

    @property
    def where(self) -> str:
        """Path of the part that is put in now."""
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
            InputError: a name that an earlier part has used.
        """
        full = [prefix + n for n in names]
        self._refuse_used(full, self.plan.points, "points")
        for name, xyz in zip(full, np.asarray(coordinates).tolist(), strict=True):
            self.plan.add_point(name, xyz, fixed=fixed)
        return full

    def photo_names(self, prefix: str, names: Sequence[str]) -> list[str]:
        """Return names of photos with the prefix; InputError where they are used."""
        full = [prefix + n for n in names]
        self._refuse_used(full, self.plan.photos, "photos")
        return full

    def _refuse_used(self, names: list[str], used: Container[str], what: str) -> None:
        twice = [n for n in names if n in used]
        if twice:
            self.fail(
                "prefix",
                f"{what} {known(twice, most=4)} exist already in an earlier part; give this one "
                "another prefix",
            )

    def points_of(self, parts: Sequence[int]) -> list[str]:
        """Return the names of the points of earlier parts; of all of them where none is named.

        Raises:
            InputError: a part that is not there, or has no points; without a problem where a part
                failed, whose problems are known.
        """
        wrong = [p for p in parts if not 0 <= p < self.number]
        if wrong:
            valid = f"0 to {self.number - 1}" if self.number else "none, it is the first"
            numbers = ", ".join(map(str, wrong))
            self.fail("parts", f"there is no earlier part {numbers}; valid: {valid}")
        chosen = parts or range(self.number)
        if self.failed & set(chosen):
            # Whatever is missing there has been said.
            raise InputError([])
        names = dict.fromkeys(n for p in chosen for n in self.points[p])
        if not names:
            self.fail("parts", "the earlier parts have no points")
        return list(names)

    def coordinates(self, names: Sequence[str]) -> Array:
        """Return true coordinates (n, 3) of points, metres."""
        return np.array([self.plan.points[n].coordinates for n in names]).reshape(-1, 3)
