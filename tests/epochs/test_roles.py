"""One rule for the reference of two epochs, whatever carries the datum, and what is said of it."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.epochs_report import EpochsReport, render_congruence
from factorgraph_adj.report.html.verdict import epochs_verdict
from factorgraph_adj.report.results_json import epochs_results_record

PLACES = {
    "P1": (0, 0, 0),
    "P2": (100, 5, 1),
    "P3": (95, 110, 3),
    "P4": (-5, 100, 2),
    "P5": (50, 50, 4),
    "P6": (30, 70, 2),
    "P7": (70, 30, 1),
}
SUNK = {"P6": (0, 0, -0.0081)}
"""A point that sinks by 8.1 mm: 0.5 of the σ with which GNSS places it, 30 σ of the levelling."""


def epoch(seed, shifts=None, *, datum, without=(), move_held=0.0):
    """Return distances (0.5 mm) and height differences (0.3 mm) between all points."""
    rng = np.random.default_rng(seed)
    network = fga.Network(f"epoch {seed}", datum="free" if datum == "free" else "given")
    true = {n: np.array(x, float) for n, x in PLACES.items() if n not in without}
    for n, x in true.items():
        held = datum == "held" and n in ("P1", "P2", "P3")
        network.add_point(n, x + (move_held if held else 0.0), fixed="xyz" if held else "")
    for n, shift in (shifts or {}).items():
        true[n] = true[n] + shift
    if datum == "gnss":
        for n in ("P1", "P2", "P3", "P4"):
            network.add(fga.GnssPosition(n, true[n] + rng.normal(0, 0.01, 3), sigma=(0.01,) * 3))
    for a, b in combinations(true, 2):
        d = true[b] - true[a]
        length = np.linalg.norm(d) + rng.normal(0, 0.0005)
        network.add(fga.SlopeDistance(a, b, length, sigma=0.0005))
        network.add(fga.HeightDifference(a, b, d[2] + rng.normal(0, 0.0003), sigma=0.0003))
    return network


def compared(first, second, **options):
    return fga.congruence(fga.adjust(first), fga.adjust(second), **options)


@pytest.mark.parametrize("datum", ["gnss", "free", "held"])
def test_a_point_that_sank_is_found_whatever_carries_the_datum(datum):
    epochs = [epoch(1, datum=datum), epoch(2, SUNK, datum=datum)]
    found = compared(*epochs)
    named = compared(*epochs, objects=["P6"])
    assert found.moved == named.moved == ("P6",)
    own, other = found.displacement("P6"), named.displacement("P6")
    assert own.test.value == pytest.approx(other.test.value, rel=1e-6)
    assert own.test.value > 500
    assert own.vector[2] == pytest.approx(-0.0081, abs=4 * own.sigmas[2])


def test_the_first_lines_say_what_was_tested_and_what_was_not():
    first = epoch(1, datum="held", without=("P7",))
    second = epoch(2, datum="held", without=("P5",))
    said = render_congruence(compared(first, second, objects=["P6"])).split("\n\n")[0]
    said = " ".join(said.split())
    assert "Reference, tested together for a change of shape: 1 point, P4." in said
    assert "Tested one by one against the reference: 1 point, P6." in said
    assert "without a test: 3 points, P1, P2, P3." in said
    assert "NOT compared, in the first epoch alone: 1 point, P5." in said
    assert "NOT compared, in the second epoch alone: 1 point, P7." in said
    said = " ".join(
        render_congruence(compared(first, second, reference=["P4"], objects=[])).split()
    )
    assert "NOT compared, neither named as reference nor as object: 1 point, P6." in said


@pytest.mark.parametrize("language", ["en", "de"])
def test_nothing_tested_is_never_nothing_moved(language):
    found = compared(epoch(1, datum="gnss"), epoch(2, datum="gnss"))
    assert found.stable == found.reference  # all fit, and none is left to be tested against them
    assert "no objects were tested" in found.headline()
    said = " ".join(render_congruence(found).split())
    assert "No point was tested as an object: none is named." in said
    assert "No point was tested against the reference." in said
    assert "moved significantly" not in said
    t = Texts(language)
    verdict = epochs_verdict(EpochsReport(found), t)
    assert verdict.text == t("verdict_epochs_shape")
    lights = [light.text for light in verdict.lights]
    assert t("light_moved_untested") in lights
    assert t("light_moved_none", alpha="5 %") not in lights


def test_held_points_that_are_held_elsewhere_make_the_comparison_doubtful():
    first = epoch(1, datum="held")
    second = epoch(2, dict.fromkeys(PLACES, (0.1, 0, 0)), datum="held", move_held=(0.1, 0, 0))
    found = compared(first, second)
    assert set(found.held_apart) == {"P1", "P2", "P3"}
    assert not found.fine
    doubts = EpochsReport(found).doubts
    assert any("'P1' is held in both epochs, 100.00 mm apart" in d for d in doubts)
    assert epochs_results_record(EpochsReport(found))["held"] == ["P1", "P2", "P3"]


@pytest.mark.parametrize("order", [("held", "free"), ("free", "held"), ("held", "gnss")])
def test_points_that_one_epoch_alone_holds_are_a_doubt(order):
    first, second = (epoch(1 + i, datum=datum) for i, datum in enumerate(order))
    found = compared(first, second)
    which = "first" if order[0] == "held" else "second"
    assert found.held_in_one == {f"held in the {which} epoch alone": ("P1", "P2", "P3")}
    assert not found.fine
    (doubt,) = EpochsReport(found).doubts
    said = f"points 'P1', 'P2', 'P3' are held in the {which} epoch alone, and cannot be compared"
    assert doubt.startswith(said)
    closed = "the difference of the datums too"
    assert (closed in doubt) == ("free" not in order)
    assert epochs_verdict(EpochsReport(found), Texts("en")).colour == "red"


@pytest.mark.parametrize("datum", ["gnss", "free", "held"])
def test_epochs_that_hold_the_same_points_have_no_such_doubt(datum):
    found = compared(epoch(1, datum=datum), epoch(2, datum=datum))
    assert not found.held_in_one
    assert found.fine
    assert not EpochsReport(found).doubts
