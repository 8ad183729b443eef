"""Deformations that models share (Ayeni's method 23)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.base import DegenerateError
from factorgraph_adj.models.deformation import DEFORMATIONS, DISPLACEMENTS, PROJECTIVE, deformed
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.triangulation.independent_models import FRAME_COMPONENTS
from factorgraph_adj.types import Array
from tests.networks.deformed_models import BASE, CENTRES, TRUE, deformed_block
from tests.support.same import assert_same_network


def terms(names: tuple[str, ...], q: Array) -> Array:
    """Return the displacements (3 n, k) of places q (n, 3) by some parameters."""
    every = deformed(q, np.zeros((len(q), len(DEFORMATIONS))), np.ones(len(q))).by_parameters
    return np.asarray(
        every.reshape(-1, len(DEFORMATIONS))[:, [DEFORMATIONS.index(n) for n in names]]
    )


def similarity(q: Array) -> Array:
    """Return the displacements (3 n, 7) by a similarity."""
    x, y, z = q.T
    zero, one = 0 * x, 0 * x + 1
    columns = [(one, zero, zero), (zero, one, zero), (zero, zero, one), (x, y, z)]
    columns += [(-y, x, zero), (zero, -z, y), (z, zero, -x)]
    return np.stack([np.column_stack(c).ravel() for c in columns], axis=1)


def test_affine_terms_and_a_similarity_are_an_affine_transformation() -> None:
    q = np.random.default_rng(1).normal(size=(20, 3))
    affine = ("affinity", "shear_xy", "stretch_z", "shear_xz", "shear_yz")
    both = np.column_stack([similarity(q), terms(affine, q)])
    assert np.linalg.matrix_rank(both) == 12
    x, y, z = q.T
    every = [np.kron(np.column_stack([x * 0 + 1, x, y, z]), e[:, None]) for e in np.eye(3)]
    assert np.linalg.matrix_rank(np.column_stack([both, *every])) == 12


def test_eight_and_three_terms_are_those_of_ebner() -> None:
    """On flat ground {1, ξ} ⊗ {1, η, η²} in x, y and z: 18 = 8 + 3 and the similarity."""
    q = np.random.default_rng(1).normal(size=(20, 3))
    q[:, 2] = 0.0
    plan = ("affinity", "shear_xy", *(n for n in DEFORMATIONS if n[:2] in ("x_", "y_")))
    height = tuple(n for n in DEFORMATIONS if n[:2] == "z_")
    assert (len(plan), len(height)) == (8, 3)
    both = np.column_stack([similarity(q), terms((*plan, *height), q)])
    x, y, _ = q.T
    one = x * 0 + 1
    each = np.column_stack([one, y, y**2, x, x * y, x * y**2])
    every = [np.kron(each, e[:, None]) for e in np.eye(3)]
    assert np.linalg.matrix_rank(both) == 18
    assert np.linalg.matrix_rank(np.column_stack([both, *every])) == 18


AFFINE = ("affinity", "shear_xy", "stretch_z", "shear_xz", "shear_yz")


def test_affine_and_projective_terms_and_a_similarity_are_a_projective_transformation() -> None:
    """Tangents at the identity: 12 affine ones, and q (w·q) for the fourth row of the matrix."""
    q = np.random.default_rng(1).normal(size=(20, 3))
    both = np.column_stack([similarity(q), terms((*AFFINE, *PROJECTIVE), q)])
    assert np.linalg.matrix_rank(both) == 15
    bent = [(q * q[:, i : i + 1]).ravel() for i in range(3)]
    assert np.linalg.matrix_rank(np.column_stack([both, *bent])) == 15


def projective_model(n: int, *, seed: int = 3) -> fga.Network:
    """Return n held points and their coordinates in a model that a 4 × 4 matrix has bent."""
    rng = np.random.default_rng(seed)
    network = fga.Network("projective model")
    matrix = np.eye(4) + 0.15 * rng.normal(size=(4, 4))
    matrix[3, 3] = 1.0
    network.add_frame("M", free=FRAME_COMPONENTS, origin=(0.0, 0.0, 0.0))
    network.set_model_deformation("M", free=(*AFFINE, *PROJECTIVE))
    for i, x in enumerate(rng.uniform(-1.0, 1.0, (n, 3))):
        network.add_point(f"{i}", 100.0 * x, fixed="xyz")
        h = matrix @ [*x, 1.0]
        assert h[3] > 0.4
        value = tuple(100.0 * h[:3] / h[3])
        o = fga.FrameCoordinate("M", f"{i}", value, sigma=(0.01,) * 3, deformation="M", base=100.0)
        network.add(o)
    return network


@pytest.mark.parametrize("seed", range(4))
def test_any_projective_transformation_is_a_frame_with_a_deformation(seed: int) -> None:
    """Fifteen parameters from zero, without approximate values: residuals vanish."""
    solution = fga.adjust(projective_model(20, seed=seed))
    assert solution.converged and solution.redundancy == 60 - 15
    assert solution.vtpv < 1e-12


def test_five_points_determine_a_projective_model_and_four_do_not() -> None:
    assert fga.adjust(projective_model(5)).redundancy == 0
    with pytest.raises(fga.DatumError, match="not determined"):
        fga.adjust(projective_model(4))


def test_a_place_beyond_the_vanishing_plane_has_no_image() -> None:
    q, base = np.array([[10.0, 0.0, 0.0], [60.0, 0.0, 0.0]]), np.array([100.0, 100.0])
    w = np.zeros((2, len(DEFORMATIONS)))
    w[:, DEFORMATIONS.index("projective_x")] = 200.0  # 1 − 200 · 60 / 100² < 0
    assert deformed(q[:1], w[:1], base[:1]).q[0, 0] == pytest.approx(10.0 / 0.8)
    with pytest.raises(DegenerateError, match="moves it to infinity") as error:
        deformed(q, w, base)
    assert list(error.value.rows) == [1]


def test_a_projective_deformation_of_all_models_is_found() -> None:
    true = {**TRUE, "projective_x": 0.8, "projective_z": -0.5}
    plan = deformed_block(weighted=DEFORMATIONS[3:], sigma=1.0)
    plan.set_model_deformation("film", values=true, sigma=dict.fromkeys(DEFORMATIONS[3:], 1.0))
    solution = fga.adjust(given_nothing(measure(plan, seed=4)))
    found = solution.unknown("model_deformation", "film")
    for name in PROJECTIVE:
        error = found[name] - true.get(name, 0.0)
        assert abs(error) < 4 * found.sigma(name)
    assert found["projective_x"] > 10 * found.sigma("projective_x")


def given_nothing(network: fga.Network) -> fga.Network:
    """Return the network as one adjusts it: every parameter of a deformation has the value 0."""
    out = network.copy()
    table = out.of_kind("model_deformation")
    for name, p in table.items():
        table[name] = replace(p, values=(0.0,) * len(p.values))
    return out


def test_a_deformation_of_all_models_is_found_and_taken_out() -> None:
    plan = deformed_block()
    network = given_nothing(measure(plan, seed=11))
    solution = fga.adjust(network)
    for group, true in (("film", TRUE), ("left", CENTRES)):
        found = solution.unknown("model_deformation", group)
        free = np.flatnonzero(found.sigmas > 0)
        error = found.values[free] - [true.get(found.names[i], 0.0) for i in free]
        assert np.all(np.abs(error) < 4 * found.sigmas[free])
    bare = network.copy()
    bare.observations = {i: replace(o, deformation=None) for i, o in network.observations.items()}
    without = fga.adjust(bare)
    assert without.sigma0 > 1.5 * solution.sigma0

    def rms(s: fga.Solution) -> float:
        free = [n for n in plan.points if not any(plan.points[n].fixed) and n[0] != "C"]
        error = [s.point(n) - plan.points[n].coordinates for n in free]
        return float(np.sqrt(np.mean(np.square(error))))

    assert rms(solution) < 0.6 * rms(without)


@pytest.mark.parametrize("seed", range(6))
def test_true_parameters_come_back(seed: int) -> None:
    """σ of the parameters and true values agree: χ² of 14, 99.9 %."""
    solution = fga.adjust(given_nothing(measure(deformed_block(sigma=1.0), seed=seed)))
    found = solution.unknown("model_deformation", "film")
    free = np.flatnonzero(found.sigmas > 0)
    error = found.values[free] - [TRUE.get(found.names[i], 0.0) for i in free]
    q = solution.variable_covariance(("model_deformation", "film"))[np.ix_(free, free)]
    assert error @ np.linalg.solve(q, error) < 36.1


def test_insignificant_parameters_are_told() -> None:
    solution = fga.adjust(given_nothing(measure(deformed_block(), seed=11)))
    tested = fga.significance(solution)
    shown = str(tested)
    assert "affinity" in shown or any("affinity" in str(t) for t in tested.first_rows().cells)


def test_shifts_of_all_places_of_a_model_are_not_determined() -> None:
    """They are the offsets of the frames, as soon as projection centres have them too."""
    network = measure(deformed_block(), seed=1)
    network.observations = {
        i: replace(o, deformation="film") for i, o in network.observations.items()
    }
    network.set_model_deformation("film", free=("x", "y"))
    with pytest.raises(fga.DatumError, match="model deformation 'film' is not determined"):
        fga.adjust(network)


def test_free_terms_need_no_weights() -> None:
    network = given_nothing(measure(deformed_block(), seed=1))
    network.set_model_deformation("film", free=DISPLACEMENTS[3:])
    solution = fga.adjust(network)
    assert solution.converged
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-6)


def test_a_wrong_model_coordinate_is_found_beside_a_deformation() -> None:
    network = given_nothing(measure(deformed_block(), seed=2))
    ident = next(i for i, o in network.observations.items() if o.point == "2-1" and o.frame == "M1")
    x, y, z = network.observations[ident].value
    network.observations[ident] = replace(network.observations[ident], value=(x, y + 0.15, z))
    assert [r.id for r in fga.snoop(network).rejected] == [ident]


def test_a_project_keeps_deformations_to_the_bit(tmp_path) -> None:
    network = measure(deformed_block(), seed=2)
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path)
    assert_same_network(network, again)
    assert again.parameters == network.parameters
    assert {o.base for o in again.observations.values()} == {BASE}


def test_bad_deformations_are_refused() -> None:
    network = deformed_block()
    with pytest.raises(
        fga.InputError, match=r"free must be some of x, y, z, affinity, .* not 'x_yyy'"
    ):
        network.set_model_deformation("other", free=("x_yyy",))
    with pytest.raises(fga.InputError, match="unknown model deformation 'lens'; known: film, left"):
        network.add(
            fga.FrameCoordinate("M1", "1-1", (0, 0, 0), sigma=(1, 1, 1), deformation="lens")
        )
    with pytest.raises(fga.InputError, match="base must be greater than zero"):
        fga.FrameCoordinate("M1", "1-1", (0, 0, 0), sigma=(1, 1, 1), base=0.0)
