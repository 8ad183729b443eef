"""Reduced observations of LandXML: azimuths and distances of a plan, read where no raw ones are."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from tests.hostile.examples import Example
from tests.io.field_books.field_files import landxml

CORNERS = {"P1": (0.0, 0.0), "P2": (30.0, 40.0), "P3": (90.0, 20.0), "P4": (60.0, -40.0)}
"""East and north."""
UNITS = '<Metric linearUnit="meter" angularUnit="radians" directionUnit="decimal dd.mm.ss"/>'


def packed(angle: float) -> str:
    """Return an angle in D.MMSSssss, without the zeros at its end, as programs write it."""
    ticks = round(math.degrees(angle) % 360 * 3600 * 1e4)
    seconds, rest = divmod(ticks, 10_000)
    d, m, s = seconds // 3600, seconds // 60 % 60, seconds % 60
    return f"{d}.{m:02d}{s:02d}{rest:04d}".rstrip("0")


def plan(extra: str = "") -> str:
    """Return a plan of four corners whose sides and a diagonal were measured."""
    points = "".join(f'<CgPoint name="{n}">{y} {x}</CgPoint>\n' for n, (x, y) in CORNERS.items())
    setups = "".join(
        f'<InstrumentSetup id="IS-{n}" stationName="S{n}" instrumentHeight="0">'
        f'<InstrumentPoint pntRef="{n}"/></InstrumentSetup>\n'
        for n in CORNERS
    )
    rows = []
    names = [*CORNERS, "P1"]
    for a, b in [*itertools.pairwise(names), ("P1", "P3")]:
        d = np.subtract(CORNERS[b], CORNERS[a])
        rows.append(
            f'<ReducedObservation name="{a}{b}" setupID="IS-{a}" targetSetupID="IS-{b}" '
            f'azimuth="{packed(math.atan2(d[0], d[1]))}" horizDistance="{np.hypot(*d):.4f}" '
            'azimuthType="measured" distanceType="measured" purpose="traverse"/>\n'
        )
    return (
        '<?xml version="1.0"?>\n<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2">\n'
        f"<Units>{UNITS}</Units>\n<CgPoints>\n{points}</CgPoints>\n<Survey>\n{setups}"
        f'<ObservationGroup id="OG-1">\n{"".join(rows)}{extra}</ObservationGroup></Survey>\n'
        "</LandXML>\n"
    )


EXAMPLE_FILES = {
    "landxml_reduced": Example(
        "landxml",
        {"plan.xml": plan()},
        "plan.xml",
        {"fixed": "P1"},
        unread=(
            r"purpose=|Type=|ObservationGroup id=|instrumentHeight=|stationName=",
            r"angularUnit|ReducedObservation name=|InstrumentPoint",
        ),
        open_names=True,
    ),
}


def read(folder, text: str, **options) -> fga.Network:
    path = folder / "plan.xml"
    path.write_text(text, encoding="utf-8")
    return fga.read(path, **options)


def test_a_loop_of_azimuths_and_distances_closes(tmp_path):
    network = read(tmp_path, plan(), fixed="P1")
    kinds = [o.kind for o in network.observations.values()]
    assert (kinds.count("azimuth"), kinds.count("horizontal_distance")) == (5, 5)
    assert network.remarks[0] == (
        "the file has no raw observations: azimuths and horizontal distances of its 5 reduced "
        "ones are read"
    )
    solution = fga.adjust(network)
    assert solution.redundancy == 4
    for name, xy in CORNERS.items():
        assert np.max(np.abs(solution.point(name)[:2] - xy)) < 1e-4


def test_packed_azimuths_may_lack_their_last_zeros(tmp_path):
    """Of a plan of Queensland: 302.504 is 302° 50′ 40″."""
    text = plan().replace(f'azimuth="{packed(math.atan2(30, 40))}"', 'azimuth="302.504"')
    first = next(iter(read(tmp_path, text).observations.values()))
    assert math.degrees(first.value) % 360 == pytest.approx(302 + 50 / 60 + 40 / 3600)


def test_reduced_observations_beside_raw_ones_are_left_out(tmp_path):
    reduced = '<ReducedObservation setupID="s1" azimuth="10" horizDistance="5"><TargetPoint '
    reduced += 'name="A"/></ReducedObservation>'
    text = landxml().replace("</ObservationGroup>", f"{reduced}</ObservationGroup>")
    network = read(tmp_path, text)
    assert len(network.observations) == 9
    assert [(left.what, left.count) for left in network.left_out] == [("reduced observations", 1)]


def test_computed_values_arcs_and_other_distances_are_left_out(tmp_path):
    extra = (
        '<ReducedObservation name="c" setupID="IS-P2" targetSetupID="IS-P4" azimuth="10" '
        'azimuthType="Computed" horizDistance="85.44" MSLDistance="85.43"/>\n'
        '<ReducedArcObservation name="arc" setupID="IS-P2" targetSetupID="IS-P4" radius="9"/>\n'
    )
    network = read(tmp_path, plan(extra), fixed="P1")
    assert len(network.observations) == 11
    assert [(left.what, left.names) for left in network.left_out] == [
        ("arcs", ("arc",)),
        ("reduced values", ("c",)),
        ("azimuths and distances", ("c",)),
    ]


def test_a_reduced_observation_of_no_set_up_is_refused(tmp_path):
    text = plan().replace('targetSetupID="IS-P3"', 'targetSetupID="IS-P9"', 1)
    with pytest.raises(InputError, match="needs targetSetupID; 'IS-P9' is none of IS-P1, IS-P2"):
        read(tmp_path, text)
