"""Image refinement: corrections of measured coordinates for refraction and curvature of the Earth.

Each ray is turned in its vertical plane, whatever the tilt of its photo: by the refraction of the
air between camera and ground (`image_refraction`), then from space to a map plane, where the frame
of the network is one. The image coordinates of the turned ray are the refined ones. Corrections
are kept for each image point and each cause, with their sum. (FRAMES F15.1, F15.2.)

They depend on heights and tilts of photos and on heights of points, of which approximate values are
enough: at 2000 m a height that is wrong by 10 m changes a correction by half a percent. The
correction is a function of what was measured, and its uncertainty that of the model of the air.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, Problem, taking
from ..frames import LocalFrame
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_rows
from ..graph.variables import State
from ..models.grid_lens import y_is_time
from ..models.image_refraction import Atmosphere, RefractionModel, in_map_plane, ray_refraction
from ..models.inverse_lens import directions
from ..models.lens import Lens
from ..network.network import Network
from ..observations.refracted_images import THROUGH_INTERFACE
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..start.approximate_values import approximate
from ..types import Array, Mask

REFRACTION, CURVATURE = "refraction", "curvature"
"""Causes of corrections."""
STEPS = 50
"""Largest number of steps from a ray to its image coordinates."""
STEP_TOLERANCE = 1e-9
"""Change of image coordinates at which these steps end, part of the principal distance."""


@dataclass(frozen=True, repr=False, eq=False)
class RefinedImages(Shown):
    """A network with refined image coordinates, and the corrections."""

    network: Network
    """The network: refined − measured coordinates are the sum of the corrections."""
    photo: tuple[str, ...]
    """Photo of each image point, in the order of the image table, (n,)."""
    point: tuple[str, ...]
    """Its point."""
    corrections: Mapping[str, Array]
    """Corrections in x and y by cause, ``refraction`` and ``curvature``, image units, (n, 2) each;
    to be added to measured coordinates."""

    @property
    def sum(self) -> Array:
        """Sum of the corrections, image units, (n, 2)."""
        return np.asarray(sum(self.corrections.values(), np.zeros((len(self.photo), 2))))

    def of_photo(self, name: str) -> dict[str, Array]:
        """Return the corrections of the image points of one photo by cause, and their ``sum``."""
        rows = np.array([p == name for p in self.photo], dtype=bool)
        return {what: c[rows] for what, c in {**self.corrections, "sum": self.sum}.items()}

    def headline(self) -> str:
        """Return the causes, and the largest sum."""
        most = np.linalg.norm(self.sum, axis=1).max(initial=0.0)
        causes = " and ".join(self.corrections)
        return f"RefinedImages: {len(self.photo)} image points, {causes}; sum up to {most:.4g}"

    def first_rows(self) -> Rows:
        """Return the root mean square and the largest correction of each photo, by cause."""
        causes = (*self.corrections, "sum")
        header = ("photo", "points", *(f"{c} {what}" for c in causes for what in ("rms", "most")))

        def row(name: str) -> tuple[object, ...]:
            own = [np.linalg.norm(c, axis=1) for c in self.of_photo(name).values()]
            each = [(float(np.sqrt(np.mean(c**2))), float(c.max())) for c in own]
            return (name, len(own[0]), *(v for pair in each for v in pair))

        photos = dict.fromkeys(self.photo)
        return Rows(header, map(row, photos), len(photos))


@taking(Network)
def refine_images(
    network: Network,
    *,
    refraction: RefractionModel | None = "integral",
    curvature: bool = False,
    atmosphere: Atmosphere | None = None,
    solution: Solution | None = None,
    geoid: float = 0.0,
) -> RefinedImages:
    """Correct measured image coordinates for refraction and curvature of the Earth; run it once.

    A network does not know that its images are refined: a second run would correct them again.

    Args:
        network: the network, with image coordinates as they were measured; it is not changed.
        refraction: model of refraction, see `image_refraction`; None: no correction.
        curvature: whether the frame is a map plane, or another plane in which heights count from
            the curved Earth, and the images are to be corrected for it.
        atmosphere: pressure and temperature for the models ``integral`` and ``traced``; None: ICAO.
        solution: poses and points, from an adjustment of the same photos and points; None: given
            and approximate values of the network.
        geoid: height of the geoid above the ellipsoid, metres, to be taken from heights of
            geocentric and topocentric frames for heights above sea level.

    Image points are refined. Observations `FiducialMark` need no refinement, as their rays end in
    the camera; measured points of lines, `ImageLine`, stay as they were measured.

    Raises:
        InputError: no correction is asked for, the frame needs no curvature, a lens has no rays
            from one centre or a time as y (``line``), image points are seen through an interface
            already (`Network.refract_images`), a point is not below its camera, a turned ray has no
            image, or ``solution`` lacks a photo or a point; image points are named.
    """
    if refraction is None and not curvature:
        raise InputError("nothing to correct: state a model of refraction, or curvature")
    if curvature:
        _refuse_curved(network)
    _refuse_what_has_no_refined_images(network)
    equations = compile_rows(network)
    state = approximate(equations) if solution is None else _carried(equations, solution)
    photo, point, xy, _ = network.images.columns()
    causes = [c for c, asked in ((REFRACTION, refraction), (CURVATURE, curvature)) if asked]
    corrections = {cause: np.zeros_like(xy) for cause in causes}
    row_of = {f"{f}/{p}": i for i, (f, p) in enumerate(zip(photo, point, strict=True))}
    problems: list[Problem] = []
    for block in equations.blocks:
        if block.lens is None or not block.n:
            continue
        (_, photos), _, (_, points), *_ = block.variables
        rows = np.array([row_of[f"{f}/{p}"] for f, p in zip(photos, points, strict=True)])
        rays = _Rays.of(network, block, state, geoid)
        if too_low := rays.problems(block):
            problems += too_low
            continue
        angle = rays.angle
        if refraction is not None:
            angle = angle - ray_refraction(
                angle, rays.camera, rays.ground, model=refraction, atmosphere=atmosphere
            )
            refracted, lost = rays.image(angle, block)
            problems += lost
            corrections[REFRACTION][rows] = refracted - block.observed
        if curvature:
            before, lost = rays.image(angle, block)
            radius = network.frame.radius
            angle = in_map_plane(angle, rays.camera, rays.ground, radius)
            after, also_lost = rays.image(angle, block)
            problems += lost or also_lost
            corrections[CURVATURE][rows] = after - before
    if problems:
        raise InputError(problems)
    out = network.copy()
    refined = xy + sum(corrections.values())
    out.images = network.images.with_columns(xy=refined)
    names, ends = list(network.photos), list(network.points)
    return RefinedImages(
        out,
        tuple(names[f] for f in photo),
        tuple(ends[p] for p in point),
        corrections,
    )


def _refuse_curved(network: Network) -> None:
    """Refuse a correction for curvature in a frame in which the Earth is curved."""
    frame = network.frame
    if not isinstance(frame, LocalFrame):
        kind = "geocentric" if "Geocentric" in type(frame).__name__ else "topocentric"
        why = f"the frame is {kind}: its axes are straight, and the curvature is in the coordinates"
    elif frame.curvature:
        why = "the frame has the curvature of the Earth, as its coordinates are in space"
    else:
        return
    raise InputError(
        f"{why}, so that a correction of images for it would count it twice; it is for map planes "
        "in a flat local frame"
    )


def _refuse_what_has_no_refined_images(network: Network) -> None:
    """Refuse lenses without rays of measured coordinates, and images through an interface."""
    problems = []
    cameras = [f.camera for f in network.photos.values()]
    for name in dict.fromkeys(cameras[i] for i in np.unique(network.images.columns()[0]).tolist()):
        lens = network.cameras[name].lens
        if lens.takes == "places":
            why = f"the lens model {lens.kind!r} has no rays from one centre"
        elif y_is_time(lens):
            why = (
                f"y of the lens {lens.kind!r} is the time of a line of the image, which a "
                "correction would change, and not the ray: its images cannot be refined"
            )
        else:
            continue
        problems.append(Problem(why, f"camera {name!r}"))
    for o in network.observations.values():
        if o.record.quantity == THROUGH_INTERFACE:
            why = (
                "it is seen through an interface already: refine the image points first, and "
                "take them as seen through the interface (refract_images) then"
            )
            problems.append(Problem(why, o.label()))
    if problems:
        raise InputError(problems)


def _carried(equations: Equations, solution: Solution) -> State:
    """Return the state of a solution for the unknowns of a network, by name."""
    given = equations.unknowns.start()
    wanted: dict[str, Mask] = {kind: np.ones(v.shape, dtype=bool) for kind, v in given.items()}
    state = equations.unknowns.carried(
        given, solution.equations.unknowns, solution.state, where=wanted
    )
    problems = [
        Problem("the solution has no value of it", f"{noun} {equations.unknowns[kind].names[i]!r}")
        for kind, noun in (("pose", "photo"), ("point", "point"))
        for i in np.flatnonzero(np.isnan(state[kind]).any(axis=1)).tolist()
    ]
    if problems:
        raise InputError(problems)
    return state


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays of the image points of a block as they arrive, and the heights of their ends."""

    lens: Lens
    calibration: Array
    """Parameters of the lens, (n, k)."""
    observed: Array
    """Measured coordinates, (n, 2)."""
    up: Array
    """Unit vectors to the zenith at the cameras, camera axes, (n, 3)."""
    ahead: Array
    """Horizontal unit vectors in the vertical planes of the rays, camera axes, (n, 3)."""
    angle: Array
    """Nadir angles, radians, (n,)."""
    camera: Array
    """Heights of the cameras, metres, (n,)."""
    ground: Array
    """Heights of the points, metres, (n,)."""

    @classmethod
    def of(cls, network: Network, block: Block, state: State, geoid: float) -> _Rays:
        """Return the rays of a block."""
        assert block.lens is not None
        (_, photos), (_, cameras), (_, points), *_ = block.variables
        k = state["calibration"][cameras, : len(block.lens.names)]
        pose = state["pose"][photos]
        ray = directions(block.lens, block.observed, k)
        basis = network.frame.basis(pose[:, 9:], np.zeros((block.n, 2)))
        up = np.einsum("nji,nj->ni", pose[:, :9].reshape(-1, 3, 3), basis.enu[:, 2])
        cosine = -np.einsum("ni,ni->n", ray, up)
        level = ray + cosine[:, None] * up
        sine = np.linalg.norm(level, axis=1)
        ahead = level / np.maximum(sine, 1e-300)[:, None]
        heights = [_heights(network, at, geoid) for at in (pose[:, 9:], state["point"][points])]
        angle = np.arctan2(sine, cosine)
        return cls(block.lens, k, block.observed, up, ahead, angle, heights[0], heights[1])

    def problems(self, block: Block) -> list[Problem]:
        """Return the image points whose rays do not go down to a point below their camera."""
        wrong = np.flatnonzero((self.ground >= self.camera) | (self.angle >= 0.5 * np.pi))
        what = "refraction from the air and curvature are of rays down to points below the camera"
        return [
            Problem(
                f"{what}: nadir angle {np.degrees(self.angle[i]):.1f}°, point at "
                f"{self.ground[i]:.1f} m, camera at {self.camera[i]:.1f} m",
                block.labels(int(i)),
            )
            for i in wrong.tolist()
        ]

    def image(self, angle: Array, block: Block) -> tuple[Array, list[Problem]]:
        """Return the image coordinates (n, 2) of the rays with other nadir angles (n,).

        v vanishes at the coordinates of a ray, and changes by −1 with them, nearly so for lens
        models from measured to ideal coordinates. Image points for which it does not vanish are
        named.
        """
        ray = np.sin(angle)[:, None] * self.ahead - np.cos(angle)[:, None] * self.up
        p = ray[:, 0], ray[:, 1], ray[:, 2]
        xy, limit = self.observed, STEP_TOLERANCE * self.calibration[:, 0]
        going = np.ones(len(xy), dtype=bool)
        for _ in range(STEPS):
            with np.errstate(over="ignore", invalid="ignore"):  # of steps that lead away
                v = self.lens.seen(p, xy[:, 0], xy[:, 1], self.calibration, jacobians=False).v
            step = np.stack(v, axis=1)
            xy = xy + step
            going = ~(np.abs(step).max(axis=1) < limit)
            if not going.any():
                break
        what = "the corrected ray has no image that its lens model and parameters give"
        return xy, [Problem(what, block.labels(i)) for i in np.flatnonzero(going).tolist()]


def _heights(network: Network, at: Array, geoid: float) -> Array:
    """Return heights above sea level, metres, of places (n, 3)."""
    found = network.frame.geodetic(at)
    return at[:, 2] if found is None else found[2] - geoid
