"""Strips of models and their polynomials: published figures, known coefficients, weak control."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from factorgraph_adj.models.deformation import COEFFICIENTS, HEIGHT_TERMS, monomials
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.triangulation.independent_models import (
    RelativeModel,
    pairs_of_strips,
    relative_model,
)
from factorgraph_adj.triangulation.strips import (
    as_strips,
    control_coordinates,
    fitted_similarity,
    join_models,
)
from tests.loaders.tsaiyoung import read_strip
from tests.networks.bent_strips import CONTROL, TRUE, bent_strips
from tests.networks.strip import network_of_photos
from tests.networks.strip_of_photos import measured_strip, strip_plan
from tests.support.places import data_dir
from tests.support.same import assert_same_network

HALF_MM = 0.501e-3
"""Half the last printed digit of the published figures, metres."""
ROUNDING = 1e-9
"""Metres."""


@pytest.fixture(scope="module")
def real() -> tuple[fga.Network, list[RelativeModel]]:
    network = network_of_photos(read_strip(data_dir("tsaiyoung_strip")))
    return network, [relative_model(network, p) for p in pairs_of_strips(network)]


@pytest.mark.published
def test_a_real_strip_of_joined_models(real: tuple[fga.Network, list[RelativeModel]]) -> None:
    """RMS at check points .084 .062 .366 with seven parameters (FRAMES 6.2)."""
    network, models = real
    strip = join_models(models).to_ground(control_coordinates(network))
    errors = [strip.points[n] - p.check for n, p in network.points.items() if p.check]
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    np.testing.assert_allclose(rms, [0.084, 0.062, 0.366], rtol=0, atol=0.0006)


@pytest.mark.published
def test_a_real_strip_bent_by_a_polynomial(real: tuple[fga.Network, list[RelativeModel]]) -> None:
    """.033 .040 .174 with degree 2 in plan and 1, x, y, x² in height (FRAMES 6.2)."""
    network, models = real
    solution = fga.adjust(as_strips(network, {"strip": models}, sigma=(0.1, 0.1, 0.2)))
    assert solution.redundancy == 2  # 4 control points in plan, 6 coefficients
    rms = fga.check_points(solution).rms
    np.testing.assert_allclose(rms, [0.033, 0.040, 0.174], rtol=0, atol=HALF_MM)


def test_exact_coefficients_without_noise() -> None:
    solution = fga.adjust(measure(bent_strips(), seed=0, noise=False))
    for strip, true in TRUE.items():
        found = solution.unknown("polynomial", strip)
        for name, value in true.items():
            assert found[name] == pytest.approx(value, abs=ROUNDING)
    assert solution.iterations <= 2  # the equations are linear


def test_coefficients_of_a_strip_are_those_of_schut() -> None:
    """Written out in FRAMES F6.1, with a₁ a₂ for the constants, a₃ a₄ for degree 1, and so on."""
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 5))
    a = rng.normal(size=8)
    size = COEFFICIENTS.index("b3") + 1
    c = np.zeros(size)
    for j in range(4):
        c[COEFFICIENTS.index(f"a{j}")], c[COEFFICIENTS.index(f"b{j}")] = a[2 * j], a[2 * j + 1]
    found = monomials(x, y, size) @ c
    dx = a[0] + a[2] * x - a[3] * y + a[4] * (x**2 - y**2) - 2 * a[5] * x * y
    dx += a[6] * (x**3 - 3 * x * y**2) - a[7] * (3 * x**2 * y - y**3)
    dy = a[1] + a[3] * x + a[2] * y + a[5] * (x**2 - y**2) + 2 * a[4] * x * y
    dy += a[6] * (3 * x**2 * y - y**3) + a[7] * (x**3 - 3 * x * y**2)
    np.testing.assert_allclose(found, np.column_stack([dx, dy, 0 * x]), atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_true_coefficients_come_back(seed: int) -> None:
    """Within χ² of 22 degrees of freedom, 99.9 %; 200 seeds in the notes of the package."""
    solution = fga.adjust(measure(bent_strips(), seed=seed))
    for strip, true in TRUE.items():
        found = solution.unknown("polynomial", strip)
        error = found.values - [true[n] for n in found.names]
        covariance = solution.variable_covariance(("polynomial", strip))
        assert error @ np.linalg.solve(covariance, error) < 33.1  # 11 coefficients


def test_polynomials_take_what_a_chain_of_models_adds_up_to() -> None:
    """A long strip of models: degree 2 is better at check points than seven parameters."""
    plan = strip_plan(20, overlap=0.6)
    network = measured_strip(plan, seed=4)
    models = [relative_model(network, p) for p in pairs_of_strips(network)]
    for name, p in network.points.items():
        if not any(p.fixed):
            network.points[name] = replace(p, check=plan.points[name].coordinates)
    strip = join_models(models).to_ground(control_coordinates(network))
    errors = [strip.points[n] - p.check for n, p in network.points.items() if p.check]
    stiff = np.sqrt(np.mean(np.square(errors), axis=0))
    bent = fga.check_points(fga.adjust(as_strips(network, {"s": models}, sigma=(1, 1, 1)))).rms
    assert (bent < stiff).all()


# -- what control must hold -----------------------------------------------------------------------


def test_two_control_points_do_not_hold_degree_two() -> None:
    few = bent_strips(control=("0-0", "8-4"))
    with pytest.raises(fga.DatumError, match=r"strip polynomial '(north|south)' is not determined"):
        fga.adjust(measure(few, seed=1))


def test_without_control_the_strip_that_is_not_held_is_named() -> None:
    with pytest.raises(fga.DatumError, match="not determined"):
        fga.adjust(measure(bent_strips(control=()), seed=1))


def one_strip(control: str) -> fga.Network:
    """Return the northern strip alone, with control in one row or in several."""
    held = [f"{i}-{j}" for i in range(9) for j in control]
    south = [f"{i}-{j}" for i in range(9) for j in (3, 4)]
    network = fga.without(measure(bent_strips(control=held), seed=1), [], points=south)
    return fga.without(network, [i for i, o in network.observations.items() if o.strip != "north"])


def test_a_row_of_control_does_not_hold_the_tilt_across() -> None:
    with pytest.raises(fga.DatumError, match=r"'north' is not determined .*z_xy"):
        fga.adjust(one_strip("1"))
    assert fga.adjust(one_strip("12")).converged


def test_two_strips_with_control_at_their_outer_edges_are_a_hinge() -> None:
    """The row that both share goes up and down; horizontal control holds the plan."""
    hinge = measure(bent_strips(control=[f"{i}-{j}" for i in (0, 4, 8) for j in (0, 4)]), seed=1)
    with pytest.raises(fga.DatumError, match=r"2 defects(.|\n)*polynomial 'north'(.|\n)*: z,"):
        fga.adjust(hinge)


def test_a_held_or_weighted_coefficient_helps() -> None:
    """Of a strip with control in one row, a weighted tilt across takes over."""
    network = one_strip("1")
    true = TRUE["north"]
    network.set_polynomial("north", height=("z", "z_x", "z_xx"), sigma={"z_y": 0.2, "z_xy": 0.1})
    solution = fga.adjust(network)
    assert solution.converged
    assert abs(solution.unknown("polynomial", "north")["z_y"]) < 1e-9  # its given value
    network.set_polynomial("north", height=("z", "z_x", "z_xx"), values={"z_y": true["z_y"]})
    held = fga.adjust(network).unknown("polynomial", "north")
    assert held.sigma("z_y") == 0.0
    assert held["z_y"] == true["z_y"]


# -- the life of the kind -------------------------------------------------------------------------


def test_a_gross_strip_coordinate_is_found() -> None:
    network = measure(bent_strips(), seed=3)
    x, y, z = network.observations["north 4-2"].value
    network.observations["north 4-2"] = replace(
        network.observations["north 4-2"], value=(x, y + 1.5, z)
    )
    assert [r.id for r in fga.snoop(network).rejected] == ["north 4-2"]


def test_redundancy_numbers_add_up() -> None:
    solution = fga.adjust(measure(bent_strips(), seed=3))
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-8)
    parts = rel.redundancy_numbers + rel.e1 + rel.e2 + rel.e12
    np.testing.assert_allclose(parts, 1.0, atol=1e-8)


def test_strip_coordinates_arrive_and_leave(tmp_path) -> None:
    network = measure(bent_strips(), seed=3)
    batch = fga.adjust(network)
    begun = network.copy()
    begun.observations = {}
    inc = fga.IncrementalAdjustment(begun, policy="accept", journal=tmp_path / "day.jsonl")
    order = np.random.default_rng(1).permutation(list(network.observations))
    for ident in order.tolist():
        o = replace(network.observations[ident], id=ident)
        inc.add(observation_from_record(json.loads(json.dumps(observation_record(o)))))
    inc.settle()
    for strip in TRUE:
        a, b = (s.unknown("polynomial", strip) for s in (batch, inc.solution()))
        np.testing.assert_allclose(b.values, a.values, rtol=0, atol=1e-5)
        np.testing.assert_allclose(b.sigmas, a.sigmas, rtol=1e-5)
    inc.remove(["south 3-2"])
    left = fga.adjust(fga.without(network, ["south 3-2"]))
    assert inc.solution().vtpv == pytest.approx(left.vtpv, rel=1e-6)


def test_a_project_keeps_strips_to_the_bit(tmp_path) -> None:
    network = measure(bent_strips(), seed=3)
    network.set_polynomial("south", plan=3, height=("z", "z_xxx"), sigma={"z_x": 0.1})
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path)
    assert_same_network(network, again)
    assert again.parameters == network.parameters


def test_points_start_from_strips() -> None:
    network = measure(bent_strips(), seed=3)
    for name, p in network.points.items():
        if name not in CONTROL:
            network.points[name] = replace(p, coordinates=(np.nan,) * 3)
    assert fga.adjust(network).converged


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"strip": ""}, "strip must name a strip polynomial"),
        ({"axes": "xw"}, "axes must be some of x, y, z, not 'xw'"),
        ({"axes": "xy"}, "value must have 2 components"),
        ({"along": np.nan}, "along must be a finite number"),
        ({"sigma": (1.0, 1.0)}, "sigma must be 3 standard deviations"),
    ],
)
def test_bad_strip_coordinates_are_refused(given: dict[str, object], said: str) -> None:
    stated = {"strip": "s", "point": "P", "value": (0.0, 0.0, 0.0), "along": 0.0, "across": 0.0}
    stated |= {"sigma": (1.0, 1.0, 1.0)}
    with pytest.raises(fga.InputError, match=said):
        fga.StripCoordinate(**(stated | given))  # type: ignore[arg-type]


def test_bad_polynomials_are_refused() -> None:
    network = fga.Network()
    network.add_point("P")
    with pytest.raises(fga.InputError, match="plan must be a degree from 0 to 4 or none, not 5"):
        network.set_polynomial("s", plan=5)
    with pytest.raises(
        fga.InputError, match=r"strip polynomial 's': free must be some of a0, b0, .* not 'z_yyy'"
    ):
        network.set_polynomial("s", height=("z", "z_yyy"))
    network.set_polynomial("s1")
    with pytest.raises(fga.InputError, match="unknown strip polynomial 's2'; known: s1"):
        network.add(fga.StripCoordinate("s2", "P", (0, 0, 0), along=0, across=0, sigma=(1, 1, 1)))


def test_bad_cells_of_a_project_are_named(tmp_path) -> None:
    fga.write_project(measure(bent_strips(), seed=3), tmp_path / "project.toml")
    table = next(p for p in tmp_path.glob("*.csv") if "along" in p.read_text().splitlines()[0])
    lines = table.read_text().splitlines()
    column = lines[0].split(",").index("along")
    cells = lines[1].split(",")
    cells[column] = "half"
    table.write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]) + "\n")
    with pytest.raises(fga.InputError, match=rf"{table.name}.*2.*along"):
        fga.read_project(tmp_path)


def test_strips_that_cannot_be_joined_are_named() -> None:
    network = measured_strip(strip_plan(4, overlap=0.6), seed=2)
    first, last = relative_model(network, ("0", "1")), relative_model(network, ("2", "3"))
    with pytest.raises(fga.InputError, match=r"model '2-3' of strip 'S': . common places"):
        join_models([first, last], name="S")
    with pytest.raises(fga.InputError, match="strip 'S': it has no models"):
        join_models([], name="S")
    with pytest.raises(fga.InputError, match="fix no similarity"):
        fitted_similarity(np.eye(3)[:2], np.eye(3)[:2], "it")
    assert sum(map(len, HEIGHT_TERMS)) == 12  # as Schut's


def test_plans_components_reports_and_plots_take_strips() -> None:
    pytest.importorskip("matplotlib")
    from factorgraph_adj.report.plots import plot_network, plot_redundancy

    plan = bent_strips()
    network = measure(plan, seed=3)
    solution = fga.adjust(network)
    planned = fga.plan(plan)
    np.testing.assert_allclose(
        planned.solution.unknown("polynomial", "north").sigmas,
        solution.unknown("polynomial", "north").sigmas,
        rtol=1e-9,
    )
    said = fga.text_report(solution)
    assert "strip coordinate" in said
    assert "strip north" in said
    assert "z_xx" in said
    found = fga.estimate_variance_components(network)
    assert found.converged
    for figure in (plot_network(solution), plot_redundancy(fga.reliability(solution))):
        assert figure.axes
