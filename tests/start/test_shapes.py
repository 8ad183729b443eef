"""Start values of shapes from their points, and what is told where points do not determine them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.validate.network_structure import check
from tests.networks.on_shapes import (
    ANGLE,
    FOCAL,
    MM,
    RADIUS,
    RING,
    edges,
    on_shape,
    places,
    posed,
    simulated,
)

SIZES = {"size": RADIUS, "angle": ANGLE}
OTHER_SIZES = {("paraboloid", "S"): FOCAL, ("torus", "S ring"): RING}
QUARTER = np.pi / 2


def sizes(solution: fga.Solution, shape: str) -> list[tuple[float, float, float]]:
    """Return values, standard deviations and true values of the sizes of a shape."""
    found = []
    for size in SHAPES[shape].sizes:
        if size.suffix is None:
            continue
        name = f"S{size.suffix}"
        e = solution.unknown(size.kind, name)
        true = OTHER_SIZES.get((shape, name), SIZES[size.kind])
        found.append((float(e.values[0]), float(e.sigmas[0]), true))
    return found


@pytest.mark.slow(
    "values of many random networks are compared with an independent search; short tests "
    "take single ones"
)
@pytest.mark.parametrize("arc", [2 * np.pi, QUARTER])
@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_anywhere_are_found_from_their_points_on_full_and_quarter_arcs(shape, arc):
    for seed in range(3):
        rng = np.random.default_rng([seed, 17])
        x = posed(places(shape, 24, rng, arc=arc), rng)
        moved = x + MM * rng.normal(size=x.shape)
        solution = fga.adjust(on_shape(shape, moved, twice=False))
        assert solution.converged
        assert solution.sigma0 < 1.5
        for value, sigma, true in sizes(solution, shape):
            assert abs(value - true) < 4.5 * sigma + 1e-12


@pytest.mark.parametrize("shape", SHAPES)
def test_points_on_a_shape_leave_no_residual(shape):
    """The sizes of points without errors, to the digits of their coordinates."""
    rng = np.random.default_rng(3)
    solution = fga.adjust(on_shape(shape, posed(places(shape, 16, rng), rng)))
    assert solution.sigma0 < 1e-5
    for value, _, true in sizes(solution, shape):
        assert value == pytest.approx(true, abs=1e-8)


# -- an independent adjustment --------------------------------------------------------------------


def dense(shape: str, x: np.ndarray) -> float:
    """Return the least sum of squares of corrections of points and distances from a shape.

    With σ of coordinates and of the form equal, a point at the distance d from the shape has the
    corrections d/2 and d/2: the sum is that of d²/2. Axis and place are parameters without
    symmetry here: a direction of two angles, and a place of three coordinates.
    """
    middle = x.mean(axis=0)
    rng = np.random.default_rng(1)

    def distances(p: np.ndarray) -> np.ndarray:
        axis = np.array([np.cos(p[0]) * np.sin(p[1]), np.sin(p[0]) * np.sin(p[1]), np.cos(p[1])])
        d = x - middle - p[2:5]
        along = d @ axis
        rho = np.linalg.norm(d - np.outer(along, axis), axis=1)
        return {
            "plane": lambda: along,
            "line": lambda: rho,
            "circle": lambda: np.hypot(along, rho - p[5]),
            "cylinder": lambda: rho - p[5],
            "sphere": lambda: np.linalg.norm(d, axis=1) - p[5],
            "cone": lambda: rho * np.cos(p[5]) - along * np.sin(p[5]),
            "torus": lambda: np.hypot(rho - p[6], along) - p[5],
        }[shape]()

    best = np.inf
    for _ in range(20):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        first = [np.arctan2(axis[1], axis[0]), np.arccos(axis[2])]
        start = [*first, *(4 * rng.normal(size=3)), 0.6 if shape == "cone" else 2.0, 5.0]
        found = least_squares(distances, start, xtol=1e-12, ftol=1e-12, gtol=1e-12)
        best = min(best, 2 * found.cost)
    return best / 2 / MM**2


@pytest.mark.slow(
    "values of many random networks are compared with an independent search; short tests "
    "take single ones"
)
@pytest.mark.parametrize("shape", sorted(SHAPES.keys() - {"paraboloid"}))
def test_the_sum_of_squares_is_that_of_an_independent_adjustment(shape):
    """By scipy, with another parametrisation, from twenty start values drawn by chance."""
    rng = np.random.default_rng(11)
    x = posed(places(shape, 14, rng), rng) + MM * rng.normal(size=(14, 3))
    solution = fga.adjust(on_shape(shape, x, twice=False))
    assert solution.vtpv == pytest.approx(dense(shape, x), rel=1e-4)


# -- closed forms ---------------------------------------------------------------------------------


def test_a_plane_is_that_of_the_least_singular_value():
    """Eberly: the plane through the middle, across the direction of the least extent."""
    rng = np.random.default_rng(5)
    x = posed(places("plane", 20, rng), rng) + MM * rng.normal(size=(20, 3))
    solution = fga.adjust(on_shape("plane", x, twice=False))
    _, values, vt = np.linalg.svd(x - x.mean(axis=0))
    axis = solution.state["frame"][0, 2:9:3]
    assert abs(axis @ vt[2]) == pytest.approx(1.0, abs=1e-12)
    assert solution.vtpv == pytest.approx(values[2] ** 2 / 2 / MM**2, rel=1e-6)


def test_a_line_is_that_of_the_largest_singular_value():
    rng = np.random.default_rng(6)
    x = posed(places("line", 20, rng), rng) + MM * rng.normal(size=(20, 3))
    solution = fga.adjust(on_shape("line", x, twice=False))
    _, values, vt = np.linalg.svd(x - x.mean(axis=0))
    assert abs(solution.state["frame"][0, 2:9:3] @ vt[0]) == pytest.approx(1.0, abs=1e-12)
    assert solution.vtpv == pytest.approx((values[1:] ** 2).sum() / 2 / MM**2, rel=1e-6)


def test_a_sphere_through_four_points_is_the_circumscribed_one():
    x = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]])
    solution = fga.adjust(on_shape("sphere", x, origin=(0.0, 0.0, 0.0)))
    frame = solution.unknown("frame", "S").values
    np.testing.assert_allclose(frame[3:6], [1.0, 2.0, 2.0], atol=1e-9)
    assert solution.unknown("size", "S").values[0] == pytest.approx(3.0, abs=1e-9)


# -- held components ------------------------------------------------------------------------------


def test_an_upright_cylinder_keeps_its_axis():
    rng = np.random.default_rng(2)
    x = places("cylinder", 12, rng) @ exp_rotation(np.array([[0.01, 0.0, 0.0]]))[0].T + 5.0
    options = {"level": True, "free": ("x", "y")}
    solution = fga.adjust(on_shape("cylinder", x, **options))
    assert solution.state["frame"][0, 2:9:3].tolist() == [0.0, 0.0, 1.0]
    assert solution.sigma0 > 3.0  # its points are on a cylinder that is not upright
    assert fga.adjust(on_shape("cylinder", x)).sigma0 < 1e-3


@pytest.mark.parametrize("shape", ["plane", "cylinder"])
def test_of_an_axis_and_its_opposite_the_one_that_points_up_is_found(shape):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        x = places(shape, 12, rng) + MM * rng.normal(size=(12, 3))
        solution = fga.adjust(on_shape(shape, x, twice=False))
        assert solution.state["frame"][0, 8] > 0.9


def test_a_horizontal_plane_has_one_unknown():
    rng = np.random.default_rng(2)
    x = np.column_stack([rng.uniform(-9, 9, (8, 2)), np.full(8, 112.0)])
    x[:, 2] += MM * rng.normal(size=8)
    network = on_shape("plane", x, level=True, free=("z",), origin=(0.0, 0.0, 100.0))
    solution = fga.adjust(network)
    found = solution.unknown("frame", "S")
    assert found.values[5] == pytest.approx(12.0, abs=2 * MM)
    assert np.count_nonzero(found.sigmas) == 1


def test_a_vertical_plane_turns_about_the_plumb_line():
    rng = np.random.default_rng(4)
    along, up = rng.uniform(-9, 9, 12), rng.uniform(0, 5, 12)
    x = np.column_stack([3.0 + along * np.cos(2.1), 4.0 + along * np.sin(2.1), up])
    options = {"values": {"ry": np.pi / 2}, "free": ("rx", "z"), "level": True}
    solution = fga.adjust(on_shape("plane", x, **options))
    normal = solution.state["frame"][0, 2:9:3]
    assert normal[2] == pytest.approx(0.0, abs=1e-12)
    assert abs(normal @ [-np.sin(2.1), np.cos(2.1), 0.0]) == pytest.approx(1.0, abs=1e-9)
    assert solution.sigma0 < 1e-4


def test_given_components_and_sizes_are_kept():
    rng = np.random.default_rng(8)
    x = posed(places("cylinder", 14, rng), rng)
    network = on_shape("cylinder", x)
    network.set_size("S", RADIUS + 0.001, fixed=True)
    solution = fga.adjust(network)
    assert solution.unknown("size", "S").values[0] == RADIUS + 0.001
    assert 0.2 < solution.sigma0 < 2.0
    weighted = on_shape("cylinder", x)
    weighted.set_size("S", RADIUS + 0.001, sigma=1e-5)
    found = fga.adjust(weighted).unknown("size", "S").values[0]
    assert found == pytest.approx(RADIUS + 0.001, abs=2e-5)


def test_shapes_share_a_frame_and_a_size():
    """A flange: a cylinder and a circle about one axis, and another cylinder of the same radius."""
    rng = np.random.default_rng(9)
    rotation = exp_rotation(np.array([[0.3, -0.2, 0.4]]))[0]
    network = fga.Network("flange")
    for name, shape, middle in (("A", "cylinder", (0, 0, 0)), ("B", "cylinder", (9, 1, 2))):
        network.add_shape(name, shape, origin=middle)
        for i, q in enumerate(places(shape, 9, rng)):
            network.add_point(f"{name}{i}", rotation @ q + middle, sigma=MM)
            network.add(o.OnCylinder(name, f"{name}{i}", sigma=MM, radius="A"))
    network.set_size("bolts")
    network.set_size("bolts height")
    del network.of_kind("size")["B"]
    for i, t in enumerate(np.linspace(0, 5, 6)):
        network.add_point(f"C{i}", rotation @ [3 * np.cos(t), 3 * np.sin(t), 4.0], sigma=MM)
        network.add(o.OnCircle("A", f"C{i}", sigma=MM, radius="bolts", height="bolts height"))
    solution = fga.adjust(network)
    assert solution.unknown("size", "A").values[0] == pytest.approx(RADIUS, abs=1e-6)
    assert solution.unknown("size", "bolts").values[0] == pytest.approx(3.0, abs=1e-6)
    assert abs(solution.unknown("size", "bolts height").values[0]) == pytest.approx(4.0, abs=1e-6)
    assert solution.n_unknowns == 3 * 24 + 4 + 4 + 1 + 2


# -- weak configurations --------------------------------------------------------------------------

WEAK = {
    # shape, places, what is told
    "a plane through collinear points": (
        "plane",
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 0, 0]],
        "r",
    ),
    "a plane through two points": ("plane", [[0, 0, 0], [1, 0, 0]], "2 conditions for 3 unknowns"),
    "a line through one point": ("line", [[0, 0, 0]], "2 conditions for 4 unknowns"),
    "a line through one place": ("line", [[0, 0, 0], [0, 0, 0]], "r"),
    "a circle through two points": (
        *("circle", [[0, 0, 0], [1, 0, 0]]),
        "4 conditions for 6 unknowns (rx, ry, x, y, z, size)",
    ),
    "a sphere through three points": (
        *("sphere", [[0, 0, 0], [1, 0, 0], [0, 1, 0]]),
        "3 conditions for 4 unknowns (x, y, z, size)",
    ),
    "a sphere through a circle": (
        *("sphere", [[np.cos(t), np.sin(t), 0.0] for t in range(6)]),
        "open",
    ),
    "a cylinder through four points": (
        *("cylinder", [[1, 0, 0], [0, 1, 1], [-1, 0, 2], [0, -1, 4]]),
        "4 conditions for 5 unknowns",
    ),
}


@pytest.mark.parametrize("name", WEAK)
def test_what_its_points_do_not_determine_is_refused_with_its_name(name):
    shape, q, told = WEAK[name]
    x = np.array(q, dtype=float) + np.array([12.0, 13.0, 4.0])
    network = on_shape(shape, x, origin=(12.0, 13.0, 4.0))
    with pytest.raises(fga.AdjustmentError) as error:
        fga.adjust(network)
    assert "shape 'S'" in str(error.value)
    assert told in str(error.value)


@pytest.mark.parametrize(("shape", "n"), [("plane", 3), ("line", 2), ("circle", 3), ("sphere", 4)])
def test_a_shape_through_as_many_points_as_it_needs_is_not_controlled(shape, n):
    rng = np.random.default_rng(1)
    network = on_shape(shape, posed(places(shape, n, rng), rng), twice=False)
    solution = fga.adjust(network)
    assert solution.redundancy == 0
    assert solution.converged
    assert not fga.reliability(solution).controlled.any()


def test_the_counts_are_told_before_an_adjustment():
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 1.0, 0.0]])
    network = on_shape("cylinder", x)
    told = [str(p) for p in check(network)]
    assert any("shape 'S'" in t and "3 conditions for 5 unknowns" in t for t in told)
    assert not check(on_shape("plane", x))


def test_points_without_coordinates_are_told_before_their_shape():
    network = on_shape("plane", np.eye(3) * 4)
    network.add_point("lost")
    network.add(o.OnPlane("S", "lost", sigma=MM))
    with pytest.raises(fga.AdjustmentError, match="lost"):
        fga.adjust(network)


# -- edges in photos ------------------------------------------------------------------------------


def test_edges_are_found_from_photos_without_a_point():
    solution = fga.adjust(edges())
    assert solution.converged
    assert solution.sigma0 < 1e-3
    for name, (a, b) in {"post": ((-3.0, 1.0, 0.0), (-2.8, 1.1, 4.0))}.items():
        along = (np.array(b) - a) / np.linalg.norm(np.array(b) - a)
        stored = solution.state["frame"][solution.equations.unknowns["frame"].number[name]]
        assert abs(stored[2:9:3] @ along) == pytest.approx(1.0, abs=1e-12)


def test_an_edge_in_one_photo_is_refused_by_name():
    with pytest.raises(fga.AdjustmentError, match=r"line 'post': 1 photo has two measured points"):
        fga.adjust(edges(stations=1))


def test_an_edge_parallel_to_the_base_is_refused_by_name():
    with pytest.raises(fga.AdjustmentError, match=r"line 'gutter': .* parallel to the base"):
        fga.adjust(edges(stations=2, parallel=True))
    assert fga.adjust(edges(parallel=True)).converged


def test_a_simulated_shape_has_no_values_before_the_adjustment():
    for shape in SHAPES:
        values = simulated(shape, 1).frames["S"].values
        assert np.isnan(values).sum() >= len(SHAPES[shape].free)
