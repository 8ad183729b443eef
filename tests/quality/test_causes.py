"""Causes of misfits: given values and errors that several observations share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csc_array

import factorgraph_adj as fga
from factorgraph_adj.observations.registry import TOTAL_STATION_QUANTITIES
from factorgraph_adj.quality.causes import mistaken_axes
from factorgraph_adj.quality.causes.cause_search import evidence, sized_causes
from factorgraph_adj.quality.causes.mistaken_axes import OrientedPhoto, axes_by_attitude
from factorgraph_adj.quality.causes.shared_error_tests import (
    given_values,
    shared_error_tests,
    whitening_matrix,
)
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.simulated_blocks import simulate_geocentric_block
from tests.benchmarks.causes import adjusted, count, detectable, determined, searched, spoiled
from tests.networks.arriving import CASES
from tests.networks.building_site import site
from tests.networks.exchanged_day import day
from tests.networks.photo_block import block
from tests.support.spoiled import EXCHANGES, PHOTOS, SIZED
from tests.support.studies import cases

LONG = pytest.mark.slow(
    "networks in which a cause has a size that nobody makes; "
    "short tests judge causes of plain networks"
)

QUICKLY_SNOOPED = (0, 2, 3)
"""Seeds of photo blocks; in another one snooping adjusts 200 times, for a minute."""

GIVEN = ("2020-barta-phase_1-2TK", "Caspary", "camcal, model 3", "own cameras", "weighted photos")
"""Networks with held values."""


@pytest.mark.parametrize("name", ["combined block", "gnss", "2020-barta-phase_1-2TK", "held photo"])
def test_columns_explain_what_dense_matrices_say(name: str) -> None:
    """∇̂, Σ_∇ and T² from P Q_vv P as a whole, of columns with whole and partial control."""
    solution = fga.adjust(CASES[name].make())
    n = solution.equations.n_rows
    system = solution.normal().system
    columns = solution.equations.unknowns.n_columns
    a = system.times(np.eye(columns))
    m = np.eye(n) - a @ solution.cofactor_times(a.T)
    w = whitening_matrix(solution.equations).toarray()
    rng = np.random.default_rng(5)
    c = rng.normal(size=(n, 5)) * (rng.random((n, 5)) < 0.3)
    c[0] += 1.0
    groups = [np.array([0]), np.array([1, 2]), np.array([3, 4])]
    found = shared_error_tests(solution, csc_array(w @ c), groups)
    for group, what in zip(groups, found, strict=True):
        z = w @ c[:, group]
        s, u = z.T @ m @ z, z.T @ system.residual
        cov = np.linalg.inv(s)
        assert what.dof == len(group)
        assert what.t2 == pytest.approx(u @ cov @ u, rel=1e-6)
        assert what.error == pytest.approx(-cov @ u, rel=1e-6, abs=1e-9 * np.sqrt(cov.max()))
        assert what.sigma == pytest.approx(np.sqrt(np.diag(cov)), rel=1e-6)


def test_whitening_is_that_of_the_adjustment() -> None:
    for name in ("gnss", "mikhail-7.4-cov", "combined block"):
        solution = fga.adjust(CASES[name].make())
        raw = solution.equations.residuals(solution.state, whitened=False)
        found = whitening_matrix(solution.equations) @ raw
        assert found == pytest.approx(solution.normal().system.residual, abs=1e-9)


@pytest.mark.parametrize("name", GIVEN)
def test_given_values_are_tested_as_if_they_were_free(name: str) -> None:
    """Against an adjustment in which the held components of a point are free."""
    network = CASES[name].make()
    solution = fga.adjust(network)
    checked = 0
    for v in given_values(solution):
        if v.kind != "point" or v.together.dof < len(v.components):
            continue
        point = network.points[v.name]
        fixed = tuple(
            h and axis not in v.components for h, axis in zip(point.fixed, "xyz", strict=True)
        )
        other = network.copy()
        other.points[v.name] = replace(point, fixed=fixed)
        free = fga.adjust(other, start=solution)
        at = ["xyz".index(c) for c in v.components]
        error = (np.array(point.coordinates) - free.point(v.name))[at]
        sigma = np.sqrt(np.diag(free.covariance(v.name)))[at]
        assert v.together.t2 == pytest.approx(solution.vtpv - free.vtpv, rel=0.02, abs=1e-4)
        assert np.abs(v.together.error - error).max() < 0.02 * (sigma + np.abs(error)).max()
        assert v.together.sigma == pytest.approx(sigma, rel=0.02)
        checked += 1
    assert checked


def test_what_alone_holds_the_datum_has_no_test() -> None:
    network = fga.Network("one held point")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (10.0, 0.0, 0.0), fixed="yz")
    for i, value in enumerate((10.001, 9.999)):
        network.add(fga.observations.SlopeDistance("A", "B", value, sigma=0.002, id=str(i)))
    for v in given_values(fga.adjust(network)):
        assert v.together.dof == 0 and np.isnan(v.together.t2)
        assert np.isinf(v.together.sigma).all() and np.isnan(v.w).all()


@pytest.mark.slow(
    "causes are found in blocks of every kind with their sizes; short tests take single hypotheses"
)
@pytest.mark.parametrize("cause", SIZED)
def test_a_cause_is_found_with_its_size(cause: str) -> None:
    """First of all, with its size; three places."""
    done = 0
    for seed in range(3):
        size = 10.0 * detectable(cause, seed)
        if not np.isfinite(size):
            continue
        case = spoiled(cause, seed, size)
        best = searched(adjusted(case.network, case.readings)).found[0]
        assert best.cause == case.cause and case.where in best.where
        # Of a centring its length, of a given point the one coordinate.
        length = float(np.linalg.norm(best.error))
        assert abs(length - size) < 4.0 * best.sigma.max() + 0.02 * size
        done += 1
    assert done >= 2


@pytest.mark.slow(
    "causes are found in blocks of every kind with their sizes; short tests take single hypotheses"
)
@pytest.mark.parametrize("cause", EXCHANGES)
def test_an_exchange_is_found_in_the_clean_solution(cause: str) -> None:
    counted = count(cause, determined(3))
    assert counted.first == counted.named == counted.cases == 3


@pytest.mark.slow(
    "causes are found in blocks of every kind with their sizes; short tests take single hypotheses"
)
@pytest.mark.parametrize("seed", cases(range(4), QUICKLY_SNOOPED))
@pytest.mark.parametrize("cause", PHOTOS)
def test_turned_axes_of_a_photo_are_found_in_the_clean_solution(cause: str, seed: int) -> None:
    counted = count(cause, [seed])
    assert counted.first == counted.named == counted.cases == 1


@pytest.mark.slow(
    "causes are found in blocks of every kind with their sizes; short tests take single hypotheses"
)
@pytest.mark.parametrize(
    ("cause", "seed", "readings"),
    [("wrong_face", 13, 1), ("confused_point", 8, 3), ("exchanged_targets", 39, 6)],
)
def test_readings_that_bend_the_adjustment_are_found_from_the_approximate_values(
    cause: str, seed: int, readings: int
) -> None:
    """Without a second search good readings are rejected in their place, or hardly any fits."""
    case = spoiled(cause, seed, 0.0)
    found = fga.snoop(adjusted(case.network, case.readings))
    wrong = {(case.readings[i].station, case.readings[i].target) for i in case.ids}  # type: ignore[attr-defined]
    aside = [found.solution.network.observations.get(r.id) for r in found.rejected]
    assert aside == [None] * readings and not found.unresolved
    gone = [adjusted(case.network, case.readings).observations[r.id] for r in found.rejected]
    assert {(o.station, o.target) for o in gone} == wrong  # type: ignore[attr-defined]
    best = found.causes.found[0]  # type: ignore[union-attr]
    assert best.cause == case.cause and case.where in best.where


def test_of_readings_that_did_not_bend_it_there_is_one_search() -> None:
    """A single reading that is far off, with which everything else fits."""
    network, readings, _ = site(3)
    readings[5] = replace(readings[5], value=readings[5].value + 20.0)  # type: ignore[attr-defined, call-arg]
    rounds: list[int] = []
    found = fga.snoop(adjusted(network, readings), progress=lambda r: rounds.append(r.number))
    assert rounds == sorted(set(rounds)) and 0 not in rounds
    assert len(found.rejected) >= 1 and not found.unresolved


@pytest.mark.slow(
    "causes are found in blocks of every kind with their sizes; short tests take single hypotheses"
)
def test_a_photo_that_does_not_fit_for_another_reason_is_not_called_mirrored() -> None:
    """Names of its points in another order: no axes make them fit."""
    network = block(4)
    f, p, xy, sigma = network.images.columns()
    mine = f == network.photo_number["F3"]
    names = np.array(list(network.points))[p[mine]]
    network.image_mask(~mine)
    network.add_image_points("F3", np.roll(names, 3).tolist(), xy[mine], sigma=sigma[mine])
    found = fga.snoop(network).causes
    assert found is not None
    assert not [c for c in found.found if "photo 'F3'" in c.where and not c.sizes]


@pytest.mark.slow(
    "causes are found in blocks of every kind with their sizes; short tests take single hypotheses"
)
def test_a_mirrored_photo_is_left_out_with_its_position(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its rays the photo is held anywhere, which its GNSS position would contradict."""
    network = simulate_geocentric_block(seed=1).network
    f, p, xy, sigma = network.images.columns()
    mine = f == network.photo_number["photo 03"]
    names = np.array(list(network.points))[p[mine]].tolist()
    network.image_mask(~mine)
    network.add_image_points("photo 03", names, xy[mine] * [1.0, -1.0], sigma=sigma[mine])
    for ident, o in network.observations.items():
        if "photo 03" in o.photos():  # so weak that it is not rejected with the rays
            weak = {"sigma": (1e3, 1e3, 1e3), "covariance": None}
            network.observations[ident] = replace(o, **weak)  # type: ignore[arg-type]
    found: list[fga.Solution] = []
    unknowns_left_out = mistaken_axes._without

    def seen(*args: Any) -> fga.Solution:
        found.append(unknowns_left_out(*args))
        return found[-1]

    monkeypatch.setattr(mistaken_axes, "_without", seen)
    best = fga.snoop(network).causes.found[0]  # type: ignore[union-attr]
    assert (best.cause, best.where) == ("the direction of y", "of photo 'photo 03'")
    (clean,) = found
    assert not [o for o in clean.network.observations.values() if "photo 03" in o.photos()]
    assert clean.sigma0 < 1.2


def test_mirrored_axes_are_told_apart_by_the_attitude_that_was_given() -> None:
    none, eye = np.zeros(3), np.eye(3)
    turned = exp_rotation(np.array([0.0, 0.0, 0.5 * np.pi]))
    fits = [OrientedPhoto("x and y, exchanged,", turned, none, 1.0, 40.0)]
    fits.append(OrientedPhoto("the direction of y", eye, none, 1.0, 41.0))
    assert axes_by_attitude(fits, eye) == "the direction of y"
    assert axes_by_attitude(fits, turned) == "x and y, exchanged,"
    assert axes_by_attitude(fits, None).startswith("the axes, mirrored")
    assert axes_by_attitude(fits[:1], None) == "x and y, exchanged,"


def test_a_cause_is_one_sentence_in_any_units() -> None:
    case = spoiled("centring", 1, 0.1)
    best = searched(adjusted(case.network, case.readings)).found[0]
    text = str(best)
    assert text.startswith("the centring of the instrument at ") and "2 degrees of freedom" in text
    metres = best.said(lambda _: (1.0, "m"), "{:.3f}".format, space="_")
    assert metres.split(": ")[0] == text.split(": ")[0]
    assert f"east_{best.error[0]:.3f}_±_{best.sigma[0]:.3f}_m" in metres


def test_nothing_is_told_of_good_readings() -> None:
    for seed in range(5):
        assert not searched(adjusted(*site(seed)[:2])).more_probable


def test_every_hypothesis_has_the_numbers_of_good_readings() -> None:
    """T² of all hypotheses of good networks: their quantiles are those of χ²."""
    small, count_ = 0, 0
    for seed in range(6):
        for c in sized_causes(fga.adjust(adjusted(*site(100 + seed)[:2]))):
            if c.dof:
                count_ += 1
                small += evidence(c.t2, c.dof) < -np.log(0.5)
    assert count_ > 500
    assert 0.42 < small / count_ < 0.58


@LONG
def test_a_cause_of_a_size_that_nobody_makes_is_not_plausible() -> None:
    """A centring of centimetres is, that by which an exchange is explained is not."""
    case = spoiled("centring", 1, 0.1)
    assert searched(adjusted(case.network, case.readings)).found[0].plausible
    done = 0
    for seed in range(8):
        case = spoiled("exchanged_targets", seed, 0.0)
        solution = fga.adjust(adjusted(case.network, case.readings))
        if solution.converged:
            found = fga.causes(fga.reliability(solution))
            assert not found.found[0].plausible
            assert found.found[0] not in found.more_probable
            done += 1
    assert done >= 3


@pytest.mark.parametrize("seed", [4, 8, 9, 12, 26])
def test_the_height_of_a_target_is_named_beside_gnss_and_levelling(seed: int) -> None:
    """−199 mm at all set-ups: alone, or with all that nothing tells from it."""
    case = day(seed, exchanges=0, most=20)
    network, rng = case.network, np.random.default_rng([seed, 9])
    seen = [o.target for o in network.observations.values() if o.kind == "slope_distance"]  # type: ignore[attr-defined]
    seen = [t for t in seen if t.startswith("P")]
    target = seen[int(rng.integers(len(seen)))]
    for ident, o in network.observations.items():
        if o.record.quantity in TOTAL_STATION_QUANTITIES and o.target == target:  # type: ignore[attr-defined]
            network.observations[ident] = replace(o, target_height=1.301)  # type: ignore[call-arg]
    found = fga.snoop(network).causes
    assert found is not None
    text = f"the height of the target at {target!r} (1.301 m)"
    first = found.most_probable
    assert text in found.undecided if first is None else f"{first.cause} {first.where}" == text
    named = [c for c in found.found if f"{c.cause} {c.where}" == text]
    assert abs(named[0].error[0] + 0.199) < 4.0 * named[0].sigma[0]
