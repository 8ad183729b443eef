"""Strips: models joined by similarities, turned to ground; network of points with polynomials.

Each model is joined to the strip by a similarity over the points and projection centres that both
have; common points get the mean. The strip is turned, scaled and shifted to the ground by one
similarity over its control points. Polynomials then take what the joins have added up to (Ayeni's
methods 11 and 18, FRAMES F6).

Weights of strip coordinates are an assumption: they are correlated along the strip, and residuals
at control are not errors of single measurements. Reliability of single points means little.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..entities import ImageTable, Point
from ..errors import InputError, Problem
from ..graph.observation_selection import without
from ..models.similarity import Similarity, extent_ratio, fit_similarity
from ..network.network import Network
from ..observations import StripCoordinate
from ..observations.base import joined_points, of_quantities
from ..observations.registry import CONTROL_QUANTITIES
from ..result_display import Rows, Shown
from ..types import Array
from .independent_models import RelativeModel, start_values

METRES_OF_STRIP_UNIT = 1000.0
"""Metres in the unit of places in a strip."""
MIN_COMMON_PLACES = 3
"""Smallest number of common places of two models, and of control points of a strip."""
MIN_EXTENT_RATIO_OF_MODELS = 1e-3
"""Smallest ratio of extents, across and along, at which places fix a similarity."""


def fitted_similarity(x: Array, to: Array, where: str) -> Similarity:
    """Return the similarity that carries places x (n, 3) to others (n, 3) with least squares.

    Raises:
        InputError: the places are fewer than three or lie on one line.
    """
    if not extent_ratio(x) > MIN_EXTENT_RATIO_OF_MODELS:
        what = f"{len(x)} common places fix no similarity: three are needed, not on one line"
        raise InputError(Problem(what, where))
    return fit_similarity(x, to)


@dataclass(frozen=True, repr=False, eq=False)
class Strip(Shown):
    """A strip: coordinates of its points and projection centres in one system."""

    name: str
    """Name."""
    points: Mapping[str, Array]
    """Coordinates (3,) by point."""
    centres: Mapping[str, Array]
    """Coordinates (3,) of the projection centres by photo, in the order of the strip."""

    def headline(self) -> str:
        """Return the numbers of photos and points."""
        return f"Strip {self.name!r}: {len(self.centres)} photos, {len(self.points)} points"

    def first_rows(self) -> Rows:
        """Return the coordinates of the points."""
        rows = ((name, *map(float, x)) for name, x in self.points.items())
        return Rows(("point", "x", "y", "z"), rows, len(self.points))

    def moved(self, by: Similarity) -> Strip:
        """Return the strip after a similarity."""
        points, centres = (
            {name: by.of(x) for name, x in places.items()} for places in (self.points, self.centres)
        )
        return Strip(self.name, points, centres)

    def to_ground(self, control: Mapping[str, Array]) -> Strip:
        """Return the strip after its absolute orientation at control points (3,).

        Raises:
            InputError: it has fewer than three control points, or they lie on one line.
        """
        common = [p for p in self.points if p in control]
        x, to = (np.array([d[p] for p in common]).reshape(-1, 3) for d in (self.points, control))
        return self.moved(fitted_similarity(x, to, f"strip {self.name!r}"))

    def places(self) -> dict[str, tuple[float, float]]:
        """Return along and across, kilometres from the middle of the strip, by point."""
        middle, axis = self._line()
        found = {}
        for name, x in self.points.items():
            s = complex(*(x - middle)[:2]) / axis / METRES_OF_STRIP_UNIT
            found[name] = (s.real, s.imag)
        return found

    def _line(self) -> tuple[Array, complex]:
        """Return the middle of the strip, and the direction from the first to the last photo."""
        centres = np.array([*self.centres.values()])
        middle = 0.5 * (centres[0] + centres[-1])
        axis = complex(*(centres[-1] - centres[0])[:2])
        return middle, axis / abs(axis)

    def observations(
        self, *, sigma: Sequence[float], axes: str = "xyz"
    ) -> tuple[StripCoordinate, ...]:
        """Return the coordinates as observations, for a strip on the ground.

        Args:
            sigma: standard deviations of the axes, metres.
            axes: axes that are observed: xy, z or xyz.
        """
        rows = ["xyz".index(a) for a in axes]
        return tuple(
            StripCoordinate(
                self.name,
                p,
                tuple(self.points[p][rows].tolist()),
                along=along,
                across=across,
                axes=axes,
                sigma=tuple(sigma),
            )
            for p, (along, across) in self.places().items()
        )


def join_models(models: Sequence[RelativeModel], *, name: str = "strip") -> Strip:
    """Return models joined one to the next, in the system of the first one.

    Raises:
        InputError: no models, or a model with fewer than three places in common with the strip.
    """
    if not models:
        raise InputError(Problem("it has no models", f"strip {name!r}"))
    sums: dict[tuple[str, str], list[Array]] = {}
    last: dict[tuple[str, str], Array] = {}
    for m in models:
        places = {("point", p): x for p, x in m.points.items()}
        places |= {("photo", f): x for f, x in m.centres.items()}
        if last:
            common = [p for p in places if p in last]
            x = np.array([places[p] for p in common]).reshape(-1, 3)
            to = np.array([last[p] for p in common]).reshape(-1, 3)
            by = fitted_similarity(x, to, f"model {m.name!r} of strip {name!r}")
            places = {p: by.of(x) for p, x in places.items()}
        last = places
        for p, x in places.items():
            sums.setdefault(p, []).append(x)
    mean = {p: np.mean(found, axis=0) for p, found in sums.items()}
    points = {n: x for (what, n), x in mean.items() if what == "point"}
    centres = {n: x for (what, n), x in mean.items() if what == "photo"}
    return Strip(name, points, centres)


def control_coordinates(network: Network) -> dict[str, Array]:
    """Return the coordinates (3,) of points that are held, weighted or observed in all axes."""
    found = {n: np.array(p.coordinates) for n, p in network.points.items() if _is_control(p)}
    for o in of_quantities(network.observations.values(), *CONTROL_QUANTITIES):
        if o.axes == "xyz":
            found[o.point] = np.array(o.value, dtype=float)
    return found


def as_strips(
    network: Network,
    strips: Mapping[str, Sequence[RelativeModel]],
    *,
    sigma: Sequence[float],
    plan: int = 2,
    height: Iterable[str] = ("z", "z_x", "z_y", "z_xx"),
    places: Mapping[str, Array] | None = None,
) -> Network:
    """Turn a block of photos into strips that polynomials bend.

    Args:
        network: the block with its control. Photos, rays and what was observed at photos leave it.
        strips: models of each strip in order, by name of the strip.
        sigma: standard deviations of strip coordinates x, y, z, metres.
        plan: degree in plan.
        height: free terms of the height.
        places: coordinates (3,) by point at which strips are oriented; by default those of control
            points where a strip has three, otherwise the approximate ones of the block. Where a
            strip has little control, repeat with the adjusted coordinates.

    Raises:
        InputError: strips that cannot be joined or oriented.
    """
    control = control_coordinates(network) if places is None else dict(places)
    terms = tuple(height)
    observed: list[StripCoordinate] = []
    oriented: list[Strip] = []
    for name, models in strips.items():
        strip = join_models(models, name=name)
        enough = sum(p in control for p in strip.points) >= MIN_COMMON_PLACES
        there = control if enough else _approximate(network)
        oriented.append(strip.to_ground(there))
        observed += oriented[-1].observations(sigma=sigma)
    gone = [i for i, o in network.observations.items() if o.photos()]
    out = without(network, gone)
    out.images, out.photos, out.photo_number, out.cameras = ImageTable(), {}, {}, {}
    for strip in oriented:
        out.set_polynomial(strip.name, plan=plan, height=terms)
    out.add(*observed)
    seen = joined_points(out.observations.values())
    return without(out, (), points=[p for p in out.points if p not in seen])


def _is_control(p: Point) -> bool:
    weighted = (False,) * 3 if p.sigma is None else tuple(np.isfinite(p.sigma))
    return all(held or w for held, w in zip(p.fixed, weighted, strict=True))


def _approximate(network: Network) -> dict[str, Array]:
    at = start_values(network)["point"]
    return {n: x for n, x in zip(network.points, at, strict=True) if np.isfinite(x).all()}
