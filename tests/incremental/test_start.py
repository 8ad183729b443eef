"""What is described and not determined waits from the start, whatever was said of it.

A network that has observations also describes a point, a photo, a camera, a set of directions, a
refraction group, a vertical or a distance meter. Nothing observes it, too few readings do, or its
weights determine it. The state must be that of the other observations; later readings that
determine it bring it in, and everything equals the batch adjustment of all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import (
    Direction,
    HeightDifference,
    ImagePoint,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.support.arrivals import compare, difference, variables

LONG = pytest.mark.slow("each start with a journal beside it; short tests take the start alone")

Datum = Literal["given", "free"]
AT_REST = 1e-6
"""Largest deviation of a settled state from the batch adjustment, relative to σ."""
MM = 1e-3
FOCAL = 28.0
"""Principal distance, mm."""
AT = {
    "A": (0.0, 0.0, 0.0),
    "B": (900.0, 50.0, 140.0),
    "C": (150.0, 800.0, -60.0),
    "D": (700.0, 950.0, 90.0),
    "P": (400.0, 450.0, 300.0),
    "Q": (600.0, 300.0, -200.0),
    "R": (300.0, 200.0, 160.0),
}
"""Where the points are, metres."""
GIVEN = "ABCD"
CENTRE = np.array([450.0, -600.0, 900.0])
"""Where the photo was taken from."""
LOOK = look_at(CENTRE, np.array([450.0, 450.0, 50.0]))
"""How."""
ASTRAY = np.array([0.1, -0.08, 0.06])
"""Error of approximate coordinates: 0.14 m."""


def site(datum: Datum = "given") -> fga.Network:
    """Return four given points and P with five distances; in a free network all ten of theirs."""
    network = fga.Network("site", datum=datum)
    free = datum == "free"
    for name in GIVEN:
        network.add_point(name, AT[name], fixed="" if free else "xyz")
    network.add_point("P", np.array(AT["P"]) + ASTRAY)
    network.add(*(distance(a, "P", error=e) for a, e in zip(GIVEN, (1, -2, 1, 1), strict=True)))
    network.add(distance("A", "P", error=2, tag="again"))
    if free:
        pairs = zip(("AB", "AC", "AD", "BC", "BD", "CD"), (0, 1, -1, 2, 0, -1), strict=True)
        network.add(*(distance(*pair, error=e) for pair, e in pairs))
    return network


def offset(a: str, b: str) -> Array:
    return np.subtract(AT[b], AT[a])


def distance(
    a: str, b: str, *, error: float = 0.0, meter: str | None = None, tag: str = ""
) -> Observation:
    """Return a slope distance with σ 2 mm; its error in mm."""
    value = float(np.linalg.norm(offset(a, b))) + MM * error
    return SlopeDistance(a, b, value, sigma=2 * MM, instrument=meter, id=f"s{a}{b}{tag}")


def zenith(a: str, b: str, *, error: float = 0.0, group: str | None = None) -> Observation:
    """Return a zenith angle with σ 2″; its error in seconds of arc."""
    d = offset(a, b)
    value = float(np.arctan2(np.hypot(d[0], d[1]), d[2])) + error * ARCSEC
    return ZenithAngle(a, b, value, sigma=2 * ARCSEC, refraction=group, id=f"z{a}{b}")


def direction(a: str, b: str, *, error: float = 0.0, set: str = "2") -> Observation:
    """Return a direction with σ 2″, of a set that is oriented to north."""
    d = offset(a, b)
    value = float(np.arctan2(d[0], d[1])) % (2 * np.pi) + error * ARCSEC
    return Direction(a, b, value, sigma=2 * ARCSEC, set=set, id=f"r{a}{b}{set}")


def ray(photo: str, point: str, *, error: float = 0.0) -> Observation:
    """Return an image point with σ 4 µm; the error of x in µm."""
    p = LOOK.T @ (np.array(AT[point]) - CENTRE)
    x, y = FOCAL * p[0] / p[2] + error * 1e-3, -FOCAL * p[1] / p[2]
    return ImagePoint(photo, point, float(x), float(y), sigma=0.004)


# -- what is described, and what observes it ------------------------------------------------------


def point(network: fga.Network) -> None:
    network.add_point("Q", np.array(AT["Q"]) - ASTRAY)


def weighted_point(network: fga.Network) -> None:
    network.add_point("Q", np.array(AT["Q"]) + 0.003, sigma=0.005)


def photo(network: fga.Network, **weights: float) -> None:
    network.add_camera("K", NoDistortion(), {"c": FOCAL})
    turned = LOOK @ exp_rotation(np.array([1e-4, -2e-4, 1e-4]))
    network.add_photo("F", "K", position=CENTRE + 0.05, rotation=turned, **weights)


def weighted_photo(network: fga.Network) -> None:
    photo(network, sigma_position=0.1, sigma_attitude=3e-4)


def half_weighted_photo(network: fga.Network) -> None:
    photo(network, sigma_position=0.1)


def camera(network: fga.Network, *, per_photo: bool = False) -> None:
    free = {"free": ("c", "x0", "y0")}
    network.add_camera("K", NoDistortion(), {"c": FOCAL + 0.02}, per_photo=per_photo, **free)
    network.add_photo("F", "K", position=CENTRE, rotation=LOOK, fixed=True)


def own_camera(network: fga.Network) -> None:
    camera(network, per_photo=True)


def camera_and_photo(network: fga.Network) -> None:
    network.add_camera("K", NoDistortion(), {"c": FOCAL + 0.02}, free=("c",))
    network.add_photo("F", "K", position=CENTRE + 0.05, rotation=LOOK)


def weighted_camera(network: fga.Network) -> None:
    weights = {"c": 0.02, "x0": 0.01, "y0": 0.01}
    network.add_camera("K", NoDistortion(), {"c": FOCAL + 0.01}, sigma=weights)
    network.add_photo("F", "K", position=CENTRE, rotation=LOOK, fixed=True)


def orientation(network: fga.Network) -> None:
    point(network)
    network.set_orientation("A", set="2", value=1e-4)


def weighted_orientation(network: fga.Network) -> None:
    network.set_orientation("A", set="2", value=1e-5, sigma=2e-5)


def refraction(network: fga.Network) -> None:
    point(network)
    network.set_refraction("ray")


def weighted_refraction(network: fga.Network) -> None:
    network.set_refraction("ray", value=0.1, sigma=0.2)


def vertical(network: fga.Network) -> None:
    network.set_vertical("B", xi=5 * ARCSEC, eta=-8 * ARCSEC)


def weighted_vertical(network: fga.Network) -> None:
    network.set_vertical("B", xi=2 * ARCSEC, eta=-1 * ARCSEC, sigma=3 * ARCSEC)


def meter(network: fga.Network) -> None:
    network.set_distance_meter("edm", scale=1e-5, zero=0.02, free=("scale", "zero"))


def weighted_meter(network: fga.Network) -> None:
    network.set_distance_meter("edm", scale=1e-6, sigma_scale=2e-6, sigma_zero=0.002)


@dataclass(frozen=True)
class Case:
    """Something that is described, and its readings."""

    variable: tuple[str, str]
    """Its kind and name."""
    describe: Callable[[fga.Network], None]
    """Describes it with given values and without weights."""
    few: tuple[Observation, ...]
    """Readings that do not determine it."""
    rest: tuple[Observation, ...]
    """Readings that do, with those."""


TO_Q = tuple(distance(a, "Q", error=e) for a, e in zip(GIVEN, (1, 2, -1, 0), strict=True))
"""Distances that determine Q."""
MEASURED = tuple(distance(*ab, error=e, meter="edm", tag="m") for ab, e in (("AC", 1), ("BD", -2)))
"""Distances with the distance meter, of different lengths."""
CASES = {
    "point, one distance": Case(("point", "Q"), point, TO_Q[:1], TO_Q[1:]),
    "point, two distances": Case(("point", "Q"), point, TO_Q[:2], TO_Q[2:]),
    "point, on a ray": Case(
        ("point", "Q"), point, (direction("A", "B"), direction("A", "Q"), zenith("A", "Q")), TO_Q
    ),
    "photo": Case(
        ("pose", "F"),
        photo,
        (ray("F", "A", error=2), ray("F", "B")),
        (ray("F", "C", error=-3), ray("F", "D"), ray("F", "P", error=1)),
    ),
    "camera": Case(
        ("calibration", "K"),
        camera,
        (ray("F", "A", error=2),),
        (ray("F", "B"), ray("F", "C", error=-3), ray("F", "D")),
    ),
    "camera for each photo": Case(
        ("calibration", "K@F"),
        own_camera,
        (ray("F", "A", error=2),),
        (ray("F", "B"), ray("F", "C", error=-3), ray("F", "D")),
    ),
    "camera with its photo": Case(
        ("calibration", "K"),
        camera_and_photo,
        (ray("F", "A", error=2), ray("F", "B"), ray("F", "C", error=-3)),
        (ray("F", "D"), ray("F", "P")),
    ),
    "orientation": Case(
        ("orientation", "A/2"),
        orientation,
        (direction("A", "Q"), TO_Q[0]),
        (direction("A", "B", error=1), direction("A", "C", error=-2), *TO_Q[1:]),
    ),
    "refraction": Case(
        ("refraction", "ray"),
        refraction,
        (zenith("A", "Q", group="ray"), *TO_Q[:2]),
        (zenith("A", "B", error=1, group="ray"), zenith("A", "C", group="ray"), *TO_Q[2:]),
    ),
    "vertical": Case(
        ("vertical", "B"),
        vertical,
        (zenith("B", "A", error=1),),
        (zenith("B", "C"), zenith("B", "D", error=-2)),
    ),
    "distance meter": Case(
        ("edm", "edm"), meter, (distance("A", "B", error=-1, meter="edm", tag="m"),), MEASURED
    ),
    "distance meter, on one line": Case(
        ("edm", "edm"),
        meter,
        tuple(distance(*ab, error=1, meter="edm", tag="m") for ab in ("AB", "BA")),
        MEASURED,
    ),
}
WEIGHTED: dict[str, tuple[str, Callable[[fga.Network], None]]] = {
    "point": ("point, one distance", weighted_point),
    "photo": ("photo", weighted_photo),
    "camera": ("camera", weighted_camera),
    "orientation": ("orientation", weighted_orientation),
    "refraction": ("refraction", weighted_refraction),
    "vertical": ("vertical", weighted_vertical),
    "distance meter": ("distance meter", weighted_meter),
}
"""The case and what describes the same with weights that determine it."""


def described(name: str, *, few: bool = False, datum: Datum = "given") -> fga.Network:
    """Return the site with what a case describes, with too few readings of it or none."""
    network = site(datum)
    CASES[name].describe(network)
    if few:
        network.add(*CASES[name].few)
    return network


def plain(name: str) -> fga.Network:
    """Return the site with those of the few readings of a case that are determined without it."""
    network = site()
    if name == "point, on a ray":  # the set is oriented without Q
        network.add(CASES[name].few[0])
    return network


def ident(o: Observation) -> str:
    """Return the id of an observation."""
    return f"{o.photo}/{o.point}" if isinstance(o, ImagePoint) else str(o.id)  # type: ignore[attr-defined]


def known(inc: fga.IncrementalAdjustment) -> set[tuple[str, str]]:
    """Return kind and name of everything that is determined."""
    return set(variables(inc.solution()))


def assert_stands(inc: fga.IncrementalAdjustment, network: fga.Network) -> None:
    """The state is the adjustment of a network, and judges what comes next as that does."""
    alone = fga.adjust(network, tolerance=1e-9)
    assert alone.converged
    solution = inc.solution()
    assert solution.converged, solution.reason
    assert known(inc) == set(variables(alone))
    assert inc.redundancy == alone.redundancy == solution.redundancy
    assert_equal(inc, alone, 1e-2)
    good = distance("B", "P", error=3, tag="next")
    (told,) = inc.add(good).verdicts
    (expected,) = fga.IncrementalAdjustment(network).add(good).verdicts
    assert told.verdict == expected.verdict == "accepted"
    assert told.test == pytest.approx(expected.test, abs=0.02)
    inc.remove(good.id)  # type: ignore[attr-defined]


def assert_equal(inc: fga.IncrementalAdjustment, theirs: fga.Solution, bound: float) -> None:
    """Estimates and standard deviations of all unknowns are those of an adjustment."""
    found = difference(inc.solution(), theirs)
    assert max(found.estimates, found.sigmas) <= bound


def assert_as_batch(inc: fga.IncrementalAdjustment, whole: fga.Network) -> None:
    """Everything is in, and equals the batch adjustment: to 1 %, and settled to 1e-6."""
    assert not inc.waiting
    assert not inc.suspects
    theirs = fga.adjust(whole, tolerance=1e-9)
    assert theirs.converged
    assert known(inc) == set(variables(theirs))
    assert_equal(inc, theirs, 1e-2)
    inc.settle()
    assert inc.settled
    assert_equal(inc, theirs, AT_REST)
    moment = compare(inc, "settled", rng=np.random.default_rng(1))
    assert moment is not None
    assert not moment.no_batch
    assert moment.promise <= 1.0
    assert inc.redundancy == theirs.redundancy


def with_all(name: str, network: fga.Network) -> fga.Network:
    """Return a network with those readings of a case that it does not have."""
    out = network.copy()
    there = {*out.observations, *map(ident, out.image_points())}
    out.add(*(o for o in (*CASES[name].few, *CASES[name].rest) if ident(o) not in there))
    return out


# -- from the start -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_what_nothing_observes_waits(name: str) -> None:
    case, network = CASES[name], described(name)
    inc = fga.IncrementalAdjustment(network)
    assert_stands(inc, site())
    assert not inc.waiting
    inc.add(case.few)
    assert case.variable not in known(inc)
    inc.add(case.rest)
    assert case.variable in known(inc)
    assert_as_batch(inc, with_all(name, network))


@pytest.mark.parametrize("name", CASES)
def test_what_too_few_readings_observe_waits_with_them(name: str) -> None:
    case, network = CASES[name], described(name, few=True)
    inc = fga.IncrementalAdjustment(network)
    assert_stands(inc, plain(name))
    assert {w.kind for w in inc.waiting} <= {o.kind for o in case.few}
    assert inc.n_waiting == len(case.few) - (name == "point, on a ray")
    assert all(w.lacks for w in inc.waiting)
    # As it does where the same arrives later.
    later = fga.IncrementalAdjustment(described(name))
    later.add(case.few)
    assert {(w.id, w.lacks) for w in inc.waiting} == {(w.id, w.lacks) for w in later.waiting}
    for o in case.rest:
        inc.add(o)
    assert case.variable in known(inc)
    assert_as_batch(inc, with_all(name, network))


@pytest.mark.parametrize("name", CASES)
def test_what_enough_readings_observe_is_in(name: str) -> None:
    network = with_all(name, described(name))
    assert_as_batch(fga.IncrementalAdjustment(network), network)


@pytest.mark.parametrize("name", CASES)
def test_beside_a_free_network_it_waits_too(name: str) -> None:
    case, network = CASES[name], described(name, few=True, datum="free")
    inc = fga.IncrementalAdjustment(network)
    assert_stands(inc, site("free"))
    assert inc.n_waiting == len(case.few)


@pytest.mark.parametrize("name", ["point, one distance", "photo", "distance meter"])
def test_it_enters_a_free_network(name: str) -> None:
    case, network = CASES[name], described(name, few=True, datum="free")
    inc = fga.IncrementalAdjustment(network)
    inc.add(case.rest)
    assert case.variable in known(inc)
    assert_as_batch(inc, with_all(name, network))


def test_several_wait_beside_each_other() -> None:
    """All kinds at once; each enters with its own readings."""
    names = ("photo", "orientation", "vertical", "distance meter")
    network = site()
    for name in names:
        CASES[name].describe(network)
    network.set_refraction("ray")
    network.add_camera("L", NoDistortion(), {"c": FOCAL}, free=("c",))
    inc = fga.IncrementalAdjustment(network)
    assert_stands(inc, site())
    for name in names:
        assert CASES[name].variable not in known(inc)
        inc.add((*CASES[name].few, *CASES[name].rest))
        assert CASES[name].variable in known(inc)
    assert not inc.waiting
    inc.settle()
    assert ("refraction", "ray") not in known(inc)
    assert ("calibration", "L") not in known(inc)
    moment = compare(inc, "settled", rng=np.random.default_rng(1))
    assert moment is not None
    assert moment.promise <= 1.0


def test_a_camera_waits_for_a_photo_that_is_described_later() -> None:
    network = site()
    network.add_camera("K", NoDistortion(), {"c": FOCAL + 0.02}, free=("c",))
    inc = fga.IncrementalAdjustment(network)
    assert_stands(inc, site())
    whole = network.copy()
    whole.add_photo("F", "K", position=CENTRE + 0.05, rotation=LOOK)
    rays = [ray("F", p, error=e) for p, e in zip("ABCDP", (2, 0, -3, 1, 0), strict=True)]
    inc.add(rays, photos=[whole.photos["F"]])
    whole.add(*rays)
    assert_as_batch(inc, whole)


def test_two_points_that_only_hang_together_wait_beside_a_core_without_redundancy() -> None:
    """Each has as many readings as coordinates, both together have not."""
    network = fga.Network("hardly")
    for name in GIVEN:
        network.add_point(name, AT[name], fixed="xyz")
    for name in "PQ":
        network.add_point(name, np.array(AT[name]) + ASTRAY)
    network.add_point("R", np.array(AT["R"]) + ASTRAY)
    network.add(*(distance(a, p) for a, p in ("AR", "BR", "CR", "AP", "RP", "PQ", "CQ", "DQ")))
    inc = fga.IncrementalAdjustment(network)
    assert inc.solution().converged
    assert inc.redundancy == 0
    assert known(inc) == {("point", "R")}
    assert {w.id for w in inc.waiting} == {"sAP", "sRP", "sPQ", "sCQ", "sDQ"}
    inc.add(distance("C", "P"))
    assert not inc.waiting
    assert known(inc) == {("point", n) for n in "PQR"}


def test_a_state_without_minimum_stays_where_it_started_beside_what_waits() -> None:
    """A distance of 1000 km: what is determined is in, says so, and recovers."""
    network = described("point, one distance", few=True)
    network.add(SlopeDistance("B", "P", 1e6, sigma=MM, id="wild"))
    inc = fga.IncrementalAdjustment(network)
    assert {w.id for w in inc.waiting} == {"sAQ"}
    assert ("point", "Q") not in known(inc)
    inc.remove("wild")
    assert_stands(inc, site())


# -- weights --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WEIGHTED)
@pytest.mark.parametrize("beside", [False, True])
def test_what_weights_determine_is_in_from_the_start(name: str, beside: bool) -> None:
    """Whether something else waits or not."""
    of, describe = WEIGHTED[name]
    case, network = CASES[of], site()
    describe(network)
    theirs = fga.adjust(network, tolerance=1e-9)
    if beside:
        network.add_point("W", (10.0, 20.0, 30.0))
        network.add(HeightDifference("A", "W", 30.0, sigma=MM, id="waits"))
    inc = fga.IncrementalAdjustment(network)
    assert inc.solution().converged
    assert [w.id for w in inc.waiting] == ["waits"] * beside
    assert case.variable in known(inc)
    assert inc.redundancy == theirs.redundancy == fga.adjust(site()).redundancy
    assert_equal(inc, theirs, 1e-2)
    (told,) = inc.add(distance("B", "P", error=3, tag="next")).verdicts
    assert told.verdict == "accepted"
    readings = [o for o in (*case.few, *case.rest) if "Q" not in o.names() or name == "point"]
    for o in readings:
        inc.add(o)
    assert not inc.suspects
    assert [w.id for w in inc.waiting] == ["waits"] * beside
    inc.settle()
    moment = compare(inc, "settled", rng=np.random.default_rng(1))
    assert moment is not None
    assert not moment.no_batch
    assert moment.promise <= 1.0


def test_weights_of_a_part_count_as_readings() -> None:
    """A photo whose centre alone is weighted waits; two rays are enough for its attitude."""
    network = site()
    half_weighted_photo(network)
    inc = fga.IncrementalAdjustment(network)
    assert_stands(inc, site())
    inc.add(ray("F", "A", error=2))
    assert inc.n_waiting == 1
    inc.add(ray("F", "B"))
    network.add(ray("F", "A", error=2), ray("F", "B"))
    assert_as_batch(inc, network)
    assert_as_batch(fga.IncrementalAdjustment(network), network)


# -- where it starts, and after a crash -----------------------------------------------------------


@LONG
@pytest.mark.parametrize("few", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_a_given_start_and_a_journal_change_nothing(name: str, few: bool, tmp_path: Path) -> None:
    """A start of the plain site or of everything; after a crash it is all as it was."""
    case, network = CASES[name], described(name, few=few)
    whole = with_all(name, network)
    expected = fga.IncrementalAdjustment(network)

    def assert_begun(inc: fga.IncrementalAdjustment) -> None:
        assert [(w.id, w.lacks) for w in inc.waiting] == [(w.id, w.lacks) for w in expected.waiting]
        assert inc.redundancy == expected.redundancy
        assert_equal(inc, expected.solution(), 1e-2)

    for i, start in enumerate((site(), whole)):
        journal = tmp_path / f"{i}.jsonl"
        inc = fga.IncrementalAdjustment(network, start=fga.adjust(start), journal=journal)
        assert_begun(inc)
        del inc  # which lets go of the journal
        inc = fga.IncrementalAdjustment.resume(journal)
        assert_begun(inc)
        inc.add(case.rest if few else (*case.few, *case.rest))
        assert not inc.waiting
        here = inc.solution()
        del inc
        inc = fga.IncrementalAdjustment.resume(journal)
        assert_equal(inc, here, 1e-2)
        assert_as_batch(inc, whole)
        del inc


@pytest.mark.parametrize("name", CASES)
def test_it_waits_again_when_its_readings_are_taken_out(name: str) -> None:
    """The way back leads to where a start with too few readings begins."""
    network = described(name, few=True)
    inc = fga.IncrementalAdjustment(with_all(name, network))
    inc.remove([ident(o) for o in CASES[name].rest])
    begun = fga.IncrementalAdjustment(network)
    assert {w.id for w in inc.waiting} == {w.id for w in begun.waiting}
    assert_stands(inc, plain(name))


# -- verticals ------------------------------------------------------------------------------------


def test_verticals_keep_no_distance_waiting() -> None:
    """Between marks a slope distance is the same in every horizon, whatever that is."""
    network = site()
    for name in (*GIVEN, "P"):
        network.set_vertical(name, xi=3 * ARCSEC, eta=-4 * ARCSEC)
    inc = fga.IncrementalAdjustment(network)
    assert_stands(inc, site())
    assert not inc.waiting
    whole = site()
    for name in "AP":
        whole.set_vertical(name, xi=3 * ARCSEC, eta=-4 * ARCSEC)
    pairs = zip(("AB", "AC", "AD", "PA", "PB", "PC"), (1, -1, 2, 0, 1, -2), strict=True)
    angles = [zenith(*pair, error=e) for pair, e in pairs]
    for o in angles:
        inc.add(o)
    whole.add(*angles)
    assert_as_batch(inc, whole)


def test_a_distance_over_an_instrument_waits_with_the_vertical() -> None:
    """The height of the instrument leans with the vertical."""
    network = site()
    network.set_vertical("B", xi=3 * ARCSEC, eta=-4 * ARCSEC)
    d = np.linalg.norm(offset("B", "P"))
    raised = SlopeDistance("B", "P", float(d) - 0.28, sigma=0.1, instrument_height=1.5, id="up")
    network.add(raised)
    inc = fga.IncrementalAdjustment(network)
    assert [w.id for w in inc.waiting] == ["up"]
    assert_stands(inc, site())
    angles = CASES["vertical"].few + CASES["vertical"].rest
    inc.add(angles)
    network.add(*angles)
    assert_as_batch(inc, network)
