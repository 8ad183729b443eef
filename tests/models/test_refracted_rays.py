"""Rays through water surfaces, planes and ports against an independent trace by Snell's law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.models.base import DegenerateError
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.positions import heights
from factorgraph_adj.models.refracted_rays import refracted_rays
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.types import Array
from tests.networks.every_kind import (
    FRAMES,
    LENSES_USED,
    MEDIA_STEPS,
    READOUT,
    add_frames,
    add_media,
    flight_equations,
    share_of_radius,
)
from tests.support.differences import assert_partials_are_right

NANOMETRE = 1e-9


def bent(d: Array, normal: Array, ratio: float) -> Array:
    """Return a unit vector behind a surface, n₁ d + γ ν = n₂ d' in vectors; ratio n₁/n₂."""
    cosine = float(normal @ d)
    return np.asarray(
        ratio * d + (np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine) * normal
    )


def traced(d: Array, normal: Array, layers: Array, indices: Array, beyond: float) -> Array:
    """Return the place that a ray d from the origin reaches in the last layer."""
    place, before = np.zeros(3), 1.0
    for thick, n in zip(layers, indices, strict=True):
        place = place + thick / (normal @ d) * d
        d, before = bent(d, normal, before / n), n
    return np.asarray(place + beyond * d)


def unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def drawn(rng: np.random.Generator, grazing: bool) -> tuple[Array, Array]:
    """Return a normal and a ray on its side, one millirad off the surface where it is grazing."""
    normal, d = unit(rng.normal(size=(2, 3)))
    d = d * np.sign(d @ normal)
    return normal, unit(d - (1 - 1e-3) * (d @ normal) * normal) if grazing else d


@pytest.mark.parametrize("grazing", [False, True])
def test_a_ray_leads_where_one_that_is_traced_began(grazing: bool) -> None:
    """Two layers and a medium, from millimetres to kilometres, with indices from 1.0 to 1.9."""
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(300):
        normal, d = drawn(rng, grazing)
        layers, indices = 10 ** rng.uniform(-3, 3, 2), rng.uniform(1.0, 1.9, 2)
        p = traced(d, normal, layers, indices, 10 ** rng.uniform(-3, 3))
        rows.append((p, normal, layers, indices, d))
    p, normal, layers, indices, d = (np.array(x) for x in zip(*rows, strict=True))
    rays = refracted_rays(p, normal, layers, indices)
    np.testing.assert_allclose(unit(rays.q), d, atol=1e-11)
    along = np.einsum("ni,ni->n", rays.q, normal)
    assert (np.abs(along - 1.0) < 1e-15 + 1e-15 * np.linalg.norm(rays.q, axis=1)).all()


def test_a_diver_sees_what_is_above_the_water_up_to_the_critical_angle() -> None:
    down, ratio = np.array([0.0, 0.0, 1.0]), 1.0 / 1.34
    for angle in np.linspace(0.0, 0.9999 * np.arcsin(ratio), 40):
        d = np.array([np.sin(angle), 0.0, np.cos(angle)])
        p = traced(d, down, np.array([2.0]), np.array([ratio]), 50.0)
        rays = refracted_rays(p[None], down[None], np.array([[2.0]]), np.array([[ratio]]))
        np.testing.assert_allclose(unit(rays.q)[0], d, atol=1e-9)


def test_straight_rays_stay_straight_and_vertical_ones_see_three_quarters_of_the_depth() -> None:
    rng = np.random.default_rng(2)
    p, normal = rng.normal((0, 0, 9), size=(20, 3)), np.tile([0.0, 0.0, 1.0], (20, 1))
    layers = np.full((20, 2), 1.5)
    np.testing.assert_allclose(
        unit(refracted_rays(p, normal, layers, np.ones((20, 2))).q), unit(p), atol=1e-15
    )
    near = np.array([[1e-9, 0.0, 5.0]])
    rays = refracted_rays(near, normal[:1], np.array([[2.0]]), np.array([[4.0 / 3.0]]))
    np.testing.assert_allclose(rays.q[0, 0], 1e-9 / (2.0 + 3.0 * 0.75), rtol=1e-12)


@pytest.mark.parametrize("grazing", [False, True])
def test_partials_of_rays_are_those_of_differences(grazing: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(40):
        normal, d = drawn(rng, grazing)
        layers, indices = rng.uniform(0.5, 3.0, 2), rng.uniform(1.1, 1.9, 2)
        p = traced(d, normal, layers, indices, 2.0)
        found = refracted_rays(p[None], normal[None], layers[None], indices[None])
        far = float(np.linalg.norm(found.q[0]))
        across = np.linalg.svd(normal[None])[2][1:]
        steps = np.array([1e-3] * 3 + [1e-3 / far] * 2 + [1e-3] * 4)
        moved = np.concatenate([d * np.diag(steps) for d in (1, -1, 2, -2)])
        one, back, two, far_back = np.split(
            refracted_rays(
                p + moved[:, :3],
                unit(normal + moved[:, 3:5] @ across),
                layers + moved[:, 5:7],
                indices + moved[:, 7:],
            ).q,
            4,
        )
        numerical = ((8 * (one - back) - (two - far_back)) / (12 * steps[:, None])).T
        parts = (found.by_p[0], found.by_normal[0] @ across.T, found.by_layers[0])
        analytic = np.concatenate([*parts, found.by_indices[0]], axis=1)
        assert (np.abs(analytic - numerical) < 2e-6 * np.abs(numerical).max(axis=0)).all()


def test_points_on_the_side_of_the_camera_are_seen_straight() -> None:
    """From both sides of the surface the image is the same there."""
    down, one, index = np.array([[0.0, 0.0, 1.0]]), np.array([[2.0]]), np.array([[1.3]])
    for p in ((1.0, 0.3, 1.9), (1.0, 0.3, -0.1)):
        rays = refracted_rays(np.array([p]), down, one, index)
        np.testing.assert_array_equal(rays.q[0], p)
        np.testing.assert_array_equal(rays.by_p[0], np.eye(3))
        assert rays.straight.all()
        assert not any(by.any() for by in (rays.by_normal, rays.by_layers, rays.by_indices))
    at = refracted_rays(np.array([[1.0, 0.3, 2.0]]), down, one, index)
    np.testing.assert_allclose(at.q[0], (0.5, 0.15, 1.0), rtol=1e-15)


def test_layers_that_cannot_be_are_refused() -> None:
    down, one, p = np.array([[0.0, 0.0, 1.0]]), np.array([[2.0]]), np.array([[1.0, 0.0, 5.0]])
    with pytest.raises(DegenerateError, match="greater than zero"):
        refracted_rays(p, down, one, np.array([[-1.3]]))
    with pytest.raises(DegenerateError, match="lies in the surface"):
        refracted_rays(p, down, 0 * one, np.array([[1.3]]))


@pytest.mark.parametrize("frame", [n for n, (f, _) in FRAMES.items() if not f.left_handed])
def test_a_level_surface_refracts_by_its_own_normal(frame: str) -> None:
    """A ray is traced from the bottom: to the surface, whose normal and place the frame has."""
    of, station = FRAMES[frame]
    enu = of.basis(station[None], np.zeros((1, 2))).enu[0]
    network = fga.Network(frame, frame=of)
    network.add_camera("camera", NoDistortion(), {"c": 100.0})
    level, n = float(heights(of, station[None])[0][0]) + 20.0, 1.34
    bottom = station + enu.T @ [300.0, 200.0, 3.0]
    ray = enu.T @ unit(np.array([-0.4, -0.3, 0.9]))
    length = 10.0
    for _ in range(50):  # where the ray meets the surface
        height, up = heights(of, (bottom + length * ray)[None])
        length += float((level - height[0]) / (up[0] @ ray))
    place = bottom + length * ray
    centre = place + 900.0 * bent(ray, unit(heights(of, place[None])[1][0]), n)
    rotation = enu.T @ world_R_camera(0.3, -0.2, 1.0)
    seen = rotation.T @ (place - centre)
    network.add_photo("f", "camera", position=centre, rotation=rotation)
    network.add_point("bottom", bottom)
    network.set_level("lake", level - 5.0)
    network.set_refractive_index("water", n)
    xy = (100.0 * seen[0] / seen[2], -100.0 * seen[1] / seen[2])
    network.add(
        o.ImageThroughLevel("f", "bottom", xy, sigma=0.01, level="lake", medium="water", geoid=5.0)
    )
    equations = compile_network(network)
    (block,) = (b for b in equations.blocks if b.kind == "image_through_level")
    v = block.evaluate(of, equations.unknowns.start()).residual
    np.testing.assert_allclose(v, 0.0, atol=100.0 / 900.0 * 20 * NANOMETRE)


@pytest.mark.parametrize("frame", [n for n, (f, _) in FRAMES.items() if not f.left_handed])
def test_partials_through_levels_and_ports_are_right_in_every_frame(frame: str) -> None:
    equations, steps = flight_equations(frame)
    equations = only(equations, "image_through")
    assert {b.kind for b in equations.blocks} == {"image_through_level", "image_through_port"}
    assert_partials_are_right(equations, equations.unknowns.start(), steps)


def only(equations: Equations, kind: str) -> Equations:
    """Return equations with the blocks of some kinds."""
    return replace(equations, blocks=tuple(b for b in equations.blocks if b.kind.startswith(kind)))


def tank_equations(lens: str) -> tuple[Equations, Array]:
    """Return points behind planes, one of them levelled at a point, in a camera of some lens."""
    camera = LENSES_USED[lens]
    network = fga.Network(lens, frame=LocalFrame(curvature=True))
    network.add_camera("camera", camera.lens, camera.values, free=camera.lens.names)
    network.add_point("i", (1.0, 2.0, 3.0))
    add_frames(network, (0.5, -1.0, 4.0))
    add_media(network)
    network.add_point("j", (0.9, 4.0, -3.0))
    network.add_point("k", (-1.5, -2.0, -1.0))
    centre = np.array([40.0, -25.0, 60.0])
    network.add_photo("f", "camera", position=centre, rotation=look_at(centre, np.zeros(3)))
    for p, f in (("j", "body"), ("k", "tripod"), ("k", "slanted")):
        network.add(o.ImageThroughPlane("f", p, (0.1, 0.2), sigma=0.01, plane=f, medium="water"))
    network.add(o.ImageThroughPort("f", "j", (0.1, 0.2), sigma=0.01, port="window", medium="water"))
    equations = compile_network(network)
    by_lens = np.abs(
        only(equations, "image_through_port")
        .blocks[0]
        .evaluate(network.frame, equations.unknowns.start())
        .jacobians[1]
    ).max(axis=(0, 1))
    along = share_of_radius(camera.lens) / np.where(by_lens > 0, by_lens, 1.0)
    along[3:] = np.minimum(along[3:], camera.longest)
    by_kind = {
        "point": (0.02,),
        "pose": (3e-4,) * 3 + (0.015,) * 3,
        "frame": (1e-3,) * 3 + (0.01,) * 3 + (1e-3,),
        "vertical": (1e-3,),
        "calibration": tuple(along),
        "model_deformation": (1e-2,),
        "photo_motion": (0.05 / READOUT,) * 3 + (1e-3 / READOUT,) * 3,
        **MEDIA_STEPS,
    }
    return equations, steps_of(equations, by_kind)


def steps_of(equations: Equations, by_kind: dict[str, tuple[float, ...]]) -> Array:
    out = np.zeros(equations.unknowns.n_columns)
    for kind, number in equations.unknowns.active():
        out[equations.unknowns.columns(kind, number)] = by_kind[kind]
    return out


@pytest.mark.parametrize("lens", [n for n, x in LENSES_USED.items() if x.lens.takes != "places"])
def test_partials_through_planes_and_ports_are_right_for_every_lens(lens: str) -> None:
    equations, steps = tank_equations(lens)
    assert_partials_are_right(only(equations, "image_through"), equations.unknowns.start(), steps)


def test_parallel_projections_are_refused() -> None:
    (name,) = (n for n, x in LENSES_USED.items() if x.lens.takes == "places")
    with pytest.raises(fga.InputError, match="no projection centre"):
        tank_equations(name)
