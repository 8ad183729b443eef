"""Shapes as engineers state them: place, axis, tilt, azimuth, sizes and their σ."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.quality.derived_quantities import AdjustedShape, adjusted_shapes
from factorgraph_adj.solve.solution import solution_at
from tests.networks.on_shapes import MM, edges, measured, on_shape, simulated

LINEAR = 1e-3
"""Relative difference of standard deviations that second-order terms may make."""


def only(network: fga.Network) -> tuple[fga.Solution, AdjustedShape]:
    solution = fga.adjust(network)
    (found,) = adjusted_shapes(solution)
    return solution, found


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("shape", SHAPES)
def test_place_axis_and_sizes_give_the_distances_of_the_points(shape) -> None:
    """Each from the text book: with d = X − X₀, h = a·d and ρ = |d − h a|."""
    s, found = only(measured(shape, 2))
    x = s.state["point"]
    d = x - found.place
    axis = np.zeros(3) if shape == "sphere" else found.axis
    h = d @ axis
    rho = np.linalg.norm(d - h[:, None] * axis, axis=1)
    size = {z.attribute: z.value for z in found.sizes}
    r, ring = size.get("radius", 0.0), size.get("ring", 0.0)
    a, focal = size.get("angle", 0.0), size.get("focal", 1.0)
    f = {
        "plane": h,
        "line": rho,
        "circle": np.hypot(h, rho - r),
        "cylinder": rho - r,
        "sphere": np.linalg.norm(d, axis=1) - r,
        "cone": rho * np.cos(a) - h * np.sin(a),
        "torus": np.hypot(rho - ring, h) - r,
        "paraboloid": (h - rho**2 / (4 * focal)) / np.sqrt(1 + (rho / (2 * focal)) ** 2),
    }[shape]
    on = np.array([i.startswith("on") for i in s.observations.ids])
    v = s.observations.residuals[on]
    given = np.concatenate(
        [np.ravel(s.network.observations[f"on {i}"].value) for i in range(len(x))]
    )
    computed = (v + given).reshape(len(x), -1)
    assert np.linalg.norm(computed, axis=1) == pytest.approx(np.abs(f), abs=1e-9)
    assert found.points == len(x)
    assert found.largest == pytest.approx(np.linalg.norm(v.reshape(len(x), -1), axis=1).max())
    assert found.rms == pytest.approx(np.sqrt(np.mean(v**2)))


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("shape", SHAPES)
def test_covariances_are_those_of_steps_of_the_unknowns(shape) -> None:
    """J Σ Jᵀ, with J from adjusted states that are moved a little, and symmetry taken out."""
    s, found = only(measured(shape, 3))
    sigma = s.variable_covariance(("frame", "S"))
    by_place, by_axis = np.zeros((3, 7)), np.zeros((3, 7))
    for component in range(7):
        step = np.zeros((1, 7))
        step[0, component] = 1e-5
        one, other = (
            adjusted_shapes(
                solution_at(
                    s, {**s.state, "frame": UNKNOWNS["frame"].retract(s.state["frame"], way * step)}
                )
            )[0]
            for way in (1, -1)
        )
        by_place[:, component] = (one.place - other.place) / 2e-5
        by_axis[:, component] = (one.axis - other.axis) / 2e-5
    if SHAPES[shape].slides == (0, 1):
        by_place = np.outer(found.axis, found.axis) @ by_place
    elif SHAPES[shape].slides == (2,):
        by_place = (np.eye(3) - np.outer(found.axis, found.axis)) @ by_place
    assert found.covariance == pytest.approx(by_place @ sigma @ by_place.T, rel=LINEAR, abs=1e-13)
    if shape != "sphere":
        expected = by_axis @ sigma @ by_axis.T
        assert found.axis_covariance == pytest.approx(expected, rel=LINEAR, abs=1e-13)
        along = float(np.trace(found.axis_covariance))
        parts = found.sigma_tilt**2 + (np.sin(found.tilt) * found.sigma_azimuth) ** 2
        assert parts == pytest.approx(along, rel=1e-9)


def test_a_plane_is_known_in_the_middle_of_its_points_as_their_mean() -> None:
    """n points, each measured twice: σ² = (σ_form² + σ²/2) / n along the normal, none across."""
    s, found = only(simulated("plane", 4))
    n = len(s.network.points)
    assert found.axis @ found.covariance @ found.axis == pytest.approx(1.5 * MM**2 / n, rel=LINEAR)
    assert np.linalg.matrix_rank(found.covariance, tol=1e-6 * MM**2) == 1


def tilted(tilt: float, azimuth: float, axes: str = "en") -> AdjustedShape:
    """Return a cylinder whose axis rises from the vertical towards an azimuth."""
    e = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    axis = np.cos(tilt) * np.array([0.0, 0.0, 1.0]) + np.sin(tilt) * e
    one = np.cross(axis, [0.3, 0.5, -0.1])
    one /= np.linalg.norm(one)
    two = np.cross(axis, one)
    t = np.linspace(0, 5.5, 12)
    ring = np.cos(t)[:, None] * one + np.sin(t)[:, None] * two
    x = 10.0 + 2.0 * ring + np.linspace(-3, 3, 12)[:, None] * axis
    if axes == "ne":
        x = x[:, [1, 0, 2]]
    network = on_shape("cylinder", x)
    if axes == "ne":
        network.frame = fga.LocalFrame(axes="ne")
    return only(network)[1]


@pytest.mark.parametrize("axes", ["en", "ne"])
def test_tilt_counts_from_the_vertical_and_azimuth_from_north_whatever_the_axes(axes) -> None:
    found = tilted(0.2, 1.1, axes)
    assert found.tilt == pytest.approx(0.2, abs=1e-6)
    assert found.azimuth == pytest.approx(1.1, abs=1e-5)


def test_an_upright_axis_has_no_azimuth_and_a_held_one_no_sigma() -> None:
    x = np.array([[np.cos(t), np.sin(t), t] for t in range(8)])
    network = on_shape("cylinder", x, level=True, free=("x", "y"), origin=(0.0, 0.0, 0.0))
    _, found = only(network)
    assert found.tilt == 0.0
    assert found.sigma_tilt == 0.0
    assert np.isnan(found.azimuth)
    assert found.covariance[2, 2] == pytest.approx(0.0, abs=1e-20)


def test_lines_in_images_are_shapes_without_points_on_them() -> None:
    found = {f.name: f for f in adjusted_shapes(fga.adjust(edges()))}
    assert {f.shape for f in found.values()} == {"line"}
    assert all(f.points == 18 and np.isnan(f.largest) for f in found.values())


def test_a_circle_is_centred_at_the_height_that_its_points_name() -> None:
    """Two targets of a turning instrument: one axis, two radii and two heights."""
    network = fga.Network("axis")
    network.add_shape("A", "circle", origin=(0, 0, 0), free=("rx", "ry", "x", "y"), values={"z": 0})
    del network.sizes["A"]  # each target has a radius of its own
    for name, radius, height in (("low", 1.0, 0.5), ("high", 2.0, 3.0)):
        network.set_size(f"r {name}", radius)
        network.set_size(f"h {name}", height)
        for i in range(6):
            at = (radius * np.cos(i), radius * np.sin(i), height)
            network.add_point(f"{name}{i}", at)
            network.add(
                o.GnssPosition(f"{name}{i}", at, sigma=(MM,) * 3),
                o.OnCircle("A", f"{name}{i}", radius=f"r {name}", height=f"h {name}", sigma=MM),
            )
    low, high = adjusted_shapes(fga.adjust(network))
    assert low.place == pytest.approx([0, 0, 0.5], abs=1e-9)
    assert high.place == pytest.approx([0, 0, 3.0], abs=1e-9)
    assert [z.value for z in high.sizes] == pytest.approx([2.0, 3.0], abs=1e-9)
    # Of n points with σ² + σ² across their plane, the mean along the axis.
    assert high.covariance[2, 2] == pytest.approx(2 * MM**2 / 6, rel=0.05)
