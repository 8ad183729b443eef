"""Names that were exchanged, a scale or held points that moved look like displacements."""

from __future__ import annotations

from dataclasses import replace

import pytest

import factorgraph_adj as fga
from tests.networks.epochs import epoch, solved


def renamed(network: fga.Network, names: dict[str, str]) -> fga.Network:
    """Return a network in which points bear other names in all observations."""
    out = fga.Network(network.name, datum=network.datum)
    for point in network.points.values():
        other = names.get(point.name, point.name)
        at = network.points.get(other, point)
        out.add_point(other, at.coordinates, fixed="z" if not all(point.fixed) else "xyz")
    for o in network.observations.values():
        ends = {e: names.get(getattr(o, e), getattr(o, e)) for e in ("station", "target")}
        out.add(replace(o, **ends, id=None))
    return out


def compared(network: fga.Network, **options) -> fga.Congruence:
    first = solved(1)
    return fga.congruence(first, fga.adjust(network, start=first), **options)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({"P": "Q", "Q": "P"}, "the names of 'P' and 'Q' look exchanged in one epoch"),
        ({"P": "Q", "Q": "E", "E": "P"}, "the names of 'E', 'Q', 'P' look exchanged"),
    ],
)
def test_exchanged_names_are_no_displacements(names, words):
    found = compared(renamed(epoch(2), names))
    (told,) = found.alternatives
    assert told.startswith(words)
    assert not found.fine


def test_objects_may_have_exchanged_names_too():
    names = {"P": "Q", "Q": "P"}
    found = compared(renamed(epoch(2), names), objects=["P", "Q"])
    assert len(found.alternatives) == 1


def test_a_point_with_another_name_is_told():
    found = compared(renamed(epoch(2), {"P": "P_new"}))
    (told,) = found.alternatives
    assert told.startswith("point 'P_new' of the second epoch lies")
    assert "from where 'P' of the first was" in told
    assert not found.fine


def test_a_common_scale_is_no_displacement():
    network = epoch(2)
    for ident, o in list(network.observations.items()):
        if isinstance(o, fga.HorizontalDistance):
            network.observations[ident] = replace(o, value=o.value * (1 + 150e-6))
    found = compared(network)
    (told,) = found.alternatives
    assert "explains all differences of the reference points" in told
    assert found.scale_change.value == pytest.approx(150e-6, abs=4 * found.scale_change.sigma)
    assert not found.fine


def test_a_held_point_that_moved_is_named():
    first = fga.adjust(epoch(1, datum="given"))
    second = fga.adjust(epoch(2, {"C": (0.03, 0.03)}, datum="given"))
    found = fga.congruence(first, second)
    told, alone = found.alternatives
    assert "in the second epoch alone" in alone and "the given x, y of point 'C'" in alone
    assert told.startswith("held points moved, as a free adjustment of both epochs shows")
    assert "'C' by 4" in told


@pytest.mark.parametrize("shifts", [{}, {"B": (0.02, 0.01)}, {"P": (0.0, 0.01), "Q": (0.0, 0.01)}])
@pytest.mark.parametrize("datum", ["free", "given"])
def test_what_did_not_move_or_really_moved_has_no_other_explanation(shifts, datum):
    for seed in (3, 5):
        first = solved(seed, datum=datum)
        found = fga.congruence(first, solved(seed + 1, shifts, datum=datum))
        assert not found.alternatives


def test_a_point_of_the_reference_that_does_not_fit_is_not_called_stable():
    first = solved(20)
    found = fga.congruence(first, solved(21, {"A": (0.05, 0), "B": (0, 0.04), "C": (-0.06, 0.02)}))
    every = found.displacements.values()
    assert all(x.test.accepted for x in every if x.verdict == "stable")
    assert all(x.verdict == "doubtful" for x in every if x.stable and not x.test.accepted)
