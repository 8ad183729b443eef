"""Removals that let much wait, or that the tree cannot hold; free networks at rest."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations, pairwise, permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental import commands
from factorgraph_adj.linear_system.front_system import FrontSystem
from factorgraph_adj.linear_system.rebase import Draft, NoMinimum
from factorgraph_adj.observations import (
    Correlated,
    Direction,
    HeightDifference,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.support.arrivals import bare, batch, difference, items

GIVEN = {"A": (0.0, 0.0, 0.0), "B": (30.0, 0.0, 1.0), "C": (12.0, -25.0, 6.0)}
POINTS = {"P": (10.0, 20.0, 3.0), "Q": (15.0, 10.0, 2.0)}


def distance(at: dict[str, Array], a: str, b: str) -> SlopeDistance:
    """Return an exact one; its id is both names."""
    return SlopeDistance(a, b, float(np.linalg.norm(at[a] - at[b])), sigma=1e-3, id=a + b)


def arc() -> fga.IncrementalAdjustment:
    """Two points by distances from three, and one between them."""
    network = fga.Network("arc")
    at = {name: np.array(x) for name, x in (GIVEN | POINTS).items()}
    for name, x in at.items():
        network.add_point(name, tuple(x), fixed="xyz" if name in GIVEN else "")
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.add([distance(at, a, b) for b in "QP" for a in "ABC"])
    inc.add(distance(at, "P", "Q"))
    return inc


def assert_at_the_minimum(inc: fga.IncrementalAdjustment) -> None:
    """Compare with the batch, settled."""
    inc.settle()
    solution = inc.solution()
    assert inc.settled
    assert solution.converged
    found = difference(solution, batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-6


@pytest.mark.parametrize("twice", [False, True])
def test_what_an_update_cannot_hold_is_found_out_anew(
    monkeypatch: pytest.MonkeyPatch, *, twice: bool
) -> None:
    """It may be singular to working precision though everything is determined without rounding."""
    inc = arc()
    once = Draft.adjusted
    with monkeypatch.context() as patch:

        def undone(draft: Draft, *arguments: Any, **options: Any) -> FrontSystem | NoMinimum:
            patch.undo()
            found = once(draft, *arguments, **options)
            return NoMinimum("singular", ()) if twice else found

        patch.setattr(commands, "downdated", lambda *_: None)
        patch.setattr(Draft, "adjusted", undone)
        waits = inc.remove("AP").waits
    assert not waits
    assert len(inc) == 6
    assert_at_the_minimum(inc)


def test_what_waits_again_then_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the update holds it."""
    told = []
    for fails in (False, True):
        inc = arc()
        with monkeypatch.context() as patch:
            if fails:
                patch.setattr(commands, "determined_only_by", lambda *_: None)
            told.append(sorted(inc.remove(["AP", "BP"]).waits))
        assert sorted(w.id for w in inc.waiting) == told[-1]
        assert_at_the_minimum(inc)
    assert told == [["CP", "PQ"]] * 2


@pytest.mark.parametrize("datum", ["free", "given"])
def test_a_determined_core_stays_beside_much_that_waits(datum: str) -> None:
    """What one removal leaves loose waits; the core is found however much had waited before."""
    rng = np.random.default_rng(0)
    core = [f"C{i}" for i in range(6)]
    chain = [f"W{i}" for i in range(100)]
    at = {name: rng.uniform(-10, 10, 3) for name in core}
    at |= {"X": np.array([3.0, 4.0, 5.0])} | {name: rng.uniform(-20, 20, 3) for name in chain}
    network = fga.Network("core", datum=datum)  # type: ignore[arg-type]
    for name, x in at.items():
        held = datum == "given" and name in core[:3]
        network.add_point(name, tuple(x), fixed="xyz" if held else "")
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.add([distance(at, a, b) for a, b in combinations(core, 2)])
    inc.add([distance(at, c, "X") for c in core[:3]])
    inc.add([distance(at, a, b) for a, b in pairwise(chain)])
    inc.add([distance(at, core[0], w) for w in chain])
    assert len(inc) == 18
    waited = inc.n_waiting
    assert sorted(inc.remove("C2X").waits) == ["C0X", "C1X"]
    assert len(inc) == 15
    assert inc.n_waiting == waited + 2


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
def test_what_a_wrong_reading_kept_out_enters_when_it_is_removed() -> None:
    """Directions to the wrong target keep two points waiting."""
    xy = {"A": (0, 0), "B": (80, 0), "C": (30, 50), "D": (70, 60)}
    network = fga.Network("yard")
    for name, (x, y) in xy.items():
        network.add_point(name, (x, y, 100), fixed="xyz" if name in "AB" else "z")
    inc = fga.IncrementalAdjustment(network)
    for a, b in ("AB", "BA", "AC", "BC", "CA", "CB", "CD", "DC", "AD", "BD"):
        azimuth = np.arctan2(xy[b][0] - xy[a][0], xy[b][1] - xy[a][1])
        wrong = 1.5 if a + b == "BC" else 0.0
        inc.add(Direction(a, b, float(azimuth + wrong) % (2 * np.pi), sigma=1.5e-5, id=a + b))
    inc.remove("BC")
    assert not inc.waiting
    assert len(inc) == 9
    assert_at_the_minimum(inc)


def test_what_waits_on_is_not_recorded_again(tmp_path: Path) -> None:
    """Neither on settling nor when something that waits with it is taken out."""
    journal = tmp_path / "day.jsonl"
    network = fga.Network("waits")
    at = {name: np.array(x) for name, x in (GIVEN | POINTS).items()}
    for name, x in at.items():
        network.add_point(name, tuple(x), fixed="xyz" if name in GIVEN else "")
    inc = fga.IncrementalAdjustment(network, journal=journal)
    inc.add([distance(at, a, "P") for a in "AB"])
    inc.add(distance(at, "P", "Q"))
    inc.settle()
    inc.remove("AP")
    *_, settled, removed = [json.loads(line) for line in journal.read_text().splitlines()]
    assert (settled["do"], removed["do"]) == ("settle", "remove")
    assert "observations" not in settled
    assert "observations" not in removed
    assert removed["gone"] == ["AP"]
    del inc  # which lets go of the journal
    again = fga.IncrementalAdjustment.resume(journal)
    assert [w.id for w in again.waiting] == ["BP", "PQ"]


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
@pytest.mark.parametrize("seed", [12, 15, 22])
def test_a_free_network_settles_on_its_inner_constraints(seed: int) -> None:
    """Though its first step is larger than what a motion onto them may follow, its second small."""
    rng = np.random.default_rng(seed)
    network = fga.Network("free", datum="free")
    at = {f"P{i}": rng.uniform(-100, 100, 3) * [1, 1, 0.2] for i in range(6)}
    for name, x in at.items():
        network.add_point(name, tuple(x))
        network.set_orientation(name, set="1", value=0.4)
    for name in at:
        network.set_vertical(name, xi=1e-4 * rng.normal(), eta=1e-4 * rng.normal())
    for a, b in permutations(at, 2):
        network.add(
            SlopeDistance(a, b, 1.0, sigma=1e-3, id=f"s{a}{b}"),
            Direction(a, b, 0.0, sigma=1e-5, set="1", id=f"r{a}{b}"),
            ZenithAngle(a, b, 1.5, sigma=1e-5, id=f"z{a}{b}"),
        )
    measured = measure(network, seed=seed)
    off = rng.choice([1.0, 3.0])
    for name, x in at.items():
        moved = tuple(x + off * rng.normal(size=3))
        measured.points[name] = replace(measured.points[name], coordinates=moved)
    inc = fga.IncrementalAdjustment(bare(measured), policy="accept")
    arriving = items(measured)
    rng.shuffle(arriving)  # type: ignore[arg-type]
    for item in arriving:
        inc.add(item)
    assert_at_the_minimum(inc)


def test_a_group_between_held_points_takes_part() -> None:
    """It determines nothing, and counts in vᵀPv and redundancy."""
    inc = arc()
    group = Correlated(
        (
            SlopeDistance("A", "B", float(np.sqrt(901.0)) + 1e-3, sigma=1e-3, id="length"),
            HeightDifference("A", "B", 1.0, sigma=1e-3, id="height"),
        ),
        1e-6 * np.array([[1.0, 0.3], [0.3, 1.0]]),
    )
    before = fga.adjust(inc.network())
    inc.add(group)
    for solution in (inc.solution(), fga.adjust(inc.network())):
        assert solution.redundancy == before.redundancy + 2
        assert solution.vtpv == pytest.approx(before.vtpv + 1.0 / (1.0 - 0.3**2), rel=1e-9)
        np.testing.assert_allclose(
            solution.covariance("P"), before.covariance("P"), rtol=1e-6, atol=1e-15
        )
        numbers = fga.reliability(solution).redundancy_numbers
        assert numbers.sum() == pytest.approx(solution.redundancy)
