"""Image coordinates come back as the files of their camera have them: y down where it was down."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.io.project import read_project
from factorgraph_adj.io.project_writer import network_files, write_project
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.snooping import snoop
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.options import Provenance
from factorgraph_adj.report.plots import plot_photo_residuals
from factorgraph_adj.report.result_files import write_tables
from factorgraph_adj.report.text import text_report
from factorgraph_adj.simulation.measurement import measure
from tests.networks.small_block import blundered, small_block
from tests.support.printed import row
from tests.support.scatter import NETWORKS
from tests.support.shifted import shift_image

Files = dict[str, str]
SIGNED = {
    "observations.csv": (
        *("observed", "residual", "adjusted", "normalised", "w", "tau", "estimated_error"),
    ),
    "snooping.csv": (
        *("observed", "test_value", "estimated_error"),
        *("final_error", "final_test_value"),
    ),
    "unknowns.csv": ("value", "t"),
    "given_values.csv": ("error", "w"),
}
"""Columns that change their sign with the direction of y."""


def down(network: Network) -> Network:
    """Return a network whose files have y down."""
    network.cameras = {
        n: replace(c, y_down_in_files=True) for n, c in network.cameras.items()
    }  # fmt: skip
    return network


def weighted_y0() -> Network:
    """Return the small block with a weighted principal point and a wrong y of an image point."""
    network = small_block()
    camera = network.cameras["D3"]
    at = camera.lens.names.index("y0")
    sigma = tuple(0.05 if i == at else s for i, s in enumerate(camera.sigma))
    network.cameras["D3"] = replace(camera, sigma=sigma)
    shift_image(network, "F1/P6", 0.0, 0.08)
    return network


def held_y0() -> Network:
    """Return the small block with a principal point that is held and wrong."""
    network = small_block()
    camera = network.cameras["D3"]
    at = camera.lens.names.index("y0")
    values = tuple(2.0 if i == at else v for i, v in enumerate(camera.values))
    fixed = tuple(i == at or f for i, f in enumerate(camera.fixed))
    network.cameras["D3"] = replace(camera, values=values, fixed=fixed)
    return network


LONG = pytest.mark.slow(
    "a wrong held value, which takes data snooping many rounds; short tests have a weighted one"
)


@pytest.fixture(
    scope="module",
    params=[blundered, weighted_y0, pytest.param(held_y0, marks=LONG)],
    ids=lambda make: make.__name__,
)
def both(request, tmp_path_factory) -> tuple[Files, Files]:
    """Return the files of a report with y up, and with y down."""
    tmp_path = tmp_path_factory.mktemp("both")
    return written(request.param, False, tmp_path), written(request.param, True, tmp_path)


def written(make: Callable[[], Network], turned: bool, folder) -> Files:
    network = down(make().copy()) if turned else make()
    found = snoop(network)
    out = folder / ("down" if turned else "up")
    write_tables(Report(found.solution, provenance=Provenance(found, network)), out)
    return {p.name: p.read_text() for p in out.iterdir()}


def is_y(record: dict[str, str]) -> bool:
    """Return whether a record is of y of an image point, or of y0."""
    return record["component"] == "y0" or (record["component"], record["kind"]) == ("y", "image")


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
def test_only_what_points_along_y_changes_its_sign(both):
    up, turned = both
    for file, signed in SIGNED.items():
        if file not in up:
            continue
        first, second = (list(csv.DictReader(io.StringIO(f[file]))) for f in (up, turned))
        assert len(first) == len(second)
        for a, b in zip(first, second, strict=True):
            for name, value in a.items():
                if not (name in signed and is_y(a) and value):
                    assert b[name] == value, (file, name)
                else:
                    assert float(b[name]) == -float(value), (file, name)


def test_rows_of_y_are_among_what_is_compared(both):
    up, _ = both
    rows = list(csv.DictReader(io.StringIO(up["observations.csv"])))
    assert sum(is_y(r) for r in rows) >= 46


def test_the_file_for_programs_says_which_way_y_points(both):
    up, turned = (json.loads(f["results.json"]) for f in both)
    a, b = (f["calibrations"]["D3"] for f in (up, turned))
    assert (a["y_axis"], b["y_axis"]) == ("up", "down")
    at = a["parameters"].index("y0")
    for i, name in enumerate(a["parameters"]):
        sign = -1 if i == at else 1
        assert b["values"][i] == sign * a["values"][i], name
        assert b["sigma"][i] == a["sigma"][i]
        if i != at:
            assert b["correlation"][at][i] == -a["correlation"][at][i]
    for one, other in zip(up["snooping"]["rejected"], turned["snooping"]["rejected"], strict=True):
        sign = -1 if (one["kind"], one["component"]) == ("image", "y") else 1
        assert other["test"] == sign * one["test"]
        assert other["final_error"] == sign * one["final_error"]


@cache
def solution():
    return adjust(down(weighted_y0()))


def test_the_report_says_what_the_tables_say():
    up = text_report(adjust(weighted_y0()))
    turned = text_report(solution())
    y0 = [float(row(t, "Calibration of D3", "y0")[1]) for t in (up, turned)]
    assert y0[0] == -y0[1] != 0
    photo, point = next(iter(solution().network.photos)), "P6"
    name = f"{photo}/{point} y"
    lines = [next(x for x in t.splitlines() if name in x and "image" in x) for t in (up, turned)]
    assert "-" in lines[0].split(name)[1].split()[0] or "-" in lines[1].split(name)[1].split()[0]
    w = [float(x.split()[-3]) for x in lines]
    assert w[0] == -w[1] != 0


def test_a_cause_is_told_in_the_direction_of_the_files():
    errors = []
    for turned in (False, True):
        network = down(held_y0()) if turned else held_y0()
        found = Report(adjust(network)).causes
        cause = next(c for c in found.found if "y0" in c.cause)
        errors.append(cause.error[[*cause.given.components].index("y0")])
    assert errors[0] == -errors[1] != 0


def test_a_photo_is_numbered_as_in_the_files():
    pytest.importorskip("matplotlib")
    photo = next(iter(solution().network.photos))
    axes = plot_photo_residuals(solution(), photo).axes[0]
    written_at = axes.yaxis.get_major_formatter()
    assert [written_at(y) for y in (-10.0, 0.0, 12.5)] == ["10", "0", "-12.5"]
    low, high = axes.get_ylim()
    assert low < high, "the picture stays upright"


def test_a_project_is_written_with_its_direction_of_y(tmp_path):
    network = down(weighted_y0())
    write_project(network, tmp_path / "project.toml")
    text = (tmp_path / "project.toml").read_text()
    assert 'y_axis = "down"' in text
    first = next(csv.DictReader(io.StringIO((tmp_path / "images.csv").read_text())))
    assert float(first["y"]) == -network.images.columns()[2][0, 1]
    again = read_project(tmp_path)
    assert again.cameras == network.cameras
    assert again.images.columns()[2].tolist() == network.images.columns()[2].tolist()
    assert network_files(again) == network_files(network)


@pytest.mark.parametrize("kind", ["fiducial_mark", "image_through_port"])
def test_what_is_observed_in_an_image_has_unit_and_y_of_its_camera(kind, tmp_path):
    network = measure(NETWORKS[kind](), seed=3).copy()
    by_direction = []
    for turn in (lambda n: n, down):
        report = Report(adjust(turn(network.copy())))
        write_tables(report, tmp_path)
        rows = list(csv.DictReader(io.StringIO((tmp_path / "observations.csv").read_text())))
        by_direction.append([r for r in rows if r["kind"] == kind])
        assert {r["unit"] for r in by_direction[-1]} == {"mm"}
        every = report.rows.all()
        assert report.rows.signs().tolist() == [r.sign for r in every]
        groups = {g.label: g.scale.small for g in report.rows.groups()}
        assert groups[kind.replace("_", " ")] == "um"
    compared = 0
    for up, turned in zip(*by_direction, strict=True):
        for name in SIGNED["observations.csv"]:
            if up.get(name):
                sign = -1 if up["component"] == "y" else 1
                assert float(turned[name]) == sign * float(up[name]), name
                compared += 1
        assert up["sigma"] == turned["sigma"]
    assert compared > 100
