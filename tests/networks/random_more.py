"""Kinds of observations that some of the networks drawn by chance have besides: `random_small`.

Photo flights, odometry, instruments in frames of their own, shapes, relations, offsets and
alignment. Each is in a small share of the networks and draws from a generator of its own, so that
the other draws of a seed stay what they are. New points hang on a given one by GNSS vectors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from factorgraph_adj import Network
from factorgraph_adj import observations as o
from factorgraph_adj.entities import JointImagePoints
from factorgraph_adj.models.film_lens import TRANSFORMATIONS, FilmLens
from factorgraph_adj.models.positions import heights
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.rotation import exp_rotation, log_rotation
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.networks.on_shapes import ANGLE, FOCAL, ON, RADIUS, RING, places

MM = 1e-3
SHARE = 0.08
"""Share of the networks with each of the families."""
SHARE_OF_PHOTOS = 0.2
"""Share of the networks of photos with each of the families that need photos."""
ZERO = (0.0, 0.0, 0.0)
SIZES = {"angle": ANGLE, "focal": FOCAL, "ring": RING, "radius": RADIUS}
"""True sizes of shapes, metres and radians."""


@dataclass
class More:
    """What is added to one network."""

    network: Network
    axes: Array
    """East, north, up, (3, 3)."""
    middle: Array
    """Middle of the site, (3,)."""
    rng: np.random.Generator

    def points(self, n: int) -> list[str]:
        """Return the names of some points."""
        names = list(self.network.points)
        return [str(x) for x in self.rng.permutation(names)[:n]]

    def values(self, names: str, sigma: float) -> dict[str, float]:
        """Return drawn values of components."""
        parts = names.split()
        return dict(zip(parts, self.rng.normal(0.0, sigma, len(parts)).tolist(), strict=True))

    def origin(self) -> tuple[float, ...]:
        """Return a constant origin of a frame on the site."""
        at = self.middle + self.axes.T @ self.rng.uniform(-15.0, 15.0, 3)
        return tuple(np.round(at).tolist())

    def new_points(self, name: str, at: Array) -> list[str]:
        """Add points (n, 3), each with a GNSS vector from a point that is there."""
        (begin,) = self.points(1)
        names = [f"{name}{i}" for i in range(len(at))]
        for new, x in zip(names, at, strict=True):
            self.network.add_point(new, x)
            self.network.add(o.GnssVector(begin, new, ZERO, sigma=(3 * MM,) * 3))
        return names


def add_more(network: Network, axes: Array, middle: Array, seed: int) -> None:
    """Add what chance says to a network with its true values."""
    for number, add in enumerate(FAMILIES):
        rng = np.random.default_rng([seed, 2026, number])
        share = OTHER_SHARES.get(add, SHARE_OF_PHOTOS if add in OF_PHOTOS else SHARE)
        if network.datum == "free" and add in ON_SITE:
            continue
        if rng.random() < share and (network.photos or add not in OF_PHOTOS):
            add(More(network, axes, middle, rng))


def without_sense(item: o.AnyObservation) -> o.AnyObservation:
    """Return a condition of shapes with the value zero: any other depends on the sense of axes."""
    if isinstance(item, (o.ParallelAxes, *ON.values())):
        zero = (0.0, 0.0) if isinstance(item.value, tuple) else 0.0
        return replace(item, value=zero)  # type: ignore[arg-type]
    return item


def _flight(m: More) -> None:
    """Observe photos by GNSS and INS on a mount, with drifts, ranges and bases."""
    n, photos = m.network, list(m.network.photos)
    few = m.rng.random() < 0.5
    # A camera that looks ahead: its body is upright.
    values = m.values("ry rz x y z", 0.05) | {"rx": -np.pi / 2 + 0.02}
    weights = {"x": 0.02, "y": 0.02, "z": 0.02}
    n.set_mount("imu", free=("rx", "ry", "rz") if few else (), values=values, sigma=weights)
    n.set_drift("flown", sigma={"x": 0.05, "z_t": 0.02}, values=m.values("x z_t", 0.02))
    n.set_attitude_drift("flown", sigma={"rz": 1e-3}, values=m.values("rz", 1e-3))
    n.set_shutter("shutter", error=0.01, sigma=0.01)
    degrees = (2e-4,) * 3
    drifting: dict[str, Any] = {"mount": "imu", "drift": "flown"}
    for i, f in enumerate(photos):
        kind = (o.PhotoAttitude, o.NavigationAttitude)[i % 2]
        n.add(
            kind(f, ZERO, sigma=degrees, about="body", time=float(i), **drifting),
            o.PhotoAngle(f, 0.0, angle="heading", sigma=1e-3, mount="imu"),
            o.AntennaVector(f, ZERO, lever_arm=(2.0, 0.3, 0.1), sigma=(5 * MM,) * 3),
            o.PhotoRange(m.points(1)[0], f, 1.0, sigma=0.02, mount="imu", instrument="edm"),
            o.PhotoPosition(
                f,
                ZERO,
                sigma=(0.03,) * 3,
                time=float(i),
                shutter="shutter",
                velocity=(5.0, 1.0, 0.0),
                **drifting,
            ),
        )
        if few and m.rng.random() < 0.5:
            n.add(kind(f, ZERO, sigma=degrees, about="body", mount="imu"))
    for a, b in pairwise(photos):
        n.add(o.PhotoBase(a, b, 1.0, sigma=0.02, mount="imu"))


def _odometry(m: More) -> None:
    """Join photos by their relative poses."""
    photos = list(m.network.photos)
    for a, b in pairwise(photos):
        m.network.add(o.RelativeRotation(a, b, ZERO, sigma=(2e-4,) * 3))
        scaled = "edm" if m.rng.random() < 0.5 else None
        m.network.add(o.RelativePosition(a, b, ZERO, sigma=(0.02,) * 3, instrument=scaled))


def _instrument(m: More) -> None:
    """Sight points with an instrument in a frame of its own, level or not."""
    n = m.network
    seen = m.points(int(m.rng.integers(3, 8)))
    level = bool(m.rng.random() < 0.5)
    values = m.values("x y z", 0.3) | {"rz": float(m.rng.uniform(-3.0, 3.0))}
    values |= {} if level else m.values("rx ry", 0.1)
    n.add_frame("tracker", free=list(values), values=values, origin=m.origin(), level=level)
    for p in seen:
        n.add(
            o.FrameDirection("tracker", p, 0.0, sigma=5 * ARCSEC),
            o.FrameZenith("tracker", p, 1.5, sigma=5 * ARCSEC),
            o.FrameDistance("tracker", p, 1.0, sigma=1 * MM),
        )


def _shape(
    m: More, name: str, shape: str, n: int, tilts: tuple[float, float] | None = None
) -> Array:
    """Add a shape, and points on it; return the zero place of its frame."""
    sort = SHAPES[shape]
    values = dict.fromkeys(sort.free, 0.0)
    values |= {c: float(m.rng.normal(0.0, 0.4)) for c in sort.free}
    values |= {} if tilts is None else dict(zip(("rx", "ry"), tilts, strict=True))
    rotation = exp_rotation(np.array([[values.get(c, 0.0) for c in ("rx", "ry", "rz")]]))[0]
    offset = [values.get(c, 0.0) for c in "xyz"]
    at = m.origin()
    for size in (s for s in sort.sizes if s.suffix is not None):
        true = SIZES[size.attribute]
        m.network.set_unknown(size.kind, f"{name}{size.suffix}", (true,))
    m.network.add_shape(name, shape, origin=at, values=values)
    points = m.new_points(f"{name} ", at + (places(shape, n, m.rng) + offset) @ rotation.T)
    for p in points:
        m.network.add(ON[shape](name, p, sigma=(2 * MM,) * 2 if shape in TWO else 2 * MM))
    return np.asarray(at + rotation @ offset)


TWO = ("line", "circle")
"""Shapes that give two distances."""


def _shapes(m: More) -> None:
    """Add two shapes of any sort; through as many points as it has unknowns there are several."""
    for number, shape in enumerate(m.rng.permutation(list(SHAPES))[:2].tolist()):
        least = len(SHAPES[shape].free) + len(SHAPES[shape].sizes)
        _shape(m, f"form {number}", shape, least + int(m.rng.integers(3, 6)))


def _walls(m: More) -> None:
    """Add two parallel planes and a cylinder with relations, none of which has a sense."""
    rx, ry = m.rng.normal(0.0, 0.2, 2).tolist()
    first = _shape(m, "wall", "plane", int(m.rng.integers(4, 8)), (rx, ry))
    second = _shape(m, "wall 2", "plane", int(m.rng.integers(4, 8)), (rx, ry))
    _shape(m, "pipe", "cylinder", int(m.rng.integers(9, 12)))
    normal = exp_rotation(np.array([[rx, ry, 0.0]]))[0][:, 2]
    # A distance that is negative has the sense of the first normal.
    walls = ("wall", "wall 2") if normal @ (second - first) > 0 else ("wall 2", "wall")
    m.network.add(
        o.ParallelAxes(*walls, sigma=1e-3),
        o.AxisAngle("wall", "pipe", 1.0, sigma=1e-3),
        o.PlaneDistance(*walls, 1.0, sigma=3 * MM),
    )


def _relations(m: More) -> None:
    """Relate points of the network."""
    n = m.network
    a, b, c, *more = m.points(4)
    d = more[0] if more else a
    step = np.subtract(n.points[b].coordinates, n.points[a].coordinates)
    n.add(
        o.EqualDistance(a, b, c, d, 0.1, sigma=2 * MM),
        o.EqualHeightDifference(a, b, c, d, 0.1, sigma=2 * MM),
        o.RightAngle(a, b, c, sigma=1e-4),
        o.PointDirection(a, b, *step.tolist(), sigma=1e-4),
        o.CoordinateDifference(a, c, (0.0, 0.0), axes="xz", sigma=2 * MM),
        o.CoordinateDifference(b, c, ZERO, horizon=True, sigma=2 * MM),
    )


def _offsets(m: More) -> None:
    """Read offsets from a plane, a plumb line, lines and sights."""
    n = m.network
    for name, free in (("scaffold", "rz x"), ("plummet", "x y")):
        values = m.values(free, 0.3)
        n.add_frame(name, free=list(values), values=values, origin=m.origin(), level=True)
    seen = m.points(int(m.rng.integers(3, 7)))
    for p in seen:
        n.add(
            o.PlaneOffset("scaffold", p, 0.0, sigma=2 * MM),
            o.PlumbOffset("plummet", p, 1.0, sigma=2 * MM),
        )
    a, b, c = seen[:3]
    turn = float(m.rng.uniform(0.0, 6.0))
    x, y, z = n.points[a].coordinates
    if (a, "1") not in n.orientations:
        n.set_orientation(a, value=0.3)
        n.add(*(o.Direction(a, p, 0.0, sigma=5 * ARCSEC) for p in (b, c)))
    for p in (a, b):
        if p not in n.of_kind("heading"):
            n.set_unknown("heading", p, (turn,))
    n.add(
        o.PlanarVector(a, b, (0.0, 0.0), sigma=(5 * MM, 5 * MM)),
        o.PlanarVector(a, c, (0.0, 0.0), covariance=np.array([[3e-5, 1e-5], [1e-5, 2e-5]])),
        o.HeadingDifference(a, b, 0.0, sigma=20 * ARCSEC),
        o.LineOffset(a, b, c, 1.0, sigma=2 * MM),
        o.SightPlaneOffset(a, b, 0.0, horizontal=turn, sigma=2 * MM),
        o.SightOffset(a, c, 1.0, horizontal=turn, zenith=1.4, sigma=2 * MM),
        o.RadialOffset(
            a, 0.0, bearing=turn, reference_x=x, reference_y=y, reference_z=z, sigma=5 * MM
        ),
    )


def _alignment(m: More) -> None:
    """Stretch a wire past sensors, join them by water; a body carries some of them."""
    n, length = m.network, 30.0
    wire: dict[str, Any] = {"sag": "sag", "length": length, "sigma": (0.2 * MM,) * 2}
    at = np.array(m.origin())
    along = np.linspace(2.0, 28.0, int(m.rng.integers(3, 7)))
    beside = m.rng.normal(0.0, 0.02, (len(along), 3))
    sensors = m.new_points("sensor ", at + (beside + np.outer(along, [0, 1.0, 0])) @ m.axes)
    values = m.values("rz rx", 1e-3) | m.values("x z", 0.02) | {"ry": 0.0}
    n.add_frame("wire", free=list(values), values=values, origin=at.tolist(), level=True)
    n.set_size("sag", 0.01)
    n.set_level("tube", float(n.points[sensors[0]].coordinates[2]))
    values = m.values("rx ry rz", 1e-2) | m.values("x y z", 0.02)
    n.add_frame("girder", free=list(values), values=values, origin=at.tolist(), level=True)
    for p in sensors:
        n.add(
            o.WireReading("wire", p, (0.0, 0.0), **wire),
            o.HydrostaticReading(p, "tube", 0.1, sigma=0.1 * MM),
            o.FrameCoordinate("girder", p, ZERO, sigma=(1 * MM,) * 3),
        )
    a, *_, b = sensors
    n.add(
        o.WireReadingOnBody("wire", a, (0.0, 0.0), body="girder", **wire),
        o.FrameRoll("wire", a, 0.0, sigma=1e-4),  # a roll of the wire has no effect
        o.FrameInclination("girder", a, 0.0, sigma=1e-5),
        o.FrameRoll("girder", b, 0.0, sigma=1e-5),
        o.UnitVector("girder", a, b, (0.0, 0.0), sigma=(1e-4, 1e-4)),
    )


def _edges(m: More) -> None:
    """Measure the image of a straight edge in photos."""
    n, photos = m.network, list(m.network.photos)
    _shape(m, "edge", "line", 3)
    ends = [n.points[f"edge {i}"].coordinates for i in (0, 1)]
    camera = n.cameras[n.photos[photos[0]].camera]
    c, x0, y0 = camera.values[:3]
    for f in photos:
        photo = n.photos[f]
        assert photo.rotation is not None
        assert photo.position is not None
        for end in ends:
            p = photo.rotation.T @ np.subtract(end, photo.position)
            at = (c * p[0] / p[2] + x0, -c * p[1] / p[2] + y0)
            n.add(o.ImageLine(f, "edge", *map(float, at), sigma=0.004))


def _media(m: More) -> None:
    """See points through a port, and half-way a level surface and a pane across the sights."""
    n, photos = m.network, list(m.network.photos)
    n.set_refractive_index("water", 1.34, sigma=None if m.rng.random() < 0.3 else 1e-3)
    n.set_port("port", distance=0.05, thickness=0.01, sigma={"distance": 1 * MM, "slope_x": 1e-3})
    placed = np.mean([f.position for f in n.photos.values() if f.position is not None], axis=0)
    away = placed - m.middle
    half = m.middle + 0.5 * away
    n.set_level("surface", float(heights(n.frame, half[None])[0][0]), fixed=True)
    axis = away / np.linalg.norm(away)
    across = np.linalg.svd(axis[None])[2][1:]
    turn = np.stack([across[0], np.cross(axis, across[0]), axis], axis=1)
    values = dict(zip(("rx", "ry", "rz"), log_rotation(turn[None])[0].tolist(), strict=True))
    n.add_frame("pane", free=(), values=values, origin=half.tolist())
    for p in m.points(3):
        for f in photos:
            seen = {"sigma": 0.004, "medium": "water"}
            n.add(
                o.ImageThroughPort(f, p, (0.0, 0.0), port="port", **seen),
                o.ImageThroughLevel(f, p, (0.0, 0.0), level="surface", **seen),
                o.ImageThroughPlane(f, p, (0.0, 0.0), plane="pane", **seen),
            )


def _own_datum(m: More) -> None:
    """Measure vectors between points in a datum that is turned, and may have a scale."""
    turned = ["rx", "ry", "rz", *(["ln_scale"] if m.rng.random() < 0.5 else [])]
    m.network.add_frame("gnss", free=turned, values=m.values(" ".join(turned), 1e-4))
    names = m.points(4)
    for a, b in pairwise([*names, names[0]]):
        m.network.add(o.FrameVector("gnss", a, b, ZERO, sigma=(3 * MM,) * 3))


def _scan(m: More) -> None:
    """Add a photo on film, with its fiducial marks, beside another one."""
    n = m.network
    beside = next(iter(n.photos.values()))
    assert beside.position is not None
    camera = n.cameras[beside.camera]
    c = camera.values[0]
    transformation = ("conformal", "affine", "projective")[int(m.rng.integers(3))]
    values = {"c": c, "x0": 300.0, "y0": -200.0, "m": -0.1, "r": 0.4}
    free = TRANSFORMATIONS[transformation]  # type: ignore[index]
    n.add_camera("film", FilmLens(pixel=0.1), values, free=free, per_photo=True)
    at = np.add(beside.position, m.axes.T @ [0.4, 0.3, 0.2])
    n.add_photo("scan", "film", position=at, rotation=beside.rotation)
    photo, point, *_ = n.images.columns()
    own = [list(n.points)[j] for j in point[photo == n.photo_number[beside.name]]]
    for name in own:
        n.add(o.ImagePoint("scan", name, 0.0, 0.0, sigma=0.004))
    for i, (x, y) in enumerate(MARKS):
        film = {"film_x": 0.05 * c * x, "film_y": 0.05 * c * y}
        n.add(o.FiducialMark("scan", f"mark {i}", (0.0, 0.0), sigma=(0.004,) * 2, **film))


MARKS = ((1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0), (0, 1), (-1, 0), (0, -1))
"""Places of fiducial marks in the corners and in the middle of the sides."""


def _joint_images(m: More) -> None:
    """Give the image points of a photo errors that are correlated with one another."""
    images = m.network.images
    photo = images.columns()[0]
    seen = np.unique(photo)
    if not len(seen):
        return
    rows = np.flatnonzero(photo == m.rng.choice(seen))
    sigma = images.columns()[3][rows].ravel()
    rho = 0.4 + 0.6 * np.eye(len(sigma))
    images.join(JointImagePoints(rows, rho * np.outer(sigma, sigma)))


OF_PHOTOS: tuple[Callable[[More], None], ...] = (
    _flight,
    _odometry,
    _edges,
    _scan,
    _media,
    _joint_images,
)
"""Those that need photos."""
ON_SITE: tuple[Callable[[More], None], ...] = (_flight, _offsets, _alignment, _edges, _media)
"""Those with constant places, or that say little of photos that nothing else holds: they are in
networks with a given datum."""
OTHER_SHARES: dict[Callable[[More], None], float] = {_shapes: 0.15, _media: 0.1}
"""Shares of the networks with families of many kinds, and of those with water: a port is weakly
determined by few points, so that test values of a day depend on where an engine linearises."""
FAMILIES: tuple[Callable[[More], None], ...] = (
    _flight,
    _odometry,
    _instrument,
    _shapes,
    _walls,
    _relations,
    _offsets,
    _alignment,
    _edges,
    _own_datum,
    _scan,
    _media,
    _joint_images,
)
"""What may be added."""
