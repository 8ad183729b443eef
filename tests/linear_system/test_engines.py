"""The engine that carries a network is named, chosen by what it is, and given as a copy."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.factor_graph.linear_isam2 import MAX_TURNS, IndeterminateError, LinearISAM2
from factorgraph_adj.factor_graph.row_arrays import Arriving
from factorgraph_adj.ledger.command_input import Engine, Options
from factorgraph_adj.linear_system import isam2_system
from factorgraph_adj.linear_system.front_system import FrontSystem
from factorgraph_adj.observations import Azimuth, HeightDifference, SlopeDistance, StandardDeviation
from factorgraph_adj.types import Index
from tests.networks.small_block import images_only, small_block


def levels(**options: object) -> fga.IncrementalAdjustment:
    """Return three bench marks, of which one is held."""
    network = fga.Network("levels")
    network.add_point("A", (0.0, 0.0, 10.0), fixed="xyz")
    for name in ("P", "Q"):
        network.add_point(name, (50.0, 0.0, 10.0), fixed="xy")
    network.add(HeightDifference("A", "P", 1.0, sigma=0.001))
    network.add(HeightDifference("P", "Q", 0.5, sigma=0.001))
    return fga.IncrementalAdjustment(network, **options)  # type: ignore[arg-type]


def test_a_levelling_network_is_in_isam2_from_the_beginning_and_after_it_has_settled() -> None:
    inc = levels(engine="auto")
    assert inc.engine == "isam2" and repr(inc).endswith("iSAM2>")
    inc.add(HeightDifference("A", "Q", 1.501, sigma=0.001))
    inc.settle()
    assert inc.engine == "isam2" and inc.settled
    batch = fga.adjust(inc.network(), tolerance=1e-10)
    assert inc.estimate("Q")[2] == pytest.approx(batch.point("Q")[2], abs=1e-10)
    assert inc.solution().converged


def test_fronts_carry_it_where_they_are_asked_for() -> None:
    inc = levels(engine="fronts")
    assert inc.engine == "fronts" and repr(inc).endswith("fronts>")
    with pytest.raises(InputError, match="this network is in fronts"):
        _ = inc.isam


@pytest.mark.parametrize("fails", [False, True])
def test_fronts_take_over_where_a_tree_does_not_come_to_rest(
    monkeypatch: pytest.MonkeyPatch, *, fails: bool
) -> None:
    """Its linear forms would be those of another place; nothing shows it from outside."""

    def follow(tree: LinearISAM2, accuracy: float | None = None) -> int:
        if fails:
            raise IndeterminateError("Indeterminate linear system")
        return MAX_TURNS

    monkeypatch.setattr(LinearISAM2, "follow", follow)
    inc = levels(engine="isam2")
    assert inc.engine == "fronts"
    inc.add(HeightDifference("A", "Q", 1.501, sigma=0.001))
    assert inc.engine == "fronts" and not inc.doubts
    batch = fga.adjust(inc.network())
    assert inc.estimate("Q")[2] == pytest.approx(batch.point("Q")[2], abs=1e-9)


def test_photos_and_free_networks_are_for_fronts() -> None:
    photos = fga.IncrementalAdjustment(images_only(), datum="free", engine="auto")
    assert photos.engine == "fronts"


def test_a_network_that_has_grown_large_is_for_fronts_which_answer_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(isam2_system, "MAX_UNKNOWNS_CHOSEN", 3)
    chosen, asked = levels(engine="auto"), levels(engine="isam2")
    engines = []
    for k in range(3):
        new = fga.Point(f"new {k}", (50.0, 0.0, 10.0), fixed="xy")
        reading = HeightDifference("Q", new.name, 0.1 * k, sigma=0.001)
        for inc in (chosen, asked):
            inc.add(
                [reading, HeightDifference("A", new.name, 1.5 + 0.1 * k, sigma=0.002)], points=new
            )
        engines.append((chosen.engine, asked.engine))
        for name in ("Q", new.name):
            assert chosen.estimate(name) == pytest.approx(asked.estimate(name), abs=1e-9)
            assert chosen.covariance(name) == pytest.approx(asked.covariance(name), abs=1e-12)
        assert chosen.redundancy == asked.redundancy
    assert engines == [("isam2", "isam2"), ("isam2", "isam2"), ("fronts", "isam2")]


def test_the_live_tree_is_given_as_a_copy() -> None:
    inc = levels(engine="isam2")
    tree = inc.isam
    assert isinstance(tree, gtsam.ISAM2)
    before = inc.estimate("Q")
    sigmas = sorted(
        float(np.sqrt(tree.marginalCovariance(key)[0, 0]))
        for key in range(tree.getLinearizationPoint().size())
    )
    assert sigmas == pytest.approx([0.001, 0.001 * np.sqrt(2.0)], rel=1e-9)
    tree.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [1])
    assert (inc.estimate("Q") == before).all()


def test_an_arrival_that_ends_in_an_error_leaves_nothing_behind() -> None:
    """One of its readings has no answer: two points are at the same place."""
    network = fga.Network("same place")
    for name, at in (("A", (0, 0, 0)), ("B", (100, 0, 0)), ("C", (0, 100, 0))):
        network.add_point(name, at, fixed="xyz")
    for name in ("P", "Q"):
        network.add_point(name, (50.0, 60.0, 0.0), fixed="z")
        for station in "ABC":
            at = np.array(network.points[station].coordinates)
            length = float(np.linalg.norm(np.array((50.0, 60.0, 0.0)) - at))
            network.add(SlopeDistance(station, name, length, sigma=0.005))
    inc = fga.IncrementalAdjustment(network)
    before = inc.redundancy, inc.n_observations, inc.covariance("P")
    good = SlopeDistance("A", "P", float(np.hypot(50.0, 60.0)), sigma=0.005)
    with pytest.raises(InputError, match="azimuth"):
        inc.add([good, Azimuth("P", "Q", 1.0, sigma=1e-4)])
    assert (inc.redundancy, inc.n_observations) == before[:2]
    assert (inc.covariance("P") == before[2]).all()
    inc.add(good)
    batch = fga.adjust(inc.network())
    assert (inc.redundancy, inc.n_observations) == (batch.redundancy, batch.n_observations)
    assert inc.covariance("P") == pytest.approx(batch.covariance("P"), rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_levelled_line_that_waited_enters_with_its_tie(seed: int) -> None:
    """Held coordinates stay, as the weights of its readings depend on lengths."""
    rng = np.random.default_rng(seed)
    at = np.column_stack([rng.uniform(0, 500, (7, 2)), rng.uniform(0, 30, 7)])
    network = fga.Network("line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (90.0, 0.0, 0.0), fixed="xy")
    for i, x in enumerate(at):
        network.add_point(f"P{i}", (*x[:2], x[2] + 0.1 * rng.normal()), fixed="xy")

    def rise(a: int, b: int, name: str) -> HeightDifference:
        error = 0.001 * rng.normal()
        sigma = StandardDeviation(per_sqrt_km=0.003)
        value = float(at[b, 2] - at[a, 2] + error)
        return HeightDifference(f"P{a}", f"P{b}", value, sigma=sigma, id=f"rise {name}")

    inc = fga.IncrementalAdjustment(network)
    inc.add(HeightDifference("A", "B", 0.0, sigma=0.001))
    inc.add([*(rise(int(rng.integers(0, i)), i, f"{i}") for i in range(1, 7)), rise(0, 1, "again")])
    tie = StandardDeviation(per_sqrt_km=0.003)
    inc.add(HeightDifference("A", "P6", float(at[6, 2]), sigma=tie))
    assert (len(inc), inc.redundancy, inc.n_waiting) == (9, 1, 0)
    assert inc.estimate("P3")[:2] == pytest.approx(at[3, :2], abs=0.0)


def test_fronts_take_over_where_a_tree_is_lost_and_cannot_be_planted_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    inc = levels(engine="isam2")
    wrong = inc.add(HeightDifference("A", "Q", 1.7, sigma=0.001, id="wrong"))
    assert [v.verdict for v in wrong.verdicts] == ["suspect"]

    def refused(self: LinearISAM2, units: Index, gone: list[int]) -> None:
        self.version, self.lost = self.version + 1_000_000, True
        raise IndeterminateError("refused")

    monkeypatch.setattr(LinearISAM2, "_update", refused)
    arrival = inc.add(HeightDifference("A", "Q", 1.501, sigma=0.001))
    assert [v.verdict for v in arrival.verdicts] == ["accepted"] and inc.engine == "fronts"
    batch = fga.adjust(inc.network(), tolerance=1e-10)
    assert inc.estimate("Q") == pytest.approx(batch.point("Q"), abs=1e-8)
    assert inc.standard_deviations("Q") == pytest.approx(batch.standard_deviations("Q"), rel=1e-6)


def test_a_network_that_isam2_refuses_is_put_into_it_again_only_when_its_datum_is_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rises to 0.1 mm beside a height that is known to 10 m: Cholesky refuses that."""
    network = fga.Network("levels")
    network.add_point("A", (0.0, 0.0, 10.0), fixed="xy", sigma=10.0)
    network.add_point("B", (0.0, 50.0, 9.0), fixed="xyz")
    for name in ("P", "Q"):
        network.add_point(name, (50.0, 0.0, 10.0), fixed="xy")
    network.add(HeightDifference("A", "P", 1.0, sigma=1e-4))
    network.add(HeightDifference("P", "Q", 0.5, sigma=1e-4))
    tried: list[int] = []
    enter = LinearISAM2.enter

    def counted(self: LinearISAM2, arrivals: list[Arriving]) -> Index:
        tried.append(len(arrivals))
        return enter(self, arrivals)

    monkeypatch.setattr(LinearISAM2, "enter", counted)
    inc = fga.IncrementalAdjustment(network, engine="isam2")
    assert inc.engine == "fronts" and len(tried) == 1
    for rise in (1.5, 1.5001, 1.4999):
        inc.add(HeightDifference("A", "Q", rise, sigma=1e-4))
    assert inc.engine == "fronts" and len(tried) == 1
    inc.add(HeightDifference("P", "B", -2.0, sigma=1e-4))
    inc.add(HeightDifference("A", "Q", 1.5, sigma=1e-4))
    assert inc.engine == "isam2" and len(tried) == 3
    batch = fga.adjust(inc.network(), tolerance=1e-10)
    assert inc.estimate("Q")[2] == pytest.approx(batch.point("Q")[2], abs=1e-9)


@pytest.mark.parametrize("seed", [0, 3])
def test_deviations_of_a_point_that_hardly_anything_determines_are_those_of_the_batch(
    seed: int,
) -> None:
    """Distances along a short base leave it free across, where a movement turns its ellipse."""
    rng, n, sigma = np.random.default_rng(seed), 12, 0.3
    there = np.array([rng.uniform(-3.0, 3.0), 15.0, 0.0])
    net = fga.Network("a beacon")
    for i in range(n):
        net.add_point(f"S{i}", (0.16 * i - 2.0, rng.normal(0.0, 0.05), 0.0), fixed="xyz")
    net.add_point(
        "b", tuple(there + np.append(rng.normal(0.0, 2.0, 2), 0.0)), fixed="z", sigma=10.0
    )
    inc = fga.IncrementalAdjustment(net, policy="accept")
    for i in range(n):
        distance = float(np.linalg.norm(there - net.points[f"S{i}"].coordinates))
        inc.add(SlopeDistance(f"S{i}", "b", distance + rng.normal(0.0, sigma), sigma=sigma))
        batch = fga.adjust(inc.network(), start=inc.solution(), tolerance=1e-9)
        ours, theirs = (x.standard_deviations("b")[:2] for x in (inc, batch))
        assert ours == pytest.approx(theirs, rel=1e-2), i


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_whether_there_are_poses_is_known_without_their_names(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An arrival that asks for the names of all poses would take longer the more there are."""
    inc = levels(engine=engine)
    system = inc._state.system
    assert system is not None and not system.has_poses
    with_photos = fga.IncrementalAdjustment(small_block(), engine=engine)
    system = with_photos._state.system
    assert system is not None and system.has_poses and system.engine == engine
    monkeypatch.setattr(type(system), "names", lambda *_: pytest.fail("all names"))
    if isinstance(system, isam2_system.ISAM2System):
        assert not system.outgrown
    else:
        assert isinstance(system, FrontSystem)
        assert isam2_system.ISAM2System.suits(
            system, Options("flag", 0.001, 0.01, "given", "isam2")
        )
