"""Sights in frames in projects and records, and what is wrong with them in tables."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from factorgraph_adj.observations import (
    FrameDirection,
    FrameDistance,
    FrameZenith,
    StandardDeviation,
)
from tests.networks.instruments import INSTRUMENTS, room_of


def with_parts() -> fga.Network:
    """Every instrument; standard deviations have parts."""
    network = room_of(41, list(INSTRUMENTS), held=4, constants=True, coarse=0.1)
    for ident, o in network.observations.items():
        if isinstance(o, FrameDistance):
            sigma = StandardDeviation(constant=1e-4, ppm=20.0, centring_target=2e-4)
            network.observations[ident] = replace(o, sigma=sigma)
        elif isinstance(o, FrameDirection | FrameZenith):
            sigma = StandardDeviation(constant=5e-6, centring_target=2e-4)
            network.observations[ident] = replace(o, sigma=sigma)
    return network


def test_a_project_of_instruments_comes_back(tmp_path: Path) -> None:
    network = with_parts()
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path)
    a, b = (list(n.observations.values()) for n in (network, again))
    assert len(a) == len(b)
    for o, p in zip(
        *(sorted(x, key=lambda o: (o.kind, o.frame, o.point)) for x in (a, b)), strict=True
    ):
        assert o.value == pytest.approx(p.value, rel=1e-14)
        assert o.names() == p.names() and o.parameters() == p.parameters()
        for part in ("constant", "ppm", "centring_target"):
            assert getattr(o.sigma, part) == pytest.approx(getattr(p.sigma, part), rel=1e-12)
    one, other = fga.adjust(network), fga.adjust(again)
    assert one.vtpv == pytest.approx(other.vtpv, rel=1e-6)


def test_records_of_sights_come_back() -> None:
    for o in with_parts().observations.values():
        assert (
            replace(
                observation_from_record(json.loads(json.dumps(observation_record(o)))), source=None
            )
            == o
        )


def test_centring_counts_by_the_length_in_the_frame() -> None:
    """0.2 mm beside a target 4 m away are 10 arc seconds, whatever direction it has."""
    network = with_parts()
    solution = fga.adjust(network)
    zero = solution.unknown("edm", "edm").values[1]
    found = dict(zip(solution.observations.ids, solution.equations.sigmas(), strict=False))
    for ident, o in network.observations.items():
        if not isinstance(o, FrameDistance):
            continue
        length = o.value - zero
        direction = next(
            (i, p)
            for i, p in network.observations.items()
            if isinstance(p, FrameZenith) and (p.frame, p.point) == (o.frame, o.point)
        )
        wanted = np.hypot(5e-6, 2e-4 / length)
        assert found[direction[0]] == pytest.approx(wanted, rel=1e-3)
        read = 1e-4 + 20e-6 * o.value
        assert found[ident] == pytest.approx(np.hypot(read, 2e-4), rel=1e-9)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (("frame_zenith", "scan", "A", "-0.1", "1"), "between 0 and 200 gon"),
        (("frame_distance", "scan", "A", "-3", "1"), "cannot be negative"),
        (("frame_distance", "scam", "A", "3", "1"), "scan"),
        (("frame_direction", "scan", "Z", "3", "1"), "unknown point 'Z'"),
        (("frame_direction", "scan", "A", "3", "0"), "sigma"),
    ],
)
def test_wrong_rows_are_named_with_file_and_line(
    wrong: tuple[str, ...], told: str, tmp_path: Path
) -> None:
    network = fga.Network("scan")
    for name, at in (("A", (4.0, 0, 0)), ("B", (0, 5.0, 1)), ("C", (-3.0, -3, 2))):
        network.add_point(name, at, fixed="xyz")
    network.add_frame("scan", values=dict.fromkeys(("rx", "ry", "rz", "x", "y", "z"), 0.0))
    for i, name in enumerate("ABC"):  # σ of each row: the columns of σ are there
        network.add(FrameDirection("scan", name, 1.0, sigma=1e-5 * (1 + i)))
    network.add(FrameDistance("scan", "A", 4.0, sigma=1e-3))
    fga.write_project(network, tmp_path / "project.toml")
    (table,) = [f for f in tmp_path.glob("*.csv") if "frame_direction" in f.read_text()]
    header = table.read_text().splitlines()[0].split(",")
    row = dict.fromkeys(header, "")
    kind, frame, point, value, sigma = wrong
    row |= {"kind": kind, "frame": frame, "point": point}
    row[next(c for c in header if c.startswith("value"))] = value
    row["sigma_mm" if kind == "frame_distance" else "sigma_mgon"] = sigma
    with table.open("a") as file:
        file.write(",".join(row[c] for c in header) + "\n")
    with pytest.raises(fga.InputError) as error:
        fga.read_project(tmp_path)
    assert told in str(error.value)
    assert f"{table.name}:6" in str(error.value) or f"{table.name} line 6" in str(error.value)


def test_parts_that_have_no_effect_are_refused() -> None:
    with pytest.raises(fga.InputError, match="ppm of sigma has no effect on a frame direction"):
        FrameDirection("scan", "A", 1.0, sigma=StandardDeviation(constant=1e-5, ppm=1.0))
    with pytest.raises(fga.InputError, match="the face must be 1 or 2"):
        FrameDirection("scan", "A", 1.0, sigma=1e-5, face=3)
