"""Networks that rounding makes look determined are refused by name, weak ones are adjusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli import command_line as cli
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io.project_writer import write_project
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import HorizontalDistance, ImagePoint, SlopeDistance
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import disturb, look_at, measure
from factorgraph_adj.types import Array
from tests.support.dense import Dense
from tests.support.studies import cases

LONG = pytest.mark.slow("singular photos in blocks of many kinds; short tests take the plainest")

SIGMA = 0.005
"""Standard deviation of an image coordinate, mm."""
DETERMINED = 1e-9
"""Smallest singular value of the scaled design matrix of a network that has an answer."""

Change = Callable[[fga.Network], None]


def rays(photo: str, *points: str) -> list[ImagePoint]:
    return [ImagePoint(photo, p, 0.0, 0.0, sigma=SIGMA) for p in points]


def spread(rng: np.random.Generator) -> list[Array]:
    """Return two cameras anywhere around the points."""
    directions = rng.uniform(-1, 1, (2, 3))
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    return list(directions / lengths * rng.uniform(30, 80, (2, 1)))


def above(rng: np.random.Generator) -> list[Array]:
    """Return two cameras above the points."""
    return [np.array([*rng.uniform(-10, 10, 2), rng.uniform(30, 80)]) for _ in "AB"]


def beside(rng: np.random.Generator) -> list[Array]:
    """Return two cameras on a base of 1/1000 of the depth."""
    first = spread(rng)[0]
    return [first, first + rng.uniform(-0.1, 0.1, 3)]


ARRANGEMENTS = (spread, above, beside)


def resected(
    seed: int,
    arrangement: Callable[[np.random.Generator], list[Array]],
    change: Change | None = None,
    *,
    seen: tuple[str, ...] = ("F0", "F1", "T"),
    tie: str = "",
    datum: Literal["given", "free"] = "given",
    noise: bool = True,
) -> fga.Network:
    """Return photo A on six control points, photo B on two of them, and a tie point in both.

    B has 6 and the tie point 3 unknowns; they have 8 image coordinates. In a free network the
    control is free, and a third photo sees it too.

    Args:
        seed: seed of geometry, errors and start values.
        arrangement: where A and B stand.
        change: what is added.
        seen: what B sees.
        tie: axes of the tie point that are held.
        datum: that of the network.
        noise: whether there are errors.
    """
    rng = np.random.default_rng(seed)
    network = fga.Network(f"photo with two points {seed}", datum=datum)
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    fixed = "xyz" if datum == "given" else ""
    control = [f"F{i}" for i in range(6)]
    for name in control:
        network.add_point(name, tuple(10 * rng.uniform(-1, 1, 3)), fixed=fixed)
    network.add_point("T", tuple(10 * rng.uniform(-1, 1, 3)), fixed=tie)
    centres = dict(zip("AB", arrangement(rng), strict=True))
    if datum == "free":
        centres["C"] = spread(rng)[0]
    for name, at in centres.items():
        turn = exp_rotation(np.array([0, 0, rng.uniform(-3, 3)]))
        rotation = look_at(at, rng.uniform(-3, 3, 3)) @ turn
        network.add_photo(name, "camera", position=tuple(at), rotation=rotation)
    network.add(*rays("A", *control, "T"), *rays("B", *seen))
    if datum == "free":
        network.add(*rays("C", *control))
    if change is not None:
        change(network)
    measured = measure(network, seed=seed, noise=noise)
    size = (0.0, 1e-3, 0.05)[seed % 3]
    return disturb(measured, seed=seed, points=size, centres=size, attitudes=size / 10)


def answered(networks: list[fga.Network]) -> list[str]:
    """Return the networks that were adjusted, with what was made of them."""
    out = []
    for network in networks:
        try:
            solution = fga.adjust(network)
        except fga.DatumError as error:
            if "B" not in error.names and "T" not in error.names:
                out.append(f"{network.name}: {error}")
        else:
            out.append(f"{network.name}: {solution.reason}, redundancy {solution.redundancy}")
    return out


# -- what is not determined -----------------------------------------------------------------------

SEEDS = pytest.mark.parametrize(
    "seeds",
    cases(
        [
            pytest.param(range(25), id="25 seeds"),
            # One of twenty seeds has a pivot that rounding leaves above every threshold.
            pytest.param(range(25, 200), id="the others"),
        ],
        [range(25)],
    ),
)


@LONG
@SEEDS
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_a_photo_with_two_points_and_a_tie_point_of_two_rays_is_named(arrangement, seeds) -> None:
    """One observation is missing: 5 to 7 % of the factors have a small pivot instead of none."""
    assert answered([resected(seed, arrangement) for seed in seeds]) == []


@LONG
@SEEDS
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_it_is_named_in_a_free_network(arrangement, seeds) -> None:
    free = [resected(seed, arrangement, datum="free") for seed in seeds if seed < 100]
    assert answered(free) == []


SIMILAR = {
    "the tie point has one ray": (("F0", "F1", "F2", "F3"), "", {"T"}),
    "the photo has two points": (("F0", "F1"), "xyz", {"photo B"}),
    "the tie point has its height, the photo one other point": (("F0", "T"), "z", {"photo B"}),
}


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize(("seen", "tie", "named"), SIMILAR.values(), ids=SIMILAR)
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@pytest.mark.parametrize("seeds", cases([range(10), range(10, 40)], [range(10)]), ids=str)
def test_similar_ones_are_named(arrangement, seen, tie, named, seeds) -> None:
    for seed in seeds:
        with pytest.raises(fga.DatumError) as error:
            fga.adjust(resected(seed, arrangement, seen=seen, tie=tie))
        message = str(error.value).replace("'", "")
        assert all(name in message for name in named), error.value


def _weak_pairs(network: fga.Network) -> None:
    """Add 80 points that two photos see from a base of 1/100 000 of the depth."""
    rng = np.random.default_rng(1)
    photo = network.photos["A"]
    at = np.add(photo.position, (3e-4, 1.5e-4, 1e-4))
    network.add_photo("A2", "camera", position=tuple(at), rotation=photo.rotation)
    network.add(*rays("A2", *(f"F{i}" for i in range(6))))
    for i in range(80):
        network.add_point(f"W{i}", tuple(10 * rng.uniform(-1, 1, 3)))
        network.add(*rays("A", f"W{i}"), *rays("A2", f"W{i}"))


@LONG
def test_it_is_named_among_many_weak_points() -> None:
    """The search looks at 40 combinations; 80 others are nearly undetermined."""
    for seed in range(0, 60, 3):  # started from the true values
        network = resected(seed, above, _weak_pairs, noise=False)
        with pytest.raises(fga.DatumError) as error:
            fga.adjust(network)
        assert set(error.value.names) <= {"B", "T"}, network.name


def touching(seed: int) -> tuple[fga.Network, float]:
    """Return a point near the line of two stations whose distances add up, and a tolerance.

    The minimum lies on the line, where the two distances determine one coordinate alone.
    """
    rng = np.random.default_rng(seed)
    along, off = rng.uniform(20, 80), 10 ** rng.uniform(-4, 1)
    network = fga.Network(f"touching circles {seed}")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (80, 60, 0), fixed="xyz")
    network.add_point("P", (0.8 * along - 0.6 * off, 0.6 * along + 0.8 * off, 0), fixed="z")
    sigma = 10 ** rng.uniform(-10, -6)
    network.add(
        HorizontalDistance("A", "P", along, sigma=sigma),
        HorizontalDistance("B", "P", 100 - along, sigma=sigma),
    )
    return network, 10 ** rng.uniform(-13, -8)


@LONG
def test_what_is_singular_at_the_solution_is_refused_though_the_start_is_not() -> None:
    refused = 0
    for seed in range(60):
        network, tolerance = touching(seed)
        equations = compile_network(network)
        assert weakest(Dense.at(equations, equations.unknowns.start())) > 1e-7
        try:
            solution = fga.adjust(network, tolerance=tolerance)
        except fga.DatumError:
            refused += 1
            continue
        at_end = Dense.at(solution.equations, solution.state)
        assert not solution.converged or weakest(at_end) > DETERMINED, network.name
    assert refused > 5


def weakest(dense: Dense) -> float:
    """Return the smallest singular value of the scaled design matrix."""
    a = dense.design / np.linalg.norm(dense.design, axis=0)
    return float(np.linalg.svd(a, compute_uv=False)[-1])


def test_points_that_turn_together_are_named() -> None:
    """150 rigid points turn about the line of two points, a third one beside it does not: that is
    no motion of everything, and the share of each point is small."""
    rng = np.random.default_rng(5)
    network = fga.Network("hinge")
    for name in ("F0", "F1", "F2", "F3", "H0", "H1", "H2", *(f"P{i}" for i in range(150))):
        fixed = "xyz" if name.startswith("F") else ""
        network.add_point(name, tuple(rng.uniform(-50, 50, 3)), fixed=fixed)
    pairs = [(f"F{i}", f"H{j}") for i in range(4) for j in range(3)]
    pairs += [("H2", "H0"), ("H2", "H1")]
    pairs += [(f"H{j}", f"P{i}") for j in range(2) for i in range(150)]
    pairs += [(f"P{j}", f"P{i}") for i in range(150) for j in range(max(0, i - 6), i)]
    network.add(*(SlopeDistance(a, b, 1.0, sigma=0.001) for a, b in pairs))
    with pytest.raises(fga.DatumError) as error:
        fga.adjust(measure(network, seed=1))
    assert error.value.defect == 1
    assert len(error.value.names) > 5
    assert all(name.startswith("P") for name in error.value.names)


# -- what is --------------------------------------------------------------------------------------


def _third_point(network: fga.Network) -> None:
    network.add(*rays("B", "F2"))


def _second_tie_point(network: fga.Network) -> None:
    network.add_point("T2", (4.0, -3.0, 2.0))
    network.add(*rays("A", "T2"), *rays("B", "T2"))


def _weighted_centre(network: fga.Network) -> None:
    network.photos["B"] = replace(network.photos["B"], sigma_position=(0.1,) * 3)


def _weighted_attitude(network: fga.Network) -> None:
    network.photos["B"] = replace(network.photos["B"], sigma_attitude=(0.02,) * 3)


def _weighted_tie_point(network: fga.Network) -> None:
    network.points["T"] = replace(network.points["T"], sigma=(np.inf, np.inf, 0.1))


def _measured_tie_point(network: fga.Network) -> None:
    network.add(SlopeDistance("F0", "T", 1.0, sigma=0.001))


DETERMINING = (
    _third_point,
    _second_tie_point,
    _weighted_centre,
    _weighted_attitude,
    _weighted_tie_point,
    _measured_tie_point,
)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("change", DETERMINING)
@pytest.mark.parametrize("arrangement", [spread, above])
def test_one_more_observation_is_enough(arrangement, change) -> None:
    """Adjusted with the covariances of a dense solution, however weak."""
    for seed in range(0, 60, 3):  # started from the true values
        network = resected(seed, arrangement, change, noise=False)
        solution = fga.adjust(network)
        assert solution.converged, network.name
        q = Dense.at(solution.equations, solution.state).cofactor(np.zeros(0, dtype=bool))
        columns = solution.equations.unknowns.columns("point", 6)
        expected = np.sqrt(np.diag(q)[columns])
        assert solution.standard_deviations("T") == pytest.approx(expected, rel=1e-6)


def on_cylinder(off: float) -> fga.Network:
    """Return a photo above the circle through its three points, ``off`` metres beside it."""
    network = fga.Network("danger cylinder")
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    for i, angle in enumerate((0.3, 2.1, 4.4)):
        at = (10 * np.cos(angle), 10 * np.sin(angle), 0.0)
        network.add_point(f"F{i}", at, fixed="xyz")
    at = np.array([(10 + off) * np.cos(1.2), (10 + off) * np.sin(1.2), 30.0])
    network.add_photo("B", "camera", position=tuple(at), rotation=look_at(at, np.zeros(3)))
    network.add(*rays("B", "F0", "F1", "F2"))
    return measure(network, seed=1, noise=False)


@pytest.mark.parametrize("off", [1.0, 1e-2, 1e-3, 1e-4])
def test_a_photo_near_the_danger_cylinder_is_weak_but_determined(off: float) -> None:
    solution = fga.adjust(on_cylinder(off))
    assert solution.converged and solution.redundancy == 0
    assert weakest(Dense.at(solution.equations, solution.state)) < 0.1 * off


def test_a_photo_on_the_danger_cylinder_is_not() -> None:
    with pytest.raises(fga.DatumError) as error:
        fga.adjust(on_cylinder(0.0))
    assert error.value.defect == 1


# -- the command ----------------------------------------------------------------------------------


def test_the_command_ends_with_2_and_writes_nothing(tmp_path: Path, capsys) -> None:
    codes = []
    for seed in range(40):
        path = tmp_path / f"{seed}" / "project.toml"
        write_project(resected(seed, above), path)
        codes.append(cli.main(["adjust", str(path), "--quiet", "--out", str(tmp_path / "out")]))
        output = capsys.readouterr()
        assert output.out == ""
        assert codes[-1] != 2 or "is not determined" in output.err
    assert codes == [2] * 40
    assert not (tmp_path / "out").exists()
