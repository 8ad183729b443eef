"""How the parts of a standard deviation combine, for each kind and each choice."""

from __future__ import annotations

import json
from math import hypot, sqrt

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import Problem, listed_once
from factorgraph_adj.io.json_records import observation_fields, observation_of
from factorgraph_adj.observations import (
    Direction,
    HeightDifference,
    HorizontalAngle,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.validate.preliminary_checks import preliminary

A, B, CI, CT = 0.002, 3e-6, 0.0015, 0.0025
D, TURN = 300.0, 2e-5
DISTANCE = {"ppm": 3.0, "centring_instrument": CI, "centring_target": CT}
CENTRED = {"centring_instrument": CI, "centring_target": CT}
VI, VT = 0.0008, 0.0011
SIN, COS = 0.8, 0.6
"""Of the zenith angle of the sight from S to T."""
HEIGHTS = {**CENTRED, "vertical_instrument": VI, "vertical_target": VT}
ALONG = hypot(CI * SIN, VI * COS), hypot(CT * SIN, VT * COS)
ACROSS = hypot(CI * COS, VI * SIN), hypot(CT * COS, VT * SIN)


def network_of(o: Observation) -> fga.Network:
    network = fga.Network("line")
    network.add_point("S", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("T", (0.0, 240.0, 180.0), fixed="xyz")
    network.add_point("U", (100.0, 0.0, 0.0), fixed="xyz")
    network.add_point("V", (0.0, 0.0, 50.0), sigma=1.0)  # something must be unknown
    network.add(o)
    return network


def sigma_of(o: Observation) -> float:
    """Return the standard deviation with which an observation is adjusted."""
    return float(fga.adjust(network_of(o)).observations.sigmas[0])


EXPECTED = {
    # kind: mixed, linear, quadratic
    "distance": (
        lambda s: SlopeDistance("S", "T", D, sigma=fga.StandardDeviation(A, **DISTANCE, combine=s)),
        sqrt((A + B * D) ** 2 + CI**2 + CT**2),
        A + B * D + CI + CT,
        sqrt(A**2 + (B * D) ** 2 + CI**2 + CT**2),
    ),
    "distance without centring": (
        lambda s: SlopeDistance("S", "T", D, sigma=fga.StandardDeviation(A, ppm=3.0, combine=s)),
        A + B * D,
        A + B * D,
        hypot(A, B * D),
    ),
    "direction": (
        lambda s: Direction("S", "T", 0.0, sigma=fga.StandardDeviation(TURN, **CENTRED, combine=s)),
        sqrt(TURN**2 + (CI**2 + CT**2) / 240.0**2),
        TURN + (CI + CT) / 240.0,
        sqrt(TURN**2 + (CI**2 + CT**2) / 240.0**2),
    ),
    "zenith angle": (
        lambda s: ZenithAngle(
            "S", "T", 0.93, sigma=fga.StandardDeviation(TURN, **CENTRED, combine=s)
        ),
        sqrt(TURN**2 + (CI**2 + CT**2) / 300.0**2),
        TURN + (CI + CT) / 300.0,
        sqrt(TURN**2 + (CI**2 + CT**2) / 300.0**2),
    ),
    "distance with heights": (
        lambda s: SlopeDistance(
            "S", "T", D, sigma=fga.StandardDeviation(A, ppm=3.0, **HEIGHTS, combine=s)
        ),
        hypot(A + B * D, *ALONG),
        A + B * D + sum(ALONG),
        hypot(A, B * D, *ALONG),
    ),
    "zenith angle with heights": (
        lambda s: ZenithAngle(
            "S", "T", 0.93, sigma=fga.StandardDeviation(TURN, **HEIGHTS, combine=s)
        ),
        hypot(TURN, ACROSS[0] / D, ACROSS[1] / D),
        TURN + sum(ACROSS) / D,
        hypot(TURN, ACROSS[0] / D, ACROSS[1] / D),
    ),
    "angle": (
        lambda s: HorizontalAngle(
            "S", "T", "U", 1.57, sigma=fga.StandardDeviation(TURN, **CENTRED, combine=s)
        ),
        sqrt(TURN**2 + (CI * 260 / 24000) ** 2 + CT**2 * (1 / 240**2 + 1 / 100**2)),
        TURN + CI * 260 / 24000 + CT * sqrt(1 / 240**2 + 1 / 100**2),
        sqrt(TURN**2 + (CI * 260 / 24000) ** 2 + CT**2 * (1 / 240**2 + 1 / 100**2)),
    ),
    "levelling": (
        lambda s: HeightDifference(
            "S", "T", 180.0, sigma=fga.StandardDeviation(A, per_sqrt_km=0.001, combine=s)
        ),
        sqrt(A**2 + 1e-6 * 0.24),
        A + 1e-3 * sqrt(0.24),
        sqrt(A**2 + 1e-6 * 0.24),
    ),
}


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("kind", EXPECTED)
def test_parts_combine_as_is_said(kind, place):
    make, *expected = EXPECTED[kind]
    choice = ("mixed", "linear", "quadratic")[place]
    assert sigma_of(make(choice)) == pytest.approx(expected[place], rel=1e-12)


def test_a_height_as_uncertain_as_the_centring_changes_nothing():
    """No stated height is the centring of its end, in all directions alike."""
    alike = {**CENTRED, "vertical_instrument": CI, "vertical_target": CT}
    for make in (
        lambda sigma: SlopeDistance("S", "T", D, sigma=sigma),
        lambda sigma: ZenithAngle("S", "T", 0.93, sigma=sigma),
    ):
        found = [sigma_of(make(fga.StandardDeviation(TURN, **p))) for p in (CENTRED, alike)]
        assert found[1] == pytest.approx(found[0], rel=1e-14)


def test_a_height_that_is_known_exactly_is_written_and_read(tmp_path):
    """0 is a value of a height: a zenith angle of a pillar has the centring across its sight."""
    sigma = fga.StandardDeviation(TURN, **CENTRED, vertical_instrument=0.0, vertical_target=VT)
    network = network_of(ZenithAngle("S", "T", 0.93, sigma=sigma))
    fga.write_project(network, tmp_path / "project.toml")
    assert fga.read_project(tmp_path).observations["1"].sigma == sigma
    assert sigma.scaled(2.0).vertical_instrument == 0.0
    assert fga.StandardDeviation(TURN, **CENTRED).scaled(2.0).vertical_target is None


def test_a_scaled_standard_deviation_has_all_its_parts_scaled():
    sigma = fga.StandardDeviation(A, ppm=3.0, **HEIGHTS)
    assert sigma.scaled(3.0) == fga.StandardDeviation(
        3 * A, ppm=9.0, **{name: 3 * value for name, value in HEIGHTS.items()}
    )


def test_mixed_is_what_is_meant_without_a_choice():
    given = fga.StandardDeviation(A, **DISTANCE)
    assert given == fga.StandardDeviation(A, **DISTANCE, combine="mixed")
    assert given.scaled(2.0).combine == "mixed" and given.scaled(2.0).ppm == 6.0
    with pytest.raises(fga.InputError, match="unknown combination 'both' of parts; valid: mixed"):
        fga.StandardDeviation(A, combine="both")  # type: ignore[arg-type]


def test_the_choice_comes_back_from_files_records_and_saved_solutions(tmp_path):
    sigma = fga.StandardDeviation(A, **DISTANCE, combine="quadratic")
    network = network_of(SlopeDistance("S", "T", D, sigma=sigma))
    fga.write_project(network, tmp_path / "project.toml")
    assert fga.read_project(tmp_path).observations["1"].sigma == sigma
    solution = fga.adjust(network)
    solution.save(tmp_path / "end.npz")
    assert fga.load_solution(tmp_path / "end.npz").network.observations["1"].sigma == sigma
    record = json.loads(json.dumps(observation_fields(network.observations["1"], id="1")))
    assert record["combine"] == "quadratic"
    assert observation_of(record).sigma == sigma


def test_a_project_states_the_choice_by_kind_or_by_row(tmp_path):
    (tmp_path / "project.toml").write_text(
        '[sigma.slope_distance]\nsigma_mm = 2\nppm = 3\ncombine = "quadratic"\n'
    )
    (tmp_path / "points.csv").write_text("name,x,y,z,fixed\nS,0,0,0,xyz\nT,0,300,0,xz\n")
    (tmp_path / "observations.csv").write_text(
        "kind,station,target,value,sigma_mm,ppm,combine\n"
        "slope_distance,S,T,300,,,\n"
        "slope_distance,S,T,300.001,2,3,linear\n"
    )
    sigmas = fga.adjust(fga.read_project(tmp_path)).observations.sigmas
    assert sigmas == pytest.approx([hypot(2e-3, 9e-4), 2e-3 + 3e-6 * 300.001])
    (tmp_path / "project.toml").write_text(
        '[sigma.slope_distance]\nsigma_mm = 2\nppm = 3\ncombine = "cubic"\n'
    )
    with pytest.raises(fga.InputError) as error:
        fga.read_project(tmp_path)
    assert [str(p) for p in error.value.problems] == [
        "project.toml:4: [sigma.slope_distance]: unknown combine 'cubic'; valid: mixed, linear, "
        "quadratic"
    ]


def test_parts_without_an_effect_are_refused():
    """A levelled height once took centring without a word; other idle parts did nothing."""
    with pytest.raises(fga.InputError, match="centring_target of sigma has no effect on a height"):
        HeightDifference("S", "T", 1.0, sigma=fga.StandardDeviation(A, centring_target=CT))
    heights = fga.StandardDeviation(A, vertical_target=CT)
    with pytest.raises(fga.InputError, match="vertical_target of sigma has no effect on a hori"):
        fga.HorizontalDistance("S", "T", 1.0, sigma=heights)
    with pytest.raises(fga.InputError, match="ppm of sigma has no effect on a direction"):
        Direction("S", "T", 1.0, sigma=fga.StandardDeviation(A, ppm=2.0))


def test_preliminary_checks_take_the_same_standard_deviation():
    """Two distances differ by 3.29 σ√2 of the linear rule, which is more than the quadratic one."""
    for combine, n in (("linear", 0), ("quadratic", 1)):
        sigma = fga.StandardDeviation(A, ppm=3.0, combine=combine)
        network = network_of(SlopeDistance("S", "T", D, sigma=sigma))
        network.add(SlopeDistance("S", "T", D + 3.2 * sqrt(2) * 2.9e-3, sigma=sigma))
        assert len([f for f in preliminary(network) if "differ" in f.what]) == n


def test_a_long_list_of_valid_names_stands_in_a_message_once(tmp_path):
    (tmp_path / "project.toml").write_text("")
    (tmp_path / "points.csv").write_text("name,x,y,z,fixed\nS,0,0,0,xyz\nT,0,300,0,xyz\n")
    rows = ["distanze,S,T,300,2"] * 30
    header = "kind,station,target,value,sigma_mm"
    (tmp_path / "observations.csv").write_text("\n".join([header, *rows]) + "\n")
    with pytest.raises(fga.InputError) as error:
        fga.read_project(tmp_path)
    text = str(error.value)
    assert text.count("horizontal_distance") == 1 and text.count("valid: as above") == 29
    short = [Problem("unknown 'x'; valid: a, b", f"f:{i}") for i in range(2)]
    assert listed_once(short) == tuple(short)
    assert [p.where.split(": ")[0] for p in error.value.problems] == [
        f"observations.csv:{i}" for i in range(2, 32)
    ]
