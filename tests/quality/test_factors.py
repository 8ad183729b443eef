"""Factors that a user adds are tested like observations, by name, and take part in snooping."""

from __future__ import annotations

import pickle
from pathlib import Path

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.quality.snooping_state import FactorSearch
from factorgraph_adj.solve.added_factors import AddedFactors

SIGMA = 0.002
FIXED = {"A": (0.0, 0.0, 0.0), "B": (10.0, 0.0, 0.0), "C": (0.0, 10.0, 0.0)}
FREE = {"P": (3.0, 6.0, 0.0), "Q": (7.0, 7.0, 0.0)}


def trilateration(*, off: float = 0.0) -> fga.Network:
    """Return two points of a plane, measured from three known ones; C-P may be wrong."""
    rng = np.random.default_rng(3)
    network = fga.Network("a plane")
    for name, place in FIXED.items():
        network.add_point(name, place, fixed="xyz")
    for name, place in FREE.items():
        network.add_point(name, place, fixed="z")
    for a in FIXED:
        for b in FREE:
            for repeated in "12":
                true = float(np.linalg.norm(np.subtract(FIXED[a], FREE[b])))
                wrong = off if (a, b, repeated) == ("C", "P", "1") else 0.0
                value = true + wrong + rng.uniform(-1.5, 1.5) * SIGMA
                network.add(SlopeDistance(a, b, value, sigma=SIGMA, id=f"{a}{b}{repeated}"))
    return network


def tape(
    network: fga.Network, error: float = 0.0, between: tuple[str, str] = ("P", "Q")
) -> gtsam.RangeFactor3:
    """Return a taped distance between the two points as a factor."""
    keys = fga.build_graph(network).keys
    a, b = (keys.key("point", name) for name in between)
    true = float(np.linalg.norm(np.subtract(FREE[between[0]], FREE[between[1]])))
    return gtsam.RangeFactor3(a, b, true + error, gtsam.noiseModel.Isotropic.Sigma(1, SIGMA))


def test_a_factor_has_the_figures_of_the_observation() -> None:
    network = trilateration()
    value = float(np.linalg.norm(np.subtract(FREE["P"], FREE["Q"]))) + 0.003
    factor = fga.reliability(fga.adjust(network, extra_factors={"tape": tape(network, 0.003)}))
    network.add(SlopeDistance("P", "Q", value, sigma=SIGMA, id="tape"))
    rel = fga.reliability(fga.adjust(network))
    (found,), row = factor.factors, rel.row("tape")
    assert found.name == "tape" and found is factor.factor("tape")
    assert found.residuals[0] * SIGMA == pytest.approx(rel.solution.observations.residuals[row])
    assert found.redundancy_numbers[0] == pytest.approx(rel.redundancy_numbers[row], rel=1e-9)
    assert found.e1[0] == pytest.approx(rel.e1[row], abs=1e-12)
    assert found.w[0] == pytest.approx(rel.w[row], rel=1e-7)
    assert found.mdb[0] * SIGMA == pytest.approx(rel.mdb[row], rel=1e-9)
    assert found.delta_bar[0] == pytest.approx(rel.delta_bar[row], rel=1e-9)
    assert found.t2 == pytest.approx(rel.w[row] ** 2, rel=1e-7)
    assert found.test == pytest.approx(abs(rel.w[row]) / rel.critical_w, rel=1e-7)
    search = FactorSearch(factor.solution.extra, "pope", factor.alpha)
    ratio = abs(rel.tau[row]) / rel.critical_tau
    assert search.ratio(found, factor.solution) == pytest.approx(ratio, rel=1e-6)


def test_t2_is_what_the_factor_adds_to_vtpv() -> None:
    """Leaving it out takes vᵀM⁻¹v away; both rows of a prior together."""
    network = trilateration()
    key = fga.build_graph(network).keys.key("point", "P")
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([SIGMA, 3 * SIGMA, 1.0]))
    prior = gtsam.PriorFactorPoint3(key, np.add(FREE["P"], (0.004, -0.003, 0.0)), noise)
    plain, solution = fga.adjust(network), fga.adjust(network, extra_factors=[prior])
    (found,) = fga.reliability(solution).factors
    assert found.name == "factor 1 (PriorFactorPoint3)"
    # z of P is held: the third row has no unknown, and its residual tests the given value.
    assert found.dof == 3 and found.redundancy_numbers[2] == pytest.approx(1.0)
    assert found.t2 == pytest.approx(solution.vtpv - plain.vtpv, rel=1e-3)


def test_what_nothing_else_controls_has_no_test() -> None:
    network = trilateration()
    network.observations = {i: o for i, o in network.observations.items() if "Q" not in i}
    network.points["Q"] = fga.Point("Q", FREE["Q"], fixed=(False, True, True))
    (found,) = fga.reliability(fga.adjust(network, extra_factors=[tape(network)])).factors
    assert not found.controlled and np.isnan(found.test) and np.isinf(found.mdb).all()


def test_unknown_names_say_which_is_meant() -> None:
    network = trilateration()
    rel = fga.reliability(fga.adjust(network, extra_factors={"tape": tape(network)}))
    with pytest.raises(fga.InputError, match=r"unknown factor 'Tape'.*did you mean 'tape'"):
        rel.factor("Tape")
    with pytest.raises(fga.InputError, match="names of factors must be texts"):
        fga.adjust(network, extra_factors={1: tape(network)})  # type: ignore[dict-item]


def test_figures_are_kept_in_files(tmp_path: Path) -> None:
    network = trilateration()
    solution = fga.adjust(network, extra_factors={"tape": tape(network, 0.003)})
    file = tmp_path / "a.solution"
    solution.save(file)
    (before,) = fga.reliability(solution).factors
    for again in (fga.load_solution(file), pickle.loads(pickle.dumps(solution))):
        (found,) = fga.reliability(again).factors
        assert (found.name, found.dof) == ("tape", 1)
        assert found.t2 == pytest.approx(before.t2, rel=1e-9)


@pytest.mark.parametrize("test", ["baarda", "pope"])
def test_snooping_sets_a_wrong_factor_aside(test: str) -> None:
    network = trilateration()
    factors = {"good": tape(network, 0.001), "wrong": tape(network, 0.05)}
    found = fga.snoop(network, extra_factors=factors, test=test)  # type: ignore[arg-type]
    assert [f.name for f in found.rejected_factors] == ["wrong"]
    assert not found.rejected and not found.unresolved
    (wrong,) = found.rejected_factors
    assert wrong.test > 1.0 and wrong.final_test > 1.0 and wrong.round == 1
    assert [f.name for f in found.reliability.factors] == ["good"]
    batch = fga.adjust(network, extra_factors={"good": factors["good"]})
    np.testing.assert_allclose(found.solution.point("P"), batch.point("P"), atol=1e-8)
    assert "1 factor rejected" in repr(found)


def test_snooping_finds_wrong_observations_beside_good_factors() -> None:
    network = trilateration(off=0.05)
    found = fga.snoop(network, extra_factors=[tape(network, 0.001)])
    assert [r.id for r in found.rejected] == ["CP1"]
    assert not found.rejected_factors
    assert found.solution.extra.n_rows == 1


def test_a_factor_that_something_needs_stays() -> None:
    """Q hangs on the factor and one distance: neither can be tested."""
    network = trilateration()
    network.observations = {
        i: o for i, o in network.observations.items() if "Q" not in i or i == "AQ1"
    }
    found = fga.snoop(network, extra_factors={"tape": tape(network, 0.05)})
    assert not found.rejected_factors and not found.rejected


def test_robust_estimators_take_no_factors() -> None:
    network = trilateration()
    with pytest.raises(fga.InputError, match="no robust estimator with factors"):
        fga.snoop(network, extra_factors=[tape(network)], robust="huber")


def test_factors_find_their_unknowns_by_name_in_a_smaller_network() -> None:
    """The keys number the points of the whole network; P and Q have other numbers in the part."""
    whole = trilateration()
    whole.points = {"first": fga.Point("first", (5.0, 5.0, 0.0), fixed=(False, False, True))} | (
        whole.points
    )
    for a in ("A", "B"):
        whole.add(SlopeDistance(a, "first", float(np.sqrt(50.0)), sigma=SIGMA))
    whole.add(SlopeDistance("C", "first", float(np.sqrt(50.0)), sigma=SIGMA))
    factor = tape(whole, 0.001)
    extra = fga.adjust(whole, extra_factors=[factor]).extra
    part = fga.without(whole, [], points=["first"])
    moved = fga.adjust(part, extra_factors=extra)
    own = fga.adjust(part, extra_factors=[tape(part, 0.001)])
    assert moved.vtpv == pytest.approx(own.vtpv, rel=1e-9)
    np.testing.assert_allclose(moved.point("Q"), own.point("Q"), atol=1e-9)
    with pytest.raises(fga.InputError, match=r"factor 1 \(RangeFactor3\): unknown point 'Q'"):
        fga.adjust(fga.without(whole, [], points=["Q"]), extra_factors=extra)
    assert isinstance(extra, AddedFactors)
