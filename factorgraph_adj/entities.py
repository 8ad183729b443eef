"""Points, cameras, photos, parameters and image tables of a network, with checks of their values.

A `Network` holds these entities by name and checks the names by which they refer to others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from .constructors import ChecksArguments
from .errors import InputError, Problem, similar
from .models.lens import Lens
from .models.rolling_shutter import Readout, Towards
from .models.unknown_registry import UnknownKind
from .types import Array, Index, Mask

REFRACTION_OF_THE_NETWORK = ""
"""Name of the refraction group for observations without a named group."""
_LOWER_LEFT: dict[Origin, tuple[float, float]] = {
    "centre": (-0.5, -0.5),
    "upper left": (0.0, -1.0),
    "lower left": (0.0, 0.0),
}
"""Lower left corner of the sensor for each origin, in widths and heights of the sensor, y up."""


@dataclass(frozen=True)
class Point(metaclass=ChecksArguments):
    """An object point."""

    name: str
    """Name."""
    coordinates: tuple[float, float, float]
    """Given or approximate coordinates, metres; NaN where unknown."""
    fixed: tuple[bool, bool, bool] = (False, False, False)
    """Whether each component is held."""
    sigma: tuple[float, float, float] | None = None
    """Standard deviations of weighted components, metres; infinite for free components."""
    datum: bool = False
    """Whether the point carries the datum of a free network."""
    check: tuple[float, float, float] | None = None
    """Reference coordinates of a check point, metres, for comparison only; NaN where unknown."""
    side_shot: bool = False
    """Whether one sight without a check gives the point, which then bears on no other."""

    @property
    def held(self) -> str:
        """Names of the held components: ``xy``, empty for a free point."""
        return "".join(a for a, fixed in zip("xyz", self.fixed, strict=True) if fixed)


Origin: TypeAlias = Literal["centre", "upper left", "lower left"]
"""Place of the origin of image coordinates on the sensor."""
ORIGINS: tuple[Origin, ...] = get_args(Origin)


@dataclass(frozen=True)
class Camera(metaclass=ChecksArguments):
    """A camera: lens model, calibration values, and which values are estimated."""

    name: str
    """Name."""
    lens: Lens
    """Lens model."""
    values: tuple[float, ...]
    """Calibration parameters in the order of ``lens.names``, image units."""
    fixed: tuple[bool, ...]
    """Whether each parameter is held."""
    sigma: tuple[float, ...]
    """Standard deviations of weighted parameters, image units; infinite for free parameters."""
    unit: str = "mm"
    """Unit of image coordinates, for reports: mm, px …"""
    per_photo: bool = False
    """Whether every photo has a calibration of its own."""
    format: tuple[float, float] | None = None
    """Width and height of the sensor, image units; None where unknown."""
    origin: Origin = "centre"
    """Place of the origin of image coordinates on the sensor; y points up in any case."""
    y_down_in_files: bool = False
    """Whether y of image coordinates, and y0, point down in files and reports; values in memory
    have y up."""
    readout: float | None = None
    """Readout time of the whole sensor by a rolling shutter, seconds; None: all rows are exposed at
    the same time. It needs ``format``."""
    readout_towards: Towards = "down"
    """Side of the image to which the readout proceeds."""

    def times(self) -> Readout | None:
        """Return the times at which the rows are read; None without a rolling shutter."""
        corners = self.corners()
        if self.readout is None or corners is None:
            return None
        return Readout.of(self.readout, self.readout_towards, *corners)

    def corners(self) -> tuple[Array, Array] | None:
        """Return lower left and upper right corner of the sensor, image units; None if unknown.

        With the origin at the upper left corner, y is 0 at the upper edge and −height at the
        lower edge: files with ``y_axis = "down"`` have the opposite sign.
        """
        if self.format is None:
            return None
        low = np.multiply(_LOWER_LEFT[self.origin], self.format)
        return low, low + self.format

    def sign_in_files(self, parameter: str) -> float:
        """Return the factor from a value in memory to files and reports: −1 for y0 with y down."""
        return -1.0 if self.y_down_in_files and parameter == "y0" else 1.0


@dataclass(frozen=True)
class Photo(metaclass=ChecksArguments):
    """A photo: its camera and its exterior orientation."""

    name: str
    """Name."""
    camera: str
    """Name of its camera."""
    position: tuple[float, float, float] | None = None
    """Approximate, weighted or fixed projection centre, metres."""
    rotation: Array | None = None
    """world_R_camera (3, 3), axes of the camera x right, y down, z forward."""
    fixed: tuple[bool, ...] = (False,) * 6
    """Six flags of held components: three rotations (all or none), X, Y, Z of the centre."""
    sigma_position: tuple[float, float, float] | None = None
    """Standard deviations of a weighted projection centre, metres."""
    sigma_attitude: float | None = None
    """Standard deviation of a weighted attitude about each axis, radians."""


@dataclass(frozen=True)
class Parameter(metaclass=ChecksArguments):
    """An unknown besides points, photos and cameras, such as a coefficient of refraction."""

    values: tuple[float, ...]
    """Start or given values of the components, SI; NaN where unknown."""
    fixed: tuple[bool, ...]
    """Whether each component is held."""
    sigma: tuple[float, ...]
    """Standard deviations of weighted components, SI; infinite for free components."""
    constants: tuple[float, ...] = ()
    """Constants of the kind, see `UnknownKind.constants`."""
    origin: str = ""
    """Name of the point at which the unknown has its origin; empty: none."""


class JointImagePoints(NamedTuple):
    """Image points with one joint covariance."""

    rows: Index
    """Their rows in the table of image points, (n,)."""
    covariance: Array
    """Covariance of x and y of each of them, in this order, (2n, 2n) image units²."""

    def kept(self, new: Index) -> JointImagePoints | None:
        """Return those that stay, with new numbers of rows (all rows,), −1 for those that go."""
        rows = new[self.rows]
        stays = np.flatnonzero(rows >= 0)
        if not len(stays):
            return None
        both = (2 * stays[:, None] + np.arange(2)).ravel()
        return JointImagePoints(rows[stays], self.covariance[np.ix_(both, both)])


@dataclass
class ImageTable:
    """Image coordinates in columns, because networks have many of them."""

    photo: list[Index] = field(default_factory=list)
    """Number of the photo of each row, (n,)."""
    point: list[Index] = field(default_factory=list)
    """Number of the point of each row, (n,)."""
    xy: list[Array] = field(default_factory=list)
    """Measured coordinates (n, 2)."""
    sigma: list[Array] = field(default_factory=list)
    """Standard deviations (n, 2)."""
    rho: list[Array] = field(default_factory=list)
    """Correlations of x and y, (n,); none where all are zero."""
    joint: list[JointImagePoints] = field(default_factory=list)
    """Groups with joint covariances, which take the place of their standard deviations."""
    ids: dict[int, str] = field(default_factory=dict)
    """Ids that differ from photo/point, by row."""
    sources: dict[int, str] = field(default_factory=dict)
    """Sources by row."""
    size: int = 0
    """Number of rows."""

    @classmethod
    def of(
        cls, points: Sequence[Any], photo: Mapping[str, int], point: Mapping[str, int]
    ) -> ImageTable:
        """Return the table of some image points.

        Args:
            points: the image points, n `ImagePoint`.
            photo: numbers of the photos, by name.
            point: numbers of the points, by name.
        """
        out = cls()
        out.append(
            np.array([photo[o.photo] for o in points], dtype=np.intp),
            np.array([point[o.point] for o in points], dtype=np.intp),
            np.array([(o.x, o.y) for o in points], dtype=float),
            np.array([np.broadcast_to(np.asarray(o.sigma, dtype=float), 2) for o in points]),
            np.array([o.correlation for o in points]),
        )
        out.ids = {i: o.id for i, o in enumerate(points) if o.id is not None}
        out.sources = {i: o.source for i, o in enumerate(points) if o.source is not None}
        return out

    def copy(self) -> ImageTable:
        """Return an independent table; both share the arrays of rows, which never change."""
        return replace(
            self,
            photo=list(self.photo),
            point=list(self.point),
            xy=list(self.xy),
            sigma=list(self.sigma),
            rho=list(self.rho),
            joint=list(self.joint),
            ids=dict(self.ids),
            sources=dict(self.sources),
        )

    def kept(self, keep: Mask) -> ImageTable:
        """Return a table of the rows with ``keep`` (n,) true."""
        new = np.where(keep, np.cumsum(keep) - 1, -1)
        out = ImageTable()
        photo, point, xy, sigma = self.columns()
        out.append(photo[keep], point[keep], xy[keep], sigma[keep], self.correlation[keep])
        out.ids = {int(new[r]): v for r, v in self.ids.items() if keep[r]}
        out.sources = {int(new[r]): v for r, v in self.sources.items() if keep[r]}
        out.joint = [left for group in self.joint if (left := group.kept(new))]
        return out

    def with_columns(
        self,
        *,
        photo: Index | None = None,
        point: Index | None = None,
        xy: Array | None = None,
        sigma: Array | None = None,
    ) -> ImageTable:
        """Return a table of as many rows with some other columns, and everything else the same."""
        columns = dict(zip(("photo", "point", "xy", "sigma"), self.columns(), strict=True))
        given = {"photo": photo, "point": point, "xy": xy, "sigma": sigma}
        columns |= {name: column for name, column in given.items() if column is not None}
        assert all(len(column) == self.size for column in columns.values())
        out = self.copy()
        for name, column in columns.items():
            setattr(out, name, [column])
        return out

    def append(
        self,
        photo: Index,
        point: Index,
        xy: Array,
        sigma: Array,
        correlation: Array | None = None,
    ) -> None:
        """Add rows; ``correlation`` (n,) of x and y, None: they are not correlated."""
        if correlation is not None and correlation.any() and not self.rho:
            self.rho = [np.zeros(self.size)]
        if self.rho:
            self.rho.append(np.zeros(len(photo)) if correlation is None else correlation)
        self.photo.append(photo)
        self.point.append(point)
        self.xy.append(xy)
        self.sigma.append(sigma)
        self.size += len(photo)

    def take_over(
        self, other: ImageTable, photos: Index | None = None, points: Index | None = None
    ) -> None:
        """Add the rows of another table with everything that they have; both stay independent.

        Args:
            other: the other table.
            photos: numbers here of the photos there, (number of photos,); None: they are the same.
            points: numbers here of the points there, (number of points,); None: likewise.
        """
        n, (photo, point, xy, sigma) = self.size, other.columns()
        photo = photo if photos is None else photos[photo]
        point = point if points is None else points[point]
        self.append(photo, point, xy, sigma, other.correlation)
        self.joint += [JointImagePoints(n + rows, q) for rows, q in other.joint]
        self.ids |= {n + row: ident for row, ident in other.ids.items()}
        self.sources |= {n + row: source for row, source in other.sources.items()}

    def join(self, group: JointImagePoints) -> None:
        """Give some of the rows a joint covariance; σ and correlation of each become those in it.

        Raises:
            InputError: a row has a joint covariance already.
        """
        if self.is_joint[group.rows].any():
            raise InputError("an image point cannot be in two groups with joint covariances")
        sigma, rho = self.columns()[3].copy(), self.correlation.copy()
        sigma[group.rows] = np.sqrt(np.diag(group.covariance)).reshape(-1, 2)
        rho[group.rows] = np.diag(group.covariance, 1)[::2] / sigma[group.rows].prod(axis=1)
        self.sigma = [sigma]
        self.rho = [rho] if rho.any() else []
        self.joint.append(group)

    @property
    def is_joint(self) -> Mask:
        """Whether rows have a joint covariance with others, (n,)."""
        out = np.zeros(self.size, dtype=bool)
        for rows, _ in self.joint:
            out[rows] = True
        return out

    @property
    def correlation(self) -> Array:
        """Correlations ρ = σ_xy / (σ_x σ_y) of the coordinates, (n,)."""
        if len(self.rho) > 1:
            self.rho = [np.concatenate(self.rho)]
        return self.rho[0] if self.rho else np.broadcast_to(0.0, self.size)

    def columns(self) -> tuple[Index, Index, Array, Array]:
        """Return photo (n,), point (n,), coordinates (n, 2) and sigma (n, 2)."""
        if not self.photo:
            none = np.zeros(0, dtype=np.intp)
            return none, none, np.zeros((0, 2)), np.zeros((0, 2))
        if len(self.photo) > 1:
            self.photo = [np.concatenate(self.photo)]
            self.point = [np.concatenate(self.point)]
            self.xy = [np.concatenate(self.xy)]
            self.sigma = [np.concatenate(self.sigma)]
        return self.photo[0], self.point[0], self.xy[0], self.sigma[0]


def triple(value: Any, what: str, where: str) -> tuple[float, float, float]:
    """Return three floats; NaN allowed for unknown components."""
    try:
        out = tuple(float(v) for v in value)
    except (TypeError, ValueError):
        raise InputError(Problem(f"{what} must be three numbers, not {value!r}", where)) from None
    if len(out) != 3:
        raise InputError(Problem(f"{what} must be three numbers, not {len(out)}", where))
    if any(np.isinf(v) for v in out):
        raise InputError(Problem(f"{what} must be finite, not {out}", where))
    return out


def sigmas(value: Any, size: int, where: str) -> tuple[float, ...]:
    """Return ``size`` standard deviations > 0; infinity means no weight."""
    if value is None:
        return (np.inf,) * size
    try:
        given = np.asarray(value if np.ndim(value) else [value] * size, dtype=float)
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.shape != (size,) or np.any(np.isnan(given)) or np.any(given <= 0):
        raise InputError(
            Problem(f"standard deviations must be {size} numbers > 0, not {value!r}", where)
        )
    return tuple(given.tolist())


Key: TypeAlias = str | tuple[str, ...]
"""Key of an unknown in a network: one name, or several names such as station and set."""


def parameter_name(key: Key) -> str:
    """Return the key of an unknown as one name; several names are joined by ``/``."""
    return key if isinstance(key, str) else "/".join(key)


def parameter_key(kind: UnknownKind, attribute: str, observation: object) -> Key:
    """Return the key by which an observation refers to a parameter.

    The name is empty if the observation names no parameter. Further names of the key, such as
    the station of a set of directions, are the attributes of the observation with these names.
    """
    name: str = getattr(observation, attribute) or ""
    if kind.table is None or len(kind.table.keys) == 1:
        return name
    return (*(getattr(observation, key) for key in kind.table.keys[:-1]), name)


def parameter(
    kind: UnknownKind,
    values: Sequence[float],
    fixed: bool | Iterable[str],
    sigma: float | Sequence[float] | Mapping[str, float] | None,
    where: str,
) -> Parameter:
    """Return a checked unknown of a kind, with free, weighted and held components.

    Args:
        kind: record of the kind.
        values: values of the components, SI.
        fixed: whether all components are held, or the names of the held components.
        sigma: standard deviations of weighted components: one for all, one for each (infinite:
            no weight), or some by name.
        where: name of the unknown in messages.
    """
    given = tuple(float(v) for v in values)
    size = len(given)
    if not (size == kind.size or (kind.variable_size and 0 < size < kind.size)):
        raise InputError(
            Problem(f"it needs {kind.size} values ({', '.join(kind.names())}), not {size}", where)
        )
    found = kind.absent != "found"  # whether a value that is not given is found by the adjustment
    open_start = [found and bool(np.isnan(c.start)) for c in kind.components[:size]]
    if any(np.isinf(v) or (np.isnan(v) and not o) for v, o in zip(given, open_start, strict=True)):
        raise InputError(Problem(f"values must be finite, not {given}", where))
    if fixed is True and sigma is not None:
        raise InputError(Problem("either fixed or sigma, not both", where))
    names = kind.names(size)
    if isinstance(sigma, Mapping):
        _refuse_unknown(sigma, names, "sigma", where)
        weights = sigmas([sigma.get(n, np.inf) for n in names], size, where)
    else:
        weights = sigmas(sigma, size, where)
    if isinstance(fixed, bool):
        held = (fixed,) * size
    else:
        chosen = set(fixed)
        _refuse_unknown(chosen, names, "fixed", where)
        held = tuple(n in chosen for n in names)
    both = [n for n, h, s in zip(names, held, weights, strict=True) if h and np.isfinite(s)]
    if both:
        raise InputError(Problem(f"{', '.join(both)}: either fixed or sigma, not both", where))
    if kind.single_turns:
        turns = tuple(bool(np.isfinite(s)) for s in weights[:3])
        if any(turns) and turns not in ((True,) * 3, (True, True, False)):
            what = "weight rx and ry, the tilts, or all three rotations: they do not commute"
            raise InputError(Problem(what, where))
    elif kind.rotates:
        for what, flags in (("hold", held), ("weight", [bool(np.isfinite(s)) for s in weights])):
            if any(flags[:3]) != all(flags[:3]):
                raise InputError(
                    Problem(f"{what} all three rotations or none: they do not commute", where)
                )
    return Parameter(given, held, weights)


def _refuse_unknown(given: Iterable[str], names: Sequence[str], what: str, where: str) -> None:
    wrong = sorted(set(given) - set(names))
    if wrong:
        raise InputError(
            Problem(
                f"{what} must name some of {', '.join(names)}, not {', '.join(wrong)}"
                f"{similar(wrong[0], names)}",
                where,
            )
        )


FREE_ORIENTATION = Parameter((np.nan,), (False,), (np.inf,))
"""Free orientation unknown, whose start value is computed from the directions."""
