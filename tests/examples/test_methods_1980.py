"""Thirty methods on one block: what the paper concludes, and figures of the real strip."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from examples.papers.methods_1980 import METHODS, REPORTED, Table3, main, run_methods
from examples.papers.methods_1980_block import MethodBlock, simulated_block
from examples.papers.methods_1980_run import outcome, uncorrelated, with_corners
from factorgraph_adj.simulation.generate.scene import corners, spread
from factorgraph_adj.triangulation.independent_models import as_models
from tests.loaders.borea import read_borea
from tests.loaders.tsaiyoung import read_strip
from tests.networks.strip import network_of_photos
from tests.support.places import data_dir

pytestmark = pytest.mark.slow(
    "the comparison of methods on whole strips; short tests compute the tables of the papers"
)

QUICK = (5, 8, 9, 11, 13, 14, 15, 16, 17, 18, 20, 23, 24, 25, 28, 29)
"""Methods that take a second or less each."""


@pytest.fixture(scope="module")
def table() -> Table3:
    return run_methods(simulated_block(), numbers=QUICK)


def plan(table: Table3, number: int) -> float:
    """Return the RMS error of one coordinate in plan, metres."""
    return float(np.sqrt(np.mean(table.of(number).rms[:2] ** 2)))


def test_every_method_has_a_way_or_a_reason() -> None:
    assert [r.number for r in METHODS] == list(range(1, 31))
    assert all((r.method is None) == bool(r.reason) for r in METHODS)
    assert set(REPORTED) <= set(range(1, 31))
    table = run_methods(simulated_block(), numbers=[r.number for r in METHODS if r.reason])
    assert all(r.outcome is None and r.reason == r.row.reason for r in table.rows)


def test_additional_parameters_take_out_what_film_and_lens_leave(table: Table3) -> None:
    """Printed for models 28 → 17.6 (factor 1.6); here 2 to 3 in plan for models and bundle."""
    assert plan(table, 24) / plan(table, 23) > 1.6
    assert plan(table, 25) / plan(table, 28) > 2.0
    assert table.of(28).outcome is not None
    assert table.of(28).outcome.sigma0 < 1.2 < table.of(25).outcome.sigma0


def test_the_bundle_is_better_than_models_and_they_than_polynomials(table: Table3) -> None:
    assert plan(table, 25) < plan(table, 24) < plan(table, 18)
    assert plan(table, 18) < plan(table, 11)  # comparator and plotter
    assert table.of(8).rms[0] > 2 * table.of(11).rms[0]  # seven parameters bend nothing


def test_collocation_of_residuals_at_control_improves_a_block_of_models(table: Table3) -> None:
    """Printed for Appenweier 5.3 → 4.4; here in plan 19 → 13, heights by less."""
    assert plan(table, 20) < 0.85 * plan(table, 24)
    assert table.of(20).rms[2] < 1.05 * table.of(24).rms[2]


def test_methods_in_plan_say_nothing_of_heights(table: Table3) -> None:
    for number in (5, 13, 16):
        assert np.isnan(table.of(number).rms[2])
    assert plan(table, 16) < 4 * plan(table, 25)


def test_auxiliary_data_hold_heights_where_control_is_in_the_corners_alone(table: Table3) -> None:
    """Heights by models alone have 1.42 m; a statoscope helps little, measured tilts much."""
    bare = as_models(with_corners(simulated_block().plotter, axes="z"))
    found = outcome(fga.adjust(uncorrelated(bare)), simulated_block())
    alone = float(np.sqrt(np.mean(found.errors[:, 2] ** 2)))
    assert table.of(9).rms[2] < alone
    assert table.of(14).rms[2] < 0.5 * alone


def test_counts_are_those_of_the_methods(table: Table3) -> None:
    """Seven unknowns a model, four in plan, six a photo, ten coefficients a strip."""
    block = simulated_block().network
    photos, pairs = len(block.photos), len(block.photos) - 3
    (points,) = {len(r.outcome.errors) for r in table.rows if r.row.number == 24}
    assert table.of(24).outcome.u == 7 * pairs + 3 * (points + photos)
    assert table.of(13).outcome.u == 4 * pairs + 2 * points
    assert table.of(18).outcome.u == 10 * 3 + 3 * points
    assert table.of(25).outcome.u == 6 * photos + 3 * len(table.of(25).outcome.errors)


def test_a_second_bundle_takes_the_signal_of_residuals_out(table: Table3) -> None:
    """Casa Grande printed 3.2 → 2.2 cm in plan, 2.9 → 1.6 in height, factors of 0.69 and 0.55."""
    found = run_methods(simulated_block(), numbers=[27])
    assert plan(found, 27) < 0.55 * plan(table, 25)
    assert found.of(27).rms[2] < 0.75 * table.of(25).rms[2]
    assert plan(table, 28) < plan(found, 27)


def test_twenty_five_methods_run_and_five_are_graphical() -> None:
    assert [r.number for r in METHODS if r.method is None] == [1, 2, 3, 6, 7]


@pytest.mark.slow("all methods that can be run, those in turn included, and the command")
def test_the_whole_table_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    said = capsys.readouterr().out
    assert "28 bundle, additional parameters" in " ".join(said.split())
    assert "20 IMT, collocation 1080 735 345" in " ".join(said.split())


@pytest.mark.published
def test_the_real_strip() -> None:
    """Rows of FRAMES 6.2 among the methods: 18 .033 .040 .174, 8 .084 .062 .366, 25 4.353 µm."""
    network = network_of_photos(read_strip(data_dir("tsaiyoung_strip")))
    table = run_methods(MethodBlock(network, network))
    np.testing.assert_allclose(table.of(18).rms, [0.033, 0.040, 0.174], rtol=0, atol=0.0005)
    np.testing.assert_allclose(table.of(8).rms, [0.084, 0.062, 0.366], rtol=0, atol=0.0006)
    bundle = table.of(25).outcome
    assert (bundle.n, bundle.u, bundle.r) == (124, 96, 28)
    assert bundle.sigma0 == pytest.approx(4.353, abs=0.0005)
    assert "no signal" in table.of(27).reason
    models = table.of(24).outcome
    assert (models.n, models.u) == (120, 105)
    assert "distances and azimuths" in table.of(17).reason
    assert "not determined" in table.of(16).reason
    ran = [r.row.number for r in table.rows if r.outcome is not None]
    assert ran == [4, 5, 8, 11, 12, 13, 15, 18, 19, 21, 23, 24, 25, 28, 29, 30]


FLOWN = ("00026", "00027", "00028")
"""Three parallel strips of IGN's block that image points join."""


def ign_block() -> MethodBlock:
    """Return three strips of IGN: 16 delivered points are held, the other ones are checks.

    The second strip was flown back: its photos stand in the other order, so that the last photo of
    a strip does not overlap the first one of the next.
    """
    block = read_borea(data_dir("borea"))
    first, second, third = ([p.name for p in block.strips[strip]] for strip in FLOWN)
    flown = [*first, *second[::-1], *third]
    count = Counter(n for p in flown for n in set(block.rays[p][0]))
    chosen = {n for n in block.points if count[n] >= 2}
    chosen = {n for i, n in enumerate(block.points) if n in chosen and i % 2 == 0}
    flown = [p for p in flown if len(chosen.intersection(block.rays[p][0])) >= 10]
    count = Counter(n for p in flown for n in set(block.rays[p][0]) & chosen)
    names = [n for n in block.points if count[n] >= 2]
    xy = np.array([block.points[n][:2] for n in names])
    control = {names[i] for i in spread(xy, 16, corners(xy))}
    given = block.network(points=names, sigma=0.3)
    network = fga.Network("three strips of IGN", frame=block.frame)
    network.cameras = dict(given.cameras)
    for n in names:
        at = tuple(block.points[n].tolist())
        network.add_point(n, at, fixed="xyz" if n in control else "")
        if n not in control:
            network.points[n] = replace(network.points[n], check=at)
    for p in flown:
        photo = given.photos[p]
        network.add_photo(p, photo.camera, position=photo.position, rotation=photo.rotation)
        points, xy = block.rays[p]
        on = [i for i, n in enumerate(points) if n in network.points]
        network.add_image_points(p, [points[i] for i in on], xy[on], sigma=0.3)
    return MethodBlock(network, network, image_base=12000.0)


@pytest.mark.published
def test_three_measured_strips_of_ign() -> None:
    """A camera of today without film: what is left are models and chains of them."""
    table = run_methods(ign_block(), numbers=(8, 11, 15, 20, 25, 27, 28, 29))
    assert [r.row.number for r in table.rows if r.outcome is None] == []
    for number in (15, 25, 27, 28, 29):
        assert plan(table, number) < 0.015
        assert table.of(number).rms[2] < 0.06
    assert plan(table, 25) < plan(table, 20) < plan(table, 11) < plan(table, 8)
    assert table.of(25).rms[2] < table.of(20).rms[2] < table.of(11).rms[2] < table.of(8).rms[2]
