"""The gain of a sight is what the adjustment has after the observation has entered.

Observations enter with the readings that their models give, so that nothing moves: the figures of
the target afterwards are then those that were expected, to rounding.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.entities import Photo
from factorgraph_adj.linear_system.cofactor_columns import FrontColumns
from factorgraph_adj.planning import possible_sights, sight_gains, sight_rows, target_functions
from factorgraph_adj.planning.candidates import Candidate
from factorgraph_adj.planning.next_sight import NextSight, NextSights
from factorgraph_adj.planning.targets import (
    DetectableDisplacement,
    DetectableError,
    PointPrecision,
    PositionError,
    RedundancyNumber,
    SemiAxis,
    Target,
    UndetectedShift,
)
from factorgraph_adj.simulation.measurement import look_at, measure
from tests.networks.small_block import small_block

NEAR = 1e-9
"""Relative difference of figures that are equal."""
ARCSEC = np.pi / 180 / 3600
STATIONS = {"S1": (0.0, 0.0, 1.0), "S2": (80.0, 5.0, 2.0), "S3": (45.0, 70.0, 0.5)}
POINTS = {
    "A": (10.0, 40.0, 3.0),
    "B": (60.0, 45.0, 6.0),
    "C": (30.0, 20.0, 4.0),
    "D": (70.0, 30.0, 9.0),
    "E": (35.0, 55.0, 2.0),
}
SEEN = {"S1": "S2 S3 A B C", "S2": "S1 S3 B C D", "S3": "S1 S2 A D E"}
TARGETS: tuple[Target, ...] = (
    PositionError(1e-9, ("D",)),
    PositionError(1e-9, ("A", "E"), axes="xy"),
    SemiAxis(1e-9, points=("B",)),
    SemiAxis(1e-9, points=("E",), dimension=3),
    PointPrecision(1e-9, ("C",), axes="z"),
    RedundancyNumber(0.99, ("S3-E-slope_distance",)),
    DetectableError(1.0, ("S1-A-zenith_angle", "S2-D-direction")),
    DetectableDisplacement(1e-9, ("D",), reference=("S*",)),
)


def survey(*, free: bool = False, instrument: bool = False) -> fga.Network:
    """Return three total stations that see one another and some points, with true readings."""
    network = fga.Network("three stations", datum="free" if free else "given")
    for name, at in (STATIONS | POINTS).items():
        fixed = "" if free else {"S1": "xyz", "S2": "x"}.get(name, "")
        network.add_point(name, at, fixed=fixed)
    edm = {"instrument": "T"} if instrument else {}
    if instrument:
        network.set_distance_meter("T", free=("zero",))
    for station, seen in SEEN.items():
        for target in seen.split():
            label = f"{station}-{target}"
            network.add(
                o.Direction(station, target, 0.0, sigma=3 * ARCSEC, id=f"{label}-direction"),
                o.ZenithAngle(station, target, 1.5, sigma=4 * ARCSEC, id=f"{label}-zenith_angle"),
                o.SlopeDistance(
                    station, target, 1.0, sigma=1e-3, id=f"{label}-slope_distance", **edm
                ),
            )
    network.add(o.HeightDifference("A", "E", 0.0, sigma=3e-4, id="levelled"))
    if not free:
        network.add(o.GnssPosition("B", POINTS["B"], sigma=(0.004, 0.004, 0.008), id="gnss"))
    return measure(network, seed=0, noise=False)


def settled(network: fga.Network, **options: object) -> fga.IncrementalAdjustment:
    """Return an adjustment of a network."""
    inc = fga.IncrementalAdjustment(network, policy="accept", **options)
    inc.settle()
    return inc


def predicted(inc: fga.IncrementalAdjustment, candidate: Candidate) -> list[o.Observation]:
    """Return the observations of a candidate with the readings that their models give."""
    network = inc.solution().as_network()
    for p in candidate.points:
        network.add_point(p.name, p.coordinates)
    for f in candidate.photos:
        network.add_photo(f.name, f.camera, position=f.position, rotation=f.rotation)
    given = [replace(m, id=f"next {n}") for n, m in enumerate(candidate.single)]
    network.add(*given)
    read = measure(network, seed=0, noise=False)
    images = {(m.photo, m.point): m for m in read.image_points(np.arange(read.images.size))}
    return [
        images[m.photo, m.point] if isinstance(m, o.ImagePoint) else read.observations[m.id]
        for m in given
    ]


def assert_is_what_comes(
    network: fga.Network, sight: NextSight, target: Target, **options: object
) -> None:
    """Let a sight enter a new adjustment, and compare the figures of the target."""
    inc = settled(network, **options)
    c = sight.candidate
    entered = inc.add(predicted(inc, c), points=c.points, photos=c.photos)
    assert {v.verdict for v in entered.verdicts} == {"accepted"}
    now = {f.item: f.before for f in inc.next_sights(target, most=1).figures}
    for figure in sight.figures:
        assert now[figure.item] == pytest.approx(figure.after, rel=NEAR)


def some(found: NextSights) -> list[NextSight]:
    """Return the best and the last sight of every composition of readings."""
    each: dict[tuple[str, ...], list[NextSight]] = {}
    for s in found.sights:
        each.setdefault(tuple(m.kind for m in s.candidate.single), []).append(s)
    return [s for own in each.values() for s in dict.fromkeys((own[0], own[-1]))]


@pytest.mark.parametrize(
    "target", TARGETS, ids=[f"{n} {type(t).__name__}" for n, t in enumerate(TARGETS)]
)
def test_a_sight_gains_what_was_expected(target):
    network = survey()
    inc = settled(network)
    found = inc.next_sights(target, most=1000, reach=1e3)
    chosen = some(found)
    assert {"direction", "height_difference", "gnss_position"} <= {
        next(iter(s.candidate.single)).kind for s in chosen
    } or len(chosen) >= 2
    assert all(a.gain >= b.gain for a, b in zip(found.sights, found.sights[1:], strict=False))
    for sight in chosen:
        assert_is_what_comes(network, sight, target)


def test_readings_by_themselves():
    network = survey(instrument=True)
    target = PositionError(1e-9, ("D",))
    found = settled(network).next_sights(target, most=1000, singly=True)
    kinds = {m.kind for s in found.sights for m in s.candidate.single}
    assert {"direction", "zenith_angle", "slope_distance"} <= kinds
    for sight in some(found):
        assert len(list(sight.candidate.single)) == 1
        assert_is_what_comes(network, sight, target)


@pytest.mark.parametrize(
    "target", [TARGETS[0], TARGETS[4], TARGETS[5], TARGETS[7]], ids=lambda t: type(t).__name__
)
def test_free_network(target):
    network = survey(free=True)
    found = settled(network).next_sights(target, most=1000, reach=1e3)
    assert found.sights
    for sight in some(found):
        assert_is_what_comes(network, sight, target)


def test_a_free_network_takes_nothing_that_notices_its_datum():
    network = survey(free=True)
    network.add(o.GnssPosition("B", POINTS["B"], sigma=(0.1, 0.1, 0.1), id="gnss"))
    network.observations.pop("gnss")
    inc = settled(network)
    gnss = Candidate("gnss", (o.GnssPosition("B", POINTS["B"], sigma=(0.1, 0.1, 0.1)),))
    tape = Candidate("tape", (o.SlopeDistance("A", "D", 60.0, sigma=1e-3),))
    assert [s.candidate.name for s in inc.next_sights("B", [gnss, tape]).sights] == ["tape"]


def test_few_are_solved_for_where_there_are_many_stations(monkeypatch):
    inc = settled(survey())
    every = inc.next_sights(["D", "E"], most=4, reach=1e3)
    monkeypatch.setattr(sight_gains, "MAX_HUB_COLUMNS", 0)
    monkeypatch.setattr(sight_gains, "SOLVED_TOGETHER", 3)
    few = inc.next_sights(["D", "E"], most=4, reach=1e3)
    assert [s.aim for s in few.sights] == [s.aim for s in every.sights]
    assert [s.gain for s in few.sights] == pytest.approx([s.gain for s in every.sights], rel=NEAR)


@pytest.mark.parametrize("hubs", [0, 400])
@pytest.mark.parametrize("kinds", [None, "height_difference"])
@pytest.mark.parametrize("free", [False, True])
def test_slices_of_any_size_give_the_same_gains(free, kinds, hubs, monkeypatch):
    """All candidates at once, and right-hand sides of four columns at most."""
    inc = settled(survey(free=free), engine="fronts")
    held = [] if free else [DetectableDisplacement(1e-9, ("D",), reference=("S3",))]
    target, options = [PositionError(1e-9, ("D",)), *held], {"kinds": kinds, "reach": 1e3}
    monkeypatch.setattr(sight_gains, "SOLVED_TOGETHER", 1000)
    every = inc.next_sights(target, most=4, **options)
    sizes: list[int] = []
    columns: list[int] = []
    times = FrontColumns.times

    def recorded(self, y):
        sizes.append(y.nbytes)
        columns.append(self.size)
        return times(self, y)

    monkeypatch.setattr(FrontColumns, "times", recorded)
    inc.next_sights(target, most=4, **options)
    assert max(sizes) > 8 * 4 * columns[0]
    sizes.clear()
    monkeypatch.setattr(sight_gains, "SOLVED_TOGETHER", 2)
    monkeypatch.setattr(sight_gains, "MAX_HUB_COLUMNS", hubs)
    monkeypatch.setattr(sight_gains, "MAX_SLICE_BYTES", 8 * 4 * columns[0])
    parts = inc.next_sights(target, most=4, **options)
    assert [s.aim for s in parts.sights] == [s.aim for s in every.sights]
    assert [s.gain for s in parts.sights] == pytest.approx([s.gain for s in every.sights], 1e-12)
    assert max(sizes) <= 8 * 4 * columns[0]


def test_more_sights_than_are_examined_are_refused(monkeypatch):
    inc = settled(survey())
    monkeypatch.setattr(possible_sights, "MAX_SIGHTS", 20)
    with pytest.raises(fga.InputError, match=r"21 sights .* more than the 20 .*`stations`"):
        inc.next_sights("D", reach=1e3)
    assert inc.next_sights("D", reach=1e3, to=["D"]).sights


def test_targets_of_too_many_points_are_refused(monkeypatch):
    """Instead of more memory than there is."""
    inc = settled(survey())
    assert inc.next_sights("*").sights
    with monkeypatch.context() as small:
        small.setattr(sight_gains, "MAX_PRODUCT_BYTES", 1000)
        with pytest.raises(fga.InputError, match=r"sights for \d points take .*fewer points.*`to`"):
            inc.next_sights("*")
    monkeypatch.setattr(target_functions, "MAX_FUNCTION_BYTES", 300)
    with pytest.raises(fga.InputError, match=r"has \d points, of at most 0 here"):
        inc.next_sights("*")


@pytest.mark.parametrize("engine", ["fronts", "isam2"])
def test_what_is_kept_between_questions_changes_no_answer(engine, monkeypatch):
    """After arrivals that move points, removals, new points and settling."""
    monkeypatch.setattr(sight_gains, "SOLVED_TOGETHER", 2)
    inc = settled(survey(), engine=engine)
    rng = np.random.default_rng(7)

    def asked() -> None:
        for options in (
            {},
            {"reach": 1e3, "stations": "S*"},
            {"singly": True, "kinds": "direction"},
        ):
            kept = inc.next_sights(["D", "E"], **options)
            memory, inc._sights = inc._sights, None
            fresh = inc.next_sights(["D", "E"], **options)
            inc._sights = memory
            assert kept.examined == fresh.examined
            assert [s.candidate.name for s in kept.sights] == [
                s.candidate.name for s in fresh.sights
            ]
            for a, b in zip(kept.sights, fresh.sights, strict=True):
                assert a.gain == pytest.approx(b.gain, rel=NEAR)
                assert a.figures[0].after == pytest.approx(b.figures[0].after, rel=NEAR)

    asked()
    for step, scale in enumerate((0.0, 1.0, 30.0)):
        sight = inc.next_sights("D", most=1, stations="S*").sights[0]
        given = predicted(inc, sight.candidate)
        noisy = [
            replace(m, id=f"{step} {n}", value=m.value + scale * float(rng.normal(0, m.sigma)))
            for n, m in enumerate(given)
        ]
        inc.add(noisy)
        asked()
    inc.remove("0 0")
    asked()
    inc.reweight("1 1", 0.25)
    asked()
    inc.add(
        [
            o.SlopeDistance(s, "N", float(np.hypot(30.0, 30.0)), sigma=5.0)
            for s in ("S1", "S2", "S3")
        ],
        points=[fga.Point("N", (35.0, 30.0, 5.0))],
    )
    asked()
    inc.settle()
    asked()


def test_partials_are_evaluated_again_only_where_points_have_moved(monkeypatch):
    inc = settled(survey())
    inc.next_sights("D")
    evaluated = []
    original = sight_rows.SightRows._renew

    def renew(self, places, which):
        evaluated.append(len(which))
        original(self, places, which)

    monkeypatch.setattr(sight_rows.SightRows, "_renew", renew)
    inc.next_sights("E")
    assert not evaluated
    monkeypatch.setattr(sight_rows, "KEPT_SHIFT", 0.0)
    sight = inc.next_sights("D", most=1, stations="S*").sights[0]
    (first, *rest) = predicted(inc, sight.candidate)
    inc.add([replace(first, id="moves", value=first.value + first.sigma), *rest])
    inc.next_sights("D")
    assert evaluated


def test_given_candidates_are_judged_alike():
    inc = settled(survey())
    found = inc.next_sights("E", most=6)
    again = inc.next_sights("E", [s.candidate for s in found.sights], most=6)
    assert [s.candidate.name for s in again.sights] == [s.candidate.name for s in found.sights]
    assert [s.gain for s in again.sights] == pytest.approx([s.gain for s in found.sights], rel=NEAR)


def test_a_sequence_is_that_of_sights_one_after_the_other():
    network = survey()
    inc = settled(network)
    sequence = inc.next_sights("D", most=3, sequence=True)
    for sight in sequence.sights:
        best = inc.next_sights("D", most=1).sights[0]
        assert best.gain == pytest.approx(sight.gain, rel=1e-8)
        assert best.figures[0].after == pytest.approx(sight.figures[0].after, rel=NEAR)
        given = [replace(m, id=None) for m in predicted(inc, sight.candidate)]
        inc.add(given)


def test_present_figures_are_those_of_the_engine_at_any_time():
    inc = settled(survey())
    rng = np.random.default_rng(41)
    for name in ("D", "B", "A"):
        best = inc.next_sights(name, most=1, stations="S*").sights[0]
        given = [replace(m, id=None) for m in predicted(inc, best.candidate)]
        noisy = [replace(m, value=m.value + float(rng.normal(0, m.sigma))) for m in given]
        assert {v.verdict for v in inc.add(noisy).verdicts} == {"accepted"}
        for point in POINTS:
            now = inc.next_sights(point, most=1).figures[0].before
            assert now == pytest.approx(np.sqrt(np.trace(inc.covariance(point))), rel=NEAR)


def test_new_points_have_no_gain_and_are_named():
    network = survey()
    network.add_point("N", (50.0, 20.0, 5.0))
    network.add_point("unplaced")
    inc = settled(network)
    found = inc.next_sights("D", most=1000, reach=1e3)
    assert set(found.determining) == {*(f"{s} to N" for s in STATIONS), "GNSS at N"}
    assert not [s for s in found.sights if "N" in s.candidate.name.split()]
    with pytest.raises(fga.InputError, match="is not determined"):
        inc.next_sights("N")


def test_a_station_without_orientation_reads_the_rest():
    network = survey()
    kept = network.copy()
    for name in [n for n in network.observations if n.startswith("S3") and "direction" in n]:
        del kept.observations[name]
    inc = settled(kept)
    # A direction that waits: no sight of its set goes to a known point.
    inc.add([], points=[fga.Point("far", (400.0, 300.0, 1.0))])
    entered = inc.add(o.Direction("S3", "far", 0.5, sigma=3 * ARCSEC))
    assert entered.verdicts[0].verdict == "waiting"
    (sight,) = inc.next_sights("D", stations="S3", to="D", reach=1e3).sights
    assert sight.lacks
    rest = [m for m in sight.candidate.single if m.kind != "direction"]
    (alone,) = inc.next_sights("D", Candidate("rest", tuple(rest))).sights
    assert sight.gain == pytest.approx(alone.gain, rel=NEAR)
    assert inc.next_sights("D", stations="S3", to="D", kinds="direction", reach=1e3).sights == ()


def test_photos_beside_total_stations_in_one_block():
    """With weighted points, σ of parts, a camera that is calibrated, and photos as candidates."""
    network = small_block()
    target = PositionError(1e-9, ("P7", "P10"))
    inc = settled(network)
    found = inc.next_sights(target, most=1000)
    for sight in (*some(found)[:3], found.sights[-1]):
        assert_is_what_comes(network, sight, target)
    centre = np.array([0.0, -10.0, 5.0])
    pose = Photo("F9", "D3", position=tuple(centre), rotation=look_at(centre, np.zeros(3)))
    rays = tuple(o.ImagePoint("F9", f"P{i}", 0.0, 0.0, sigma=0.004) for i in (1, 2, 3, 7, 8, 10))
    photo = Candidate("photo from the south", rays, photos=(pose,))
    blind = Candidate("two rays", rays[:2], photos=(pose,))
    judged = inc.next_sights(target, [photo, blind])
    (sight,) = judged.sights  # two rays do not orient it
    assert sight.aim == "photo from the south"
    assert_is_what_comes(network, sight, target)


def test_after_retirement_the_rest_is_judged_with_all_that_there_was():
    network = survey()
    network.add_point("Z", (20.0, 60.0, 3.0))
    for station, seen in (("S1", "Z"), ("S3", "Z")):
        network.add(
            o.Direction(station, seen, 0.0, sigma=3 * ARCSEC, id=f"{station}-Z-d"),
            o.SlopeDistance(station, seen, 1.0, sigma=1e-3, id=f"{station}-Z-s"),
            o.ZenithAngle(station, seen, 1.5, sigma=4 * ARCSEC, id=f"{station}-Z-z"),
        )
    network = measure(network, seed=0, noise=False)
    before = settled(network).next_sights("E", most=5, to="D")
    inc = settled(network)
    inc.retire(points=["Z"])
    after = inc.next_sights("E", most=5, to="D")
    assert [s.aim for s in after.sights] == [s.aim for s in before.sights]
    assert [s.gain for s in after.sights] == pytest.approx(
        [s.gain for s in before.sights], rel=1e-6
    )


def test_cost_and_choice():
    inc = settled(survey())
    found = inc.next_sights("D", costs={"direction": 20.0, "zenith_angle": 20.0}, singly=True)
    worth = [s.gain / s.cost for s in found.sights]
    assert worth == sorted(worth, reverse=True)
    assert {s.cost for s in found.sights} <= {1.0, 20.0}
    only = inc.next_sights("D", stations="S1", to=["A", "B"], reach=1e3)
    assert {s.candidate.name for s in only.sights} == {"S1 to A", "S1 to B"}
    near = inc.next_sights("D", stations="S1", reach=50.0)
    assert {s.candidate.name for s in near.sights} <= {"S1 to A", "S1 to C"}


def test_faulty_questions_are_refused():
    inc = settled(survey())
    for target, options, what in (
        ("Q", {}, "no point is named like 'Q'"),
        ("S1", {}, "held"),
        ([], {}, "needs a target"),
        (UndetectedShift(1e-3), {}, "no target of single observations"),
        (RedundancyNumber(0.5, ("none",)), {}, "no observation has an id or kind"),
        ("D", {"stations": "D"}, "no station that is set up"),
        ("D", {"kinds": "azimuth"}, "no kind of what has been observed"),
        ("D", {"to": "Q"}, "no point like 'Q'"),
        ("D", {"most": 0}, "most must be"),
        ("D", {"reach": -1.0}, "reach must be"),
        ("D", {"costs": {"direction": 0.0}}, "cost of 'direction'"),
    ):
        with pytest.raises(fga.InputError, match=what):
            inc.next_sights(target, **options)
    with pytest.raises(fga.InputError, match="no observations"):
        inc.next_sights("D", Candidate("nothing", ()))
    with pytest.raises(fga.InputError, match="nothing is determined"):
        fga.IncrementalAdjustment(fga.Network("empty")).next_sights("D")


def test_sentences():
    inc = settled(survey())
    best = str(inc.next_sights("D", most=1, stations="S*").sights[0])
    assert best.startswith("aim at ")
    assert " position error of D from " in best
    assert best.endswith(" mm")
    assert str(inc.next_sights("D", kinds="gnss_position").sights[0]).startswith("measure GNSS at ")
    height = inc.next_sights(PositionError(1e-9, ("A",), axes="z"), kinds="height_difference")
    assert str(height.sights[0]).startswith("level from ")
    assert "σ of the height of A from" in str(height.sights[0])
    control = inc.next_sights(RedundancyNumber(0.99, ("S3-E-slope_distance",)))
    assert "redundancy number of" in str(control.sights[0])
    assert repr(control).startswith("<Next sights, of ")
    assert "<table>" in control._repr_html_()
