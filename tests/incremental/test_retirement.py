"""Points and photos are retired, and taken back.

What remains has the estimates, covariances, vᵀPv and redundancy of the batch adjustment of
everything; taken back, everything is within 1e-6 σ of it.
"""

from __future__ import annotations

import pickle
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ledger.command_input import ENGINES
from factorgraph_adj.observations import ControlPoint, Direction, HeightDifference, SlopeDistance
from factorgraph_adj.solve import marginalisation
from tests.benchmarks.vehicle import Drive
from tests.networks.moved_after_retirement import (
    MOVEMENTS,
    moved_after_retirement,
    retired_with_residuals,
    truly_missed,
    two_points,
    two_points_by_distances,
)
from tests.networks.photo_block import SIGMA, block
from tests.networks.traverse import observed, points_of, traverse
from tests.support.arrivals import bare, items

POINTS = 12
LATE = ("P8", "P10")
"""Points with which the second and third part of the traverse begin."""
ACCURACY = 0.01
"""What an adjustment promises at any time."""


def everything() -> fga.Solution:
    network = traverse(POINTS)
    for _, found in observed(POINTS):
        network.add(*found)
    return fga.adjust(network)


def off(inc: fga.IncrementalAdjustment, batch: fga.Solution, names: list[str]) -> float:
    """Return the largest difference of estimates and σ from those of a batch, relative to σ."""
    worst = 0.0
    for name in names:
        sigma = batch.standard_deviations(name)
        on = sigma > 0
        step = np.abs(inc.estimate(name) - batch.point(name))
        assert np.all(step[~on] == 0)
        wider = np.abs(inc.standard_deviations(name) - sigma)
        worst = max(worst, float(np.max((step[on], wider[on]) / sigma[on], initial=0.0)))
    return worst


def survey(journal: Path | None = None, *, engine: str = "auto") -> fga.IncrementalAdjustment:
    """Return a traverse of which the first points were retired while the others came."""
    inc = fga.IncrementalAdjustment(
        traverse(POINTS),
        engine=engine,  # type: ignore[arg-type]
        journal=journal,
    )
    found = [o for _, some in observed(POINTS) for o in some]
    parts = [next(i for i, o in enumerate(found) if n in (o.station, o.target)) for n in LATE]
    inc.add(found[: parts[0]])
    inc.retire(points=["P2", "P3", "P4"])
    inc.add(found[parts[0] : parts[1]])
    inc.retire(points=["P0", "P5"])
    inc.add(found[parts[1] :])
    return inc


@pytest.mark.parametrize("engine", ENGINES)
def test_what_remains_is_that_of_the_batch_with_everything(engine):
    batch, inc = everything(), survey(engine=engine)
    left = [f"P{i}" for i in (1, 6, 7, 8, 9, 10, 11)]
    assert off(inc, batch, left) < ACCURACY
    inc.settle()
    # Linear rows 1 σ from where they were made: distances of 50 m and σ of 2 mm bend by 1e-4 σ.
    assert off(inc, batch, left) < 1e-3
    for found in (inc, inc.solution()):
        assert found.redundancy == batch.redundancy
        assert found.vtpv == pytest.approx(batch.vtpv, abs=1e-4)
    here, there = inc.reliability(), fga.reliability(batch)
    for ident in inc.solution().network.observations:
        r = (rel.redundancy_numbers[rel.row(ident)] for rel in (here, there))
        assert next(r) == pytest.approx(next(r), abs=1e-4)
    (rest,) = here.factors
    assert rest.name == "retired observations"


@pytest.mark.parametrize("engine", ENGINES)
def test_everything_is_taken_back(engine):
    batch, inc = everything(), survey(engine=engine)
    assert inc.retired.points == 5
    inc.settle(all=True)
    assert inc.retired is None
    assert off(inc, batch, list(points_of(POINTS))) < 1e-6
    assert len(inc) == len(batch.network.observations)
    inc.remove("17")
    assert inc.redundancy == batch.redundancy - 1


def test_photos_are_retired_with_their_points_and_taken_back():
    network = block(3)
    batch, inc = fga.adjust(network), fga.IncrementalAdjustment(network)
    gone = ["P9", "P10", "P11", "P12"]
    inc.retire(points=gone, photos=["F2", "F5"])
    left = [n for n in network.points if n not in gone]
    assert off(inc, batch, left) < 1e-3
    inc.retire(points=left[:7], photos=["F3"])
    assert off(inc, batch, left[7:]) < 1e-3
    assert inc.redundancy == batch.redundancy
    assert inc.vtpv == pytest.approx(batch.vtpv, abs=1e-3)
    last = inc.last_estimate("P9")
    assert (
        np.abs(last.value - batch.point("P9")).max() < 1e-3 * batch.standard_deviations("P9").min()
    )
    assert np.sqrt(np.diag(last.covariance)) == pytest.approx(
        batch.standard_deviations("P9"), rel=1e-3
    )
    assert inc.last_estimate("F2", kind="pose").covariance.shape == (6, 6)
    inc.settle(all=True)
    assert off(inc, batch, list(network.points)) < 1e-6
    assert inc.redundancy == batch.redundancy


def test_the_batch_adjustment_of_the_network_has_what_was_retired():
    inc = survey()
    assert off(inc, fga.adjust(inc.network()), ["P8", "P11"]) < ACCURACY
    assert inc.network().points.keys() == set(points_of(POINTS))


def test_a_journal_resumes_what_was_retired(tmp_path):
    inc = survey(tmp_path / "journal")
    inc.settle()
    said, seen = repr(inc), {n: inc.estimate(n) for n in ("P6", "P11")}
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert repr(again) == said
    for name, x in seen.items():
        assert np.abs(again.estimate(name) - x).max() < 1e-6 * again.standard_deviations(name).min()
    assert again.last_estimate("P3").covariance.shape == (3, 3)
    again.settle(all=True)
    del again
    last = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert last.retired is None
    assert off(last, everything(), list(points_of(POINTS))) < 1e-6


def test_what_arrives_for_something_retired_is_refused_and_enters_once_it_is_taken_back():
    inc = survey()
    late = SlopeDistance("P3", "P8", 203.0, sigma=0.003, id="late")
    before = repr(inc)
    with pytest.raises(fga.InputError, match=r"point 'P3' was retired when point 'P11' .*all=True"):
        inc.add(late)
    with pytest.raises(fga.InputError, match="one of this name was retired"):
        inc.add(points=fga.Point("P3", (1.0, 2.0, 3.0)))
    with pytest.raises(fga.InputError, match=r"duplicate id '4'.*retired"):
        inc.add(SlopeDistance("P7", "P8", 50.0, sigma=0.003, id="4"))
    assert repr(inc) == before
    inc.settle(all=True)
    (verdict,) = inc.add(late).verdicts
    assert verdict.verdict == "suspect"


@pytest.mark.parametrize("resumed", [False, True])
def test_new_observations_get_no_ids_of_retired_ones(engine, resumed, tmp_path):
    journal = tmp_path / "day.jsonl"
    inc = fga.IncrementalAdjustment(
        two_points_by_distances(0.01), engine=engine, journal=journal if resumed else None
    )
    before = len(inc)
    inc.retire(points=["Q"])
    if resumed:
        del inc
        inc = fga.IncrementalAdjustment.resume(journal)
    new = [HeightDifference("A", "P", 0.0, sigma=0.01), SlopeDistance("A", "P", 6.41, sigma=0.01)]
    inc.add(new)
    inc.settle(all=True)
    assert len(inc) == before + len(new)
    everything = two_points_by_distances(0.01)
    everything.add(*new)
    assert off(inc, fga.adjust(everything), ["P", "Q"]) < 1e-6


@pytest.mark.parametrize("resumed", [False, True])
def test_new_observations_get_no_ids_of_removed_ones(engine, resumed, tmp_path):
    """Nor where the removed one had been given its number as an id."""
    journal = tmp_path / "day.jsonl"
    inc = fga.IncrementalAdjustment(two_points_by_distances(0.01), engine=engine, journal=journal)
    inc.remove("6")
    inc.add(HeightDifference("A", "P", 0.0, sigma=0.01, id="9"))
    inc.remove("9")
    if resumed:
        del inc
        inc = fga.IncrementalAdjustment.resume(journal, engine=engine)
    (verdict,) = inc.add(HeightDifference("A", "P", 0.0, sigma=0.01)).verdicts
    assert verdict.id == "10"


def test_ids_of_retired_image_points_name_nothing_else():
    """Their own ids are refused; with photo/point as another id they are not taken back."""
    network = block(3, SIGMA)
    rays = [o for o in network.image_points() if o.point == "P23"]
    inc = fga.IncrementalAdjustment(bare(network), policy="accept")
    inc.add([replace(o, id="900") if o == rays[0] else o for o in items(network)])
    inc.settle()
    before = len(inc)
    inc.retire(points=["P23"])
    near = ControlPoint("P0", tuple(inc.estimate("P0").tolist()), sigma=(1.0, 1.0, 1.0))
    with pytest.raises(fga.InputError, match=r"duplicate id '900'.*retired"):
        inc.add(replace(near, id="900"))
    other = f"{rays[1].photo}/P23"
    inc.add(replace(near, id=other))
    said = repr(inc)
    with pytest.raises(fga.InputError, match=f"observation '{other}': has the id of a retired one"):
        inc.settle(all=True)
    assert repr(inc) == said
    inc.remove(other)
    inc.settle(all=True)
    assert len(inc) == before


def test_what_is_asked_of_something_retired_says_so():
    inc = survey()
    for ask in (inc.estimate, inc.covariance, inc.standard_deviations):
        with pytest.raises(fga.InputError, match=r"was retired .*last_estimate\('P3'\)"):
            ask("P3")
    for command in (inc.remove, inc.accept, inc.discard, inc.observation):
        with pytest.raises(fga.InputError, match="observation '4': was retired"):
            command("4")
    with pytest.raises(fga.InputError, match=r"P3.*was retired"):
        inc.retire(points="P3")
    with pytest.raises(fga.InputError, match="unknown point"):
        inc.retire(points=["P8", "Q"])
    with pytest.raises(fga.InputError, match="some are retired"):
        inc.snoop()
    with pytest.raises(fga.InputError, match="was not retired"):
        inc.last_estimate("P8")
    with pytest.raises(fga.InputError, match="nothing would remain"):
        inc.retire(points=["P1", *(f"P{i}" for i in range(6, 12))])
    assert "are retired" in repr(inc)
    assert not inc.determined("P3")


def test_what_was_left_out_is_taken_back_as_it_was():
    inc = fga.IncrementalAdjustment(traverse(POINTS))
    for _, found in observed(POINTS):
        wrong = [o for o in found if isinstance(o, SlopeDistance)][:1]
        more = [SlopeDistance(o.station, o.target, o.value + 0.5, sigma=0.003) for o in wrong]
        inc.add(found)
        inc.add(more)
    assert len(inc.suspects) == 11
    inc.add(points=fga.Point("Q", (0.0, 0.0, 0.0)))
    inc.add(SlopeDistance("P3", "Q", 70.0, sigma=0.003, id="waits"))
    before = [(v.id, v.t2) for v in inc.suspects]
    inc.retire(points=["P3", "P4"])
    assert len(inc.suspects) == 7
    assert not inc.n_waiting
    inc.settle(all=True)
    assert sorted((v.id, v.t2) for v in inc.suspects) == sorted(before)
    assert [w.id for w in inc.waiting] == ["waits"]


def test_a_free_network_keeps_everything():
    network = traverse(POINTS)
    for _, found in observed(POINTS):
        network.add(*found)
    inc = fga.IncrementalAdjustment(network, datum="free")
    with pytest.raises(fga.InputError, match="free network"):
        inc.retire(points="P4")


def test_copies_of_a_solution_keep_the_linear_rows():
    solution = survey().solution()
    copy = deepcopy(solution)
    for one in (copy, pickle.loads(pickle.dumps(solution))):
        (rows,) = one.extra.at(one.equations, one.state).rows
        assert rows.residual == pytest.approx(solution.extra.rows[0].residual, abs=1e-12)
        assert one.redundancy == solution.redundancy


def test_what_nothing_has_touched_since_an_observation_is_retired():
    inc = fga.IncrementalAdjustment(traverse(POINTS))
    for _, found in observed(POINTS):
        inc.add(found)
    first = 1 + sum(len(found) for _, found in list(observed(POINTS))[:9])
    assert "P9" in inc.observation(f"{first}").points()
    inc.retire(before=f"{first}")
    assert not any(inc.determined(f"P{i}") for i in range(2, 6))
    assert all(inc.determined(f"P{i}") for i in (0, 1, *range(6, POINTS)))
    batch = everything()
    assert off(inc, batch, ["P6", "P11"]) < ACCURACY
    assert inc.redundancy == batch.redundancy
    assert inc.vtpv == pytest.approx(batch.vtpv, abs=1e-3)
    # Readings between the two given points tell nothing of what remains, and go too.
    assert not any({*o.points()} == {"P0", "P1"} for o in inc.described.observations.values())
    with pytest.raises(fga.InputError, match=r"unknown observation.*before= takes one, or a photo"):
        inc.retire(before="nothing")
    inc.settle(all=True)
    assert off(inc, batch, list(points_of(POINTS))) < 1e-6
    assert inc.redundancy == batch.redundancy


def timed(journal: Path | None = None, *, engine: str = "auto") -> fga.IncrementalAdjustment:
    """Return a traverse whose readings come every ten seconds; those of 25 seconds are kept."""
    inc = fga.IncrementalAdjustment(
        traverse(POINTS),
        engine=engine,  # type: ignore[arg-type]
        keep_seconds=25.0,
        journal=journal,
    )
    for number, (_, found) in enumerate(observed(POINTS)):
        inc.add(found[:1], time=10.0 * number)
        inc.add(found[1:])  # at the same time
    return inc


@pytest.mark.parametrize("engine", ENGINES)
def test_what_nothing_has_touched_for_some_seconds_is_retired_by_itself(engine):
    batch, inc = everything(), timed(engine=engine)
    assert inc.keep == 25.0
    gone = [f"P{i}" for i in range(2, 6)]
    left = [f"P{i}" for i in (0, 1, *range(6, POINTS))]
    assert all(inc.last_estimate(name) is not None for name in gone)
    assert all(inc.determined(name) for name in left)
    assert off(inc, batch, left) < ACCURACY
    assert inc.redundancy == batch.redundancy
    inc.settle(all=True)
    assert off(inc, batch, list(points_of(POINTS))) < 1e-6


def test_a_journal_resumes_with_the_times_of_arrivals(tmp_path):
    inc = timed(tmp_path / "journal")
    said = repr(inc)
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert repr(again) == said
    assert again.keep == 25.0
    new = SlopeDistance("P10", "P11", 50.0, sigma=0.5)
    with pytest.raises(fga.InputError, match="must not be before that of an earlier one"):
        again.add(new, time=1.0)
    again.add(new)
    retired = again.retired.points
    again.add(SlopeDistance("P10", "P11", 50.0, sigma=0.5), time=1000.0)
    assert again.retired.points > retired
    assert again.determined("P11")
    again.settle(all=True)
    assert again.determined("P2")


def test_a_journal_resumes_sets_between_given_points_that_were_retired(tmp_path):
    """Nothing remains of them: their rows touch no other unknown."""
    network = traverse(POINTS)
    inc = fga.IncrementalAdjustment(network, keep_seconds=60.0, journal=tmp_path / "journal")
    assert network.points["P0"].fixed and network.points["P1"].fixed
    for number in range(6):
        inc.add(Direction("P0", "P1", 0.0, sigma=1e-5, set=str(number)), time=30.0 * number)
    assert inc.retired is not None
    said = repr(inc)
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert repr(again) == said


def test_times_of_arrivals_are_those_of_a_window_of_seconds():
    network, found = traverse(POINTS), next(iter(observed(POINTS)))[1]
    inc = fga.IncrementalAdjustment(network, keep_seconds=60)
    with pytest.raises(fga.InputError, match="needs the time of arrivals, at least that"):
        inc.add(found)
    for time in (-1.0, np.nan, np.inf, "10", True):
        with pytest.raises(fga.InputError, match="must be from 0 to 1e\\+11 seconds"):
            inc.add(found, time=time)
    assert len(inc) == 0
    with pytest.raises(fga.InputError, match="time= needs keep_seconds"):
        fga.IncrementalAdjustment(network, keep=5).add(found, time=1.0)


def vehicle(
    journal: Path, seconds: float = 19.0, **window: float
) -> tuple[fga.IncrementalAdjustment, fga.Solution]:
    """Return a survey vehicle that keeps its last photos, and the batch adjustment of its drive."""
    drive = Drive(seconds, rays=25, seed=2)
    inc = fga.IncrementalAdjustment(drive.network(), journal=journal, **window)  # type: ignore[arg-type]
    for event in drive.events():
        at = {"time": event.time} if "keep_seconds" in window else {}
        inc.add(event.observations, points=event.points, photos=event.photos, **at)
    whole = fga.IncrementalAdjustment(inc.network(), start=inc.solution(), policy="accept")
    whole.settle()
    return inc, whole.solution()


@pytest.mark.slow(
    "photos that retire by themselves, their journal and what is taken back; others retire by hand"
)
@pytest.mark.parametrize("window", [{"keep": 6}, {"keep_seconds": 6.0}])
def test_a_vehicle_keeps_its_last_photos_and_is_that_of_the_whole_drive(tmp_path, window):
    inc, batch = vehicle(tmp_path / "drive", **window)
    assert inc.retired.photos >= 4
    assert len(inc.solution().network.photos) == 19 - inc.retired.photos
    left = [n for n in inc.solution().network.points if n in batch.network.points]
    assert off(inc, batch, left) < ACCURACY
    assert inc.redundancy == batch.redundancy
    said, seen = repr(inc), inc.pose("photo 18").position
    sigma = inc.pose("photo 18").sigmas[3:]
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "drive")
    assert repr(again).split("BUT")[0] == said.split("BUT")[0]
    assert np.max(np.abs(again.pose("photo 18").position - seen) / sigma) < ACCURACY
    again.settle(all=True)
    assert off(again, batch, list(batch.network.points)) < 1e-6


def test_linear_rows_that_hold_no_more_are_told():
    """Weak distances, of which other readings later take the points five σ away."""
    network = two_points()
    for a, b, value in (
        ("A", "P", 6.4),
        ("B", "P", 7.1),
        ("P", "Q", 3.6),
        ("A", "Q", 10.0),
        ("B", "Q", 8.5),
    ):
        network.add(SlopeDistance(a, b, value, sigma=1.0))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.retire(points="Q")
    assert not inc.doubts
    assert inc.missed_step < 1e-9
    inc.add([SlopeDistance(a, "P", v, sigma=0.01) for a, v in (("A", 9.0), ("B", 6.0))])
    (told,) = inc.doubts
    assert "linear rows may miss" in told
    assert "BUT what remains has moved" in repr(inc)
    inc.settle(all=True)
    assert inc.missed_step == 0.0
    assert not inc.doubts


@pytest.mark.parametrize("movement", MOVEMENTS)
@pytest.mark.parametrize("kind", ["distances", "directions"])
def test_no_more_is_missed_than_the_bound_says(kind, movement):
    inc = moved_after_retirement(1, kind, movement)
    bound = inc.missed_step
    missed = truly_missed(inc)
    assert 1e-5 < missed <= bound < 20 * missed


@pytest.mark.parametrize("residual", [2.0, 5.0])
def test_no_more_is_missed_where_residuals_curve_what_was_retired(residual):
    """Without residuals rows miss 0.001 σ of this movement; with them their curvature counts."""
    inc = retired_with_residuals(residual)
    bound = inc.missed_step
    missed = truly_missed(inc)
    assert 0.01 < missed <= bound < 1.2 * missed


@pytest.mark.slow("photos miss no more than the bound says, whatever of them moves")
@pytest.mark.parametrize("movement", MOVEMENTS)
def test_photos_miss_no_more_than_the_bound_says(movement):
    inc = moved_after_retirement(1, "photos", movement)
    bound = inc.missed_step
    missed = truly_missed(inc)
    assert 1e-5 < missed <= bound < 20 * missed


@pytest.mark.parametrize("later", [0, 1, 6])
def test_rows_that_hold_no_more_are_told_whatever_is_retired_after_them(later):
    """Levels that follow P are retired before P moves; in them nothing is nonlinear."""
    network = two_points_by_distances(0.5)
    for i in range(later):
        network.add_point(f"H{i}", (1.0, 1.0, 0.5), fixed="xy")
        network.add(HeightDifference("A", f"H{i}", 0.5, sigma=0.001))
        network.add(HeightDifference("P", f"H{i}", 0.5, sigma=0.001))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.retire(points="Q")
    for i in range(later):
        inc.retire(points=f"H{i}")
    assert not inc.doubts
    inc.add(
        [
            SlopeDistance(a, "P", d, sigma=0.02)
            for a, d in zip("ABC", (6.77, 5.12, 7.65), strict=True)
        ]
    )
    inc.settle()
    (told,) = inc.doubts
    assert "linear rows may miss" in told
    assert truly_missed(inc) > ACCURACY


def test_a_point_that_is_held_in_part_is_retired_after_one_that_it_was_observed_from():
    network = fga.Network("one after another")
    for name, at in {"A": (0, 0, 0), "B": (9, 0, 0), "C": (0, 9, 0)}.items():
        network.add_point(name, at, fixed="xyz")
    for name, at in {"P": (4.0, 5.0), "Q": (6.0, 8.0), "R": (5.0, 2.0)}.items():
        network.add_point(name, (*at, 0.0), fixed="z")
    for a, b in ("AP", "BP", "CP", "PQ", "AQ", "BQ", "QR", "PR", "AR"):
        d = np.subtract(network.points[b].coordinates, network.points[a].coordinates)
        network.add(SlopeDistance(a, b, float(np.linalg.norm(d)) + 0.001, sigma=0.01))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.settle()
    sigma = inc.standard_deviations("R")
    inc.retire(points="Q")
    inc.retire(points="P")
    assert inc.retired.prior.variables == (("point", "R"),)
    assert inc.standard_deviations("R") == pytest.approx(sigma, rel=1e-6)


def test_what_rows_miss_that_join_too_much_is_not_known(monkeypatch, tmp_path):
    monkeypatch.setattr(marginalisation, "MAX_SECOND_DERIVATIVE_UNKNOWNS", 1)
    inc = survey(journal=tmp_path / "journal")
    assert inc.missed_step == np.inf
    assert "it is not known what their linear rows miss" in inc.doubts[0]
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert again.missed_step == np.inf
    again.settle(all=True)
    assert again.missed_step == 0.0


def test_a_resumed_adjustment_has_the_same_bound(tmp_path):
    inc = moved_after_retirement(1, "directions", "all points", journal=tmp_path / "journal")
    bound = inc.missed_step
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert again.missed_step == pytest.approx(bound, rel=0.01)


@pytest.mark.parametrize("keep", [0, -1, 2.5, True, "60"])
def test_what_is_kept_is_a_number_of_photos(keep):
    with pytest.raises(fga.InputError, match="keep must be a whole number of photos"):
        fga.IncrementalAdjustment(fga.Network("empty"), keep=keep)
    with pytest.raises(fga.InputError, match="free network"):
        fga.IncrementalAdjustment(fga.Network("empty"), keep=5, datum="free")


@pytest.mark.parametrize("seconds", [0.0, -1, np.nan, np.inf, True, "60"])
def test_what_is_kept_is_a_time(seconds):
    with pytest.raises(fga.InputError, match=r"keep_seconds must be 0\.001 or more"):
        fga.IncrementalAdjustment(fga.Network("empty"), keep_seconds=seconds)
    with pytest.raises(fga.InputError, match=r"either keep.*or keep_seconds, not both"):
        fga.IncrementalAdjustment(fga.Network("empty"), keep=5, keep_seconds=60)
    with pytest.raises(fga.InputError, match="free network"):
        fga.IncrementalAdjustment(fga.Network("empty"), keep_seconds=5, datum="free")


def test_a_solution_file_has_the_rows_of_what_was_retired(tmp_path):
    solution = survey().solution()
    solution.save(tmp_path / "solution.npz")
    again = fga.load_solution(tmp_path / "solution.npz")
    assert again.redundancy == solution.redundancy
    assert again.vtpv == solution.vtpv
    assert again.standard_deviations("P8") == pytest.approx(solution.standard_deviations("P8"))
    assert fga.reliability(again).factors[0].t2 == pytest.approx(
        fga.reliability(solution).factors[0].t2
    )


def test_held_points_that_are_retired_are_named(tmp_path):
    journal = tmp_path / "day.jsonl"
    inc = fga.IncrementalAdjustment(traverse(POINTS), journal=journal)
    for _, found in observed(POINTS):
        inc.add(found)
    inc.retire(points="P3")
    assert inc.retired.held_points == ()
    assert "held" not in repr(inc)
    inc.retire(points="P1")
    assert inc.retired.held_points == ("P1",)
    assert "2 points (held: P1)" in repr(inc)
    del inc
    resumed = fga.IncrementalAdjustment.resume(journal)
    assert resumed.retired.held_points == ("P1",)
    resumed.settle(all=True)
    assert resumed.retired is None
