"""Mappings: all problems at once with their lines; names, prisms, air as they say."""

from __future__ import annotations

import tomllib
from math import pi

import pytest

from factorgraph_adj.atmosphere import group_index
from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import (
    Instrument,
    ReceivedLine,
    SensorBoard,
    read_instruments,
)
from factorgraph_adj.instruments.instrument_settings import duration
from factorgraph_adj.io.observation_records import observation_from_record
from factorgraph_adj.io.text_files import TomlPlaces

WRONG = """[site]
name = "x"
[[instrument]]
name = "ts1"
network = "dem"
source = "tpc://10.0.0.1:4001"
grammar = "gsi-onlin"
faces = 3
set_pause = "ten minutes"
[[instrument]]
name = "ts2"
network = "dam"
source = "serial:/dev/ttyUSB0?baud=19201"
grammar = "gsi-online"
stations = "P1"
targets = ["A", "A"]
[instrument.rename]
"1" = "A"
"2" = "A"
[instrument.accuracies]
sigma_direction_mgon = -1.0
refraction = 0.13
[instrument.atmosphere]
wavelength_nm = 6580
reference_index = 286.0
sensor = "air"
humidity = 60
"""


def test_all_problems_are_told_with_their_lines():
    document, places = tomllib.loads(WRONG), TomlPlaces(WRONG, "site.toml")
    with pytest.raises(InputError) as error, places.placing():
        read_instruments(document["instrument"], where="site.toml", networks=["dam"])
    found = [str(p) for p in error.value.problems]
    wanted = {
        5: "no network 'dem'",
        6: "unknown source 'tpc://",
        7: "unknown grammar 'gsi-onlin'",
        8: "faces must be 1 or 2",
        9: "set_pause must be a duration",
        13: "baud must be one of",
        15: "unknown key 'stations'",
        16: "targets: A more than once",
        21: "sigma_direction_mgon: must be a number > 0",
        22: "refraction is of the network",
        24: "wavelength_nm must be from 400 to 1600 nm",
        25: "reference_index must be such as",
        26: "sensor: there is no instrument 'air'; known: ts1, ts2",
        27: "unknown key 'humidity'",
    }
    for line, what in wanted.items():
        assert any(f"site.toml:{line}:" in text and what in text for text in found), (line, found)
    assert any("both become 'A'" in text for text in found)
    assert len(found) == len(wanted) + 1, found


@pytest.mark.parametrize(
    "text, seconds", [("10 min", 600), ("1.5h", 5400), ("2 d", 172_800), (3, 3), ("-1 h", -3600)]
)
def test_durations(text, seconds):
    assert duration(text) == seconds


@pytest.mark.parametrize("text", ["10", "min", "1 week", True, "1e9 d", ""])
def test_wrong_durations(text):
    with pytest.raises(ValueError):
        duration(text)


def test_the_group_index_is_that_of_two_makers():
    """References of Leica's instruments at 12 °C, 1013.25 hPa and 60 %.

    User manuals of TPS1200 (658 nm: 286.34 ppm) and TPS1000 (780 nm: 283.04 ppm).
    """
    air = {"temperature": 285.15, "pressure": 101_325.0, "humidity": 0.6}
    assert round(1e6 * (group_index(**air, wavelength=658e-9) - 1.0), 2) == 286.34
    assert 1e6 * (group_index(**air, wavelength=780e-9) - 1.0) == pytest.approx(283.04, abs=0.01)


@pytest.mark.parametrize(
    "name, value", [("temperature", 15.0), ("pressure", 1013.0), ("humidity", 60.0)]
)
def test_air_in_another_unit_is_refused(name, value):
    air = {"temperature": 285.15, "pressure": 101_325.0, "humidity": 0.6, "wavelength": 658e-9}
    with pytest.raises(InputError, match=name):
        group_index(**{**air, name: value})


LINE = "11....+000000{n} 21.322+12345678 22.322+10000000 31...0+01000000 "
AIR = {"wavelength_nm": 658, "reference_index": 1.00028634}


def instrument(sensors=None, **keys):
    table = {"name": "ts1", "network": "dam", "source": "file:x", "grammar": "gsi-online"}
    table |= {"station": "P", "faces": 1, "post": "sights", **keys}
    tables = [table, {**table, "name": "weather", "atmosphere": None}]
    return Instrument(read_instruments(tables, where="site.toml")[0], sensors=sensors)


def distance(of, text, received=1.79e9):
    out = of.take(ReceivedLine(text.encode(), received, 1))
    found = [observation_from_record(r) for p in out for r in p.record["observations"]]
    return next((o.value for o in found if o.kind == "slope_distance"), None)


def test_prism_constants_are_added_by_the_name_of_the_network():
    prisms = {"default": -34.4, "D1": 17.5}
    of = instrument(rename={"11": "D1"}, prisms=prisms)
    assert distance(of, LINE.format(n="11")) == pytest.approx(1000.0175)
    assert distance(of, LINE.format(n="12")) == pytest.approx(999.9656)


def test_the_first_velocity_correction_has_the_size_of_the_formula():
    """+10 K make distances that the instrument computed for the reference 1 ppm/K longer."""
    stated = {"temperature_c": 22.0, "pressure_hpa": 1013.25, "humidity_percent": 60}
    found = distance(instrument(atmosphere={**AIR, **stated}), LINE.format(n="11"))
    warm = group_index(temperature=295.15, pressure=101_325, humidity=0.6, wavelength=658e-9)
    assert found == pytest.approx(1000.0 * 1.00028634 / warm, abs=1e-9)
    assert 9e-3 < found - 1000.0 < 11e-3


def test_sensors_count_for_their_age_and_distances_without_air_are_left_out():
    board = SensorBoard()
    of = instrument(board, atmosphere={**AIR, "sensor": "weather", "max_age": "10 min"})
    assert distance(of, LINE.format(n="11")) is None
    assert of.health.counts["left_out"] == 1 and "no temperature" in of.health.problem
    board.note("weather", {"temperature": 275.15, "pressure": 95_000.0}, 1.79e9)
    cold = group_index(temperature=275.15, pressure=95_000, humidity=0.6, wavelength=658e-9)
    assert distance(of, LINE.format(n="11"), 1.79e9 + 599) == pytest.approx(
        1000.0 * 1.00028634 / cold
    )
    assert distance(of, LINE.format(n="12"), 1.79e9 + 601) is None


def test_a_distance_that_is_corrected_already_is_not_corrected_again():
    of = instrument(atmosphere={**AIR, "temperature_c": 20, "pressure_hpa": 950})
    text = LINE.format(n="11") + "51....+0012+000 "
    assert distance(of, text) is None
    assert "12 ppm already" in of.health.problem


def test_sights_are_posted_at_once_with_the_orientation_of_their_set_up():
    of = instrument()
    out = []
    for n, name in enumerate(("11", "12", "13")):
        out += of.take(ReceivedLine(LINE.format(n=name).encode(), 1.79e9 + n, n))
    assert len(out) == 3
    found = [observation_from_record(r) for p in out for r in p.record["observations"]]
    directions = [o for o in found if o.kind == "direction"]
    assert len({o.set for o in directions}) == 1
    assert directions[0].value == pytest.approx(123.45678 * pi / 200)


def test_only_targets_leaves_others_out():
    of = instrument(only_targets=True, targets=["11"])
    assert distance(of, LINE.format(n="11")) is not None
    assert distance(of, LINE.format(n="12")) is None
    assert of.health.counts["left_out"] == 1
