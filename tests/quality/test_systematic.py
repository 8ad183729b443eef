"""Significance and correlations of additional parameters, and their backward exclusion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NoReturn

import numpy as np
import pytest
from scipy.stats import binom, norm
from scipy.stats import t as student

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import AdjustmentError, InputError, SingularError
from factorgraph_adj.models.lens import BrownLens, HarmonicLens, Lens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import SlopeDistance, ZenithAngle
from factorgraph_adj.quality.datum_change import s_transform
from factorgraph_adj.quality.parameter_exclusion import exclude_insignificant
from factorgraph_adj.quality.parameter_significance import Significance, significance
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.solve.normal_equations import NormalEquations
from factorgraph_adj.solve.solution import Solution
from tests.networks.aicon import CAMERA as AICON_CAMERA
from tests.networks.aicon import FREE as AICON_FREE
from tests.networks.aicon import read_aicon
from tests.networks.dbat import CAMCAL as DBAT_CAMERA
from tests.networks.dbat import read_camcal
from tests.networks.small_block import small_block
from tests.support.dense import Dense
from tests.support.places import data_dir

LONG = pytest.mark.slow("correlations of a real calibration; short tests take simulated ones")

HALF_OF_PRINTED = 0.5e-3
"""Published correlations have three decimals."""
adjusted = partial(adjust, variance="a-posteriori")


def pairs(test: Significance) -> dict[frozenset[str], float]:
    """Return the strong correlations by the names of two components."""
    return {frozenset((c.a[2], c.b[2])): c.value for c in test.correlations}


# -- published correlations -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def aicon() -> Solution:
    return adjusted(read_aicon(data_dir("aicon_jaicov")))


@pytest.fixture(scope="module")
def camcal_network() -> Network:
    return read_camcal(data_dir("dbat_camcal"))


@pytest.fixture(scope="module")
def camcal(camcal_network: Network) -> Solution:
    return adjusted(camcal_network)


@LONG
def test_strong_correlations_of_a_calibration_are_the_published_ones(aicon: Solution) -> None:
    """AICON 3D Studio prints A1-A2 −.909, Xh-B1 .939, Yh-B2 .800 and nothing else from 0.75."""
    published = {("A1", "A2"): -0.909, ("x0", "B1"): 0.939, ("y0", "B2"): 0.800}
    found = pairs(significance(aicon, correlation=0.75))
    assert set(found) == {frozenset(p) for p in published}
    for pair, value in published.items():
        assert found[frozenset(pair)] == pytest.approx(value, abs=HALF_OF_PRINTED)
    sizes = [abs(c.value) for c in significance(aicon, correlation=0.75).correlations]
    assert sizes == sorted(sizes, reverse=True)


def test_a_good_calibration_is_significant_and_not_overparametrised(aicon: Solution) -> None:
    """All that the report calibrates stays: the t values are its values over its sigmas."""
    test = significance(aicon)
    assert [p.component for p in test.parameters] == list(AICON_FREE)
    assert test.overparametrised == ()
    assert test.insignificant == ()
    published = {"A1": (-1.096069e-4, 2.978787e-8), "B2": (-8.644540e-6, 1.043919e-7)}
    for component, (value, sigma) in published.items():
        tested = test[AICON_CAMERA, component]
        assert tested.significant
        assert tested.t == pytest.approx(value / sigma, rel=1e-6)


def test_the_radial_parameters_of_a_camera_calibration_are_warned_of_by_name(
    camcal: Solution,
) -> None:
    """DBAT: ρ(K2, K3) = −0.979."""
    test = significance(camcal)
    assert pairs(test) == {
        frozenset(("k2", "k3")): pytest.approx(-0.979, abs=HALF_OF_PRINTED),
    }
    assert test.overparametrised == (
        f"k2 of camera {DBAT_CAMERA!r} and k3 are correlated by -0.979",
        f"k1 of camera {DBAT_CAMERA!r} is explained to 94.6 % by the other parameters of the same "
        "camera",
    )


# -- figures against dense matrices ---------------------------------------------------------------


def mixed_block() -> Network:
    """Return the small block with a distance meter and a coefficient of refraction to find."""
    network = small_block(3)
    network.set_distance_meter("EDM", scale=2e-6, sigma_scale=5e-6, zero=0.1, free=["zero"])
    network.set_refraction("ray", value=0.13)
    for ident, o in network.observations.items():
        if isinstance(o, SlopeDistance):
            network.observations[ident] = SlopeDistance(
                **{**vars(o), "instrument": "EDM", "value": o.value + 0.1}
            )
        if isinstance(o, ZenithAngle):
            network.observations[ident] = ZenithAngle(**{**vars(o), "refraction": "ray"})
    return network


@pytest.fixture(scope="module")
def mixed() -> Solution:
    return adjusted(mixed_block())


def test_what_a_parameter_is_tested_against(mixed: Solution) -> None:
    """0; what is given for c, x0, y0, refraction, and whatever is weighted."""
    test = significance(mixed)
    given = dict(
        zip(BrownLens().names, mixed.network.cameras["D3"].values, strict=True),
    )
    expected = {
        ("D3", "c"): given["c"],
        ("D3", "x0"): given["x0"],
        ("D3", "y0"): given["y0"],
        ("D3", "k1"): 0.0,
        ("D3", "k2"): given["k2"],
        ("EDM", "scale"): 2e-6,
        ("EDM", "zero"): 0.0,
        ("ray", "kappa"): 0.13,
    }
    assert {(p.name, p.component): p.reference for p in test.parameters} == expected
    weighted = {(p.name, p.component) for p in test.parameters if p.weighted}
    assert weighted == {("D3", "k2"), ("EDM", "scale")}
    interior = {p.component for p in test.parameters if not p.additional}
    assert interior == {"c", "x0", "y0"}


def test_sigma_and_inflation_are_those_of_dense_matrices(mixed: Solution) -> None:
    """The inflation compares with an adjustment in which the others of the camera are known."""
    test = significance(mixed)
    dense = Dense.at(mixed.equations, mixed.state)
    normal = dense.design.T @ dense.design
    column = np.cumsum(dense.free) - 1
    unknowns = mixed.equations.unknowns
    cofactor = np.linalg.inv(normal)
    for p in test.parameters:
        number = unknowns[p.kind].number[p.name]
        own = unknowns.columns(p.kind, number)
        own = own[unknowns.free[own]]
        names = unknowns.component_names(p.kind, number)
        at = column[unknowns.columns(p.kind, number)[names.index(p.component)]]
        known = np.setdiff1d(column[own], [at])
        left = np.setdiff1d(np.arange(len(normal)), known)
        alone = np.linalg.inv(normal[np.ix_(left, left)])[np.searchsorted(left, at)] @ (left == at)
        assert p.sigma == pytest.approx(mixed.sigma0 * np.sqrt(cofactor[at, at]), rel=1e-6)
        assert p.variance_inflation == pytest.approx(cofactor[at, at] / alone, rel=1e-6)
        assert p.explained == pytest.approx(1 - alone / cofactor[at, at], abs=1e-9)


def test_ties_to_photos_and_points_are_those_of_dense_matrices(mixed: Solution) -> None:
    """A photo's position counts along the axes of its camera."""
    test = significance(mixed, correlation=0.3)
    unknowns = mixed.equations.unknowns
    datum = np.zeros(unknowns.n_columns, dtype=bool)
    cofactor = Dense.at(mixed.equations, mixed.state).cofactor(datum)

    def strongest(kind: str, at: int) -> tuple[str, str, float, int]:
        best, count = ("", "", 0.0), 0
        for number, name in enumerate(unknowns[kind].names):
            own = unknowns.columns(kind, number)
            if not len(own):
                continue
            turn = np.eye(len(own))
            if kind == "pose":
                turn[3:, 3:] = mixed.state["pose"][number, :9].reshape(3, 3).T
            cross = turn @ cofactor[own, at]
            variance = np.diag(turn @ cofactor[np.ix_(own, own)] @ turn.T)
            rho = cross / np.sqrt(np.where(variance > 0, variance, np.inf) * cofactor[at, at])
            i = int(np.argmax(np.abs(rho)))
            count += int(abs(rho[i]) >= 0.3)
            if abs(rho[i]) > abs(best[2]):
                best = (name, unknowns.component_names(kind, number)[i], float(rho[i]))
        return (*best, count)

    for p in test.parameters:
        number = unknowns[p.kind].number[p.name]
        names = unknowns.component_names(p.kind, number)
        at = int(unknowns.columns(p.kind, number)[names.index(p.component)])
        for kind, tie in (("pose", p.orientation), ("point", p.point)):
            if kind == "pose" and p.kind != "calibration":
                assert tie is None
                continue
            assert tie is not None
            name, component, rho, count = strongest(kind, at)
            assert (tie.name, tie.component, tie.count) == (name, component, count)
            assert tie.correlation == pytest.approx(rho, abs=1e-6)


def test_student_takes_the_place_of_the_normal_distribution_a_posteriori(mixed: Solution) -> None:
    test = significance(mixed, alpha=0.01)
    assert test.critical == pytest.approx(student.ppf(0.995, mixed.redundancy))
    prior = significance(adjust(mixed.network), alpha=0.01)
    assert prior.critical == pytest.approx(norm.ppf(0.995))
    tested = test["D3", "k1"]
    assert tested.t * mixed.sigma0 == pytest.approx(prior["D3", "k1"].t, rel=1e-6)
    assert tested.significant == (abs(tested.t) > test.critical)


def test_another_datum_changes_nothing(mixed: Solution) -> None:
    assert significance(s_transform(mixed, ["P1", "P4", "P8"])) == significance(mixed)


# -- backward exclusion ---------------------------------------------------------------------------

SIGMA = 0.003
"""Of image coordinates, mm."""
BROWN = ("k1", "k2", "p1", "p2", "b1", "b2")


def test_field(
    values: Mapping[str, float],
    free: Sequence[str],
    *,
    lens: Lens | None = None,
    per_photo: bool = False,
    sigma: float = SIGMA,
) -> Network:
    """Return six convergent photos, some of them turned, of 24 points with four of control."""
    network = Network("test field")
    rng = np.random.default_rng(7)
    xy = np.stack(np.meshgrid(np.linspace(-2, 2, 6), np.linspace(-1.6, 1.6, 4)), 2).reshape(-1, 2)
    for i, (x, y) in enumerate(xy.tolist()):
        at = (x, y, float(rng.uniform(0.0, 1.2)))
        network.add_point(f"P{i}", at, fixed="xyz" if i in (0, 5, 18, 23) else "")
    network.add_camera(
        "cam",
        BrownLens() if lens is None else lens,
        {"c": 28.0, **values},
        free=("c", "x0", "y0", *free),
        per_photo=per_photo,
    )
    for k in range(6):
        angle = 2 * np.pi * k / 6
        centre = np.array([3 * np.cos(angle), 3 * np.sin(angle), 5.0])
        rotation = look_at(centre, np.array([0.0, 0.0, 0.4]))
        rotation = rotation @ exp_rotation(np.array([0.0, 0.0, np.pi / 2 * (k % 4)]))
        network.add_photo(f"F{k}", "cam", position=centre.tolist(), rotation=rotation)
        no_image = np.zeros((len(xy), 2))
        network.add_image_points(f"F{k}", list(network.points), no_image, sigma=sigma)
    return network


test_field.__test__ = False  # type: ignore[attr-defined]


def without_errors(plan: Network) -> Network:
    """Return measurements as they should be, with the plan's standard deviations."""
    exact = plan.copy()
    photo, point, xy, sigma = plan.images.columns()
    exact.images = type(plan.images)()
    exact.images.append(photo, point, xy, 1e-9 * sigma)
    measured = measure(exact, seed=0)
    _, _, xy, _ = measured.images.columns()
    measured.images = type(plan.images)()
    measured.images.append(photo, point, xy, sigma)
    return measured


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
def test_only_the_real_parameter_stays_and_false_ones_pass_as_often_as_alpha_says() -> None:
    """k1 alone is real. 24 blocks, α = 20 %, counts inside 99.9 % of a binomial distribution.

    The t values of the five others in the first adjustment are tests of the stated size. What is
    left at the end has passed tests among fewer parameters: about as many again.
    """
    alpha, blocks = 0.2, 24
    plan = test_field({"k1": -1e-4}, BROWN)
    first, left = Counter[str](), Counter[str]()
    for seed in range(blocks):
        result = exclude_insignificant(measure(plan, seed=seed), alpha=alpha)
        everything = significance(result.first, alpha=alpha, ties=False)
        first.update(p.component for p in everything.parameters if p.additional and p.significant)
        remaining = [p for p in result.significance.parameters if p.additional]
        left.update(p.component for p in remaining)
        assert all(p.significant for p in remaining)
        names = {p.component for p in remaining} | {e.tested.component for e in result.excluded}
        assert names == set(BROWN)
        assert [e.round for e in result.excluded] == list(range(1, len(result.excluded) + 1))
    low, high = binom.ppf([0.0005, 0.9995], blocks * 5, alpha)
    for count in (first, left):
        assert count["k1"] == blocks
        assert low <= count.total() - blocks <= high


def test_holding_a_parameter_makes_vtpv_grow_by_its_t_squared() -> None:
    """True for linear observation equations; with errors this small these are to a thousandth."""
    network = measure(test_field({"k1": -1e-4}, BROWN, sigma=SIGMA / 10), seed=1)
    result = exclude_insignificant(network)
    assert len(result.excluded) == 5
    squares = [e.tested.t**2 for e in result.excluded]
    assert result.growth == pytest.approx(sum(squares), rel=1e-3)
    assert result.growth == pytest.approx(result.solution.vtpv - result.first.vtpv)
    assert result.solution.redundancy == result.first.redundancy + 5
    held = result.solution.calibration("cam")
    assert {n: held[n] for n in BROWN if n != "k1"} == dict.fromkeys(BROWN[1:], 0.0)


def test_the_network_that_was_given_is_not_changed() -> None:
    network = measure(test_field({"k1": -1e-4}, BROWN), seed=1)
    camera = network.cameras["cam"]
    result = exclude_insignificant(network)
    assert network.cameras["cam"] is camera
    assert result.first.network is network
    assert result.solution.network.cameras["cam"] != camera


def test_of_two_correlated_parameters_that_both_look_superfluous_one_stays() -> None:
    """Images without errors of a small k1: beside k2 it is 0.9 σ, alone 2.2 σ."""
    k1 = -4.5e-6
    network = without_errors(test_field({"k1": k1}, ("k1", "k2")))
    first = significance(adjust(network))
    assert [p.component for p in first.insignificant] == ["k2", "k1"]
    result = exclude_insignificant(network)
    assert [e.tested.component for e in result.excluded] == ["k2"]
    assert result.significance["cam", "k1"].significant
    assert result.significance["cam", "k1"].value == pytest.approx(k1, rel=1e-6)


def test_significant_parameters_are_left_in_for_all_their_correlation(
    camcal_network: Network, camcal: Solution
) -> None:
    result = exclude_insignificant(camcal_network, variance="a-posteriori")
    assert result.excluded == ()
    assert result.growth == 0.0
    assert result.solution.sigma0 == pytest.approx(camcal.sigma0, rel=1e-9)


def test_one_of_a_correlated_pair_is_excluded_where_that_is_asked_for(
    camcal_network: Network,
) -> None:
    """K2 and K3, −0.979, 17 and 20 σ: without K2 σ̂0 is 4 % larger."""
    result = exclude_insignificant(camcal_network, variance="a-posteriori", correlation=0.95)
    (only,) = result.excluded
    assert (only.tested.component, only.reason) == ("k2", "correlated")
    assert only.partner == ("calibration", DBAT_CAMERA, "k3")
    assert only.correlation == pytest.approx(-0.979, abs=HALF_OF_PRINTED)
    assert result.significance.correlations == ()
    assert result.solution.sigma0 > 1.03 * result.first.sigma0
    assert str(only).startswith(f"k2 of camera {DBAT_CAMERA!r} held at 0: |t| = 17.0")


def test_interior_orientation_and_what_shall_be_kept_stay() -> None:
    """c, x0, y0 are exactly as given, and p1 is 0: none differs from its reference."""
    network = without_errors(test_field({}, BROWN))
    result = exclude_insignificant(network, keep=["p1"])
    left = [p.component for p in result.significance.parameters]
    assert left == ["c", "x0", "y0", "p1"]
    assert not any(p.significant for p in result.significance.parameters)


def test_a_parameter_of_cameras_with_a_calibration_for_each_photo_is_excluded_for_all() -> None:
    """k1 is real, k2 is not: it must be insignificant in every photo."""
    plan = test_field({"k1": -2e-4}, ("k1", "k2"), per_photo=True)
    result = exclude_insignificant(without_errors(plan))
    assert [e.tested.component for e in result.excluded] == ["k2"]
    left = {(p.name, p.component) for p in result.significance.parameters if p.additional}
    assert left == {(f"cam@F{k}", "k1") for k in range(6)}
    tested = result.excluded[0].tested
    others = [p for p in significance(result.first).parameters if p.component == "k2"]
    assert abs(tested.t) == max(abs(p.t) for p in others)


def test_distance_meters_and_refraction_are_tested_and_excluded_too() -> None:
    """The zero constant of 100 mm is real; scale and refraction are as given."""
    network = mixed_block()
    result = exclude_insignificant(network)
    left = {(p.name, p.component) for p in result.significance.parameters if p.additional}
    assert left == {("D3", "k1"), ("D3", "k2"), ("EDM", "zero")}
    scale, kappa = result.excluded
    assert (scale.tested.label, scale.reason) == (("edm", "EDM", "scale"), "not significant")
    assert (kappa.tested.label, kappa.reason) == (("refraction", "ray", "kappa"), "not significant")
    assert str(kappa).startswith("kappa of refraction 'ray' held at 0.13: |t| = 0.7")
    meter = result.solution.network.distance_meters["EDM"]
    assert (meter.values[0], meter.fixed, meter.sigma) == (2e-6, (True, False), (np.inf, np.inf))
    refraction = result.solution.network.refractions["ray"]
    assert (refraction.values, refraction.fixed) == ((0.13,), (True,))
    # Holding what was weighted takes its given value from the observations.
    assert result.solution.n_observations == result.first.n_observations - 1


# -- overparametrised cameras ---------------------------------------------------------------------


def flat_scene(lens: Lens, free: Sequence[str], *, tilted: bool, relief: float = 0.0) -> Network:
    """Return six photos of a horizontal plane, from above or tilted towards its middle."""
    network = Network("flat scene")
    rng = np.random.default_rng(3)
    axis = np.linspace(-2, 2, 7)
    for i, (x, y) in enumerate((x, y) for x in axis.tolist() for y in axis.tolist()):
        at = (x, y, relief * float(rng.uniform()))
        network.add_point(f"P{i}", at, fixed="xyz" if i in (0, 6, 42, 48) else "")
    network.add_camera("P31", lens, {"c": 28.0}, free=("c", "x0", "y0", *free))
    for k in range(6):
        x, y = (-1.0, 0.0, 1.0)[k % 3], (-0.8, 0.8)[k // 3]
        centre = np.array([2 * x, 2 * y, 5.0]) if tilted else np.array([x, y, 5.0])
        target = np.zeros(3) if tilted else np.array([x, y + 1e-3, 0.0])
        rotation = look_at(centre, target) @ exp_rotation(np.array([0.0, 0.0, np.pi / 2 * k]))
        network.add_photo(f"F{k}", "P31", position=centre.tolist(), rotation=rotation)
        no_image = np.zeros((len(network.points), 2))
        network.add_image_points(f"F{k}", list(network.points), no_image, sigma=SIGMA)
    return network


def test_a_harmonic_lens_on_a_flat_scene_is_overparametrised_by_name() -> None:
    """Its a11, a31 (b11, b31) do to a plane what shifts of the principal point and tilts do."""
    lens = HarmonicLens(reference_radius=12.0)
    network = measure(flat_scene(lens, lens.names[4:], tilted=True), seed=1)
    test = significance(adjust(network))
    assert set(pairs(test)) == {
        frozenset(p) for p in (("x0", "a31"), ("x0", "a11"), ("y0", "b31"), ("y0", "b11"))
    }
    text = "\n".join(test.overparametrised)
    assert "x0 of camera 'P31' and a31 are correlated by -0.9" in text
    for component, part in (("x0", "ry"), ("y0", "rx"), ("a31", "ry"), ("b31", "rx")):
        assert f"{component} of camera 'P31' and {part} of photo 'F" in text
    assert "; 6 photos in all" in text
    assert not {"a22", "b22", "a33", "b33"} & set(text.split())


def test_vertical_photos_of_flat_ground_cannot_tell_c_from_the_flying_height() -> None:
    network = measure(flat_scene(BrownLens(), (), tilted=False, relief=0.3), seed=1)
    test = significance(adjust(network))
    tie = test["P31", "c"].orientation
    assert tie is not None
    assert (tie.component, tie.count) == ("z", 6)
    assert abs(tie.correlation) > 0.99
    assert any(
        s.startswith("c of camera 'P31' and z of photo 'F") and s.endswith("; 6 photos in all")
        for s in test.overparametrised
    )


def test_a_parameter_that_several_others_explain_together_is_named() -> None:
    """Three radial terms on a small test field: k2 is tied to both others at once."""
    network = measure(test_field({}, ("k1", "k2", "k3")), seed=1)
    test = significance(adjust(network), correlation=0.999)
    assert test.correlations == ()
    loose = significance(adjust(network), correlation=0.985)
    named = [s for s in loose.overparametrised if "is explained to" in s]
    expected = [
        p.component
        for p in loose.parameters
        if p.explained >= 0.985**2 and p.component not in set().union(*pairs(loose), ())
    ]
    assert [s.split()[0] for s in named] == expected
    assert expected


# -- errors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, float("nan")])
def test_an_alpha_that_is_no_probability_is_refused(mixed: Solution, alpha: float) -> None:
    with pytest.raises(InputError, match="alpha must lie between 0 and 1, not"):
        significance(mixed, alpha=alpha)


@pytest.mark.parametrize("limit", [0.0, 1.1, -0.9])
def test_a_limit_that_is_no_correlation_is_refused(mixed: Solution, limit: float) -> None:
    with pytest.raises(InputError, match="correlation must lie above 0 and be 1 at most, not"):
        significance(mixed, correlation=limit)


def test_a_solution_with_singular_normal_equations_has_no_tests(
    mixed: Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    def singular(_: NormalEquations, *__: object, **___: object) -> NoReturn:
        raise SingularError("a pivot vanished")

    monkeypatch.setattr(NormalEquations, "factorise", singular)
    with pytest.raises(
        AdjustmentError, match=r"singular at the solution \(a pivot vanished; no unknown"
    ):
        significance(replace(mixed))


def test_unknown_parameters_are_named_with_what_there_is(mixed: Solution) -> None:
    with pytest.raises(InputError, match=r"no tested parameter \('D3', 'k9'\); known: .*'k1'"):
        significance(mixed)["D3", "k9"]
    with pytest.raises(InputError, match="keep names no free parameter: k9; known: c, x0, y0, k1"):
        exclude_insignificant(mixed.network, keep=["k1", "k9"])


def test_a_network_without_additional_parameters_has_nothing_to_test() -> None:
    network = measure(test_field({}, ()), seed=1)
    result = exclude_insignificant(network)
    assert result.excluded == ()
    assert result.solution is result.first
    assert [p.component for p in result.significance.parameters] == ["c", "x0", "y0"]
