"""Standard deviations below what double precision carries are named, and what is valid is told."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import (
    ControlPoint,
    Direction,
    GnssVector,
    HeightDifference,
    ImagePoint,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.types import Array

STATIONS = {"A": (0.0, 0.0, 0.1), "B": (60.0, 5.0, 0.4), "C": (10.0, 70.0, -0.3)}
POINT = (41.0, 33.0, 12.0)
PRECISE: dict[str, Callable[[float, Array], Observation]] = {
    "distance": lambda s, _: SlopeDistance("A", "P", 1.0, sigma=s, id="precise"),
    "height": lambda s, _: HeightDifference("B", "P", 0.0, sigma=s, id="precise"),
    "direction": lambda s, _: Direction("A", "P", 0.0, sigma=s, id="precise"),
    "zenith": lambda s, _: ZenithAngle("C", "P", 1.5, sigma=s, id="precise"),
    "vector": lambda s, _: GnssVector("A", "P", (0.0, 0.0, 0.0), sigma=(s,) * 3, id="precise"),
    "correlated vector": lambda s, _: GnssVector(
        "A", "P", (0.0, 0.0, 0.0), covariance=s**2 * (np.eye(3) + 0.5), id="precise"
    ),
    "control": lambda s, at: ControlPoint("P", tuple(at), sigma=(s,) * 3, id="precise"),
}


ANGLES = ("direction", "zenith")


def network(shift: float, kind: str, sigma: float, *, beside: float = 1e-3) -> fga.Network:
    """Return a point from three stations, with one further observation of a small σ.

    ``beside`` is the σ of the other distances, metres; that of angles belongs to 50 m.
    """
    origin = shift * np.array([1.0, 0.8, 0.1])
    out = fga.Network("precise")
    for name, at in STATIONS.items():
        out.add_point(name, origin + at, fixed="xyz")
    out.add_point("P", origin + POINT)
    for name in STATIONS:
        out.set_orientation(name, value=0.7)
        out.add(SlopeDistance(name, "P", 1.0, sigma=beside))
        out.add(ZenithAngle(name, "P", 1.5, sigma=beside / 50))
        out.add(
            *(Direction(name, t, 0.0, sigma=beside / 50) for t in (*STATIONS, "P") if t != name)
        )
    out.add(PRECISE[kind](sigma, origin + POINT))
    return measure(out, seed=3)


@pytest.mark.parametrize("kind", PRECISE)
@pytest.mark.parametrize("shift", [1e2, 1e6, 6e6])
def test_every_kind_says_the_smallest_valid_standard_deviation(kind: str, shift: float) -> None:
    with pytest.raises(fga.InputError) as caught:
        fga.adjust(network(shift, kind, 1e-17))
    (problem,) = caught.value.problems
    assert "(id precise)" in problem.where
    assert "below what double precision carries" in problem.what
    found = re.search(r"valid: σ of at least (\S+) ", problem.what)
    assert found is not None
    valid = float(found[1])
    beside = 1e4 * valid * (50 if kind in ANGLES else 1)
    assert fga.adjust(network(shift, kind, valid, beside=beside)).converged
    with pytest.raises(fga.InputError, match="precise"):
        fga.adjust(network(shift, kind, 0.05 * valid))


def test_image_points_too() -> None:
    out = fga.Network("photo")
    out.add_camera("C", BrownLens(), {"c": 28.0})
    for name, x in {"F1": -5.0, "F2": 5.0, "F3": 0.0}.items():
        centre = np.array([1e6 + x, 1e6 - 2.0, 6.0])
        turn = look_at(centre, np.array([1e6, 1e6, 0.0]))
        out.add_photo(name, "C", position=centre, rotation=turn, fixed=True)
    out.add_point("P", (1e6, 1e6, 0.3))
    for name in ("F1", "F2", "F3"):
        out.add(ImagePoint(name, "P", 0.0, 0.0, sigma=1e-3))
    assert fga.adjust(measure(out, seed=1)).converged
    out.add_point("Q", (1e6 + 0.4, 1e6, 0.2))
    for name, sigma in (("F1", 1e-3), ("F2", 1e-3), ("F3", 1e-12)):
        out.add(ImagePoint(name, "Q", 0.0, 0.0, sigma=sigma))
    with pytest.raises(fga.InputError, match=r"F3.*Q.*double precision") as caught:
        fga.adjust(measure(out, seed=1))
    assert len(caught.value.problems) == 1


def trilateration(size: float, sigmas: tuple[float, ...], rank: int = 3) -> fga.Network:
    """Return a point with distances from fixed points around it; the file is named."""
    out = fga.Network("trilateration")
    base = size * np.array([1.0, 0.5, 0.3])
    place = base + np.array([0.4, 0.3, 1.0])
    out.add_point("P", place + 0.01)
    at = ((0, 0, 0), (1, 0, 0.1), (0, 1, 0.2), (1, 1, -0.3), (0.3, -0.7, 0.5))
    for i, (x, sigma) in enumerate(zip(at, sigmas, strict=False)):
        x = x if rank == 3 else (x[0], 0.0, 0.0)
        out.add_point(f"S{i}", base + x, fixed="xyz")
        length = float(np.linalg.norm(place - base - x))
        where = f"observations.csv:{i + 2}"
        out.add(SlopeDistance(f"S{i}", "P", length, sigma=sigma, id=f"d{i}", source=where))
    return out


def test_all_readings_of_a_small_standard_deviation_are_named_with_their_lines() -> None:
    with pytest.raises(fga.InputError) as caught:
        fga.adjust(trilateration(1e6, (1e-13,) * 4))
    assert [p.where.split(": ")[0] for p in caught.value.problems] == [
        f"observations.csv:{i}" for i in range(2, 6)
    ]


@pytest.mark.parametrize("sigma", [1e-12, 1e-13])
@pytest.mark.parametrize("count", [3, 5])
def test_rows_that_are_lost_beside_a_heavy_one_are_no_datum_defect(
    sigma: float, count: int
) -> None:
    """Of readings of 1 m beside one of 1e-12 m, normal equations keep nothing."""
    loose = 1e9 * sigma * 1e3
    with pytest.raises(fga.InputError) as caught:
        fga.adjust(trilateration(1.0, (sigma, *(loose,) * (count - 1))))
    (problem,) = caught.value.problems
    assert problem.where.startswith("observations.csv:2: slope_distance")
    assert "d1" in problem.what
    assert "lost beside it" in problem.what


def test_a_datum_defect_beside_a_heavy_row_is_still_one() -> None:
    with pytest.raises(fga.DatumError):
        fga.adjust(trilateration(1.0, (1e-12, 1e-3, 1e-3), rank=1))


@pytest.mark.parametrize("precise", [1, 4])
def test_a_nanometre_in_a_hundred_metres_is_adjusted(precise: int) -> None:
    sigmas = (1e-9,) * precise + (1e-3,) * (5 - precise)
    solution = fga.adjust(trilateration(100.0, sigmas))
    assert solution.converged
    np.testing.assert_allclose(solution.point("P"), [100.4, 50.3, 31.0], atol=1e-11)
