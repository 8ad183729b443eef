"""What the benchmarks of arrivals measure, with small sizes."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.entities import Photo
from factorgraph_adj.graph.observation_selection import filtered
from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Direction, ImagePoint, PhotoPosition
from tests.benchmarks.__main__ import with_arguments
from tests.benchmarks.arrivals import Options, Played, aims, by_hundreds, play, table
from tests.benchmarks.hour import Kept, Taken, together
from tests.benchmarks.players import Alone, Incremental, stream
from tests.benchmarks.roma import FIRST, order_of
from tests.benchmarks.thousand import measure, scene
from tests.benchmarks.timing import Spread
from tests.benchmarks.vehicle import TRACK, Drive, Event


def test_words_after_a_name_are_its_arguments():
    known = ("roma", "thousand", "soak")
    found = with_arguments(["thousand", "30", "100", "soak", "roma", "file"], known)
    assert found == {"thousand": ["30", "100"], "soak": [], "roma": ["file"]}
    assert with_arguments(["soak", "30"], known) == {"soak": [], "30": []}


def test_a_spread_of_nothing_is_undefined():
    assert Spread.of([1.0, 2.0, 6.0]).median == 2.0
    assert Spread.of([1.0, 2.0, 6.0]).longest == 6.0
    assert np.isnan(Spread.of([]).median)


def test_photos_of_roma_arrive_once_each():
    photos = 60
    for name in ("file", "7"):
        assert sorted(order_of(name, photos)) == list(range(FIRST, photos))
    assert order_of("7", photos) == order_of("7", photos) != order_of("8", photos)
    assert 0 not in order_of("all", photos)  # the datum


def test_a_small_block_takes_photos_and_single_observations():
    times = measure(scene(12, 60, arriving=4, single=2), told=False)
    assert len(times.photos) == 4
    assert len(times.single) == 4 + 3 * 2


def _whole(drive: Drive) -> Network:
    """Return the network of all that a drive sends, but for points that are seen once."""
    out = drive.network()
    events = list(drive.events())
    rays: dict[str, int] = {}
    for event in events:
        for p in event.points:
            out.add_point(p.name, p.coordinates, fixed="xyz" if all(p.fixed) else "")
        for f in event.photos:
            out.add_photo(
                f.name,
                f.camera,
                position=f.position,
                rotation=f.rotation,
                sigma_attitude=f.sigma_attitude,
            )
        for o in event.observations:
            if isinstance(o, ImagePoint):
                rays[o.point] = rays.get(o.point, 0) + 1
    alone = {p for p, n in rays.items() if n == 1}
    for event in events:
        out.add(*(o for o in event.observations if not alone & set(o.points())))
    return filtered(out, lambda kind, name: kind != "point" or name not in alone)


def test_the_vehicle_measures_what_it_says():
    drive = Drive(30.0, rays=100)
    network = _whole(drive)
    assert any(isinstance(o, Direction) for o in network.observations.values())
    photo, point, _, _ = network.images.columns()
    assert 80 < len(photo) / 30 < 120
    assert np.bincount(point).max() == TRACK[1]
    solution = fga.adjust(network)
    assert solution.converged
    assert 0.95 < solution.sigma0 < 1.05
    poses = solution.equations.unknowns["pose"]
    off = [solution.state["pose"][k, 9:] - drive.true[n] for n, k in poses.number.items()]
    assert np.abs(off).max() < 0.1  # GNSS alone: 0.05 m


def test_events_come_in_order_and_their_points_before_their_rays():
    told: set[str] = set()
    last = 0.0
    for event in Drive(30.0, rays=50).events():
        assert event.time >= last
        last = event.time
        told |= {p.name for p in event.points} | {f.name for f in event.photos}
        for o in event.observations:
            assert {p for p in o.points() if p} <= told
            if isinstance(o, ImagePoint | PhotoPosition):
                assert o.photo in told


class _Asleep:
    """Takes everything."""

    def add(self, *_: object, **__: object) -> None:
        """Take it."""


def test_what_comes_while_the_program_is_busy_is_taken_together():
    events = iter([Event(float(t), ()) for t in range(6)])
    ticks = count(0.0, 2.5)
    arrivals = list(together(events, _Asleep(), timer=lambda: next(ticks)))  # type: ignore[arg-type]
    assert [a.start for a in arrivals] == [0.0, 2.5, 5.0]
    assert [len(a.latencies) for a in arrivals] == [1, 2, 3]
    assert arrivals[1].latencies == (4.0, 3.0)


@pytest.mark.parametrize(("photos", "kept"), [(1, True), (5, False)])
def test_a_growing_backlog_is_not_kept_up(photos: int, kept: bool):
    found = Kept([Taken(float(t), t + 1.0, 1, 0, ()) for t in range(20)])
    found.arrivals += [Taken(float(t), t + 1.0, photos, 0, ()) for t in range(20, 30)]
    assert found.kept_up(30.0) is kept


def test_a_photo_enters_with_position_and_attitude_before_its_camera():
    network = Network("vehicle")
    network.add_camera("front", BrownForwardLens(), {"c": 5.0}, sigma={"c": 2e-3})
    inc = fga.IncrementalAdjustment(network)
    at = (0.0, 0.0, 2.0)
    photo = Photo("f", "front", position=at, rotation=np.eye(3), sigma_attitude=1e-3)
    arrival = inc.add(PhotoPosition("f", at, sigma=(0.03,) * 3), photos=[photo])
    assert [v.verdict for v in arrival.verdicts] == ["accepted"]


ARRIVING = ("single:25", "stations:16", "sphere2500:8", "victoria:6", "w10000:6", "plaza:2")


@pytest.mark.parametrize("name", ARRIVING)
def test_engines_and_gtsam_alone_take_the_same_stream(name: str):
    playing = stream(name)
    players = [Incremental("isam2"), Alone(0.01)]
    for each in players:
        each.begin(playing)
    for step in playing.steps[:4]:
        found, _ = [each.take(step) for each in players]
        assert found["suspect"] == 0
    off = players[0].compared(1)
    assert max(off.estimates, off.sigmas) < 1e-2


def test_edges_say_where_poses_are():
    playing = stream("w10000:12")
    inc, isam = Incremental("fronts"), Alone(0.01)
    for each in (inc, isam):
        each.begin(playing)
    for step in playing.steps:
        for each in (inc, isam):
            each.take(step)
    for number in (1, 6, 11):
        there = isam.isam.calculateEstimatePose2(number)
        assert inc.inc.pose(f"x{number}").position[:2] == pytest.approx(
            there.translation(), abs=1e-3
        )


@pytest.mark.slow("players as processes that alternate; short tests let them play in this one")
def test_players_alternate_in_processes_of_their_own():
    options = Options(arrivals=2, promise=1, players=("isam2", "gtsam"))
    played = play("single:25", options)
    assert [len(p.seconds) for p in played.values()] == [2, 2]
    lines = "\n".join(table("single:25", played))
    assert "settled" in lines
    assert "BROKEN" not in lines


def test_aims_compare_the_arrivals_that_both_took():
    played = {"before": Played(seconds=[8.0, 8.0]), "isam2": Played(seconds=[1.0, 1.0, 9.0, 9.0])}
    assert aims("stations:100", played) == ["isam2   of before: 0.125, at most 0.125: met"]
    assert by_hundreds([3.0] * 250, [1.0] * 199) == [3.0]
