"""A doubtful result says which mistakes of whole groups the given coordinates tell of."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.html.verdict import adjustment_verdict

FOOT = 0.3048
PLACES = {"A": (0, 0), "B": (120, 10), "C": (60, 110), "D": (-70, 95), "P": (45, 50)}


def surveyed(*, unit: float = 1.0, exchanged: bool = False) -> fga.Network:
    """Return P and four held points with distances and directions between all of them.

    Args:
        unit: metres of the unit in which distances are taken for metres.
        exchanged: whether X and Y of the held points are exchanged.
    """
    rng = np.random.default_rng(4)
    network = fga.Network("yard")
    for name, (x, y) in PLACES.items():
        at = (y, x, 0) if exchanged else (x, y, 0)
        network.add_point(name, at, fixed="z" if name == "P" else "xyz")
    for a, at in PLACES.items():
        for b, there in PLACES.items():
            if a != b:
                d = np.subtract(there, at)
                s, t = np.hypot(*d) / unit + rng.normal(0, 1e-3), np.arctan2(*d)
                network.add(fga.HorizontalDistance(a, b, float(s), sigma=1e-3))
                reading = float((t + rng.normal(0, 1e-5)) % (2 * np.pi))
                network.add(fga.Direction(a, b, reading, sigma=1e-5))
    return network


@pytest.mark.parametrize(
    ("network", "said"),
    [
        (surveyed(unit=FOOT), "20 horizontal distances fit the given coordinates"),
        (surveyed(exchanged=True), "directions between held points run the other way round"),
    ],
)
def test_a_unit_and_exchanged_axes_are_told_by_texts_and_pages(
    network: fga.Network, said: str
) -> None:
    report = Report(fga.adjust(network))
    (doubt,) = report.shared_error_doubts
    assert doubt.startswith("found before the adjustment: ") and said in doubt
    text = " ".join(fga.text_report(report.solution).split())
    assert said in text[: text.index("program")]
    lights = adjustment_verdict(report, Texts("en")).lights
    assert any(said in f"{light.text} {light.told}" for light in lights)


def test_a_result_that_fits_and_one_gross_error_have_nothing_in_common() -> None:
    assert Report(fga.adjust(surveyed())).shared_error_doubts == []
    network = surveyed()
    wrong = next(o for o in network.observations.values() if o.kind == "horizontal_distance")
    network.observations[wrong.id] = fga.HorizontalDistance(
        wrong.station, wrong.target, wrong.value + 0.1, sigma=1e-3, id=wrong.id
    )
    report = Report(fga.adjust(network))
    assert report.doubts and report.shared_error_doubts == []
