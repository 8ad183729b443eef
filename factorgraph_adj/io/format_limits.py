"""Refusals of what a format cannot express; calibrations, grid points and scalar σ for writers.

`Refusals` collects everything that a format cannot express. `GridPoints` and `scalar_sigmas` give
coordinates in the grid and standard deviations as single numbers, which formats of survey programs
demand.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..crs.grid_places import GridPlaces, grid_places
from ..crs.reference_system import ReferenceSystem
from ..entities import Camera, parameter_name
from ..errors import Problem
from ..frames import LocalFrame
from ..graph.equations import compile_rows
from ..graph.weights import weighed_where_known
from ..models.unknown_registry import parameter_kinds
from ..network.network import Network
from ..observations import Observation
from ..start.approximate_values import partial_approximation
from ..stochastic_model import StandardDeviation
from ..types import Array
from .source import Problems


class Refusals(Problems):
    """What a format cannot express, so that one error lists all of it."""

    def __init__(self, format: str) -> None:
        """Start without problems; ``format``: its name in messages."""
        super().__init__()
        self.format = format

    def refuse(self, what: str, where: str = "") -> None:
        """Add what the format cannot express."""
        self.wrong(f"{self.format} cannot express {what}", where)

    def observations(self, network: Network, kinds: Collection[str], hint: str = "") -> None:
        """Refuse observations of other kinds than some, correlations among them, and unknowns."""
        for ident, o in network.observations.items():
            if o.kind not in kinds:
                what = f"a {o.kind.replace('_', ' ')}"
                self.refuse(f"{what}{'; ' + hint if hint else ''}", o.label() or ident)
        if network.clusters or network.images.joint:
            self.refuse("observations that are correlated with others")
        rays = np.flatnonzero(network.images.correlation).tolist()
        if rays:
            photo, point, *_ = network.images.columns()
            first = f"{list(network.photos)[photo[rays[0]]]}/{list(network.points)[point[rays[0]]]}"
            more = f" and {len(rays) - 1} more" if len(rays) > 1 else ""
            self.refuse("correlated image coordinates", f"image point {first}{more}")

    def points(self, network: Network, *, fixed: bool = False) -> None:
        """Refuse held points, unless ``fixed``, and weighted ones."""
        for name, p in network.points.items():
            if any(p.fixed) and not fixed:
                self.refuse("held coordinates: observe them as a control point", f"point {name!r}")
            if p.sigma is not None:
                self.refuse("a weight on coordinates; use a control point", f"point {name!r}")

    def photos(self, network: Network, *, motions: bool = False) -> None:
        """Refuse held and weighted poses, and motions of photos unless the format has them."""
        if not motions:
            self.motions(network)
        for name, photo in network.photos.items():
            if any(photo.fixed):
                self.refuse("a held pose", f"photo {name!r}")
            if photo.sigma_position is not None or photo.sigma_attitude is not None:
                self.refuse("a weighted pose", f"photo {name!r}")

    def motions(self, network: Network) -> None:
        """Refuse motions of photos during the readout of a rolling shutter."""
        for problem in motions_of_photos(network, self.format):
            self.wrong(problem.what, problem.where)

    def cameras(self, network: Network, *, readouts: bool = False) -> None:
        """Refuse weighted calibrations and those of single photos.

        Args:
            network: the network.
            readouts: whether the format says which sensors have a rolling shutter; otherwise
                readout times are refused, too.
        """
        for name, camera in network.cameras.items():
            where = f"camera {name!r}"
            if camera.readout is not None and not readouts:
                self.refuse("the readout time of a rolling shutter", where)
            if np.isfinite(camera.sigma).any():
                self.refuse("weighted calibration parameters", where)
            if camera.per_photo:
                self.refuse("a calibration for each photo", where)

    def parts(self, network: Network, *, unknowns: Iterable[str] = ("orientation",)) -> None:
        """Refuse photos, cameras, a free datum, and unknowns other than those of some kinds."""
        for what, found in (
            ("photos", network.photos),
            ("cameras", network.cameras),
            ("image points", network.n_image_points),
        ):
            if found:
                self.wrong(f"{self.format} has no {what}", network.name)
        if network.datum == "free":
            self.wrong(
                f"{self.format} has no free datum: hold points, or write a solution", network.name
            )
        for kind, given in network.parameters.items():
            if given and kind not in unknowns:
                names = ", ".join(str(n) for n in list(given)[:3])
                self.wrong(
                    f"{self.format} has no unknowns of the kind {kind}: {names}", network.name
                )

    def sigma(self, o: Observation) -> float:
        """Return the standard deviation of an observation as one number; refuse others."""
        given = getattr(o, "sigma", None)
        if isinstance(given, StandardDeviation):
            alone = StandardDeviation(given.constant or 1.0, combine=given.combine)
            if given != alone:
                self.wrong(f"{self.format} has standard deviations of one part only", o.label())
            return given.constant
        return float(given) if given is not None else float("nan")

    def nothing_of(self, o: Observation, *attributes: str) -> None:
        """Refuse an observation that has a value other than none, zero or 1 in an attribute."""
        for name in attributes:
            value = getattr(o, name, None)
            if value not in (None, 0.0, 1, ""):
                self.wrong(f"{self.format} has no {name} ({value})", o.label())


def motions_of_photos(network: Network, format: str) -> list[Problem]:
    """Return what is wrong with the motions of photos for a format whose photos have one pose."""
    what = (
        f"{format} cannot express the motion of a photo: its image points do not fit one pose; "
        "without its motion (network.of_kind('photo_motion')) the pose of the middle row is written"
    )
    return [
        Problem(what, f"photo {parameter_name(key)!r}")
        for kind in parameter_kinds()
        if kind.in_photo
        for key in network.of_kind(kind.name)
    ]


def common_value(values: Iterable[float]) -> float | None:
    """Return the only value, to 12 digits, of some; None if they differ or there are none."""
    found = np.array(list(values))
    if not len(found) or np.ptp(found) > 1e-12 * np.abs(found).max():
        return None
    return float(found[0])


def calibration_values(camera: Camera) -> dict[str, float]:
    """Return the calibration of a camera by name."""
    return dict(zip(camera.lens.names, camera.values, strict=True))


def pixel_format(camera: Camera) -> tuple[float, float] | None:
    """Return the size of the sensor if image coordinates count pixels from the upper left corner.

    None where they do not, or where the size is unknown.
    """
    if camera.unit != "px" or camera.format is None or camera.origin != "upper left":
        return None
    return camera.format


def numbers_text(values: Array | Iterable[float]) -> str:
    """Return numbers with all digits, separated by blanks."""
    return " ".join(repr(float(v)) for v in np.asarray(values, dtype=float).ravel())


@dataclass(frozen=True, eq=False)
class GridPoints:
    """Points of a network on the Earth in its grid."""

    network: Network
    """The network."""
    system: ReferenceSystem
    """Its reference system."""

    @cached_property
    def coordinates(self) -> dict[str, Array]:
        """Easting, northing, height by point, (3,) metres; NaN of points without coordinates."""
        out = {name: np.full(3, np.nan) for name in self.network.points}
        names = list(self._known)
        if names:
            xyz = np.array(list(self._known.values()))
            found = self.system.from_frame(self.network.frame, xyz, names)
            out |= dict(zip(names, found, strict=True))
        return out

    @cached_property
    def places(self) -> GridPlaces | None:
        """Convergence, undulation and partials of the points with coordinates; None: no such."""
        if not self._known:
            return None
        xyz = np.array(list(self._known.values()))
        return grid_places(self.system, self.network.frame, xyz, names=list(self._known))

    @cached_property
    def rows(self) -> dict[str, int]:
        """Rows of ``places`` by point."""
        return {name: row for row, name in enumerate(self._known)}

    @cached_property
    def _known(self) -> dict[str, Array]:
        every = {n: np.array(p.coordinates, dtype=float) for n, p in self.network.points.items()}
        return {n: xyz for n, xyz in every.items() if np.isfinite(xyz).all()}


def grid_points(network: Network) -> GridPoints | None:
    """Return the points of a network in its grid; None: it has its own coordinates alone.

    That is so of a network in a local frame, and of one without the reference system of a grid.

    Raises:
        InputError: pyproj is missing, or PROJ does not know the system.
    """
    system = network.crs
    if isinstance(network.frame, LocalFrame) or system is None or not system.projected:
        return None
    return GridPoints(network, system)


def scalar_sigmas(network: Network) -> dict[str, float]:
    """Return σ of the first component by id of observation, at the coordinates of the network.

    Coordinates are given or approximate ones that observations determine; σ is NaN where it
    depends on others.
    """
    equations = compile_rows(network)
    state, _ = partial_approximation(equations)
    out: dict[str, float] = {}
    for block in equations.blocks:
        if block.prior or block.lens is not None:
            continue
        found = weighed_where_known(network, block, state)
        out |= dict(zip(found.ids, found.sigma[:, 0].tolist(), strict=True))
    return out
