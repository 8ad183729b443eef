"""The camera of scanned or comparator-measured film: interior orientation of each photo.

The film is the ideal image, distorted by the lens and by the film, and laid into a scanner or a
comparator. From the ideal coordinates q, relative to the principal point, follow the measured ones:

    X = (1 + m + b1) q_x + (b2 − r) q_y + h1 q_x q_y
    Y = r q_x + (1 + m) q_y + h2 q_x q_y
    (x, y) = (x0, y0) + (X, Y) / (1 + g1 q_x + g2 q_y)

with the place (x0, y0) of the principal point in the scanner, scale m, rotation r (anticlockwise),
affinity b1 and shear b2, bilinear terms h1, h2 and the vanishing line g1, g2. Which of these are
free makes the transformation conformal, affine, bilinear or projective, see `TRANSFORMATIONS`.
They map the film to the measured coordinates, so that residuals are those of what was measured, in
its units. (FRAMES F15.3.)

Before that, a table of a calibration certificate displaces the ideal coordinates, see
`distortion_table`: q = a + d(a).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np

from ..errors import InputError, Problem, known
from ..frames import Frame, LocalFrame
from ..types import Array, Mask
from .base import Linearised, require
from .distortion_table import DistortionTable
from .lens import Lens, LensPartials, Pair
from .rolling_shutter import Readout

Transformation: TypeAlias = Literal["conformal", "affine", "bilinear", "projective"]
"""Transformations of the plane from the film to a scanner or comparator."""
TRANSFORMATIONS: dict[Transformation, tuple[str, ...]] = {
    "conformal": ("x0", "y0", "m", "r"),
    "affine": ("x0", "y0", "m", "r", "b1", "b2"),
    "bilinear": ("x0", "y0", "m", "r", "b1", "b2", "h1", "h2"),
    "projective": ("x0", "y0", "m", "r", "b1", "b2", "g1", "g2"),
}
"""The parameters that are free in each transformation."""
NAMES = ("c", "x0", "y0", "m", "r", "b1", "b2", "h1", "h2", "g1", "g2")
"""Names of all parameters."""
ITERATIONS = 10
"""Largest number of steps of a start; all transformations but the projective need one."""
START_TOLERANCE = 1e-6
"""Change of places of marks at which the search for a start ends, image units."""
BEYOND_VANISHING_LINE = "it lies on the vanishing line of the projective transformation"


def transformation_parameters(transformation: Transformation) -> tuple[str, ...]:
    """Return the names of the parameters that a transformation of the plane has.

    Raises:
        InputError: an unknown transformation.
    """
    if transformation not in TRANSFORMATIONS:
        valid = known(get_args(Transformation), meant=str(transformation))
        raise InputError(f"unknown transformation {transformation!r}; valid: {valid}")
    return TRANSFORMATIONS[transformation]


@dataclass(frozen=True)
class FilmLens(Lens):
    """Lens model of a camera whose film was scanned or measured in a comparator, ideal → measured.

    v = (x0, y0) + T(a + d(a)) − (x, y), a = c t, with the interior orientation T of this module and
    the distortion d of a table. Parameters are
    in image units; coordinates of fiducial marks are in film units, see ``pixel``.
    """

    kind: ClassVar[str] = "film"
    pixel: float = 1.0
    """Length of an image unit on the film, in the unit of coordinates of marks: 0.015 for pixels of
    15 µm and marks in millimetres; 1 where a comparator measures in the unit of the marks."""

    radii: tuple[float, ...] = ()
    """Measured distances from the principal point, film units, at which a certificate states the
    distortion of the lens; none: it has no table."""
    radial: tuple[tuple[float, ...], ...] = ()
    """Radial distortion at the radii, film units, outwards: a row for all directions, or one for
    each of ``directions``."""
    tangential: tuple[tuple[float, ...], ...] = ()
    """Tangential distortion at the radii, film units, anticlockwise: likewise; none: zero."""
    directions: tuple[float, ...] = ()
    """Directions of the rows of a table, anticlockwise from x, radians, increasing: of the four
    half diagonals π/4, 3π/4 …; none: the table has one row for all of them."""
    between: str = "spline"
    """How the table goes on between its radii: by a natural cubic ``spline``, or ``linear``."""

    def __post_init__(self) -> None:
        """Check the options."""
        problems = []
        if not self.pixel > 0:
            problems.append(f"pixel must be a length greater than zero, not {self.pixel}")
        if self.between not in ("spline", "linear"):
            problems.append(f"between must be spline or linear, not {self.between!r}")
        n, rows = len(self.radii), len(self.directions) or 1
        increasing = np.diff([0.0, *self.radii]) > 0
        if n and not (increasing[1:].all() and self.radii[0] >= 0 and self.radii[-1] > 0):
            problems.append("radii must be distances that increase")
        for name, table in (("radial", self.radial), ("tangential", self.tangential)):
            if {len(row) for row in table} - {n} or (table and len(table) != rows):
                what = f"{rows} row{'s' * (rows > 1)}, one for each direction, of {n} values"
                problems.append(f"{name} must have {what}, one for each of the radii")
            if n and self.radii[0] == 0.0 and any(row[:1] != (0.0,) for row in table):
                problems.append(f"{name} must be zero at the principal point")
        if n and not self.radial and not self.tangential:
            problems.append("radii are those of a table: radial or tangential must be stated")
        if np.any(np.diff(self.directions) <= 0) or np.ptp([0.0, *self.directions]) >= 2 * np.pi:
            problems.append("directions must increase, radians, by less than a full circle")
        if problems:
            raise InputError([Problem(what) for what in problems])

    @classmethod
    def of_angles(
        cls,
        c: float,
        angles: Sequence[float],
        radial: Sequence[Sequence[float]],
        *,
        pixel: float = 1.0,
        tangential: Sequence[Sequence[float]] = (),
        directions: Sequence[float] = (),
        between: str = "spline",
    ) -> FilmLens:
        """Return the lens of a certificate that states distortions by the angle from the axis.

        Args:
            c: principal distance to which the distortions belong, film units.
            angles: angles α of the rays from the axis, radians, increasing.
            radial: radial distortions r − c tan α, film units: a row for all directions, or one for
                each.
            pixel: length of an image unit on the film, film units.
            tangential: tangential distortions, likewise.
            directions: directions of the rows, anticlockwise from x, radians.
            between: how the table goes on between the angles.
        """
        mean = np.mean(np.atleast_2d(np.array(radial, dtype=float)), axis=0) if len(radial) else 0.0
        radii = c * np.tan(np.array(angles, dtype=float)) + mean
        tables = [tuple(tuple(map(float, row)) for row in t) for t in (radial, tangential)]
        at = tuple(radii.tolist())
        return cls(pixel, at, tables[0], tables[1], tuple(map(float, directions)), between)

    def plus(self, radii: Sequence[float], radial: Sequence[float]) -> FilmLens:
        """Return the lens with another radial table on top: of a boundary layer, of refraction.

        Both are taken at the radii of both, this lens's as it goes on between them.

        Args:
            radii: measured distances from the principal point, film units, increasing.
            radial: displacements outwards, film units.
        """
        at = np.union1d(self.radii, radii)
        more = np.interp(at, [0.0, *radii], [0.0, *radial])
        own = np.zeros((len(self.directions) or 1, 2, len(at)))
        if self.table is not None:
            for i in range(len(own)):
                own[i] = self.table.along(np.full(len(at), i), at - self._mean_at(at))[0]
        rows = [tuple(map(tuple, part.tolist())) for part in (own[:, 0] + more, own[:, 1])]
        return replace(
            self,
            radii=tuple(at.tolist()),
            radial=rows[0],
            tangential=rows[1] if self.tangential else (),
        )

    def _mean_at(self, radii: Array) -> Array:
        """Return the mean radial distortion over the directions at measured radii, (n,)."""
        mean = np.mean(self.radial, axis=0) if self.radial else np.zeros(len(self.radii))
        return np.interp(radii, self.radii, mean) if len(self.radii) else np.zeros(len(radii))

    @cached_property
    def table(self) -> DistortionTable | None:
        """The table as a function of ideal places; none: the lens has no distortion.

        A measured radius r is the ideal one ρ and the distortion, mean of all directions: over the
        distortion of one direction it changes by less than 10⁻³ of itself.
        """
        if not self.radii:
            return None
        radii = np.array(self.radii)
        rows, n = len(self.directions) or 1, len(radii)
        values = np.zeros((rows, 2, n))
        for part, table in enumerate((self.radial, self.tangential)):
            if table:
                values[:, part] = table
        directions = np.array(self.directions or (0.0,))
        ideal = radii - self._mean_at(radii)
        return DistortionTable.of(ideal, values, directions, spline=self.between == "spline")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return NAMES

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`."""
        c = k[:, 0]
        qx, qy = c * tx, c * ty
        if self.table is not None:
            dx, dy, d = self.table.displacements(self.pixel * qx, self.pixel * qy)
            qx, qy = qx + dx / self.pixel, qy + dy / self.pixel
        place, by_q, by_k = self.scanned(qx, qy, k)
        v = place[0] - x, place[1] - y
        if not jacobians:
            return LensPartials(v, (), ())
        (xx, yx), (xy, yy) = by_q
        if self.table is not None:
            dxx, dxy, dyx, dyy = d
            xx, xy = xx * (1.0 + dxx) + xy * dyx, xx * dxy + xy * (1.0 + dyy)
            yx, yy = yx * (1.0 + dxx) + yy * dyx, yx * dxy + yy * (1.0 + dyy)
        by_c = xx * tx + xy * ty, yx * tx + yy * ty
        return LensPartials(v, ((c * xx, c * yx), (c * xy, c * yy)), (by_c, *by_k))

    def towards_ideal(self, x: Array, y: Array, k: Array) -> Pair:
        """Return differences of measured coordinates turned back to the film, and to its scale."""
        m, r, b1, b2 = (k[:, j] for j in range(3, 7))
        xx, xy, yx, yy = 1.0 + m + b1, b2 - r, r, 1.0 + m
        i = 1.0 / (xx * yy - xy * yx)
        return (yy * x - xy * y) * i, (xx * y - yx * x) * i

    def scanned(
        self, x: Array, y: Array, k: Array
    ) -> tuple[Pair, tuple[Pair, Pair], tuple[Pair, ...]]:
        """Return the measured place of film coordinates, its partials by these and by x0 ….

        Args:
            x: film coordinates x from the principal point, image units, (n,).
            y: film coordinates y, (n,).
            k: calibration parameters, (n, number of names) or (1, …).

        Raises:
            DegenerateError: a place on the vanishing line.
        """
        x0, y0, m, r, b1, b2, h1, h2, g1, g2 = (k[:, j] for j in range(1, len(NAMES)))
        xy = x * y
        up, vp = (1.0 + m + b1) * x + (b2 - r) * y + h1 * xy, r * x + (1.0 + m) * y + h2 * xy
        below = 1.0 + g1 * x + g2 * y
        require(np.abs(below) > 1e-9, BEYOND_VANISHING_LINE)
        i = 1.0 / below
        u, v = up * i, vp * i
        by_x = (1.0 + m + b1 + h1 * y - g1 * u) * i, (r + h2 * y - g1 * v) * i
        by_y = (b2 - r + h1 * x - g2 * u) * i, (1.0 + m + h2 * x - g2 * v) * i
        zero = np.zeros_like(u)
        xi, yi, both = x * i, y * i, xy * i
        by_k: tuple[Pair, ...] = (
            (zero + 1.0, zero),
            (zero, zero + 1.0),
            (xi, yi),
            (-yi, xi),
            (xi, zero),
            (yi, zero),
            (both, zero),
            (zero, both),
            (-u * xi, -v * xi),
            (-u * yi, -v * yi),
        )
        return (x0 + u, y0 + v), (by_x, by_y), by_k


def fiducial_mark(
    frame: Frame,
    calibration: Array,
    *,
    observed: Array,
    film_x: Array,
    film_y: Array,
    lens: Lens,
    readout: Readout | None = None,
) -> Linearised:
    """Compute the place of marks in a scanner or comparator − observed, image units, (n, 2).

    Args:
        frame: not used.
        calibration: parameters of the lens, (n, k).
        observed: measured coordinates, (n, 2).
        film_x: calibrated coordinate x of the mark from the principal point, film units, (n,).
        film_y: calibrated coordinate y, (n,).
        lens: the lens model; it has to be `FilmLens`.
        readout: not used: film is exposed at one moment.

    Raises:
        InputError: another lens model.
        DegenerateError: a mark on the vanishing line.
    """
    if not isinstance(lens, FilmLens):
        raise InputError(
            "fiducial marks are in photos of a camera with the lens model 'film', whose parameters "
            f"they observe; the model {lens.kind!r} has no interior orientation of each photo"
        )
    at = film_x / lens.pixel, film_y / lens.pixel
    place, _, by_k = lens.scanned(*at, calibration)
    n = len(observed)
    partials = np.zeros((n, 2, len(NAMES)))
    for j, (px, py) in enumerate(by_k, start=1):
        partials[:, 0, j], partials[:, 1, j] = px, py
    return Linearised(np.stack(place, axis=1) - observed, (partials,))


def start_of_interior_orientation(
    lens: FilmLens, values: Array, free: Mask, film: Array, measured: Array
) -> Array:
    """Return parameters (k,) that fit marks, from which an adjustment begins.

    Held parameters keep their values. Where marks do not determine all free ones, these keep what
    is nearest to the given values.

    Args:
        lens: the lens model.
        values: given parameters, (k,).
        free: whether each may change, (k,).
        film: calibrated coordinates of the marks from the principal point, film units, (n, 2).
        measured: measured coordinates, (n, 2).
    """
    k = np.array(values, dtype=float)
    size = float(np.abs(film).max(initial=1.0)) / lens.pixel
    # Each parameter in the unit in which it moves the outer marks by one image unit.
    unit = np.array([1.0, 1.0, 1.0, *([1.0 / size] * 4), *([1.0 / size**2] * 4)])
    for _ in range(ITERATIONS):
        found = fiducial_mark(
            LocalFrame(),
            k[None],
            observed=measured,
            film_x=film[:, 0],
            film_y=film[:, 1],
            lens=lens,
        )
        a = (found.jacobians[0] * unit)[:, :, free].reshape(-1, int(free.sum()))
        step = np.linalg.lstsq(a, found.residual.ravel(), rcond=1e-9)[0] * unit[free]
        k[free] -= step
        if np.abs(step / unit[free]).max(initial=0.0) < START_TOLERANCE:
            break
    return k
