"""Large networks in sections: the same answers as if the whole were adjusted with each arrival."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.entities import Point
from factorgraph_adj.incremental import commands, entry
from factorgraph_adj.incremental import commands as removal
from factorgraph_adj.linear_system import linearisation_error, section_choice
from factorgraph_adj.linear_system.front_system import FrontSystem
from factorgraph_adj.linear_system.rebase import Draft, NoMinimum, with_doubt
from factorgraph_adj.linear_system.section import Attempts
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import (
    ControlPoint,
    Direction,
    ImagePoint,
    Observation,
    PhotoPosition,
    SlopeDistance,
)
from factorgraph_adj.solve.linear_base import ReducedCofactors
from factorgraph_adj.solve.solution import Solution
from tests.benchmarks.vehicle import Drive, Event
from tests.networks.arriving import CASES

LONG = pytest.mark.slow(
    "sections of a network of many photos; "
    "short tests take constants, rows and factors that enter one"
)

PROMISE = 0.01
"""Largest deviation from the batch adjustment, relative to σ."""
SECONDS, RAYS = 40.0, 60
"""A short drive, and rays of each photo."""
BEFORE = 24.0
"""Seconds of it that arrive at once."""
BLOCKS = ("combined block", "own cameras", "held photo", "AICON, 12 photos", "camcal, weighted")
"""Networks with photos."""


@pytest.fixture(autouse=True)
def _small_networks_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(section_choice, "MIN_NETWORK_RAYS", 0)


class Driving:
    """A drive, part of which has arrived."""

    def __init__(self, *, gross: float = 0.0, seed: int = 1) -> None:
        self.drive = Drive(SECONDS, rays=RAYS, gross=gross, seed=seed)
        self.inc = fga.IncrementalAdjustment(self.drive.network())
        events = list(self.drive.events())
        self.add([e for e in events if e.time < BEFORE])
        self.later = [e for e in events if e.time >= BEFORE]

    def add(self, events: Iterable[Event]) -> fga.incremental.arrival.Arrival:
        taken = list(events)
        return self.inc.add(
            [o for e in taken for o in e.observations],
            points=[p for e in taken for p in e.points],
            photos=[f for e in taken for f in e.photos],
        )

    @property
    def system(self) -> FrontSystem:
        found = self.inc._state.system
        assert found is not None
        return found

    def play(self) -> Iterator[None]:
        for event in self.later:
            self.add([event])
            yield

    def batch(self) -> Solution:
        return fga.adjust(self.inc.network(), start=self.inc.solution(), tolerance=1e-7)


def deviations(driving: Driving, batch: Solution) -> tuple[float, int, int]:
    """Return the largest deviation of an unknown from the batch adjustment, relative to its σ.

    Returns:
        It, and the numbers of unknowns inside the section and outside.
    """
    worst, inside, outside = 0.0, 0, 0
    for kind, table in batch.equations.unknowns.tables.items():
        for number in np.flatnonzero(table.offset >= 0).tolist():
            name = table.names[number]
            value = driving.system.value(kind, name)
            stored = batch.state[kind][number]
            step = UNKNOWNS[kind].local(stored[None], value[None, : len(stored)])[0]
            sigma = np.sqrt(np.diag(batch.variable_covariance((kind, name))))
            step = step[: len(sigma)]
            worst = max(worst, float(np.max(np.abs(step) / np.where(sigma > 0, sigma, np.inf))))
            within = driving.system.covers([(kind, name)])
            inside, outside = inside + within, outside + (not within)
    return worst, inside, outside


def cofactor_gap(inc: fga.IncrementalAdjustment, batch: Solution, pairs: Sequence) -> float:
    """Return the largest error of covariances between points, relative to their σ."""
    worst = 0.0
    for a, b in pairs:
        sigma = [np.sqrt(np.diag(batch.covariance(p))) for p in (a, b)]
        gap = inc.covariance(a, b) - batch.covariance(a, b)
        worst = max(worst, float(np.abs(gap / np.outer(*sigma)).max()))
    return worst


@pytest.mark.slow("sections keep the promise in many networks; short tests take one network")
def test_everything_is_as_in_the_batch_inside_a_section_and_outside():
    driving = Driving()
    sections, outside, worst, gap = 0, 0, 0.0, 0.0
    rng = np.random.default_rng(2)
    for number, _ in enumerate(driving.play()):
        if number % 5:
            continue
        batch = driving.batch()
        far, _, beyond = deviations(driving, batch)
        worst, outside = max(worst, far), max(outside, beyond)
        sections += driving.system.section is not None
        assert driving.inc.redundancy == batch.redundancy
        assert driving.inc.n_observations == batch.n_observations
        assert driving.inc.vtpv == pytest.approx(batch.vtpv, rel=1e-4)
        points = [p.name for p in batch.network.points.values() if not all(p.fixed)]
        pairs = [tuple(rng.choice(points, 2)) for _ in range(20)]
        gap = max(gap, cofactor_gap(driving.inc, batch, [*pairs, *((p, p) for p, _ in pairs)]))
    assert sections >= 4 and outside > 50
    assert worst < PROMISE and gap < 2 * PROMISE
    driving.inc.settle()
    assert deviations(driving, driving.batch())[0] < 1e-6
    assert driving.system.section is None


def test_a_factor_of_a_user_enters_a_section():
    driving = Driving()
    for _ in driving.play():
        if driving.system.section is not None:
            break
    else:
        pytest.fail("no arrival took a section")
    batch = driving.batch()
    free = [p.name for p in batch.network.points.values() if not all(p.fixed)]
    inside = next(n for n in free if driving.system.covers([("point", n)]))
    outside = next(n for n in free if not driving.system.covers([("point", n)]))
    value = float(np.linalg.norm(batch.point(inside) - batch.point(outside))) + 0.01
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.002)

    def tape(key):
        return gtsam.RangeFactor3(key("point", inside), key("point", outside), value, noise)

    (verdict,) = driving.inc.add(factors={"tape": tape}).verdicts
    batch = driving.batch()
    found = fga.reliability(batch)
    assert verdict.verdict == "accepted"
    assert driving.inc.redundancy == batch.redundancy
    assert deviations(driving, batch)[0] < PROMISE
    assert verdict.w[0] == pytest.approx(found.w[found.row("tape")], rel=0.02)


@pytest.mark.slow("sections keep the promise in many networks; short tests take one network")
@pytest.mark.parametrize("name", BLOCKS)
def test_networks_keep_the_promise(name: str) -> None:
    for moment in CASES[name].play(1, 4):
        assert moment.promise <= 1.0, moment


@pytest.mark.slow("sections keep the promise in many networks; short tests take one network")
def test_verdicts_are_those_of_the_whole(monkeypatch):
    """T² with gross errors among the rays, and what is in, waits and is suspect at the end.

    Suspects come back at once where everything that they touch is in a section, otherwise when the
    whole is adjusted.
    """
    found = []
    for least in (0, 10**9):
        monkeypatch.setattr(section_choice, "MIN_NETWORK_RAYS", least)
        monkeypatch.setattr(section_choice, "MAX_SECTION_WORK", 1.0)
        driving = Driving(gross=0.02, seed=3)
        told, used = {}, 0
        for event in driving.later[:-2]:
            new = {v.id: v for v in driving.add([event]).verdicts if v.id not in told}
            told |= {i: v for i, v in new.items() if v.verdict != "waiting"}
            used += driving.system.section is not None
        assert (used > 0) == (least == 0)
        monkeypatch.setattr(section_choice, "MAX_SECTION_WORK", 0.0)
        for event in driving.later[-2:]:
            driving.add([event])
        found.append((told, driving.inc))
    (parts, a), (whole, b) = found
    assert {v.id for v in a.suspects} == {v.id for v in b.suspects} and a.suspects
    assert len(a) == len(b) and a.n_waiting == b.n_waiting
    assert parts.keys() == whole.keys() and len(parts) > 500
    for ident, v in parts.items():
        assert v.verdict == whole[ident].verdict
        assert v.t2 == pytest.approx(whole[ident].t2, rel=1e-2, abs=1e-2, nan_ok=True)


def section_with(driving: Driving, photos: int = 2) -> None:
    """Let photos arrive until a section stands for the network."""
    for event in driving.later[: 2 * photos + 2]:
        driving.add([event])
    assert driving.system.section is not None


@pytest.mark.slow("sections keep the promise in many networks; short tests take one network")
def test_what_is_removed_is_out_wherever_it_was():
    driving = Driving()
    section_with(driving)
    rays = list(driving.inc.network().image_points())
    unknowns = driving.system.unknowns
    far = [o for o in rays if o.photo not in unknowns["pose"].number]
    near = [o for o in rays if o.point in unknowns["point"].number]
    for o in (near[len(near) // 2], far[len(far) // 2]):
        ident = f"{o.photo}/{o.point}"
        driving.inc.remove(ident)
        with pytest.raises(fga.InputError):
            driving.inc.observation(ident)
        driving.add(driving.later[6:7])
        driving.later = driving.later[1:]
        batch = driving.batch()
        assert ident not in batch.observations.ids
        assert driving.inc.redundancy == batch.redundancy
        assert deviations(driving, batch)[0] < PROMISE


@LONG
def test_a_ledger_that_gives_its_room_back_keeps_its_sections():
    """Rows get new numbers when more than half of them have been taken out."""
    driving = Driving()
    section_with(driving)
    before = driving.inc._state.ledger.rows.n
    rays = [f"{o.photo}/{o.point}" for o in driving.inc.network().image_points()]
    photos = {o.split("/")[0] for o in rays}
    gone = sorted(photos)[: int(0.6 * len(photos))]
    driving.inc.remove([r for r in rays if r.split("/")[0] in gone])
    assert driving.inc._state.ledger.rows.n < before
    for event in driving.later[6:14]:
        driving.add([event])
    batch = driving.batch()
    assert driving.inc.redundancy == batch.redundancy
    assert deviations(driving, batch)[0] < PROMISE


@LONG
def test_the_whole_is_adjusted_again_when_sections_have_taken_as_long(monkeypatch):
    driving = Driving()
    section_with(driving)
    before = driving.system.whole.base
    assert driving.system.section is not None and driving.system.section.work > 0
    monkeypatch.setattr(section_choice, "MAX_SECTION_WORK", 0.0)
    driving.add(driving.later[6:7])
    driving.add(driving.later[7:8])
    assert driving.system.whole.base is not before
    assert deviations(driving, driving.batch())[0] < PROMISE


def outside(driving: Driving) -> list[str]:
    """Return the free points outside the section."""
    system, points = driving.system, driving.inc.network().points
    names = [n for n in system.whole.unknowns["point"].names if n in points]
    return [n for n in names if not all(points[n].fixed) and not system.covers([("point", n)])]


def scattered(driving: Driving, n: int, seed: int = 3) -> Iterator[Observation]:
    """Measure between points anywhere, and positions of any photos."""
    rng = np.random.default_rng(seed)
    inside = [n for n in driving.system.unknowns["point"].names if "/" not in n][:40]
    far, photos = outside(driving), driving.inc.network().photos
    value = driving.system.value
    for i in range(n):
        a, b = rng.choice(far, 2, replace=False)
        if i % 2:
            b = rng.choice([p for p in inside if value("point", p) is not None])
        x, y = (value("point", p) for p in (a, b))
        if i % 3 == 0:
            length = float(np.linalg.norm(x - y))
            yield SlopeDistance(a, b, length + 0.01 * rng.normal(), sigma=0.01, id=f"tape {i}")
        elif i % 3 == 1:
            at = tuple((x + 0.02 * rng.normal(size=3)).tolist())
            yield ControlPoint(a, at, sigma=(0.02,) * 3, id=f"control {i}")
        else:
            photo = rng.choice(sorted(photos))
            at = value("pose", photo)[9:] + 0.02 * rng.normal(size=3)
            yield PhotoPosition(photo, tuple(at.tolist()), sigma=(0.02,) * 3, id=f"antenna {i}")


@LONG
@pytest.mark.parametrize("seed", [1, 2])
def test_rows_beside_a_section_reach_the_whole_network(monkeypatch, seed):
    """Estimates, counts, vᵀPv and covariances anywhere, also of what no row touches."""
    monkeypatch.setattr(section_choice, "MAX_SECTION_WORK", np.inf)
    monkeypatch.setattr(section_choice, "MIN_SIZE_RATIO", 0)
    driving = Driving(seed=seed)
    section_with(driving)
    beside, removed = 0, ""
    for o in scattered(driving, 9, seed):
        driving.inc.add(o)
        section, joined = driving.system.section, list(driving.system.joined)
        assert section is not None
        beside += section.n_own > 0
        if len(joined) > 1 and not removed:
            removed = joined[-1]
            driving.inc.remove(removed)
    assert beside > 3 and removed
    batch = driving.batch()
    assert removed not in batch.observations.ids
    assert driving.inc.redundancy == batch.redundancy
    assert driving.inc.n_observations == batch.n_observations
    assert driving.inc.vtpv == pytest.approx(batch.vtpv, rel=1e-4)
    far, within, beyond = deviations(driving, batch)
    assert far < PROMISE and within > 50 and beyond > 50
    rng = np.random.default_rng(seed)
    names = [p.name for p in batch.network.points.values() if not all(p.fixed)]
    pairs = [tuple(rng.choice(names, 2)) for _ in range(30)]
    near = [p for i in ("tape 0", "tape 6") for p in driving.inc.observation(i).points()]
    pairs += [(a, b) for a in near for b in (*near, *names[::40])]
    assert cofactor_gap(driving.inc, batch, pairs) < 2 * PROMISE


@LONG
def test_what_a_section_makes_of_a_step_of_the_rest(monkeypatch):
    """(Q' − Q) g, of gradients by points outside and by photos of T."""
    monkeypatch.setattr(section_choice, "MIN_SIZE_RATIO", 0)
    driving = Driving()
    section_with(driving)
    for o in scattered(driving, 2):
        driving.inc.add(o)
    system, outer = driving.system, driving.system.whole
    assert system.section is not None and system.section.n_own
    far = outside(driving)
    both = [n for n in outer.unknowns["pose"].names if system.covers([("pose", n)])]
    some = [*(("point", n) for n in far[::30]), *(("pose", n) for n in both[:2])]
    rng = np.random.default_rng(1)
    g, expected = np.zeros(outer.unknowns.n_columns), 0.0
    for v in some:
        g[outer.columns(*v)] = rng.normal(size=len(outer.columns(*v)))
    found = linearisation_error._by_section(system, g)
    for a in some:
        for b in some:
            gap = system.cofactors(a, b) - outer.cofactors(a, b)
            expected = expected + gap @ g[outer.columns(*b)]
        at = found[outer.columns(*a)]
        scale = np.abs(outer.cofactors(a, a)).max() * np.abs(g).max()
        assert np.abs(at - expected).max() < 1e-6 * scale
        expected = 0.0


@pytest.mark.parametrize("least", [0, 10**9])
def test_rows_may_touch_constants_that_have_come_since(monkeypatch, least):
    monkeypatch.setattr(section_choice, "MIN_NETWORK_RAYS", least)
    driving = Driving()
    for event in driving.later[:6]:
        driving.add([event])
    assert (driving.system.section is not None) == (least == 0)
    names = driving.inc.network().points
    known = next(n for n in names if driving.system.value("point", n) is not None)
    at = driving.inc.estimate(known) + np.array([3.0, 4.0, 0.0])
    driving.inc.add(
        SlopeDistance(known, "new", 5.0, sigma=0.01, id="tape"),
        points=[Point("new", tuple(at.tolist()), fixed=(True,) * 3)],
    )
    assert "tape" in driving.inc.network().observations
    assert deviations(driving, driving.batch())[0] < PROMISE


def test_what_touches_nothing_of_the_rest_is_a_section_too(monkeypatch):
    """Directions between constants: their orientation is all that is new."""
    monkeypatch.setattr(section_choice, "MIN_SIZE_RATIO", 0)
    monkeypatch.setattr(FrontSystem, "most_beside", 0)  # there is no room beside the base
    driving = Driving()
    fixed = (True,) * 3
    names = {"pillar": (5.0, 5.0, 2.0), "north": (5.0, 95.0, 2.0), "east": (85.0, 5.0, 2.0)}
    before = driving.system.whole.base
    driving.inc.add(
        [
            Direction("pillar", "north", 0.1, sigma=1e-5, set="1", id="north"),
            Direction("pillar", "east", 0.1 + np.pi / 2 + 2e-5, sigma=1e-5, set="1", id="east"),
        ],
        points=[Point(n, at, fixed=fixed) for n, at in names.items()],
    )
    assert {"north", "east"} <= set(driving.inc.network().observations)
    assert driving.system.section is not None and driving.system.whole.base is before
    batch = driving.batch()
    assert driving.inc.redundancy == batch.redundancy
    assert deviations(driving, batch)[0] < PROMISE


@LONG
def test_the_rest_is_solved_for_what_is_new_in_a_section(monkeypatch):
    """Cofactors of T that the section before had are the same to the last bit."""
    monkeypatch.setattr(section_choice, "MAX_SECTION_WORK", np.inf)
    monkeypatch.setattr(section_choice, "MIN_SIZE_RATIO", 0)
    driving = Driving()
    section_with(driving, 1)
    before, asked = driving.system.section, []
    times = ReducedCofactors.times

    def counted(self, at, b):
        asked.append(len(at))
        return times(self, at, b)

    monkeypatch.setattr(ReducedCofactors, "times", counted)
    assert before is not None
    _, after = section_choice.section_of(driving.inc._state.ledger, driving.system)
    assert np.array_equal(after.columns, before.columns) and not asked
    assert np.array_equal(after.spread, before.spread)
    for event in driving.later[4:8]:
        driving.add([event])
    section = driving.system.section
    assert section is not None and section.lifted is before.lifted
    monkeypatch.setattr(ReducedCofactors, "times", times)
    at = section.lifted.place[section.columns]
    found = section.lifted.times(at, np.eye(len(at)))
    assert np.abs(section.spread - found).max() <= 1e-12 * np.abs(found).max()


def test_rows_touch_no_more_of_the_rest_than_there_is_room_for():
    driving = Driving()
    section_with(driving)
    system = driving.system
    far = [("point", n) for n in outside(driving)]
    room = system.lifted.slots - len(system.slots)
    assert system.reaching(far[:5]).section.n_own == 15
    again = system.reaching(far[:5]).reaching(far[3:8])
    assert again.section.n_own == 24
    assert not system.has_room({k: k for k in range(room + len(system.slots) + 1)})
    poses = [
        ("pose", n) for n in system.whole.unknowns["pose"].names if not system.covers([("pose", n)])
    ]
    assert len(far) + 2 * len(poses) <= room or system.reaching([*far, *poses]) is None


@LONG
def test_observations_between_known_points_are_sections_too(monkeypatch):
    monkeypatch.setattr(section_choice, "MAX_SECTION_WORK", np.inf)
    monkeypatch.setattr(section_choice, "MIN_SIZE_RATIO", 0)
    driving = Driving()
    section_with(driving)
    batch = driving.batch()
    known = outside(driving)[:40:8]
    for i, (a, b) in enumerate(pairwise(known)):
        x, y = (batch.point(n) for n in (a, b))
        length = float(np.linalg.norm(x - y))
        arrival = driving.inc.add(SlopeDistance(a, b, length, sigma=5e-3, id=f"tape {i}"))
        assert [v.verdict for v in arrival.verdicts] == ["accepted"]
        at = tuple((y + 0.002).tolist())
        driving.inc.add(ControlPoint(b, at, sigma=(0.01,) * 3, id=f"control {i}"))
    assert driving.system.section is not None
    after = driving.batch()
    assert driving.inc.redundancy == after.redundancy
    assert deviations(driving, after)[0] < PROMISE
    assert cofactor_gap(driving.inc, after, [(a, b) for a in known for b in known]) < 2 * PROMISE


@LONG
def test_a_gross_error_between_known_points_is_left_out_of_a_section():
    driving = Driving()
    section_with(driving)
    outer = driving.system.whole
    names = [n for n in outer.unknowns["point"].names if not driving.system.covers([("point", n)])]
    batch = driving.batch()
    a, b = [n for n in names if n in batch.network.points][:9:8]
    length = float(np.linalg.norm(batch.point(a) - batch.point(b)))
    before = driving.system.base
    arrival = driving.inc.add(SlopeDistance(a, b, length + 5.0, sigma=5e-3, id="wrong"))
    assert [v.verdict for v in arrival.verdicts] == ["suspect"]
    assert "wrong" in [v.id for v in driving.inc.suspects]
    assert driving.system.base is before


def test_image_points_of_a_free_network_are_not_cut():
    network = CASES["combined block, free"].make()
    inc = fga.IncrementalAdjustment(network)
    o = next(o for o in network.image_points())
    ident = f"{o.photo}/{o.point}"
    inc.remove(ident)
    inc.add(ImagePoint(o.photo, o.point, o.x, o.y, sigma=o.sigma))
    system = inc._state.system
    assert system is not None and system.section is None


@LONG
def test_photos_that_come_together_are_taken_one_by_one(monkeypatch):
    """The same is in, and everything is in the same place, as if they had come one by one."""
    monkeypatch.setattr(section_choice, "MAX_RAYS_PER_PIECE", RAYS)
    together, alone = Driving(seed=4), Driving(seed=4)
    rows = []
    taken = section_choice.in_pieces

    def noted(*arguments):
        rows.append(taken(*arguments))
        return rows[-1]

    monkeypatch.setattr(commands, "in_pieces", noted)
    together.add(together.later[:13])
    assert len(rows[-1]) > 3
    assert sum(map(len, rows[-1])) == len(np.unique(np.concatenate(rows[-1])))
    for event in alone.later[:13]:
        alone.add([event])
    assert len(together.inc) == len(alone.inc) and together.inc.n_waiting == alone.inc.n_waiting
    assert {v.id for v in together.inc.suspects} == {v.id for v in alone.inc.suspects}
    assert deviations(together, alone.batch())[0] < 2 * PROMISE


@LONG
def test_what_the_rest_has_is_removed_from_where_everything_is(monkeypatch):
    """The whole is adjusted from its state, without finding out anew what is determined."""
    driving = Driving()
    section_with(driving)
    unknowns = driving.system.unknowns
    rays = list(driving.inc.network().image_points())
    count = Counter(o.point for o in rays)
    far = next(o for o in rays if o.photo not in unknowns["pose"].number and count[o.point] > 3)

    def refused(*_: object) -> None:
        raise AssertionError("everything is looked for anew")

    monkeypatch.setattr(removal, "adjusted", refused)
    driving.inc.remove(f"{far.photo}/{far.point}")
    assert driving.system.section is None
    assert deviations(driving, driving.batch())[0] < PROMISE


@LONG
def test_a_section_without_minimum_is_not_followed_by_another():
    """What is wrong with a system would be forgotten with it."""
    driving = Driving()
    section_with(driving)
    system = with_doubt(driving.system, "no minimum")
    assert section_choice.section_of(driving.inc._state.ledger, system) is None
    assert section_choice.section_of(driving.inc._state.ledger, driving.system) is not None


@LONG
def test_what_comes_to_no_minimum_in_a_section_waits(monkeypatch):
    """The whole, from the same values, would only take longer to find none."""
    driving = Driving()
    section_with(driving)
    adjusted = Draft.adjusted

    def creeping(draft: Draft, *arguments, **options):
        assert draft.section is not None, "the whole is adjusted"
        adjusted(draft, *arguments, **options)
        return NoMinimum("stopped after 200 iterations")

    with monkeypatch.context() as patch:
        patch.setattr(Draft, "adjusted", creeping)
        before, waiting = len(driving.inc), driving.inc.n_waiting
        driving.add(driving.later[7:8])
        assert len(driving.inc) == before and driving.inc.n_waiting > waiting + 50
    driving.inc.settle()
    assert len(driving.inc) > before + 50
    assert deviations(driving, driving.batch())[0] < PROMISE


@LONG
def test_rows_of_the_rest_that_left_make_no_section(monkeypatch):
    """A ray to a point with a tape distance leaves: what the rest says of the point has changed."""
    driving = Driving()
    rays = driving.inc.network().image_points()
    (a, _), (b, _) = Counter(o.point for o in rays).most_common(2)
    length = float(np.linalg.norm(driving.inc.estimate(a) - driving.inc.estimate(b)))
    driving.inc.add(SlopeDistance(a, b, length, sigma=5e-3, id="tape"))
    driving.inc.settle()
    section_with(driving)
    ledger = driving.inc._state.ledger
    unknowns = driving.system.unknowns
    mine = ledger.rows.images(driving.system.whole.rows)
    mine = mine[ledger.rows.point[mine] == ledger.names.point[a]]
    assert len(mine) and a not in unknowns["point"].number
    assert section_choice.section_of(ledger, driving.system) is not None
    gone = ledger.moved(mine[:1], None, "remove")
    assert section_choice.section_of(gone, driving.system) is None


def test_a_look_at_the_rest_that_has_no_answer_leaves_it_to_the_whole(monkeypatch):
    driving = Driving()

    def unanswered(*_: object) -> None:
        raise fga.InputError("an observation of the rest has no answer")

    monkeypatch.setattr(entry, "with_rest", unanswered)
    for event in driving.later[:4]:
        driving.add([event])
    assert driving.system.section is None
    assert deviations(driving, driving.batch())[0] < PROMISE


def test_sections_are_tried_less_often_while_they_fail():
    attempts, tried = Attempts(), []
    for number in range(60):
        tried.append(not attempts.waits)
        attempts = attempts.passed() if attempts.waits else attempts.failed()
        assert attempts.waits <= number
    assert np.flatnonzero(tried).tolist() == [0, 1, 3, 7, 15, 31, 47]
