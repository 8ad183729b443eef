"""Variance components: do they find the precision of groups, and do they know how well?

The reference is the restricted likelihood itself: with Kᵀ of full rank and KᵀA = 0, Kᵀl is
normal with covariance Σ f_g² KᵀE_gK, and its density is maximised over ln f² (Patterson &
Thompson 1971). It shares nothing with redundancy numbers or Helmert's equations.

Statistical bounds are two-sided at `CONFIDENCE` for all figures of a test; seeds are fixed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gtsam
import numpy as np
import pytest
from scipy import linalg, optimize, stats

from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.factor_graph.network_graph import build_graph
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Correlated, GnssVector, HeightDifference, SlopeDistance
from factorgraph_adj.quality.component_iteration import conjugate_gradients
from factorgraph_adj.quality.observation_groups import (
    GroupChoice,
    group_redundancy,
    observation_groups,
    sharpened_redundancy,
)
from factorgraph_adj.quality.variance_components import (
    VarianceComponent,
    VarianceComponents,
    components_of_trial,
    estimate_variance_components,
)
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.estimates import ObservationRecord
from factorgraph_adj.solve.minimum import readjust
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.statistical_tests import global_test
from factorgraph_adj.types import Array
from tests.networks.simulated import free_block
from tests.networks.small_block import SIGMA_MM, plan, small_block
from tests.networks.wrong_weights import TRUE, WRONG, industry_block, measured_kinds, rescaled
from tests.support.dense import Dense
from tests.support.places import data_dir

LONG = pytest.mark.slow(
    "components of larger networks and against their likelihood; "
    "short tests recover those of small ones"
)

CONFIDENCE = 0.999
REPETITIONS = [
    6,
    pytest.param(
        30,
        marks=pytest.mark.slow(
            "sees standard deviations of components that are wrong by a third; six repetitions "
            "see those that are wrong by a factor of two"
        ),
    ),
]
AT_REST = 1e-9
"""Change of components relative to their own σ at which iterations end here."""
AS_DENSE = 1e-6
"""Relative: agreement with the restricted likelihood by dense matrices."""
ROUNDING = 1e-9
MM = 1e-3


# -- networks -------------------------------------------------------------------------------------


def levelling(
    lines: Sequence[tuple[str, str, str, float]], *, seed: int, points: Sequence[str] = "ABCDEFGH"
) -> Network:
    """Return levelled lines (id, from, to, true σ in mm) that claim σ = 1 mm; A is held."""
    rng = np.random.default_rng(seed)
    network = Network("levelling")
    for i, name in enumerate(points):
        network.add_point(name, (10.0 * i, 0.0, 0.3 * i), fixed="xyz" if i == 0 else "xy")
    for ident, a, b, sigma in lines:
        value = 0.3 * (points.index(b) - points.index(a)) + sigma * MM * rng.standard_normal()
        network.add(HeightDifference(a, b, value, sigma=MM, id=ident))
    return network


def loops(sigmas: Mapping[str, float], *, repeated: int = 1) -> list[tuple[str, str, str, float]]:
    """Return all lines between eight points, dealt to groups with a true σ each, mm."""
    names = list(sigmas)
    pairs = [(a, b) for i, a in enumerate("ABCDEFGH") for b in "ABCDEFGH"[i + 1 :]] * repeated
    return [
        (f"{names[i % len(names)]}{i}", a, b, sigmas[names[i % len(names)]])
        for i, (a, b) in enumerate(pairs)
    ]


def by_letter(record: ObservationRecord) -> str | None:
    """Group ids by their first letter."""
    return record.id[0]


COVARIANCE = np.array([[4.0, 1.0, -0.5], [1.0, 3.0, 0.7], [-0.5, 0.7, 5.0]]) * 1e-6
"""Of a GNSS vector, m²."""


def gnss(seed: int = 0) -> Network:
    """Return sessions of three vectors each with a joint covariance, twice wrong in half of them.

    Sessions of receivers r claim the half of their σ, those of receivers s the truth; single
    vectors v with a covariance of their own too.
    """
    rng = np.random.default_rng(seed)
    network = Network("sessions")
    true = {n: rng.uniform(-500.0, 500.0, 3) for n in "ABCDEFG"}
    for name, at in true.items():
        network.add_point(name, at, fixed="xyz" if name == "A" else "")
    joint = np.kron(np.eye(3) + 0.5, COVARIANCE)
    root, own = np.linalg.cholesky(joint), np.linalg.cholesky(COVARIANCE)
    for session in range(12):
        receivers = "r" if session % 2 else "s"
        base, *others = rng.choice(list("ABCDEFG"), 4, replace=False).tolist()
        error = (2.0 if receivers == "r" else 1.0) * (root @ rng.standard_normal(9))
        network.add(
            Correlated(
                tuple(
                    GnssVector(
                        base,
                        other,
                        tuple((true[other] - true[base] + error[3 * i : 3 * i + 3]).tolist()),
                        covariance=COVARIANCE,
                        id=f"{receivers}{session}-{other}",
                    )
                    for i, other in enumerate(others)
                ),
                joint,
            )
        )
    for i, (a, b) in enumerate(zip("ABCDEF", "BCDEFG", strict=True)):
        value = true[b] - true[a] + own @ rng.standard_normal(3)
        network.add(GnssVector(a, b, tuple(value.tolist()), covariance=COVARIANCE, id=f"v{i}"))
    return network


def two_cameras_two_instruments(seed: int = 3) -> Network:
    """Return the small block with two photos by a camera, and a station by a tachymeter, that
    are three times, and half, as uncertain as their observations claim."""
    network = plan()
    d3 = network.cameras["D3"]
    network.add_camera("D4", d3.lens, d3.values, free=("c", "x0", "y0", "k1"))
    for name in ("F3", "F4"):
        network.photos[name] = replace(network.photos[name], camera="D4")
    for name in ("T1", "T2"):
        network.set_distance_meter(name)
    network.observations = {
        ident: replace(o, instrument=f"T{o.station[1]}", sigma=MM)
        if isinstance(o, SlopeDistance)
        else o
        for ident, o in network.observations.items()
    }
    # What is true is measured with; what is claimed is adjusted with.
    photo, _, _, sigma = network.images.columns()
    sigma[photo >= 2] = 3.0 * SIGMA_MM
    second = [i for i, o in network.observations.items() if getattr(o, "instrument", "") == "T2"]
    rescaled(network, dict.fromkeys(second, 0.5))
    measured = measure(network, seed=seed)
    rescaled(measured, dict.fromkeys(second, 2.0))
    measured.images.columns()[3][:] = SIGMA_MM
    return measured


# -- the restricted likelihood, dense -------------------------------------------------------------


@dataclass(frozen=True)
class Restricted:
    """Kᵀl and KᵀE_gK of the linearised network, whitened with the a-priori weights."""

    observed: Array
    """Kᵀl (r,)."""
    parts: Array
    """KᵀE_gK of the groups that are estimated, (k, r, r)."""
    rest: Array
    """The same of all else with its known factors, (r, r)."""

    @classmethod
    def of(cls, found: VarianceComponents) -> Restricted:
        """Linearise with a-priori weights where the components came to rest."""
        solution = found.solution
        equations = compile_network(solution.network).weighted_at(solution.state)
        dense = Dense.at(equations, solution.state)
        scaled = dense.design / np.linalg.norm(dense.design, axis=0)
        k = linalg.null_space(scaled.T, rcond=1e-10)
        of_row, parts = found.groups.of_row, []
        rest = k[of_row < 0].T @ k[of_row < 0]
        for g, c in enumerate(found.components):
            own = k[of_row == g]
            if c.estimated:
                parts.append(own.T @ own)
            else:
                rest = rest + c.factor**2 * own.T @ own
        return cls(k.T @ dense.residual, np.array(parts), rest)

    def covariance(self, logarithms: Array) -> Array:
        """Return the covariance of Kᵀl for ln f²."""
        return np.asarray(np.tensordot(np.exp(logarithms), self.parts, 1) + self.rest)

    def minus_two_ln(self, logarithms: Array) -> float:
        """Return −2 ln of the density, without its constant."""
        c = self.covariance(logarithms)
        return float(np.linalg.slogdet(c)[1] + self.observed @ np.linalg.solve(c, self.observed))

    def slope(self, logarithms: Array) -> Array:
        """Return its derivative by ln f²."""
        inverse = np.linalg.inv(self.covariance(logarithms))
        z = inverse @ self.observed
        traces = np.einsum("ij,gji->g", inverse, self.parts)
        return np.exp(logarithms) * (traces - np.einsum("i,gij,j->g", z, self.parts, z))

    def best(self) -> Array:
        """Return ln f² of the greatest density, from the a-priori ones."""
        found = optimize.minimize(
            self.minus_two_ln, np.zeros(len(self.parts)), jac=self.slope, method="BFGS"
        )
        return np.asarray(optimize.root(self.slope, found.x, tol=1e-13).x)

    def covariance_of_estimates(self, logarithms: Array) -> Array:
        """Return the covariance of ln f²: the inverse of the Fisher information, ½ tr(…)."""
        inverse = np.linalg.inv(self.covariance(logarithms))
        m = np.exp(logarithms)[:, None, None] * (inverse @ self.parts)
        return np.linalg.inv(0.5 * np.einsum("gij,hji->gh", m, m))


TERRESTRIAL_AND_IMAGES = {
    "small block by kind": (small_block, "kind"),
    "free small block by kind": (partial(free_block, 2), "kind"),
    "two cameras and instruments": (two_cameras_two_instruments, "instrument"),
    "sessions of GNSS vectors": (gnss, by_letter),
    "levelling in two groups": (lambda: levelling(loops({"a": 1.0, "b": 3.0}), seed=5), by_letter),
    "levelling, one of two groups": (
        lambda: levelling(loops({"a": 2.0, "b": 1.0}), seed=6),
        {"first": [f"a{i}" for i in range(0, 28, 2)]},
    ),
}


@LONG
@pytest.mark.parametrize("name", TERRESTRIAL_AND_IMAGES)
def test_components_have_the_greatest_restricted_likelihood(name: str) -> None:
    make, groups = TERRESTRIAL_AND_IMAGES[name]
    found = estimate_variance_components(make(), groups=groups, tolerance=AT_REST)
    assert found.converged, found.reason
    at = [i for i, c in enumerate(found.components) if c.estimated]
    assert len(at) > 0
    reference = Restricted.of(found)
    best = reference.best()
    factors = np.array([found.components[i].factor for i in at])
    np.testing.assert_allclose(factors, np.exp(best / 2), rtol=AS_DENSE)
    covariance = reference.covariance_of_estimates(best)
    own = np.sqrt(np.diag(covariance))
    sigmas = np.array([found.components[i].sigma for i in at])
    np.testing.assert_allclose(sigmas, factors * own / 2, rtol=AS_DENSE)
    correlation = covariance / np.outer(own, own)
    np.testing.assert_allclose(found.correlation[np.ix_(at, at)], correlation, atol=AS_DENSE)


# -- wrong weights --------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=REPETITIONS)
def repetitions(request: pytest.FixtureRequest) -> list[VarianceComponents]:
    return [
        estimate_variance_components(industry_block(seed), groups=measured_kinds)
        for seed in range(request.param)
    ]


def standardised(repetitions: list[VarianceComponents], kind: str) -> Array:
    """Return (ln f − ln true) / σ of each repetition."""
    found = [r[kind] for r in repetitions]
    return np.array([np.log(c.factor / TRUE[kind]) * c.factor / c.sigma for c in found])


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("kind", TRUE)
def test_doubled_halved_and_true_weights_are_recovered(
    repetitions: list[VarianceComponents], kind: str
) -> None:
    """The mean of ln χ²_ν/ν is −1/ν, with ν of 91 (tape), 44 (level) and 239 (images)."""
    z = standardised(repetitions, kind)
    tail = (1 - CONFIDENCE) / 2 / (2 * len(TRUE))
    bias = -np.mean([1.0 / np.sqrt(2.0 * r[kind].freedom) for r in repetitions])
    assert abs(z.mean() - bias) < stats.norm.isf(tail) / np.sqrt(len(z))
    low, high = stats.chi2.ppf(tail, len(z)), stats.chi2.isf(tail, len(z))
    assert low < np.sum(np.square(z - bias)) < high


def test_true_weights_pass_the_test_of_a_factor_of_one_and_wrong_ones_do_not(
    repetitions: list[VarianceComponents],
) -> None:
    p = np.array([r["image"].p_value for r in repetitions])
    assert stats.kstest(p, "uniform").pvalue > 1 - CONFIDENCE
    for kind in WRONG:
        wrong = np.array([r[kind].p_value for r in repetitions])
        assert np.median(wrong) < 1e-3


def test_every_repetition_comes_to_rest_with_a_standard_deviation_of_unit_weight_of_one(
    repetitions: list[VarianceComponents],
) -> None:
    """Σ v_gᵀP_g v_g = Σ r_g; the certificate, the only part in no group, has little to say."""
    assert all(r.converged for r in repetitions)
    for r in repetitions:
        v = r.solution.equations.residuals(r.solution.state)
        at = group_redundancy(r.solution, r.groups)
        np.testing.assert_allclose(at.squares, at.redundancy, rtol=1e-3)
        rest = v[r.groups.of_row < 0]
        expected = at.redundancy.sum() + rest @ rest
        assert r.solution.vtpv == pytest.approx(expected, rel=1e-3)


@LONG
def test_cameras_and_instruments_are_told_apart() -> None:
    found = estimate_variance_components(two_cameras_two_instruments(), groups="instrument")
    names = {c.name for c in found.components}
    assert {"camera D3", "camera D4", "instrument T1", "instrument T2", "direction"} < names
    true = {"camera D3": 1.0, "camera D4": 3.0, "instrument T1": 1.0, "instrument T2": 0.5}
    for name, factor in true.items():
        c = found[name]
        low, high = c.interval(confidence=CONFIDENCE)
        assert low < factor < high, name


def test_sessions_of_correlated_vectors_are_weighted_as_a_whole() -> None:
    found = estimate_variance_components(gnss(), groups=by_letter)
    low, high = found["r"].interval(confidence=CONFIDENCE)
    assert low < 2.0 < high
    assert low > 1.0
    low, high = found["s"].interval(confidence=CONFIDENCE)
    assert low < 1.0 < high
    before = compile_network(found.solution.network)
    for old, new in zip(before.clusters, found.solution.equations.clusters, strict=True):
        factor = found.factors[old.rows[0]]
        np.testing.assert_allclose(new.whitener * factor, old.whitener, rtol=ROUNDING)


def test_the_factor_of_every_row_is_what_its_standard_deviation_was_multiplied_by() -> None:
    network = small_block()
    found = estimate_variance_components(
        network, groups={"level": level_ids(network)}, tolerance=AT_REST
    )
    before = compile_network(network).weighted_at(found.solution.state).sigmas()
    after = found.solution.observations.sigmas
    np.testing.assert_allclose(after, before * found.factors, rtol=ROUNDING)
    kinds = np.array(found.solution.observations.kinds)
    assert np.all(found.factors[kinds != "height_difference"] == 1.0)
    assert np.all(found.factors[kinds == "height_difference"] == found["level"].factor)


def level_ids(network: Network) -> list[str]:
    return [i for i, o in network.observations.items() if isinstance(o, HeightDifference)]


# -- one group: what is known in closed form ------------------------------------------------------

PRINTED = {
    # m0 a posteriori / m0 a priori of the .xml files, 8 digits; degrees of freedom.
    "stroner-levelling-a": (2.0518565 / 3.0, 8),
    "mikhail-7.4": (63.583349 / 10.0, 4),
    "mikhail-7.4-cov": (63.583349 / 10.0, 4),
}


@pytest.mark.parametrize("name", PRINTED)
def test_one_group_is_the_standard_deviation_of_unit_weight_of_gama(name: str) -> None:
    """With one group S = r: f = σ̂0, σ_f = f/√(2r), and its test is the global test.

    The covariance of mikhail-7.4-cov is printed with 4 digits.
    """
    factor, freedom = PRINTED[name]
    network = read_gama(data_dir("gama_levelling") / f"{name}.gkf")
    found = estimate_variance_components(network)
    (c,) = found.components
    assert c.factor == pytest.approx(factor, rel=1e-3 if name.endswith("cov") else 1e-7)
    assert c.freedom == pytest.approx(freedom, rel=ROUNDING)
    assert c.redundancy == pytest.approx(freedom, rel=ROUNDING)
    assert c.sigma == pytest.approx(c.factor / np.sqrt(2 * freedom), rel=ROUNDING)
    assert c.state == "uncertain"
    assert found.iterations == 2
    before = adjust(network)
    accepted = [global_test(before, alpha=a).accepted for a in (0.5, 0.1, 0.01, 1e-9)]
    assert accepted == [c.p_value >= 1 - p for p in (0.5, 0.9, 0.99, 1 - 1e-9)]
    low, high = c.interval(confidence=0.9)
    test = global_test(before, alpha=0.1)
    assert low == pytest.approx(c.factor / test.upper, rel=ROUNDING)
    assert high == pytest.approx(c.factor / test.lower, rel=ROUNDING)


# -- what cannot be estimated ---------------------------------------------------------------------


def test_a_group_without_redundancy_keeps_its_weight_and_says_so() -> None:
    """A single line to a point of its own is checked by nothing; one more line, by half."""
    lines = [*loops({"a": 2.0}), ("b0", "A", "I", 1.0), ("c0", "A", "B", 1.0)]
    network = levelling(lines, seed=1, points="ABCDEFGHI")
    found = estimate_variance_components(network, groups=by_letter)
    assert found.converged
    for name in "bc":
        held = found[name]
        assert held.state == "held"
        assert held.factor == 1.0
        assert np.isnan(held.sigma)
        assert np.isnan(held.p_value)
        assert held.interval() == (0.0, np.inf)
        assert "less than 1" in held.note
        assert "a-priori" in held.note
    assert found["b"].redundancy == pytest.approx(0.0, abs=ROUNDING)
    assert 0.5 < found["c"].redundancy < 1.0
    assert found["a"].state == "estimated"
    at = [c.name for c in found.components].index("b")
    assert not found.correlation[at].any()


def test_a_network_that_checks_nothing_keeps_all_weights() -> None:
    network = levelling([("a0", "A", "B", 1.0), ("b0", "B", "C", 1.0)], seed=1, points="ABC")
    found = estimate_variance_components(network, groups=by_letter)
    assert found.converged
    assert "no group" in found.reason
    assert found.iterations == 1
    assert [c.state for c in found.components] == ["held", "held"]


def test_a_group_with_little_redundancy_is_estimated_and_warned_of() -> None:
    three = {"a": 2.0, "b": 1.0, "c": 1.0}
    found = estimate_variance_components(levelling(loops(three), seed=2), groups=by_letter)
    many = levelling(loops(three, repeated=4), seed=2)
    for c in found.components:
        assert c.state == "uncertain"
        assert c.freedom < 10
        assert c.freedom < c.redundancy
        assert f"{c.freedom:.1f} degrees of freedom" in c.note
    for c in estimate_variance_components(many, groups=by_letter).components:
        assert c.state == "estimated"
        assert c.freedom > 10
        assert c.note == ""


def test_observations_that_agree_too_well_are_stopped_on_the_way_to_zero() -> None:
    """What was taken from the adjustment of the others has no residuals whatever its σ; the
    smaller it is, the less redundancy there is to say so."""
    network = levelling(loops({"a": 2.0}, repeated=2), seed=3)
    others = adjust(network)
    for i, name in enumerate("BCDEFGH"):
        rise = float(others.point(name)[2])
        network.add(HeightDifference("A", name, rise, sigma=MM, id=f"b{i}"))
    found = estimate_variance_components(network, groups=by_letter)
    assert found.converged
    b = found["b"]
    assert b.state == "driven to zero"
    assert 0.01 < b.factor < 0.5
    assert 0.1 < b.redundancy < 1
    assert "not distinguishable from zero" in b.note
    assert np.isnan(b.sigma)
    low, high = found["a"].interval(confidence=CONFIDENCE)
    assert low < 2.0 < high


def test_observations_of_one_value_again_and_again_are_stopped_at_the_smallest_factor() -> None:
    """Without any discrepancy among themselves redundancy stays, residuals vanish."""
    twice = [(f"b{i}", "A", p, 0.0) for i, p in enumerate("BCDEFGH" * 2)]
    found = estimate_variance_components(
        levelling(loops({"a": 2.0}) + twice, seed=3), groups=by_letter, max_iterations=100
    )
    assert found.converged
    assert found["b"].state == "driven to zero"
    assert found["b"].redundancy > 6.9
    assert found["b"].factor < 1e-4


def test_groups_whose_errors_look_alike_are_not_told_apart() -> None:
    """Each height is levelled once by either level, and by nothing else: v_a = −v_b. Only the sum
    of their variances shows, and its estimate is right."""
    points = [f"P{i}" for i in range(40)]
    lines = [(f"{g}{i}", "P0", p, 3.0) for i, p in enumerate(points[1:]) for g in "ab"]
    network = levelling(lines, seed=4, points=points)
    found = estimate_variance_components(network, groups=by_letter)
    assert found.converged
    for name, other in ("ab", "ba"):
        c = found[name]
        assert c.state == "not separable"
        assert other in c.note.split("from those of ")[1]
        assert "at all" in c.note
        assert np.isinf(c.sigma)
        assert np.isnan(c.p_value)
        # What is not seen stays as it was: equal.
        assert c.factor == pytest.approx(found[other].factor, rel=ROUNDING)
    together = estimate_variance_components(network)
    variance = found["a"].factor ** 2 + found["b"].factor ** 2
    assert variance == pytest.approx(2 * together["height_difference"].factor ** 2, rel=1e-6)


def test_groups_that_are_hardly_told_apart_are_warned_of() -> None:
    """Some heights are levelled by one of them again: that tells the two a little."""
    points = [f"P{i}" for i in range(200)]
    lines = [(f"{g}{i}", "P0", p, 1.0) for i, p in enumerate(points[1:]) for g in "ab"]
    lines += [(f"a{i}'", "P0", f"P{i}", 1.0) for i in range(1, 11)]
    found = estimate_variance_components(levelling(lines, seed=8, points=points), groups=by_letter)
    assert found.converged
    assert -1 < found.correlation[0, 1] < -0.9
    for name, other in ("ab", "ba"):
        assert found[name].state == "not separable"
        assert other in found[name].note.split("from those of ")[1]
        assert np.isfinite(found[name].sigma)


@pytest.mark.parametrize("claimed", [1e-1, 1e-3])
def test_weights_that_are_far_too_great_give_way_to_the_truth(claimed: float) -> None:
    """With σ a thousandth of the truth, lines b have a redundancy of 1e-5 and push their errors
    upon the others; what is left of them in their own residuals is still too much for that."""
    direct = [(f"b{i}", "A", p, 1.0) for i, p in enumerate("BCDEFGH")]
    network = levelling(loops({"a": 1.0}) + direct, seed=9)
    rescaled(network, {i: claimed for i in network.observations if i.startswith("b")})
    before = group_redundancy(adjust(network), observation_groups(adjust(network), by_letter))
    assert before.redundancy[1] < 1e-3 if claimed < 0.01 else before.redundancy[1] < 1
    found = estimate_variance_components(network, groups=by_letter)
    assert found.converged
    for name, true in (("a", 1.0), ("b", 1.0 / claimed)):
        low, high = found[name].interval(confidence=CONFIDENCE)
        assert low < true < high


def test_a_blunder_is_not_taken_for_a_variance_component() -> None:
    """One line alone never has a redundancy of 1, however large its σ."""
    lines = [*loops({"a": 1.0}), ("b0", "A", "B", 0.0)]
    network = levelling(lines, seed=1)
    o = network.observations["b0"]
    assert isinstance(o, HeightDifference)
    network.observations["b0"] = replace(o, value=o.value + 0.05)
    found = estimate_variance_components(network, groups=by_letter)
    assert found.converged
    assert found["b"].state == "held"
    assert found["b"].factor == 1.0


# -- groups ---------------------------------------------------------------------------------------


def refusal(network: Network, groups: GroupChoice) -> str:
    with pytest.raises(InputError) as error:
        estimate_variance_components(network, groups=groups)
    return str(error.value)


def test_groups_by_photo_and_camera_leave_other_kinds_alone() -> None:
    solution = adjust(small_block())
    photos = observation_groups(solution, "photo")
    kinds = [k for k in dict.fromkeys(solution.observations.kinds) if k != "image"]
    assert set(photos.names) == {*kinds, "photo F1", "photo F2", "photo F3", "photo F4"}
    of_f2 = photos.of_row == photos.names.index("photo F2")
    ids = {solution.observations[i].id for i in np.flatnonzero(of_f2).tolist()}
    assert ids == {f"F2/P{i}" for i in range(1, 13)}
    assert set(observation_groups(solution, "camera").names) == {*kinds, "camera D3"}
    assert set(observation_groups(solution, "kind").names) == {*kinds, "image"}
    assert photos.sizes.sum() == len(solution.observations)


def test_a_correlated_session_cannot_be_split() -> None:
    message = refusal(gnss(), lambda o: o.id[-1])
    assert "one factor holds for a covariance" in message
    assert message.count("r1-") + message.count("s0-") >= 2
    # One line for each of the sessions that touch several groups, not only the first.
    assert len(message.splitlines()) == 12


def test_correlated_components_of_a_vector_cannot_be_split() -> None:
    message = refusal(gnss(), lambda o: o.component if o.id == "v3" else "rest")
    assert "v3" in message
    assert "'x'" in message
    assert len(message.splitlines()) == 1


def test_components_without_correlation_may_be_split() -> None:
    found = estimate_variance_components(
        small_block(), groups=lambda o: f"image {o.component}" if o.kind == "image" else None
    )
    assert [c.name for c in found.components] == ["image x", "image y"]
    assert found.converged


@pytest.mark.parametrize(
    ("groups", "said"),
    [
        ("kinds", "one of kind, camera, photo, instrument, frame; did you mean 'kind'?"),
        ({}, "no groups"),
        ({"a": ["a0"], "b": []}, "it has no observations"),
        ({"a": ["a0", "x1", "x2"]}, "unknown observations x1, x2; known: a0, b1"),
        ({"a": ["a0"], "b": ["b1", "a0"]}, "it is in the groups 'a' and 'b'"),
        ({"a": "a0"}, "give a list of ids"),
        (lambda _: None, "no observation is in any group"),
        (lambda _: 3, "a group must be text"),
    ],
)
def test_groups_that_make_no_sense_are_refused_by_name(groups: GroupChoice, said: str) -> None:
    assert said in refusal(levelling(loops({"a": 1.0, "b": 1.0}), seed=1), groups)


def test_an_unknown_component_is_refused_by_name() -> None:
    found = estimate_variance_components(
        levelling(loops({"a": 1.0, "b": 1.0}), seed=1), groups=by_letter
    )
    with pytest.raises(InputError, match="unknown group 'c'; known: a, b"):
        found["c"]
    with pytest.raises(InputError, match="between 0 and 1"):
        found["a"].interval(confidence=95)


# -- the way there --------------------------------------------------------------------------------


def test_an_iteration_that_is_cut_short_says_so() -> None:
    found = estimate_variance_components(industry_block(1), groups=measured_kinds, max_iterations=2)
    assert not found.converged
    assert "stopped after 2 adjustments" in found.reason
    np.testing.assert_allclose(
        found.solution.observations.sigmas,
        adjust(industry_block(1)).observations.sigmas * found.factors,
        rtol=ROUNDING,
    )


@pytest.mark.parametrize("factor", [0.01, 0.1, 10.0, 100.0])
def test_the_start_does_not_matter(factor: float) -> None:
    """Wrong σ of one group, by whatever factor, lead to the same precision."""
    network = levelling(loops({"a": 1.0, "b": 1.0}, repeated=2), seed=7)
    reference = estimate_variance_components(network, groups=by_letter, tolerance=AT_REST)
    rescaled(network, {i: factor for i in network.observations if i.startswith("b")})
    found = estimate_variance_components(network, groups=by_letter, tolerance=AT_REST)
    assert found["a"].factor == pytest.approx(reference["a"].factor, rel=AS_DENSE)
    assert found["b"].factor * factor == pytest.approx(reference["b"].factor, rel=AS_DENSE)
    assert found["b"].sigma * factor == pytest.approx(reference["b"].sigma, rel=AS_DENSE)


def test_stochastic_traces_agree_with_the_exact_ones() -> None:
    """r and B without any probes; the off-diagonal of S to a tenth, σ to a few per cent."""
    solution = adjust(simulate_industry_block(1).network)
    groups = observation_groups(solution, "kind")
    exact = group_redundancy(solution, groups, exact=True)
    probed = group_redundancy(solution, groups, exact=False, seed=1)
    assert exact.exact
    assert not probed.exact
    assert exact.redundancy.sum() == pytest.approx(solution.redundancy, rel=1e-6)
    np.testing.assert_allclose(probed.redundancy, exact.redundancy, rtol=1e-6)
    np.testing.assert_allclose(probed.average, exact.average, rtol=1e-6, atol=1e-6)
    good = sharpened_redundancy(probed, solution, groups, seed=2)
    assert sharpened_redundancy(exact, solution, groups) is exact
    np.testing.assert_allclose(good.information, exact.information, rtol=0.15, atol=0.05)
    of_exact, of_probes = (np.sqrt(np.diag(np.linalg.inv(at.information))) for at in (exact, good))
    np.testing.assert_allclose(of_probes, of_exact, rtol=0.05)
    for at in (exact, good):
        np.testing.assert_allclose(at.information.sum(axis=1), at.redundancy, rtol=1e-9)


@pytest.mark.parametrize("make", [partial(free_block, 2), gnss])
def test_large_networks_need_no_dense_matrix_for_what_decides(make: Callable[[], Network]) -> None:
    """q, r and B come from factor and redundancy numbers, in free networks and with clusters."""
    solution = adjust(make())
    groups = observation_groups(solution, by_letter if make is gnss else "kind")
    exact = group_redundancy(solution, groups, exact=True)
    other = group_redundancy(solution, groups, exact=False)
    scale = float(exact.squares.max())
    np.testing.assert_allclose(other.squares, exact.squares, rtol=ROUNDING)
    np.testing.assert_allclose(other.redundancy, exact.redundancy, rtol=0, atol=1e-6)
    np.testing.assert_allclose(other.average, exact.average, rtol=0, atol=1e-6 * scale)


@LONG
def test_large_networks_get_the_same_components(monkeypatch: pytest.MonkeyPatch) -> None:
    network = industry_block(2)
    exact = estimate_variance_components(network, groups=measured_kinds, tolerance=1e-6)
    monkeypatch.setattr("factorgraph_adj.quality.observation_groups.EXACT_ROWS", 0)
    probed = estimate_variance_components(network, groups=measured_kinds, tolerance=1e-6)
    assert exact.exact
    assert not probed.exact
    for a, b in zip(exact.components, probed.components, strict=True):
        assert b.factor == pytest.approx(a.factor, rel=1e-6)
        assert b.sigma == pytest.approx(a.sigma, rel=0.05)


def test_factors_of_ones_own_keep_their_weight_and_take_part() -> None:
    """A range factor for a line does the same as its distance in no group."""
    network = small_block()
    k = build_graph(network).keys
    line = (k.key("point", "P1"), k.key("point", "P12"))
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.0005)
    a, b = network.points["P1"].coordinates, network.points["P12"].coordinates
    length = float(np.linalg.norm(np.subtract(a, b)))
    factor = gtsam.RangeFactor3(*line, length, noise)
    ids = level_ids(network)
    by_factor = estimate_variance_components(network, groups={"level": ids}, extra_factors=[factor])
    network.add(SlopeDistance("P1", "P12", length, sigma=0.0005, id="line"))
    by_distance = estimate_variance_components(network, groups={"level": ids})
    one, other = by_factor["level"], by_distance["level"]
    assert one.factor == pytest.approx(other.factor, rel=1e-6)
    assert one.sigma == pytest.approx(other.sigma, rel=1e-6)


@pytest.mark.parametrize("name", ["small block", "sessions"])
def test_the_transposed_product_belongs_to_the_product(name: str) -> None:
    """⟨A x, z⟩ = ⟨x, Aᵀz⟩, clusters among the rows."""
    solution = adjust(small_block() if name == "small block" else gnss())
    system = solution.normal().system
    rng = np.random.default_rng(1)
    for k in (1, 5):
        x = rng.standard_normal((system.unknowns.n_columns, k))
        z = rng.standard_normal((system.equations.n_rows, k))
        products = system.times(x).T @ z, x.T @ system.transposed(z)
        np.testing.assert_allclose(*products, rtol=1e-9, atol=1e-6 * np.abs(products[0]).max())


def test_a_component_knows_that_it_is_estimated() -> None:
    c = VarianceComponent("a", 2.0, 0.1, 200.0, 300, "estimated", "")
    assert c.estimated
    assert c.freedom == pytest.approx(200.0)
    assert not replace(c, state="held").estimated


@pytest.mark.parametrize("large", [False, True])
def test_the_last_adjustment_is_a_plain_one_and_those_on_the_way_are_steps(
    large: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four sets of weights and more need two adjustments to the end after the first."""
    if large:
        monkeypatch.setattr("factorgraph_adj.quality.observation_groups.EXACT_ROWS", 0)
    whole = []

    def counted(*args: Any, **options: Any) -> Solution:
        whole.append(readjust(*args, **options))
        return whole[-1]

    monkeypatch.setattr("factorgraph_adj.quality.variance_components.readjust", counted)
    network = industry_block(2)
    found = estimate_variance_components(network, groups=measured_kinds)
    assert found.converged
    assert found.iterations >= 4
    assert 1 <= len(whole) <= min(2, found.iterations - 2)
    assert found.solution is whole[-1]
    assert found.solution.converged
    plain = adjust(network, weights=found.factors**-2.0)
    assert found.solution.vtpv == pytest.approx(plain.vtpv, rel=1e-9)
    sigma = np.sqrt(np.einsum("pii->pi", plain.point_covariances))
    moved = found.solution.state["point"] - plain.state["point"]
    assert np.all(np.abs(moved) <= 1e-4 * sigma + ROUNDING)
    at = group_redundancy(plain, found.groups)
    np.testing.assert_allclose([c.redundancy for c in found.components], at.redundancy, rtol=1e-6)


@LONG
def test_weights_that_move_the_estimates_far_are_adjusted_to_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where one step does not bring the predicted vᵀPv, the network is adjusted."""
    network = industry_block(2)
    expected = estimate_variance_components(network, groups=measured_kinds, tolerance=1e-6)
    whole = []

    def counted(*args: Any, **options: Any) -> Solution:
        whole.append(readjust(*args, **options))
        return whole[-1]

    monkeypatch.setattr("factorgraph_adj.quality.variance_components.readjust", counted)
    monkeypatch.setattr("factorgraph_adj.quality.variance_components.MAX_UNPREDICTED_SHARE", -1.0)
    found = estimate_variance_components(network, groups=measured_kinds, tolerance=1e-6)
    assert len(whole) == found.iterations - 1
    for a, b in zip(found.components, expected.components, strict=True):
        assert a.factor == pytest.approx(b.factor, rel=1e-7)


@LONG
def test_many_groups_of_a_large_network_have_the_components_of_a_small_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every photo a group: S comes from probes, B from its products, R from no matrix."""
    network = industry_block(3)
    exact = estimate_variance_components(network, groups="photo", tolerance=1e-6)
    monkeypatch.setattr("factorgraph_adj.quality.observation_groups.EXACT_ROWS", 0)
    probed = estimate_variance_components(network, groups="photo", tolerance=1e-6)
    assert probed.converged
    assert probed.reason == exact.reason
    for a, b in zip(exact.components, probed.components, strict=True):
        assert (a.name, a.state) == (b.name, b.state)
        assert b.factor == pytest.approx(a.factor, rel=1e-5)
        assert b.redundancy == pytest.approx(a.redundancy, rel=1e-4)
        assert b.sigma == pytest.approx(a.sigma, rel=0.05, nan_ok=True)


def test_probes_serve_for_standard_deviations_as_long_as_the_weights_are_similar(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("factorgraph_adj.quality.observation_groups.EXACT_ROWS", 0)
    monkeypatch.setattr("factorgraph_adj.quality.observation_groups.PROBES_OF_RESULT", 2)
    solution = adjust(industry_block(1))
    groups = observation_groups(solution, "kind")
    at = group_redundancy(solution, groups, probe=True)
    assert sharpened_redundancy(at, solution, groups) is at
    for change, same in ((0.05, True), (0.2, False)):
        other = readjust(solution, np.full(solution.equations.n_rows, np.exp(change)))
        then = group_redundancy(other, groups, earlier=at)
        assert then.probed is at.probed
        assert (sharpened_redundancy(then, other, groups) is then) == same


def test_one_group_of_everything_needs_no_probes(monkeypatch: pytest.MonkeyPatch) -> None:
    network = levelling(loops({"a": 2.0}), seed=5)
    expected = estimate_variance_components(network)["height_difference"]
    monkeypatch.setattr("factorgraph_adj.quality.observation_groups.EXACT_ROWS", 0)
    found = estimate_variance_components(network)
    assert found.exact
    assert found["height_difference"].sigma == pytest.approx(expected.sigma, rel=ROUNDING)
    rest = estimate_variance_components(network, groups={"half": [f"a{i}" for i in range(14)]})
    assert not rest.exact


def test_conjugate_gradients_solve_what_curves_upwards() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((6, 6))
    matrix, right = root @ root.T + np.eye(6), rng.standard_normal(6)
    scale = np.diag(1.0 / np.diag(matrix))
    x = conjugate_gradients(matrix.__matmul__, scale, right, relative=1e-12, least=1e-9)
    assert x is not None
    np.testing.assert_allclose(x, np.linalg.solve(matrix, right), rtol=1e-9)
    nothing = conjugate_gradients(matrix.__matmul__, scale, 0 * right, relative=1e-3, least=1e-9)
    assert nothing is not None
    assert not nothing.any()
    down = matrix - 1.5 * np.linalg.eigvalsh(matrix)[0] * np.eye(6)
    assert conjugate_gradients(down.__matmul__, scale, right, relative=1e-12, least=1e-9) is None


def test_a_trial_finds_the_same_factors_and_leaves_points_on_their_sides():
    network, random = Network("two distances, mirrored"), np.random.default_rng(5)
    network.add_point("P", (20.0, 9.0, 0.0), fixed="z")
    ids: dict[str, list[str]] = {"fine": [], "coarse": []}
    for name, x in {"A": (0.0, 0.0, 0.0), "B": (40.0, 0.0, 0.0)}.items():
        network.add_point(name, x, fixed="xyz")
        d = float(np.hypot(20.0, 9.0))
        for group, true in (("fine", 1.0), ("coarse", 20.0)):
            for _ in range(8):
                value = d + true * MM * random.normal()
                ids[group] += network.add(SlopeDistance(name, "P", value, sigma=MM))
    solution = adjust(network)
    assert solution.second_places
    whole = estimate_variance_components(network, groups=ids)
    trial = components_of_trial(solution, ids)
    assert trial.converged and whole.converged
    for name in ids:
        assert abs(trial[name].factor / whole[name].factor - 1.0) < 1e-3
    assert whole.solution.second_places
    assert not trial.solution.second_places
