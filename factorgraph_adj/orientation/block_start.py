"""Start of an adjustment from image points alone: oriented parts, and what is left out."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import known
from ..graph.observation_selection import filtered
from ..models.variables import VariableKind
from ..network.network import Network
from ..result_display import Rows, Shown
from ..start.start_values import Start
from ..types import Mask


@dataclass(frozen=True)
class OrientedPart:
    """Photos that were oriented together, from one start pair."""

    photos: tuple[str, ...]
    """Names of the photos."""
    start: tuple[str, str]
    """Names of the start pair."""
    n_points: int
    """Number of points."""
    n_fitting: int
    """Number of image points that agree."""
    spread: float
    """Standard deviation of the image points of the part, in their a-priori ones, from the median
    of the misses."""
    datum: str
    """What gave scale, rotation and shift, in words."""
    placed: bool
    """Whether all seven were found."""
    misfit: float
    """Median distance of known places from those of the part, metres; NaN: none is known."""

    def sentence(self) -> str:
        """Return the part in words."""
        off = f", median misfit {self.misfit:.2g} m" if np.isfinite(self.misfit) else ""
        placed = "placed in the frame by" if self.placed else "its place in the frame:"
        return (
            f"{len(self.photos)} photos from the pair {self.start[0]}, {self.start[1]}; "
            f"{len(self.photos) - 2} by resection, {self.n_points} points by intersection; "
            f"{placed} {self.datum}{off}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class BlockStart(Shown):
    """Poses and points of a block that were found from its image points."""

    network: Network
    """The network, which is not changed."""
    start: Start | None
    """Start of an adjustment; none: ``problems`` names what has no values."""
    parts: tuple[OrientedPart, ...]
    """Parts, the first one found first."""
    doubtful: tuple[str, ...]
    """Ids of the image points of oriented photos that do not agree with the block."""
    doubtful_rows: Mask
    """The same by their rows in the table of image points, (n,)."""
    unoriented: dict[str, str]
    """Photos that were not oriented, and why."""
    unreached: tuple[str, ...]
    """Points of which fewer than two image points agree; their start values are rough."""
    found_distances: dict[str, float]
    """Principal distance by camera where another than the given one was found, image units."""
    problems: tuple[str, ...] = ()
    """Why there is no start: what has no values."""
    by_given: tuple[str, ...] = ()
    """Photos with too few image points for a resection that were oriented from their known
    projection centres or attitudes."""
    doubts: tuple[str, ...] = ()
    """What may be wrong where parts share many points and do not fit one another."""

    def headline(self) -> str:
        """Return how many photos and points were found, and what was left out."""
        n = sum(len(p.photos) for p in self.parts) + len(self.by_given)
        return (
            f"BlockStart: {n} of {len(self.network.photos)} photos in {len(self.parts)} "
            f"part{'s' * (len(self.parts) != 1)}, {len(self.doubtful)} of "
            f"{self.network.n_image_points} image points doubtful"
        )

    def first_rows(self) -> Rows:
        """Return the parts."""
        header = ("start pair", "photos", "points", "image points", "spread", "datum")
        rows = (
            (", ".join(p.start), len(p.photos), p.n_points, p.n_fitting, p.spread, p.datum)
            for p in self.parts
        )
        return Rows(header, rows, len(self.parts))

    def sentences(self, *, most: int = 12) -> tuple[str, ...]:
        """Return in words how the block was oriented and what it left out.

        Args:
            most: number of names that are listed at most.
        """
        several = len(self.parts) > 1
        out = [
            f"Start from image points{f', part {i}' if several else ''}: {p.sentence()}."
            for i, p in enumerate(self.parts, 1)
        ]
        out += [
            f"Principal distance of camera {name}: {value:.6g} was found by a search."
            for name, value in self.found_distances.items()
        ]
        out += self.doubts
        if self.by_given:
            out.append(
                "Oriented from known projection centres or attitudes, and two rays or more: "
                f"{known(self.by_given, most=most)}."
            )
        if self.doubtful:
            out.append(
                f"{len(self.doubtful)} image points do not agree with the start, and were not used "
                f"for it: {known(self.doubtful, most=most)}."
            )
        if self.unreached:
            out.append(
                "Fewer than two image points agree on these points, whose start values are rough: "
                f"{known(self.unreached, most=most)}."
            )
        out += [f"Photo {name} was not oriented: {why}." for name, why in self.unoriented.items()]
        return tuple(out)

    def without_doubtful(self) -> Network:
        """Return the network without the doubtful image points and what they alone determine.

        The points of ``unreached`` are taken out with all their image points, and photos that were
        not oriented with theirs, unless something else observes them.
        """
        photo, point, _, _ = self.network.images.columns()
        out = self.network.copy()
        lost = _flags_of(self.network.points, self.unreached)
        away = _flags_of(self.network.photos, self.unoriented)
        out.image_mask(~(self.doubtful_rows | lost[point] | away[photo]))
        observed_points = {p for o in out.observations.values() for p in o.points()}
        observed_photos = {f for o in out.observations.values() for f in o.photos()}
        seen = set(np.array(list(out.points), dtype=object)[out.images.columns()[1]].tolist())

        def stays(kind: VariableKind, name: str) -> bool:
            if kind == "pose":
                return name not in self.unoriented or name in observed_photos
            if kind == "point":
                return name in seen or name in observed_points
            return True

        return filtered(out, stays)


def _flags_of(names: Mapping[str, object], some: Collection[str]) -> Mask:
    """Return flags of some of many names."""
    chosen = set(some)
    return np.array([n in chosen for n in names], dtype=bool)
