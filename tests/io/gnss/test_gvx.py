"""GVX: marks occupied several times, correlations of sessions, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import Correlated

PLACES = {"A": (4e6, 1e6, 4.8e6), "B": (4e6 + 100, 1e6 + 200, 4.8e6), "C": (4e6, 1e6 + 300, 4.8e6)}


def network() -> fga.Network:
    """Return a single vector and a session of two."""
    n = fga.Network("n", frame=fga.GeocentricFrame())
    for name, at in PLACES.items():
        n.add_point(name, at)
    one = np.array([[4e-6, 1e-6, 0], [1e-6, 4e-6, 2e-6], [0, 2e-6, 9e-6]])
    n.add(fga.GnssVector("A", "B", (100.001, 200.002, -0.003), covariance=one, id="alone"))
    joint = np.kron([[1.0, 0.4], [0.4, 1.0]], one)
    joint[0, 4] = joint[4, 0] = 1.1e-6  # correlations of two vectors are not symmetric
    n.add(
        Correlated(
            (
                fga.GnssVector("A", "C", (0.0, 300.0, 0.0), covariance=one, id="first"),
                fga.GnssVector("B", "C", (-100.0, 100.0, 0.0), covariance=one, id="second"),
            ),
            joint,
        )
    )
    return n


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "n.gvx"
    fga.write_gvx(network(), path, reference_system_id=126, reference_system="NAD 83(2011)")
    return path


def test_a_network_there_and_back(written: Path) -> None:
    expected, found = network(), fga.read(written)
    assert {n: p.coordinates for n, p in found.points.items()} == PLACES
    for ident, o in expected.observations.items():
        other = found.observations[ident]
        assert o.names() == other.names() and o.value == other.value  # type: ignore[attr-defined]
        np.testing.assert_allclose(other.covariance, o.covariance, rtol=1e-14)  # type: ignore[attr-defined]
    ((members, joint),) = found.clusters
    assert members == ("first", "second")
    np.testing.assert_allclose(joint, expected.clusters[0][1], rtol=1e-13, atol=1e-22)
    for n in (expected, found):
        n.points["A"] = fga.Point("A", PLACES["A"], (True, True, True))
    a, b = fga.adjust(expected), fga.adjust(found)
    np.testing.assert_allclose(a.point("C"), b.point("C"), rtol=0, atol=1e-9)
    assert a.vtpv == pytest.approx(b.vtpv, rel=1e-6)


def test_correlations_between_vectors_can_stay_out(written: Path) -> None:
    found = fga.read_gvx(written, correlations="vectors")
    assert not found.clusters
    assert len(found.observations) == 3


def test_points_of_one_name_are_occupations_of_one_mark(written: Path) -> None:
    text = written.read_text(encoding="utf-8")
    begin, end = text.index("  <POINT><ID>C<"), text.index("  <GNSS_VECTOR>")
    point = text[begin:end].replace("<ID>C<", "<ID>C2<").replace(repr(1e6 + 300), repr(1e6 + 302))
    text = text[:end] + point + text[end:]
    text = text.replace("<TERMINAL_POINT_ID>C<", "<TERMINAL_POINT_ID>C2<", 1)
    written.write_text(text, encoding="utf-8")
    found = fga.read_gvx(written)
    assert list(found.points) == ["A", "B", "C"]
    assert found.observations["first"].names()[-1] == "C"
    written.write_text(text.replace(repr(1e6 + 302), repr(1e6 + 802)), encoding="utf-8")
    with pytest.raises(fga.InputError, match="mark 'C' is 502 m from its first occupation"):
        fga.read_gvx(written)


def test_geodetic_coordinates_serve_where_geocentric_ones_are_missing(written: Path) -> None:
    text = written.read_text(encoding="utf-8").replace("<X>4000000.0</X>", "<X/>")
    written.write_text(text, encoding="utf-8")
    at = fga.read_gvx(written).points["A"].coordinates
    np.testing.assert_allclose(at, PLACES["A"], rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('VERSION="1.0"', 'VERSION="2.0"', "VERSION must be 1.0"),
        ("<NAME>meter</NAME>", "<NAME>US survey foot</NAME>", "unit must be metres"),
        ("<TERMINAL_POINT_ID>B<", "<TERMINAL_POINT_ID>Q<", "unknown point ID 'Q'; known: A, B, C"),
        ("<ID>second<", "<ID>first<", "second vector with the ID 'first'"),
        ("<ID>C<", "<ID>B<", "second point with the ID 'B'"),
        ('ROW="second"', 'ROW="third"', "unknown vector ID 'third'"),
        ("<CORRELATIONS>", "<CORRELATIONS>1,", "needs 9 numbers, not 10"),
        ("<SDX>0.002<", "<SDX>0<", "<SDX> must be greater than zero, not 0"),
        ("<PXY>0.25<", "<PXY>1.25<", "positive"),
        ("<REFERENCE_SYSTEM_ID>126<", "<REFERENCE_SYSTEM_ID>196<", "several reference systems"),
        ("<ECEF_DELTAS>", "<DELTAS>", "not well-formed"),
        ("<SURVEY_SETUP>", "<LEVELLING/><SURVEY_SETUP>", "<LEVELLING> cannot be in <GVX>"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(
    written: Path, old: str, new: str, message: str
) -> None:
    text = written.read_text(encoding="utf-8")
    assert old in text
    written.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(fga.InputError) as caught:
        fga.read_gvx(written)
    assert message in str(caught.value)
    assert "n.gvx:" in str(caught.value)


def test_what_gvx_cannot_express_is_refused_all_at_once(tmp_path: Path) -> None:
    n = network()
    n.points["A"] = fga.Point("A", PLACES["A"], (True, True, True))
    n.add(fga.SlopeDistance("A", "B", 223.6, sigma=0.01))
    n.add(fga.GnssVector("A", "B", (1.0, 2.0, 3.0), sigma=(1, 1, 1), instrument_height=1.5))
    with pytest.raises(fga.InputError) as caught:
        fga.write_gvx(n, tmp_path / "no.gvx")
    for part in ("held or weighted marks", "no slope distance", "no instrument_height"):
        assert part in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_marks_that_are_named_are_held(written: Path) -> None:
    found = fga.read(written, fixed="A,B")
    assert [p.name for p in found.points.values() if p.held == "xyz"] == ["A", "B"]
    assert found.datum == "given"
    assert fga.adjust(found).redundancy == 6  # three vectors, one free mark
    with pytest.raises(fga.InputError, match=r"n\.gvx:\d+: fixed: there is no mark 'D'; known: A"):
        fga.read(written, fixed=["D"])
