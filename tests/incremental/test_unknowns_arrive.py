"""Frames, mounts, shapes and other unknowns are stated while observations arrive."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.entities import parameter_name
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import measure
from tests.networks.deformed_models import deformed_block
from tests.networks.hall import hall
from tests.networks.rigs import rig
from tests.networks.three_frames import three_frames
from tests.support import journals
from tests.support.arrivals import difference, items, split

AT_REST = 1e-6
"""Largest deviation of a settled state from the batch adjustment, relative to σ."""
LONG = pytest.mark.slow("a rig of many photos, and a whole hall: short tests let frames arrive")
Case = tuple[Callable[[], Network], str, str]
CASES: dict[str, Case] = {
    "a scanner": (three_frames, "frame", "scan"),
    "a model of unknown scale": (three_frames, "frame", "model"),
    "a levelled station": (three_frames, "frame", "station"),
    "the next model of a strip": (lambda: measure(deformed_block(), seed=2), "frame", "M3"),
    "a deformation of models": (
        lambda: measure(deformed_block(), seed=2),
        "model_deformation",
        "left",
    ),
}
MORE: dict[str, Case] = {
    "a camera of a rig": (lambda: measure(rig(3, held_points=30), seed=1), "mount", "back"),
    "the water of a tube": (hall, "level", "water"),
}


def arrives(case: Case, journal: Path | None) -> tuple[fga.IncrementalAdjustment, Network]:
    make, kind, name = case
    whole = make()
    first, later = split(whole, kind, name)
    inc = fga.IncrementalAdjustment(first, policy="accept", journal=journal)
    inc.add(later, unknowns={kind: {name: whole.of_kind(kind)[name]}})
    return inc, whole


def ends_as_the_batch(inc: fga.IncrementalAdjustment, whole: Network) -> None:
    inc.settle()
    assert not inc.n_waiting and len(inc) == len(items(whole))
    solution = inc.solution()
    found = difference(solution, fga.adjust(whole, start=solution, tolerance=1e-9))
    assert found.estimates < AT_REST
    assert found.sigmas < AT_REST


@pytest.mark.parametrize(
    "case",
    [*CASES.values(), *(pytest.param(c, marks=LONG) for c in MORE.values())],
    ids=[*CASES, *MORE],
)
def test_it_arrives_and_ends_where_the_batch_adjustment_does(case: Case, tmp_path: Path) -> None:
    journal = tmp_path / "day.jsonl"
    inc, whole = arrives(case, journal)
    ends_as_the_batch(inc, whole)
    before = inc.solution()
    del inc
    again = fga.IncrementalAdjustment.resume(journal)
    assert difference(again.solution(), before).estimates < 10 * AT_REST


def test_a_shape_is_a_frame_and_sizes_of_a_scratch_network() -> None:
    rng = np.random.default_rng(3)
    network = fga.Network("a tank")
    middle, radius = np.array((5.0, 5.0, 2.0)), 1.5
    for i in range(14):
        d = rng.normal(size=3)
        at = middle + radius * d / np.linalg.norm(d)
        network.add_point(f"P{i}", at)
        network.add(fga.ControlPoint(f"P{i}", at + rng.normal(0, 1e-3, 3), sigma=(1e-3,) * 3))
    inc = fga.IncrementalAdjustment(network)
    scratch = fga.Network()
    scratch.add_shape("tank", "sphere", origin=(5.2, 4.9, 2.1))
    on = [fga.observations.OnSphere("tank", f"P{i}", sigma=1e-3) for i in range(14)]
    inc.add(on, unknowns=scratch.parameters)
    assert not inc.n_waiting
    whole = network.copy()
    whole.add_shape("tank", "sphere", origin=(5.2, 4.9, 2.1))
    whole.add(*on)
    ends_as_the_batch(inc, whole)
    assert abs(inc.solution().unknown("size", "tank").values[0] - radius) < 5e-3


def test_a_station_arrives_with_its_point_and_waits_for_its_observations(tmp_path: Path) -> None:
    whole = three_frames()
    first, later = split(whole, "frame", "station")
    station = first.points.pop("T")
    del first.point_number["T"]
    inc = fga.IncrementalAdjustment(first, journal=tmp_path / "day.jsonl")
    inc.add(points=station, unknowns={"frame": {"station": whole.frames["station"]}})
    inc.add(later[0])
    assert inc.n_waiting == 1
    inc.add(later[1:])
    ends_as_the_batch(inc, whole)


def test_a_weighted_unknown_that_nothing_observes_is_in_the_solution() -> None:
    inc = fga.IncrementalAdjustment(three_frames())
    scratch = fga.Network()
    scratch.set_mount("lever", values={"x": 0.3}, sigma=dict.fromkeys(("x", "y", "z"), 0.01))
    inc.add(unknowns=scratch.parameters)
    assert inc.solution().unknown("mount", "lever").values[3] == pytest.approx(0.3)


def test_everything_that_is_wrong_is_told_at_once_and_nothing_changes() -> None:
    inc = fga.IncrementalAdjustment(three_frames())
    scratch = fga.Network()
    scratch.add_point("Q")
    scratch.add_frame("next", origin="Q")
    scratch.add_frame("scan")
    given: dict[str, dict[Any, Any]] = {
        "frame": {**scratch.frames, "": scratch.frames["scan"], ("a", "b"): 1, "odd": 1},
        "fame": {"x": scratch.frames["scan"]},
        "vertical": {"nobody": replace(scratch.frames["scan"], values=(0.0,) * 7)},
    }
    with pytest.raises(fga.InputError) as error:
        inc.add(points=fga.Point("P0", (0.0, 0.0, 0.0)), unknowns=given)
    text = str(error.value)
    for words in (
        "point 'P0'",
        "frame 'next': unknown point 'Q'",
        "frame 'scan': is stated already",
        "it is named by name, not by ''",
        "it is named by name, not by ('a', 'b')",
        "frame 'odd': is no Parameter: 1",
        "unknown kind 'fame'",
        "did you mean 'frame'?",
        "it needs 2 values, not 7",
    ):
        assert words in text
    assert "next" not in inc.network().frames
    with pytest.raises(fga.InputError, match="as the parameters of a scratch network"):
        inc.add(unknowns=scratch.frames["scan"])  # type: ignore[arg-type]


def test_what_observations_depend_on_already_is_not_stated_after_them() -> None:
    network = fga.Network("tower")
    for name, x in {"A": (0, 0, 0), "B": (100, 0, 20)}.items():
        network.add_point(name, x, fixed="xyz")
    network.add_point("P", (60.0, 40.0, 10.0))
    network.add(*(SlopeDistance(n, "P", 70.0, sigma=0.01) for n in "AB"))
    network.add(ZenithAngle("A", "P", 1.43, sigma=1e-3))
    inc = fga.IncrementalAdjustment(network)
    for state in (
        lambda n: n.set_vertical("A", sigma=1e-4),
        lambda n: n.set_refraction(value=0.13, fixed=True),
    ):
        scratch = fga.Network()
        scratch.add_point("A")
        state(scratch)
        with pytest.raises(fga.InputError, match="observation '3' depends on it: state it before"):
            inc.add(unknowns=scratch.parameters)
    scratch = fga.Network()
    scratch.add_point("B")
    scratch.set_vertical("B", sigma=1e-4)
    scratch.set_refraction("evening", sigma=0.1)
    inc.add(
        ZenithAngle("B", "P", 1.6, sigma=1e-3, refraction="evening"),
        unknowns=scratch.parameters,
    )
    assert not inc.n_waiting


def test_a_damaged_line_of_unknowns_is_told(tmp_path: Path) -> None:
    journal = tmp_path / "day.jsonl"
    inc, _ = arrives(CASES["a scanner"], journal)
    inc.settle()
    del inc
    lines = journals.read(journal)
    at = next(i for i, line in enumerate(lines) if "unknowns" in line)
    (record,) = lines[at]["unknowns"]
    for change, told in (
        ({"kind": "fame"}, "unknown kind 'fame'"),
        ({"colour": "red"}, "unknown field 'colour'"),
        ({"origin": "nowhere", "origin_x": None, "origin_y": None, "origin_z": None}, "nowhere"),
    ):
        lines[at]["unknowns"] = [{**record, **change}]
        journals.write(journal, lines)
        with pytest.raises(fga.InputError, match=told) as error:
            fga.IncrementalAdjustment.resume(journal)
        assert f"{journal}:{at + 1}" in str(error.value)


@pytest.mark.parametrize("make", [case[0] for case in CASES.values()] + [hall])
def test_every_unknown_is_read_from_its_record_as_it_was(make: Callable[[], Network]) -> None:
    from factorgraph_adj.io.json_records import unknown_fields, unknown_of

    network = make()
    for kind, given in network.parameters.items():
        for key, p in given.items():
            record = json.loads(json.dumps(unknown_fields(kind, key, p)))
            found_kind, found_key, found = unknown_of(record)
            assert (found_kind, parameter_name(found_key)) == (kind, parameter_name(key))
            assert found.fixed == p.fixed and found.origin == p.origin
            for a, b in ((found.values, p.values), (found.sigma, p.sigma)):
                assert np.allclose(a, b, rtol=1e-14, atol=0, equal_nan=True)
