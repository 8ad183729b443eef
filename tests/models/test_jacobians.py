"""Every analytic partial against one numerical check, near-degenerate geometry included."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.models.lens_registry import LENSES
from factorgraph_adj.models.rpc_lens import RpcLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import KINDS
from factorgraph_adj.rotation import world_R_camera
from tests.networks import every_kind
from tests.networks.every_kind import CENTRAL, FRAMES, GEOMETRIES, LENSES_USED, OBSERVED, VIEWS
from tests.support.differences import assert_partials_are_right, observed_as_computed


@pytest.mark.slow(
    "partials of all kinds and lenses by differences in every frame; short tests compare "
    "values and some partials"
)
@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("frame", FRAMES)
def test_partials_of_every_kind_are_right_in_every_frame(frame: str, geometry: str) -> None:
    equations, steps = every_kind.sight_equations(frame, GEOMETRIES[geometry])
    state = equations.unknowns.start()
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)


@pytest.mark.slow(
    "partials of all kinds and lenses by differences in every frame; short tests compare "
    "values and some partials"
)
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("lens", LENSES_USED)
def test_partials_of_image_coordinates_are_right_for_every_lens(lens: str, view: str) -> None:
    equations, steps = every_kind.image_equations(lens, VIEWS[view])
    state = equations.unknowns.start()
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)


@pytest.mark.slow(
    "partials of all kinds and lenses by differences in every frame; short tests compare "
    "values and some partials"
)
@pytest.mark.parametrize("view", [v for v in VIEWS if v != "90° across"])
@pytest.mark.parametrize("lens", CENTRAL)
def test_partials_of_lines_in_images_are_right_for_every_lens(lens: str, view: str) -> None:
    """Not 90° across, where strong lenses from ideal to measured coordinates have no inverse."""
    equations, steps = every_kind.line_equations(lens, VIEWS[view])
    state = equations.unknowns.start()
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)


@pytest.mark.slow(
    "partials of all kinds and lenses by differences in every frame; short tests compare "
    "values and some partials"
)
@pytest.mark.parametrize("turned", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("frame", [n for n, (f, _) in FRAMES.items() if not f.left_handed])
def test_partials_of_a_photo_flight_are_right_in_every_frame(frame: str, turned: float) -> None:
    """``turned``: by how much observed attitudes are wrong, radians."""
    equations, steps = every_kind.flight_equations(frame, turned=turned)
    assert_partials_are_right(equations, equations.unknowns.start(), steps)


def test_kinds_are_declared_linear_whose_partials_by_points_are_the_same_everywhere() -> None:
    """Points move by 20 m in a flat frame; the deformed model is bent by 10⁻⁷."""
    equations, _ = every_kind.sight_equations("flat", GEOMETRIES["ordinary"])
    frame, state = equations.network.frame, equations.unknowns.start()
    elsewhere = {k: v.copy() for k, v in state.items()}
    elsewhere["point"] += np.random.default_rng(1).normal(0.0, 20.0, state["point"].shape)
    most: dict[str, float] = {}
    for block in equations.blocks:
        of_points = [i for i, (kind, _) in enumerate(block.variables) if kind == "point"]
        if block.prior or not of_points:
            continue
        here, there = (block.evaluate(frame, x).jacobians for x in (state, elsewhere))
        change = max(float(np.abs(here[i] - there[i]).max()) for i in of_points)
        most[block.kind] = max(change, most.get(block.kind, 0.0))
    assert len(most) > 40
    straight = {kind for kind, change in most.items() if change < 1e-6}
    assert straight == {kind for kind in most if KINDS[kind].linear}


def test_every_registered_kind_and_lens_is_checked() -> None:
    assert set(OBSERVED) == {*KINDS} - {"image"}  # image coordinates are checked by lens
    used = {type(c.lens) for c in LENSES_USED.values()}
    assert used == {*LENSES.values()} - {RpcLens}  # it has no poses: test_rpc_lens


@pytest.mark.parametrize("away", [0.0, 1e-6, 0.3, 3.0])
def test_partials_of_weighted_unknowns_are_right_away_from_their_given_values(away: float) -> None:
    """``away``: by how much the attitude is turned, radians."""
    network = Network()
    network.add_point("i", (1.0, 2.0, 3.0), sigma=(0.1, np.inf, 0.2))
    network.add_point("j", (4.0, 5.0, 6.0))
    network.set_vertical("i", xi=1e-5, eta=2e-5, sigma=1e-5)
    network.set_refraction("ray", value=0.13, sigma=0.05)
    network.set_distance_meter("edm", scale=1e-5, zero=0.01, sigma_scale=1e-6, free=["zero"])
    network.set_orientation("i", value=0.2, sigma=0.01)
    network.set_unknown("index_error", "circle", (2e-4,), sigma=1e-4)
    values = every_kind.LENSES_USED["brown"].values
    network.add_camera("camera", BrownLens(), values, free=["x0"], sigma={"c": 0.1, "k1": 1e-5})
    network.add_photo(
        "f",
        "camera",
        position=(1.0, 2.0, 9.0),
        rotation=world_R_camera(0.1, 0.2, 0.3),
        sigma_position=(0.1, 0.2, 0.3),
        sigma_attitude=0.01,
    )
    network.add(*OBSERVED["slope_distance"](), *OBSERVED["zenith_angle"]())
    equations = compile_network(network)
    unknowns = equations.unknowns
    step = np.zeros(unknowns.n_columns)
    step[unknowns.columns("pose", 0)] = [0.6 * away, -0.64 * away, 0.48 * away, 0.1, 0.2, 0.3]
    state = unknowns.retract(unknowns.start(), step)
    steps = np.full(unknowns.n_columns, 1e-2)
    steps[unknowns.columns("pose", 0)[:3]] = 1e-3
    assert_partials_are_right(equations, state, steps)
