"""A mistake that alone explains what does not close is named; honest readings have none."""

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_rows
from factorgraph_adj.validate.loop_misclosures import lines_between_given, open_loops
from factorgraph_adj.validate.preliminary_checks import named_mistakes
from factorgraph_adj.validate.repeated_readings import copied_returns
from factorgraph_adj.validate.stated_values import (
    differing_heights,
    exchanged_heights,
    wrong_line_lengths,
)

HEIGHTS = {"A": 231.45, "B": 244.812, "P": 228.93, "Q": 235.71, "R": 240.02, "S": 238.335}
LINES = [*("AP", "PQ", "QB", "BR", "RS", "SA", "QS", "SP")]


def levelling(*, given=None, seed=1, sigma=0.001, lengths=None):
    """Levelled lines between two bench marks, of which nobody knows where they are in plan."""
    rng = np.random.default_rng(seed)
    network = fga.Network("levelling")
    for name, z in HEIGHTS.items():
        held = name in "AB"
        known = (given or {}).get(name, z) if held else np.nan
        network.add_point(name, (0.0, 0.0, known), fixed="xyz" if held else "xy")
    for i, (a, b) in enumerate(LINES):
        value = round(HEIGHTS[b] - HEIGHTS[a] + rng.normal(0, sigma), 4)
        km = (lengths or {}).get(i, 0.8 + 0.1 * i)
        network.add(fga.HeightDifference(a, b, value, sigma=sigma, length_km=km))
    return network


def turned(network, ident, change):
    network.observations[ident] = replace(
        network.observations[ident], value=change(network.observations[ident].value)
    )
    return network


def found(network):
    equations = compile_rows(network)
    return [*open_loops(equations), *lines_between_given(equations)]


def test_a_levelled_line_with_the_wrong_sign_is_named_once():
    network = turned(levelling(), "7", lambda v: -v)
    label = network.observations["7"].label()
    causes = {f.cause for f in found(network)}
    assert causes == {f"{label} with the other sign explains"}
    assert len(named_mistakes(network)) == 1


@pytest.mark.parametrize(
    ("given", "told"),
    [(-244.812, "-244.812 m of point 'B' with the other sign"), (244.182, "as 244.812 m")],
)
def test_a_mistyped_height_is_named(given, told):
    (first,) = named_mistakes(levelling(given={"B": given}))
    assert told in str(first) and "2 more misclosures" in str(first)


def test_a_contradiction_of_any_size_is_not_explained():
    """Misclosures that no sign, unit or digits make have no cause: 4 of 100 may by chance."""
    rng = np.random.default_rng(5)
    explained = 0
    for seed in range(100):
        off = float(rng.uniform(0.05, 5.0))
        network = turned(levelling(seed=seed), "3", lambda v, off=off: v + off)
        explained += any(f.cause for f in found(network))
    assert explained <= 4


def test_good_lines_have_no_findings():
    assert not any(found(levelling(seed=seed)) for seed in range(20))


@pytest.mark.parametrize("wrong", [0, 4, 6])
def test_one_length_in_metres_is_told_without_coordinates(wrong):
    network = levelling(lengths={wrong: 1000.0 * (0.8 + 0.1 * wrong)})
    equations = compile_rows(network)
    (told,) = wrong_line_lengths(equations, equations.unknowns.start())
    assert network.observations[str(wrong + 1)].label() in told and "in metres" in told


def test_points_without_a_place_are_not_apart():
    """One benchmark alone has coordinates in plan."""
    network = levelling()
    name = next(iter(network.points))
    at = network.points[name].coordinates
    network.points[name] = replace(network.points[name], coordinates=(5_136_302.4, 52_100.0, at[2]))
    equations = compile_rows(network)
    assert not wrong_line_lengths(equations, equations.unknowns.start())


def test_long_ways_round_are_no_wrong_lengths():
    """Benchmarks 50 m apart, and a line of 4.5 km round the hill."""
    network = levelling(lengths={0: 0.05, 1: 0.05, 7: 4.5})
    equations = compile_rows(network)
    assert not wrong_line_lengths(equations, equations.unknowns.start())


def test_copied_returns_are_noted_and_measured_ones_are_not():
    rng = np.random.default_rng(2)
    forth = list(levelling().observations.values())
    copied, measured = levelling(), levelling()
    for o in forth:
        copied.add(replace(o, station=o.target, target=o.station, value=-o.value, id=None))
        back = round(-o.value + rng.normal(0, 0.001), 4)
        measured.add(replace(o, station=o.target, target=o.station, value=back, id=None))
    (note,) = copied_returns(copied)
    assert "8 of 8 lines" in note
    assert not copied_returns(measured)


def vectors(axes, *, wrong=()):
    """GNSS vectors of a network in a grid, along its axes or those of the Earth."""
    places = {
        "G1": (652300.0, 5411200.0, 310.0),
        "G2": (655120.5, 5412010.3, 342.4),
        "G3": (653900.0, 5413800.0, 401.0),
        "G4": (651800.0, 5412900.0, 377.0),
    }
    system = fga.ReferenceSystem("EPSG:25832", geoid=47.35)
    earth = system.geocentric_frame()
    network = fga.Network("vectors", crs=system)
    for name, xyz in places.items():
        network.add_point(name, xyz, fixed="xyz" if name in ("G1", "G2") else "")
    for a, b in (("G1", "G3"), ("G3", "G2"), ("G2", "G4"), ("G4", "G1"), ("G3", "G4")):
        if axes == "grid":
            d = np.subtract(places[b], places[a])
        else:
            d = np.subtract(*system.to_frame(earth, np.array([places[b], places[a]])))
        if (a, b) in wrong:
            d = d[[0, 2, 1]]
        network.add(fga.GnssVector(a, b, tuple(d.tolist()), sigma=(0.05,) * 3))
    return network


def test_a_vector_with_exchanged_components_is_named_along_the_axes_of_the_file():
    network = fga.from_grid(vectors("geocentric", wrong=[("G3", "G4")]), vectors="geocentric")
    told = [str(f) for f in found(network)]
    assert told and all("G3 G4 with y and z exchanged explains" in text for text in told)
    assert not found(fga.from_grid(vectors("geocentric"), vectors="geocentric"))


def test_geocentric_vectors_that_are_called_grid_are_named_beside_what_they_lack():
    network = vectors("geocentric")
    network.points["G4"] = replace(network.points["G4"], coordinates=(np.nan,) * 3)
    network.add(fga.GnssVector("G1", "G2", (-1067.1433, 2687.0703, 506.4988), sigma=(0.01,) * 3))
    with pytest.raises(InputError) as error:
        fga.from_grid(network, vectors="grid")
    assert "say vectors = 'geocentric'" in str(error.value.problems[-1])
    with pytest.raises(InputError) as error:
        grid = vectors("grid")
        grid.points["G4"] = replace(grid.points["G4"], coordinates=(np.nan,) * 3)
        fga.from_grid(grid, vectors="grid")
    assert "geocentric'" not in str(error.value)


@pytest.mark.parametrize("east", [32_652_300.0, 4_432_233.0])
def test_an_easting_with_the_number_of_a_zone_is_named(east):
    network = fga.Network("zone", crs=fga.ReferenceSystem("EPSG:25832", geoid=47.35))
    network.add_point("G1", (east, 5_411_200.0, 310.0), fixed="xyz")
    with pytest.raises(InputError, match="the easting begins with"):
        fga.from_grid(network)


def set_ups(heights_of_instruments, heights_of_targets):
    network = fga.Network("set-ups")
    for i, name in enumerate("ABCD"):
        network.add_point(name, (100.0 * i, 10.0 * i * i, 0.0))
    for s, i in zip("ABC", heights_of_instruments, strict=True):
        for t, h in zip("ABCD", heights_of_targets, strict=True):
            if s != t:
                network.add(
                    fga.ZenithAngle(s, t, 1.5, sigma=1e-5, instrument_height=i, target_height=h)
                )
    return network


def test_exchanged_columns_of_heights_are_named_instead_of_every_set_up():
    right = set_ups((1.5, 1.61, 1.55), (1.3, 1.3, 2.0, 1.3))
    assert not list(exchanged_heights(right)) and not list(differing_heights(right))
    wrong = fga.Network("set-ups")
    wrong.points = right.points
    for o in right.observations.values():
        wrong.add(replace(o, instrument_height=o.target_height, target_height=o.instrument_height))
    assert len(list(exchanged_heights(wrong))) == 1
    # Heights of instruments alone differ, where a format has none of targets.
    other = set_ups((1.5, 1.61, 1.55), (0.0, 0.0, 0.0, 0.0))
    for ident in ("1", "4"):
        other.observations[ident] = replace(other.observations[ident], instrument_height=1.7)
    assert not list(exchanged_heights(other))
