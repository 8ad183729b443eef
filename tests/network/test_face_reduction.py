"""Readings in two faces: means, index and collimation errors, and what does not agree."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sin, sqrt

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import Doubt
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.network.face_readings import FaceReading
from factorgraph_adj.network.face_reduction import reduce_faces
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle
from tests.support.same import assert_same_network

MGON = pi / 200e3
SIGMAS = {"sigma_direction": MGON, "sigma_zenith": MGON, "sigma_distance": 0.002}


def book(
    n: int = 8, *, index: float = 0.0, collimation: float = 0.0, noise: float = 0.0, seed: int = 1
) -> tuple[list[FaceReading], np.ndarray, np.ndarray]:
    """Return readings of n targets with errors of the instrument, and true d and z."""
    rng = np.random.default_rng(seed)
    d, z = rng.uniform(0.0, 2 * pi, n), rng.uniform(0.6, 2.4, n)
    out = []
    for k in range(n):
        c = collimation / sin(z[k])
        e = noise * rng.normal(size=4)
        out += [
            FaceReading(
                station="S",
                target=f"T{k}",
                face=1,
                direction=float((d[k] - c + e[0]) % (2 * pi)),
                zenith=float(z[k] + index + e[1]),
                distance=50.0,
                instrument_height=1.5,
            ),
            FaceReading(
                station="S",
                target=f"T{k}",
                face=2,
                direction=float((d[k] + c + pi + e[2]) % (2 * pi)),
                zenith=float(2 * pi - z[k] + index + e[3]),
                distance=50.002,
                instrument_height=1.5,
            ),
        ]
    return out, d, z


def of_kind(found, kind):
    return [o for o in found.observations if isinstance(o, kind)]


def test_means_are_free_of_index_and_collimation():
    readings, d, z = book(index=7 * MGON, collimation=-12 * MGON)
    found = reduce_faces(readings, **SIGMAS)
    turn = np.array([o.value for o in of_kind(found, Direction)]) - d
    assert np.abs((turn + pi) % (2 * pi) - pi).max() < 1e-12
    assert [o.value for o in of_kind(found, ZenithAngle)] == pytest.approx(z, abs=1e-12)
    (setup,) = found.setups
    assert setup.index == pytest.approx(7 * MGON, abs=1e-12)
    assert setup.collimation == pytest.approx(-12 * MGON, abs=1e-12)
    assert setup.targets == 8 and not found.doubts
    assert of_kind(found, SlopeDistance)[0].value == pytest.approx(50.001)
    assert of_kind(found, Direction)[0].sigma == pytest.approx(MGON / sqrt(2))
    assert all(o.instrument_height == 1.5 for o in found.observations)


def test_one_face_is_freed_of_the_means_of_its_set_up():
    readings, d, z = book(index=7 * MGON, collimation=-12 * MGON)
    found = reduce_faces([*readings[:-2], readings[-1]], **SIGMAS)
    last = [o for o in found.observations if o.target == "T7"]
    # The zenith angle in c / sin z is not freed of the index error.
    assert (last[0].value - d[7] + pi) % (2 * pi) - pi == pytest.approx(0.0, abs=1e-8)
    assert last[1].value == pytest.approx(z[7], abs=1e-12)
    assert last[1].sigma == pytest.approx(MGON * sqrt(1 + 1 / 14))
    alone = reduce_faces(readings[1:2], **SIGMAS)
    assert np.isnan(alone.setups[0].index) and np.isnan(alone.setups[0].sigma_collimation)
    assert alone.observations[1].value == pytest.approx(z[0] - 7 * MGON)


def test_index_and_collimation_scatter_as_their_sigma_says():
    index, collimation = [], []
    for seed in range(400):
        readings, *_ = book(6, noise=MGON, seed=seed)
        (s,) = reduce_faces(readings, **SIGMAS).setups
        index.append(s.index / s.sigma_index)
        collimation.append(s.collimation / s.sigma_collimation)
    assert np.std(index) == pytest.approx(1.0, abs=0.1)
    assert np.std(collimation) == pytest.approx(1.0, abs=0.1)


def test_a_target_whose_faces_do_not_agree_is_named():
    false = 0
    for seed in range(50):
        readings, *_ = book(noise=MGON, seed=seed)
        false += len(reduce_faces(readings, **SIGMAS).doubts)
        wrong = [
            FaceReading(**{**vars(r), "zenith": r.zenith + 10 * MGON}) if i == 5 else r
            for i, r in enumerate(readings)
        ]
        found = reduce_faces(wrong, **SIGMAS)
        assert any("target 'T2'" in str(p) and "index" in str(p) for p in found.doubts)
    assert false <= 4  # 800 tests at one in a thousand


def test_the_mean_of_the_network_is_that_of_both_faces():
    """The adjusted orientation is free of the collimation error, the height of the index error."""
    network = fga.Network("two faces")
    rng = np.random.default_rng(3)
    true = {f"T{k}": np.append(rng.uniform(-50, 50, 2), rng.uniform(-20, 20)) for k in range(6)}
    for name, at in true.items():
        network.add_point(name, tuple(at), fixed="xyz")
    network.add_point("S", (1.0, 1.0, 1.0))
    readings = []
    for name, at in true.items():
        length = float(np.linalg.norm(at))
        d, z = np.arctan2(at[0], at[1]), np.arccos(at[2] / length)
        for face in (1, 2):
            side = -1 if face == 1 else 1
            direction = d + side * 40 * MGON / sin(z) + pi * (face - 1)
            zenith = (z if face == 1 else 2 * pi - z) + 30 * MGON
            readings.append(
                FaceReading(
                    station="S",
                    target=name,
                    face=face,
                    direction=float(direction % (2 * pi)),
                    zenith=float(zenith),
                    distance=length,
                )
            )
    network.add(*reduce_faces(readings, **SIGMAS).observations)
    solution = fga.adjust(network)
    assert np.abs(solution.point("S")).max() < 1e-8 and solution.vtpv < 1e-8


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"face": 3}, "the face must be 1 or 2, not 3"),
        ({"zenith": 5.0}, "belongs to the other face"),
        ({"target": "T1"}, "is read twice in this face"),
        ({"target_height": 0.4}, "its heights differ from those of the other face"),
    ],
)
def test_bad_readings_are_named(change, message):
    readings, *_ = book()
    bad = [FaceReading(**{**vars(readings[0]), **change}), *readings[1:]]
    with pytest.raises(fga.InputError, match=message):
        reduce_faces(bad, **SIGMAS)


def test_sigmas_are_positive():
    with pytest.raises(fga.InputError, match="sigma_zenith must be greater than zero"):
        reduce_faces([], sigma_direction=1.0, sigma_zenith=0.0, sigma_distance=1.0)


def test_what_no_instrument_has_is_doubted_with_one_target_too():
    readings, *_ = book(1)
    same = [readings[0], FaceReading(**{**vars(readings[1]), "direction": readings[0].direction})]
    (doubt,) = reduce_faces(same, **SIGMAS).doubts
    assert "give collimation" in str(doubt) and "station 'S', set '1'" in str(doubt)
    longer = [readings[0], FaceReading(**{**vars(readings[1]), "distance": 52.0})]
    (doubt,) = reduce_faces(longer, **SIGMAS).doubts
    assert "its distances differ by 2000.0 mm, tolerance 9.3 mm" in str(doubt)


def test_readings_in_another_unit_are_one_doubt_of_the_set_up():
    """Degrees read as gon: no collimation fits, and only the unit is told, not every target."""
    readings, _, _ = book(noise=MGON)
    degrees = [replace(r, direction=0.9 * r.direction, zenith=0.9 * r.zenith) for r in readings]
    found = reduce_faces(degrees, **{**SIGMAS, "sigma_distance": 0.01})
    assert [str(d) for d in found.doubts] == [
        "station 'S', set '1': the two faces give index -20.000 gon: both add up to a circle of "
        "degrees, not of gon; state their unit"
    ]


@pytest.mark.parametrize("faces", ["means", "both"])
def test_a_doubt_ends_with_the_observation_that_is_taken_out(faces):
    readings, _, _ = book(3, index=MGON, noise=0.0)
    readings = [replace(r, station="S") for r in readings]
    wrong = next(i for i, r in enumerate(readings) if (r.target, r.face) == ("T2", 2))
    readings[wrong] = replace(readings[wrong], zenith=readings[wrong].zenith + 20 * MGON)
    network = fga.Network()
    for name in ("S", "T0", "T1", "T2"):
        network.add_point(name, (0, 0, 0), fixed="xyz")
    reduce_faces(readings, **SIGMAS, faces=faces).add_to(network)
    (doubt,) = network.doubts
    about = [network.observations[i] for i in doubt.ids]
    assert {(o.kind, o.target) for o in about} == {("zenith_angle", "T2")}
    assert len(about) == (2 if faces == "both" else 1)
    assert without(network, [doubt.ids[0]]).doubts == []
    others = [i for i in network.observations if i not in doubt.ids]
    assert without(network, others).doubts == [doubt]


def test_both_faces_announced_and_one_read_are_doubted_unless_the_errors_are_given():
    readings = [r for r in book(3)[0] if r.face == 1]
    found = reduce_faces(readings, **SIGMAS, faces="both")
    network = fga.Network()
    for name in {r.station for r in readings} | {r.target for r in readings}:
        network.add_point(name, (0, 0, 0), fixed="xyz")
    given = network.copy()
    found.add_to(network)
    name = f"{readings[0].station}/{readings[0].set}"
    assert [d.where for d in network.doubts] == [
        f"collimation error {name!r}",
        f"index error {name!r}",
    ]
    for kind in ("index_error", "collimation_error"):
        given.set_unknown(kind, name, (0.0,), sigma=MGON)
    found.add_to(given)
    assert given.doubts == []


def test_a_wrong_reading_does_not_make_the_others_doubtful():
    readings, *_ = book(noise=0.2 * MGON)
    wrong = [
        replace(r, zenith=r.zenith + 60 * MGON) if i == 5 else r for i, r in enumerate(readings)
    ]
    (doubt,) = reduce_faces(wrong, **SIGMAS).doubts
    assert "target 'T2'" in str(doubt)
    both = reduce_faces(wrong[4:8], **SIGMAS).doubts  # nobody knows which of two is wrong
    assert [str(p).split(":")[0][-4:] for p in both] == ["'T2'", "'T3'"]


def test_the_zenith_reading_tells_the_face():
    readings, *_ = book()
    plain = [replace(r, face=None) for r in readings]
    assert (
        reduce_faces(plain, **SIGMAS).observations == reduce_faces(readings, **SIGMAS).observations
    )
    unknown = replace(readings[0], face=None, zenith=None)
    with pytest.raises(fga.InputError, match="the face is missing: give 1 or 2"):
        reduce_faces([unknown], **SIGMAS)


def test_centring_and_ppm_are_not_less_for_two_faces():
    readings, *_ = book(2)
    sigma = fga.StandardDeviation(MGON, centring_target=0.001)
    length = fga.StandardDeviation(0.002, ppm=2.0)
    given = {"sigma_direction": sigma, "sigma_zenith": MGON, "sigma_distance": length}
    found = reduce_faces(readings, **given)
    d, s = of_kind(found, Direction)[0].sigma, of_kind(found, SlopeDistance)[0].sigma
    assert (d.constant, d.centring_target) == (MGON / sqrt(2), 0.001)
    assert (s.constant, s.ppm) == (0.002 / sqrt(2), 2.0)
    with pytest.raises(fga.InputError, match="sigma_direction has centring, which the two faces"):
        reduce_faces(readings, **given, faces="both")


# -- both faces as observations -------------------------------------------------------------------

HELD = {f"H{k}": (60 * np.sin(k), 70 * np.cos(1.3 * k), 15 * np.sin(2 * k)) for k in range(5)}
NEW = {"S1": (3.0, -4.0, 1.0), "S2": (28.0, 9.0, -2.0), "N": (10.0, 35.0, 12.0)}
INDEX, COLLIMATION = {"S1": 35 * MGON, "S2": -20 * MGON}, {"S1": -42 * MGON, "S2": 25 * MGON}


def site(faces, *, instrument=None, noise=1.0, seed=4, only_one=()):
    """Return two stations that read held and new points in both faces, and what was reduced."""
    network = fga.Network("two faces")
    for name, at in HELD.items():
        network.add_point(name, at, fixed="xyz")
    for name in NEW:
        network.add_point(name)
    rng, readings = np.random.default_rng(seed), []
    for station in ("S1", "S2"):
        of = "S1" if instrument else station
        for target, at in {**HELD, **NEW}.items():
            if target == station:
                continue
            q = np.subtract(at, NEW[station])
            length = float(np.linalg.norm(q))
            d, z = np.arctan2(q[0], q[1]) + 0.7, np.arccos(q[2] / length)
            for face in (1, 2) if target not in only_one else (2,):
                e = noise * rng.normal(size=3)
                side = -1 if face == 1 else 1
                turned = d + side * COLLIMATION[of] / sin(z) + pi * (face - 1)
                circle = (z if face == 1 else 2 * pi - z) + INDEX[of]
                readings.append(
                    FaceReading(
                        station=station,
                        target=target,
                        face=face,
                        direction=float((turned + MGON * e[0]) % (2 * pi)),
                        zenith=float(circle + MGON * e[1]),
                        distance=length + 0.002 * e[2],
                        instrument=instrument,
                    )
                )
    found = reduce_faces(readings, **SIGMAS, faces=faces)
    found.add_to(network)
    return network, found


def test_both_ways_give_the_same_estimates_of_everything_else():
    means, reduced = site("means")
    both, _ = site("both")
    a, b = fga.adjust(means), fga.adjust(both)
    for name in NEW:
        # c/sin z depends on the points, so that differences of faces tell of them, by c/sin z.
        away = np.abs(a.point(name) - b.point(name))
        assert away.max() < 1e-3 * a.standard_deviations(name).min()
        assert b.standard_deviations(name) == pytest.approx(a.standard_deviations(name), rel=1e-3)
    for s in reduced.setups:
        i = b.unknown("index_error", f"{s.station}/1")
        c = b.unknown("collimation_error", f"{s.station}/1")
        assert i.values[0] == pytest.approx(s.index, abs=1e-3 * s.sigma_index)
        assert c.values[0] == pytest.approx(s.collimation, abs=2e-2 * s.sigma_collimation)
        assert i.sigmas[0] == pytest.approx(s.sigma_index, rel=1e-6)
        assert c.sigmas[0] == pytest.approx(s.sigma_collimation, rel=1e-3)
    # Each target has told its own index and collimation error, of which one of each was unknown.
    targets = sum(s.targets for s in reduced.setups)
    assert b.redundancy - a.redundancy == 2 * (targets - len(reduced.setups))


def test_the_errors_are_found_without_noise_also_from_one_face_of_some_targets():
    network, _ = site("both", noise=0.0, only_one=("H1", "N"))
    solution = fga.adjust(network)
    for name, at in NEW.items():
        assert solution.point(name) == pytest.approx(at, abs=1e-9)
    for station in ("S1", "S2"):
        found = solution.unknown("index_error", f"{station}/1").values[0]
        assert found == pytest.approx(INDEX[station], abs=1e-12)
        found = solution.unknown("collimation_error", f"{station}/1").values[0]
        assert found == pytest.approx(COLLIMATION[station], abs=1e-12)


def test_an_instrument_shares_its_errors():
    network, _ = site("both", instrument="TS")
    solution = fga.adjust(network)
    assert list(network.of_kind("index_error")) == ["TS"]
    shared = solution.unknown("index_error", "TS")
    assert shared.values[0] == pytest.approx(INDEX["S1"], abs=4 * shared.sigmas[0])
    assert shared.sigmas[0] == pytest.approx(MGON / sqrt(2 * 14), rel=1e-6)


def test_errors_of_circles_may_be_weighted_or_held_and_are_tested():
    other, found = site("both")
    network = fga.Network("again")
    for name, p in other.points.items():
        network.add_point(name, p.coordinates, fixed="xyz" if all(p.fixed) else "")
    network.set_unknown("index_error", "S1/1", (30 * MGON,), fixed=True)
    network.set_unknown("collimation_error", "S1/1", (-40 * MGON,), sigma=5 * MGON)
    found.add_to(network)
    solution = fga.adjust(network)
    assert solution.unknown("index_error", "S1/1").sigmas[0] == 0.0
    weighted = solution.unknown("collimation_error", "S1/1")
    assert 0 < weighted.sigmas[0] < MGON / sqrt(2 * 6)
    rel = fga.reliability(solution)
    (held,) = [v for v in rel.given_values if v.kind == "index_error"]
    error = held.together.error[0]  # given − true
    assert held.name == "S1/1" and error == pytest.approx(-5 * MGON, abs=1.5 * MGON)
    assert abs(held.w[0]) > 3.29
    labels = [p.label for p in fga.significance(solution).parameters if p.significant]
    names = [("index_error", "S2/1", "index"), ("collimation_error", "S2/1", "collimation")]
    assert set(names) <= set(labels)


def test_an_error_that_nothing_determines_is_named():
    network, _ = site("both")
    ids = [i for i, o in network.observations.items() if getattr(o, "face", 1) == 1]
    one_face = fga.without(network, [i for i in network.observations if i not in ids])
    # One face alone has no collimation error apart from the orientation where sights are level.
    flat = fga.Network("flat")
    for name, at in {**HELD, "S": (1.0, 2.0, 0.0)}.items():
        flat.add_point(name, (*at[:2], 0.0), fixed="xyz")
    flat.set_unknown("collimation_error", "T")
    for o in one_face.observations.values():
        if isinstance(o, Direction) and o.station == "S1" and o.target in HELD:
            flat.add(Direction("S", o.target, o.value, sigma=MGON, collimation_error="T"))
    with pytest.raises(fga.DatumError, match="collimation error"):
        fga.adjust(flat)


def test_both_faces_arrive_one_by_one():
    network, found = site("both")
    empty = fga.Network("arrives")
    for name, p in network.points.items():
        fixed = "xyz" if all(p.fixed) else ""
        empty.add_point(name, p.coordinates if fixed else NEW[name], fixed=fixed)
    for kind in ("index_error", "collimation_error"):
        for name in network.of_kind(kind):
            empty.set_unknown(kind, name)
    inc = fga.IncrementalAdjustment(empty, policy="accept")
    for o in found.observations:
        inc.add(o)
    inc.settle()
    end, batch = inc.solution(), fga.adjust(network)
    for name in NEW:
        assert end.point(name) == pytest.approx(batch.point(name), abs=1e-6)
    assert end.unknown("index_error", "S2/1").values == pytest.approx(
        batch.unknown("index_error", "S2/1").values, abs=1e-9
    )


def test_a_network_with_both_faces_comes_back_from_files(tmp_path):
    network, _ = site("both")
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path)
    assert_same_network(network, again)
    header = (tmp_path / "observations.csv").read_text().splitlines()[0].split(",")
    assert {"face", "index_error", "collimation_error"} <= set(header)
    assert "S1/1" in (tmp_path / "index_errors.csv").read_text()
    network.doubts.append(Doubt("what, and why", "where", ("1", "2")))
    network.doubts.append(Doubt("what else", "elsewhere"))
    fga.write_project(network, tmp_path / "doubted" / "project.toml")
    assert fga.read_project(tmp_path / "doubted").doubts == network.doubts
    solution = fga.adjust(network)
    solution.save(tmp_path / "end.npz")
    loaded = fga.load_solution(tmp_path / "end.npz")
    assert loaded.network.doubts == network.doubts
    assert np.array_equal(loaded.covariance("N"), solution.covariance("N"))
