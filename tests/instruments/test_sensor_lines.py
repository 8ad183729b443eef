"""CSV and JSON lines of sensors become quantities and observations of any kind."""

import json
import math
from datetime import UTC, datetime

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments.grammars import grammar_record
from factorgraph_adj.instruments.readings import Observed, ReceivedLine, SensorValues
from factorgraph_adj.instruments.sensor_lines import SensorLines

TILT = {
    "kind": "frame_inclination",
    "frame": "pier",
    "point": "$serial",
    "value": "$X",
    "unit": "mrad",
    "sigma_mrad": 0.01,
}
PENDULUM = {
    "kind": "coordinate_difference",
    "station": "top",
    "target": "foot",
    "axes": "xy",
    "x": "$x",
    "y": "$y",
    "unit": "mm",
    "sigma_mm": 0.1,
}
COLUMNS = ["time", "serial", "X", "T"]


def line(text):
    text = text if isinstance(text, bytes) else text.encode()
    return ReceivedLine(text, 0.0, 1)


def tilts(**options):
    given = {"columns": COLUMNS, "time": "time", "sensors": {"temperature": "T degC"}}
    return SensorLines(**{**given, "observations": [TILT], **options})


def test_the_grammar_has_its_word():
    assert grammar_record("sensor-lines").make is SensorLines


def test_a_row_of_csv_is_a_temperature_and_a_tilt():
    air, tilt = tilts().read(line("2026-06-01T12:00:00+02:00,T7,1.5,20.0\r"))
    assert isinstance(air, SensorValues) and isinstance(tilt, Observed)
    assert air.values == {"temperature": pytest.approx(293.15)}
    (o,) = tilt.observations
    assert (o.kind, o.frame, o.point) == ("frame_inclination", "pier", "T7")
    assert (o.value, o.sigma) == (pytest.approx(1.5e-3), pytest.approx(1e-5))
    assert tilt.stamped == datetime(2026, 6, 1, 10, tzinfo=UTC).timestamp()
    assert tilt.identity == "2026-06-01T12:00:00+02:00"


def test_an_observation_may_have_several_values():
    grammar = SensorLines(columns=["x", "y"], separator=";", observations=[PENDULUM])
    ((o,),) = (r.observations for r in grammar.read(line(" 1.25 ; -0.75 ")))
    assert o.value == pytest.approx((1.25e-3, -0.75e-3))


def test_json_is_nested_and_may_hold_several_rows():
    grammar = SensorLines(
        time="at",
        time_format="ms",
        sensors={"pressure": "air.p hPa", "humidity": "air.rh %", "piezo": "air.u kPa"},
    )
    row = {"at": 1780308000500, "air": {"p": 950.5, "rh": 61, "u": 12.5}}
    (one,) = grammar.read(line(json.dumps(row)))
    assert one.values == pytest.approx({"pressure": 95050.0, "humidity": 0.61, "piezo": 12500.0})
    assert one.stamped == 1780308000.5
    assert len(grammar.read(line(json.dumps([row, row])))) == 2


@pytest.mark.parametrize(
    ("quantity", "text", "unit", "expected"),
    [
        ("temperature", "68", "degF", 293.15),
        ("temperature", "-40", "degC", 233.15),
        ("temperature", "-40", "degF", 233.15),
        ("pressure", "760", "mmHg", 101325.0),
        ("pressure", "29.92126", "inHg", 101325.0),
        ("crack", "250", "um", 2.5e-4),
        ("tilt", "1", "deg", math.pi / 180),
    ],
)
def test_units_lead_to_si(quantity, text, unit, expected):
    grammar = SensorLines(columns=["a"], sensors={quantity: f"a {unit}"})
    (found,) = grammar.read(line(text))
    assert found.values[quantity] == pytest.approx(expected, rel=1e-6)


def test_missing_values_leave_out_what_uses_them():
    grammar = tilts(missing=["", "-9999"])
    (air,) = grammar.read(line("2026-06-01T12:00:00,T7,-9999,20.0"))
    assert isinstance(air, SensorValues)
    (tilt,) = grammar.read(line("2026-06-01T12:00:00,T7,1.0,"))
    assert isinstance(tilt, Observed)
    assert grammar.read(line("2026-06-01T12:00:00,T7,,")) == []
    assert SensorLines(sensors={"a": "v 1"}).read(line('{"v": null}')) == []


def test_headers_and_other_sensors_are_passed_over():
    grammar = tilts(where={"serial": "T7"})
    assert grammar.read(line("time, serial, X, T")) == []
    assert grammar.read(line("2026-06-01T12:00:00,T8,not read,x")) == []
    assert len(grammar.read(line("2026-06-01T12:00:00,T7,1,2"))) == 2


def test_times_have_a_format():
    grammar = tilts(time_format="%d.%m.%y %H:%M", sensors={})
    (tilt,) = grammar.read(line("01.06.26 12:30,T7,1,2"))
    assert tilt.stamped == datetime(2026, 6, 1, 12, 30, tzinfo=UTC).timestamp()
    (tilt,) = SensorLines(columns=["X"], observations=[{**TILT, "point": "P"}]).read(line("1"))
    assert tilt.stamped is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2026-06-01T12:00:00,T7,1.5", "3 fields for 4 stated columns"),
        ("2026-06-01T12:00:00,T7,1.5,20,3", "5 fields for 4 stated columns"),
        ("2026-06-01T12:00:00,T7,1.5,warm", "'T' must be a number, not 'warm'"),
        ("2026-06-01T12:00:00,T7,1_5,20", "1_5"),
        ("2026-06-01T12:00:00,T7,1.5,inf", "must be a number"),
        ("yesterday,T7,1.5,20", "no time of the format"),
        ('{"time": 3}', "'serial' is not there"),
        ("{", "not JSON"),
        ("[1]", "must hold objects"),
        (b"\xff,T7,1,2", "UTF-8"),
        ("2026-06-01T12:00:00,,1.5,20,", "5 fields"),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_reason(text, message):
    with pytest.raises(InputError, match=message):
        tilts().read(line(text))


def test_all_problems_of_a_line_come_together():
    with pytest.raises(InputError) as caught:
        tilts().read(line("yesterday,T7,a,b"))
    assert len(caught.value.problems) == 3


def test_csv_needs_columns():
    with pytest.raises(InputError, match="columns of CSV are not stated"):
        SensorLines(sensors={"a": "v 1"}).read(line("1,2"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sensors": None, "observations": None}, "state sensors, observations or both"),
        ({"sensors": {"temperature": "T"}}, "a column and a unit"),
        ({"sensors": {"temperature": "T hPa"}}, "unknown unit 'hPa'"),
        ({"sensors": {"temperature": "t degC"}}, "unknown column 't'"),
        ({"time": "at"}, "unknown column 'at'"),
        ({"where": {"a": 1}}, "unknown column 'a'"),
        ({"columns": ["a", "a"]}, "same name"),
        ({"separator": "::"}, "one character"),
        ({"observations": [{**TILT, "kind": "tilt"}]}, "unknown kind 'tilt'"),
        ({"observations": [{**TILT, "value": "$Y"}]}, "unknown column 'Y'"),
        ({"observations": [{**TILT, "value": 1.0, "point": "P"}]}, "no field is a column"),
        ({"observations": [{k: v for k, v in TILT.items() if k != "unit"}]}, "unit of the values"),
        ({"observations": [{k: v for k, v in TILT.items() if k[0] != "s"}]}, "standard deviation"),
        ({"observations": [{k: v for k, v in TILT.items() if k != "frame"}]}, "frame"),
        ({"observations": [{**TILT, "colour": "red"}]}, "colour"),
        ({"observations": [{**TILT, "unit": "mm"}]}, "mm"),
        ({"observations": ["x"]}, "table of fields"),
    ],
)
def test_options_that_are_wrong_are_refused_before_any_line(options, message):
    with pytest.raises(InputError, match=message):
        tilts(**options)
