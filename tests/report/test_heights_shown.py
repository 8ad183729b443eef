"""Profiles, levels, tilts, sights and gyrotheodolites in reports, tables and pictures."""

from __future__ import annotations

import matplotlib as mpl
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.report import plots
from factorgraph_adj.simulation.measurement import measure
from tests.networks.aerial_heights import Aerial, plan_of, unknown_values

BLOCK = Aerial(
    strips=2,
    photos=3,
    statoscope=("height", "height_t"),
    lake=True,
    recorder=("height",),
    tilts=("rx", "ry"),
    sights=("rx", "ry", "rz"),
)


@pytest.fixture(scope="module")
def solution() -> fga.Solution:
    plan = plan_of(BLOCK)
    plan.set_gyro("theodolite 7", 0.01)
    a, b, *_ = plan.points
    plan.add(
        o.GyroAzimuth(a, b, 0.0, gyro="theodolite 7", sigma=1e-4),
        o.GyroAzimuth(b, a, 0.0, gyro="theodolite 7", sigma=1e-4),
    )
    return fga.adjust(unknown_values(measure(plan, seed=1)))


def test_the_report_has_observations_and_unknowns_with_their_names(solution) -> None:
    text = fga.text_report(solution)
    for what in ("profile height", "level height", "photo tilt", "photo sight", "gyro azimuth"):
        assert what in text
    for name in ("strip 0", "recorder", "lake", "horizon camera", "star tracker", "theodolite 7"):
        assert name in text


def test_parameters_are_tested_for_significance(solution) -> None:
    tested = {(t.kind, t.name) for t in fga.significance(solution).parameters}
    assert {("profile", "strip 0"), ("mount", "star tracker"), ("gyro", "theodolite 7")} <= tested


@pytest.mark.parametrize(
    "draw", ["plot_network", "plot_redundancy", "plot_w", "plot_qq", "plot_photos"]
)
def test_pictures_are_drawn(solution, draw: str) -> None:
    mpl.use("agg")
    of_solution = draw in ("plot_network", "plot_photos")
    figure = getattr(plots, draw)(solution if of_solution else fga.reliability(solution))
    assert figure.axes


def test_variance_components_have_a_group_for_each_kind() -> None:
    network = unknown_values(measure(plan_of(BLOCK), seed=2))
    found = fga.estimate_variance_components(network)
    assert found.converged
