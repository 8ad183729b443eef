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
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np

from ..errors import InputError, known
from ..frames import Frame, LocalFrame
from ..types import Array, Mask
from .base import Linearised, require
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
    """The camera of film that was scanned or measured in a comparator, ideal → measured.

    v = (x0, y0) + T(a) − (x, y), a = c t, with the transformation T of this module. Parameters are
    in image units; coordinates of fiducial marks are in film units, see ``pixel``.
    """

    kind: ClassVar[str] = "film"
    pixel: float = 1.0
    """Length of an image unit on the film, in the unit of coordinates of marks: 0.015 for pixels of
    15 µm and marks in millimetres; 1 where a comparator measures in the unit of the marks."""

    def __post_init__(self) -> None:
        """Check the option."""
        if not self.pixel > 0:
            raise InputError(f"pixel must be a length greater than zero, not {self.pixel}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return NAMES

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`."""
        c = k[:, 0]
        place, by_q, by_k = self.scanned(c * tx, c * ty, k)
        v = place[0] - x, place[1] - y
        if not jacobians:
            return LensPartials(v, (), ())
        (xx, yx), (xy, yy) = by_q
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
