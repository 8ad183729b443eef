"""Points on shapes, measured twice each; a room of planes; edges in photos."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.types import Array

MM = 1e-3
RADIUS, RING, ANGLE, FOCAL = 2.0, 5.0, 0.4, 1.5
"""Sizes of the shapes, metres and radians."""
ON = {
    cls.shape_name: cls
    for cls in (
        o.OnPlane,
        o.OnLine,
        o.OnCircle,
        o.OnCylinder,
        o.OnSphere,
        o.OnCone,
        o.OnTorus,
        o.OnParaboloid,
    )
}
"""Classes of observations by shape."""
MIDDLE = np.array([1200.0, 340.0, 85.0])


def places(shape: str, n: int, rng: np.random.Generator, *, arc: float = 2 * np.pi) -> Array:
    """Return places q (n, 3) on a shape in its frame, on an arc about its axis."""
    turn, along = rng.uniform(0, arc, n), rng.uniform(-3, 3, n)
    c, s, zero = np.cos(turn), np.sin(turn), np.zeros(n)
    if shape == "torus":
        tube = rng.uniform(0, 2 * np.pi, n)
        out = RING + RADIUS * np.cos(tube)
        return np.column_stack([out * c, out * s, RADIUS * np.sin(tube)])
    if shape == "sphere":
        z = rng.uniform(-0.9, 0.9, n)
        flat = np.sqrt(1 - z**2)
        return RADIUS * np.column_stack([flat * c, flat * s, z])
    if shape == "plane":
        return np.column_stack([rng.uniform(-4, 4, (n, 2)), zero])
    rho, z = {
        "line": (zero, along),
        "circle": (zero + RADIUS, zero),
        "cylinder": (zero + RADIUS, along),
        "cone": (np.tan(ANGLE) * (along + 4), along + 4),
        "paraboloid": (np.abs(along) + 0.2, (np.abs(along) + 0.2) ** 2 / (4 * FOCAL)),
    }[shape]
    return np.column_stack([rho * c, rho * s, z])


def posed(q: Array, rng: np.random.Generator) -> Array:
    """Return places X (n, 3) of places q in a frame that lies anywhere."""
    rotation = exp_rotation(rng.uniform(-2, 2, (1, 3)))[0]
    return np.asarray(MIDDLE + (q + rng.uniform(-2, 2, 3)) @ rotation.T)


def on_shape(
    shape: str, x: Array, *, sigma: float = MM, twice: bool = True, **options: object
) -> fga.Network:
    """Return points measured by GNSS, and the shape on which they lie, without its values.

    Args:
        shape: name of the shape.
        x: coordinates of the points, (n, 3).
        sigma: standard deviation of coordinates and of the form, metres.
        twice: whether each point is measured twice.
        options: further arguments of `add_shape`.
    """
    network = fga.Network(shape)
    network.add_shape("S", shape, **{"origin": x.mean(axis=0).round().tolist(), **options})
    for i, at in enumerate(x):
        network.add_point(f"P{i}", at)
        for k in range(1 + twice):
            name = f"P{i}/{k}"
            network.add(o.GnssPosition(f"P{i}", tuple(at), sigma=(sigma,) * 3, id=name))
        network.add(ON[shape]("S", f"P{i}", sigma=sigma, id=f"on {i}"))
    return network


def simulated(shape: str, seed: int, *, n: int = 14, arc: float = 2 * np.pi) -> fga.Network:
    """Return points on a shape, with measurements; the shape has no values."""
    rng = np.random.default_rng([seed, list(SHAPES).index(shape)])
    return on_shape(shape, posed(places(shape, n, rng, arc=arc), rng))


def plan(shape: str, seed: int = 1, *, n: int = 14) -> fga.Network:
    """Return a plan of points on a shape, with true values of everything."""
    return fga.adjust(simulated(shape, seed, n=n)).as_network()


def without_shapes(network: fga.Network) -> fga.Network:
    """Return a network without the values of shapes and their sizes."""
    out = network.copy()
    for kind in ("frame", "size", "angle"):
        for key, p in network.of_kind(kind).items():
            found = [v if h else np.nan for v, h in zip(p.values, p.fixed, strict=True)]
            out.of_kind(kind)[key] = fga.observations.Parameter(
                tuple(found), p.fixed, p.sigma, **_constants(p)
            )
    return out


def _constants(p: fga.observations.Parameter) -> dict[str, object]:
    return {"constants": p.constants, "origin": p.origin}


def measured(shape: str, seed: int) -> fga.Network:
    """Return a plan measured with errors, without values of its shape."""
    return without_shapes(measure(plan(shape), seed=seed))


# -- a room ---------------------------------------------------------------------------------------

SIDES = np.array([8.0, 6.0, 3.0])
PLANES = {"floor": (2, 0), "ceiling": (2, 1), "west": (0, 0), "south": (1, 0)}
"""Planes of the room: their axis, and their side of it."""


def room(seed: int = 5) -> fga.Network:
    """Return the corners of a box, its planes, and relations of both; true values of everything."""
    rng = np.random.default_rng(seed)
    rotation = exp_rotation(np.array([[0.02, -0.03, 0.7]]))[0]
    network = fga.Network("room")
    corners = {f"{a}{b}{c}": np.array([a, b, c]) for a in (0, 1) for b in (0, 1) for c in (0, 1)}
    inside = {f"M{i}": rng.uniform(0, 1, 3) for i in range(6)}
    for name, (axis, side) in PLANES.items():
        for i in range(3):
            inside[f"{name}{i}"] = np.where(np.arange(3) == axis, side, rng.uniform(0, 1, 3))
    for name, at in (corners | inside).items():
        network.add_point(name, MIDDLE + rotation @ (at * SIDES))
        network.add(o.GnssPosition(name, (0.0, 0.0, 0.0), sigma=(2 * MM,) * 3))
    for name, (axis, side) in PLANES.items():
        middle = np.where(np.arange(3) == axis, side, 0.5) * SIDES
        network.add_shape(name, "plane", origin=(MIDDLE + rotation @ middle).tolist())
        for point, at in (corners | inside).items():
            if at[axis] == side:
                network.add(o.OnPlane(name, point, sigma=2 * MM))
    network.add(
        o.ParallelAxes("floor", "ceiling", sigma=3e-4),
        o.AxisAngle("floor", "west", sigma=3e-4),
        o.AxisAngle("west", "south", sigma=3e-4),
        o.PlaneDistance("floor", "ceiling", SIDES[2], sigma=2 * MM),
        o.EqualDistance("000", "100", "010", "110", sigma=2 * MM),
        o.EqualDistance("000", "100", "000", "010", sigma=2 * MM, ratio=8 / 6),
        o.EqualHeightDifference("000", "001", "110", "111", sigma=2 * MM),
        o.EqualHeightDifference("000", "M0", "M0", "M1", sigma=2 * MM),
        o.RightAngle("000", "100", "001", sigma=3e-4),
        o.PointDirection("000", "001", *(rotation @ [0.0, 0.0, 2.0]).tolist(), sigma=3e-4),
        o.CoordinateDifference("000", "M1", (0.0, 0.0), axes="xz", sigma=2 * MM),
        o.CoordinateDifference("111", "M1", (0.0, 0.0, 0.0), sigma=2 * MM),
        o.CoordinateDifference("M2", "M3", (0.0, 0.0, 0.0), horizon=True, sigma=2 * MM),
    )
    return fga.adjust(measure(_with_truth(network), seed=0, noise=False)).as_network()


def _with_truth(network: fga.Network) -> fga.Network:
    """Return the network with values of its shapes that their points determine."""
    bare = network.copy()
    bare.observations = {
        i: x for i, x in network.observations.items() if isinstance(x, o.GnssPosition | o.OnPlane)
    }
    for i, x in bare.observations.items():
        if isinstance(x, o.GnssPosition):
            at = tuple(network.points[x.point].coordinates)
            bare.observations[i] = o.GnssPosition(x.point, at, sigma=x.sigma, id=x.id)
    found = fga.adjust(bare).as_network()
    found.observations = network.observations
    return found


# -- edges in photos ------------------------------------------------------------------------------

STATIONS = ((-6.0, -12.0, 3.0), (0.0, -13.0, 6.0), (7.0, -11.0, 2.0))
EDGES = {
    "post": ((-3.0, 1.0, 0.0), (-2.8, 1.1, 4.0)),
    "eave": ((-3.0, 0.5, 4.0), (3.0, -0.5, 4.5)),
}
FOCAL_MM, K1, SIGMA_MM = 50.0, 2e-5, 0.005


def edges(*, stations: int = 3, parallel: bool = False) -> fga.Network:
    """Return photos of edges of a building, without values of the edges.

    Args:
        stations: number of photos.
        parallel: whether an edge is parallel to the base of the first two photos.
    """
    network = fga.Network("edges")
    network.add_camera("camera", BrownLens(), {"c": FOCAL_MM, "k1": K1})
    ends = dict(EDGES)
    if parallel:
        a, b = (np.array(s) for s in STATIONS[:2])
        ends = {"gutter": ((0.0, 0.0, 2.0), tuple(np.array([0.0, 0.0, 2.0]) + 0.5 * (b - a)))}
    for i, at in enumerate(STATIONS[:stations]):
        rotation = look_at(np.array(at), np.array([0.0, 0.0, 2.0]))
        network.add_photo(
            str(i),
            "camera",
            position=at,
            rotation=rotation,
            sigma_position=2 * MM,
            sigma_attitude=1e-4,
        )
    for name, (a, b) in ends.items():
        network.add_shape(name, "line", origin=tuple(0.5 * (np.array(a) + b)))
        for i, at in enumerate(STATIONS[:stations]):
            for share in np.linspace(0.05 * i, 0.7 + 0.1 * i, 6):
                p = (np.array(a) + share * (np.array(b) - a) - at) @ network.photos[str(i)].rotation
                ideal = FOCAL_MM * np.array([p[0], -p[1]]) / p[2]
                x = ideal
                for _ in range(60):
                    x = ideal - K1 * (x @ x) * x
                network.add(o.ImageLine(str(i), name, *x.tolist(), sigma=SIGMA_MM))
    return network
