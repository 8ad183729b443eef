"""Readings in two faces: means, index and collimation errors, and what does not agree."""

from __future__ import annotations

from math import pi, sin, sqrt

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.field.faces import reduce_faces
from factorgraph_adj.field.readings import FaceReading
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle

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
